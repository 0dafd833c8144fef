//! Figures as tables.

use super::Kind::{Code, Number, Short, Text, Zone as ZoneWord};
use super::Table;
use robogate_analysis::labels::{mode_label, parameter_label, value_with_unit};
use robogate_analysis::shell_word;
use robogate_analysis::{
    Along, CalibrationFigures, CriticalThreshold, DangerZones, FailureModes, Finding, Frontier, HowDrawn, ModeChanges,
    PairMap, Population, Regression, ReplayGroup, RiskModel, RocFigures, Success,
};
use robogate_stats::format::{
    count, fixed, number, p_value, percent, percent_or_dash, percent_range, range, significant,
};

/// Most rows of one table on the page, whatever the data.
const MOST: usize = 60;

pub(crate) fn stages(success: &Success) -> Table {
    let rows = success.stages.iter().map(|stage| {
        let weights = match stage.weights {
            Some([low, high]) if (high - low).abs() <= 0.0 => number(low),
            Some(both) => range(both),
            None => "-".to_owned(),
        };
        vec![
            stage.stage.clone(),
            stage.designs.join(", ").replace('_', " "),
            count(stage.episodes),
            count(stage.invalid),
            percent_or_dash(stage.rate.rate),
            percent_range(stage.rate.wilson_95),
            percent_range(stage.rate.clopper_pearson_95),
            weights,
            count(stage.effective_sample_size.round() as u64),
            stage.population.brief().to_owned(),
        ]
    });
    let columns = [
        ("stage", Text),
        ("drawn by", Short),
        ("episodes", Number),
        ("invalid", Number),
        ("success", Number),
        ("Wilson 95 %", Number),
        ("exact 95 %", Number),
        ("weights", Number),
        ("effective n", Number),
        ("speaks of", Text),
    ];
    Table::new("Stages", &columns, rows.collect()).at_most(MOST)
}

pub(crate) fn by_weights(success: &Success) -> Option<Table> {
    let mut rows: Vec<Vec<String>> = Vec::new();
    if let Some(found) = success.reweighted.as_ref().and_then(Finding::estimated) {
        rows.push(vec![
            "all rows".to_owned(),
            percent(found.estimate.rate),
            percent_range(found.estimate.interval_95),
            count(found.rows),
            count(found.estimate.effective_sample_size.round() as u64),
            Population::Reweighted.brief().to_owned(),
        ]);
    }
    for stage in &success.stages {
        if let Some(found) = stage.by_weights {
            rows.push(vec![
                format!("{} stage", stage.stage),
                percent(found.rate),
                percent_range(found.interval_95),
                count(stage.rate.n),
                count(found.effective_sample_size.round() as u64),
                Population::FocusedRegion.brief().to_owned(),
            ]);
        }
    }
    let columns = [
        ("rows", Text),
        ("success", Number),
        ("95 %", Number),
        ("n", Number),
        ("effective n", Number),
        ("speaks of", Text),
    ];
    (!rows.is_empty()).then(|| Table::new("By weights (Hajek)", &columns, rows))
}

pub(crate) fn cells(along: &Along) -> Table {
    let rows = along.cells.iter().map(|cell| {
        vec![
            cell.label.clone(),
            count(cell.rate.n),
            count(cell.rate.successes),
            percent_or_dash(cell.rate.rate),
            percent_range(cell.rate.wilson_95),
            percent_range(cell.rate.clopper_pearson_95),
            cell.zone.word().to_owned(),
        ]
    });
    let head = match along.unit.as_str() {
        "" => along.label.clone(),
        unit => format!("{} ({unit})", along.label),
    };
    let columns = [
        (head.as_str(), Short),
        ("n", Number),
        ("succeeded", Number),
        ("success", Number),
        ("Wilson 95 %", Number),
        ("exact 95 %", Number),
        ("zone, level shared", ZoneWord),
    ];
    Table::new(format!("Success along {}", along.label), &columns, rows.collect()).at_most(MOST)
}

pub(crate) fn map(map: &PairMap) -> Table {
    let nx = map.x.cells().max(1);
    let rows = map.cells.iter().enumerate().map(|(i, cell)| {
        vec![
            map.y.cell_label(i / nx),
            map.x.cell_label(i % nx),
            count(cell.rate.n),
            percent_or_dash(cell.rate.rate),
            percent_range(cell.rate.wilson_95),
            cell.zone.word().to_owned(),
        ]
    });
    let (y, x) = (parameter_label(&map.y.parameter), parameter_label(&map.x.parameter));
    let columns = [
        (y.as_str(), Short),
        (x.as_str(), Short),
        ("n", Number),
        ("success", Number),
        ("Wilson 95 %", Number),
        ("zone, level shared", ZoneWord),
    ];
    Table::new(format!("Cells of {y} \u{d7} {x}"), &columns, rows.collect()).at_most(100)
}

