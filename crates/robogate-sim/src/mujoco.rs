//! MuJoCo under the cell.
//!
//! Each scene is compiled afresh from the robot's model and the scene's bodies: about a millisecond, and
//! nothing of one episode can leak into the next. Settings that make grasps right (measured in
//! `robogate check physics`): implicit integration, elliptic friction cones with `impratio` 10, and
//! contacts of the object as stiff as the default time step allows.

use std::path::PathBuf;
use std::sync::Once;

use mujoco_rs::mujoco_c::mjtLimited;
use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_editing::MjsBody;
use mujoco_rs::wrappers::mj_logging::{log_config, set_log_config};
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use robogate_core::{Fault, FaultKind};

use crate::engine::Collision;
use crate::robot::RobotSource;
use crate::scene::isometry;
use crate::{Chain, ChainJoint, Engine, EngineBuild, Gripper, JointTargets, Primitive, Readback, Robot, RobotError};
use crate::{ParallelJaw, Scene, Touches, Wrench};

/// Contact masks: the robot meets the object and fixtures, the object meets fixtures; the robot does not
/// meet itself (fingers that close on nothing are a miss, not a collision).
const ROBOT: (i32, i32) = (1, 0);
const OBJECT: (i32, i32) = (2, 1);
const FIXTURE: (i32, i32) = (0, 3);

/// Radius of the patch in which a soft pad touches, in metres: torsional friction is that of a disc
/// under even pressure, 2/3 of friction times radius.
const PATCH_RADIUS: f64 = 5e-3;

/// Rolling friction of the object, in metres: what stops a ball on the table's mat.
const ROLLING: f64 = 5e-4;

/// Time constant in which a contact of the object gives way, in seconds: as stiff as the default time step
/// allows (MuJoCo asks for two steps), and the same for shorter ones, so that they converge to one physics.
const CONTACT_TIME_S: f64 = 2.0 * MujocoEngine::TIME_STEP_S;

/// Group in which a model's own actuators are switched off: the cell has its own drives.
const OFF_GROUP: i32 = 30;

