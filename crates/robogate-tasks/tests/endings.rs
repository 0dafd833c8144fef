//! Tests of failure modes at the time limit, of policies that give up, and of feasibility.
#![cfg(feature = "mujoco")]
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::f64::consts::PI;

use common::EngineKind;
use robogate_core::{
    Action, Assignment, Episode, FailureMode, Fault, GAVE_UP, Observation, Outcome, Policy, Scenario, Seed,
    TaskInstance, TaskSpec, Value, is_feasible, rollout, rollout_with,
};
use robogate_tasks::claims::{Bench, Workbench};
use robogate_tasks::pick_place::spec::{Briefing, JAM, MISPLACED};
use robogate_tasks::pick_place::{ModeSet, PickPlace, Placement, Shape};
use robogate_tasks::{ArmSettings, ArmTask};

/// The task without a limit of contact forces.
const UNLIMITED: PickPlace =
    PickPlace { arm: ArmSettings { contact_force_limit_n: Some(1e6), ..PickPlace::DEFAULT.arm }, ..PickPlace::DEFAULT };

fn bench(task: PickPlace) -> Bench {
    let cell = EngineKind::Mujoco.franka();
    let settings = task.settings().into_iter().filter_map(|spec| Some((spec.name, spec.value?))).collect();
    let setup = robogate_tasks::claims::Setup { settings, ..cell.setup() };
    cell.bench(&setup).unwrap()
}

fn scenario(index: u64, pairs: &[(&str, Value)]) -> Scenario {
    let requested: Assignment = pairs.iter().map(|(name, value)| ((*name).into(), value.clone())).collect();
    Scenario { index, seed: Seed::campaign(7).episode(index), requested }
}

fn wide() -> Vec<(&'static str, Value)> {
    vec![("size_m", Value::Number(0.1)), ("friction", Value::Number(0.6))]
}

fn run((environment, policy): &mut Bench, scenario: &Scenario) -> Episode {
    rollout(&mut **environment, &mut **policy, scenario)
}

/// A policy that changes the briefing of another one, and may hide that it gave up.
struct Changed<F> {
    inner: Box<dyn Policy>,
    change: F,
    hides: bool,
}

impl<F: Fn(&mut Briefing)> Policy for Changed<F> {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.inner.check(task)
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        let mut briefing = Briefing::of(instance)?;
        (self.change)(&mut briefing);
        self.inner.reset(task, &briefing.instance(), seed)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        self.inner.act(observation)
    }

    fn gave_up(&self) -> bool {
        !self.hides && self.inner.gave_up()
    }
}

#[test]
fn coming_down_on_a_wide_part_is_a_hit() {
    let (mut environment, mut policy) = bench(PickPlace::DEFAULT);
    let mut events = Vec::new();
    let episode = rollout_with(&mut *environment, &mut *policy, &scenario(0, &wide()), &mut |tick| {
        events.extend(tick.step.events.iter().cloned());
    });
    assert_eq!(episode.outcome, Outcome::Failure(FailureMode::constant("struck")));
    assert!(episode.time_s < 5.0 && episode.measures.get("peak_contact_force_n").unwrap() > 150.0);
    assert!(events.iter().any(|event| event.starts_with("struck: contact force")), "{events:?}");
    // The fingers come down on the part, for less than a control period.
    let measured = |name: &str| episode.measures.get(name);
    let peak = measured("peak_contact_force_n");
    let both = measured("peak_force_fingers_part_n").unwrap();
    assert!(both > 1.5 * peak.unwrap() && both <= 2.0 * peak.unwrap(), "{both} of {peak:?}");
    assert!(measured("held_force_fingers_part_n").unwrap() < 0.2 * both);
    assert_eq!(measured("peak_force_arm_surroundings_n"), None);
    let over = measured("contact_over_limit_s").unwrap();
    assert!(over > 0.0 && over < 0.05, "{over}");
    let impulse = measured("peak_contact_impulse_n_s").unwrap();
    assert!(impulse > 0.0 && impulse < 0.06 * both, "{impulse}");
}

/// A part that only loses contact with the table for a moment is not off it.
#[test]
fn parts_are_off_the_table_at_a_height() {
    let (mut environment, mut policy) = bench(PickPlace::DEFAULT);
    let (mut closed_m, mut height_m) = (None, None);
    rollout_with(&mut *environment, &mut *policy, &scenario(0, &[]), &mut |tick| {
        let tool_m = tick.step.observation.tool_pose().unwrap().position[2];
        for event in &tick.step.events {
            match event.as_str() {
                "gripper closes" => closed_m = Some(tool_m),
                "object off the table" => height_m = closed_m.map(|closed| tool_m - closed),
                _ => {}
            }
        }
    });
    assert!(height_m.unwrap() > 0.0045, "{height_m:?}");
}

/// The pads press with nearly the limit, and lose their allowance only when they have let go.
#[test]
fn strong_grip_is_no_hit() {
    let arm = ArmSettings { grip_force_n: Some(65.0), contact_force_limit_n: Some(60.0), ..PickPlace::DEFAULT.arm };
    let episode = run(&mut bench(PickPlace { arm, ..PickPlace::DEFAULT }), &scenario(0, &[]));
    assert_eq!(episode.outcome, Outcome::Success);
    assert!(episode.measures.get("peak_contact_force_n").unwrap() > 60.0);
}

