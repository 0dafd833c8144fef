//! `robogate demos`: records demonstrations of the scripted controller.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use anyhow::anyhow;
use clap::Args;
use robogate_campaign::DEFAULT_SEED;
use robogate_campaign::folder::DICTIONARY;
use robogate_core::samplers::Uniform;
use robogate_core::{Assignment, Outcome, Sampler, Scenario, Seed, rollout};
use robogate_demos::{Dataset, DatasetError, Demonstration};
use robogate_dictionary::Dictionary;
use serde_json::json;

use crate::arguments::EnvironmentArguments;
use crate::commands::run::stop_on_signal;
use crate::exit::{DONE, Exit, INFRASTRUCTURE, INTERRUPTED, INVALID, OrExit, USAGE};
use crate::number;
use crate::place;
use crate::terminal::{grouped, line, note, warning};
use robogate_session::{Cell, named_space};

/// Frames per second: one for each control period.
const FPS: u32 = 20;

/// Record demonstrations of the scripted controller, with images, as a LeRobot dataset (v3.0).
#[derive(Debug, Args)]
pub(crate) struct Demos {
    /// Folder of the dataset; it must not exist
    #[arg(long, value_name = "DIR", value_parser = place::local())]
    out: PathBuf,
    /// Set the number of episodes to try
    #[arg(short, long, value_name = "N", default_value_t = 100)]
    n: u32,
    /// Set the seed of the scenarios
    #[arg(long, value_name = "S", default_value_t = DEFAULT_SEED)]
    seed: u64,
    /// Choose the parameter space: a built-in one (see `robogate list`) or a TOML file; default: learned for pick_place,
    /// otherwise that of the task
    #[arg(long, value_name = "NAME|FILE")]
    space: Option<String>,
    /// Use the scenarios in which the policy of this run failed, in order and with fresh seeds, instead of a space
    #[arg(long, value_name = "DIR", conflicts_with = "space")]
    failed_in: Option<PathBuf>,
    /// Set width and height of the images, in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 96, value_parser = clap::value_parser!(u16).range(8..=1024))]
    size: u16,
    /// Set how far the arm is pushed off the controller's path above the table, so that the recovery is recorded too:
    /// standard deviation in metres, from 0 to 0.1; 0 disables the pushes
    #[arg(long, value_name = "METRES", default_value_t = 0.02)]
    push: f64,
    /// Keep failed episodes too
    #[arg(long)]
    all: bool,
    /// Set the number of threads; default: one for each core
    #[arg(long, value_name = "T", value_parser = number::threads)]
    threads: Option<NonZeroUsize>,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    environment: EnvironmentArguments,
}

