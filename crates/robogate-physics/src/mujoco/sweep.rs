//! Measures how drives move the fingers of a robot: the drives go from open to closed in the model without a scene.
//!
//! Equalities, tendons and springs of the model act as in an episode. The arm stands still. Rotary linkages, tendons and
//! slides are therefore the same case.

use mujoco_rs::mujoco_c::mjtLimited;
use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Point3};

use super::{PREFIX, probe, rigid};
use crate::finger_motion::{FingerMotion, FingerState};
use crate::{FingerDrive, ParallelJaw, Problem, RobotSettings, contact};

/// Number of states from open to closed.
const STATES: usize = 33;
/// Natural frequency of the drives during the measurement, in rad/s.
const FREQUENCY: f64 = 60.0;
/// Gain of the integral of the error, in 1/s, as a multiple of the stiffness: it overcomes springs and friction.
const INTEGRAL: f64 = 20.0;
/// A drive has arrived within this fraction of its travel, if it moves by less than that fraction in a second. The state
/// that is measured is the one it has reached.
const ARRIVED: f64 = 5e-3;
/// Time steps at the open end before the first measurement.
const SETTLE_STEPS: usize = 100;
/// Most time steps to one state.
const MOST_STEPS: usize = 1_500;
/// Inertia of the gripper's motors during the measurement, in kg m^2 or kg.
const ARMATURE: f64 = 1e-3;
/// Inertia of the arm's motors during the measurement, in kg m^2: the arm's servos, which pull towards zero, and the reaction
/// of the fingers do not accelerate it, so fingers with springs rest as on an arm that stands still. MuJoCo's solver stops at an
/// error of force that grows with this inertia: 1e6 kg m^2 moves light fingers by millimetres.
const STANDING: f64 = 1e4;
/// Number of time steps in which the inertia that a drive moves is measured: longer than equalities take to act.
const PROBE_STEPS: usize = 20;
/// In these steps a drive moves by at most this fraction of its travel.
const PROBE_TRAVEL: f64 = 0.02;
/// The inertia that a drive moves is at most this multiple of what it moves without equalities.
const MOST_COUPLED: f64 = 1e3;
/// Pads open like a V if their distance at the tool centre point changes by more than this multiple of their smallest distance.
const V_SHAPED: f64 = 1.25;
/// The face of a fixed jaw may differ from robot.toml by this much, in metres.
const FACE_M: f64 = 2e-3;
/// A joint is moved by this much to measure its share in the opening, in radians or metres.
const PARTIAL: f64 = 5e-4;
/// A follower with less than this share in the opening gets no drive.
const CARRIES: f64 = 0.02;
/// The shares must have a sum in this range.
const EXPLAINED: std::ops::RangeInclusive<f64> = 0.7..=1.4;
/// Distances between pads are measured up to this one, in metres.
const FARTHEST_M: f64 = 0.5;

/// Removes dry friction from everything except the arm's joints. `robot.toml` states the force at the pads, so what the
/// mechanism loses is already subtracted.
pub(crate) fn remove_friction(spec: &mut MjSpec, arm: &[&str]) {
    for joint in spec.joint_iter_mut().filter(|joint| !arm.contains(&joint.name())) {
        joint.set_frictionloss(0.0);
    }
    for tendon in spec.tendon_iter_mut() {
        tendon.set_frictionloss(0.0);
    }
}

/// Changes a robot's model so that its fingers can be measured quickly. States at rest depend neither on dry friction nor on
/// the inertia of motors, and equalities hold best if everything that they couple has a similar inertia.
pub(crate) fn measurable(spec: &mut MjSpec, arm: &[&str]) {
    remove_friction(spec, arm);
    // Neither do they depend on the damping of the drives, which would count as inertia when that is measured.
    let driven: Vec<String> =
        spec.actuator_iter().filter_map(|actuator| actuator.name().strip_prefix(PREFIX).map(str::to_owned)).collect();
    for joint in spec.joint_iter_mut() {
        if driven.iter().any(|name| name == joint.name()) {
            joint.damping_mut().fill(0.0);
        }
        let inertia = if arm.contains(&joint.name()) { STANDING } else { ARMATURE };
        joint.set_armature(inertia);
    }
}

