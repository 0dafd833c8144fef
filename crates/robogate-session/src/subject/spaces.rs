//! Parameter spaces and settings by name.

use std::path::Path;

use anyhow::{Context, anyhow, bail};
use robogate_campaign::{BUILT_IN_SUITES, built_in_suite};
use robogate_core::{Assignment, ParameterSpace, Suite, TaskSpec};
use robogate_dictionary::read_text;
use robogate_tasks::built_in_space;

use crate::failure::{Failure, OrFailure};
use crate::registry;
use crate::text::foreign;

/// A space without some of its parameters and their correlations.
pub(crate) fn without(space: &ParameterSpace, left_out: impl Fn(&str) -> bool) -> anyhow::Result<ParameterSpace> {
    let kept: Vec<_> = space.parameters().iter().filter(|parameter| !left_out(&parameter.name)).cloned().collect();
    let correlations =
        space.correlations().iter().filter(|c| !c.parameters.iter().any(|name| left_out(name))).cloned().collect();
    ParameterSpace::new(space.name(), kept)
        .with_context(|| format!("space {}", space.name()))?
        .with_correlations(correlations)
        .map_err(Into::into)
}

/// The space without the parameters that this test finds, which the environment itself does not have. `None` if nothing is left.
pub(crate) fn remaining(
    space: &ParameterSpace,
    is_own: impl Fn(&str) -> bool,
) -> anyhow::Result<Option<ParameterSpace>> {
    if space.parameters().iter().all(|parameter| is_own(&parameter.name)) {
        return Ok(None);
    }
    without(space, is_own).map(Some)
}

/// Finds a parameter space by its name or file.
pub fn named_space(wanted: &str) -> anyhow::Result<ParameterSpace> {
    let own = registry::TASKS.iter().find(|task| task.name() == wanted).map(|task| task.space());
    match built_in_space(wanted).or(own) {
        Some(text) => ParameterSpace::from_toml(text).with_context(|| wanted.to_owned()),
        None if !Path::new(wanted).exists() && !wanted.contains(['/', '.']) => {
            let known = registry::spaces().collect::<Vec<_>>().join(", ");
            bail!("--space {wanted}: unknown parameter space. Expected a file, or one of: {known}")
        }
        None => read_text(Path::new(wanted))
            .with_context(|| format!("cannot read {wanted}"))
            .and_then(|text| ParameterSpace::from_toml(&text).with_context(|| wanted.to_owned())),
    }
}

/// Finds a suite by its name or file.
///
/// # Errors
/// A name or file that is not a suite.
pub fn named_suite(wanted: &str) -> Result<Suite, Failure> {
    if let Some(suite) = built_in_suite(wanted) {
        return suite.or_broken();
    }
    let file = Path::new(wanted);
    if !file.exists() {
        let known: Vec<&str> = BUILT_IN_SUITES.iter().map(|(name, _)| *name).collect();
        let known = known.join(", ");
        return Err(anyhow!("unknown suite `{wanted}`. Expected a file, or one of: {known}")).or_request();
    }
    read_text(file)
        .with_context(|| format!("cannot read {wanted}"))
        .and_then(|text| Suite::from_toml(&text).with_context(|| wanted.to_owned()))
        .or_request()
}

/// Parses parameters given as NAME=VALUE.
pub(crate) fn assignment(pairs: &[String]) -> anyhow::Result<Assignment> {
    let mut assignment = Assignment::default();
    for pair in pairs {
        let Some((name, value)) = pair.split_once('=') else {
            bail!("--set {}: expected NAME=VALUE", foreign(pair));
        };
        let value = match (value.parse::<i64>(), value.parse::<f64>()) {
            (Ok(integer), _) => robogate_core::Value::Integer(integer),
            (_, Ok(number)) => robogate_core::Value::Number(number),
            _ => robogate_core::Value::Category(value.into()),
        };
        assignment.set(name, value);
    }
    Ok(assignment)
}

/// Rejects a space with a parameter that the task does not declare, or with values that it does not accept.
pub fn check_declared(task: &TaskSpec, space: &ParameterSpace) -> anyhow::Result<()> {
    for parameter in space.parameters() {
        let Some(spec) = task.parameter(&parameter.name) else {
            let known: Vec<&str> = task.parameters.iter().map(|spec| &*spec.name).collect();
            bail!(
                "the task {} has no parameter `{}`. Expected one of: {}",
                task.name,
                parameter.name,
                known.join(", ")
            );
        };
        parameter.domain.extremes().iter().try_for_each(|value| spec.accepts(value)).map_err(|why| anyhow!(why))?;
    }
    Ok(())
}
