//! Likelihood-ratio tests of categorical parameters.
//!
//! The penalty of a level is learnt from the outcomes that it predicts, so the Wald test of its coefficient is false: with
//! many levels it finds an effect in noise. The test here compares the model without the parameter with one that has a
//! coefficient for each level; the degrees of freedom count the levels.

use robogate_stats::likelihood_ratio::{likelihood_ratio, normal_score};
use robogate_stats::logistic::{Data, Estimator, Fit, Options, fit};

use crate::Finding;
use crate::models::Regression;
use crate::table::{ParameterKind, Sample};

/// Rows of the test.
const MOST_ROWS: usize = 100_000;
/// Most levels of a parameter.
const MOST_LEVELS: usize = 40;

/// Replaces the tests of the penalties in `regression` by likelihood-ratio tests. The standard error becomes the
/// test-based one, |coefficient| / z, and the interval follows from it (Miettinen 1976). `columns` are those of the fit.
pub(super) fn replace_tests(regression: &mut Regression, base: &Sample, columns: &[&[f64]], failed: &[bool]) {
    let step = failed.len().div_ceil(MOST_ROWS).max(1);
    let thin = |column: &[f64]| column.iter().step_by(step).copied().collect::<Vec<f64>>();
    let outcomes: Vec<bool> = failed.iter().step_by(step).copied().collect();
    let columns: Vec<Vec<f64>> = columns.iter().map(|column| thin(column)).collect();
    for (at, parameter) in base.parameters.iter().enumerate() {
        let ParameterKind::Categorical { levels } = &parameter.kind else { continue };
        let Some(term) = regression.terms.get_mut(at + 1) else { continue };
        let Finding::Estimated(estimate) = &mut term.estimate else { continue };
        if !base.is_plain() {
            term.estimate = Finding::not(
                "a likelihood-ratio test needs independent rows without weights; see its influence on success instead",
            );
            continue;
        }
        let codes: Vec<usize> = parameter.values.iter().step_by(step).map(|v| *v as usize).collect();
        let others: Vec<&[f64]> =
            columns.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, c)| c.as_slice()).collect();
        match ln_p(&others, &codes, levels.len(), &outcomes) {
            Some(ln_p) => {
                estimate.ln_p = ln_p.max(f64::MIN);
                let z = normal_score(estimate.ln_p);
                estimate.z = z.copysign(estimate.coefficient);
                estimate.se = estimate.coefficient.abs() / z.max(1e-3);
                estimate.interval_95 = [-1.0, 1.0].map(|side| estimate.coefficient + side * 1.959_964 * estimate.se);
            }
            None => {
                term.estimate = Finding::not(
                    "a likelihood-ratio test needs both outcomes in each of at most 40 levels; see its influence on success \
                     instead",
                );
            }
        }
    }
}

/// ln of the p-value of all levels together, given the other columns.
fn ln_p(others: &[&[f64]], codes: &[usize], levels: usize, failed: &[bool]) -> Option<f64> {
    let (mut seen, mut outcomes) = (vec![0_usize; levels], vec![0_usize; levels]);
    for (code, failed) in codes.iter().zip(failed) {
        seen[*code] += 1;
        outcomes[*code] += usize::from(*failed);
    }
    let one_outcome = |(n, failures): (&usize, &usize)| *n > 0 && (*failures == 0 || failures == n);
    if levels > MOST_LEVELS || seen.iter().zip(&outcomes).any(one_outcome) {
        return None;
    }
    let dummy = |level: usize| codes.iter().map(|code| f64::from(u8::from(*code == level))).collect::<Vec<f64>>();
    let dummies: Vec<Vec<f64>> = (1..levels).map(dummy).collect();
    let all: Vec<&[f64]> = others.iter().copied().chain(dummies.iter().map(Vec::as_slice)).collect();
    let fitted = |columns: &[&[f64]]| fit(Data::new(columns, failed, None).ok()?, Options::default()).ok();
    let maximum = |fit: &Fit| fit.estimator == Estimator::MaximumLikelihood;
    let (with, without) = (fitted(&all)?, fitted(others)?);
    (maximum(&with) && maximum(&without)).then(|| likelihood_ratio(&with, &without).map(|test| test.ln_p))?
}
