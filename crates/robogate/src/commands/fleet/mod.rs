//! `robogate fleet`: judges units of a robot, each with its own constant deviations.
//!
//! ```text
//! DIR/fleet.json           the plan; written first, never changed
//! DIR/unit-001/            the gate of one unit, as `robogate gate` writes it
//! DIR/fleet-result.json    the share of units that meet the requirements, and what distinguishes the others
//! DIR/fleet.md, fleet.html the same for people
//! ```

mod result;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::Args;
use robogate_campaign::{DEFAULT_SEED, Event};
use robogate_gate::{Evaluation, FleetUnit, Verdict};

use crate::arguments::{AccessArguments, EnvironmentArguments, LatencyArguments, PolicyArguments};
use crate::commands::gate::answer_files;
use crate::commands::run::{How, free_folder, interrupted, introduce};
use crate::exit::Exit;
use crate::place;
use crate::progress::Progress;
use crate::terminal::{grouped, note, percent};
use robogate_session::{
    FleetEnd, FleetPlan, FleetRequest, PolicyLocation, Reopening, Subject, named_suite, unit_space,
};

/// Estimate the share of a robot's units that meet the requirements, and find what distinguishes the others.
///
/// Each unit has its own constant deviations (encoder biases, grip force, friction of the pads, pose of the camera, delay), and
/// the gate judges it on episodes of its own. The same command, or `robogate resume DIR`, continues an interrupted fleet.
///
/// Exit codes: 0 done, or at least --share of the units meet the requirements; with --share also 1 fewer, 3 not shown. 4
/// nothing was evaluated.
#[derive(Debug, Args)]
pub(crate) struct FleetOf {
    /// Set the number of units, 1 to 10000
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    units: u32,
    /// Draw the parameters of each unit from this space: a built-in one (franka-units, ur-units) or a TOML file; default:
    /// that of the robot's gripper
    #[arg(long, value_name = "NAME|FILE")]
    unit_space: Option<String>,
    /// Judge each unit on this suite: a built-in one or a TOML file; default: that of the task, otherwise 64 scenarios
    /// sampled from the environment's parameter space
    #[arg(long, value_name = "NAME|FILE")]
    suite: Option<String>,
    /// Sample the scenarios from this parameter space, without the parameters of the units
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "suite")]
    space: Option<String>,
    /// Choose the requirements on each unit: default, paper or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = "default")]
    requirements: String,
    /// Compare relative requirements with this baseline file; default: the built-in one of suite and robot
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Require at least this share of units to meet the requirements, 0 to 1: the exit code is then a verdict
    #[arg(long, value_name = "SHARE")]
    share: Option<f64>,
    /// Set the maximum number of rounds of the scenarios for each unit; default: the budget of the requirements
    #[arg(long, value_name = "N")]
    rounds: Option<u32>,
    /// Run all rounds of each unit and test once, instead of stopping as soon as the unit's verdict is certain
    #[arg(long)]
    fixed: bool,
    /// Set the seed of units and episodes
    #[arg(long, value_name = "S", default_value_t = DEFAULT_SEED)]
    seed: u64,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    policy: PolicyArguments,
    #[command(flatten)]
    access: AccessArguments,
    #[command(flatten)]
    latency: LatencyArguments,
    #[command(flatten)]
    how: How,
    /// Write the fleet to this folder; default: a new one under runs/
    #[arg(long, value_name = "DIR", value_parser = place::local())]
    out: Option<PathBuf>,
}

impl FleetOf {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let suite = self.suite.as_deref().map(named_suite).transpose()?;
        let environment = self.environment.choice().environment_of(suite.as_ref())?;
        let location = PolicyLocation { at: None, access: self.access.choice() };
        let policy = self.policy.choice().source_at(&location)?;
        location.check_used(policy.as_ref())?;
        let subject = Subject::new(environment, policy)?;
        let subject = subject.with_statistics(&self.policy.choice().statistics)?;
        let suite = match (suite, subject.own_suite()) {
            (None, Some(own)) if self.space.is_none() => Some(named_suite(own)?),
            (suite, _) => suite,
        };
        let unit_space = unit_space(&subject, self.unit_space.as_deref(), suite.as_ref())?;
        let subject = subject.with_latency(&self.latency.choice().varied_by(&unit_space))?;
        let request = FleetRequest {
            units: self.units,
            suite,
            space: self.space.clone(),
            latency: self.latency.choice(),
            requirements: self.requirements.clone(),
            baseline: self.baseline.clone(),
            share: self.share,
            rounds: self.rounds,
            fixed: self.fixed,
            seed: self.seed,
        };
        let plan = request.plan(&subject, unit_space)?;
        introduce(&plan.provenance, plan.seed);
        note(format_args!(
            "{} units from {}, each judged on at most {} rounds of {} scenarios ({}) by the requirements `{}`",
            grouped(u64::from(plan.units)),
            plan.unit_space.name(),
            plan.rounds,
            plan.suite.cases().len(),
            plan.suite.name(),
            plan.requirements.name
        ));
        let dir = match &self.out {
            Some(dir) => dir.clone(),
            None => free_folder(&format!("fleet-{}-{}", subject.label(), self.seed)),
        };
        subject.register(&dir, &plan.provenance);
        plan.begin(&dir)?;
        judge(&dir, &plan, &subject, &self.how)
    }
}

/// Continues an interrupted fleet.
pub(crate) fn resume(dir: &Path, opening: &Reopening, how: &How) -> Result<u8, Exit> {
    let plan = FleetPlan::open(dir)?;
    let subject = Subject::recorded(&plan.provenance, Some(dir), opening)?;
    judge(dir, &plan, &subject, how)
}

/// Judges the units that are not finished, and writes the result.
fn judge(dir: &Path, plan: &FleetPlan, subject: &Subject, how: &How) -> Result<u8, Exit> {
    let mut progress = Progress::new();
    // A bar for each unit suits a terminal. A log gets one line for each unit.
    let shown = std::io::stderr().is_terminal();
    let mut events = |event: &Event| {
        if shown || matches!(event, Event::Warning { .. }) {
            progress.hear(event);
        }
    };
    let mut on_unit = |folder: &Path, unit: &FleetUnit, evaluation: &Evaluation| {
        tell(plan, unit);
        answer_files(folder, evaluation, None)
    };
    let end = how.with_workers(|workers| Ok(plan.judge(dir, subject, workers, &mut events, &mut on_unit)?))?;
    match end {
        FleetEnd::Judged(units) => result::write(dir, plan, units, how.json),
        FleetEnd::Interrupted { judged, done, episodes, .. } => {
            note(format_args!("{judged} of {} units are judged; of the next one:", plan.units));
            Ok(interrupted(dir, done, episodes))
        }
    }
}

/// Prints the result of a unit.
fn tell(plan: &FleetPlan, unit: &FleetUnit) {
    let verdict = match unit.verdict {
        Verdict::Pass => "meets the requirements",
        Verdict::Fail => "violates them",
        Verdict::Inconclusive => "is undecided",
        Verdict::Invalid => "has no valid episode",
    };
    let rate = if unit.valid > 0 { percent(unit.successes as f64 / unit.valid as f64) } else { "-".to_owned() };
    note(format_args!(
        "unit {} of {} {verdict}: {rate} success in {} episodes",
        unit.unit,
        plan.units,
        grouped(unit.episodes)
    ));
}