/// Where a drive acts.
#[derive(Debug, Clone, Copy)]
pub(super) enum DriveAt {
    /// A joint, by its addresses in qpos and qvel.
    Joint { qpos: usize, qvel: usize },
    /// A tendon, by its index.
    Tendon(usize),
}

impl DriveAt {
    /// Where the drive of this name acts in a compiled model.
    pub(super) fn find(model: &MjModel, moves: &str) -> Option<Self> {
        match model.name_to_id(MjtObjBase::mjOBJ_JOINT, moves) {
            Some(joint) => Some(Self::Joint {
                qpos: model.jnt_qposadr()[joint] as usize,
                qvel: model.jnt_dofadr()[joint] as usize,
            }),
            None => model.name_to_id(MjtObjBase::mjOBJ_TENDON, moves).map(Self::Tendon),
        }
    }

    /// Position and speed of joint or tendon.
    pub(super) fn state(self, data: &MjData<Box<MjModel>>) -> [f64; 2] {
        match self {
            Self::Joint { qpos, qvel } => [data.qpos()[qpos], data.qvel()[qvel]],
            Self::Tendon(id) => [data.ten_length()[id], data.ten_velocity()[id]],
        }
    }

    /// The inertia that the drive moves at joint positions 0, in kg m^2 or kg.
    pub(super) fn inertia(self, model: &MjModel) -> f64 {
        let inverse = match self {
            Self::Joint { qvel, .. } => model.dof_invweight0()[qvel],
            Self::Tendon(id) => model.tendon_invweight0()[id],
        };
        1.0 / inverse.max(1e-9)
    }

    /// Damping of the joint or tendon itself, in N m s/rad or N s/m.
    pub(super) fn passive_damping(self, model: &MjModel) -> f64 {
        match self {
            Self::Joint { qvel, .. } => model.dof_damping()[qvel],
            Self::Tendon(id) => model.tendon_damping()[id],
        }
    }
}

/// Adds a motor for a drive to the robot's model. Its control is a force or torque; [`limit`] adds damping and limits.
pub(crate) fn add_motor(spec: &mut MjSpec, moves: &str) -> bool {
    let on_joint = spec.joint(moves).is_some();
    if let Some(joint) = spec.joint_mut(moves) {
        joint.set_actfrclimited(mjtLimited::mjLIMITED_FALSE);
    }
    let actuator = spec.add_actuator();
    if actuator.set_name(&format!("{PREFIX}{moves}")).is_err() {
        // SAFETY: the handle was created above, is used for the last time, and no other handle is held.
        #[expect(unsafe_code, reason = "the binding has no safe deletion")]
        let _ = unsafe { actuator.delete() };
        return false;
    }
    actuator.set_trntype(if on_joint { MjtTrn::mjTRN_JOINT } else { MjtTrn::mjTRN_TENDON });
    actuator.set_target(moves);
    actuator.set_gaintype(MjtGain::mjGAIN_FIXED);
    actuator.set_biastype(MjtBias::mjBIAS_AFFINE);
    actuator.gainprm_mut()[0] = 1.0;
    actuator.set_ctrllimited(mjtLimited::mjLIMITED_FALSE);
    actuator.set_forcelimited(mjtLimited::mjLIMITED_FALSE);
    actuator.set_group(0);
    true
}

