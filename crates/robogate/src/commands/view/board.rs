//! The runs on the page, and their episodes so far.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use robogate_analysis::{ExplorerTable, Source};
use robogate_campaign::folder::{DICTIONARY, LAYOUT, PLAN};
use robogate_campaign::shards::Shards;
use robogate_campaign::{Follower, Progress, RunError, settings};
use robogate_dictionary::{Entry, Provenance};
use serde_json::{Value, json};

use crate::exit::{Exit, OrExit};
use crate::place;
use crate::terminal::{foreign, note};
use robogate_session::{open_source, open_store};

/// All runs with their episodes.
pub(super) struct Board {
    pub(super) runs: Vec<Run>,
    pub(super) table: ExplorerTable,
    /// Increases when episodes became void. A page then reads all rows again.
    pub(super) epoch: u64,
}

/// A run.
pub(super) struct Run {
    /// The name on the page.
    pub(super) name: String,
    /// Its folder or file.
    pub(super) path: PathBuf,
    pub(super) provenance: Arc<Provenance>,
    feed: Feed,
    /// Its number in the table.
    number: usize,
    rows: u64,
    /// Number of planned episodes. `None` if unknown.
    planned: Option<u64>,
    finished: bool,
    /// The reason why no further episodes can be read.
    problem: Option<String>,
}

enum Feed {
    Campaign(Box<Follower>),
    /// A dictionary without a run's folder.
    Dictionary(Box<Source>),
}

impl Board {
    /// Opens the runs and reads their episodes. Of more than `most_rows` episodes, it has a random sample.
    pub(super) fn open(paths: &[PathBuf], most_rows: usize) -> Result<Self, Exit> {
        let table = ExplorerTable::new(most_rows);
        let mut board = Self { runs: Vec::with_capacity(paths.len()), table, epoch: 1 };
        for path in paths {
            let (feed, provenance, planned) = open(path)?;
            let mut name = name(path, paths);
            // The same run twice.
            if board.runs.iter().any(|run| run.name == name) {
                name = format!("{name} ({})", board.runs.len() + 1);
            }
            let number = board.table.add_run(&name, &provenance);
            board.runs.push(Run {
                name,
                path: path.clone(),
                provenance: Arc::new(provenance),
                feed,
                number,
                rows: 0,
                planned,
                finished: false,
                problem: None,
            });
        }
        board.look();
        // No page has read a row yet.
        board.epoch = 1;
        for run in &board.runs {
            if let Some(problem) = &run.problem {
                note(format_args!("note: {}: {}", run.path.display(), foreign(problem)));
            }
        }
        Ok(board)
    }

    /// Reads the episodes that arrived.
    pub(super) fn look(&mut self) {
        let halvings = self.table.halvings();
        let mut restarted = false;
        for run in self.runs.iter_mut().filter(|run| !run.finished) {
            restarted |= run.look(&mut self.table);
        }
        if restarted {
            // The rows of all runs are in one table, so all are read again.
            self.epoch += 1;
            self.table.clear();
            for run in &mut self.runs {
                run.again(&mut self.table);
            }
        } else if self.table.halvings() != halvings {
            // The table dropped rows.
            self.epoch += 1;
        }
    }

    /// The description of runs and columns.
    pub(super) fn state(&self) -> Value {
        let runs = self.runs.iter().enumerate().map(|(at, run)| {
            json!({
                "name": run.name,
                "rows": run.rows,
                "counts": self.table.counts(at),
                "planned": run.planned,
                "finished": run.finished,
                "problem": run.problem,
                "playable": run.is_playable(),
                "task": run.provenance.task.name,
                "policy": run.provenance.policy,
                "robot": run.provenance.robot.name,
                "engine": run.provenance.engine.name,
            })
        });
        json!({
            "version": 1,
            "epoch": self.epoch,
            "halvings": self.table.halvings(),
            "rows": self.table.rows(),
            "columns": self.table.columns(),
            "runs": runs.collect::<Vec<_>>(),
        })
    }

