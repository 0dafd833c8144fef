//! Gate evaluations for readers and for CI.

mod changes;
mod fleet;
mod junit;
mod leaderboard;
mod markdown;
mod page;
mod twins;
mod verdict;

use robogate_gate::{
    Evaluation, Metric, Mode, NextBudget, RequirementResult, Sampling, StageComparison, Status, UNLIMITED, Verdict,
};

pub use changes::{Again, Change, required_success, what_to_change};
pub use fleet::{fleet_drivers, fleet_headline, fleet_html, fleet_markdown, fleet_share};
pub use junit::junit;
pub use leaderboard::{
    leaderboard_html, leaderboard_markdown, leaderboard_text, leaderboards_html, leaderboards_markdown,
};
pub use markdown::{evaluation_markdown, evaluation_markdown_with};
pub use page::{evidence_html, verdict_html};
pub use twins::TwinRow;
pub(crate) use verdict::VerdictBlock;

use robogate_stats::format::{self, count, counted, fixed, number, percent, percent_range};

/// One requirement as a row of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequirementRow {
    /// The status.
    pub status: Status,
    /// The requirement.
    pub requirement: String,
    /// The observed figure.
    pub observed: String,
    /// The bounds of the figure, each one-sided at the confidence of the requirements. Empty in point mode.
    pub interval: String,
    /// How many episodes would decide it, or why there is no evidence. Empty if it is decided.
    pub note: String,
}

/// The comparison by stages, as the end of a sentence.
fn stage_about(stage: &StageComparison) -> String {
    let [low, high] = stage.interval_95;
    let than = match (stage.p_better <= 0.025, stage.p_worse <= 0.025) {
        (true, false) => ": this policy gets further",
        (false, true) => ": this policy gets less far",
        _ => "",
    };
    format!(
        "; by stages {} of the way ({} to {}, 95 % at any time){than}",
        points(stage.difference),
        points(low),
        points(high)
    )
}

impl RequirementRow {
    /// The rows of all requirements of an evaluation, with the comparison last.
    pub fn all(evaluation: &Evaluation) -> Vec<Self> {
        let mut rows: Vec<Self> = evaluation.results.iter().map(Self::of).collect();
        if let Some(c) = &evaluation.comparison {
            let interval = if c.difference.is_some() {
                format!("{} to {}", points(c.interval_95[0]), points(c.interval_95[1]))
            } else {
                String::new()
            };
            rows.push(Self {
                status: c.status,
                requirement: format!(
                    "not worse than {} by more than {}",
                    c.policy,
                    points(c.margin).trim_start_matches('+')
                ),
                observed: c.difference.map_or_else(|| "-".to_owned(), points),
                interval,
                note: format!(
                    "{} pairs: both {}, only {} {}, only this {}, neither {}{}",
                    count(c.both + c.only_other + c.only_this + c.neither),
                    count(c.both),
                    c.policy,
                    count(c.only_other),
                    count(c.only_this),
                    count(c.neither),
                    c.stage.as_ref().map(stage_about).unwrap_or_default()
                ),
            });
        }
        rows
    }

    fn of(result: &RequirementResult) -> Self {
        let metric = result.requirement.metric;
        let text = |x: f64| value(metric, &result.unit, x);
        let scope = match (&result.requirement.category, &result.requirement.group) {
            (Some(category), Some(group)) => format!(" in {category}/{group}"),
            (Some(scope), None) | (None, Some(scope)) => format!(" in {scope}"),
            (None, None) => String::new(),
        };
        let requirement = format!("{}{scope} {} {}", metric.title(), result.bound.sense, text(result.bound.limit));
        let observed = result.over_groups.or(result.figure.observed).map_or_else(|| "-".to_owned(), text);
        let interval = match result.interval {
            Some([low, high]) => {
                let low = text(low);
                let unit = if result.unit.is_empty() { "%" } else { &result.unit };
                format!("{} to {}", low.trim_end_matches(unit).trim_end(), text(high))
            }
            None => String::new(),
        };
        let mut notes = Vec::new();
        if let (Some(_), Some(all)) = (result.over_groups, result.figure.observed) {
            notes.push(format!("each group counts once; over all episodes the figure is {}", text(all)));
        }
        match result.status {
            Status::NoEvidence => notes.push("no episode gives evidence".to_owned()),
            Status::Undecided => notes.extend(result.next.as_ref().map(chance)),
            Status::Met | Status::Violated => {}
        }
        if result.invalid > 0 && result.status != Status::NoEvidence {
            let most = result.figure.most.map_or_else(|| "any".to_owned(), text);
            notes.push(format!(
                "{} of {} episodes are invalid or have no value: the figure could be {} to {most}",
                count(result.invalid),
                count(result.valid + result.invalid),
                result.figure.least.map_or_else(|| "any".to_owned(), text)
            ));
        }
        Self { status: result.status, requirement, observed, interval, note: notes.join("; ") }
    }
}

