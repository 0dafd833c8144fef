//! A campaign in shards, with the question of its gate if it has one.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::anyhow;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::shards::{Assignment, OpenRound, ShardError, ShardStatus, Shards};
use robogate_campaign::{AfterRound, Completion, Event, Round};
use robogate_core::Foresight;
use robogate_dictionary::Provenance;
use robogate_gate::{Asked, GateError, Record};

use crate::arms::{ArmKind, rounds_of, space_of};
use crate::compared::compared_with;
use crate::failure::Failure;
use crate::gate::{Look, begun, write_question};
use crate::notice::note;
use crate::origin::register_copy;
use crate::reopening::Reopening;
use crate::rounds::ruled_out;
use crate::store::{create_store, open_store};
use crate::subject::{Subject, starts_processes};
use crate::text::quoted;

/// A campaign in shards. After each round of a gate, the sequential test decides whether another one follows.
pub struct ShardedCampaign {
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
    fn of(shards: &Shards) -> Result<Option<Self>, Failure> {
        let path = shards.dir().join(Asked::FILE);
        let planned = shards.settings().provenance.question_sha256.as_deref();
        let Some(text) = shards.document(Asked::FILE)? else {
            return match planned {
                None => Ok(None),
                Some(_) => Err(not_planned(&path, "missing, but the plan is that of a gate with a question")),
            };
        };
        let text = String::from_utf8_lossy(&text);
        let asked = Asked::from_json(&path, &text)?;
        if planned.is_some_and(|planned| planned != asked.sha256()) {
            return Err(not_planned(&path, "not the question of the plan, which has another SHA-256"));
        }
        let other = compared_with(&asked)?.map(|(_, record)| record);
        let record = begun(&shards.settings().provenance, &asked)?;
        Ok(Some(Self { asked, other, record }))
    }
}

/// The error of a question that the plan does not name.
fn not_planned(path: &Path, reason: &str) -> Failure {
    let hint = "run the `robogate gate --divide` that wrote the plan again, which writes a missing question, or restore the file";
    Failure::broken_if(false, anyhow!("{}: {reason}\nHint: {hint}", path.display()))
}

/// What the task knows about episodes before they run. `None` if it knows nothing.
type Knowledge = Option<Arc<dyn Foresight>>;

/// The knowledge of the environment of a run. The policy, whose server may be gone, is not needed.
fn recorded_foresight(shards: &Shards, opening: &Reopening) -> Result<Knowledge, Failure> {
    let provenance = &shards.settings().provenance;
    if starts_processes(provenance) {
        // The bridge protocol has no such knowledge for environments in other processes.
        return Ok(None);
    }
    let subject = Subject::recorded_environment(provenance, Some(&shards.dir()), opening)?;
    subject.foresight()
}

impl ShardedCampaign {
    /// Reads the question of the gate.
    pub fn of(shards: Shards) -> Result<Self, Failure> {
        let gate = Gate::of(&shards)?;
        Ok(Self { shards, gate })
    }

    /// The shards.
    pub fn shards(&self) -> &Shards {
        &self.shards
    }

    /// Chooses the points of the next round of an active stage, if it can be chosen now. `foresight` is called only then.
    pub fn choose(&self, foresight: &dyn Fn() -> Result<Knowledge, Failure>) -> Result<(), Failure> {
        if let Some(round) = self.shards.unchosen()? {
            self.shards.choose(round, foresight()?)?;
        }
        Ok(())
    }

    /// Like [`Self::choose`], in the environment of the plan.
    pub fn choose_as_recorded(&self, opening: &Reopening) -> Result<(), Failure> {
        self.choose(&|| recorded_foresight(&self.shards, opening))
    }

