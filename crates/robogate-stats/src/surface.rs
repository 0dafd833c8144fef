//! A smooth success rate over two parameters, with its uncertainty.
//!
//! The log-odds of success are a Gaussian process over the unit square: a Gaussian kernel by random Fourier features
//! ([`crate::fourier`]) and a plane. Surfaces of several length scales and prior variances are averaged by their evidence,
//! so that few rows give a flat and wide surface, and many rows a detailed and narrow one. Rows enter as counts of a grid: the cost does not depend on
//! their number.
//!
//! The interval at a point is that of the log-odds, mean ± z standard deviations of the posterior. It is pointwise: it
//! holds on average over the square, and not for all points at once.
//!
//! Sources: Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, chapters 3 and 5; Hoeting et al.
//! (1999), Statistical Science 14(4), for averaging.

use robogate_maths::normal;

use crate::fourier::Fourier;
use crate::logistic::{Data, logistic_and_log};
use crate::ridge::{RidgeFit, fit};
use crate::{Confidence, Interval};

/// Frequencies of the features.
const FREQUENCIES: usize = 28;
/// Length scales that are compared, in units of the range of a parameter.
const LENGTH_SCALES: [f64; 4] = [0.2, 0.35, 0.7, 1.4];
/// Prior variances that are compared.
const PRIORS: [f64; 4] = [0.3, 2.0, 12.0, 60.0];
/// Factor of the plane's columns: its prior is wider than that of the features.
const PLANE: f64 = 6.0;
/// Share of the largest evidence below which a surface is left out of the average.
const NEGLIGIBLE: f64 = 1e-3;
/// The seed of the frequencies. Equal data give equal surfaces.
const SEED: u64 = 20;

/// A fitted surface.
#[derive(Debug)]
pub struct Surface {
    fourier: Fourier,
    /// Fits with their length scales and their shares of the evidence.
    fits: Vec<(RidgeFit, f64, f64)>,
}

/// The rate at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceRate {
    /// The mean of the rate over the posterior, approximately.
    pub rate: f64,
    /// Its interval.
    pub interval: Interval,
}

impl Surface {
    /// Fits successes and failures in `nx` x `ny` cells of equal size over the unit square; x varies fastest. Rows with sampling
    /// weights count as that many independent ones. `None` if the number of cells does not match, or without both outcomes.
    pub fn fit(cells: &[[f64; 2]], nx: usize, ny: usize) -> Option<Self> {
        if cells.len() != nx * ny || cells.is_empty() {
            return None;
        }
        let (mut x, mut y, mut outcomes, mut weights) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (i, cell) in cells.iter().enumerate() {
            for (success, count) in [true, false].into_iter().zip(*cell) {
                if count > 0.0 {
                    x.push(((i % nx) as f64 + 0.5) / nx as f64);
                    y.push(((i / nx) as f64 + 0.5) / ny as f64);
                    outcomes.push(success);
                    weights.push(count);
                }
            }
        }
        let fourier = Fourier::new(2, FREQUENCIES, SEED);
        let mut fits: Vec<(RidgeFit, f64, f64)> = Vec::new();
        for length_scale in LENGTH_SCALES {
            let columns = columns(&fourier, &x, &y, length_scale)?;
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            let data = Data::new(&slices, &outcomes, Some(&weights)).ok()?;
            for prior in PRIORS {
                // A combination that does not converge is not a candidate.
                let Ok(found) = fit(data, prior) else { continue };
                fits.push((found, length_scale, 0.0));
            }
        }
        let most = fits.iter().map(|(fit, ..)| fit.log_evidence).fold(f64::NEG_INFINITY, f64::max);
        fits.iter_mut().for_each(|(fit, _, share)| *share = (fit.log_evidence - most).exp());
        fits.retain(|(_, _, share)| *share > NEGLIGIBLE);
        let total: f64 = fits.iter().map(|(_, _, share)| share).sum();
        fits.iter_mut().for_each(|(_, _, share)| *share /= total);
        (!fits.is_empty()).then_some(Self { fourier, fits })
    }

    /// The mean length scale, in units of the range of a parameter.
    pub fn length_scale(&self) -> f64 {
        self.fits.iter().map(|(_, length_scale, share)| share * length_scale).sum()
    }

