//! The limits of the statistic after each look.

use robogate_maths::normal;

use super::intervals::Won;
use super::lattice::{At, Course, Step, course};
use crate::compare::at_least;
use crate::group_sequential::{MOST_LOOKS, crosses};
use crate::interval::Trials;

/// Up to this many blocks the limits are computed from the exact distribution. Beyond, they are those of Brownian motion.
pub const EXACT_BLOCKS: u64 = 150;
/// Shares of blocks with a winner for which the error is computed first, and the number of equally spaced ones that are checked
/// afterwards. Between these the error is not bounded.
const SHARES: [f64; 8] = [0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0];
const CHECKED: u32 = 50;
/// No test ends before this part of the looks: very early looks use error and rarely decide.
const FIRST: f64 = 0.2;
/// Δ beyond [`EXACT_BLOCKS`]: a simulation can afford a few more blocks for an early end.
const LARGE: f64 = 0.4;
/// Above this limit of the statistic nothing is left.
const UNREACHED: f64 = 9.0;

/// The boundary of one pair of policies: the same limit for both sides.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Boundary {
    per_look: u64,
    /// The limit after each look, in units of the constant. Infinite where no test ends.
    units: Vec<f64>,
    constant: f64,
}

impl Boundary {
    /// Limits whose error on both sides together, over all looks, is at most `error` at each checked share of blocks with a winner.
    /// They are at most about 0.1 % larger than necessary for these.
    pub(super) fn new(per_look: u64, looks: u64, error: f64) -> Self {
        let every = every(per_look * looks, looks);
        let shape = if per_look * looks <= EXACT_BLOCKS { shape(looks) } else { LARGE };
        let unit = |look: u64| {
            let t = look as f64 / looks as f64;
            let is_used = t >= FIRST && look.is_multiple_of(every);
            if is_used { t.powf(shape - 0.5) } else { f64::INFINITY }
        };
        let mut boundary = Self { per_look, units: (1..=looks).map(unit).collect(), constant: UNREACHED };
        let (mut low, mut high) = (0.5, UNREACHED);
        for _ in 0..16 {
            boundary.constant = 0.5 * (low + high);
            if boundary.exceeds(error, &SHARES) { low = boundary.constant } else { high = boundary.constant }
        }
        boundary.constant = high;
        while boundary.is_exact() && boundary.constant < UNREACHED && boundary.exceeds(error, &checked()) {
            boundary.constant *= 1.001;
        }
        boundary
    }

    /// All blocks.
    pub(super) fn blocks(&self) -> u64 {
        self.per_look * self.looks()
    }

    fn looks(&self) -> u64 {
        self.units.len() as u64
    }

    fn is_exact(&self) -> bool {
        self.blocks() <= EXACT_BLOCKS
    }

    /// Whether the error exceeds a limit for any of the given shares of blocks with a winner.
    fn exceeds(&self, limit: f64, shares: &[f64]) -> bool {
        if self.is_exact() { shares.iter().any(|d| self.error(&[*d]) > limit) } else { self.error(&[]) > limit }
    }

    /// The largest error over the given shares of blocks with a winner. Brownian motion has one error for all.
    fn error(&self, shares: &[f64]) -> f64 {
        if !self.is_exact() {
            let every = every(self.blocks(), self.looks());
            return 2.0 * crosses(self.looks() / every, |look| self.limit(look * every).min(UNREACHED));
        }
        let of = |d: &f64| {
            let found = self.course(Step::equal(*d), |_, _, _| false);
            found.first + found.second
        };
        shares.iter().map(of).fold(0.0, f64::max)
    }

    /// The probability of each end, if also those runs end without a winner for which `futile(n, ahead, behind)` holds.
    pub(super) fn course(&self, step: Step, futile: impl Fn(u64, u64, u64) -> bool) -> Course {
        course(self.blocks(), step, |n, ahead, behind| {
            if !n.is_multiple_of(self.per_look) {
                At::Open
            } else if self.is_reached(n / self.per_look, ahead, behind) {
                At::Leader
            } else if futile(n, ahead, behind) {
                At::Neither
            } else {
                At::Open
            }
        })
    }

    /// The limit of the statistic at a look, numbered from 1.
    fn limit(&self, look: u64) -> f64 {
        let unit = usize::try_from(look).ok().and_then(|look| self.units.get(look.wrapping_sub(1)));
        self.constant * unit.copied().unwrap_or(f64::INFINITY)
    }

    /// Whether a look shows that the policy that won `ahead` blocks is better than the one that won `behind`.
    pub(super) fn is_reached(&self, look: u64, ahead: u64, behind: u64) -> bool {
        let limit = self.limit(look) - 1e-9;
        if ahead <= behind || limit >= UNREACHED {
            return false;
        }
        if self.is_exact() {
            // The square of the statistic, without a root for each cell of the recursion.
            let lead = (ahead - behind) as f64;
            return lead * lead >= limit * limit * (ahead + behind) as f64;
        }
        self.statistic(ahead, behind) >= limit
    }

    fn statistic(&self, ahead: u64, behind: u64) -> f64 {
        if self.is_exact() {
            return z(ahead, behind);
        }
        let tail = Trials::new(ahead, ahead + behind).map_or(0.0, |trials| at_least(trials, 0.5)).exp();
        -normal::quantile(tail.clamp(1e-300, 1.0 - 1e-12))
    }

    /// The smallest two-sided error at which a look would have ended for either policy. `looks` are the blocks won by each policy
    /// after the looks so far.
    pub(super) fn p_value(&self, looks: &[Won]) -> f64 {
        let unit = Self { constant: 1.0, ..self.clone() };
        let of = |(at, won): (u64, &Won)| {
            let (ahead, behind) = (won.first.max(won.second), won.first.min(won.second));
            if ahead == behind { 0.0 } else { self.statistic(ahead, behind) / unit.limit(at) }
        };
        let constant = (1..).zip(looks).map(of).fold(0.0, f64::max);
        if constant <= 0.5 { 1.0 } else { Self { constant, ..self.clone() }.error(&checked()).min(1.0) }
    }
}

/// Every how many looks one is used: the recursion of Brownian motion has at most [`MOST_LOOKS`].
fn every(blocks: u64, looks: u64) -> u64 {
    if blocks <= EXACT_BLOCKS { 1 } else { looks.div_ceil(MOST_LOOKS) }
}

/// Shares of blocks with a winner in small steps.
fn checked() -> Vec<f64> {
    (1..=CHECKED).map(|i| f64::from(i) / f64::from(CHECKED)).collect()
}

/// (ahead - behind) / √(ahead + behind), and 0 without winners.
pub(super) fn z(ahead: u64, behind: u64) -> f64 {
    if ahead + behind == 0 { 0.0 } else { (ahead as f64 - behind as f64) / ((ahead + behind) as f64).sqrt() }
}

/// Δ. With few looks, most of the error is kept for the last ones, which need it for the power. With many, the contest is planned
/// for a small difference, and a large one should end it early.
fn shape(looks: u64) -> f64 {
    (0.25 + 0.25 * (looks as f64 - 60.0) / 40.0).clamp(0.25, 0.5)
}
