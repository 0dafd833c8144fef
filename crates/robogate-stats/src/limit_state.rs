//! The boundary between success and failure for two parameters, in closed form.
//!
//! Model: logit P(success) = β₀ + β₁ x + β₂ y + β₃ x y (any two parameters; in the paper x = friction, y = mass).
//! P = π where
//!
//! x*(y) = (t - β₀ - β₂ y) / (β₁ + β₃ y),  t = ln(π/(1-π)),
//!
//! with a pole at y = -β₁/β₃. Delta method: se(x*) = se(η)/|β₁ + β₃ y|, where se(η) is the standard error of the linear
//! predictor at (x*, y). The band x* ± z se is symmetric and invalid near the pole. [`FrontierPoint::set`] is the exact
//! set (Fieller): every x whose linear predictor is compatible with t at this y. It is unbounded exactly if the slope
//! in x does not differ significantly from zero.
//!
//! Guarantee: both are pointwise in y, not simultaneous over the curve. Limit: the frontier is that of the model.
//! Beyond the observed range of x or y, or past the pole, it is extrapolation, and every point reports this. Sources:
//! robogate paper, equations for mu*(m); Fieller (1954), JRSS B 16(2); Ditlevsen and Madsen (1996) for limit states.

use crate::interval::{Confidence, Interval};
use crate::logistic::{Data, Fit, Options, RegressionError, fit, interaction};

/// The side of the frontier with the higher probability of success.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SuccessSide {
    /// Success is more likely at x above the frontier.
    Above,
    /// Success is more likely at x below the frontier.
    Below,
}

/// The set of x that are compatible with the target at one y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CompatibleSet {
    /// An interval.
    Bounded(Interval),
    /// Everything except an open interval: the slope in x does not differ significantly from zero.
    Outside(Interval),
    /// All x.
    Everything,
}

/// A point of the frontier at one y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrontierPoint {
    /// Second parameter.
    pub y: f64,
    /// First parameter at which the probability of success equals the target.
    pub x: f64,
    /// Delta-method standard error of `x`.
    pub se: f64,
    /// `x` ± z `se`.
    pub band: Interval,
    /// Exact compatible set.
    pub set: CompatibleSet,
    /// The side with the higher probability of success.
    pub success: SuccessSide,
    /// Whether (x, y) is within the observed ranges. Otherwise the point is an extrapolation.
    pub observed: bool,
}

/// Coefficients of the two-parameter model with their covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimitState {
    beta: [f64; 4],
    covariance: [[f64; 4]; 4],
    x_range: Interval,
    y_range: Interval,
    target: f64,
}

/// The reason why there is no limit state.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LimitStateError {
    /// The regression failed.
    #[error(transparent)]
    Regression(#[from] RegressionError),
    /// A column was dropped from the fit, so the frontier is undetermined.
    #[error("term {term} of (x, y, x*y) has no coefficient: it is constant or explained by the others")]
    MissingTerm {
        /// 0 for x, 1 for y, 2 for their product.
        term: usize,
    },
    /// The target rate is not strictly between 0 and 1.
    #[error("the target rate {target} is out of range. Expected a number in (0, 1)")]
    Target {
        /// Value found.
        target: f64,
    },
    /// A coefficient or covariance is not a finite number.
    #[error("coefficients and covariance must be finite numbers")]
    NotFinite,
}

impl LimitState {
    /// Creates a limit state from coefficients in the order (1, x, y, xy), in raw units, and the observed ranges.
    ///
    /// # Errors
    /// A target outside (0, 1), or a number that is not finite.
    pub fn new(
        beta: [f64; 4],
        covariance: [[f64; 4]; 4],
        x_range: Interval,
        y_range: Interval,
        target: f64,
    ) -> Result<Self, LimitStateError> {
        if !(target > 0.0 && target < 1.0) {
            return Err(LimitStateError::Target { target });
        }
        if !beta.iter().chain(covariance.iter().flatten()).all(|v| v.is_finite()) {
            return Err(LimitStateError::NotFinite);
        }
        Ok(Self { beta, covariance, x_range, y_range, target })
    }

