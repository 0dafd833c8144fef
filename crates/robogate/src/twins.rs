//! The control arm of a campaign: runs the nominal twins, and compares them with their partners.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::Source;
use robogate_campaign::folder::{DICTIONARY, PLAN};
use robogate_campaign::shards::{ShardError, Shards};
use robogate_campaign::{Completion, Event, Executor, NOMINAL, NominalArm, Plan, RunError, SuiteStage, Summary};
use robogate_core::ParameterSpace;
use robogate_dictionary::Provenance;
use robogate_gate::{Record, Sampling, TwinFamily, Twins};
use robogate_report::TwinRow;

use crate::commands::gate::refused;
use crate::commands::run;
use crate::commands::shard::{self, quoted};
use crate::exit::{Exit, OrExit};
use crate::place;
use crate::sharded::Campaign;
use crate::source::open_source;
use crate::subject::Subject;
use crate::terminal::{bold, dim, grouped, line, note, wrapped};

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
                Err(anyhow!("--nominal applies to a finished run\n  hint: add --run RUN, or use --twins")).or_usage()
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
    Ok(Some(Twins::of(&record, &nominal, sampling).map_err(refused)?.keeping(kept)))
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

/// A control arm that belongs to a campaign.
pub(crate) struct Arm {
    folder: PathBuf,
    plan: Plan,
    provenance: Provenance,
}

impl Arm {
    /// The control arm of a campaign in `dir`. `None` if its plan has none.
    pub(crate) fn of(dir: &Path, plan: &Plan, space: &ParameterSpace, subject: &Subject) -> Result<Option<Self>, Exit> {
        if !plan.twins {
            return Ok(None);
        }
        let rounds = plan.suite.as_ref().map_or_else(|| plan.episodes(), |stage| stage.rounds);
        let arm = NominalArm::of(plan, &space.clone().into(), subject.task(), rounds).map_err(run::exit)?;
        let space = arm.plan.suite.as_ref().map(|stage| stage.suite.space().clone());
        let space = space.ok_or_else(|| anyhow!("the control arm has no suite")).or_broken()?;
        let provenance = subject.provenance(space)?;
        Ok(Some(Self { folder: dir.join(NOMINAL), plan: arm.plan, provenance }))
    }

    /// Runs or resumes the arm after its campaign. A campaign that was stopped has no arm yet.
    pub(crate) fn after(
        self,
        campaign: Completion,
        executor: &dyn Executor,
        events: &mut dyn FnMut(&Event),
    ) -> Result<Completion, RunError> {
        let Completion::Finished { summary, .. } = &campaign else { return Ok(campaign) };
        let Self { folder, mut plan, provenance } = self;
        if let Some(stage) = &mut plan.suite {
            as_many_rounds(stage, rounds_of(summary));
        }
        let done = if folder.join(PLAN).is_file() {
            robogate_campaign::resume(&folder, &provenance, executor, events)?
        } else {
            note(format_args!("control arm: {} nominal twins", grouped(plan.episodes())));
            robogate_campaign::start(&folder, &plan, provenance, executor, events)?
        };
        Ok(match done {
            Completion::Finished { .. } => campaign,
            interrupted @ Completion::Interrupted { .. } => interrupted,
        })
    }
}

/// The rounds of the suite that ran, or the episodes of a campaign without a suite.
fn rounds_of(summary: &Summary) -> u64 {
    summary.suite.as_ref().map_or(summary.episodes, |suite| suite.rounds)
}

/// Limits the arm to the rounds that ran.
fn as_many_rounds(stage: &mut SuiteStage, rounds: u64) {
    stage.rounds = stage.rounds.min(rounds.max(1));
}

/// Merges the control arm of a campaign in shards into `out`, after the campaign itself was merged. If the arm does not
/// exist, writes its plan; if shards are missing, prints how to run them.
pub(crate) fn merge(campaign: &Shards, out: &Path, completion: &Completion) -> Result<(), Exit> {
    let settings = campaign.settings();
    let Completion::Finished { summary, .. } = completion else { return Ok(()) };
    if !settings.plan.twins || out.join(NOMINAL).join(DICTIONARY).is_file() {
        return Ok(());
    }
    let dir = campaign.dir().join(NOMINAL);
    let open = match Shards::open(place::open(&dir)?) {
        Ok(open) => open,
        Err(ShardError::NotInShards { .. }) => {
            let space = settings.provenance.space.clone().into();
            let arm = NominalArm::of(&settings.plan, &space, &settings.provenance.task, rounds_of(summary))
                .map_err(run::exit)?;
            let space = arm.plan.suite.as_ref().map(|stage| stage.suite.space().clone());
            let space = space.ok_or_else(|| anyhow!("the control arm has no suite")).or_broken()?;
            let provenance = Provenance { space, question_sha256: None, ..settings.provenance.clone() };
            Shards::begin(place::create(&dir)?, campaign.shards(), &arm.plan, provenance).map_err(shard::exit)?
        }
        Err(error) => return Err(shard::exit(error)),
    };
    let mut arm = Campaign::of(open)?;
    if let Some(round) = arm.open_round()? {
        note(format_args!(
            "the control arm is incomplete: {} shards are missing\nnext: robogate plan {} --next, then robogate merge {} again",
            round.missing.len(),
            quoted(&dir),
            quoted(&campaign.dir())
        ));
        return Ok(());
    }
    arm.merge_quietly(&out.join(NOMINAL), &mut |_: &Event| {})?;
    // The page of the first merge has no control arm.
    match std::fs::remove_file(out.join(crate::commands::report::PAGE)) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error)
            .with_context(|| format!("cannot replace {}", out.join(crate::commands::report::PAGE).display()))
            .or_broken(),
        _ => Ok(()),
    }
}
