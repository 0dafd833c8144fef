//! The MuJoCo engine.
//!
//! Each scene is compiled from the robot's model and the scene's bodies, which takes about a millisecond and prevents
//! any state from carrying over to the next episode. These settings make grasps correct (`robogate check physics`
//! measures them): implicit integration, elliptic friction cones with `impratio` 10, and contacts of the object as
//! stiff as the default time step allows.

mod contacts;
pub(crate) mod damping;
mod export;
mod inspection;
mod joints;
pub(crate) mod links;
pub(crate) mod numbers;
pub(crate) mod probe;
mod scene;
pub(crate) mod sweep;

use std::sync::{Arc, Mutex, Once};

use mujoco_loader::{Library, LoadError};
use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_logging::{log_config, set_log_config};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{ContactPoint, Fault, FaultKind, Region};

use self::damping::Strong;
pub use self::export::{Input, Tape};
use self::sweep::DriveAt;
use crate::contact_sums::ContactSums;
use crate::finger_motion::DriveReading;
use crate::friction::Friction;
use crate::robot_model::Built;
use crate::{
    BELLOWS_JOINT, Chain, Engine, EngineBuild, FingerMotion, FixtureRead, FreeBodyRead, JointKind, JointTargets,
    Motion, Primitive, Readback, Robot, RobotError, Scene, Side, Touches, Wrench, isometry, robot_model,
};

/// Contact masks (`contype`, `conaffinity`). The robot collides with object and fixtures, the object with fixtures. At first
/// the robot does not collide with itself: its fingers are measured through each other.
/// [`links::let_links_collide`] changes that.
pub(crate) const ROBOT: (i32, i32) = (1, 0);
/// The masks of a robot whose links collide with each other.
const ROBOT_WITH_ITSELF: (i32, i32) = (1, 1);
const OBJECT: (i32, i32) = (2, 1);
/// A body on a joint collides with the robot and with free bodies: its joint guides it through its fixtures.
const JOINTED: (i32, i32) = (4, 3);
const FIXTURE: (i32, i32) = (0, 3);

/// Prefix of the names of fixtures and object in the compiled model, so that they differ from a robot's names.
pub const PREFIX: &str = "robogate/";

/// MuJoCo with one robot.
pub struct MujocoEngine {
    robot: Robot,
    base: MjSpec,
    chain: Chain,
    /// Motion of fingers with drives.
    fingers: Option<FingerMotion>,
    /// Which joints and drives are strongly damped ([`damping`]).
    strong: Strong,
    time_step: f64,
    loaded: Option<Loaded>,
    /// Where it records what moves its scenes.
    tape: Option<Arc<Mutex<Tape>>>,
}

/// The role of a geom.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Robot {
        body: usize,
        finger: Option<usize>,
    },
    /// A free body, by its index in the scene.
    Object(usize),
    Fixture(usize),
    /// A visual shape without contact.
    Visual,
}

/// A compiled scene and its state.
struct Loaded {
    data: MjData<Box<MjModel>>,
    kinds: Vec<Kind>,
    /// The region of the robot to which each body belongs.
    regions: Vec<Region>,
    /// Addresses of the arm's joints in qpos and qvel.
    arm: Vec<(usize, usize)>,
    /// Addresses of the joints of sliding fingers in qpos and qvel. Empty without such fingers.
    fingers: Vec<(usize, usize)>,
    /// Where the drives of other fingers act. Empty without such fingers.
    drives: Vec<DriveAt>,
    /// Address in qpos of the spring of a suction cup.
    bellows: Option<usize>,
    /// The collision shapes of each finger.
    pads: [Vec<usize>; 2],
    /// Distance between the pads of fingers with drives, in metres.
    gap: f64,
    /// The weld between cup and each free body. Empty without a cup.
    welds: Vec<Weld>,
    /// The free bodies: the object, then the others.
    free: Vec<Free>,
    /// The free body that is the object.
    selected: usize,
    tcp: usize,
    touches: Touches,
    forces: ContactSums,
    scene: Scene,
    /// The fixtures that move.
    movers: Vec<Mover>,
    /// Steps taken since the scene was loaded.
    steps: u64,
}

