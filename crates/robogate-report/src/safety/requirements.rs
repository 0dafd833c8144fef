//! Claims about the requirements.

use robogate_gate::evidence::{Judged, Role};
use robogate_gate::{Metric, Mode, Status, Verdict};
use robogate_stats::format::{count, percent, sentence};

use super::{Answered, Claim, Defeater, paths};
use crate::RequirementRow;
use crate::gate::of_invalid;

pub(super) fn claim(judged: &Judged<'_>) -> Claim {
    let evaluation = judged.evaluation;
    // The comparison is the last row.
    let rows = RequirementRow::all(evaluation).into_iter().enumerate();
    let mut parts: Vec<Claim> = rows
        .map(|(at, row)| {
            let result = evaluation.results.get(at);
            let ids = result.map(|result| result.requirement.ids.join(", ")).unwrap_or_default();
            let from = match result.map(|result| result.requirement.metric) {
                Some(Metric::RealSuccess) => vec![Role::Evaluation, Role::Real],
                Some(_) => vec![Role::Evaluation, Role::Dictionary, Role::Baseline],
                None => vec![Role::Evaluation, Role::Dictionary, Role::Against],
            };
            decided(at + 1, &row, &ids, paths(judged, &from))
        })
        .collect();
    parts.extend(evaluation.dropped.iter().enumerate().map(|(at, dropped)| {
        let text = format!("The requirement {} is met as it is written.", dropped.id);
        let because = format!("It was not judged as written: {}.", dropped.because.trim_end_matches('.'));
        Claim::on(format!("dropped-{}", at + 1), text, because, Vec::new(), Vec::new())
    }));
    let text = format!("The requirements \"{}\" are met.", evaluation.requirements.name);
    let claim = Claim::of_parts("requirements", text, "Argue over each requirement.", parts, defeaters(judged));
    let verdict = evaluation.verdict.as_str().to_uppercase();
    let because = format!("Verdict of the gate: {verdict}: {}.", evaluation.because.trim_end_matches('.'));
    Claim { because, ..claim }
}

/// A claim that a test decides.
fn decided(place: usize, row: &RequirementRow, ids: &str, files: Vec<String>) -> Claim {
    let name = format!("requirement-{place}");
    let ids = if ids.is_empty() { String::new() } else { format!(" Identifiers: {ids}.") };
    let text = format!("Requirement: {}.{ids}", row.requirement);
    let bounds = match row.interval.as_str() {
        "" => String::new(),
        interval => format!(", bounds {interval}"),
    };
    let note = if row.note.is_empty() { String::new() } else { format!(" ({})", row.note) };
    let because = format!("{}: observed {}{bounds}{note}.", sentence(row.status.as_str()), row.observed);
    let violated = Defeater::new(
        format!("{name}-violated"),
        format!("The requirement is violated: {}.", row.requirement),
        Answered::Confirmed,
        because.clone(),
        files.clone(),
    );
    match row.status {
        Status::Met => Claim::on(name, text, because, files, Vec::new()),
        Status::Violated => Claim::on(name, text, because, Vec::new(), vec![violated]),
        Status::Undecided | Status::NoEvidence => Claim::on(name, text, because, Vec::new(), Vec::new()),
    }
}

fn defeaters(judged: &Judged<'_>) -> Vec<Defeater> {
    let evaluation = judged.evaluation;
    let (state, because) = match evaluation.requirements.mode {
        Mode::Confidence => (
            Answered::Yes,
            format!(
                "A pass, and a fail, is wrong in at most {} of gates like this one.",
                percent(1.0 - evaluation.requirements.confidence)
            ),
        ),
        Mode::Point => {
            (Answered::Open, "The requirements compare observed figures without an error probability.".to_owned())
        }
    };
    let files = paths(judged, &[Role::Evaluation]);
    let mut found = vec![Defeater::new(
        "chance",
        "The figures are on the right side of their limits by chance.",
        state,
        because,
        files.clone(),
    )];
    if evaluation.counts.invalid > 0 {
        let holds = matches!(evaluation.verdict, Verdict::Pass | Verdict::Fail);
        found.push(Defeater::new(
            "invalid-episodes",
            format!("The outcomes of {} invalid episodes are unknown.", count(evaluation.counts.invalid)),
            if holds { Answered::Yes } else { Answered::Open },
            format!("{}.", sentence(of_invalid(evaluation.verdict))),
            files.clone(),
        ));
    }
    if judged.policy_is_connected() {
        found.push(connection(judged, files));
    }
    found
}

/// Whether the connection of the policy was shown to work.
fn connection(judged: &Judged<'_>, files: Vec<String>) -> Defeater {
    let controls = judged.evaluation.controls.as_ref();
    let ran = controls.is_some_and(|controls| controls.positive.is_some() && controls.negative.is_some());
    let because = match controls {
        Some(_) if ran => "An expert succeeds through the same connection, and random actions do not.".to_owned(),
        Some(controls) if !controls.without.is_empty() => {
            format!("No controls: {}.", controls.without.trim_end_matches('.'))
        }
        _ => "No controls ran: an expert and random actions were not compared with the policy.".to_owned(),
    };
    Defeater::new(
        "connection",
        "The episodes measure the connection and not the policy: images, states or actions are not those that it was trained on.",
        if ran { Answered::Yes } else { Answered::Open },
        because,
        files,
    )
}
