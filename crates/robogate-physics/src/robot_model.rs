//! Builds a MuJoCo model from a robot's folder, with the drives of `robot.toml`. All problems are reported at once.

use std::path::{Path, PathBuf};

use mujoco_rs::mujoco_c::mjtLimited;
use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_editing::{MjsBody, MjsGeom};
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::mujoco::damping::{self, Strong};
use crate::mujoco::{PREFIX, ROBOT, links, probe, sweep, wxyz};
use crate::robot::{BELLOWS_JOINT, CONTINUOUS_RAD, NOT_UTF_8, RobotSource};
use crate::scene::isometry;
use crate::{
    Bellows, Chain, ChainJoint, FingerMotion, Gripper, ParallelJaw, Problem, Robot, RobotError, RobotSettings, Site,
    SuctionCup, contact, includes, mesh_files, robot_folder,
};

/// Group of the model's own actuators, which is disabled: `robot.toml` defines the drives.
const OFF_GROUP: i32 = 30;
/// Group of shapes that pictures do not show.
const HIDDEN_GROUP: i32 = 3;
/// Mass (kg) and moment of inertia (kg m^2) of a moving link of a URDF without a mass.
const FRAME_MASS_KG: f64 = 1e-3;
const FRAME_INERTIA_KGM2: f64 = 1e-6;
/// Opening and length of fingers may differ from the model by this much, in metres.
const STATED_M: f64 = 2e-3;

/// The model's file.
pub(crate) fn path(robot: &Robot) -> PathBuf {
    match &robot.source {
        RobotSource::BuiltIn { .. } => PathBuf::from(&robot.settings.model),
        RobotSource::Folder(folder) => folder.join(&robot.settings.model),
    }
}

/// A robot's model without a scene.
pub(crate) struct Built {
    /// The model, ready for a scene.
    pub(crate) spec: MjSpec,
    pub(crate) chain: Chain,
    /// The motion of fingers with drives.
    pub(crate) fingers: Option<FingerMotion>,
    /// Which joints and drives are strongly damped ([`damping`]).
    pub(crate) strong: Strong,
}

/// Builds the model of a robot.
pub(crate) fn build(robot: &Robot, time_step: f64) -> Result<Built, Vec<Problem>> {
    let parsed = match &robot.source {
        RobotSource::BuiltIn { model, .. } => MjSpec::from_xml_string(model).map_err(|error| error.to_string()),
        RobotSource::Folder(_) => read(&path(robot)),
    };
    let mut spec = parsed.map_err(|why| vec![Problem::new(why, "MuJoCo reads MJCF and URDF: correct the file")])?;
    let settings = &robot.settings;
    let mut problems = Vec::new();
    prepare(&mut spec, time_step);
    turn(&mut spec, settings.arm.base_yaw_rad);
    for site in &settings.sites {
        add_site(&mut spec, site, &mut problems);
    }
    links::name_bodies(&mut spec);
    check_names(&spec, settings, &mut problems);
    let named = problems.is_empty();
    limit_continuous(&mut spec, settings);
    if settings.gripper.jaw().is_some() {
        let arm: Vec<&str> = settings.arm.joints.iter().map(String::as_str).collect();
        sweep::remove_friction(&mut spec, &arm);
    }
    add_drives(&mut spec, settings, &mut problems);
    // A spring with wrong figures is a problem of the settings.
    if let Some(cup) = settings.gripper.cup().filter(|_| named)
        && let Some(bellows) = &cup.bellows
        && bellows.stroke_m > 0.0
        && bellows.stiffness_n_m > 0.0
    {
        add_bellows(&mut spec, settings, cup, bellows, &mut problems);
    }
    let compiled = spec.clone().compile().or_else(|error| {
        let missing = leave_out_missing_meshes(&mut spec, robot);
        if missing.is_empty() {
            return Err(rejected(&error));
        }
        problems.extend(missing);
        // Without the missing meshes the compiler finds further problems.
        spec.clone().compile().map_err(|error| rejected(&error))
    });
    let model = match compiled {
        Ok(model) => model,
        Err(problem) => {
            // Errors that follow from missing meshes are not reported.
            if problems.is_empty() {
                problems.push(problem);
            }
            return Err(problems);
        }
    };
    check_joints(&model, settings, &mut problems);
    check_gripper(&model, settings, &mut problems);
    check_shapes(&model, settings, &mut problems);
    check_alone(&model, settings, &mut problems);
    // Without all names the chain cannot be followed.
    let chain = if named { chain(&model, settings, &mut problems) } else { None };
    let Some(chain) = chain.filter(|_| problems.is_empty()) else { return Err(problems) };
    let fingers = match settings.gripper.jaw().filter(|jaw| !jaw.drives.is_empty()) {
        Some(jaw) => Some(finger_motion(&mut spec, settings, jaw)?),
        None => None,
    };
    let strong = damping::couple(&mut spec, &model, settings, fingers.as_ref(), time_step);
    links::let_links_collide(&mut spec, model, settings, fingers.as_ref());
    Ok(Built { spec, chain, fingers, strong })
}

