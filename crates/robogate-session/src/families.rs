//! Families of perturbations: groups of parameters whose effects are measured one at a time.

use std::sync::Arc;

use anyhow::{bail, ensure};
use robogate_core::{ParameterSpace, Suite, TaskSpec, Word};

/// The word for one family of each parameter.
const EACH: &str = "each";
/// The word for the families that the task declares.
const DECLARED: &str = "declared";

/// The suite of the families in the arguments: `NAME=PARAMETER,PARAMETER`, `each` or `declared`. A `*` at the end of a
/// parameter stands for any ending. It has about `scenarios` scenarios, at least one for each family.
pub fn suite(given: &[String], space: &ParameterSpace, task: &TaskSpec, scenarios: usize) -> anyhow::Result<Suite> {
    ensure!(
        space.correlations().is_empty(),
        "--family: the space {} samples parameters jointly, so they cannot be varied one family at a time\nHint: choose a space without `correlation`",
        space.name()
    );
    let mut families: Vec<(String, Vec<String>)> = Vec::new();
    for argument in given {
        match argument.split_once('=') {
            None if argument == EACH => families.extend(each(space, task)),
            None if argument == DECLARED => families.extend(declared(space, task)?),
            Some((name, patterns)) if !name.is_empty() && !patterns.is_empty() => {
                families.push((name.to_owned(), matching(argument, patterns, space, task)?));
            }
            _ => bail!(
                "--family {argument}: expected NAME=PARAMETER,PARAMETER, `{EACH}` or `{DECLARED}`, for example light=light,camera_*"
            ),
        }
    }
    for (at, (name, parameters)) in families.iter().enumerate() {
        for (other, others) in &families[..at] {
            ensure!(name != other, "--family {name}: this name is used twice");
            if let Some(both) = parameters.iter().find(|parameter| others.contains(parameter)) {
                bail!("--family {name}: `{both}` is in the family {other} too. Expected each parameter in one family");
            }
        }
    }
    let each = scenarios.div_ceil(families.len().max(1)).max(1);
    Ok(Suite::of_families(space, task, &families, each)?)
}

fn has_nominal(task: &TaskSpec, name: &str) -> bool {
    task.parameter(name).is_some_and(|spec| spec.nominal.is_some())
}

fn each(space: &ParameterSpace, task: &TaskSpec) -> Vec<(String, Vec<String>)> {
    let names = space.parameters().iter().map(|parameter| parameter.name.to_string());
    names.filter(|name| has_nominal(task, name)).map(|name| (name.clone(), vec![name])).collect()
}

fn declared(space: &ParameterSpace, task: &TaskSpec) -> anyhow::Result<Vec<(String, Vec<String>)>> {
    let names = space.parameters().iter().map(|parameter| &*parameter.name);
    let families = task.families_among(names);
    ensure!(
        !families.is_empty(),
        "--family {DECLARED}: the task {} declares no family for a parameter of the space {}\nHint: use NAME=PARAMETER,PARAMETER or `{EACH}`",
        task.name,
        space.name()
    );
    let named = |(family, of): (Word, Vec<Arc<str>>)| {
        (family.as_str().to_owned(), of.iter().map(|name| name.to_string()).collect())
    };
    Ok(families.into_iter().map(named).collect())
}

fn matching(argument: &str, patterns: &str, space: &ParameterSpace, task: &TaskSpec) -> anyhow::Result<Vec<String>> {
    let mut found: Vec<String> = Vec::new();
    for pattern in patterns.split(',').map(str::trim) {
        let matches = |name: &str| match pattern.strip_suffix('*') {
            Some(start) => name.starts_with(start),
            None => name == pattern,
        };
        let names: Vec<String> =
            space.parameters().iter().map(|of| of.name.to_string()).filter(|name| matches(name)).collect();
        if names.is_empty() {
            let known: Vec<&str> = space.parameters().iter().map(|of| &*of.name).collect();
            bail!(
                "--family {argument}: the space {} has no parameter `{pattern}`. Expected one of: {}",
                space.name(),
                known.join(", ")
            );
        }
        if let Some(name) = names.iter().find(|name| !has_nominal(task, name)) {
            bail!("--family {argument}: the task {} declares no nominal value for `{name}`", task.name);
        }
        found.extend(names.into_iter().filter(|name| !found.contains(name)).collect::<Vec<_>>());
    }
    Ok(found)
}
