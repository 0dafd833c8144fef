//! The sections in their order: the answer first, then the evidence.

use super::{Block, Figure, Section, Story, Table, tables};
use crate::page::{charts, drawable, heatmap};
use crate::text::{Headline, limits as limits_of};
use robogate_analysis::TaskAnalysis;
use robogate_analysis::labels::{mode_label, parameter_label, value_with_unit};
use robogate_analysis::{Along, CriticalThreshold};
use robogate_analysis::{Analysis, Envelope, Finding, Frontier, Regression};
use robogate_stats::format::{count, counted, fixed, list, number, percent, percent_range, range, sentence};

/// Parameters that are drawn on the page; the rest stands in the tables.
const MOST_FIGURES: usize = 16;

/// Tells an analysis.
pub(crate) fn tell(analysis: &Analysis) -> Story {
    let subject = &analysis.subject;
    let success = &analysis.success;
    let unknown = |word: &str| word.is_empty() || word == "unknown";
    let robot = match subject.robot.as_str() {
        robot if unknown(robot) => "Robot not named".to_owned(),
        // A short type code, as in ur10.
        robot if robot.len() < 6 && robot.ends_with(|c: char| c.is_ascii_digit()) => robot.to_uppercase(),
        robot => sentence(robot),
    };
    let policy =
        if unknown(&subject.policy) { "policy not named".to_owned() } else { format!("{} policy", subject.policy) };
    let bounds = match (success.bounds.invalid, success.bounds.worst_case, success.bounds.best_case) {
        (1.., Some(worst), Some(best)) => Some([worst, best]),
        _ => None,
    };
    let headline = Headline::of(analysis);
    Story {
        kind: "failure report",
        title: format!("{robot}, {policy}"),
        subtitle: format!(
            "{} in {} \u{b7} dataset {}",
            counted(subject.episodes, "episode"),
            if unknown(&subject.engine) { "an engine that is not named" } else { subject.engine.as_str() },
            subject.dataset_hash.get(..12).unwrap_or(&subject.dataset_hash)
        ),
        rate: success.rate.rate.map_or_else(|| "\u{2013}".to_owned(), percent),
        rate_of: format!("success, {}", analysis.population.brief()),
        interval: format!(
            "95 % interval {} \u{b7} n = {}",
            percent_range(success.rate.wilson_95),
            count(success.rate.n)
        ),
        scale: charts::rate_scale(&success.rate, bounds),
        answer: headline.answer,
        columns: vec![
            ("Where it fails", headline.where_it_fails),
            ("What to do", headline.what_to_do),
            ("How sure", headline.how_sure),
        ]
        .into_iter()
        .filter(|(_, lines)| !lines.is_empty())
        .collect(),
        sections: vec![
            envelope(analysis),
            thresholds(analysis),
            failures(analysis),
            danger(analysis),
            risk(analysis),
            interactions(analysis),
            drawn(analysis),
            replay(analysis),
            provenance(analysis),
            limits(analysis),
        ],
    }
}

fn population(analysis: &Analysis) -> Option<String> {
    Some(format!("Speaks of {}.", analysis.population.describe()))
}

fn cannot(what: &str, because: &str) -> Block {
    Block::Text(format!("{what} cannot be estimated because {because}."))
}

fn envelope(analysis: &Analysis) -> Section {
    let mut blocks = Vec::new();
    if analysis.envelopes.is_empty() {
        blocks.push(cannot("An envelope", "there are no two numeric parameters to draw it over"));
    }
    for (i, envelope) in analysis.envelopes.iter().enumerate() {
        one_envelope(&mut blocks, envelope, i);
    }
    Section { id: "envelope", title: "Operating envelope".to_owned(), population: population(analysis), blocks }
}

