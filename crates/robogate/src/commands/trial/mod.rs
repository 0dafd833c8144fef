//! `robogate trial`: acceptance trials of the real robot, from a question to an answer.

mod plan;
mod record;
mod report;
mod serve;
mod status;

use std::path::PathBuf;

use clap::{Args, Subcommand};
use robogate_trial::Problem;

use crate::exit::{Exit, INFRASTRUCTURE, INVALID, USAGE};

/// Plan, run and judge trials of the real robot: randomised, blinded, with as few trials as possible.
#[derive(Debug, Args)]
pub(crate) struct Trial {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Plan a study: question, policies, set-ups, largest number of trials
    Plan(plan::PlanOf),
    /// Serve the page for the operator's phone, and connect the robot to the policy of each trial
    Serve(serve::Serve),
    /// Print the next trial: code and set-up
    Next(record::Next),
    /// Record an event of a trial: start, stop, result, invalid, pause, resume
    Record(record::RecordOf),
    /// Attach a file or folder to a trial: a recording, a log, a data set
    Attach(record::Attach),
    /// Check the records of a study and show its progress. Changed records end with exit code 4
    Status(status::Status),
    /// Write the answer of a study: page, CSV of the trials, provenance. Exit codes are those of the gate
    Report(report::Report),
    /// Publish the order of a study. Before its end, this withdraws its claim
    Unblind(report::Unblind),
}

impl Trial {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.verb {
            Verb::Plan(plan) => plan.execute(),
            Verb::Serve(serve) => serve.execute(),
            Verb::Next(next) => next.execute(),
            Verb::Record(record) => record.execute(),
            Verb::Attach(attach) => attach.execute(),
            Verb::Status(status) => status.execute(),
            Verb::Report(report) => report.execute(),
            Verb::Unblind(unblind) => unblind.execute(),
        }
    }
}

/// The folder of a study.
#[derive(Debug, Args)]
struct StudyArgument {
    /// Folder of the study
    #[arg(value_name = "DIR")]
    study: PathBuf,
}

/// The exit code of a problem: changed records are invalid evidence.
fn exit(problem: Problem) -> Exit {
    let code = match problem {
        Problem::Changed { .. } | Problem::Attachment { .. } => INVALID,
        Problem::Random(_) | Problem::Listen { .. } => INFRASTRUCTURE,
        Problem::File { .. } | Problem::Plan(_) | Problem::InUse(_) | Problem::Refused(_) | Problem::Conflict(_) => {
            USAGE
        }
    };
    Exit { code, error: problem.into() }
}