/// Measures how the drives move the fingers, and gives them their limits.
fn finger_motion(spec: &mut MjSpec, settings: &RobotSettings, jaw: &ParallelJaw) -> Result<FingerMotion, Vec<Problem>> {
    let arm: Vec<&str> = settings.arm.joints.iter().map(String::as_str).collect();
    let mut measurable = spec.clone();
    sweep::measurable(&mut measurable, &arm);
    probe::add(&mut measurable);
    let model = measurable.compile().map_err(|error| vec![rejected(&error)])?;
    let motion = sweep::measure(model, settings, jaw)?;
    let open = motion.open().opening_m;
    let mut problems = Vec::new();
    if (open - jaw.opening_m).abs() > STATED_M {
        problems.push(Problem::new(
            format!(
                "gripper.opening_m = {}, but with [[gripper.drive]] at open the pads are {open:.4} m apart",
                jaw.opening_m
            ),
            "give the distance between the pads of the open gripper, or another position for open",
        ));
    }
    if motion.tip_m > jaw.tip_m + STATED_M {
        problems.push(Problem::new(
            format!(
                "gripper.tip_m = {}, but the fingers reach {:.4} m beyond the tool centre point between open and closed",
                jaw.tip_m, motion.tip_m
            ),
            "give the largest distance from the site of arm.tcp_site to the fingertips, along its z axis",
        ));
    }
    if !problems.is_empty() {
        return Err(problems);
    }
    for follower in &motion.followers {
        sweep::add_motor(spec, follower);
    }
    sweep::limit(spec, jaw, &motion);
    Ok(motion)
}

/// Reads a model file. The mesh files of a URDF are found in its folder, also by `package://` addresses.
pub(crate) fn read(path: &Path) -> Result<MjSpec, String> {
    let is_urdf = is_urdf(path);
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // The names of a model are texts, so a file in another encoding has none that can be used.
    let text = robot_folder::text(path).map_err(|error| match error {
        // The caller names the file.
        RobotError::Encoding { .. } => NOT_UTF_8.to_owned(),
        RobotError::Read { why, .. } => why,
        other => other.to_string(),
    })?;
    includes::replaced(&text, folder)?;
    let mut spec = match is_urdf.then(|| mesh_files::with_full_paths(&text, folder)).flatten() {
        Some(text) => MjSpec::from_xml_string(&text),
        None => MjSpec::from_xml(path),
    }
    .map_err(|error| error.to_string())?;
    for [first, second] in if is_urdf { mesh_files::excluded(&text) } else { Vec::new() } {
        let exclude = spec.add_exclude();
        exclude.set_bodyname1(&first);
        exclude.set_bodyname2(&second);
    }
    if is_urdf {
        give_mass(&mut spec);
    }
    Ok(spec)
}

/// Whether a model is a URDF, by the end of its name.
pub(crate) fn is_urdf(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("urdf"))
}

/// A URDF as the text of an MJCF for pictures. Its visual shapes are in group 1, and its collision shapes are hidden if it has
/// visual ones that MuJoCo can read.
pub(crate) fn pictured(path: &Path) -> Result<String, String> {
    /// Longest text. Robots have some hundred kilobytes.
    const LONGEST: usize = 1 << 24;
    crate::mujoco::load_mujoco().map_err(|error| error.to_string())?;
    let mut spec = read(path)?;
    spec.compiler_mut().set_fusestatic(false);
    let physical = spec.clone();
    spec.compiler_mut().set_discardvisual(false);
    let touches = |geom: &MjsGeom| geom.contype() != 0 || geom.conaffinity() != 0;
    if spec.geom_iter().any(|geom| !touches(geom)) {
        for geom in spec.geom_iter_mut() {
            if touches(geom) {
                geom.set_group(HIDDEN_GROUP);
            }
        }
    }
    if spec.compile().is_err() {
        spec = physical;
        spec.compile().map_err(|error| error.to_string())?;
    }
    spec.save_xml_string(LONGEST).map_err(|error| error.to_string())
}

