//! Newton's method for both likelihoods, on standardized columns.

use super::data::{BLOCK, Standardized, add_weighted_gram, mirror};
use robogate_maths::dense::{Cholesky, dot};

/// Smallest pivot of the information, as a fraction of its diagonal. Below it a direction has almost no curvature.
const PIVOT: f64 = 1e-12;
/// The same for the information without one cluster.
const SINGULAR: f64 = 1e-8;
/// Largest number of clusters for the jackknife.
const JACKKNIFED: usize = 500;
/// Maximum number of steps.
const MOST_STEPS: usize = 50;
/// Number of steps after which large steps indicate separation.
const SUSPICION: usize = 10;

/// Log-likelihood, its gradient and the information XᵀWX at one point.
pub(super) struct Local {
    pub(super) log_likelihood: f64,
    pub(super) gradient: Vec<f64>,
    pub(super) information: Vec<f64>,
}

/// A converged fit.
pub(super) struct Solution {
    pub(super) beta: Vec<f64>,
    pub(super) log_likelihood: f64,
    /// ln of the Jeffreys penalty, ½ ln det I, if it was used.
    pub(super) penalty: Option<f64>,
    pub(super) inverse_information: Vec<f64>,
    pub(super) iterations: usize,
}

/// A fit that did not converge, with its last point.
pub(super) struct Unsettled {
    pub(super) beta: Vec<f64>,
    pub(super) iterations: usize,
}

/// 1/(1+e^-t) and its logarithm.
pub(crate) fn logistic_and_log(t: f64) -> (f64, f64) {
    let e = (-t.abs()).exp();
    let log = t.min(0.0) - e.ln_1p();
    let p = if t >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) };
    (p, log)
}

pub(super) fn evaluate(x: &Standardized<'_>, beta: &[f64]) -> Local {
    let q = x.parameters();
    let mut log_likelihood = 0.0;
    let mut gradient = vec![0.0; q];
    let mut information = vec![0.0; q * q];
    let mut eta = [0.0; BLOCK];
    let mut residual = [0.0; BLOCK];
    let mut curvature = [0.0; BLOCK];
    x.for_each_block(|block| {
        block.predictor(beta, &mut eta);
        let mut sum = 0.0;
        for i in 0..BLOCK {
            // Probability of the observed outcome and of the other one.
            let margin = block.sign[i] * eta[i];
            let (p, log) = logistic_and_log(margin);
            let (other, _) = logistic_and_log(-margin);
            let w = block.weight[i];
            sum += w * log;
            residual[i] = w * block.sign[i] * other;
            curvature[i] = w * p * other;
        }
        log_likelihood += sum;
        for (j, g) in gradient.iter_mut().enumerate() {
            *g += dot(&residual, block.column(j));
        }
        add_weighted_gram(&mut information, q, block, &curvature);
    });
    mirror(&mut information, q);
    Local { log_likelihood, gradient, information }
}

/// The start of the search: all slopes are 0, and the intercept is the log-odds of the weighted rate.
fn start(x: &Standardized<'_>) -> Vec<f64> {
    let mut beta = vec![0.0; x.parameters()];
    let failures = x.weight - x.success_weight;
    if x.success_weight > 0.0 && failures > 0.0 {
        beta[0] = (x.success_weight / failures).ln();
    }
    beta
}

fn settled(step: &[f64], beta: &[f64]) -> bool {
    let scale = beta.iter().fold(1.0_f64, |m, b| m.max(b.abs()));
    step.iter().all(|s| s.abs() <= 1e-8 * scale)
}

