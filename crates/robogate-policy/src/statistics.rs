//! Ranges of states, from the statistics that authors publish with a checkpoint.
//!
//! Four layouts are known: openpi's `norm_stats.json`, `dataset_statistics.json` of OpenVLA and OpenVLA-OFT, GR00T's
//! `statistics.json` (N1.6 and N1.7) and `experiment_cfg/metadata.json` (N1.5), and LeRobot's `meta/stats.json`.

use robogate_core::budget::Budget;
use serde_json::Value as Json;

use super::profile::Profile;

/// Part of the width of a range between quantiles by which it is widened at both ends. Quantiles leave out 2 % of the
/// training data, and a gripper at its end stop is one of them.
const MARGIN: f64 = 0.1;

/// Why statistics cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct StatisticsError(String);

fn wrong<T>(why: impl Into<String>) -> Result<T, StatisticsError> {
    Err(StatisticsError(why.into()))
}

/// The range of each number of the states in the training data of a checkpoint.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    states: States,
}

#[derive(Debug, Clone, PartialEq)]
enum States {
    /// All states in one vector, in the order of the profile.
    Together(Range),
    /// Each state by the name that the server uses.
    Named(Vec<(String, Range)>),
}

#[derive(Debug, Clone, PartialEq)]
struct Range {
    low: Vec<f64>,
    high: Vec<f64>,
}

impl Statistics {
    /// Reads a file of statistics. `group` selects the training set or the embodiment, if the file has several.
    ///
    /// # Errors
    /// If the text is not JSON, has no statistics of states, or needs a `group`.
    pub fn from_json(text: &str, group: Option<&str>) -> Result<Self, StatisticsError> {
        let file: Json = Budget::FILE.json(text.as_bytes()).map_err(|error| StatisticsError(error.to_string()))?;
        let root = file.get("norm_stats").unwrap_or(&file);
        let found = match (section(root), group) {
            (Some(section), None) => section,
            (Some(_), Some(group)) => {
                return wrong(format!("the file has one group without a name, but `{group}` is selected"));
            }
            (None, group) => self::group(root, group)?,
        };
        let states = if found.get("mean").or_else(|| found.get("min")).is_some() {
            States::Together(range(found, "the state")?)
        } else {
            let Some(entries) = found.as_object() else { return wrong("the statistics of the states are not a map") };
            let named = entries.iter().map(|(name, entry)| Ok((name.clone(), range(entry, name)?)));
            States::Named(named.collect::<Result<_, StatisticsError>>()?)
        };
        Ok(Self { states })
    }

    /// The profile with the ranges of its states. `sizes` has the number of elements of each state of the profile.
    ///
    /// # Errors
    /// If names or sizes of the states differ.
    pub fn apply(&self, profile: &Profile, sizes: &[usize]) -> Result<Profile, StatisticsError> {
        let mut result = profile.clone();
        match &self.states {
            States::Together(range) => {
                let total: usize = sizes.iter().sum();
                if total != range.low.len() {
                    let published = range.low.len();
                    return wrong(format!(
                        "the statistics are for {published} numbers, but the states of the profile have {total}"
                    ));
                }
                let (mut low, mut high) = (range.low.iter(), range.high.iter());
                for (state, size) in result.states.iter_mut().zip(sizes) {
                    state.low = low.by_ref().take(*size).copied().collect();
                    state.high = high.by_ref().take(*size).copied().collect();
                }
            }
            States::Named(named) => {
                for (state, size) in result.states.iter_mut().zip(sizes) {
                    let Some((_, range)) = named.iter().find(|(name, _)| *name == state.key) else {
                        let known: Vec<&str> = named.iter().map(|(name, _)| name.as_str()).collect();
                        return wrong(format!(
                            "no statistics of the state `{}`. Known: {}",
                            state.key,
                            known.join(", ")
                        ));
                    };
                    if range.low.len() != *size {
                        return wrong(format!(
                            "the statistics of the state `{}` are for {} numbers, but the profile has {size}",
                            state.key,
                            range.low.len()
                        ));
                    }
                    (state.low, state.high) = (range.low.clone(), range.high.clone());
                }
            }
        }
        Ok(result)
    }
}

/// The statistics of the states in one group.
fn section(group: &Json) -> Option<&Json> {
    let inner = group.get("statistics").unwrap_or(group);
    ["state", "proprio", "observation.state"].iter().find_map(|name| inner.get(name)).filter(|found| found.is_object())
}

/// The section of the group with this name, or of the only one.
fn group<'a>(root: &'a Json, name: Option<&str>) -> Result<&'a Json, StatisticsError> {
    let entries = root.as_object().map(|map| map.iter().collect::<Vec<_>>()).unwrap_or_default();
    let groups: Vec<(&String, &Json)> =
        entries.into_iter().filter_map(|(name, group)| Some((name, section(group)?))).collect();
    let known = || groups.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ");
    match (groups.as_slice(), name) {
        ([], _) => wrong(
            "no statistics of states found. Expected a file such as norm_stats.json, dataset_statistics.json, statistics.json \
             or stats.json",
        ),
        ([(_, only)], None) => Ok(only),
        (_, None) => wrong(format!("the file has several groups: {}. Hint: select one", known())),
        (groups, Some(name)) => match groups.iter().find(|(known, _)| *known == name) {
            Some((_, found)) => Ok(found),
            None => wrong(format!("no group `{name}`. Known: {}", known())),
        },
    }
}

