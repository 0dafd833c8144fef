//! The arm of coarse episodes: all scenarios of a campaign in a simulator with a larger time step. The episodes of the campaign
//! itself are the first ones of the same scenarios.
//!
//! The arm is a campaign of its own, in a folder of the first. Its plan follows from the plan of the first campaign, so threads
//! and interruptions change nothing.

use robogate_dictionary::Fidelity;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Plan, PlanError, UniformStage};

/// The folder of the coarse episodes in the folder of their campaign.
pub const COARSE: &str = "coarse";

/// The sampler of a campaign with coarse episodes: any subset of its points is a sample from the operating space.
const SAMPLER: &str = "uniform";

/// Coarse episodes beside a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoarseStage {
    /// The number of scenarios that run with the larger time step. The first `uniform.episodes` of them also run with that of
    /// the run.
    pub episodes: u64,
    /// The larger time step, in seconds.
    pub time_step_s: f64,
}

impl Plan {
    /// Runs all uniform episodes with this time step, and this share of them, rounded up, with that of the run as well.
    #[must_use]
    pub fn with_coarse(mut self, share: f64, time_step_s: f64) -> Self {
        self = self.with_uniform_only();
        let episodes = self.uniform.episodes;
        self.sampler = SAMPLER.to_owned();
        self.uniform.episodes = ((share * episodes as f64).ceil() as u64).clamp(1, episodes.max(1));
        self.coarse = Some(CoarseStage { episodes, time_step_s });
        self
    }

    /// The plan of the coarse episodes. `None` if there are none.
    pub fn coarse_arm(&self) -> Option<Self> {
        let CoarseStage { episodes, .. } = self.coarse?;
        Some(Self { uniform: UniformStage { episodes }, coarse: None, fidelity: Fidelity::Coarse, ..self.clone() })
    }

    /// Rejects coarse episodes that cannot be compared with those of the plan.
    pub(crate) fn check_coarse(&self) -> Result<(), PlanError> {
        let Some(coarse) = &self.coarse else { return Ok(()) };
        if self.suite.is_some() || self.active.is_some() || self.boundary.episodes > 0 || self.twins {
            return Err(PlanError::CoarseAndOthers);
        }
        if self.sampler != SAMPLER || self.fidelity == Fidelity::Coarse {
            return Err(PlanError::CoarseSampler { found: self.sampler.clone() });
        }
        if coarse.episodes < self.uniform.episodes {
            return Err(PlanError::FewCoarse { coarse: coarse.episodes, fine: self.uniform.episodes });
        }
        // Written in this form to reject NaN as well.
        if !(coarse.time_step_s > 0.0 && coarse.time_step_s <= 1.0) {
            let (key, found) = ("coarse.time_step_s", coarse.time_step_s);
            return Err(PlanError::Setting { key, found, expected: "a number above 0 and up to 1" });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use robogate_core::{Domain, Parameter, ParameterSpace, Scale};

    use super::*;
    use crate::{Points, Preset};

    #[test]
    fn fine_scenarios_are_the_first_coarse_ones() {
        let domain = Domain::Continuous { low: 0.0, high: 1.0, scale: Scale::Linear };
        let parameters = ["a", "b"].map(|name| Parameter { name: name.into(), domain: domain.clone() });
        let space = Arc::new(ParameterSpace::new("square", parameters.to_vec()).unwrap());
        let fine = Plan::from_toml("uniform.episodes = 101").unwrap().with_coarse(0.2, 0.005);
        assert_eq!((fine.uniform.episodes, fine.coarse.unwrap().episodes), (21, 101));
        fine.check(&space).unwrap();
        let coarse = fine.coarse_arm().unwrap();
        coarse.check(&space).unwrap();
        assert_eq!((coarse.episodes(), coarse.coarse_arm()), (101, None));
        let [fine, coarse] = [&fine, &coarse].map(|plan| Points::uniform(plan, &space).unwrap());
        for index in 0..21 {
            assert_eq!(fine.scenario(index), coarse.scenario(index), "{index}");
        }
    }

    #[test]
    fn coarse_episodes_need_a_uniform_sample() {
        let plan = Preset::Quick.plan().unwrap().with_total(100).with_coarse(0.2, 0.005);
        let says = |change: &dyn Fn(&mut Plan), part: &str| {
            let mut changed = plan.clone();
            change(&mut changed);
            let error = changed.check_coarse().unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        };
        says(&|plan| plan.twins = true, "cannot be combined");
        says(&|plan| plan.boundary.episodes = 3, "cannot be combined");
        says(&|plan| plan.sampler = "latin_hypercube".to_owned(), "latin_hypercube");
        says(&|plan| plan.uniform.episodes = 101, "101");
        says(&|plan| plan.coarse.as_mut().unwrap().time_step_s = f64::NAN, "coarse.time_step_s");
        let written = toml::to_string(&plan.coarse_arm().unwrap()).unwrap();
        assert!(Plan::from_toml(&written).unwrap_err().to_string().contains("fidelity"));
        assert_eq!(Plan::from_toml(&toml::to_string(&plan).unwrap()).unwrap(), plan);
    }
}