/// Fixtures and object by their names in the compiled model. The prefix keeps them from meeting a
/// robot's names.
const PREFIX: &str = "robogate/";

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
        let mut base = parse(&robot)?;
        let invalid = |why: String| RobotError::Invalid { path: model_path(&robot), why };
        // The cell's physics is the cell's: a robot's file says nothing about it.
        *base.option_mut() = MjSpec::new().option().clone();
        base.set_memory(MjSpec::new().memory());
        let compiler = base.compiler_mut();
        compiler.set_boundmass(0.0);
        compiler.set_boundinertia(0.0);
        compiler.set_balanceinertia(false);
        for actuator in base.actuator_iter_mut() {
            actuator.set_group(OFF_GROUP);
        }
        let settings = &robot.settings;
        let arm = settings.arm.joints.iter().enumerate().map(|(i, name)| {
            let arm = &settings.arm;
            (name, arm.stiffness_nm_rad[i], arm.damping_nms_rad[i], arm.torque_limit_nm[i])
        });
        let fingers = settings.gripper.jaw().into_iter().flat_map(|jaw| {
            jaw.finger_joints.iter().map(|name| (name, jaw.stiffness_n_m, jaw.damping_ns_m, jaw.force_limit_n))
        });
        for (joint, stiffness, damping, limit) in arm.chain(fingers) {
            let Some(driven) = base.joint_mut(joint) else {
                return Err(invalid(format!("there is no joint `{joint}`, which robot.toml names")));
            };
            // The weight of the arm itself is part of what its drives have to bear.
            driven.set_actgravcomp(true);
            *driven.actfrcrange_mut() = [-limit, limit];
            driven.set_actfrclimited(mjtLimited::mjLIMITED_TRUE);
            // An end stop does not give way to the drive.
            driven.solref_limit_mut()[..2].copy_from_slice(&[CONTACT_TIME_S, 1.0]);
            driven.solimp_limit_mut()[..3].copy_from_slice(&[0.99, 0.999, 1e-4]);
            let mut gain = [0.0; 10];
            gain[0] = stiffness;
            let mut bias = [0.0; 10];
            (bias[1], bias[2]) = (-stiffness, -damping);
            let actuator = base.add_actuator();
            actuator.set_name(&format!("{PREFIX}{joint}")).map_err(|e| invalid(e.to_string()))?;
            actuator.set_trntype(MjtTrn::mjTRN_JOINT);
            actuator.set_target(joint);
            actuator.set_gaintype(MjtGain::mjGAIN_FIXED);
            actuator.set_biastype(MjtBias::mjBIAS_AFFINE);
            actuator.gainprm_mut()[..10].copy_from_slice(&gain);
            actuator.biasprm_mut()[..10].copy_from_slice(&bias);
            actuator.set_ctrllimited(mjtLimited::mjLIMITED_FALSE);
            actuator.set_forcelimited(mjtLimited::mjLIMITED_TRUE);
            *actuator.forcerange_mut() = [-limit, limit];
            actuator.set_group(0);
        }
        for geom in base.geom_iter_mut() {
            if geom.contype() != 0 || geom.conaffinity() != 0 {
                geom.set_contype(ROBOT.0);
                geom.set_conaffinity(ROBOT.1);
                // The object's friction is what counts, whatever a hand's model says.
                geom.set_priority(0);
                geom.set_margin(0.0);
                geom.set_gap(0.0);
            }
        }
        compensate_weight(base.world_body_mut());
        let option = base.option_mut();
        option.timestep = time_step;
        option.integrator = MjtIntegrator::mjINT_IMPLICITFAST as i32;
        option.cone = MjtCone::mjCONE_ELLIPTIC as i32;
        option.impratio = 10.0;
        option.solver = MjtSolver::mjSOL_NEWTON as i32;
        option.iterations = 100;
        option.ls_iterations = 50;
        option.disableactuator = 1 << OFF_GROUP;
        let model = base.clone().compile().map_err(|e| invalid(e.to_string()))?;
        let chain = chain(&model, &robot).map_err(invalid)?;
        check(&model, &robot, &chain).map_err(invalid)?;
        Ok(Self { robot, base, chain, time_step, loaded: None })
    }

    /// The scene that [`Engine::load`] put there; every reading of a world needs one.
    fn loaded(&self) -> &Loaded {
        self.loaded.as_ref().expect("a scene is loaded before it is read")
    }

    /// The scene as a MuJoCo model, for whoever wants to look at it or step it alone.
    pub fn compile(&self, scene: &Scene) -> Result<MjModel, MjEditError> {
        let mut spec = self.base.clone();
        spec.option_mut().gravity = [0.0, 0.0, -scene.gravity];
        let world = spec.world_body_mut();
        for (i, fixture) in scene.fixtures.iter().enumerate() {
            let geom = world.add_geom().with_name(&format!("{PREFIX}{}", fixture.name));
            shape(geom, &fixture.part.primitive, &fixture.part.pose);
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
        spec.compile()
    }
}