    /// The rates at points of the unit square. `None` if the coordinates differ in length.
    pub fn at(&self, x: &[f64], y: &[f64], confidence: Confidence) -> Option<Vec<SurfaceRate>> {
        if x.len() != y.len() {
            return None;
        }
        // Mean and mean square of the mixture.
        let mut moments = vec![(0.0, 0.0); x.len()];
        for (fit, length_scale, share) in &self.fits {
            let columns = columns(&self.fourier, x, y, *length_scale)?;
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            for (moments, (eta, variance)) in moments.iter_mut().zip(fit.posterior(&slices)?) {
                moments.0 += share * eta;
                moments.1 += share * (variance + eta * eta);
            }
        }
        let z = normal::quantile(1.0 - confidence.tail());
        let rate = |(eta, square): (f64, f64)| {
            let variance = (square - eta * eta).max(0.0);
            let half = z * variance.sqrt();
            let p = |t: f64| logistic_and_log(t).0;
            let moderated = eta / (1.0 + std::f64::consts::PI * variance / 8.0).sqrt();
            SurfaceRate { rate: p(moderated), interval: Interval { low: p(eta - half), high: p(eta + half) } }
        };
        Some(moments.into_iter().map(rate).collect())
    }
}

fn columns(fourier: &Fourier, x: &[f64], y: &[f64], length_scale: f64) -> Option<Vec<Vec<f64>>> {
    let mut columns = fourier.columns(&[x, y], length_scale)?;
    columns.extend([x, y].map(|c| c.iter().map(|v| PLANE * (v - 0.5)).collect()));
    Some(columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    const SIDE: usize = 20;

    fn sampled(seed: u64, rows: usize, law: impl Fn(f64, f64) -> f64) -> Vec<[f64; 2]> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut counts = vec![[0.0; 2]; SIDE * SIDE];
        for _ in 0..rows {
            let (x, y) = (uniform(&mut rng), uniform(&mut rng));
            let cell = &mut counts[(y * SIDE as f64) as usize * SIDE + (x * SIDE as f64) as usize];
            cell[usize::from(uniform(&mut rng) >= law(x, y))] += 1.0;
        }
        counts
    }

    #[test]
    fn intervals_cover_the_rate() {
        let laws: [fn(f64, f64) -> f64; 3] = [
            |x, y| logistic_and_log(6.0 * x - 4.0 * y).0,
            |x, y| logistic_and_log(1.0 - 20.0 * (x - 0.5).powi(2) + 3.0 * (x - 0.5) * y).0,
            |_, _| 0.3,
        ];
        let points: Vec<(f64, f64)> =
            (0..100).map(|i| ((f64::from(i % 10) + 0.5) / 10.0, (f64::from(i / 10) + 0.5) / 10.0)).collect();
        let (x, y): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
        let mut coverage = Vec::new();
        for law in laws {
            for rows in [600, 3_000] {
                let mut covered = 0;
                for seed in 0..8 {
                    let surface = Surface::fit(&sampled(seed, rows, law), SIDE, SIDE).unwrap();
                    let rates = surface.at(&x, &y, Confidence::P95).unwrap();
                    covered += points.iter().zip(rates).filter(|((x, y), r)| r.interval.contains(law(*x, *y))).count();
                }
                coverage.push(covered as f64 / 800.0);
            }
        }
        // Points of one surface are dependent: the standard deviation of a coverage is about 4 %.
        assert!(coverage.iter().all(|c| *c > 0.85), "{coverage:?}");
        assert!(coverage.iter().sum::<f64>() / 6.0 > 0.92, "{coverage:?}");
    }

    #[test]
    fn one_outcome_gives_no_surface() {
        assert!(Surface::fit(&[[5.0, 0.0]; 4], 2, 2).is_none());
        assert!(Surface::fit(&[[2.0, 3.0]; 4], 3, 2).is_none());
        let surface = Surface::fit(&[[2.0, 3.0]; 4], 2, 2).unwrap();
        assert!(surface.at(&[0.1], &[], Confidence::P95).is_none());
    }
}
