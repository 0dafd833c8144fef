//! The simulated episode that is most similar to a real cycle.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::cycle::ParameterValue;

/// A simulated episode.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedEpisode {
    /// Its index in the campaign.
    pub index: u64,
    /// `success`, or the failure mode.
    pub outcome: String,
    /// Its parameters by name.
    pub parameters: BTreeMap<String, ParameterValue>,
}

/// The episodes of a run.
#[derive(Debug, Clone)]
pub struct Episodes {
    /// The run's folder, for commands.
    run: String,
    /// The number of the run for [`Replays`](super::Replays). `None` if its episodes cannot be replayed here.
    replayed: Option<usize>,
    episodes: Vec<SimulatedEpisode>,
    /// The difference between the largest and the smallest value of each numeric parameter.
    spans: BTreeMap<String, f64>,
}

/// The simulated episode that is nearest to a cycle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NearestEpisode {
    /// Its index in the campaign.
    pub index: u64,
    /// `success`, or the failure mode.
    pub outcome: String,
    /// Root mean square of the differences over the compared parameters: 0 is equal, and 1 is a whole range apart.
    pub distance: f64,
    /// The compared parameters.
    pub parameters: Vec<String>,
    /// Their values in the episode.
    pub values: BTreeMap<String, ParameterValue>,
    /// The command that replays it.
    pub command: String,
    /// The number of its run for `GET /v1/replay`. `None` if its episodes cannot be replayed here.
    pub run: Option<usize>,
}

impl Episodes {
    /// The episodes of the run in this folder.
    pub fn new(run: String, episodes: Vec<SimulatedEpisode>) -> Self {
        let mut ranges: BTreeMap<&str, [f64; 2]> = BTreeMap::new();
        for (name, value) in episodes.iter().flat_map(|episode| &episode.parameters) {
            if let ParameterValue::Number(x) = value {
                let [low, high] = ranges.entry(name).or_insert([*x, *x]);
                (*low, *high) = (low.min(*x), high.max(*x));
            }
        }
        let spans = ranges.into_iter().map(|(name, [low, high])| (name.to_owned(), high - low)).collect();
        Self { run, replayed: None, episodes, spans }
    }

    /// The same episodes, which run number `run` of [`Replays`](super::Replays) can replay.
    #[must_use]
    pub fn replayed(self, run: usize) -> Self {
        Self { replayed: Some(run), ..self }
    }

    /// Whether its episodes can be replayed.
    pub(super) fn can_replay(&self) -> bool {
        self.replayed.is_some()
    }

    /// The nearest episode among those that `wanted` accepts. `None` if the cycle reports no parameter of the run. Of equally
    /// near episodes, the first one.
    pub fn nearest(
        &self,
        cycle: &BTreeMap<String, ParameterValue>,
        wanted: impl Fn(&SimulatedEpisode) -> bool,
    ) -> Option<NearestEpisode> {
        let (mut best, mut least) = (None, f64::INFINITY);
        for episode in self.episodes.iter().filter(|episode| wanted(episode)) {
            if let Some(distance) = self.distance(cycle, episode).filter(|distance| *distance < least) {
                (best, least) = (Some(episode), distance);
            }
        }
        let episode = best?;
        let compared = episode.parameters.iter().filter(|(name, _)| cycle.contains_key(*name));
        let values: BTreeMap<String, ParameterValue> =
            compared.map(|(name, value)| (name.clone(), value.clone())).collect();
        Some(NearestEpisode {
            index: episode.index,
            outcome: episode.outcome.clone(),
            distance: least,
            parameters: values.keys().cloned().collect(),
            values,
            run: self.replayed,
            command: format!("robogate replay {} {}", self.run, episode.index),
        })
    }

    /// The nearest failure: one of this mode, or of any mode if no comparable episode has it.
    pub fn nearest_failure(
        &self,
        cycle: &BTreeMap<String, ParameterValue>,
        mode: Option<&str>,
    ) -> Option<NearestEpisode> {
        let failed = |one: &SimulatedEpisode| one.outcome != "success";
        let alike = mode.and_then(|mode| self.nearest(cycle, |one| failed(one) && one.outcome == mode));
        alike.or_else(|| self.nearest(cycle, failed))
    }

    /// Root mean square difference over the parameters that both have.
    fn distance(&self, cycle: &BTreeMap<String, ParameterValue>, episode: &SimulatedEpisode) -> Option<f64> {
        let (mut sum, mut n) = (0.0, 0_u32);
        for (name, theirs) in &episode.parameters {
            let difference = match (cycle.get(name), theirs) {
                (Some(ParameterValue::Number(a)), ParameterValue::Number(b)) => {
                    let span = self.spans.get(name).copied().unwrap_or_default();
                    if span > 0.0 { (a - b) / span } else { f64::from(a.total_cmp(b).is_ne()) }
                }
                (Some(ours), theirs) => f64::from(ours != theirs),
                (None, _) => continue,
            };
            sum += difference * difference;
            n += 1;
        }
        (n > 0).then(|| (sum / f64::from(n)).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(mass: f64, shape: &str) -> BTreeMap<String, ParameterValue> {
        let words = ParameterValue::Word(shape.to_owned());
        BTreeMap::from([("mass_kg".to_owned(), ParameterValue::Number(mass)), ("shape".to_owned(), words)])
    }

    #[test]
    fn nearest_episode_is_found() {
        let episode = |index, outcome: &str, mass, shape| SimulatedEpisode {
            index,
            outcome: outcome.to_owned(),
            parameters: values(mass, shape),
        };
        let all =
            vec![episode(0, "success", 0.0, "box"), episode(1, "jam", 0.5, "ball"), episode(2, "jam", 2.0, "box")];
        let episodes = Episodes::new("runs/a".to_owned(), all);
        let near = |mass, shape, failed: bool| {
            episodes.nearest(&values(mass, shape), |one| !failed || one.outcome != "success").unwrap()
        };
        assert_eq!(near(0.4, "box", false).index, 0);
        assert_eq!(near(0.4, "box", false).values, values(0.0, "box"));
        assert_eq!(near(0.6, "ball", false).command, "robogate replay runs/a 1");
        assert_eq!(near(1.9, "box", true).index, 2);
        assert!((near(1.9, "box", true).distance - 0.05 / 2_f64.sqrt()).abs() < 1e-12);
        // A failure of the same mode is preferred to a nearer one.
        let all = vec![episode(0, "jam", 0.5, "box"), episode(1, "grip_loss", 2.0, "ball")];
        let episodes = Episodes::new("runs/a".to_owned(), all);
        let failure = |mode| episodes.nearest_failure(&values(0.4, "box"), mode).unwrap().index;
        assert_eq!([failure(None), failure(Some("grip_loss")), failure(Some("drop"))], [0, 1, 0]);
        // No common parameter.
        assert_eq!(episodes.nearest(&BTreeMap::new(), |_| true), None);
    }
}
