//! The beta distribution, and the binomial and Student distributions that follow from it.
//!
//! Tails use a continued fraction whose prefactor has the saddle-point form of Loader (2000). Quantiles are found by Newton
//! steps that stay inside a bracket.
//!
//! Sources: Abramowitz and Stegun (1964), 26.5; Loader (2000), "Fast and accurate computation of binomial probabilities".

use crate::gamma::{LN_SQRT_2PI, deviance_term, nonzero, stirling_error};

/// ln of x^a (1-x)^b / B(a, b), given x and y = 1 - x both positive.
fn ln_beta_kernel(a: f64, b: f64, x: f64, y: f64) -> f64 {
    let n = a + b;
    stirling_error(n) - stirling_error(a) - stirling_error(b) - deviance_term(a, n * x) - deviance_term(b, n * y)
        + 0.5 * (a * b / n).ln()
        - LN_SQRT_2PI
}

/// ln P(X = k) for X binomial(n, p), 0 <= k <= n, 0 < p < 1.
pub fn ln_binomial_pmf(k: f64, n: f64, p: f64) -> f64 {
    let j = n - k;
    if k <= 0.0 {
        return n * (-p).ln_1p();
    }
    if j <= 0.0 {
        return n * p.ln();
    }
    stirling_error(n)
        - stirling_error(k)
        - stirling_error(j)
        - deviance_term(k, n * p)
        - deviance_term(j, n * (1.0 - p))
        + 0.5 * (n / (k * j)).ln()
        - LN_SQRT_2PI
}

/// Continued fraction of the incomplete beta function, evaluated by the modified Lentz method.
fn beta_fraction(a: f64, b: f64, x: f64) -> f64 {
    let mut c = 1.0;
    let mut d = 1.0 / nonzero(1.0 - (a + b) * x / (a + 1.0));
    let mut value = d;
    for m in 1..100_000 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        d = 1.0 / nonzero(1.0 + even * d);
        c = nonzero(1.0 + even / c);
        value *= d * c;
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        d = 1.0 / nonzero(1.0 + odd * d);
        c = nonzero(1.0 + odd / c);
        let factor = d * c;
        value *= factor;
        if (factor - 1.0).abs() < 1e-16 {
            break;
        }
    }
    value
}

/// Both tails (I_x(a,b), 1 - I_x(a,b)), the smaller one to full relative precision; y = 1 - x.
fn beta_tails(a: f64, b: f64, x: f64, y: f64) -> (f64, f64) {
    if x <= 0.0 {
        return (0.0, 1.0);
    }
    if y <= 0.0 {
        return (1.0, 0.0);
    }
    let kernel = ln_beta_kernel(a, b, x, y).exp();
    if x < (a + 1.0) / (a + b + 2.0) {
        let lower = kernel * beta_fraction(a, b, x) / a;
        (lower, 1.0 - lower)
    } else {
        let upper = kernel * beta_fraction(b, a, y) / b;
        (1.0 - upper, upper)
    }
}

/// ln I_x(a, b), finite even if I underflows. The caller gives y = 1 - x, which keeps the digits of x near 1.
pub fn ln_beta_cdf(a: f64, b: f64, x: f64, y: f64) -> f64 {
    if x <= 0.0 {
        return f64::NEG_INFINITY;
    }
    if y <= 0.0 {
        return 0.0;
    }
    if x < (a + 1.0) / (a + b + 2.0) {
        ln_beta_kernel(a, b, x, y) + (beta_fraction(a, b, x) / a).ln()
    } else {
        (-beta_tails(a, b, x, y).1).ln_1p()
    }
}

/// The quantile: the x with I_x(a, b) = `p`, for 0 < p < 1.
///
/// The search uses the logarithm of x, so small quantiles such as 1e-9 have full relative precision.
pub fn beta_quantile(a: f64, b: f64, p: f64) -> f64 {
    let mut low = f64::MIN_POSITIVE.ln();
    let mut high = 0.0_f64;
    let mut t = (a / (a + b)).ln();
    for _ in 0..300 {
        let x = t.exp();
        let y = -t.exp_m1();
        let excess = beta_tails(a, b, x, y).0 - p;
        if excess > 0.0 {
            high = t;
        } else {
            low = t;
        }
        // d I / d ln x = x^a y^(b-1) / B(a, b)
        let slope = if y > 0.0 { ln_beta_kernel(a, b, x, y).exp() / y } else { 0.0 };
        let newton = t - excess / slope;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        let moved = (next - t).abs();
        t = next;
        if moved <= 1e-16 * (1.0 + t.abs()) || high - low <= 1e-16 {
            break;
        }
    }
    t.exp()
}

/// ln of the two-sided tail P(|T| > |t|) of Student's t with `df` degrees of freedom.
pub fn ln_student_two_sided(df: f64, t: f64) -> f64 {
    if t.is_infinite() {
        return f64::NEG_INFINITY;
    }
    let total = df + t * t;
    ln_beta_cdf(0.5 * df, 0.5, df / total, t * t / total)
}

/// The quantile t with P(|T| <= t) = `level`, for Student's t with `df` > 0 degrees of freedom, not necessarily an
/// integer.
pub fn student_quantile(df: f64, level: f64) -> f64 {
    // t^2/(df + t^2) is a beta variable. This form keeps its digits for large df.
    let y = beta_quantile(0.5, 0.5 * df, level);
    (df * y / (1.0 - y)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::check;

    #[test]
    fn tails_match_scipy() {
        check("beta", "cdf", 1e-12, |g| ln_beta_cdf(g("a"), g("b"), g("x"), 1.0 - g("x")).exp());
        check("student", "ln_p", 1e-11, |g| ln_student_two_sided(g("df"), g("t")));
    }

    #[test]
    fn beta_quantile_inverts_both_tails() {
        for (a, b) in [(0.5, 0.5), (1.0, 1.0), (3.0, 9998.0), (1e6, 2.0), (4e5, 6e5)] {
            for p in [1e-9, 0.025, 0.5, 0.975] {
                let x = beta_quantile(a, b, p);
                let back = ln_beta_cdf(a, b, x, 1.0 - x).exp();
                assert!((back / p - 1.0).abs() < 1e-8, "a {a} b {b} p {p}: {back}");
            }
        }
    }
}
