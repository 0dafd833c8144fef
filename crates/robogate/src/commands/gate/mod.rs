//! `robogate gate`: decides whether a policy may run.
//!
//! `start` prepares a gate and runs its suite, `judge` asks the question about a finished run, and `verdict` writes and prints the
//! answer.

mod baseline;
mod judge;
mod question;
mod start;
mod verdict;

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;

use crate::arguments::{AccessArguments, EnvironmentArguments, LatencyArguments, PolicyArguments, WarnerArguments};
use crate::commands::run::How;
use crate::exit::{Exit, OrExit};
use crate::given::Given;
use crate::twins::NominalEpisodes;
use robogate_report::Again;
use robogate_session::{CONTROL_EPISODES, PolicyLocation};

/// `robogate_eval` sets this variable if its own process has the environment.
const CALLED_FROM_PYTHON: &str = "ROBOGATE_CALLED_FROM_PYTHON";

pub(crate) use judge::evaluation_of;
pub(crate) use question::real_evidence_for;
pub(crate) use start::resume;
pub(crate) use verdict::{answer_files, finish};

/// Decide whether the policy may run: run a suite until the verdict is certain, or judge a finished run.
///
/// Exit codes: 0 pass, 1 fail, 3 inconclusive, 4 nothing was evaluated.
#[derive(Debug, Args)]
pub(crate) struct Gate {
    /// First, because reading the other arguments removes them.
    #[command(flatten)]
    given: Given,
    /// Judge this run's folder or dictionary instead of running episodes
    #[arg(long, value_name = "RUN", conflicts_with_all = ["suite", "rounds", "fixed", "seed", "plan"])]
    run: Option<PathBuf>,
    /// Run this suite: a built-in one or a TOML file; default: industrial-68 in the built-in cell, otherwise 64
    /// new points of the environment's parameter space in each round, so that the verdict is about the space
    #[arg(long, value_name = "NAME|FILE")]
    suite: Option<String>,
    /// Run 64 new points of this parameter space in each round, so that the verdict is about the space; default: the
    /// environment's own
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "suite")]
    space: Option<String>,
    /// Judge one family of perturbations at a time, in about 64 scenarios, and run nominal twins: NAME=PARAMETER,PARAMETER (`*`
    /// at the end stands for any ending), `each` for every parameter alone, or `declared` for the families of the task. Repeat
    /// it for each family
    #[arg(long, value_name = "FAMILY", conflicts_with_all = ["suite", "run"])]
    family: Vec<String>,
    /// Choose the requirements: default, paper or a TOML file
    #[arg(long, value_name = "NAME|FILE")]
    requirements: Option<String>,
    /// Also require that at most 1 % of the episodes exceed these limits of contact forces, and list the contacts that do
    /// (TOML, docs/guides/forces.md)
    #[arg(long, value_name = "FILE")]
    force_limits: Option<PathBuf>,
    /// Compare relative requirements with this baseline file or run; with a run, also test whether this policy may
    /// replace that one
    #[arg(long, value_name = "FILE|RUN")]
    baseline: Option<PathBuf>,
    /// Also write the figures of the run to this file, as a baseline for other runs of the same scenarios
    #[arg(long, value_name = "FILE", requires = "run")]
    write_baseline: Option<PathBuf>,
    /// Judge requirements on `real:success` with these trials of the real robot: the file of `robogate transfer --out`;
    /// default: that of the run's gate
    #[arg(long, value_name = "FILE")]
    real: Option<PathBuf>,
    /// Set the non-inferiority margin: how far the success rate may lie below that of the baseline run or of the policy
    /// of --against; default: 0.05, with --run the margin of its gate
    #[arg(long, value_name = "SHARE")]
    margin: Option<f64>,
    /// Also test whether this policy may replace another one, which runs the same scenarios round by round: `random`,
    /// `scripted`, the address of a policy server, or an ONNX file
    #[arg(long, value_name = "URL|FILE|random|scripted", conflicts_with_all = ["run", "baseline"])]
    against: Option<String>,
    /// Choose the observation and action mapping of the policy of --against
    #[arg(long, value_name = "NAME|FILE", requires = "against", conflicts_with_all = ["run", "baseline"])]
    against_profile: Option<String>,
    /// Set the maximum number of rounds of the suite; default: the budget of the requirements, or 1 for a published
    /// benchmark
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    rounds: Option<u32>,
    /// Run all rounds and test once, instead of stopping as soon as the verdict is certain. Points of a space are then one set,
    /// which each round repeats
    #[arg(long)]
    fixed: bool,
    /// Print how often the gate passes and fails at given true rates, and run nothing
    #[arg(long)]
    plan: bool,
    /// Also run the nominal twin of each scenario: the same seed with the task's nominal values. The gate then states the
    /// effect of each group of perturbations, or of each family that the task declares, and what fails without them. The verdict
    /// does not depend on it
    #[arg(long, conflicts_with = "run")]
    twins: bool,
    /// Vary nothing: judge the environment as its author made it. With --run: compare each episode with its nominal twin, in this run
    /// or import of the control arm, or in the imported rows with COLUMN=VALUE
    #[arg(long, value_name = "RUN|COLUMN=VALUE", num_args = 0..=1, conflicts_with_all = ["suite", "space", "family", "twins"])]
    nominal: Option<Option<String>>,
    #[command(flatten)]
    nominal_episodes: NominalEpisodes,
    /// Set the number of episodes of each control of an external policy: the environment's expert, the expert through
    /// the profile, and random actions of the model. 0 skips the controls, and the result says so; it also skips the
    /// episodes that run twice, in another process and order
    #[arg(long, value_name = "N", default_value_t = CONTROL_EPISODES)]
    controls: u32,
    /// Set the seed of the rounds
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    policy: PolicyArguments,
    /// Record the files of the policy behind a server: the folder or file of its checkpoint, which `robogate admit --checkpoint`
    /// compares; default: that of a policy that the environment's process loads (lerobot:, sb3:)
    #[arg(long, value_name = "PATH", requires = "policy", conflicts_with_all = ["run", "plan", "divide"])]
    checkpoint: Option<PathBuf>,
    #[command(flatten)]
    access: AccessArguments,
    #[command(flatten)]
    latency: LatencyArguments,
    #[command(flatten)]
    warner: WarnerArguments,
    #[command(flatten)]
    how: How,
    /// Write the plan of the gate in N shards to --out, and run nothing: `robogate plan DIR --next` prints the commands
    /// that run the next round, and `robogate merge DIR` returns the verdict (docs/guides/cluster.md)
    #[arg(long, value_name = "N", requires = "out", conflicts_with_all = ["run", "plan", "against"])]
    divide: Option<u32>,
    /// Register the run before its first episode: sign its plan, seed, question and policy with this private key, and
    /// number the registration in PRIVATE.registrations (docs/concepts/signatures.md)
    #[arg(long, value_name = "PRIVATE", conflicts_with_all = ["run", "plan"])]
    register: Option<PathBuf>,
    /// Write the run to this folder (default: a new one under runs/); with --run, write only the verdict's files
    /// (default: none)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Gate {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        self.check_warner()?;
        match &self.run {
            Some(run) => self.judge(run),
            None => self.start(),
        }
    }

    /// The options of a new run: those of the subject, and those of this command line that a new run also has.
    fn again(&self, subject: Again) -> Again {
        // A baseline run has the scenarios of its own seed.
        let own = [
            &["run", "seed", "rounds", "out", "json", "plan", "divide", "register", "write_baseline", "goes_on"][..],
            if self.baseline.is_some() { &["baseline", "margin"] } else { &[] },
        ]
        .concat();
        let scenarios = ["suite", "space", "family", "nominal", "fixed"];
        let elsewhere = [&own[..], &scenarios].concat();
        Again {
            gate: subject.gate + &self.given.again("gate", &own),
            gate_elsewhere: subject.gate_elsewhere + &self.given.again("gate", &elsewhere),
            run: subject.run + &self.given.again("run", &elsewhere),
            from_python: std::env::var_os(CALLED_FROM_PYTHON).is_some(),
        }
    }

    /// Rejects a margin if there is no comparison that it applies to.
    fn check_margin(&self, compared: bool) -> Result<(), Exit> {
        match self.margin {
            Some(_) if !compared => Err(anyhow!(
                "--margin applies to a comparison with another policy\nHint: give a run with --baseline, or a policy with --against"
            ))
            .or_usage(),
            _ => Ok(()),
        }
    }

    /// Rejects a warner where none can act: in a finished run, and beside another policy, for which no detector was trained.
    fn check_warner(&self) -> Result<(), Exit> {
        let elsewhere = [(self.run.is_some(), "--run"), (self.against.is_some(), "--against")];
        match elsewhere.into_iter().find(|(given, _)| *given && self.warner.choice().detector.is_some()) {
            Some((_, option)) => Err(anyhow!(
                "--warner cannot be used with {option}\nHint: leave out {option}; the gate runs warned episodes again without the warner"
            ))
            .or_usage(),
            None => Ok(()),
        }
    }

    /// Rejects a control arm for a gate that runs episodes, and a judgement of a finished run without one.
    fn check_nominal(&self) -> Result<(), Exit> {
        let wrong = match (&self.nominal, &self.run) {
            (Some(Some(_)), None) => {
                "--nominal with a control arm applies to a finished run\nHint: add --run RUN, use --twins, or leave out the value"
            }
            (Some(None), Some(_)) => {
                "--nominal needs the control arm of a finished run\nHint: give its folder, or COLUMN=VALUE"
            }
            _ => return Ok(()),
        };
        Err(anyhow!(wrong)).or_usage()
    }

    /// How this process reaches the policy.
    fn location(&self) -> PolicyLocation {
        PolicyLocation { at: None, access: self.access.choice() }
    }
}
