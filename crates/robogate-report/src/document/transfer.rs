//! The document of a transfer to the real robot.

use robogate_analysis::Finding;
use robogate_analysis::labels::{mode_label, parameter_label, parameter_or_level};
use robogate_analysis::transfer::{CorrectedMap, Transfer, WithInterval};
use robogate_stats::format::{count, counted, fixed, percent, percent_range, range, sentence};

use super::Kind::{Number, Short, Text};
use super::map::{map_table, map_title, map_zones};
use super::{Block, Document, Figure, Section, Table, plain_p};
use crate::figures::{self, Boundary, heatmap};
use crate::text::{TransferHeadline, next_trials};

pub(crate) fn transfer_document(of: &Transfer) -> Document {
    let headline = TransferHeadline::of(of);
    // The scale shows the best figure that exists.
    let mut shown = of.alone;
    let (figure, interval) = match of.rate.estimated() {
        Some(found) => {
            shown.rate = Some(found.rate);
            shown.wilson_95 = found.interval_95;
            (percent(found.rate), percent_range(found.interval_95))
        }
        None => (super::or_dash(of.alone.rate, percent), percent_range(of.alone.wilson_95)),
    };
    Document {
        kind: "transfer",
        title: format!("{} policy on the real {}", sentence(&of.simulation.policy), of.simulation.robot),
        subtitle: format!(
            "{} trials of the real robot, {} episodes in {}",
            count(of.real.trials),
            count(of.simulation.episodes),
            of.simulation.engine
        ),
        figure,
        figure_label: "real success rate".to_owned(),
        interval: format!("95 % interval {interval}"),
        scale: figures::rate_scale(&shown, None),
        answer: headline.answer,
        columns: [
            ("What the simulation adds", headline.what_the_simulation_adds),
            ("What differs", headline.what_differs),
            ("Assumptions", headline.limits),
        ]
        .into_iter()
        .filter(|(_, lines)| !lines.is_empty())
        .collect(),
        sections: [
            Some(rates(of)),
            Some(map(of)),
            of.next.as_ref().map(|_| next(of)),
            Some(correction(of)),
            Some(differences(of)),
        ]
        .into_iter()
        .flatten()
        .collect(),
        verdict: None,
    }
}

fn rates(of: &Transfer) -> Section {
    let row = |name: &str, rate: Option<f64>, interval: [f64; 2], how: &str| {
        vec![name.to_owned(), super::or_dash(rate, percent), percent_range(interval), how.to_owned()]
    };
    let mut rows = Vec::new();
    let mut blocks = Vec::new();
    let grouped = of.alone.clusters.is_some();
    let by_group = |independent: &'static str| if grouped { "by group (Korn and Graubard)" } else { independent };
    match of.rate.estimated() {
        Some(found) => {
            rows.push(row(
                "trials and simulation",
                Some(found.rate),
                found.interval_95,
                "prediction-powered, cross-fitted",
            ));
            rows.push(row("trials alone", of.alone.rate, found.alone_95, "Wilson"));
        }
        None => {
            blocks.push(Block::cannot("The real rate with the simulation", of.rate.because().unwrap_or_default()));
            rows.push(row("trials alone", of.alone.rate, of.alone.wilson_95, by_group("Wilson")));
        }
    }
    match of.exact.estimated() {
        // That of the trials alone, which is the next row.
        Some(exact) if exact.strata[0].share <= 0.0 => {}
        Some(exact) => rows.push(row("trials and simulation", None, exact.interval_95, "exact, two strata")),
        None => blocks.push(Block::cannot("The exact interval", of.exact.because().unwrap_or_default())),
    }
    rows.push(row("trials alone", of.alone.rate, of.alone.clopper_pearson_95, by_group("exact (Clopper-Pearson)")));
    rows.push(row("simulation", of.simulated.rate, of.simulated.wilson_95, "Wilson"));
    let columns = [("source", Short), ("success", Number), ("95 % interval", Number), ("method", Text)];
    blocks.insert(0, Block::Table(Table::new("Success rates", &columns, rows)));
    Section {
        id: "rates",
        title: "Success rates".to_owned(),
        population: Some(format!("Rates of the real robot apply to {}.", of.population)),
        blocks,
    }
}

fn next(of: &Transfer) -> Section {
    let mut blocks = Vec::new();
    if let Some(next) = &of.next {
        let rows = next
            .settings
            .iter()
            .map(|trial| vec![trial.setting.clone(), percent(trial.simulated), percent(trial.expected)]);
        blocks.push(Block::Text(format!(
            "These settings are a random sample of the population with one from each tenth by predicted success. {}",
            next_trials(next)
        )));
        let columns = [("setting", Text), ("simulated success", Number), ("corrected", Number)];
        blocks.push(Block::Table(Table::new("Trials to run next", &columns, rows.collect())));
    }
    Section { id: "next", title: "Trials to run next".to_owned(), population: None, blocks }
}

