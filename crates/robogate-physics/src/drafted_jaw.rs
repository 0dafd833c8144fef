//! Finds the fingers of a model for a drafted `robot.toml`: drives, pads, opening, and the frame of the tool.

mod one_jaw;

use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::mujoco::sweep::{self, Sweep};
use crate::scene::isometry;
use crate::{FingerDrive, Problem, robot_model};

/// Distance from the fingertips back to the tool centre point, in metres.
pub(crate) const TIP: f64 = 0.01;
/// Largest distance from the tool centre point of a model's own site to the fingertips, in metres.
const FARTHEST_TIP: f64 = 0.05;
/// An axis of the tool within this angle of an axis of the palm is that axis, in radians.
const SNAP: f64 = 0.3;
/// Two slides are described by their joints alone if their opening is right to within this, in metres.
const EXACT: f64 = 1e-3;
/// A part of the gripper is a finger if it reaches this fraction of the way of the pads from the palm.
const FINGER_SHARE: f64 = 0.9;
/// Number of states in which the fingers are measured.
const STATES: usize = 9;
/// Stiffness of a finger's servo, in N/m, and its smallest damping, in N s/m.
const STIFFNESS: f64 = 10_000.0;
const LEAST_DAMPING: f64 = 100.0;
/// Smallest and largest speed of a finger, in m/s.
const SPEEDS: [f64; 2] = [0.015, 0.05];
/// Momentum of a jaw that meets a part against a fixed jaw, in N s: over the 4 ms of a contact it stays below 150 N.
const MOMENTUM_N_S: f64 = 0.5;

/// Two fingers.
pub(crate) struct Jaw {
    /// The joints of two slides whose zero is closed.
    pub(crate) slides: Option<[String; 2]>,
    /// The drives of all other fingers.
    pub(crate) drives: Vec<FingerDrive>,
    pub(crate) bodies: [String; 2],
    pub(crate) opening_m: f64,
    /// Distance from the tool centre point to a jaw that does not move.
    pub(crate) fixed_jaw_m: Option<f64>,
    /// Largest force of each pad, in newtons, if the model limits it.
    pub(crate) force_n: Option<f64>,
    pub(crate) stiffness_n_m: f64,
    pub(crate) damping_ns_m: f64,
    /// A tool centre point in the palm's frame.
    pub(crate) tcp: Isometry3<f64>,
    /// Smallest and largest distance of the fingertips along the tool's z axis from the palm's origin, in metres.
    tips: [f64; 2],
    /// Distance of the fingers' inner ends along that axis, in metres.
    base: f64,
}

