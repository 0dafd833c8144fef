//! Tests of the industrial suite and of the fixtures that suites use.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::collections::{BTreeMap, BTreeSet};

use common::EngineKind;
use robogate_core::{
    Action, Assignment, Command, Domain, Episode, Fault, FaultKind, Observation, Outcome, Policy, Scenario, Seed,
    Spread, Suite, TaskInstance, TaskSpec, Value, rollout,
};
use robogate_physics::{TableMaterial, built_in_robot};
use robogate_tasks::ArmDeclaration;
use robogate_tasks::claims::{Bench, Workbench};
use robogate_tasks::pick_place::{PickPlace, Placement};

/// The default seed of a campaign.
const SEED: u64 = 2026;

fn suite() -> Suite {
    Suite::from_toml(include_str!("../../../assets/suites/industrial-68.toml")).unwrap()
}

fn scenario(parameters: &[(&str, Value)], index: u64) -> Scenario {
    let requested: Assignment = parameters.iter().map(|(name, value)| ((*name).into(), value.clone())).collect();
    Scenario { index, seed: Seed::campaign(SEED).episode(index), requested }
}

fn number(x: f64) -> Value {
    Value::Number(x)
}

#[test]
fn groups_have_the_papers_sizes() {
    let mut counts: BTreeMap<(String, String), usize> = BTreeMap::new();
    for case in suite().cases() {
        *counts.entry((case.category.clone(), case.group.clone())).or_default() += 1;
    }
    let expected = [
        ("nominal", "standard_objects", 7),
        ("nominal", "standard_lighting", 7),
        ("nominal", "centered_placement", 6),
        ("edge_cases", "small_objects", 3),
        ("edge_cases", "heavy_objects", 3),
        ("edge_cases", "edge_placement", 3),
        ("edge_cases", "occluded_objects", 3),
        ("edge_cases", "transparent_objects", 3),
        ("adversarial", "low_lighting", 3),
        ("adversarial", "cluttered_scene", 3),
        ("adversarial", "slippery_surface", 2),
        ("adversarial", "moving_disturbance", 2),
        ("domain_randomisation", "lighting", 10),
        ("domain_randomisation", "color", 5),
        ("domain_randomisation", "position", 5),
        ("domain_randomisation", "camera", 3),
    ];
    let expected = expected.map(|(category, group, n)| ((category.to_owned(), group.to_owned()), n));
    assert_eq!(counts, expected.into_iter().collect());
    assert_eq!(suite().cases().len(), 68);
}

/// The smallest and largest value of a parameter over all scenarios.
fn ends(suite: &Suite, name: &str) -> (f64, f64) {
    let mut ends = (f64::INFINITY, f64::NEG_INFINITY);
    for case in suite.cases() {
        let (low, high) = match &case.parameters.iter().find(|(n, _)| &**n == name).unwrap().1 {
            Spread::Fixed(Value::Number(x)) => (*x, *x),
            Spread::Fixed(Value::Integer(n)) => (*n as f64, *n as f64),
            Spread::Drawn(Domain::Continuous { low, high, .. }) => (*low, *high),
            other => panic!("{name}: {other:?}"),
        };
        ends = (ends.0.min(low), ends.1.max(high));
    }
    ends
}

#[test]
fn values_fill_their_ranges() {
    let suite = suite();
    let five_degrees = 5_f64.to_radians();
    for (name, low, high) in [
        ("lighting_lux", 200.0, 2000.0),
        ("camera_roll_rad", -five_degrees, five_degrees),
        ("camera_pitch_rad", -five_degrees, five_degrees),
        ("object_transparency", 0.0, 0.95),
        ("mass_kg", 0.0, 3.0),
        ("size_m", 0.02, 0.08),
    ] {
        let (lowest, highest) = ends(&suite, name);
        assert!(low <= lowest && highest <= high, "{name}: {lowest} to {highest}");
    }
    let (dark, bright) = ends(&suite, "lighting_lux");
    assert!(dark <= 200.0 && bright >= 1900.0);
    let materials: BTreeSet<_> = (0..68)
        .map(|i| suite.scenario(Seed::campaign(SEED), i).requested.category("table_material").unwrap().to_owned())
        .collect();
    assert_eq!(materials.len(), TableMaterial::ALL.len());
}

#[test]
fn every_parameter_is_accepted() {
    let misfits = PickPlace::DEFAULT
        .parameters()
        .check_suite(&suite(), Some(&built_in_robot("franka").unwrap().settings.gripper));
    assert!(misfits.is_empty(), "{misfits:?}");
}

