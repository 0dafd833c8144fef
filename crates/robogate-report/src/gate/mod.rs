//! The gate's answer for people and for CI.

mod junit;
mod leaderboard;
mod markdown;

use robogate_gate::{Evaluation, Metric, Mode, RequirementResult, Sampling, Status};

pub use junit::junit;
pub use leaderboard::{leaderboard_html, leaderboard_markdown};
pub use markdown::evaluation_markdown;

use robogate_stats::format::{count, fixed, number, percent};

/// One requirement in words: what a table of any kind shows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequirementRow {
    /// What follows.
    pub status: Status,
    /// The requirement.
    pub requirement: String,
    /// What was observed.
    pub observed: String,
    /// What is known of the true figure; empty in point mode.
    pub interval: String,
    /// What would decide it, or why there is nothing to say; empty where it is decided.
    pub note: String,
}

impl RequirementRow {
    /// Every requirement of an evaluation, the comparison last.
    pub fn all(evaluation: &Evaluation) -> Vec<Self> {
        let mut rows: Vec<Self> = evaluation.results.iter().map(|f| Self::of(f, evaluation)).collect();
        if let Some(c) = &evaluation.comparison {
            let known = if c.difference.is_some() {
                format!("{} to {}", points(c.interval_95[0]), points(c.interval_95[1]))
            } else {
                String::new()
            };
            rows.push(Self {
                status: c.status,
                requirement: format!("not worse than {} by {}", c.policy, points(c.margin).trim_start_matches('+')),
                observed: c.difference.map_or_else(|| "-".to_owned(), points),
                interval: known,
                note: format!(
                    "{} pairs: both {}, only {} {}, only this {}, neither {}",
                    count(c.both + c.only_other + c.only_this + c.neither),
                    count(c.both),
                    c.policy,
                    count(c.only_other),
                    count(c.only_this),
                    count(c.neither)
                ),
            });
        }
        rows
    }

    fn of(result: &RequirementResult, evaluation: &Evaluation) -> Self {
        let metric = result.requirement.metric;
        let text = |x: f64| value(metric, &result.unit, x);
        let scope = match (&result.requirement.category, &result.requirement.group) {
            (Some(category), Some(group)) => format!(" in {category}/{group}"),
            (Some(scope), None) | (None, Some(scope)) => format!(" in {scope}"),
            (None, None) => String::new(),
        };
        let requirement = format!("{}{scope} {} {}", metric.title(), result.bound.sense, text(result.bound.limit));
        let observed = result.figure.observed.map_or_else(|| "-".to_owned(), text);
        let interval = match result.interval {
            Some([low, high]) => {
                let low = text(low);
                let unit = if result.unit.is_empty() { "%" } else { &result.unit };
                format!("{} to {}", low.trim_end_matches(unit).trim_end(), text(high))
            }
            None => String::new(),
        };
        let mut notes = Vec::new();
        match (result.status, result.decided_at_episodes) {
            (Status::NoEvidence, _) => notes.push("no episode is evidence for or against it".to_owned()),
            (Status::Undecided, Some(at)) => notes.push(how_many(at, evaluation)),
            (Status::Undecided, None) if evaluation.requirements.mode == Mode::Confidence => {
                notes.push("too near the limit to decide with any practical number of episodes".to_owned());
            }
            _ => {}
        }
        if result.invalid > 0 && result.status != Status::NoEvidence {
            let most = result.figure.most.map_or_else(|| "any".to_owned(), text);
            let say = if result.invalid == 1 { "says" } else { "say" };
            notes.push(format!(
                "{} of {} {say} nothing: could be {} to {most}",
                count(result.invalid),
                count(result.valid + result.invalid),
                result.figure.least.map_or_else(|| "any".to_owned(), text)
            ));
        }
        Self { status: result.status, requirement, observed, interval, note: notes.join("; ") }
    }
}

/// What a number of episodes in all means, as things stand.
fn how_many(at: u64, evaluation: &Evaluation) -> String {
    match evaluation.sampling {
        Sampling::Sequential => {
            format!("about {} more episodes at this rate", count(at.saturating_sub(evaluation.counts.episodes).max(1)))
        }
        Sampling::Fixed => format!("a run of about {} episodes would decide at this rate", count(at)),
    }
}

/// What an inconclusive gate needs, in a sentence; empty where it has answered.
pub fn what_next(evaluation: &Evaluation) -> String {
    evaluation.decided_at_episodes.map_or_else(String::new, |at| match evaluation.sampling {
        Sampling::Sequential => {
            let more = at.saturating_sub(evaluation.counts.episodes).max(1);
            format!("If all goes on as so far, about {} more episodes decide.", count(more))
        }
        Sampling::Fixed => {
            format!(
                "If all goes as here, a new run of about {} episodes decides; these may not be counted again.",
                count(at)
            )
        }
    })
}

/// How the figures are held against the limits, in a sentence.
pub fn how_judged(evaluation: &Evaluation) -> String {
    let percent = percent(evaluation.requirements.confidence);
    match (evaluation.requirements.mode, evaluation.sampling) {
        (Mode::Point, _) => "Point comparisons: each observed figure is taken for the true one, without a stated error (the paper's gate).".to_owned(),
        (Mode::Confidence, Sampling::Fixed) => format!(
            "Each demand at {percent} confidence by an exact test of a number of episodes that was fixed beforehand; a pass claims all of them together, and a fail any of them, each wrong with at most the rest of that probability."
        ),
        (Mode::Confidence, Sampling::Sequential) => format!(
            "Each demand at {percent} confidence by a test that holds however often one looks, after each round; a pass claims all of them together, and a fail any of them, each wrong with at most the rest of that probability."
        ),
    }
}

/// A figure of a metric with its unit.
pub(crate) fn value(metric: Metric, unit: &str, x: f64) -> String {
    match metric {
        Metric::CycleTime(_) => format!("{} s", fixed(x, 2)),
        Metric::Measure(..) => format!("{} {unit}", number(x)).trim_end().to_owned(),
        Metric::FailureCount(_) => fixed(x, 0),
        // A limit of 0.25 % must not be told as 0.2 %.
        _ if (x > 0.0 && x < 0.01) || (x > 0.99 && x < 1.0) => format!("{} %", fixed(100.0 * x, 2)),
        _ => percent(x),
    }
}

/// A difference of shares in percentage points.
fn points(difference: f64) -> String {
    format!("{}{} points", if difference > 0.0 { "+" } else { "" }, fixed(100.0 * difference, 1))
}

/// One sign for each status; the word stands beside it wherever there is room.
pub fn sign(status: Status) -> &'static str {
    match status {
        Status::Met => "\u{2713}",
        Status::Violated => "\u{2717}",
        Status::Undecided => "?",
        Status::NoEvidence => "-",
    }
}