impl Jaw {
    /// The fingers that `joints` move on the body `palm`. `spec` is the robot alone, and `model` its compiled form.
    pub(crate) fn of(
        spec: &MjSpec,
        model: &MjModel,
        arm: &[usize],
        palm: usize,
        joints: &[usize],
    ) -> Result<Self, Vec<Problem>> {
        let pads = pads(model, palm).map_err(|problem| vec![problem])?;
        let name = |body: usize| model.id_to_name(MjtObjBase::mjOBJ_BODY, body).unwrap_or_default().to_owned();
        let slides = slides(model, joints);
        let mut drives = match &slides {
            Some(_) => joints.iter().map(|joint| Driven::joint(model, *joint)).collect(),
            None => drives(model, joints).map_err(|problem| vec![problem])?,
        };
        let mut spec = spec.clone();
        for drive in &drives {
            sweep::add_motor(&mut spec, &drive.moves);
        }
        let names: Vec<&str> =
            arm.iter().filter_map(|joint| model.id_to_name(MjtObjBase::mjOBJ_JOINT, *joint)).collect();
        sweep::measurable(&mut spec, &names);
        let compiled = spec.compile().map_err(|error| vec![robot_model::rejected(&error)])?;
        let arm: Vec<(&str, f64)> = arm
            .iter()
            .map(|joint| (model.id_to_name(MjtObjBase::mjOBJ_JOINT, *joint).unwrap_or_default(), 0.0))
            .collect();
        orient(&compiled, &pads.shapes, &arm, &mut drives)?;
        let settings: Vec<FingerDrive> = drives.iter().map(Driven::settings).collect();
        let mut sweep = Sweep::new(compiled, &arm, &settings).map_err(|problem| vec![problem])?;
        let measured = Measured::of(&mut sweep, &pads.shapes, palm).map_err(|problem| vec![problem])?;
        // A change of the drives' positions per change of the opening.
        let travel = (drives[0].ends[1] - drives[0].ends[0]).abs();
        let slope = (measured.opening_m - measured.closed_m).max(1e-3) / travel;
        let mass = pad_mass(model, &measured);
        let force = drives[0].force.map(|force| force * drives.len() as f64 / slope);
        let force = force.or_else(|| joints.first().and_then(|joint| joint_force(model, *joint)));
        Ok(Self {
            slides: slides.filter(|_| {
                let closed_at_zero = drives.iter().all(|drive| drive.ends[1].abs() < 1e-9);
                closed_at_zero && measured.closed_m < EXACT && (measured.opening_m - travel * 2.0).abs() < EXACT
            }),
            drives: settings,
            bodies: pads.bodies.map(name),
            opening_m: measured.opening_m,
            fixed_jaw_m: None,
            force_n: force,
            stiffness_n_m: STIFFNESS,
            damping_ns_m: (STIFFNESS * mass).sqrt().clamp(LEAST_DAMPING, 10.0 * LEAST_DAMPING).round(),
            tcp: measured.tcp,
            tips: measured.tips,
            base: measured.base,
        })
    }

    /// Whether a site, given by its pose in the palm's frame, is a tool centre point: between the pads, z out of the tool,
    /// and the fingers along y. Jaws of which one does not move have a tool centre point of their own.
    pub(crate) fn accepts(&self, site: &Isometry3<f64>) -> bool {
        if self.fixed_jaw_m.is_some() {
            return false;
        }
        let off = self.tcp.inverse() * site;
        let [z, y] = [off * Vector3::z(), off * Vector3::y()];
        let beside = off.translation.vector.xy().norm();
        let tips = self.tips.map(|tip| tip - self.along(site));
        z.z > SNAP.cos() && y.y.abs() > SNAP.cos() && beside < TIP && tips[0] > 0.0 && tips[1] < FARTHEST_TIP
    }

    /// From a tool centre point, given by its pose in the palm's frame, to the fingertips and back to the palm, in metres.
    pub(crate) fn tip_and_palm(&self, tcp: &Isometry3<f64>) -> [f64; 2] {
        let at = self.along(tcp);
        [(self.tips[1] - at).max(1e-3), (at - self.base).clamp(1e-3, 0.5)]
    }

    /// A speed of the fingers, in m/s. A heavy jaw that meets a part against a fixed one is slower: it strikes with its momentum.
    pub(crate) fn speed_m_s(&self) -> f64 {
        let mass = self.damping_ns_m.powi(2) / self.stiffness_n_m;
        let fastest = if self.fixed_jaw_m.is_some() { MOMENTUM_N_S / mass } else { SPEEDS[1] };
        (1e3 * fastest.clamp(SPEEDS[0], SPEEDS[1])).round() / 1e3
    }

    fn along(&self, pose: &Isometry3<f64>) -> f64 {
        pose.translation.vector.dot(&(self.tcp * Vector3::z()))
    }
}

/// A drive of the fingers with the ends of its range: open, then closed.
struct Driven {
    moves: String,
    ends: [f64; 2],
    /// Address in qpos, if it moves a joint.
    joint: Option<usize>,
    /// Largest force or torque, if the model limits it.
    force: Option<f64>,
}

