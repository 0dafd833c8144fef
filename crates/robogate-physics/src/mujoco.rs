//! MuJoCo under the cell.
//!
//! Each scene is compiled afresh from the robot's model and the scene's bodies: about a millisecond, and
//! nothing of one episode can leak into the next. Settings that make grasps right (measured in
//! `robogate check physics`): implicit integration, elliptic friction cones with `impratio` 10, and
//! contacts of the object as stiff as the default time step allows.

use std::cmp::Ordering;
use std::path::PathBuf;
use std::sync::Once;

use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_logging::{log_config, set_log_config};
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Fault, FaultKind};

use crate::engine::Collision;
use crate::friction::{Coefficients, Friction};
use crate::scene::isometry;
use crate::{
    Chain, Engine, EngineBuild, FixtureKind, FixtureRead, JointTargets, Motion, Part, Primitive, Problem, Readback,
    Robot, RobotError, Scene, Touches, Wrench, robot_model,
};

/// Contact masks: the robot meets the object and fixtures, the object meets fixtures; the robot does not
/// meet itself (fingers that close on nothing are a miss, not a collision).
pub(crate) const ROBOT: (i32, i32) = (1, 0);
const OBJECT: (i32, i32) = (2, 1);
const FIXTURE: (i32, i32) = (0, 3);

/// Radius of the patch in which a soft pad touches, in metres: torsional friction is that of a disc
/// under even pressure, 2/3 of friction times radius.
const PATCH_RADIUS: f64 = 5e-3;

/// Rolling friction of the object, in metres: what stops a ball on the table's mat.
const ROLLING: f64 = 5e-4;

/// Time constant in which a contact of the object gives way, in seconds: as stiff as the default time step
/// allows (MuJoCo asks for two steps), and the same for shorter ones, so that they converge to one physics.
pub(crate) const CONTACT_TIME_S: f64 = 2.0 * MujocoEngine::TIME_STEP_S;

/// Mass of a fixture that moves, in kilograms.
const DRIVEN_MASS: f64 = 1e3;

/// Fixtures and object by their names in the compiled model. The prefix keeps them from meeting a
/// robot's names.
pub const PREFIX: &str = "robogate/";

/// MuJoCo with one robot.
pub struct MujocoEngine {
    robot: Robot,
    base: MjSpec,
    chain: Chain,
    time_step: f64,
    loaded: Option<Loaded>,
}

/// What a geom is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Robot {
        body: usize,
        finger: Option<usize>,
    },
    Object,
    Fixture(usize),
    /// A shape without contact.
    Ghost,
}

/// A compiled scene.
struct Loaded {
    data: MjData<Box<MjModel>>,
    kinds: Vec<Kind>,
    /// Addresses of the arm's and fingers' joints in qpos and qvel.
    arm: Vec<(usize, usize)>,
    /// Without fingers there is nothing here.
    fingers: Vec<(usize, usize)>,
    /// The joint between cup and object, and the cup's body.
    weld: Option<Weld>,
    object_body: usize,
    object_qpos: usize,
    object_qvel: usize,
    tcp: usize,
    touches: Touches,
    /// Force of each touching pair in the last step: robot body, and fixture or object.
    forces: Vec<((usize, Option<usize>), f64)>,
    /// What table and obstacles did to the object in the last step, about its centre of mass.
    support: Wrench,
    scene: Scene,
    /// The fixtures that move.
    movers: Vec<Mover>,
    /// Steps taken since the scene was loaded.
    steps: u64,
}

/// A fixture that moves.
#[derive(Debug, Clone, Copy)]
struct Mover {
    /// Its position in the scene.
    fixture: usize,
    /// The addresses of its joint.
    qpos: usize,
    qvel: usize,
    motion: Motion,
}

/// The joint between cup and object: there from the start, and switched on and off.
#[derive(Debug, Clone, Copy)]
struct Weld {
    equality: usize,
    cup_body: usize,
}

impl MujocoEngine {
    /// The default time step in seconds: halving it changes few outcomes (`robogate check physics`).
    pub const TIME_STEP_S: f64 = 0.002;