fn one_envelope(blocks: &mut Vec<Block>, envelope: &Envelope, at: usize) {
    let frontier = envelope.frontier.estimated();
    match &envelope.map {
        Finding::Estimated(map) => {
            let (y, x) = (parameter_label(&map.y.parameter), parameter_label(&map.x.parameter));
            let zones = map.zones;
            let mut reading = vec![format!(
                "Of {} cells {} are surely safe (70 % or more), {} surely in danger (30 % or less), {} surely between; {} are \
                 undecided and {} too thin to say. A zone goes by an interval whose level is shared over the whole map: it is \
                 wider than the 95 % interval of a cell.",
                map.cells.len(),
                zones.safe,
                zones.danger,
                zones.boundary,
                zones.undecided,
                zones.too_thin
            )];
            reading.extend(frontier.map(read_frontier).unwrap_or_default());
            blocks.push(Block::Figure(Figure {
                title: format!("{} \u{d7} {}", sentence(&y), x),
                svg: heatmap(map, frontier, &format!("clip{at}")),
                is_map: true,
                caption: "Observed success in percent, and below it the number of episodes. Cells are even in each \
                          parameter's own scale."
                    .to_owned(),
                reading,
                table: tables::map(map),
            }));
        }
        Finding::CannotBeEstimated { because } => blocks.push(cannot("The map", because)),
    }
    match &envelope.frontier {
        Finding::Estimated(frontier) => {
            blocks.push(Block::Code(frontier.closed_form.clone()));
            if frontier.contradicted {
                blocks.push(Block::Caution(format!(
                    "Do not rely on this frontier: where the model states 40 to 60 % success, {} was observed ({} in {}). \
                     The cells of the map are what happened.",
                    frontier.near.rate.map_or_else(|| "-".to_owned(), percent),
                    percent_range(frontier.near.wilson_95),
                    counted(frontier.near.n, "episode")
                )));
            }
            blocks.push(Block::Folded(tables::regression("The model behind the frontier", &frontier.regression)));
            blocks.push(Block::Folded(tables::curve(frontier)));
            blocks.extend(frontier.regression.cautions.iter().cloned().map(Block::Caution));
        }
        Finding::CannotBeEstimated { because } => blocks.push(cannot("The frontier in closed form", because)),
    }
}

fn read_frontier(frontier: &Frontier) -> Vec<String> {
    let (x, y) = (parameter_label(&frontier.x), parameter_label(&frontier.y));
    let mut lines = Vec::new();
    match frontier.valid_for {
        _ if drawable(frontier).is_empty() => {
            lines.push(format!(
                "No {x} surely parts success from failure here: within what was observed, the exact interval of the \
                 frontier {x}*({y}) is not bounded, so that it is not drawn."
            ));
            return lines;
        }
        Some(valid) => {
            if let Some(above) = frontier.success_above {
                let side = if above { "above" } else { "below" };
                lines.push(format!("Success is likelier than failure {side} the frontier {x}*({y})."));
            }
            if !frontier.contradicted && frontier.near.n > 0 {
                lines.push(format!(
                    "Where the model states 40 to 60 %, {} was observed ({}).",
                    frontier.near.rate.map_or_else(|| "-".to_owned(), percent),
                    percent_range(frontier.near.wilson_95)
                ));
            }
            lines.push(format!(
                "It lies within what was observed for {y} {}; beyond, it is extrapolation.",
                value_with_unit(&range(valid), &frontier.y)
            ));
        }
        None => lines.push(format!(
            "The frontier {x}*({y}) lies outside what was observed everywhere: the model sees one outcome as likelier \
             throughout."
        )),
    }
    if let Some(pole) = frontier.pole {
        lines.push(format!(
            "It runs to infinity (its pole) at {y} {}; near there no {x} parts success from failure.",
            value_with_unit(&number(pole), &frontier.y)
        ));
    }
    lines
}