    /// Fits the model to two columns and their product. Returns the frontier and the fit. `clusters` are those of
    /// [`Data::clustered`].
    ///
    /// # Errors
    /// An error of the regression, or a term without a coefficient.
    pub fn fit(
        x: &[f64],
        y: &[f64],
        outcomes: &[bool],
        weights: Option<&[f64]>,
        clusters: Option<&[usize]>,
        options: Options,
        target: f64,
    ) -> Result<(Self, Fit), LimitStateError> {
        let product = interaction(x, y);
        let columns = [x, y, product.as_slice()];
        let found = fit(Data::new(&columns, outcomes, weights)?.clustered(clusters)?, options)?;
        if let Some(term) = found.terms.iter().position(|t| t.coefficient().is_none()) {
            return Err(LimitStateError::MissingTerm { term });
        }
        let raw = found.raw_covariance();
        let beta = std::array::from_fn(|i| found.raw_coefficients()[i]);
        // Bands use normal quantiles, so the wider ones of Student's t enter here. They agree exactly at 95 %.
        let wider = (found.quantile(Confidence::P95) / Confidence::P95.z()).powi(2);
        let covariance = std::array::from_fn(|i| std::array::from_fn(|j| wider * raw[i * 4 + j]));
        let used = |row: &usize| weights.is_none_or(|w| w[*row] > 0.0);
        let range = |column: &[f64]| {
            let mut range = Interval { low: f64::INFINITY, high: f64::NEG_INFINITY };
            for row in (0..column.len()).filter(used) {
                range.low = range.low.min(column[row]);
                range.high = range.high.max(column[row]);
            }
            range
        };
        let this = Self::new(beta, covariance, range(x), range(y), target)?;
        Ok((this, found))
    }

    /// The y at which the frontier goes to infinity. `None` without interaction.
    pub fn pole(&self) -> Option<f64> {
        let pole = -self.beta[1] / self.beta[3];
        pole.is_finite().then_some(pole)
    }

    /// Slope of the log-odds in x at this y.
    pub fn slope(&self, y: f64) -> f64 {
        self.beta[1] + self.beta[3] * y
    }