/// A fixture that moves.
#[derive(Debug, Clone, Copy)]
struct Mover {
    /// The index in the scene.
    fixture: usize,
    /// Addresses of its joint.
    qpos: usize,
    qvel: usize,
    motion: Motion,
}

/// A body that moves freely or on a joint.
#[derive(Debug, Clone, Copy)]
struct Free {
    body: usize,
    /// Addresses of its joint.
    qpos: usize,
    qvel: usize,
}

/// The weld between cup and a free body. It is always part of the model and is switched on and off.
#[derive(Debug, Clone, Copy)]
struct Weld {
    equality: usize,
    cup_body: usize,
}

impl MujocoEngine {
    /// Default time step in seconds. Halving it changes few outcomes (`robogate check physics`).
    pub const TIME_STEP_S: f64 = 0.002;

    /// An engine for this robot, with this time step in seconds.
    ///
    /// # Errors
    /// If MuJoCo cannot be loaded, or if the robot's model does not compile or does not match `robot.toml`; the error lists
    /// all problems.
    pub fn new(robot: Robot, time_step: f64) -> Result<Self, RobotError> {
        load_mujoco().map_err(|error| RobotError::Engine { why: error.to_string() })?;
        let Built { spec, chain, fingers, strong } = robot_model::build(&robot, time_step)
            .map_err(|problems| RobotError::Invalid { path: robot_model::path(&robot), problems })?;
        Ok(Self { robot, base: spec, chain, fingers, strong, time_step, loaded: None, tape: None })
    }

    /// The motion of a robot's fingers, measured in its model.
    pub(crate) fn finger_motion_of(robot: &Robot) -> Result<Option<FingerMotion>, RobotError> {
        Self::new(robot.clone(), Self::TIME_STEP_S).map(|engine| engine.fingers)
    }

    /// Opening of the closed gripper, in metres: 0 where the pads meet.
    pub(crate) fn narrowest_m(&self) -> f64 {
        self.fingers.as_ref().map_or(0.0, FingerMotion::narrowest_m)
    }

    /// Width of the narrowest part that the closed gripper does not let through at the tool centre point, in metres.
    pub(crate) fn narrowest_held_m(&self) -> f64 {
        self.fingers.as_ref().map_or(0.0, |fingers| fingers.closed_at_tool_m.max(fingers.narrowest_m()))
    }

    /// Smallest distance between the fingers' collision shapes in the loaded scene, in metres. `None` without fingers.
    pub(crate) fn pad_gap(&mut self) -> Option<f64> {
        let loaded = self.loaded.as_mut().filter(|loaded| loaded.pads.iter().all(|pad| !pad.is_empty()))?;
        let [first, second] = &loaded.pads;
        Some(sweep::gap(&mut loaded.data, [first, second]))
    }

    /// The loaded scene. All methods that read the state require one.
    fn loaded(&self) -> &Loaded {
        self.loaded.as_ref().expect("a scene must be loaded before it is read")
    }

    /// Compiles robot and scene to a MuJoCo model.
    pub fn compile(&self, scene: &Scene) -> Result<MjModel, MjEditError> {
        let mut spec = self.base.clone();
        self.furnish(&mut spec, scene)?;
        spec.compile()
    }

    /// The model of the robot alone.
    pub fn base(&self) -> &MjSpec {
        &self.base
    }

    /// Stiffness of the first servo of the arm in the loaded scene, as a multiple of the robot's setting.
    fn arm_stiffness(&self) -> Option<f64> {
        let (model, arm) = (self.loaded().data.model(), &self.robot.settings.arm);
        let name = format!("{PREFIX}{}", arm.joints.first()?);
        let actuator = model.name_to_id(MjtObjBase::mjOBJ_ACTUATOR, &name)?;
        Some(model.actuator_gainprm()[actuator][0] / arm.stiffness_nm_rad[0])
    }

