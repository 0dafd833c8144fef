//! The shape of an effect: between which values of a parameter is the success rate high or low?
//!
//! The rate is a step function of the cells with two segments (a one-sided effect) or three (a band or a gap), fitted by
//! maximum likelihood over all places of the steps. Three segments are reported only if the middle one is the highest or
//! the lowest, if they are better by Schwarz's criterion, and if both steps are significant.
//!
//! A step lies at the edge of a cell. For a smooth effect it estimates where the rate crosses the level
//!
//! ```text
//! L = ln(q1 / q2) / (ln(q1 / q2) + ln(p2 / p1)),    q = 1 - p
//! ```
//!
//! between the rates p1 and p2 of its two sides: a cell with the rate r has the same expected log-likelihood
//! r ln p + (1 - r) ln q on both sides if r = L. The level is near the mean of p1 and p2.
//!
//! The interval of a step is valid for every effect that is monotone near it, a jump as well as a gradual change. It
//! consists of the edges c for which "the rate is on one side of L in all cells before c, and on the other side in all
//! cells after c" is not rejected. Windows of 1, 2, 4, ... cells directly before and directly after c, up to the ends of
//! both segments, are tested against L with exact binomial tests. The error of 5 % is divided equally among them
//! (Bonferroni). The interval is the hull of these edges, widened by one cell on each side, because a crossing lies
//! within a cell.
//!
//! Limit: the tests take L as known. It is estimated from the rates (k + 1/2) / (n + 1) of both segments. The windows
//! overlap, so the interval covers more often than 95 % and is longer than one that assumes a jump. For a band or a gap,
//! the interval of one step ends at the other step.
//!
//! Sources: Schwarz (1978) for the number of segments; Dümbgen and Spokoiny (2001), Annals of Statistics 29(1), for
//! tests on all scales together.

use crate::Trials;
use crate::compare::{at_least, at_most};
use crate::scan::log_likelihood;

/// Error of all tests of one edge together.
const ERROR: f64 = 0.05;
/// Standard errors between the rates of neighbouring segments for a band or a gap.
const SIGNIFICANT: f64 = 3.0;

/// A step of the success rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// The edge at which the rate changes.
    pub at: f64,
    /// Lower end of its 95 % interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// The shape of the success rate along one parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// The rate is higher above the step.
    Rising(Step),
    /// The rate is higher below the step.
    Falling(Step),
    /// The rate is higher between the steps.
    Band(Step, Step),
    /// The rate is lower between the steps.
    Gap(Step, Step),
}

/// A shape with the counts of its two sides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segments {
    /// The shape.
    pub shape: Shape,
    /// Trials where the rate is high.
    pub high: Trials,
    /// Trials where the rate is low.
    pub low: Trials,
}

/// The shape of the success rate over cells with these edges (one more than cells). `None` for fewer than two cells with
/// trials, for equal outcomes, and if the number of edges does not match.
pub fn segments(cells: &[Trials], edges: &[f64]) -> Option<Segments> {
    let counts = Cumulative::of(cells);
    let m = cells.len();
    let successes = counts.k[m];
    if edges.len() != m + 1 || m < 2 || successes <= 0.0 || successes >= counts.n[m] {
        return None;
    }
    let cut = one_step(&counts)?;
    // Schwarz's criterion: two more places and rates cost ln n each in the deviance.
    let penalty = counts.n[m].ln();
    let better = |cuts: &[usize; 2]| counts.of_cuts(cuts) - counts.of_cuts(&[cut]) > penalty;
    if let Some([a, b]) = two_steps(&counts).filter(better) {
        let steps = [counts.difference(0, a, b), counts.difference(a, b, m)];
        let band = steps[0] > SIGNIFICANT && steps[1] < -SIGNIFICANT;
        let gap = steps[0] < -SIGNIFICANT && steps[1] > SIGNIFICANT;
        if band || gap {
            let (from, to) = (step(&counts, edges, [0, a, b]), step(&counts, edges, [a, b, m]));
            let (inner, outer) = (counts.trials(a, b), counts.outside(a, b));
            return Some(if band {
                Segments { shape: Shape::Band(from, to), high: inner, low: outer }
            } else {
                Segments { shape: Shape::Gap(from, to), high: outer, low: inner }
            });
        }
    }
    let at = step(&counts, edges, [0, cut, m]);
    let (below, above) = (counts.trials(0, cut), counts.trials(cut, m));
    Some(if above.rate() > below.rate() {
        Segments { shape: Shape::Rising(at), high: above, low: below }
    } else {
        Segments { shape: Shape::Falling(at), high: below, low: above }
    })
}