#[test]
fn pressing_on_a_wide_part_is_a_jam() {
    let (mut environment, mut policy) = bench(UNLIMITED);
    let mut events = Vec::new();
    let episode = rollout_with(&mut *environment, &mut *policy, &scenario(0, &wide()), &mut |tick| {
        events.extend(tick.step.events.iter().cloned());
    });
    assert_eq!(episode.outcome, Outcome::Failure(JAM));
    assert!((episode.time_s - 15.0).abs() < 1e-9, "the outcome is that at the time limit");
    assert!(episode.ticks < 100, "{} control periods", episode.ticks);
    let gave_up = episode.measures.get(GAVE_UP.as_str()).unwrap();
    assert!(gave_up > 0.5 && gave_up < 0.05 * f64::from(episode.ticks), "{gave_up}");
    assert!(episode.measures.get("peak_contact_force_n").unwrap() > 100.0);
    assert_eq!(is_feasible(&episode.measures), Some(false));
    for what in ["contact force", "jam: pressed", "policy gave up"] {
        assert!(events.iter().any(|event| event.contains(what)), "{what}: {events:?}");
    }
}

#[test]
fn limits_of_a_jam_are_settings() {
    for task in [
        PickPlace { jam_force_n: 1e4, ..UNLIMITED },
        PickPlace { jam_duration_s: 14.9, ..UNLIMITED },
        PickPlace { modes: ModeSet::Paper, ..PickPlace::DEFAULT },
    ] {
        let episode = run(&mut bench(task), &scenario(0, &wide()));
        assert_eq!(episode.outcome, Outcome::Failure(FailureMode::TIMEOUT), "{task:?}");
    }
}

#[test]
fn paper_modes_are_the_published_ones() {
    let modes = |modes| {
        let (environment, _) = bench(PickPlace { modes, ..PickPlace::DEFAULT });
        let task = environment.task().clone();
        task.modes().map(|mode| (mode, task.published_mode(mode))).collect::<Vec<_>>()
    };
    let published: Vec<FailureMode> = modes(ModeSet::Paper).into_iter().map(|(mode, _)| mode).collect();
    assert_eq!(published.len(), 4);
    assert!(modes(ModeSet::All).iter().all(|(_, mode)| published.contains(mode)));
    assert_eq!(modes(ModeSet::All).len(), 7);
}

#[test]
fn part_beside_the_target_is_misplaced() {
    let (mut environment, policy) = bench(PickPlace::DEFAULT);
    let beside = |briefing: &mut Briefing| briefing.target_pose.position[1] -= 0.1;
    let mut policy = Changed { inner: policy, change: beside, hides: false };
    let episode = rollout(&mut *environment, &mut policy, &scenario(0, &[]));
    assert_eq!(episode.outcome, Outcome::Failure(MISPLACED));
    assert!((episode.time_s - 15.0).abs() < 1e-9 && episode.ticks < 200, "{}", episode.ticks);
    assert_eq!(is_feasible(&episode.measures), Some(true));
}

#[test]
fn time_limit_ends_the_episode() {
    let mut short =
        bench(PickPlace { arm: ArmSettings { time_limit_s: 3.0, ..PickPlace::DEFAULT.arm }, ..PickPlace::DEFAULT });
    let episode = run(&mut short, &scenario(0, &[]));
    assert_eq!((episode.outcome, episode.ticks), (Outcome::Failure(FailureMode::TIMEOUT), 60));
    assert!((episode.time_s - 3.0).abs() < 1e-9);
}

#[test]
fn episode_waits_for_the_moving_box() {
    let moving = [
        ("disturbance_speed_m_s", Value::Number(0.1)),
        ("disturbance_start_s", Value::Number(8.0)),
        ("disturbance_y_m", Value::Number(-1.0)),
        ("disturbance_travel_m", Value::Number(0.1)),
    ];
    let episode = run(&mut bench(UNLIMITED), &scenario(0, &[&wide()[..], &moving].concat()));
    assert_eq!(episode.outcome, Outcome::Failure(JAM));
    assert!((181..200).contains(&episode.ticks), "{} control periods", episode.ticks);
}

#[test]
fn ending_early_changes_no_outcome() {
    let (mut environment, policy) = bench(UNLIMITED);
    let mut patient = Changed { inner: policy, change: |_: &mut Briefing| {}, hides: true };
    let mut early = bench(UNLIMITED);
    for index in 0..12 {
        let pairs = [
            ("size_m", Value::Number(0.03 + 0.007 * index as f64)),
            ("friction", Value::Number(0.1 + 0.05 * index as f64)),
            ("mass_kg", Value::Number(0.8)),
            ("ik_noise_rad", Value::Number(0.03)),
            ("obstacles", Value::Integer(3)),
            ("shape", Value::Category(Shape::ALL[index as usize % 5].as_str().into())),
            ("placement", Value::Category(Placement::NAMES[index as usize].into())),
        ];
        let scenario = scenario(index, &pairs);
        let whole = rollout(&mut *environment, &mut patient, &scenario);
        let short = run(&mut early, &scenario);
        assert_eq!((&short.outcome, short.time_s), (&whole.outcome, whole.time_s), "{index}");
        assert!(short.ticks <= whole.ticks);
    }
}

#[test]
fn orientation_can_be_required() {
    let strict = PickPlace { orientation_tolerance_rad: 5.0 * PI / 180.0, ..PickPlace::DEFAULT };
    let turned = [("placement", Value::Category("rotated_45".into())), ("shape", Value::Category("L_shape".into()))];
    let episode = run(&mut bench(strict), &scenario(0, &turned));
    assert_eq!(episode.outcome, Outcome::Success, "the controller aligns the part");
    // A policy that is told nothing of the tolerance places the part as it hangs.
    let (mut environment, policy) = bench(strict);
    let untold = |briefing: &mut Briefing| briefing.orientation_tolerance_rad = None;
    let mut policy = Changed { inner: policy, change: untold, hides: false };
    let episode = rollout(&mut *environment, &mut policy, &scenario(0, &turned));
    assert_eq!(episode.outcome, Outcome::Failure(MISPLACED));
}