impl Driven {
    fn joint(model: &MjModel, joint: usize) -> Self {
        Self {
            moves: model.id_to_name(MjtObjBase::mjOBJ_JOINT, joint).unwrap_or_default().to_owned(),
            ends: model.jnt_range()[joint],
            joint: Some(model.jnt_qposadr()[joint] as usize),
            force: None,
        }
    }

    fn tendon(model: &MjModel, tendon: usize) -> Self {
        let ends = if model.tendon_limited()[tendon] {
            model.tendon_range()[tendon]
        } else {
            let first = model.tendon_adr()[tendon] as usize;
            let wraps = first..first + model.tendon_num()[tendon] as usize;
            wraps.fold([0.0; 2], |[low, high], wrap| {
                let coefficient = model.wrap_prm()[wrap];
                let [a, b] = model.jnt_range()[model.wrap_objid()[wrap] as usize].map(|q| coefficient * q);
                [low + a.min(b), high + a.max(b)]
            })
        };
        let moves = model.id_to_name(MjtObjBase::mjOBJ_TENDON, tendon).unwrap_or_default().to_owned();
        Self { moves, ends, joint: None, force: None }
    }

    fn settings(&self) -> FingerDrive {
        let rounded = |x: f64| (x * 1e6).round() / 1e6;
        FingerDrive { moves: self.moves.clone(), open: rounded(self.ends[0]), closed: rounded(self.ends[1]) }
    }
}

/// The names of two slides that are closed at 0.
fn slides(model: &MjModel, joints: &[usize]) -> Option<[String; 2]> {
    let slides = |joint: &usize| {
        let [low, high] = model.jnt_range()[*joint];
        model.jnt_type()[*joint] == MjtJoint::mjJNT_SLIDE
            && model.jnt_limited()[*joint]
            && low.abs() < 1e-9
            && high > 0.0
    };
    let &[first, second] = joints else { return None };
    let name = |joint: usize| model.id_to_name(MjtObjBase::mjOBJ_JOINT, joint).unwrap_or_default().to_owned();
    joints.iter().all(slides).then(|| [name(first), name(second)])
}

/// The force limit of a joint.
fn joint_force(model: &MjModel, joint: usize) -> Option<f64> {
    model.jnt_actfrclimited()[joint].then(|| model.jnt_actfrcrange()[joint][1]).filter(|force| *force > 0.0)
}

/// The drives of the fingers: the model's actuators, or the joints that others follow.
fn drives(model: &MjModel, joints: &[usize]) -> Result<Vec<Driven>, Problem> {
    let mut found: Vec<Driven> = Vec::new();
    for actuator in 0..model.actuator_trntype().len() {
        let id = model.actuator_trnid()[actuator][0].max(0) as usize;
        let mut driven = match model.actuator_trntype()[actuator] {
            MjtTrn::mjTRN_JOINT if joints.contains(&id) => Driven::joint(model, id),
            MjtTrn::mjTRN_TENDON if pulls(model, id, joints) => Driven::tendon(model, id),
            _ => continue,
        };
        if driven.ends[0] >= driven.ends[1] {
            driven.ends = commanded(model, actuator).unwrap_or(driven.ends);
        }
        let limit = model.actuator_forcerange()[actuator][1];
        driven.force = (model.actuator_forcelimited()[actuator] && limit > 0.0).then_some(limit);
        if found.iter().all(|known| known.moves != driven.moves) {
            found.push(driven);
        }
    }
    if found.is_empty() {
        let pairs: Vec<[usize; 2]> = (0..model.eq_type().len())
            .filter(|equality| model.eq_type()[*equality] == MjtEq::mjEQ_JOINT && model.eq_obj2id()[*equality] >= 0)
            .map(|equality| [model.eq_obj1id()[equality] as usize, model.eq_obj2id()[equality] as usize])
            .collect();
        let follows = |joint: &&usize| pairs.iter().any(|[follower, _]| follower == *joint);
        let leads = |joint: &&usize| pairs.iter().any(|[_, leader]| leader == *joint);
        let leaders = joints.iter().filter(leads).filter(|joint| !follows(joint));
        found = leaders.map(|joint| Driven::joint(model, *joint)).collect();
        if found.is_empty() && joints.len() <= 2 {
            found = joints.iter().map(|joint| Driven::joint(model, *joint)).collect();
        }
    }
    let names = |joint: &usize| model.id_to_name(MjtObjBase::mjOBJ_JOINT, *joint).unwrap_or("(without a name)");
    if found.is_empty() {
        return Err(Problem::new(
            format!(
                "the gripper has the joints {}, but no actuator and no joint that the others follow",
                joints.iter().map(names).collect::<Vec<_>>().join(", ")
            ),
            "couple the joints in the model by equalities or a tendon, or add an actuator to the joint or tendon that drives them",
        ));
    }
    match found.iter().find(|drive| drive.moves.is_empty() || (drive.ends[1] - drive.ends[0]).abs() < 1e-6) {
        Some(drive) => Err(Problem::new(
            format!("`{}`, which drives the fingers, has no range or no name", drive.moves),
            "give joint or tendon a name and a range in the model",
        )),
        None => Ok(found),
    }
}

