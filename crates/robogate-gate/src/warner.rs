//! What a warner changed: episodes that a warning stopped, slowed down or handed over, and what they become without it.

use std::collections::BTreeMap;

use robogate_core::{FailureMode, Word};
use robogate_dictionary::{OnWarning, Provenance};
use robogate_stats::format::{count, counted, percent};
use robogate_stats::{Confidence, Trials, clopper_pearson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{Ending, Trial};

/// The measure with the time of the first warning, in seconds.
pub const WARNED_S: Word = Word::constant("warned_s");
/// The failure mode of an episode that a warning stopped. It is not a failure of the policy by one of the task's own modes.
pub const WARNED_STOP: FailureMode = FailureMode::constant("warned_stop");
/// The failure mode of an episode that a person took over at a warning.
pub const HANDOVER: FailureMode = FailureMode::constant("handover");

/// The warner of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ActingWarner {
    /// What happens at a warning.
    pub on_warning: OnWarning,
    /// SHA-256 (hex) of the file of the detector.
    pub detector_sha256: String,
    /// The share of warned successes that the detector promises at most. `None` if its file does not say it.
    pub promised: Option<f64>,
}

impl ActingWarner {
    /// The warner of a record. `None` without one.
    pub(crate) fn of(provenance: &Provenance) -> Option<Self> {
        let record = provenance.world.as_ref()?.warner.as_ref()?;
        let file: Value = serde_json::from_str(&record.detector).unwrap_or_default();
        Some(Self {
            on_warning: record.on_warning,
            detector_sha256: record.sha256.clone(),
            promised: file.pointer("/calibration/promised").and_then(Value::as_f64),
        })
    }
}

/// How the valid episodes ended.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Endings {
    /// Successes.
    pub successes: u64,
    /// Failures by mode, without episodes that a warning ended.
    pub failures: BTreeMap<String, u64>,
}

impl Endings {
    fn add(&mut self, ending: &str) {
        match ending {
            "success" => self.successes += 1,
            mode => *self.failures.entry(mode.to_owned()).or_default() += 1,
        }
    }

    fn failed(&self) -> u64 {
        self.failures.values().sum()
    }
}

/// What a warner changed in the valid episodes of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WarnerEffect {
    /// The warner.
    pub warner: ActingWarner,
    /// The number of valid episodes.
    pub episodes: u64,
    /// How many were warned.
    pub warned: u64,
    /// How many a warning ended.
    pub ended: u64,
    /// Warned episodes that fail without the warner, and that do not fail by a mode of the task with it.
    pub avoided: u64,
    /// Warned episodes that fail without the warner, and with it too.
    pub not_avoided: u64,
    /// Warned episodes that succeed without the warner. A warner that stops makes false stops of them.
    pub false_warnings: u64,
    /// Those of them that fail with the warner.
    pub spoiled: u64,
    /// Failures without a warning.
    pub missed: u64,
    /// Warned episodes of which it is unknown what they become without the warner.
    pub unknown: u64,
    /// How the episodes ended.
    pub with: Endings,
    /// How they end without the warner. `None` if that is unknown for some of them.
    pub without: Option<Endings>,
}

/// How an episode ended, as one word. `None` for an invalid one.
fn word(ending: &Ending) -> Option<&str> {
    ending.is_valid().then(|| ending.as_str())
}

