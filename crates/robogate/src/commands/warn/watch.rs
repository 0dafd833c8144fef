//! `robogate warn watch`: warns in episodes that run now.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use robogate_monitor::warn::{Feed, FeedEvent, Period};
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit, USAGE};
use crate::terminal::{foreign, line, note};

/// The longest line.
const LONGEST_LINE: u64 = 1 << 20;
/// Rejected lines that are shown.
const SHOWN: u64 = 10;

/// Warn in episodes that run now: read their control periods as JSON Lines, and write warnings as JSON Lines.
///
/// A line is one control period, before its action is executed: {"robot": "cell-1", "time_s": 0.05, "observation": {NAME: [...]},
/// "command": {KIND: [...]}, "gripper": 1.0}. {"robot": "cell-1", "start": {PARAMETER: VALUE}} starts an episode, and "end" with success, the
/// failure mode, or stopped ends it. docs/guides/warn.md has the names and units.
///
/// Warnings are suspended when the successes so far contradict the promise. Exit codes: 0, or 2 if a line was rejected.
#[derive(Debug, Args)]
pub(super) struct Watch {
    /// Detector of `robogate warn train`
    file: PathBuf,
    /// File or pipe to read; default: stdin
    input: Option<PathBuf>,
}

impl Watch {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let file = super::read(&self.file)?;
        let mut feed = Feed::new(file).or_usage()?;
        let mut input: Box<dyn BufRead> = match &self.input {
            Some(path) => {
                let opened = File::open(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
                Box::new(BufReader::new(opened))
            }
            None => Box::new(std::io::stdin().lock()),
        };
        let (mut number, mut rejected) = (0_u64, 0_u64);
        let mut text = Vec::new();
        loop {
            text.clear();
            let read = input.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut text).or_broken()?;
            if read == 0 {
                break;
            }
            number += 1;
            if text.trim_ascii().is_empty() {
                continue;
            }
            let heard = serde_json::from_slice::<Period>(&text).map_err(anyhow::Error::from).and_then(|period| {
                let mut say = |event: FeedEvent| line(serde_json::to_string(&event).unwrap_or_default());
                Ok(feed.hear(&period, &mut say)?)
            });
            if let Err(why) = heard {
                rejected += 1;
                if rejected <= SHOWN {
                    note(format_args!("line {number} is rejected: {}", foreign(format!("{why:#}"))));
                }
            }
        }
        line(json!({ "episodes": feed.tally(), "rejected_lines": rejected }));
        if rejected > 0 {
            note("Hint: docs/guides/warn.md describes the lines");
        }
        Ok(if rejected > 0 { USAGE } else { DONE })
    }
}
