//! Runs the coarse episodes of a campaign, and estimates the rates of the fine simulator from both.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, anyhow};
use robogate_analysis::{FidelityRisk, TwoFidelities};
use robogate_campaign::folder::{DICTIONARY, PLAN};
use robogate_campaign::{COARSE, Completion, Event, Executor, Plan, RunError, ThreadPool};
use robogate_core::Outcome;
use robogate_dictionary::{Dictionary, Provenance};
use robogate_report::fidelity_lines;
use robogate_risk::{Fitting, Inputs, RiskModel, Sample, all_processors, prior_gain};
use robogate_stats::Confidence;
use robogate_stats::format::counted;
use robogate_stats::two_fidelities::FEWEST;
use serde_json::json;

use crate::commands::run::{self, How};
use crate::exit::{Exit, OrExit};
use crate::lost_episodes::RunsLostAgain;
use crate::progress::Progress;
use crate::reopening::Reopening;
use crate::subject::Subject;
use crate::terminal::{bold, line, note, percent, wrapped};

/// The estimate in the folder of a run.
pub(crate) const FIDELITY: &str = "fidelity.json";

/// The default share of scenarios that also run in the fine simulator: the best one for a correlation of 0.96 and coarse episodes that
/// cost 0.44 of fine ones.
pub(crate) const SHARE: &str = "0.2";

/// The default time step of coarse episodes, in seconds.
pub(crate) const TIME_STEP_S: f64 = 0.005;

/// Largest number of coarse episodes that train a risk model, at equal distances. More hardly change it, and the fit takes seconds.
const MOST_TRAINED: usize = 5_000;

/// The key of the time step in the record of a built-in environment.
const TIME_STEP: &str = "time_step_s";

/// The coarse episodes beside a campaign.
pub(crate) struct CoarseArm {
    folder: PathBuf,
    plan: Plan,
    provenance: Provenance,
    subject: Subject,
}

impl CoarseArm {
    /// The coarse episodes of a campaign in `dir`. `None` if its plan has none.
    pub(crate) fn of(
        dir: &Path,
        plan: &Plan,
        provenance: &Provenance,
        opening: &Reopening,
    ) -> Result<Option<Self>, Exit> {
        let (Some(coarse), Some(arm)) = (&plan.coarse, plan.coarse_arm()) else { return Ok(None) };
        plan.check(&provenance.space).or_usage()?;
        let world = &provenance.world;
        let own = world.get(TIME_STEP).and_then(serde_json::Value::as_f64);
        let Some(own) = own.filter(|_| world.get("simulator").is_none()) else {
            return Err(anyhow!(
                "--coarse: the time step of {} in {} cannot be changed\n  hint: use a built-in task for an arm without --env and \
                 --simulator, or leave out --coarse",
                provenance.task.name,
                provenance.engine.name
            ))
            .or_usage();
        };
        if coarse.time_step_s <= own {
            return Err(anyhow!(
                "--coarse-step {}: expected a time step above that of the run, which is {own} s",
                coarse.time_step_s
            ))
            .or_usage();
        }
        if plan.uniform.episodes < FEWEST {
            return Err(anyhow!(
                "--coarse: {} with both time steps; expected at least {FEWEST}\n  hint: increase -n or the share",
                counted(plan.uniform.episodes, "episode")
            ))
            .or_usage();
        }
        let mut coarser = provenance.clone();
        if let Some(world) = coarser.world.as_object_mut() {
            world.insert(TIME_STEP.to_owned(), json!(coarse.time_step_s));
        }
        let subject = Subject::recorded(&coarser, Some(dir), opening).map_err(|exit| {
            let error = exit.error.context(format!("--coarse-step {}: cannot be used", coarse.time_step_s));
            Exit { error, ..exit }
        })?;
        let provenance = subject.provenance(provenance.space.clone())?;
        Ok(Some(Self { folder: dir.join(COARSE), plan: arm, provenance, subject }))
    }

    /// Runs the campaign with `work`, then the coarse episodes, and writes and prints the results.
    pub(crate) fn conduct(
        self,
        dir: &Path,
        how: &How,
        subject: &Subject,
        work: impl FnOnce(&dyn Executor, &mut dyn FnMut(&Event)) -> Result<Completion, RunError>,
    ) -> Result<u8, Exit> {
        let (fine, coarse, outage) = how.with_pool(subject, |pool| {
            let mut progress = Progress::new();
            let mut show = |event: &Event| progress.hear(event);
            let executor = RunsLostAgain::new(pool, u64::MAX);
            let fine = work(&executor, &mut show).map_err(run::exit)?;
            if let Completion::Interrupted { .. } = fine {
                return Ok((fine, None, executor.outage()));
            }
            let pool = ThreadPool { factory: &self.subject, threads: pool.threads, stop: pool.stop };
            let executor = RunsLostAgain::new(&pool, u64::MAX);
            let coarse = self.run(&executor, &mut show).map_err(run::exit)?;
            Ok((fine, Some(coarse), executor.outage()))
        })?;
        let interrupted = match (&fine, coarse) {
            (Completion::Interrupted { .. }, _) => Some(fine.clone()),
            (_, coarse) => coarse.filter(|coarse| matches!(coarse, Completion::Interrupted { .. })),
        };
        if let Some(interrupted) = interrupted {
            if let Some(outage) = outage {
                return Err(anyhow!(
                    "stopped: {outage}\n  hint: the recorded episodes are kept; `robogate resume` runs the others once the server is \
                     available again"
                ))
                .or_broken();
            }
            return run::conclude(dir, &interrupted, None, how.json);
        }
        note("comparing risk models with and without the coarse episodes");
        match estimate(dir, subject) {
            Ok(found) => write(dir, &found)?,
            Err(exit) => note(format_args!("note: {exit}")),
        }
        run::conclude(dir, &fine, Some(subject), how.json)
    }

