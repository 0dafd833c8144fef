//! Synthetic dictionaries: a known law, and many kinds of insufficient data. The tests of `robogate-report` use this
//! file too.

use std::path::Path;
use std::sync::Arc;

use robogate_core::{
    Assignment, Episode, FailureMode, Fault, FaultKind, Outcome, ParameterSpace, Scenario, Seed, Word,
};
use robogate_dictionary::{
    DictionaryError, Engine, Entry, Label, Platform, Provenance, Robot, SCHEMA_VERSION, Tool, v1, write_parquet,
};

const SEED: u64 = 7;

/// A space of friction, mass, obstacles and a shape with these levels.
pub(crate) fn space(shapes: &[&str]) -> ParameterSpace {
    let choices: Vec<String> = shapes.iter().map(|shape| format!("{shape:?}")).collect();
    ParameterSpace::from_toml(&format!(
        r#"
        name = "test"
        [[parameter]]
        name = "friction"
        kind = "continuous"
        low = 0.05
        high = 1.2
        scale = "log"
        [[parameter]]
        name = "mass_kg"
        kind = "continuous"
        low = 0.05
        high = 2.0
        [[parameter]]
        name = "obstacles"
        kind = "integer"
        low = 0
        high = 3
        [[parameter]]
        name = "shape"
        kind = "categorical"
        choices = [{}]
        "#,
        choices.join(", ")
    ))
    .unwrap()
}

pub(crate) fn provenance(space: ParameterSpace) -> Provenance {
    Provenance {
        tool: Tool { name: "robogate".to_owned(), version: "0.0.0".to_owned() },
        schema_version: SCHEMA_VERSION,
        engine: Engine { name: "none".to_owned(), version: None, build_sha256: None },
        task: Arc::new(v1::task()),
        robot: Robot { name: "testbot".to_owned(), sha256: None, dimensions: None },
        policy: "scripted".to_owned(),
        world: serde_json::Value::Null,
        space,
        plan: serde_json::Value::Null,
        seed: SEED,
        platform: Some(Platform { os: "test".to_owned(), arch: "test".to_owned() }),
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

/// A point of the space, sampled uniformly.
pub(crate) fn point(space: &ParameterSpace, i: u64) -> Assignment {
    let parameters = space.parameters().iter().enumerate();
    parameters
        .map(|(p, of)| (Arc::clone(&of.name), of.domain.decode(of.domain.from_unit(unit(i, p as u64 + 1)))))
        .collect()
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
            ticks: 10,
            trajectory_hash: i,
        },
    }
}

/// P(success) = logistic(-1 + 6 friction - 2 mass). Light objects are missed, heavy ones lost, and some episodes
/// collide.
pub(crate) fn outcome(i: u64, requested: &Assignment) -> Outcome {
    let friction = requested.number("friction").unwrap();
    let mass = requested.number("mass_kg").unwrap();
    let p = 1.0 / (1.0 + (1.0 - 6.0 * friction + 2.0 * mass).exp());
    if unit(i, 99) < p {
        Outcome::Success
    } else if unit(i, 96) < 0.2 {
        Outcome::Failure(FailureMode::constant("collision"))
    } else if mass > 1.0 {
        Outcome::Failure(FailureMode::constant("grip_loss"))
    } else {
        Outcome::Failure(FailureMode::constant("grasp_miss"))
    }
}

/// `n` episodes of the law. Every fiftieth is invalid.
pub(crate) fn law(space: &ParameterSpace, n: u64) -> Vec<Entry> {
    (0..n)
        .map(|i| {
            let requested = point(space, i);
            let outcome = if i % 50 == 49 {
                Outcome::Invalid(Fault::new(FaultKind::Diverged, "made up"))
            } else {
                outcome(i, &requested)
            };
            entry(i, requested, outcome)
        })
        .collect()
}

pub(crate) fn write(path: &Path, space: &ParameterSpace, entries: Vec<Entry>) {
    let entries = entries.into_iter().map(Ok::<_, DictionaryError>);
    write_parquet(path, &provenance(space.clone()), entries).unwrap();
}

/// The analysis of these entries, written to a file and read back.
pub(crate) fn analysed(space: &ParameterSpace, entries: Vec<Entry>) -> robogate_analysis::Analysis {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dictionary.parquet");
    write(&path, space, entries);
    let source = robogate_analysis::Source::open(&path).unwrap();
    robogate_analysis::Analysis::of(&source, Path::new("test.parquet"), &[]).unwrap()
}

/// `n` episodes at random points, with these outcomes.
pub(crate) fn with_outcomes(n: u64, outcome_of: impl Fn(u64) -> Outcome) -> Vec<Entry> {
    let space = space(&["box", "sphere"]);
    (0..n).map(|i| entry(i, point(&space, i), outcome_of(i))).collect()
}