fn thresholds(analysis: &Analysis) -> Section {
    let mut blocks = vec![Block::Table(tables::thresholds(&analysis.along))];
    blocks.extend(tables::categories(&analysis.along).map(Block::Table));
    blocks.push(Block::Text(
        "The vertical line is where success crosses 50 %, with its interval from 1,000 bootstrap replicates; whiskers are \
         Wilson intervals; dotted lines part danger (30 %), boundary and safe (70 %)."
            .to_owned(),
    ));
    let mut ranked: Vec<&Along> = analysis.along.iter().collect();
    let strength = |a: &Along| a.correlation.estimated().map_or(0.0, |c| c.strength());
    ranked.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    let left_out = ranked.len().saturating_sub(MOST_FIGURES);
    let figures = ranked.into_iter().take(MOST_FIGURES).map(|along| Figure {
        title: sentence(&along.label),
        svg: charts::along(along),
        is_map: false,
        caption: caption(along),
        reading: Vec::new(),
        table: tables::cells(along),
    });
    blocks.push(Block::Grid(figures.collect()));
    if left_out > 0 {
        blocks.push(Block::Text(format!(
            "{} that go less with success stand in the JSON document.",
            counted(left_out as u64, "parameter")
        )));
    }
    Section { id: "thresholds", title: "Along each parameter".to_owned(), population: population(analysis), blocks }
}

fn caption(along: &Along) -> String {
    let outside = if along.outside > 0 {
        format!(" {} lie outside the range.", counted(along.outside, "episode"))
    } else {
        String::new()
    };
    let text = match &along.threshold {
        Finding::Estimated(CriticalThreshold::Crosses { at, rising, .. }) => format!(
            "Success {} through 50 % at {}.",
            if *rising { "rises" } else { "falls" },
            value_with_unit(&number(*at), &along.parameter)
        ),
        Finding::Estimated(CriticalThreshold::CrossesMoreThanOnce { .. }) => {
            "Success crosses 50 % more than once: no single threshold exists.".to_owned()
        }
        Finding::Estimated(CriticalThreshold::DoesNotCross { stays_above, crossing_share }) => format!(
            "Success stays {} 50 %{}.",
            if *stays_above { "above" } else { "below" },
            if *crossing_share > 0.05 { " as observed, though not surely" } else { "" }
        ),
        Finding::CannotBeEstimated { because } => match along.kind {
            robogate_analysis::AlongKind::Categorical => match along.correlation.estimated() {
                Some(found) => format!("Cramer's V {}.", fixed(found.strength(), 3)),
                None => String::new(),
            },
            _ => format!("No threshold: {because}."),
        },
    };
    format!("{text}{outside}")
}

fn failures(analysis: &Analysis) -> Section {
    let modes = &analysis.failure_modes;
    let mut blocks = Vec::new();
    if modes.failures == 0 {
        blocks.push(cannot("A distribution of failure modes", "nothing failed"));
    } else {
        let reading = match &modes.dominant {
            Finding::Estimated(dominant) => {
                format!("{} is surely the most frequent mode.", sentence(&mode_label(dominant)))
            }
            Finding::CannotBeEstimated { because } => format!("No mode is surely the most frequent: {because}."),
        };
        blocks.push(Block::Figure(Figure {
            title: format!("{} by mode", counted(modes.failures, "failure")),
            svg: charts::modes(modes),
            is_map: false,
            caption: "Shares of all failures, with intervals that hold for all modes together.".to_owned(),
            reading: vec![reading],
            table: tables::failure_modes(modes),
        }));
        let mut changing: Vec<&Along> =
            analysis.along.iter().filter(|a| a.transitions.estimated().is_some_and(|t| t.bins.len() > 1)).collect();
        let weight = |a: &Along| {
            let changes = a.transitions.estimated().map_or(0, |t| t.changes.len());
            (changes > 0, a.correlation.estimated().map_or(0.0, |c| c.strength()))
        };
        changing.sort_by(|a, b| weight(b).partial_cmp(&weight(a)).unwrap_or(std::cmp::Ordering::Equal));
        let told: Vec<String> = changing.iter().flat_map(|a| changes_along(a)).collect();
        let only_one = modes.modes.iter().filter(|m| m.failures > 0).count() == 1;
        if only_one {
            blocks.push(Block::Text(
                "There is one failure mode only, so that nothing can change along a parameter.".into(),
            ));
        } else {
            blocks.push(Block::Heading("Where the dominant mode changes".to_owned()));
            if told.is_empty() {
                blocks.push(Block::Text("Along no parameter does the surely dominant mode change.".to_owned()));
            } else {
                blocks.push(Block::List(told));
            }
            let figures = changing.into_iter().take(4).filter_map(|a| {
                let changes = a.transitions.estimated()?;
                Some(Figure {
                    title: format!("Modes along {}", a.label),
                    svg: charts::mode_changes(&a.parameter, changes, modes),
                    is_map: false,
                    caption:
                        "Shares of the failures in bins of about equal numbers of failures. A point below a bin: its \
                              dominant mode is surely ahead."
                            .to_owned(),
                    reading: Vec::new(),
                    table: tables::mode_changes(&a.label, changes, modes),
                })
            });
            blocks.push(Block::Grid(figures.collect()));
        }
    }
    Section { id: "failures", title: "How it fails".to_owned(), population: population(analysis), blocks }
}

