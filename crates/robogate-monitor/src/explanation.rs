//! The texts of an alarm: the change, its start, the guarantee, and the likely causes.

use robogate_stats::format::{count, fixed, number, percent};
use robogate_stats::overdispersion::{Outlier, outliers};
use robogate_stats::{Confidence, Trials, wilson};

use crate::alarm::{Alarm, Happening, Level, Since};
use crate::block_sums::Inflation;
use crate::cycle::Cycle;
use crate::detector::{ChangePoint, Factors, change_point};
use crate::domain::Validated;
use crate::history::Symbols;
use crate::metric::Metric;
use crate::modes::OTHER_MODE;
use crate::recipe::{Recipe, Standing, happening_id};
use crate::settings::Settings;

fn rate(trials: Trials) -> String {
    let interval = wilson(trials, Confidence::P95);
    let observed = trials.rate().map_or_else(|| "-".to_owned(), percent);
    format!("{observed} ({} to {})", percent(interval.low), percent(interval.high))
}

#[expect(clippy::too_many_arguments, reason = "the fields of an alarm that differ between its callers")]
fn alarm(
    recipe: &Recipe,
    cycle: &Cycle,
    happening: Happening,
    level: Level,
    metric: String,
    what: String,
    how_sure: String,
    since: Option<Since>,
    look_at: Vec<String>,
) -> Alarm {
    Alarm {
        id: happening_id(recipe, cycle, &metric, level, happening),
        happening,
        level,
        recipe: cycle.recipe.clone(),
        metric,
        cycle: recipe.state().cycles,
        cycle_id: cycle.id.clone(),
        robot: cycle.robot.clone(),
        time_s: cycle.time_s,
        what,
        how_sure,
        since,
        look_at,
    }
}

/// Describes an alarm of a detector whose evidence reached its limit.
pub(crate) fn raised(recipe: &Recipe, metric: Metric, level: Level, cycle: &Cycle, settings: &Settings) -> Alarm {
    let state = recipe.state();
    let began = state.began[metric.index()];
    // Only cycles since the detector started. Those that the baseline was learnt from are not compared with it.
    let compared = usize::try_from(state.cycles.saturating_sub(began)).unwrap_or(usize::MAX);
    let place = state.robots.get(&cycle.robot).map(|robot| robot.place);
    let kept: Vec<(u64, &Symbols, u8)> = state
        .history
        .newest_first()
        .take(compared)
        .enumerate()
        .filter(|(_, symbols)| metric != Metric::Robot || Some(symbols.robot) == place)
        .filter_map(|(back, symbols)| Some((state.cycles.saturating_sub(back as u64), symbols, symbols.code(metric)?)))
        .collect();
    let found =
        recipe.factors[metric.index()].as_ref().and_then(|factors| start(recipe, metric, factors, &kept, settings));
    let since = found.and_then(|found| since(&found, &kept));
    let after = kept.get(..found.map_or(kept.len(), |f| f.likeliest + 1)).unwrap_or(&kept);
    let what = what(recipe, metric, after, &cycle.robot, settings);
    let promise = count(settings.promise(level).round_ties_even() as u64);
    let condition = match recipe.inflation(metric) {
        None => {
            "if each cycle is as likely to fail as in the baseline, independently of the cycles before it".to_owned()
        }
        Some(found) => {
            format!("but this is approximate here, because the guarantee needs independent cycles: {}", depends(found))
        }
    };
    let how_sure = format!(
        "The evidence reached its limit of {}. Without a change, the mean number of cycles until the first {} of any metric is at least {promise}, {condition}.",
        count(settings.limit(metric, level).round_ties_even() as u64),
        match level {
            Level::Warning => "warning",
            Level::Critical => "critical alarm",
        }
    );
    let mode = matches!(metric, Metric::Success | Metric::FailureModes | Metric::Robot)
        .then(|| grown_mode(recipe, after))
        .flatten();
    let first = since.map_or(began, |since| since.cycles_95[0]);
    let mut look_at = look_at(recipe, metric, &cycle.robot, settings, mode);
    if matches!(metric, Metric::Outside | Metric::Risk) {
        look_at.splice(0..0, outside(recipe, first));
    }
    let metric = metric.name(settings).into_owned();
    alarm(recipe, cycle, Happening::Raised, level, metric, what, how_sure, since, look_at)
}

/// How cycles depend on each other, in half a sentence.
pub(crate) fn depends(found: Inflation) -> String {
    format!(
        "sums of {} cycles vary {} times as much as those of independent cycles, and the evidence is divided accordingly",
        count(found.cycles),
        fixed(found.ratio, 1)
    )
}

