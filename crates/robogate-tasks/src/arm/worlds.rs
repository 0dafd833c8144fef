//! A task for an arm in many worlds of a simulator, each judged like an engine of this process.

use std::num::NonZeroUsize;
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use robogate_camera::{Cameras, Posture};
use robogate_core::{
    Action, BatchEnvironment, Ending, Fault, FaultKind, Foresight, Image, Scenario, Start, Step, TaskSpec,
};
use robogate_physics::worlds::{Member, Period, StepReport, World};
use robogate_physics::{ArmState, Engine, GripperCommand, MujocoEngine, Scene, grip_force, state_hash};

use super::forces::no_wrist_sensor;
use super::judge::Judge;
use super::rules::{Bodies, Found, Rules};
use super::{CONTROL_PERIOD_S, HasSettings, Rig, camera_specs, cameras, posture, render, show};

/// A task for an arm in many worlds.
pub struct ArmWorlds {
    /// It holds one scene at a time: for compilation, and to measure and render what the simulator reports.
    engine: MujocoEngine,
    member: Member,
    slots: Vec<Slot>,
    grip_force_n: f64,
    cameras: Result<Cameras, String>,
}

/// The episode of one slot.
struct Slot {
    judge: Judge,
    world: Option<World>,
    /// The scene, for the cameras.
    scene: Option<Scene>,
}

impl std::fmt::Debug for ArmWorlds {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ArmWorlds").field("slots", &self.slots.len()).finish_non_exhaustive()
    }
}

impl ArmWorlds {
    /// Creates the task in these worlds, see [`super::ArmTask::worlds`].
    pub(crate) fn new<T: Rules + HasSettings + 'static>(
        task: &T,
        engine: MujocoEngine,
        rig: Rig,
        member: Member,
        slots: NonZeroUsize,
    ) -> Result<Self, String> {
        no_wrist_sensor(task.arm())?;
        let grip_force_n = grip_force(&engine.robot().settings.gripper, task.arm().grip_force_n)?;
        let cameras = cameras(engine.robot(), rig.picture_px);
        let (robot, chain) = (engine.robot().clone(), engine.chain().clone());
        let judge = Judge::new(task, (robot, chain), grip_force_n, camera_specs(&cameras));
        let mut all: Vec<Slot> =
            (1..slots.get()).map(|_| Slot { judge: judge.another(), world: None, scene: None }).collect();
        all.push(Slot { judge, world: None, scene: None });
        Ok(Self { engine, member, slots: all, grip_force_n, cameras })
    }

    fn start(&mut self, slot: usize, scenario: &Scenario) -> Result<Start, Fault> {
        let Self { engine, member, slots, grip_force_n, cameras } = self;
        let Slot { judge, world, scene } = &mut slots[slot];
        if let Some(mut ended) = world.take() {
            member.release(&mut ended);
        }
        let resolved = judge.resolve(scenario)?;
        let mut new = World::new(engine, &resolved.scene, *grip_force_n, CONTROL_PERIOD_S)?;
        let visual = show(cameras, &resolved.scene);
        let found = Found {
            engine: &new.read_back(engine)?,
            visual: &visual,
            grip_threshold_m: None,
            grip_force_scale: Some(new.grip_force_n() / *grip_force_n),
        };
        *scene = Some(resolved.scene.clone());
        let started = judge.start(scenario, resolved, &found, engine.touches(), ArmState::of(engine));
        new.leave(engine);
        *world = Some(new);
        started
    }
}

impl Slot {
    /// The command of an action for the simulator.
    fn command(&mut self, action: &Action, engine: &MujocoEngine) -> Result<Vec<f32>, Fault> {
        let joints = self.judge.command(action)?;
        let Some(world) = &mut self.world else {
            return Err(Fault::new(FaultKind::Setup, "this world was not stepped together with the others"));
        };
        if let Some(body) = self.judge.select(world.last().tcp(), world.last()) {
            world.select(body);
        }
        Ok(world.command(engine, &joints, GripperCommand::of(action)))
    }

