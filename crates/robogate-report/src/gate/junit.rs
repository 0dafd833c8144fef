//! Gate evaluations as JUnit XML, which CI systems display.
//!
//! One test suite has a case for each requirement, another one for each scenario group. A violated requirement is a
//! failure. An undecided requirement, or one without evidence, is an error. Groups never fail, because a requirement
//! can be set for a group. The file has no failure and no error exactly if the gate passes.
//!
//! Every element has an end tag, so the HTML template writes well-formed XML.

use maud::{Markup, PreEscaped, html};
use robogate_gate::{Evaluation, GroupResult, Status, Verdict};
use robogate_stats::format::{count, percent, percent_range};

use super::RequirementRow;
use crate::html::prose;

/// The XML declaration.
const DECLARATION: PreEscaped<&str> = PreEscaped("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");

/// The failure or error of a test case.
struct Problem {
    /// Whether it is a failure, otherwise an error.
    failure: bool,
    kind: &'static str,
    message: String,
    details: String,
}

/// The evaluation as JUnit XML.
pub fn junit(evaluation: &Evaluation) -> String {
    let rows = RequirementRow::all(evaluation);
    let ids: Vec<String> = evaluation
        .results
        .iter()
        .map(|f| format!("{} {} {}", f.id, f.bound.sense, f.bound.limit))
        .chain(evaluation.comparison.iter().map(|_| "non-inferiority".to_owned()))
        .collect();
    let failures = rows.iter().filter(|row| row.status == Status::Violated).count();
    let mut errors = rows.iter().filter(|row| matches!(row.status, Status::Undecided | Status::NoEvidence)).count();
    // Without episodes there may be no requirement that can report the verdict.
    let no_evidence = (evaluation.verdict == Verdict::Invalid).then(|| Problem {
        failure: false,
        kind: "invalid",
        message: evaluation.because.clone(),
        details: String::new(),
    });
    errors += usize::from(no_evidence.is_some());
    let requirements = rows.len() + usize::from(no_evidence.is_some());
    let tests = requirements + evaluation.groups.len();
    let page = html! {
        (DECLARATION)
        testsuites name="robogate" tests=(tests) failures=(failures) errors=(errors) skipped="0" {
            "\n"
            testsuite name={ "gate " (prose(&evaluation.requirements.name)) } tests=(requirements) failures=(failures)
                errors=(errors) skipped="0"
            {
                "\n"
                (properties(evaluation))
                @if no_evidence.is_some() { (case("robogate.gate", "evidence", &[], no_evidence.as_ref())) }
                @for (at, (id, row)) in ids.iter().zip(&rows).enumerate() {
                    (case("robogate.requirement", id, requirement_ids(evaluation, at), problem(row).as_ref()))
                }
            }
            "\n"
            @if !evaluation.groups.is_empty() {
                testsuite name="groups" tests=(evaluation.groups.len()) failures="0" errors="0" skipped="0" {
                    "\n"
                    @for group in &evaluation.groups { (self::group(group)) }
                }
                "\n"
            }
        }
        "\n"
    };
    page.into_string()
}

fn problem(row: &RequirementRow) -> Option<Problem> {
    let (failure, kind) = match row.status {
        Status::Met => return None,
        Status::Violated => (true, "violated"),
        Status::Undecided => (false, "inconclusive"),
        Status::NoEvidence => (false, "no evidence"),
    };
    let details = [row.interval.as_str(), row.note.as_str()].join("\n").trim().to_owned();
    Some(Problem { failure, kind, message: format!("{}: observed {}", row.requirement, row.observed), details })
}

fn properties(evaluation: &Evaluation) -> Markup {
    let counts = evaluation.counts;
    let all = [
        ("verdict", evaluation.verdict.as_str().to_owned()),
        ("because", evaluation.because.clone()),
        ("policy", evaluation.policy.clone()),
        ("robot", evaluation.robot.clone()),
        ("population", evaluation.population.to_string()),
        ("dataset_sha256", evaluation.dataset_sha256.clone()),
        ("episodes", counts.episodes.to_string()),
        ("invalid_episodes", counts.invalid.to_string()),
    ];
    html! {
        properties { "\n" @for (name, value) in &all { property name=(name) value=(prose(value)) {} "\n" } }
        "\n"
    }
}

/// The identifiers of the user's requirements that a result verifies. A comparison has none.
fn requirement_ids(evaluation: &Evaluation, at: usize) -> &[String] {
    evaluation.results.get(at).map_or(&[], |result| result.requirement.ids.as_slice())
}

fn case(class: &str, name: &str, ids: &[String], problem: Option<&Problem>) -> Markup {
    html! {
        testcase classname=(class) name=(prose(name)) time="0" {
            @if !ids.is_empty() {
                properties { @for id in ids { property name="requirement" value=(prose(id)) {} } }
            }
            @if let Some(Problem { failure, kind, message, details }) = problem {
                @if *failure {
                    failure type=(kind) message=(prose(message)) { (prose(details)) }
                } @else {
                    error type=(kind) message=(prose(message)) { (prose(details)) }
                }
            }
        }
        "\n"
    }
}

fn group(group: &GroupResult) -> Markup {
    let rate = if group.valid > 0 { percent(group.successes as f64 / group.valid as f64) } else { "-".to_owned() };
    let endings: Vec<String> = group.endings.iter().map(|e| format!("{} {}", e.ending, e.episodes)).collect();
    let text = format!(
        "{} of {} valid episodes succeeded: {rate}, 95 % interval {}; {}",
        count(group.successes),
        count(group.valid),
        percent_range(group.interval_95),
        if endings.is_empty() { "no failure".to_owned() } else { endings.join(", ") }
    );
    html! {
        testcase classname={ "robogate.group." (prose(&group.category)) } name=(prose(&group.group)) time="0" {
            system-out { (prose(&text)) }
        }
        "\n"
    }
}
