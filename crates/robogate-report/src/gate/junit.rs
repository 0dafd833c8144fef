//! The gate's answer as JUnit XML, which every CI shows.
//!
//! One test suite has a case for each demand, another one for each scenario group. A violated demand is a failure; an
//! undecided one, or one without evidence, is an error: the gate could not answer. A group by itself fails nothing: what
//! is demanded of a group is a demand. So the file has neither failure nor error exactly where the gate passes.

use std::fmt::Write;

use robogate_gate::{Evaluation, GroupResult, Status, Verdict};

use super::DemandRow;
use crate::page::escape;
use robogate_stats::format::{count, percent, percent_range};

/// The evaluation as JUnit XML.
pub fn junit(evaluation: &Evaluation) -> String {
    let rows = DemandRow::all(evaluation);
    let ids: Vec<String> = evaluation
        .findings
        .iter()
        .map(|f| format!("{} {} {}", f.id, f.bound.sense, f.bound.limit))
        .chain(evaluation.comparison.iter().map(|_| "non-inferiority".to_owned()))
        .collect();
    let failures = rows.iter().filter(|row| row.status == Status::Violated).count();
    let mut errors = rows.iter().filter(|row| matches!(row.status, Status::Undecided | Status::NoEvidence)).count();
    // Without one episode there may be no demand to hang the answer on.
    let nothing = evaluation.verdict == Verdict::Invalid;
    errors += usize::from(nothing);
    let demands = rows.len() + usize::from(nothing);
    let tests = demands + evaluation.groups.len();
    let mut out = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    // Writing to a string cannot fail; so throughout this file.
    let _ = writeln!(
        out,
        "<testsuites name=\"robogate\" tests=\"{tests}\" failures=\"{failures}\" errors=\"{errors}\" skipped=\"0\">"
    );
    let _ = writeln!(
        out,
        "  <testsuite name=\"gate {}\" tests=\"{demands}\" failures=\"{failures}\" errors=\"{errors}\" skipped=\"0\">",
        escape(&evaluation.requirements.name)
    );
    properties(&mut out, evaluation);
    if nothing {
        case(&mut out, "robogate.gate", "evidence", Some(("error", "invalid", &evaluation.because, "")));
    }
    for (id, row) in ids.iter().zip(&rows) {
        let said = format!("{}: observed {}", row.demand, row.observed);
        let body = [row.interval.as_str(), row.note.as_str()].join("\n");
        let problem = match row.status {
            Status::Met => None,
            Status::Violated => Some(("failure", "violated", said.as_str(), body.as_str())),
            Status::Undecided => Some(("error", "inconclusive", said.as_str(), body.as_str())),
            Status::NoEvidence => Some(("error", "no evidence", said.as_str(), body.as_str())),
        };
        case(&mut out, "robogate.requirement", id, problem);
    }
    out.push_str("  </testsuite>\n");
    if !evaluation.groups.is_empty() {
        let _ = writeln!(
            out,
            "  <testsuite name=\"groups\" tests=\"{}\" failures=\"0\" errors=\"0\" skipped=\"0\">",
            evaluation.groups.len()
        );
        evaluation.groups.iter().for_each(|group| self::group(&mut out, group));
        out.push_str("  </testsuite>\n");
    }
    out.push_str("</testsuites>\n");
    out
}

fn properties(out: &mut String, evaluation: &Evaluation) {
    out.push_str("    <properties>\n");
    let counts = evaluation.counts;
    for (name, value) in [
        ("verdict", evaluation.verdict.word().to_owned()),
        ("because", evaluation.because.clone()),
        ("policy", evaluation.policy.clone()),
        ("robot", evaluation.robot.clone()),
        ("population", evaluation.population.to_string()),
        ("dataset_sha256", evaluation.dataset_sha256.clone()),
        ("episodes", counts.episodes.to_string()),
        ("invalid_episodes", counts.invalid.to_string()),
    ] {
        let _ = writeln!(out, "      <property name=\"{name}\" value=\"{}\"/>", escape(&value));
    }
    out.push_str("    </properties>\n");
}

fn case(out: &mut String, class: &str, name: &str, problem: Option<(&str, &str, &str, &str)>) {
    let _ = write!(out, "    <testcase classname=\"{class}\" name=\"{}\" time=\"0\"", escape(name));
    match problem {
        None => out.push_str("/>\n"),
        Some((element, kind, message, body)) => {
            let _ = writeln!(
                out,
                ">\n      <{element} type=\"{kind}\" message=\"{}\">{}</{element}>\n    </testcase>",
                escape(message),
                escape(body.trim())
            );
        }
    }
}

fn group(out: &mut String, group: &GroupResult) {
    let rate = if group.valid > 0 { percent(group.successes as f64 / group.valid as f64) } else { "-".to_owned() };
    let endings: Vec<String> = group.endings.iter().map(|e| format!("{} {}", e.ending, e.episodes)).collect();
    let _ = writeln!(
        out,
        "    <testcase classname=\"robogate.group.{}\" name=\"{}\" time=\"0\">\n      <system-out>{}</system-out>\n    </testcase>",
        escape(&group.category),
        escape(&group.group),
        escape(&format!(
            "{} of {} valid episodes succeeded: {rate}, 95 % interval {}; {}",
            count(group.successes),
            count(group.valid),
            percent_range(group.interval_95),
            if endings.is_empty() { "nothing else happened".to_owned() } else { endings.join(", ") }
        ))
    );
}