    /// An engine for this robot, with this time step in seconds.
    pub fn new(robot: Robot, time_step: f64) -> Result<Self, RobotError> {
        silence_log_file();
        let (base, chain) = robot_model::build(&robot, time_step)
            .map_err(|problems| RobotError::Invalid { path: robot_model::path(&robot), problems })?;
        Ok(Self { robot, base, chain, time_step, loaded: None })
    }

    /// All that is wrong with a robot's model; its settings may be wrong too.
    pub(crate) fn problems(robot: &Robot) -> Vec<Problem> {
        silence_log_file();
        robot_model::build(robot, Self::TIME_STEP_S).err().unwrap_or_default()
    }

    /// Mass of each moving body of the loaded robot that has one, in the model's order, in kilograms.
    pub(crate) fn masses(&self) -> Vec<(String, f64)> {
        let Some(loaded) = &self.loaded else { return Vec::new() };
        let model = loaded.data.model();
        (1..model.body_mass().len())
            .filter(|body| *body != loaded.object_body && model.body_weldid()[*body] != 0)
            .map(|body| (self.robot_body(body), model.body_mass()[body]))
            .filter(|(_, mass)| *mass > 0.0)
            .collect()
    }

    /// Pairs of the loaded robot's bodies that stand deeper in each other than `deep` (m), and how deep. Neighbours
    /// in the chain, the fingers and what the model excludes from contact do not count.
    pub(crate) fn self_contacts(&mut self, deep: f64) -> Vec<(String, String, f64)> {
        let Some(loaded) = self.loaded.as_mut() else { return Vec::new() };
        let model = loaded.data.model();
        let weld = |body: usize| model.body_weldid()[body] as usize;
        let above = |body: usize| weld(model.body_parentid()[weld(body)] as usize);
        let excluded: Vec<(usize, usize)> =
            model.exclude_signature().iter().map(|s| ((*s >> 16) as usize, (*s & 0xffff) as usize)).collect();
        let mut pairs = Vec::new();
        for (i, a) in loaded.kinds.iter().enumerate() {
            for (j, b) in loaded.kinds.iter().enumerate().skip(i + 1) {
                let (Kind::Robot { body: a, finger: f }, Kind::Robot { body: b, finger: g }) = (*a, *b) else {
                    continue;
                };
                let neighbours = weld(a) == weld(b) || weld(a) == above(b) || weld(b) == above(a);
                let fingers = f.is_some() && g.is_some();
                if !neighbours && !fingers && !excluded.contains(&(a, b)) && !excluded.contains(&(b, a)) {
                    pairs.push((i, j, a, b));
                }
            }
        }
        let mut deepest: Vec<(usize, usize, f64)> = Vec::new();
        for (i, j, a, b) in pairs {
            let depth = -loaded.data.geom_distance(i, j, deep, None);
            if depth > deep {
                match deepest.iter_mut().find(|(x, y, _)| (*x, *y) == (a, b)) {
                    Some((.., most)) => *most = most.max(depth),
                    None => deepest.push((a, b, depth)),
                }
            }
        }
        deepest.into_iter().map(|(a, b, depth)| (self.robot_body(a), self.robot_body(b), depth)).collect()
    }

    /// The scene that [`Engine::load`] put there; every reading of a world needs one.
    fn loaded(&self) -> &Loaded {
        self.loaded.as_ref().expect("a scene is loaded before it is read")
    }

    /// The scene as a MuJoCo model, for whoever wants to look at it or step it alone.
    pub fn compile(&self, scene: &Scene) -> Result<MjModel, MjEditError> {
        let mut spec = self.base.clone();
        self.furnish(&mut spec, scene)?;
        spec.compile()
    }

    /// The robot alone, before any scene.
    pub fn base(&self) -> &MjSpec {
        &self.base
    }

    /// Positions of all joints of the loaded scene, in the compiled model's order.
    pub fn positions(&self) -> &[f64] {
        self.loaded().data.qpos()
    }