pub(crate) fn curve(frontier: &Frontier) -> Table {
    let rows = frontier.curve.iter().step_by(4).map(|point| {
        vec![
            number(point.y),
            number(point.x),
            number(point.se),
            range(point.band_95),
            point.exact_95.map_or_else(|| "not bounded".to_owned(), range),
            if point.observed { "yes" } else { "extrapolated" }.to_owned(),
        ]
    });
    let (y, x) = (parameter_label(&frontier.y), format!("{}*", parameter_label(&frontier.x)));
    let columns = [
        (y.as_str(), Number),
        (x.as_str(), Number),
        ("se", Number),
        ("95 % band", Number),
        ("exact 95 %", Number),
        ("observed", Text),
    ];
    Table::new("Points of the frontier", &columns, rows.collect())
}

pub(crate) fn regression(title: &str, regression: &Regression) -> Table {
    let rows = regression.terms.iter().map(|term| match &term.found {
        Finding::Estimated(e) => vec![
            term.term.clone(),
            significant(e.coefficient, 4),
            number(e.se),
            fixed(e.z, 2),
            p_value(e.ln_p),
            range(e.interval_95),
        ],
        Finding::CannotBeEstimated { because } => {
            let mut row = vec![format!("{} (left out: {because})", term.term)];
            row.extend(vec!["-".to_owned(); 5]);
            row
        }
    });
    let columns =
        [("term", Text), ("coefficient", Number), ("se", Number), ("z", Number), ("p", Number), ("95 %", Number)];
    let mut table = Table::new(title, &columns, rows.collect()).at_most(MOST);
    let how = match regression.estimator.as_str() {
        "firth" => "Firth's penalised likelihood",
        _ => "Maximum likelihood",
    };
    let scale = if regression.standardized { "per standard deviation" } else { "per unit" };
    table.remark = Some(format!(
        "{how}, {} rows, log-odds of {} {scale}; deviance {} against {} of the intercept alone.",
        count(regression.rows),
        regression.outcome,
        fixed(regression.deviance, 1),
        fixed(regression.null_deviance, 1)
    ));
    table
}

pub(crate) fn thresholds(along: &[Along]) -> Table {
    let rows = along.iter().filter(|a| !matches!(a.kind, robogate_analysis::AlongKind::Categorical)).map(|a| {
        let unit = |x: f64| value_with_unit(&number(x), &a.parameter);
        let (at, ci, se, what) = match &a.threshold {
            Finding::Estimated(CriticalThreshold::Crosses { at, rising, low, high, se, crossing_share }) => {
                let end = |x: &Option<f64>| x.map_or_else(|| "beyond".to_owned(), number);
                (
                    unit(*at),
                    format!("{} to {}", end(low), end(high)),
                    se.map_or_else(|| "-".to_owned(), number),
                    format!(
                        "success {} through it; {} of replicates cross",
                        if *rising { "rises" } else { "falls" },
                        percent(*crossing_share)
                    ),
                )
            }
            Finding::Estimated(CriticalThreshold::CrossesMoreThanOnce { between }) => {
                let between: Vec<String> = between.iter().map(|b| range(*b)).collect();
                (
                    "-".to_owned(),
                    "-".to_owned(),
                    "-".to_owned(),
                    format!("crosses more than once: {}", between.join("; ")),
                )
            }
            Finding::Estimated(CriticalThreshold::DoesNotCross { stays_above, crossing_share }) => {
                ("-".to_owned(), "-".to_owned(), "-".to_owned(), {
                    let side = if *stays_above { "above" } else { "below" };
                    if *crossing_share > 0.05 {
                        let share = percent(*crossing_share);
                        format!("stays {side} 50 % as observed, yet {share} of replicates cross: unsure")
                    } else {
                        format!("does not cross: stays {side} 50 %")
                    }
                })
            }
            Finding::CannotBeEstimated { because } => {
                ("-".to_owned(), "-".to_owned(), "-".to_owned(), format!("cannot be estimated because {because}"))
            }
        };
        let r = a.correlation.estimated();
        let (r, spearman, p) = match r {
            Some(robogate_analysis::Correlation::Number { point_biserial, ln_p, spearman, .. }) => (
                fixed(*point_biserial, 3),
                spearman.map_or_else(|| "-".to_owned(), |s| fixed(s, 3)),
                ln_p.map_or_else(|| "-".to_owned(), p_value),
            ),
            _ => ("-".to_owned(), "-".to_owned(), "-".to_owned()),
        };
        vec![a.label.clone(), what, at, ci, se, r, spearman, p]
    });
    let columns = [
        ("parameter", Short),
        ("what was found", Text),
        ("50 % at", Number),
        ("95 %", Number),
        ("se", Number),
        ("correlation", Number),
        ("rank", Number),
        ("p", Number),
    ];
    Table::new("Critical thresholds and correlations with success", &columns, rows.collect())
        .at_most(MOST)
        .without_empty()
}