impl Demos {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let usage = |why: String| Exit { code: USAGE, error: anyhow!(why) };
        if !(0.0..=0.1).contains(&self.push) {
            return Err(usage(format!("--push {}: out of range. Expected 0 to 0.1 m", self.push)));
        }
        if self.n == 0 {
            return Err(usage("-n 0: expected at least 1 episode".to_owned()));
        }
        let mut cell = self.environment.choice().cell()?;
        cell.set_picture_px(self.size.into());
        let seed = Seed::campaign(self.seed);
        let points = match &self.failed_in {
            Some(run) => failures(run)?.into_iter().cycle().take(self.n as usize).collect(),
            None => self.points(&cell, seed)?,
        };
        let stop = stop_on_signal()?;
        let mut dataset = Dataset::create(&self.out, FPS, cell.robot_name()).map_err(exit)?;
        let wanted = cell.servers().or(self.threads).or_else(|| thread::available_parallelism().ok());
        let threads = wanted.map_or(1, NonZeroUsize::get);
        let (mut kept, mut failed, mut invalid) = (0_u64, 0_u64, 0_u64);
        // Rounds limit the number of episodes that wait to be written.
        let round = 4 * threads;
        for (nth, some) in points.chunks(round).enumerate() {
            let first = nth * round;
            let scenarios: Vec<Scenario> = (first as u64..)
                .zip(some)
                .map(|(index, requested)| Scenario { index, seed: seed.episode(index), requested: requested.clone() })
                .collect();
            let recorded = self.record(&cell, &scenarios, threads, &stop)?;
            if stop.load(Ordering::Relaxed) {
                // The unfinished dataset removes its folder.
                note("interrupted: no dataset was written");
                return Ok(INTERRUPTED);
            }
            for (outcome, demonstration) in recorded {
                match outcome {
                    Outcome::Success => {}
                    Outcome::Failure(_) => failed += 1,
                    Outcome::Invalid(fault) => {
                        invalid += 1;
                        warning(format_args!("an episode is invalid: {fault}"));
                        continue;
                    }
                }
                if self.all || outcome == Outcome::Success {
                    dataset.push(&demonstration).map_err(exit)?;
                    kept += 1;
                }
            }
            let done = first + scenarios.len();
            if done * 10 / points.len() > first * 10 / points.len() {
                note(format_args!("{done} of {} episodes, {kept} kept", points.len()));
            }
        }
        if kept == 0 {
            let what = if invalid > 0 { "was valid" } else { "succeeded" };
            return Err(Exit { code: INVALID, error: anyhow!("no episode {what}: no dataset was written") });
        }
        let written = dataset.finish().map_err(exit)?;
        self.report(&written, failed, invalid);
        Ok(DONE)
    }

    /// Samples points of the space, independently and uniformly.
    fn points(&self, cell: &Cell, seed: Seed) -> Result<Vec<Assignment>, Exit> {
        let gripper = &cell.robot().settings.gripper;
        let own = cell.task().demonstration_space(gripper);
        let space = match &self.space {
            Some(name) => named_space(name),
            // The space of a task in a file has no name outside of it.
            None if own == cell.task().space(gripper) => cell.own_space(),
            None => named_space(own),
        };
        let space = space.or_usage()?;
        cell.check_space(&space).or_usage()?;
        let space = Arc::new(space);
        let design = Uniform.design(&space, self.n as usize, seed.stream("demonstrations")).or_usage()?;
        Ok((0..design.len()).filter_map(|i| design.assignment(i)).collect())
    }

    fn report(&self, written: &robogate_demos::Written, failed: u64, invalid: u64) {
        if self.json {
            line(json!({
                "version": 1,
                "dataset": self.out,
                "episodes": written.episodes,
                "frames": written.frames,
                "failed": failed,
                "invalid": invalid,
            }));
        } else {
            let (episodes, frames) = (grouped(written.episodes as u64), grouped(written.frames as u64));
            let kept = if self.all { "kept" } else { "excluded" };
            line(format_args!("{episodes} episodes, {frames} frames in {}", self.out.display()));
            line(format_args!("  of {} tried, {failed} failed ({kept}), {invalid} were invalid", self.n));
        }
    }

    /// Runs the scenarios on this number of threads. The results have the order of the scenarios. Episodes that have not
    /// begun when `stop` is set are left out.
    fn record(
        &self,
        cell: &Cell,
        scenarios: &[Scenario],
        threads: usize,
        stop: &AtomicBool,
    ) -> Result<Vec<(Outcome, Demonstration)>, Exit> {
        let share = scenarios.len().div_ceil(threads).max(1);
        let work = |mine: &[Scenario]| -> anyhow::Result<Vec<(Outcome, Demonstration)>> {
            let (mut environment, mut recorder) = cell.demonstrator(self.push)?;
            Ok(mine
                .iter()
                .take_while(|_| !stop.load(Ordering::Relaxed))
                .map(|scenario| (rollout(&mut *environment, &mut recorder, scenario).outcome, recorder.take()))
                .collect())
        };
        let results: Vec<_> = thread::scope(|scope| {
            let handles: Vec<_> = scenarios.chunks(share).map(|mine| scope.spawn(move || work(mine))).collect();
            handles.into_iter().map(thread::ScopedJoinHandle::join).collect()
        });
        let mut all = Vec::with_capacity(scenarios.len());
        for result in results {
            let broken = |error| Exit { code: INFRASTRUCTURE, error };
            all.extend(
                result.map_err(|_| broken(anyhow!("a recording thread panicked"))).and_then(|r| r.map_err(broken))?,
            );
        }
        Ok(all)
    }
}

/// Gives an error of a dataset its exit code: usage if another folder helps, infrastructure otherwise.
fn exit(error: DatasetError) -> Exit {
    let code = match error {
        DatasetError::Exists(_) | DatasetError::Locked(_) => USAGE,
        DatasetError::Io { .. } | DatasetError::Table { .. } | DatasetError::Episode { .. } | DatasetError::Empty => {
            INFRASTRUCTURE
        }
    };
    Exit { code, error: error.into() }
}

/// The requested parameters of the failed episodes of this run, in their order.
fn failures(run: &Path) -> Result<Vec<Assignment>, Exit> {
    let dictionary = Dictionary::open(&run.join(DICTIONARY))
        .map_err(|error| anyhow!(error).context(format!("{}: not a finished run", run.display())))
        .or_usage()?;
    let mut failed = Vec::new();
    for entry in dictionary.entries() {
        let episode = entry.or_usage()?.episode;
        if matches!(episode.outcome, Outcome::Failure(_)) {
            failed.push(episode.scenario.requested);
        }
    }
    if failed.is_empty() {
        return Err(anyhow!(
            "--failed-in {}: the run has no failed episode. Expected a run with failures",
            run.display()
        ))
        .or_usage();
    }
    Ok(failed)
}
