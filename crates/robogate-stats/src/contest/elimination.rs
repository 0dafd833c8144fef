//! The best of several policies: all run the same blocks, and a policy leaves once another one is shown to be better.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use super::boundary::Boundary;
use super::intervals::{PairInterval, Won, difference};
use super::{ContestError, MOST_POLICIES, check};
use crate::interval::{Confidence, Interval, Trials};
use crate::resample::uniform;

/// What the error probability of a contest bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Guarantee {
    /// The best policy is eliminated at most this often. One of several equally good policies may be eliminated.
    BestStays,
    /// A policy that is as good as the best one is eliminated at most this often, whichever it is. This needs more blocks.
    NoFalseElimination,
}

impl Guarantee {
    /// The error of the test of one pair, on both sides together, if `error` is that of the whole contest. Equal policies divide it
    /// evenly, and of two unequal ones the better one is eliminated even less often.
    pub fn error_of_pair(self, policies: usize, error: f64) -> f64 {
        let n = policies.max(2) as f64;
        match self {
            Self::BestStays => 2.0 * error / (n - 1.0),
            Self::NoFalseElimination => 2.0 * error / (n * (n - 1.0)),
        }
    }
}

/// The blocks of a contest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Schedule {
    /// Blocks between two looks, for example the scenarios of a round. 1 for a look after each block.
    pub per_look: u64,
    /// The largest number of looks.
    pub looks: u64,
}

/// An eliminated policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dropped {
    /// Position of the policy.
    pub policy: usize,
    /// Position of a policy that is better.
    pub by: usize,
    /// The look, numbered from 1.
    pub look: u64,
}

/// How a contest ends for given true rates, by simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExpectedContest {
    /// Share of contests in which only policies with the highest rate are left.
    pub best_alone: f64,
    /// Share of contests in which the first policy with the highest rate was eliminated.
    pub best_dropped: f64,
    /// Share of contests in which any policy with the highest rate was eliminated.
    pub any_best_dropped: f64,
    /// Mean number of trials of all policies together.
    pub trials: f64,
    /// Mean number of blocks until the first elimination, among contests with one. `None` without any.
    pub first_after: Option<f64>,
    /// Mean number of policies that are left.
    pub left: f64,
}

/// The blocks for and against the claim that one policy is better than another.
///
/// An invalid trial counts in the worst case for the claim: as a failure of the policy that would be better, and as a success of the
/// other one. If it had been valid, the statistic could only be larger, so that the error holds for any reason of invalid trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Claim {
    won: u64,
    lost: u64,
}

impl Claim {
    /// Adds a block: the trial of the policy that would be better, and that of the other one.
    fn add(&mut self, better: Option<bool>, other: Option<bool>) {
        let (better, other) = (better.unwrap_or(false), other.unwrap_or(true));
        self.won += u64::from(better && !other);
        self.lost += u64::from(other && !better);
    }
}

/// A contest of several policies.
///
/// Call [`Elimination::look`] with the outcomes of the blocks since the last look. Policies that it returns need no further trials.
#[derive(Debug, Clone, PartialEq)]
pub struct Elimination {
    guarantee: Guarantee,
    schedule: Schedule,
    boundary: Boundary,
    /// The number of looks so far.
    at: u64,
    /// For each pair i < j, the valid blocks that each won, after each look at which both ran.
    pairs: Vec<Vec<Won>>,
    /// For each pair i < j, the blocks of "i is better", and those of "j is better".
    claims: Vec<[Claim; 2]>,
    rates: Vec<(u64, u64)>,
    dropped: Vec<Option<Dropped>>,
}

impl Elimination {
    /// Plans a contest. `error` is the probability that `guarantee` bounds, over all pairs and looks.
    ///
    /// # Errors
    /// A number of policies or blocks, or an error, that cannot be planned.
    pub fn new(policies: usize, schedule: Schedule, guarantee: Guarantee, error: f64) -> Result<Self, ContestError> {
        if !(2..=MOST_POLICIES).contains(&policies) {
            return Err(ContestError::Policies(policies));
        }
        check(schedule.per_look.saturating_mul(schedule.looks), error)?;
        let boundary = Boundary::new(schedule.per_look, schedule.looks, guarantee.error_of_pair(policies, error));
        Ok(Self {
            guarantee,
            schedule,
            boundary,
            at: 0,
            pairs: vec![Vec::new(); policies * (policies - 1) / 2],
            claims: vec![[Claim::default(); 2]; policies * (policies - 1) / 2],
            rates: vec![(0, 0); policies],
            dropped: vec![None; policies],
        })
    }