    /// Positions of all joints of the loaded scene, in the compiled model's order.
    pub fn positions(&self) -> &[f64] {
        self.loaded().data.qpos()
    }
}

/// Identifies the loaded MuJoCo.
pub(crate) fn build(library: &Library) -> EngineBuild {
    let version = mujoco_rs::mujoco_version().to_owned();
    EngineBuild { name: "mujoco", version, sha256: Some(library.sha256.clone()) }
}

/// The first warning that MuJoCo has issued since the state was created.
pub(crate) fn warning(data: &MjData<Box<MjModel>>) -> Option<String> {
    let kind = data.warning().iter().position(|warning| warning.number > 0)?;
    let info = data.warning()[kind].lastinfo;
    let what = match kind {
        0 => "the inertia matrix is singular",
        1 => "the contact buffer is full",
        2 => "the constraint buffer is full",
        3 => "a position is not finite or too large",
        4 => "a velocity is not finite or too large",
        5 => "an acceleration is not finite or too large",
        6 => "a control is not finite or too large",
        _ => "warning",
    };
    Some(format!("MuJoCo: {what} (at {info})"))
}

/// Loads the MuJoCo library, once for the process, and stops it from writing its warnings to a file in the current folder.
/// All types of this crate that use MuJoCo call this first; code that uses the binding directly must do so too.
///
/// # Errors
/// If the library is missing and cannot be downloaded, or is not the pinned one.
pub fn load_mujoco() -> Result<&'static Library, LoadError> {
    static ONCE: Once = Once::new();
    let library = mujoco_loader::load()?;
    ONCE.call_once(|| {
        // SAFETY: all use of MuJoCo begins with a constructor that waits for this call, so MuJoCo is not in use.
        #[expect(unsafe_code, reason = "the binding has no safe setter")]
        unsafe {
            set_log_config(log_config().with_logto_file(false));
        }
    });
    Ok(library)
}

/// A rotation as MuJoCo's quaternion (w, x, y, z).
pub fn wxyz(rotation: &UnitQuaternion<f64>) -> [f64; 4] {
    [rotation.w, rotation.i, rotation.j, rotation.k]
}

/// Converts a MuJoCo geom to a primitive. `None` for another shape.
fn primitive(model: &MjModel, geom: usize) -> Option<Primitive> {
    let [a, b, c] = model.geom_size()[geom];
    match model.geom_type()[geom] {
        MjtGeomBase::mjGEOM_BOX => Some(Primitive::Box { half: [a, b, c] }),
        MjtGeomBase::mjGEOM_CYLINDER => Some(Primitive::Cylinder { radius: a, half_height: b }),
        MjtGeomBase::mjGEOM_SPHERE => Some(Primitive::Sphere { radius: a }),
        _ => None,
    }
}

/// A pose from MuJoCo's position (m) and rotation matrix, row by row.
fn rigid(position: [f64; 3], matrix: &[f64; 9]) -> Isometry3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(matrix));
    Isometry3::from_parts(Translation3::from(Vector3::from(position)), UnitQuaternion::from_rotation_matrix(&rotation))
}

fn find(model: &MjModel, kind: MjtObjBase, what: &str, name: &str) -> Result<usize, String> {
    model.name_to_id(kind, name).ok_or_else(|| format!("the model has no {what} `{name}`, which robot.toml names"))
}

impl Engine for MujocoEngine {
    fn build(&self) -> EngineBuild {
        build(load_mujoco().expect("the constructor has loaded MuJoCo"))
    }

    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn chain(&self) -> &Chain {
        &self.chain
    }

    fn time_step(&self) -> f64 {
        self.time_step
    }

