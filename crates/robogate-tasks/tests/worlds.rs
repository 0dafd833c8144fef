//! Tests of many worlds in MuJoCo Warp, on its CPU device, against MuJoCo in this process.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::BufReader;
use std::num::NonZeroUsize;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;

use robogate_core::{
    Episode, Outcome, ParameterSpace, Policy, Sampler, Scenario, Seed, SinglePolicies, Value, rollout, rollout_all,
    samplers,
};
use robogate_physics::worlds::{Member, Server, Simulator};
use robogate_physics::{MujocoEngine, built_in_robot};
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::{ArmTask, Rig, built_in_space};

/// A simulator process, which ends with this value.
struct Process {
    child: Child,
    simulator: Arc<Simulator>,
    _folder: tempfile::TempDir,
}

impl Process {
    /// `None` without the Python.
    fn start() -> Option<Self> {
        let python = robogate_testing::path("ROBOGATE_NEWTON_PYTHON", "a Python with mujoco-warp, as Newton has it")?;
        // Compiled kernels are kept where the tests of Newton keep theirs.
        let kernels = python.parent().unwrap().parent().unwrap().join("kernels");
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new(python);
        command.args(["-m", "robogate_worlds", "--device", "cpu", "--deterministic"]);
        command.env("WARP_CACHE_PATH", kernels);
        command.env("PYTHONPATH", Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python/src"));
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (requests, replies) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        let server = Server::new(Box::new(requests), Box::new(replies), folder.path().to_owned()).unwrap();
        Some(Self { child, simulator: Arc::new(Simulator::new(server)), _folder: folder })
    }

    /// Episodes of a task in this many slots.
    fn episodes(&self, task: &dyn ArmTask, scenarios: &[Scenario], slots: usize) -> Vec<Episode> {
        let slots = NonZeroUsize::new(slots).unwrap();
        let member = Member::join(Arc::clone(&self.simulator));
        let mut environment = task.worlds(engine(), Rig::default(), member, slots).unwrap();
        let policies = (0..slots.get()).map(|_| controller(task)).collect();
        rollout_all(&mut environment, &mut SinglePolicies::new(policies), scenarios)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn engine() -> MujocoEngine {
    MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap()
}

fn controller(task: &dyn ArmTask) -> Box<dyn Policy> {
    let robot = built_in_robot("franka").unwrap();
    let chain = robogate_physics::Engine::chain(&engine()).clone();
    task.controller(robot, chain)
}

/// Scenarios of a task's default space. All of them have one topology.
fn scenarios(task: &dyn ArmTask, count: usize) -> Vec<Scenario> {
    let gripper = built_in_robot("franka").unwrap().settings.gripper;
    let space = Arc::new(ParameterSpace::from_toml(built_in_space(task.space(&gripper)).unwrap()).unwrap());
    let design = samplers::Uniform.design(&space, count, Seed::campaign(5).stream("worlds")).unwrap();
    let scenario = |i: usize| {
        let index = i as u64;
        Scenario { index, seed: Seed::campaign(5).episode(index), requested: design.assignment(i).unwrap() }
    };
    (0..design.len()).map(scenario).collect()
}

fn single(task: &dyn ArmTask, scenarios: &[Scenario]) -> Vec<Episode> {
    let mut environment = task.environment(Box::new(engine()), Rig::default()).unwrap();
    let mut policy = controller(task);
    scenarios.iter().map(|scenario| rollout(&mut *environment, &mut *policy, scenario)).collect()
}

#[test]
#[ignore = "takes minutes on Warp's CPU device: scripts/worlds.sh runs it"]
fn worlds_agree_with_mujoco() {
    let Some(process) = Process::start() else { return };
    let limit = |name: &str| (name.into(), Value::Number(5.0));
    let task = PickPlace::DEFAULT.with(&[limit("time_limit_s")].into_iter().collect()).unwrap();
    let scenarios = scenarios(&*task, 8);
    let (many, one) = (process.episodes(&*task, &scenarios, 8), single(&*task, &scenarios));
    for (many, one) in many.iter().zip(&one) {
        println!(
            "{:?} after {} periods; in many worlds {:?} after {}",
            one.outcome, one.ticks, many.outcome, many.ticks
        );
        assert!(!matches!(many.outcome, Outcome::Invalid(_)), "{:?}", many.outcome);
        assert_eq!(many.applied, one.applied);
        // One of these scenarios ends with a collision: an obstacle that stands elsewhere changes it.
        assert_eq!(many.outcome, one.outcome);
    }
    assert!(one.iter().any(|episode| episode.outcome != one[0].outcome), "all outcomes are equal");
    // An episode depends neither on its slot nor on the worlds beside it. Fewer slots also refill worlds.
    assert_eq!(process.episodes(&*task, &scenarios[..3], 2), many[..3]);
}
