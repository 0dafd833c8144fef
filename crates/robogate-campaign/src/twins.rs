//! The arms of a campaign that show what its perturbations do: the nominal twin of each episode, and the episodes of the first
//! stage with the perturbations of one declared family each.
//!
//! An arm is a campaign of its own, in a folder of the first. Its plan follows from the plan of the first campaign, so
//! threads, shards and interruptions change nothing.

use std::sync::Arc;

use robogate_core::{Assignment, ParameterSpace, Suite, TaskSpec, Word};

use crate::{Plan, Points, RunError};

/// The folder of the control arm in the folder of its campaign.
pub const NOMINAL: &str = "nominal";

/// The folder of the episodes with one family of perturbations each, in the folder of their campaign.
pub const FAMILIES: &str = "families";

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
    pub fn of(plan: &Plan, space: &Arc<ParameterSpace>, task: &TaskSpec, rounds: u64) -> Result<Self, RunError> {
        let kept: Vec<String> = names(space).filter(|name| !has_nominal(task, name)).map(str::to_owned).collect();
        let (suite, rounds) = match &plan.suite {
            Some(stage) => (stage.suite.nominal_twin(task)?, rounds.min(stage.rounds)),
            None => {
                let points = first_stage(plan, space)?;
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

/// The plan of the episodes with the perturbations of one declared family each: the scenarios of the campaign with nominal
/// values for all other parameters, and with the same seeds. Each scenario is in one family, so the arm has as many episodes
/// as the first stage, or as the suite in `rounds` rounds. `None` if the campaign itself shows the effect of each family, or if
/// the task declares none: for a suite with several groups or with one scenario, and for a space with parameters of one family.
///
/// # Errors
/// If the points of the first stage cannot be sampled.
pub fn family_arm(
    plan: &Plan,
    space: &Arc<ParameterSpace>,
    task: &TaskSpec,
    rounds: u64,
) -> Result<Option<Plan>, RunError> {
    let perturbed: Vec<&str> = match &plan.suite {
        Some(stage) => stage.suite.perturbed(task),
        None => names(space).filter(|name| has_nominal(task, name)).collect(),
    };
    let families: Vec<(Word, Vec<Arc<str>>)> = task.families_among(perturbed.iter().copied());
    if families.first().is_none_or(|(_, of)| of.len() == perturbed.len()) {
        return Ok(None);
    }
    let (suite, rounds) = match &plan.suite {
        Some(stage) => {
            let cases = stage.suite.cases();
            let groups = cases.windows(2).any(|two| two[0].group != two[1].group || two[0].category != two[1].category);
            if groups || cases.len() < 2 {
                return Ok(None);
            }
            (stage.suite.one_family_each(task, &families)?, rounds.min(stage.rounds))
        }
        None => (Suite::points_with_one_family(task, &families, &first_stage(plan, space)?)?, 1),
    };
    Ok(Some(Plan::of_suite(suite, rounds, plan.seed)))
}

fn names(space: &ParameterSpace) -> impl Iterator<Item = &str> {
    space.parameters().iter().map(|parameter| &*parameter.name)
}

fn has_nominal(task: &TaskSpec, name: &str) -> bool {
    task.parameter(name).is_some_and(|spec| spec.nominal.is_some())
}

/// The points of the first stage.
fn first_stage(plan: &Plan, space: &Arc<ParameterSpace>) -> Result<Vec<Assignment>, RunError> {
    let points = Points::uniform(plan, space)?;
    Ok(points.indices().filter_map(|index| points.requested(index)).collect())
}
