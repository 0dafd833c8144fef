//! Rows of a dictionary as cycles: episodes of a run, and imported results such as datasets of LeRobot.

use std::path::Path;

use anyhow::Context;
use clap::Args;
use robogate_analysis::Source;
use robogate_core::{FailureMode, Outcome, Value};
use robogate_monitor::{Cycle, ParameterValue};
use robogate_session::open_source;
use robogate_stats::format::counted;

use super::bag::Found;
use crate::terminal::note;

/// The time of an episode whose duration is unknown, in seconds.
const UNKNOWN_S: f64 = 1.0;

/// What the rows of a dictionary do not say.
#[derive(Debug, Clone, Default, Args)]
pub(super) struct OfRows {
    /// Set the robot of the cycles of a dictionary; default: that of the dictionary
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
    /// Set the recipe of the cycles of a dictionary; default: its task
    #[arg(long, value_name = "NAME")]
    recipe: Option<String>,
    /// Set the time of the first episode of a dictionary, in seconds since 1970-01-01 UTC; the others follow by their durations
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = crate::number::not_negative)]
    since: f64,
}

/// Says how many episodes do not become cycles.
pub(super) fn say_left_out(invalid: u64) {
    if invalid > 0 {
        note(format_args!("{} left out: they say nothing about the policy", counted(invalid, "invalid episode")));
    }
}

/// Whether a path is a dictionary (Parquet) or the folder of a run.
pub(super) fn is_dictionary(path: &Path) -> bool {
    let parquet = path.extension().is_some_and(|extension| extension == "parquet");
    parquet || path.join(robogate_campaign::folder::DICTIONARY).is_file()
}

impl OfRows {
    /// Whether a value is given.
    pub(super) fn any(&self) -> bool {
        self.robot.is_some() || self.recipe.is_some() || self.since > 0.0
    }

    /// The names of the parameters of a dictionary.
    pub(super) fn parameters(path: &Path) -> Result<Vec<String>, robogate_session::Failure> {
        let source = open_source(path)?;
        let space = &source.dictionary().provenance().space;
        Ok(space.parameters().iter().map(|of| of.name.to_string()).collect())
    }

    /// Passes on the cycles of a dictionary. An invalid episode says nothing about the policy, and is left out. Returns their number.
    pub(super) fn cycles(&self, path: &Path, each: &mut dyn FnMut(Found) -> Result<(), String>) -> anyhow::Result<u64> {
        let source: Source = open_source(path)?;
        let dictionary = source.dictionary();
        let provenance = dictionary.provenance();
        let hash = dictionary.dataset_hash();
        let prefix = hash.get(..12).unwrap_or(hash);
        let robot = self.robot.clone().unwrap_or_else(|| provenance.robot.name.clone());
        let recipe = self.recipe.clone().unwrap_or_else(|| provenance.task.name.to_string());
        let (mut time_s, mut number, mut invalid) = (self.since, 0_u64, 0_u64);
        for entry in dictionary.entries() {
            let episode = entry.with_context(|| path.display().to_string())?.episode;
            let duration_s = Some(episode.time_s).filter(|time| time.is_finite() && *time > 0.0);
            time_s += duration_s.unwrap_or(UNKNOWN_S);
            let failure = match &episode.outcome {
                Outcome::Success => None,
                Outcome::Failure(mode) => Some(*mode),
                Outcome::Invalid(_) => {
                    invalid += 1;
                    continue;
                }
            };
            let parameters = episode.scenario.requested.iter().map(|(name, value)| {
                let value = match value {
                    Value::Number(number) => ParameterValue::Number(*number),
                    Value::Integer(number) => ParameterValue::Number(*number as f64),
                    Value::Category(word) => ParameterValue::Word(word.to_string()),
                };
                (name.to_owned(), value)
            });
            let cycle = Cycle {
                id: format!("{prefix}/{number}"),
                robot: robot.clone(),
                recipe: recipe.clone(),
                time_s,
                success: failure.is_none(),
                failure_mode: failure.filter(|mode| *mode != FailureMode::UNKNOWN).map(|mode| mode.as_str().to_owned()),
                events: std::collections::BTreeMap::new(),
                cycle_time_s: duration_s,
                parameters: parameters.collect(),
            };
            number += 1;
            let checked = cycle.check().map(|()| cycle).map_err(|error| error.to_string());
            each(Found::Cycle(checked)).map_err(anyhow::Error::msg)?;
        }
        Ok(invalid)
    }
}
