//! Binary encoding of entries.
//!
//! One encoding, little-endian and self-delimiting, has two forms. The *exact* form, used in the journal, restores the
//! same entry to the bit. The *canonical* form, used for the dataset hash, is the same for all equivalent entries:
//! assignments are sorted by name, an integer equals the same real number, and a measure that is not finite counts as
//! missing, as in Parquet.
//!
//! The canonical form writes failure modes and phases by their position in the task if declared, and the task's
//! measures in their order. This keeps the hashes of earlier versions, which knew one task, valid.

use std::sync::Arc;

use robogate_core::{
    Assignment, Contact, Episode, FailureMode, Fault, FaultKind, Measures, Outcome, Scenario, Seed, TaskSpec, Value,
    Word,
};

use crate::{Entry, Label};

/// Every class of fault, in the order of the codes.
pub(crate) const FAULT_KINDS: [FaultKind; 5] =
    [FaultKind::Diverged, FaultKind::Setup, FaultKind::NotApplied, FaultKind::BadAction, FaultKind::Unavailable];

/// The code of a class of fault: its index in [`FAULT_KINDS`]. A match, because the compiler then reports a missing
/// class.
fn fault_code(kind: FaultKind) -> u8 {
    match kind {
        FaultKind::Diverged => 0,
        FaultKind::Setup => 1,
        FaultKind::NotApplied => 2,
        FaultKind::BadAction => 3,
        FaultKind::Unavailable => 4,
    }
}

/// Largest magnitude up to which every integer is exact as a double.
pub(crate) const EXACT_INTEGER: i64 = 1 << 53;

/// Converts an integer to a double if that is exact.
pub(crate) fn integer_as_number(n: i64) -> Option<f64> {
    (-EXACT_INTEGER..=EXACT_INTEGER).contains(&n).then_some(n as f64)
}

/// Converts a double to an integer if that is exact. -0.0 would lose its sign and is not converted.
pub(crate) fn number_as_integer(x: f64) -> Option<i64> {
    let whole = x.trunc().to_bits() == x.to_bits() && x.abs() <= EXACT_INTEGER as f64;
    (whole && (x != 0.0 || x.is_sign_positive())).then_some(x as i64)
}

/// Appends the exact form of `entry`.
pub(crate) fn encode(entry: &Entry, out: &mut Vec<u8>) {
    Encoder { out, canonical: None }.entry(entry);
}

/// Appends the canonical form of `entry`, an episode of `task`.
pub(crate) fn encode_canonical(entry: &Entry, task: &TaskSpec, out: &mut Vec<u8>) {
    Encoder { out, canonical: Some(task) }.entry(entry);
}

struct Encoder<'a> {
    out: &'a mut Vec<u8>,
    /// The task, for the canonical form only.
    canonical: Option<&'a TaskSpec>,
}

