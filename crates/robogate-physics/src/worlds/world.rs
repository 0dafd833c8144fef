//! One world: its scene, its drives, and what the simulator reports about it.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Fault, FaultKind, RegionForces};

use super::member::{Entry, Place, Rows};
use crate::mujoco::numbers::Stage;
use crate::plant::{unit_grip_force, unrest};
use crate::unrest::Unrest;
use crate::{
    Collision, Engine, Fixture, FixtureKind, GripperCommand, GripperState, Hit, MujocoEngine, Object, Part, Primitive,
    Readback, Scene, Servo, StepView, Touches, Wrench, isometry,
};

/// Numbers of a report before those of the free bodies, and of each free body.
const REPORT: usize = 28;
const BODY: usize = 13;
/// Flags of a report.
const BODY_ON_OBJECT: u32 = 1;
const OBJECT_ON_FIXTURE: u32 = 2;
const NOT_FINITE: u32 = 4;

/// Scenes with at most so many boxes and cylinders that stand still have the same topology, whatever they are.
const SPARES: usize = 5;
/// Objects with at most so many boxes, cylinders and balls have the same topology: those that an object lacks are out of reach.
const SPARE_PARTS: [usize; 3] = [2, 1, 1];
/// Spare fixtures are this far below the table, in metres. Spare parts are twice as far below their object.
const SPARE_DEPTH_M: f64 = 0.5 * Part::OUT_OF_REACH_M;

/// The parts of an object by their kinds, with spare ones. Also returns the index of each in the object. `None` if there are too
/// many.
fn with_spare_parts(object: &Object) -> Option<(Object, Vec<Option<usize>>)> {
    let kind = |primitive: &Primitive| match primitive {
        Primitive::Box { .. } => 0,
        Primitive::Cylinder { .. } => 1,
        Primitive::Sphere { .. } => 2,
        Primitive::Hull(_) => SPARE_PARTS.len(),
    };
    if object.parts.iter().any(|part| kind(&part.primitive) == SPARE_PARTS.len()) {
        return None;
    }
    let (size, pose) = (1e-3, Isometry3::translation(0.0, 0.0, -Part::OUT_OF_REACH_M));
    let spares = [
        Primitive::Box { half: [size; 3] },
        Primitive::Cylinder { radius: size, half_height: size },
        Primitive::Sphere { radius: size },
    ];
    let (mut parts, mut order) = (Vec::new(), Vec::new());
    for (own, (spare, count)) in spares.into_iter().zip(SPARE_PARTS).enumerate() {
        let those = object.parts.iter().enumerate().filter(|(_, part)| kind(&part.primitive) == own);
        let first = parts.len();
        for (index, part) in those {
            parts.push(part.clone());
            order.push(Some(index));
        }
        if parts.len() > first + count {
            return None;
        }
        parts.resize_with(first + count, || Part { primitive: spare.clone(), pose });
        order.resize(first + count, None);
    }
    Some((Object { parts, ..object.clone() }, order))
}

/// The same scene with its fixtures in an order that depends on their kinds alone, and spare ones out of reach. Also returns the
/// index in `scene` of each fixture.
fn with_spares(scene: &Scene) -> (Scene, Vec<Option<usize>>) {
    let (mut kept, mut boxes, mut cylinders) = (Vec::new(), Vec::new(), Vec::new());
    for (index, fixture) in scene.fixtures.iter().enumerate() {
        match (fixture.kind, &fixture.part.primitive, fixture.motion) {
            (FixtureKind::Obstacle, Primitive::Box { .. }, None) => boxes.push((Some(index), fixture.clone())),
            (FixtureKind::Obstacle, Primitive::Cylinder { .. }, None) => cylinders.push((Some(index), fixture.clone())),
            _ => kept.push((Some(index), fixture.clone())),
        }
    }
    for (fixtures, primitive, side) in [
        (&mut boxes, Primitive::Box { half: [0.02; 3] }, 1.0),
        (&mut cylinders, Primitive::Cylinder { radius: 0.02, half_height: 0.02 }, -1.0),
    ] {
        for k in fixtures.len()..SPARES {
            let pose = Isometry3::translation(0.0, side * (k + 1) as f64, -SPARE_DEPTH_M);
            let (name, kind) = (String::new(), FixtureKind::Obstacle);
            let part = Part { primitive: primitive.clone(), pose };
            fixtures.push((None, Fixture { name, kind, part, motion: None, friction: None, color: None }));
        }
    }
    let (order, mut fixtures): (Vec<_>, Vec<_>) = kept.into_iter().chain(boxes).chain(cylinders).unzip();
    fixtures.iter_mut().enumerate().for_each(|(k, fixture)| fixture.name = format!("fixture {k}"));
    (Scene { fixtures, ..scene.clone() }, order)
}