/// Gives links a mass where a moving link of a URDF has none. They are frames between joints, which MuJoCo rejects.
fn give_mass(spec: &mut MjSpec) {
    let massless = |error: MjEditError| error.to_string().contains("mass and inertia of moving bodies");
    if spec.clone().compile().err().is_some_and(massless) {
        spec.compiler_mut().set_boundmass(FRAME_MASS_KG);
        spec.compiler_mut().set_boundinertia(FRAME_INERTIA_KGM2);
    }
}

/// The problem of a model that does not compile.
pub(crate) fn rejected(error: &MjEditError) -> Problem {
    let why = error.to_string();
    match why.split_once("no decoder found for mesh file '").and_then(|(_, rest)| rest.split_once('\'')) {
        Some((file, _)) => Problem::new(
            format!("the mesh {file} has a format that MuJoCo does not read"),
            "convert it to STL or OBJ, for example with MeshLab or Blender, and name the new file in the model",
        ),
        None if why.contains("Error opening file 'package:") => Problem::new(
            why.replacen("package:/", "package://", 1),
            "the files of a robot lie below the folder of its model. In a ROS package with `urdf` and `meshes` side by side, copy the \
             URDF into the folder above them",
        ),
        None => Problem::new(why, "this error is from MuJoCo: correct the model"),
    }
}

/// Removes everything from the model that is not part of the robot: options, actuators, keyframes, contact settings.
pub(crate) fn prepare(spec: &mut MjSpec, time_step: f64) {
    *spec.option_mut() = MjSpec::new().option().clone();
    spec.set_memory(MjSpec::new().memory());
    let compiler = spec.compiler_mut();
    // Other bounds than those of `read` are settings of the file.
    if (compiler.boundmass() - FRAME_MASS_KG).abs() > 0.0 {
        compiler.set_boundmass(0.0);
        compiler.set_boundinertia(0.0);
    }
    compiler.set_balanceinertia(false);
    // Links of a URDF that are fixed to each other stay separate bodies, because robot.toml names them.
    compiler.set_fusestatic(false);
    for actuator in spec.actuator_iter_mut() {
        actuator.set_group(OFF_GROUP);
    }
    // A keyframe is a state of the robot without a scene.
    while let Some(key) = spec.key_iter_mut().next() {
        // SAFETY: the handle comes directly from the spec, is used once, and no other handle is held.
        #[expect(unsafe_code, reason = "the binding has no safe deletion")]
        if unsafe { key.delete() }.is_err() {
            break;
        }
    }
    for geom in spec.geom_iter_mut() {
        if geom.contype() != 0 || geom.conaffinity() != 0 {
            geom.set_contype(ROBOT.0);
            geom.set_conaffinity(ROBOT.1);
            // The object's friction coefficient takes precedence over the model's.
            geom.set_priority(0);
            geom.set_margin(0.0);
            geom.set_gap(0.0);
        }
    }
    compensate_weight(spec.world_body_mut());
    let option = spec.option_mut();
    option.timestep = time_step;
    option.integrator = MjtIntegrator::mjINT_IMPLICITFAST as i32;
    option.cone = MjtCone::mjCONE_ELLIPTIC as i32;
    option.impratio = 10.0;
    option.solver = MjtSolver::mjSOL_NEWTON as i32;
    option.iterations = 100;
    option.ls_iterations = 50;
    option.disableactuator = 1 << OFF_GROUP;
}

