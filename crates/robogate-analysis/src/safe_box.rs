//! The largest box of parameters in which the policy reaches a target rate.

use robogate_stats::format::percent;
use robogate_stats::safe_box::{Column, Inside, Limits, contains, rows_needed, search};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::dependence::too_few;
use crate::effects::Effects;
use crate::table::{EpisodeTable, ParameterColumn, ParameterKind, Sample};
use crate::{Finding, Population, Rate};

/// The target rate unless the user gives one.
pub const DEFAULT_TARGET: f64 = 0.9;
/// The seed of the division into two halves. Equal rows give equal boxes.
const SEED: u64 = 1;

/// The largest box of at most three parameters in which success is at least a target rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SafeBox {
    /// The target rate.
    pub target: f64,
    /// Whether the lower bound reaches the target. Otherwise the box is the most promising one.
    pub verified: bool,
    /// The limited parameters. Empty for the whole space.
    pub limits: Vec<BoxLimit>,
    /// The rate inside, from episodes that did not choose the box. For the whole space, from all episodes.
    pub held_out: Rate,
    /// Exact lower bound of that rate: the lower end of the 95 % interval.
    pub lower_bound: f64,
    /// Share of the operating space inside, or of the episodes if the parameters were not sampled independently.
    pub volume: f64,
    /// All failures.
    pub failures: u64,
    /// Failures outside the box.
    pub avoided: u64,
    /// The same for each failure mode that occurred.
    pub avoided_modes: Vec<AvoidedMode>,
    /// Estimated number of further episodes that verify the box with a probability of 80 %. `None` if it is verified, or
    /// if the estimated rate is not above the target.
    pub more_episodes: Option<u64>,
}

/// One limit of a box.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BoxLimit {
    /// The parameter.
    pub parameter: String,
    /// Smallest value inside. `None` if it is not limited from below, and for levels.
    pub low: Option<f64>,
    /// Largest value inside. `None` if it is not limited from above, and for levels.
    pub high: Option<f64>,
    /// The levels inside, for a categorical parameter.
    pub levels: Vec<String>,
    /// The levels outside.
    pub excluded_levels: Vec<String>,
}

/// Failures of one mode outside the box.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AvoidedMode {
    /// The mode.
    pub mode: String,
    /// Its failures.
    pub failures: u64,
    /// Those outside the box.
    pub avoided: u64,
}

pub(crate) fn safe_box(
    table: &EpisodeTable,
    base: &Sample,
    population: Population,
    independent: bool,
    effects: &Effects,
    target: f64,
) -> Finding<SafeBox> {
    match population {
        Population::Suite => return Finding::not("the scenarios of a suite were chosen and do not fill a space"),
        Population::FocusedDesign => return Finding::not("a focused design does not estimate the operating space"),
        _ => {}
    }
    if let Some(because) = base.clusters().and_then(|clusters| too_few(clusters.count())) {
        return Finding::not(because);
    }
    let all = base.effective(|_| true);
    let whole = Rate::of_rows(base, |_| true).clopper_pearson_95[0];
    if whole >= target {
        return Finding::Estimated(describe(table, base, &Vec::new(), all, whole, target, true, 1.0));
    }
    // A box may name only parameters that pass the test of the headline. The search tests them again, in the rows that
    // choose the box.
    let used: Vec<&ParameterColumn> = base.parameters.iter().filter(|p| effects.may_name(&p.name)).collect();
    if used.is_empty() {
        return Finding::not("no parameter has a significant effect");
    }
    let columns: Vec<Column<'_>> = used.iter().map(|parameter| column(parameter)).collect();
    let Some(mut found) =
        search(&columns, &base.success, base.weights.as_deref(), base.clusters(), target, Confidence::P95, SEED)
    else {
        return Finding::not(format!("{} valid episodes are too few (it needs at least 100)", base.len()));
    };
    for (at, _) in &mut found.limits {
        let name = &used[*at].name;
        *at = base.parameters.iter().position(|p| p.name == *name).unwrap_or(*at);
    }
    if found.limits.is_empty() {
        return Finding::not(format!(
            "no parameter has a significant effect in the half of the episodes that chooses the box, and the rate of the whole \
             space is not significantly at or above {}",
            percent(target)
        ));
    }
    let share = found.held_out.n() as f64 / found.held_out_rows.max(1) as f64;
    let volume = if population == Population::OperatingSpace && independent {
        found.limits.iter().map(|(at, inside)| share_inside(&base.parameters[*at], inside)).product()
    } else {
        share
    };
    let mut described =
        describe(table, base, &found.limits, found.held_out, found.lower_bound, target, found.verified, volume);
    // The number of further episodes depends on how many clusters they come from.
    if let (false, Some(rate), None) = (found.verified, found.all.rate(), &base.dependence) {
        // Half of the episodes verify the box.
        let needed =
            rows_needed(rate, target, Confidence::P95).map(|rows| (2.0 * rows as f64 / share.max(1e-9)).ceil());
        described.more_episodes = needed.map(|all| (all as u64).saturating_sub(base.len() as u64)).filter(|n| *n > 0);
    }
    Finding::Estimated(described)
}

