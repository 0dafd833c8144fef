//! The figures of a run as a baseline for other runs.

use std::path::Path;

use anyhow::Context;
use robogate_analysis::Source;
use robogate_dictionary::files;
use robogate_gate::{Baseline, Metric};
use robogate_session::record_of;
use robogate_stats::format::number;

use crate::exit::{Exit, INVALID, OrExit};
use crate::terminal::{grouped, note, percent};

/// Writes the figures of a run to a file. It records the scenarios of the run: a gate rejects it for others.
pub(super) fn write(source: &Source, file: &Path) -> Result<(), Exit> {
    let record = record_of(source).or_broken()?;
    let baseline = Baseline::of(&record).map_err(|error| Exit { code: INVALID, error: error.into() })?;
    files::write(file, baseline.to_json())
        .with_context(|| format!("cannot write {}", file.display()))
        .or_unwritable()?;
    note(format_args!(
        "{}: {} on {}, {}, {} valid episodes",
        file.display(),
        baseline.policy,
        baseline.robot,
        baseline.population,
        grouped(baseline.valid)
    ));
    for figure in &baseline.figures {
        let value = match figure.metric {
            Metric::CycleTime(_) => format!("{:.3} s", figure.value),
            Metric::FailureCount(_) => format!("{}", figure.value),
            Metric::Measure(..) | Metric::Production(_) => number(figure.value),
            _ => percent(figure.value),
        };
        note(format_args!("  {:<28} {value}", figure.metric.title()));
    }
    Ok(())
}
