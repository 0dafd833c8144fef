//! The live view of a campaign on stderr, driven by its events: counts, rate, time left and the last failures.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use robogate_campaign::{Event, OutcomeCounts, Stage};
use robogate_core::{FailureMode, Outcome};

use crate::summary::outcomes_in_one_line;
use crate::terminal::{self, Screen, foreign, grouped};
use robogate_session::duration::in_words;

/// Number of failures in the live view.
pub(crate) const LAST_FAILURES: usize = 3;
/// Longest line about a failure, in characters. The text of a fault comes from another program.
const LONGEST: usize = 400;
/// The shortest and the longest bar, in columns.
const BAR: [usize; 2] = [8, 40];
/// Columns beside the bar: stage, counts, rate and time left.
const BESIDE_BAR: usize = 60;
/// Columns of the name of a stage, with the space after it.
pub(crate) const LEFT: usize = 9;

/// Listens to a campaign and shows its progress. Without a terminal, it prints a line for each tenth of a stage.
pub(crate) struct Progress {
    screen: Screen,
    live: Option<Live>,
}

/// The view of a running stage.
struct Live {
    stage: &'static str,
    episodes: u64,
    counts: OutcomeCounts,
    /// Episodes that earlier processes recorded.
    before: u64,
    begun: Instant,
    bar: ProgressBar,
    /// Lines below the bar.
    below: Vec<ProgressBar>,
    /// The last failures, newest first.
    failures: VecDeque<String>,
}

impl Progress {
    /// Creates a listener that has shown nothing yet.
    pub(crate) fn new() -> Self {
        Self { screen: Screen::open(), live: None }
    }

    /// Handles an event.
    pub(crate) fn hear(&mut self, event: &Event) {
        match event {
            Event::Started { already_done, episodes, .. } if *already_done > 0 => {
                terminal::note(format_args!(
                    "{} of {} episodes are recorded already",
                    grouped(*already_done),
                    grouped(*episodes)
                ));
            }
            // A stage that is complete already has no progress.
            Event::StageStarted { episodes, already_done, .. } if already_done.total() == *episodes => {}
            Event::StageStarted { stage, episodes, already_done } => {
                self.live = Some(Live::new(&self.screen, name(*stage), *episodes, already_done));
            }
            Event::Episode { index, outcome, fault, time_s, .. } => {
                if let Some(live) = &mut self.live {
                    live.count(outcome);
                    if outcome != "success" {
                        live.failed(*index, outcome, fault.as_deref(), *time_s);
                    }
                }
            }
            Event::StageFinished { outcomes, .. } => {
                if let Some(live) = self.live.take() {
                    live.end(outcomes);
                }
            }
            Event::Interrupted { .. } => {
                if let Some(live) = self.live.take() {
                    let counts = live.counts.clone();
                    live.end(&counts);
                }
            }
            Event::Warning { message, .. } => terminal::warning(message),
            Event::Started { .. } | Event::BoundaryFound { .. } | Event::Finished { .. } => {}
        }
    }
}

impl Drop for Live {
    /// A run that ends with an error leaves no half-drawn bar.
    fn drop(&mut self) {
        self.clear();
    }
}

impl Live {
    fn new(screen: &Screen, stage: &'static str, episodes: u64, already_done: &OutcomeCounts) -> Self {
        let bars = screen.bars();
        let bar = bars.add(ProgressBar::new(episodes));
        let wide = bar_columns(screen);
        bar.set_style(style(&format!(
            "{stage:<LEFT$}{{bar:{wide}}} {{human_pos}}/{{human_len}} {{per_sec:>9}}, {{eta}} left"
        )));
        let below: Vec<ProgressBar> = (0..=LAST_FAILURES).map(|_| bars.add(ProgressBar::new(0))).collect();
        below.iter().for_each(|line| line.set_style(style(&format!("{:LEFT$}{{wide_msg}}", ""))));
        bar.set_position(already_done.total());
        bar.reset_eta();
        let live = Self {
            stage,
            episodes,
            counts: already_done.clone(),
            before: already_done.total(),
            begun: Instant::now(),
            bar,
            below,
            failures: VecDeque::new(),
        };
        live.say();
        live
    }

