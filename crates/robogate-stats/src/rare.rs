//! The probability of a rare event with a graded margin, by subset simulation.
//!
//! A point has independent standard normal coordinates and the number of a random draw. Its margin says how far the event is away, on any
//! scale: smaller is nearer, and negative infinity is the event. Each level keeps the
//! share p0 of the points with the smallest margins, and grows one Markov chain from each until there are as many points as before. All of
//! them have a margin of at most that level's. The probability is p0 for each level, times the share of the last level with the event.
//!
//! A chain moves by conditional sampling with an adapted step (Papaioannou et al. 2015), which keeps the normal distribution: u' = ρ u + σ z with
//! σ² + ρ² = 1. With a probability of 1/2 it also takes a new draw, or a new draw alone with another 1/4.
//!
//! The coefficient of variation is that of one run (Au and Beck 2001): it contains the correlation within chains. It does not see a part of
//! the event that no chain reached. A second run with another seed is a check of that, not a proof.
//!
//! Sources: Au and Beck (2001), Probabilistic Engineering Mechanics 16; Papaioannou, Betz, Zwirglmaier and Straub (2015), the same journal 41.

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_maths::normal::{cdf, quantile};

use crate::resample::uniform;

/// Share of the points that a level keeps.
const KEPT: f64 = 0.1;
/// The margin of the event.
pub const EVENT: f64 = f64::NEG_INFINITY;
/// Acceptance to which the step is adapted.
const ACCEPTANCE: f64 = 0.44;
/// Most levels. The probability of the last one is 1e-20.
const MOST_LEVELS: usize = 20;

/// A point.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Standard normal coordinates.
    pub u: Vec<f64>,
    /// Number of the draw.
    pub draw: u64,
}

impl Point {
    /// The coordinates as a point of the unit cube, each below 1.
    pub fn unit(&self) -> Vec<f64> {
        self.u.iter().map(|u| cdf(*u).clamp(0.0, 1.0 - f64::EPSILON)).collect()
    }
}

/// The size of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Number of coordinates.
    pub dimensions: usize,
    /// Whether the margin depends on the draw.
    pub draws: bool,
    /// Number of points of each level.
    pub points: usize,
    /// Most evaluations of the margin.
    pub budget: usize,
    /// Seed.
    pub seed: u64,
}

/// One level of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// The margin that its points do not exceed.
    pub margin: f64,
    /// Share of the points of the level before that it keeps.
    pub share: f64,
    /// Coefficient of variation of that share.
    pub variation: f64,
}

/// The result of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Rare {
    /// The probability of the event. If the budget ended first, an upper estimate: three divided by the number of chains of the last
    /// level, times the probability of that level.
    pub probability: f64,
    /// Its coefficient of variation. `None` without an event.
    pub variation: Option<f64>,
    /// Whether the last level reached the event.
    pub reached: bool,
    /// The levels.
    pub levels: Vec<Level>,
    /// Evaluations of the margin.
    pub evaluations: usize,
    /// Points with the event, those of the last level.
    pub events: Vec<Point>,
}

/// Points per level so that a probability of `target` needs at most `budget` evaluations. A multiple of ten.
pub fn points_per_level(budget: usize, target: f64) -> usize {
    let levels = (-target.log10()).ceil().max(1.0);
    (budget as f64 / (1.0 + (1.0 - KEPT) * (levels - 1.0)) / 10.0) as usize * 10
}

/// Runs the simulation. `margin` returns the margin of each point: negative infinity for the event, and NaN for a point that is as far away as
/// possible.
///
/// # Errors
/// Those of `margin`.
pub fn subset<E>(plan: Plan, mut margin: impl FnMut(&[Point]) -> Result<Vec<f64>, E>) -> Result<Rare, E> {
    let mut rng = ChaCha8Rng::seed_from_u64(plan.seed);
    let n = plan.points.max(20) / 10 * 10;
    let kept = (KEPT * n as f64).round() as usize;
    let steps = n / kept - 1;
    let fresh = |rng: &mut ChaCha8Rng| Point {
        u: (0..plan.dimensions).map(|_| normal(rng)).collect(),
        draw: if plan.draws { rng.next_u64() } else { 0 },
    };
    let mut points: Vec<Point> = (0..n).map(|_| fresh(&mut rng)).collect();
    let mut margins = clean(margin(&points)?);
    let mut result = Rare {
        probability: 1.0,
        variation: None,
        reached: false,
        levels: Vec::new(),
        evaluations: n,
        events: Vec::new(),
    };
    // Row r belongs to the chain r mod `chains`, in order.
    let mut chains = n;
    let mut step = 0.6_f64;
    loop {
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|a, b| margins[*a].total_cmp(&margins[*b]));
        let at = margins[order[kept - 1]];
        let last = at == EVENT;
        let limit = at;
        let share = margins.iter().filter(|m| **m <= limit).count() as f64 / n as f64;
        let variation = variation(&margins, limit, chains);
        let ends = last || result.levels.len() >= MOST_LEVELS || result.evaluations + n - kept > plan.budget;
        if ends {
            let events = margins.iter().filter(|m| **m == EVENT).count();
            let (share, variation, limit) = match events {
                // Rule of three, with one independent point for each chain.
                0 => ((3.0 / chains as f64).min(1.0), f64::INFINITY, EVENT),
                _ => (events as f64 / n as f64, self::variation(&margins, EVENT, chains), EVENT),
            };
            result.levels.push(Level { margin: limit, share, variation });
            result.probability *= share;
            result.reached = events > 0;
            let total = result.levels.iter().map(|level| level.variation.powi(2)).sum::<f64>().sqrt();
            result.variation = result.reached.then_some(total);
            result.events =
                points.into_iter().zip(margins).filter(|(_, m)| *m == EVENT).map(|(point, _)| point).collect();
            return Ok(result);
        }
        result.levels.push(Level { margin: limit, share, variation });
        // Equal margins are kept together, so the share of the level is what was counted.
        let count = margins.iter().filter(|m| **m <= limit).count();
        result.probability *= share;
        let mut seeds: Vec<usize> = order[..count].to_vec();
        crate::resample::shuffle(&mut rng, &mut seeds);
        seeds.truncate(kept);
        let mut now: Vec<Point> = seeds.iter().map(|row| points[*row].clone()).collect();
        let mut here: Vec<f64> = seeds.iter().map(|row| margins[*row]).collect();
        let spread: Vec<f64> = (0..plan.dimensions).map(|j| deviation(now.iter().map(|p| p.u[j]))).collect();
        (points, margins) = (now.clone(), here.clone());
        for sweep in 0..steps {
            let proposed: Vec<Point> =
                now.iter().map(|from| proposal(from, &spread, step, plan.draws, &mut rng)).collect();
            let found = clean(margin(&proposed)?);
            result.evaluations += kept;
            let mut accepted = 0;
            for (at, (point, margin)) in proposed.into_iter().zip(found).enumerate() {
                if margin <= limit {
                    (now[at], here[at]) = (point, margin);
                    accepted += 1;
                }
            }
            points.extend(now.iter().cloned());
            margins.extend(&here);
            let rate = accepted as f64 / kept as f64;
            step = (step.ln() + (rate - ACCEPTANCE) / ((sweep + 1) as f64).sqrt()).exp().clamp(0.05, 3.0);
        }
        chains = kept;
    }
}