fn changes_along(along: &Along) -> Vec<String> {
    let Some(changes) = along.transitions.estimated() else { return Vec::new() };
    let told = |c: &robogate_analysis::ModeChange| {
        let place = if (c.between[1] - c.between[0]).abs() <= 0.0 {
            format!("at {}", value_with_unit(&number(c.between[0]), &along.parameter))
        } else {
            format!("between {}", value_with_unit(&range(c.between).replace(" to ", " and "), &along.parameter))
        };
        format!("Along {}, {} gives way to {} {place}.", along.label, mode_label(&c.from), mode_label(&c.to))
    };
    changes.changes.iter().map(told).collect()
}

fn danger(analysis: &Analysis) -> Section {
    let zones = &analysis.danger_zones;
    let sure = zones.zones.iter().filter(|z| z.sure).count();
    let mut reading = vec![format!(
        "{} of {} bins and levels are surely below 40 % success, the limit of the paper's table of dangers (exact one-sided \
         tests, adjusted by Holm over all of them).",
        sure,
        count(zones.looked_at)
    )];
    if zones.zones.len() > sure {
        reading.push(format!("{} more were observed below it without being sure.", zones.zones.len() - sure));
    }
    if analysis.success.rate.rate.is_some_and(|rate| rate < zones.limit) {
        reading.push(
            "The overall rate is itself below the limit, so that most bins are too: what stands out is far below the others."
                .to_owned(),
        );
    }
    let blocks = if zones.zones.is_empty() {
        vec![Block::Text(format!(
            "Of {} bins and levels none was observed below 40 % success.",
            count(zones.looked_at)
        ))]
    } else {
        vec![Block::Figure(Figure {
            title: "Surest first".to_owned(),
            svg: charts::danger(zones, 14),
            is_map: false,
            caption: "Observed success with Wilson intervals; the line is at 40 %. Filled: surely below.".to_owned(),
            reading,
            table: tables::danger(zones),
        })]
    };
    Section { id: "danger", title: "Failure zones".to_owned(), population: population(analysis), blocks }
}

