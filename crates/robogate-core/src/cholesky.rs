//! Cholesky's factor of a correlation matrix.

/// The lower triangular L with C = L L', row by row. Where C is not safely positive definite: the first row that shows
/// it.
pub(crate) fn cholesky(c: &[f64], d: usize) -> Result<Vec<f64>, usize> {
    let mut l = vec![0.0; d * d];
    for i in 0..d {
        for j in 0..=i {
            let rest = c[i * d + j] - (0..j).map(|k| l[i * d + k] * l[j * d + k]).sum::<f64>();
            if i == j {
                if rest <= 1e-6 {
                    return Err(i);
                }
                l[i * d + i] = rest.sqrt();
            } else {
                l[i * d + j] = rest / l[j * d + j];
            }
        }
    }
    Ok(l)
}
