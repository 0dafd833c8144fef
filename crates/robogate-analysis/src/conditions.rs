//! Where the policy fails, as a table of conditions, and what the rows could have shown.

use robogate_stats::Confidence;
use robogate_stats::clusters::FEWEST;
use robogate_stats::pocket::{EventRate, pocket};
use robogate_stats::safe_box::Limits;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::effects::{Effects, Interaction, LEVEL, SINGLE, ShapeKind};
use crate::replay::{ReplayEpisode, episode};
use crate::safe_box::{BoxLimit, column, limit};
use crate::table::{Ending, EpisodeTable, ParameterColumn, Sample};
use crate::{Finding, Rate};

/// Most conditions.
const MOST: usize = 12;
/// Cells of each parameter among which the worst corner of a pair is found.
const CORNERS: usize = 10;
/// Fewest episodes in a corner, as a share of all.
const SMALLEST_CORNER: f64 = 0.02;
/// The part by which the effect must be larger than for a test of the right step alone, from simulations of the test.
const OF_UNKNOWN_SHAPE: f64 = 1.2;
/// Listed episodes of a pocket.
const LISTED: usize = 3;
/// The seed of the division into two halves.
const SEED: u64 = 1;

/// Where the policy fails.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Conditions {
    /// Conditions under which it significantly fails more often: one parameter, or two that interact. The smallest p-value first.
    pub failing: Vec<FailureCondition>,
    /// What the tests could have found. Absent without tested parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power: Option<Power>,
    /// Where the failure mode that the run sought occurs. Absent if it sought none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sought: Option<Finding<SoughtBox>>,
}

/// A condition on one or two parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FailureCondition {
    /// The values of each parameter.
    pub parameters: Vec<ConditionPart>,
    /// The rate under the condition. The limits were chosen on the same rows, so the contrast is slightly too large.
    pub inside: Rate,
    /// The rate elsewhere.
    pub outside: Rate,
    /// The failure rate under the condition, divided by that of all episodes. Absent without a failure.
    pub lift: Option<f64>,
    /// p-value of the effect, corrected for everything that was tested.
    pub adjusted_p: f64,
}

/// Values of one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ConditionPart {
    /// The parameter.
    pub parameter: String,
    /// Ranges, each with its lower and upper end. `None` where it has no end. Empty for levels.
    pub ranges: Vec<[Option<f64>; 2]>,
    /// Levels.
    pub levels: Vec<String>,
}

/// What the tests could have found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Power {
    /// The difference of the success rates in both halves of one parameter's range that these episodes show with a probability of
    /// 80 %, as a share. Above 1, no difference is large enough.
    pub detectable: f64,
    /// Episodes of this design that show a difference of 10 points with a probability of 80 %.
    pub episodes_for_10_points: u64,
}

/// The box of the sought failure mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SoughtBox {
    /// The failure mode.
    pub mode: String,
    /// Its limits.
    pub limits: Vec<BoxLimit>,
    /// How often the mode occurs inside, in episodes that did not choose the box.
    pub inside: ModeRate,
    /// How often it occurs outside.
    pub outside: ModeRate,
    /// Up to three of its episodes inside.
    pub replay: Vec<ReplayEpisode>,
}

/// How often a failure mode occurs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeRate {
    /// Episodes.
    pub episodes: u64,
    /// Those with the mode.
    pub occurred: u64,
    /// Its rate, by sampling weights.
    pub rate: f64,
    /// The 95 % interval.
    pub interval_95: [f64; 2],
}

impl From<EventRate> for ModeRate {
    fn from(of: EventRate) -> Self {
        Self {
            episodes: of.rows as u64,
            occurred: of.events as u64,
            rate: of.rate,
            interval_95: [of.interval.low, of.interval.high],
        }
    }
}