/// Gives the motors of the drives their damping and their limits of force and travel.
///
/// A pad force F on each pad does the work F dx over a change dx of the opening. With the slope s = d(opening)/d(position)
/// and a drive that has the share w of it, the drive's force is F s w, and the damping D of a finger, which moves by half of the
/// opening, is D s^2 w / 2 at the drive.
pub(crate) fn limit(spec: &mut MjSpec, jaw: &ParallelJaw, motion: &FingerMotion) {
    for (i, moves) in motion.driven(jaw).enumerate() {
        let (slope, share) = (motion.steepest(i), motion.largest_share(i));
        let force = jaw.force_limit_n * slope * share;
        if let Some(actuator) = spec.actuator_mut(&format!("{PREFIX}{moves}")) {
            actuator.biasprm_mut()[2] = -0.5 * jaw.damping_ns_m * slope * slope * share;
            // A follower's drive stands for the equality too, which has no limit.
            if motion.followers.is_empty() {
                actuator.set_forcelimited(mjtLimited::mjLIMITED_TRUE);
                *actuator.forcerange_mut() = [-force, force];
            }
        }
        // The pads of an empty gripper pass through each other: an end stop is where they meet.
        let ends = [motion.states[0].drives[i], motion.open().drives[i]];
        let range = [ends[0].min(ends[1]), ends[0].max(ends[1])];
        let stop = [contact::TIME_CONSTANT_S, 1.0];
        if let Some(joint) = spec.joint_mut(moves) {
            *joint.range_mut() = range;
            joint.set_limited(mjtLimited::mjLIMITED_TRUE);
            joint.solref_limit_mut()[..2].copy_from_slice(&stop);
            joint.solimp_limit_mut()[..3].copy_from_slice(&contact::LIMIT_IMPEDANCE);
        } else if let Some(tendon) = spec.tendon_mut(moves) {
            *tendon.range_mut() = range;
            tendon.set_limited(mjtLimited::mjLIMITED_TRUE);
            tendon.solref_limit_mut()[..2].copy_from_slice(&stop);
            tendon.solimp_limit_mut()[..3].copy_from_slice(&contact::LIMIT_IMPEDANCE);
        }
    }
}

/// A gripper whose drives move through the model.
pub(crate) struct Sweep {
    pub(crate) data: MjData<Box<MjModel>>,
    names: Vec<String>,
    drives: Vec<DriveAt>,
    /// Positions of the drives when open and closed.
    ends: Vec<[f64; 2]>,
    inertia: Vec<f64>,
    integral: Vec<f64>,
    /// Addresses and positions of the arm's joints.
    arm: Vec<(usize, usize, f64)>,
}

impl Sweep {
    /// The drives at their open end. `model` is the robot alone, [`measurable`], with a motor for each drive after all other
    /// actuators; `arm` are its arm's joints with their positions.
    pub(crate) fn new(model: MjModel, arm: &[(&str, f64)], drives: &[FingerDrive]) -> Result<Self, Problem> {
        let at: Vec<DriveAt> = drives.iter().filter_map(|drive| DriveAt::find(&model, &drive.moves)).collect();
        let arm = arm.iter().filter_map(|(name, q)| match DriveAt::find(&model, name) {
            Some(DriveAt::Joint { qpos, qvel }) => Some((qpos, qvel, *q)),
            _ => None,
        });
        let mut sweep = Self {
            names: drives.iter().map(|drive| drive.moves.clone()).collect(),
            ends: drives.iter().map(|drive| [drive.open, drive.closed]).collect(),
            inertia: at.iter().map(|drive| drive.inertia(&model)).collect(),
            integral: vec![0.0; at.len()],
            drives: at,
            arm: arm.collect(),
            data: MjData::new(Box::new(model)),
        };
        for (drive, [open, _]) in sweep.drives.iter().zip(&sweep.ends) {
            if let DriveAt::Joint { qpos, .. } = drive {
                sweep.data.qpos_mut()[*qpos] = *open;
            }
        }
        for (qpos, _, q) in &sweep.arm {
            sweep.data.qpos_mut()[*qpos] = *q;
        }
        sweep.place_followers();
        sweep.data.forward();
        sweep.inertia = (0..sweep.drives.len()).map(|i| sweep.coupled_inertia(i)).collect();
        // Linkages that are closed by other equalities come to rest.
        for _ in 0..SETTLE_STEPS {
            sweep.drive_to(0.0);
            sweep.step();
        }
        sweep.go(0.0)?;
        Ok(sweep)
    }