/// The most likely place of one step.
fn one_step(counts: &Cumulative) -> Option<usize> {
    let m = counts.cells();
    best((1..m).filter(|c| counts.splits(&[*c])), |c| counts.of_cuts(&[c]))
}

/// The most likely places of two steps.
fn two_steps(counts: &Cumulative) -> Option<[usize; 2]> {
    let m = counts.cells();
    let pairs = (1..m).flat_map(|a| (a + 1..m).map(move |b| [a, b]));
    best(pairs.filter(|cuts| counts.splits(cuts)), |cuts| counts.of_cuts(&cuts))
}

fn best<T: Copy>(of: impl Iterator<Item = T>, score: impl Fn(T) -> f64) -> Option<T> {
    let mut best: Option<(f64, T)> = None;
    for item in of {
        let found = score(item);
        if best.as_ref().is_none_or(|(score, _)| found > *score) {
            best = Some((found, item));
        }
    }
    best.map(|(_, item)| item)
}

/// The step at edge `cut` between the segments `from..cut` and `cut..to`. Its interval is the hull of the compatible
/// edges, widened by one cell on each side.
fn step(counts: &Cumulative, edges: &[f64], [from, cut, to]: [usize; 3]) -> Step {
    let (below, above) = (counts.trials(from, cut), counts.trials(cut, to));
    let level = level(below, above);
    let rising = above.rate() > below.rate();
    // An edge has at most this many windows. All edges have the same limit.
    let windows = 2 * widths(to - from - 1).count();
    let ln_limit = (ERROR / windows as f64).ln();
    let contradicts = |from: usize, to: usize, high: bool| {
        let cells = counts.trials(from, to);
        let ln_p = if high { at_most(cells, level) } else { at_least(cells, level) };
        ln_p <= ln_limit
    };
    let compatible = |c: usize| {
        !widths(c - from).any(|width| contradicts(c - width, c, !rising))
            && !widths(to - c).any(|width| contradicts(c, c + width, rising))
    };
    // A segment of very few trials can be on the wrong side of the level, which then says nothing.
    if !compatible(cut) {
        return Step { at: edges[cut], low: edges[from], high: edges[to] };
    }
    let low = (from + 1..cut).find(|c| compatible(*c)).unwrap_or(cut);
    let high = (cut + 1..to).rev().find(|c| compatible(*c)).unwrap_or(cut);
    Step { at: edges[cut], low: edges[low - 1], high: edges[high + 1] }
}

/// The level L of the module's documentation: a cell with this rate is equally likely on both sides.
fn level(below: Trials, above: Trials) -> f64 {
    let rate = |of: Trials| (of.successes() as f64 + 0.5) / (of.n() as f64 + 1.0);
    let (p1, p2) = (rate(below), rate(above));
    let failures = ((1.0 - p1) / (1.0 - p2)).ln();
    let both = failures + (p2 / p1).ln();
    // Equal rates are their own level.
    if both.abs() > 1e-9 { failures / both } else { p1 }
}

/// The widths of the windows of at most `most` cells: powers of two, and `most` itself.
fn widths(most: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(Some(1_usize), |width| Some(width * 2)).take_while(move |width| *width < most).chain([most])
}

/// Cumulative counts.
struct Cumulative {
    n: Vec<f64>,
    k: Vec<f64>,
}

impl Cumulative {
    fn of(cells: &[Trials]) -> Self {
        let (mut n, mut k) = (vec![0.0], vec![0.0]);
        for cell in cells {
            n.push(n[n.len() - 1] + cell.n() as f64);
            k.push(k[k.len() - 1] + cell.successes() as f64);
        }
        Self { n, k }
    }

    fn cells(&self) -> usize {
        self.n.len() - 1
    }

    fn counts(&self, from: usize, to: usize) -> (f64, f64) {
        (self.k[to] - self.k[from], self.n[to] - self.n[from])
    }

