//! Overdispersion between groups of trials, and outliers among the groups.
//!
//! Groups are, for example, the robots of one recipe.
//!
//! Model: group i succeeds k_i times in n_i trials. Its rate comes from a Beta distribution with mean μ and
//! overdispersion ρ = 1 / (a + b + 1). The variance of the rates is ρ μ (1 - μ); at ρ = 0 all rates are equal. Both are
//! estimated by maximum likelihood. The 95 % interval of ρ comes from the profile likelihood: its deviance is compared
//! with the square of the 97.5 % quantile of Student's t with one degree of freedom less than groups. The 95 % quantile
//! of chi squared, its limit for many groups, gives too narrow intervals for few groups.
//!
//! A group is an outlier if two tests against the other groups agree. The two-sided p-value of a group is the larger
//! one of them, and is compared with α after Holm's correction over the groups:
//!
//! - twice the smaller tail of the beta-binomial distribution that is fitted to the other groups by moments. It is exact
//!   in the counts, but takes the fitted parameters as known, so its tails are too light with few groups;
//! - Student's t of the externally studentised residual of the transformed rate asin √((k + 3/8) / (n + 3/4)), with the
//!   degrees of freedom of the variance between the other groups. It contains the uncertainty of mean and variance.
//!   That variance is at least the sampling variance.
//!
//! Limits: outliers need at least four groups, and with few of them only large differences are significant. At ρ = 0
//! and with two or three groups the interval is conservative. Sources: Skellam (1948), JRSS B 10 (the beta-binomial);
//! Anscombe (1948), Biometrika 35 (the transformation); Cook and Weisberg (1982), Residuals and Influence in
//! Regression; Holm (1979), Scand. J. Statist. 6.

use robogate_maths::beta::{ln_student_two_sided, student_quantile};
use robogate_maths::gamma::ln_gamma;

use crate::Trials;
use crate::multiplicity::holm;

/// Smallest number of groups for outlier detection.
pub const FEWEST: usize = 4;

/// The differences between groups.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Mean success rate of a group, μ.
    pub mean: f64,
    /// Overdispersion ρ, from 0 (equal rates) to 1 (each group always succeeds or always fails).
    pub rho: f64,
    /// 95 % interval of ρ.
    pub rho_95: [f64; 2],
    /// Standard deviation of the groups' rates, √(ρ μ (1 - μ)).
    pub deviation: f64,
    /// The interval of the deviation, from the interval of ρ at the estimated mean.
    pub deviation_95: [f64; 2],
    /// Number of groups with trials.
    pub groups: usize,
}

/// A group whose rate differs significantly from the other groups.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outlier {
    /// The position in the input.
    pub index: usize,
    /// The trials of the group.
    pub trials: Trials,
    /// Whether the group is worse than the others; otherwise it is better.
    pub worse: bool,
    /// The two-sided p-value after Holm's correction.
    pub p: f64,
}

/// ln of the beta-binomial likelihood of one group, without the binomial coefficient, which does not depend on the
/// parameters.
///
/// The logarithms are summed by Stirling's series. ρ = 0 is the binomial limit.
fn ln_likelihood(k: f64, n: f64, mean: f64, rho: f64) -> f64 {
    if rho <= 0.0 {
        let term = |count: f64, p: f64| if count > 0.0 { count * p.ln() } else { 0.0 };
        return term(k, mean) + term(n - k, 1.0 - mean);
    }
    let size = (1.0 - rho) / rho;
    rising(mean * size, k) + rising((1.0 - mean) * size, n - k) - rising(size, n)
}

/// ln of the rising factorial x (x+1) ... (x+m-1).
fn rising(x: f64, m: f64) -> f64 {
    ln_gamma(x + m) - ln_gamma(x)
}

/// Maximises a unimodal function in [low, high] by golden-section search. Returns position and value.
fn maximum(mut low: f64, mut high: f64, f: impl Fn(f64) -> f64) -> (f64, f64) {
    const SECTION: f64 = 0.618_033_988_749_895;
    let (mut a, mut b) = (high - SECTION * (high - low), low + SECTION * (high - low));
    let (mut at_a, mut at_b) = (f(a), f(b));
    // Each step keeps one of the two points: 0.618^36 is 3e-8 of the range.
    for _ in 0..36 {
        if at_a >= at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - SECTION * (high - low);
            at_a = f(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + SECTION * (high - low);
            at_b = f(b);
        }
    }
    let at = 0.5 * (low + high);
    (at, f(at))
}

/// The profile likelihood at ρ: the best mean, and its ln L.
fn profile(groups: &[(f64, f64)], rho: f64) -> (f64, f64) {
    maximum(1e-9, 1.0 - 1e-9, |mean| groups.iter().map(|(k, n)| ln_likelihood(*k, *n, mean, rho)).sum())
}

