//! The control arm of a campaign: runs the nominal twins, and compares them with their partners and with the episodes of one
//! family of perturbations each.

use std::path::Path;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::Source;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::shards::{ShardError, Shards};
use robogate_campaign::{Completion, Event, FAMILIES, NOMINAL};
use robogate_dictionary::Provenance;
use robogate_gate::{Record, Sampling, TwinFamily, Twins};
use robogate_report::TwinRow;

use crate::commands::gate::refused;
use crate::commands::run;
use crate::commands::shard;
use crate::exit::{Exit, OrExit};
use crate::place;
use crate::sharded::Campaign;
use crate::source::open_source;
use crate::terminal::{bold, dim, line, note, quoted, wrapped};
use robogate_session::{ArmKind, Reopening, register_copy, rounds_of, space_of};

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
    /// Rejects the argument for a gate that runs episodes.
    pub(crate) fn unused(&self) -> Result<(), Exit> {
        match &self.nominal {
            None => Ok(()),
            Some(_) => {
                Err(anyhow!("--nominal applies to a finished run\nHint: add --run RUN, or use --twins")).or_usage()
            }
        }
    }

    /// The comparison of the episodes of `source` with their twins. `None` without a control arm.
    pub(crate) fn twins(&self, source: &Source, sampling: Sampling) -> Result<Option<Twins>, Exit> {
        let Some(nominal) = &self.nominal else {
            return source.folder().map_or(Ok(None), |folder| of_folder(folder, source, sampling));
        };
        let record = Record::of(source.dictionary()).map_err(refused)?;
        if !Path::new(nominal).exists()
            && let Some((column, value)) = nominal.split_once('=')
        {
            return Twins::within(&record, column, value, sampling).map_err(refused).map(Some);
        }
        let arm = open_source(Path::new(nominal))?;
        let arm = Record::of(arm.dictionary()).map_err(refused)?;
        Twins::of(&record, &arm, sampling).map_err(refused).map(Some)
    }
}

/// The comparison with the control arm in the folder of a run. `None` without a finished arm.
pub(crate) fn of_folder(folder: &Path, source: &Source, sampling: Sampling) -> Result<Option<Twins>, Exit> {
    let arm = folder.join(NOMINAL);
    if !arm.join(DICTIONARY).is_file() {
        return Ok(None);
    }
    let provenance = source.dictionary().provenance();
    let has_nominal = |name: &str| provenance.task.parameter(name).is_some_and(|spec| spec.nominal.is_some());
    let names = provenance.space.parameters().iter().map(|parameter| &*parameter.name);
    let kept = names.filter(|name| !has_nominal(name)).map(str::to_owned).collect();
    let nominal = Source::open(&arm).or_broken()?;
    let record = Record::of(source.dictionary()).map_err(refused)?;
    let nominal = Record::of(nominal.dictionary()).map_err(refused)?;
    let families = folder.join(FAMILIES);
    let families = match families.join(DICTIONARY).is_file() {
        true => Some(Record::of(Source::open(&families).or_broken()?.dictionary()).map_err(refused)?),
        false => None,
    };
    let twins = Twins::with_families(&record, &nominal, families.as_ref(), sampling).map_err(refused)?;
    Ok(Some(twins.keeping(kept)))
}

/// The same for a run that has just finished.
pub(crate) fn of_run(folder: &Path, sampling: Sampling) -> Result<Option<Twins>, Exit> {
    if !folder.join(NOMINAL).join(DICTIONARY).is_file() {
        return Ok(None);
    }
    of_folder(folder, &Source::open(folder).or_broken()?, sampling)
}

/// Writes the comparison into the folder of the run.
pub(crate) fn write(folder: &Path, twins: &Twins) -> Result<(), Exit> {
    let path = folder.join(TWINS);
    std::fs::write(&path, twins.to_json()).with_context(|| format!("cannot write {}", path.display())).or_broken()
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

/// Merges the arms of a campaign in shards into `out`, after the campaign itself was merged. If an arm does not exist, writes
/// its plan; if shards are missing, prints how to run them.
pub(crate) fn merge(campaign: &Shards, out: &Path, completion: &Completion, opening: &Reopening) -> Result<(), Exit> {
    let Completion::Finished { summary, .. } = completion else { return Ok(()) };
    if campaign.settings().plan.twins {
        for kind in ArmKind::ALL {
            merge_arm(kind, campaign, out, rounds_of(summary), opening)?;
        }
    }
    Ok(())
}

fn merge_arm(kind: ArmKind, campaign: &Shards, out: &Path, rounds: u64, opening: &Reopening) -> Result<(), Exit> {
    let settings = campaign.settings();
    if out.join(kind.folder()).join(DICTIONARY).is_file() {
        return Ok(());
    }
    let dir = campaign.dir().join(kind.folder());
    let open = match Shards::open(place::open(&dir)?) {
        Ok(open) => open,
        Err(ShardError::NotInShards { .. }) => {
            let space = settings.provenance.space.clone().into();
            let plan = kind.plan(&settings.plan, &space, &settings.provenance.task, rounds).map_err(run::exit)?;
            let Some(plan) = plan else { return Ok(()) };
            let provenance =
                Provenance { space: space_of(&plan)?, question_sha256: None, ..settings.provenance.clone() };
            register_copy(&dir, &campaign.dir(), &provenance);
            Shards::begin(place::create(&dir)?, campaign.shards(), &plan, provenance).map_err(shard::exit)?
        }
        Err(error) => return Err(shard::exit(error)),
    };
    let mut arm = Campaign::of(open)?;
    if let Some(round) = arm.open_round()? {
        note(format_args!(
            "the {} is incomplete: {} shards are missing\nnext: robogate plan {} --next, then robogate merge {} again",
            kind.as_str(),
            round.missing.len(),
            quoted(&dir),
            quoted(&campaign.dir())
        ));
        return Ok(());
    }
    arm.merge_quietly(&out.join(kind.folder()), &mut |_: &Event| {}, opening)?;
    // The page of an earlier merge lacks this arm.
    match std::fs::remove_file(out.join(crate::commands::report::PAGE)) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error)
            .with_context(|| format!("cannot replace {}", out.join(crate::commands::report::PAGE).display()))
            .or_broken(),
        _ => Ok(()),
    }
}
