//! The headline of an analysis in sentences.

use robogate_analysis::labels::{mode_label, parameter_label, value_with_unit};
use robogate_analysis::{
    Advice, Analysis, BoxLimit, ClusterReport, ConditionPart, EffectShape, FailureCondition, FailureModes,
    FailureRegion, Finding, Population, Power, Predictor, SafeBox, ShapeKind, SoughtBox, unrecorded,
};
use robogate_stats::format::{count, counted, list, number, percent, percent_or_dash, percent_range, range, sentence};
use schemars::JsonSchema;
use serde::Serialize;

use super::labels;

/// Smallest number of valid episodes for a verbal description of the rate.
const MIN_EPISODES: u64 = 30;

/// Maximum number of failure modes in a sentence.
const LISTED_MODES: usize = 3;

/// Smallest gain of the adjusted interval that is reported.
const MIN_GAIN: f64 = 1.1;

/// Clusters below which intervals of a rate above [`HIGH_RATE`] cover too rarely.
const FEW_AT_HIGH_RATES: u64 = 50;
const HIGH_RATE: f64 = 0.9;

/// The headline of an analysis.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Headline {
    /// The success rate in one sentence.
    pub answer: String,
    /// Where and how it fails.
    pub where_it_fails: Vec<String>,
    /// Recommendations.
    pub what_to_do: Vec<String>,
    /// Intervals and bounds of the rate.
    pub uncertainty: Vec<String>,
}

impl Headline {
    /// Creates the headline of an analysis.
    pub fn of(analysis: &Analysis) -> Self {
        Self {
            answer: answer(analysis),
            where_it_fails: where_it_fails(analysis),
            what_to_do: analysis.claims.advice.iter().map(|advice| advise(analysis, advice)).collect(),
            uncertainty: uncertainty(analysis),
        }
    }
}

fn answer(analysis: &Analysis) -> String {
    let rate = &analysis.success.rate;
    if rate.rate.is_none() {
        return "No episode is valid, so there is no evidence about this policy.".to_owned();
    }
    let of = match analysis.population {
        Population::OperatingSpace => "over the operating space",
        Population::AsImported => "over the imported episodes",
        Population::Suite => "over the scenarios of the suite (not the operating space)",
        _ => "in a focused design (not the operating space)",
    };
    let chance = if rate.n < MIN_EPISODES { String::new() } else { chance(rate.wilson_95) };
    let of_feasible = match &analysis.success.feasible {
        Some(part) if part.n < rate.n => match part.rate {
            Some(share) => format!(
                " No policy can complete {} of the scenarios; over the others it succeeded in {} of {} ({}).",
                percent((rate.n - part.n) as f64 / rate.n as f64),
                count(part.successes),
                count(part.n),
                percent(share)
            ),
            None => " No policy can complete any of these scenarios.".to_owned(),
        },
        _ => String::new(),
    };
    let clusters = analysis.clusters.as_ref().map_or_else(String::new, |of| format!(" {}", dependent(analysis, of)));
    let result = match (rate.weighted_as, rate.rate) {
        (Some(_), Some(share)) => format!(
            "The policy succeeds in {} {of}{chance}, from {} by their sampling weights.",
            percent(share),
            counted(rate.n, "valid episode")
        ),
        _ => format!(
            "The policy succeeded in {} of {} {of}{chance}.",
            count(rate.successes),
            counted(rate.n, "valid episode")
        ),
    };
    format!("{result}{clusters}{of_feasible}")
}