    /// Calls `work` with the decision after each round.
    fn in_rounds<T>(
        &mut self,
        work: impl FnOnce(&Shards, Option<&mut AfterRound<'_>>) -> Result<T, ShardError>,
    ) -> Result<T, Failure> {
        let Some(Gate { asked, other, record }) = &mut self.gate else {
            return Ok(work(&self.shards, None)?);
        };
        let mut trouble: Option<GateError> = None;
        let mut look = Look { asked, other: other.as_ref(), record, trouble: &mut trouble };
        let result = work(&self.shards, Some(&mut |round: &Round<'_>| look.after(round)));
        match trouble {
            Some(error) => Err(error.into()),
            None => Ok(result?),
        }
    }

    /// The first round with missing shards.
    pub fn open_round(&mut self) -> Result<Option<OpenRound>, Failure> {
        self.in_rounds(|shards, after_round| shards.open_round(after_round))
    }

    /// What the worker of shard `index` has to do.
    pub fn assign(&mut self, index: u32) -> Result<Assignment, Failure> {
        self.in_rounds(|shards, after_round| shards.assign(index, after_round))
    }

    /// The progress of the campaign.
    pub fn status(&mut self) -> Result<ShardStatus, Failure> {
        self.in_rounds(|shards, after_round| shards.status(after_round))
    }

    /// Notes that the merged run is this user's, if the campaign is.
    fn register(&self, out: &Path) {
        register_copy(out, &self.shards.dir(), &self.shards.settings().provenance);
    }

    /// Merges the shards into `out`.
    ///
    /// # Errors
    /// Missing or contradictory shards, or a folder that cannot be written.
    pub fn merge(
        &mut self,
        out: &Path,
        events: &mut dyn FnMut(&Event),
        opening: &Reopening,
    ) -> Result<Completion, Failure> {
        self.choose_as_recorded(opening)?;
        self.register(out);
        self.in_rounds(|shards, after_round| shards.merge(out, events, after_round))
    }

    /// Merges the arms of the campaign into `out`, after the campaign itself was merged. If an arm does not exist, writes its plan;
    /// if shards are missing, notes how to run them. Returns the folders of the arms that are new there.
    ///
    /// # Errors
    /// As [`Self::merge`].
    pub fn merge_arms(
        &self,
        out: &Path,
        completion: &Completion,
        opening: &Reopening,
    ) -> Result<Vec<PathBuf>, Failure> {
        let Completion::Finished { summary, .. } = completion else { return Ok(Vec::new()) };
        if !self.shards.settings().plan.twins {
            return Ok(Vec::new());
        }
        if let Some(Gate { asked, other, .. }) = &self.gate
            && ruled_out(out, asked, other.as_ref())?
        {
            return Ok(Vec::new());
        }
        let arms = ArmKind::TWINS.map(|kind| self.merge_arm(kind, out, rounds_of(summary), opening));
        Ok(arms.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }

    fn merge_arm(
        &self,
        kind: ArmKind,
        out: &Path,
        rounds: u64,
        opening: &Reopening,
    ) -> Result<Option<PathBuf>, Failure> {
        let (settings, folder) = (self.shards.settings(), out.join(kind.folder()));
        if folder.join(DICTIONARY).is_file() {
            return Ok(None);
        }
        let dir = self.shards.dir().join(kind.folder());
        let open = match Shards::open(open_store(&dir)?) {
            Ok(open) => open,
            Err(ShardError::NotInShards { .. }) => {
                let space = settings.provenance.space.clone().into();
                let plan = kind.plan(&settings.plan, &space, &settings.provenance.task, rounds)?;
                let Some(plan) = plan else { return Ok(None) };
                let provenance =
                    Provenance { space: space_of(&plan)?, question_sha256: None, ..settings.provenance.clone() };
                register_copy(&dir, &self.shards.dir(), &self.shards.settings().provenance);
                Shards::begin(create_store(&dir)?, self.shards.shards(), &plan, provenance)?
            }
            Err(error) => return Err(error.into()),
        };
        let mut arm = Self::of(open)?;
        if let Some(round) = arm.open_round()? {
            note(format_args!(
                "the {} is incomplete: {} shards are missing\nnext: robogate plan {} --next, then robogate merge {} again",
                kind.as_str(),
                round.missing.len(),
                quoted(&dir),
                quoted(&self.shards.dir())
            ));
            return Ok(None);
        }
        arm.merge(&folder, &mut |_: &Event| {}, opening)?;
        Ok(Some(folder))
    }

    /// The question of the campaign's gate, with the record that it compares with. Writes the question beside the merged run if it
    /// is not there. `None` for a campaign without a gate.
    pub fn question(&self, out: &Path) -> Option<(&Asked, Option<&Record>)> {
        let Gate { asked, other, .. } = self.gate.as_ref()?;
        if !out.join(Asked::FILE).exists() {
            write_question(out, asked);
        }
        Some((asked, other.as_ref()))
    }
}
