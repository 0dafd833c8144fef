//! Limits of contact forces: reads them for a run or a gate, and prints the contacts that exceed them.

use std::path::Path;

use robogate_core::TaskSpec;
use robogate_dictionary::Dictionary;
use robogate_gate::{Evaluation, ForceLimitResult, ForceLimits, Requirements, Trial};

use crate::exit::{Exit, OrExit};
use crate::terminal::line;

/// Number of contacts of each limit that the terminal lists.
const CONTACTS: usize = 5;

/// The requirements of a gate with the limits of `file`, which replace their own.
pub(crate) fn added(requirements: Requirements, file: Option<&Path>, task: &TaskSpec) -> Result<Requirements, Exit> {
    let Some(limits) = opened(file, task)? else { return Ok(requirements) };
    Ok(requirements.with_force_limits(limits)?)
}

/// The limits of a file, for episodes of `task`.
pub(crate) fn opened(file: Option<&Path>, task: &TaskSpec) -> Result<Option<ForceLimits>, Exit> {
    let Some(file) = file else { return Ok(None) };
    let limits = ForceLimits::open(file)?;
    limits.check_task(task)?;
    Ok(Some(limits))
}

/// The contacts of a run that exceed the limits of its gate, or those that it was started with. Empty without limits.
pub(crate) fn of_run(
    dir: Option<&Path>,
    dictionary: &Dictionary,
    evaluation: Option<&Evaluation>,
) -> Result<Vec<ForceLimitResult>, Exit> {
    if let Some(evaluation) = evaluation {
        return Ok(evaluation.force_limits.clone());
    }
    let file = dir.map(|dir| dir.join(ForceLimits::FILE)).filter(|file| file.is_file());
    let Some(limits) = opened(file.as_deref(), &dictionary.provenance().task)? else { return Ok(Vec::new()) };
    let trials =
        dictionary.entries().map(|entry| entry.map(|entry| Trial::from(&entry))).collect::<Result<Vec<_>, _>>();
    Ok(limits.results(trials.or_broken()?.iter()))
}

/// Prints the contacts that exceed limits.
pub(crate) fn print(results: &[ForceLimitResult]) {
    if !results.is_empty() {
        line("");
    }
    for result in results {
        let mut lines = result.lines(CONTACTS).into_iter();
        lines.next().into_iter().for_each(|text| line(format_args!("  {text}")));
        lines.for_each(|text| line(format_args!("     {text}")));
    }
}