    /// Moves joints that are coupled to a drive by an equality to where it puts them. `open` need not be 0, and a drive may be the joint
    /// that follows.
    fn place_followers(&mut self) {
        let model = self.data.model();
        let driven = |qpos: usize| {
            let at = |drive: &DriveAt| matches!(drive, DriveAt::Joint { qpos: other, .. } if *other == qpos);
            self.drives.iter().any(at) || self.arm.iter().any(|(other, ..)| *other == qpos)
        };
        let placed: Vec<(usize, f64)> = (0..model.eq_type().len())
            .filter(|equality| model.eq_type()[*equality] == MjtEq::mjEQ_JOINT && model.eq_active0()[*equality])
            .filter_map(|equality| {
                let at = |joint: i32| usize::try_from(joint).ok().map(|joint| model.jnt_qposadr()[joint] as usize);
                let follower = at(model.eq_obj1id()[equality])?;
                let leader = at(model.eq_obj2id()[equality])?;
                let moved = |qpos: usize| self.data.qpos()[qpos] - model.qpos0()[qpos];
                let coefficients = &model.eq_data()[equality][..5];
                let [constant, factor, others @ ..] = coefficients else { return None };
                if !driven(follower) {
                    let value =
                        coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * moved(leader) + coefficient);
                    return Some((follower, model.qpos0()[follower] + value));
                }
                let linear = factor.abs() > 1e-9 && others.iter().all(|coefficient| *coefficient == 0.0);
                (linear && !driven(leader))
                    .then(|| (leader, model.qpos0()[leader] + (moved(follower) - constant) / factor))
            })
            .collect();
        for (qpos, position) in placed {
            self.data.qpos_mut()[qpos] = position;
        }
    }

    /// The inertia that a drive moves with all that equalities couple to it, from the speed that a force gives to it.
    fn coupled_inertia(&mut self, i: usize) -> f64 {
        let start = self.data.qpos().to_vec();
        let alone = self.inertia[i];
        let [open, closed] = self.ends[i];
        let control = self.data.ctrl().len() - self.drives.len() + i;
        let time = PROBE_STEPS as f64 * self.data.model_opt().timestep;
        let force = 2.0 * alone * PROBE_TRAVEL * (closed - open) / (time * time);
        // Springs act in both cases.
        let speeds = [0.0, force].map(|force| {
            self.data.ctrl_mut()[control] = force;
            for _ in 0..PROBE_STEPS {
                self.step();
            }
            self.data.forward();
            let [_, speed] = self.drives[i].state(&self.data);
            self.data.qpos_mut().copy_from_slice(&start);
            self.data.qvel_mut().fill(0.0);
            self.data.ctrl_mut()[control] = 0.0;
            self.data.forward();
            speed
        });
        let coupled = force * time / (speeds[1] - speeds[0]);
        if coupled.is_finite() { coupled.clamp(alone, MOST_COUPLED * alone) } else { alone }
    }

    /// One time step, in which the arm stands still.
    fn step(&mut self) {
        self.data.step();
        for (qpos, qvel, q) in &self.arm {
            self.data.qpos_mut()[*qpos] = *q;
            self.data.qvel_mut()[*qvel] = 0.0;
        }
    }

    /// Sets the controls of the drives for a share of their way from open (0) to closed (1). Returns a drive that is not there yet.
    fn drive_to(&mut self, share: f64) -> Option<usize> {
        let first = self.data.ctrl().len() - self.drives.len();
        let step = self.data.model_opt().timestep;
        let mut off = None;
        for (i, drive) in self.drives.iter().enumerate() {
            let [open, closed] = self.ends[i];
            let [position, speed] = drive.state(&self.data);
            let error = open + share * (closed - open) - position;
            let stiffness = self.inertia[i] * FREQUENCY * FREQUENCY;
            self.integral[i] += INTEGRAL * step * error;
            self.data.ctrl_mut()[first + i] =
                stiffness * (error + self.integral[i]) - 2.0 * self.inertia[i] * FREQUENCY * speed;
            let travel = (closed - open).abs();
            if error.abs() > ARRIVED * travel || speed.abs() > ARRIVED * travel {
                off = Some(i);
            }
        }
        off
    }

    /// Moves the drives to a share of their way from open (0) to closed (1).
    pub(crate) fn go(&mut self, share: f64) -> Result<(), Problem> {
        let mut off = 0;
        for _ in 0..MOST_STEPS {
            match self.drive_to(share) {
                None => return Ok(()),
                Some(drive) => off = drive,
            }
            self.step();
        }
        let ([open, closed], [position, _]) = (self.ends[off], self.drives[off].state(&self.data));
        Err(Problem::new(
            format!(
                "[[gripper.drive]] `{}` does not reach {:.4} on its way from open = {open} to closed = {closed}: it stops at {position:.4}",
                self.names[off],
                open + share * (closed - open),
            ),
            "check open and closed (radians or metres), the ranges of the gripper's joints, and the equalities and tendons that couple them",
        ))
    }

    /// Positions of the drives.
    fn positions(&self) -> Vec<f64> {
        self.drives.iter().map(|drive| drive.state(&self.data)[0]).collect()
    }

    /// The change of the distance between the pads by each drive and then each follower, which is a joint, while all others stand still.
    fn gradient(&mut self, followers: &[(String, usize)], tool: &Isometry3<f64>, pads: &[Vec<usize>; 2]) -> Vec<f64> {
        let start = self.data.qpos().to_vec();
        let joints = self.drives.iter().filter_map(|drive| match drive {
            DriveAt::Joint { qpos, .. } => Some(*qpos),
            DriveAt::Tendon(_) => None,
        });
        let joints: Vec<usize> = joints.chain(followers.iter().map(|(_, qpos)| *qpos)).collect();
        let at = |sweep: &mut Self, joint: usize, moved: f64| {
            sweep.data.qpos_mut()[joint] = start[joint] + moved;
            sweep.data.kinematics();
            let distance = at_tool(&mut sweep.data, tool, pads);
            let distance = distance.unwrap_or_else(|| gap(&mut sweep.data, [&pads[0], &pads[1]]));
            sweep.data.qpos_mut()[joint] = start[joint];
            distance
        };
        let gradient = joints.iter().map(|joint| {
            let [before, after] = [-PARTIAL, PARTIAL].map(|moved| at(self, *joint, moved));
            (after - before) / (2.0 * PARTIAL)
        });
        let gradient = gradient.collect();
        self.data.forward();
        gradient
    }

    /// Smallest distance between a shape of the first set and one of the second, in metres. Negative if they overlap.
    pub(crate) fn gap(&mut self, [first, second]: &[Vec<usize>; 2]) -> f64 {
        self.data.forward();
        gap(&mut self.data, [first, second])
    }

    /// The nearest points of the shapes of the first set and of the second.
    pub(crate) fn nearest(&mut self, [first, second]: &[Vec<usize>; 2]) -> [Point3<f64>; 2] {
        let (mut smallest, mut points) = (FARTHEST_M, [Point3::origin(); 2]);
        for a in first {
            for b in second {
                let mut line = [0.0; 6];
                let distance = self.data.geom_distance(*a, *b, FARTHEST_M, Some(&mut line));
                if distance < smallest {
                    smallest = distance;
                    points = [Point3::new(line[0], line[1], line[2]), Point3::new(line[3], line[4], line[5])];
                }
            }
        }
        points
    }

    /// Positions of all joints.
    pub(crate) fn joints(&self) -> Vec<f64> {
        self.data.qpos().to_vec()
    }

    /// The corners of the bounding boxes of these shapes, in metres.
    pub(crate) fn corners(&mut self, geoms: &[usize]) -> Vec<Point3<f64>> {
        self.data.forward();
        corners(&self.data, geoms)
    }
}