    /// Adds a scene to the robot's model.
    pub fn furnish(&self, spec: &mut MjSpec, scene: &Scene) -> Result<(), MjEditError> {
        spec.option_mut().gravity = [0.0, 0.0, -scene.gravity];
        let world = spec.world_body_mut();
        for (i, fixture) in scene.fixtures.iter().enumerate() {
            let name = format!("{PREFIX}{}", fixture.name);
            let Part { primitive, pose } = &fixture.part;
            let geom = if let Some(motion) = &fixture.motion {
                // Its joint is put where the motion has it at every step. It has a joint at all so that a contact
                // sees its speed, and a mass beside which whatever it pushes is nothing.
                let body = world.add_body().with_name(&name);
                place(pose, body.pos_mut());
                *body.quat_mut() = wxyz(&pose.rotation);
                let joint = body.add_joint().with_name(&name);
                joint.set_type(MjtJoint::mjJNT_SLIDE);
                *joint.axis_mut() = (pose.rotation.inverse() * motion.velocity.normalize()).into();
                let geom = body.add_geom().with_name(&name);
                shape(geom, primitive, &Isometry3::identity());
                geom.set_mass(DRIVEN_MASS);
                geom
            } else {
                let geom = world.add_geom().with_name(&name);
                shape(geom, primitive, pose);
                geom
            };
            geom.set_contype(FIXTURE.0);
            geom.set_conaffinity(FIXTURE.1);
            // Where the table has a friction of its own, it and not the object says how the two meet.
            if let (0, Some(friction)) = (i, scene.table_friction) {
                geom.set_priority(2);
                let balls = scene.object.parts.iter().map(|part| &part.primitive);
                object_contact(geom, friction, balls.clone().any(|part| matches!(part, Primitive::Sphere { .. })));
            }
        }
        let body = world.add_body().with_name(&format!("{PREFIX}object"));
        place(&scene.object_pose, body.pos_mut());
        *body.quat_mut() = wxyz(&scene.object_pose.rotation);
        let mass = &scene.object.mass;
        body.set_explicitinertial(true);
        body.set_mass(mass.mass_kg);
        place(&Isometry3::from_parts(Translation3::from(mass.centre), UnitQuaternion::identity()), body.ipos_mut());
        let m: &Matrix3<f64> = &mass.inertia;
        *body.fullinertia_mut() = [m[(0, 0)], m[(1, 1)], m[(2, 2)], m[(0, 1)], m[(0, 2)], m[(1, 2)]];
        body.add_free_joint().set_name(&format!("{PREFIX}object"))?;
        for (i, part) in scene.object.parts.iter().enumerate() {
            let geom = body.add_geom().with_name(&format!("{PREFIX}object_{i}"));
            shape(geom, &part.primitive, &part.pose);
            geom.set_contype(OBJECT.0);
            geom.set_conaffinity(OBJECT.1);
            geom.set_mass(0.0);
            // The object's friction is that of each of its contacts, whatever it touches.
            geom.set_priority(1);
            object_contact(geom, scene.friction, matches!(part.primitive, Primitive::Sphere { .. }));
        }
        if let Some(cup) = self.robot.settings.gripper.cup() {
            let weld = spec.add_equality().with_name(&format!("{PREFIX}cup"));
            weld.set_type(MjtEq::mjEQ_WELD);
            weld.set_objtype(MjtObjBase::mjOBJ_BODY);
            weld.set_name1(&cup.cup_body);
            weld.set_name2(&format!("{PREFIX}object"));
            weld.set_active(false);
            // Given in full, or the model's compiler would take the start's poses for those to hold.
            weld.data_mut()[..11].copy_from_slice(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
            weld.solref_mut()[..2].copy_from_slice(&[CONTACT_TIME_S, 1.0]);
            weld.solimp_mut()[..3].copy_from_slice(&[0.95, 0.99, 0.001]);
        }
        Ok(())
    }
}

/// Which MuJoCo this process runs.
pub(crate) fn build() -> EngineBuild {
    // The library that this process runs, as the loader mapped it.
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    let library = maps
        .lines()
        .filter_map(|line| line.splitn(6, ' ').nth(5).map(str::trim_start))
        .find(|path| path.rsplit('/').next().is_some_and(|file| file.starts_with("libmujoco.so")));
    EngineBuild { name: "mujoco", version: mujoco_rs::mujoco_version().to_owned(), library: library.map(PathBuf::from) }
}

/// The first warning that MuJoCo raised since the state was made, in words.
pub(crate) fn warning(data: &MjData<Box<MjModel>>) -> Option<String> {
    let kind = data.warning().iter().position(|warning| warning.number > 0)?;
    let info = data.warning()[kind].lastinfo;
    let what = match kind {
        0 => "inertia matrix is singular",
        1 => "contact buffer is full",
        2 => "constraint buffer is full",
        3 => "a position is not finite or too large",
        4 => "a velocity is not finite or too large",
        5 => "an acceleration is not finite or too large",
        6 => "a control is not finite or too large",
        _ => "warning",
    };
    Some(format!("MuJoCo: {what} (at {info})"))
}

/// MuJoCo would write its warnings, with the time, into a file in the current folder.
pub(crate) fn silence_log_file() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // SAFETY: all use of MuJoCo here begins with `MujocoEngine::new`, which waits for this call: nobody
        // uses MuJoCo meanwhile.
        #[expect(unsafe_code, reason = "the binding has no safe way to set it")]
        unsafe {
            set_log_config(log_config().with_logto_file(false));
        }
    });
}