    /// Adds the blocks since the last look, and eliminates policies. A block has an outcome for each policy: `None` if it did not run
    /// or if its trial is invalid. Outcomes of eliminated policies are ignored. Returns the policies that leave now.
    ///
    /// An invalid trial counts against each elimination: as a success of the policy that would leave, and as a failure of the other
    /// one. Rates and differences leave it out.
    ///
    /// # Errors
    /// A block with another number of outcomes. Nothing is added then.
    pub fn look(&mut self, blocks: &[Vec<Option<bool>>]) -> Result<Vec<Dropped>, ContestError> {
        let expected = self.rates.len();
        if let Some(block) = blocks.iter().find(|block| block.len() != expected) {
            return Err(ContestError::Outcomes { expected, found: block.len() });
        }
        self.at += 1;
        let left = self.best_set();
        for &i in &left {
            let valid = blocks.iter().filter_map(|block| block[i]);
            for success in valid {
                self.rates[i].0 += u64::from(success);
                self.rates[i].1 += 1;
            }
            for &j in left.iter().filter(|j| **j > i) {
                let looks = &mut self.pairs[place(i, j)];
                let mut won = looks.last().copied().unwrap_or_default();
                for (first, second) in blocks.iter().filter_map(|block| block[i].zip(block[j])) {
                    won.first += u64::from(first && !second);
                    won.second += u64::from(second && !first);
                    won.blocks += 1;
                }
                looks.push(won);
                let [forth, back] = &mut self.claims[place(i, j)];
                for block in blocks {
                    forth.add(block[i], block[j]);
                    back.add(block[j], block[i]);
                }
            }
        }
        let out: Vec<Dropped> = left.iter().filter_map(|&policy| self.beaten(policy, &left)).collect();
        for dropped in &out {
            self.dropped[dropped.policy] = Some(*dropped);
        }
        Ok(out)
    }

    /// The elimination of a policy at this look, by the one that is most clearly better.
    fn beaten(&self, policy: usize, left: &[usize]) -> Option<Dropped> {
        let shown = |other: usize| {
            let Claim { won, lost } = self.claim(other, policy);
            self.boundary.is_reached(self.at, won, lost).then(|| won - lost)
        };
        let others = left.iter().filter(|other| **other != policy);
        let by = others.filter_map(|&other| shown(other).map(|lead| (lead, other))).max_by_key(|(lead, _)| *lead)?.1;
        Some(Dropped { policy, by, look: self.at })
    }

    /// The blocks for and against the claim that a policy is better than another one.
    fn claim(&self, better: usize, other: usize) -> Claim {
        let [forth, back] = self.claims[place(better.min(other), better.max(other))];
        if better < other { forth } else { back }
    }

    /// The policies that are left: they cannot be distinguished from the best.
    pub fn best_set(&self) -> Vec<usize> {
        (0..self.dropped.len()).filter(|policy| self.dropped[*policy].is_none()).collect()
    }

    /// The elimination of a policy, if it was eliminated.
    pub fn dropped(&self, policy: usize) -> Option<Dropped> {
        self.dropped.get(policy).copied().flatten()
    }

    /// Whether the contest has ended: one policy is left, or all looks are used.
    pub fn is_over(&self) -> bool {
        self.at >= self.schedule.looks || self.dropped.iter().filter(|dropped| dropped.is_none()).count() <= 1
    }

    /// Number of looks so far.
    pub fn looks(&self) -> u64 {
        self.at
    }

    /// The guarantee.
    pub fn guarantee(&self) -> Guarantee {
        self.guarantee
    }

    /// The valid trials of a policy.
    pub fn trials(&self, policy: usize) -> Trials {
        self.rates.get(policy).and_then(|(k, n)| Trials::new(*k, *n).ok()).unwrap_or(Trials::NONE)
    }

