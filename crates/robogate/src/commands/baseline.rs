//! `robogate baseline`: the figures that others are held against.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use robogate_analysis::Source;
use robogate_gate::{Baseline, Metric, Record};
use robogate_stats::format::number;

use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::terminal::{grouped, line, note, percent};

/// Keep a run's figures, for others to be held against.
///
/// The file names the scenarios that the figures are of: a gate refuses it for others.
#[derive(Debug, Args)]
pub(crate) struct BaselineOf {
    /// A run's folder or a dictionary
    run: PathBuf,
    /// The file to write, - for stdout
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
}

impl BaselineOf {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let source = Source::open(&self.run).or_usage()?;
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