    /// The range of y for which the frontier is within the observed ranges of both parameters, on one side of the pole.
    ///
    /// `None` if there is no such y. If the pole splits the observed range of y, the longer part is returned.
    pub fn validity(&self) -> Option<Interval> {
        let Interval { low, high } = self.y_range;
        // x*(y) is monotone on each side of the pole, so it reaches each end of the x range at most once: x (β₁ + β₃ y)
        // = t - β₀ - β₂ y.
        let meets = |x: f64| (self.logit() - self.beta[0] - self.beta[1] * x) / (self.beta[2] + self.beta[3] * x);
        let mut cuts: Vec<f64> =
            [Some(low), Some(high), self.pole(), Some(meets(self.x_range.low)), Some(meets(self.x_range.high))]
                .into_iter()
                .flatten()
                .filter(|c| low <= *c && *c <= high)
                .collect();
        cuts.sort_unstable_by(f64::total_cmp);
        let mut best: Option<Interval> = None;
        for pair in cuts.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let inside = self.x_at(0.5 * (a + b)).is_some_and(|x| self.x_range.contains(x));
            if b > a && inside && best.is_none_or(|i| b - a > i.width()) {
                best = Some(Interval { low: a, high: b });
            }
        }
        best
    }

    fn logit(&self) -> f64 {
        (self.target / (1.0 - self.target)).ln()
    }

    /// The frontier x*(y). `None` at the pole.
    pub fn x_at(&self, y: f64) -> Option<f64> {
        let x = (self.logit() - self.beta[0] - self.beta[2] * y) / self.slope(y);
        x.is_finite().then_some(x)
    }

    /// The frontier at `y` with its uncertainty. `None` at the pole.
    pub fn at(&self, y: f64, confidence: Confidence) -> Option<FrontierPoint> {
        let x = self.x_at(y)?;
        let slope = self.slope(y);
        let z = confidence.z();
        let se = self.variance(x, y).max(0.0).sqrt() / slope.abs();
        Some(FrontierPoint {
            y,
            x,
            se,
            band: Interval { low: x - z * se, high: x + z * se },
            set: self.compatible(y, z),
            success: if slope > 0.0 { SuccessSide::Above } else { SuccessSide::Below },
            observed: self.x_range.contains(x) && self.y_range.contains(y),
        })
    }

    /// The frontier at `points` values of y, evenly spaced over the observed range. The pole is skipped.
    pub fn curve(&self, points: usize, confidence: Confidence) -> Vec<FrontierPoint> {
        let last = points.saturating_sub(1).max(1) as f64;
        (0..points)
            .filter_map(|i| self.at(self.y_range.low + self.y_range.width() * i as f64 / last, confidence))
            .collect()
    }

    /// Variance of the linear predictor.
    fn variance(&self, x: f64, y: f64) -> f64 {
        let v = [1.0, x, y, x * y];
        let mut sum = 0.0;
        for i in 0..4 {
            for j in 0..4 {
                sum += v[i] * v[j] * self.covariance[i][j];
            }
        }
        sum
    }

    /// Solves (a + b x)² ≤ z² var(a + b x), with a, b the intercept and slope of the predictor at y.
    fn compatible(&self, y: f64, z: f64) -> CompatibleSet {
        let c = &self.covariance;
        let a = self.beta[0] + self.beta[2] * y - self.logit();
        let b = self.slope(y);
        let var_a = c[0][0] + 2.0 * y * c[0][2] + y * y * c[2][2];
        let var_b = c[1][1] + 2.0 * y * c[1][3] + y * y * c[3][3];
        let cov = c[0][1] + y * (c[0][3] + c[1][2]) + y * y * c[2][3];
        let zz = z * z;
        let quadratic = b * b - zz * var_b;
        let half_linear = a * b - zz * cov;
        let constant = a * a - zz * var_a;
        let discriminant = half_linear * half_linear - quadratic * constant;
        if discriminant < 0.0 {
            return CompatibleSet::Everything;
        }
        // The root of larger magnitude comes first, the other one from the product of the roots.
        let q = -(half_linear + discriminant.sqrt().copysign(half_linear));
        let (r1, r2) = (q / quadratic, constant / q);
        if !(r1.is_finite() && r2.is_finite()) {
            return CompatibleSet::Everything;
        }
        let roots = Interval { low: r1.min(r2), high: r1.max(r2) };
        if quadratic > 0.0 { CompatibleSet::Bounded(roots) } else { CompatibleSet::Outside(roots) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn published() -> LimitState {
        let covariance =
            [[0.0023, 0.0, 0.0, 0.0], [0.0, 0.0076, 0.0, 0.0], [0.0, 0.0, 0.0060, 0.0], [0.0, 0.0, 0.0, 0.0185]];
        let friction = Interval { low: 0.05, high: 1.2 };
        let mass = Interval { low: 0.05, high: 2.0 };
        LimitState::new([-1.469, 3.691, -0.419, -1.400], covariance, friction, mass, 0.5).unwrap()
    }

    #[test]
    fn published_equation_gives_anchors() {
        let f = published();
        assert!((f.x_at(0.1).unwrap() - 0.42549).abs() < 5e-6);
        assert!((f.x_at(1.0).unwrap() - 0.82409).abs() < 5e-6);
        assert!((f.pole().unwrap() - 2.636).abs() < 5e-4);
    }

    #[test]
    fn validity_ends_at_observed_range() {
        let v = published().validity().unwrap();
        assert!((v.low - 0.05).abs() < 1e-12);
        // (1.469 + 0.419 m) / (3.691 - 1.4 m) = 1.2
        assert!((v.high - (1.2 * 3.691 - 1.469) / (0.419 + 1.2 * 1.4)).abs() < 1e-9);
        assert!(!published().at(1.9, Confidence::P95).unwrap().observed);
    }

    #[test]
    fn delta_band_matches_gradient() {
        let f = published();
        let y = 0.7;
        let mut variance = 0.0;
        for i in 0..4 {
            let h = 1e-5;
            let moved = |d: f64| {
                let mut g = f;
                g.beta[i] += d;
                g.x_at(y).unwrap()
            };
            variance += ((moved(h) - moved(-h)) / (2.0 * h)).powi(2) * f.covariance[i][i];
        }
        let point = f.at(y, Confidence::P95).unwrap();
        assert!((point.se / variance.sqrt() - 1.0).abs() < 1e-7);
        assert_eq!(point.success, SuccessSide::Above);
    }

    #[test]
    fn exact_set_is_unbounded_near_pole() {
        let f = published();
        let CompatibleSet::Bounded(near) = f.at(0.3, Confidence::P95).unwrap().set else {
            panic!("expected an interval far from the pole")
        };
        let band = f.at(0.3, Confidence::P95).unwrap().band;
        assert!((near.low - band.low).abs() < 0.02 && (near.high - band.high).abs() < 0.02);
        let close = f.at(2.6, Confidence::P95).unwrap();
        assert!(close.band.width().is_finite());
        assert!(!matches!(close.set, CompatibleSet::Bounded(_)));
    }

    #[test]
    fn pole_has_no_point() {
        let mut f = published();
        f.beta = [-1.0, 2.0, 0.5, -1.0];
        assert_eq!(f.at(2.0, Confidence::P95), None);
    }
}
