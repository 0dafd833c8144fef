//! Episodes worth seeing again.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::models::Scored;
use crate::rows::{Rows, Sample, Seen};
use crate::task::TaskAnalysis;
use robogate_stats::format::{fixed, percent};

/// Episodes in one group.
const MOST: usize = 5;

/// Episodes that are worth seeing again for one reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReplayGroup {
    /// The reason.
    pub reason: ReplayReason,
    /// The reason, as a heading.
    pub title: String,
    /// What is behind it.
    pub why: String,
    /// The episodes, the most telling first.
    pub episodes: Vec<WorthReplaying>,
}

/// Why episodes are worth replaying.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReplayReason {
    /// They failed although the risk model predicts success.
    UnexpectedFailure,
    /// They succeeded although the risk model predicts failure.
    UnexpectedSuccess,
    /// The risk model predicts success and failure alike.
    Boundary,
    /// The task finds them worth replaying.
    Task,
    /// They are invalid.
    Invalid,
}

/// One episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WorthReplaying {
    /// Its index in its campaign: what `robogate replay DIR INDEX` takes.
    pub index: u64,
    /// The stage that ran it.
    pub stage: String,
    /// Its outcome.
    pub outcome: String,
    /// The figure that brought it here.
    pub figure: String,
    /// Its parameters, name and value.
    pub parameters: Vec<(String, String)>,
}

pub(crate) fn worth_replaying(
    rows: &Rows,
    base: &Sample,
    scored: Option<&Scored>,
    task: &TaskAnalysis,
) -> Vec<ReplayGroup> {
    let mut groups = Vec::new();
    if let Some(scored) = scored {
        let by = if scored.unseen { "a risk model that had not seen the episode" } else { "the risk model" };
        let risk = |i: usize| scored.p[i];
        let said = |i: usize| format!("risk {}", percent(scored.p[i]));
        let row = |i: usize| base.rows[i] as usize;
        let mut push = |reason: ReplayReason, title: &str, why: String, best: Vec<usize>| {
            if !best.is_empty() {
                let episodes = best.into_iter().map(|i| episode(rows, row(i), said(i))).collect();
                groups.push(ReplayGroup { reason, title: title.to_owned(), why, episodes });
            }
        };
        push(
            ReplayReason::UnexpectedFailure,
            "Failed where success was expected",
            format!("Lowest chance of failure by {by}, and it failed all the same: what does the model not see?"),
            lowest(base.len(), |i| (!base.success[i]).then(|| risk(i))),
        );
        push(
            ReplayReason::UnexpectedSuccess,
            "Succeeded where failure was expected",
            format!("Highest chance of failure by {by}, and it succeeded: luck, or room that the model does not see?"),
            lowest(base.len(), |i| base.success[i].then(|| -risk(i))),
        );
        push(
            ReplayReason::Boundary,
            "Nearest to the boundary",
            format!("A chance of failure nearest to one half by {by}."),
            lowest(base.len(), |i| Some((risk(i) - 0.5).abs())),
        );
    }
    groups.extend((task.replay)(rows));
    let invalid = lowest(rows.len(), |row| (rows.outcome[row] == Seen::Invalid).then_some(row as f64));
    if !invalid.is_empty() {
        groups.push(ReplayGroup {
            reason: ReplayReason::Invalid,
            title: "Invalid".to_owned(),
            why: "No evidence about the policy: something under it broke. The first of them.".to_owned(),
            episodes: invalid.into_iter().map(|row| episode(rows, row, String::new())).collect(),
        });
    }
    groups
}

/// Positions of the smallest values, the first of equals first.
pub(crate) fn lowest(n: usize, value: impl Fn(usize) -> Option<f64>) -> Vec<usize> {
    let mut best: Vec<(f64, usize)> = Vec::with_capacity(MOST + 1);
    for i in 0..n {
        let Some(v) = value(i) else { continue };
        if best.len() < MOST || best.last().is_some_and(|(worst, _)| v < *worst) {
            let at = best.partition_point(|(w, _)| *w <= v);
            best.insert(at, (v, i));
            best.truncate(MOST);
        }
    }
    best.into_iter().map(|(_, i)| i).collect()
}

pub(crate) fn episode(rows: &Rows, row: usize, figure: String) -> WorthReplaying {
    let outcome = rows.outcome_name(rows.outcome[row]);
    let when = rows.time_s[row].map_or_else(String::new, |t| format!(" at {} s", fixed(t, 2)));
    WorthReplaying {
        index: rows.index[row],
        stage: rows.stages.get(usize::from(rows.stage[row])).map_or_else(String::new, |s| s.name.clone()),
        outcome: format!("{outcome}{when}"),
        figure,
        parameters: rows.parameters.iter().map(|p| (p.name.clone(), p.show(p.values[row]))).collect(),
    }
}

/// A text as a POSIX shell reads it as one word.
pub fn shell_word(text: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || matches!(c, '/' | '\\' | ':' | '.' | '_' | '-');
    if !text.is_empty() && text.chars().all(plain) {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}
