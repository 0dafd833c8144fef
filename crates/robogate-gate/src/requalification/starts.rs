//! The initial states before and after an upgrade: whether they are the same, how many are different, and whether pairs are pairs.

use std::collections::BTreeMap;

use robogate_stats::format::{counted, number, significant};
use serde::Serialize;

use super::Seen;
use super::trace::{PENETRATION, angle, distance, tilt};

/// Poses that differ by less are equal: in metres, and in radians.
const SAME_M: f64 = 0.001;
const SAME_RAD: f64 = 0.009;
/// Depths that differ by less are equal, in metres.
const SAME_DEPTH_M: f64 = 0.0005;
/// Observations within this difference are equal, relative to their size.
const SAME_OBSERVED: f64 = 1e-3;
/// Fewest pairs, and fewest different starts, for which it can be told whether pairs belong together.
const FEWEST_PAIRS: usize = 8;
const FEWEST_STARTS: f64 = 3.0;

/// The initial states.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Starts {
    /// Pairs whose starts can be compared.
    pub pairs: u64,
    /// Pairs whose starts differ.
    pub different: u64,
    /// How many different starts there are in effect, before and after: the inverse of the chance that two are equal.
    pub effective: [f64; 2],
    /// The share of episodes whose start is nearest to that of its own pair. `None` if that cannot be told.
    pub recognized: Option<f64>,
    /// What differs, as sentences.
    pub differences: Vec<String>,
}

impl Starts {
    pub(super) fn of(pairs: &[(&Seen, &Seen)]) -> Self {
        let mut found = Self { pairs: pairs.len() as u64, ..Self::default() };
        let mut by_kind: BTreeMap<(String, &str), Vec<f64>> = BTreeMap::new();
        for (before, after) in pairs {
            let differences = differences(before, after);
            found.different += u64::from(!differences.is_empty());
            differences.into_iter().for_each(|(kind, size)| by_kind.entry(kind).or_default().push(size));
        }
        let signatures: [Vec<Vec<f64>>; 2] = [
            pairs.iter().map(|pair| signature(pair.0)).collect(),
            pairs.iter().map(|pair| signature(pair.1)).collect(),
        ];
        found.effective = [effective(&signatures[0]), effective(&signatures[1])];
        found.recognized = recognized(&signatures, found.effective[0]);
        let mut kinds: Vec<((String, &str), Vec<f64>)> = by_kind.into_iter().collect();
        kinds.sort_by_key(|(_, sizes)| std::cmp::Reverse(sizes.len()));
        found.differences = kinds.into_iter().map(|((name, unit), sizes)| told(&name, unit, sizes)).collect();
        found
    }

    /// Whether a relevant share of the starts is another one, or they are fewer.
    pub(super) fn changed(&self) -> bool {
        let fewer = self.effective[1] < 0.8 * self.effective[0] && self.different > 0;
        fewer || (self.different > 0 && self.different as f64 >= super::RELEVANT * self.pairs as f64)
    }

    /// Whether the starts are as different as those of different pairs, although they are as many.
    pub(super) fn mixed_up(&self) -> bool {
        let as_many = self.effective[1] >= 0.5 * self.effective[0];
        as_many && self.different > 0 && self.recognized.is_some_and(|share| share <= 0.5)
    }
}

fn told(name: &str, unit: &str, mut sizes: Vec<f64>) -> String {
    let n = sizes.len() as u64;
    sizes.sort_by(f64::total_cmp);
    let median = sizes[sizes.len() / 2];
    let (scale, unit) = match unit {
        "m" => (1e3, " mm"),
        "rad" => (180.0 / std::f64::consts::PI, " degrees"),
        _ => (1.0, ""),
    };
    let sign = if median > 0.0 { "+" } else { "" };
    format!("{name}: {sign}{}{unit} (median) in {}", significant(scale * median, 2), counted(n, "start"))
}

