//! Episodes with nothing varied: the environment as its author made it.

use std::path::Path;

use robogate_campaign::Plan;
use robogate_campaign::folder::DICTIONARY;
use robogate_core::latency::LATENCY_PARAMETER;
use robogate_core::{ParameterSpace, Suite, SuiteError, TaskSpec};
use robogate_dictionary::Dictionary;
use robogate_gate::{NominalRate, Record};

use crate::failure::{Failure, OrFailure};
use crate::stress::is_stress;
use crate::subject::{EnvironmentSource, Subject};

/// The folder of these episodes in the folder of their campaign.
pub(crate) const UNVARIED: &str = "unvaried";
/// The largest default number of these episodes beside a campaign.
const EPISODES: u64 = 20;
/// The smallest default number, and the share of the campaign's episodes in between.
const FEWEST: u64 = 5;
const SHARE: u64 = 10;
/// A parameter of every environment in Python that changes nothing at its nominal value.
const NEUTRAL: &str = "action_delay";

/// Scenarios in which nothing is varied. A suite needs a parameter: one that changes nothing at its nominal value, otherwise those of
/// the space that have a nominal value.
///
/// # Errors
/// A task without nominal values.
pub fn nominal_suite(task: &TaskSpec, space: &ParameterSpace, scenarios: usize) -> Result<Suite, SuiteError> {
    let is_neutral = task.parameter(NEUTRAL).is_some_and(|spec| spec.nominal.is_some());
    let all = space.parameters().iter().map(|parameter| &*parameter.name);
    let names: Vec<&str> = if is_neutral { vec![NEUTRAL] } else { all.collect() };
    Suite::nominal(task, &names, scenarios)
}

/// The number of episodes with nothing varied beside a campaign, unless the user gives it: none for a built-in environment, a short
/// campaign, one with nominal twins, and one with parameters that have no nominal value, such as the number of a task.
pub fn default_nominal_episodes(subject: &Subject, plan: &Plan, space: &ParameterSpace) -> u64 {
    let remote = matches!(subject.environment_source(), EnvironmentSource::Remote(_));
    let has_nominal = |name: &str| subject.task().parameter(name).is_some_and(|spec| spec.nominal.is_some());
    let varies = |name: &str| plan.suite.as_ref().is_none_or(|stage| stage.suite.varies(name));
    let names = || space.parameters().iter().map(|parameter| &*parameter.name);
    // The environment does not apply stress, and nominal values of stress change nothing.
    let known = names().all(|name| name != LATENCY_PARAMETER && (has_nominal(name) || is_stress(name)));
    let episodes = plan.episodes();
    if !remote || !known || !names().any(varies) || plan.twins || episodes < EPISODES {
        return 0;
    }
    (episodes / SHARE).clamp(FEWEST, EPISODES)
}

/// The success rate with nothing varied beside the campaign in this folder. `None` without such episodes.
///
/// # Errors
/// Rows that cannot be read.
pub fn nominal_rate_of(folder: &Path) -> Result<Option<NominalRate>, Failure> {
    let path = folder.join(UNVARIED).join(DICTIONARY);
    if !path.is_file() {
        return Ok(None);
    }
    Ok(Some(NominalRate::of(&Record::of(&Dictionary::open(&path).or_broken()?)?)))
}
