//! Drafts a `robot.toml` from a robot's model, and marks what is guessed.
//!
//! The arm is the chain of hinges from the base to the first body that branches into fingers, or to the end. Limits, servo
//! gains and the home posture come from the model where it has them. A model that is not one arm is rejected.

mod clearance;
mod home;
mod servo;
mod urdf;

use std::fmt::Write;
use std::path::Path;

use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use self::home::{BASE_YAWS, face_the_table, home_of, is_over_workspace, turns_fully};
use crate::drafted_jaw::{Jaw, TIP};
use crate::mujoco::{load_mujoco, sweep};
use crate::robot::{CONTINUOUS_RAD, RobotSource};
use crate::robot_model::{self, joint_id};
use crate::scene::isometry;
use crate::{Chain, MujocoEngine, Problem, Robot, RobotSettings};

/// An arm has at least this many hinges in a row.
const FEWEST_JOINTS: usize = 4;
/// Words in the names of joints that move a jaw.
const JAW_NAMES: [&str; 3] = ["jaw", "finger", "claw"];
/// A link up to this mass without a shape is a frame, in kilograms: MuJoCo gives a massless link of a URDF 1 g.
const MOST_FRAME_KG: f64 = 2e-3;
/// Distance that the home posture keeps from the ends of the joints' ranges, in radians.
const HOME_MARGIN: f64 = 0.05;
/// Number of joints of the shoulder, which are near the base in every posture.
const SHOULDER: usize = 2;
/// The shapes of a tool reach farther along another axis by more than this factor.
const OUTWARDS: f64 = 1.05;
/// Speed of a joint without a stated limit, in rad/s.
const SPEED: f64 = 2.0;
/// Acceleration of the joints, in rad/s^2: no model states it. MoveIt configurations of industrial arms use this value.
const ACCELERATION: f64 = 5.0;
/// Torque limit of a joint without one, in N m.
const TORQUE: f64 = 100.0;
/// Stiffness of a servo without a stated gain, in multiples of its torque limit per radian.
const STIFFNESS: f64 = 60.0;
/// Damping of such a servo, in multiples of its stiffness, in seconds.
const DAMPING_S: f64 = 0.07;

/// A drafted `robot.toml`.
#[derive(Debug, Clone, PartialEq)]
pub struct Draft {
    /// The text of the file, with a comment on each guess.
    pub text: String,
    /// The guesses, one sentence each.
    pub guesses: Vec<String>,
}

/// Drafts the `robot.toml` of a model (MJCF or URDF). `name` is the robot's name.
///
/// # Errors
/// If the model cannot be read, or is not one arm.
pub fn draft(model: &Path, name: &str) -> Result<Draft, Vec<Problem>> {
    let one = |what: String, hint: &str| vec![Problem::new(what, hint)];
    load_mujoco().map_err(|error| one(error.to_string(), "MuJoCo reads the model"))?;
    let file = model.file_name().map(|file| file.to_string_lossy().into_owned()).unwrap_or_default();
    let mut spec =
        robot_model::read(model).map_err(|error| one(error, "MuJoCo reads MJCF and URDF: correct the file"))?;
    let raw = spec.clone().compile().map_err(|error| vec![robot_model::rejected(&error)])?;
    robot_model::prepare(&mut spec, MujocoEngine::TIME_STEP_S);
    let compiled = spec.clone().compile().map_err(|error| vec![robot_model::rejected(&error)])?;
    let text = match std::fs::read_to_string(model) {
        // MuJoCo has read it. A URDF in another encoding has no limits of velocity for the draft.
        Err(error) if error.kind() == std::io::ErrorKind::InvalidData => String::new(),
        read => read.map_err(|error| one(format!("{file}: {error}"), "check the file"))?,
    };
    let mut tree = Tree::of(&compiled).map_err(|problem| vec![problem])?;
    let one_jaw = tree.take_jaw(&spec, &compiled)?;
    let mut draft = Writer { out: String::new(), guesses: Vec::new() };
    let mut arm = ArmDraft::of(&compiled, &raw, &tree, &text);
    let tool = Tool::of(&spec, &compiled, &tree, one_jaw)?;
    let mut settings = settings(name, &file, &arm, &tool, arm.home.clone().unwrap_or_else(|| arm.middle()))?;
    let folder = model.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut chain = kinematics(&settings, folder);
    let stated = arm.home.as_deref();
    let home_is_known = stated.is_some_and(|home| chain.as_ref().is_none_or(|chain| is_over_workspace(chain, home)));
    // A model may face another way, and its first joint may not turn far enough.
    let mut found = None;
    let mut clearance = if home_is_known { None } else { clearance::Clearance::of(&spec, &tree.joints) };
    // A posture that touches something is better than none.
    for may_touch in [false, true] {
        for yaw in if home_is_known || found.is_some() { &[][..] } else { &BASE_YAWS } {
            if settings.arm.base_yaw_rad.to_bits() != yaw.to_bits() {
                settings.arm.base_yaw_rad = *yaw;
                chain = kinematics(&settings, folder);
            }
            let mut accepted =
                |home: &[f64]| may_touch || clearance.as_mut().is_none_or(|clearance| clearance.is_free(home));
            found = chain.as_ref().and_then(|chain| home_of(chain, stated, &mut accepted));
            if found.is_some() || chain.as_ref().is_none_or(turns_fully) {
                break;
            }
        }
    }
    if found.is_none() && settings.arm.base_yaw_rad != 0.0 {
        settings.arm.base_yaw_rad = 0.0;
        chain = kinematics(&settings, folder);
    }
    if let (Some(home), Some(chain)) = (&found, &chain) {
        settings.arm.home_rad.clone_from(home);
        face_the_table(chain, &mut settings);
    }
    if let Some(chain) = &chain {
        settings.arm.reach_m = crate::inspect::reach(chain)[0];
        arm.drop_soft_gains(chain, &settings.arm.home_rad);
    }
    draft.guesses.extend(urdf::guesses(&text));
    draft.write(name, &file, &arm, &tool, &settings, (home_is_known, found.is_some()));
    Ok(Draft { text: draft.out, guesses: draft.guesses })
}

