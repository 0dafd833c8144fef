//! `robogate runs`: the runs below a folder.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use clap::Args;
use robogate_campaign::Summary;
use robogate_stats::format::{date_and_time, percent_range};
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{bold, dim, grouped, line, note, percent};
use robogate_session::{Run, runs_below};

/// List the runs below a folder: when, what, verdict, success rate and size, the newest first.
#[derive(Debug, Args)]
pub(crate) struct Runs {
    /// Folder
    #[arg(default_value = ".")]
    folder: PathBuf,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

/// A run as a row of text.
struct Row {
    folder: String,
    started: String,
    what: String,
    verdict: String,
    rate: String,
    episodes: String,
}

impl Runs {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if !self.folder.is_dir() {
            return Err(anyhow!("{} is not a folder\nHint: name the folder of the runs", self.folder.display()))
                .or_usage();
        }
        let runs = runs_below(&self.folder);
        if self.json {
            let runs: Vec<_> = runs.iter().map(document).collect();
            line(json!({ "version": 1, "runs": runs }));
            return Ok(DONE);
        }
        if runs.is_empty() {
            note(format_args!("no runs below {}\nnext: robogate run", self.folder.display()));
            return Ok(DONE);
        }
        let rows: Vec<Row> = runs.iter().map(row).collect();
        let wide = |cell: fn(&Row) -> &str| rows.iter().map(|row| cell(row).chars().count()).max().unwrap_or(0);
        let [folder, what, verdict, rate] =
            [wide(|r| &r.folder), wide(|r| &r.what), wide(|r| &r.verdict), wide(|r| &r.rate)];
        for row in &rows {
            line(format_args!(
                "{}  {}  {:<what$}  {:<verdict$}  {:<rate$}  {:>9}",
                bold(format_args!("{:<folder$}", row.folder)),
                dim(&row.started),
                row.what,
                row.verdict,
                row.rate,
                row.episodes
            ));
        }
        note("times are UTC; look at one: robogate view FOLDER");
        Ok(DONE)
    }
}

fn row(run: &Run) -> Row {
    let folder = run.folder.strip_prefix(".").unwrap_or(&run.folder);
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let estimate = run.summary.as_ref().map(|summary| &summary.estimate);
    let rate = estimate.and_then(|estimate| Some((estimate.success_rate?, estimate.interval_95)));
    let verdict = match (&run.summary, run.verdict) {
        (_, Some(verdict)) => verdict.as_str(),
        (None, None) => "unfinished",
        (Some(_), None) => "-",
    };
    let on = if run.robot == run.task { String::new() } else { format!(" on {}", run.robot) };
    Row {
        folder: folder.display().to_string(),
        started: date_and_time(run.started_s),
        what: format!("{}{on}, {}", run.task, run.policy),
        verdict: verdict.to_owned(),
        rate: match rate {
            // A gate chooses the number of its episodes by their results: its report has the interval that allows for that.
            Some((rate, _)) if run.verdict.is_some() => percent(rate),
            Some((rate, interval)) => format!("{} ({})", percent(rate), percent_range(interval)),
            None => "-".to_owned(),
        },
        episodes: run.summary.as_ref().map_or_else(|| "-".to_owned(), |summary| grouped(summary.episodes)),
    }
}

fn document(run: &Run) -> serde_json::Value {
    let of = |value: fn(&Summary) -> serde_json::Value| run.summary.as_ref().map(value);
    json!({
        "folder": run.folder,
        "started": date_and_time(run.started_s),
        "task": run.task,
        "robot": run.robot,
        "policy": run.policy,
        "finished": run.summary.is_some(),
        "verdict": run.verdict,
        "episodes": of(|summary| summary.episodes.into()),
        "success_rate": of(|summary| summary.estimate.success_rate.into()),
        "interval_95": of(|summary| json!(summary.estimate.interval_95)),
        "dataset_sha256": of(|summary| summary.dataset_hash.clone().into()),
    })
}