/// Describes a cleared alarm of a detector: there was no further evidence.
pub(crate) fn cleared(
    recipe: &Recipe,
    metric: Metric,
    level: Level,
    cycle: &Cycle,
    settings: &Settings,
    stood: Standing,
) -> Alarm {
    let what = format!(
        "No further evidence for {} cycles: the alarm of cycle {} is cleared (the evidence reached its limit {} times).",
        count(settings.clear_after_cycles),
        stood.raised,
        stood.times
    );
    let how_sure = "A cleared alarm does not prove that the cause is gone.".to_owned();
    let metric = metric.name(settings).into_owned();
    alarm(recipe, cycle, Happening::Cleared, level, metric, what, how_sure, None, vec![])
}

/// The start of a change. The interval contains those that start from the bound and from the estimate of the baseline.
fn start(
    recipe: &Recipe,
    metric: Metric,
    factors: &Factors,
    kept: &[(u64, &Symbols, u8)],
    settings: &Settings,
) -> Option<ChangePoint> {
    let of = |factors: &Factors| change_point(factors, kept.iter().map(|(_, _, code)| *code));
    let found = of(factors)?;
    let estimated = recipe.baseline().estimated_factors(metric, &recipe.state().modes, settings);
    Some(estimated.as_ref().and_then(of).map_or(found, |other| found.extended(other)))
}

fn since(found: &ChangePoint, kept: &[(u64, &Symbols, u8)]) -> Option<Since> {
    let at = |back: usize| kept.get(back).map(|(cycle, symbols, _)| (*cycle, symbols.time_s));
    let (likeliest, earliest, latest) = (at(found.likeliest)?, at(found.earliest)?, at(found.latest)?);
    Some(Since {
        cycle: likeliest.0,
        time_s: likeliest.1,
        cycles_95: [earliest.0, latest.0],
        times_95_s: [earliest.1, latest.1],
        or_before: found.or_before,
    })
}

fn what(recipe: &Recipe, metric: Metric, after: &[(u64, &Symbols, u8)], robot: &str, settings: &Settings) -> String {
    let baseline = recipe.baseline();
    let before = |count: Option<crate::Count>, failures: bool| {
        let trials = count.and_then(crate::Count::trials).unwrap_or(Trials::NONE);
        let events = if failures { trials.failures() } else { trials.successes() };
        rate(Trials::new(events, trials.n()).unwrap_or(Trials::NONE))
    };
    // These cycles begin where the change probably did, which is where events are frequent: no interval around their share is valid.
    let share = |events: usize| format!("{events} ({})", percent(events as f64 / after.len().max(1) as f64));
    let events = || share(after.iter().filter(|(_, _, code)| *code == 1).count());
    let n = after.len();
    let chosen = "The last cycles were chosen because they fit a change best, so the lasting rate may be nearer to the baseline.";
    match metric {
        Metric::Success => {
            format!(
                "{} of the last {n} cycles failed; the baseline is {}. {chosen}",
                events(),
                before(baseline.success, true)
            )
        }
        Metric::Event(_) => {
            let event = settings.event(metric).unwrap_or_default();
            let before = before(baseline.events.get(event).copied(), false);
            format!(
                "The event `{event}` happened in {} of the last {n} cycles; the baseline is {before}. {chosen}",
                events()
            )
        }
        Metric::CycleTime | Metric::CycleTimeSpread => {
            let mut now: Vec<f64> = after.iter().map(|(_, symbols, _)| f64::from(symbols.cycle_time_s)).collect();
            let mut then = baseline.cycle_times_s.clone().unwrap_or_default();
            let [low, middle, high] = quartiles(&mut now);
            let [low_before, middle_before, high_before] = quartiles(&mut then);
            if metric == Metric::CycleTime {
                let change = if middle >= middle_before { "slower" } else { "faster" };
                format!(
                    "Successful cycles became {change}: median {middle:.3} s over the last {n}; the baseline is {middle_before:.3} s."
                )
            } else {
                format!(
                    "The spread of cycle times grew: the interquartile range is {:.3} s over the last {n}; the baseline is {:.3} s.",
                    high - low,
                    high_before - low_before
                )
            }
        }
        Metric::FailureModes => match grown_mode(recipe, after) {
            Some(mode) => {
                let now = after.iter().filter(|(_, symbols, _)| symbols.code(metric) == Some(mode)).count();
                let name = recipe.state().modes.name(mode);
                let counts = baseline.failure_modes.clone().unwrap_or_default();
                let then = Trials::new(counts.of(name), counts.total());
                format!(
                    "`{name}` is {} of the last {n} failures; the baseline is {}. {chosen}",
                    share(now),
                    rate(then.unwrap_or(Trials::NONE))
                )
            }
            None => "The mix of failure modes changed.".to_owned(),
        },
        Metric::Robot => {
            let before = before(baseline.success, true);
            format!("Robot {robot}: {} of its last {n} cycles failed; the baseline is {before}. {chosen}", events())
        }
        Metric::Outside => format!(
            "{} of the last {n} cycles lie outside the validated region; at most {} are accepted.",
            events(),
            percent(settings.outside_share)
        ),
        Metric::Risk => {
            let expected =
                after.iter().map(|(_, _, step)| crate::factors::risk_of(*step)).sum::<f64>() / n.max(1) as f64;
            format!(
                "The risk model predicts {} failures for the parameters of the last {n} cycles; the baseline is {}.",
                percent(expected),
                before(baseline.success, true)
            )
        }
    }
}