/// The arm's joints and the body that carries the gripper.
struct Tree {
    /// Joints from base to tip.
    joints: Vec<usize>,
    /// The body of the last joint.
    last: usize,
    /// The body where the fingers branch. `None` without fingers.
    palm: Option<usize>,
    /// The joints of the gripper.
    fingers: Vec<usize>,
    /// Joints behind the arm that move nothing.
    idle: Vec<String>,
}

impl Tree {
    fn of(model: &MjModel) -> Result<Self, Problem> {
        let bodies = model.body_parentid().len();
        let joints_of = |body: usize| {
            let first = model.body_jntadr()[body].max(0) as usize;
            first..first + model.body_jntnum()[body] as usize
        };
        let children = |body: usize| (1..bodies).filter(move |child| model.body_parentid()[*child] as usize == body);
        // A body comes after its parent, so counts can be added from the last body to the first.
        let mut below = vec![0; bodies];
        let mut deepest = vec![0; bodies];
        for body in (1..bodies).rev() {
            let hinges = joints_of(body).filter(|joint| model.jnt_type()[*joint] == MjtJoint::mjJNT_HINGE).count();
            below[body] += joints_of(body).len();
            deepest[body] += hinges;
            let parent = model.body_parentid()[body] as usize;
            if parent > 0 {
                below[parent] += below[body];
                deepest[parent] = deepest[parent].max(deepest[body]);
            }
        }
        let name =
            |joint: usize| model.id_to_name(MjtObjBase::mjOBJ_JOINT, joint).unwrap_or("(without a name)").to_owned();
        let (mut joints, mut last, mut at) = (Vec::new(), 0, 0);
        loop {
            let moving: Vec<usize> = children(at).filter(|child| below[*child] > 0).collect();
            let arms = moving.iter().filter(|child| deepest[**child] >= FEWEST_JOINTS).count();
            let [next] = moving[..] else {
                if moving.is_empty() && joints.len() >= FEWEST_JOINTS {
                    return Ok(Self { joints, last, palm: None, fingers: Vec::new(), idle: Vec::new() });
                }
                if joints.len() < FEWEST_JOINTS {
                    return Err(not_one_arm(arms, moving.len()));
                }
                let fingers = moving.iter().flat_map(|child| subtree(model, *child)).flat_map(joints_of).collect();
                return Ok(Self { joints, last, palm: Some(at), fingers, idle: Vec::new() });
            };
            for joint in joints_of(next) {
                match model.jnt_type()[joint] {
                    MjtJoint::mjJNT_HINGE => {
                        joints.push(joint);
                        last = next;
                    }
                    // The only finger of a gripper with one moving jaw.
                    MjtJoint::mjJNT_SLIDE if joints.len() >= FEWEST_JOINTS => joints.push(joint),
                    MjtJoint::mjJNT_SLIDE => {
                        return Err(Problem::new(
                            format!(
                                "`{}` slides between the base and the arm: mobile and gantry robots are not supported",
                                name(joint)
                            ),
                            "fix the joint in the model, so that the arm's base stands still",
                        ));
                    }
                    _ => {
                        return Err(Problem::new(
                            format!("`{}` moves the base freely: mobile robots are not supported", name(joint)),
                            "fix the base to the world in the model",
                        ));
                    }
                }
            }
            at = next;
        }
    }
}

