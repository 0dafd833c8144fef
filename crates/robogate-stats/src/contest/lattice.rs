//! The exact distribution of the numbers of blocks that each of two policies wins.
//!
//! A cell is (s, b): s blocks had a winner, and the first policy won b of them.

/// The probabilities of one block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    /// Only the first policy succeeds.
    pub(super) first: f64,
    /// Only the second policy succeeds.
    pub(super) second: f64,
}

impl Step {
    /// Equal policies that differ in a share `d` of the blocks.
    pub(super) fn equal(d: f64) -> Self {
        Self { first: 0.5 * d, second: 0.5 * d }
    }
}

/// What a look does with the runs in a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum At {
    /// They go on.
    Open,
    /// They end for the policy that leads.
    Leader,
    /// They end without a winner.
    Neither,
}

/// How the runs end.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Course {
    /// The probability of an end for the first policy.
    pub(super) first: f64,
    /// The probability of an end for the second policy.
    pub(super) second: f64,
    /// The expected number of blocks.
    pub(super) blocks: f64,
}

/// Probabilities below this are not propagated.
const NEGLIGIBLE: f64 = 1e-18;

/// Propagates the distribution over `blocks` blocks, with a look after each of them.
///
/// `at(n, ahead, behind)` is asked about each cell after block n with ahead >= behind, where ahead is the number of blocks that the
/// leading policy won.
pub(super) fn course(blocks: u64, step: Step, mut at: impl FnMut(u64, u64, u64) -> At) -> Course {
    let size = blocks as usize + 1;
    let index = |s: usize, b: usize| s * (s + 1) / 2 + b;
    let mut mass = vec![0.0_f64; size * (size + 1) / 2];
    mass[0] = 1.0;
    let same = (1.0 - step.first - step.second).max(0.0);
    let mut out = Course::default();
    let mut going = 1.0;
    // The first and the last b of each s that runs have reached and not left; empty if the first is larger.
    let mut reached = vec![(usize::MAX, 0_usize); size];
    reached[0] = (0, 0);
    for n in 1..=blocks {
        out.blocks += going;
        going = 0.0;
        for s in (0..=n as usize).rev() {
            let (mut first, mut last) = reached[s];
            if let Some((before, until)) = s.checked_sub(1).map(|s| reached[s]).filter(|(from, to)| from <= to) {
                (first, last) = (first.min(before), last.max(until + 1));
            }
            let mut still = (usize::MAX, 0);
            for b in (first..=last).rev() {
                let mut here = mass[index(s, b)] * same;
                if s > 0 {
                    // From s - 1 winners so far: this block was won by the first, or by the second.
                    here += if b > 0 { mass[index(s - 1, b - 1)] * step.first } else { 0.0 };
                    here += if b < s { mass[index(s - 1, b)] * step.second } else { 0.0 };
                }
                mass[index(s, b)] = 0.0;
                if here < NEGLIGIBLE {
                    continue;
                }
                let (won, lost) = (b as u64, (s - b) as u64);
                match at(n, won.max(lost), won.min(lost)) {
                    At::Open => {
                        going += here;
                        mass[index(s, b)] = here;
                        still = (still.0.min(b), still.1.max(b));
                    }
                    At::Leader if won > lost => out.first += here,
                    At::Leader => out.second += here,
                    At::Neither => {}
                }
            }
            reached[s] = still;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use robogate_maths::beta::ln_binomial_pmf;

    use super::*;

    #[test]
    fn counts_are_trinomial() {
        let step = Step { first: 0.3, second: 0.1 };
        let last = |n: u64, ahead: u64, behind: u64| match (n, ahead, behind) {
            (12, 5, 2) => At::Leader,
            _ => At::Open,
        };
        let found = course(12, step, last);
        // Seven of twelve blocks have a winner, and five or two of those are won by the first policy.
        let seven = ln_binomial_pmf(7.0, 12.0, 0.4).exp();
        let five = seven * ln_binomial_pmf(5.0, 7.0, 0.75).exp();
        let two = seven * ln_binomial_pmf(2.0, 7.0, 0.75).exp();
        assert!((found.first - five).abs() < 1e-14 && (found.second - two).abs() < 1e-14, "{found:?}");
        assert_eq!(found.blocks, 12.0);
    }
}
