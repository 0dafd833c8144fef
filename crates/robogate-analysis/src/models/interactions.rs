//! The published logistic model of a task: standardised main effects and products of them.

use robogate_stats::clusters::Clusters;
use robogate_stats::format::list;
use robogate_stats::logistic::{Data, Options, Scale, fit, interaction, standardized};

use super::{Regression, why};
use crate::Finding;
use crate::labels::parameter_label;
use crate::table::Sample;
use crate::task::{InteractionModel, TaskAnalysis};

/// Fits the interaction model that the task publishes.
pub(crate) fn interactions(base: &Sample, task: &TaskAnalysis) -> Finding<Regression> {
    let Some(model) = &task.interactions else {
        return Finding::not("no model with interactions is published for this task");
    };
    if let Some(missing) = missing(base, model) {
        return Finding::not(format!("the dataset has no {missing}, which the paper's model needs"));
    }
    let columns: Vec<&[f64]> =
        model.main.iter().filter_map(|m| base.parameter(m)).map(|p| p.values.as_slice()).collect();
    // A constant column is not standardised; the fit reports it.
    let scaled: Vec<Vec<f64>> = columns.iter().map(|c| standardized(c).unwrap_or_else(|| c.to_vec())).collect();
    let products: Vec<Vec<f64>> = model.products.iter().map(|(a, b)| interaction(&scaled[*a], &scaled[*b])).collect();
    let all: Vec<&[f64]> = scaled.iter().chain(&products).map(Vec::as_slice).collect();
    let product = |(a, b): &(usize, usize)| {
        format!("{} \u{d7} {}", parameter_label(model.main[*a]), parameter_label(model.main[*b]))
    };
    let names: Vec<String> =
        model.main.iter().map(|m| parameter_label(m)).chain(model.products.iter().map(product)).collect();
    let weights = base.weights.as_deref();
    let options = Options { scale: Scale::Standardized, ..Options::for_rows(weights.is_some()) };
    let found = Data::new(&all, &base.success, weights)
        .and_then(|data| data.clustered(base.clusters().map(Clusters::of_row)))
        .and_then(|data| fit(data, options));
    match found {
        Ok(fit) => Finding::Estimated(Regression::of(&fit, "success", &names, true)),
        Err(error) => Finding::not(why(&error, &names)),
    }
}

/// Labels of the parameters that the model needs but the sample lacks as numbers. `None` if there are none.
pub(crate) fn missing(base: &Sample, model: &InteractionModel) -> Option<String> {
    let missing: Vec<String> = model
        .main
        .iter()
        .filter(|m| base.parameter(m).is_none_or(|p| !p.is_numeric()))
        .map(|m| parameter_label(m))
        .collect();
    (!missing.is_empty()).then(|| list(&missing))
}