/// What the clusters of the episodes mean for the claims, in sentences.
fn dependent(analysis: &Analysis, of: &ClusterReport) -> String {
    let by: Vec<String> =
        of.groupings.iter().map(|group| format!("{} ({})", group.by, count(group.clusters))).collect();
    let found = match of.serial_p {
        Some(_) => format!(
            "Neighbouring rows of the file depend on each other, so {} of them are counted instead of episodes. If sessions, days or \
             operators explain it, name their column with `--groups`. If the file was sorted by its outcomes, import the rows in the order \
             in which they were recorded.",
            counted(of.clusters, "block")
        ),
        None => format!("The episodes are not independent: they repeat {}.", list(&by)),
    };
    let scope = match analysis.population {
        Population::Suite => "The rate applies to these scenarios; effects of parameters count each scenario once.",
        _ => "Intervals and tests count these clusters, and apply to new ones of the same kind.",
    };
    let power = if of.too_few {
        " They are too few for a claim about others: at least 8 are needed."
    } else if of.low_power {
        " With fewer than 15 of them only large effects can be found."
    } else {
        ""
    };
    format!("{found} {scope}{power}")
}

/// A success rate in words, from both ends of its interval: a rate alone would claim more than the episodes support.
fn chance([low, high]: [f64; 2]) -> String {
    let tenths = [low, high].map(|end| (10.0 * end).round().clamp(0.0, 10.0));
    // Bounds are rounded outwards, so that they hold.
    let [least, most] = [(10.0 * low).floor(), (10.0 * high).ceil()];
    match tenths {
        _ if high < 0.01 => ": almost never".to_owned(),
        _ if low > 0.99 => ": almost always".to_owned(),
        [_, 10.0] if least >= 1.0 => format!(": at least {} in 10", times(least)),
        [0.0, _] if most <= 9.0 => format!(": at most {} in 10", times(most)),
        [low, high] if high - low < 0.5 => format!(": about {low} times in 10"),
        [low, high] => format!(": about {low} to {high} times in 10"),
    }
}

fn times(n: f64) -> String {
    if n < 1.5 { "once".to_owned() } else { format!("{n} times") }
}

fn where_it_fails(analysis: &Analysis) -> Vec<String> {
    let mut lines = Vec::new();
    let modes = &analysis.failure_modes;
    if modes.failures > 0 && !modes.not_recorded.is_empty() {
        lines.push(format!("The failure modes are uncertain: {}.", unrecorded(&modes.not_recorded)));
    } else if modes.failures > 0 {
        lines.push(main_modes(modes));
    } else if analysis.success.rate.n > 0 {
        lines.push("No failure was observed. This bounds the failure rate, but does not make it zero.".to_owned());
    }
    let regions = &analysis.claims.failure_regions;
    lines.extend(regions.iter().map(region));
    lines.extend(analysis.claims.interactions.iter().map(|[first, second]| {
        format!(
            "The effects of {} and {} depend on each other: see the map or compare both together.",
            parameter_label(first),
            parameter_label(second)
        )
    }));
    let tested = analysis.effects.tested;
    if regions.is_empty() && analysis.claims.interactions.is_empty() && modes.failures > 0 && tested > 0 {
        let power = analysis.conditions.power.as_ref().map_or_else(String::new, |of| format!(" {}", shown(of)));
        lines.push(format!(
            "No parameter has a significant effect on success ({} tested together).{power}",
            counted(tested, "parameter")
        ));
    }
    lines.extend(analysis.conditions.sought.as_ref().map(sought));
    lines
}

/// What the tests could have found.
fn shown(power: &Power) -> String {
    let now = if power.detectable < 1.0 {
        format!(
            "These episodes would show a difference of {} points between both halves of a parameter's range with a probability of 80 %.",
            count((100.0 * power.detectable).ceil() as u64)
        )
    } else {
        "These episodes are too few to show any difference between both halves of a parameter's range.".to_owned()
    };
    format!(
        "{now} A difference of 10 points needs about {}.",
        counted(rounded_up(power.episodes_for_10_points), "episode")
    )
}

/// A number with two significant digits, rounded up.
pub(crate) fn rounded_up(n: u64) -> u64 {
    let mut unit = 1;
    while n / unit >= 100 {
        unit *= 10;
    }
    n.div_ceil(unit) * unit
}

