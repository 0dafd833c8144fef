//! Episodes compared with their nominal twins.

use robogate_core::{FailureMode, Value};
use robogate_gate::{Effect, Ending, GateError, Record, Sampling, Twins};

use crate::common::{failed, invalid, sampled, suite};

const MISS: FailureMode = FailureMode::constant("grasp_miss");

fn ending(success: bool) -> Ending {
    if success { Ending::Success } else { failed(MISS) }
}

/// A suite of four scenarios in `rounds` rounds: the parameter `friction` differs from its nominal value in the groups 1, 2
/// and 3.
fn arm(rounds: u64, friction: impl Fn(u64) -> f64, success: impl Fn(u64) -> bool) -> Record {
    let mut record = suite(4, (0..4 * rounds).map(|i| ending(success(i))));
    for trial in &mut record.trials {
        trial.requested.set("friction", Value::Number(friction(trial.index % 4)));
    }
    record.planned = Some(4 * rounds);
    record
}

#[test]
fn groups_are_families_with_paired_effects() {
    // Group 1 always fails with the perturbation only, group 2 fails in both arms, group 3 has no effect.
    let perturbed = arm(20, |case| case as f64, |i| ![1, 2].contains(&(i % 4)));
    let nominal = arm(20, |_| 0.0, |i| i % 4 != 2);
    let twins = Twins::of(&perturbed, &nominal, Sampling::Fixed).unwrap();
    let of: Vec<(&str, Effect)> = twins.families.iter().map(|of| (of.family.as_str(), of.effect)).collect();
    assert_eq!(
        of,
        [
            ("edge_cases/group-1", Effect::Harmful),
            ("nominal/group-2", Effect::NotSignificant),
            ("edge_cases/group-3", Effect::NotSignificant)
        ]
    );
    assert_eq!((twins.pairs, twins.unperturbed, twins.already_failing, twins.looks), (60, 20, 20, 1));
    assert_eq!((twins.families[0].new_failures, twins.families[1].already_failing), (20, 20));
    let text = twins.lines().join(" ");
    assert!(text.contains("20 of 40 failures also fail without the perturbation"), "{text}");
    assert!(text.contains("Shown to lower the success rate: edge_cases/group-1."), "{text}");
    // One failure proves nothing.
    let few = Twins::of(&arm(1, |case| case as f64, |i| i != 1), &arm(1, |_| 0.0, |_| true), Sampling::Fixed).unwrap();
    assert!(few.families.iter().all(|of| of.effect == Effect::NotSignificant));
    assert!(few.lines().join(" ").contains("No perturbation is shown to lower the success rate."));
}

#[test]
fn early_stopping_widens_the_intervals() {
    let (perturbed, nominal) = (arm(8, |case| case as f64, |i| i % 8 != 1), arm(8, |_| 0.0, |_| true));
    let width = |sampling| {
        let twins = Twins::of(&perturbed, &nominal, sampling).unwrap();
        (twins.looks, twins.families[0].interval_95[1] - twins.families[0].interval_95[0])
    };
    let (fixed, sequential) = (width(Sampling::Fixed), width(Sampling::Sequential));
    assert_eq!((fixed.0, sequential.0), (1, 8));
    assert!(sequential.1 > fixed.1);
}

#[test]
fn other_seeds_are_not_twins() {
    let (perturbed, mut nominal) = (arm(2, |case| case as f64, |_| true), arm(2, |_| 0.0, |_| true));
    nominal.trials[3].seed = 2;
    assert!(matches!(Twins::of(&perturbed, &nominal, Sampling::Fixed), Err(GateError::NotPaired { index: 3, .. })));
    nominal.trials.remove(3);
    assert_eq!(Twins::of(&perturbed, &nominal, Sampling::Fixed).unwrap().unpaired, 1);
}

#[test]
fn invalid_twins_can_have_had_any_result() {
    let perturbed = arm(10, |case| case as f64, |i| i % 4 != 1);
    let mut nominal = arm(10, |_| 0.0, |_| true);
    assert_eq!(Twins::of(&perturbed, &nominal, Sampling::Fixed).unwrap().families[0].effect, Effect::Harmful);
    nominal.trials.iter_mut().filter(|trial| trial.index % 4 == 1).for_each(|trial| trial.ending = invalid());
    let twins = Twins::of(&perturbed, &nominal, Sampling::Fixed).unwrap();
    assert_eq!((twins.families[0].invalid, twins.families[0].effect), (10, Effect::NotSignificant));
}

/// Imported rows of one task: seeds in order, and the perturbation in the category.
fn imported(category: &str, seeds: std::ops::Range<i64>, success: impl Fn(i64) -> bool) -> Record {
    let mut record = sampled(seeds.clone().map(|seed| ending(success(seed))));
    record.imported = true;
    record.stopping = Some(robogate_dictionary::Stopping::Fixed);
    for (trial, seed) in record.trials.iter_mut().zip(seeds) {
        trial.label.case = Some("lift".to_owned());
        trial.label.category = Some(category.to_owned());
        trial.requested.set("source_seed", Value::Integer(seed));
    }
    record
}

#[test]
fn imported_arms_are_paired_by_task_and_seed() {
    let nominal = imported("none", 0..30, |_| true);
    let camera = imported("camera", 10..40, |seed| seed % 2 == 0);
    let twins = Twins::of(&camera, &nominal, Sampling::Fixed).unwrap();
    let family = &twins.families[0];
    assert_eq!((family.family.as_str(), family.pairs, family.new_failures), ("camera", 20, 10));
    assert_eq!((family.effect, twins.unpaired), (Effect::Harmful, 20));

    // Both arms in one file.
    let mut one = nominal;
    let from = one.trials.len() as u64;
    let more = camera.trials.into_iter().chain(imported("light", 0..30, |seed| seed != 4).trials);
    one.trials.extend(more);
    one.trials.iter_mut().zip(0..).skip(from as usize).for_each(|(trial, index)| trial.index = index);
    let twins = Twins::within(&one, "category", "none", Sampling::Fixed).unwrap();
    let of: Vec<(&str, u64, Effect)> =
        twins.families.iter().map(|of| (of.family.as_str(), of.pairs, of.effect)).collect();
    assert_eq!(of, [("camera", 20, Effect::Harmful), ("light", 30, Effect::NotSignificant)]);
    assert!(matches!(
        Twins::within(&one, "category", "nothing", Sampling::Fixed),
        Err(GateError::NoNominalRows { .. })
    ));
}