impl Encoder<'_> {
    fn entry(&mut self, entry: &Entry) {
        let Entry { stage, design, weight, label, episode } = entry;
        let Episode { scenario, applied, outcome, time_s, phase, contact, measures, draws, ticks, trajectory_hash } =
            episode;
        self.u64(scenario.index);
        self.u64(scenario.seed.campaign_number());
        self.text(stage);
        self.text(design);
        self.f64(*weight);
        self.assignment(&scenario.requested);
        self.assignment(applied);
        match outcome {
            Outcome::Success => self.u8(0),
            Outcome::Failure(mode) => self.failure_mode(*mode),
            Outcome::Invalid(Fault { kind, detail }) => {
                self.u8(INVALID);
                self.u8(fault_code(*kind));
                self.text(detail);
            }
        }
        self.f64(*time_s);
        self.phase(*phase);
        // One byte marks which parts follow. Without a label it equals the byte of schema 1.0, which keeps records and
        // hashes of unlabelled episodes unchanged.
        // Draws follow from the scenario, so the hash, which covers the scenario, leaves them out. A dictionary keeps its
        // hash if its draws are computed later.
        let with_draws = self.canonical.is_none() && !draws.is_empty();
        self.u8(u8::from(contact.is_some()) * CONTACT
            + u8::from(!label.is_empty()) * LABEL
            + u8::from(with_draws) * DRAWS);
        if let Some(Contact { robot_body, other_body, force_n }) = contact {
            self.text(robot_body);
            self.text(other_body);
            self.f64(*force_n);
        }
        if !label.is_empty() {
            let Label { case, category, group } = label;
            for word in [case, category, group] {
                self.u8(u8::from(word.is_some()));
                if let Some(word) = word {
                    self.text(word);
                }
            }
        }
        self.measures(measures);
        if with_draws {
            self.numbers(draws);
        }
        self.u32(*ticks);
        self.u64(*trajectory_hash);
    }

    fn failure_mode(&mut self, mode: FailureMode) {
        let place = self.canonical.and_then(|task| task.modes().position(|known| known == mode));
        match place {
            Some(place) if place < usize::from(INVALID) - 1 => self.u8(1 + place as u8),
            _ => {
                self.u8(BY_NAME);
                self.text(mode.as_str());
            }
        }
    }

    fn phase(&mut self, phase: Option<Word>) {
        let Some(phase) = phase else { return self.u8(0) };
        let place = self.canonical.and_then(|task| task.phases.iter().position(|known| *known == phase));
        match place {
            Some(place) if place + 1 < usize::from(PHASE_BY_NAME) => self.u8(1 + place as u8),
            _ => {
                self.u8(PHASE_BY_NAME);
                self.text(phase.as_str());
            }
        }
    }

    fn measures(&mut self, measures: &Measures) {
        let Some(task) = self.canonical else {
            return self.numbers(measures);
        };
        for measure in &task.measures {
            match measures.get(measure.name.as_str()).filter(|x| x.is_finite()) {
                None => self.u8(0),
                Some(x) => {
                    self.u8(1);
                    self.f64(x);
                }
            }
        }
    }

    fn numbers(&mut self, numbers: &Measures) {
        self.u32(numbers.len() as u32);
        for (name, value) in numbers.iter() {
            self.text(name.as_str());
            self.f64(value);
        }
    }

    fn assignment(&mut self, assignment: &Assignment) {
        let mut pairs: Vec<(&str, &Value)> = assignment.iter().collect();
        if self.canonical.is_some() {
            pairs.sort_by_key(|(name, _)| *name);
        }
        self.u32(pairs.len() as u32);
        for (name, value) in pairs {
            self.text(name);
            match value {
                Value::Number(x) => {
                    self.u8(NUMBER);
                    self.f64(*x);
                }
                Value::Integer(n) => match integer_as_number(*n).filter(|_| self.canonical.is_some()) {
                    Some(x) => {
                        self.u8(NUMBER);
                        self.f64(x);
                    }
                    None => {
                        self.u8(INTEGER);
                        self.u64(n.cast_unsigned());
                    }
                },
                Value::Category(word) => {
                    self.u8(CATEGORY);
                    self.text(word);
                }
            }
        }
    }

    fn text(&mut self, text: &str) {
        self.u64(text.len() as u64);
        self.out.extend_from_slice(text.as_bytes());
    }

    fn f64(&mut self, x: f64) {
        let x = if self.canonical.is_some() && !x.is_finite() { f64::NAN } else { x };
        self.u64(x.to_bits());
    }

    fn u64(&mut self, n: u64) {
        self.out.extend_from_slice(&n.to_le_bytes());
    }

    fn u32(&mut self, n: u32) {
        self.out.extend_from_slice(&n.to_le_bytes());
    }

    fn u8(&mut self, n: u8) {
        self.out.push(n);
    }
}

/// The code of an invalid episode. Lower codes are the first failure modes of a task.
const INVALID: u8 = 5;
/// The code of a failure mode that is stored by name.
const BY_NAME: u8 = 6;
/// The code of a phase that is stored by name.
const PHASE_BY_NAME: u8 = u8::MAX;

const CONTACT: u8 = 1;
const LABEL: u8 = 2;
const DRAWS: u8 = 4;

const NUMBER: u8 = b'n';
const INTEGER: u8 = b'i';
const CATEGORY: u8 = b'c';

/// Shares names and words within a data set. Otherwise each row would own about twenty strings.
#[derive(Debug, Default)]
pub(crate) struct Interner(Vec<Arc<str>>);

impl Interner {
    /// Above this number, the lookup costs more than sharing saves.
    const LIMIT: usize = 256;

    pub(crate) fn get(&mut self, text: &str) -> Arc<str> {
        if let Some(known) = self.0.iter().find(|known| known.as_ref() == text) {
            return Arc::clone(known);
        }
        let new: Arc<str> = text.into();
        if self.0.len() < Self::LIMIT {
            self.0.push(Arc::clone(&new));
        }
        new
    }
}

/// Decodes the exact form. The error names the problem.
pub(crate) fn decode(bytes: &[u8], words: &mut Interner) -> Result<Entry, String> {
    let mut decoder = Decoder { rest: bytes, words };
    let entry = decoder.entry()?;
    match decoder.rest.len() {
        0 => Ok(entry),
        n => Err(format!("{n} unexpected bytes after the episode")),
    }
}

/// Decodes only the index of an entry.
pub(crate) fn decode_index(bytes: &[u8]) -> Option<u64> {
    Some(u64::from_le_bytes(*bytes.first_chunk()?))
}