/// Where the sought failure mode occurs.
fn sought(found: &Finding<SoughtBox>) -> String {
    match found {
        Finding::CannotBeEstimated { because } => {
            format!("The sought failure mode has no box of parameters: {because}.")
        }
        Finding::Estimated(found) => format!(
            "The sought mode, {}, occurs in {} of the episodes with {} (95 % interval {}, {}), and in {} of the others ({}). Watch {}.",
            mode_label(&found.mode),
            percent(found.inside.rate),
            limits_in_words(&found.limits),
            percent_range(found.inside.interval_95),
            counted(found.inside.episodes, "held-out episode"),
            percent(found.outside.rate),
            percent_range(found.outside.interval_95),
            list(&found.replay.iter().map(|of| format!("episode {}", of.index)).collect::<Vec<_>>())
        ),
    }
}

/// The most frequent mode if a test supports it, otherwise the counts alone.
pub(crate) fn main_modes(modes: &FailureModes) -> String {
    let occurred = modes.modes.iter().filter(|m| m.failures > 0);
    let (unknown, mut by): (Vec<_>, Vec<_>) = occurred.partition(|m| m.is_unknown());
    if by.is_empty() {
        return "No failure mode is recorded.".to_owned();
    }
    by.sort_by_key(|m| std::cmp::Reverse(m.failures));
    let failures = counted(modes.failures, "failure");
    if let Some(dominant) = modes.dominant.estimated() {
        let of = by.iter().find(|m| m.mode == *dominant).map_or(0, |m| m.failures);
        return format!(
            "{} is the most frequent failure mode: {} of {failures}.",
            sentence(&mode_label(dominant)),
            count(of)
        );
    }
    let others = by.iter().skip(LISTED_MODES).chain(&unknown).map(|m| m.failures).sum::<u64>();
    let mut counts: Vec<String> =
        by.iter().take(LISTED_MODES).map(|m| format!("{} {}", count(m.failures), mode_label(&m.mode))).collect();
    if others > 0 {
        counts.push(format!("{} other", count(others)));
    }
    let none = if counts.len() > 1 { " None is significantly more frequent than the others." } else { "" };
    format!("{}: {}.{none}", sentence(&failures), list(&counts))
}

fn region(region: &FailureRegion) -> String {
    let name = sentence(&parameter_label(&region.parameter));
    let EffectShape { kind, low_levels, high, low, .. } = &region.shape;
    let low_rate = format!("{} success in {}", percent_or_dash(low.rate), counted(low.n, "episode"));
    let high_rate = percent_or_dash(high.rate);
    match kind {
        ShapeKind::Levels => format!("{name} {}: {low_rate}, and {high_rate} for the other levels.", some(low_levels)),
        _ => format!("{name} {}: {low_rate}, and {high_rate} elsewhere.", low_side(&region.parameter, &region.shape)),
    }
}

/// Where the rate is low along a numeric parameter, with the intervals of the steps.
pub(crate) fn low_side(parameter: &str, shape: &EffectShape) -> String {
    let steps: Vec<String> = shape
        .steps
        .iter()
        .map(|step| {
            let at = value_with_unit(&number(step.at), parameter);
            format!("{at} (95 % interval {})", range(step.interval_95))
        })
        .collect();
    match (shape.kind, steps.as_slice()) {
        (ShapeKind::Rising, [step]) => format!("below {step}"),
        (ShapeKind::Falling, [step]) => format!("above {step}"),
        (ShapeKind::Band, [from, to]) => format!("below {from} or above {to}"),
        (ShapeKind::Gap, [from, to]) => format!("between {from} and {to}"),
        _ => some(&shape.low_levels),
    }
}

/// A condition in words: "friction below 0.32 and mass above 1.2 kg".
pub(crate) fn condition(of: &FailureCondition) -> String {
    of.parameters.iter().map(part).collect::<Vec<_>>().join(" and ")
}

fn part(of: &ConditionPart) -> String {
    let name = parameter_label(&of.parameter);
    let value = |v: f64| value_with_unit(&number(v), &of.parameter);
    let range = |[low, high]: &[Option<f64>; 2]| match (low, high) {
        (Some(low), Some(high)) => format!("between {} and {}", value(*low), value(*high)),
        (Some(low), None) => format!("above {}", value(*low)),
        (None, Some(high)) => format!("below {}", value(*high)),
        (None, None) => "anywhere".to_owned(),
    };
    if of.ranges.is_empty() {
        return format!("{name} {}", list(&of.levels));
    }
    format!("{name} {}", of.ranges.iter().map(range).collect::<Vec<_>>().join(" or "))
}