/// MuJoCo would write its warnings, with the time, into a file in the current folder.
fn silence_log_file() {
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

fn model_path(robot: &Robot) -> PathBuf {
    match &robot.source {
        RobotSource::BuiltIn { .. } => PathBuf::from(&robot.settings.model),
        RobotSource::Folder(folder) => folder.join(&robot.settings.model),
    }
}

fn parse(robot: &Robot) -> Result<MjSpec, RobotError> {
    let parsed = match &robot.source {
        RobotSource::BuiltIn { model, .. } => MjSpec::from_xml_string(model),
        RobotSource::Folder(_) => MjSpec::from_xml(model_path(robot)),
    };
    parsed.map_err(|e| RobotError::Invalid { path: model_path(robot), why: e.to_string() })
}

/// As every arm's controller does; the weight of what the robot carries is not compensated.
fn compensate_weight(body: &mut MjsBody) {
    for child in body.body_iter_mut() {
        child.set_gravcomp(1.0);
        compensate_weight(child);
    }
}

fn wxyz(rotation: &UnitQuaternion<f64>) -> [f64; 4] {
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

fn find(model: &MjModel, kind: MjtObjBase, what: &str, name: &str) -> Result<usize, String> {
    model.name_to_id(kind, name).ok_or_else(|| format!("there is no {what} `{name}`, which robot.toml names"))
}

/// The serial chain from the base to the tool, out of a compiled model.
fn chain(model: &MjModel, robot: &Robot) -> Result<Chain, String> {
    let arm = &robot.settings.arm;
    let tcp = find(model, MjtObjBase::mjOBJ_SITE, "site", &arm.tcp_site)?;
    let flange = find(model, MjtObjBase::mjOBJ_SITE, "site", &arm.flange_site)?;
    let wanted = arm
        .joints
        .iter()
        .map(|name| find(model, MjtObjBase::mjOBJ_JOINT, "joint", name))
        .collect::<Result<Vec<_>, _>>()?;
    let parent = |body: usize| model.body_parentid()[body] as usize;
    let mut bodies = Vec::new();
    let mut body = model.site_bodyid()[tcp] as usize;
    while body != 0 {
        bodies.push(body);
        body = parent(body);
    }
    let mut joints = Vec::new();
    // The way from the last joint's frame, as far as it has come.
    let mut way = Isometry3::identity();
    let mut flange_way = None;
    let flange_body = model.site_bodyid()[flange] as usize;
    for &body in bodies.iter().rev() {
        way *= isometry(&model.body_pos()[body], &model.body_quat()[body]);
        let first = model.body_jntadr()[body];
        for joint in (0..model.body_jntnum()[body]).map(|k| (first + k) as usize) {
            let name = model.id_to_name(MjtObjBase::mjOBJ_JOINT, joint).unwrap_or("(without a name)");
            let expected = wanted.get(joints.len()).copied();
            if expected != Some(joint) {
                return Err(format!(
                    "joint `{name}` lies between base and `{}` where arm.joints has {}: list every joint of the arm, base to tip",
                    arm.tcp_site,
                    arm.joints.get(joints.len()).map_or("no more".to_owned(), |n| format!("`{n}`")),
                ));
            }
            if model.jnt_type()[joint] != MjtJoint::mjJNT_HINGE {
                return Err(format!("joint `{name}` is no hinge: arms with sliding joints are not supported"));
            }
            let range = model.jnt_range()[joint];
            if !model.jnt_limited()[joint] || range[0] >= range[1] {
                return Err(format!("joint `{name}` has no limits: give it a range"));
            }
            let anchor = Translation3::from(Vector3::from(model.jnt_pos()[joint]));
            joints.push(ChainJoint {
                placement: way * anchor,
                axis: Unit::new_normalize(Vector3::from(model.jnt_axis()[joint])),
                range,
            });
            way = Isometry3::from_parts(anchor.inverse(), UnitQuaternion::identity());
        }
        if body == flange_body {
            flange_way = Some(way);
        }
    }
    if joints.len() < wanted.len() {
        return Err(format!("joint `{}` does not lie between base and `{}`", arm.joints[joints.len()], arm.tcp_site));
    }
    let flange_way = flange_way
        .ok_or_else(|| format!("site `{}` does not lie between base and `{}`", arm.flange_site, arm.tcp_site))?;
    let site = |id: usize| isometry(&model.site_pos()[id], &model.site_quat()[id]);
    Ok(Chain { joints, flange: flange_way * site(flange), tcp: way * site(tcp) })
}

/// What a compiled robot must be besides a chain.
fn check(model: &MjModel, robot: &Robot, chain: &Chain) -> Result<(), String> {
    let settings = &robot.settings;
    for ((joint, home), name) in chain.joints.iter().zip(&settings.arm.home_rad).zip(&settings.arm.joints) {
        if !(joint.range[0]..=joint.range[1]).contains(home) {
            let [low, high] = joint.range;
            return Err(format!("joint `{name}`: arm.home_rad has {home}, outside its range {low} to {high}"));
        }
    }
    match &settings.gripper {
        Gripper::ParallelJaw(jaw) => check_jaw(model, jaw)?,
        Gripper::Suction(cup) => {
            let body = find(model, MjtObjBase::mjOBJ_BODY, "body", &cup.cup_body)?;
            let tcp = find(model, MjtObjBase::mjOBJ_SITE, "site", &settings.arm.tcp_site)?;
            if model.body_weldid()[body] != model.body_weldid()[model.site_bodyid()[tcp] as usize] {
                let (cup, tcp) = (&cup.cup_body, &settings.arm.tcp_site);
                return Err(format!("gripper.cup_body = \"{cup}\" moves against the site `{tcp}`, where its lip is"));
            }
        }
    }
    // A robot's folder holds the robot alone: whatever else it brings would stand in the cell unseen.
    let tcp = find(model, MjtObjBase::mjOBJ_SITE, "site", &settings.arm.tcp_site)?;
    let mut root = model.site_bodyid()[tcp];
    while model.body_parentid()[root as usize] != 0 {
        root = model.body_parentid()[root as usize];
    }
    for (geom, body) in model.geom_bodyid().iter().enumerate() {
        let touchable = model.geom_contype()[geom] != 0;
        if touchable && model.body_rootid()[*body as usize] != root {
            let name = model.id_to_name(MjtObjBase::mjOBJ_GEOM, geom).unwrap_or("without a name");
            return Err(format!("the shape `{name}` does not belong to the robot: a robot's model holds no scene"));
        }
    }
    Ok(())
}

/// What a compiled parallel jaw must be.
fn check_jaw(model: &MjModel, jaw: &ParallelJaw) -> Result<(), String> {
    let ParallelJaw { finger_joints, finger_bodies, opening_m, .. } = jaw;
    let mut width = 0.0;
    for name in finger_joints {
        let joint = find(model, MjtObjBase::mjOBJ_JOINT, "joint", name)?;
        if model.jnt_type()[joint] != MjtJoint::mjJNT_SLIDE || !model.jnt_limited()[joint] {
            return Err(format!("finger joint `{name}` must be a slide with a range"));
        }
        width += model.jnt_range()[joint][1];
    }
    if *opening_m > width + 1e-9 {
        return Err(format!("gripper.opening_m = {opening_m}, but the finger joints open {width} m at most"));
    }
    let fingers = [&finger_bodies[0], &finger_bodies[1]].map(|name| find(model, MjtObjBase::mjOBJ_BODY, "body", name));
    let [left, right] = [fingers[0].clone()?, fingers[1].clone()?];
    if left == right || finger_joints[0] == finger_joints[1] {
        return Err("gripper: the two fingers are one and the same".to_owned());
    }
    Ok(())
}

impl Engine for MujocoEngine {
    fn build(&self) -> EngineBuild {
        // The library that this process runs, as the loader mapped it.
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
        let library = maps
            .lines()
            .filter_map(|line| line.splitn(6, ' ').nth(5).map(str::trim_start))
            .find(|path| path.rsplit('/').next().is_some_and(|file| file.starts_with("libmujoco.so")));
        EngineBuild {
            name: "mujoco",
            version: mujoco_rs::mujoco_version().to_owned(),
            library: library.map(PathBuf::from),
        }
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
        };
        let loaded = self.loaded.insert(loaded);
        loaded.read_touches();
        Ok(())
    }

    fn read_back(&self) -> Result<Readback, Fault> {
        let loaded = self.loaded();
        let model = loaded.data.model();
        let mut friction = None;
        let mut table_friction = None;
        let mut parts = Vec::new();
        let mut obstacles = 0;
        for (geom, kind) in loaded.kinds.iter().enumerate() {
            match kind {
                Kind::Object => {
                    friction = Some(model.geom_friction()[geom][0]);
                    parts.extend(primitive(model, geom));
                }
                Kind::Fixture(0) if model.geom_priority()[geom] > 1 => {
                    table_friction = Some(model.geom_friction()[geom][0]);
                }
                Kind::Fixture(fixture) if *fixture > 0 => obstacles += 1,
                _ => {}
            }
        }
        let friction = friction.ok_or_else(|| Fault::new(FaultKind::Setup, "the object has no shape"))?;
        Ok(Readback {
            friction,
            table_friction: table_friction.unwrap_or(friction),
            gravity: -loaded.data.model_opt().gravity[2],
            mass_kg: model.body_mass()[loaded.object_body],
            centre_of_mass: Vector3::from(model.body_ipos()[loaded.object_body]),
            parts,
            object: self.object(),
            obstacles,
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
        loaded.read_touches();
    }

    fn health(&self) -> Result<(), Fault> {
        let loaded = self.loaded();
        if let Some(kind) = loaded.data.warning().iter().position(|warning| warning.number > 0) {
            let info = loaded.data.warning()[kind].lastinfo;
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
            return Err(Fault::new(FaultKind::Diverged, format!("MuJoCo: {what} (at {info})")));
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

    fn join(&mut self) {
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

    fn part(&mut self) {
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
                if loaded.scene.fixtures[fixture].distance_bound(centre, radius) < best {
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