/// The probability that another gate of the same size decides.
fn chance(next: &NextBudget) -> String {
    let [least, most] = next.over_interval;
    format!(
        "a new gate of {} episodes decides with a probability of {} if the observed rate is the true one ({} over its interval)",
        count(next.episodes),
        percent(next.at_observed),
        percent_range([least, most])
    )
}

/// What invalid episodes mean for a verdict, as the end of a sentence.
pub fn of_invalid(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass | Verdict::Fail => "the verdict holds for every outcome that they could have had",
        Verdict::Inconclusive | Verdict::Invalid => "a pass must hold if they all failed, a fail if they all succeeded",
    }
}

/// What an inconclusive gate needs: more episodes, or a repair of what makes episodes invalid. Empty if it is conclusive.
pub fn what_next(evaluation: &Evaluation) -> String {
    if let Some(ruled_out) = &evaluation.ruled_out {
        let Some(of) = &ruled_out.fault else {
            return "Run more trials of the real robot: `robogate transfer` proposes settings. Then start a new gate with its \
                    new file."
                .to_owned();
        };
        let cause = of.fault.lines().next().unwrap_or_default().trim_end_matches('.');
        return format!(
            "Most frequent cause, in {} episodes, the first of which is number {}: {cause}. Fix the cause, and start a new gate.",
            count(of.with_fault),
            of.first
        );
    }
    if evaluation.verdict != Verdict::Inconclusive {
        return String::new();
    }
    let undecided = evaluation.results.iter().filter_map(|result| Some((result, result.next?)));
    let hardest = undecided.min_by(|a, b| a.1.at_observed.total_cmp(&b.1.at_observed));
    if let Some(of) = evaluation.population.groups().first() {
        return format!(
            "More episodes need more values of {}: each counts as one observation, and fewer than 8 decide nothing.",
            of.by
        );
    }
    let faults = match evaluation.counts.invalid {
        0 => String::new(),
        n => format!(" Fix what makes episodes invalid first ({} of {}).", count(n), count(evaluation.counts.episodes)),
    };
    hardest.map_or_else(String::new, |(result, next)| {
        format!("`{}`: {}. The episodes of this run may not be counted again.{faults}", result.id, chance(&next))
    })
}

/// The success rate over the feasible part of the episodes, as a sentence. `None` if every scenario is feasible, or if this
/// is unknown.
pub fn feasible_part(evaluation: &Evaluation) -> Option<String> {
    let part = evaluation.feasible.filter(|part| part.valid < evaluation.counts.valid)?;
    Some(match part.rate() {
        Some(rate) => format!(
            "No policy can complete {} of the episodes. Over the feasible part, {} of {} succeeded ({}, 95 % interval {}).",
            percent(1.0 - part.share),
            count(part.successes),
            count(part.valid),
            percent(rate),
            percent_range(part.interval_95)
        ),
        None => "No policy can complete any of these episodes.".to_owned(),
    })
}

/// The success rate over new cases, as a sentence. `None` unless imported episodes repeat cases.
pub fn new_cases(evaluation: &Evaluation) -> Option<String> {
    let new = evaluation.new_cases?;
    Some(format!(
        "If these {} are a random sample of all cases, the success rate over new cases is {} (95 % interval, each case counts once).",
        counted(new.cases, "case"),
        percent_range(new.interval_95)
    ))
}