/// Rotates the bodies on the ground about the vertical axis through the origin.
fn turn(spec: &mut MjSpec, yaw_rad: f64) {
    // A model that does not compile is reported by the caller.
    let Some(model) = (yaw_rad != 0.0).then(|| spec.clone().compile().ok()).flatten() else { return };
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    let roots = (1..model.body_parentid().len()).filter(|body| model.body_parentid()[*body] == 0);
    for (body, id) in spec.world_body_mut().body_iter_mut().zip(roots) {
        let at = isometry(&model.body_pos()[id], &model.body_quat()[id]);
        let turned = Isometry3::from_parts(Translation3::identity(), yaw) * at;
        *body.pos_mut() = turned.translation.vector.into();
        *body.quat_mut() = wxyz(&turned.rotation);
        // The angles of the model are part of the quaternion now.
        body.alt_mut().switch_quat();
    }
}

/// Compensates the weight of the robot, as every arm's controller does, but not the weight of its load.
fn compensate_weight(body: &mut MjsBody) {
    for child in body.body_iter_mut() {
        child.set_gravcomp(1.0);
        compensate_weight(child);
    }
}

fn add_site(spec: &mut MjSpec, site: &Site, problems: &mut Vec<Problem>) {
    if spec.site(&site.name).is_some() {
        problems.push(Problem::new(
            format!("[[site]] `{}`: the model already has a site of this name", site.name),
            "use the model's site, or choose another name",
        ));
        return;
    }
    let Some(body) = spec.body_mut(&site.body) else {
        let there = listed(spec.body_iter().map(|body| body.name()));
        problems.push(Problem::new(
            format!("[[site]] `{}`: the model has no body `{}`", site.name, site.body),
            format!("the model has {there}"),
        ));
        return;
    };
    let [roll, pitch, yaw] = site.rpy_rad;
    let added = body.add_site().with_name(&site.name);
    *added.pos_mut() = site.position_m;
    *added.quat_mut() = wxyz(&UnitQuaternion::from_euler_angles(roll, pitch, yaw));
}

/// Names for a hint.
fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<String> =
        names.filter(|name| !name.is_empty() && *name != "world").map(|n| format!("`{n}`")).collect();
    if names.is_empty() { "none with a name".to_owned() } else { names.join(", ") }
}

/// Checks that the model has all names of robot.toml.
fn check_names(spec: &MjSpec, settings: &RobotSettings, problems: &mut Vec<Problem>) {
    let arm = &settings.arm;
    let mut missing = |what: &str, name: &str, hint: String| {
        let what = format!("the model has no {what} `{name}`, which robot.toml names");
        problems.push(Problem::new(what, hint));
    };
    let (fingers, bodies): (&[String], &[String]) = match &settings.gripper {
        Gripper::ParallelJaw(jaw) => (jaw.slides(), &jaw.finger_bodies),
        Gripper::Suction(cup) => (&[], std::slice::from_ref(&cup.cup_body)),
    };
    for name in arm.joints.iter().chain(fingers).filter(|name| spec.joint(name).is_none()) {
        missing("joint", name, format!("the model has {}", listed(spec.joint_iter().map(|joint| joint.name()))));
    }
    for name in [&arm.flange_site, &arm.tcp_site].into_iter().filter(|name| spec.site(name).is_none()) {
        let there = listed(spec.site_iter().map(|site| site.name()));
        missing(
            "site",
            name,
            format!("the model has {there}; add one in robot.toml: [[site]] with name, body, position_m and rpy_rad"),
        );
    }
    let drives = settings.gripper.jaw().map_or(&[][..], |jaw| &jaw.drives).iter().map(|drive| &drive.moves);
    for name in drives.filter(|name| spec.joint(name).is_none() && spec.tendon(name).is_none()) {
        let joints = spec.joint_iter().map(|joint| joint.name());
        let there = listed(joints.chain(spec.tendon_iter().map(|tendon| tendon.name())));
        missing("joint or tendon", name, format!("the model has {there}"));
    }
    for name in bodies.iter().filter(|name| spec.body(name).is_none()) {
        missing("body", name, format!("the model has {}", listed(spec.body_iter().map(|body| body.name()))));
    }
}

/// Gives the arm's hinges without limits the range of a continuous joint.
fn limit_continuous(spec: &mut MjSpec, settings: &RobotSettings) {
    for name in &settings.arm.joints {
        let Some(joint) = spec.joint_mut(name) else { continue };
        let unlimited = match joint.limited() {
            mjtLimited::mjLIMITED_TRUE => false,
            mjtLimited::mjLIMITED_FALSE => true,
            mjtLimited::mjLIMITED_AUTO => *joint.range() == [0.0; 2],
        };
        if unlimited && joint.type_() == MjtJoint::mjJNT_HINGE {
            *joint.range_mut() = [-CONTINUOUS_RAD, CONTINUOUS_RAD];
            joint.set_limited(mjtLimited::mjLIMITED_TRUE);
        }
    }
}