fn clean(margins: Vec<f64>) -> Vec<f64> {
    margins.into_iter().map(|m| if m.is_nan() { f64::INFINITY } else { m }).collect()
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    quantile(uniform(rng).max(1e-300))
}

fn proposal(from: &Point, spread: &[f64], step: f64, draws: bool, rng: &mut ChaCha8Rng) -> Point {
    let choice = if draws { uniform(rng) } else { 1.0 };
    let draw = if choice < 0.75 && draws { rng.next_u64() } else { from.draw };
    // A quarter of the moves changes the draw alone.
    let moved = choice >= 0.25;
    let coordinate = |(u, spread): (&f64, &f64)| {
        let sigma = (step * spread).min(1.0);
        if moved { (1.0 - sigma * sigma).sqrt() * u + sigma * normal(rng) } else { *u }
    };
    Point { u: from.u.iter().zip(spread).map(coordinate).collect(), draw }
}

fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / n;
    (values.map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt()
}

/// The coefficient of variation of the share of points with a margin up to `limit`, with the correlation within chains.
fn variation(margins: &[f64], limit: f64, chains: usize) -> f64 {
    let n = margins.len();
    let hit: Vec<f64> = margins.iter().map(|m| f64::from(u8::from(*m <= limit))).collect();
    let p = hit.iter().sum::<f64>() / n as f64;
    let length = n / chains;
    let variance = p * (1.0 - p);
    if variance <= 0.0 {
        return 0.0;
    }
    let mut gamma = 0.0;
    for lag in 1..length {
        let pairs = n - lag * chains;
        let product = (0..pairs).map(|at| hit[at] * hit[at + lag * chains]).sum::<f64>() / pairs as f64;
        gamma += 2.0 * (1.0 - lag as f64 / length as f64) * (product - p * p) / variance;
    }
    ((1.0 - p) / (p * n as f64) * (1.0 + gamma).max(0.1)).sqrt()
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn graded(margin: f64) -> f64 {
        if margin <= 0.0 { EVENT } else { margin }
    }

    #[test]
    fn linear_event_has_its_probability() {
        // Φ(-3.0902) = 1e-3: a sum of two coordinates and half of a draw.
        let (mut sum, mut square) = (0.0, 0.0);
        for seed in 0..20 {
            let plan = Plan { dimensions: 2, draws: true, points: 500, budget: 10_000, seed };
            let run = subset(plan, |points| {
                let of_draw = |draw: u64| quantile((draw >> 11) as f64 / (1_u64 << 53) as f64 + 1e-17);
                let margin = |p: &Point| 3.0902 - (p.u[0] + p.u[1]) / 2.0 - of_draw(p.draw) / 2.0_f64.sqrt();
                Ok::<_, Infallible>(points.iter().map(|p| graded(margin(p))).collect())
            })
            .unwrap();
            assert!(run.reached && run.evaluations <= 10_000);
            sum += run.probability / 20.0;
            square += run.variation.unwrap_or(9.0) / 20.0;
        }
        assert!((0.8e-3..1.2e-3).contains(&sum), "{sum}");
        assert!((0.15..0.5).contains(&square), "{square}");
    }

    #[test]
    fn exhausted_budget_is_an_upper_estimate() {
        let plan = Plan { dimensions: 2, draws: false, points: 100, budget: 150, seed: 1 };
        let run = subset(plan, |p| Ok::<_, Infallible>(p.iter().map(|p| graded(8.0 - p.u[0])).collect())).unwrap();
        assert!(
            !run.reached && run.variation.is_none() && run.events.is_empty() && (run.probability - 0.03).abs() < 1e-12
        );
    }
}