fn correction(of: &Transfer) -> Section {
    let of_rate = |rate: &WithInterval| format!("{} ({})", percent(rate.mean), percent_range(rate.interval_95));
    let number = |of: &WithInterval| format!("{} ({})", fixed(of.mean, 2), range(of.interval_95));
    let correction = &of.correction;
    let boundary = correction
        .boundary
        .as_ref()
        .map_or_else(|| "not shown: the trials do not show that the slope is positive".to_owned(), of_rate);
    let rows = correction.curve.iter().map(|at| vec![percent(at.simulated), of_rate(&at.real)]);
    let mut facts = vec![
        ("shift (0: the simulation is right)".to_owned(), number(&correction.shift)),
        ("slope (1: right, 0: no relation)".to_owned(), number(&correction.slope)),
    ];
    facts.extend(correction.parameters.iter().map(|of| {
        let name = parameter_or_level(&of.parameter, of.level.as_deref());
        (format!("effect of {name} (for one standard deviation)"), number(&of.effect))
    }));
    facts.push(("simulated success where the real one is 50 %".to_owned(), boundary));
    Section {
        id: "correction",
        title: "Corrected risk model".to_owned(),
        population: None,
        blocks: vec![
            Block::Text(if correction.parameters.is_empty() {
                "Log-odds of real success = shift + slope x log-odds of simulated success.".to_owned()
            } else {
                "Log-odds of real success = shift + slope x log-odds of simulated success + the effects of single parameters, \
                 which the trials show beyond the simulation. Shift and the rates below apply where these parameters have \
                 their means."
                    .to_owned()
            }),
            Block::Facts(facts),
            Block::Table(Table::new(
                "Real success by simulated success",
                &[("simulated", Number), ("real (95 %)", Number)],
                rows.collect(),
            )),
        ],
    }
}

fn map(of: &Transfer) -> Section {
    let block = match &of.map {
        Finding::Estimated(map) => Block::Figure(map_figure(map, !of.correction.parameters.is_empty())),
        Finding::CannotBeEstimated { because } => Block::cannot("The map of the corrected model", because),
    };
    Section {
        id: "real-map",
        title: "Real success by two parameters".to_owned(),
        population: None,
        blocks: vec![block],
    }
}

fn map_figure(of: &CorrectedMap, with_effects: bool) -> Figure {
    let map = &of.map;
    let mut findings = vec![map_zones(map)];
    let target = format!("{:.0} %", 100.0 * of.target);
    findings.push(match &of.contour {
        Finding::CannotBeEstimated { because } => format!("The {target} contour is not drawn because {because}."),
        Finding::Estimated(curves) if curves.is_empty() => {
            format!("The corrected model predicts {target} real success nowhere on this map.")
        }
        Finding::Estimated(_) => format!(
            "On the line, the corrected model predicts {target} real success. In the band, the 95 % interval contains {target}."
        ),
    });
    findings.push(format!(
        "Each rate is a mean over the other parameters of {} of the population. Intervals include the uncertainty of {}, \
         but not that of the model of the simulation.",
        counted(of.settings, "setting"),
        if with_effects { "shift, slope and effects" } else { "shift and slope" }
    ));
    if map.outside > 0 {
        findings.push(format!(
            "{} {} not on the map, because a value is missing.",
            counted(map.outside, "trial"),
            if map.outside == 1 { "is" } else { "are" }
        ));
    }
    Figure {
        title: map_title(map),
        svg: heatmap(map, Boundary::Corrected(of), "corrected"),
        is_map: true,
        caption: "Real success in percent by the corrected model, with the number of real trials below it. These are the two \
                  numeric parameters with the most influence in the simulation."
            .to_owned(),
        findings,
        table: map_table(map, "trials"),
    }
}

fn differences(of: &Transfer) -> Section {
    let endings = of.endings.iter().map(|ending| {
        vec![
            mode_label(&ending.ending),
            percent(ending.real),
            percent_range(ending.real_95),
            percent(ending.simulated),
            plain_p(ending.adjusted_p),
        ]
    });
    let parameters = of.parameters.iter().map(|parameter| {
        vec![
            parameter_label(&parameter.parameter),
            parameter.level.as_deref().map_or_else(|| "-".to_owned(), mode_label),
            fixed(parameter.effect, 2),
            range(parameter.interval_95),
            plain_p(parameter.adjusted_p),
        ]
    });
    let settings = of
        .settings
        .iter()
        .map(|check| vec![parameter_label(&check.parameter), count(check.trials), plain_p(check.adjusted_p)]);
    let ending_columns =
        [("ending", Short), ("real", Number), ("95 %", Number), ("simulated", Number), ("adjusted p", Number)];
    let parameter_columns =
        [("parameter", Short), ("level", Short), ("log-odds per sd", Number), ("95 %", Number), ("adjusted p", Number)];
    let setting_columns = [("parameter", Short), ("trials", Number), ("adjusted p", Number)];
    Section {
        id: "differences",
        title: "Where simulation and reality differ".to_owned(),
        population: None,
        blocks: vec![
            Block::Table(Table::new("Endings", &ending_columns, endings.collect())),
            Block::Folded(
                Table::new("Effects of parameters beyond shift and slope", &parameter_columns, parameters.collect())
                    .without_empty(),
            ),
            Block::Folded(Table::new("Settings of the trials: random sample?", &setting_columns, settings.collect())),
        ],
    }
}
