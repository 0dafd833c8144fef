//! Budgets for decoding text that another program wrote.
//!
//! A decoder needs more memory than its input has bytes: the seven bytes `{"":0},` become a tree node of 632 bytes. A
//! [`Budget`] counts the values of a text in one pass, without allocation, before a decoder sees it. Time and memory of
//! the decoder are then at most proportional to the budget.

use serde::de::DeserializeOwned;

/// Memory that one charged value may need once it is decoded, in bytes. A JSON value has 32 bytes, and a growing list
/// reserves twice its length.
pub const BYTES_PER_VALUE: usize = 64;

/// Values that an object is charged for: its first entry reserves room for eleven.
const OBJECT: usize = 16;

/// Limits on one text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Largest text, in bytes.
    pub bytes: usize,
    /// Most values. An object counts as 16.
    pub values: usize,
    /// Deepest nesting of lists and objects.
    pub depth: usize,
}

/// The limit that a text exceeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum OverBudget {
    /// Too many bytes.
    #[error("it has {found} bytes. At most {limit} are accepted")]
    Bytes {
        /// Size of the text.
        found: usize,
        /// The limit.
        limit: usize,
    },
    /// Too many values.
    #[error("it has too many values by byte {at}. At most {limit} are accepted, and an object counts as {OBJECT}")]
    Values {
        /// Position of the first value above the limit.
        at: usize,
        /// The limit.
        limit: usize,
    },
    /// Nested too deeply.
    #[error("its lists and objects are nested too deeply at byte {at}. At most {limit} levels are accepted")]
    Depth {
        /// Position of the first list or object above the limit.
        at: usize,
        /// The limit.
        limit: usize,
    },
}

