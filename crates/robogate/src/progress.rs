//! A progress bar driven by the events of a campaign.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use robogate_campaign::{Event, OutcomeCounts, Stage};
use robogate_core::{FailureMode, Outcome};

use crate::summary::outcomes_in_one_line;
use crate::terminal;

/// Listens to a campaign and shows its progress.
pub(crate) struct Progress {
    bar: ProgressBar,
    counts: OutcomeCounts,
}

impl Progress {
    /// Creates a listener that has shown nothing yet.
    pub(crate) fn new() -> Self {
        Self { bar: ProgressBar::hidden(), counts: OutcomeCounts::default() }
    }

    /// Handles an event.
    pub(crate) fn hear(&mut self, event: &Event) {
        match event {
            Event::Started { already_done, episodes, .. } if *already_done > 0 => {
                let (done, all) = (terminal::grouped(*already_done), terminal::grouped(*episodes));
                terminal::note(format_args!("{done} of {all} episodes are recorded already"));
            }
            Event::StageStarted { stage, episodes, already_done } => {
                self.counts = already_done.clone();
                self.bar = ProgressBar::with_draw_target(Some(*episodes), ProgressDrawTarget::stderr());
                self.bar.set_style(style(RUNNING));
                self.bar.set_prefix(match stage {
                    Stage::Uniform => "uniform ",
                    Stage::Boundary => "boundary",
                    Stage::Active => "active  ",
                    Stage::Suite => "suite   ",
                });
                self.bar.set_position(already_done.total());
                self.bar.reset_eta();
                self.say();
            }
            Event::Episode { outcome, .. } => {
                self.counts.add(&outcome_of(outcome));
                self.bar.inc(1);
                // The bar limits how often it is drawn. Formatting its message costs time too, so it is updated every
                // few episodes.
                if self.counts.total().is_multiple_of(8) {
                    self.say();
                }
                if self.bar.is_hidden() {
                    self.log();
                }
            }
            Event::StageFinished { .. } | Event::Interrupted { .. } => {
                self.say();
                // A stopped bar would show a remaining time of 0 s.
                self.bar.set_style(style("{prefix} {bar:32} {human_pos}/{human_len}\n         {wide_msg}"));
                self.bar.abandon();
            }
            // The bar leaves the cursor at the end of its line.
            Event::Finished { already: false, .. } if !self.bar.is_hidden() => terminal::note(""),
            Event::Warning { message, .. } => self.bar.suspend(|| terminal::note(format_args!("warning: {message}"))),
            Event::Started { .. } | Event::BoundaryFound { .. } | Event::Finished { .. } => {}
        }
    }

    /// Without a terminal (CI, a log file): prints a line for each tenth of a stage.
    fn log(&self) {
        let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0));
        if done * 10 / all.max(1) > (done - 1) * 10 / all.max(1) {
            let (prefix, done, all) = (self.bar.prefix(), terminal::grouped(done), terminal::grouped(all));
            terminal::note(format_args!("{prefix} {done}/{all}  {}", outcomes_in_one_line(&self.counts)));
        }
    }

    fn say(&self) {
        self.bar.set_message(outcomes_in_one_line(&self.counts));
    }
}

/// Parses the name of an outcome. Only the kind matters here, because the bar counts kinds.
fn outcome_of(name: &str) -> Outcome {
    match name {
        "success" => Outcome::Success,
        "invalid" => Outcome::Invalid(robogate_core::Fault::new(robogate_core::FaultKind::Unavailable, "")),
        mode => Outcome::Failure(FailureMode::from_foreign(mode)),
    }
}

/// The bar of a running stage.
const RUNNING: &str = "{prefix} {bar:32} {human_pos}/{human_len} {per_sec:>8}, {eta} left\n         {wide_msg}";

fn style(template: &str) -> ProgressStyle {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    style.progress_chars("█▉▊▋▌▍▎▏ ").with_key(
        "per_sec",
        |state: &indicatif::ProgressState, out: &mut dyn std::fmt::Write| {
            // A bar that cannot be formatted must not stop the campaign.
            let _ = write!(out, "{:.1}/s", state.per_sec());
        },
    )
}