    /// The differences of all pairs, on the blocks that are valid for both. At this confidence, all intervals hold simultaneously,
    /// after any number of looks. They are wider than the test of the elimination, which uses the known number of looks.
    pub fn table(&self, confidence: Confidence) -> Vec<PairInterval> {
        let shared = confidence.shared_by(self.pairs.len());
        let pair = |first: usize, second: usize| {
            let looks = &self.pairs[place(first, second)];
            let won = looks.last().copied().unwrap_or_default();
            let difference_of = (won.first as f64 - won.second as f64) / won.blocks.max(1) as f64;
            let Interval { low, high } = difference(looks, shared.tail());
            let interval = Interval { low, high };
            PairInterval { first, second, blocks: won.blocks, difference: difference_of, interval }
        };
        let n = self.rates.len();
        (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).map(|(i, j)| pair(i, j)).collect()
    }

    /// How a contest with this plan ends if the policies have the true rates `rates`, from `runs` simulated contests. In a part
    /// `shared` of the blocks one draw decides all policies, which correlates their outcomes.
    ///
    /// # Errors
    /// Another number of rates than policies.
    pub fn expected(&self, rates: &[f64], shared: f64, runs: u64, seed: u64) -> Result<ExpectedContest, ContestError> {
        let n = self.rates.len();
        if rates.len() != n {
            return Err(ContestError::Outcomes { expected: n, found: rates.len() });
        }
        let top = rates.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let is_best = |policy: usize| rates[policy] >= top;
        let best = (0..n).find(|policy| is_best(*policy)).unwrap_or(0);
        let mut sum = ExpectedContest {
            best_alone: 0.0,
            best_dropped: 0.0,
            any_best_dropped: 0.0,
            trials: 0.0,
            first_after: None,
            left: 0.0,
        };
        let (mut first, mut some) = (0.0, 0_u64);
        for run in 0..runs {
            let random = &mut ChaCha8Rng::seed_from_u64(seed ^ run.wrapping_mul(0x9e37_79b9_7f4a_7c15));
            let mut contest = self.afresh();
            let mut first_look = None;
            while !contest.is_over() {
                let blocks: Vec<Vec<Option<bool>>> = (0..self.schedule.per_look)
                    .map(|_| {
                        let common = (uniform(random) < shared).then(|| uniform(random));
                        rates.iter().map(|rate| Some(common.unwrap_or_else(|| uniform(random)) < *rate)).collect()
                    })
                    .collect();
                sum.trials += (contest.best_set().len() as u64 * self.schedule.per_look) as f64;
                let out = contest.look(&blocks)?;
                if !out.is_empty() && first_look.is_none() {
                    first_look = Some(contest.at * self.schedule.per_look);
                }
            }
            let left = contest.best_set();
            let out = |policy: usize| contest.dropped[policy].is_some();
            sum.best_alone += f64::from(u8::from(left.iter().all(|policy| is_best(*policy))));
            sum.best_dropped += f64::from(u8::from(out(best)));
            sum.any_best_dropped += f64::from(u8::from((0..n).any(|policy| is_best(policy) && out(policy))));
            sum.left += left.len() as f64;
            if let Some(look) = first_look {
                first += look as f64;
                some += 1;
            }
        }
        let all = runs.max(1) as f64;
        Ok(ExpectedContest {
            best_alone: sum.best_alone / all,
            best_dropped: sum.best_dropped / all,
            any_best_dropped: sum.any_best_dropped / all,
            trials: sum.trials / all,
            first_after: (some > 0).then(|| first / some as f64),
            left: sum.left / all,
        })
    }

    /// The same plan without blocks.
    fn afresh(&self) -> Self {
        let n = self.rates.len();
        Self {
            at: 0,
            pairs: vec![Vec::new(); self.pairs.len()],
            claims: vec![[Claim::default(); 2]; self.claims.len()],
            rates: vec![(0, 0); n],
            dropped: vec![None; n],
            ..self.clone()
        }
    }
}

