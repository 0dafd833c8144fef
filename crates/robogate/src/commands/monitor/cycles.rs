//! `robogate monitor cycles`: the cycles of a recording as lines, for `robogate import` and other programs.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_monitor::{Cycle, ParameterValue};
use serde_json::json;

use super::bag::{Found, cycles, files};
use super::results::{OfRows, is_dictionary, say_left_out};
use super::topic_map;
use crate::exit::{DONE, Exit, FAIL, INFRASTRUCTURE, INVALID, OrExit};
use crate::terminal::{grouped, note};

/// Print the cycles of a recording or of a dictionary as JSON Lines, or as CSV.
///
/// `robogate import` reads those of a recording as trials. A dictionary is a run, or what `import` made of a dataset of LeRobot, a log of
/// Inspect Robots, a table of RoboArena or another table. Exit code 1 if cycles were refused, 4 if there was none.
#[derive(Debug, Args)]
pub(super) struct Cycles {
    /// MCAP file, folder of rosbag2 with this storage, dictionary (Parquet) or folder of a run
    #[arg(value_name = "RECORDING|DICTIONARY")]
    recording: PathBuf,
    /// Read from this file (TOML) which messages of a recording are cycles
    #[arg(long, value_name = "FILE")]
    topics: Option<PathBuf>,
    /// Print a table (CSV) with the outcome and the parameters of each cycle, for `transfer --real` and `import`
    #[arg(long)]
    csv: bool,
    #[command(flatten)]
    of_rows: OfRows,
}

impl Cycles {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let map = self.topics.as_deref().map(topic_map).transpose()?;
        let parameters: Vec<String> = match &map {
            Some(_) if self.of_rows.any() => {
                return Err(anyhow!("--robot, --recipe and --since apply to a dictionary")).or_usage();
            }
            Some(map) => {
                files(&self.recording).map_err(anyhow::Error::msg).or_usage()?;
                map.parameters.keys().cloned().collect()
            }
            None if is_dictionary(&self.recording) => OfRows::parameters(&self.recording)?,
            None => {
                return Err(anyhow!(
                    "{}: not a dictionary\nHint: describe the messages of a recording with --topics FILE, or make a dictionary of other \
                     results with `robogate import`",
                    self.recording.display()
                ))
                .or_usage();
            }
        };
        let mut out = std::io::BufWriter::new(std::io::stdout().lock());
        let (mut printed, mut refused) = (0_u64, 0_u64);
        if self.csv {
            let head = ["id", "robot", "recipe", "time_s", "success", "failure_mode", "cycle_time_s"];
            let head = head.into_iter().chain(parameters.iter().map(String::as_str)).map(cell).collect::<Vec<_>>();
            writeln!(out, "{}", head.join(",")).or_broken()?;
        }
        let mut print = |found: Found| {
            let Found::Cycle(cycle) = found else { return Ok(()) };
            match cycle {
                Ok(cycle) => {
                    printed += 1;
                    let line = if self.csv { row(&cycle, &parameters) } else { json!(cycle).to_string() };
                    writeln!(out, "{line}").map_err(|error| format!("stdout: {error}"))?;
                }
                Err(because) => {
                    refused += 1;
                    note(format_args!("cycle {}: {because}", printed + refused));
                }
            }
            Ok(())
        };
        let read = match map {
            Some(map) => cycles(&self.recording, map, &mut print),
            None => {
                self.of_rows.cycles(&self.recording, &mut print).map(say_left_out).map_err(|why| format!("{why:#}"))
            }
        };
        out.flush().context("stdout").or_broken()?;
        read.map_err(|because| Exit { code: INFRASTRUCTURE, error: anyhow!(because) })?;
        note(format_args!("{} cycles, {} refused", grouped(printed), grouped(refused)));
        Ok(match (printed, refused) {
            (0, _) => INVALID,
            (_, 0) => DONE,
            _ => FAIL,
        })
    }
}

/// A row of the table. A value that is missing is an empty cell.
fn row(cycle: &Cycle, parameters: &[String]) -> String {
    let mut cells: Vec<String> = [&cycle.id, &cycle.robot, &cycle.recipe].into_iter().map(|name| cell(name)).collect();
    cells.extend([cycle.time_s.to_string(), cycle.success.to_string()]);
    cells.push(cell(cycle.failure_mode.as_deref().unwrap_or_default()));
    cells.push(cycle.cycle_time_s.map_or_else(String::new, |time| time.to_string()));
    cells.extend(parameters.iter().map(|name| match cycle.parameters.get(name) {
        Some(ParameterValue::Number(number)) => number.to_string(),
        Some(ParameterValue::Word(word)) => cell(word),
        None => String::new(),
    }));
    cells.join(",")
}

/// A cell (RFC 4180).
fn cell(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}
