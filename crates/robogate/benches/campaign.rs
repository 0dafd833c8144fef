//! Measures the overhead of a campaign over its physics, as ratios within one run.
//!
//! `cargo bench -p robogate --bench campaign [-- EPISODES]`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark prints, and fails by panicking")]

use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use mujoco_rs::prelude::{MjData, MjModel};
use nalgebra::{Isometry3, Vector3};
use robogate_campaign::{Executor, ThreadPool, Worker, WorkerFactory};
use robogate_core::{ContactPoint, Design, Fault, ParameterSpace, Sampler, Scenario, Seed, rollout, samplers};
use robogate_physics::{
    Chain, Engine, EngineBuild, JointTargets, MujocoEngine, Readback, Robot, Scene, Side, Touches, Wrench,
    built_in_robot,
};
use robogate_tasks::pick_place::{FRANKA_SPACE, PickPlace, Scripted};
use robogate_tasks::{ArmTask, Rig};

fn main() {
    let episodes = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(200);
    let space = Arc::new(ParameterSpace::from_toml(FRANKA_SPACE).unwrap());
    for name in samplers::NAMES {
        let sampler = samplers::by_name(name).unwrap();
        let (time, _) = timed(|| sampler.design(&space, 10_000, Seed::campaign(1).stream("bench")).unwrap());
        println!("sampling 10,000 points, {name}: {:.2} s", time.as_secs_f64());
    }
    let design = samplers::Uniform.design(&space, episodes, Seed::campaign(1).stream("bench")).unwrap();

    // The recorded targets of every time step let bare MuJoCo run the same steps.
    let tapes = record(&design);
    let steps: usize = tapes.iter().map(|tape| tape.targets.len()).sum();
    let engine = MujocoEngine::new(robot(), MujocoEngine::TIME_STEP_S).unwrap();
    let mut worlds: Vec<(MjData<Rc<MjModel>>, &Tape)> =
        tapes.iter().map(|tape| (MjData::new(Rc::new(engine.compile(&tape.scene).unwrap())), tape)).collect();
    let (bare, ()) = timed(|| worlds.iter_mut().for_each(|(data, tape)| tape.step(data, &engine)));
    let (one, ()) = timed(|| campaign(&design, 1));
    let (two, ()) = timed(|| campaign(&design, 2));
    let per_second = |time: Duration| episodes as f64 / time.as_secs_f64();
    println!("{episodes} episodes, {steps} steps of {} ms", 1e3 * MujocoEngine::TIME_STEP_S);
    println!("bare stepping {:.0} steps/s", steps as f64 / bare.as_secs_f64());
    println!("campaign, 1 thread {:.1} episodes/s: {:.3} x bare stepping", per_second(one), ratio(one, bare));
    println!("campaign, 2 threads {:.1} episodes/s: {:.2} x one thread", per_second(two), ratio(one, two));
}

fn timed<T>(work: impl FnOnce() -> T) -> (Duration, T) {
    let start = Instant::now();
    let result = work();
    (start.elapsed(), result)
}

fn ratio(a: Duration, b: Duration) -> f64 {
    a.as_secs_f64() / b.as_secs_f64()
}

fn robot() -> Robot {
    built_in_robot("franka").unwrap()
}

fn scenario(design: &Design, i: usize) -> Scenario {
    let index = i as u64;
    Scenario { index, seed: Seed::campaign(1).episode(index), requested: design.assignment(i).unwrap() }
}

struct Franka;

impl WorkerFactory for Franka {
    fn worker(&self) -> Result<Worker, Fault> {
        let engine = MujocoEngine::new(robot(), MujocoEngine::TIME_STEP_S).unwrap();
        let policy = Scripted::new(robot(), engine.chain().clone());
        Ok(Worker {
            environment: Box::new(PickPlace::default().on(Box::new(engine), Rig::default()).unwrap()),
            policy: Box::new(policy),
        })
    }
}

fn campaign(design: &Design, threads: usize) {
    let pool =
        ThreadPool { factory: &Franka, threads: NonZeroUsize::new(threads).unwrap(), stop: &AtomicBool::new(false) };
    pool.execute(&|i| (i < design.len()).then(|| scenario(design, i)), &mut |_| ControlFlow::Continue(())).unwrap();
}

/// The commands that an engine received in one episode.
struct Tape {
    scene: Scene,
    start: Vec<f64>,
    targets: Vec<JointTargets>,
}

