//! `robogate monitor simulate`: simulates false-alarm rates and detection delays.

use anyhow::anyhow;
use clap::Args;
use robogate_monitor::simulate::{Figures, Mean, Question, simulate};
use robogate_monitor::{Baseline, Count, Metric, Settings};
use serde::Serialize;

use super::Watched;
use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{bold, dim, line};

/// Simulate false-alarm rates and detection delays.
///
/// Prints false alarms per day and detection delays of the paper's rule and of the failure-rate detector, from
/// simulated streams of independent cycles.
#[derive(Debug, Args)]
pub(super) struct Simulate {
    /// Set the true success rate before a change, in (0, 1)
    #[arg(long, value_name = "SHARE", default_value_t = 0.95)]
    rate: f64,
    /// Set the true success rates after a drop, each in (0, 1)
    #[arg(long, value_name = "SHARE", num_args = 1.., default_values_t = [0.92, 0.90, 0.85])]
    drop_to: Vec<f64>,
    /// Set the number of cycles of the baseline, at the rate above; a baseline in the settings takes precedence
    #[arg(long, value_name = "CYCLES", default_value_t = 10_000)]
    baseline_cycles: u64,
    /// Set the time from one cycle to the next, in seconds
    #[arg(long, value_name = "S", default_value_t = 4.0)]
    cycle_s: f64,
    /// Set the number of simulated streams per figure, from 2 to 100000
    #[arg(long, value_name = "N", default_value_t = 1_000)]
    streams: u32,
    /// Set the seed of the streams
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print the figures as one versioned JSON document
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    watched: Watched,
}

/// The document of `--json`.
#[derive(Serialize)]
struct Document<'a> {
    version: u32,
    rate: f64,
    baseline_successes: u64,
    baseline_cycles: u64,
    cycles_per_day: f64,
    streams: u32,
    seed: u64,
    figures: &'a [Figures],
}

impl Simulate {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let (settings, _) = self.watched.settings()?;
        let settings = &settings.detectors;
        let share = |name: &str, value: f64| {
            let good = value > 0.0 && value < 1.0;
            if good {
                Ok(())
            } else {
                Err(anyhow!("{name} {value} is out of range: expected a fraction in (0, 1)")).or_usage()
            }
        };
        share("--rate", self.rate)?;
        self.drop_to.iter().try_for_each(|to| share("--drop-to", *to))?;
        if !(1e-3..=1e9).contains(&self.cycle_s) {
            return Err(anyhow!("--cycle-s {} is out of range: expected 0.001 to 1e9 seconds", self.cycle_s))
                .or_usage();
        }
        if self.baseline_cycles == 0 || !(2..=100_000).contains(&self.streams) {
            let hint = "--baseline-cycles must be above 0 and --streams from 2 to 100000";
            return Err(anyhow!("{hint}")).or_usage();
        }
        let count = settings.baseline.success.unwrap_or_else(|| count(self.rate, self.baseline_cycles));
        let baseline = Baseline { success: Some(count), ..Baseline::default() };
        let question = Question {
            rate: self.rate,
            drops: self.drop_to.clone(),
            cycles_per_day: 86_400.0 / self.cycle_s,
            streams: self.streams,
            seed: self.seed,
        };
        let figures = simulate(&question, settings, &baseline)
            .ok_or_else(|| {
                anyhow!(
                    "the baseline ({} of {}) is too small, or has too many failures, to detect a change",
                    count.count,
                    count.of
                )
            })
            .or_usage()?;
        if self.json {
            let document = Document {
                version: 1,
                rate: self.rate,
                baseline_successes: count.count,
                baseline_cycles: count.of,
                cycles_per_day: question.cycles_per_day,
                streams: self.streams,
                seed: self.seed,
                figures: &figures,
            };
            line(serde_json::to_string_pretty(&document).map_err(anyhow::Error::from).or_broken()?);
        } else {
            self.print(&figures, settings, &question, (count.count, count.of));
        }
        Ok(DONE)
    }

    fn print(&self, figures: &[Figures], settings: &Settings, question: &Question, (k, n): (u64, u64)) {
        line(bold(format_args!(
            "Success {} before a change, a cycle every {} s ({} per day), baseline {k} of {n}",
            self.rate,
            self.cycle_s,
            whole(question.cycles_per_day)
        )));
        line("");
        let mut head = format!("{:<20} {:>14} {:>20} {:>16}", "rule", "bound", "to a false alarm", "false per day");
        for to in &self.drop_to {
            head += &format!(" {:>16}", format!("delay to {to}"));
        }
        line(head);
        for figure in figures {
            let mut row = format!(
                "{:<20} {:>14} {:>20} {:>16}",
                format!("{} {}", figure.rule, figure.level.as_str()),
                figure.promised_cycles.map_or_else(|| "-".to_owned(), |c| format!(">= {}", whole(c))),
                mean(figure.cycles_to_false_alarm),
                format!("{:.2}", figure.false_alarms_per_day)
            );
            for delay in &figure.delays {
                row += &format!(" {:>16}", mean(delay.cycles));
            }
            line(row);
        }
        line("");
        line(dim(format_args!(
            "In cycles, mean and standard error; {} streams, seed {}. A delay counts from the drop, after 1,000 cycles without one.",
            self.streams, self.seed
        )));
        line(dim(format_args!(
            "The detector of the failure rate uses its share ({}) of the false-alarm budget of all {} metrics.",
            settings.share(Metric::Success),
            Metric::all(settings).count()
        )));
    }
}

/// The number of successes that gives `rate` in `of` cycles.
fn count(rate: f64, of: u64) -> Count {
    Count { count: (rate * of as f64).round() as u64, of }
}

fn whole(number: f64) -> String {
    crate::terminal::grouped(number.round() as u64)
}

fn mean(mean: Mean) -> String {
    let most = if mean.cut > 0 { ">" } else { "" };
    format!("{most}{} ± {}", whole(mean.mean), whole(mean.se))
}