pub(crate) fn categories(along: &[Along]) -> Option<Table> {
    let rows: Vec<Vec<String>> = along
        .iter()
        .filter(|a| matches!(a.kind, robogate_analysis::AlongKind::Categorical))
        .map(|a| match &a.correlation {
            Finding::Estimated(robogate_analysis::Correlation::Category { cramers_v, ln_p, smallest_expected }) => {
                let rough = if *smallest_expected < 5.0 { " (rough: a level is rare)" } else { "" };
                vec![a.label.clone(), fixed(*cramers_v, 3), format!("{}{rough}", p_value(*ln_p))]
            }
            Finding::Estimated(_) => vec![a.label.clone(), "-".to_owned(), "-".to_owned()],
            Finding::CannotBeEstimated { because } => {
                vec![a.label.clone(), "-".to_owned(), format!("cannot be estimated because {because}")]
            }
        })
        .collect();
    let columns = [("category", Text), ("Cramer's V", Number), ("p of independence", Number)];
    (!rows.is_empty()).then(|| Table::new("Categories and success", &columns, rows))
}

pub(crate) fn failure_modes(modes: &FailureModes) -> Table {
    let rows = modes
        .modes
        .iter()
        .map(|m| vec![mode_label(&m.mode), count(m.failures), percent_or_dash(m.share), percent_range(m.interval_95)]);
    let columns = [("mode", Text), ("failures", Number), ("share", Number), ("95 %, jointly", Number)];
    Table::new("Failures by mode", &columns, rows.collect())
}

pub(crate) fn mode_changes(label: &str, changes: &ModeChanges, modes: &FailureModes) -> Table {
    let rows = changes.bins.iter().map(|bin| {
        let mut row = vec![range(bin.range), count(bin.counts.iter().sum())];
        row.extend(bin.counts.iter().map(|n| count(*n)));
        row.push(bin.dominant.as_deref().map_or_else(|| "-".to_owned(), mode_label));
        row.push(percent_or_dash(bin.share));
        row.push(if bin.sure { "sure" } else { "not sure" }.to_owned());
        row
    });
    let heads: Vec<String> = modes.modes.iter().map(|m| mode_label(&m.mode)).collect();
    let mut columns = vec![(label, Short), ("failures", Number)];
    columns.extend(heads.iter().map(|h| (h.as_str(), Number)));
    columns.extend([("dominant", Text), ("share", Number), ("ahead of the second", Short)]);
    Table::new(format!("Failure modes along {label}"), &columns, rows.collect())
}

pub(crate) fn danger(zones: &DangerZones) -> Table {
    let rows = zones.zones.iter().map(|zone| {
        vec![
            parameter_label(&zone.parameter),
            value_with_unit(&zone.cell, &zone.parameter),
            percent_or_dash(zone.rate.rate),
            percent_range(zone.rate.wilson_95),
            count(zone.rate.n),
            p_value(zone.ln_p),
            if zone.holm_p > 0.0 { p_value(zone.holm_p.ln()) } else { "0".to_owned() },
            if zone.sure { "sure" } else { "not sure" }.to_owned(),
        ]
    });
    let columns = [
        ("parameter", Text),
        ("bin or level", Short),
        ("success", Number),
        ("Wilson 95 %", Number),
        ("n", Number),
        ("p, below 40 %", Number),
        ("p by Holm", Number),
        ("verdict", Short),
    ];
    Table::new("Bins and levels observed below 40 % success", &columns, rows.collect()).at_most(MOST)
}

