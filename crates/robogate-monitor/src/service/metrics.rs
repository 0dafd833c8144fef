//! `/metrics` in the text format of Prometheus, version 0.0.4.

use std::fmt::Write;

use super::intake::Intake;
use crate::{Level, Recipe};

/// Escapes the value of a label.
fn label(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

/// Writes one metric for all recipes.
fn family(
    text: &mut String,
    intake: &Intake,
    (name, kind, help): (&str, &str, &str),
    mut samples: impl FnMut(&Recipe, &mut dyn FnMut(&str, f64)),
) {
    let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
    for (recipe, state) in intake.monitor().recipes() {
        let recipe = label(recipe);
        samples(state, &mut |labels, value| {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{name}{{recipe=\"{recipe}\"{labels}}} {value}");
        });
    }
}

pub(super) fn metrics(intake: &Intake) -> String {
    let mut text = String::new();
    let totals = intake.totals();
    for (outcome, n) in [("accepted", totals.accepted), ("duplicate", totals.duplicates), ("refused", totals.refused)] {
        if outcome == "accepted" {
            text += "# HELP robogate_monitor_intake_total Cycles that arrived since the start, by result.\n\
                     # TYPE robogate_monitor_intake_total counter\n";
        }
        let _ = writeln!(text, "robogate_monitor_intake_total{{outcome=\"{outcome}\"}} {n}");
    }
    for (name, n, help) in [
        ("out_of_order", totals.out_of_order, "Accepted cycles before the newest of their robot."),
        ("late", totals.late, "Out-of-order cycles beyond `late_after_s`."),
        ("outside", totals.outside, "Accepted cycles outside the validated region."),
    ] {
        let _ = writeln!(
            text,
            "# HELP robogate_monitor_{name}_total {help}\n# TYPE robogate_monitor_{name}_total counter\n\
             robogate_monitor_{name}_total {n}"
        );
    }
    if let Some((tally, suppressed)) = intake.warnings().map(super::warnings::Warnings::counts) {
        text += "# HELP robogate_monitor_episodes_total Watched episodes, by end and warning.\n\
                 # TYPE robogate_monitor_episodes_total counter\n";
        let mut tally = *tally;
        let suspended = u8::from(tally.suspended);
        for (name, count) in tally.counts_mut() {
            let _ = writeln!(text, "robogate_monitor_episodes_total{{outcome=\"{name}\"}} {count}");
        }
        let _ = writeln!(
            text,
            "# HELP robogate_monitor_warnings_suppressed_total Warnings that were not sent, because the recipe had an alarm.\n\
             # TYPE robogate_monitor_warnings_suppressed_total counter\n\
             robogate_monitor_warnings_suppressed_total {suppressed}\n\
             # HELP robogate_monitor_warnings_suspended 1 if more successes were warned than promised.\n\
             # TYPE robogate_monitor_warnings_suspended gauge\n\
             robogate_monitor_warnings_suspended {suspended}"
        );
    }
    let settings = intake.monitor().settings();
    family(&mut text, intake, ("robogate_monitor_cycles_total", "counter", "Cycles of the recipe."), |recipe, say| {
        say("", recipe.trials().n() as f64)
    });
    family(
        &mut text,
        intake,
        ("robogate_monitor_successes_total", "counter", "Successful cycles of the recipe."),
        |recipe, say| say("", recipe.trials().successes() as f64),
    );
    family(
        &mut text,
        intake,
        ("robogate_monitor_window_success_ratio", "gauge", "Success rate in the paper's moving window."),
        |recipe, say| {
            if let Some(rate) = recipe.window().rate() {
                say("", rate);
            }
        },
    );
    family(
        &mut text,
        intake,
        ("robogate_monitor_baseline_success_ratio", "gauge", "Success rate of the baseline."),
        |recipe, say| {
            if let Some(rate) = recipe.baseline().success_rate() {
                say("", rate);
            }
        },
    );
    family(
        &mut text,
        intake,
        (
            "robogate_monitor_outside_cycles",
            "gauge",
            "Cycles since the detectors started in which the parameter lay outside the validated region.",
        ),
        |recipe, say| {
            for (parameter, tally) in recipe.outside() {
                let name = parameter.map_or("combination", |(name, _)| name);
                say(&format!(",parameter=\"{}\"", label(name)), tally.cycles as f64);
            }
        },
    );
    family(&mut text, intake, ("robogate_monitor_alarms_total", "counter", "Alarms raised."), |recipe, say| {
        say("", recipe.raised() as f64)
    });
    family(
        &mut text,
        intake,
        (
            "robogate_monitor_evidence_ratio",
            "gauge",
            "Evidence of a detector as a share of its limit. An alarm is raised at 1, and the evidence restarts.",
        ),
        |recipe, say| {
            for view in recipe.detectors(settings) {
                for (level, (evidence, limit)) in Level::ALL.into_iter().zip(view.levels.into_iter().flatten()) {
                    let labels = format!(",metric=\"{}\",level=\"{}\"", label(&view.name), level.as_str());
                    say(&labels, evidence / limit);
                }
            }
        },
    );
    family(
        &mut text,
        intake,
        ("robogate_monitor_paper_rule", "gauge", "1 while the paper's rule holds. Its false-alarm rate has no bound."),
        |recipe, say| {
            for level in Level::ALL {
                let labels = format!(",level=\"{}\"", level.as_str());
                say(&labels, f64::from(u8::from(recipe.paper_level() >= Some(level))));
            }
        },
    );
    family(
        &mut text,
        intake,
        ("robogate_monitor_alarm_standing", "gauge", "1 while an alarm is active."),
        |recipe, say| {
            for view in recipe.detectors(settings) {
                for level in Level::ALL {
                    let labels = format!(",metric=\"{}\",level=\"{}\"", label(&view.name), level.as_str());
                    say(&labels, f64::from(u8::from(view.standing[level as usize].is_some())));
                }
            }
        },
    );
    for level in Level::ALL {
        let promise = settings.promise(level);
        if level == Level::Warning {
            text += "# HELP robogate_monitor_promised_cycles Lower bound of the mean number of cycles to a false alarm.\n\
                     # TYPE robogate_monitor_promised_cycles gauge\n";
        }
        let _ = writeln!(text, "robogate_monitor_promised_cycles{{level=\"{}\"}} {promise}", level.as_str());
    }
    text
}