/// Maximum likelihood by Newton's method. A step that lowers the likelihood is halved.
///
/// Towards a finite estimate the steps shrink quadratically. Under separation they stay near one unit of log-odds. If
/// the steps are still large after a few iterations, `separated` is called and may stop the fit.
pub(super) fn maximum_likelihood(
    x: &Standardized<'_>,
    mut separated: impl FnMut(&[f64]) -> bool,
) -> Result<Solution, Unsettled> {
    let q = x.parameters();
    let mut beta = start(x);
    let mut here = evaluate(x, &beta);
    for iteration in 1..=MOST_STEPS {
        let Ok(factor) = Cholesky::new(&here.information, q, PIVOT) else {
            return Err(Unsettled { beta, iterations: iteration });
        };
        let mut step = here.gradient.clone();
        factor.solve(&mut step);
        let slack = 1e-13 * here.log_likelihood.abs();
        let mut accepted = None;
        for _ in 0..40 {
            let trial: Vec<f64> = beta.iter().zip(&step).map(|(b, s)| b + s).collect();
            let there = evaluate(x, &trial);
            if there.log_likelihood >= here.log_likelihood - slack {
                accepted = Some((trial, there));
                break;
            }
            step.iter_mut().for_each(|s| *s *= 0.5);
        }
        let Some((trial, there)) = accepted else {
            return Err(Unsettled { beta, iterations: iteration });
        };
        let done = settled(&step, &trial);
        let strides = step.iter().any(|s| s.abs() > 0.01);
        beta = trial;
        here = there;
        if iteration == SUSPICION && strides && separated(&beta) {
            return Err(Unsettled { beta, iterations: iteration });
        }
        if done {
            let Ok(factor) = Cholesky::new(&here.information, q, PIVOT) else {
                return Err(Unsettled { beta, iterations: iteration });
            };
            return Ok(Solution {
                beta,
                log_likelihood: here.log_likelihood,
                penalty: None,
                inverse_information: factor.inverse(),
                iterations: iteration,
            });
        }
    }
    Err(Unsettled { beta, iterations: MOST_STEPS })
}

/// A point of the penalised likelihood with Firth's modified score.
struct Penalised {
    local: Local,
    factor: Cholesky,
    score: Vec<f64>,
}

impl Penalised {
    fn objective(&self) -> f64 {
        self.local.log_likelihood + 0.5 * self.factor.ln_det()
    }

    fn at(x: &Standardized<'_>, beta: &[f64]) -> Option<Self> {
        let q = x.parameters();
        let local = evaluate(x, beta);
        let factor = Cholesky::new(&local.information, q, 1e-14).ok()?;
        // Uⱼ = Σ (w (y - p) + h (½ - p)) xⱼ with the leverage h = w p (1-p) xᵀ I⁻¹ x.
        let mut score = local.gradient.clone();
        let inverse = factor.inverse();
        let mut eta = [0.0; BLOCK];
        let mut distance = [0.0; BLOCK];
        let mut image = [0.0; BLOCK];
        x.for_each_block(|block| {
            block.predictor(beta, &mut eta);
            // xᵀ I⁻¹ x of every row of the block, column by column to vectorise.
            distance.fill(0.0);
            for a in 0..q {
                image.fill(0.0);
                for b in 0..=a {
                    let entry = if a == b { 1.0 } else { 2.0 } * inverse[a * q + b];
                    for (t, v) in image.iter_mut().zip(block.column(b)) {
                        *t += entry * v;
                    }
                }
                for ((d, t), v) in distance.iter_mut().zip(&image).zip(block.column(a)) {
                    *d += t * v;
                }
            }
            for i in 0..BLOCK {
                let (p, _) = logistic_and_log(eta[i]);
                let (other, _) = logistic_and_log(-eta[i]);
                distance[i] *= block.weight[i] * p * other * 0.5 * (other - p);
            }
            for (j, s) in score.iter_mut().enumerate() {
                *s += dot(&distance, block.column(j));
            }
        });
        Some(Self { local, factor, score })
    }
}

/// Inverse of the submatrix with the rows and columns `free`.
fn inverse_of_part(matrix: &[f64], q: usize, free: &[usize]) -> Option<Vec<f64>> {
    let m = free.len();
    let mut part = vec![0.0; m * m];
    for (a, &i) in free.iter().enumerate() {
        for (b, &j) in free.iter().enumerate() {
            part[a * m + b] = matrix[i * q + j];
        }
    }
    Some(Cholesky::new(&part, m, 1e-14).ok()?.inverse())
}