impl Tree {
    /// The gripper whose moving jaw is the end of the chain. Its joint is not one of the arm. A joint behind the arm that moves nothing
    /// but frames is not one of the arm either.
    fn take_jaw(&mut self, spec: &MjSpec, model: &MjModel) -> Result<Option<Jaw>, Vec<Problem>> {
        if self.palm.is_some() {
            return Ok(None);
        }
        let body_of = |joint: usize| model.jnt_bodyid()[joint] as usize;
        let is_empty = |joint: usize| {
            let carried = subtree(model, body_of(joint));
            let touches = |body: &usize| !sweep::shapes(model, *body).is_empty();
            model.body_subtreemass()[body_of(joint)] <= MOST_FRAME_KG && !carried.iter().any(touches)
        };
        while let Some(joint) = self.joints.pop_if(|joint| is_empty(*joint)) {
            self.idle.push(model.id_to_name(MjtObjBase::mjOBJ_JOINT, joint).unwrap_or_default().to_owned());
        }
        let Some((joint, arm)) = self.joints.split_last() else { return Ok(None) };
        let (joint, slides) = (*joint, model.jnt_type()[*joint] == MjtJoint::mjJNT_SLIDE);
        let jaw = if arm.len() >= FEWEST_JOINTS { Jaw::of_one(spec, model, arm, joint)? } else { None };
        let name = model.id_to_name(MjtObjBase::mjOBJ_JOINT, joint).unwrap_or("(without a name)");
        let is_named = JAW_NAMES.iter().any(|word| name.to_lowercase().contains(word));
        if jaw.is_some() {
            self.joints.pop();
            self.palm = Some(model.body_parentid()[body_of(joint)] as usize);
            self.fingers = vec![joint];
        } else if slides || is_named {
            return Err(vec![Problem::new(
                format!("`{name}` is the only finger that moves, and no fixed jaw was found that it closes on"),
                "give both jaws collision shapes that face each other at the tips, and the joint a range from open to closed; or fix the joint in the model",
            )]);
        }
        self.last = self.joints.last().map_or(0, |joint| body_of(*joint));
        if self.joints.len() < FEWEST_JOINTS {
            return Err(vec![not_one_arm(0, 1)]);
        }
        Ok(jaw)
    }
}

/// The reason why a model with these branches at its base is not one arm.
fn not_one_arm(arms: usize, branches: usize) -> Problem {
    match (arms, branches) {
        (2.., _) => Problem::new(
            format!("the model has {arms} arms: robots with several arms are not supported"),
            "write a model with one of the arms, and fix or remove the others",
        ),
        (_, 0 | 1) => Problem::new(
            format!("the model has fewer than {FEWEST_JOINTS} hinges in a row: it is not an arm"),
            "check that the joints are hinges (URDF: type=\"revolute\") and not fixed",
        ),
        _ => Problem::new(
            format!("the base has {branches} moving parts, such as wheels or legs: mobile robots are not supported"),
            "fix or remove everything that moves except the arm and its gripper",
        ),
    }
}

/// A body and all bodies that it carries.
fn subtree(model: &MjModel, root: usize) -> Vec<usize> {
    let mut found = vec![root];
    for body in root + 1..model.body_parentid().len() {
        if found.contains(&(model.body_parentid()[body] as usize)) {
            found.push(body);
        }
    }
    found
}

/// The arm's figures. `None` where the model has none.
struct ArmDraft {
    names: Vec<String>,
    ranges: Vec<[f64; 2]>,
    home: Option<Vec<f64>>,
    velocity: Vec<Option<f64>>,
    torque: Vec<Option<f64>>,
    gains: Vec<Option<[f64; 2]>>,
    /// Torque that moves each joint alone, in N m.
    drags: Vec<f64>,
    /// Which joints have a gain in the model that is too soft, and is not used.
    soft: Vec<bool>,
}