/// A world in a simulator, with the scene as MuJoCo has compiled it in this process.
#[derive(Debug)]
pub struct World {
    stage: Option<Stage>,
    /// What the simulator needs, until it has it.
    pub(super) entry: Option<Entry>,
    pub(super) place: Option<(Place, Rows)>,
    servo: Servo,
    unrest: Unrest,
    grip_force_n: f64,
    softness: f64,
    selected: usize,
    /// The index in the scene of each fixture of the world. `None` for a spare one.
    fixtures: Vec<Option<usize>>,
    /// The same for the parts of the object. `None` if they are those of the scene.
    parts: Option<Vec<Option<usize>>>,
    bodies: usize,
    steps_per_period: usize,
    steps: u64,
    last: StepReport,
}

/// The report of a time step.
#[derive(Debug, Clone)]
pub struct StepReport {
    opening: f64,
    touches: Touches,
    tcp: Isometry3<f64>,
    support: Wrench,
    /// Pose, velocity (m/s) and angular velocity (rad/s) of each free body.
    bodies: Vec<(Isometry3<f64>, Vector3<f64>, Vector3<f64>)>,
    selected: usize,
}

impl StepReport {
    /// The state of an engine.
    fn of(engine: &MujocoEngine) -> Self {
        let body = |body: usize| {
            let (linear, angular) = engine.free_body_velocity(body);
            (engine.free_body(body), linear, angular)
        };
        Self {
            opening: engine.opening().unwrap_or_default(),
            touches: engine.touches().clone(),
            tcp: engine.tcp(),
            support: engine.support(),
            bodies: (0..engine.free_bodies()).map(body).collect(),
            selected: 0,
        }
    }

    /// The state for an observer, at this fraction of the control period.
    pub fn view(&self, fraction: f64) -> StepView<'_> {
        let (object, linear, angular) = self.bodies[self.selected];
        StepView {
            fraction,
            gripper: GripperState::Fingers(self.opening),
            touches: &self.touches,
            object,
            velocity: (linear, angular),
            tcp: self.tcp,
        }
    }

    /// Pose of the tool centre point.
    pub fn tcp(&self) -> &Isometry3<f64> {
        &self.tcp
    }

    /// Pose of a free body.
    pub fn pose(&self, body: usize) -> Isometry3<f64> {
        self.bodies[body].0
    }

    /// Velocity (m/s) and angular velocity (rad/s) of a free body.
    pub fn velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>) {
        let (_, linear, angular) = self.bodies[body];
        (linear, angular)
    }

    /// Wrench of the fixtures and the other free bodies on the object, about its centre of mass.
    pub fn support(&self) -> Wrench {
        self.support
    }
}

/// What a simulator reports about a control period of one world, as it is in the tables.
#[derive(Debug, Clone, Default)]
pub struct Period {
    pub(super) reports: Vec<f32>,
    pub(super) qpos: Vec<f32>,
    pub(super) qvel: Vec<f32>,
    pub(super) lost: u32,
}