/// A rotation as MuJoCo's quaternion (w, x, y, z).
pub fn wxyz(rotation: &UnitQuaternion<f64>) -> [f64; 4] {
    [rotation.w, rotation.i, rotation.j, rotation.k]
}

fn place(pose: &Isometry3<f64>, at: &mut [f64; 3]) {
    *at = pose.translation.vector.into();
}

fn shape(geom: &mut mujoco_rs::wrappers::mj_editing::MjsGeom, primitive: &Primitive, pose: &Isometry3<f64>) {
    let (kind, size) = match *primitive {
        Primitive::Box { half } => (MjtGeomBase::mjGEOM_BOX, half),
        Primitive::Cylinder { radius, half_height } => (MjtGeomBase::mjGEOM_CYLINDER, [radius, half_height, 0.0]),
        Primitive::Sphere { radius } => (MjtGeomBase::mjGEOM_SPHERE, [radius, 0.0, 0.0]),
    };
    geom.set_type(kind);
    // The defaults of a robot's file do not reach the cell's own shapes.
    geom.set_margin(0.0);
    geom.set_gap(0.0);
    geom.set_condim(3);
    *geom.size_mut() = size;
    place(pose, geom.pos_mut());
    *geom.quat_mut() = wxyz(&pose.rotation);
}

/// How the object meets what it touches.
fn object_contact(geom: &mut mujoco_rs::wrappers::mj_editing::MjsGeom, friction: f64, rolls: bool) {
    // Sliding and twisting friction; a ball has rolling friction too, or it would never rest.
    geom.set_condim(if rolls { 6 } else { 4 });
    *geom.friction_mut() = [friction, friction * PATCH_RADIUS * 2.0 / 3.0, ROLLING];
    geom.solref_mut()[..2].copy_from_slice(&[CONTACT_TIME_S, 1.0]);
    geom.solimp_mut()[..3].copy_from_slice(&[0.95, 0.99, 0.001]);
}

fn primitive(model: &MjModel, geom: usize) -> Option<Primitive> {
    let [a, b, c] = model.geom_size()[geom];
    match model.geom_type()[geom] {
        MjtGeomBase::mjGEOM_BOX => Some(Primitive::Box { half: [a, b, c] }),
        MjtGeomBase::mjGEOM_CYLINDER => Some(Primitive::Cylinder { radius: a, half_height: b }),
        MjtGeomBase::mjGEOM_SPHERE => Some(Primitive::Sphere { radius: a }),
        _ => None,
    }
}

