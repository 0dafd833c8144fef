//! The control arm of a campaign: the nominal twin of each episode.
//!
//! The arm is a campaign of its own, in a folder of the first. Its plan follows from the plan of the first campaign, so
//! threads, shards and interruptions change nothing.

use std::sync::Arc;

use robogate_core::{Assignment, Suite, TaskSpec};

use crate::{Plan, Points, RunError};

/// The folder of the control arm in the folder of its campaign.
pub const NOMINAL: &str = "nominal";

/// The plan of the nominal twins of a campaign, and the parameters that keep their values.
#[derive(Debug, Clone, PartialEq)]
pub struct NominalArm {
    /// The plan: a suite with the seed of the campaign. Its episodes have the indices of their partners.
    pub plan: Plan,
    /// Parameters without a nominal value. Twins keep the values of their partners.
    pub kept: Vec<String>,
}

impl NominalArm {
    /// The nominal twins of a plan for `space`. For a suite, `rounds` is the number of rounds that ran, otherwise the number
    /// of episodes. The twins are those of the first stage and, if every parameter has a nominal value, of the rounds of an
    /// active stage, which contain a uniform sample. A boundary stage samples a part of the space, which represents no
    /// population.
    ///
    /// # Errors
    /// If the task has no nominal values, or if the points of the first stage cannot be sampled.
    pub fn of(
        plan: &Plan,
        space: &Arc<robogate_core::ParameterSpace>,
        task: &TaskSpec,
        rounds: u64,
    ) -> Result<Self, RunError> {
        let has_nominal = |name: &str| task.parameter(name).is_some_and(|spec| spec.nominal.is_some());
        let names = space.parameters().iter().map(|parameter| &*parameter.name);
        let kept: Vec<String> = names.filter(|name| !has_nominal(name)).map(str::to_owned).collect();
        let (suite, rounds) = match &plan.suite {
            Some(stage) => (stage.suite.nominal_twin(task)?, rounds.min(stage.rounds)),
            None => {
                let points = Points::uniform(plan, space)?;
                let points: Vec<Assignment> = points.indices().filter_map(|index| points.requested(index)).collect();
                let suite = Suite::nominal_twins(task, &points)?;
                let first_stage = points.len() as u64 / suite.cases().len().max(1) as u64;
                // All twins are the same scenario, so those of points that are not known yet are known.
                let all = plan.active.is_some() && kept.is_empty();
                (suite, if all { rounds.max(first_stage) } else { first_stage })
            }
        };
        Ok(Self { plan: Plan::of_suite(suite, rounds, plan.seed), kept })
    }
}