/// Estimates the differences between groups.
///
/// `None` with fewer than two groups with trials, or if all trials have the same outcome.
pub fn spread(tallies: &[Trials]) -> Option<Spread> {
    let groups: Vec<(f64, f64)> =
        tallies.iter().filter(|t| t.n() > 0).map(|t| (t.successes() as f64, t.n() as f64)).collect();
    let total: (f64, f64) = groups.iter().fold((0.0, 0.0), |sum, (k, n)| (sum.0 + k, sum.1 + n));
    if groups.len() < 2 || total.0 <= 0.0 || total.0 >= total.1 {
        return None;
    }
    // ρ is searched on a log scale. Below 1e-7 it is indistinguishable from 0.
    let (low, high) = (1e-7_f64.ln(), 0.999_f64.ln());
    let at = |log: f64| profile(&groups, log.exp()).1;
    let (log, inside) = maximum(low, high, at);
    let zero = profile(&groups, 0.0).1;
    let (rho, best) = if zero >= inside { (0.0, zero) } else { (log.exp(), inside) };
    let floor = best - 0.5 * student_quantile(groups.len() as f64 - 1.0, 0.95).powi(2);
    let cross = |mut inside: f64, mut outside: f64| {
        for _ in 0..24 {
            let middle = 0.5 * (inside + outside);
            if at(middle) >= floor {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        0.5 * (inside + outside)
    };
    let centre = if rho > 0.0 { log } else { low };
    let bottom = if zero >= floor { 0.0 } else { cross(centre, low).exp() };
    let top = if at(high) >= floor { 1.0 } else { cross(centre, high).exp() };
    let mean = profile(&groups, rho).0;
    let deviation = |rho: f64| (rho * mean * (1.0 - mean)).sqrt();
    Some(Spread {
        mean,
        rho,
        rho_95: [bottom, top],
        deviation: deviation(rho),
        deviation_95: [deviation(bottom), deviation(top)],
        groups: groups.len(),
    })
}

/// The outliers among the groups at the level `alpha` over all of them, smallest p-value first.
pub fn outliers(tallies: &[Trials], alpha: f64) -> Vec<Outlier> {
    let active: Vec<(usize, Trials)> = tallies.iter().copied().enumerate().filter(|(_, t)| t.n() > 0).collect();
    if active.len() < FEWEST {
        return Vec::new();
    }
    let judged: Vec<(f64, bool)> = (0..active.len()).map(|at| judge(&active, at)).collect();
    let p: Vec<f64> = judged.iter().map(|(p, _)| *p).collect();
    let Ok(adjusted) = holm(&p) else { return Vec::new() };
    let mut found: Vec<Outlier> = active
        .iter()
        .zip(&judged)
        .zip(adjusted)
        .filter(|(_, p)| *p <= alpha)
        .map(|(((index, trials), (_, worse)), p)| Outlier { index: *index, trials: *trials, worse: *worse, p })
        .collect();
    found.sort_by(|a, b| a.p.total_cmp(&b.p));
    found
}

/// Mean and overdispersion by moments (Kleinman 1973, JASA 68), fast enough to leave out each group in turn.
///
/// Half a success and half a failure are added to the pooled counts, which keeps the mean away from 0 and 1.
fn moments(tallies: &[Trials]) -> (f64, f64) {
    let n: f64 = tallies.iter().map(|t| t.n() as f64).sum();
    let k: f64 = tallies.iter().map(|t| t.successes() as f64).sum();
    let mean = (k + 0.5) / (n + 1.0);
    let variance = mean * (1.0 - mean);
    let scatter: f64 = tallies.iter().filter_map(|t| Some(t.n() as f64 * (t.rate()? - mean).powi(2))).sum();
    let squares: f64 = tallies.iter().map(|t| (t.n() as f64).powi(2)).sum();
    let free = tallies.len() as f64 - 1.0;
    let rho = (scatter - variance * free) / (variance * (n - squares / n - free));
    (mean, if rho.is_finite() { rho.clamp(0.0, 0.999) } else { 0.0 })
}

/// The two-sided p-value of one group among the others, and whether it is worse.
fn judge(active: &[(usize, Trials)], own: usize) -> (f64, bool) {
    let trials = active[own].1;
    let peers: Vec<Trials> = active.iter().enumerate().filter(|(at, _)| *at != own).map(|(_, (_, t))| *t).collect();
    let (mean, rho) = moments(&peers);
    let worse = trials.rate().unwrap_or(mean) < mean;
    (beta_binomial_p(trials, mean, rho, worse).max(residual_p(trials, &peers, rho)), worse)
}

/// Twice the tail of the beta-binomial distribution on the side of the group's count, including that count.
fn beta_binomial_p(trials: Trials, mean: f64, rho: f64, worse: bool) -> f64 {
    let (k, n) = (trials.successes(), trials.n());
    let ln_choose = |k: u64| {
        let (k, n) = (k as f64, n as f64);
        ln_gamma(n + 1.0) - ln_gamma(k + 1.0) - ln_gamma(n - k + 1.0)
    };
    let chance = |k: u64| (ln_choose(k) + ln_likelihood(k as f64, n as f64, mean, rho)).exp();
    // Terms are added until they no longer contribute.
    let mut tail = 0.0;
    let mut at = k;
    loop {
        let term = chance(at);
        tail += term;
        let end = if worse { 0 } else { n };
        if at == end || term < 1e-18 * tail {
            break;
        }
        at = if worse { at - 1 } else { at + 1 };
    }
    (2.0 * tail).min(1.0)
}

/// The two-sided p-value of the externally studentised residual of a group.
///
/// The variance of a transformed rate is (1 + (n - 1) ρ) / 4n up to a scale, which the peers give. Groups with few
/// trials thus have little weight. Without the scale, the variance with ρ = 0 is the sampling variance.
fn residual_p(own: Trials, peers: &[Trials], rho: f64) -> f64 {
    let transformed = |t: &Trials| ((t.successes() as f64 + 0.375) / (t.n() as f64 + 0.75)).sqrt().asin();
    let variance = |t: &Trials| (1.0 + (t.n() as f64 - 1.0) * rho) / (4.0 * t.n() as f64);
    let weight: f64 = peers.iter().map(|t| 1.0 / variance(t)).sum();
    let mean = peers.iter().map(|t| transformed(t) / variance(t)).sum::<f64>() / weight;
    let free = peers.len() as f64 - 1.0;
    let scale = peers.iter().map(|t| (transformed(t) - mean).powi(2) / variance(t)).sum::<f64>() / free;
    let error = (scale.max(1.0) * (variance(&own) + 1.0 / weight)).sqrt();
    ln_student_two_sided(free, (transformed(&own) - mean) / error).exp()
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;
    use robogate_maths::beta::beta_quantile;

    use super::*;
    use crate::resample::uniform;

    fn trials(k: u64, n: u64) -> Trials {
        Trials::new(k, n).unwrap()
    }

    #[test]
    fn interval_covers_the_true_spread() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut groups = |low: f64, high: f64| -> Vec<Trials> {
            let mut group = || {
                let rate = low + (high - low) * uniform(&mut rng);
                Trials::count((0..500).map(|_| uniform(&mut rng) < rate))
            };
            (0..30).map(|_| group()).collect()
        };
        let alike = spread(&groups(0.9, 0.9)).unwrap();
        assert!(alike.rho_95[0] <= 0.0 && alike.rho_95[1] < 0.02, "{alike:?}");
        // Uniform on 0.8 to 1.0 has a standard deviation of 0.2 / √12 = 0.0577.
        let differ = spread(&groups(0.8, 1.0)).unwrap();
        assert!(differ.deviation_95[0] < 0.0577 && 0.0577 < differ.deviation_95[1], "{differ:?}");
        assert!(differ.deviation_95[0] > 0.03);
    }

    #[test]
    fn only_worse_group_is_outlier() {
        let mut groups = [trials(474, 500); 5];
        assert_eq!(outliers(&groups, 0.05), []);
        groups[3] = trials(430, 500);
        let found = outliers(&groups, 0.05);
        assert_eq!(found.iter().map(|o| (o.index, o.worse)).collect::<Vec<_>>(), [(3, true)]);
        assert!(outliers(&groups[2..], 0.05).is_empty(), "three groups are not enough");
    }

    /// Groups of 1,000 trials whose rates come from a beta distribution with the mean 0.95.
    fn beta_groups(count: usize, rho: f64, rng: &mut ChaCha8Rng) -> Vec<Trials> {
        let size = (1.0 - rho) / rho;
        let mut group = || {
            let rate = beta_quantile(0.95 * size, 0.05 * size, uniform(rng));
            Trials::count((0..1_000).map(|_| uniform(rng) < rate))
        };
        (0..count).map(|_| group()).collect()
    }

    #[test]
    fn interval_covers_with_few_groups() {
        // The quantile of chi squared covers in 81 to 85 % of the cases.
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let covered = (0..60).filter(|_| {
            let [low, high] = spread(&beta_groups(3, 0.02, &mut rng)).unwrap().rho_95;
            low <= 0.02 && 0.02 <= high
        });
        assert!(covered.count() >= 57);
    }

    #[test]
    fn ordinary_spread_is_no_outlier() {
        // The fitted beta-binomial distribution alone names a group in half of the cases.
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        for (groups, rho) in [(4, 0.005), (4, 0.02), (6, 0.02)] {
            let named = (0..100).filter(|_| !outliers(&beta_groups(groups, rho, &mut rng), 0.05).is_empty()).count();
            assert!(named <= 12, "{groups} groups, overdispersion {rho}: {named} of 100");
        }
    }

    #[test]
    fn small_group_hides_no_outlier() {
        let mut groups = [trials(950, 1_000); 10];
        groups[4] = trials(860, 1_000);
        groups[7] = trials(0, 1);
        assert_eq!(outliers(&groups, 0.05).iter().map(|o| o.index).collect::<Vec<_>>(), [4]);
    }

    #[test]
    fn no_trials_give_no_spread() {
        assert_eq!(spread(&[]), None);
        assert_eq!(spread(&[trials(3, 5)]), None);
        assert_eq!(spread(&[trials(5, 5), trials(7, 7)]), None);
    }
}