impl Tape {
    fn step(&self, data: &mut MjData<Rc<MjModel>>, engine: &MujocoEngine) {
        let arm = &engine.robot().settings.arm;
        let n = self.start.len();
        data.qpos_mut()[..n].copy_from_slice(&self.start);
        data.qpos_mut()[n..n + 2].fill(0.04);
        for targets in &self.targets {
            let ctrl = data.ctrl_mut();
            for (i, ctrl) in ctrl[..n].iter_mut().enumerate() {
                *ctrl = targets.positions[i] + targets.velocities[i] * arm.damping_nms_rad[i] / arm.stiffness_nm_rad[i];
            }
            ctrl[n..].fill(targets.finger);
            data.step();
        }
    }
}

fn record(design: &Design) -> Vec<Tape> {
    let inner = MujocoEngine::new(robot(), MujocoEngine::TIME_STEP_S).unwrap();
    let mut policy = Scripted::new(robot(), inner.chain().clone());
    let tapes = Rc::new(std::cell::RefCell::new(Vec::new()));
    let mut simulator =
        PickPlace::default().on(Box::new(Recorder { inner, tapes: Rc::clone(&tapes) }), Rig::default()).unwrap();
    for i in 0..design.len() {
        rollout(&mut simulator, &mut policy, &scenario(design, i));
    }
    tapes.take()
}

/// An engine that records its commands.
struct Recorder {
    inner: MujocoEngine,
    tapes: Rc<std::cell::RefCell<Vec<Tape>>>,
}

impl Engine for Recorder {
    fn load(&mut self, scene: &Scene, joints: &[f64]) -> Result<(), Fault> {
        self.tapes.borrow_mut().push(Tape { scene: scene.clone(), start: joints.to_vec(), targets: Vec::new() });
        self.inner.load(scene, joints)
    }

    fn advance(&mut self, targets: &JointTargets) {
        self.tapes.borrow_mut().last_mut().unwrap().targets.push(targets.clone());
        self.inner.advance(targets);
    }

    fn force_between(&self, one: Side, other: Side) -> Option<f64> {
        self.inner.force_between(one, other)
    }

    fn build(&self) -> EngineBuild {
        self.inner.build()
    }

    fn robot(&self) -> &Robot {
        self.inner.robot()
    }

    fn chain(&self) -> &Chain {
        self.inner.chain()
    }

    fn time_step(&self) -> f64 {
        self.inner.time_step()
    }

    fn read_back(&self) -> Result<Readback, Fault> {
        self.inner.read_back()
    }

    fn health(&self) -> Result<(), Fault> {
        self.inner.health()
    }

    fn joint_positions(&self) -> Vec<f64> {
        self.inner.joint_positions()
    }

    fn joint_velocities(&self) -> Vec<f64> {
        self.inner.joint_velocities()
    }

    fn opening(&self) -> Option<f64> {
        self.inner.opening()
    }

    fn select(&mut self, body: usize) {
        self.inner.select(body);
    }

    fn free_body(&self, body: usize) -> Isometry3<f64> {
        self.inner.free_body(body)
    }

    fn free_body_velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>) {
        self.inner.free_body_velocity(body)
    }

    fn attach(&mut self) {
        self.inner.attach();
    }

    fn detach(&mut self) {
        self.inner.detach();
    }

    fn cup_load(&self) -> Option<Wrench> {
        self.inner.cup_load()
    }

    fn tcp(&self) -> Isometry3<f64> {
        self.inner.tcp()
    }

    fn fixture(&self, fixture: usize) -> Isometry3<f64> {
        self.inner.fixture(fixture)
    }

    fn object(&self) -> Isometry3<f64> {
        self.inner.object()
    }

    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>) {
        self.inner.object_velocity()
    }

    fn touches(&self) -> &Touches {
        self.inner.touches()
    }

    fn support(&self) -> Wrench {
        self.inner.support()
    }

    fn contact_points(&self) -> Vec<ContactPoint> {
        self.inner.contact_points()
    }

    fn clearance_below(&mut self, bound: f64) -> Option<f64> {
        self.inner.clearance_below(bound)
    }

    fn robot_body(&self, body: usize) -> String {
        self.inner.robot_body(body)
    }

    fn state_bits(&self, sink: &mut dyn FnMut(u64)) {
        self.inner.state_bits(sink);
    }
}
