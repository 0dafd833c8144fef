//! Runs randomly chosen rows of evidence again.

use std::path::Path;

use anyhow::{Context, anyhow};
use robogate_campaign::{WorkerFactory, check_rows};
use robogate_core::{FaultKind, Outcome, rollout};
use robogate_dictionary::{Dictionary, Provenance, World};
use robogate_gate::evidence::{Problem, random_positions};
use serde::Serialize;

use crate::failure::{Failure, OrFailure};
use crate::origin::is_own;
use crate::reopening::Reopening;
use crate::subject::Subject;

/// The rows in the folder of evidence.
const ROWS: &str = "dictionary.parquet";

/// The result of running rows again.
#[derive(Debug, Serialize)]
pub struct Rerun {
    /// The number of rows that could have been chosen.
    pub of: u64,
    /// The indices of the rows that ran again, all with the same outcome.
    pub rows: Vec<u64>,
    /// How many of them also have the same measures and trajectory, bit for bit.
    pub identical: u64,
    /// How many other chosen rows were lost to an unavailable server when they were recorded, which need not happen again.
    pub lost: u64,
    /// Whether the mathematical functions differ from those of the run, so that last bits differ.
    pub other_maths: bool,
}

impl Rerun {
    /// The share of invented rows that this number of rows detects with 95 % probability.
    pub fn detects(&self) -> f64 {
        1.0 - 0.05_f64.powf(1.0 / self.rows.len().max(1) as f64)
    }
}

/// Checks that the rows are those of the plan, and runs `k` of them again. A difference is a problem of the evidence.
///
/// # Errors
/// Rows that were not simulated, another build or machine, or an environment that does not start.
pub fn rerun(folder: &Path, k: u64, opening: &Reopening) -> Result<Result<Rerun, Problem>, Failure> {
    let dictionary = Dictionary::open(&folder.join(ROWS)).or_request()?;
    let recorded = dictionary.provenance();
    if recorded.source.is_some() {
        return Err(anyhow!("--rerun: the rows were imported, so they cannot be run again\nHint: leave out --rerun"))
            .or_request();
    }
    let mut opening = opening.clone();
    if !is_own(folder, recorded) {
        // The user may have named the program, or may trust the author, but did not write it.
        opening.simulators.sandbox.get_or_insert(true);
    }
    let subject = Subject::recorded(recorded, Some(folder), &opening)?;
    if let Some(engine) = subject.many_worlds_engine() {
        return Err(anyhow!(
            "--rerun: the rows were simulated in many worlds at once ({engine}), and a single episode has other bits\n\
             Hint: leave out --rerun"
        ))
        .or_request();
    }
    let here = subject.provenance(recorded.space.clone())?;
    let other_maths =
        matches!((&recorded.platform, &here.platform), (Some(was), Some(is)) if was.differs_in_maths_only(is));
    same_setup(recorded, &here, other_maths)?;
    let world = |provenance: &Provenance| provenance.world.as_ref().map(World::without_packages);
    if world(&here) != world(recorded) {
        let reason = "the policy or the environment differs from the recorded one: another file, or its server declares something else";
        return Err(anyhow!("--rerun: {reason}\nHint: name the judged policy with --policy")).or_request();
    }
    let wrong = |reason: String| Ok(Err(Problem::new(ROWS, reason)));
    if let Err(error) = check_rows(recorded, subject.foresight()?, dictionary.entries()) {
        return wrong(error.to_string());
    }
    let mut indices = Vec::new();
    for entry in dictionary.entries() {
        indices.push(entry.or_request()?.index());
    }
    let chosen = random_positions(indices.len() as u64, k)?;
    let mut rows: Vec<u64> = chosen.iter().filter_map(|at| indices.get(*at as usize).copied()).collect();
    let chosen = rows.len();
    let mut identical = 0;
    let mut worker = subject.worker().or_broken()?;
    for entry in dictionary.entries() {
        let entry = entry.or_request()?;
        if rows.binary_search(&entry.index()).is_err() {
            continue;
        }
        let before = entry.episode;
        if matches!(&before.outcome, Outcome::Invalid(fault) if fault.kind == FaultKind::Unavailable) {
            rows.retain(|row| *row != before.scenario.index);
            continue;
        }
        let again = rollout(&mut *worker.environment, &mut *worker.policy, &before.scenario);
        if let Outcome::Invalid(fault) = &again.outcome
            && fault.kind == FaultKind::Unavailable
        {
            return Err(anyhow!("{fault}"))
                .with_context(|| format!("--rerun: row {} cannot be run", entry_index(&before)))
                .or_broken();
        }
        let same = again.repeats(&before);
        identical += u64::from(same);
        let alike = match (&before.outcome, &again.outcome) {
            // The text of a fault may name an address or a time.
            (Outcome::Invalid(was), Outcome::Invalid(is)) => was.kind == is.kind,
            (was, is) => other_maths && was.as_str() == is.as_str(),
        };
        if !same && !alike {
            let describe = |episode: &robogate_core::Episode| {
                let outcome = episode.outcome.as_str();
                format!("{outcome} at {:.3} s, trajectory {:016x}", episode.time_s, episode.trajectory_hash)
            };
            return wrong(format!(
                "row {} is not what happens: recorded {}, now {}",
                entry_index(&before),
                describe(&before),
                describe(&again)
            ));
        }
    }
    let lost = (chosen - rows.len()) as u64;
    Ok(Ok(Rerun { of: indices.len() as u64, rows, identical, lost, other_maths }))
}

fn entry_index(episode: &robogate_core::Episode) -> u64 {
    episode.scenario.index
}

/// Rejects a setup in which the same episodes can have other bits.
fn same_setup(recorded: &Provenance, here: &Provenance, other_maths: bool) -> Result<(), Failure> {
    let same = |name: &str, equal: bool, was: String, is: String| {
        if equal {
            return Ok(());
        }
        let hint = "Hint: run the verification with the build, library and platform of the run";
        Err(anyhow!("--rerun: the rows were made with another {name}: {was}, here {is}\n  {hint}")).or_request()
    };
    let text = |value: &Option<String>| value.clone().unwrap_or_else(|| "unknown".to_owned());
    same("version of robogate", recorded.tool == here.tool, recorded.tool.version.clone(), here.tool.version.clone())?;
    let build = |p: &Provenance| text(&p.build.as_ref().map(|build| build.source_sha256.clone()));
    same("build of robogate", recorded.build == here.build, build(recorded), build(here))?;
    let engine =
        |p: &Provenance| format!("{} {} {}", p.engine.name, text(&p.engine.version), text(&p.engine.build_sha256));
    same("engine", recorded.engine == here.engine, engine(recorded), engine(here))?;
    same("robot", recorded.robot == here.robot, text(&recorded.robot.sha256), text(&here.robot.sha256))?;
    let platform = |p: &Provenance| {
        let known = p.platform.as_ref().map(robogate_dictionary::Platform::properties).unwrap_or_default();
        known.into_iter().map(|(_, value)| value).collect::<Vec<_>>().join(", ")
    };
    same("platform", recorded.platform == here.platform || other_maths, platform(recorded), platform(here))
}