pub(crate) fn column(parameter: &ParameterColumn) -> Column<'_> {
    let levels = match &parameter.kind {
        ParameterKind::Categorical { levels } => Some(levels.len()),
        ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => None,
    };
    Column { values: &parameter.values, levels }
}

#[expect(clippy::too_many_arguments, reason = "each is one figure of the box")]
fn describe(
    table: &EpisodeTable,
    base: &Sample,
    limits: &Limits,
    held_out: Trials,
    lower_bound: f64,
    target: f64,
    verified: bool,
    volume: f64,
) -> SafeBox {
    let columns: Vec<Column<'_>> = base.parameters.iter().map(column).collect();
    let (failed, modes) = base.failures(table);
    let mut counts = vec![(0, 0); table.modes.len()];
    for (row, mode) in failed.iter().zip(modes) {
        counts[mode].0 += 1;
        counts[mode].1 += u64::from(!contains(limits, &columns, *row));
    }
    let modes = counts.iter().enumerate().filter(|(_, (failures, _))| *failures > 0);
    SafeBox {
        target,
        verified,
        limits: limits.iter().map(|(at, inside)| limit(&base.parameters[*at], inside)).collect(),
        held_out: Rate::of(held_out),
        lower_bound,
        volume,
        failures: failed.len() as u64,
        avoided: counts.iter().map(|(_, avoided)| avoided).sum(),
        avoided_modes: modes
            .map(|(mode, (failures, avoided))| AvoidedMode {
                mode: table.mode(mode).to_owned(),
                failures: *failures,
                avoided: *avoided,
            })
            .collect(),
        more_episodes: None,
    }
}

pub(crate) fn limit(parameter: &ParameterColumn, inside: &Inside) -> BoxLimit {
    let name = parameter.name.clone();
    match (inside, &parameter.kind) {
        (Inside::Levels(kept), ParameterKind::Categorical { levels }) => {
            let of = |wanted: bool| {
                let levels = levels.iter().enumerate();
                let chosen = levels.filter(|(at, _)| kept.get(*at).copied().unwrap_or(false) == wanted);
                chosen.map(|(_, level)| level.clone()).collect()
            };
            BoxLimit { parameter: name, low: None, high: None, levels: of(true), excluded_levels: of(false) }
        }
        (Inside::Range { low, high }, kind) => {
            // Between two integers, the limit is the next integer inside.
            let whole = matches!(kind, ParameterKind::Integer { .. });
            let low = low.map(|v| if whole { v.ceil() } else { v });
            let high = high.map(|v| if whole { v.floor() } else { v });
            BoxLimit { parameter: name, low, high, levels: Vec::new(), excluded_levels: Vec::new() }
        }
        (Inside::Levels(_), _) => {
            BoxLimit { parameter: name, low: None, high: None, levels: Vec::new(), excluded_levels: Vec::new() }
        }
    }
}

/// Share of the operating distribution of one parameter inside a limit.
fn share_inside(parameter: &ParameterColumn, inside: &Inside) -> f64 {
    match (inside, &parameter.kind) {
        (Inside::Range { low, high }, ParameterKind::Continuous { low: from, high: to, log }) => {
            let scale = |v: f64| if *log { v.ln() } else { v };
            let (a, b) = (low.unwrap_or(*from).max(*from), high.unwrap_or(*to).min(*to));
            ((scale(b) - scale(a)) / (scale(*to) - scale(*from))).clamp(0.0, 1.0)
        }
        (Inside::Range { low, high }, ParameterKind::Integer { low: from, high: to }) => {
            let (from, to) = (*from as f64, *to as f64);
            let (a, b) = (low.unwrap_or(from).ceil().max(from), high.unwrap_or(to).floor().min(to));
            ((b - a + 1.0) / (to - from + 1.0)).clamp(0.0, 1.0)
        }
        (Inside::Levels(kept), ParameterKind::Categorical { levels }) => {
            kept.iter().filter(|kept| **kept).count() as f64 / levels.len().max(1) as f64
        }
        _ => 1.0,
    }
}