/// Maximum number of levels in a sentence.
const MAX_LEVELS: usize = 6;

/// Levels as a list, the first ones if there are many.
fn some(levels: &[String]) -> String {
    if levels.len() <= MAX_LEVELS {
        return list(levels);
    }
    format!("{} and {} more", levels[..MAX_LEVELS].join(", "), levels.len() - MAX_LEVELS)
}

/// A box in words: "friction above 0.32, mass below 1.2 kg".
fn box_in_words(found: &SafeBox) -> String {
    limits_in_words(&found.limits)
}

fn limits_in_words(limits: &[BoxLimit]) -> String {
    let limit = |limit: &BoxLimit| {
        let name = parameter_label(&limit.parameter);
        let value = |v: f64| value_with_unit(&number(v), &limit.parameter);
        match (limit.low, limit.high) {
            (Some(low), Some(high)) => {
                format!("{name} {}", value_with_unit(&range([low, high]), &limit.parameter))
            }
            (Some(low), None) => format!("{name} at least {}", value(low)),
            (None, Some(high)) => format!("{name} at most {}", value(high)),
            (None, None) if limit.excluded_levels.len() < limit.levels.len() => {
                format!("{name} not {}", some(&limit.excluded_levels))
            }
            (None, None) => format!("{name} {}", some(&limit.levels)),
        }
    };
    list(&limits.iter().map(limit).collect::<Vec<_>>())
}

/// A verification that needs more episodes than this multiple of the run is not advised.
const MOST_MORE: u64 = 20;

fn operate(found: &SafeBox) -> String {
    let main = found.avoided_modes.iter().max_by_key(|mode| mode.avoided).filter(|mode| mode.avoided > 0);
    let main = main.map_or_else(String::new, |m| {
        format!(", among them {} of {} by {}", count(m.avoided), count(m.failures), mode_label(&m.mode))
    });
    format!(
        "Operate within {}: success is at least {} there with 95 % confidence ({} of {} held-out episodes). This is {} of the \
         space and avoids {} of {}{main}.",
        box_in_words(found),
        percent(found.target),
        count(found.held_out.successes),
        count(found.held_out.n),
        percent(found.volume),
        count(found.avoided),
        counted(found.failures, "failure")
    )
}

pub(crate) fn advise(analysis: &Analysis, advice: &Advice) -> String {
    let found = analysis.safe_box.estimated();
    match advice {
        Advice::ExplainInvalid => "Find out why every episode is invalid: see the faults under Sampling.".to_owned(),
        Advice::ReduceInvalid { invalid } => format!(
            "First investigate the {}: they are more than 2 % of the episodes.",
            counted(*invalid, "invalid episode")
        ),
        Advice::WholeSpace { target } => format!(
            "No limits are needed for a success rate of {}: the whole space reaches it with 95 % confidence.",
            percent(*target)
        ),
        Advice::Operate { .. } => found.map_or_else(String::new, operate),
        Advice::RunMore { target, episodes } if *episodes > MOST_MORE * analysis.success.rate.n => format!(
            "No limits on up to three parameters were verified to raise success to {}: the rate within the best that were found ({}) is so near \
             to it that {MOST_MORE} times as many episodes would not decide.",
            percent(*target),
            found.map_or_else(String::new, box_in_words)
        ),
        Advice::RunMore { target, episodes } => format!(
            "Run about {} to verify a success rate of {} within {}: the episodes so far do not show it with 95 % confidence.",
            counted(*episodes, "more episode"),
            percent(*target),
            found.map_or_else(String::new, box_in_words)
        ),
        Advice::NoBox { target } => format!(
            "No limits on up to three parameters were found that raise success to {}{}.",
            percent(*target),
            found.and_then(|found| found.held_out.rate.map(|rate| (found, rate))).map_or_else(
                String::new,
                |(found, rate)| {
                    format!(
                        ": the best that were found ({}) reach {} in held-out episodes",
                        box_in_words(found),
                        percent(rate)
                    )
                }
            )
        ),
        Advice::Joint { parameters } => format!(
            "The space samples {} jointly, so the effect of one of them may be caused by another.",
            labels(parameters)
        ),
        Advice::Replay { episode } => {
            format!("Replay the failures that the risk model does not explain, starting with episode {episode}.")
        }
    }
}