    fn load(&mut self, scene: &Scene, joints: &[f64]) -> Result<(), Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
        scene.pad_friction()?;
        let model = self.compile(scene).map_err(|e| setup(format!("MuJoCo cannot compile the scene: {e}")))?;
        let gripper = &self.robot.settings.gripper;
        let id = |kind, what: &str, name: &str| find(&model, kind, what, name).map_err(setup);
        let address = |name: &str| {
            id(MjtObjBase::mjOBJ_JOINT, "joint", name)
                .map(|joint| (model.jnt_qposadr()[joint] as usize, model.jnt_dofadr()[joint] as usize))
        };
        let arm = self.robot.settings.arm.joints.iter().map(|name| address(name)).collect::<Result<Vec<_>, _>>()?;
        let (mut fingers, mut drives) = (Vec::new(), Vec::new());
        let mut finger_bodies = Vec::new();
        if let Some(jaw) = gripper.jaw() {
            for joint in jaw.slides() {
                fingers.push(address(joint)?);
            }
            for body in &jaw.finger_bodies {
                finger_bodies.push(id(MjtObjBase::mjOBJ_BODY, "body", body)?);
            }
            for name in self.fingers.iter().flat_map(|fingers| fingers.driven(jaw)) {
                drives.push(DriveAt::find(&model, name).ok_or_else(|| setup(format!("the model has no `{name}`")))?);
            }
        }
        let bellows = gripper.cup().and_then(|cup| cup.bellows).map(|_| address(BELLOWS_JOINT)).transpose()?;
        let mut welds = Vec::new();
        let mut free = Vec::new();
        for i in 0..=scene.others.len() {
            if let Some(cup) = gripper.cup() {
                let equality = id(MjtObjBase::mjOBJ_EQUALITY, "joint", &scene::weld_name(i))?;
                let cup_body = id(MjtObjBase::mjOBJ_BODY, "body", &cup.cup_body)?;
                welds.push(Weld { equality, cup_body });
            }
            let name = scene::free_name(i);
            let (qpos, qvel) = address(&name)?;
            free.push(Free { body: id(MjtObjBase::mjOBJ_BODY, "body", &name)?, qpos, qvel });
        }
        let tcp = id(MjtObjBase::mjOBJ_SITE, "site", &self.robot.settings.arm.tcp_site)?;
        let mut kinds = Vec::with_capacity(model.geom_bodyid().len());
        for (geom, body) in model.geom_bodyid().iter().map(|b| *b as usize).enumerate() {
            let named = model.id_to_name(MjtObjBase::mjOBJ_GEOM, geom).and_then(|name| name.strip_prefix(PREFIX));
            let fixture = named.and_then(|name| scene.fixtures.iter().position(|fixture| fixture.name == name));
            let touchable = model.geom_contype()[geom] != 0 || model.geom_conaffinity()[geom] != 0;
            kinds.push(match (fixture, free.iter().position(|free| free.body == body)) {
                (Some(fixture), _) => Kind::Fixture(fixture),
                (None, Some(object)) => Kind::Object(object),
                (None, None) if touchable => {
                    // Bodies that are welded to a finger belong to it.
                    let weld = |body: usize| model.body_weldid()[body];
                    Kind::Robot { body, finger: finger_bodies.iter().position(|f| weld(*f) == weld(body)) }
                }
                (None, None) => Kind::Visual,
            });
        }
        let regions = links::regions(&model, &self.robot.settings);
        let mut movers = Vec::new();
        for (i, fixture) in scene.fixtures.iter().enumerate() {
            if let Some(motion) = fixture.motion {
                let (qpos, qvel) = address(&format!("{PREFIX}{}", fixture.name))?;
                movers.push(Mover { fixture: i, qpos, qvel, motion });
            }
        }
        let mut data = MjData::new(Box::new(model));
        for (free, (object, _)) in free.iter().zip(scene.free_bodies()) {
            if let Some(joint) = &object.joint {
                data.qpos_mut()[free.qpos] = joint.start;
                if joint.kind == JointKind::Screw {
                    data.qpos_mut()[free.qpos + 1] = joint.lead_m_rad() * joint.start;
                }
            }
        }
        for ((address, _), q) in arm.iter().zip(joints) {
            data.qpos_mut()[*address] = *q;
        }
        for ((address, _), jaw) in fingers.iter().zip(gripper.jaw().into_iter().cycle()) {
            data.qpos_mut()[*address] = 0.5 * jaw.opening_m;
        }
        // The robot's joints come first in a compiled scene, in the order of the robot's own model.
        let others = (0..data.model().jnt_type().len())
            .filter(|joint| !arm.iter().any(|(qpos, _)| *qpos == data.model().jnt_qposadr()[*joint] as usize))
            .map(|joint| data.model().jnt_qposadr()[joint] as usize)
            .collect::<Vec<_>>();
        for (address, q) in others.iter().zip(self.fingers.iter().flat_map(|fingers| &fingers.open().joints)) {
            data.qpos_mut()[*address] = *q;
        }
        data.forward();
        // The distance between the jaws of which one does not move is not their opening.
        let both_move = gripper.jaw().is_none_or(|jaw| jaw.fixed_jaw_m.is_none());
        let pads = [0, 1].map(|i| {
            let on_finger =
                |kind: &Kind| matches!(kind, Kind::Robot { finger: Some(finger), .. } if *finger == i && both_move);
            kinds.iter().enumerate().filter(|(_, kind)| on_finger(kind)).map(|(geom, _)| geom).collect()
        });
        let loaded = Loaded {
            data,
            kinds,
            regions,
            arm,
            fingers,
            drives,
            bellows: bellows.map(|(qpos, _)| qpos),
            pads,
            gap: 0.0,
            welds,
            free,
            selected: 0,
            tcp,
            touches: Touches::default(),
            forces: ContactSums::default(),
            scene: scene.clone(),
            movers,
            steps: 0,
        };
        let loaded = self.loaded.insert(loaded);
        loaded.move_fixtures(self.time_step);
        loaded.read_touches();
        loaded.read_gap();
        self.tape_start();
        Ok(())
    }

    fn read_back(&self) -> Result<Readback, Fault> {
        let loaded = self.loaded();
        let model = loaded.data.model();
        let mut fixtures = Vec::new();
        let parts = |body: usize| {
            let geoms = loaded.kinds.iter().enumerate().filter(|(_, kind)| **kind == Kind::Object(body));
            geoms.filter_map(|(geom, _)| primitive(model, geom)).collect::<Vec<_>>()
        };
        for (geom, kind) in loaded.kinds.iter().enumerate() {
            if let Kind::Fixture(fixture) = kind {
                let motion = loaded.movers.iter().find(|mover| mover.fixture == *fixture).map(|mover| mover.motion);
                let pose = loaded.geom_pose(geom);
                let friction = loaded.scene.fixtures[*fixture].friction.map(|_| model.geom_friction()[geom][0]);
                let primitive = primitive(model, geom);
                fixtures.push(FixtureRead { fixture: *fixture, primitive, pose, motion, friction });
            }
        }
        let Friction { others, table, pads, own } = loaded.friction()?;
        Ok(Readback {
            friction: others,
            table_friction: table,
            pad_friction: pads,
            own_friction: own,
            gravity: -loaded.data.model_opt().gravity[2],
            arm_stiffness: self.arm_stiffness(),
            mass_kg: model.body_mass()[loaded.free[0].body],
            centre_of_mass: Vector3::from(model.body_ipos()[loaded.free[0].body]),
            parts: parts(0),
            object: self.free_body(0),
            others: (1..loaded.free.len())
                .map(|body| FreeBodyRead {
                    mass_kg: model.body_mass()[loaded.free[body].body],
                    centre_of_mass: Vector3::from(model.body_ipos()[loaded.free[body].body]),
                    parts: parts(body),
                    pose: self.free_body(body),
                })
                .collect(),
            fixtures,
            joints: loaded.joints_read(),
        })
    }

    fn advance(&mut self, targets: &JointTargets) {
        let arm = &self.robot.settings.arm;
        let Some(loaded) = self.loaded.as_mut() else { return };
        let first = loaded.data.ctrl().len() - arm.joints.len() - loaded.fingers.len() - loaded.drives.len();
        let softness = loaded.scene.arm_stiffness.sqrt();
        let ctrl = &mut loaded.data.ctrl_mut()[first..];
        for (i, ctrl) in ctrl[..arm.joints.len()].iter_mut().enumerate() {
            // The servo's velocity target is expressed as an offset of its position target.
            let lead = targets.velocities[i] * arm.damping_nms_rad[i] / arm.stiffness_nm_rad[i];
            *ctrl = targets.positions[i] + lead / softness;
        }
        let (slides, drives) = (arm.joints.len(), arm.joints.len() + loaded.fingers.len());
        ctrl[slides..drives].fill(targets.finger);
        for i in (0..arm.joints.len()).filter(|i| self.strong.arm[*i]) {
            let speed = loaded.data.qvel()[loaded.arm[i].1];
            let lag = speed * arm.damping_nms_rad[i] / arm.stiffness_nm_rad[i];
            loaded.data.ctrl_mut()[first + i] -= lag / softness;
        }
        if let Some(jaw) = self.robot.settings.gripper.jaw() {
            // See [`damping`]: a strongly damped finger is pulled to where it would be after this step.
            let lag = self.time_step + jaw.damping_ns_m / jaw.stiffness_n_m;
            for i in (0..loaded.fingers.len()).filter(|i| self.strong.fingers[*i]) {
                let speed = loaded.data.qvel()[loaded.fingers[i].1];
                loaded.data.ctrl_mut()[first + slides + i] -= lag * speed;
            }
        }
        if let (Some(jaw), Some(fingers)) = (self.robot.settings.gripper.jaw(), &self.fingers) {
            let lag = self.time_step + jaw.damping_ns_m / jaw.stiffness_n_m;
            let readings = loaded.drives.iter().enumerate().map(|(i, at)| {
                let [position, speed] = at.state(&loaded.data);
                let DriveReading { opening_m, slope } = fingers.reading(i, position);
                // See [`damping`].
                let ahead = if self.strong.fingers[i] { lag * slope * speed } else { 0.0 };
                (opening_m + ahead, slope)
            });
            let (openings, slopes): (Vec<f64>, Vec<f64>) = readings.unzip();
            // The servo of a finger, which moves by half of the opening: the force on its pad, positive to open.
            let servo = |opening: f64| jaw.stiffness_n_m * (targets.finger - 0.5 * opening);
            let forces = fingers.forces(&openings, servo);
            for (ctrl, (force, slope)) in
                loaded.data.ctrl_mut()[first + drives..].iter_mut().zip(forces.iter().zip(slopes))
            {
                *ctrl = force * slope;
            }
        }
        self.tape_inputs();
        let Some(loaded) = self.loaded.as_mut() else { return };
        loaded.data.step();
        loaded.steps += 1;
        loaded.move_fixtures(self.time_step);
        loaded.read_touches();
        loaded.read_gap();
        self.tape_positions();
    }

    fn health(&self) -> Result<(), Fault> {
        let loaded = self.loaded();
        if let Some(warning) = warning(&loaded.data) {
            return Err(Fault::new(FaultKind::Diverged, warning));
        }
        if loaded.data.qpos().iter().chain(loaded.data.qvel()).any(|x| !x.is_finite()) {
            return Err(Fault::new(FaultKind::Diverged, "MuJoCo: the state is not finite"));
        }
        Ok(())
    }

    fn joint_positions(&self) -> Vec<f64> {
        let loaded = self.loaded();
        loaded.arm.iter().map(|(q, _)| loaded.data.qpos()[*q]).collect()
    }

    fn joint_velocities(&self) -> Vec<f64> {
        let loaded = self.loaded();
        loaded.arm.iter().map(|(_, v)| loaded.data.qvel()[*v]).collect()
    }

    fn opening(&self) -> Option<f64> {
        let loaded = self.loaded();
        // The jaws of a gripper with one moving jaw meet at its hinge too.
        if self.robot.settings.gripper.jaw().is_some_and(|jaw| jaw.fixed_jaw_m.is_some()) {
            return self.drive_opening().map(|opening| opening.max(0.0));
        }
        if !loaded.drives.is_empty() {
            return Some(loaded.gap);
        }
        let opening = loaded.fingers.iter().map(|(q, _)| loaded.data.qpos()[*q]).sum();
        (!loaded.fingers.is_empty()).then_some(opening)
    }

    fn drive_opening(&self) -> Option<f64> {
        let loaded = self.loaded();
        match &self.fingers {
            Some(fingers) if !loaded.drives.is_empty() => {
                let readings = loaded.drives.iter().enumerate();
                let openings = readings.map(|(i, at)| fingers.reading(i, at.state(&loaded.data)[0]).opening_m);
                Some(fingers.opening(&openings.collect::<Vec<_>>()))
            }
            _ => self.opening(),
        }
    }

    fn cup_travel(&self) -> f64 {
        let loaded = self.loaded();
        loaded.bellows.map_or(0.0, |qpos| -loaded.data.qpos()[qpos])
    }

    fn attach(&mut self) {
        let (tcp, object) = (self.tcp(), self.object());
        let Some((loaded, weld)) = self.loaded.as_mut().and_then(|loaded| loaded.weld().map(|weld| (loaded, weld)))
        else {
            return;
        };
        let cup = isometry(&loaded.data.xpos()[weld.cup_body], &loaded.data.xquat()[weld.cup_body]);
        // They are joined at the centre of the lip.
        loaded.join(weld.equality, [&cup, &object], &tcp.translation.vector);
    }

    fn detach(&mut self) {
        if let Some(loaded) = self.loaded.as_mut()
            && let Some(weld) = loaded.weld()
        {
            loaded.data.eq_active_mut()[weld.equality] = false;
        }
    }

    fn take_up(&mut self, screw: usize, body: usize) {
        let poses = [self.free_body(screw), self.free_body(body)];
        if let Some(loaded) = self.loaded.as_mut()
            && let Some(weld) = loaded.thread(screw, true)
        {
            loaded.join(weld, [&poses[0], &poses[1]], &poses[0].translation.vector);
        }
    }

    fn let_go(&mut self, screw: usize) {
        if let Some(loaded) = self.loaded.as_mut() {
            loaded.thread(screw, false);
        }
    }

    fn cup_load(&self) -> Option<Wrench> {
        let loaded = self.loaded();
        loaded.joined().then(|| loaded.load_about(&self.tcp(), &self.object()))
    }

    fn tcp(&self) -> Isometry3<f64> {
        let loaded = self.loaded();
        let at = loaded.data.site_xpos()[loaded.tcp];
        rigid(at, &loaded.data.site_xmat()[loaded.tcp])
    }

    fn object(&self) -> Isometry3<f64> {
        self.free_body(self.loaded().selected)
    }

    fn select(&mut self, body: usize) {
        if let Some(loaded) = self.loaded.as_mut().filter(|loaded| body < loaded.free.len() && !loaded.joined()) {
            loaded.selected = body;
        }
    }

    fn free_body(&self, body: usize) -> Isometry3<f64> {
        let loaded = self.loaded();
        if let Some(pose) = loaded.jointed_pose(body) {
            return pose;
        }
        let q = &loaded.data.qpos()[loaded.free[body].qpos..];
        isometry(&[q[0], q[1], q[2]], &[q[3], q[4], q[5], q[6]])
    }

    fn free_body_velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>) {
        let loaded = self.loaded();
        if let Some(velocity) = loaded.jointed_velocity(body) {
            return velocity;
        }
        let v = &loaded.data.qvel()[loaded.free[body].qvel..];
        (Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]))
    }

    fn fixture(&self, fixture: usize) -> Isometry3<f64> {
        let loaded = self.loaded();
        let pose = loaded.scene.fixtures[fixture].part.pose;
        let mover = loaded.movers.iter().find(|mover| mover.fixture == fixture);
        mover.map_or(pose, |mover| mover.motion.moved(loaded.data.qpos()[mover.qpos]) * pose)
    }

    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>) {
        self.free_body_velocity(self.loaded().selected)
    }

    fn touches(&self) -> &Touches {
        &self.loaded().touches
    }

    fn support(&self) -> Wrench {
        self.loaded().support()
    }

    fn body_joint(&self, body: usize) -> Option<[f64; 2]> {
        self.loaded().jointed(body).map(|(_, _, state)| state)
    }

    fn hand_wrench(&self) -> Option<Wrench> {
        Some(self.loaded().hand_wrench(&self.tcp(), self.cup_load()))
    }

    fn force_between(&self, one: Side, other: Side) -> Option<f64> {
        self.loaded().force_between(one, other)
    }

    fn contact_points(&self) -> Vec<ContactPoint> {
        self.loaded().contact_points()
    }

    fn clearance_below(&mut self, bound: f64) -> Option<f64> {
        let loaded = self.loaded.as_mut()?;
        let mut best = bound;
        for robot in 0..loaded.kinds.len() {
            // Fixed parts of the base are at the table's level and have no clearance.
            let Kind::Robot { body, .. } = loaded.kinds[robot] else { continue };
            if loaded.data.model().body_weldid()[body] == 0 {
                continue;
            }
            for other in 0..loaded.kinds.len() {
                let Kind::Fixture(fixture) = loaded.kinds[other] else { continue };
                let (centre, radius) = (loaded.data.geom_xpos()[robot], loaded.data.model().geom_rbound()[robot]);
                let scene = &loaded.scene.fixtures[fixture];
                let near = match scene.motion {
                    Some(_) => scene.distance_bound_at(&loaded.geom_pose(other), centre, radius),
                    None => scene.distance_bound_at(&scene.part.pose, centre, radius),
                };
                if near < best {
                    best = best.min(loaded.data.geom_distance(robot, other, best, None));
                }
            }
        }
        (best < bound).then_some(best)
    }

    fn robot_body(&self, body: usize) -> String {
        let name = self.loaded().data.model().id_to_name(MjtObjBase::mjOBJ_BODY, body);
        name.map_or_else(|| format!("body {body}"), str::to_owned)
    }

    fn state_bits(&self, sink: &mut dyn FnMut(u64)) {
        let data = &self.loaded().data;
        data.qpos().iter().chain(data.qvel()).for_each(|x| sink(x.to_bits()));
    }
}