/// The corners of the bounding boxes of these shapes, in metres.
pub(crate) fn corners(data: &MjData<Box<MjModel>>, geoms: &[usize]) -> Vec<Point3<f64>> {
    let model = data.model();
    let of = |geom: &usize| {
        let [x, y, z, a, b, c] = model.geom_aabb()[*geom];
        let at = rigid(data.geom_xpos()[*geom], &data.geom_xmat()[*geom]);
        (0..8).map(move |bits: u8| {
            let side = |bit: u8| if bits >> bit & 1 == 1 { 1.0 } else { -1.0 };
            at * Point3::new(x + side(0) * a, y + side(1) * b, z + side(2) * c)
        })
    };
    geoms.iter().flat_map(of).collect()
}

/// Smallest distance between a shape of the first set and one of the second, in metres.
pub(crate) fn gap(data: &mut MjData<Box<MjModel>>, [first, second]: [&[usize]; 2]) -> f64 {
    let mut smallest = FARTHEST_M;
    for a in first {
        for b in second {
            smallest = smallest.min(data.geom_distance(*a, *b, smallest, None));
        }
    }
    smallest
}

/// The collision shapes of the bodies that are welded to `body`, or are `body`.
pub(crate) fn shapes(model: &MjModel, body: usize) -> Vec<usize> {
    let weld = |body: usize| model.body_weldid()[body];
    let touchable = |geom: &usize| model.geom_contype()[*geom] != 0 || model.geom_conaffinity()[*geom] != 0;
    let of = |geom: &usize| weld(model.geom_bodyid()[*geom] as usize) == weld(body);
    (0..model.geom_bodyid().len()).filter(of).filter(touchable).collect()
}

