//! Episodes that are worth replaying.

use robogate_dictionary::{Place, PolicyRecord, Provenance};
use robogate_stats::format::{fixed, percent};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::models::Scored;
use crate::table::{Ending, EpisodeTable, Sample};
use crate::task::TaskAnalysis;

/// Maximum number of episodes in a group.
const MAX_EPISODES: usize = 5;

/// Episodes that are worth replaying for one reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReplayGroup {
    /// The reason.
    pub reason: ReplayReason,
    /// The reason as a heading.
    pub title: String,
    /// The reason as a sentence.
    pub why: String,
    /// The episodes, the most informative first.
    pub episodes: Vec<ReplayEpisode>,
}

/// The reason why episodes are worth replaying.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReplayReason {
    /// They failed although the risk model predicts success.
    UnexpectedFailure,
    /// They succeeded although the risk model predicts failure.
    UnexpectedSuccess,
    /// The risk model predicts success and failure with about the same probability.
    Boundary,
    /// The plug-in of the task selected them.
    Task,
    /// They are invalid.
    Invalid,
}

/// One episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReplayEpisode {
    /// Its index in its campaign: the argument of `robogate replay DIR INDEX`.
    pub index: u64,
    /// The stage that ran it.
    pub stage: String,
    /// Its outcome.
    pub outcome: String,
    /// The figure that selected it.
    pub figure: String,
    /// Its parameters as names and values.
    pub parameters: Vec<(String, String)>,
}

/// The groups of episodes worth replaying.
pub(crate) fn replay_groups(
    table: &EpisodeTable,
    base: &Sample,
    scored: Option<&Scored>,
    task: &TaskAnalysis,
) -> Vec<ReplayGroup> {
    let mut groups = scored.map_or_else(Vec::new, |scored| by_risk(table, base, scored));
    groups.extend((task.replay)(table));
    let invalid = lowest(table.len(), |row| (table.outcome[row] == Ending::Invalid).then_some(row as f64));
    if !invalid.is_empty() {
        groups.push(ReplayGroup {
            reason: ReplayReason::Invalid,
            title: "Invalid".to_owned(),
            why: "Infrastructure faults: these episodes say nothing about the policy. The first ones are listed."
                .to_owned(),
            episodes: invalid.into_iter().map(|row| episode(table, row, String::new())).collect(),
        });
    }
    groups
}

/// Episodes with unexpected outcomes, and those nearest to the model's boundary.
fn by_risk(table: &EpisodeTable, base: &Sample, scored: &Scored) -> Vec<ReplayGroup> {
    let by = if scored.unseen { "a risk model that was not fitted to the episode" } else { "the risk model" };
    let risk = |i: usize| scored.p[i];
    let group = |reason, title: &str, why, best: Vec<usize>| ReplayGroup {
        reason,
        title: title.to_owned(),
        why,
        episodes: best
            .into_iter()
            .map(|i| episode(table, base.rows[i] as usize, format!("risk {}", percent(scored.p[i]))))
            .collect(),
    };
    let mut groups = vec![
        group(
            ReplayReason::UnexpectedFailure,
            "Failed although success was predicted",
            format!("Failed although {by} predicts success: possible model error."),
            lowest(base.len(), |i| (!base.success[i] && risk(i) < 0.5).then(|| risk(i))),
        ),
        group(
            ReplayReason::UnexpectedSuccess,
            "Succeeded although failure was predicted",
            format!("Succeeded although {by} predicts failure: possible model error."),
            lowest(base.len(), |i| (base.success[i] && risk(i) > 0.5).then(|| -risk(i))),
        ),
        group(
            ReplayReason::Boundary,
            "Nearest to the boundary",
            format!("The probability of failure by {by} is nearest to 50 %."),
            lowest(base.len(), |i| Some((risk(i) - 0.5).abs())),
        ),
    ];
    groups.retain(|group| !group.episodes.is_empty());
    groups
}

/// Indices of the smallest values. Among equal values the first ones.
pub(crate) fn lowest(n: usize, value: impl Fn(usize) -> Option<f64>) -> Vec<usize> {
    let mut best: Vec<(f64, usize)> = Vec::with_capacity(MAX_EPISODES + 1);
    for i in 0..n {
        let Some(v) = value(i) else { continue };
        if best.len() < MAX_EPISODES || best.last().is_some_and(|(worst, _)| v < *worst) {
            let at = best.partition_point(|(w, _)| *w <= v);
            best.insert(at, (v, i));
            best.truncate(MAX_EPISODES);
        }
    }
    best.into_iter().map(|(_, i)| i).collect()
}

pub(crate) fn episode(table: &EpisodeTable, row: usize, figure: String) -> ReplayEpisode {
    let outcome = table.outcome_name(table.outcome[row]);
    let time = table.time_s[row].map_or_else(String::new, |t| format!(" at {} s", fixed(t, 2)));
    ReplayEpisode {
        index: table.index[row],
        stage: table.stages.get(usize::from(table.stage[row])).map_or_else(String::new, |s| s.name.clone()),
        outcome: format!("{outcome}{time}"),
        figure,
        parameters: table.parameters.iter().map(|p| (p.name.clone(), p.show(p.values[row]))).collect(),
    }
}

/// The folder of the run in the commands of its own page, which lies in that folder.
pub const HERE: &str = ".";

/// Quotes a text as one word for a POSIX shell.
pub fn shell_word(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-./:,@%+=".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}

/// The options of a command that runs the same policy in the same environment, as far as the provenance names them, with a space
/// before them.
pub fn same_subject(provenance: &Provenance) -> String {
    let Some(world) = &provenance.world else { return String::new() };
    let mut options = String::new();
    let mut add = |name: &str, value: &str| options += &format!(" --{name} {}", shell_word(value));
    match &world.place {
        Place::Cell(cell) => {
            add("task", provenance.task.name.as_str());
            add("robot", &cell.robot);
            if cell.engine != "mujoco" && !cell.physics_servers {
                add("engine", &cell.engine);
            }
        }
        Place::SelfContained => add("task", provenance.task.name.as_str()),
        Place::Python(python) => add("env", &python.environment),
        Place::Servers { .. } => add("simulator", "ADDRESS"),
    }
    match &world.policy {
        None => {}
        Some(PolicyRecord::BuiltIn { name }) => add("policy", name),
        Some(PolicyRecord::Hosted { name, from, .. }) => add("policy", from.as_deref().unwrap_or(name)),
        Some(PolicyRecord::External(policy)) => add("policy", &policy.server),
    }
    options
}