impl ArmDraft {
    /// Leaves out the gains of joints that are too soft.
    fn drop_soft_gains(&mut self, chain: &Chain, home: &[f64]) {
        self.soft = servo::soft(chain, home, &self.gains, &self.drags);
        for (gains, soft) in self.gains.iter_mut().zip(&self.soft) {
            *gains = gains.filter(|_| !soft);
        }
    }

    fn of(model: &MjModel, raw: &MjModel, tree: &Tree, text: &str) -> Self {
        let name = |joint: &usize| model.id_to_name(MjtObjBase::mjOBJ_JOINT, *joint).unwrap_or_default().to_owned();
        let names: Vec<String> = tree.joints.iter().map(name).collect();
        let drive = |joint: &usize| {
            (0..model.actuator_trnid().len()).find(|actuator| {
                model.actuator_trntype()[*actuator] == MjtTrn::mjTRN_JOINT
                    && model.actuator_trnid()[*actuator][0] == *joint as i32
            })
        };
        // A motor: force = gain * ctrl.
        let motor = |joint: &usize| {
            let actuator = drive(joint).filter(|actuator| {
                model.actuator_biastype()[*actuator] == MjtBias::mjBIAS_NONE
                    && model.actuator_gaintype()[*actuator] == MjtGain::mjGAIN_FIXED
                    && model.actuator_ctrllimited()[*actuator]
            })?;
            let gain = model.actuator_gear()[actuator][0] * model.actuator_gainprm()[actuator][0];
            Some((gain * model.actuator_ctrlrange()[actuator][1]).abs())
        };
        let torque = |joint: &usize| {
            let limited = model.jnt_actfrclimited()[*joint].then(|| model.jnt_actfrcrange()[*joint][1]);
            let driven = drive(joint).filter(|actuator| model.actuator_forcelimited()[*actuator]);
            limited
                .or_else(|| driven.map(|actuator| model.actuator_forcerange()[actuator][1]))
                .or_else(|| motor(joint))
                .filter(|limit| *limit > 0.0)
        };
        // A position servo: force = kp (ctrl - q) - kv dq.
        let gains = |joint: &usize| {
            let actuator = drive(joint)?;
            let (gain, bias) = (model.actuator_gainprm()[actuator][0], model.actuator_biasprm()[actuator]);
            let damping = -bias[2] + model.dof_damping()[model.jnt_dofadr()[*joint] as usize];
            (gain > 0.0 && (gain + bias[1]).abs() < 1e-9 * gain && damping > 0.0).then_some([gain, damping])
        };
        Self {
            ranges: tree
                .joints
                .iter()
                .map(|joint| {
                    if model.jnt_limited()[*joint] {
                        model.jnt_range()[*joint]
                    } else {
                        [-CONTINUOUS_RAD, CONTINUOUS_RAD]
                    }
                })
                .collect(),
            home: home(raw, &names),
            velocity: names.iter().map(|name| urdf::velocity(text, name)).collect(),
            torque: tree.joints.iter().map(torque).collect(),
            gains: tree.joints.iter().map(gains).collect(),
            drags: tree.joints.iter().map(|joint| servo::drag(model, *joint, ACCELERATION)).collect(),
            soft: vec![false; tree.joints.len()],
            names,
        }
    }

    fn middle(&self) -> Vec<f64> {
        self.ranges
            .iter()
            .map(|[low, high]| 0.0_f64.clamp(low + HOME_MARGIN, (high - HOME_MARGIN).max(low + HOME_MARGIN)))
            .collect()
    }
}

/// The posture of the keyframe `home`, or of the only keyframe.
fn home(model: &MjModel, joints: &[String]) -> Option<Vec<f64>> {
    let nq = model.qpos0().len();
    let keys = model.key_qpos().len() / nq.max(1);
    let key = model.name_to_id(MjtObjBase::mjOBJ_KEY, "home").or_else(|| (keys == 1).then_some(0))?;
    let position =
        |name: &String| model.key_qpos().get(key * nq + model.jnt_qposadr()[joint_id(model, name)?] as usize).copied();
    joints.iter().map(position).collect()
}

/// The frames and the gripper.
struct Tool {
    /// Sites to add: name, body, position in metres, and roll, pitch and yaw.
    sites: Vec<(String, String, [f64; 3], [f64; 3])>,
    flange: String,
    tcp: String,
    /// `[gripper]` as TOML.
    gripper: toml::Table,
    guesses: Vec<String>,
}

