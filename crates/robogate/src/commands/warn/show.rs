//! What a detector sees, for the terminal and as JSON.

use robogate_monitor::warn::{
    Calibration, Detector, EARLY_S, FalseWarnings, ModeView, Model, Scored, Track, View, WarnFile, Warner,
    random_early, seconds, view,
};
use robogate_stats::boosting::Boosting;
use robogate_stats::format::{count, counted, fixed, number, percent};
use serde_json::{Value, json};

use super::train::baseline_scores;
use crate::exit::{DONE, Exit, FAIL, INCONCLUSIVE, OrExit};
use crate::terminal::{bold, foreign, line, wrapped};

/// Failures of a mode below which nothing is said about what cannot be seen.
const FEWEST: usize = 10;

/// Whether the promise holds on other episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// The upper bound of the share is at most the promised one.
    Holds,
    /// The lower bound is above it.
    Broken,
    /// Neither.
    Unknown,
}

impl Verdict {
    pub(super) fn of(found: &FalseWarnings, promised: f64) -> Self {
        match (found.upper_bound <= promised, found.lower_bound > promised) {
            (true, _) => Self::Holds,
            (_, true) => Self::Broken,
            _ => Self::Unknown,
        }
    }

    fn as_str(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::Broken => "broken",
            Self::Unknown => "unknown",
        }
    }

    pub(super) fn exit_code(self) -> u8 {
        match self {
            Self::Holds => DONE,
            Self::Broken => FAIL,
            Self::Unknown => INCONCLUSIVE,
        }
    }
}

/// What the detector and the baselines see.
pub(super) struct Views {
    detector: View,
    clock: View,
    scenario: Option<View>,
    random_early: Option<f64>,
    successes: usize,
    failures: usize,
    /// The share warned at least 0.5 s before by the detector in time, and not by the clock, in timeouts: the lead over it.
    over_clock_s: Vec<(String, f64)>,
}

impl Views {
    pub(super) fn of(file: &WarnFile, tracks: &[&Track], scored: &[Scored], risk: Option<&Boosting>) -> Self {
        let seconds = seconds(scored);
        let (clock, scenario) = baseline_scores(tracks, scored, risk);
        let detector = view(scored, file.calibration.threshold, &seconds);
        let failures = scored.iter().filter(|of| of.failure.is_some()).count();
        let share = detector.false_warnings.warned as f64 / detector.false_warnings.of.max(1) as f64;
        // How much earlier than the clock each mode is warned, where both warn.
        let over = |mode: &ModeView| {
            let name = mode.mode.clone()?;
            let mut gained: Vec<f64> = scored
                .iter()
                .zip(&clock)
                .filter(|(of, _)| of.failure.as_ref() == Some(&name))
                .filter_map(|(of, clock)| {
                    Some(of.lead_s(file.calibration.threshold)? - clock.lead_s(file.baselines.clock)?)
                })
                .collect();
            gained.sort_by(f64::total_cmp);
            Some((name, *gained.get(gained.len() / 2)?))
        };
        Self {
            clock: view(&clock, file.baselines.clock, &seconds),
            scenario: scenario
                .zip(file.baselines.scenario)
                .map(|(scored, threshold)| view(&scored, threshold, &seconds)),
            random_early: random_early(scored, share),
            successes: scored.len() - failures,
            failures,
            over_clock_s: detector.modes.iter().filter_map(over).collect(),
            detector,
        }
    }

    fn rows(&self) -> Vec<(&'static str, &View)> {
        let mut rows = vec![("detector", &self.detector), ("clock", &self.clock)];
        rows.extend(self.scenario.as_ref().map(|view| ("scenario risk", view)));
        rows
    }
}

/// The output of `train` and `check`.
pub(super) struct Shown<'a> {
    pub(super) file: &'a WarnFile,
    /// The detector of the file.
    pub(super) detector: &'a Detector,
    pub(super) views: &'a Views,
    /// The episodes that fitted the model.
    pub(super) fitted: Option<&'a [&'a Track]>,
    pub(super) check: Option<Verdict>,
    pub(super) differences: &'a [String],
}