    fn count(&mut self, outcome: &str) {
        self.counts.add(&outcome_of(outcome));
        self.bar.inc(1);
        // The bar limits how often it is drawn. Formatting the counts costs time too, so they are updated every few
        // episodes.
        if self.counts.total().is_multiple_of(8) || self.episodes < 200 {
            self.say();
        }
        if self.bar.is_hidden() {
            self.log();
        }
    }

    /// Shows a failed or invalid episode with its cause.
    fn failed(&mut self, index: u64, outcome: &str, fault: Option<&str>, time_s: f64) {
        if self.bar.is_hidden() {
            return;
        }
        let cause =
            fault.map_or_else(|| format!("at {time_s:.2} s"), |fault| foreign(fault.lines().next().unwrap_or("")));
        let line: String = format!("#{index} {} {cause}", foreign(outcome)).chars().take(LONGEST).collect();
        self.failures.push_front(line);
        self.failures.truncate(LAST_FAILURES);
        let lines = self.below.iter().skip(1).zip(&self.failures);
        lines.for_each(|(line, text)| line.set_message(text.clone()));
    }

    /// Without a terminal (CI, a log file): prints a line for each tenth of a stage.
    fn log(&self) {
        let (done, all) = (self.counts.total(), self.episodes);
        if done * 10 / all.max(1) > (done - 1) * 10 / all.max(1) {
            let (done, all) = (grouped(done), grouped(all));
            terminal::note(format_args!("{:<LEFT$}{done}/{all}  {}", self.stage, outcomes_in_one_line(&self.counts)));
        }
    }

    fn say(&self) {
        if let Some(line) = self.below.first() {
            line.set_message(outcomes_in_one_line(&self.counts));
        }
    }

    /// Removes the view.
    fn clear(&self) {
        self.below.iter().for_each(ProgressBar::finish_and_clear);
        self.bar.finish_and_clear();
    }

    /// Replaces the view by its last figures.
    fn end(self, counts: &OutcomeCounts) {
        self.clear();
        if self.bar.is_hidden() {
            return;
        }
        let here = counts.total().saturating_sub(self.before);
        let passed = self.begun.elapsed();
        let rate = here as f64 / passed.as_secs_f64().max(1e-3);
        let done = if counts.total() == self.episodes {
            grouped(counts.total())
        } else {
            format!("{} of {}", grouped(counts.total()), grouped(self.episodes))
        };
        terminal::note(format_args!("{:<LEFT$}{done} episodes in {}, {rate:.1}/s", self.stage, seconds(passed)));
        terminal::note(format_args!("{:LEFT$}{}", "", outcomes_in_one_line(counts)));
    }
}

/// The length of a bar.
pub(crate) fn bar_columns(screen: &Screen) -> usize {
    screen.columns().saturating_sub(BESIDE_BAR).clamp(BAR[0], BAR[1])
}

/// A duration to a second.
pub(crate) fn seconds(of: Duration) -> String {
    in_words(Duration::from_secs(of.as_secs_f64().round() as u64))
}

/// The name of a stage.
fn name(stage: Stage) -> &'static str {
    match stage {
        Stage::Uniform => "uniform",
        Stage::Boundary => "boundary",
        Stage::Active => "active",
        Stage::Suite => "suite",
    }
}

/// Parses the name of an outcome. Only the kind matters here, because the view counts kinds.
fn outcome_of(name: &str) -> Outcome {
    match name {
        "success" => Outcome::Success,
        "invalid" => Outcome::Invalid(robogate_core::Fault::new(robogate_core::FaultKind::Unavailable, "")),
        mode => Outcome::Failure(FailureMode::from_foreign(mode)),
    }
}

/// The style of a bar.
pub(crate) fn style(template: &str) -> ProgressStyle {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    style.progress_chars("█▉▊▋▌▍▎▏ ").with_key(
        "per_sec",
        |state: &indicatif::ProgressState, out: &mut dyn std::fmt::Write| {
            // A bar that cannot be formatted must not stop the campaign.
            let _ = write!(out, "{:.1}/s", state.per_sec());
        },
    )
}
