//! Random Fourier features: columns whose products approximate a Gaussian kernel.
//!
//! With m frequencies w drawn from N(0, 1/l²) in each coordinate, the 2m columns cos(w·x)/sqrt(m) and
//! sin(w·x)/sqrt(m) have φ(x)·φ(y) = (1/m) Σ cos(w·(x - y)), whose expectation is exp(-|x - y|²/(2 l²)); its standard
//! error is at most 1/sqrt(2m). A linear model on them is a Gaussian process on that kernel, up to this error.
//! Sources: Rahimi and Recht (2007), NeurIPS 20; Sutherland and Schneider (2015), UAI, for sine and cosine in pairs.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::resample::uniform;

/// Frequencies for a number of coordinates, at length scale 1.
#[derive(Debug, Clone)]
pub struct Fourier {
    /// One row of `dimensions` for each frequency.
    frequencies: Vec<f64>,
    dimensions: usize,
}

impl Fourier {
    /// Draws `frequencies` random frequencies. The same seed gives the same frequencies.
    pub fn new(dimensions: usize, frequencies: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Box and Muller (1958): two normal numbers from two uniform ones. The first must not be 0.
        let mut normal = || {
            let radius = (-2.0 * (1.0 - uniform(&mut rng)).ln()).sqrt();
            radius * (std::f64::consts::TAU * uniform(&mut rng)).cos()
        };
        Self { frequencies: (0..dimensions * frequencies).map(|_| normal()).collect(), dimensions }
    }

    /// The feature columns of rows with these coordinates (column by column), with one length scale for all. `None` if
    /// the number of coordinates or their lengths do not match.
    pub fn columns(&self, coordinates: &[&[f64]], length_scale: f64) -> Option<Vec<Vec<f64>>> {
        let rows = coordinates.first()?.len();
        if coordinates.len() != self.dimensions || coordinates.iter().any(|c| c.len() != rows) {
            return None;
        }
        let scale = (self.dimensions as f64 / self.frequencies.len() as f64).sqrt();
        let mut columns = Vec::with_capacity(2 * self.frequencies.len() / self.dimensions);
        for frequency in self.frequencies.chunks_exact(self.dimensions) {
            let mut angle = vec![0.0; rows];
            for (w, x) in frequency.iter().zip(coordinates) {
                angle.iter_mut().zip(*x).for_each(|(a, x)| *a += w / length_scale * x);
            }
            columns.push(angle.iter().map(|a| scale * a.cos()).collect());
            columns.push(angle.iter().map(|a| scale * a.sin()).collect());
        }
        Some(columns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feature_products_match_gaussian_kernel() {
        let m = 20_000;
        let fourier = Fourier::new(3, m, 1);
        let (a, b, c) = ([0.0, 0.3, 1.5, 0.0], [0.0, -0.4, 0.2, 2.0], [0.0, 0.9, -1.0, 0.0]);
        for l in [0.7, 2.0] {
            let columns = fourier.columns(&[&a, &b, &c], l).unwrap();
            assert_eq!(columns.len(), 2 * m);
            for i in 0..4 {
                for j in 0..=i {
                    let product: f64 = columns.iter().map(|column| column[i] * column[j]).sum();
                    let square = (a[i] - a[j]).powi(2) + (b[i] - b[j]).powi(2) + (c[i] - c[j]).powi(2);
                    let kernel = (-square / (2.0 * l * l)).exp();
                    // The tolerance is five standard errors.
                    assert!((product - kernel).abs() < 5.0 / (2.0 * m as f64).sqrt(), "{product} {kernel}");
                }
            }
        }
    }

    #[test]
    fn mismatched_coordinates_are_rejected() {
        let fourier = Fourier::new(2, 4, 1);
        assert!(fourier.columns(&[&[1.0]], 1.0).is_none());
        assert!(fourier.columns(&[&[1.0], &[1.0, 2.0]], 1.0).is_none());
        assert!(fourier.columns(&[], 1.0).is_none());
    }
}