#[test]
fn problems_are_reported_with_their_scenarios() {
    let text = include_str!("../../../assets/suites/industrial-68.toml")
        .replace("mass_kg = 0.3\n", "mass_kg = 0.3\nhumidity = 0.5\n")
        .replace("friction = 0.1,", "friction = 11.0,")
        .replace("\"#f0f0f0\", \"#e8e0d0\"", "\"white\", \"#e8e0d0\"");
    let gripper = built_in_robot("franka").unwrap().settings.gripper;
    let messages = PickPlace::DEFAULT.parameters().check_suite(&Suite::from_toml(&text).unwrap(), Some(&gripper));
    assert_eq!(messages.len(), 3, "{messages:?}");
    let find = |what: &str| messages.iter().find(|message| message.contains(what)).unwrap();
    assert!(
        find("friction")
            .starts_with("scenario `slippery_surface-1`: parameter `friction` = 11: expected a number from 0 to 10")
    );
    assert!(find("humidity").starts_with("scenario `standard_objects-1` and 67 more: unknown parameter `humidity`"));
    assert!(find("white").starts_with("scenario `color-5`: parameter `object_color`: unknown value `white`"));
}

fn bench() -> Bench {
    let franka = EngineKind::Mujoco.franka();
    franka.bench(&franka.setup()).unwrap()
}

fn run(suite: &Suite, indices: impl Iterator<Item = u64>) -> Vec<Episode> {
    let (mut simulator, mut policy) = bench();
    let episode = |i| rollout(&mut *simulator, &mut *policy, &suite.scenario(Seed::campaign(SEED), i));
    indices.map(episode).collect()
}

#[test]
fn scripted_controller_solves_all_68() {
    let suite = suite();
    let episodes = run(&suite, 0..3 * 68);
    let failed: Vec<_> = episodes
        .iter()
        .filter(|episode| episode.outcome != Outcome::Success)
        .map(|e| {
            let of = (suite.case(e.scenario.index).id.clone(), e.scenario.index / 68);
            (of, &e.outcome, e.phase, e.time_s, &e.contact)
        })
        .collect();
    assert!(failed.is_empty(), "{failed:#?}");
    for (one, other) in episodes[..68].iter().zip(&episodes[68..136]) {
        assert_ne!(one.trajectory_hash, other.trajectory_hash, "rounds have different trajectories");
    }
}

#[test]
fn visual_parameters_do_not_change_physics() {
    let looks = [
        ("lighting_lux", number(230.0)),
        ("camera_roll_rad", number(0.05)),
        ("camera_pitch_rad", number(-0.03)),
        ("object_transparency", number(0.7)),
        ("table_material", Value::Category("steel".into())),
        ("background_color", Value::Category("#102030".into())),
        ("object_color", Value::Category("#a0b0c0".into())),
    ];
    let (mut simulator, mut policy) = bench();
    let plain = rollout(&mut *simulator, &mut *policy, &scenario(&[], 5));
    let looked = rollout(&mut *simulator, &mut *policy, &scenario(&looks, 5));
    assert_eq!(looked.trajectory_hash, plain.trajectory_hash);
    assert_eq!(looked.applied, looked.scenario.requested);
}

/// Waits for a while, then acts like another policy.
struct Late<P>(P, f64, usize);

impl Policy for Late<Box<dyn Policy>> {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.0.check(task)
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.2 = (self.1 / task.control_period_s).round() as usize;
        self.0.reset(task, instance, seed)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        if self.2 == 0 {
            return self.0.act(observation);
        }
        self.2 -= 1;
        Ok(Action {
            command: Command::JointPosition(observation.joint_positions().to_vec()),
            gripper: Some(Action::OPEN),
            phase: None,
        })
    }
}

#[test]
fn late_policy_meets_the_disturbance() {
    let suite = suite();
    let case = suite.cases().iter().position(|case| case.id == "moving_disturbance-1").unwrap() as u64;
    let (mut simulator, policy) = bench();
    let mut late = Late(policy, 3.0, 0);
    for round in 0..3 {
        let scenario = suite.scenario(Seed::campaign(SEED), round * 68 + case);
        let episode = rollout(&mut *simulator, &mut late, &scenario);
        assert!(matches!(episode.outcome, Outcome::Failure(_)), "{:?}", episode.outcome);
    }
}

#[test]
fn occluders_and_far_obstacles_are_harmless() {
    let (mut simulator, mut policy) = bench();
    for index in 0..20 {
        let placement = Placement::NAMES[index as usize % Placement::NAMES.len()];
        let parameters = [
            ("occluders", Value::Integer(3)),
            ("obstacles", Value::Integer(5)),
            ("obstacle_gap_m", number(0.08)),
            ("placement", Value::Category(placement.into())),
        ];
        let episode = rollout(&mut *simulator, &mut *policy, &scenario(&parameters, index));
        assert_eq!(episode.outcome, Outcome::Success, "{placement}: {:?} {:?}", episode.contact, episode.phase);
        assert_eq!(episode.applied, episode.scenario.requested);
    }
}

#[test]
fn object_off_table_is_fault() {
    let (mut simulator, mut policy) = bench();
    let beside = scenario(&[("offset_x_m", number(0.5))], 0);
    let episode = rollout(&mut *simulator, &mut *policy, &beside);
    assert!(
        matches!(&episode.outcome, Outcome::Invalid(fault) if fault.kind == FaultKind::Setup
            && fault.to_string().contains("is not on the table")),
        "{:?}",
        episode.outcome
    );
}
