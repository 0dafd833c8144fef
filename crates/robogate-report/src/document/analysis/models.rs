//! The risk model and the model with interactions.

use robogate_analysis::labels::parameter_label;
use robogate_analysis::{Analysis, CalibrationFigures, Finding, Regression, RiskModel, RocFigures, TaskAnalysis};
use robogate_stats::format::{count, fixed, list, number, p_value, percent, percent_range, range, significant};

use super::{Block, Figure, Section, Table, population};
use crate::document::Kind::{Number, Text};
use crate::document::{MAX_ROWS, or_dash};
use crate::figures;
use crate::text::predictor_about;

pub(super) fn risk(analysis: &Analysis) -> Section {
    let mut blocks = Vec::new();
    match &analysis.risk {
        Finding::CannotBeEstimated { because } => blocks.push(Block::cannot("A risk model", because)),
        Finding::Estimated(risk) => {
            blocks.push(match &risk.predictor {
                Finding::Estimated(model) => Block::Text(predictor_about(model)),
                Finding::CannotBeEstimated { because } => {
                    Block::Text(format!("The logistic model predicts, because {because}."))
                }
            });
            blocks.push(Block::Figure(coefficients(risk, analysis)));
            blocks.extend(risk.regression.warnings.iter().cloned().map(Block::Caution));
            if analysis.effects.by_scenario {
                let text = "Scenarios have several episodes. Intervals and p-values of the coefficients treat them as independent, \
                            and are too optimistic.";
                blocks.push(Block::Caution(text.to_owned()));
            }
            let mut figures = Vec::new();
            match &risk.roc {
                Finding::Estimated(roc) => figures.push(Figure {
                    title: "Discrimination".to_owned(),
                    svg: figures::roc(roc),
                    is_map: false,
                    caption: format!(
                        "ROC curves. Cross-validated: each of five folds is scored by a model of the other four.{}",
                        if analysis.effects.by_scenario {
                            " All episodes of a scenario are in one fold, and the intervals count scenarios."
                        } else {
                            ""
                        }
                    ),
                    findings: Vec::new(),
                    table: roc_table(roc, analysis.effects.by_scenario),
                }),
                Finding::CannotBeEstimated { because } => blocks.push(Block::cannot("A ROC curve", because)),
            }
            figures.extend(calibration(risk, analysis.effects.by_scenario));
            blocks.push(Block::Grid(figures));
            blocks.push(Block::Table(calibration_table(risk)));
            blocks.extend(penalties_table(risk).map(Block::Folded));
        }
    }
    Section { id: "risk", title: "Risk model".to_owned(), population: population(analysis), blocks }
}

fn coefficients(risk: &RiskModel, analysis: &Analysis) -> Figure {
    let form = if risk.paper_features {
        TaskAnalysis::of(&analysis.subject.task).risk_about
    } else {
        "The form of the paper's model, fitted to the parameters of this dataset instead of the paper's."
    };
    let rate = "failure rate, shrunk towards the overall rate by the weight of ten episodes";
    let penalty = if risk.logit_penalties { format!("the log-odds of its {rate}") } else { format!("its {rate}") };
    let coding = format!(
        "The penalty of a level is {penalty}. The paper does not define its penalties. Cross-validation chose this coding and \
         {}. The p-value of a penalty is that of a likelihood-ratio test of all levels, and its standard error is derived from \
         it.",
        if risk.logarithmic.is_empty() {
            "linear scales".to_owned()
        } else {
            format!(
                "a logarithmic scale for {}",
                list(&risk.logarithmic.iter().map(|p| parameter_label(p)).collect::<Vec<_>>())
            )
        }
    );
    let strongest = strongest(risk, analysis);
    Figure {
        title: "Effects on the risk of failure".to_owned(),
        svg: figures::coefficients(&risk.regression),
        is_map: false,
        caption: "Change of the log-odds of failure per standard deviation, with 95 % intervals.".to_owned(),
        findings: std::iter::once(form.to_owned()).chain(strongest).chain([coding]).collect(),
        table: regression_table("Coefficients of the risk model", &risk.regression),
    }
}

fn calibration(risk: &RiskModel, by_scenario: bool) -> Option<Figure> {
    let predictor = risk.predictor.estimated().and_then(|model| model.calibration_cross_validated.estimated());
    let (found, rows) = match (predictor, &risk.calibration_cross_validated, &risk.calibration_in_sample) {
        (Some(found), ..) => (found, "the model that predicts, cross-validated"),
        (None, Finding::Estimated(found), _) => (found, "the logistic model, cross-validated"),
        (None, _, Finding::Estimated(found)) => (found, "the logistic model, in sample"),
        _ => return None,
    };
    Some(Figure {
        title: "Calibration".to_owned(),
        svg: figures::reliability(found),
        is_map: false,
        caption: format!(
            "Observed failure rates by predicted probability, ten bins, {rows}. A calibrated model lies on the line.{}",
            if by_scenario { " The intervals allow for dependent episodes of a scenario." } else { "" }
        ),
        findings: Vec::new(),
        table: reliability_table(found),
    })
}

/// The term with the strongest effect, if the parameter may be named.
fn strongest(risk: &RiskModel, analysis: &Analysis) -> Option<String> {
    let regression = &risk.regression;
    let named = |term: &str| {
        let mut labels = analysis.effects.significant().map(|effect| parameter_label(&effect.parameter));
        labels.any(|label| term == label || term == format!("log {label}") || term == format!("{label} penalty"))
    };
    let (term, estimate) = regression
        .terms
        .iter()
        .filter(|t| named(&t.term))
        .filter_map(|t| Some((&t.term, t.estimate.estimated()?)))
        .max_by(|a, b| a.1.z.abs().total_cmp(&b.1.z.abs()))?;
    let change = if estimate.coefficient > 0.0 { "multiplies" } else { "divides" };
    Some(format!(
        "The strongest effect is that of {term}: one standard deviation more {change} the odds of {} by {}.",
        regression.outcome,
        number(estimate.coefficient.abs().exp())
    ))
}

