//! Contests of policies in blocks: which of two is better, and which of several is the best.
//!
//! A block is one trial of each policy under one set-up or scenario. The largest number of blocks is fixed before the first.
//! After each block or round of blocks, the tests decide whether to go on. The outcomes of one block may depend on each other in
//! any way, because only their differences count; different blocks are independent.
//!
//! | question | what to call |
//! |---|---|
//! | which of two policies is better? | [`Duel::new`], then [`Duel::block`] after each block |
//! | which of several policies is the best? | [`Elimination::new`], then [`Elimination::look`] after each block or round |
//! | how long does that take, and how often is it right? | [`Duel::expected`], [`Elimination::expected`] |
//! | how far are the policies apart, at any time? | [`Duel::interval`], [`Elimination::table`] |
//! | does one policy meet a limit? | [`crate::operating::Boundaries::new`] with a budget of one trial per round, then [`look`] |
//! | the same with predictions of a simulation? | [`Predicted::new`], then [`Predicted::trial`] after each trial |
//!
//! [`look`]: crate::operating::Boundaries::look
//!
//! **Test.** Let the first of two policies win b blocks and the second a blocks. The statistic (b - a) / √(b + a) is compared after
//! each look with C t^(Δ - 1/2), where t is the part of the blocks that has run (Wang and Tsiatis 1987). If the policies are equal,
//! only the probability d that a block has a winner is unknown. Up to [`EXACT_BLOCKS`] blocks, the error over all looks is computed
//! by recursion over (b, a), and C is chosen so that it is at most the allowed one for d = 0.02, 0.04, ..., 1. Beyond, C is that
//! of Brownian motion, and the statistic is the normal score of the exact binomial tail.
//!
//! **Tolerance.** For d between the checked values, the error can be slightly larger than the allowed one. The tests compute it at 97
//! other values of d, for 1, 6, 20 and 52 blocks, and accept at most 5.02 % for an allowed error of 5 %. This is a check and not
//! a proof for every d and every number of blocks. The limits of Brownian motion are an approximation, which simulations check.
//!
//! **Invalid trials.** In [`Elimination`], an invalid trial counts in the worst case for the policy that would be shown to be better:
//! the error holds for any reason of invalid trials. A [`Duel`] gets complete blocks only.
//!
//! **Scores.** Ordered outcomes, such as stages of which success is the last, are tested in the same way: a block has a winner if one of
//! the policies gets further, and d is the probability of that. This is a sign test; it needs no distance between the stages.
//!
//! If every look has the same scenarios, the tested difference is the mean over them. Scenarios whose differences have opposite signs
//! then only reduce the variance of b - a.
//!
//! Sources: Wang and Tsiatis (1987), Biometrics 43; McNemar (1947), Psychometrika 12; Jennison and Turnbull (2000), Group
//! Sequential Methods, chapter 12 (repeated tests of binary outcomes).

mod boundary;
mod duel;
mod elimination;
mod intervals;
mod lattice;
mod predicted;

pub use boundary::EXACT_BLOCKS;
pub use duel::{Decision, Duel, ExpectedDuel, Truth};
pub use elimination::{Dropped, Elimination, ExpectedContest, Guarantee, Schedule};
pub use intervals::PairInterval;
pub use predicted::Predicted;

/// The most blocks that a contest can have.
pub const MOST_BLOCKS: u64 = 1_000_000;
/// The most policies in one contest.
pub const MOST_POLICIES: usize = 100;

/// A contest that cannot be planned, or blocks that do not belong to it.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ContestError {
    /// No blocks, or too many.
    #[error("{0} blocks. Expected 1 to {MOST_BLOCKS}")]
    Blocks(u64),
    /// Fewer than two policies, or too many.
    #[error("{0} policies. Expected 2 to {MOST_POLICIES}")]
    Policies(usize),
    /// An error probability outside (0, 0.5).
    #[error("an error probability of {0}. Expected a number between 0 and 0.5")]
    Error(f64),
    /// A limit or a prediction that is not a rate.
    #[error("{0} is not a rate. Expected a number from 0 to 1, and a limit between them")]
    Rate(f64),
    /// A block with another number of outcomes.
    #[error("a block with {found} outcomes. Expected {expected}, one for each policy")]
    Outcomes {
        /// Policies of the contest.
        expected: usize,
        /// Outcomes of the block.
        found: usize,
    },
}

fn check(blocks: u64, error: f64) -> Result<(), ContestError> {
    if !(1..=MOST_BLOCKS).contains(&blocks) {
        return Err(ContestError::Blocks(blocks));
    }
    if error > 0.0 && error < 0.5 { Ok(()) } else { Err(ContestError::Error(error)) }
}