impl World {
    /// The world of a scene, with the arm at home and at rest, and the gripper open. `grip_force_n` is the grip force of the robot, and
    /// `period_s` the control period. The scene is then loaded in `engine` until [`Self::leave`].
    ///
    /// # Errors
    /// If the scene cannot be compiled, or the robot has a part that such worlds cannot simulate.
    pub fn new(engine: &mut MujocoEngine, scene: &Scene, grip_force_n: f64, period_s: f64) -> Result<Self, Fault> {
        let home = engine.robot().settings.arm.home_rad.clone();
        let grip_force_n = unit_grip_force(&engine.robot().settings.gripper, grip_force_n, scene.gripper.force_scale)?;
        let (mut same, fixtures) = with_spares(scene);
        // The shapes of a single object are drawn from the scenario. Those of several bodies belong to the task.
        let parts = if scene.others.is_empty() { with_spare_parts(&scene.object) } else { None };
        let parts = parts.map(|(object, order)| {
            same.object = object;
            order
        });
        engine.load(&same, &home)?;
        let steps_per_period = (period_s / engine.time_step()).round() as usize;
        Ok(Self {
            stage: None,
            entry: Some(Entry {
                plan: engine.plan(steps_per_period)?,
                numbers: engine.numbers(),
                model: engine.model_bytes(),
            }),
            place: None,
            servo: Servo::at_rest(&home, period_s),
            unrest: Unrest::default(),
            grip_force_n,
            softness: scene.arm_stiffness.sqrt(),
            selected: 0,
            fixtures,
            parts,
            bodies: engine.free_bodies(),
            steps_per_period,
            steps: 0,
            last: StepReport::of(engine),
        })
    }

    /// Grip force in newtons.
    pub fn grip_force_n(&self) -> f64 {
        self.grip_force_n
    }

    /// The state after the last time step, or at the start.
    pub fn last(&self) -> &StepReport {
        &self.last
    }

    /// The physical quantities of the scene, with the fixtures as the scene numbers them.
    ///
    /// # Errors
    /// As [`Engine::read_back`].
    pub fn read_back(&self, engine: &MujocoEngine) -> Result<Readback, Fault> {
        let mut found = engine.read_back()?;
        found.fixtures.retain_mut(|read| {
            let fixture = self.fixtures[read.fixture];
            read.fixture = fixture.unwrap_or_default();
            fixture.is_some()
        });
        if let Some(order) = &self.parts {
            let read = order.iter().zip(&found.parts).filter_map(|(index, part)| Some(((*index)?, part.clone())));
            let mut read: Vec<(usize, Primitive)> = read.collect();
            read.sort_by_key(|(index, _)| *index);
            found.parts = read.into_iter().map(|(_, part)| part).collect();
        }
        Ok(found)
    }

    /// Poses of the fixtures, as the scene numbers them.
    pub fn fixture_poses(&self, engine: &MujocoEngine) -> Vec<Isometry3<f64>> {
        let mut poses: Vec<(usize, Isometry3<f64>)> =
            self.fixtures.iter().enumerate().filter_map(|(own, of)| Some(((*of)?, engine.fixture(own)))).collect();
        poses.sort_by_key(|(fixture, _)| *fixture);
        poses.into_iter().map(|(_, pose)| pose).collect()
    }

    /// Loads this world's scene in its last state into `engine`.
    pub fn enter(&mut self, engine: &mut MujocoEngine) {
        if let Some(stage) = self.stage.take() {
            engine.put(stage);
        }
    }

    /// Takes this world's scene out of `engine`.
    pub fn leave(&mut self, engine: &mut MujocoEngine) {
        self.stage = engine.take();
    }

    /// Selects the free body that the gripper acts on.
    pub fn select(&mut self, body: usize) {
        if body < self.bodies {
            self.selected = body;
        }
    }

