//! Interned words: names of failure modes, measures, phases and observation vectors.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt;
use std::sync::{Mutex, PoisonError};

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A short name of 1 to 64 ASCII letters, digits, `_`, `-` and `.`.
/// Words are compared by their text. They are interned for the life of the process and copy as a reference: a million
/// episodes share one text per failure mode.
/// reference, so a million episodes share one text for each failure mode.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Word(&'static str);

/// The text of every word that was created at run time.
static INTERNED: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());

impl Word {
    /// Maximum length in bytes.
    pub const MAX_LENGTH: usize = 64;

    /// The word with this text. Returns an error if the text is not a valid word.
    pub fn new(text: &str) -> Result<Self, WordError> {
        if is_word(text.as_bytes()) {
            Ok(Self::intern(text))
        } else {
            Err(WordError { text: text.chars().take(2 * Self::MAX_LENGTH).collect() })
        }
    }

    /// Creates a word at compile time. Compilation fails if the text is not a valid word.
    pub const fn constant(text: &'static str) -> Self {
        assert!(is_word(text.as_bytes()), "not a word");
        Self(text)
    }

    /// The nearest valid word for any text: invalid characters become `_`, and long text is cut. `None` for a text
    /// without a letter or digit.
    pub fn nearest(text: &str) -> Option<Self> {
        let text = text.trim();
        let same = |c: char| if c.is_ascii_alphanumeric() || "_-.".contains(c) { c } else { '_' };
        let cut: String = text.chars().take(Self::MAX_LENGTH).map(same).collect();
        cut.chars().any(|c| c.is_ascii_alphanumeric()).then(|| Self::intern(&cut))
    }

    /// The text of the word.
    pub const fn as_str(self) -> &'static str {
        self.0
    }

    fn intern(text: &str) -> Self {
        // A panic in another thread cannot leave the set inconsistent.
        let mut interned = INTERNED.lock().unwrap_or_else(PoisonError::into_inner);
        match interned.get(text) {
            Some(known) => Self(known),
            None => {
                let new: &'static str = Box::leak(text.into());
                interned.insert(new);
                Self(new)
            }
        }
    }
}

const fn is_word(bytes: &[u8]) -> bool {
    let mut i = 0;
    while i < bytes.len() {
        if !(bytes[i].is_ascii_alphanumeric() || matches!(bytes[i], b'_' | b'-' | b'.')) {
            return false;
        }
        i += 1;
    }
    !bytes.is_empty() && bytes.len() <= Word::MAX_LENGTH
}

impl fmt::Display for Word {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.0)
    }
}

impl fmt::Debug for Word {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.0, f)
    }
}

impl PartialEq<str> for Word {
    fn eq(&self, other: &str) -> bool {
        self.0 == other
    }
}

impl PartialEq<&str> for Word {
    fn eq(&self, other: &&str) -> bool {
        self.0 == *other
    }
}

impl Serialize for Word {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0)
    }
}

impl<'de> Deserialize<'de> for Word {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = Cow::<str>::deserialize(deserializer)?;
        Self::new(&text).map_err(D::Error::custom)
    }
}

impl JsonSchema for Word {
    fn schema_name() -> Cow<'static, str> {
        "Word".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "pattern": "^[A-Za-z0-9_.-]{1,64}$",
            "description": "A short name: 1 to 64 letters, digits, `_`, `-` and `.`.",
        })
    }
}

/// A text that is not a valid word.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not a valid name: expected 1 to 64 letters, digits, `_`, `-` and `.`")]
pub struct WordError {
    /// The text, truncated if long.
    pub text: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_texts_are_one_word() {
        let (made, constant) = (Word::new("jam").unwrap(), Word::constant("jam"));
        assert_eq!(made, constant);
        assert!(std::ptr::eq(made.as_str(), Word::new("jam").unwrap().as_str()));
    }

    #[test]
    fn invalid_texts_are_rejected() {
        for text in ["", "two words", "ä", "a\n", &"x".repeat(65)] {
            assert!(Word::new(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn nearest_word_replaces_invalid_characters() {
        let nearest = |text| Word::nearest(text).map(Word::as_str);
        assert_eq!(nearest(" Object dropped! "), Some("Object_dropped_"));
        assert_eq!(nearest("??"), None);
        assert_eq!(nearest(&"x".repeat(100)).map(str::len), Some(64));
    }
}
