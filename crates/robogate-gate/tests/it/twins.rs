//! Episodes compared with their nominal twins.

use std::sync::Arc;

use robogate_core::{Allowed, FailureMode, ParameterSpec, Value, Word};
use robogate_gate::{Effect, Ending, GateError, Record, Sampling, Twins};
use robogate_stats::{Confidence, Trials, wilson};

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

/// Episodes with these values of `friction` and `mass_kg`, of a task that declares a family for each.
fn of_families(of: impl Fn(u64) -> (f64, f64), success: impl Fn(u64) -> bool) -> Record {
    let mut record = sampled((0..40).map(|i| ending(success(i))));
    let task = Arc::make_mut(&mut record.task);
    for (name, family) in [("friction", "contact"), ("mass_kg", "load")] {
        task.parameters.push(ParameterSpec {
            name: name.into(),
            unit: String::new(),
            meaning: String::new(),
            allowed: Allowed::Continuous { low: 0.0, high: 9.0 },
            nominal: Some(Value::Number(0.5)),
            read_from: String::new(),
            family: Some(Word::constant(family)),
        });
    }
    for trial in &mut record.trials {
        let (friction, mass) = of(trial.index);
        trial.requested.set("friction", Value::Number(friction));
        trial.requested.set("mass_kg", Value::Number(mass));
    }
    record
}

#[test]
fn declared_families_have_effects_beside_the_joint_one() {
    // A low friction is the cause of every failure.
    let joint = of_families(|i| (0.1 + 0.001 * i as f64, 2.0), |_| false);
    let nominal = of_families(|_| (0.8, 0.3), |_| true);
    let one = of_families(|i| if i < 20 { (0.1, 0.3) } else { (0.8, 2.0) }, |i| i >= 20);
    let twins = Twins::with_families(&joint, &nominal, Some(&one), Sampling::Fixed).unwrap();
    let of: Vec<(&str, u64, Effect)> =
        twins.families.iter().map(|of| (of.family.as_str(), of.pairs, of.effect)).collect();
    assert_eq!(
        of,
        [
            ("all perturbations together", 40, Effect::Harmful),
            ("contact", 20, Effect::Harmful),
            ("load", 20, Effect::NotSignificant)
        ]
    );
    // The totals are those of the campaign.
    assert_eq!((twins.valid, twins.perturbed_successes, twins.nominal_successes, twins.one_family), (40, 0, 40, 40));
    assert!(twins.lines().join(" ").contains("40 further episodes perturb one declared family only"));
    // The intervals hold together, so they are wider than that of one family.
    let alone = Twins::of(&joint, &nominal, Sampling::Fixed).unwrap();
    let width = |twins: &Twins| twins.families[0].interval_95[1] - twins.families[0].interval_95[0];
    assert!(width(&twins) > width(&alone));
    // An episode with perturbations of two families is not one of a family.
    let wrong = Twins::with_families(&joint, &nominal, Some(&joint), Sampling::Fixed);
    assert!(matches!(wrong, Err(GateError::NotPaired { .. })));
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

/// These records as one, with rows numbered anew.
fn joined(mut records: Vec<Record>) -> Record {
    let more: Vec<_> = records.drain(1..).flat_map(|record| record.trials).collect();
    let mut all = records.remove(0);
    all.trials.extend(more);
    all.trials.iter_mut().zip(0..).for_each(|(trial, index)| trial.index = index);
    all
}

#[test]
fn each_twin_counts_once() {
    // 30 of 40 twins succeed. Half of the perturbed episodes of each family fail, on ten seeds without the perturbation too.
    let nominal = |seeds: std::ops::Range<i64>| imported("none", seeds, |seed| seed % 4 != 0);
    let perturbed = |category: &str| imported(category, 0..40, |seed| seed % 2 == 1);
    let interval = wilson(Trials::new(30, 40).unwrap(), Confidence::P95);

    // Five severities of one family share a twin.
    let severities = joined((0..5).map(|_| perturbed("camera")).collect());
    let twins = Twins::of(&severities, &nominal(0..44), Sampling::Fixed).unwrap();
    let family = &twins.families[0];
    assert_eq!((twins.pairs, twins.shared_twins, twins.shared_twin_successes, twins.unpaired), (200, 40, 30, 4));
    assert_eq!(twins.nominal_interval_95, [interval.low, interval.high]);
    assert_eq!((family.pairs, family.shared_twins, family.new_failures), (200, 40, 50));
    assert_eq!((family.difference, family.effect), (Some(-0.25), Effect::Harmful));
    // The interval is about as wide as that of one pair for each twin, not of five.
    let single = Twins::of(&perturbed("camera"), &nominal(0..40), Sampling::Fixed).unwrap();
    let width = |twins: &Twins| twins.families[0].interval_95[1] - twins.families[0].interval_95[0];
    assert!((width(&twins) / width(&single) - 1.0).abs() < 0.25, "{} {}", width(&twins), width(&single));
    assert_eq!((single.shared_twins, single.families[0].shared_twins), (0, 0));
    assert!(!single.to_json().contains("shared"));
    let text = twins.lines().join(" ");
    assert!(text.contains("In 200 pairs with 40 distinct nominal twins, success is "), "{text}");
    assert!(text.contains("Several pairs of a family share a twin."), "{text}");

    // Two families with one episode for each twin share it in the rate without the perturbations only.
    let one = joined(vec![nominal(0..40), perturbed("camera"), perturbed("light")]);
    let twins = Twins::within(&one, "category", "none", Sampling::Fixed).unwrap();
    assert_eq!((twins.valid, twins.shared_twins), (80, 40));
    assert_eq!(twins.nominal_interval_95, [interval.low, interval.high]);
    assert!(twins.families.iter().all(|family| family.shared_twins == 0));
    assert!(!twins.lines().join(" ").contains("Several pairs of a family"));
}