/// How the figures are compared with the limits, and which requirements were left out, in sentences.
pub fn how_judged(evaluation: &Evaluation) -> String {
    let dropped =
        evaluation.dropped.iter().map(|d| format!(" Not judged as written: `{}`, because {}.", d.id, d.because));
    test_used(evaluation) + &levels(evaluation) + &dropped.collect::<String>()
}

/// What the printed bounds mean.
fn levels(evaluation: &Evaluation) -> String {
    if evaluation.requirements.mode == Mode::Point {
        return String::new();
    }
    let confidence = evaluation.requirements.confidence;
    let groups = match evaluation.sampling {
        Sampling::Fixed => "exact",
        Sampling::Sequential if evaluation.planned_rounds.is_some() => "those of the same test",
        Sampling::Sequential => "valid at any number of episodes",
    };
    format!(
        " Each of the two bounds of a requirement holds at {}, so both together are a {} interval. The 95 % intervals of groups are {groups}.",
        percent(confidence),
        percent(2.0 * confidence - 1.0)
    )
}

fn test_used(evaluation: &Evaluation) -> String {
    let confidence = evaluation.requirements.confidence;
    let (percent, error) = (percent(confidence), percent(1.0 - confidence));
    match (evaluation.requirements.mode, evaluation.sampling) {
        (Mode::Confidence, _) if !evaluation.population.groups().is_empty() => format!(
            "Each requirement is tested at {percent} confidence for the mean over new groups, each of which counts once, by betting on the means of these groups. It assumes that they are a random sample. A pass states that all requirements hold, a fail that at least one does not; each is wrong with a probability of at most {error}."
        ),
        (Mode::Point, _) => "Point comparison: each observed figure is compared with its limit, without an error probability (as in the paper).".to_owned(),
        (Mode::Confidence, Sampling::Fixed) => format!(
            "Each requirement is tested at {percent} confidence by an exact test, with a number of episodes that was fixed in advance. A pass states that all requirements hold, a fail that at least one does not; each is wrong with a probability of at most {error}."
        ),
        (Mode::Confidence, Sampling::Sequential) if evaluation.counts.rounds.is_none() => format!(
            "Each requirement is tested at {percent} confidence by a test that is valid however the number of episodes was chosen. If it was fixed in advance, import with `--stopping fixed`: the exact test needs fewer episodes. A pass states that all requirements hold, a fail that at least one does not; each is wrong with a probability of at most {error}."
        ),
        (Mode::Confidence, Sampling::Sequential) if evaluation.planned_rounds.is_none() => format!(
            "Each requirement is tested at {percent} confidence after each round, by a test that is valid for any number of rounds. A pass states that all requirements hold, a fail that at least one does not; each is wrong with a probability of at most {error}."
        ),
        (Mode::Confidence, Sampling::Sequential) => format!(
            "Each requirement is tested at {percent} confidence after each round, by a test for the number of rounds that was planned before the first (it assumes independent scenarios and fresh randomness in each round). A pass states that all requirements hold, a fail that at least one does not; each is wrong with a probability of at most {error}."
        ),
    }
}

/// Formats a figure of a metric with its unit.
pub(crate) fn value(metric: Metric, unit: &str, x: f64) -> String {
    match metric {
        Metric::Production(_) | Metric::TimeToSuccess(_) if x >= UNLIMITED => "no limit".to_owned(),
        Metric::CycleTime(_) | Metric::TimeToSuccess(_) => format!("{} s", fixed(x, 2)),
        Metric::Production(_) => format!("{} {unit}", number(x)).trim_end().to_owned(),
        Metric::Measure(..) => format!("{} {unit}", number(x)).trim_end().to_owned(),
        Metric::FailureCount(_) => fixed(x, 0),
        // With one decimal, a limit of 0.25 % would become 0.2 %.
        _ if (x > 0.0 && x < 0.01) || (x > 0.99 && x < 1.0) => format!("{} %", fixed(100.0 * x, 2)),
        _ => percent(x),
    }
}

/// Formats a difference of shares in percentage points.
fn points(difference: f64) -> String {
    format!("{} points", format::points(difference))
}

/// The symbol of a status.
pub fn sign(status: Status) -> &'static str {
    match status {
        Status::Met => "\u{2713}",
        Status::Violated => "\u{2717}",
        Status::Undecided => "?",
        Status::NoEvidence => "-",
    }
}
