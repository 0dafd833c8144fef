//! The control arm of a campaign: runs the nominal twins, and compares them with their partners and with the episodes of one
//! family of perturbations each.

use std::num::NonZeroU64;
use std::path::Path;

use anyhow::Context;
use clap::Args;
use robogate_analysis::Source;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{NOMINAL, Plan};
use robogate_core::ParameterSpace;
use robogate_dictionary::files;
use robogate_gate::{Record, Sampling, TwinFamily, Twins};
use robogate_report::TwinRow;

use crate::exit::{Exit, OrExit};
use crate::terminal::{bold, dim, line, wrapped};
use robogate_session::{Subject, default_nominal_episodes, nominal_suite, open_source, twins_of};

/// The comparison with the control arm in the folder of a run.
pub(crate) const TWINS: &str = "twins.json";

/// The control arm of an existing run or import.
#[derive(Debug, Args)]
pub(crate) struct NominalArguments {
    /// Compare each episode with its nominal twin: the run or import of the control arm, or COLUMN=VALUE for imported
    /// rows of both arms (category, group or a parameter); default: the control arm of the run
    #[arg(long, value_name = "RUN|COLUMN=VALUE")]
    nominal: Option<String>,
}

impl NominalArguments {
    /// The argument with this value.
    pub(crate) fn of(nominal: Option<String>) -> Self {
        Self { nominal }
    }

    /// The column and the value of imported rows of the control arm.
    fn column(&self) -> Option<(&str, &str)> {
        self.nominal.as_deref().filter(|nominal| !Path::new(nominal).exists())?.split_once('=')
    }

    /// The record that is judged: without imported rows of the control arm.
    pub(crate) fn judged(&self, record: Record) -> Record {
        match self.column() {
            Some((column, value)) => Twins::without_nominal(record, column, value),
            None => record,
        }
    }

    /// The comparison of the episodes of `source` with their twins. `None` without a control arm.
    pub(crate) fn twins(&self, source: &Source, sampling: Sampling) -> Result<Option<Twins>, Exit> {
        let Some(nominal) = &self.nominal else {
            return source.folder().map_or(Ok(None), |folder| Ok(twins_of(folder, source, sampling)?));
        };
        let record = Record::of(source.dictionary())?;
        if let Some((column, value)) = self.column() {
            return Twins::within(&record, column, value, sampling).map_err(Exit::from).map(Some);
        }
        let arm = open_source(Path::new(nominal))?;
        let arm = Record::of(arm.dictionary())?;
        Twins::of(&record, &arm, sampling).map_err(Exit::from).map(Some)
    }
}

/// The number of episodes of a run with nothing varied.
const NOMINAL_RUN: u64 = 100;

/// The plan of a run with nothing varied, and its space.
pub(crate) fn nominal_plan(
    subject: &Subject,
    n: Option<NonZeroU64>,
    seed: u64,
) -> Result<(Plan, ParameterSpace), Exit> {
    let suite = nominal_suite(subject.task(), &subject.space(None).or_usage()?, 1).or_usage()?;
    let space = suite.space().clone();
    Ok((Plan::of_suite(suite, n.map_or(NOMINAL_RUN, NonZeroU64::get), seed), space))
}

/// The episodes with nothing varied beside a campaign.
#[derive(Debug, Args)]
pub(crate) struct NominalEpisodes {
    /// Also run this many episodes with nothing varied, and state their success rate beside the other; 0 for none; default in an
    /// environment that is not built in: a tenth of the episodes, from 5 to 20
    #[arg(long, value_name = "N")]
    nominal_episodes: Option<u64>,
}

impl NominalEpisodes {
    /// The number for this plan.
    pub(crate) fn of(&self, subject: &Subject, plan: &Plan, space: &ParameterSpace) -> Result<u64, Exit> {
        let Some(wanted) = self.nominal_episodes else { return Ok(default_nominal_episodes(subject, plan, space)) };
        if wanted > 0 {
            nominal_suite(subject.task(), space, 1).or_usage()?;
        }
        Ok(wanted)
    }
}

/// The same for a run that has just finished.
pub(crate) fn of_run(folder: &Path, sampling: Sampling) -> Result<Option<Twins>, Exit> {
    if !folder.join(NOMINAL).join(DICTIONARY).is_file() {
        return Ok(None);
    }
    Ok(twins_of(folder, &Source::open(folder).or_broken()?, sampling)?)
}

/// Writes the comparison into the folder of the run.
pub(crate) fn write(folder: &Path, twins: &Twins) -> Result<(), Exit> {
    let path = folder.join(TWINS);
    files::write(&path, twins.to_json()).with_context(|| format!("cannot write {}", path.display())).or_broken()
}

/// Prints the comparison.
pub(crate) fn print(twins: &Twins) {
    line("");
    line(bold("Control arm: the same seeds without the perturbations"));
    twins.lines().iter().for_each(|text| wrapped(text));
    let rows: Vec<TwinRow> = twins.families.iter().map(TwinRow::of).collect();
    let wide = rows.iter().map(|row| row.family.chars().count()).max().unwrap_or(0);
    let by_size = |of: &TwinFamily| of.difference.unwrap_or(0.0);
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|a, b| by_size(&twins.families[*a]).total_cmp(&by_size(&twins.families[*b])));
    for row in order.into_iter().filter_map(|at| rows.get(at)) {
        line(format_args!(
            "  {:<wide$}  {:>7} points  {:<18}  {:<15}  {}",
            row.family,
            row.difference,
            row.interval,
            row.effect,
            dim(&row.pairs)
        ));
    }
}