impl Tool {
    fn of(spec: &MjSpec, model: &MjModel, tree: &Tree, one_jaw: Option<Jaw>) -> Result<Self, Vec<Problem>> {
        let body_name = |body: usize| model.id_to_name(MjtObjBase::mjOBJ_BODY, body).unwrap_or_default().to_owned();
        let palm = tree.palm.unwrap_or_else(|| end_of(model, tree.last));
        let mut tool = Self {
            sites: Vec::new(),
            flange: String::new(),
            tcp: String::new(),
            gripper: toml::Table::new(),
            guesses: Vec::new(),
        };
        let bodies: Vec<usize> = subtree(model, tree.last);
        let sites = |words: &[&str]| -> Vec<usize> {
            let named = |site: &usize| {
                let name = model.id_to_name(MjtObjBase::mjOBJ_SITE, *site).unwrap_or_default().to_lowercase();
                bodies.contains(&(model.site_bodyid()[*site] as usize)) && words.iter().any(|word| name.contains(word))
            };
            (0..model.site_bodyid().len()).filter(named).collect()
        };
        let site_name = |site: usize| model.id_to_name(MjtObjBase::mjOBJ_SITE, site).unwrap_or_default().to_owned();
        match sites(&["flange", "attachment", "tool0"]).first() {
            Some(found) => tool.flange = site_name(*found),
            None => {
                let carrier = named_body(model, &bodies, &["flange", "tool0"]).unwrap_or(tree.last);
                tool.sites.push(("flange".to_owned(), body_name(carrier), [0.0; 3], [0.0; 3]));
                tool.flange = "flange".to_owned();
                tool.guesses.push(format!("the flange is at the frame of the body `{}`", body_name(carrier)));
            }
        }
        let jaw = match (one_jaw, tree.palm) {
            (None, Some(palm)) => Some(Jaw::of(spec, model, &tree.joints, palm, &tree.fingers)?),
            (one_jaw, _) => one_jaw,
        };
        for joint in &tree.idle {
            tool.guesses.push(format!("`{joint}` moves nothing but frames, so it is not a joint of the arm"));
        }
        let mut tcp = jaw.as_ref().map_or_else(Isometry3::identity, |jaw| jaw.tcp);
        // A site of the model is used where it is between the pads, z out of the tool and the fingers along y.
        let fits = |site: &usize| {
            let Some(jaw) = &jaw else { return true };
            in_body(model, *site, palm).is_some_and(|pose| jaw.accepts(&pose))
        };
        let words: &[&[&str]] = &[&["tcp", "grip", "pinch", "tool_center"], &["tool", "ee"]];
        let known = words.iter().flat_map(|words| sites(words)).find(fits);
        if let Some(pose) = known.and_then(|site| in_body(model, site, palm)) {
            tcp = pose;
        }
        match (known, &jaw) {
            (Some(found), _) => tool.tcp = site_name(found),
            (None, Some(jaw)) => {
                let at = jaw.tcp;
                let (roll, pitch, yaw) = at.rotation.euler_angles();
                let taken = (0..model.site_bodyid().len())
                    .any(|site| model.id_to_name(MjtObjBase::mjOBJ_SITE, site) == Some("tcp"));
                tool.tcp = if taken { "drafted_tcp" } else { "tcp" }.to_owned();
                tool.sites.push((tool.tcp.clone(), body_name(palm), at.translation.vector.into(), [roll, pitch, yaw]));
                let between = if jaw.fixed_jaw_m.is_some() { "open jaws" } else { "pads" };
                tool.guesses.push(format!(
                    "the tool centre point is {} mm behind the fingertips, in the middle between the {between}",
                    1e3 * TIP
                ));
            }
            (None, None) => {
                let named = named_body(model, &bodies, &["tcp", "tool", "ee_link", "end_effector"]);
                let flange = sites(&["flange", "attachment"]).first().and_then(|site| in_body(model, *site, palm));
                // Without a frame of the tool, the cup sits on the end of the arm, along the z axis of the flange.
                let (carrier, at, end) = match named {
                    Some(body) => (body, Isometry3::identity(), 0.0),
                    None => {
                        let flange = flange.unwrap_or_else(|| outwards(model, palm, tree.joints.last().copied()));
                        (palm, flange, farthest_along_z(model, palm, &flange))
                    }
                };
                let at = at * Translation3::new(0.0, 0.0, end);
                let (roll, pitch, yaw) = at.rotation.euler_angles();
                let position = at.translation.vector.into();
                tool.sites.push(("tcp".to_owned(), body_name(carrier), position, [roll, pitch, yaw]));
                tool.tcp = "tcp".to_owned();
                tool.guesses.push(match end > 0.0 {
                    true => format!(
                        "the tool centre point is {:.1} mm beyond the flange, at the end of the shapes of the body `{}`",
                        1e3 * end,
                        body_name(carrier)
                    ),
                    false => format!("the tool centre point is at the frame of the body `{}`", body_name(carrier)),
                });
            }
        }
        match &jaw {
            Some(jaw) => tool.add_jaw(jaw, jaw.tip_and_palm(&tcp)),
            None => tool.add_cup(&body_name(palm)),
        }
        Ok(tool)
    }

