//! Gate evaluations as one page that can be filed and printed.

use maud::html;
use robogate_gate::{Controls, Evaluation, Mode, Verdict};
use robogate_stats::format::{count, counted, percent, percent_range, sentence};

use super::{RequirementRow, TwinRow, feasible_part, how_judged, new_cases, what_next};
use crate::document::Kind::{Number, Short, Text};
use crate::document::{Block, Table};
use crate::html::{block, frame, prose};

/// The evaluation as one self-contained HTML file without scripts. `origin` are names and values that identify what was
/// judged: versions and digests. Equal evaluations and facts give equal bytes.
pub fn verdict_html(evaluation: &Evaluation, origin: &[(String, String)]) -> String {
    page(evaluation, origin, None, None)
}

/// The first page of a folder of evidence: [`verdict_html`], and what a reader needs who was not there. `ranges` are the parameters
/// with their ranges, units and meanings, `unchecked` sentences on what was not checked, `safety_case` the path of the page of the safety
/// case, if the folder has one.
pub fn evidence_html(
    evaluation: &Evaluation,
    origin: &[(String, String)],
    ranges: Vec<Vec<String>>,
    unchecked: Vec<String>,
    safety_case: Option<&str>,
) -> String {
    page(evaluation, origin, Some((ranges, unchecked)), safety_case)
}

fn page(
    evaluation: &Evaluation,
    origin: &[(String, String)],
    filed: Option<(Vec<Vec<String>>, Vec<String>)>,
    safety_case: Option<&str>,
) -> String {
    let word = match evaluation.verdict {
        Verdict::Pass => "PASS",
        Verdict::Fail => "FAIL",
        Verdict::Inconclusive => "INCONCLUSIVE",
        Verdict::Invalid => "INVALID",
    };
    let dataset = ("SHA-256 of the episodes".to_owned(), evaluation.dataset_sha256.clone());
    let mut sections = vec![("Requirements", requirements(evaluation))];
    if let Some(controls) = evaluation.controls.as_ref().map(Controls::lines).filter(|lines| !lines.is_empty()) {
        sections.push(("Controls", vec![Block::List(controls)]));
    }
    sections.extend(twins(evaluation).map(|blocks| ("Control arm: the same seeds without the perturbations", blocks)));
    if !evaluation.groups.is_empty() {
        sections.push(("Success by scenario group", vec![Block::Table(groups(evaluation))]));
    }
    let facts = origin.iter().cloned().chain([dataset]).collect();
    let filed = filed.map(|(ranges, unchecked)| {
        let columns = [("parameter", Short), ("range", Short), ("unit", Short), ("meaning", Text)];
        let table = Table::new("", &columns, ranges);
        sections.insert(1, ("Operating ranges", vec![Block::Table(table)]));
        unchecked
    });
    sections.push(("What was judged", vec![Block::Facts(facts)]));
    if let Some(unchecked) = filed {
        sections.push(("Limits of validity", vec![Block::List(validity(evaluation))]));
        sections.push(("What was not checked", vec![Block::List(unchecked)]));
        let check = "Run `robogate verify .` in this folder. It compares every file with the manifest, computes the verdict again from \
                     the rows, and says who signed it. This page states no signature: anybody could have written one here.";
        sections.push(("Signatures and trust", vec![Block::Text(check.to_owned())]));
    }
    let body = html! {
        header.top {
            p.brand { b { "RoboGate" } " verdict of the gate" }
            h1 { (word) }
            p.sub { (prose(&sentence(&format!("{}.", evaluation.because.trim_end_matches('.'))))) }
            (block(&Block::Facts(subject(evaluation))))
            @if let Some(page) = safety_case {
                p.text { a href=(page) { "Safety case" } ": the argument from these files to the claim that the policy may run, and what can defeat it." }
            }
        }
        main {
            @for (title, blocks) in &sections {
                section {
                    header { h2 { (title) } }
                    @for one in blocks { (block(one)) }
                }
            }
        }
    };
    frame(&format!("{word}: {} on {}", evaluation.policy, evaluation.robot), &body, false)
}

/// What the verdict applies to, in sentences.
fn validity(evaluation: &Evaluation) -> Vec<String> {
    let requirements = &evaluation.requirements;
    let population = &evaluation.population;
    let mut texts = vec![
        format!("The verdict applies to {population} within the operating ranges above. Nothing was tested outside of them."),
        "It applies to the policy, the robot, the environment and the settings with the digests above. Any change needs a new gate."
            .to_owned(),
    ];
    texts.push(match requirements.mode {
        Mode::Confidence => format!(
            "A pass, and a fail, is wrong in at most {} of gates like this one.",
            percent(1.0 - requirements.confidence)
        ),
        Mode::Point => {
            "The observed figures were compared with the limits: the verdict has no error probability.".to_owned()
        }
    });
    if evaluation.real.is_none() {
        texts.push("All episodes are simulated or imported as recorded: the verdict makes no statement about other real robots.".to_owned());
    }
    texts
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

/// The requirements with their identifiers, and how they were judged.
fn requirements(evaluation: &Evaluation) -> Vec<Block> {
    let columns = [
        ("status", Short),
        ("requirement", Text),
        ("identifiers", Text),
        ("observed", Number),
        ("one-sided bounds", Number),
    ];
    let mut notes = Vec::new();
    let rows = RequirementRow::all(evaluation).into_iter().enumerate().map(|(at, row)| {
        if !row.note.is_empty() {
            notes.push(format!("{}: {}.", row.requirement, row.note));
        }
        let ids = evaluation.results.get(at).map(|result| result.requirement.ids.join(", "));
        vec![row.status.as_str().to_owned(), row.requirement, ids.unwrap_or_default(), row.observed, row.interval]
    });
    let table = Table::new("", &columns, rows.collect());
    notes.extend([what_next(evaluation), how_judged(evaluation), evaluation.estimand.clone()]);
    notes.extend(new_cases(evaluation).into_iter().chain(feasible_part(evaluation)));
    notes.extend(evaluation.outside_range.iter().map(ToString::to_string));
    notes.extend(evaluation.remarks());
    notes.extend(evaluation.force_limits.iter().flat_map(|result| result.lines(3)));
    notes.retain(|text| !text.is_empty());
    std::iter::once(Block::Table(table)).chain(notes.into_iter().map(Block::Text)).collect()
}

fn twins(evaluation: &Evaluation) -> Option<Vec<Block>> {
    let twins = evaluation.twins.as_ref()?;
    let rows = twins.families.iter().map(|family| TwinRow::of(family).cells().into()).collect();
    let table = Table::new("", &TwinRow::HEADS.map(|head| (head, Text)), rows);
    Some(vec![Block::List(twins.lines()), Block::Table(table)])
}

fn groups(evaluation: &Evaluation) -> Table {
    let columns = [("group", Text), ("success", Number), ("95 % interval", Number), ("failures", Text)];
    let row = |group: &robogate_gate::GroupResult| {
        let endings: Vec<String> = group.endings.iter().map(|e| format!("{} {}", e.ending, e.episodes)).collect();
        vec![
            format!("{}/{}", group.category, group.group),
            format!("{} of {}", count(group.successes), count(group.valid)),
            percent_range(group.interval_95),
            endings.join(", "),
        ]
    };
    Table::new("", &columns, evaluation.groups.iter().map(row).collect())
}