/// The range of one vector: from the smallest to the largest value, or between the quantiles of 1 % and 99 % with a
/// margin.
fn range(entry: &Json, name: &str) -> Result<Range, StatisticsError> {
    let numbers = |key: &str| -> Option<Vec<f64>> {
        let numbers: Vec<f64> = entry.get(key)?.as_array()?.iter().map(Json::as_f64).collect::<Option<_>>()?;
        numbers.iter().all(|n| n.is_finite()).then_some(numbers)
    };
    let pair = |low, high| Some((numbers(low)?, numbers(high)?));
    let (mut low, mut high) = match (pair("min", "max"), pair("q01", "q99")) {
        (Some(extremes), _) => extremes,
        (None, Some((low, high))) => {
            let widened = |from: &[f64], to: &[f64]| -> Vec<f64> {
                from.iter().zip(to).map(|(from, to)| from - MARGIN * (to - from)).collect()
            };
            (widened(&low, &high), widened(&high, &low))
        }
        (None, None) => return wrong(format!("{name}: neither `min` and `max` nor `q01` and `q99`")),
    };
    if low.len() != high.len() || low.is_empty() {
        return wrong(format!("{name}: {} lower and {} upper limits", low.len(), high.len()));
    }
    low.iter_mut().zip(&mut high).filter(|(low, high)| low > high).for_each(|(low, high)| std::mem::swap(low, high));
    Ok(Range { low, high })
}

#[cfg(test)]
mod tests {
    use serde_json::Map;

    use super::*;

    fn profile(name: &str) -> Profile {
        Profile::from_toml(Profile::built_in(name).unwrap()).unwrap()
    }

    fn eight(value: f64) -> Vec<f64> {
        (0..8).map(|i| value * f64::from(i + 1)).collect()
    }

    #[test]
    fn openpi_quantiles_get_a_margin() {
        let state = serde_json::json!({"mean": eight(0.0), "std": eight(0.1), "q01": eight(-1.0), "q99": eight(1.0)});
        let text = serde_json::json!({"norm_stats": {"state": state, "actions": {}}}).to_string();
        let statistics = Statistics::from_json(&text, None).unwrap();
        let one = statistics.apply(&profile("pi05-libero"), &[8]).unwrap();
        assert!((one.states[0].high[1] - 2.4).abs() < 1e-12 && (one.states[0].low[1] + 2.4).abs() < 1e-12);
        // Two states of the profile, and one vector in the file.
        let two = statistics.apply(&profile("pi05-droid"), &[7, 1]).unwrap();
        assert_eq!((two.states[0].low.len(), two.states[1].low.len()), (7, 1));
        assert!((two.states[1].high[0] - 9.6).abs() < 1e-12);
        assert!(statistics.apply(&profile("pi05-droid"), &[7, 2]).unwrap_err().to_string().contains("have 9"));
        assert!(Statistics::from_json(&text, Some("x")).is_err());
    }

    #[test]
    fn openvla_groups_are_selected() {
        let proprio = serde_json::json!({"min": eight(-1.0), "max": eight(1.0), "q01": eight(-0.1), "q99": eight(0.1)});
        let set = serde_json::json!({"action": {"min": [0.0]}, "proprio": proprio, "num_transitions": 3});
        let text = serde_json::json!({"libero_spatial_no_noops": set, "bridge_orig": set}).to_string();
        let chosen = Statistics::from_json(&text, Some("bridge_orig")).unwrap();
        assert_eq!(chosen.apply(&profile("openvla-oft"), &[8]).unwrap().states[0].high, eight(1.0));
        let error = Statistics::from_json(&text, None).unwrap_err().to_string();
        assert!(error.contains("bridge_orig, libero_spatial_no_noops"), "{error}");
        assert!(Statistics::from_json(&text, Some("fractal")).is_err());
    }

    #[test]
    fn gr00t_states_have_names() {
        let one =
            |size: usize| serde_json::json!({"min": vec![-1.0; size], "max": vec![1.0; size], "mean": vec![0.0; size]});
        let names = ["x", "y", "z", "roll", "pitch", "yaw"].map(|name| (name.to_owned(), one(1)));
        let mut state: Map<String, Json> = names.into_iter().collect();
        state.insert("gripper".to_owned(), one(2));
        // N1.6 and N1.7, and N1.5.
        for tag in [serde_json::json!({"state": state}), serde_json::json!({"statistics": {"state": state}})] {
            let text = serde_json::json!({"libero_sim": tag}).to_string();
            let statistics = Statistics::from_json(&text, None).unwrap();
            let profile = profile("gr00t-n1.7-libero");
            let ranged = statistics.apply(&profile, &[1, 1, 1, 1, 1, 1, 2]).unwrap();
            assert_eq!(ranged.states[6].low, [-1.0, -1.0]);
            assert!(statistics.apply(&profile, &[1, 1, 1, 1, 1, 1, 1]).is_err());
            ranged.check().unwrap();
        }
    }

    #[test]
    fn lerobot_statistics_are_read() {
        let text =
            serde_json::json!({"observation.state": {"min": eight(-2.0), "max": eight(2.0)}, "action": {}}).to_string();
        let ranged = Statistics::from_json(&text, None).unwrap().apply(&profile("smolvla"), &[8]).unwrap();
        assert_eq!(ranged.states[0].low, eight(-2.0));
    }

    #[test]
    fn other_files_are_rejected() {
        for text in [
            "",
            "[]",
            "{}",
            "3",
            r#"{"state": {"mean": [1]}}"#,
            r#"{"state": {"min": [1], "max": []}}"#,
            r#"{"state": {"x": 3}}"#,
        ] {
            assert!(Statistics::from_json(text, None).is_err(), "{text}");
        }
    }
}
