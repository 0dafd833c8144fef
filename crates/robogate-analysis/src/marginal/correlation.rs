//! Correlation of one parameter with success.

use robogate_stats::binning::per_category;
use robogate_stats::correlation::{cramers_v, midranks, pearson, weighted};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::no_contrast;
use crate::rate::{Finding, ends};
use crate::table::{ParameterColumn, ParameterKind, Sample};

/// Correlation of a parameter with success.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "measure")]
pub enum Correlation {
    /// Of a numeric parameter.
    Number {
        /// Point-biserial correlation: above 0, success is more likely at larger values.
        point_biserial: f64,
        /// 95 % interval by Fisher's transform. It covers too rarely for a heavy-tailed (log-normal) parameter.
        interval_95: [f64; 2],
        /// ln of the two-sided p-value. `None` if it is undefined.
        ln_p: Option<f64>,
        /// Spearman's rank correlation. `None` if it is undefined.
        spearman: Option<f64>,
    },
    /// Of a categorical parameter: Cramer's V, which has no direction.
    Category {
        /// Cramer's V, from 0 to 1, corrected for its bias under independence.
        cramers_v: f64,
        /// ln of the p-value of independence.
        ln_p: f64,
        /// Smallest expected count: below 5 the p-value is approximate.
        smallest_expected: f64,
    },
}

impl Correlation {
    /// Strength without direction, from 0 to 1.
    pub fn strength(&self) -> f64 {
        match self {
            Self::Number { point_biserial, .. } => point_biserial.abs(),
            Self::Category { cramers_v, .. } => *cramers_v,
        }
    }
}

pub(super) fn correlation(base: &Sample, parameter: &ParameterColumn) -> Finding<Correlation> {
    // A parameter that varies between clusters has as many independent values as clusters.
    let clusters = base.dependence.as_ref().map(|of| of.grouping_of(parameter)).filter(|(_, share)| *share > 0.5);
    let clusters = clusters.map(|(clusters, _)| clusters.count());
    let independent = (base.share() * base.len() as f64).floor() as usize;
    if parameter.is_numeric() {
        let outcomes: Vec<f64> = base.success.iter().map(|s| f64::from(u8::from(*s))).collect();
        let of = |values: &[f64]| match &base.weights {
            Some(weights) => weighted(values, &outcomes, weights, independent, Confidence::P95),
            None => pearson(values, &outcomes, Confidence::P95),
        };
        let Ok(found) = of(&parameter.values) else {
            return Finding::not(no_contrast(base, parameter));
        };
        let found = clusters.map_or(found, |n| found.counted_as(n, Confidence::P95));
        let ranks = of(&midranks(&parameter.values)).ok();
        return Finding::Estimated(Correlation::Number {
            point_biserial: found.r,
            interval_95: ends(found.interval),
            ln_p: found.ln_p.filter(|p| p.is_finite()),
            spearman: ranks.map(|ranks| ranks.r),
        });
    }
    let ParameterKind::Categorical { levels } = &parameter.kind else {
        return Finding::not(no_contrast(base, parameter));
    };
    // One row for each independent episode of a level.
    let cells = match base.weights {
        Some(_) => base.effective_cells(levels.len(), |row| Some(parameter.values[row] as usize)),
        None => per_category(&parameter.codes(), &base.success, levels.len()).unwrap_or_default(),
    };
    let row = |(level, cell): (usize, &Trials)| {
        let outcome = |(outcome, count): (usize, u64)| std::iter::repeat_n((level, outcome), count as usize);
        [(0, cell.failures()), (1, cell.successes())].into_iter().flat_map(outcome).collect::<Vec<_>>()
    };
    let (codes, outcomes): (Vec<usize>, Vec<usize>) = cells.iter().enumerate().flat_map(row).unzip();
    match cramers_v(&codes, &outcomes) {
        Ok(found) => Finding::Estimated(Correlation::Category {
            cramers_v: found.v_corrected,
            ln_p: clusters
                .map_or(found.ln_p, |n| found.ln_p_counted_as(n as f64 / base.len().max(1) as f64))
                .max(f64::MIN),
            smallest_expected: found.smallest_expected,
        }),
        Err(_) => Finding::not(no_contrast(base, parameter)),
    }
}
