//! Trials of the real robot as evidence for requirements on the real success rate.
//!
//! The trials are divided into two strata by a simulation that never saw them. Both p-values and the interval are those
//! of [`robogate_stats::exact_strata`]: exact for any number of trials and any quality of the simulation. The trials were
//! not collected in the gate's rounds, so their number counts as fixed.

use std::path::Path;

use robogate_core::budget::Budget;
use robogate_stats::Trials;
use robogate_stats::exact_strata::{MOST_TRIALS, Stratum, bounds, estimate, p_above, p_below};
use robogate_stats::format::count;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::figure::Extremes;
use crate::requirement_test::Tested;
use crate::{Bound, GateError, Record, Sense};

/// Trials of the real robot, and the simulation that divides them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RealEvidence {
    /// Version of the format.
    pub format: u32,
    /// The task.
    pub task: String,
    /// The robot.
    pub robot: String,
    /// SHA-256 (hex) over the files of the simulated robot. Absent if it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot_sha256: Option<String>,
    /// The policy.
    pub policy: String,
    /// SHA-256 (hex) of the policy. Absent if it is unknown, and for a policy that is built into RoboGate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy_sha256: Option<String>,
    /// The population of the trials, in one sentence.
    pub population: String,
    /// SHA-256 (hex) of the file of trials.
    pub trials_sha256: String,
    /// SHA-256 (hex) of the simulation's rows.
    pub simulation_sha256: String,
    /// The strata, the harder one first.
    pub strata: [RealStratum; 2],
}

/// One stratum of the population.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RealStratum {
    /// Its share of the population.
    pub share: f64,
    /// Trials in it.
    pub trials: u64,
    /// Successes among them.
    pub successes: u64,
}

impl RealEvidence {
    /// The name of the file in a folder of evidence.
    pub const FILE: &'static str = "real.json";
    /// The version that this build writes, and the only one that it reads.
    pub const FORMAT: u32 = 1;

    /// Parses the content of the file `path`.
    ///
    /// # Errors
    /// If the content is not valid.
    pub fn from_json(path: &Path, text: &str) -> Result<Self, GateError> {
        let wrong = |reason: String| GateError::InFile {
            path: path.to_owned(),
            error: Box::new(GateError::Syntax(format!("not real evidence: {reason}"))),
        };
        let found: Self = Budget::FILE.json(text.as_bytes()).map_err(|error| wrong(error.to_string()))?;
        found.check().map_err(wrong)?;
        Ok(found)
    }

    /// Serialises the evidence. Equal evidence gives equal bytes.
    pub fn to_json(&self) -> String {
        // Strings and finite numbers always serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    fn check(&self) -> Result<(), String> {
        if self.format != Self::FORMAT {
            return Err(format!("unsupported format {}. Expected {}", self.format, Self::FORMAT));
        }
        let [a, b] = self.strata;
        // One of them can be the whole population.
        let share = |s: RealStratum| (0.0..=1.0).contains(&s.share) && (s.share > 0.0 || s.trials == 0);
        if !(share(a) && share(b)) || (a.share + b.share - 1.0).abs() > 1e-9 {
            return Err("the shares of the strata do not add up to 1, or an empty one has trials".to_owned());
        }
        if self.strata.iter().any(|s| s.successes > s.trials) {
            return Err("a stratum has more successes than trials".to_owned());
        }
        if self.strata.iter().any(|s| s.trials > MOST_TRIALS) || self.trials() > MOST_TRIALS {
            return Err(format!("it has more than {} trials", count(MOST_TRIALS)));
        }
        Ok(())
    }

    /// Checks that the trials are about the task, robot and policy of these episodes. Hashes of robot and policy count
    /// where both are known: a built-in policy has none, a server may declare none, and files of earlier versions have
    /// none.
    ///
    /// # Errors
    /// If the trials are invalid or about something else. The error names all differences.
    pub fn check_subject(&self, record: &Record) -> Result<(), GateError> {
        self.check().map_err(|reason| GateError::Real { reason })?;
        let names = [
            ("task", &*self.task, record.task.name.as_str()),
            ("robot", &*self.robot, &*record.robot),
            ("policy", &*self.policy, &*record.policy),
        ];
        let hashes = [
            ("SHA-256 of the robot's files", &self.robot_sha256, &record.robot_sha256),
            ("SHA-256 of the policy", &self.policy_sha256, &record.policy_sha256),
        ];
        let hashes =
            hashes.into_iter().filter_map(|(what, real, judged)| Some((what, real.as_deref()?, judged.as_deref()?)));
        let differences: Vec<String> = names
            .into_iter()
            .chain(hashes)
            .filter(|(_, real, judged)| real != judged)
            .map(|(what, real, judged)| format!("the {what} is `{real}`, and that of the episodes `{judged}`"))
            .collect();
        if differences.is_empty() {
            return Ok(());
        }
        Err(GateError::Real { reason: format!("the real trials are about something else: {}", differences.join("; ")) })
    }

    fn counts(&self) -> [Stratum; 2] {
        self.strata
            .map(|s| Stratum { share: s.share, trials: Trials::new(s.successes, s.trials).unwrap_or(Trials::NONE) })
    }

    /// Number of trials.
    pub fn trials(&self) -> u64 {
        self.strata.iter().map(|s| s.trials).sum()
    }

    /// Number of successes.
    pub fn successes(&self) -> u64 {
        self.strata.iter().map(|s| s.successes).sum()
    }

    /// The estimated success rate. It has no bounds for invalid episodes, because trials are successes or failures.
    pub(crate) fn figure(&self) -> Extremes {
        let rate = estimate(self.counts());
        Extremes { observed: rate, least: rate.or(Some(0.0)), most: rate.or(Some(1.0)) }
    }

    pub(crate) fn test(&self, bound: Bound, alpha: f64) -> Tested {
        let strata = self.counts();
        let (above, below) = (p_above(strata, bound.limit), p_below(strata, bound.limit));
        let (p_met, p_violated) = if bound.sense == Sense::AtLeast { (above, below) } else { (below, above) };
        let interval = bounds(strata, alpha);
        Tested { p_met, p_violated, interval: Some([interval.low, interval.high]) }
    }
}
