//! What happens in a study: the content of its journal.

use robogate_core::Word;
use serde::{Deserialize, Serialize};

use crate::{Attachment, Secret};

/// The time of an event. Durations are differences of `uptime_ms` within one boot, so that a changed clock does not reach them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Moment {
    /// Time of the clock, in milliseconds since 1970.
    pub unix_ms: u64,
    /// Time since the machine started, in milliseconds.
    pub uptime_ms: u64,
    /// Identifier of the machine's start.
    pub boot: String,
}

impl Moment {
    /// Reads the clocks of this machine.
    pub fn now() -> Self {
        let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let uptime: f64 = read("/proc/uptime").split(' ').next().and_then(|text| text.parse().ok()).unwrap_or(0.0);
        Self {
            unix_ms: since.as_millis() as u64,
            uptime_ms: (1000.0 * uptime) as u64,
            boot: read("/proc/sys/kernel/random/boot_id").trim().to_owned(),
        }
    }

    /// The seconds since `earlier`. `None` if the machine was started again in between, or does not tell.
    pub fn seconds_since(&self, earlier: &Self) -> Option<f64> {
        let same = self.boot == earlier.boot && !self.boot.is_empty();
        let passed = self.uptime_ms.checked_sub(earlier.uptime_ms).filter(|_| same)?;
        Some(passed as f64 / 1000.0)
    }
}

/// One line of the journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// Its number, from 0.
    pub n: u64,
    /// When it was written.
    pub at: Moment,
    /// Identifier that the device chose for the request. A request that is sent twice has one record.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub id: String,
    /// What happened.
    pub event: Event,
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Event {
    /// The study was opened with this plan.
    Opened {
        /// SHA-256 (hex) of the plan.
        plan_sha256: String,
    },
    /// A trial began.
    Start {
        /// Its code.
        code: String,
        /// Who runs it.
        operator: String,
    },
    /// The motion of a trial ended. Its result is still open.
    Stop {
        /// Its code.
        code: String,
        /// Its duration in seconds, if known.
        duration_s: Option<f64>,
    },
    /// The result of a trial.
    Result {
        /// Its code.
        code: String,
        /// The result.
        result: Outcome,
    },
    /// A trial was invalid. It is repeated if this was said before its end.
    Void {
        /// Its code.
        code: String,
        /// The reason.
        reason: String,
        /// Who said it.
        by: VoidBy,
    },
    /// The result of the last trial was corrected.
    Correct {
        /// Its code.
        code: String,
        /// The new result.
        result: Outcome,
        /// The reason.
        reason: String,
    },
    /// A pause began.
    Pause,
    /// A pause ended.
    Resume,
    /// What the switch measured during a trial.
    Switch {
        /// Its code.
        code: String,
        /// The measurements.
        measured: Measured,
    },
    /// A file was attached to a trial.
    Attach {
        /// The code of the trial.
        code: String,
        /// The file.
        file: Attachment,
    },
    /// A script was told the policy of a trial.
    Told {
        /// The code of the trial.
        code: String,
    },
    /// The study was unblinded.
    Unblind {
        /// The secret of order and journal.
        secret: Secret,
        /// Whether this was before the end that the plan states.
        early: bool,
    },
}

/// The result of a trial, as the operator states it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outcome {
    /// Whether it succeeded.
    pub success: bool,
    /// The failure mode of a failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<Word>,
    /// The last stage that a failure reached.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<Word>,
    /// A measured number, such as a force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<f64>,
    /// Notes.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub notes: String,
}

/// Who declared a trial invalid, and when.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VoidBy {
    /// The operator before Stop: the trial is repeated.
    OperatorBefore,
    /// The operator after Stop: the trial counts as a failure.
    OperatorAfter,
    /// The switch or the server of the policy: the trial is repeated.
    Infrastructure,
}

/// What the switch measured during a trial.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// Number of connections.
    pub connections: u64,
    /// Number of replies.
    pub replies: u64,
    /// Median time to the first byte of a reply at the server, in milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reply_ms: Option<f64>,
    /// Time that was added to each reply so that all paths are equally long, in milliseconds.
    pub added_ms: f64,
    /// Time from Stop to the end of the last connection, in milliseconds.
    pub cut_ms: f64,
}
