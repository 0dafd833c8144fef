//! The identity of a suite, as a dictionary's provenance states it.

use robogate_core::Suite;
use sha2::{Digest, Sha256};

use crate::hex;

/// The identity of a suite: SHA-256 (hex) of its JSON without white space, in which neither the comments nor
/// the layout of its file are left.
pub fn suite_sha256(suite: &Suite) -> String {
    // A tree of strings, finite numbers and maps with string keys cannot fail to serialise.
    let json = serde_json::to_vec(suite).unwrap_or_default();
    hex(&Sha256::digest(json))
}