/// Adds a servo to every joint that robot.toml names.
fn add_drives(spec: &mut MjSpec, settings: &RobotSettings, problems: &mut Vec<Problem>) {
    let arm = &settings.arm;
    // An array that is too short is reported as a problem of the settings.
    let entry = |values: &[f64], i: usize| values.get(i).copied().unwrap_or(1.0);
    let joints = arm.joints.iter().enumerate().map(|(i, name)| {
        let [stiffness, damping, limit] =
            [&arm.stiffness_nm_rad, &arm.damping_nms_rad, &arm.torque_limit_nm].map(|values| entry(values, i));
        (name, stiffness, damping, limit)
    });
    let fingers =
        settings.gripper.jaw().into_iter().flat_map(|jaw| {
            jaw.slides().iter().map(|name| (name, jaw.stiffness_n_m, jaw.damping_ns_m, jaw.force_limit_n))
        });
    for (joint, stiffness, damping, limit) in joints.chain(fingers) {
        let Some(driven) = spec.joint_mut(joint) else { continue };
        // The drives' torque limits include the weight of the arm.
        driven.set_actgravcomp(true);
        *driven.actfrcrange_mut() = [-limit, limit];
        driven.set_actfrclimited(mjtLimited::mjLIMITED_TRUE);
        // End stops are stiffer than the drives.
        driven.solref_limit_mut()[..2].copy_from_slice(&[contact::TIME_CONSTANT_S, 1.0]);
        driven.solimp_limit_mut()[..3].copy_from_slice(&contact::LIMIT_IMPEDANCE);
        let mut gain = [0.0; 10];
        gain[0] = stiffness;
        let mut bias = [0.0; 10];
        (bias[1], bias[2]) = (-stiffness, -damping);
        let actuator = spec.add_actuator();
        if actuator.set_name(&format!("{PREFIX}{joint}")).is_err() {
            problems
                .push(Problem::new(format!("joint `{joint}` is named twice in robot.toml"), "name each joint once"));
            // SAFETY: the handle was created above, is used for the last time, and no other handle is held.
            #[expect(unsafe_code, reason = "the binding has no safe deletion")]
            let _ = unsafe { actuator.delete() };
            continue;
        }
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
    for drive in settings.gripper.jaw().map_or(&[][..], |jaw| &jaw.drives) {
        let there = spec.joint(&drive.moves).is_some() || spec.tendon(&drive.moves).is_some();
        if there && !sweep::add_motor(spec, &drive.moves) {
            let what = format!("`{}` is named twice in robot.toml", drive.moves);
            problems.push(Problem::new(what, "name each joint or tendon once"));
        }
    }
}

/// Adds the spring of a suction cup: a slide of the cup's body along the tool's z axis.
fn add_bellows(
    spec: &mut MjSpec,
    settings: &RobotSettings,
    cup: &SuctionCup,
    bellows: &Bellows,
    problems: &mut Vec<Problem>,
) {
    // A model that does not compile is reported by the caller.
    let Ok(model) = spec.clone().compile() else { return };
    let body = model.name_to_id(MjtObjBase::mjOBJ_BODY, &cup.cup_body);
    let tcp = model.name_to_id(MjtObjBase::mjOBJ_SITE, &settings.arm.tcp_site);
    let (Some(body), Some(tcp)) = (body, tcp) else { return };
    let (name, site) = (&cup.cup_body, &settings.arm.tcp_site);
    let mass = model.body_subtreemass()[body];
    let problem = if model.site_bodyid()[tcp] as usize != body {
        Some((
            format!("gripper.bellows: the site `{site}` is not on the body `{name}`, which the spring moves"),
            "put the site on the cup's own body",
        ))
    } else if model.body_jntnum()[body] > 0 {
        Some((
            format!("gripper.bellows: the body `{name}` has a joint of its own"),
            "remove the joint from the model: RoboGate adds the spring",
        ))
    } else if mass <= 0.0 {
        Some((
            format!("gripper.bellows: the body `{name}` moves on its spring but has no mass"),
            "give it the mass of the cup, for example 0.03 kg",
        ))
    } else {
        None
    };
    if let Some((what, hint)) = problem {
        problems.push(Problem::new(what, hint));
        return;
    }
    let axis = isometry(&model.site_pos()[tcp], &model.site_quat()[tcp]).rotation * Vector3::z();
    let Some(body) = spec.body_mut(name) else { return };
    let joint = body.add_joint().with_name(BELLOWS_JOINT);
    joint.set_type(MjtJoint::mjJNT_SLIDE);
    *joint.pos_mut() = [0.0; 3];
    *joint.axis_mut() = axis.into();
    *joint.range_mut() = [-bellows.stroke_m, 0.0];
    joint.set_limited(mjtLimited::mjLIMITED_TRUE);
    joint.stiffness_mut().fill(0.0);
    joint.stiffness_mut()[0] = bellows.stiffness_n_m;
    joint.damping_mut().fill(0.0);
    joint.damping_mut()[0] = bellows.damping_ns_m(mass);
    // The defaults of a robot's file do not apply to the spring.
    joint.set_springref(0.0);
    joint.set_armature(0.0);
    joint.set_frictionloss(0.0);
    joint.set_margin(0.0);
    joint.solref_limit_mut()[..2].copy_from_slice(&[contact::TIME_CONSTANT_S, 1.0]);
    joint.solimp_limit_mut()[..3].copy_from_slice(&contact::LIMIT_IMPEDANCE);
}

/// Reports the meshes without a file, and replaces them by small balls.
fn leave_out_missing_meshes(spec: &mut MjSpec, robot: &Robot) -> Vec<Problem> {
    let RobotSource::Folder(folder) = &robot.source else { return Vec::new() };
    let folder = folder.join(spec.compiler().meshdir());
    let missing: Vec<(String, PathBuf)> = spec
        .mesh_iter()
        .filter(|mesh| !mesh.file().is_empty())
        .map(|mesh| (mesh.name().to_owned(), folder.join(mesh.file())))
        .filter(|(_, file)| !file.is_file())
        .collect();
    let is_missing = |name: &str| missing.iter().any(|(mesh, _)| mesh == name);
    for geom in spec.geom_iter_mut().filter(|geom| is_missing(geom.meshname())) {
        geom.set_meshname("");
        geom.set_type(MjtGeomBase::mjGEOM_SPHERE);
        *geom.size_mut() = [0.01, 0.0, 0.0];
    }
    for (name, _) in &missing {
        if let Some(mesh) = spec.mesh_mut(name) {
            // SAFETY: the handle comes directly from the spec, is used once, and no geom refers to the mesh.
            #[expect(unsafe_code, reason = "the binding has no safe deletion")]
            let _ = unsafe { mesh.delete() };
        }
    }
    let problem = |(name, file): (String, PathBuf)| {
        Problem::new(
            format!("mesh `{name}`: the file {} does not exist", file.display()),
            "copy the file there, or correct the mesh's file or the compiler's meshdir in the model",
        )
    };
    missing.into_iter().map(problem).collect()
}

pub(crate) fn joint_id(model: &MjModel, name: &str) -> Option<usize> {
    model.name_to_id(MjtObjBase::mjOBJ_JOINT, name)
}

/// Checks the arm's joints.
fn check_joints(model: &MjModel, settings: &RobotSettings, problems: &mut Vec<Problem>) {
    let arm = &settings.arm;
    for (i, name) in arm.joints.iter().enumerate() {
        let Some(joint) = joint_id(model, name) else { continue };
        if model.jnt_type()[joint] != MjtJoint::mjJNT_HINGE {
            problems.push(Problem::new(
                format!("joint `{name}` is not a hinge: arms with sliding joints are not supported"),
                "fix the joint in the model, or list only the arm's hinges",
            ));
            continue;
        }
        let [low, high] = model.jnt_range()[joint];
        if low >= high {
            problems.push(Problem::new(
                format!("joint `{name}` has the range {low} to {high}"),
                "give it a range in the model (MJCF: range=\"low high\"; URDF: a revolute joint with <limit>)",
            ));
            continue;
        }
        if let Some(home) = arm.home_rad.get(i).filter(|home| !(low..=high).contains(*home)) {
            problems.push(Problem::new(
                format!("joint `{name}`: arm.home_rad has {home}, outside the joint's range {low} to {high}"),
                "home_rad is in radians and in the order of arm.joints",
            ));
        }
    }
}

fn check_gripper(model: &MjModel, settings: &RobotSettings, problems: &mut Vec<Problem>) {
    let body = |name: &str| model.name_to_id(MjtObjBase::mjOBJ_BODY, name);
    let tcp = model.name_to_id(MjtObjBase::mjOBJ_SITE, &settings.arm.tcp_site);
    match &settings.gripper {
        Gripper::ParallelJaw(jaw) => check_jaw(model, jaw, problems),
        Gripper::Suction(cup) => {
            if let (Some(body), Some(tcp)) = (body(&cup.cup_body), tcp)
                && model.body_weldid()[body] != model.body_weldid()[model.site_bodyid()[tcp] as usize]
            {
                let (cup, tcp) = (&cup.cup_body, &settings.arm.tcp_site);
                problems.push(Problem::new(
                    format!("gripper.cup_body = \"{cup}\" moves relative to the site `{tcp}`, where its lip is"),
                    "put the site on the cup's own body",
                ));
            }
        }
    }
}

/// Checks that the robot and its gripper have collision shapes.
fn check_shapes(model: &MjModel, settings: &RobotSettings, problems: &mut Vec<Problem>) {
    let collides = |geom: usize| model.geom_contype()[geom] != 0 || model.geom_conaffinity()[geom] != 0;
    let of = |weld: i32| {
        let bodies = model.geom_bodyid().iter().map(|body| model.body_weldid()[*body as usize]);
        bodies.enumerate().any(|(geom, body)| body == weld && collides(geom))
    };
    let moving = model.geom_bodyid().iter().map(|body| model.body_weldid()[*body as usize]);
    if !moving.enumerate().any(|(geom, weld)| weld != 0 && collides(geom)) {
        problems.push(Problem::new(
            "no moving part of the robot has a collision shape: it would pass through everything",
            "give the links geoms with contype or conaffinity (MJCF) or <collision> elements (URDF: <visual> does not collide)",
        ));
        return;
    }
    let bodies: &[String] = match &settings.gripper {
        Gripper::ParallelJaw(jaw) => &jaw.finger_bodies,
        Gripper::Suction(cup) => std::slice::from_ref(&cup.cup_body),
    };
    for name in bodies {
        if let Some(body) = model.name_to_id(MjtObjBase::mjOBJ_BODY, name)
            && !of(model.body_weldid()[body])
        {
            problems.push(Problem::new(
                format!("body `{name}` of the gripper has no collision shape: it could not touch anything"),
                "give it a geom with contype or conaffinity, or a <collision> element",
            ));
        }
    }
}

/// Checks a parallel jaw.
fn check_jaw(model: &MjModel, jaw: &ParallelJaw, problems: &mut Vec<Problem>) {
    let ParallelJaw { finger_bodies, opening_m, .. } = jaw;
    if finger_bodies[0] == finger_bodies[1] || jaw.finger_joints.as_ref().is_some_and(|[a, b]| a == b) {
        problems.push(Problem::new(
            "gripper: both fingers have the same name",
            "give two different joints and two different bodies",
        ));
        return;
    }
    let Some(finger_joints) = &jaw.finger_joints else { return };
    let mut width = 0.0;
    for name in finger_joints {
        let Some(joint) = joint_id(model, name) else { return };
        let [low, high] = model.jnt_range()[joint];
        if model.jnt_type()[joint] != MjtJoint::mjJNT_SLIDE || !model.jnt_limited()[joint] {
            problems.push(Problem::new(
                format!("finger joint `{name}` is not a slide with a range"),
                "gripper.finger_joints are slides that range from 0, closed, to half the opening; give all other fingers [[gripper.drive]] (docs/guides/robots.md)",
            ));
            return;
        }
        if low > 0.0 || high <= 0.0 {
            problems.push(Problem::new(
                format!("finger joint `{name}` ranges from {low} to {high}. Expected 0, closed, to a positive value"),
                "describe a slide with another zero or direction by [[gripper.drive]] (docs/guides/robots.md)",
            ));
            return;
        }
        width += high;
    }
    if *opening_m > width + 1e-9 {
        problems.push(Problem::new(
            format!("gripper.opening_m = {opening_m}, but the finger joints open by at most {width} m"),
            "opening_m is the distance between the pads when both joints are at the end of their range",
        ));
    }
}

/// Checks that the model contains only the robot: other shapes would be unknown obstacles.
fn check_alone(model: &MjModel, settings: &RobotSettings, problems: &mut Vec<Problem>) {
    let Some(tcp) = model.name_to_id(MjtObjBase::mjOBJ_SITE, &settings.arm.tcp_site) else { return };
    let root = model.body_rootid()[model.site_bodyid()[tcp] as usize];
    for (geom, body) in model.geom_bodyid().iter().enumerate() {
        if model.geom_contype()[geom] != 0 && model.body_rootid()[*body as usize] != root {
            let name = model.id_to_name(MjtObjBase::mjOBJ_GEOM, geom).unwrap_or("without a name");
            problems.push(Problem::new(
                format!("the shape `{name}` does not belong to the robot: a robot's model must not contain a scene"),
                "remove floor, table and objects from the model, and attach the robot's base to the world as one body",
            ));
        }
    }
}

/// The serial chain from the base to the tool of a compiled model.
fn chain(model: &MjModel, settings: &RobotSettings, problems: &mut Vec<Problem>) -> Option<Chain> {
    let arm = &settings.arm;
    let site = |name: &str| model.name_to_id(MjtObjBase::mjOBJ_SITE, name);
    let (tcp, flange) = (site(&arm.tcp_site)?, site(&arm.flange_site)?);
    let mut bodies = Vec::new();
    let mut body = model.site_bodyid()[tcp] as usize;
    while body != 0 {
        bodies.push(body);
        body = model.body_parentid()[body] as usize;
    }
    let mut joints: Vec<ChainJoint> = Vec::new();
    // Transform from the last joint's frame to the current body.
    let mut offset = Isometry3::identity();
    let mut flange_offset = None;
    for &body in bodies.iter().rev() {
        offset *= isometry(&model.body_pos()[body], &model.body_quat()[body]);
        let first = model.body_jntadr()[body];
        for joint in (0..model.body_jntnum()[body]).map(|k| (first + k) as usize) {
            let name = model.id_to_name(MjtObjBase::mjOBJ_JOINT, joint).unwrap_or("(without a name)");
            // The kinematics are those of the relaxed cup.
            if name == BELLOWS_JOINT {
                continue;
            }
            let expected = arm.joints.get(joints.len());
            if expected.and_then(|expected| joint_id(model, expected)) != Some(joint) {
                let expected = expected.map_or("no more".to_owned(), |name| format!("`{name}`"));
                problems.push(Problem::new(
                    format!("joint `{name}` is between base and `{}` where arm.joints has {expected}", arm.tcp_site),
                    "list every joint of the arm from base to tip; fix joints that must not move in the model",
                ));
                return None;
            }
            let anchor = Translation3::from(Vector3::from(model.jnt_pos()[joint]));
            joints.push(ChainJoint {
                placement: offset * anchor,
                axis: Unit::new_normalize(Vector3::from(model.jnt_axis()[joint])),
                range: model.jnt_range()[joint],
            });
            offset = Isometry3::from_parts(anchor.inverse(), UnitQuaternion::identity());
            flange_offset = None;
        }
        if body == model.site_bodyid()[flange] as usize {
            flange_offset = Some(offset);
        }
    }
    if let Some(left) = arm.joints.get(joints.len()) {
        problems.push(Problem::new(
            format!("joint `{left}` is not between base and `{}`", arm.tcp_site),
            "list only the arm's joints in arm.joints, from base to tip; the fingers' joints belong under [gripper]",
        ));
        return None;
    }
    let Some(flange_offset) = flange_offset else {
        problems.push(Problem::new(
            format!("site `{}` is not between the last joint and `{}`", arm.flange_site, arm.tcp_site),
            "the flange is where the tool is mounted: put its site on the last link or on a body fixed to it",
        ));
        return None;
    };
    let pose = |id: usize| isometry(&model.site_pos()[id], &model.site_quat()[id]);
    Some(Chain { joints, flange: flange_offset * pose(flange), tcp: offset * pose(tcp) })
}