impl Shown<'_> {
    pub(super) fn print(&self, json: bool) -> Result<(), Exit> {
        if json {
            line(serde_json::to_string_pretty(&self.document()).or_broken()?);
        } else {
            self.text();
        }
        Ok(())
    }

    fn document(&self) -> Value {
        let Self { file, detector, views, check, differences, .. } = self;
        json!({
            "format": 1,
            "calibration": file.calibration,
            "conditions": file.conditions,
            "verdict": check.map(Verdict::as_str),
            "differences": differences,
            "successes": views.successes,
            "failures": views.failures,
            "detector": views.detector,
            "clock": views.clock,
            "scenario_risk": views.scenario,
            "random_early": views.random_early,
            "lead_over_clock_s": views.over_clock_s.iter().map(|(mode, s)| json!({"mode": mode, "median_s": s})).collect::<Vec<_>>(),
            "bytes": Warner::new(*detector, 0.0).bytes(),
        })
    }

    fn text(&self) {
        let Self { file, detector, .. } = self;
        let Calibration { successes, rank, promised, .. } = file.calibration;
        if let Some(fitted) = self.fitted {
            let failures = fitted.iter().filter(|track| track.failure.is_some()).count();
            line(format_args!(
                "{} on {}, from {} successes and {}",
                match detector.model {
                    Model::Trees(_) => "Boosted trees",
                    Model::Distance(_) => "Distance to successes",
                },
                counted(detector.features.names().len() as u64, "signal"),
                count((fitted.len() - failures) as u64),
                counted(failures as u64, "failure"),
            ));
        }
        line(bold(format_args!(
            "Promise: at most {} of successful episodes are warned, with 95 % confidence",
            percent(promised)
        )));
        line(format_args!(
            "  threshold: the {} smallest of the highest scores of {} independent successes",
            ordinal(rank),
            count(successes)
        ));
        let of = &file.conditions;
        line("  it holds for new episodes of the same kind only:");
        for (what, text) in [
            ("task", &of.task),
            ("engine", &of.engine),
            ("robot", &of.robot),
            ("policy", &of.policy),
            ("scenarios", &of.population),
        ] {
            line(format_args!("    {what:<10} {}", foreign(text)));
        }
        self.verdict();
        line("");
        self.running();
        self.modes();
    }

    fn verdict(&self) {
        let found = &self.views.detector.false_warnings;
        let Some(verdict) = self.check else {
            line(format_args!(
                "\nThe other episodes: {} successes and {}. They gave the threshold, so only another run measures the promise:\nrobogate warn check FILE DIR",
                count(self.views.successes as u64),
                counted(self.views.failures as u64, "failure")
            ));
            return;
        };
        line("");
        let share = found.warned as f64 / found.of.max(1) as f64;
        line(bold(format_args!(
            "{}: {} of {} independent successes warned ({}, 95 % bounds {} and {})",
            match verdict {
                Verdict::Holds => "The promise holds here",
                Verdict::Broken => "The promise does NOT hold here",
                Verdict::Unknown => "Undecided whether the promise holds here",
            },
            count(found.warned),
            count(found.of),
            percent(share),
            percent(found.lower_bound),
            percent(found.upper_bound)
        )));
        for difference in self.differences {
            line(format_args!("  another {}", foreign(difference)));
        }
        if verdict == Verdict::Broken {
            line("  `--out FILE` calibrates the detector again with this run");
        }
    }

    fn running(&self) {
        let rows = self.views.rows();
        if self.views.failures == 0 {
            line("No failures, so nothing is known about how early they are warned.");
            return;
        }
        let times = &self.views.detector.running;
        line(bold("AUROC among the episodes that still run"));
        let head: Vec<String> = times.iter().map(|of| format!("{:>8}", format!("{} s", number(of.at_s)))).collect();
        line(format_args!("  {:<16}{}", "after", head.concat()));
        // All running episodes have the same age, so the clock says nothing.
        for (name, view) in rows.iter().filter(|(name, _)| *name != "clock") {
            let cells: Vec<String> = view.running.iter().map(|of| format!("{:>8}", auroc(of.auroc))).collect();
            line(format_args!("  {name:<16}{}", cells.concat()));
        }
        let failures: Vec<String> = times.iter().map(|of| format!("{:>8}", of.failures)).collect();
        line(format_args!("  {:<16}{}", "failures", failures.concat()));
        line("");
    }

    fn modes(&self) {
        let views = self.views;
        if views.failures == 0 {
            return;
        }
        line(bold(format_args!(
            "{:<34}{:>8}{:>8}{:>8}{:>9}   AUROC at the same age, before the event",
            "Warned before the event", "0.5 s", "at all", "<0.25 s", "median"
        )));
        line(format_args!("{:<67}  {:>8}{:>8}{:>8}", "", "0.25 s", "0.5 s", "1 s"));
        for (at, mode) in views.detector.modes.iter().enumerate() {
            let name = mode.mode.as_deref().unwrap_or("all failures");
            line(format_args!("{} ({})", foreign(name), count(mode.failures as u64)));
            for (row, view) in views.rows() {
                // The order of the modes does not depend on the scores.
                let Some(of) = view.modes.get(at) else { continue };
                let matched: Vec<String> = of.matched.iter().map(|of| format!("{:>8}", auroc(of.auroc))).collect();
                line(format_args!(
                    "  {row:<32}{:>8}{:>8}{:>8}{:>9}  {}",
                    percent(of.early),
                    percent(of.warned),
                    percent(of.detected),
                    of.median_lead_s.map_or_else(|| "-".to_owned(), |s| format!("{} s", fixed(s, 2))),
                    matched.concat()
                ));
            }
            if let (None, Some(random)) = (&mode.mode, views.random_early) {
                line(format_args!("  {:<32}{:>8}", "random, as many successes warned", percent(random)));
            }
        }
        line("");
        for mode in &views.detector.modes {
            let Some(name) = &mode.mode else { continue };
            let name = foreign(name);
            match mode.is_hidden() {
                Some(true) => wrapped(&format!(
                    "{name}: its {} do not show that it can be seen in advance. {} s before the event their scores do not differ \
                     significantly from those of successes of the same age.",
                    counted(mode.failures as u64, "failure"),
                    number(EARLY_S)
                )),
                None if mode.failures < FEWEST => {
                    wrapped(&format!(
                        "{name}: too few failures ({}) to say what can be seen in advance.",
                        mode.failures
                    ));
                }
                None => wrapped(&format!(
                    "{name}: no comparison at the same age, because too few successes run that long: only the clock matters. {}",
                    self.over_clock(mode)
                )),
                Some(false) => {}
            }
        }
    }

    /// The lead over the clock of one mode.
    fn over_clock(&self, mode: &ModeView) -> String {
        let found = self.views.over_clock_s.iter().find(|(name, _)| Some(name) == mode.mode.as_ref());
        found.map_or_else(String::new, |(_, s)| {
            let side = if *s < 0.0 { "after" } else { "before" };
            format!("The detector warns {} s {side} the clock (median).", fixed(s.abs(), 2))
        })
    }
}

fn auroc(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |x| fixed(x, 2))
}

fn ordinal(n: u64) -> String {
    let ending = match (n % 10, n % 100) {
        (1, x) if x != 11 => "st",
        (2, x) if x != 12 => "nd",
        (3, x) if x != 13 => "rd",
        _ => "th",
    };
    format!("{}{ending}", count(n))
}