/// The sliding friction coefficient of a contact of two geoms, by MuJoCo's rule ("Computation", "Contact"): that of the
/// geom with the higher priority, or the larger one at equal priority.
fn contact_friction(model: &MjModel, a: usize, b: usize) -> f64 {
    let [(first, friction), (second, other)] =
        [a, b].map(|geom| (model.geom_priority()[geom], model.geom_friction()[geom][0]));
    match first.cmp(&second) {
        Ordering::Greater => friction,
        Ordering::Less => other,
        Ordering::Equal => friction.max(other),
    }
}

fn find(model: &MjModel, kind: MjtObjBase, what: &str, name: &str) -> Result<usize, String> {
    model.name_to_id(kind, name).ok_or_else(|| format!("there is no {what} `{name}`, which robot.toml names"))
}

impl Engine for MujocoEngine {
    fn build(&self) -> EngineBuild {
        build()
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
        let model = self.compile(scene).map_err(|e| setup(format!("MuJoCo does not compile the scene: {e}")))?;
        let gripper = &self.robot.settings.gripper;
        let id = |kind, what: &str, name: &str| find(&model, kind, what, name).map_err(setup);
        let address = |name: &str| {
            id(MjtObjBase::mjOBJ_JOINT, "joint", name)
                .map(|joint| (model.jnt_qposadr()[joint] as usize, model.jnt_dofadr()[joint] as usize))
        };
        let arm = self.robot.settings.arm.joints.iter().map(|name| address(name)).collect::<Result<Vec<_>, _>>()?;
        let mut fingers = Vec::new();
        let mut finger_bodies = Vec::new();
        if let Some(jaw) = gripper.jaw() {
            for (joint, body) in jaw.finger_joints.iter().zip(&jaw.finger_bodies) {
                fingers.push(address(joint)?);
                finger_bodies.push(id(MjtObjBase::mjOBJ_BODY, "body", body)?);
            }
        }
        let weld = match gripper.cup() {
            Some(cup) => Some(Weld {
                equality: id(MjtObjBase::mjOBJ_EQUALITY, "joint", &format!("{PREFIX}cup"))?,
                cup_body: id(MjtObjBase::mjOBJ_BODY, "body", &cup.cup_body)?,
            }),
            None => None,
        };
        let object_body = id(MjtObjBase::mjOBJ_BODY, "body", &format!("{PREFIX}object"))?;
        let (object_qpos, object_qvel) = address(&format!("{PREFIX}object"))?;
        let tcp = id(MjtObjBase::mjOBJ_SITE, "site", &self.robot.settings.arm.tcp_site)?;
        let mut kinds = Vec::with_capacity(model.geom_bodyid().len());
        for (geom, body) in model.geom_bodyid().iter().map(|b| *b as usize).enumerate() {
            let named = model.id_to_name(MjtObjBase::mjOBJ_GEOM, geom).and_then(|name| name.strip_prefix(PREFIX));
            let fixture = named.and_then(|name| scene.fixtures.iter().position(|fixture| fixture.name == name));
            let touchable = model.geom_contype()[geom] != 0 || model.geom_conaffinity()[geom] != 0;
            kinds.push(match fixture {
                Some(fixture) => Kind::Fixture(fixture),
                None if body == object_body => Kind::Object,
                None if touchable => Kind::Robot { body, finger: finger_bodies.iter().position(|f| *f == body) },
                None => Kind::Ghost,
            });
        }
        let mut movers = Vec::new();
        for (i, fixture) in scene.fixtures.iter().enumerate() {
            if let Some(motion) = fixture.motion {
                let (qpos, qvel) = address(&format!("{PREFIX}{}", fixture.name))?;
                movers.push(Mover { fixture: i, qpos, qvel, motion });
            }
        }
        let mut data = MjData::new(Box::new(model));
        for ((address, _), q) in arm.iter().zip(joints) {
            data.qpos_mut()[*address] = *q;
        }
        for ((address, _), jaw) in fingers.iter().zip(gripper.jaw().into_iter().cycle()) {
            data.qpos_mut()[*address] = 0.5 * jaw.opening_m;
        }
        data.forward();
        let loaded = Loaded {
            data,
            kinds,
            arm,
            fingers,
            weld,
            object_body,
            object_qpos,
            object_qvel,
            tcp,
            touches: Touches::default(),
            forces: Vec::new(),
            support: Wrench::ZERO,
            scene: scene.clone(),
            movers,
            steps: 0,
        };
        let loaded = self.loaded.insert(loaded);
        loaded.move_fixtures(self.time_step);
        loaded.read_touches();
        Ok(())
    }

