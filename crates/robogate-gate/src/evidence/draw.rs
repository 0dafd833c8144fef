//! Chooses the rows that a verifier runs again.

use std::collections::BTreeSet;

use super::EvidenceError;

/// Chooses `k` different positions below `n` at random, sorted; all of them if there are fewer.
///
/// The numbers come from the operating system: the author of the evidence must not be able to predict them.
#[expect(clippy::disallowed_methods, reason = "the author of evidence must not predict which rows are run again")]
pub fn random_positions(n: u64, k: u64) -> Result<Vec<u64>, EvidenceError> {
    if k >= n {
        return Ok((0..n).collect());
    }
    // Floyd's algorithm (Bentley and Floyd 1987): each subset of k has the same probability.
    let mut chosen = BTreeSet::new();
    for upper in n - k..n {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|e| EvidenceError::Random(e.to_string()))?;
        // The remainder of 128 bits is uniform to within 2^-64.
        let position = (u128::from_le_bytes(bytes) % u128::from(upper + 1)) as u64;
        chosen.insert(if chosen.contains(&position) { upper } else { position });
    }
    Ok(chosen.into_iter().collect())
}
