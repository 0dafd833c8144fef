//! The live view of `robogate transfer` on stderr: counts of the simulation and of the trials, the last failed trials, and the fit
//! of the model with its rate and the time left.

use std::time::Instant;

use indicatif::ProgressBar;
use robogate_analysis::transfer::{RealTrial, TransferStep};

use crate::progress::{LAST_FAILURES, LEFT, bar_columns, seconds, style};
use crate::terminal::{self, Screen, foreign, grouped, percent};

/// Listens to a transfer. Without a terminal, it prints a line for each step.
pub(crate) struct TransferView {
    screen: Screen,
    /// The start of the present step.
    begun: Instant,
    /// The bar of the fit, and the lines below it.
    live: Option<(ProgressBar, Vec<ProgressBar>)>,
    fits: u32,
    /// The last failed trials, newest first.
    failures: Vec<String>,
}

impl TransferView {
    /// Creates a view, and shows that the simulation is being read.
    pub(crate) fn new() -> Self {
        let screen = Screen::open();
        let reading = screen.bars().add(ProgressBar::new_spinner());
        reading.set_style(style(&format!("{:<LEFT$}{{spinner}} reading the episodes, {{elapsed}}", "sim")));
        reading.tick();
        Self { screen, begun: Instant::now(), live: Some((reading, Vec::new())), fits: 0, failures: Vec::new() }
    }

    /// Handles a step.
    pub(crate) fn hear(&mut self, step: TransferStep<'_>) {
        match step {
            TransferStep::Simulated { episodes, endings } => {
                self.clear();
                let took = self.begun.elapsed();
                let rate = episodes as f64 / took.as_secs_f64().max(1e-3);
                let took = seconds(took);
                say("sim", format_args!("{} valid episodes in {took}, {}/s", grouped(episodes), grouped(rate as u64)));
                let success = endings.first().map_or(0, |(_, count)| *count);
                let others = endings.iter().skip(1).map(|(mode, count)| (*mode, *count));
                say("", counts(success, episodes, others));
            }
            TransferStep::Trials(trials) => self.trials(trials),
            TransferStep::Fitted { done: 0, all } => self.begin(all),
            TransferStep::Fitted { done, .. } => {
                self.fits = done;
                if let Some((bar, _)) = &self.live {
                    bar.set_position(done.into());
                }
            }
        }
    }

    /// Replaces the view by the last figures of the fit.
    pub(crate) fn end(mut self) {
        self.clear();
        if self.fits > 0 {
            say("model", format_args!("{} fits in {}", self.fits, seconds(self.begun.elapsed())));
        }
    }

    fn trials(&mut self, trials: &[RealTrial]) {
        let failed = trials.iter().filter(|trial| !trial.success);
        let mode = |trial: &RealTrial| trial.mode.clone().unwrap_or_else(|| "failure".to_owned());
        let mut modes: Vec<(String, u64)> = Vec::new();
        for trial in failed.clone() {
            let name = mode(trial);
            match modes.iter_mut().find(|(known, _)| *known == name) {
                Some((_, count)) => *count += 1,
                None => modes.push((name, 1)),
            }
        }
        modes.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        let n = trials.len() as u64;
        say("trials", format_args!("{} of the real robot", grouped(n)));
        let lost: u64 = modes.iter().map(|(_, count)| count).sum();
        say("", counts(n - lost, n, modes.iter().map(|(mode, count)| (mode.as_str(), *count))));
        let last = failed.rev().take(LAST_FAILURES);
        self.failures = last.map(|trial| format!("line {} {}", trial.line, foreign(mode(trial)))).collect();
    }

    /// Shows the bar of the fit, with the last failed trials below it.
    fn begin(&mut self, all: u32) {
        let bars = self.screen.bars();
        let bar = bars.add(ProgressBar::new(all.into()));
        let wide = bar_columns(&self.screen);
        bar.set_style(style(&format!(
            "{:<LEFT$}{{bar:{wide}}} {{human_pos}}/{{human_len}} {{per_sec:>9}}, {{eta}} left",
            "model"
        )));
        let line = |text: &String| {
            let line = bars.add(ProgressBar::new(0));
            line.set_style(style(&format!("{:LEFT$}{{wide_msg}}", "")));
            line.set_message(text.clone());
            line
        };
        let below = self.failures.iter().map(line).collect();
        bar.tick();
        self.begun = Instant::now();
        self.live = Some((bar, below));
    }

    fn clear(&mut self) {
        if let Some((bar, below)) = self.live.take() {
            below.iter().for_each(ProgressBar::finish_and_clear);
            bar.finish_and_clear();
        }
    }
}

impl Drop for TransferView {
    /// A transfer that ends with an error leaves no half-drawn bar.
    fn drop(&mut self) {
        self.clear();
    }
}

/// Writes a line of a step.
fn say(step: &str, text: impl std::fmt::Display) {
    terminal::note(format_args!("{step:<LEFT$}{text}"));
}

/// Successes and failures in one line.
fn counts<'a>(success: u64, all: u64, modes: impl Iterator<Item = (&'a str, u64)>) -> String {
    let rate = if all > 0 { percent(success as f64 / all as f64) } else { "\u{2013}".to_owned() };
    let mut text = format!("success {rate} ({} of {})", grouped(success), grouped(all));
    for (mode, count) in modes {
        text += &format!(" \u{b7} {} {}", foreign(mode), grouped(count));
    }
    text
}
