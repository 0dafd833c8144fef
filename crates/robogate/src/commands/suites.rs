//! Suites: how they are found, listed, shown and checked.

use std::path::Path;

use anyhow::Context;
use robogate_campaign::{BUILT_IN_SUITES, suite_sha256};
use robogate_core::{Case, Domain, Spread, Suite, SuiteError};
use robogate_dictionary::read_text;
use serde_json::{Value, json};

use crate::exit::{DONE, Exit, OrExit, USAGE};
use crate::terminal::{bold, dim, line, note};
use robogate_session::{ARM_TASKS, TASKS, check_declared};

/// Prints the built-in suites.
pub(crate) fn list(json: bool) -> Result<u8, Exit> {
    let suites = BUILT_IN_SUITES
        .iter()
        .map(|(_, text)| Suite::from_toml(text))
        .collect::<Result<Vec<_>, SuiteError>>()
        .or_broken()?;
    if json {
        line(json!({ "version": 1, "suites": suites.iter().map(head).collect::<Vec<_>>() }));
        return Ok(DONE);
    }
    for suite in &suites {
        line(format_args!("{} {}", bold(suite.name()), suite.version()));
        line(format_args!("  {}", suite.description()));
    }
    note("show one: robogate list suites NAME; run it: robogate run --suite NAME");
    Ok(DONE)
}

/// Prints every scenario of a suite.
pub(crate) fn show(suite: &Suite, json: bool) -> Result<u8, Exit> {
    if json {
        let mut document = head(suite);
        document["scenarios"] = suite.cases().iter().map(scenario).collect();
        line(json!({ "version": 1, "suite": document }));
        return Ok(DONE);
    }
    line(format_args!("{} {}", bold(suite.name()), suite.version()));
    line(format_args!("  {}", suite.description()));
    line(format_args!("  {} scenarios, SHA-256 {}", suite.cases().len(), suite_sha256(suite)));
    let common = common(suite);
    line("");
    line(bold("Defaults of the scenarios"));
    for ((name, _), spread) in suite.cases()[0].parameters.iter().zip(&common) {
        line(format_args!("  {name:<26} {}", words(spread)));
    }
    let mut last = None;
    for case in suite.cases() {
        let group = (case.category.as_str(), case.group.as_str());
        if last != Some(group) {
            line("");
            line(bold(format_args!("{} / {}", group.0, group.1)));
            if let Some(description) = suite.group_description(group.0, group.1) {
                line(format_args!("  {description}"));
            }
            last = Some(group);
        }
        let own = case.parameters.iter().zip(&common).filter(|((_, spread), common)| spread != *common);
        let own: Vec<String> = own.map(|((name, spread), _)| format!("{name} {}", words(spread))).collect();
        line(format_args!("  {:<24} {}", case.id, dim(own.join(", "))));
    }
    Ok(DONE)
}

/// Checks the file of a suite and prints every problem.
pub(crate) fn check(file: &Path, json: bool) -> Result<u8, Exit> {
    let text = read(file).or_usage()?;
    let (suite, problems): (Option<Suite>, Vec<String>) = match Suite::from_toml(&text) {
        Ok(suite) => {
            let problems = misfits(&suite)?;
            (Some(suite), problems)
        }
        Err(SuiteError::Syntax(text)) => (None, vec![text]),
        Err(SuiteError::Problems(problems)) => (None, problems.iter().map(ToString::to_string).collect()),
        Err(error @ SuiteError::NoNominal { .. }) => (None, vec![error.to_string()]),
    };
    let ok = problems.is_empty();
    if json {
        line(json!({ "version": 1, "file": file, "ok": ok, "suite": suite.as_ref().map(head), "problems": problems }));
    } else {
        problems.iter().for_each(|problem| line(format_args!("{}: {problem}", file.display())));
        match &suite {
            Some(suite) if ok => line(format_args!(
                "{}: {} {} is a suite of {} scenarios, SHA-256 {}",
                file.display(),
                suite.name(),
                suite.version(),
                suite.cases().len(),
                suite_sha256(suite)
            )),
            _ => note(format_args!("{} problem{}", problems.len(), if problems.len() == 1 { "" } else { "s" })),
        }
    }
    Ok(if ok { DONE } else { USAGE })
}

/// The problems of a suite with the task that has most of its parameters. A suite that names its environment is checked by
/// that environment, when it runs.
fn misfits(suite: &Suite) -> Result<Vec<String>, Exit> {
    if suite.environment().is_some() {
        return Ok(Vec::new());
    }
    let parameters = suite.space().parameters();
    let unknown = |known: &dyn Fn(&str) -> bool| parameters.iter().filter(|p| !known(&p.name)).count();
    let arms = ARM_TASKS
        .iter()
        .map(|task| (unknown(&|name| task.parameters().knows(name)), task.parameters().check_suite(suite, None)));
    // The first of equals.
    let mut best = arms.min_by_key(|(missing, _)| *missing).unwrap_or((usize::MAX, Vec::new()));
    for task in TASKS.iter().map(|task| task.task()) {
        let missing = unknown(&|name| task.parameter(name).is_some());
        if missing < best.0 {
            let problem = check_declared(&task, suite.space()).err();
            best = (missing, problem.iter().map(|why| format!("{why:#}")).collect());
        }
    }
    if best.0 >= parameters.len() {
        note(
            "no built-in task has one of its parameters, so their names and ranges were not checked\nHint: `robogate gate --env FILE --suite FILE` \
             checks them against the environment",
        );
        return Ok(Vec::new());
    }
    Ok(best.1)
}

fn read(file: &Path) -> anyhow::Result<String> {
    read_text(file).with_context(|| format!("cannot read {}", file.display()))
}

fn head(suite: &Suite) -> Value {
    json!({
        "name": suite.name(),
        "version": suite.version(),
        "description": suite.description(),
        "scenario_count": suite.cases().len(),
        "sha256": suite_sha256(suite),
    })
}

fn scenario(case: &Case) -> Value {
    let parameters: serde_json::Map<_, _> =
        case.parameters.iter().map(|(name, spread)| (name.to_string(), as_json(spread))).collect();
    json!({ "id": case.id, "category": case.category, "group": case.group, "parameters": parameters })
}

fn as_json(spread: &Spread) -> Value {
    match spread {
        Spread::Fixed(value) => json!(value),
        Spread::Drawn(Domain::Continuous { low, high, .. }) => json!({ "low": low, "high": high }),
        Spread::Drawn(Domain::Integer { low, high }) => json!({ "low": low, "high": high }),
        Spread::Drawn(Domain::Categorical { choices }) => json!(choices),
    }
}

fn words(spread: &Spread) -> String {
    match spread {
        Spread::Fixed(value) => value.to_string(),
        Spread::Drawn(Domain::Continuous { low, high, .. }) => format!("{low} to {high}"),
        Spread::Drawn(Domain::Integer { low, high }) => format!("{low} to {high}"),
        Spread::Drawn(Domain::Categorical { choices }) => choices.join("|"),
    }
}

/// The most frequent value of each parameter.
fn common(suite: &Suite) -> Vec<Spread> {
    let most = |i: usize| {
        let all = || suite.cases().iter().filter_map(|case| Some(&case.parameters.get(i)?.1));
        // Among equally frequent values the last one is chosen, so that the output is deterministic.
        all().max_by_key(|spread| all().filter(|other| other == spread).count()).cloned()
    };
    (0..suite.space().len()).filter_map(most).collect()
}
