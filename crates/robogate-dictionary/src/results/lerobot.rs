//! Reads LeRobot's `eval_info.json`, as written by `lerobot-eval`.
//!
//! There are two layouts: `per_episode`, an array of objects with `success` and `seed` (one environment), and
//! `per_task`, an array of `task_group`, `task_id` and `metrics`, whose `successes` has one entry per episode (several
//! tasks). LeRobot does not record crashed episodes: an error ends the evaluation, and no file is written. Here an
//! episode is invalid only if its `success` is missing.

use std::fmt;
use std::path::Path;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::flat::{RowArray, Rows, Scalars, TaskArray, TaskObject};
use super::{Frame, Mapping, SOURCE_EPISODE, Sink};
use crate::DictionaryError;
use crate::raw::{AnyScalar, Scalar};

/// Rewards are measures. Only the seed, or the number of the episode within its task, is a parameter.
pub(super) fn mapping() -> Mapping {
    Mapping { parameters: Some(std::collections::BTreeMap::new()), ..Mapping::default() }
}

pub(super) fn read(path: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    let mut frame = Frame::default();
    let (mut counted, mut found) = (Counts::default(), false);
    let mut counting = |row: &crate::raw::RawRow| {
        counted.episodes += 1;
        counted.successes += u64::from(row.get("success") == Some(&Scalar::Bool(true)));
        counted.silent += u64::from(matches!(row.get("success"), None | Some(Scalar::Null)));
        sink(row)
    };
    frame.sha256 = Rows::read(path, &mut counting, |rows, json| {
        json.deserialize_map(Whole { rows, metadata: &mut frame.metadata, found: &mut found })
    })?;
    if !found {
        let reason =
            "it has neither `per_episode` nor `per_task`. Expected episodes: averages alone cannot be imported";
        return Err(DictionaryError::results(path, reason));
    }
    counted.check(path, &frame)?;
    Ok(frame)
}

/// Totals over the rows.
#[derive(Default)]
struct Counts {
    episodes: u64,
    successes: u64,
    silent: u64,
}

impl Counts {
    /// Checks that the file's averages match its rows.
    fn check(&self, path: &Path, frame: &Frame) -> Result<(), DictionaryError> {
        let claimed = |key: &str| frame.metadata.get(key).and_then(serde_json::Value::as_f64);
        if let Some(n) = claimed("n_episodes")
            && (n - self.episodes as f64).abs() > 0.5
        {
            let reason = format!("its `overall.n_episodes` is {n}, but it has {} episodes", self.episodes);
            return Err(DictionaryError::results(path, reason));
        }
        let percent = 100.0 * self.successes as f64 / self.episodes.max(1) as f64;
        if let Some(claimed) = claimed("pc_success")
            && self.silent == 0
            && (claimed - percent).abs() > 1e-3
        {
            let reason = format!(
                "its `pc_success` is {claimed}, but it has {} successes in {} episodes ({percent:.4} %)",
                self.successes, self.episodes
            );
            return Err(DictionaryError::results(path, reason));
        }
        Ok(())
    }
}

struct Whole<'a, 'b> {
    rows: &'a mut Rows<'b>,
    metadata: &'a mut serde_json::Map<String, serde_json::Value>,
    found: &'a mut bool,
}

impl<'de> Visitor<'de> for Whole<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with `per_episode` or `per_task`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "per_episode" | "per_task" if *self.found => {
                    return Err(A::Error::custom("it has episodes twice (`per_episode`, `per_task`)"));
                }
                "per_episode" => {
                    *self.found = true;
                    map.next_value_seed(RowArray(&mut *self.rows, |_: &mut Rows<'_>| ()))?;
                }
                "per_task" => {
                    *self.found = true;
                    map.next_value_seed(TaskArray::<Task>::new(&mut *self.rows))?;
                }
                "aggregated" | "overall" => map.next_value_seed(Scalars(&mut *self.metadata))?,
                _ => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        Ok(())
    }
}

/// A task of `per_task`.
enum Task {}

impl TaskObject for Task {
    const EXPECTED: &'static str = "a task with `task_group`, `task_id` and `metrics`";

    fn read<'de, A: MapAccess<'de>>(rows: &mut Rows<'_>, mut map: A) -> Result<(), A::Error> {
        let (mut group, mut id, mut metrics) = (Scalar::Null, Scalar::Null, None);
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "task_group" => group = map.next_value_seed(AnyScalar)?,
                "task_id" => id = map.next_value_seed(AnyScalar)?,
                "metrics" => metrics = Some(map.next_value_seed(Metrics)?),
                _ => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        let metrics: OfTask = metrics.unwrap_or_default();
        let Some(successes) = metrics.successes else {
            return Err(A::Error::custom("a task of `per_task` has no `metrics.successes`"));
        };
        let word = |value: &Scalar| match value {
            Scalar::Text(text) => Some(text.clone()),
            Scalar::Integer(n) => Some(n.to_string()),
            Scalar::Unsigned(n) => Some(n.to_string()),
            Scalar::Null | Scalar::Bool(_) | Scalar::Number(_) | Scalar::Nested => None,
        };
        let (group, id) = (word(&group), word(&id));
        for (episode, success) in successes.into_iter().enumerate() {
            rows.push("success", success.map_or(Scalar::Null, Scalar::Bool));
            rows.push(SOURCE_EPISODE, Scalar::Integer(episode as i64));
            for (name, values) in &metrics.rewards {
                rows.push(name, values.get(episode).cloned().unwrap_or(Scalar::Null));
            }
            if let Some(group) = &group {
                rows.push("category", Scalar::Text(group.clone()));
            }
            if let Some(id) = &id {
                let case = group.as_ref().map_or_else(|| id.clone(), |group| format!("{group}/{id}"));
                rows.push("case", Scalar::Text(case));
            }
            rows.finish_row()?;
        }
        Ok(())
    }
}

/// The metrics of one task, with one value per episode.
#[derive(Default)]
struct OfTask {
    successes: Option<Vec<Option<bool>>>,
    rewards: Vec<(&'static str, Vec<Scalar>)>,
}

struct Metrics;

impl<'de> DeserializeSeed<'de> for Metrics {
    type Value = OfTask;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Metrics {
    type Value = OfTask;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("metrics with `successes`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut metrics = OfTask::default();
        while let Some(key) = map.next_key::<String>()? {
            // The meter of the file limits the number of values.
            match key.as_str() {
                "successes" => metrics.successes = Some(map.next_value()?),
                "sum_rewards" => metrics.rewards.push(("sum_reward", map.next_value_seed(Values)?)),
                "max_rewards" => metrics.rewards.push(("max_reward", map.next_value_seed(Values)?)),
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        Ok(metrics)
    }
}

/// An array of values.
struct Values;

impl<'de> DeserializeSeed<'de> for Values {
    type Value = Vec<Scalar>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Values {
    type Value = Vec<Scalar>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of numbers")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = seq.next_element_seed(AnyScalar)? {
            values.push(value);
        }
        Ok(values)
    }
}
