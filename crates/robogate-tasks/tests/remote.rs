//! Tests that episodes on a remote engine equal those on a local one, for every task and gripper.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::sync::Arc;

use robogate_core::samplers::LatinHypercube;
use robogate_core::{
    Action, Assignment, Ending, Environment, Fault, FaultKind, Foresight, Infeasibility, Observation, Outcome,
    ParameterSpace, Policy, Sampler, Scenario, Seed, Start, Step, TaskSpec, Value, rollout, vectors,
};
use robogate_physics::{Chain, Engine, GripperCommand, MujocoEngine, Primitive, RapierEngine, Robot, built_in_robot};
use robogate_tasks::file::{FileTask, shipped};
use robogate_tasks::insertion::Insertion;
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::remote::{
    Cell, PhysicsHost, RemoteArm, RemoteCollision, RemotePeriod, RemoteReadback, RemoteSight,
};
use robogate_tasks::{ArmDeclaration, ArmTask, Rig, built_in_space};

fn stacking() -> &'static FileTask {
    shipped().find(|task| task.name() == "stacking").unwrap()
}

/// A remote engine without a socket. `tamper` may change its reports.
struct Remote {
    host: PhysicsHost<Box<dyn Engine>>,
    task: RemoteArm,
    tamper: fn(&mut RemotePeriod),
}

/// The robot and its kinematics.
fn of(engine: &dyn Engine) -> (Robot, Chain) {
    (engine.robot().clone(), engine.chain().clone())
}

impl Remote {
    fn new(task: &dyn ArmTask, engine: Box<dyn Engine>) -> Self {
        let (robot, chain) = of(&*engine);
        let task = task.remote(robot, chain, None, [64; 2]).unwrap();
        Self { host: PhysicsHost::new(engine).unwrap(), task, tamper: |_| {} }
    }

    /// Sets a scenario up, with a changed cell or changed reports.
    fn start(
        &mut self,
        scenario: &Scenario,
        change: impl FnOnce(&mut RemoteReadback, &mut RemoteSight, &mut Observation),
    ) -> Result<Start, Fault> {
        let cell = self.task.resolve(scenario)?;
        let (mut held, mut sight, mut observation) = self.host.reset(&cell)?;
        change(&mut held, &mut sight, &mut observation);
        self.task.start(held, &sight, &observation)
    }
}

