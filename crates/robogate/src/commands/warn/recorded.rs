//! The recorded episodes of a run, as a detector learns from them.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::ops::ControlFlow;

use anyhow::anyhow;
use clap::Args;
use robogate_campaign::folder::DICTIONARY;
use robogate_core::{Assignment, Domain, ParameterSpace, Scenario, Signals, Word};
use robogate_dictionary::{Dictionary, Entry, OnWarning, Provenance, hex};
use robogate_gate::{WARNED_S, evidence};
use robogate_monitor::warn::{Conditions, Detector, EventRule, KnownParameter, MOST_SIGNALS, Scored, Track, score};
use robogate_session::{Reopening, SIGNALS, Subject, UnwarnedEnd, Workers, read_signals, unwarned};
use robogate_stats::format::{count, counted};
use sha2::{Digest, Sha256};

use crate::commands::run::stop_on_signal;
use crate::exit::{Exit, OrExit};
use crate::number;
use crate::terminal::note;

/// The run of a detector.
#[derive(Debug, Args)]
pub(super) struct RunArguments {
    /// Folder of a run; its episodes run again if it has no recorded signals (`run --record-signals`)
    #[arg(value_name = "DIR")]
    pub(super) run: std::path::PathBuf,
    /// Set the number of threads for episodes that run again; default: one for each core
    #[arg(long, value_name = "T", value_parser = number::threads)]
    threads: Option<NonZeroUsize>,
}

/// The episodes of a run.
#[derive(Clone)]
pub(super) struct Recorded {
    pub(super) conditions: Conditions,
    /// SHA-256 (hex) of the provenance of the run, which determines its episodes.
    pub(super) run: String,
    pub(super) signals: Signals,
    /// The parameters that vary.
    pub(super) parameters: Vec<KnownParameter>,
    pub(super) tracks: Vec<Track>,
    /// Episodes whose signals after a warning are not those of the policy alone, because a warner acted.
    pub(super) cut: BTreeSet<u64>,
    /// Those of them of which it is unknown how they end without the warner. They count as warned successes.
    pub(super) unknown: BTreeSet<u64>,
}

impl Recorded {
    /// The scores of the episodes. A success whose signals are cut at a warning has the highest score.
    pub(super) fn scores(&self, detector: &Detector, tracks: &[&Track]) -> Result<Vec<Scored>, Exit> {
        // An episode without an evaluation before its event cannot be warned; it counts as not warned.
        let mut scored: Vec<Scored> =
            tracks.iter().map(|track| score(detector, track)).collect::<Result<_, _>>().or_usage()?;
        for of in scored.iter_mut().filter(|of| of.failure.is_none() && self.cut.contains(&of.index)) {
            of.scores.iter_mut().rev().take(1).for_each(|last| *last = f64::INFINITY);
        }
        Ok(scored)
    }
}

