//! Gate evaluations as a PDF that can be filed and printed.

use robogate_gate::{Controls, Evaluation, Mode, Verdict};
use robogate_stats::format::{count, counted, percent, percent_range, sentence};

use super::{RequirementRow, TwinRow, feasible_part, how_judged, new_cases, what_next};
use crate::pdf::{Pdf, PdfColumn};

/// The evaluation as a PDF. `origin` are names and values that identify what was judged: versions and digests. Equal
/// evaluations and facts give equal bytes.
pub fn verdict_pdf(evaluation: &Evaluation, origin: &[(String, String)]) -> Vec<u8> {
    let mut pdf = Pdf::new();
    let (word, colour) = match evaluation.verdict {
        Verdict::Pass => ("PASS", [0.05, 0.45, 0.2]),
        Verdict::Fail => ("FAIL", [0.7, 0.1, 0.1]),
        Verdict::Inconclusive => ("INCONCLUSIVE", [0.6, 0.4, 0.0]),
        Verdict::Invalid => ("INVALID", [0.4, 0.4, 0.4]),
    };
    pdf.title("Verdict of the gate", 12.0, [0.4; 3]);
    pdf.title(word, 26.0, colour);
    pdf.paragraph(&sentence(&format!("{}.", evaluation.because.trim_end_matches('.'))));
    pdf.facts(&subject(evaluation));
    requirements(&mut pdf, evaluation);
    for text in [what_next(evaluation), how_judged(evaluation), evaluation.estimand.clone()] {
        if !text.is_empty() {
            pdf.paragraph(&text);
        }
    }
    new_cases(evaluation).iter().chain(&feasible_part(evaluation)).for_each(|text| pdf.paragraph(text));
    evaluation.outside_range.iter().for_each(|outside| pdf.paragraph(&outside.to_string()));
    let controls = evaluation.controls.as_ref().map(Controls::lines).unwrap_or_default();
    if !controls.is_empty() {
        pdf.heading("Controls");
        controls.iter().for_each(|text| pdf.paragraph(text));
    }
    twins(&mut pdf, evaluation);
    groups(&mut pdf, evaluation);
    pdf.heading("What was judged");
    let dataset = ("SHA-256 of the episodes".to_owned(), evaluation.dataset_sha256.clone());
    let facts: Vec<(String, String)> = origin.iter().cloned().chain([dataset]).collect();
    pdf.facts(&facts);
    pdf.finish(
        &format!("{word}: {} on {}", evaluation.policy, evaluation.robot),
        &format!("RoboGate {} - {word}: {}", env!("CARGO_PKG_VERSION"), evaluation.policy),
    )
}

fn subject(evaluation: &Evaluation) -> Vec<(String, String)> {
    let counts = evaluation.counts;
    let rounds = counts.rounds.map_or_else(String::new, |rounds| format!(" in {}", counted(rounds, "round")));
    let requirements = &evaluation.requirements;
    let confidence = match requirements.mode {
        Mode::Confidence => format!("{}, at {} confidence", requirements.name, percent(requirements.confidence)),
        Mode::Point => format!("{}, observed figures without an error probability", requirements.name),
    };
    [
        ("Policy", evaluation.policy.clone()),
        ("Robot", evaluation.robot.clone()),
        ("Task", format!("{} {}", evaluation.task.name, evaluation.task.version)),
        ("Scenarios", evaluation.population.to_string()),
        ("Episodes", format!("{}{rounds}, {} of them invalid", count(counts.episodes), count(counts.invalid))),
        ("Requirements", confidence),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

fn requirements(pdf: &mut Pdf, evaluation: &Evaluation) {
    pdf.heading("Requirements");
    let column = |head, share| PdfColumn { head, share };
    let columns = [
        column("Status", 0.12),
        column("Requirement", 0.34),
        column("Identifiers", 0.18),
        column("Observed", 0.14),
        column("Confidence interval", 0.22),
    ];
    let mut notes = Vec::new();
    let rows: Vec<Vec<String>> = RequirementRow::all(evaluation)
        .into_iter()
        .enumerate()
        .map(|(at, row)| {
            if !row.note.is_empty() {
                notes.push(format!("{}: {}.", row.requirement, row.note));
            }
            let ids = evaluation.results.get(at).map(|result| result.requirement.ids.join(", "));
            vec![row.status.as_str().to_owned(), row.requirement, ids.unwrap_or_default(), row.observed, row.interval]
        })
        .collect();
    pdf.table(&columns, &rows);
    notes.iter().for_each(|note| pdf.paragraph(note));
}

fn twins(pdf: &mut Pdf, evaluation: &Evaluation) {
    let Some(twins) = &evaluation.twins else { return };
    pdf.heading("Control arm: the same seeds without the perturbations");
    twins.lines().iter().for_each(|line| pdf.paragraph(line));
    let shares = [0.22, 0.34, 0.12, 0.18, 0.14];
    let columns: Vec<PdfColumn> =
        TwinRow::HEADS.into_iter().zip(shares).map(|(head, share)| PdfColumn { head, share }).collect();
    let rows: Vec<Vec<String>> = twins.families.iter().map(|family| TwinRow::of(family).cells().into()).collect();
    pdf.table(&columns, &rows);
}

fn groups(pdf: &mut Pdf, evaluation: &Evaluation) {
    if evaluation.groups.is_empty() {
        return;
    }
    pdf.heading("Success by scenario group");
    let column = |head, share| PdfColumn { head, share };
    let columns =
        [column("Group", 0.34), column("Success", 0.18), column("95 % interval", 0.2), column("Failures", 0.28)];
    let row = |group: &robogate_gate::GroupResult| {
        let endings: Vec<String> = group.endings.iter().map(|e| format!("{} {}", e.ending, e.episodes)).collect();
        vec![
            format!("{}/{}", group.category, group.group),
            format!("{} of {}", count(group.successes), count(group.valid)),
            percent_range(group.interval_95),
            endings.join(", "),
        ]
    };
    let rows: Vec<Vec<String>> = evaluation.groups.iter().map(row).collect();
    pdf.table(&columns, &rows);
}