    fn read_back(&self) -> Result<Readback, Fault> {
        let loaded = self.loaded();
        let model = loaded.data.model();
        let mut parts = Vec::new();
        let mut fixtures = Vec::new();
        for (geom, kind) in loaded.kinds.iter().enumerate() {
            if *kind == Kind::Object {
                parts.extend(primitive(model, geom));
            }
            if let Kind::Fixture(fixture) = kind {
                let motion = loaded.movers.iter().find(|mover| mover.fixture == *fixture).map(|mover| mover.motion);
                let pose = loaded.geom_pose(geom);
                fixtures.push(FixtureRead { fixture: *fixture, primitive: primitive(model, geom), pose, motion });
            }
        }
        let Friction { others, table } = loaded.friction()?;
        Ok(Readback {
            friction: others,
            table_friction: table,
            gravity: -loaded.data.model_opt().gravity[2],
            mass_kg: model.body_mass()[loaded.object_body],
            centre_of_mass: Vector3::from(model.body_ipos()[loaded.object_body]),
            parts,
            object: self.object(),
            fixtures,
        })
    }

    fn advance(&mut self, targets: &JointTargets) {
        let arm = &self.robot.settings.arm;
        let Some(loaded) = self.loaded.as_mut() else { return };
        let first = loaded.data.ctrl().len() - arm.joints.len() - loaded.fingers.len();
        let ctrl = &mut loaded.data.ctrl_mut()[first..];
        for (i, ctrl) in ctrl[..arm.joints.len()].iter_mut().enumerate() {
            // The servo's velocity target, written as an offset of its position target.
            *ctrl = targets.positions[i] + targets.velocities[i] * arm.damping_nms_rad[i] / arm.stiffness_nm_rad[i];
        }
        ctrl[arm.joints.len()..].fill(targets.finger);
        loaded.data.step();
        loaded.steps += 1;
        loaded.move_fixtures(self.time_step);
        loaded.read_touches();
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
        let opening = loaded.fingers.iter().map(|(q, _)| loaded.data.qpos()[*q]).sum();
        (!loaded.fingers.is_empty()).then_some(opening)
    }

    fn attach(&mut self) {
        let (tcp, object) = (self.tcp(), self.object());
        let Some((loaded, weld)) = self.loaded.as_mut().and_then(|loaded| loaded.weld.map(|weld| (loaded, weld)))
        else {
            return;
        };
        let cup = isometry(&loaded.data.xpos()[weld.cup_body], &loaded.data.xquat()[weld.cup_body]);
        let turn = cup.rotation.inverse() * object.rotation;
        // The same point, the middle of the lip, in the object's and in the cup's frame; the object's turn in the cup.
        let lip = Point3::from(tcp.translation.vector);
        let (in_object, in_cup) = (object.inverse_transform_point(&lip), cup.inverse_transform_point(&lip));
        // SAFETY: only numbers of an equality of this very model change; no size and no address depends on them.
        #[expect(unsafe_code, reason = "the binding has no safe way to set it")]
        let numbers = unsafe { &mut loaded.data.model_mut().eq_data_mut()[weld.equality] };
        numbers[..3].copy_from_slice(in_object.coords.as_slice());
        numbers[3..6].copy_from_slice(in_cup.coords.as_slice());
        numbers[6..10].copy_from_slice(&wxyz(&turn));
        loaded.data.eq_active_mut()[weld.equality] = true;
    }

    fn detach(&mut self) {
        if let Some(loaded) = self.loaded.as_mut()
            && let Some(weld) = loaded.weld
        {
            loaded.data.eq_active_mut()[weld.equality] = false;
        }
    }