    /// Judges a control period.
    fn finish(&mut self, action: &Action, period: &Period, engine: &mut MujocoEngine) -> Result<Step, Fault> {
        let Self { judge, world, .. } = self;
        let Some(world) = world else { return Err(Fault::new(FaultKind::Setup, "no episode is running")) };
        world.read(engine, period, GripperCommand::of(action), &mut |report, fraction| {
            judge.observe(&report.view(fraction), report);
        })?;
        let clearance = judge.clearance_bound().and_then(|bound| engine.clearance_below(bound));
        let hash = state_hash(engine);
        let step = judge.finish(ArmState::of(engine), clearance, hash, |body| engine.robot_body(body));
        world.leave(engine);
        step
    }
}

impl BatchEnvironment for ArmWorlds {
    fn task(&self) -> &Arc<TaskSpec> {
        self.slots[0].judge.task()
    }

    fn slots(&self) -> NonZeroUsize {
        NonZeroUsize::new(self.slots.len()).unwrap_or(NonZeroUsize::MIN)
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.slots[0].judge.foresight()
    }

    fn reset(&mut self, scenarios: &[(usize, &Scenario)]) -> Vec<Result<Start, Fault>> {
        scenarios.iter().map(|(slot, scenario)| self.start(*slot, scenario)).collect()
    }

    fn step(&mut self, actions: &[(usize, &Action)]) -> Vec<Result<Step, Fault>> {
        let Self { engine, member, slots, .. } = self;
        let mut replies: Vec<Option<Result<Step, Fault>>> = (0..slots.len()).map(|_| None).collect();
        let mut running = Vec::new();
        let mut exchanged: Vec<(&mut World, Vec<f32>)> = Vec::new();
        let mut listed: Vec<Option<&Action>> = vec![None; slots.len()];
        actions.iter().for_each(|(slot, action)| listed[*slot] = Some(action));
        for (at, slot) in slots.iter_mut().enumerate() {
            match listed[at] {
                Some(action) => match (slot.command(action, engine), &mut slot.world) {
                    (Ok(command), Some(world)) => {
                        running.push((at, action));
                        exchanged.push((world, command));
                    }
                    (Ok(_), None) => {}
                    (Err(fault), _) => replies[at] = Some(Err(fault)),
                },
                // All worlds of the simulator are stepped together, so this one has no known state any more.
                None => {
                    if let Some(mut missed) = slot.world.take() {
                        member.release(&mut missed);
                    }
                }
            }
        }
        let periods = match exchanged.is_empty() {
            true => Ok(Vec::new()),
            false => member.exchange(&mut exchanged),
        };
        let periods = periods.unwrap_or_else(|fault| running.iter().map(|_| Err(fault.clone())).collect());
        for ((at, action), period) in running.into_iter().zip(periods) {
            let step = period.and_then(|period| slots[at].finish(action, &period, engine));
            if step.is_err() {
                slots[at].judge.abandon();
            }
            replies[at] = Some(step);
        }
        let lacks = || Err(Fault::new(FaultKind::Setup, "no episode is running"));
        actions.iter().map(|(slot, _)| replies[*slot].take().unwrap_or_else(lacks)).collect()
    }

    fn foregone_ending(&self, slot: usize) -> Option<Ending> {
        self.slots[slot].judge.foregone_ending()
    }

    fn render(&mut self, slots: &[usize]) -> Vec<Result<Vec<Image>, Fault>> {
        let Self { engine, cameras, slots: all, .. } = self;
        let mut images = Vec::with_capacity(slots.len());
        for slot in slots {
            let Slot { world: Some(world), scene: Some(scene), .. } = &mut all[*slot] else {
                images.push(Err(Fault::new(FaultKind::Setup, "no episode is running")));
                continue;
            };
            world.enter(engine);
            show(cameras, scene);
            let fixtures = world.fixture_poses(engine);
            images.push(render(cameras, |[_, others]| Posture { fixtures, ..posture(engine, [0, others]) }));
            world.leave(engine);
        }
        images
    }
}

impl Bodies for StepReport {
    fn pose(&self, body: usize) -> Isometry3<f64> {
        self.pose(body)
    }

    fn velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>) {
        self.velocity(body)
    }

    fn support(&self) -> Vector3<f64> {
        self.support().force
    }
}