/// The positions at which a position actuator rests at the ends of its control range. `None` for another actuator.
///
/// Its force is gain times control + bias[0] + bias[1] times position, which is zero at rest.
fn commanded(model: &MjModel, actuator: usize) -> Option<[f64; 2]> {
    let (gain, bias) = (model.actuator_gainprm()[actuator][0], model.actuator_biasprm()[actuator]);
    let ends = model.actuator_ctrlrange()[actuator].map(|control| (gain * control + bias[0]) / -bias[1]);
    let rests = model.actuator_ctrllimited()[actuator] && gain > 0.0 && bias[1] < 0.0;
    (rests && ends.iter().all(|end| end.is_finite())).then_some(ends)
}

/// Whether a tendon is a sum of joints with one of these.
fn pulls(model: &MjModel, tendon: usize, joints: &[usize]) -> bool {
    let first = model.tendon_adr()[tendon] as usize;
    let mut wraps = first..first + model.tendon_num()[tendon] as usize;
    let on_joints = wraps.clone().all(|wrap| model.wrap_type()[wrap] == MjtWrap::mjWRAP_JOINT);
    on_joints && wraps.any(|wrap| joints.contains(&(model.wrap_objid()[wrap] as usize)))
}

/// The two bodies that carry the pads, and the collision shapes of the fingers.
struct Pads {
    bodies: [usize; 2],
    shapes: [Vec<usize>; 2],
}

/// The pads are the two moving parts of the gripper that reach farthest from the palm.
fn pads(model: &MjModel, palm: usize) -> Result<Pads, Problem> {
    let mut data = MjData::new(Box::new(model.clone()));
    data.forward();
    let frame = isometry(&data.xpos()[palm], &data.xquat()[palm]);
    let below = |mut body: usize| {
        while body > palm {
            body = model.body_parentid()[body] as usize;
        }
        body == palm
    };
    let weld = |body: usize| model.body_weldid()[body];
    let mut parts: Vec<(f64, usize, i32)> = Vec::new();
    for geom in 0..model.geom_bodyid().len() {
        let body = model.geom_bodyid()[geom] as usize;
        let touchable = model.geom_contype()[geom] != 0 || model.geom_conaffinity()[geom] != 0;
        if !touchable || !below(body) || weld(body) == weld(palm) {
            continue;
        }
        let reach = (Point3::from(data.geom_xpos()[geom]) - Point3::from(frame.translation.vector)).norm();
        match parts.iter_mut().find(|(_, _, known)| *known == weld(body)) {
            Some(part) if part.0 < reach => *part = (reach, body, weld(body)),
            Some(_) => {}
            None => parts.push((reach, body, weld(body))),
        }
    }
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    let [(_, first, _), (_, second, _), ..] = parts[..] else {
        return Err(Problem::new(
            "the gripper has fewer than two moving fingers with a collision shape",
            "only grippers with two moving fingers are supported; give both geoms with contype or conaffinity, or <collision> elements",
        ));
    };
    if let Some(third) = third_finger(model, palm, &parts) {
        let name = |body: usize| model.id_to_name(MjtObjBase::mjOBJ_BODY, body).unwrap_or_default();
        let [first, second, third] = [first, second, third].map(name);
        return Err(Problem::new(
            format!("the gripper has three fingers or more: `{first}`, `{second}` and `{third}` reach equally far"),
            "only grippers with two fingers are supported: remove the other fingers from the model",
        ));
    }
    let bodies = [first.min(second), first.max(second)];
    Ok(Pads { bodies, shapes: bodies.map(|body| sweep::shapes(model, body)) })
}

