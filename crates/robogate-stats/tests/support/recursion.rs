//! The exact probability that the successes of rounds of scenarios with unequal rates reach a boundary.

use robogate_maths::beta::ln_binomial_pmf;

/// The probabilities of the number of successes of a round: some scenarios always succeed, some never, the others are equal.
pub(crate) fn round(m: u64, always: u64, never: u64, rate: f64) -> Vec<f64> {
    let others = m - always - never;
    let mut masses = vec![0.0; m as usize + 1];
    for k in 0..=others {
        let mass = if rate <= 0.0 {
            f64::from(u8::from(k == 0))
        } else if rate >= 1.0 {
            f64::from(u8::from(k == others))
        } else {
            ln_binomial_pmf(k as f64, others as f64, rate).exp()
        };
        masses[(always + k) as usize] += mass;
    }
    masses
}

/// The probability of reaching a boundary.
pub(crate) fn crossing(step: &[f64], boundary: &[u64]) -> f64 {
    let (mut going, mut crossed) = (vec![1.0], 0.0);
    for limit in boundary {
        let mut next = vec![0.0; going.len() + step.len() - 1];
        for (k, probability) in going.iter().enumerate().filter(|(_, p)| **p > 1e-18) {
            for (j, s) in step.iter().enumerate().filter(|(_, s)| **s > 1e-18) {
                next[k + j] += probability * s;
            }
        }
        for (k, probability) in next.iter_mut().enumerate() {
            if k as u64 >= *limit {
                crossed += std::mem::take(probability);
            }
        }
        going = next;
    }
    crossed
}
