//! Likelihood-ratio tests of nested logistic models.
//!
//! 2 (ln L of the larger model - ln L of the smaller one) has a chi-squared distribution with as many degrees of freedom
//! as the larger model has further coefficients, if they have no effect. Both models must be fitted by maximum likelihood to
//! the same rows. Source: Wilks (1938), Annals of Mathematical Statistics 9(1).

use robogate_maths::gamma::ln_chi_squared_sf;
use robogate_maths::normal::ln_two_sided;

use crate::logistic::Fit;

/// The result of a likelihood-ratio test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LikelihoodRatio {
    /// Twice the difference of the log-likelihoods.
    pub statistic: f64,
    /// Degrees of freedom.
    pub df: usize,
    /// ln of the p-value.
    pub ln_p: f64,
}

/// Tests the further coefficients of `larger`. `None` if it has none.
pub fn likelihood_ratio(larger: &Fit, smaller: &Fit) -> Option<LikelihoodRatio> {
    let coefficients = |fit: &Fit| fit.terms.iter().filter(|term| term.coefficient().is_some()).count();
    let df = coefficients(larger).checked_sub(coefficients(smaller)).filter(|df| *df > 0)?;
    let statistic = (2.0 * (larger.log_likelihood - smaller.log_likelihood)).max(0.0);
    Some(LikelihoodRatio { statistic, df, ln_p: ln_chi_squared_sf(df as f64, statistic).min(0.0) })
}

/// The standard normal score z ≥ 0 whose two-sided p-value has this logarithm.
pub fn normal_score(ln_p: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while ln_two_sided(high) > ln_p && high < 1e9 {
        high *= 2.0;
    }
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if ln_two_sided(middle) > ln_p {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_score_inverts_the_p_value() {
        for z in [0.0, 0.5, 1.96, 6.0, 40.0] {
            assert!((normal_score(ln_two_sided(z)) - z).abs() < 1e-6, "{z}");
        }
        assert!(normal_score(f64::MIN).is_finite());
    }
}
