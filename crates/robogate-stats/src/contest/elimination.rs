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
/// An invalid trial counts in the worst case for the claim: as the lowest score of the policy that would be better, and as the highest of
/// the other one. If it had been valid, the statistic could only be larger, so that the error holds for any reason of invalid trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Claim {
    won: u64,
    lost: u64,
}

impl Claim {
    /// Adds a block: the score of the policy that would be better, and that of the other one.
    fn add(&mut self, better: Option<u32>, other: Option<u32>, top: u32) {
        let (better, other) = (better.unwrap_or(0), other.unwrap_or(top));
        self.won += u64::from(better > other);
        self.lost += u64::from(other > better);
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
    /// The score of a success.
    top: u32,
    /// The number of looks so far.
    at: u64,
    /// For each pair i < j, the valid blocks that each won, after each look at which both ran.
    pairs: Vec<Vec<Won>>,
    /// For each pair i < j, the blocks of "i is better", and those of "j is better".
    claims: Vec<[Claim; 2]>,
    /// Valid trials, successes and the sum of scores of each policy.
    trials: Vec<[u64; 3]>,
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
            top: 1,
            at: 0,
            pairs: vec![Vec::new(); policies * (policies - 1) / 2],
            claims: vec![[Claim::default(); 2]; policies * (policies - 1) / 2],
            trials: vec![[0; 3]; policies],
            dropped: vec![None; policies],
        })
    }

    /// The same contest with ordered scores from 0 to `top`, of which `top` is a success. A policy wins a block with the higher score: the
    /// test compares how often each policy gets further than the other one. The best policy is then one that no other one gets further than
    /// more often. With a cycle (A beats B, B beats C, C beats A) there may be no such policy, and the guarantee does not apply. Call it
    /// before the first look.
    #[must_use]
    pub fn with_top(self, top: u32) -> Self {
        Self { top: top.max(1), ..self }
    }

    /// Adds the blocks since the last look, and eliminates policies. A block has an outcome for each policy, which is a success or a
    /// score: `None` if it did not run or if its trial is invalid. Outcomes of eliminated policies are ignored. Returns the policies that
    /// leave now.
    ///
    /// An invalid trial counts against each elimination: as a success of the policy that would leave, and as the lowest score of the other
    /// one. Rates and differences leave it out.
    ///
    /// # Errors
    /// A block with another number of outcomes. Nothing is added then.
    pub fn look<S: Into<u32> + Copy>(&mut self, blocks: &[Vec<Option<S>>]) -> Result<Vec<Dropped>, ContestError> {
        let expected = self.trials.len();
        if let Some(block) = blocks.iter().find(|block| block.len() != expected) {
            return Err(ContestError::Outcomes { expected, found: block.len() });
        }
        self.at += 1;
        let top = self.top;
        let score = |block: &Vec<Option<S>>, policy: usize| block[policy].map(|score| score.into().min(top));
        let left = self.best_set();
        for &i in &left {
            for score in blocks.iter().filter_map(|block| score(block, i)) {
                let [n, successes, sum] = &mut self.trials[i];
                *n += 1;
                *successes += u64::from(score == top);
                *sum += u64::from(score);
            }
            for &j in left.iter().filter(|j| **j > i) {
                let looks = &mut self.pairs[place(i, j)];
                let mut won = looks.last().copied().unwrap_or_default();
                for (first, second) in blocks.iter().filter_map(|block| score(block, i).zip(score(block, j))) {
                    won.first += u64::from(first > second);
                    won.second += u64::from(second > first);
                    won.blocks += 1;
                }
                looks.push(won);
                let [forth, back] = &mut self.claims[place(i, j)];
                for block in blocks {
                    forth.add(score(block, i), score(block, j), top);
                    back.add(score(block, j), score(block, i), top);
                }
            }
        }
        let mut out: Vec<Dropped> = left.iter().filter_map(|&policy| self.beaten(policy, &left)).collect();
        // With scores each of three policies can get further than the next one. Then none of them is the best.
        if out.len() == left.len() {
            out.clear();
        }
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
        self.trials.get(policy).and_then(|[n, k, _]| Trials::new(*k, *n).ok()).unwrap_or(Trials::NONE)
    }

    /// The mean score of a policy as a part of that of a success. `None` without a valid trial.
    pub fn mean_score(&self, policy: usize) -> Option<f64> {
        let [n, _, sum] = self.trials.get(policy)?;
        (*n > 0).then(|| *sum as f64 / (*n as f64 * f64::from(self.top)))
    }

    /// The differences of all pairs, on the blocks that are valid for both: the part of them that the first policy won minus the part that
    /// the second one won. At this confidence, all intervals hold simultaneously,
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
        let n = self.trials.len();
        (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).map(|(i, j)| pair(i, j)).collect()
    }

    /// How a contest with this plan ends if the policies have the true rates `rates`, from `runs` simulated contests. In a part
    /// `shared` of the blocks one draw decides all policies, which correlates their outcomes.
    ///
    /// # Errors
    /// Another number of rates than policies.
    pub fn expected(&self, rates: &[f64], shared: f64, runs: u64, seed: u64) -> Result<ExpectedContest, ContestError> {
        let n = self.trials.len();
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
        let n = self.trials.len();
        Self {
            top: 1,
            at: 0,
            pairs: vec![Vec::new(); self.pairs.len()],
            claims: vec![[Claim::default(); 2]; self.claims.len()],
            trials: vec![[0; 3]; n],
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

    /// Scores of 0 to 3, of which 3 is a success, from a draw and the probability that a policy stops at each stage.
    fn scored(random: &mut ChaCha8Rng, stop: f64, success: f64) -> u32 {
        if uniform(random) < success {
            return 3;
        }
        (0..2).take_while(|_| uniform(random) >= stop).count() as u32
    }

    #[test]
    fn further_policy_wins_although_none_succeeds_more_often() {
        let contest = || {
            Elimination::new(2, Schedule { per_look: 10, looks: 6 }, Guarantee::BestStays, 0.05).unwrap().with_top(3)
        };
        let random = &mut ChaCha8Rng::seed_from_u64(5);
        // Both succeed in 5 %. The first one stops at each stage with a probability of 20 %, the second one with 70 %.
        let mut further = [0, 0];
        for _ in 0..200 {
            let mut by_stage = contest();
            while !by_stage.is_over() {
                let block = |_| vec![Some(scored(random, 0.2, 0.05)), Some(scored(random, 0.7, 0.05))];
                by_stage.look(&(0..10).map(block).collect::<Vec<_>>()).unwrap();
            }
            let best = by_stage.best_set();
            further[0] += u64::from(best == [0]);
            further[1] += u64::from(best == [1]);
            let [one, two] = [0, 1].map(|of| by_stage.mean_score(of).unwrap());
            assert!(one > two && by_stage.trials(0).n() % 10 == 0);
        }
        assert!(further[0] >= 195 && further[1] == 0, "{further:?}");
        // Equal policies: either leaves in at most 10 % together, each in 5 %.
        let mut left = 0;
        for _ in 0..400 {
            let mut equal = contest();
            while !equal.is_over() {
                let block = |_| vec![Some(scored(random, 0.5, 0.1)), Some(scored(random, 0.5, 0.1))];
                equal.look(&(0..10).map(block).collect::<Vec<_>>()).unwrap();
            }
            left += u64::from(equal.best_set().len() == 1);
        }
        assert!(left <= 55, "{left} of 400");
    }

    #[test]
    fn circle_of_policies_drops_none() {
        let mut contest =
            Elimination::new(3, Schedule { per_look: 60, looks: 6 }, Guarantee::BestStays, 0.05).unwrap().with_top(3);
        let circle = [[3_u32, 2, 1], [2, 1, 3], [1, 3, 2]];
        let blocks: Vec<Vec<Option<u32>>> = (0..60).map(|at| circle[at % 3].map(Some).to_vec()).collect();
        while !contest.is_over() {
            contest.look(&blocks).unwrap();
        }
        assert_eq!(contest.best_set(), [0, 1, 2]);
    }

    #[test]
    fn invalid_trials_have_the_worst_score_for_a_claim() {
        let mut contest =
            Elimination::new(2, Schedule { per_look: 4, looks: 6 }, Guarantee::BestStays, 0.05).unwrap().with_top(3);
        let round = [vec![Some(2_u32), None], vec![None, Some(1)], vec![Some(3), None], vec![Some(2), Some(1)]];
        contest.look(&round).unwrap();
        // For "the first is better" the second has the top score in the first block, and the first has none in the second one.
        assert_eq!(contest.claim(0, 1), Claim { won: 1, lost: 2 });
        assert_eq!(contest.claim(1, 0), Claim { won: 0, lost: 4 });
        assert_eq!(contest.mean_score(0), Some(7.0 / 9.0));
        assert_eq!((contest.trials(0).n(), contest.trials(0).successes()), (3, 1));
    }
}
