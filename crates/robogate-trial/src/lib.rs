//! Acceptance trials of a real robot: from a question to an answer with the fewest trials.
//!
//! A [`Plan`] is public and fixed before the first trial. A [`Secret`] gives the order of the policies, the set-ups and a new code for
//! each trial; nobody sees it until the study is unblinded. A [`Study`] is the state that follows from plan, secret and
//! journal; each change is an [`Event`] that is on disk before it is acknowledged. [`Judge`] decides after each block.
//! [`serve`] is the page for the operator's phone, and [`Switch`] connects the robot to the policy of the trial.

mod answer;
mod attachment;
mod decide;
mod event;
mod expected;
mod folder;
mod journal;
mod order;
mod plan;
mod qr;
mod report;
mod secret;
mod service;
mod study;
mod switch;
mod table;

use std::path::PathBuf;

pub use answer::{Answer, answer};
pub use attachment::{ATTACHMENTS, Attachment, check_attachments};
pub use decide::{BlockResults, Decision, Judge, Verdict};
pub use event::{Event, Measured, Moment, Outcome, Record, VoidBy};
pub use expected::{expected, rules};
pub use folder::{Folder, PLAN, SECRET};
pub use journal::{HEAD, JOURNAL, Journal};
pub use order::{Codes, Planned, order};
pub use plan::{Arm, Expected, FORMAT, MOST_ARMS, MOST_BLOCKS, Plan, Population, Question, Time};
pub use qr::{qr, qr_text};
pub use report::report;
pub use secret::{Secret, random_token, write_private};
pub use service::{Service, serve};
pub use study::{Attempt, Command, Phase, Study};
pub use switch::{Fault, Switch, SwitchSettings};
pub use table::{csv_of, mapping, provenance};

/// The result of a trial that succeeded, on pages and in files.
pub const SUCCESS: &str = "success";

/// Properties of a set-up and their values, in order.
pub type Setup = Vec<(String, String)>;

/// The reason why a step of a study is not possible.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// A file cannot be used.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A record was changed, removed or moved.
    #[error(
        "{}:{line}: {reason}\nHint: the record of this study is not intact, and no result can be taken from it. Compare it with a copy",
        path.display()
    )]
    Changed {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// What is wrong.
        reason: String,
    },
    /// An attachment is missing or was changed.
    #[error(
        "{}: {reason}\nHint: restore the file that was attached; the results of the study do not depend on it",
        path.display()
    )]
    Attachment {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The plan, or what was asked for it, is wrong.
    #[error("plan: {0}")]
    Plan(String),
    /// Another process writes the journal.
    #[error("{}: another process runs this study\nHint: use its page or its HTTP interface, or end it first", .0.display())]
    InUse(PathBuf),
    /// A request does not fit the state of the study, or contradicts itself.
    #[error("{0}")]
    Refused(String),
    /// Another request came first.
    #[error("{0}")]
    Conflict(String),
    /// The operating system has no random numbers.
    #[error("the operating system returned no random numbers: {0}")]
    Random(String),
    /// An address cannot be used.
    #[error("cannot listen on {address}: {reason}")]
    Listen {
        /// The address.
        address: String,
        /// The cause.
        reason: String,
    },
}
