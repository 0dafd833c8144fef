//! The standard normal distribution, accurate in the far tails.

use std::f64::consts::{FRAC_1_SQRT_2, LN_2, PI};

use crate::gamma::upper_gamma_fraction;

/// P(Z <= z) of a standard normal variable.
pub fn cdf(z: f64) -> f64 {
    0.5 * libm::erfc(-z * FRAC_1_SQRT_2)
}

/// Upper tail P(Z > z).
pub fn sf(z: f64) -> f64 {
    cdf(-z)
}

/// ln of the upper tail P(Z > z), finite for every finite `z`.
pub fn ln_sf(z: f64) -> f64 {
    // Above this point the continued fraction converges in a few steps. The tail itself would underflow at 38.
    const FAR: f64 = 10.0;
    if z < -1.0 {
        (-sf(-z)).ln_1p()
    } else if z < FAR {
        sf(z).ln()
    } else {
        let x = z * FRAC_1_SQRT_2;
        -x * x + erfc_fraction(x).ln() - LN_2
    }
}

/// ln of the two-sided tail P(|Z| > |z|).
pub fn ln_two_sided(z: f64) -> f64 {
    (ln_sf(z.abs()) + LN_2).min(0.0)
}

/// erfc(x) e^(x^2) for x >= 1.5: the even part of Laplace's continued fraction.
fn erfc_fraction(x: f64) -> f64 {
    x * upper_gamma_fraction(0.5, x * x) / PI.sqrt()
}

/// The point z with P(Z <= z) = u, for 0 < u < 1: Wichura's algorithm AS 241 (PPND16), with a relative error near 1e-16.
///
/// Source: Wichura (1988), Applied Statistics 37(3).
pub fn quantile(u: f64) -> f64 {
    let q = u - 0.5;
    if q.abs() <= 0.425 {
        let r = 0.180625 - q * q;
        return q * horner(&MIDDLE, r) / horner(&MIDDLE_BELOW, r);
    }
    let r = (-u.min(1.0 - u).ln()).sqrt();
    let z = if r <= 5.0 {
        horner(&NEAR, r - 1.6) / horner(&NEAR_BELOW, r - 1.6)
    } else {
        horner(&FAR, r - 5.0) / horner(&FAR_BELOW, r - 5.0)
    };
    if q < 0.0 { -z } else { z }
}

/// c0 + c1 x + c2 x² + ...
fn horner(coefficients: &[f64; 8], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

const MIDDLE: [f64; 8] = [
    3.387_132_872_796_366_5,
    1.331_416_678_917_843_8e2,
    1.971_590_950_306_551_3e3,
    1.373_169_376_550_946e4,
    4.592_195_393_154_987e4,
    6.726_577_092_700_87e4,
    3.343_057_558_358_813e4,
    2.509_080_928_730_122_7e3,
];
const MIDDLE_BELOW: [f64; 8] = [
    1.0,
    4.231_333_070_160_091e1,
    6.871_870_074_920_579e2,
    5.394_196_021_424_751e3,
    2.121_379_430_158_659_7e4,
    3.930_789_580_009_271e4,
    2.872_908_573_572_194_3e4,
    5.226_495_278_852_854e3,
];
const NEAR: [f64; 8] = [
    1.423_437_110_749_683_5,
    4.630_337_846_156_546,
    5.769_497_221_460_691,
    3.647_848_324_763_204_5,
    1.270_458_252_452_368_4,
    2.417_807_251_774_506e-1,
    2.272_384_498_926_918_4e-2,
    7.745_450_142_783_414e-4,
];
const NEAR_BELOW: [f64; 8] = [
    1.0,
    2.053_191_626_637_759,
    1.676_384_830_183_803_8,
    6.897_673_349_851e-1,
    1.481_039_764_274_800_8e-1,
    1.519_866_656_361_645_7e-2,
    5.475_938_084_995_345e-4,
    1.050_750_071_644_416_9e-9,
];
const FAR: [f64; 8] = [
    6.657_904_643_501_103,
    5.463_784_911_164_114,
    1.784_826_539_917_291_3,
    2.965_605_718_285_048_7e-1,
    2.653_218_952_657_612_4e-2,
    1.242_660_947_388_078_4e-3,
    2.711_555_568_743_487_6e-5,
    2.010_334_399_292_288_1e-7,
];
const FAR_BELOW: [f64; 8] = [
    1.0,
    5.998_322_065_558_88e-1,
    1.369_298_809_227_358e-1,
    1.487_536_129_085_061_5e-2,
    7.868_691_311_456_133e-4,
    1.846_318_317_510_054_8e-5,
    1.421_511_758_316_446e-7,
    2.044_263_103_389_939_8e-15,
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{check, list};

    #[test]
    fn quantile_and_cdf_match_scipy() {
        let (quantiles, back) = (list("quantile", "quantile"), list("quantile", "cdf"));
        for ((u, z), p) in list("quantile", "u").into_iter().zip(quantiles).zip(back) {
            assert!((quantile(u) - z).abs() <= 1e-14 * z.abs().max(1.0), "{u}: {} {z}", quantile(u));
            assert!((cdf(z) - p).abs() <= 1e-13 * p, "{z}: {} {p}", cdf(z));
        }
        check("normal_quantile", "z", 1e-13, |g| -quantile(g("tail")));
    }

    #[test]
    fn log_tails_match_scipy() {
        check("normal", "ln_sf", 1e-13, |g| ln_sf(g("z")));
    }

    #[test]
    fn tail_equals_exponential_of_log_tail() {
        for i in -80..200 {
            let z = f64::from(i) / 10.0;
            assert!((sf(z) / ln_sf(z).exp() - 1.0).abs() < 1e-13, "{z}");
        }
    }
}