/// Firth's penalised likelihood. `fixed` keeps one coefficient at a value (for profiles).
///
/// The modified score is the gradient of ln L + ½ ln det I, so the search is BFGS that starts from the inverse
/// information. Plain Fisher scoring ignores the curvature of the penalty and may not converge for small data.
pub(super) fn firth(
    x: &Standardized<'_>,
    fixed: Option<(usize, f64)>,
    from: Option<&[f64]>,
) -> Result<Solution, Unsettled> {
    const LONGEST: f64 = 3.0;
    const STEPS: usize = 500;
    let q = x.parameters();
    let mut beta = from.map_or_else(|| start(x), <[f64]>::to_vec);
    if let Some((j, value)) = fixed {
        beta[j] = value;
    }
    let free: Vec<usize> = (0..q).filter(|&j| fixed.is_none_or(|(f, _)| f != j)).collect();
    let m = free.len();
    let give_up = |beta: Vec<f64>, iterations| Err(Unsettled { beta, iterations });
    let Some(mut here) = Penalised::at(x, &beta) else {
        return give_up(beta, 0);
    };
    let Some(mut inverse) = inverse_of_part(&here.local.information, q, &free) else {
        return give_up(beta, 0);
    };
    let mut fresh = true;
    for iteration in 1..=STEPS {
        let mut step: Vec<f64> =
            (0..m).map(|a| (0..m).map(|b| inverse[a * m + b] * here.score[free[b]]).sum()).collect();
        let longest = step.iter().fold(0.0_f64, |l, s| l.max(s.abs()));
        if longest > LONGEST {
            step.iter_mut().for_each(|s| *s *= LONGEST / longest);
        }
        let slack = 1e-13 * here.objective().abs();
        let mut accepted = None;
        for _ in 0..40 {
            let mut trial = beta.clone();
            for (&i, s) in free.iter().zip(&step) {
                trial[i] += s;
            }
            if let Some(there) = Penalised::at(x, &trial)
                && there.objective() >= here.objective() - slack
            {
                accepted = Some((trial, there));
                break;
            }
            step.iter_mut().for_each(|s| *s *= 0.5);
        }
        let Some((trial, there)) = accepted else {
            return give_up(beta, iteration);
        };
        let done = settled(&step, &trial);
        // Change of the gradient along the step.
        let change: Vec<f64> = free.iter().map(|&i| here.score[i] - there.score[i]).collect();
        beta = trial;
        here = there;
        if done && fresh {
            return Ok(Solution {
                beta,
                log_likelihood: here.local.log_likelihood,
                penalty: Some(0.5 * here.factor.ln_det()),
                inverse_information: here.factor.inverse(),
                iterations: iteration,
            });
        }
        let along: f64 = step.iter().zip(&change).map(|(s, y)| s * y).sum();
        if done || along <= 0.0 {
            // A small step of an outdated approximation does not imply convergence. Restart from the information.
            let Some(renewed) = inverse_of_part(&here.local.information, q, &free) else {
                return give_up(beta, iteration);
            };
            inverse = renewed;
            fresh = true;
        } else {
            fresh = false;
            update(&mut inverse, &step, &change, along);
        }
    }
    give_up(beta, STEPS)
}

/// BFGS: H ← (1 - ρ s yᵀ) H (1 - ρ y sᵀ) + ρ s sᵀ with ρ = 1 / sᵀy.
fn update(inverse: &mut [f64], step: &[f64], change: &[f64], along: f64) {
    let m = step.len();
    let image: Vec<f64> = (0..m).map(|a| (0..m).map(|b| inverse[a * m + b] * change[b]).sum()).collect();
    let curvature: f64 = change.iter().zip(&image).map(|(y, hy)| y * hy).sum();
    for a in 0..m {
        for b in 0..m {
            inverse[a * m + b] += (1.0 + curvature / along) * step[a] * step[b] / along
                - (image[a] * step[b] + step[a] * image[b]) / along;
        }
    }
}

