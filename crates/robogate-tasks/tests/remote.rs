//! An engine that is somewhere else is judged as one that is here.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use robogate_core::samplers::LatinHypercube;
use robogate_core::{
    Action, Environment, Fault, FaultKind, Outcome, ParameterSpace, Sampler, Scenario, Seed, Start, Step, rollout,
};
use robogate_physics::{Engine, MujocoEngine, RapierEngine, built_in_robot};
use robogate_tasks::pick_place::remote::{FarPeriod, Host, Offsite};
use robogate_tasks::pick_place::{FRANKA_SPACE, PickPlace, Scripted};

/// Told and heard without a socket between; `lie` may change what is heard.
struct Far<E> {
    host: Host<E>,
    offsite: Offsite,
    lie: fn(&mut FarPeriod),
}

impl<E: Engine> Far<E> {
    fn new(engine: E) -> Self {
        let (robot, chain) = (engine.robot().clone(), engine.chain().clone());
        let offsite = Offsite::new(robot, chain, None, None).unwrap();
        Self { host: Host::new(engine, None).unwrap(), offsite, lie: |_| {} }
    }
}

impl<E: Engine> Environment for Far<E> {
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.offsite.brief(scenario)?;
        let (held, sight, observation) = self.host.reset(scenario)?;
        self.offsite.start(held, &sight, &observation)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let command = self.offsite.command(action)?;
        let mut period = self.host.step(&command, action.gripper)?;
        (self.lie)(&mut period);
        let FarPeriod { observation, state_hash, sights, clearance_m } = period;
        self.offsite.finish(&sights, &observation, clearance_m, state_hash)
    }
}

fn scenarios(count: usize) -> Vec<Scenario> {
    let space = Arc::new(ParameterSpace::from_toml(FRANKA_SPACE).unwrap());
    let seed = Seed::campaign(11);
    let design = LatinHypercube::default().design(&space, count, seed.stream("design")).unwrap();
    let scenario =
        |i: usize| Scenario { index: i as u64, seed: seed.episode(i as u64), requested: design.assignment(i).unwrap() };
    (0..count).map(scenario).collect()
}

fn same_there_as_here<E: Engine>(count: usize, make: impl Fn() -> E) {
    let engine = make();
    let mut policy = Scripted::new(engine.robot().clone(), engine.chain().clone());
    let (mut here, mut there) = (PickPlace::new(engine, None).unwrap(), Far::new(make()));
    let mut words = std::collections::BTreeSet::new();
    for scenario in scenarios(count) {
        let episode = rollout(&mut here, &mut policy, &scenario);
        assert_eq!(rollout(&mut there, &mut policy, &scenario), episode);
        words.insert(episode.outcome.word());
    }
    assert!(words.len() >= 2, "{words:?}");
}

#[test]
fn mujoco_far_away_gives_the_episodes_of_mujoco_here() {
    same_there_as_here(16, || MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap());
}

#[test]
fn rapier_far_away_gives_the_episodes_of_rapier_here() {
    same_there_as_here(6, || RapierEngine::new(built_in_robot("franka").unwrap(), RapierEngine::TIME_STEP_S).unwrap());
}

#[test]
fn what_a_far_engine_changed_or_cannot_have_seen_makes_the_episode_invalid() {
    let engine = MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    let (robot, chain) = (engine.robot().clone(), engine.chain().clone());
    let mut policy = Scripted::new(robot.clone(), chain.clone());
    let mut far = Far::new(engine);
    let scenario = &scenarios(1)[0];
    let invalid = |far: &mut Far<MujocoEngine>, policy: &mut Scripted, lie, words: &str| {
        far.lie = lie;
        let Outcome::Invalid(fault) = rollout(far, policy, scenario).outcome else { panic!("{words}") };
        assert!(fault.kind == FaultKind::Unavailable && fault.detail.contains(words), "{fault}");
    };
    let collision = |period: &mut FarPeriod| {
        period.sights[3].collision = Some(robogate_tasks::pick_place::remote::FarCollision {
            robot_body: "hand".to_owned(),
            fixture: 99,
            force_n: 1.0,
        });
    };
    invalid(&mut far, &mut policy, collision, "fixture 99");
    invalid(&mut far, &mut policy, |p| p.sights[0].opening_m = None, "no opening");
    invalid(&mut far, &mut policy, |p| p.sights[0].object_pose.orientation = [0.0; 4], "no rotation");

    let mut offsite = Offsite::new(robot, chain, None, None).unwrap();
    let mut start =
        |change: fn(&mut robogate_tasks::pick_place::remote::FarReadback, &mut robogate_core::Observation)| {
            offsite.brief(scenario).unwrap();
            let (mut held, sight, mut observation) = far.host.reset(scenario).unwrap();
            change(&mut held, &mut observation);
            offsite.start(held, &sight, &observation)
        };
    let asked = &scenario.requested;
    for (name, applied) in [
        ("friction", start(|held, _| held.friction *= 1.01).unwrap().applied),
        ("mass_kg", start(|held, _| held.mass_kg *= 1.01).unwrap().applied),
        ("placement", start(|held, _| held.object_pose.position[0] += 1e-3).unwrap().applied),
        ("obstacles", start(|held, _| held.fixtures.clear()).unwrap().applied),
    ] {
        assert_ne!(applied.get(name), asked.get(name), "{name}");
    }
    let other = start(|_, observation| observation.tool_pose.position[2] += 0.02).unwrap_err();
    assert!(other.detail.contains("another robot"), "{other}");
    assert!(Offsite::new(built_in_robot("ur5e").unwrap(), far.offsite_chain(), None, None).is_err());
}

impl<E: Engine> Far<E> {
    fn offsite_chain(&self) -> robogate_physics::Chain {
        self.host.engine().chain().clone()
    }
}
