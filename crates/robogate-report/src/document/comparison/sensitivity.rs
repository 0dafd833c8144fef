//! The effect of the parameter that the task declares for comparisons.

use robogate_analysis::labels::{parameter_label, value_with_unit};
use robogate_analysis::{Comparison, Effect, Finding, Sensitivity};
use robogate_stats::format::{fixed, number, p_value, percent_or_dash, percent_range, range, sentence};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Text};
use crate::document::or_dash;
use crate::figures;

pub(super) fn section(of: &Comparison) -> Section {
    let (title, block) = match &of.sensitivity {
        Finding::Estimated(found) => {
            let label = parameter_label(&found.parameter);
            (format!("Effect of {label}"), Block::Figure(figure(found, &label)))
        }
        Finding::CannotBeEstimated { because } => {
            ("Effect of one parameter".to_owned(), Block::cannot("The effect", because))
        }
    };
    Section { id: "sensitivity", title, population: population(of), blocks: vec![block] }
}

fn figure(found: &Sensitivity, label: &str) -> Figure {
    Figure {
        title: format!(
            "Slope of the log-odds over ln({label}), {}",
            value_with_unit(&range(found.range), &found.parameter)
        ),
        svg: figures::sensitivity(found),
        is_map: false,
        caption: format!("Logistic regression of success on ln({label}) only, over the range that all datasets cover."),
        findings: found.effects.iter().map(|effect| finding(effect, label)).collect(),
        table: table(found, label),
    }
}

fn finding(effect: &Effect, label: &str) -> String {
    match &effect.slope {
        Finding::Estimated(slope) => format!(
            "{}: doubling {label} multiplies the odds of success by {}{}.",
            effect.name,
            number(slope.odds_per_doubling),
            if slope.penalised { " (Firth's penalised fit, because the outcomes are separated)" } else { "" }
        ),
        Finding::CannotBeEstimated { because } => format!("{}: cannot be estimated because {because}.", effect.name),
    }
}

fn table(found: &Sensitivity, label: &str) -> Table {
    let values = |both: [f64; 2]| value_with_unit(&range(both), &found.parameter);
    let rows = found.effects.iter().map(|effect| {
        let slope = effect.slope.estimated();
        let end = |end: Option<f64>| end.map_or_else(|| "unbounded".to_owned(), |end| fixed(end, 2));
        vec![
            effect.name.clone(),
            or_dash(slope, |s| fixed(s.per_log_unit, 3)),
            or_dash(slope, |s| format!("{} to {}", end(s.interval_95[0]), end(s.interval_95[1]))),
            or_dash(slope, |s| format!("\u{d7} {}", number(s.odds_per_doubling))),
            or_dash(slope, |s| p_value(s.ln_p)),
            format!("{} ({})", percent_or_dash(effect.low.rate), percent_range(effect.low.wilson_95)),
            format!("{} ({})", percent_or_dash(effect.high.rate), percent_range(effect.high.wilson_95)),
        ]
    });
    let heads = [format!("success at {}", values(found.low)), format!("success at {}", values(found.high))];
    let columns = [
        ("dataset", Text),
        ("slope", Number),
        ("95 %", Number),
        ("odds per doubling", Number),
        ("p", Number),
        (heads[0].as_str(), Number),
        (heads[1].as_str(), Number),
    ];
    Table::new(sentence(label), &columns, rows.collect())
}