/// The reason why a JSON text was not decoded.
#[derive(Debug, thiserror::Error)]
pub enum JsonError {
    /// It exceeds a budget.
    #[error(transparent)]
    OverBudget(#[from] OverBudget),
    /// It is not JSON, or not of the expected form.
    #[error(transparent)]
    Syntax(#[from] serde_json::Error),
}

/// The reason why a TOML text was not decoded.
#[derive(Debug, thiserror::Error)]
pub enum TomlError {
    /// It exceeds a budget.
    #[error(transparent)]
    OverBudget(#[from] OverBudget),
    /// It is not TOML, or not of the expected form.
    #[error(transparent)]
    Syntax(#[from] toml::de::Error),
}

impl Budget {
    /// A reply of a policy server. A chunk of a thousand actions with 32 numbers has 33,000 values.
    pub const REPLY: Self = Self { bytes: 64 << 20, values: 1 << 18, depth: 64 };

    /// A file or a part of a file. A suite of 10,000 scenarios with 20 parameters has about 500,000 values.
    pub const FILE: Self = Self { bytes: 64 << 20, values: 1 << 22, depth: 100 };

    /// Checks the size of a text.
    pub fn check_bytes(&self, bytes: usize) -> Result<(), OverBudget> {
        if bytes > self.bytes {
            return Err(OverBudget::Bytes { found: bytes, limit: self.bytes });
        }
        Ok(())
    }

    /// Checks a JSON text. Text that is not JSON may pass: its decoder rejects it.
    pub fn check_json(&self, text: &[u8]) -> Result<(), OverBudget> {
        self.check_bytes(text.len())?;
        let (mut values, mut depth) = (1, 0_usize);
        let mut bytes = text.iter().enumerate();
        while let Some((at, byte)) = bytes.next() {
            match byte {
                b'"' => loop {
                    match bytes.next() {
                        Some((_, b'\\')) => drop(bytes.next()),
                        Some((_, b'"')) | None => break,
                        Some(_) => {}
                    }
                },
                b'[' | b'{' => {
                    depth += 1;
                    values += if *byte == b'{' { OBJECT } else { 1 };
                    if depth > self.depth {
                        return Err(OverBudget::Depth { at, limit: self.depth });
                    }
                }
                b']' | b'}' => depth = depth.saturating_sub(1),
                b',' | b':' => values += 1,
                _ => {}
            }
            if values > self.values {
                return Err(OverBudget::Values { at, limit: self.values });
            }
        }
        Ok(())
    }

    /// Checks a TOML text. Text that is not TOML may pass: its decoder rejects it. Signs in strings and comments count too.
    pub fn check_toml(&self, text: &str) -> Result<(), OverBudget> {
        self.check_bytes(text.len())?;
        let bytes = text.as_bytes();
        let mut values = 1;
        for (at, byte) in bytes.iter().enumerate() {
            values += match byte {
                b'[' | b'{' => OBJECT,
                // A dotted key is a table for each dot; a dot before a digit belongs to a number.
                b'.' if bytes.get(at + 1).is_some_and(|next| next.is_ascii_alphabetic() || b"_-\"'".contains(next)) => {
                    OBJECT
                }
                b'=' | b',' => 1,
                _ => 0,
            };
            if values > self.values {
                return Err(OverBudget::Values { at, limit: self.values });
            }
        }
        Ok(())
    }

    /// Checks a TOML text and decodes it.
    pub fn toml<T: DeserializeOwned>(&self, text: &str) -> Result<T, TomlError> {
        self.check_toml(text)?;
        Ok(toml::from_str(text)?)
    }

    /// Checks a JSON text and decodes it.
    pub fn json<T: DeserializeOwned>(&self, text: &[u8]) -> Result<T, JsonError> {
        self.check_json(text)?;
        Ok(serde_json::from_slice(text)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: Budget = Budget { bytes: 1_000, values: 40, depth: 4 };

    #[test]
    fn texts_within_the_budget_are_decoded() {
        let text = br#"{"a\"[[[[[": [1, 2, {"b": "]]{{{{,,,,"}], "c": null}"#;
        let decoded: serde_json::Value = SMALL.json(text).unwrap();
        assert_eq!(decoded, serde_json::from_slice::<serde_json::Value>(text).unwrap());
    }

    #[test]
    fn tables_of_toml_are_counted() {
        let check = |text: &str| SMALL.check_toml(text);
        assert_eq!(check("a = 1.5\n[b]\nc = [0.25, 0.5]\n"), Ok(()));
        for text in ["[a]\n[b]\n[c]\n", "a.b.c.d = 1", "a = {b = {c = {}}}"] {
            assert!(matches!(check(text), Err(OverBudget::Values { limit: 40, .. })), "{text}");
        }
        assert_eq!(check(&"#".repeat(1_001)), Err(OverBudget::Bytes { found: 1_001, limit: 1_000 }));
        assert_eq!(SMALL.toml::<toml::Table>("a = 1").unwrap().len(), 1);
        assert!(matches!(SMALL.toml::<toml::Table>("a = "), Err(TomlError::Syntax(_))));
    }

    #[test]
    fn each_limit_is_reported() {
        let check = |text: &str| SMALL.check_json(text.as_bytes()).unwrap_err();
        assert_eq!(check(&" ".repeat(1_001)), OverBudget::Bytes { found: 1_001, limit: 1_000 });
        assert_eq!(check("[[[[[1]]]]]"), OverBudget::Depth { at: 4, limit: 4 });
        assert_eq!(check(&format!("[{}1]", "1,".repeat(50))), OverBudget::Values { at: 78, limit: 40 });
        assert_eq!(check("[{},{},{}]"), OverBudget::Values { at: 7, limit: 40 });
    }

    #[test]
    fn brackets_in_texts_are_not_counted() {
        let text = format!("\"{}\"", "[{,:\\\"".repeat(100));
        assert_eq!(SMALL.check_json(text.as_bytes()), Ok(()));
        // An unclosed text is the decoder's error.
        assert!(matches!(SMALL.json::<String>(b"\"[[[[[[[[").unwrap_err(), JsonError::Syntax(_)));
    }
}