    /// The recorded entry of an episode. `None` if the run has none of this index.
    pub(super) fn recorded(&mut self, run: usize, index: u64) -> anyhow::Result<Option<Entry>> {
        let Some(run) = self.runs.get_mut(run) else { return Ok(None) };
        match &mut run.feed {
            Feed::Campaign(follower) => Ok(follower.recorded(index)?),
            Feed::Dictionary(_) => Ok(None),
        }
    }
}

impl Run {
    /// Whether its episodes can be replayed: they come from a run's folder, not from another tool.
    pub(super) fn is_playable(&self) -> bool {
        matches!(self.feed, Feed::Campaign(_)) && self.provenance.source.is_none()
    }

    /// Whether all its episodes are there.
    pub(super) fn is_finished(&self) -> bool {
        self.finished
    }

    /// Reads the episodes that arrived. Returns whether those before became void.
    fn look(&mut self, table: &mut ExplorerTable) -> bool {
        let (number, rows) = (self.number, &mut self.rows);
        let mut sink = |entry: &Entry| {
            table.push(number, entry);
            *rows += 1;
        };
        let looked: anyhow::Result<Progress> = match &mut self.feed {
            Feed::Campaign(follower) => follower.look(&mut sink).map_err(Into::into),
            Feed::Dictionary(source) => source
                .dictionary()
                .entries()
                .try_for_each(|entry| entry.map(|entry| sink(&entry)))
                .map_err(Into::into)
                .map(|()| Progress::Finished),
        };
        match looked {
            Ok(progress) => {
                self.problem = None;
                self.finished = progress == Progress::Finished;
                progress == Progress::Restarted
            }
            Err(error) => {
                self.problem = Some(format!("{error:#}"));
                // A dictionary does not change, so a second look would read its rows again.
                self.finished = matches!(self.feed, Feed::Dictionary(_));
                false
            }
        }
    }

    /// Reads all episodes again.
    fn again(&mut self, table: &mut ExplorerTable) {
        self.rows = 0;
        self.finished = false;
        if let Feed::Campaign(follower) = &mut self.feed {
            match reopened(&self.path, follower) {
                Ok(again) => **follower = again,
                Err(exit) => {
                    self.problem = Some(exit.to_string());
                    return;
                }
            }
        }
        self.look(table);
    }
}

fn reopened(path: &Path, before: &Follower) -> Result<Follower, Exit> {
    match open(path)? {
        (Feed::Campaign(follower), ..) if follower.settings().provenance == before.settings().provenance => {
            Ok(*follower)
        }
        _ => {
            Err(anyhow::anyhow!("{}: the plan of the run has changed\nHint: start robogate view again", path.display()))
                .or_usage()
        }
    }
}

/// Opens a run: its feed, its provenance and the number of planned episodes.
fn open(path: &Path) -> Result<(Feed, Provenance, Option<u64>), Exit> {
    let in_shards = place::is_remote(path) || path.join(LAYOUT).is_file() && !path.join(DICTIONARY).is_file();
    if in_shards {
        let follower = Follower::of_shards(Shards::open(open_store(path)?)?);
        return Ok(campaign(follower));
    }
    if path.join(PLAN).is_file() {
        // A finished run whose plan has an older format still has its dictionary.
        match settings(path) {
            Err(error @ RunError::Io { .. }) => return Err(error).or_broken(),
            Err(_) if path.join(DICTIONARY).is_file() => {}
            _ => return Ok(campaign(Follower::open(path).or_usage()?)),
        }
    }
    let source = open_source(path)?;
    let (provenance, rows) = (source.dictionary().provenance().clone(), source.dictionary().len());
    Ok((Feed::Dictionary(Box::new(source)), provenance, Some(rows)))
}

fn campaign(follower: Follower) -> (Feed, Provenance, Option<u64>) {
    let settings = follower.settings();
    let (provenance, planned) = (settings.provenance.clone(), settings.plan.episodes());
    (Feed::Campaign(Box::new(follower)), provenance, Some(planned))
}

/// The name of a run: that of its folder or file, or the whole path if two are equal.
fn name(path: &Path, all: &[PathBuf]) -> String {
    let short = |path: &Path| {
        path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
    };
    let own = short(path);
    if all.iter().filter(|other| short(other) == own).count() > 1 { path.display().to_string() } else { own }
}