fn risk(analysis: &Analysis) -> Section {
    let mut blocks = Vec::new();
    match &analysis.risk {
        Finding::CannotBeEstimated { because } => blocks.push(cannot("A risk model", because)),
        Finding::Estimated(risk) => {
            let form = if risk.paper_features {
                TaskAnalysis::of(&analysis.subject.task).risk_about
            } else {
                "A model of the paper's form over the parameters that there are; these are not the paper's nine features."
            };
            let coding = "A penalty is the failure rate of its level, drawn towards the overall rate by ten episodes' worth; \
                          the paper does not define its penalties.";
            let reading = match strongest(&risk.regression) {
                Some(strongest) => vec![form.to_owned(), strongest, coding.to_owned()],
                None => vec![form.to_owned(), coding.to_owned()],
            };
            blocks.push(Block::Figure(Figure {
                title: "What raises the chance of failure".to_owned(),
                svg: charts::coefficients(&risk.regression),
                is_map: false,
                caption: "Change of the log-odds of failure per standard deviation, with 95 % intervals.".to_owned(),
                reading,
                table: tables::regression("Coefficients of the risk model", &risk.regression),
            }));
            blocks.extend(risk.regression.cautions.iter().cloned().map(Block::Caution));
            let mut figures = Vec::new();
            match &risk.roc {
                Finding::Estimated(roc) => figures.push(Figure {
                    title: "Telling failures apart".to_owned(),
                    svg: charts::roc(roc),
                    is_map: false,
                    caption: "ROC; unseen: five folds, each scored by a model of the other four.".to_owned(),
                    reading: Vec::new(),
                    table: tables::roc(roc),
                }),
                Finding::CannotBeEstimated { because } => blocks.push(cannot("A ROC curve", because)),
            }
            let shown = match (&risk.calibration_cross_validated, &risk.calibration_in_sample) {
                (Finding::Estimated(unseen), _) => Some((unseen, "unseen episodes")),
                (_, Finding::Estimated(seen)) => Some((seen, "in sample")),
                _ => None,
            };
            if let Some((found, which)) = shown {
                figures.push(Figure {
                    title: "Do its probabilities come true?".to_owned(),
                    svg: charts::reliability(found),
                    is_map: false,
                    caption: format!(
                        "Stated against observed failure rates, ten bins, {which}. On the line it is right."
                    ),
                    reading: Vec::new(),
                    table: tables::reliability(found),
                });
            }
            blocks.push(Block::Grid(figures));
            blocks.push(Block::Table(tables::calibration(risk)));
            blocks.extend(tables::penalties(risk).map(Block::Folded));
        }
    }
    Section { id: "risk", title: "Risk model".to_owned(), population: population(analysis), blocks }
}

fn strongest(regression: &Regression) -> Option<String> {
    let (term, estimate) = regression
        .terms
        .iter()
        .filter(|t| t.term != "intercept")
        .filter_map(|t| Some((&t.term, t.found.estimated()?)))
        .max_by(|a, b| a.1.z.abs().total_cmp(&b.1.z.abs()))?;
    let way = if estimate.coefficient > 0.0 { "raises" } else { "lowers" };
    Some(format!(
        "The strongest is {term}: one standard deviation more {way} the odds of {} by a factor of {}.",
        regression.outcome,
        number(estimate.coefficient.abs().exp())
    ))
}

fn interactions(analysis: &Analysis) -> Section {
    let model = TaskAnalysis::of(&analysis.subject.task).interactions;
    let blocks = match &analysis.interactions {
        Finding::CannotBeEstimated { because } => vec![cannot("The paper's model with interactions", because)],
        Finding::Estimated(regression) => {
            let mut blocks = vec![Block::Figure(Figure {
                title: "What raises the chance of success".to_owned(),
                svg: charts::coefficients(regression),
                is_map: false,
                caption: "Change of the log-odds of success per standard deviation, with 95 % intervals.".to_owned(),
                reading: model.map(|model| model.note.to_owned()).into_iter().collect(),
                table: tables::regression("Coefficients of the model with interactions", regression),
            })];
            blocks.extend(regression.cautions.iter().cloned().map(Block::Caution));
            blocks
        }
    };
    Section { id: "interactions", title: "Interactions".to_owned(), population: population(analysis), blocks }
}