    fn log_likelihood(&self, from: usize, to: usize) -> f64 {
        let (k, n) = self.counts(from, to);
        log_likelihood(k, n)
    }

    /// The log-likelihood of segments with these cuts between them.
    fn of_cuts(&self, cuts: &[usize]) -> f64 {
        let (mut from, mut sum) = (0, 0.0);
        for to in cuts.iter().copied().chain([self.cells()]) {
            sum += self.log_likelihood(from, to);
            from = to;
        }
        sum
    }

    /// Whether every segment between these cuts has trials.
    fn splits(&self, cuts: &[usize]) -> bool {
        let mut from = 0;
        cuts.iter().chain([&self.cells()]).all(|to| {
            let filled = self.n[*to] > self.n[from];
            from = *to;
            filled
        })
    }

    /// The difference of the rates of two neighbouring segments, in standard errors of their common rate.
    fn difference(&self, from: usize, middle: usize, to: usize) -> f64 {
        let ((k1, n1), (k2, n2)) = (self.counts(from, middle), self.counts(middle, to));
        let p = (k1 + k2) / (n1 + n2);
        let se = (p * (1.0 - p) * (1.0 / n1 + 1.0 / n2)).sqrt();
        if se > 0.0 { (k2 / n2 - k1 / n1) / se } else { 0.0 }
    }

    fn trials(&self, from: usize, to: usize) -> Trials {
        let (k, n) = self.counts(from, to);
        Trials::new(k as u64, n as u64).unwrap_or(Trials::NONE)
    }