    fn add_jaw(&mut self, jaw: &Jaw, [tip_m, palm_m]: [f64; 2]) {
        let strings = |names: &[String; 2]| toml::Value::from(names.to_vec());
        let force = jaw.force_n.unwrap_or(30.0);
        for (key, value) in [
            ("kind", toml::Value::from("parallel_jaw")),
            ("finger_bodies", strings(&jaw.bodies)),
            ("opening_m", rounded(jaw.opening_m)),
            ("finger_speed_m_s", jaw.speed_m_s().into()),
            ("force_n", rounded(force.min(30.0))),
            ("force_limit_n", rounded(force.max(30.0))),
            ("stiffness_n_m", jaw.stiffness_n_m.into()),
            ("damping_ns_m", jaw.damping_ns_m.into()),
            ("tip_m", rounded(tip_m)),
            ("palm_m", rounded(palm_m)),
        ] {
            self.gripper.insert(key.to_owned(), value);
        }
        if let Some(fixed) = jaw.fixed_jaw_m {
            self.gripper.insert("fixed_jaw_m".to_owned(), rounded(fixed));
            self.guesses.push(format!("the jaw on `{}` does not move", jaw.bodies[0]));
        }
        self.guesses.push("speed, force, stiffness and damping of the fingers".to_owned());
        self.guesses.push(format!(
            "the pads are on `{}` and `{}`; opening_m, tip_m and palm_m are measured from their collision shapes",
            jaw.bodies[0], jaw.bodies[1]
        ));
        match &jaw.slides {
            Some(joints) => {
                self.gripper.insert("finger_joints".to_owned(), strings(joints));
            }
            None => {
                let drives: Vec<toml::Value> =
                    jaw.drives.iter().filter_map(|d| toml::Value::try_from(d).ok()).collect();
                self.guesses.push(match &jaw.drives[..] {
                    [drive] => format!("{} drives the fingers between the ends of its range", drive.moves),
                    drives => {
                        let names: Vec<&str> = drives.iter().map(|drive| drive.moves.as_str()).collect();
                        format!("{} drive the fingers between the ends of their ranges", names.join(" and "))
                    }
                });
                self.gripper.insert("drive".to_owned(), drives.into());
            }
        }
    }

    fn add_cup(&mut self, body: &str) {
        for (key, value) in [
            ("kind", toml::Value::from("suction")),
            ("cup_body", body.into()),
            ("cup_diameter_m", 0.04.into()),
            ("vacuum_pa", 60_000.0.into()),
        ] {
            self.gripper.insert(key.to_owned(), value);
        }
        self.guesses.push(format!(
            "the model has no fingers, so the gripper is a suction cup of 40 mm at 60 kPa on the body `{body}`, with its lip at the tool centre point"
        ));
    }
}

/// A number with six decimals.
fn rounded(x: f64) -> toml::Value {
    ((x * 1e6).round() / 1e6).into()
}

/// The pose of a site in the frame of a body that it is fixed to. `None` if it moves relative to that body.
fn in_body(model: &MjModel, site: usize, body: usize) -> Option<Isometry3<f64>> {
    let carrier = model.site_bodyid()[site] as usize;
    if model.body_weldid()[carrier] != model.body_weldid()[body] {
        return None;
    }
    let mut data = MjData::new(Box::new(model.clone()));
    data.forward();
    let carrier = isometry(&data.xpos()[carrier], &data.xquat()[carrier]);
    let at = carrier * isometry(&model.site_pos()[site], &model.site_quat()[site]);
    Some(isometry(&data.xpos()[body], &data.xquat()[body]).inverse() * at)
}

