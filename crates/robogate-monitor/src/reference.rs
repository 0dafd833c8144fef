//! What a run of the gate leaves for the monitor: its baseline, and what was validated. `robogate monitor reference` writes it.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::baseline::{Baseline, BaselineError};
use crate::domain::{Domain, DomainError};
use crate::settings::Settings;

/// One file: what was evaluated, and how it went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// The version of this form: 1.
    pub version: u32,
    /// The robot that was evaluated.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// What drew the episodes, in words: the rate is that of this population.
    pub population: String,
    /// The content hash of the rows.
    pub dataset_sha256: String,
    /// Successes and failure modes, as counts. Cycle times are left to be learnt: those of a simulator are not the cell's.
    pub baseline: Baseline,
    /// The envelope, and the risk model where the rows allow one.
    pub domain: Domain,
}

/// Why a reference is none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReferenceError {
    /// It was written by another version.
    #[error("the reference has the version {0}, but this RoboGate reads {version}", version = Reference::VERSION)]
    Version(u32),
    /// Its baseline is none.
    #[error(transparent)]
    Baseline(#[from] BaselineError),
    /// Its domain is none.
    #[error(transparent)]
    Domain(#[from] DomainError),
}

impl Reference {
    /// The version that is written and read here.
    pub const VERSION: u32 = 1;

    /// Refuses what cannot be a reference.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self) -> Result<(), ReferenceError> {
        if self.version != Self::VERSION {
            return Err(ReferenceError::Version(self.version));
        }
        self.baseline.check()?;
        Ok(self.domain.check()?)
    }
}

impl Settings {
    /// Takes a reference for a recipe, or for all that have none of their own. What the settings say of a baseline goes
    /// before what the reference says.
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
        let Baseline { success, drop, collision, failure_modes, cycle_times_s } = reference.baseline;
        baseline.success = baseline.success.or(success);
        baseline.drop = baseline.drop.or(drop);
        baseline.collision = baseline.collision.or(collision);
        baseline.failure_modes = baseline.failure_modes.or(failure_modes);
        baseline.cycle_times_s = baseline.cycle_times_s.take().or(cycle_times_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Count;

    #[test]
    fn a_recipes_own_reference_goes_before_the_common_one_and_the_settings_before_both() {
        let of = |count| Reference {
            version: 1,
            robot: "r".to_owned(),
            policy: "p".to_owned(),
            population: "x".to_owned(),
            dataset_sha256: String::new(),
            baseline: Baseline { success: Some(Count { count, of: 100 }), ..Baseline::default() },
            domain: Domain::default(),
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
    }
}
