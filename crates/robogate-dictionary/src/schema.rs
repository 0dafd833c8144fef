//! The version of the dictionary's schema.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

/// The version that this crate writes, and the oldest one that it reads.
pub const SCHEMA_VERSION: SchemaVersion = SchemaVersion { major: 4, minor: 0 };

/// A version of the dictionary's schema, in the form `major.minor`.
///
/// A minor version adds columns, so newer ones of the same major version are readable. A major version changes the columns
/// or their meaning, so all other ones are rejected. Older versions are rejected too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SchemaVersion {
    /// Increases when the meaning of a column changes or a column is removed.
    pub major: u32,
    /// Increases when a column is added.
    pub minor: u32,
}

impl SchemaVersion {
    /// Whether this crate can read a file of this version.
    pub fn is_readable(self) -> bool {
        SCHEMA_VERSION <= self && self.major == SCHEMA_VERSION.major
    }
}

impl fmt::Display for SchemaVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}

impl FromStr for SchemaVersion {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a schema version (major.minor, as in {SCHEMA_VERSION})");
        let (major, minor) = text.split_once('.').ok_or_else(wrong)?;
        match (major.parse(), minor.parse()) {
            (Ok(major), Ok(minor)) => Ok(Self { major, minor }),
            _ => Err(wrong()),
        }
    }
}

impl TryFrom<String> for SchemaVersion {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<SchemaVersion> for String {
    fn from(version: SchemaVersion) -> Self {
        version.to_string()
    }
}

impl JsonSchema for SchemaVersion {
    fn schema_name() -> Cow<'static, str> {
        "SchemaVersion".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "pattern": "^[0-9]+\\.[0-9]+$",
            "description": "Version of the dictionary's schema, major.minor.",
        })
    }
}