/// The body of a third finger: a part that reaches nearly as far as the pads, on another branch of the palm. `parts` are reach and
/// body of each moving part, farthest first.
fn third_finger(model: &MjModel, palm: usize, parts: &[(f64, usize, i32)]) -> Option<usize> {
    let weld = |body: usize| model.body_weldid()[body];
    let branch = |mut body: usize| {
        while body > 0 && weld(model.body_parentid()[weld(body) as usize] as usize) != weld(palm) {
            body = model.body_parentid()[weld(body) as usize] as usize;
        }
        weld(body)
    };
    let [(_, first, _), (reach, second, _), others @ ..] = parts else { return None };
    let known = [branch(*first), branch(*second)];
    let far = |(other, body, _): &&(f64, usize, i32)| *other > FINGER_SHARE * reach && !known.contains(&branch(*body));
    others.iter().find(far).map(|(_, body, _)| *body)
}

/// Puts the open end of each drive first: where the pads are farther apart.
fn orient(
    model: &MjModel,
    pads: &[Vec<usize>; 2],
    arm: &[(&str, f64)],
    drives: &mut [Driven],
) -> Result<(), Vec<Problem>> {
    if let [drive] = drives {
        let settings = drive.settings();
        let mut sweep = Sweep::new(model.clone(), arm, &[settings]).map_err(|problem| vec![problem])?;
        let first = sweep.gap(pads);
        sweep.go(1.0).map_err(|problem| vec![problem])?;
        if sweep.gap(pads) > first {
            drive.ends.reverse();
        }
        return Ok(());
    }
    // Each of several drives moves a finger of its own: one at a time, with the others in the middle.
    let mut data = MjData::new(Box::new(model.clone()));
    let middle = |drive: &Driven| 0.5 * (drive.ends[0] + drive.ends[1]);
    for i in 0..drives.len() {
        let mut gaps = [0.0; 2];
        for (end, gap) in gaps.iter_mut().enumerate() {
            for (j, drive) in drives.iter().enumerate() {
                let position = if i == j { drive.ends[end] } else { middle(drive) };
                if let Some(joint) = drive.joint {
                    data.qpos_mut()[joint] = position;
                }
            }
            data.forward();
            *gap = sweep::gap(&mut data, [&pads[0], &pads[1]]);
        }
        if gaps[1] > gaps[0] {
            drives[i].ends.reverse();
        }
    }
    Ok(())
}

/// Measurements of the fingers from open to closed, in the palm's frame.
struct Measured {
    opening_m: f64,
    closed_m: f64,
    tcp: Isometry3<f64>,
    tips: [f64; 2],
    base: f64,
    /// Two states of the gripper: opening in metres, and the positions of all joints.
    moved: [(f64, Vec<f64>); 2],
}