/// How far the collision shapes that are fixed to a body reach along the z axis of a frame in it, in metres. 0 if they do not.
fn farthest_along_z(model: &MjModel, body: usize, frame: &Isometry3<f64>) -> f64 {
    let mut data = MjData::new(Box::new(model.clone()));
    data.forward();
    let frame = isometry(&data.xpos()[body], &data.xquat()[body]) * frame;
    let corners = sweep::corners(&data, &sweep::shapes(model, body));
    corners.iter().map(|corner| frame.inverse_transform_point(corner).z).fold(0.0, f64::max)
}

/// The frame of a body, turned so that z points out of the tool: along its z axis, or along the axis of the last joint if the shapes
/// reach farther that way.
fn outwards(model: &MjModel, body: usize, joint: Option<usize>) -> Isometry3<f64> {
    let Some(joint) = joint.filter(|joint| model.jnt_bodyid()[*joint] as usize == body) else {
        return Isometry3::identity();
    };
    let axis = Vector3::from(model.jnt_axis()[joint]).normalize();
    let turned = |z: Vector3<f64>| {
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &z);
        let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        Isometry3::from_parts(Translation3::identity(), turn.unwrap_or(flip))
    };
    let frames = [Isometry3::identity(), turned(axis), turned(-axis)];
    let reach = frames.map(|frame| farthest_along_z(model, body, &frame));
    // Equal reach leaves the frame of the body.
    let farthest = (1..3).fold(0, |best, i| if reach[i] > OUTWARDS * reach[best] { i } else { best });
    frames[farthest]
}

/// The last body that is fixed to `body`.
fn end_of(model: &MjModel, body: usize) -> usize {
    let fixed = |other: &usize| model.body_weldid()[*other] == model.body_weldid()[body];
    subtree(model, body).into_iter().rfind(fixed).unwrap_or(body)
}

fn named_body(model: &MjModel, bodies: &[usize], words: &[&str]) -> Option<usize> {
    let named = |body: &&usize| {
        let name = model.id_to_name(MjtObjBase::mjOBJ_BODY, **body).unwrap_or_default().to_lowercase();
        words.iter().any(|word| name.contains(word))
    };
    bodies.iter().rev().find(named).copied()
}

/// The settings for the search of a home posture.
fn settings(
    name: &str,
    file: &str,
    arm: &ArmDraft,
    tool: &Tool,
    home: Vec<f64>,
) -> Result<RobotSettings, Vec<Problem>> {
    let text = document(name, file, arm, tool, &home, (1.0, 0.0));
    RobotSettings::from_toml(&text, Path::new("robot.toml")).map_err(crate::RobotError::into_problems)
}

/// `robot.toml` without comments.
fn document(
    name: &str,
    file: &str,
    arm: &ArmDraft,
    tool: &Tool,
    home: &[f64],
    (reach, base_yaw): (f64, f64),
) -> String {
    let list = |values: Vec<f64>| toml::Value::Array(values.into_iter().map(rounded).collect());
    let torque: Vec<f64> = arm.torque.iter().map(|torque| torque.unwrap_or(TORQUE)).collect();
    let gains: Vec<[f64; 2]> = arm
        .gains
        .iter()
        .zip(&torque)
        .map(|(gains, torque)| gains.unwrap_or([STIFFNESS * torque, STIFFNESS * torque * DAMPING_S]))
        .collect();
    let mut table = toml::Table::new();
    table.insert("joints".to_owned(), arm.names.clone().into());
    for (key, values) in [
        ("home_rad", home.to_vec()),
        ("velocity_limit_rad_s", arm.velocity.iter().map(|speed| speed.unwrap_or(SPEED)).collect()),
        ("acceleration_limit_rad_s2", vec![ACCELERATION; arm.names.len()]),
        ("torque_limit_nm", torque.clone()),
        ("stiffness_nm_rad", gains.iter().map(|[stiffness, _]| *stiffness).collect()),
        ("damping_nms_rad", gains.iter().map(|[_, damping]| *damping).collect()),
    ] {
        table.insert(key.to_owned(), list(values));
    }
    table.insert("flange_site".to_owned(), tool.flange.clone().into());
    table.insert("tcp_site".to_owned(), tool.tcp.clone().into());
    table.insert("reach_m".to_owned(), ((reach * 1e3).floor() / 1e3).max(0.01).into());
    if base_yaw != 0.0 {
        table.insert("base_yaw_rad".to_owned(), rounded(base_yaw));
    }
    table.insert("payload_kg".to_owned(), payload_kg(&torque, reach).into());
    let mut text = format!("name = {}\nmodel = {}\n", toml::Value::from(name), toml::Value::from(file));
    // Writing to a string cannot fail.
    let mut gripper = toml::Table::new();
    gripper.insert("gripper".to_owned(), tool.gripper.clone().into());
    let _ = write!(text, "\n[arm]\n{table}\n{gripper}");
    for (name, body, position, rpy) in &tool.sites {
        let _ = write!(
            text,
            "\n[[site]]\nname = {}\nbody = {}\nposition_m = {}\nrpy_rad = {}\n",
            toml::Value::from(name.as_str()),
            toml::Value::from(body.as_str()),
            list(position.to_vec()),
            list(rpy.to_vec())
        );
    }
    text
}