fn uncertainty(analysis: &Analysis) -> Vec<String> {
    let success = &analysis.success;
    let rate = &success.rate;
    if rate.n == 0 {
        return vec!["Without a valid episode the success rate may be anywhere from 0 to 100 %.".to_owned()];
    }
    let mut lines = vec![match (rate.clusters, rate.weighted_as) {
        (None, Some(independent)) => format!(
            "95 % interval {}. The {} are as precise as {} independent ones from the operating space, because {} were chosen.",
            percent_range(rate.wilson_95),
            counted(rate.n, "episode"),
            count(independent.round() as u64),
            count(success.weighting.as_ref().and_then(|of| of.estimated()).map_or(0, |of| of.chosen))
        ),
        (Some(of), _) => format!(
            "95 % interval {} for new clusters like these {} (Korn and Graubard). The episodes are as precise as {} independent ones.",
            percent_range(rate.wilson_95),
            count(of.clusters),
            count(of.effective_episodes.round() as u64)
        ),
        (None, None) => format!(
            "95 % interval {} (Wilson), {} (exact).",
            percent_range(rate.wilson_95),
            percent_range(rate.clopper_pearson_95)
        ),
    }];
    if let (Some(of), Some(observed)) = (rate.clusters, rate.rate)
        && of.clusters < FEW_AT_HIGH_RATES
        && observed > HIGH_RATE
    {
        lines.push("At rates above 90 % so few clusters seldom contain the rare bad one: the interval covers about 90 %, not 95 %.".to_owned());
    }
    if let Some(found) = success.adjusted.as_ref().and_then(|a| a.estimated()) {
        let gain = found.effective_episodes / rate.n as f64;
        if gain > MIN_GAIN {
            lines.push(format!(
                "With the known distribution of {}: {}, 95 % interval {}. Its variance is {} of that of the plain rate.",
                counted(found.parameters, "parameter"),
                percent(found.rate),
                percent_range(found.interval_95),
                percent(1.0 / gain)
            ));
        }
    }
    if success.bounds.invalid > 0 {
        lines.push(format!(
            "The rate excludes {}. If all of them had failed or succeeded, it would be {} or {}.",
            counted(success.bounds.invalid, "invalid episode"),
            percent_or_dash(success.bounds.worst_case),
            percent_or_dash(success.bounds.best_case)
        ));
    }
    if let Some(because) = success.weighting.as_ref().and_then(|of| of.because()) {
        lines.push(format!("Episodes whose points were chosen are left out: {because}."));
    }
    let model = analysis.risk.estimated().and_then(|risk| risk.predictor.estimated());
    if let Some(auc) = model.and_then(|model| model.auc_cross_validated) {
        lines.push(format!(
            "A risk model of the parameters ranks a failure above a success in {} of all pairs (cross-validated AUC).",
            percent(auc)
        ));
    }
    lines
}

/// The model that predicts, in one sentence.
pub(crate) fn predictor_about(model: &Predictor) -> String {
    let learners = match model.boosting_share {
        0.0 => "a logistic model on splines and products of the parameters".to_owned(),
        1.0 => "gradient boosting".to_owned(),
        share => format!("{} gradient boosting, the rest a logistic model on splines and products", percent(share)),
    };
    format!(
        "Predictions of single episodes and of the monitor come from {learners}, chosen and calibrated ({}) by cross-validation over {} \
         episodes. The coefficients are those of the logistic model.",
        if model.calibrated_by_curve { "by a monotone curve" } else { "by a line" },
        count(model.rows)
    )
}
