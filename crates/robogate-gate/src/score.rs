//! The confidence score, 0 to 100 (the paper's section 3.4 and appendix E).
//!
//! C = 100 Σ wᵢ sᵢ, with weights and terms as data ([`ScoreTerm`]). It summarises observed figures and has no error
//! bound, so the verdict does not depend on it. The cycle-time term 1 - |Δt/t_base| is limited to 0, because it would
//! be negative beyond twice the baseline. The paper's baseline term max(0, 1 + ΔSR) exceeds 1 if a policy is better
//! than its baseline, and the score may then exceed 100. Requirements can limit the term to 1 as well.
//!
//! The cycle time is that of the successes, as in the baseline. The paper also scores policies that never succeed, by
//! the durations of their failures. So does this score.

use robogate_stats::Interval;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::figure::{Extremes, applies, figure};
use crate::scope::Scope;
use crate::{Baseline, Ending, GateError, Metric, Trial};

/// One term of the score, as data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScoreTerm {
    /// The name in reports.
    pub name: String,
    /// The metric.
    pub metric: Metric,
    /// Only scenarios of this category count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub category: Option<String>,
    /// Its weight; the weights sum to 1.
    pub weight: f64,
    /// How the metric is converted to a number from 0 to 1.
    pub scoring: Scoring,
}

/// How a metric x is converted to a number from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "form", deny_unknown_fields)]
pub enum Scoring {
    /// min(1, x / full_at).
    Linear {
        /// The value at which the term reaches 1.
        full_at: f64,
    },
    /// 1 - |x - b| / b, at least 0, with the baseline's figure b.
    BaselineDeviation,
    /// 1 at x = 0, otherwise 0.
    Zero,
    /// 1 + x - b, at least 0, with the baseline's figure b. It exceeds 1 if the policy is better.
    BaselineDelta,
    /// 1 + x - b, limited to 0 to 1, with the baseline's figure b.
    BaselineDeltaCapped,
}

impl Scoring {
    /// Whether the term refers to a baseline.
    pub fn needs_baseline(self) -> bool {
        matches!(self, Self::BaselineDeviation | Self::BaselineDelta | Self::BaselineDeltaCapped)
    }

    /// Converts the figure `x` to a number from 0 to 1, with the baseline's figure `b`. `None` if a baseline is
    /// missing.
    pub fn of(self, x: f64, b: Option<f64>) -> Option<f64> {
        let scored = match self {
            Self::Linear { full_at } => (x / full_at).min(1.0),
            Self::BaselineDeviation => {
                let b = b.filter(|b| *b > 0.0)?;
                (1.0 - (x - b).abs() / b).max(0.0)
            }
            Self::Zero => f64::from(u8::from(x <= 0.0)),
            Self::BaselineDelta => (1.0 + x - b?).max(0.0),
            Self::BaselineDeltaCapped => (1.0 + x - b?).clamp(0.0, 1.0),
        };
        Some(scored)
    }

    /// The range of the term for a figure between `least` and `most`.
    fn range(self, extremes: &Extremes, b: Option<f64>) -> Option<Interval> {
        let low = match extremes.least {
            Some(least) => self.of(least, b)?,
            None => 0.0,
        };
        let high = match extremes.most {
            Some(most) => self.of(most, b)?,
            // Only a duration is unbounded, and an infinite duration scores 0.
            None => 0.0,
        };
        let inside = b.is_some_and(|b| {
            extremes.least.is_none_or(|least| least <= b) && extremes.most.is_none_or(|most| b <= most)
        });
        let peak = if self == Self::BaselineDeviation && inside { 1.0 } else { low.max(high) };
        Some(Interval { low: low.min(high), high: peak })
    }
}

/// A term with its figures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScoredTerm {
    /// The term.
    pub term: ScoreTerm,
    /// The metric's figure over the valid episodes. `None` if there is none.
    pub value: Option<f64>,
    /// The baseline's figure, if the term uses it.
    pub baseline: Option<f64>,
    /// The converted value, 0 to 1. `None` without a figure.
    pub scored: Option<f64>,
    /// 100 times the weight times this value.
    pub points: Option<f64>,
}

/// The confidence score with its terms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ConfidenceScore {
    /// 0 to 100 (more if an uncapped baseline term exceeds 1) over the valid episodes. `None` if a term has no figure.
    pub points: Option<f64>,
    /// The range of the score over all outcomes that the invalid episodes could have had.
    pub bounds: [f64; 2],
    /// Its terms.
    pub terms: Vec<ScoredTerm>,
}

pub(crate) fn check(terms: &[ScoreTerm]) -> Result<(), GateError> {
    let wrong = |reason: String| Err(GateError::Score { reason });
    if terms.is_empty() {
        return Ok(());
    }
    for term in terms {
        if !(0.0..=1.0).contains(&term.weight) {
            return wrong(format!("`{}` has weight {}. Expected 0 to 1", term.name, term.weight));
        }
        if let Scoring::Linear { full_at } = term.scoring
            && !(full_at.is_finite() && full_at > 0.0)
        {
            return wrong(format!("`{}` has full_at = {full_at}. Expected a value above 0", term.name));
        }
    }
    let sum: f64 = terms.iter().map(|term| term.weight).sum();
    if (sum - 1.0).abs() > 1e-9 {
        return wrong(format!("the weights sum to {sum}. Expected 1"));
    }
    Ok(())
}

impl ConfidenceScore {
    /// The score of `trials`. `None` if there are no terms.
    pub fn of<'a>(
        terms: &[ScoreTerm],
        baseline: Option<&Baseline>,
        trials: impl Iterator<Item = &'a Trial> + Clone,
    ) -> Option<Self> {
        if terms.is_empty() {
            return None;
        }
        let mut bounds = [0.0; 2];
        let scored = terms.iter().map(|term| {
            let scope = Scope { category: term.category.as_deref(), group: None };
            let range = [Some(0.0).filter(|_| term.metric == Metric::MEAN_CYCLE_TIME), None];
            let in_scope = trials.clone().filter(|trial| scope.holds(trial));
            let never = !in_scope.clone().any(|trial| trial.ending == Ending::Success);
            let counted = in_scope.filter(|trial| never || applies(term.metric, trial));
            let (_, _, extremes) = figure(term.metric, counted, range);
            let b = if term.scoring.needs_baseline() { baseline.and_then(|b| b.figure(term.metric)) } else { None };
            let full = 100.0 * term.weight;
            let range = term.scoring.range(&extremes, b).unwrap_or(Interval::UNIT);
            bounds[0] += full * range.low;
            bounds[1] += full * range.high;
            let scored = extremes.observed.and_then(|x| term.scoring.of(x, b));
            ScoredTerm {
                term: term.clone(),
                value: extremes.observed,
                baseline: b,
                scored,
                points: scored.map(|s| full * s),
            }
        });
        let terms: Vec<ScoredTerm> = scored.collect();
        let points = terms.iter().map(|term| term.points).sum();
        Some(Self { points, bounds, terms })
    }
}