impl Measured {
    fn of(sweep: &mut Sweep, pads: &[Vec<usize>; 2], palm: usize) -> Result<Self, Problem> {
        let all: Vec<usize> = pads.iter().flatten().copied().collect();
        let opening_m = sweep.gap(pads);
        let frame = isometry(&sweep.data.xpos()[palm], &sweep.data.xquat()[palm]);
        let mut corners = vec![Self::in_palm(&frame, &sweep.corners(&all))];
        let [from, to] = sweep.nearest(pads).map(|point| frame.inverse_transform_point(&point).coords);
        let mut closed_m = opening_m;
        let start = (opening_m, sweep.joints());
        let mut moved = None;
        for k in 1..STATES {
            sweep.go(k as f64 / (STATES - 1) as f64)?;
            closed_m = sweep.gap(pads);
            moved.get_or_insert_with(|| (closed_m, sweep.joints()));
            corners.push(Self::in_palm(&frame, &sweep.corners(&all)));
            if closed_m <= 0.0 {
                break;
            }
        }
        // The fingers close along y; z points from the palm to their tips.
        let y = snapped(&(to - from).try_normalize(1e-6).unwrap_or_else(Vector3::y));
        let middle = corners[0].iter().sum::<Vector3<f64>>() / corners[0].len() as f64;
        let outwards = middle - y * middle.dot(&y);
        let z = snapped(&outwards.try_normalize(1e-6).unwrap_or_else(|| y.cross(&Vector3::x()).normalize()));
        let y = (y - z * y.dot(&z)).normalize();
        let along = |corners: &Vec<Vector3<f64>>, pick: fn(f64, f64) -> f64, start: f64| {
            corners.iter().map(|corner| corner.dot(&z)).fold(start, pick)
        };
        let tips: Vec<f64> = corners.iter().map(|corners| along(corners, f64::max, f64::NEG_INFINITY)).collect();
        let base =
            corners.iter().map(|corners| along(corners, f64::min, f64::INFINITY)).fold(f64::NEG_INFINITY, f64::max);
        let tips =
            [tips.iter().copied().fold(f64::INFINITY, f64::min), tips.into_iter().fold(f64::NEG_INFINITY, f64::max)];
        let x = y.cross(&z);
        let centre = x * middle.dot(&x) + y * (0.5 * (from + to)).dot(&y) + z * (tips[0] - TIP);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z])));
        let tcp = Isometry3::from_parts(Translation3::from(centre), rotation);
        let moved = [start.clone(), moved.unwrap_or(start)];
        Ok(Self { opening_m, closed_m, tcp, tips, base, moved })
    }

    fn in_palm(frame: &Isometry3<f64>, corners: &[Point3<f64>]) -> Vec<Vector3<f64>> {
        corners.iter().map(|corner| frame.inverse_transform_point(corner).coords).collect()
    }
}

/// The mass that a pad moves, in kilograms, with all that the gripper's joints carry and the inertia of its motors.
///
/// With v the change of the joints' positions by the opening o and M the mass matrix, the kinetic energy is
/// v^T M v (do/dt)^2 / 2. Each of two pads moves at half of do/dt.
fn pad_mass(model: &MjModel, Measured { moved: [(opened, from), (closed, to)], .. }: &Measured) -> f64 {
    let velocity: Vec<f64> = from.iter().zip(to).map(|(from, to)| (to - from) / (closed - opened)).collect();
    let n = velocity.len();
    let mut data = MjData::new(Box::new(model.clone()));
    data.qpos_mut().copy_from_slice(from);
    data.forward();
    let mut matrix = vec![0.0; n * n];
    match data.full_m(&mut matrix) {
        Ok(()) => {
            2.0 * (0..n * n)
                .map(|k| velocity[k / n] * matrix[k] * velocity[k % n])
                .filter(|x| x.is_finite())
                .sum::<f64>()
        }
        Err(_) => 0.0,
    }
}

/// The axis of a frame that a direction is almost parallel to, or the direction itself.
fn snapped(direction: &Vector3<f64>) -> Vector3<f64> {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    let near = axes.iter().find(|axis| direction.dot(axis).abs() > SNAP.cos());
    near.map_or(*direction, |axis| axis * direction.dot(axis).signum())
}