/// The payload of an arm without a stated one, in kilograms: with it the weakest joint of the shoulder has half of its torque left.
fn payload_kg(torque: &[f64], reach: f64) -> f64 {
    let shoulder = torque.iter().take(SHOULDER).copied().fold(f64::INFINITY, f64::min);
    let half = 0.5 * shoulder / (crate::GRAVITY * reach);
    ((half * 20.0).floor() / 20.0).clamp(0.05, 1.0)
}

/// The kinematics of the robot with these settings.
fn kinematics(settings: &RobotSettings, folder: &Path) -> Option<Chain> {
    let robot = Robot { settings: settings.clone(), source: RobotSource::Folder(folder.to_owned()) };
    robot_model::build(&robot, MujocoEngine::TIME_STEP_S).ok().map(|built| built.chain)
}

/// Writes the file with comments.
struct Writer {
    out: String,
    guesses: Vec<String>,
}

impl Writer {
    fn write(
        &mut self,
        name: &str,
        file: &str,
        arm: &ArmDraft,
        tool: &Tool,
        settings: &RobotSettings,
        (home_is_known, home_is_found): (bool, bool),
    ) {
        let reach: f64 = settings.arm.reach_m;
        let joints = |missing: &dyn Fn(usize) -> bool| {
            let names: Vec<&str> =
                arm.names.iter().enumerate().filter(|(i, _)| missing(*i)).map(|(_, name)| name.as_str()).collect();
            names.join(", ")
        };
        let mut guess = |text: String| self.guesses.push(text);
        if !home_is_known {
            guess(match home_is_found {
                true => "home_rad: a posture with the tool pointing down over the workspace".to_owned(),
                false => {
                    "home_rad: zero; no posture with the tool pointing down over the workspace was found".to_owned()
                }
            });
        }
        for (missing, what) in [
            (joints(&|i| arm.velocity[i].is_none()), format!("velocity_limit_rad_s = {SPEED}")),
            (joints(&|i| arm.torque[i].is_none()), format!("torque_limit_nm = {TORQUE}")),
            (
                joints(&|i| arm.gains[i].is_none()),
                format!(
                    "stiffness_nm_rad = {STIFFNESS} times the torque limit, damping_nms_rad = {DAMPING_S} times that"
                ),
            ),
        ] {
            if !missing.is_empty() {
                guess(format!("{what} for {missing}"));
            }
        }
        let soft = joints(&|i| arm.soft[i]);
        if !soft.is_empty() {
            guess(format!(
                "the model's gains of {soft} are not used: with them the tool lags or gives way by more than {:.0} mm",
                1e3 * servo::GIVES_M
            ));
        }
        if settings.arm.base_yaw_rad != 0.0 {
            guess("base_yaw_rad: the model does not face the table".to_owned());
        }
        guess(format!("acceleration_limit_rad_s2 = {ACCELERATION}: no model states it"));
        guess("payload_kg and reach_m: replace them by the manufacturer's figures".to_owned());
        self.guesses.extend(tool.guesses.iter().cloned());
        let lines: Vec<String> = self.guesses.iter().map(|guess| format!("# - {guess}\n")).collect();
        self.out = format!(
            "# Drafted from {file}. Guessed, because the model does not state it:\n{}# Correct these, and check the robot with `robogate robots check FOLDER`.\n\n{}",
            lines.concat(),
            document(name, file, arm, tool, &settings.arm.home_rad, (reach, settings.arm.base_yaw_rad))
        );
    }
}