struct Decoder<'a> {
    rest: &'a [u8],
    words: &'a mut Interner,
}

impl<'a> Decoder<'a> {
    fn entry(&mut self) -> Result<Entry, String> {
        let index = self.u64()?;
        let seed = Seed::campaign(self.u64()?).episode(index);
        let stage = self.text()?.to_owned();
        let design = self.text()?.to_owned();
        let weight = self.f64()?;
        let scenario = Scenario { index, seed, requested: self.assignment()? };
        let applied = self.assignment()?;
        let outcome = match self.u8()? {
            0 => Outcome::Success,
            INVALID => {
                let kind = *pick(&FAULT_KINDS, self.u8()?, "class of fault")?;
                Outcome::Invalid(Fault::new(kind, self.text()?))
            }
            BY_NAME => Outcome::Failure(FailureMode::new(self.text()?).map_err(|why| why.to_string())?),
            code => return Err(format!("{code} is not the code of an outcome")),
        };
        let time_s = self.f64()?;
        let phase = match self.u8()? {
            0 => None,
            PHASE_BY_NAME => Some(self.name()?),
            code => return Err(format!("{code} is not the code of a phase")),
        };
        let there = match self.u8()? {
            there if there & !(CONTACT | LABEL | DRAWS) == 0 => there,
            code => return Err(format!("{code} is not a valid mark for contact, label and draws")),
        };
        let contact = if there & CONTACT != 0 {
            let (robot_body, other_body) = (self.text()?.to_owned(), self.text()?.to_owned());
            Some(Contact { robot_body, other_body, force_n: self.f64()? })
        } else {
            None
        };
        let label = if there & LABEL != 0 {
            Label { case: self.optional_text()?, category: self.optional_text()?, group: self.optional_text()? }
        } else {
            Label::default()
        };
        let measures = self.numbers()?;
        let draws = if there & DRAWS != 0 { self.numbers()? } else { Measures::default() };
        let ticks = u32::from_le_bytes(self.array()?);
        let trajectory_hash = self.u64()?;
        let episode =
            Episode { scenario, applied, outcome, time_s, phase, contact, measures, draws, ticks, trajectory_hash };
        Ok(Entry { stage, design, weight, label, episode })
    }

    fn numbers(&mut self) -> Result<Measures, String> {
        let count = u32::from_le_bytes(self.array()?);
        (0..count).map(|_| Ok((self.name()?, Some(self.f64()?)))).collect()
    }

    fn assignment(&mut self) -> Result<Assignment, String> {
        let pairs = u32::from_le_bytes(self.array()?);
        (0..pairs)
            .map(|_| {
                let name = self.word()?;
                let value = match self.u8()? {
                    NUMBER => Value::Number(self.f64()?),
                    INTEGER => Value::Integer(self.u64()?.cast_signed()),
                    CATEGORY => Value::Category(self.word()?),
                    code => return Err(format!("{code} is not a kind of value")),
                };
                Ok((name, value))
            })
            .collect()
    }

    fn name(&mut self) -> Result<Word, String> {
        Word::new(self.text()?).map_err(|why| why.to_string())
    }

    fn optional_text(&mut self) -> Result<Option<String>, String> {
        if self.flag()? { self.text().map(|text| Some(text.to_owned())) } else { Ok(None) }
    }

    fn flag(&mut self) -> Result<bool, String> {
        match self.u8()? {
            0 => Ok(false),
            1 => Ok(true),
            code => Err(format!("{code} is neither 0 nor 1")),
        }
    }

    fn word(&mut self) -> Result<Arc<str>, String> {
        let text = self.text()?;
        Ok(self.words.get(text))
    }

    fn text(&mut self) -> Result<&'a str, String> {
        let length = self.u64()?;
        let (text, rest) = usize::try_from(length)
            .ok()
            .and_then(|length| self.rest.split_at_checked(length))
            .ok_or_else(|| format!("a text of {length} bytes where {} are left", self.rest.len()))?;
        self.rest = rest;
        std::str::from_utf8(text).map_err(|e| format!("a text is not UTF-8: {e}"))
    }

    fn f64(&mut self) -> Result<f64, String> {
        self.u64().map(f64::from_bits)
    }

    fn u64(&mut self) -> Result<u64, String> {
        self.array().map(u64::from_le_bytes)
    }

    fn u8(&mut self) -> Result<u8, String> {
        self.array().map(|[byte]| byte)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (head, rest) = self.rest.split_first_chunk().ok_or("unexpected end of the record")?;
        self.rest = rest;
        Ok(*head)
    }
}

fn pick<'a, T>(all: &'a [T], code: u8, what: &str) -> Result<&'a T, String> {
    all.get(usize::from(code)).ok_or_else(|| format!("{code} is not the code of a {what}"))
}
