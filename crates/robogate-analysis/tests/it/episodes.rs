//! Synthetic episodes and dictionaries, for tests and simulations.

use std::path::Path;
use std::sync::Arc;

use robogate_core::{Assignment, Episode, FailureMode, Outcome, ParameterSpace, Scenario, Seed, Word};
use robogate_dictionary::{
    DictionaryError, Engine, Entry, Label, Platform, Provenance, Robot, SCHEMA_VERSION, Tool, v1, write_parquet,
};

const SEED: u64 = 7;

pub(crate) fn provenance(space: ParameterSpace) -> Provenance {
    Provenance {
        tool: Tool { name: "robogate".to_owned(), version: "0.0.0".to_owned() },
        schema_version: SCHEMA_VERSION,
        build: None,
        engine: Engine { name: "none".to_owned(), version: None, build_sha256: None },
        task: Arc::new(v1::task()),
        robot: Robot { name: "testbot".to_owned(), sha256: None, dimensions: None },
        policy: "scripted".to_owned(),
        world: None,
        space,
        plan: serde_json::Value::Null,
        seed: SEED,
        question_sha256: None,
        platform: Some(Platform { os: "test".to_owned(), arch: "test".to_owned(), libc: None, cpu: None, maths: None }),
        source: None,
    }
}

/// A number from 0 to 1 that depends only on `i` and `salt`.
pub(crate) fn unit(i: u64, salt: u64) -> f64 {
    let mut x = i.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ salt.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x ^= x >> 30;
    x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x ^= x >> 27;
    x = x.wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^= x >> 31;
    (x >> 11) as f64 / (1_u64 << 53) as f64
}

pub(crate) fn entry(i: u64, requested: Assignment, outcome: Outcome) -> Entry {
    let force = (outcome == Outcome::Failure(FailureMode::constant("collision"))).then(|| 10.0 + 90.0 * unit(i, 98));
    Entry {
        stage: "uniform".to_owned(),
        design: "uniform".to_owned(),
        weight: 1.0,
        label: Label::default(),
        episode: Episode {
            scenario: Scenario { index: i, seed: Seed::campaign(SEED).episode(i), requested },
            applied: Assignment::default(),
            outcome,
            time_s: 1.0 + unit(i, 97),
            phase: None,
            contact: None,
            measures: [(Word::constant("peak_contact_force_n"), force)].into_iter().collect(),
            draws: Default::default(),
            ticks: 10,
            trajectory_hash: i,
        },
    }
}

pub(crate) fn write(path: &Path, space: &ParameterSpace, entries: Vec<Entry>) {
    let entries = entries.into_iter().map(Ok::<_, DictionaryError>);
    write_parquet(path, &provenance(space.clone()), entries).unwrap();
}