impl Conditions {
    /// `seek` is the failure mode that the plan of the run sought.
    pub(crate) fn of(table: &EpisodeTable, base: &Sample, effects: &Effects, seek: Option<&str>) -> Self {
        let overall = Rate::of_rows(base, |_| true);
        let all = overall.rate.map_or(0.0, |rate| 1.0 - rate);
        let condition = |base: &Sample, parameters: Vec<ConditionPart>, adjusted_p: f64| {
            let holds = |row: usize| parameters.iter().all(|part| part.holds(base, row));
            let of_row: Vec<bool> = (0..base.len()).map(holds).collect();
            let inside = Rate::of_rows(base, |row| of_row[row]);
            let outside = Rate::of_rows(base, |row| !of_row[row]);
            let lift = inside.rate.filter(|_| all > 0.0).map(|rate| (1.0 - rate) / all);
            FailureCondition { parameters, inside, outside, lift, adjusted_p }
        };
        let mut failing: Vec<FailureCondition> = Vec::new();
        for effect in effects.significant() {
            let Some(shape) = effect.shape.estimated() else { continue };
            let steps: Vec<f64> = shape.steps.iter().map(|step| step.at).collect();
            let ranges = match (shape.kind, steps.as_slice()) {
                (ShapeKind::Rising, [at]) => vec![[None, Some(*at)]],
                (ShapeKind::Falling, [at]) => vec![[Some(*at), None]],
                (ShapeKind::Band, [from, to]) => vec![[None, Some(*from)], [Some(*to), None]],
                (ShapeKind::Gap, [from, to]) => vec![[Some(*from), Some(*to)]],
                _ => Vec::new(),
            };
            let part = ConditionPart { parameter: effect.parameter.clone(), ranges, levels: shape.low_levels.clone() };
            let comparable = base.comparable(&effect.parameter);
            failing.push(condition(comparable.as_ref().unwrap_or(base), vec![part], effect.adjusted_p));
        }
        let corners = effects.interactions.iter().filter_map(|pair| Some((corner(base, pair)?, pair.adjusted_p)));
        failing.extend(corners.map(|(parts, p)| condition(base, parts, p)));
        failing.sort_by(|a, b| a.adjusted_p.total_cmp(&b.adjusted_p));
        failing.truncate(MOST);
        Self { failing, power: power(base, overall, effects), sought: seek.map(|mode| sought(table, base, mode)) }
    }
}

impl ConditionPart {
    fn holds(&self, base: &Sample, row: usize) -> bool {
        let Some(column) = base.parameter(&self.parameter) else { return false };
        let value = column.values[row];
        if self.ranges.is_empty() {
            return self.levels.contains(&column.show(value));
        }
        let within = |[low, high]: &[Option<f64>; 2]| low.is_none_or(|l| value >= l) && high.is_none_or(|h| value < h);
        self.ranges.iter().any(within)
    }
}

/// The corner of two parameters with the most failures beyond those of the rest: each is limited on one side.
fn corner(base: &Sample, pair: &Interaction) -> Option<Vec<ConditionPart>> {
    let columns = [base.parameter(&pair.parameters[0])?, base.parameter(&pair.parameters[1])?];
    let limits = columns.map(quantiles);
    let total: f64 = (0..base.len()).map(|row| base.weight(row)).sum();
    let failed: f64 = (0..base.len()).filter(|row| !base.success[*row]).map(|row| base.weight(row)).sum();
    // Weight and failures of each cell; sums over corners follow.
    let side = CORNERS;
    let mut cells = vec![[0.0; 2]; side * side];
    let place = |axis: usize, row: usize| limits[axis].partition_point(|limit| *limit <= columns[axis].values[row]);
    for row in 0..base.len() {
        let cell = &mut cells[place(0, row) * side + place(1, row)];
        cell[0] += base.weight(row);
        cell[1] += if base.success[row] { 0.0 } else { base.weight(row) };
    }
    let mut best: Option<(f64, [(usize, bool); 2])> = None;
    for first in 1..side {
        for second in 1..side {
            for above in [[false, false], [false, true], [true, false], [true, true]] {
                let inside = |i: usize, j: usize| (i >= first) == above[0] && (j >= second) == above[1];
                let (n, k) = (0..side * side)
                    .filter(|at| inside(at / side, at % side))
                    .fold((0.0, 0.0), |(n, k), at| (n + cells[at][0], k + cells[at][1]));
                let rate = failed / total.max(f64::MIN_POSITIVE);
                let excess =
                    (k - rate * n) / (n * (1.0 - n / total) * rate * (1.0 - rate)).max(f64::MIN_POSITIVE).sqrt();
                if n >= SMALLEST_CORNER * total && best.is_none_or(|(most, _)| excess > most) {
                    best = Some((excess, [(first, above[0]), (second, above[1])]));
                }
            }
        }
    }
    let (_, corner) = best?;
    let part = |axis: usize| {
        let (at, above) = corner[axis];
        let limit = limits[axis].get(at - 1).copied()?;
        let range = if above { [Some(limit), None] } else { [None, Some(limit)] };
        Some(ConditionPart { parameter: columns[axis].name.clone(), ranges: vec![range], levels: Vec::new() })
    };
    Some(vec![part(0)?, part(1)?])
}

