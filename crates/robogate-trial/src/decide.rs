//! The decision after each block.
//!
//! One policy against a limit: the gate's test of a rate with a known largest number of rounds, one trial per round. Two
//! policies: [`Duel`]. More: [`Elimination`], whose error is the probability that the best policy is eliminated.
//!
//! Trials that were declared invalid before their end are repeated. A claim must hold whatever the invalid ones would have been: for
//! "A is better", each of A counts as a failure and each of B as a success. With this the error is bounded however the invalid
//! trials were chosen, also by somebody who knows the policies.

use robogate_stats::Trials;
use robogate_stats::budgeted::Budget;
use robogate_stats::contest::{Decision as Contest, Duel, Elimination, Guarantee, Schedule};
use robogate_stats::operating::{Answer, Boundaries, RateTest};
use serde::{Deserialize, Serialize};

use crate::{Plan, Problem, Question};

/// The results of one complete block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockResults {
    /// Whether each policy succeeded. `None` for one that was eliminated before.
    pub success: Vec<Option<bool>>,
    /// For each policy, the trials that were declared invalid before their end and repeated.
    pub repeated: Vec<u64>,
    /// For each policy, whether the trial succeeded as it was first recorded, if it was corrected.
    pub first: Vec<Option<bool>>,
}

impl BlockResults {
    /// The results if each invalid trial, and each of the two results of a corrected one, had been against the claim that the policies of
    /// `favoured` are good and all others are not.
    fn against(&self, favoured: impl Fn(usize) -> bool) -> Vec<Option<bool>> {
        let result = |(arm, success): (usize, &Option<bool>)| {
            success.map(|success| match self.first[arm] {
                _ if self.repeated[arm] > 0 => !favoured(arm),
                Some(first) if favoured(arm) => success && first,
                Some(first) => success || first,
                None => success,
            })
        };
        self.success.iter().enumerate().map(result).collect()
    }
}

/// A decision.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Decision {
    /// The answer.
    pub answer: Verdict,
    /// Whether each policy was eliminated.
    pub dropped: Vec<bool>,
    /// Whether the answer would be a claim if invalid trials did not count and corrections did.
    pub withheld: bool,
}

/// The answer to the question of a study.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Another block is needed.
    Open,
    /// The rate is at least the limit.
    Pass,
    /// The rate is below the limit.
    Fail,
    /// This policy is better than all others.
    Best(usize),
    /// No difference was shown, or too little for a claim.
    NotShown,
}

impl Decision {
    /// The decision before the first block.
    pub fn open(arms: usize) -> Self {
        Self { answer: Verdict::Open, dropped: vec![false; arms], withheld: false }
    }

    /// Whether no further trial is needed.
    pub fn is_final(&self) -> bool {
        self.answer != Verdict::Open
    }
}

/// The test of a plan.
#[derive(Debug)]
pub struct Judge {
    arms: usize,
    blocks: u64,
    test: Test,
}

#[derive(Debug)]
enum Test {
    Limit(Boundaries),
    Two(Duel),
    Several(Elimination),
}

impl Judge {
    /// The test of a plan.
    ///
    /// # Errors
    /// If the plan cannot be tested.
    pub fn new(plan: &Plan) -> Result<Self, Problem> {
        let wrong = |error: robogate_stats::contest::ContestError| Problem::Plan(error.to_string());
        let test = match plan.question {
            Question::AtLeast(limit) => Test::Limit(Boundaries::new(rate_test(plan, limit), budget(plan))),
            Question::Better => Test::Two(Duel::new(plan.blocks, plan.error).map_err(wrong)?),
            Question::Best => Test::Several(elimination(plan).map_err(wrong)?),
        };
        Ok(Self { arms: plan.arms.len(), blocks: plan.blocks, test })
    }

    /// The decision after these complete blocks.
    pub fn decision(&self, blocks: &[BlockResults]) -> Decision {
        let ended = blocks.len() as u64 >= self.blocks;
        let unshown = if ended { Verdict::NotShown } else { Verdict::Open };
        let arms = self.arms;
        let mut decision = Decision { answer: unshown, ..Decision::open(arms) };
        match &self.test {
            Test::Limit(boundaries) => {
                let count = |favoured: bool| {
                    Trials::count(
                        blocks.iter().filter_map(|block| block.against(|_| favoured).first().copied().flatten()),
                    )
                };
                let plain = Trials::count(blocks.iter().filter_map(|block| block.success.first().copied().flatten()));
                if plain.n() == 0 {
                    return decision;
                }
                if boundaries.look(count(true)) == Answer::Met {
                    decision.answer = Verdict::Pass;
                } else if boundaries.look(count(false)) == Answer::Violated {
                    decision.answer = Verdict::Fail;
                } else {
                    decision.withheld = boundaries.look(plain) != Answer::Open;
                }
            }
            Test::Two(duel) => {
                let run = |results: &dyn Fn(&BlockResults) -> Vec<Option<bool>>| {
                    let mut duel = duel.clone();
                    let pairs = blocks.iter().filter_map(|block| match results(block).as_slice() {
                        [Some(first), Some(second)] => Some((*first, *second)),
                        _ => None,
                    });
                    pairs.for_each(|(first, second)| {
                        duel.block(first, second);
                    });
                    duel.decision()
                };
                let plain = run(&|block| block.success.clone());
                let better = |arm: usize| {
                    let claim = if arm == 0 { Contest::FirstBetter } else { Contest::SecondBetter };
                    run(&|block| block.against(|a| a == arm)) == claim
                };
                if let Some(best) = (0..2).find(|arm| better(*arm)) {
                    decision.answer = Verdict::Best(best);
                    decision.dropped = vec![best != 0, best != 1];
                } else {
                    decision.withheld = matches!(plain, Contest::FirstBetter | Contest::SecondBetter);
                    if plain == Contest::NoDifferenceShown {
                        decision.answer = Verdict::NotShown;
                    }
                }
            }
            Test::Several(contest) => {
                let run = |results: &dyn Fn(&BlockResults) -> Vec<Option<bool>>| {
                    let mut contest = contest.clone();
                    let mut dropped = vec![false; arms];
                    for block in blocks {
                        // A block always has one result for each policy.
                        let out = contest.look(&[results(block)]).unwrap_or_default();
                        out.into_iter().for_each(|out| dropped[out.policy] = true);
                    }
                    dropped
                };
                for arm in 0..arms {
                    decision.dropped[arm] = run(&|block| block.against(|a| a != arm))[arm];
                }
                let left: Vec<usize> = (0..arms).filter(|arm| !decision.dropped[*arm]).collect();
                match left.as_slice() {
                    [best] => decision.answer = Verdict::Best(*best),
                    _ => decision.withheld = run(&|block| block.success.clone()) != decision.dropped,
                }
            }
        }
        decision
    }
}

/// The test of one policy against a limit: both errors are that of the plan.
pub(crate) fn rate_test(plan: &Plan, limit: f64) -> RateTest {
    RateTest { at_least: limit, alpha: plan.error, beta: plan.error }
}

/// A look after each trial.
pub(crate) fn budget(plan: &Plan) -> Budget {
    Budget { per_round: 1, rounds: plan.blocks }
}

/// The contest of several policies.
pub(crate) fn elimination(plan: &Plan) -> Result<Elimination, robogate_stats::contest::ContestError> {
    let schedule = Schedule { per_look: 1, looks: plan.blocks };
    Elimination::new(plan.arms.len(), schedule, Guarantee::BestStays, plan.error)
}