/// Measures the motion of the fingers of a robot. `model` is the robot alone, with its drives, and [`measurable`].
pub(crate) fn measure(
    model: MjModel,
    settings: &RobotSettings,
    jaw: &ParallelJaw,
) -> Result<FingerMotion, Vec<Problem>> {
    let arm: Vec<(&str, f64)> =
        settings.arm.joints.iter().map(String::as_str).zip(settings.arm.home_rad.iter().copied()).collect();
    let joints: Vec<(String, usize)> = (0..model.jnt_type().len())
        .map(|joint| (model.id_to_name(MjtObjBase::mjOBJ_JOINT, joint).unwrap_or_default().to_owned(), joint))
        .filter(|(name, _)| !settings.arm.joints.contains(name))
        .map(|(name, joint)| (name, model.jnt_qposadr()[joint] as usize))
        .collect();
    let find = |kind, name: &str| model.name_to_id(kind, name).unwrap_or_default();
    let pads = [0, 1].map(|i| shapes(&model, find(MjtObjBase::mjOBJ_BODY, &jaw.finger_bodies[i])));
    let tcp = find(MjtObjBase::mjOBJ_SITE, &settings.arm.tcp_site);
    let mut followers = if jaw.fixed_jaw_m.is_none() { followers(&model, settings, jaw) } else { Vec::new() };
    let mut sweep = Sweep::new(model, &arm, &jaw.drives).map_err(|problem| vec![problem])?;
    let mut gradients = Vec::with_capacity(STATES);
    let (mut states, mut tip_m) = (Vec::with_capacity(STATES), f64::NEG_INFINITY);
    for k in 0..STATES {
        sweep.go(k as f64 / (STATES - 1) as f64).map_err(|problem| vec![problem])?;
        sweep.data.forward();
        let tool: Isometry3<f64> = rigid(sweep.data.site_xpos()[tcp], &sweep.data.site_xmat()[tcp]);
        let opening_m = match jaw.fixed_jaw_m {
            Some(fixed) => one_jaw(&mut sweep.data, &tool, jaw, fixed, &pads).map_err(|problem| vec![problem])?,
            None => sweep.gap(&pads),
        };
        let ahead = |corner: &Point3<f64>| tool.inverse_transform_point(corner).z;
        tip_m = pads.iter().flat_map(|pad| sweep.corners(pad)).map(|corner| ahead(&corner)).fold(tip_m, f64::max);
        let joints = joints.iter().map(|(_, qpos)| sweep.data.qpos()[*qpos]).collect();
        let at_tool_m = if jaw.fixed_jaw_m.is_none() { at_tool(&mut sweep.data, &tool, &pads) } else { None };
        let mut drives = sweep.positions();
        drives.extend(followers.iter().map(|(_, qpos)| sweep.data.qpos()[*qpos]));
        if !followers.is_empty() {
            gradients.push(sweep.gradient(&followers, &tool, &pads));
        }
        let shares = vec![1.0 / jaw.drives.len() as f64; jaw.drives.len()];
        states.push(FingerState { opening_m, at_tool_m, drives, shares, joints });
        if opening_m <= 0.0 {
            break;
        }
    }
    states.reverse();
    gradients.reverse();
    let (closed, open) = (states[0].opening_m, states[states.len() - 1].opening_m);
    let grows = |pair: &[FingerState]| pair[1].opening_m > pair[0].opening_m;
    if states.len() < 2 || !states.windows(2).all(grows) {
        return Err(vec![Problem::new(
            format!(
                "the pads of `{}` and `{}` do not approach each other steadily from open ({:.1} mm apart) to closed ({:.1} mm apart)",
                jaw.finger_bodies[0],
                jaw.finger_bodies[1],
                1e3 * open,
                1e3 * closed
            ),
            "name the bodies that carry the pads in gripper.finger_bodies, and check open and closed of [[gripper.drive]]",
        )]);
    }
    meet(&mut states);
    let closed_at_tool_m = states[0].held_m();
    // Parallel pads are as far apart at the tool centre point as anywhere.
    let steeper = |pair: &[FingerState]| {
        let at_tool = pair[0].at_tool_m.zip(pair[1].at_tool_m).map(|(a, b)| b - a);
        at_tool.map(|moved| moved > V_SHAPED * (pair[1].opening_m - pair[0].opening_m))
    };
    let measured: Option<Vec<bool>> = states.windows(2).map(steeper).collect();
    if !measured.is_some_and(|steeper| steeper.contains(&true)) {
        states.iter_mut().for_each(|state| state.at_tool_m = None);
    }
    share(&mut states, &mut followers, &gradients, jaw.drives.len());
    let names = |joints: Vec<(String, usize)>| joints.into_iter().map(|(name, _)| name).collect();
    Ok(FingerMotion { joints: names(joints), followers: names(followers), states, closed_at_tool_m, tip_m })
}