pub(crate) fn roc(figures: &RocFigures) -> Table {
    let unseen = figures.auc_cross_validated.map_or_else(|| "-".to_owned(), |a| fixed(a, 4));
    let both = |[low, high]: [f64; 2]| format!("{} to {}", fixed(low, 4), fixed(high, 4));
    let rows = vec![
        vec!["cross-validated, 5 folds".to_owned(), unseen, both(figures.auc_cross_validated_95)],
        vec!["in sample".to_owned(), fixed(figures.auc_in_sample, 4), both(figures.auc_in_sample_95)],
    ];
    let columns = [("rows judged", Text), ("AUC", Number), ("95 % (DeLong)", Number)];
    Table::new("Area under the ROC curve", &columns, rows)
}

pub(crate) fn calibration(risk: &RiskModel) -> Table {
    let row = |label: &str, found: &Finding<CalibrationFigures>| match found {
        Finding::Estimated(f) => vec![
            label.to_owned(),
            fixed(f.brier, 4),
            fixed(f.brier_of_the_rate, 4),
            f.log_loss.map_or_else(|| "infinite".to_owned(), |l| fixed(l, 4)),
            fixed(f.expected_calibration_error, 4),
        ],
        Finding::CannotBeEstimated { because } => {
            let dash = || "-".to_owned();
            vec![format!("{label}: cannot be estimated because {because}"), dash(), dash(), dash(), dash()]
        }
    };
    let rows =
        vec![row("cross-validated", &risk.calibration_cross_validated), row("in sample", &risk.calibration_in_sample)];
    let columns = [
        ("rows judged", Text),
        ("Brier", Number),
        ("of the bare rate", Number),
        ("log loss", Number),
        ("ECE, 10 bins", Number),
    ];
    Table::new("Calibration", &columns, rows)
}

pub(crate) fn reliability(figures: &CalibrationFigures) -> Table {
    let rows = figures
        .bins
        .iter()
        .map(|bin| vec![count(bin.rows), percent(bin.stated), percent(bin.observed), percent_range(bin.interval_95)]);
    let columns = [("n", Number), ("stated", Number), ("observed", Number), ("Wilson 95 %", Number)];
    Table::new("Stated and observed failure rates", &columns, rows.collect())
}

pub(crate) fn penalties(risk: &RiskModel) -> Option<Table> {
    let rows: Vec<Vec<String>> = risk
        .penalties
        .iter()
        .flat_map(|p| {
            p.levels.iter().map(|l| vec![parameter_label(&p.parameter), l.level.clone(), fixed(l.penalty, 4)])
        })
        .collect();
    let columns = [("parameter", Text), ("level", Text), ("penalty", Number)];
    (!rows.is_empty()).then(|| Table::new("Penalties of the levels", &columns, rows).at_most(MOST))
}

pub(crate) fn ranges(drawn: &HowDrawn) -> Table {
    let rows = drawn.ranges.iter().map(|r| {
        let focused = match (&r.focused, r.focused_from.as_deref()) {
            (Some(range), Some("bins")) => range.clone(),
            (Some(range), Some(why)) => format!("{range} ({})", why.replace('_', " ")),
            _ => "-".to_owned(),
        };
        vec![with_unit_head(&r.parameter), r.operating.clone(), r.scale.clone(), focused]
    });
    let columns = [("parameter", Text), ("operating space", Text), ("even in", Text), ("focused stage", Text)];
    Table::new("Ranges", &columns, rows.collect()).at_most(MOST)
}

fn with_unit_head(parameter: &str) -> String {
    robogate_analysis::labels::label_with_unit(parameter)
}

pub(crate) fn replays(group: &ReplayGroup, command: Option<&str>) -> Table {
    let rows = group.episodes.iter().map(|episode| {
        let parameters: Vec<String> = episode
            .parameters
            .iter()
            .take(12)
            .map(|(parameter, value)| format!("{} {}", parameter_label(parameter), value_with_unit(value, parameter)))
            .collect();
        vec![
            match command {
                Some(folder) => format!("robogate replay {} {}", shell_word(folder), episode.index),
                None => episode.index.to_string(),
            },
            episode.outcome.replace('_', " "),
            if episode.figure.is_empty() { "-".to_owned() } else { episode.figure.clone() },
            parameters.join(", "),
        ]
    });
    let columns = [
        if command.is_some() { ("command", Code) } else { ("index", Number) },
        ("outcome", Short),
        ("why here", Short),
        ("parameters", Text),
    ];
    Table::new(group.title.clone(), &columns, rows.collect())
}