/// The limits of cells of about equal count.
fn quantiles(column: &ParameterColumn) -> Vec<f64> {
    let mut sorted = column.values.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    (1..CORNERS).filter_map(|i| sorted.get(i * sorted.len() / CORNERS).copied()).collect()
}

/// The step in the middle of a parameter's range that the test finds with a probability of 80 %. A test of exactly this step needs a
/// difference of 2 s (z + 0.84) / sqrt(n), with the standard deviation s of an outcome.
fn power(base: &Sample, overall: Rate, effects: &Effects) -> Option<Power> {
    let rate = overall.rate?.clamp(0.02, 0.98);
    // The rate of a suite is that of its own scenarios. The tests of effects count its scenarios as clusters all the same.
    let independent = overall.independent().min(base.share() * base.len() as f64);
    let few = base.clusters().is_some_and(|clusters| clusters.count() < FEWEST);
    if effects.tested == 0 || independent < 1.0 || few {
        return None;
    }
    let level = Confidence::new(1.0 - LEVEL * SINGLE / effects.tested as f64).ok()?;
    let z = level.z() + 0.8416;
    let scale = 2.0 * (rate * (1.0 - rate)).sqrt() * z * OF_UNKNOWN_SHAPE;
    let per_row = independent / base.len() as f64;
    Some(Power {
        detectable: scale / independent.sqrt(),
        episodes_for_10_points: ((scale / 0.1).powi(2) / per_row).ceil() as u64,
    })
}

fn sought(table: &EpisodeTable, base: &Sample, mode: &str) -> Finding<SoughtBox> {
    let is_sought = |row: u32| match table.outcome[row as usize] {
        Ending::Failure(of) => table.mode(usize::from(of)) == mode,
        Ending::Success | Ending::Invalid => false,
    };
    let event: Vec<bool> = base.rows.iter().map(|row| is_sought(*row)).collect();
    let columns: Vec<_> = base.parameters.iter().map(column).collect();
    let occurred = event.iter().filter(|event| **event).count();
    let Some(found) = pocket(&columns, &event, base.weights.as_deref(), Confidence::P95, SEED) else {
        return Finding::not(format!("{occurred} episodes with it are too few"));
    };
    if !found.is_significant() {
        return Finding::not(format!(
            "no box was found in which it is significantly more frequent than outside ({occurred} episodes with it)"
        ));
    }
    let limits: &Limits = &found.limits;
    let inside = |at: usize| robogate_stats::safe_box::contains(limits, &columns, at);
    let listed = (0..base.len()).filter(|at| event[*at] && inside(*at)).take(LISTED);
    Finding::Estimated(SoughtBox {
        mode: mode.to_owned(),
        limits: limits.iter().map(|(at, inside)| limit(&base.parameters[*at], inside)).collect(),
        inside: found.inside.into(),
        outside: found.outside.into(),
        replay: listed.map(|at| episode(table, base.rows[at] as usize, String::new())).collect(),
    })
}
