//! `robogate baseline`: writes a run's figures for later comparisons.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use robogate_gate::{Baseline, Metric, Record};
use robogate_stats::format::number;

use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::source::open_source;
use crate::terminal::{grouped, line, note, percent};

/// Write a run's figures to a file, as a baseline for other runs.
///
/// The file records the scenarios of the run. A gate rejects it for other scenarios.
#[derive(Debug, Args)]
pub(crate) struct BaselineOf {
    /// A run's folder or a dictionary
    run: PathBuf,
    /// File to write, - for stdout
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
}

impl BaselineOf {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let source = open_source(&self.run)?;
        let record = Record::of(source.dictionary()).or_broken()?;
        let baseline = Baseline::of(&record).map_err(|error| Exit { code: INVALID, error: error.into() })?;
        if self.out.as_os_str() == "-" {
            line(baseline.to_json().trim_end());
            return Ok(DONE);
        }
        std::fs::write(&self.out, baseline.to_json())
            .with_context(|| format!("cannot write {}", self.out.display()))
            .or_broken()?;
        note(format_args!(
            "{}: {} on {}, {}, {} valid episodes",
            self.out.display(),
            baseline.policy,
            baseline.robot,
            baseline.population,
            grouped(baseline.valid)
        ));
        for figure in &baseline.figures {
            let value = match figure.metric {
                Metric::CycleTime(_) => format!("{:.3} s", figure.value),
                Metric::FailureCount(_) => format!("{}", figure.value),
                Metric::Measure(..) => number(figure.value),
                _ => percent(figure.value),
            };
            note(format_args!("  {:<28} {value}", figure.metric.title()));
        }
        Ok(DONE)
    }
}
