//! Synthetic dictionaries: a known law, and many kinds of insufficient data. The tests of `robogate-report` use this
//! file too.

#[path = "episodes.rs"]
mod episodes;

use std::path::Path;
use std::sync::Arc;

use robogate_core::{Assignment, FailureMode, Fault, FaultKind, Outcome, ParameterSpace};
use robogate_dictionary::Entry;

pub(crate) use episodes::{entry, provenance, unit, write};

/// The analysis of these entries, written to a file and read back.
pub(crate) fn analysed(space: &ParameterSpace, entries: Vec<Entry>) -> robogate_analysis::Analysis {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dictionary.parquet");
    write(&path, space, entries);
    let source = robogate_analysis::Source::open(&path).unwrap();
    robogate_analysis::Analysis::of(&source, Path::new("test.parquet"), &[]).unwrap()
}

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

/// A point of the space, sampled uniformly.
pub(crate) fn point(space: &ParameterSpace, i: u64) -> Assignment {
    let parameters = space.parameters().iter().enumerate();
    parameters
        .map(|(p, of)| (Arc::clone(&of.name), of.domain.decode(of.domain.from_unit(unit(i, p as u64 + 1)))))
        .collect()
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

/// `n` episodes at random points, with these outcomes.
pub(crate) fn with_outcomes(n: u64, outcome_of: impl Fn(u64) -> Outcome) -> Vec<Entry> {
    let space = space(&["box", "sphere"]);
    (0..n).map(|i| entry(i, point(&space, i), outcome_of(i))).collect()
}
