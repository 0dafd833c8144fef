//! A campaign in shards, with the question of its gate if it has one.

use std::path::Path;
use std::sync::Arc;

use anyhow::anyhow;
use robogate_campaign::shards::{Assignment, OpenRound, ShardError, ShardStatus, Shards};
use robogate_campaign::{AfterRound, Completion, Event, Round};
use robogate_core::Foresight;
use robogate_gate::{Asked, GateError, Record};

use crate::commands::gate::{compared_with, finish, refused, ruled_out};
use crate::commands::run::{conclude, write_report};
use crate::commands::shard::exit;
use crate::exit::{Exit, USAGE};
use crate::twins;
use robogate_session::{Look, Reopening, Subject, begun, register_copy, starts_processes, write_question};

/// A campaign in shards. After each round of a gate, the sequential test decides whether another one follows.
pub(crate) struct Campaign {
    shards: Shards,
    gate: Option<Gate>,
}

/// The question of a gate.
struct Gate {
    asked: Asked,
    /// The run that it compares with.
    other: Option<Record>,
    /// The episodes of the rounds so far.
    record: Record,
}

impl Gate {
    fn of(shards: &Shards) -> Result<Option<Self>, Exit> {
        let path = shards.dir().join(Asked::FILE);
        let planned = shards.settings().provenance.question_sha256.as_deref();
        let Some(text) = shards.document(Asked::FILE).map_err(exit)? else {
            return match planned {
                None => Ok(None),
                Some(_) => Err(not_planned(&path, "missing, but the plan is that of a gate with a question")),
            };
        };
        let text = String::from_utf8_lossy(&text);
        let asked = Asked::from_json(&path, &text).map_err(refused)?;
        if planned.is_some_and(|planned| planned != asked.sha256()) {
            return Err(not_planned(&path, "not the question of the plan, which has another SHA-256"));
        }
        let other = compared_with(&asked)?.map(|(_, record)| record);
        let record = begun(&shards.settings().provenance, &asked).map_err(refused)?;
        Ok(Some(Self { asked, other, record }))
    }
}

/// The error of a question that the plan does not name.
fn not_planned(path: &Path, reason: &str) -> Exit {
    let hint = "run the `robogate gate --divide` that wrote the plan again, which writes a missing question, or restore the file";
    Exit { code: USAGE, error: anyhow!("{}: {reason}\nHint: {hint}", path.display()) }
}

/// What the task knows about episodes before they run. `None` if it knows nothing.
pub(crate) type Knowledge = Option<Arc<dyn Foresight>>;

/// The knowledge of the environment of a run. The policy, whose server may be gone, is not needed.
fn recorded_foresight(shards: &Shards, opening: &Reopening) -> Result<Knowledge, Exit> {
    let provenance = &shards.settings().provenance;
    if starts_processes(provenance) {
        // The bridge protocol has no such knowledge for environments in other processes.
        return Ok(None);
    }
    let subject = Subject::recorded_environment(provenance, Some(&shards.dir()), opening)?;
    Ok(subject.foresight()?)
}

impl Campaign {
    /// Reads the question of the gate.
    pub(crate) fn of(shards: Shards) -> Result<Self, Exit> {
        let gate = Gate::of(&shards)?;
        Ok(Self { shards, gate })
    }

    /// The shards.
    pub(crate) fn shards(&self) -> &Shards {
        &self.shards
    }

    /// Chooses the points of the next round of an active stage, if it can be chosen now. `foresight` is called only then.
    pub(crate) fn choose(&self, foresight: &dyn Fn() -> Result<Knowledge, Exit>) -> Result<(), Exit> {
        if let Some(round) = self.shards.unchosen().map_err(exit)? {
            self.shards.choose(round, foresight()?).map_err(exit)?;
        }
        Ok(())
    }

    /// Like [`Self::choose`], in the environment of the plan.
    pub(crate) fn choose_as_recorded(&self, opening: &Reopening) -> Result<(), Exit> {
        self.choose(&|| recorded_foresight(&self.shards, opening))
    }

    /// Calls `work` with the decision after each round.
    fn in_rounds<T>(
        &mut self,
        work: impl FnOnce(&Shards, Option<&mut AfterRound<'_>>) -> Result<T, ShardError>,
    ) -> Result<T, Exit> {
        let Some(Gate { asked, other, record }) = &mut self.gate else {
            return work(&self.shards, None).map_err(exit);
        };
        let mut trouble: Option<GateError> = None;
        let mut look = Look { asked, other: other.as_ref(), record, trouble: &mut trouble };
        let result = work(&self.shards, Some(&mut |round: &Round<'_>| look.after(round))).map_err(exit);
        match trouble {
            Some(error) => Err(refused(error)),
            None => result,
        }
    }

    /// The first round with missing shards.
    pub(crate) fn open_round(&mut self) -> Result<Option<OpenRound>, Exit> {
        self.in_rounds(|shards, after_round| shards.open_round(after_round))
    }

    /// What the worker of shard `index` has to do.
    pub(crate) fn assign(&mut self, index: u32) -> Result<Assignment, Exit> {
        self.in_rounds(|shards, after_round| shards.assign(index, after_round))
    }

    /// The progress of the campaign.
    pub(crate) fn status(&mut self) -> Result<ShardStatus, Exit> {
        self.in_rounds(|shards, after_round| shards.status(after_round))
    }

    /// Notes that the merged run is this user's, if the campaign is.
    fn register(&self, out: &Path) {
        register_copy(out, &self.shards.dir(), &self.shards.settings().provenance);
    }

    /// Merges the shards into `out`, and prints nothing.
    pub(crate) fn merge_quietly(
        mut self,
        out: &Path,
        events: &mut dyn FnMut(&Event),
        opening: &Reopening,
    ) -> Result<(), Exit> {
        self.choose_as_recorded(opening)?;
        self.register(out);
        self.in_rounds(|shards, after_round| shards.merge(out, events, after_round))?;
        write_report(out, None, None);
        Ok(())
    }

    /// Merges the shards into `out`, and prints the summary or the verdict.
    pub(crate) fn merge(
        mut self,
        out: &Path,
        events: &mut dyn FnMut(&Event),
        opening: &Reopening,
        json: bool,
    ) -> Result<u8, Exit> {
        self.choose_as_recorded(opening)?;
        self.register(out);
        let completion = self.in_rounds(|shards, after_round| shards.merge(out, events, after_round))?;
        let stopped = match (&self.gate, &completion) {
            (Some(Gate { asked, other, .. }), Completion::Finished { .. }) => ruled_out(out, asked, other.as_ref())?,
            _ => false,
        };
        if !stopped {
            twins::merge(&self.shards, out, &completion, opening)?;
        }
        match &self.gate {
            Some(Gate { asked, other, .. }) => {
                if !out.join(Asked::FILE).exists() {
                    write_question(out, asked);
                }
                finish(out, asked, other.as_ref(), None, completion, None, json)
            }
            None => conclude(out, &completion, None, json),
        }
    }
}
