//! Test helpers for dialects: captured bytes, and mutations of them.

use std::path::Path;
use std::time::{Duration, Instant};

use rmpv::ValueRef;

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

/// The kept inputs of a fuzz target: messages that once found a defect, or that a rule of a decoder forbids.
pub(crate) fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(target);
    let mut paths: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// Messages that a fuzz test tries. More for `ROBOGATE_FUZZ_SECONDS` seconds.
const CASES: u64 = 12_000;

/// Calls `try_one` with a generator of numbers below a limit: [`CASES`] times, or for `ROBOGATE_FUZZ_SECONDS`.
pub(crate) fn cases(mut try_one: impl FnMut(&mut dyn FnMut(usize) -> usize)) {
    let seconds = std::env::var("ROBOGATE_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    let end = seconds.map(|seconds| Instant::now() + Duration::from_secs_f64(seconds));
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut draw = move |below: usize| {
        // xorshift64*: Marsaglia 2003, Vigna 2016.
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        (state.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) as usize % below.max(1)
    };
    let mut tried = 0_u64;
    while end.map_or(tried < CASES, |end| Instant::now() < end) {
        try_one(&mut draw);
        tried += 1;
    }
    println!("{tried} messages");
}

/// Feed mutated messages to a decoder. A panic fails the test.
pub(crate) fn fuzz(seeds: &[Vec<u8>], decode: impl Fn(&[u8])) {
    seeds.iter().for_each(|seed| decode(seed));
    cases(|draw| {
        let seed = &seeds[draw(seeds.len())];
        let mut bytes = seed.clone();
        for _ in 0..=draw(4) {
            let at = draw(bytes.len());
            match draw(6) {
                0 => bytes.truncate(at),
                1 => bytes.extend_from_slice(&seed[draw(seed.len())..]),
                2 => bytes.insert(at, draw(256) as u8),
                // Lengths near the limits of their integer types.
                3 => bytes.splice(at..at, [0xff, 0xff, 0xff, 0x7f]).for_each(drop),
                _ => {
                    if let Some(byte) = bytes.get_mut(at) {
                        *byte = draw(256) as u8;
                    }
                }
            }
        }
        decode(&bytes);
    });
}
