//! Tests that episodes on a remote engine equal those on a local one.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use robogate_core::samplers::LatinHypercube;
use robogate_core::{
    Action, Assignment, Ending, Environment, Fault, FaultKind, Foresight, Infeasibility, Observation, Outcome,
    ParameterSpace, Sampler, Scenario, Seed, Start, Step, TaskSpec, rollout, vectors,
};
use robogate_physics::{Engine, GripperCommand, MujocoEngine, RapierEngine, built_in_robot};
use robogate_tasks::pick_place::remote::{PhysicsHost, RemotePeriod, RemotePickPlace};
use robogate_tasks::pick_place::{FRANKA_SPACE, PickPlace, Scripted};
use robogate_tasks::{ArmTask, Rig};

/// A remote engine without a socket. `tamper` may change its reports.
struct Remote<E> {
    host: PhysicsHost<E>,
    task: RemotePickPlace,
    tamper: fn(&mut RemotePeriod),
}

impl<E: Engine> Remote<E> {
    fn new(engine: E) -> Self {
        let (robot, chain) = (engine.robot().clone(), engine.chain().clone());
        let task = RemotePickPlace::new(PickPlace::default(), robot, chain, None, [64; 2]).unwrap();
        Self { host: PhysicsHost::new(engine, PickPlace::DEFAULT).unwrap(), task, tamper: |_| {} }
    }
}

impl<E: Engine> Environment for Remote<E> {
    fn task(&self) -> &Arc<TaskSpec> {
        self.task.task()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.task.resolve(scenario)?;
        let (held, sight, observation) = self.host.reset(scenario)?;
        self.task.start(held, &sight, &observation)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let command = self.task.command(action)?;
        let mut period = self.host.step(&command, GripperCommand::of(action))?;
        (self.tamper)(&mut period);
        let RemotePeriod { observation, state_hash, sights, clearance_m } = period;
        self.task.finish(&sights, &observation, clearance_m, state_hash)
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        Some(self.task.foresight())
    }

    fn foregone_ending(&self) -> Option<Ending> {
        self.task.foregone_ending()
    }

    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.task.infeasibility(requested)
    }
}

/// The observation of an arm with the tool raised by this much.
fn raise_tool(observation: &mut Observation, by_m: f64) {
    let tool = observation.vectors.iter_mut().find(|(name, _)| *name == vectors::TOOL_POSE);
    tool.unwrap().1[2] += by_m;
}

fn scenarios(count: usize) -> Vec<Scenario> {
    let space = Arc::new(ParameterSpace::from_toml(FRANKA_SPACE).unwrap());
    let seed = Seed::campaign(11);
    let design = LatinHypercube::default().design(&space, count, seed.stream("design")).unwrap();
    let scenario =
        |i: usize| Scenario { index: i as u64, seed: seed.episode(i as u64), requested: design.assignment(i).unwrap() };
    (0..count).map(scenario).collect()
}

fn same_episodes<E: Engine>(count: usize, make: impl Fn() -> E) {
    let engine = make();
    let mut policy = Scripted::new(engine.robot().clone(), engine.chain().clone());
    let (mut local, mut remote) = (
        PickPlace::default().on(Box::new(engine), Rig { picture_px: [64; 2], ..Rig::default() }).unwrap(),
        Remote::new(make()),
    );
    let mut words = std::collections::BTreeSet::new();
    for scenario in scenarios(count) {
        let episode = rollout(&mut local, &mut policy, &scenario);
        assert_eq!(rollout(&mut remote, &mut policy, &scenario), episode);
        words.insert(episode.outcome.as_str());
    }
    assert!(words.len() >= 2, "{words:?}");
}

#[test]
fn remote_mujoco_gives_the_same_episodes() {
    same_episodes(16, || MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap());
}

#[test]
fn remote_rapier_gives_the_same_episodes() {
    same_episodes(6, || RapierEngine::new(built_in_robot("franka").unwrap(), RapierEngine::TIME_STEP_S).unwrap());
}

#[test]
fn impossible_reports_make_an_episode_invalid() {
    let engine = MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    let (robot, chain) = (engine.robot().clone(), engine.chain().clone());
    let mut policy = Scripted::new(robot.clone(), chain.clone());
    let mut remote = Remote::new(engine);
    let scenario = &scenarios(1)[0];
    let invalid = |remote: &mut Remote<MujocoEngine>, policy: &mut Scripted, tamper, words: &str| {
        remote.tamper = tamper;
        let Outcome::Invalid(fault) = rollout(remote, policy, scenario).outcome else { panic!("{words}") };
        assert!(fault.kind == FaultKind::Unavailable && fault.detail.contains(words), "{fault}");
    };
    let collision = |period: &mut RemotePeriod| {
        period.sights[3].collision = Some(robogate_tasks::pick_place::remote::RemoteCollision {
            robot_body: "hand".to_owned(),
            fixture: 99,
            force_n: 1.0,
        });
    };
    invalid(&mut remote, &mut policy, collision, "fixture 99");
    invalid(&mut remote, &mut policy, |p| p.sights[0].opening_m = None, "no opening");
    invalid(&mut remote, &mut policy, |p| p.sights[0].object_pose.orientation = [0.0; 4], "not a unit quaternion");

    let mut task = RemotePickPlace::new(PickPlace::default(), robot, chain, None, [64; 2]).unwrap();
    let mut start = |change: fn(&mut robogate_tasks::pick_place::remote::RemoteReadback, &mut Observation)| {
        task.resolve(scenario).unwrap();
        let (mut held, sight, mut observation) = remote.host.reset(scenario).unwrap();
        change(&mut held, &mut observation);
        task.start(held, &sight, &observation)
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
    let other = start(|_, observation| raise_tool(observation, 0.02)).unwrap_err();
    assert!(other.detail.contains("a different robot"), "{other}");
    assert!(
        RemotePickPlace::new(PickPlace::default(), built_in_robot("ur5e").unwrap(), remote.chain(), None, [64; 2])
            .is_err()
    );
}

impl<E: Engine> Remote<E> {
    fn chain(&self) -> robogate_physics::Chain {
        self.host.engine().chain().clone()
    }
}
