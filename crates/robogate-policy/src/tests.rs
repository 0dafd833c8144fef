//! Test helpers for dialects: captured bytes, and mutations of them.

use std::path::Path;

use rmpv::ValueRef;
use robogate_testing::fuzz;

use super::array::Array;
use super::msgpack;
use super::query::Query;

#[global_allocator]
static MEMORY: robogate_testing::CountingAllocator = robogate_testing::CountingAllocator;

/// Bytes of an upstream server or client.
pub(crate) struct Capture {
    pub(crate) bytes: Vec<u8>,
}

impl Capture {
    /// Read a file by dialect and name.
    pub(crate) fn read(folder: &str, name: &str) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures").join(folder).join(name);
        Self { bytes: std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())) }
    }

    pub(crate) fn msgpack(&self) -> ValueRef<'_> {
        msgpack::decode("capture", &self.bytes).unwrap()
    }
}

/// The query of a captured request. Arrays with three axes are images.
pub(crate) fn query(request: &ValueRef<'_>, instruction: &str) -> Query {
    let arrays: Vec<(String, Array)> = msgpack::entries(request)
        .unwrap()
        .iter()
        .filter_map(|(key, value)| Some((msgpack::name(key)?.to_owned(), msgpack::read_array("capture", value).ok()?)))
        .collect();
    let (images, states) = arrays.into_iter().partition(|(_, array)| array.shape().len() >= 3);
    Query { images, states, instruction: instruction.to_owned(), step: 0, time_s: 0.0 }
}

/// The kept inputs of a fuzz target.
pub(crate) fn corpus(target: &str) -> Vec<Vec<u8>> {
    fuzz::corpus(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(target))
}

/// Messages that a fuzz test tries.
pub(crate) const MESSAGES: u64 = 12_000;

/// Tries a decoder with mutations of the messages of a server that it accepts.
pub(crate) fn fuzz(name: &str, valid: &[Vec<u8>], decode: impl Fn(&[u8]) -> bool) {
    fuzz::Target { name, valid, kept: &[], words: WORDS, inputs: MESSAGES }.run(decode);
}

/// Words with a meaning for JSON and for the servers.
const WORDS: &[&str] = &[
    "{", "}", "[", "]", "null", "NaN", "Infinity", "1e999", "-1", "\"\"", "\\ud800", "[[[[[[[[", "actions", "dtype",
    "shape", "<f4", "|O", "error",
];