    /// Runs or resumes the coarse episodes.
    fn run(&self, executor: &dyn Executor, events: &mut dyn FnMut(&Event)) -> Result<Completion, RunError> {
        if self.folder.join(PLAN).is_file() {
            return robogate_campaign::resume(&self.folder, &self.provenance, executor, events);
        }
        note(counted(self.plan.episodes(), "coarse episode"));
        robogate_campaign::start(&self.folder, &self.plan, self.provenance.clone(), executor, events)
    }
}

/// The estimate from the run in `dir` and its coarse episodes.
fn estimate(dir: &Path, subject: &Subject) -> Result<TwoFidelities, Exit> {
    let open = |folder: &Path| Dictionary::open(&folder.join(DICTIONARY)).or_broken();
    let (fine, coarse) = (open(dir)?, open(&dir.join(COARSE))?);
    let found = TwoFidelities::of(&fine, &coarse).or_broken()?;
    Ok(TwoFidelities { risk: risk(&fine, &coarse, subject)?, ..found })
}

/// Compares risk models of fine episodes with and without one of the coarse episodes. Partners of fine episodes are left out of the
/// latter, because they would tell it the outcomes. `None` if no model can be fitted.
fn risk(fine: &Dictionary, coarse: &Dictionary, subject: &Subject) -> Result<Option<FidelityRisk>, Exit> {
    let samples = |dictionary: &Dictionary, first: u64| -> Result<Vec<Sample>, Exit> {
        let mut samples = Vec::new();
        for entry in dictionary.entries() {
            let episode = entry.or_broken()?.episode;
            if episode.scenario.index >= first && !matches!(episode.outcome, Outcome::Invalid(_)) {
                samples.push(Sample { scenario: episode.scenario, success: episode.outcome == Outcome::Success });
            }
        }
        Ok(samples)
    };
    let (own, mut others) = (samples(fine, 0)?, samples(coarse, fine.len())?);
    let step = others.len().div_ceil(MOST_TRAINED).max(1);
    others = others.into_iter().step_by(step).collect();
    let inputs = Arc::new(Inputs::new(&fine.provenance().space, subject.foresight()?));
    let how = Fitting { threads: all_processors(), ..Fitting::default() };
    let Ok(prior) = RiskModel::fit(Arc::clone(&inputs), &others, how) else { return Ok(None) };
    let prior = Arc::new(prior);
    let Ok(gain) = prior_gain(&prior, &inputs, &own, how) else { return Ok(None) };
    let Ok(model) = RiskModel::fit_after(&prior, inputs, &own, how) else { return Ok(None) };
    let (mean, half) = (gain.without - gain.with, Confidence::P95.z() * gain.se);
    Ok(Some(FidelityRisk {
        coarse_episodes: others.len() as u64,
        fine_episodes: gain.episodes,
        with: gain.with,
        without: gain.without,
        gain_95: [mean - half, mean + half],
        slope: model.choice().prior_slope,
    }))
}

/// Writes the estimate into the folder of the run.
fn write(dir: &Path, found: &TwoFidelities) -> Result<(), Exit> {
    let path = dir.join(FIDELITY);
    let mut text = serde_json::to_string_pretty(found).or_broken()?;
    text.push('\n');
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display())).or_broken()
}

/// The estimate in the folder of a run. `None` without one.
pub(crate) fn of_run(dir: &Path) -> Option<TwoFidelities> {
    serde_json::from_slice(&std::fs::read(dir.join(FIDELITY)).ok()?).ok()
}

/// Prints the estimate.
pub(crate) fn print(found: &TwoFidelities) {
    line("");
    line(bold("Fine and coarse episodes"));
    fidelity_lines(found).iter().for_each(|text| wrapped(text));
    for rate in found.rates.iter().skip(1) {
        let [low, high] = rate.interval_95.map(percent);
        line(format_args!("  {:<28} {:>7}  95 % interval {low} to {high}", rate.metric, percent(rate.rate)));
    }
}
