//! `robogate rank`: finds the best of several policies.
//!
//! ```text
//! DIR/NAME/          the campaign of one policy, as `robogate run --suite` writes it
//! DIR/question.json  names of the policies, guarantee and error, written before the first episode
//! DIR/ranking.json   the answer
//! ```

mod results;
mod rounds;
mod show;

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use clap::{Args, ValueEnum};
use robogate_campaign::DEFAULT_SEED;
use robogate_gate::{RankingGuarantee, RankingOutcome};

use crate::arguments::{AccessArguments, EnvironmentArguments, LatencyArguments};
use crate::commands::analyze::Groups;
use crate::commands::run::How;
use crate::exit::{Exit, OrExit};
use crate::given::Given;
use crate::place;
use robogate_session::{CONTROL_EPISODES, POLICIES};

/// The file of the answer in the folder of a contest.
const ANSWER: &str = "ranking.json";

/// Find the best of several policies: all run the same scenarios, and worse ones leave after each round.
///
/// With runs or results files in place of policies, rank these: the rows are tested once, paired where scenario and seed agree. A
/// results file with a column of the policy holds several of them. The folder of a finished contest prints its answer again.
///
/// Exit codes: 0 one policy is the best, 3 several cannot be distinguished from the best, 4 a policy has no valid episode.
#[derive(Debug, Args)]
pub(crate) struct Rank {
    /// First, because reading the other arguments removes them.
    #[command(flatten)]
    given: Given,
    /// Two or more policies as for --policy of `robogate run` (scripted, random, the name of one that the environment
    /// declares, the address of a server, an ONNX file), or runs, dictionaries and results files
    #[arg(required = true, value_name = "POLICY|RUN|FILE")]
    policies: Vec<String>,
    /// Set the names of the policies, in their order; default: their own names, with a number if they are not unique
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    names: Vec<String>,
    /// Choose the observation and action mapping of a policy: POLICY=PROFILE, with the policy as given; repeat it for each
    #[arg(long, value_name = "POLICY=NAME|FILE", value_parser = profile_of)]
    profile: Vec<(String, String)>,
    /// Choose what is guaranteed: best-stays (the best policy is not dropped) or no-false-elimination (no policy that is as good
    /// as the best one is dropped, which needs more episodes)
    #[arg(long, value_name = "NAME", default_value = "best-stays")]
    guarantee: Named,
    /// Choose what is compared: success, or stage, which policy gets further on the way to success more often (a task that declares
    /// stages). The rates of the answer are those of success in any case
    #[arg(long, value_name = "OUTCOME", default_value = "success")]
    by: By,
    /// Set the error probability of the guarantee, over all policies and rounds, above 0 and below 0.5
    #[arg(long, value_name = "SHARE", default_value_t = 0.05)]
    error: f64,
    /// Run this suite: a built-in one or a TOML file; default: that of the task, otherwise 64 new points of the
    /// environment's parameter space in each round
    #[arg(long, value_name = "NAME|FILE")]
    suite: Option<String>,
    /// Run 64 new points of this parameter space in each round; default: the environment's own
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "suite")]
    space: Option<String>,
    /// Set the maximum number of rounds
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    rounds: u32,
    /// Print how often such a contest finds the best policy, and run nothing
    #[arg(long)]
    plan: bool,
    /// Set the seed of the rounds
    #[arg(long, value_name = "S", default_value_t = DEFAULT_SEED)]
    seed: u64,
    /// Set the number of episodes of each control of an external policy, as for `robogate gate`; 0 skips the controls
    #[arg(long, value_name = "N", default_value_t = CONTROL_EPISODES)]
    controls: u32,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    access: AccessArguments,
    #[command(flatten)]
    latency: LatencyArguments,
    #[command(flatten)]
    how: How,
    #[command(flatten)]
    groups: Groups,
    /// Give a column of a results file a role, such as policy=model (see `robogate import`); repeat it for each
    #[arg(long, value_name = "ROLE=COLUMN")]
    map: Vec<String>,
    /// Write the comparison of the results, with maps and failure modes, to this HTML page
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write the contest to this folder, or continue the one in it; default: a new folder under runs/
    #[arg(long, value_name = "DIR", value_parser = place::local())]
    out: Option<PathBuf>,
}

/// The guarantees as words of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Named {
    BestStays,
    NoFalseElimination,
}

/// What is compared, as words of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum By {
    Success,
    Stage,
}

fn profile_of(text: &str) -> Result<(String, String), String> {
    let (policy, profile) = text.rsplit_once('=').ok_or("expected POLICY=PROFILE, for example net.onnx=droid")?;
    Ok((policy.to_owned(), profile.to_owned()))
}

impl Rank {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        // The names of built-in policies are policies also where a file has such a name.
        let is_policy = |text: &String| POLICIES.contains(&text.as_str()) || text.ends_with(".onnx");
        let is_file = |text: &String| !is_policy(text) && Path::new(text).exists();
        let files = self.policies.iter().filter(|text| is_file(text)).count();
        if files == 0 {
            return self.contest();
        }
        if let Some(policy) = self.policies.iter().find(|text| !is_file(text)) {
            return Err(anyhow!(
                "{policy} is not a run or a results file, but others of the arguments are\nHint: give policies alone, or files \
                 alone; a folder with the name of a policy is ./NAME"
            ))
            .or_usage();
        }
        self.results()
    }

    fn outcome(&self) -> RankingOutcome {
        match self.by {
            By::Success => RankingOutcome::Success,
            By::Stage => RankingOutcome::Stage,
        }
    }

    fn guarantee(&self) -> RankingGuarantee {
        match self.guarantee {
            Named::BestStays => RankingGuarantee::BestStays,
            Named::NoFalseElimination => RankingGuarantee::NoFalseElimination,
        }
    }
}
