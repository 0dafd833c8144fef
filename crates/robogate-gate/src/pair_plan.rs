//! The plan of a comparison of two policies: its operating characteristic, computed before a run.
//!
//! Pairs are simulated for several true differences and shares of pairs that disagree, because both determine how many
//! pairs are needed. The simulation has a fixed seed, so equal questions give equal tables.

use robogate_core::Seed;
use robogate_stats::compare::Pairs;
use robogate_stats::group_sequential::PairedRun;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::GateError;

/// Simulated gates for each row.
const RUNS: u64 = 2_000;
/// True differences of the table, as multiples of the margin.
const DIFFERENCES: [f64; 6] = [1.0, 0.0, -0.5, -1.0, -2.0, -4.0];
/// Shares of pairs that disagree, in addition to the difference.
const DISAGREEMENT: [f64; 2] = [0.02, 0.1];

/// The operating characteristic of a comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairPlan {
    /// The non-inferiority margin.
    pub margin: f64,
    /// The error of each conclusion.
    pub alpha: f64,
    /// Pairs per round.
    pub per_round: u64,
    /// Maximum number of rounds.
    pub rounds: u64,
    /// Number of simulated gates for each row.
    pub runs: u64,
    /// The rows.
    pub at: Vec<PairOperating>,
}

/// Probabilities for one true difference and share of disagreement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairOperating {
    /// True success rate of this policy minus that of the other.
    pub difference: f64,
    /// Share of pairs in which exactly one succeeds.
    pub disagreement: f64,
    /// Probability of the conclusion "not worse by the margin".
    pub met: f64,
    /// Probability of the conclusion "worse by the margin".
    pub violated: f64,
    /// Probability of no conclusion.
    pub open: f64,
    /// Mean number of pairs until a conclusion, or until the budget is spent.
    pub pairs: f64,
}

impl PairPlan {
    /// Simulates the comparison.
    ///
    /// # Errors
    /// [`GateError::Margin`] if the margin is out of range.
    pub fn of(margin: f64, alpha: f64, per_round: u64, rounds: u64) -> Result<Self, GateError> {
        let mut test = PairedRun::new(margin, rounds, alpha, alpha)?;
        let mut at = Vec::new();
        for difference in DIFFERENCES.map(|multiple| multiple * margin) {
            for extra in DISAGREEMENT {
                let disagreement = (f64::abs(difference) + extra).min(1.0);
                at.push(simulate(&mut test, difference, disagreement, per_round, rounds));
            }
        }
        Ok(Self { margin, alpha, per_round, rounds, runs: RUNS, at })
    }
}

fn simulate(test: &mut PairedRun, difference: f64, disagreement: f64, per_round: u64, rounds: u64) -> PairOperating {
    // "Only the other" and "only this" have these probabilities.
    let other = 0.5 * (disagreement - difference);
    let mut counts = [0_u64; 2];
    let mut pairs = 0;
    for run in 0..RUNS {
        let mut stream = Seed::campaign(7).episode(run).stream("pairs");
        let mut found = Pairs::default();
        for round in 1..=rounds {
            for _ in 0..per_round {
                let u = stream.uniform();
                if u < other {
                    found.first_only += 1;
                } else if u < disagreement {
                    found.second_only += 1;
                } else {
                    found.both += 1;
                }
            }
            let decided = test.look(round, found);
            if decided.contains(&true) {
                counts[usize::from(decided[1])] += 1;
                break;
            }
        }
        pairs += found.n();
    }
    let share = |count: u64| count as f64 / RUNS as f64;
    let [met, violated] = counts.map(share);
    PairOperating {
        difference,
        disagreement,
        met,
        violated,
        open: 1.0 - met - violated,
        pairs: pairs as f64 / RUNS as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_stay_below_alpha() {
        let plan = PairPlan::of(0.05, 0.05, 68, 20).unwrap();
        // At a difference of exactly the margin both conclusions are wrong, each with probability alpha at most.
        let slack = 3.0 * (0.05_f64 * 0.95 / RUNS as f64).sqrt();
        for row in plan.at.iter().filter(|row| (row.difference + 0.05).abs() < 1e-9) {
            assert!(row.met <= 0.05 + slack && row.violated <= 0.05 + slack, "{row:?}");
        }
        let equal = plan.at.iter().find(|row| row.difference.abs() < 1e-9).unwrap();
        assert!(equal.met > 0.9 && equal.pairs < 400.0, "{equal:?}");
        assert!(PairPlan::of(0.0, 0.05, 68, 20).is_err());
    }
}