    fn outside(&self, from: usize, to: usize) -> Trials {
        let (k, n) = self.counts(from, to);
        let last = self.cells();
        Trials::new((self.k[last] - k) as u64, (self.n[last] - n) as u64).unwrap_or(Trials::NONE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::binomial;
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    const CELLS: usize = 60;

    fn edges() -> Vec<f64> {
        (0..=CELLS).map(|i| i as f64 / CELLS as f64).collect()
    }

    fn sampled(seed: u64, rate: impl Fn(f64) -> f64) -> Vec<Trials> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let one = |i: usize| Trials::new(binomial(&mut rng, 50, rate((i as f64 + 0.5) / CELLS as f64)), 50).unwrap();
        (0..CELLS).map(one).collect()
    }

    fn covers(step: Step, truth: f64) -> bool {
        step.low <= truth && truth <= step.high
    }

    #[test]
    fn intervals_cover_planted_steps() {
        let (mut one, mut both) = (0, 0);
        for seed in 0..300 {
            let found = segments(&sampled(seed, |x| if x > 0.35 { 0.8 } else { 0.6 }), &edges()).unwrap();
            one += u32::from(matches!(found.shape, Shape::Rising(step) if covers(step, 0.35)));
            let gap = |x: f64| if (0.3..0.7).contains(&x) { 0.5 } else { 0.8 };
            let found = segments(&sampled(seed, gap), &edges()).unwrap();
            both += u32::from(matches!(found.shape, Shape::Gap(a, b) if covers(a, 0.3) && covers(b, 0.7)));
        }
        assert!(one >= 285, "one step: {one} of 300");
        assert!(both >= 270, "both steps: {both} of 300");
    }

    fn logistic(x: f64) -> f64 {
        1.0 / (1.0 + (-x).exp())
    }

    /// Counts with the expected number of successes of each cell. Their most likely steps are what the steps of a
    /// smooth effect estimate.
    fn expected(rate: impl Fn(f64) -> f64) -> Cumulative {
        let (mut n, mut k) = (vec![0.0], vec![0.0]);
        for i in 0..CELLS {
            n.push(n[i] + 50.0);
            k.push(k[i] + 50.0 * rate((i as f64 + 0.5) / CELLS as f64));
        }
        Cumulative { n, k }
    }

    #[test]
    fn intervals_cover_smooth_crossings() {
        for (slope, centre) in [(4.0, 0.5), (6.0, 0.4), (8.0, 0.6), (12.0, 0.3)] {
            let rate = |x: f64| logistic(slope * (x - centre));
            let truth = edges()[one_step(&expected(rate)).unwrap()];
            let (mut held, mut width) = (0, 0.0);
            for seed in 0..200 {
                let found = segments(&sampled(seed, rate), &edges()).unwrap();
                if let Shape::Rising(step) = found.shape {
                    held += u32::from(covers(step, truth));
                    width += (step.high - step.low) / 200.0;
                }
            }
            assert!(held >= 186, "slope {slope}: {held} of 200");
            assert!(width < 0.4, "slope {slope}: {width}");
        }
        let band = |x: f64| logistic(2.0 - 30.0 * (x - 0.5).powi(2));
        let truth = two_steps(&expected(band)).unwrap().map(|cut| edges()[cut]);
        let mut held = [0, 0];
        for seed in 0..200 {
            if let Shape::Band(from, to) = segments(&sampled(seed, band), &edges()).unwrap().shape {
                held[0] += u32::from(covers(from, truth[0]));
                held[1] += u32::from(covers(to, truth[1]));
            }
        }
        assert!(held.iter().all(|held| *held >= 186), "band: {held:?} of 200");
    }

    #[test]
    fn jumps_have_short_intervals() {
        let width = |seed| match segments(&sampled(seed, |x| if x > 0.35 { 0.8 } else { 0.6 }), &edges()).unwrap().shape
        {
            Shape::Rising(step) => step.high - step.low,
            other => panic!("expected a rising rate, got {other:?}"),
        };
        let mean = (0..100).map(width).sum::<f64>() / 100.0;
        assert!(mean < 0.3, "{mean}");
    }

    #[test]
    fn level_is_equally_likely_in_both_segments() {
        let t = |k: u64, n: u64| Trials::new(k, n).unwrap();
        for (below, above) in
            [(t(20, 100), t(70, 90)), (t(95, 100), t(400, 2_000)), (t(0, 50), t(50, 50)), (t(0, 9), t(1, 9))]
        {
            let level = level(below, above);
            let of = |of: Trials| {
                let p = (of.successes() as f64 + 0.5) / (of.n() as f64 + 1.0);
                (p, level * p.ln() + (1.0 - level) * (1.0 - p).ln())
            };
            let ((p1, one), (p2, two)) = (of(below), of(above));
            assert!(
                (one - two).abs() < 1e-9 && p1.min(p2) < level && level < p1.max(p2),
                "{below:?} {above:?}: {level}"
            );
        }
        assert!((level(t(1, 2), t(1, 2)) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn few_trials_allow_the_whole_range() {
        let cells = [0, 0, 1, 1].map(|k| Trials::new(k, 1).unwrap());
        let found = segments(&cells, &[0.0, 1.0, 2.0, 3.0, 4.0]).unwrap();
        assert_eq!(found.shape, Shape::Rising(Step { at: 2.0, low: 0.0, high: 4.0 }));
    }

    #[test]
    fn smooth_shapes_are_recognised() {
        for seed in 0..20 {
            let of = |rate: &dyn Fn(f64) -> f64| segments(&sampled(seed, rate), &edges()).unwrap().shape;
            let near = |step: Step, truth: f64| (step.at - truth).abs() < 0.15;
            assert!(matches!(of(&|x| logistic(6.0 * x - 3.0)), Shape::Rising(step) if near(step, 0.5)));
            assert!(matches!(of(&|x| logistic(3.0 - 6.0 * x)), Shape::Falling(_)));
            // The published case of an offset: it fails at both ends.
            assert!(
                matches!(of(&|x| logistic(2.0 - 30.0 * (x - 0.5).powi(2))), Shape::Band(a, b) if a.at < 0.4 && b.at > 0.6)
            );
            assert!(matches!(of(&|x| logistic(30.0 * (x - 0.5).powi(2) - 2.0)), Shape::Gap(..)));
        }
    }

    #[test]
    fn equal_outcomes_have_no_shape() {
        let all = [Trials::new(5, 5).unwrap(); 3];
        assert!(segments(&all, &[0.0, 1.0, 2.0, 3.0]).is_none());
        assert!(segments(&[Trials::new(2, 5).unwrap()], &[0.0, 1.0]).is_none());
        assert!(segments(&[Trials::new(2, 5).unwrap(); 3], &[0.0, 1.0]).is_none());
    }
}