    fn cup_load(&self) -> Option<Wrench> {
        let loaded = self.loaded();
        let joined = loaded.weld.is_some_and(|weld| loaded.data.eq_active()[weld.equality]);
        joined.then(|| loaded.load_about(&self.tcp(), &self.object()))
    }

    fn tcp(&self) -> Isometry3<f64> {
        let loaded = self.loaded();
        let at = loaded.data.site_xpos()[loaded.tcp];
        let turn = Matrix3::from_row_slice(&loaded.data.site_xmat()[loaded.tcp]);
        let turn = nalgebra::Rotation3::from_matrix_unchecked(turn);
        Isometry3::from_parts(Translation3::from(Vector3::from(at)), UnitQuaternion::from_rotation_matrix(&turn))
    }

    fn object(&self) -> Isometry3<f64> {
        let loaded = self.loaded();
        let q = &loaded.data.qpos()[loaded.object_qpos..];
        isometry(&[q[0], q[1], q[2]], &[q[3], q[4], q[5], q[6]])
    }

    fn fixture(&self, fixture: usize) -> Isometry3<f64> {
        let loaded = self.loaded();
        let mut pose = loaded.scene.fixtures[fixture].part.pose;
        if let Some(mover) = loaded.movers.iter().find(|mover| mover.fixture == fixture) {
            let way = mover.motion.velocity.normalize() * loaded.data.qpos()[mover.qpos];
            pose.translation.vector += way;
        }
        pose
    }

    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>) {
        let loaded = self.loaded();
        let v = &loaded.data.qvel()[loaded.object_qvel..];
        (Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]))
    }

    fn touches(&self) -> &Touches {
        &self.loaded().touches
    }

    fn clearance_below(&mut self, bound: f64) -> Option<f64> {
        let loaded = self.loaded.as_mut()?;
        let mut best = bound;
        for robot in 0..loaded.kinds.len() {
            // A part of the base that stands on the table's level has no clearance to lose.
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
    /// Puts every moving fixture where it is after the steps taken.
    fn move_fixtures(&mut self, time_step: f64) {
        let time = self.steps as f64 * time_step;
        for Mover { qpos, qvel, motion, .. } in &self.movers {
            self.data.qpos_mut()[*qpos] = motion.offset(time).norm();
            self.data.qvel_mut()[*qvel] = motion.velocity_at(time).norm();
        }
    }

    /// The friction coefficients that act between the object and everything that it can touch.
    fn friction(&self) -> Result<Friction, Fault> {
        let model = self.data.model();
        let object: Vec<usize> = (0..self.kinds.len()).filter(|geom| self.kinds[*geom] == Kind::Object).collect();
        let mut friction = Coefficients::default();
        for (geom, kind) in self.kinds.iter().enumerate() {
            let table = match *kind {
                Kind::Fixture(fixture) => self.scene.fixtures[fixture].kind == FixtureKind::Table,
                Kind::Robot { .. } => false,
                Kind::Object | Kind::Ghost => continue,
            };
            object.iter().for_each(|part| friction.add(table, contact_friction(model, *part, geom)));
        }
        friction.finish()
    }

    /// Where MuJoCo has a geom.
    fn geom_pose(&self, geom: usize) -> Isometry3<f64> {
        let turn = Matrix3::from_row_slice(&self.data.geom_xmat()[geom]);
        let turn = nalgebra::Rotation3::from_matrix_unchecked(turn);
        let at = Translation3::from(Vector3::from(self.data.geom_xpos()[geom]));
        Isometry3::from_parts(at, UnitQuaternion::from_rotation_matrix(&turn))
    }

    /// Sums up the contacts of the last step: two bodies may touch at several points, and it is their
    /// force together that counts.
    fn read_touches(&mut self) {
        let touches = &mut self.touches;
        *touches = Touches::default();
        self.forces.clear();
        self.support = Wrench::ZERO;
        let joined = self.weld.is_some_and(|weld| self.data.eq_active()[weld.equality]);
        for (i, contact) in self.data.contact().iter().enumerate() {
            // A contact that is only near has no constraint.
            if contact.efc_address < 0 || contact.geom1 < 0 || contact.geom2 < 0 {
                continue;
            }
            let (body, other) = match (self.kinds[contact.geom1 as usize], self.kinds[contact.geom2 as usize]) {
                (Kind::Robot { body, finger }, Kind::Object) | (Kind::Object, Kind::Robot { body, finger }) => {
                    let force = self.data.contact_force(i)[0];
                    match finger {
                        Some(finger) => *touches.fingers[finger].get_or_insert(0.0) += force,
                        None => touches.body_on_object = true,
                    }
                    add(&mut self.forces, (body, None), force);
                    continue;
                }
                (Kind::Robot { body, .. }, Kind::Fixture(fixture))
                | (Kind::Fixture(fixture), Kind::Robot { body, .. }) => (body, fixture),
                (first @ Kind::Object, Kind::Fixture(_)) | (first @ Kind::Fixture(_), Kind::Object) => {
                    touches.object_on_fixture = true;
                    if joined {
                        // The force is that on the second shape, along axes that are the rows of the frame.
                        let sign = if first == Kind::Object { -1.0 } else { 1.0 };
                        let axes = Matrix3::from_column_slice(&contact.frame) * sign;
                        let [n, t1, t2, twist, r1, r2] = self.data.contact_force(i);
                        let force = axes * Vector3::new(n, t1, t2);
                        let arm = Vector3::from(contact.pos) - Vector3::from(self.data.xipos()[self.object_body]);
                        self.support.force += force;
                        self.support.torque += axes * Vector3::new(twist, r1, r2) + arm.cross(&force);
                    }
                    continue;
                }
                _ => continue,
            };
            add(&mut self.forces, (body, Some(other)), self.data.contact_force(i)[0]);
        }
        for ((robot_body, other), force) in self.forces.iter().copied() {
            touches.peak_force = Some(touches.peak_force.unwrap_or(0.0).max(force));
            if let Some(fixture) = other
                && touches.collision.is_none_or(|strongest| force > strongest.force)
            {
                touches.collision = Some(Collision { robot_body, fixture, force });
            }
        }
    }
}

impl Loaded {
    /// What moved the object in the last step beside its weight and what it stood on, about the tool centre point:
    /// Newton's and Euler's laws, read the other way round. (The joint's own force alone would not do: where the cup
    /// also presses on the object, the two bear against each other.)
    fn load_about(&self, tcp: &Isometry3<f64>, object: &Isometry3<f64>) -> Wrench {
        let mass = &self.scene.object.mass;
        let turn = object.rotation;
        // MuJoCo has a free body's velocity in the world's axes and its turning in the body's own.
        let (acceleration, speed) = (&self.data.qacc()[self.object_qvel..], &self.data.qvel()[self.object_qvel..]);
        let linear = Vector3::new(acceleration[0], acceleration[1], acceleration[2]);
        let angular = Vector3::new(acceleration[3], acceleration[4], acceleration[5]);
        let spin = Vector3::new(speed[3], speed[4], speed[5]);
        let of_centre = linear + turn * (angular.cross(&mass.centre) + spin.cross(&spin.cross(&mass.centre)));
        let weight = Vector3::new(0.0, 0.0, -self.scene.gravity);
        let force = (of_centre - weight) * mass.mass_kg - self.support.force;
        let turning = turn * (mass.inertia * angular + spin.cross(&(mass.inertia * spin)));
        let centre = (object * Point3::from(mass.centre)).coords;
        let torque = turning - self.support.torque + (centre - tcp.translation.vector).cross(&force);
        Wrench { force: tcp.inverse_transform_vector(&force), torque: tcp.inverse_transform_vector(&torque) }
    }
}

/// Adds to the force between a robot body and a fixture (`None`: the object).
fn add(forces: &mut Vec<((usize, Option<usize>), f64)>, pair: (usize, Option<usize>), force: f64) {
    match forces.iter_mut().find(|(known, _)| *known == pair) {
        Some((_, sum)) => *sum += force,
        None => forces.push((pair, force)),
    }
}