/// The quartiles as order statistics. Zeros without values.
fn quartiles(values: &mut [f64]) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [1, 2, 3].map(|q| values.get((q * values.len() / 4).min(values.len().saturating_sub(1))).copied().unwrap_or(0.0))
}

/// The code of the failure mode whose share grew most. `None` without failures or without a known mix.
fn grown_mode(recipe: &Recipe, after: &[(u64, &Symbols, u8)]) -> Option<u8> {
    let counts = recipe.baseline().failure_modes.as_ref()?;
    let known = &recipe.state().modes;
    let n = counts.total().max(1) as f64;
    let modes: Vec<u8> = after.iter().filter_map(|(_, symbols, _)| symbols.code(Metric::FailureModes)).collect();
    let growth = |mode: &u8| {
        let now = modes.iter().filter(|m| *m == mode).count() as f64 / modes.len().max(1) as f64;
        now - counts.of(known.name(*mode)) as f64 / n
    };
    (0..known.len() as u8).max_by(|a, b| growth(a).total_cmp(&growth(b))).filter(|_| !modes.is_empty())
}

/// The parameters that lay outside the validated region since a cycle, as text.
fn outside(recipe: &Recipe, from: u64) -> Vec<String> {
    let lately = recipe.outside().filter(|(_, tally)| tally.cycles > 0 && tally.last >= from);
    lately
        .map(|(parameter, tally)| {
            let Some((name, validated)) = parameter else {
                return format!("combinations of parameters outside the validated region, in {} cycles", tally.cycles);
            };
            let seen = match (tally.numbers, &tally.word) {
                (Some([low, high]), _) if low < high => format!("{} to {}", number(low), number(high)),
                (Some([low, _]), _) => number(low),
                (None, word) => format!("`{}`", word.as_deref().unwrap_or_default()),
            };
            let good = match validated {
                Validated::Range([low, high]) => format!("from {} to {}", number(*low), number(*high)),
                Validated::Words(words) => format!("for {}", words.join(", ")),
            };
            format!("{name}: {seen} in {} cycles; validated {good}", tally.cycles)
        })
        .collect()
}

/// Likely causes: first a robot that differs from its peers, then the usual causes of such a change.
fn look_at(recipe: &Recipe, metric: Metric, robot: &str, settings: &Settings, mode: Option<u8>) -> Vec<String> {
    let mut all = Vec::new();
    let (names, tallies): (Vec<&str>, Vec<Trials>) =
        recipe.robots().filter_map(|(name, t)| Some((name, Trials::new(t.successes, t.cycles).ok()?))).unzip();
    let worse: Vec<Outlier> =
        outliers(&tallies, 1.0 - settings.baseline_confidence).into_iter().filter(|outlier| outlier.worse).collect();
    if matches!(metric, Metric::Success | Metric::FailureModes) {
        all.extend(worse.iter().map(|outlier| {
            format!(
                "robot {}: {} of {} cycles succeeded, significantly fewer than its peers",
                names[outlier.index],
                outlier.trials.successes(),
                outlier.trials.n()
            )
        }));
    }
    if let Some(mode) = mode {
        all.push(match recipe.state().modes.name(mode) {
            OTHER_MODE => "failures with an unlisted mode increased: see the robot's log".to_owned(),
            mode => format!("failures with the mode `{mode}` increased: see the last cycles with this mode"),
        });
    }
    let usual = match metric {
        Metric::Success => "changes in the cell since then: parts, gripper, lighting, software",
        Metric::Event(event) => {
            let causes = settings.events.values().nth(usize::from(event)).and_then(|event| event.causes.as_deref());
            causes.unwrap_or("the last cycles with this event")
        }
        Metric::CycleTime => "speed override, retries, joint friction, network or camera delays",
        Metric::CycleTimeSpread => "retries, intermittent delays, different parts under one recipe",
        Metric::FailureModes => "changes in the cell since then, even if the success rate is unchanged",
        Metric::Robot if !worse.iter().any(|outlier| names[outlier.index] == robot) => {
            "its peers do not do significantly better: first what all robots share (parts, lighting, software), then its gripper, calibration and load"
        }
        Metric::Robot => {
            "this robot: its gripper, calibration and load; the other robots have the same parts and software"
        }
        Metric::Outside => "parts, fixtures or lighting that the gate did not evaluate: validate or exclude them",
        Metric::Risk => "harder parts or conditions than those of the gate, even if the success rate is unchanged",
    };
    all.push(usual.to_owned());
    all
}