    /// The command of the next control period: joint positions (rad), and the gripper.
    pub fn command(&mut self, engine: &MujocoEngine, joints: &[f64], gripper: GripperCommand) -> Vec<f32> {
        let settings = &engine.robot().settings;
        self.servo.command(joints, &settings.arm, engine.chain());
        let mut row: Vec<f64> = self.servo.control_points().concat();
        let (open, stiffness, speed) = settings
            .gripper
            .jaw()
            .map_or((0.0, 1.0, 0.0), |jaw| (jaw.opening_m, jaw.stiffness_n_m, jaw.finger_speed_m_s));
        let (goal, grip) = match gripper {
            GripperCommand::Open => (0.5 * open, 0.0),
            GripperCommand::Close => (-0.5 * open, 1.0),
        };
        let (lead, speed) = (self.grip_force_n / stiffness, speed * engine.time_step());
        row.extend([goal, lead, speed, self.softness, self.selected as f64, self.steps as f64, grip]);
        row.into_iter().map(|number| number as f32).collect()
    }

    /// Reads a control period, and loads this world's scene in its new state into `engine`. `observe` gets each time step, with the
    /// fraction of the period.
    ///
    /// # Errors
    /// If the simulator lost contacts or diverged, or the fingers do not come to rest.
    pub fn read(
        &mut self,
        engine: &mut MujocoEngine,
        period: &Period,
        gripper: GripperCommand,
        observe: &mut dyn FnMut(&StepReport, f64),
    ) -> Result<(), Fault> {
        let diverged = |why: &str| Err(Fault::new(FaultKind::Diverged, why));
        let width = REPORT + BODY * self.bodies;
        let mut restless = None;
        for (k, numbers) in period.reports.chunks_exact(width).enumerate() {
            if numbers[3] as u32 & NOT_FINITE != 0 {
                return diverged("MuJoCo Warp: the state is not finite");
            }
            let report = self.report(numbers);
            restless = self.unrest.step(gripper, report.opening, engine.time_step()).or(restless);
            observe(&report, (k + 1) as f64 / self.steps_per_period as f64);
            self.last = report;
        }
        self.steps += self.steps_per_period as u64;
        restless.map_or(Ok(()), |frequency| Err(unrest(frequency)))?;
        if period.lost != 0 {
            return diverged(&format!("MuJoCo Warp: a buffer of contacts or constraints is full ({})", period.lost));
        }
        self.enter(engine);
        engine.set_state(&period.qpos, &period.qvel, self.steps);
        Ok(())
    }

    fn report(&self, numbers: &[f32]) -> StepReport {
        let at = |i: usize| f64::from(numbers[i]);
        let vector = |i: usize| Vector3::new(at(i), at(i + 1), at(i + 2));
        let force = |i: usize| (numbers[i] >= 0.0).then(|| at(i));
        let flags = numbers[3] as u32;
        let hit = |other: usize| match self.fixtures.get(other) {
            // The robot cannot reach a spare fixture.
            Some(fixture) => Hit::Fixture(fixture.unwrap_or_default()),
            None => Hit::Itself(other - self.fixtures.len()),
        };
        let touches = Touches {
            fingers: [force(1), force(2)],
            body_on_object: flags & BODY_ON_OBJECT != 0,
            object_on_fixture: flags & OBJECT_ON_FIXTURE != 0,
            collision: force(6).map(|force| Collision {
                robot_body: numbers[4] as usize,
                hit: hit(numbers[5] as usize),
                force,
            }),
            peak_force: force(7),
            regions: RegionForces::default(),
            squeeze: None,
        };
        let turn = Rotation3::from_matrix_unchecked(Matrix3::from_fn(|row, column| at(11 + 3 * row + column)));
        let bodies = (0..self.bodies).map(|body| {
            let i = REPORT + BODY * body;
            let pose = isometry(&[at(i), at(i + 1), at(i + 2)], &[at(i + 3), at(i + 4), at(i + 5), at(i + 6)]);
            (pose, vector(i + 7), vector(i + 10))
        });
        StepReport {
            opening: at(0),
            touches,
            tcp: Isometry3::from_parts(Translation3::from(vector(8)), UnitQuaternion::from_rotation_matrix(&turn)),
            support: Wrench { force: vector(20), torque: vector(23) },
            bodies: bodies.collect(),
            selected: self.selected,
        }
    }
}