impl Loaded {
    /// Sets every moving fixture to its prescribed position and speed.
    fn move_fixtures(&mut self, time_step: f64) {
        let time = self.steps as f64 * time_step;
        for Mover { qpos, qvel, motion, .. } in &self.movers {
            self.data.qpos_mut()[*qpos] = motion.travel(time);
            self.data.qvel_mut()[*qvel] = motion.speed(time);
        }
    }

    /// Measures the distance between the pads of fingers with drives.
    fn read_gap(&mut self) {
        if !self.drives.is_empty() {
            let [first, second] = &self.pads;
            self.gap = sweep::gap(&mut self.data, [first, second]).max(0.0);
        }
    }

    /// The weld between cup and object.
    fn weld(&self) -> Option<Weld> {
        self.welds.get(self.selected).copied()
    }

    /// Whether the cup holds the object.
    fn joined(&self) -> bool {
        self.weld().is_some_and(|weld| self.data.eq_active()[weld.equality])
    }

    /// Pose of a geom.
    fn geom_pose(&self, geom: usize) -> Isometry3<f64> {
        let pose = rigid(self.data.geom_xpos()[geom], &self.data.geom_xmat()[geom]);
        let model = self.data.model();
        // The compiler moves the frame of a mesh to its centre of mass and turns it to the principal axes.
        match usize::try_from(model.geom_dataid()[geom]) {
            Ok(mesh) if model.geom_type()[geom] == MjtGeomBase::mjGEOM_MESH => {
                pose * isometry(&model.mesh_pos()[mesh], &model.mesh_quat()[mesh]).inverse()
            }
            _ => pose,
        }
    }
}
