//! The reference file: baseline, envelope and risk model of a run. `robogate monitor reference` writes it.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::baseline::{Baseline, BaselineError};
use crate::domain::{Domain, DomainError};
use crate::settings::Settings;

/// Baseline and validated region of one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// The version of the format: 1.
    pub version: u32,
    /// The robot that was evaluated.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// The population whose success rate is estimated.
    pub population: String,
    /// The content hash of the rows.
    pub dataset_sha256: String,
    /// SHA-256 (hex) of the file of real trials that the success rate of the baseline comes from. Absent if it comes from the
    /// run, or if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub real_trials_sha256: Option<String>,
    /// The folder of the run, from the folder of this file. The monitor's page replays its episodes if they are still there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
    /// Successes and failure modes, as counts. Cycle times are learnt from the robot, because those of a simulator
    /// differ.
    pub baseline: Baseline,
    /// The envelope, and the risk model if the run allows one.
    pub domain: Domain,
    /// Whether the run was made in a simulator. Its mix of failure modes then differs from that of the robot.
    #[serde(default)]
    pub simulated: bool,
    /// The smallest success rate that the run's gate accepts, in simulation and on the real robot. Absent in files of version
    /// 0.2 and older.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub required_success: Option<f64>,
}

/// An error in a reference file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReferenceError {
    /// The file has another version.
    #[error("the reference has version {0}. Expected version {version}", version = Reference::VERSION)]
    Version(u32),
    /// The baseline is invalid.
    #[error(transparent)]
    Baseline(#[from] BaselineError),
    /// The validated region is invalid.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// A baseline that the gate would reject.
    #[error(
        "the baseline is a success rate of {:.1} %, below the {:.1} % that the gate requires: a monitor with it would accept what the gate rejects\n\
         Hint: use the run of a gate that passed, or leave the rate out with `robogate monitor reference RUN --learn-baseline`; the monitor then \
         learns it from the first cycles of the robot",
        100.0 * rate,
        100.0 * required
    )]
    BelowGate {
        /// The success rate of the baseline.
        rate: f64,
        /// The smallest rate that the gate accepts.
        required: f64,
    },
    /// A mix of failure modes from a simulator.
    #[error(
        "the mix of failure modes comes from a simulator, so every robot would raise an alarm about it\nHint: write the reference again with \
         `robogate monitor reference RUN`; the monitor then learns the mix from the robot"
    )]
    SimulatedModes,
}

impl Reference {
    /// The version that this build writes and reads.
    pub const VERSION: u32 = 1;

    /// Checks the version and all parts.
    ///
    /// # Errors
    /// The first problem.
    pub fn check(&self) -> Result<(), ReferenceError> {
        if self.version != Self::VERSION {
            return Err(ReferenceError::Version(self.version));
        }
        self.baseline.check()?;
        if let (Some(rate), Some(required)) = (self.baseline.success_rate(), self.required_success)
            && rate < required
        {
            return Err(ReferenceError::BelowGate { rate, required });
        }
        if self.simulated && self.baseline.failure_modes.is_some() {
            return Err(ReferenceError::SimulatedModes);
        }
        Ok(self.domain.check()?)
    }
}

impl Settings {
    /// Applies a reference to a recipe, or to all recipes without their own. A baseline in the settings takes
    /// precedence over the reference.
    pub fn refer(&mut self, recipe: Option<&str>, reference: Reference) {
        let domain = Arc::new(reference.domain);
        let baseline = match recipe {
            Some(recipe) => {
                self.domains.insert(recipe.to_owned(), domain);
                let common = &self.baseline;
                self.recipes.entry(recipe.to_owned()).or_insert_with(|| common.clone())
            }
            None => {
                self.domain = Some(domain);
                &mut self.baseline
            }
        };
        let Baseline { success, events, failure_modes, cycle_times_s } = reference.baseline;
        baseline.success = baseline.success.or(success);
        for (name, count) in events {
            baseline.events.entry(name).or_insert(count);
        }
        baseline.failure_modes = baseline.failure_modes.take().or(failure_modes);
        baseline.cycle_times_s = baseline.cycle_times_s.take().or(cycle_times_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Count;

    #[test]
    fn settings_precede_references() {
        let of = |count| Reference {
            version: 1,
            robot: "r".to_owned(),
            policy: "p".to_owned(),
            population: "x".to_owned(),
            dataset_sha256: String::new(),
            real_trials_sha256: None,
            run: None,
            baseline: Baseline { success: Some(Count { count, of: 100 }), ..Baseline::default() },
            domain: Domain::default(),
            simulated: true,
            required_success: Some(0.92),
        };
        let own = Some(Count { count: 3, of: 100 });
        let mut settings = Settings::default();
        settings.recipes.insert("c".to_owned(), Baseline { success: own, ..Baseline::default() });
        for recipe in ["b", "c"] {
            settings.refer(Some(recipe), of(90));
        }
        settings.refer(None, of(95));
        let count = |recipe| settings.baseline_of(recipe).success.map(|c| c.count);
        assert_eq!([count("a"), count("b"), count("c")], [Some(95), Some(90), Some(3)]);
        assert!(Reference { version: 2, ..of(1) }.check().is_err());
        assert!(matches!(of(29).check(), Err(ReferenceError::BelowGate { .. })));
        assert!(of(93).check().is_ok());
        let modes = Baseline { failure_modes: Some([("jammed", 3)].into_iter().collect()), ..of(93).baseline };
        assert_eq!(Reference { baseline: modes, ..of(93) }.check(), Err(ReferenceError::SimulatedModes));
    }
}
