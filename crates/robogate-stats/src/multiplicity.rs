//! Corrections for multiple tests on one data set.
//!
//! - [`holm`]: step-down adjusted p-values. The probability of any false rejection is at most α under any dependence.
//! - [`intersection_union`]: tests the claim "it holds in all of them". The claim is shown at level α if each part is,
//!   so its p-value is the largest. No adjustment is needed within a claim; use Holm between several joint claims.
//!
//! Limit: each p-value must be valid by itself, and the family must be fixed before looking at the data. Sources: Holm
//! (1979), Scandinavian Journal of Statistics 6; Berger (1982), Technometrics 24.

/// A number that is not a p-value.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("p-value {index} is {value}. Expected a number from 0 to 1")]
pub struct NotAPValue {
    /// Position in the input.
    pub index: usize,
    /// Value found.
    pub value: f64,
}

fn check(p_values: &[f64]) -> Result<(), NotAPValue> {
    match p_values.iter().position(|p| !(0.0..=1.0).contains(p)) {
        Some(index) => Err(NotAPValue { index, value: p_values[index] }),
        None => Ok(()),
    }
}

/// Holm's adjusted p-values, in the input order. Reject a hypothesis if its adjusted value is at most α.
///
/// # Errors
/// [`NotAPValue`] for anything outside [0, 1].
pub fn holm(p_values: &[f64]) -> Result<Vec<f64>, NotAPValue> {
    check(p_values)?;
    let m = p_values.len();
    let mut order: Vec<usize> = (0..m).collect();
    order.sort_by(|&a, &b| p_values[a].total_cmp(&p_values[b]));
    let mut adjusted = vec![0.0; m];
    let mut largest = 0.0_f64;
    for (rank, &i) in order.iter().enumerate() {
        largest = largest.max((m - rank) as f64 * p_values[i]).min(1.0);
        adjusted[i] = largest;
    }
    Ok(adjusted)
}

/// The p-value of the claim "every one of these claims holds". `None` without claims.
///
/// # Errors
/// [`NotAPValue`] for anything outside [0, 1].
pub fn intersection_union(p_values: &[f64]) -> Result<Option<f64>, NotAPValue> {
    check(p_values)?;
    Ok(p_values.iter().copied().reduce(f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adjustment_keeps_order() {
        let p = [0.04, 0.001, 0.03, 0.03, 0.9];
        let a = holm(&p).unwrap();
        for i in 0..5 {
            assert!(a[i] >= p[i]);
            for j in 0..5 {
                assert!(p[i] > p[j] || a[i] <= a[j]);
            }
        }
    }

    #[test]
    fn no_claims_give_no_p_value() {
        assert_eq!(intersection_union(&[]), Ok(None));
        assert_eq!(intersection_union(&[0.01, 0.2]), Ok(Some(0.2)));
        assert!(holm(&[f64::NAN]).is_err());
    }
}