fn drawn(analysis: &Analysis) -> Section {
    let success = &analysis.success;
    let mut blocks = vec![Block::Table(tables::stages(success))];
    blocks.extend(tables::by_weights(success).map(Block::Table));
    match &success.reweighted {
        Some(Finding::Estimated(found)) => blocks.push(Block::Text(format!(
            "{}. The region holds {} of the operating distribution.",
            sentence(&found.method),
            percent(found.region_share)
        ))),
        Some(Finding::CannotBeEstimated { because }) => blocks.push(cannot("The rate from all rows", because)),
        None => {}
    }
    if success.bounds.invalid > 0 || !success.bounds.faults.is_empty() {
        let faults: Vec<String> = success
            .bounds
            .faults
            .iter()
            .map(|f| format!("{} {}", count(f.episodes), f.fault.replace('_', " ")))
            .collect();
        blocks.push(Block::Caution(format!(
            "{} among the rows of the headline are no evidence. Faults over all stages: {}.",
            sentence(&counted(success.bounds.invalid, "invalid episode")),
            list(&faults)
        )));
    }
    blocks.push(Block::Folded(tables::ranges(&analysis.drawn)));
    blocks.extend(analysis.drawn.remarks.iter().cloned().map(Block::Caution));
    Section { id: "drawn", title: "How the points were drawn".to_owned(), population: None, blocks }
}

fn replay(analysis: &Analysis) -> Section {
    let mut blocks = Vec::new();
    let command = analysis.subject.replayable.then_some(analysis.subject.path.as_str());
    if analysis.replay.is_empty() {
        blocks.push(Block::Text("There is no episode that stands out.".to_owned()));
    } else if command.is_none() {
        blocks.push(Block::Text(
            "These rows are not a run's folder of this tool, so that they cannot be replayed; the index is the row's own."
                .to_owned(),
        ));
    }
    for group in &analysis.replay {
        blocks.push(Block::Heading(group.title.clone()));
        blocks.push(Block::Text(group.why.clone()));
        blocks.push(Block::Table(Table { title: String::new(), ..tables::replays(group, command) }));
    }
    Section { id: "replay", title: "Episodes worth replaying".to_owned(), population: None, blocks }
}

fn provenance(analysis: &Analysis) -> Section {
    let p = &analysis.provenance;
    let mut facts = vec![
        ("source".to_owned(), analysis.subject.path.clone()),
        ("dataset hash".to_owned(), analysis.subject.dataset_hash.clone()),
        ("episodes".to_owned(), count(analysis.subject.episodes)),
        ("robot".to_owned(), with_hash(&p.robot.name, p.robot.sha256.as_deref())),
        ("policy".to_owned(), p.policy.clone()),
        ("engine".to_owned(), with_hash(&analysis.subject.engine, p.engine.build_sha256.as_deref())),
        ("space".to_owned(), format!("{}, {}", p.space.name(), counted(p.space.len() as u64, "parameter"))),
        ("campaign seed".to_owned(), p.seed.to_string()),
        ("written by".to_owned(), format!("{} {}", p.tool.name, p.tool.version)),
        ("dictionary schema".to_owned(), p.schema_version.to_string()),
    ];
    if let Some(platform) = &p.platform {
        facts.push(("platform".to_owned(), format!("{} {}", platform.os, platform.arch)));
    }
    let mut blocks = Vec::new();
    let mut notes = Vec::new();
    if let Some(source) = &p.source {
        facts.push(("imported from".to_owned(), with_hash(&source.format.replace('_', " "), Some(&source.sha256))));
        notes.clone_from(&source.notes);
        notes.truncate(20);
    }
    facts.push(("analysis".to_owned(), format!("robogate {} form {}", env!("CARGO_PKG_VERSION"), analysis.version)));
    blocks.push(Block::Facts(facts));
    if !notes.is_empty() {
        blocks.push(Block::Heading("What the import had to decide".to_owned()));
        blocks.push(Block::List(notes.iter().map(|note| sentence(note)).collect()));
    }
    Section { id: "provenance", title: "Provenance".to_owned(), population: None, blocks }
}

fn with_hash(name: &str, hash: Option<&str>) -> String {
    match hash {
        Some(hash) => format!("{name}, sha256 {}", hash.get(..16).unwrap_or(hash)),
        None => name.to_owned(),
    }
}

fn limits(analysis: &Analysis) -> Section {
    Section {
        id: "limits",
        title: "What these figures do not say".to_owned(),
        population: None,
        blocks: vec![Block::List(limits_of(analysis))],
    }
}
