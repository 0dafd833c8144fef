//! Sampling: the stages, their weights, and the ranges of the parameters.

use robogate_analysis::labels::label_with_unit;
use robogate_analysis::{Analysis, Finding, Population, Sampling, Success};
use robogate_stats::format::{count, counted, list, number, percent, percent_or_dash, percent_range, range};

use super::{Block, Section, Table};
use crate::document::Kind::{Number, Short, Text};
use crate::document::MAX_ROWS;

pub(super) fn section(analysis: &Analysis) -> Section {
    let success = &analysis.success;
    let mut blocks = vec![Block::Table(stages_table(success))];
    blocks.extend(weighted_table(success).map(Block::Table));
    match &success.adjusted {
        Some(Finding::Estimated(found)) => blocks.push(Block::Text(format!(
            "With the known distribution of {} as a control variate (a linear model on their bins), the rate is {} with a standard \
             error of {} and a 95 % interval of {}.",
            counted(found.parameters, "parameter"),
            percent(found.rate),
            percent(found.se),
            percent_range(found.interval_95)
        ))),
        Some(Finding::CannotBeEstimated { because }) => {
            blocks.push(Block::cannot("An interval with the known distribution of the parameters", because));
        }
        None => {}
    }
    match &success.weighting {
        Some(Finding::Estimated(found)) => blocks.push(Block::Text(format!(
            "All {} count in every figure, {}: {} of them have points that were chosen, in a region with {} of the operating \
             distribution.",
            counted(found.rows, "valid episode"),
            found.method,
            count(found.chosen),
            percent(found.region_share)
        ))),
        Some(Finding::CannotBeEstimated { because }) => {
            blocks.push(Block::Text(format!("Episodes whose points were chosen are left out because {because}.")));
        }
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
            "The headline excludes {}, which give no information about the policy. Faults in all stages: {}.",
            counted(success.bounds.invalid, "invalid episode"),
            list(&faults)
        )));
    }
    blocks.push(Block::Folded(ranges_table(&analysis.sampling)));
    blocks.extend(analysis.sampling.warnings.iter().cloned().map(Block::Caution));
    Section { id: "sampling", title: "Sampling".to_owned(), population: None, blocks }
}

fn stages_table(success: &Success) -> Table {
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
        ("sampler", Short),
        ("episodes", Number),
        ("invalid", Number),
        ("success", Number),
        ("95 % interval", Number),
        ("exact 95 %", Number),
        ("weights", Number),
        ("effective n", Number),
        ("applies to", Text),
    ];
    Table::new("Stages", &columns, rows.collect()).at_most(MAX_ROWS)
}

fn weighted_table(success: &Success) -> Option<Table> {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for stage in &success.stages {
        if let Some(found) = stage.weighted {
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
        ("applies to", Text),
    ];
    (!rows.is_empty()).then(|| Table::new("Weighted rates (Hajek)", &columns, rows))
}

fn ranges_table(sampling: &Sampling) -> Table {
    let rows = sampling.ranges.iter().map(|r| {
        let focused = match (&r.focused, r.focused_from.as_deref()) {
            (Some(range), Some("bins")) => range.clone(),
            (Some(range), Some(source)) => format!("{range} ({})", source.replace('_', " ")),
            _ => "-".to_owned(),
        };
        vec![label_with_unit(&r.parameter), r.operating.clone(), r.scale.clone(), focused]
    });
    let columns = [("parameter", Text), ("operating space", Text), ("scale", Text), ("focused stage", Text)];
    Table::new("Ranges", &columns, rows.collect()).at_most(MAX_ROWS)
}