/// The joints that equalities couple to the drives of a gripper, with their addresses in qpos.
fn followers(model: &MjModel, settings: &RobotSettings, jaw: &ParallelJaw) -> Vec<(String, usize)> {
    let joint = |name: &String| model.name_to_id(MjtObjBase::mjOBJ_JOINT, name);
    let known: Vec<usize> = jaw.drives.iter().filter_map(|drive| joint(&drive.moves)).collect();
    if known.len() < jaw.drives.len() {
        return Vec::new();
    }
    let arm: Vec<usize> = settings.arm.joints.iter().filter_map(joint).collect();
    let pairs: Vec<[i32; 2]> = (0..model.eq_type().len())
        .filter(|equality| model.eq_type()[*equality] == MjtEq::mjEQ_JOINT && model.eq_active0()[*equality])
        .map(|equality| [model.eq_obj1id()[equality], model.eq_obj2id()[equality]])
        .collect();
    let mut coupled = known.clone();
    // Each pass adds at least one joint, or is the last.
    loop {
        let other = |[a, b]: &[i32; 2]| {
            let is_in = |joint: i32| usize::try_from(joint).is_ok_and(|joint| coupled.contains(&joint));
            let new = if is_in(*a) && !is_in(*b) { *b } else { *a };
            usize::try_from(new).ok().filter(|_| is_in(*a) != is_in(*b)).filter(|joint| !arm.contains(joint))
        };
        match pairs.iter().find_map(other) {
            Some(joint) => coupled.push(joint),
            None => break,
        }
    }
    let named = |joint: &usize| model.id_to_name(MjtObjBase::mjOBJ_JOINT, *joint).filter(|name| !name.is_empty());
    coupled[known.len()..]
        .iter()
        .filter_map(|joint| Some((named(joint)?.to_owned(), model.jnt_qposadr()[*joint] as usize)))
        .collect()
}