impl RunArguments {
    /// Reads the run. `events` are the modes whose event is not the end of the episode, and `known` the parameters that the detector
    /// gets.
    pub(super) fn read(
        &self,
        events: &[EventRule],
        known: impl FnOnce(&[KnownParameter]) -> Result<Vec<KnownParameter>, Exit>,
    ) -> Result<(Recorded, Vec<KnownParameter>), Exit> {
        let dictionary = Dictionary::open(&self.run.join(DICTIONARY)).or_usage()?;
        let provenance = dictionary.provenance();
        let mut entries: BTreeMap<u64, Entry> = BTreeMap::new();
        for entry in dictionary.entries() {
            let entry = entry.or_usage()?;
            entries.insert(entry.index(), entry);
        }
        if !self.run.join(SIGNALS).is_file() {
            self.replay(provenance, &entries)?;
        }
        let parameters = varied(&provenance.space);
        let known = known(&parameters)?;
        // Without parameters, or with equal ones in all episodes, scenarios differ by their seed.
        let differ = entries.values().map(|entry| key(&entry.episode.scenario.requested)).collect::<BTreeSet<_>>();
        let repeats = differ.len() > 1;
        let (mut tracks, mut foreign) = (Vec::new(), 0_u64);
        let acts = provenance.world.as_ref().and_then(|world| world.warner.as_ref());
        let acts = acts.is_some_and(|warner| warner.on_warning != OnWarning::Record);
        let ends: BTreeMap<u64, UnwarnedEnd> =
            unwarned(&self.run, &dictionary)?.into_iter().map(|end| (end.index, end)).collect();
        let (mut cut, mut unknown) = (BTreeSet::new(), BTreeSet::new());
        let header = read_signals(&self.run, &mut |header, episode| {
            let Some(entry) = entries.get(&episode.index) else { return };
            if entry.episode.trajectory_hash != episode.trajectory_hash {
                foreign += 1;
                return;
            }
            let (width, numbers) = (header.width(), header.signals.width());
            let warned_s = entry.episode.measures.get(WARNED_S.as_str()).filter(|_| acts);
            let is_own = |row: &&[f32]| warned_s.is_none_or(|warned_s| f64::from(row[0]) <= warned_s + 1e-4);
            let rows = episode.numbers.chunks_exact(width).filter(is_own);
            let times: Vec<f32> = rows.clone().map(|row| row[0]).collect();
            let end = ends.get(&episode.index);
            if warned_s.is_some() {
                cut.insert(episode.index);
                unknown.extend(end.is_none().then_some(episode.index));
            }
            let failure = match &entry.episode.outcome {
                _ if warned_s.is_some() => end.map(|end| end.outcome.clone()).filter(|outcome| outcome != "success"),
                robogate_core::Outcome::Success => None,
                robogate_core::Outcome::Failure(mode) => Some(mode.as_str().to_owned()),
                robogate_core::Outcome::Invalid(_) => return,
            };
            // A policy that gave up ends an episode before its recorded time.
            let end_s = times.last().map_or(0.0, |last| f64::from(*last) + header.signals.period_s);
            let rule = events.iter().find(|rule| Some(&rule.mode) == failure.as_ref());
            let excess_s = rule.and_then(|rule| {
                let at = 1 + numbers + header.measures.iter().position(|name| name.as_str() == rule.measure)?;
                let row = rows.clone().find(|row| f64::from(row[at]) > rule.above)?;
                Some(f64::from(row[0]) + header.signals.period_s)
            });
            let requested = &entry.episode.scenario.requested;
            tracks.push(Track {
                index: episode.index,
                scenario: if repeats { key(requested) } else { episode.index },
                sampled: !entry.is_chosen(),
                failure,
                event_s: match (warned_s, end) {
                    (Some(_), Some(end)) => end.time_s,
                    (Some(_), None) => f64::INFINITY,
                    _ => entry.episode.time_s.min(end_s).min(excess_s.unwrap_or(f64::INFINITY)),
                },
                rows: rows.flat_map(|row| row[1..1 + numbers].iter().copied()).collect(),
                times,
                parameters: known.iter().map(|of| of.number_in(requested)).collect(),
                scenario_numbers: parameters.iter().map(|of| of.number_in(requested)).collect(),
            });
        })?;
        if foreign > 0 {
            return Err(anyhow!(
                "{}: {} of its {SIGNALS} are not those of the recorded episodes\nHint: the environment is not deterministic; repeat the \
                 run with --record-signals",
                self.run.display(),
                count(foreign)
            ))
            .or_usage();
        }
        if header.signals.width() == 0 || header.signals.width() > MOST_SIGNALS {
            return Err(anyhow!(
                "the task has {} numbers in each control period. Expected 1 to {MOST_SIGNALS}\nHint: observe fewer vectors",
                count(header.signals.width() as u64)
            ))
            .or_usage();
        }
        let valid = |entry: &&Entry| !matches!(entry.episode.outcome, robogate_core::Outcome::Invalid(_));
        let missing = entries.values().filter(valid).count().saturating_sub(tracks.len());
        if missing > 0 {
            note(format_args!(
                "note: {} of {} valid episodes have no signals and are left out. To record them again, remove {}",
                count(missing as u64),
                count(entries.values().filter(valid).count() as u64),
                self.run.join(SIGNALS).display()
            ));
        }
        if !unknown.is_empty() {
            note(format_args!(
                "note: a warner acted in {} whose end without it is unknown",
                counted(unknown.len() as u64, "episode")
            ));
        }
        let conditions = conditions(provenance);
        let run = hex(&Sha256::digest(provenance.to_json()));
        Ok((Recorded { conditions, run, signals: header.signals, parameters, tracks, cut, unknown }, known))
    }