impl Environment for Remote {
    fn task(&self) -> &Arc<TaskSpec> {
        self.task.task()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.start(scenario, |_, _, _| {})
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let (joints, object) = self.task.command(action)?;
        object.into_iter().for_each(|object| self.host.select(object));
        let mut period = self.host.step(&joints, GripperCommand::of(action))?;
        (self.tamper)(&mut period);
        let RemotePeriod { observation, state_hash, sights, clearance_m } = period;
        self.task.finish(&sights, &observation, clearance_m, state_hash)
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.task.foresight()
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

/// Scenarios of a space, with units that differ from the robot's settings.
fn scenarios(space: &str, gripper: bool, count: usize) -> Vec<Scenario> {
    let space = Arc::new(ParameterSpace::from_toml(built_in_space(space).unwrap()).unwrap());
    let seed = Seed::campaign(11);
    let design = LatinHypercube::default().design(&space, count, seed.stream("design")).unwrap();
    let scenario = |i: usize| {
        let mut requested = design.assignment(i).unwrap();
        if i % 2 == 1 {
            requested.set("unit_bias_2_rad", Value::Number(0.002));
            requested.set("grip_force_scale", Value::Number(0.83));
            if gripper {
                requested.set("pad_friction_scale", Value::Number(0.91));
            }
        }
        Scenario { index: i as u64, seed: seed.episode(i as u64), requested }
    };
    (0..count).map(scenario).collect()
}

fn mujoco(robot: &str) -> Box<dyn Engine> {
    Box::new(MujocoEngine::new(built_in_robot(robot).unwrap(), MujocoEngine::TIME_STEP_S).unwrap())
}

fn rapier(robot: &str) -> Box<dyn Engine> {
    Box::new(RapierEngine::new(built_in_robot(robot).unwrap(), RapierEngine::TIME_STEP_S).unwrap())
}

/// Compares episodes bit for bit: outcome, measures, applied values, state hashes.
fn same_episodes(task: &dyn ArmTask, count: usize, robot: &str, make: fn(&str) -> Box<dyn Engine>) {
    let engine = make(robot);
    let (robot_, chain) = of(&*engine);
    let gripper = robot_.settings.gripper.clone();
    let mut policy = task.controller(robot_, chain);
    let mut local = task.on(engine, Rig { picture_px: [64; 2], ..Rig::default() }).unwrap();
    let mut remote = Remote::new(task, make(robot));
    let mut words = BTreeSet::new();
    for scenario in scenarios(task.space(&gripper), gripper.jaw().is_some(), count) {
        let episode = rollout(&mut local, &mut *policy, &scenario);
        assert_eq!(rollout(&mut remote, &mut *policy, &scenario), episode, "{} {robot}", task.name());
        words.insert(episode.outcome.as_str());
        assert_eq!(remote.task.render().is_ok(), local.render().is_ok());
        assert_eq!(remote.task.render().unwrap(), local.render().unwrap(), "{} {robot}", task.name());
    }
    assert!(words.contains("success"), "{words:?}");
}

#[test]
fn remote_pick_and_place_gives_the_same_episodes() {
    same_episodes(&PickPlace::DEFAULT, 16, "franka", mujoco);
    same_episodes(&PickPlace::DEFAULT, 6, "ur5e", mujoco);
}

#[test]
fn remote_stacking_gives_the_same_episodes() {
    same_episodes(stacking(), 4, "franka", mujoco);
    same_episodes(stacking(), 4, "ur5e", mujoco);
}

#[test]
fn remote_insertion_gives_the_same_episodes() {
    same_episodes(&Insertion::DEFAULT, 6, "franka", mujoco);
    same_episodes(&Insertion::DEFAULT, 4, "ur5e", mujoco);
}

#[test]
fn remote_rapier_gives_the_same_episodes() {
    same_episodes(&PickPlace::DEFAULT, 6, "franka", rapier);
    same_episodes(stacking(), 3, "franka", rapier);
}

/// The settings of the task reach the engine with the cell.
#[test]
fn settings_act_through_the_cell() {
    let settings = [("grip_force_n".into(), Value::Number(17.0))].into_iter().collect();
    same_episodes(&*PickPlace::DEFAULT.with(&settings).unwrap(), 4, "franka", mujoco);
    let surface = [("suction".into(), Value::Category("surface".into()))].into_iter().collect();
    same_episodes(&*PickPlace::DEFAULT.with(&surface).unwrap(), 4, "ur5e", mujoco);
}

#[test]
fn impossible_reports_make_an_episode_invalid() {
    let (robot, chain) = of(&*mujoco("franka"));
    let mut policy = PickPlace::DEFAULT.controller(robot, chain);
    let mut remote = Remote::new(&PickPlace::DEFAULT, mujoco("franka"));
    let scenario = &scenarios("franka", true, 1)[0];
    let invalid = |remote: &mut Remote, policy: &mut dyn Policy, tamper, words: &str| {
        remote.tamper = tamper;
        let Outcome::Invalid(fault) = rollout(remote, policy, scenario).outcome else { panic!("{words}") };
        assert!(fault.kind == FaultKind::Unavailable && fault.detail.contains(words), "{fault}");
    };
    fn hit(period: &mut RemotePeriod, fixture: Option<usize>) {
        let collision = RemoteCollision { robot_body: "hand".to_owned(), fixture, other_body: None, force_n: 1.0 };
        period.sights[3].collision = Some(collision);
    }
    invalid(&mut remote, &mut *policy, |p| hit(p, Some(99)), "fixture 99");
    invalid(&mut remote, &mut *policy, |p| hit(p, None), "a collision with nothing");
    invalid(&mut remote, &mut *policy, |p| p.sights[0].opening_m = None, "no opening");
    invalid(&mut remote, &mut *policy, |p| p.sights[0].objects.clear(), "0 objects");
    invalid(&mut remote, &mut *policy, |p| p.sights[0].object = 1, "acts on object 1");
    let crooked = |p: &mut RemotePeriod| p.sights[0].objects[0].pose.orientation = [0.0; 4];
    invalid(&mut remote, &mut *policy, crooked, "not a unit quaternion");
    let other = remote.start(scenario, |_, _, observation| raise_tool(observation, 0.02)).unwrap_err();
    assert!(other.detail.contains("a different robot"), "{other}");
}

/// A value that the engine has not applied is found, whichever object or drive it belongs to.
#[test]
fn values_that_are_not_applied_are_found() {
    let check = |task: &dyn ArmTask, name: &str, value: Value, change: fn(&mut RemoteReadback)| {
        let requested: Assignment = [(name.into(), value.clone())].into_iter().collect();
        let scenario = Scenario { index: 3, seed: Seed::campaign(1).episode(3), requested };
        let mut remote = Remote::new(task, mujoco("franka"));
        let applied = remote.reset(&scenario).unwrap().applied;
        assert_eq!(applied.get(name), Some(&value), "{name}");
        let applied = remote.start(&scenario, |held, _, _| change(held)).unwrap().applied;
        assert_ne!(applied.get(name), Some(&value), "{name}");
    };
    let number = Value::Number;
    let (pick, stack, insert) = (&PickPlace::DEFAULT, stacking(), &Insertion::DEFAULT);
    check(pick, "friction", number(0.7), |held| held.friction *= 1.01);
    check(pick, "mass_kg", number(0.2), |held| held.objects[0].mass_kg *= 1.01);
    check(pick, "placement", Value::Category("left_0".into()), |held| held.objects[0].pose.translation.x += 1e-3);
    check(pick, "obstacles", Value::Integer(2), |held| held.fixtures.clear());
    check(pick, "grip_force_scale", number(0.9), |held| held.grip_force_n *= 1.01);
    check(pick, "pad_friction_scale", number(0.9), |held| held.pad_friction = None);
    check(stack, "mass_step", number(1.5), |held| held.objects[2].mass_kg *= 1.01);
    check(stack, "order", Value::Category("cab".into()), |held| drop(held.objects.pop()));
    check(stack, "size_m", number(0.045), |held| held.objects[1].parts.clear());
    check(insert, "arm_stiffness", number(0.3), |held| held.stiffness_nm_rad[4] *= 1.01);
    check(insert, "arm_stiffness", number(0.3), |held| held.stiffness_nm_rad.truncate(6));
    check(insert, "friction", number(0.3), |held| held.table_friction *= 1.01);
    check(insert, "chamfer_m", number(0.002), |held| held.fixtures[3].pose.translation.z += 1e-5);
}

/// A server takes cells from other programs. One that no engine can set up is a setup fault, and the next one is set up.
#[test]
fn impossible_cells_are_rejected() {
    let mut remote = Remote::new(stacking(), mujoco("franka"));
    let scenario = &scenarios("stacking", true, 1)[0];
    let good = remote.task.resolve(scenario).unwrap();
    let mut check = |change: fn(&mut Cell), words: &str| {
        let mut cell = good.clone();
        change(&mut cell);
        let fault = remote.host.reset(&cell).unwrap_err();
        assert!(fault.kind == FaultKind::Setup && fault.detail.contains(words), "{words}: {fault}");
        remote.host.reset(&good).unwrap();
    };
    check(|cell| cell.objects.clear(), "0 objects");
    check(|cell| cell.objects = vec![cell.objects[0].clone(); 40], "40 objects");
    check(|cell| cell.objects[1].name = cell.objects[0].name.clone(), "different names");
    check(|cell| cell.objects[1].name = "a\0b".to_owned(), "not valid");
    check(|cell| cell.objects[2].object.mass.mass_kg = 0.0, "mass_kg of part_c is 0");
    check(|cell| cell.objects[2].object.parts.clear(), "0 parts of part_c");
    check(|cell| cell.objects[0].object.mass.inertia.fill(-1.0), "");
    check(|cell| cell.fixtures[0].part.primitive = Primitive::Sphere { radius: 0.0 }, "a size of table is 0");
    check(|cell| cell.fixtures.clear(), "0 fixtures");
    check(|cell| cell.robot.scales.stiffness = -1.0, "scales.stiffness");
    check(|cell| drop(cell.robot.joints.pop()), "this server's robot is franka");
    check(|cell| cell.control_period_s = 0.1, "control_period_s");
    let written = serde_json::to_value(&good).unwrap();
    let read = |(at, value)| {
        let mut changed = written.clone();
        *changed.pointer_mut(at).unwrap() = value;
        serde_json::from_value::<Cell>(changed).map_err(|why| why.to_string())
    };
    assert_eq!(read(("/friction", serde_json::json!(good.friction))).unwrap(), good);
    for (at, value, words) in [
        ("/objects/2/pose/orientation", serde_json::json!([2.0, 2.0, 2.0, 2.0]), "not a unit quaternion"),
        ("/objects/0/color", serde_json::json!("red"), "#rrggbb"),
        ("/visual/table_material", serde_json::json!("cheese"), "cheese"),
    ] {
        let why = read((at, value)).unwrap_err();
        assert!(why.contains(words), "{why}");
    }
    let mut cup = Remote::new(stacking(), mujoco("ur5e"));
    let mut mixed = good.clone();
    mixed.robot.joints = cup.task.robot().settings.arm.joints.clone();
    let fault = cup.host.reset(&mixed).unwrap_err();
    assert!(fault.detail.contains("the gripper of this server is a suction cup"), "{fault}");
}