/// Sets the shares of drives and followers, from the change of the opening by each of them alone in each state. Followers that carry
/// little, or do not move steadily with the opening, are removed.
fn share(states: &mut [FingerState], followers: &mut Vec<(String, usize)>, gradients: &[Vec<f64>], drives: usize) {
    let last = states.len() - 1;
    let shares: Vec<Vec<f64>> = (0..gradients.len())
        .map(|k| {
            let (before, after) = (&states[k.saturating_sub(1)], &states[(k + 1).min(last)]);
            let opened = after.held_m() - before.held_m();
            (0..drives + followers.len())
                .map(|i| gradients[k][i] * (after.drives[i] - before.drives[i]) / opened)
                .collect()
        })
        .collect();
    let monotonic = |i: usize| {
        let steps = || states.windows(2).map(move |pair| pair[1].drives[i] - pair[0].drives[i]);
        steps().all(|step| step > 0.0) || steps().all(|step| step < 0.0)
    };
    let carries = |i: usize| shares.iter().any(|shares| shares[i].abs() > CARRIES);
    let mut kept: Vec<usize> = (0..drives + followers.len()).collect();
    kept.retain(|i| *i < drives || (monotonic(*i) && carries(*i)));
    let sums: Vec<f64> = shares.iter().map(|shares| kept.iter().map(|i| shares[*i]).sum()).collect();
    // Where linkages of another kind move the pads too, the joints alone do not explain the opening.
    if !sums.iter().all(|sum| EXPLAINED.contains(sum)) {
        kept.truncate(drives);
    }
    for (k, state) in states.iter_mut().enumerate() {
        state.drives = kept.iter().map(|i| state.drives[*i]).collect();
        if kept.len() > drives {
            state.shares = kept.iter().map(|i| shares[k][*i] / sums[k]).collect();
        }
    }
    *followers = kept[drives..].iter().map(|i| followers[i - drives].clone()).collect();
}

/// Distance between the pads along the y axis of a tool, in metres. `None` if a pad is not there.
fn at_tool(data: &mut MjData<Box<MjModel>>, tool: &Isometry3<f64>, pads: &[Vec<usize>; 2]) -> Option<f64> {
    let side = |pad: &[usize], data: &MjData<Box<MjModel>>| -> f64 {
        corners(data, pad).iter().map(|corner| tool.inverse_transform_point(corner).y).sum()
    };
    let [first, second] = pads;
    let (left, right) = if side(first, data) > side(second, data) { (first, second) } else { (second, first) };
    let left = probe::moving_face(data, tool, left)?;
    Some(left - probe::fixed_face(data, tool, probe::BESIDE_M, right)?)
}

/// The opening between a fixed jaw and one that moves, whose shapes are `pads`, in metres. The fixed jaw is where robot.toml says.
fn one_jaw(
    data: &mut MjData<Box<MjModel>>,
    tool: &Isometry3<f64>,
    jaw: &ParallelJaw,
    fixed_m: f64,
    [fixed, moved]: &[Vec<usize>; 2],
) -> Result<f64, Problem> {
    let face = probe::fixed_face(data, tool, 0.5 * jaw.opening_m - fixed_m, fixed);
    if face.is_none_or(|face| (face + fixed_m).abs() > FACE_M) {
        let found = face.map_or("not there".to_owned(), |face| format!("{:.4} m from it", -face));
        return Err(Problem::new(
            format!(
                "gripper.fixed_jaw_m = {fixed_m}, but the inner face of `{}` on the negative y axis of the tool centre point is {found}",
                jaw.finger_bodies[0]
            ),
            "name the body of the fixed jaw first in gripper.finger_bodies, and put the site of arm.tcp_site between the jaws with the fixed one on its negative y axis",
        ));
    }
    let moving = probe::moving_face(data, tool, moved);
    moving.map(|moving| moving + fixed_m).ok_or_else(|| {
        Problem::new(
            format!("`{}` leaves the y axis of the tool centre point on its way from open to closed", jaw.finger_bodies[1]),
            "choose another position for open in [[gripper.drive]], or a tool centre point nearer to the hinge of the jaw",
        )
    })
}

/// Moves the closed end to where the pads meet, if they overlap there.
fn meet(states: &mut [FingerState]) {
    let [closed, next, ..] = states else { return };
    if closed.opening_m < 0.0 {
        let share = -closed.opening_m / (next.opening_m - closed.opening_m);
        let mix = |a: &mut Vec<f64>, b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += share * (b - *a));
        mix(&mut closed.drives, &next.drives);
        mix(&mut closed.joints, &next.joints);
        closed.at_tool_m = closed.at_tool_m.zip(next.at_tool_m).map(|(a, b)| a + share * (b - a));
        closed.opening_m = 0.0;
    }
}