impl WarnerEffect {
    /// The effect in these episodes. `unwarned` are the endings of warned episodes without the warner, by index.
    pub fn of<'a>(
        warner: &ActingWarner,
        trials: impl Iterator<Item = &'a Trial>,
        unwarned: &BTreeMap<u64, String>,
    ) -> Self {
        let mut effect = Self {
            warner: warner.clone(),
            episodes: 0,
            warned: 0,
            ended: 0,
            avoided: 0,
            not_avoided: 0,
            false_warnings: 0,
            spoiled: 0,
            missed: 0,
            unknown: 0,
            with: Endings::default(),
            without: None,
        };
        let mut without = Endings::default();
        for trial in trials {
            let Some(ending) = word(&trial.ending) else { continue };
            effect.episodes += 1;
            let ended = [WARNED_STOP, HANDOVER].iter().any(|mode| mode.as_str() == ending);
            if ended {
                effect.ended += 1;
            } else {
                effect.with.add(ending);
            }
            let failed = !ended && ending != "success";
            if trial.measures.get(WARNED_S.as_str()).is_none() {
                effect.missed += u64::from(failed);
                without.add(ending);
                continue;
            }
            effect.warned += 1;
            // A warning that is only recorded changes nothing.
            let recorded = (warner.on_warning == OnWarning::Record).then_some(ending);
            match recorded.or_else(|| unwarned.get(&trial.index).map(String::as_str)) {
                None => effect.unknown += 1,
                Some("success") => {
                    effect.false_warnings += 1;
                    effect.spoiled += u64::from(failed);
                    without.add("success");
                }
                Some(mode) => {
                    *(if failed { &mut effect.not_avoided } else { &mut effect.avoided }) += 1;
                    without.add(mode);
                }
            }
        }
        effect.without = (effect.unknown == 0).then_some(without);
        effect
    }

    /// The effect in a few sentences.
    pub fn lines(&self) -> Vec<String> {
        let share = |n: u64, of: u64| percent(n as f64 / of.max(1) as f64);
        let (on, known) = (self.warner.on_warning, self.warned - self.unknown);
        let what = match on {
            OnWarning::Record => "were warned".to_owned(),
            OnWarning::Stop => "were stopped at a warning".to_owned(),
            OnWarning::Slow(periods) => {
                format!("were slowed down at a warning (each action takes {periods} control periods)")
            }
            OnWarning::Handover => "were handed over to a person at a warning".to_owned(),
        };
        let mut first = format!("Warner: {} of {} {what}.", count(self.warned), counted(self.episodes, "episode"));
        let missed = format!("{} came without a warning.", counted(self.missed, "failure"));
        let (would_fail, falsely) = (self.avoided + self.not_avoided, self.false_warnings);
        first += &match on {
            OnWarning::Record => {
                format!(" {} of them fail and {} succeed. {missed}", count(would_fail), count(falsely))
            }
            _ if self.warned == 0 => format!(" {missed}"),
            _ if known == 0 => {
                format!(" What they become without the warner is not recorded here. {missed}")
            }
            OnWarning::Slow(_) => format!(
                " Run again without the warner, {} of them fail, of which {} succeed in slow motion (avoided failures), and {} succeed, of \
                 which {} fail in slow motion. {missed}",
                count(would_fail),
                count(self.avoided),
                count(falsely),
                count(self.spoiled)
            ),
            OnWarning::Stop | OnWarning::Handover => format!(
                " Run again without the warner, {} of them fail (avoided failures) and {} succeed (false {}). {missed}",
                count(would_fail),
                count(falsely),
                if on == OnWarning::Stop { "stops" } else { "handovers" }
            ),
        };
        if known > 0 && self.unknown > 0 {
            first += &format!(" Of {} it is unknown.", counted(self.unknown, "warned episode"));
        }
        let mut lines = vec![first];
        let Some(without) = self.without.as_ref().filter(|_| self.warned > 0) else { return lines };
        if on != OnWarning::Record {
            let n = self.episodes;
            lines.push(format!(
                "With the warner, success is {} and failure {}; without it, success is {} and failure {}.{}",
                share(self.with.successes, n),
                share(self.with.failed(), n),
                share(without.successes, n),
                share(without.failed(), n),
                self.by_mode(without)
            ));
        }
        let would_succeed = Trials::new(falsely, without.successes).unwrap_or(Trials::NONE);
        // The two-sided interval of 90 % has 5 % on each side.
        let level = Confidence::new(0.9).unwrap_or(Confidence::P95);
        let promise = self
            .warner
            .promised
            .map_or_else(String::new, |promised| format!("; the detector promises at most {}", percent(promised)));
        if without.successes > 0 {
            lines.push(format!(
                "{} of {} that succeed without the warner are warned: {}, at most {} with 95 % confidence{promise}.",
                count(falsely),
                counted(without.successes, "episode"),
                share(falsely, without.successes),
                percent(clopper_pearson(would_succeed, level).high)
            ));
        }
        lines
    }

    /// Failures by mode, without and with the warner, where they differ.
    fn by_mode(&self, without: &Endings) -> String {
        let modes = without.failures.keys().chain(self.with.failures.keys());
        let modes: std::collections::BTreeSet<&String> = modes.collect();
        let of = |endings: &Endings, mode: &str| endings.failures.get(mode).copied().unwrap_or(0);
        let changed: Vec<String> = modes
            .into_iter()
            .map(|mode| (mode, of(&self.with, mode), of(without, mode)))
            .filter(|(_, with, without)| with != without)
            .map(|(mode, with, without)| format!("{mode} {} in place of {}", count(with), count(without)))
            .collect();
        if changed.is_empty() { String::new() } else { format!(" By mode: {}.", changed.join(", ")) }
    }
}