/// I⁻¹ (Σ w² (y-p)² x xᵀ) I⁻¹: the covariance for weights that are not counts.
pub(super) fn sandwich(x: &Standardized<'_>, solution: &Solution) -> Vec<f64> {
    let q = x.parameters();
    let mut meat = vec![0.0; q * q];
    let mut eta = [0.0; BLOCK];
    let mut squared = [0.0; BLOCK];
    x.for_each_block(|block| {
        block.predictor(&solution.beta, &mut eta);
        for i in 0..BLOCK {
            let (other, _) = logistic_and_log(-block.sign[i] * eta[i]);
            squared[i] = (block.weight[i] * other).powi(2);
        }
        add_weighted_gram(&mut meat, q, block, &squared);
    });
    mirror(&mut meat, q);
    let bread = &solution.inverse_information;
    product(bread, &product(&meat, bread, q), q)
}

/// The covariance if rows come in clusters, and the number of clusters.
///
/// With at most [`JACKKNIFED`] clusters it is that of the jackknife: (G-1)/G Σ dᵢ dᵢᵀ, where dᵢ = (I - Iᵢ)⁻¹ sᵢ is the change of
/// the coefficients without cluster i, from its information Iᵢ and its score sᵢ (one Newton step). Without a cluster that
/// determines a coefficient alone, I - Iᵢ is singular, and I replaces it. With more clusters, dᵢ = I⁻¹ sᵢ and the factor is
/// G/(G-1). Sources: Liang and Zeger (1986), Biometrika 73; Mancl and DeRouen (2001), Biometrics 57.
pub(super) fn clustered(x: &Standardized<'_>, solution: &Solution, of_row: &[usize]) -> (Vec<f64>, usize) {
    let q = x.parameters();
    let most = of_row.iter().max().map_or(0, |last| last + 1);
    let jackknife = most <= JACKKNIFED;
    let mut scores = vec![0.0; most * q];
    let mut parts = vec![0.0; if jackknife { most * q * q } else { 0 }];
    let mut whole = vec![0.0; q * q];
    let mut used = vec![false; most];
    let mut eta = [0.0; BLOCK];
    x.for_each_block(|block| {
        block.predictor(&solution.beta, &mut eta);
        for i in (0..block.rows).filter(|i| block.weight[*i] > 0.0) {
            let cluster = of_row[block.first_row + i];
            used[cluster] = true;
            let (other, _) = logistic_and_log(-block.sign[i] * eta[i]);
            let (score, curvature) = (block.weight[i] * block.sign[i] * other, block.weight[i] * other * (1.0 - other));
            for a in 0..q {
                let of_a = block.x[a * BLOCK + i];
                scores[cluster * q + a] += score * of_a;
                for b in (0..q).filter(|_| jackknife) {
                    let part = curvature * of_a * block.x[b * BLOCK + i];
                    parts[cluster * q * q + a * q + b] += part;
                    whole[a * q + b] += part;
                }
            }
        }
    });
    let mut covariance = vec![0.0; q * q];
    for cluster in (0..most).filter(|cluster| used[*cluster]) {
        let score = &scores[cluster * q..(cluster + 1) * q];
        let row = |a: usize| &solution.inverse_information[a * q..(a + 1) * q];
        let mut step: Vec<f64> = (0..q).map(|a| dot(row(a), score)).collect();
        if jackknife {
            let own = &parts[cluster * q * q..(cluster + 1) * q * q];
            let without: Vec<f64> = whole.iter().zip(own).map(|(all, own)| all - own).collect();
            if let Ok(factor) = Cholesky::new(&without, q, SINGULAR) {
                step.copy_from_slice(score);
                factor.solve(&mut step);
            }
        }
        for a in 0..q {
            for b in 0..q {
                covariance[a * q + b] += step[a] * step[b];
            }
        }
    }
    let clusters = used.iter().filter(|used| **used).count();
    let g = clusters as f64;
    let factor = if jackknife { (g - 1.0) / g } else { g / (g - 1.0) };
    covariance.iter_mut().for_each(|value| *value *= factor);
    (covariance, clusters)
}

/// The product A B of square row-major matrices.
pub(super) fn product(a: &[f64], b: &[f64], q: usize) -> Vec<f64> {
    let mut c = vec![0.0; q * q];
    for i in 0..q {
        for k in 0..q {
            for j in 0..q {
                c[i * q + j] += a[i * q + k] * b[k * q + j];
            }
        }
    }
    c
}