/// The place of the pair i < j in a list of pairs.
fn place(i: usize, j: usize) -> usize {
    j * (j - 1) / 2 + i
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contest(guarantee: Guarantee) -> Elimination {
        Elimination::new(3, Schedule { per_look: 10, looks: 6 }, guarantee, 0.05).unwrap()
    }

    /// Ten blocks: the first policy always succeeds, the second in nine blocks, the third in `third`.
    fn round(third: usize) -> Vec<Vec<Option<bool>>> {
        (0..10).map(|i| vec![Some(true), Some(i != 3), Some(i < third)]).collect()
    }

    #[test]
    fn clearly_worse_policy_leaves() {
        let mut contest = contest(Guarantee::BestStays);
        assert_eq!(contest.look(&round(2)).unwrap(), []);
        let out = contest.look(&round(2)).unwrap();
        assert_eq!(out, [Dropped { policy: 2, by: 0, look: 2 }]);
        assert_eq!((contest.best_set(), contest.is_over()), (vec![0, 1], false));
        // Its later outcomes are ignored.
        contest.look(&round(10)).unwrap();
        assert_eq!(contest.trials(2), Trials::new(4, 20).unwrap());
        let table = contest.table(Confidence::P95);
        assert_eq!(table.iter().map(|pair| pair.blocks).collect::<Vec<_>>(), [30, 20, 20]);
        assert!((table[1].difference - 0.8).abs() < 1e-12 && table[1].interval.low > 0.0, "{table:?}");
        assert!(table[0].interval.contains(0.0));
    }

    #[test]
    fn stronger_guarantee_needs_more_blocks() {
        let after = |guarantee| {
            let mut contest = contest(guarantee);
            (1..=6).find(|_| !contest.look(&round(8)).unwrap().is_empty())
        };
        let (best, every) = (after(Guarantee::BestStays), after(Guarantee::NoFalseElimination));
        assert!(best.is_some() && best < every.or(Some(7)), "{best:?} {every:?}");
    }

    #[test]
    fn invalid_trials_count_against_a_claim() {
        // The policies succeed in five of ten blocks each, but the failures of the first one are invalid.
        let hidden: Vec<Vec<Option<bool>>> =
            (0..10).map(|i| vec![(i >= 5).then_some(true), Some(i < 5), Some(i < 5)]).collect();
        let mut equal = contest(Guarantee::BestStays);
        for _ in 0..6 {
            assert_eq!(equal.look(&hidden).unwrap(), []);
        }
        assert_eq!((equal.best_set(), equal.table(Confidence::P95)[0].blocks), (vec![0, 1, 2], 30));
        // The failures of the policy that would leave may be invalid as well.
        let mut spared = contest(Guarantee::BestStays);
        let missing: Vec<Vec<Option<bool>>> = (0..10).map(|_| vec![Some(true), Some(true), None]).collect();
        assert!((0..6).all(|_| spared.look(&missing).unwrap().is_empty()));
        // A clear difference is shown although some trials are invalid.
        let mut clear = contest(Guarantee::BestStays);
        let mut blocks = round(2);
        blocks[0][0] = None;
        assert!((0..6).any(|_| clear.look(&blocks).unwrap().iter().any(|out| out.policy == 2)));
    }

    #[test]
    fn rates_leave_out_invalid_trials() {
        let mut contest = contest(Guarantee::BestStays);
        let mut blocks = round(5);
        blocks[0][2] = None;
        blocks[1][0] = None;
        contest.look(&blocks).unwrap();
        assert_eq!((contest.trials(0).n(), contest.trials(1).n(), contest.trials(2).n()), (9, 10, 9));
        let table = contest.table(Confidence::P95);
        assert_eq!(table.iter().map(|pair| pair.blocks).collect::<Vec<_>>(), [9, 8, 9]);
        let short = contest.look(&[vec![Some(true)]]);
        assert_eq!(short, Err(ContestError::Outcomes { expected: 3, found: 1 }));
    }

    #[test]
    fn simulated_errors_hold() {
        for (guarantee, rates) in [(Guarantee::BestStays, [0.7; 3]), (Guarantee::NoFalseElimination, [0.7; 3])] {
            let found = contest(guarantee).expected(&rates, 0.3, 2_000, 5).unwrap();
            let error = if guarantee == Guarantee::BestStays { found.best_dropped } else { found.any_best_dropped };
            assert!(error <= 0.06, "{guarantee:?}: {found:?}");
        }
        let found = contest(Guarantee::BestStays).expected(&[0.9, 0.5, 0.5], 0.0, 500, 6).unwrap();
        assert!(found.best_alone > 0.95 && found.trials < 130.0 && found.left < 1.1, "{found:?}");
    }

    #[test]
    fn unusable_contests_are_rejected() {
        let of = |policies, looks| {
            Elimination::new(policies, Schedule { per_look: 10, looks }, Guarantee::BestStays, 0.05).map(|_| ())
        };
        assert_eq!(of(1, 5), Err(ContestError::Policies(1)));
        assert_eq!(of(2, 0), Err(ContestError::Blocks(0)));
        assert!(of(2, u64::MAX).is_err());
    }
}
