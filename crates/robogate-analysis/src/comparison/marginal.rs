//! Marginal effects of the shared parameters, in the same bins for every dataset.

use robogate_stats::Trials;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::axis::SharedAxis;
use crate::comparison::dataset::Dataset;
use crate::rate::Rate;

/// The marginal effect of a parameter that all datasets have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SharedCurve {
    /// The parameter.
    pub parameter: String,
    /// Its label.
    pub label: String,
    /// Its unit; empty without one.
    pub unit: String,
    /// Whether the bins have equal width on a logarithmic scale.
    pub log: bool,
    /// A sentence on the part of it that is not shared.
    pub remark: Option<String>,
    /// The bins or levels, the same for every dataset.
    pub cells: Vec<SharedCell>,
}

/// One bin or level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SharedCell {
    /// The label of the bin or level.
    pub label: String,
    /// Edges of a bin; absent for a level.
    pub range: Option<[f64; 2]>,
    /// The rate of each compared dataset, in their order.
    pub rates: Vec<Rate>,
}

/// The marginal effect of one shared parameter on each dataset.
pub(crate) fn curve(datasets: &[&Dataset<'_>], shared: &SharedAxis) -> SharedCurve {
    let trials: Vec<Vec<Trials>> = datasets.iter().map(|dataset| shared.trials(dataset)).collect();
    let (label, unit) = crate::labels::label_and_unit(&shared.axis.parameter);
    SharedCurve {
        parameter: shared.axis.parameter.clone(),
        label,
        unit: unit.to_owned(),
        log: shared.axis.log,
        remark: shared.remark.clone(),
        cells: (0..shared.cells())
            .map(|i| SharedCell {
                label: shared.axis.cell_label(i),
                range: shared.range(i),
                rates: trials.iter().map(|of| Rate::of(of[i])).collect(),
            })
            .collect(),
    }
}
