//! The rounds of the active stage in a campaign in shards.
//!
//! The points of such a round follow from a model of all earlier episodes. The first process that needs them fits the model
//! and stores the points, so all shards use the same ones, also on machines whose C library rounds differently.

use std::sync::Arc;

use robogate_core::Foresight;
use robogate_dictionary::Entry;
use robogate_risk::all_processors;

use super::{ShardError, ShardRound, Shards, get, store};
use crate::RunError;
use crate::active::{Chooser, Opened};
use crate::folder;

impl Shards {
    /// The round of the active stage whose points are the next ones to choose. All rounds before it are complete. The number after
    /// the last round stands for the report on the model of all episodes. `None` if nothing can be chosen now.
    pub fn unchosen(&self) -> Result<Option<ShardRound>, ShardError> {
        let Some(stage) = &self.plan().active else { return Ok(None) };
        let committed = self.committed(&self.files()?)?;
        let rounds = stage.rounds(self.plan().uniform.episodes).len() as u64;
        let mut before = ShardRound::Uniform;
        for number in 0..=rounds {
            if !self.missing(&committed, before).is_empty() {
                return Ok(None);
            }
            before = ShardRound::Active(number);
            match self.chosen(number)? {
                None => return Ok(Some(before)),
                Some(chosen) if chosen.points.is_empty() => return Ok(None),
                Some(_) => {}
            }
        }
        Ok(None)
    }

    /// Chooses and stores the points of the round that [`Self::unchosen`] returns. `foresight` is that of the campaign's
    /// environment.
    pub fn choose(&self, round: ShardRound, foresight: Option<Arc<dyn Foresight>>) -> Result<(), ShardError> {
        let ShardRound::Active(number) = round else { return Ok(()) };
        // No shard can run meanwhile, so all processors are free.
        let threads = all_processors();
        let Some(mut chooser) = Chooser::new(self.plan(), &self.space, foresight, threads) else {
            return Ok(());
        };
        for before in std::iter::once(ShardRound::Uniform).chain((0..number).map(ShardRound::Active)) {
            let mut entries = self.entries(before).collect::<Result<Vec<Entry>, _>>()?;
            entries.sort_unstable_by_key(Entry::index);
            entries.iter().for_each(|entry| chooser.add(entry));
        }
        // A plan has far fewer rounds than numbers.
        let opened = chooser.open(usize::try_from(number).unwrap_or(usize::MAX))?;
        let name = name(number);
        let path = self.store.place(&name);
        let text = folder::document_bytes(&opened).map_err(|source| RunError::Unreadable { path, source })?;
        self.put_equal(&name, &text)?;
        Ok(())
    }

    /// The stored points of a round.
    pub(super) fn chosen(&self, number: u64) -> Result<Option<Opened>, ShardError> {
        let name = name(number);
        let Some(text) = get(&*self.store, &name)? else { return Ok(None) };
        let path = self.store.place(&name);
        let opened: Opened = folder::parse(&path, &text)?;
        let indices = ShardRound::Active(number).indices(self.plan());
        let points = opened.points.len() as u64;
        if points > 0 && points != indices.end - indices.start {
            let reason = format!("it has {points} points, expected {}", indices.end - indices.start);
            return Err(ShardError::Damaged { path, reason });
        }
        Ok(Some(opened))
    }

    /// Whether the active stage ended before this round.
    pub(super) fn is_over(&self, round: ShardRound) -> Result<bool, ShardError> {
        match round {
            ShardRound::Active(number) => Ok(self.chosen(number)?.is_some_and(|chosen| chosen.points.is_empty())),
            _ => Ok(false),
        }
    }

    /// All stored rounds of the active stage. The last one, without points, must be among them.
    pub(super) fn all_chosen(&self) -> Result<Vec<Opened>, ShardError> {
        let mut all = Vec::new();
        if self.plan().active.is_none() {
            return Ok(all);
        }
        for number in 0.. {
            let round = ShardRound::Active(number);
            let chosen = self.chosen(number)?.ok_or(ShardError::NotChosen { dir: self.dir(), round })?;
            let last = chosen.points.is_empty();
            all.push(chosen);
            if last {
                break;
            }
        }
        Ok(all)
    }
}

/// The name of a round's points in the store.
fn name(number: u64) -> String {
    format!("{}/{}.json", store::SHARDS, ShardRound::Active(number))
}