pub(super) fn interactions(analysis: &Analysis) -> Section {
    let model = TaskAnalysis::of(&analysis.subject.task).interactions;
    let blocks = match &analysis.interactions {
        Finding::CannotBeEstimated { because } => vec![Block::cannot("The paper's model with interactions", because)],
        Finding::Estimated(regression) => {
            let mut blocks = vec![Block::Figure(Figure {
                title: "Effects on success".to_owned(),
                svg: figures::coefficients(regression),
                is_map: false,
                caption: "Change of the log-odds of success per standard deviation, with 95 % intervals.".to_owned(),
                findings: model.map(|model| model.note.to_owned()).into_iter().collect(),
                table: regression_table("Coefficients of the model with interactions", regression),
            })];
            blocks.extend(regression.warnings.iter().cloned().map(Block::Caution));
            blocks
        }
    };
    Section { id: "interactions", title: "Interactions".to_owned(), population: population(analysis), blocks }
}

/// The coefficients of a regression.
pub(super) fn regression_table(title: &str, regression: &Regression) -> Table {
    let rows = regression.terms.iter().map(|term| match &term.estimate {
        Finding::Estimated(e) => vec![
            term.term.clone(),
            significant(e.coefficient, 4),
            number(e.se),
            fixed(e.z, 2),
            p_value(e.ln_p),
            range(e.interval_95),
        ],
        Finding::CannotBeEstimated { because } => {
            let mut row = vec![format!("{} (excluded: {because})", term.term)];
            row.extend(vec!["-".to_owned(); 5]);
            row
        }
    });
    let columns =
        [("term", Text), ("coefficient", Number), ("se", Number), ("z", Number), ("p", Number), ("95 %", Number)];
    let mut table = Table::new(title, &columns, rows.collect()).at_most(MAX_ROWS);
    let how = match regression.estimator.as_str() {
        "firth" => "Firth's penalised likelihood",
        _ => "Maximum likelihood",
    };
    let scale = if regression.standardized { "per standard deviation" } else { "per unit" };
    table.remark = Some(format!(
        "{how}, {} rows, log-odds of {} {scale}; deviance {} compared with {} of the intercept-only model.",
        count(regression.rows),
        regression.outcome,
        fixed(regression.deviance, 1),
        fixed(regression.null_deviance, 1)
    ));
    table
}

fn roc_table(figures: &RocFigures, by_scenario: bool) -> Table {
    let both = |[low, high]: [f64; 2]| format!("{} to {}", fixed(low, 4), fixed(high, 4));
    let cross_validated = or_dash(figures.auc_cross_validated, |a| fixed(a, 4));
    let rows = vec![
        vec!["cross-validated, 5 folds".to_owned(), cross_validated, both(figures.auc_cross_validated_95)],
        vec!["in sample".to_owned(), fixed(figures.auc_in_sample, 4), both(figures.auc_in_sample_95)],
    ];
    let interval = if by_scenario { "95 % (Obuchowski)" } else { "95 % (DeLong)" };
    let columns = [("rows", Text), ("AUC", Number), (interval, Number)];
    Table::new("Area under the ROC curve", &columns, rows)
}

fn calibration_table(risk: &RiskModel) -> Table {
    let row = |label: &str, found: &Finding<CalibrationFigures>| match found {
        Finding::Estimated(f) => vec![
            label.to_owned(),
            fixed(f.brier, 4),
            fixed(f.base_rate_brier, 4),
            f.log_loss.map_or_else(|| "infinite".to_owned(), |l| fixed(l, 4)),
            fixed(f.expected_calibration_error, 4),
        ],
        Finding::CannotBeEstimated { because } => {
            let mut row = vec![format!("{label}: cannot be estimated because {because}")];
            row.extend(vec!["-".to_owned(); 4]);
            row
        }
    };
    let predictor = risk.predictor.estimated();
    let rows = predictor
        .map(|model| row("model that predicts, cross-validated", &model.calibration_cross_validated))
        .into_iter()
        .chain([
            row("logistic, cross-validated", &risk.calibration_cross_validated),
            row("logistic, in sample", &risk.calibration_in_sample),
        ])
        .collect();
    let columns = [
        ("rows", Text),
        ("Brier score", Number),
        ("of the overall rate", Number),
        ("log loss", Number),
        ("ECE, 10 bins", Number),
    ];
    Table::new("Calibration", &columns, rows)
}

fn reliability_table(figures: &CalibrationFigures) -> Table {
    let rows = figures.bins.iter().map(|bin| {
        vec![count(bin.rows), percent(bin.predicted), percent(bin.observed), percent_range(bin.interval_95)]
    });
    let columns = [("n", Number), ("predicted", Number), ("observed", Number), ("95 % interval", Number)];
    Table::new("Predicted and observed failure rates", &columns, rows.collect())
}

fn penalties_table(risk: &RiskModel) -> Option<Table> {
    let rows: Vec<Vec<String>> = risk
        .penalties
        .iter()
        .flat_map(|p| {
            p.levels.iter().map(|l| vec![parameter_label(&p.parameter), l.level.clone(), fixed(l.penalty, 4)])
        })
        .collect();
    let columns = [("parameter", Text), ("level", Text), ("penalty", Number)];
    (!rows.is_empty()).then(|| Table::new("Penalties of the levels", &columns, rows).at_most(MAX_ROWS))
}