/// What differs between two starts, with its size.
fn differences<'a>(before: &Seen, after: &Seen) -> Vec<((String, &'a str), f64)> {
    let mut found = Vec::new();
    if let (Some(one), Some(two)) = (&before.trace, &after.trace) {
        for (name, then) in &one.start {
            let Some(now) = two.start.get(name) else {
                found.push(((format!("{name} is missing"), ""), 1.0));
                continue;
            };
            let [dx, dy, dz] = [0, 1, 2].map(|axis| now[axis] - then[axis]);
            let (tipped, turned) = (tilt(then, now), angle(then, now));
            let candidates = [
                ("height", "m", dz, dz.abs() > SAME_M),
                ("horizontal position", "m", dx.hypot(dy), dx.hypot(dy) > SAME_M),
                ("tilt", "rad", tipped, tipped > SAME_RAD),
                ("rotation", "rad", turned, turned > SAME_RAD && tipped <= SAME_RAD),
            ];
            let differ = candidates.into_iter().filter(|of| of.3);
            found.extend(differ.map(|(what, unit, size, _)| ((format!("{what} of {name}"), unit), size)));
        }
        let of_robot = one.bodies.iter().enumerate().filter(|(_, part)| part.robot).filter_map(|(at, part)| {
            let other = two.bodies.iter().position(|other| other.name == part.name)?;
            Some(distance(&one.pose(0, at), &two.pose(0, other)))
        });
        let robot = of_robot.fold(0.0, f64::max);
        if robot > SAME_M {
            found.push((("position of the robot".to_owned(), "m"), robot));
        }
        let depth = |seen: &super::Trace| seen.signal(PENETRATION).and_then(|depths| depths.first().copied());
        if let (Some(then), Some(now)) = (depth(one), depth(two))
            && (now - then).abs() > SAME_DEPTH_M
        {
            found.push((("penetration at the start".to_owned(), "m"), now - then));
        }
    }
    if before.start.len() != after.start.len() {
        let what = format!("{} instead of {} observed numbers", after.start.len(), before.start.len());
        found.push(((what, ""), 1.0));
    } else if let Some((at, size)) = before
        .start
        .iter()
        .zip(&after.start)
        .map(|(then, now)| (now - then, SAME_OBSERVED * (1.0 + then.abs())))
        .enumerate()
        .find_map(|(at, (size, same))| (size.abs() > same).then_some((at, size)))
        && found.is_empty()
    {
        found.push(((format!("observed number {}", number(at as f64)), ""), size));
    }
    found
}

/// The numbers that describe a start.
fn signature(seen: &Seen) -> Vec<f64> {
    let placed = seen.trace.iter().flat_map(|trace| trace.start.values().flatten().copied());
    placed.chain(seen.start.iter().copied()).collect()
}

/// The effective number of different starts.
fn effective(signatures: &[Vec<f64>]) -> f64 {
    let mut groups: Vec<(&Vec<f64>, f64)> = Vec::new();
    for one in signatures {
        let same = |other: &Vec<f64>| {
            one.len() == other.len()
                && one.iter().zip(other).all(|(a, b)| (a - b).abs() <= SAME_OBSERVED * (1.0 + a.abs()))
        };
        match groups.iter_mut().find(|(other, _)| same(other)) {
            Some((_, count)) => *count += 1.0,
            None => groups.push((one, 1.0)),
        }
    }
    let n: f64 = groups.iter().map(|(_, count)| count).sum();
    if n == 0.0 { 0.0 } else { n * n / groups.iter().map(|(_, count)| count * count).sum::<f64>() }
}

/// The share of starts whose nearest one before the upgrade is that of their own pair. A shift that all have in common does not count.
fn recognized(signatures: &[Vec<Vec<f64>>; 2], effective: f64) -> Option<f64> {
    let [before, after] = signatures;
    let (n, width) = (before.len(), before.first()?.len());
    let comparable = before.iter().chain(after).all(|one| one.len() == width);
    if n < FEWEST_PAIRS || effective < FEWEST_STARTS || !comparable {
        return None;
    }
    let column = |of: &[Vec<f64>], at: usize| of.iter().map(|row| row[at]).collect::<Vec<f64>>();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let mut scaled: Vec<(Vec<f64>, Vec<f64>)> = Vec::new();
    for at in 0..width {
        let (then, now) = (column(before, at), column(after, at));
        let (centre, shifted) = (mean(&then), mean(&now));
        let spread = mean(&then.iter().map(|x| (x - centre) * (x - centre)).collect::<Vec<f64>>()).sqrt();
        if spread > 1e-6 {
            let scale = |values: &[f64], centre: f64| values.iter().map(|x| (x - centre) / spread).collect();
            scaled.push((scale(&then, centre), scale(&now, shifted)));
        }
    }
    if scaled.is_empty() {
        return None;
    }
    let far = |i: usize, j: usize| scaled.iter().map(|(then, now)| (now[i] - then[j]).powi(2)).sum::<f64>();
    let own = (0..n).filter(|i| (0..n).all(|j| far(*i, *i) <= far(*i, j) + 1e-12)).count();
    Some(own as f64 / n as f64)
}
