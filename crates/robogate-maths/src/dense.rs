//! Small dense symmetric matrices, stored row-major in a `Vec<f64>`, for regressions of a few dozen columns.

/// Lower Cholesky factor L of a symmetric positive definite matrix, A = L Lᵀ.
#[derive(Debug, Clone)]
pub struct Cholesky {
    size: usize,
    lower: Vec<f64>,
}

impl Cholesky {
    /// Factors `matrix`.
    ///
    /// # Errors
    /// The index of the first row whose pivot is at most `tolerance` times its diagonal entry: earlier rows explain it.
    pub fn new(matrix: &[f64], size: usize, tolerance: f64) -> Result<Self, usize> {
        let (lower, kept) = pivots(matrix, size, tolerance);
        match (0..size).find(|i| kept.get(*i) != Some(i)) {
            Some(explained) => Err(explained),
            None => Ok(Self { size, lower }),
        }
    }

    /// L, row by row, with zeros above the diagonal.
    pub fn lower(&self) -> &[f64] {
        &self.lower
    }

    /// ln det A.
    pub fn ln_det(&self) -> f64 {
        (0..self.size).map(|i| 2.0 * self.lower[i * self.size + i].ln()).sum()
    }

    /// Solves A x = b in place.
    pub fn solve(&self, b: &mut [f64]) {
        self.forward(b);
        for i in (0..self.size).rev() {
            let mut value = b[i];
            for (k, &x) in b.iter().enumerate().take(self.size).skip(i + 1) {
                value -= self.lower[k * self.size + i] * x;
            }
            b[i] = value / self.lower[i * self.size + i];
        }
    }

    /// Solves L x = b in place.
    pub fn forward(&self, b: &mut [f64]) {
        for i in 0..self.size {
            let row = &self.lower[i * self.size..i * self.size + i];
            let value: f64 = row.iter().zip(b.iter()).map(|(l, x)| l * x).sum();
            b[i] = (b[i] - value) / self.lower[i * self.size + i];
        }
    }

    /// A⁻¹.
    pub fn inverse(&self) -> Vec<f64> {
        let n = self.size;
        let mut inverse = vec![0.0; n * n];
        let mut unit = vec![0.0; n];
        for j in 0..n {
            unit.fill(0.0);
            unit[j] = 1.0;
            self.solve(&mut unit);
            for i in 0..n {
                inverse[i * n + j] = unit[i];
            }
        }
        for i in 0..n {
            for j in 0..i {
                let mean = 0.5 * (inverse[i * n + j] + inverse[j * n + i]);
                inverse[i * n + j] = mean;
                inverse[j * n + i] = mean;
            }
        }
        inverse
    }
}

/// Cholesky factorization in the given order. Columns that earlier ones explain are left out.
///
/// Returns the factor, with zero rows for left-out columns, and the indices of the kept columns.
fn pivots(matrix: &[f64], size: usize, tolerance: f64) -> (Vec<f64>, Vec<usize>) {
    let mut lower = vec![0.0; size * size];
    let mut kept = Vec::with_capacity(size);
    for i in 0..size {
        for (at, &j) in kept.iter().enumerate() {
            let earlier: &[usize] = &kept[..at];
            let explained: f64 = earlier.iter().map(|&k| lower[i * size + k] * lower[j * size + k]).sum();
            lower[i * size + j] = (matrix[i * size + j] - explained) / lower[j * size + j];
        }
        let explained: f64 = kept.iter().map(|&k| lower[i * size + k] * lower[i * size + k]).sum();
        let pivot = matrix[i * size + i] - explained;
        // Written in this form to reject NaN as well.
        if pivot > tolerance * matrix[i * size + i] && pivot.is_finite() {
            lower[i * size + i] = pivot.sqrt();
            kept.push(i);
        } else {
            lower[i * size..(i + 1) * size].fill(0.0);
        }
    }
    (lower, kept)
}

/// Finds the columns of a Gram matrix that earlier columns explain up to `tolerance` of their square. Each comes with the
/// columns that explain it.
pub fn dependent_columns(gram: &[f64], size: usize, tolerance: f64) -> Vec<(usize, Vec<usize>)> {
    let (_, kept) = pivots(gram, size, tolerance);
    let mut dependent = Vec::new();
    for column in (0..size).filter(|i| !kept.contains(i)) {
        let before: Vec<usize> = kept.iter().copied().filter(|&k| k < column).collect();
        let m = before.len();
        let mut sub = vec![0.0; m * m];
        let mut rhs = vec![0.0; m];
        for (a, &i) in before.iter().enumerate() {
            rhs[a] = gram[i * size + column];
            for (b, &j) in before.iter().enumerate() {
                sub[a * m + b] = gram[i * size + j];
            }
        }
        let mut explaining = Vec::new();
        if let Ok(factor) = Cholesky::new(&sub, m, 0.0) {
            factor.solve(&mut rhs);
            let own = gram[column * size + column];
            for (a, &i) in before.iter().enumerate() {
                if rhs[a].powi(2) * gram[i * size + i] > 1e-8 * own {
                    explaining.push(i);
                }
            }
        }
        dependent.push((column, explaining));
    }
    dependent
}

/// Dot product in eight lanes to vectorise. The order of additions is fixed.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let (a_chunks, a_rest) = a.as_chunks::<8>();
    let (b_chunks, b_rest) = b.as_chunks::<8>();
    for (x, y) in a_chunks.iter().zip(b_chunks) {
        for k in 0..8 {
            lanes[k] += x[k] * y[k];
        }
    }
    let tail: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    lanes.iter().sum::<f64>() + tail
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_times_matrix_is_identity() {
        let a = [4.0, 2.0, 0.6, 2.0, 5.0, 1.0, 0.6, 1.0, 3.0];
        let inverse = Cholesky::new(&a, 3, 1e-12).unwrap().inverse();
        for i in 0..3 {
            for j in 0..3 {
                let entry: f64 = (0..3).map(|k| a[i * 3 + k] * inverse[k * 3 + j]).sum();
                assert!((entry - f64::from(u8::from(i == j))).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn dependent_column_names_its_sources() {
        // Columns u, v, w, u + w with orthonormal u, v, w.
        let gram = [
            1.0, 0.0, 0.0, 1.0, //
            0.0, 1.0, 0.0, 0.0, //
            0.0, 0.0, 1.0, 1.0, //
            1.0, 0.0, 1.0, 2.0,
        ];
        assert_eq!(dependent_columns(&gram, 4, 1e-10), vec![(3, vec![0, 2])]);
    }
}
