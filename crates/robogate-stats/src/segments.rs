//! The shape of an effect: between which values of a parameter is the success rate high or low?
//!
//! The rate is a step function of the cells with two segments (a one-sided effect) or three (a band or a gap), fitted by
//! maximum likelihood over all places of the steps. Three segments are reported only if the middle one is the highest or
//! the lowest, if they are better by Schwarz's criterion, and if both steps are significant.
//!
//! A step lies at the edge of a cell. For a smooth effect it estimates where the rate crosses the mean of the two rates.
//! Its interval is the set of edges whose profile likelihood ratio 2 (ln L max - ln L) is at most 7.35: for a jump the
//! ratio has the distribution function (1 - exp(-x/2))², which is 95 % there. It is widened to the neighbouring edges,
//! between which a step cannot be located.
//!
//! Sources: Yao (1987), Biometrika 74(3), and Hansen (2000), Econometrica 68(3), for the distribution; Schwarz (1978).

use crate::Trials;
use crate::scan::log_likelihood;

/// The 95 % point of (1 - exp(-x/2))², halved: the allowed loss of log-likelihood.
const PROFILE: f64 = 7.352 / 2.0;
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
    let one = |c: usize| counts.log_likelihood(0, c) + counts.log_likelihood(c, m);
    let cut = best((1..m).filter(|c| counts.splits(&[*c])), one)?;
    let two = |(a, b): (usize, usize)| {
        counts.log_likelihood(0, a) + counts.log_likelihood(a, b) + counts.log_likelihood(b, m)
    };
    let pairs = (1..m).flat_map(|a| (a + 1..m).map(move |b| (a, b))).filter(|(a, b)| counts.splits(&[*a, *b]));
    // Schwarz's criterion: two more places and rates cost ln n each in the deviance.
    let penalty = counts.n[m].ln();
    if let Some((a, b)) = best(pairs, two).filter(|pair| two(*pair) - one(cut) > penalty) {
        let steps = [counts.difference(0, a, b), counts.difference(a, b, m)];
        let band = steps[0] > SIGNIFICANT && steps[1] < -SIGNIFICANT;
        let gap = steps[0] < -SIGNIFICANT && steps[1] > SIGNIFICANT;
        if band || gap {
            let most = two((a, b));
            // The other step moves too: the profile is the best over it.
            let first =
                |c: usize| best((c + 1..m).filter(|b| counts.splits(&[c, *b])), |b| two((c, b))).map(|b| two((c, b)));
            let second =
                |c: usize| best((1..c).filter(|a| counts.splits(&[*a, c])), |a| two((a, c))).map(|a| two((a, c)));
            let from = step(edges, a, m, |c| first(c).is_some_and(|l| most - l <= PROFILE));
            let to = step(edges, b, m, |c| second(c).is_some_and(|l| most - l <= PROFILE));
            let (inner, outer) = (counts.trials(a, b), counts.outside(a, b));
            return Some(if band {
                Segments { shape: Shape::Band(from, to), high: inner, low: outer }
            } else {
                Segments { shape: Shape::Gap(from, to), high: outer, low: inner }
            });
        }
    }
    let most = one(cut);
    let at = step(edges, cut, m, |c| counts.splits(&[c]) && most - one(c) <= PROFILE);
    let (below, above) = (counts.trials(0, cut), counts.trials(cut, m));
    Some(if above.rate() > below.rate() {
        Segments { shape: Shape::Rising(at), high: above, low: below }
    } else {
        Segments { shape: Shape::Falling(at), high: below, low: above }
    })
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

/// The step at edge `cut`, with the outermost compatible edges, each widened by one cell.
fn step(edges: &[f64], cut: usize, cells: usize, compatible: impl Fn(usize) -> bool) -> Step {
    let low = (1..cut).find(|c| compatible(*c)).unwrap_or(cut);
    let high = (cut + 1..cells).rev().find(|c| compatible(*c)).unwrap_or(cut);
    Step { at: edges[cut], low: edges[low - 1], high: edges[high + 1] }
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

    fn counts(&self, from: usize, to: usize) -> (f64, f64) {
        (self.k[to] - self.k[from], self.n[to] - self.n[from])
    }

    fn log_likelihood(&self, from: usize, to: usize) -> f64 {
        let (k, n) = self.counts(from, to);
        log_likelihood(k, n)
    }

    /// Whether every segment between these cuts has trials.
    fn splits(&self, cuts: &[usize]) -> bool {
        let mut from = 0;
        cuts.iter().chain([&(self.n.len() - 1)]).all(|to| {
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
        let last = self.n.len() - 1;
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

    #[test]
    fn smooth_shapes_are_recognised() {
        let logistic = |x: f64| 1.0 / (1.0 + (-x).exp());
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