    /// Runs the episodes again and records their signals.
    fn replay(&self, provenance: &Provenance, entries: &BTreeMap<u64, Entry>) -> Result<(), Exit> {
        let subject = Subject::recorded(provenance, Some(&self.run), &Reopening::default())?;
        let again = "Hint: repeat the run with `robogate run --record-signals`";
        if !subject.is_deterministic() || subject.many_worlds_engine().is_some() {
            return Err(anyhow!(
                "{}: it has no recorded signals, and its episodes cannot be repeated bit for bit\n{again}",
                self.run.display()
            ))
            .or_usage();
        }
        note(format_args!("{} episodes run again to record their signals", count(entries.len() as u64)));
        let stop = stop_on_signal()?;
        let scenarios: Vec<Scenario> = entries.values().map(|entry| entry.episode.scenario.clone()).collect();
        let workers = Workers { threads: self.threads, in_flight: None, stop: &stop };
        let done = workers.record_signals(&self.run, &subject, &scenarios, &mut |_| ControlFlow::Continue(()))?;
        if done < scenarios.len() {
            return Err(anyhow!("stopped after {} of {} episodes", count(done as u64), scenarios.len())).or_broken();
        }
        Ok(())
    }
}

/// The parameters of a space that vary.
fn varied(space: &ParameterSpace) -> Vec<KnownParameter> {
    let parameters = space.parameters().iter();
    let known = parameters.map(|parameter| KnownParameter {
        name: parameter.name.to_string(),
        choices: match &parameter.domain {
            Domain::Categorical { choices } => choices.iter().map(ToString::to_string).collect(),
            Domain::Continuous { .. } | Domain::Integer { .. } => Vec::new(),
        },
    });
    known.collect()
}

/// A number that equal scenarios have in common.
fn key(requested: &Assignment) -> u64 {
    let mut hash = Sha256::new();
    for (name, value) in requested.iter() {
        hash.update(format!("{name}={value:?};"));
    }
    let digest = hash.finalize();
    u64::from_le_bytes(std::array::from_fn(|i| digest[i]))
}

/// The conditions of episodes.
fn conditions(provenance: &Provenance) -> Conditions {
    let [task, engine, robot, policy, population] = evidence::conditions(provenance).map(|(_, text)| text);
    Conditions { task, engine, robot, policy, population }
}

/// A rule such as `jam=peak_contact_force_n>100`.
pub(super) fn event_rule(text: &str) -> Result<EventRule, String> {
    let parts = text.split_once('=').and_then(|(mode, rest)| Some((mode, rest.split_once('>')?)));
    let rule = parts.and_then(|(mode, (measure, above))| {
        let above = above.trim().parse().ok().filter(|above: &f64| above.is_finite())?;
        let word = |text: &str| Word::new(text.trim()).ok().map(|word| word.to_string());
        Some(EventRule { mode: word(mode)?, measure: word(measure)?, above })
    });
    rule.ok_or_else(|| "expected MODE=MEASURE>LIMIT, for example jam=peak_contact_force_n>100".to_owned())
}
