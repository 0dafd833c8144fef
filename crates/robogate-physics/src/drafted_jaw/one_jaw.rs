//! Finds a gripper with one moving jaw: the last joint of the chain moves a jaw towards one that is fixed to the link before it.

use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{Jaw, LEAST_DAMPING, Measured, STIFFNESS, TIP, joint_force, pad_mass};
use crate::mujoco::{probe, sweep};
use crate::scene::isometry;
use crate::{FingerDrive, Problem, robot_model};

/// Number of positions at which the jaw is measured over its range.
const POSITIONS: usize = 41;
/// A jaw changes the opening by at least this much, in metres.
const LEAST_OPENING_M: f64 = 8e-3;
/// The fixed jaw reaches at least this fraction of the way of the moving jaw from the hinge.
const FIXED_SHARE: f64 = 0.4;
/// A jaw on a hinge turns by at most this angle from closed to open, in radians: beyond, it is too steep to hold a part.
const MOST_TURN: f64 = 0.8;
/// The last joint of the arm turns the tool about its own axis if its axis is this near to perpendicular to that of the jaw (the
/// cosine of the angle between them).
const PERPENDICULAR: f64 = 0.3;
/// Distance from the hinge to where parts find room between the jaws, in metres.
const HINGE_ROOM_M: f64 = 0.01;

/// The jaws in a robot's model.
struct Jaws {
    data: MjData<Box<MjModel>>,
    joint: usize,
    /// The body of the fixed jaw, whose frame is that of all figures.
    palm: usize,
    fixed: Vec<usize>,
    moved: Vec<usize>,
}

impl Jaws {
    /// Moves the jaw, and returns the frame of the palm.
    fn go(&mut self, position: f64) -> Isometry3<f64> {
        let at = self.data.model().jnt_qposadr()[self.joint] as usize;
        self.data.qpos_mut()[at] = position;
        self.data.forward();
        isometry(&self.data.xpos()[self.palm], &self.data.xquat()[self.palm])
    }

    /// The corners of shapes in the palm's frame.
    fn corners(&self, frame: &Isometry3<f64>, shapes: &[usize]) -> Vec<Vector3<f64>> {
        Measured::in_palm(frame, &sweep::corners(&self.data, shapes))
    }

    /// The opening along the y axis of a tool in the palm's frame whose origin is on the fixed face.
    fn opening(&mut self, position: f64, tool: &Isometry3<f64>) -> Option<f64> {
        let tool = self.go(position) * tool;
        let moved = self.moved.clone();
        probe::moving_face(&mut self.data, &tool, &moved)
    }
}

impl Jaw {
    /// The gripper whose moving jaw is on `joint`, at the end of the arm with these joints. `None` if the joint does not move a jaw
    /// towards a fixed one. `spec` is the robot alone, and `model` its compiled form.
    pub(crate) fn of_one(
        spec: &MjSpec,
        model: &MjModel,
        arm: &[usize],
        joint: usize,
    ) -> Result<Option<Self>, Vec<Problem>> {
        let body = model.jnt_bodyid()[joint] as usize;
        let palm = model.body_parentid()[body] as usize;
        let (fixed, moved) = (sweep::shapes(model, palm), sweep::shapes(model, body));
        let (range, is_hinge) = (model.jnt_range()[joint], model.jnt_type()[joint] == MjtJoint::mjJNT_HINGE);
        let &[.., last] = arm else { return Ok(None) };
        if fixed.is_empty() || moved.is_empty() || !model.jnt_limited()[joint] || range[0] >= range[1] {
            return Ok(None);
        }
        let mut spec = spec.clone();
        probe::add(&mut spec);
        let compiled = spec.compile().map_err(|error| vec![robot_model::rejected(&error)])?;
        let data = MjData::new(Box::new(compiled));
        let mut jaws = Jaws { data, joint, palm, fixed, moved };
        let positions: Vec<f64> =
            (0..POSITIONS).map(|k| range[0] + (range[1] - range[0]) * k as f64 / (POSITIONS - 1) as f64).collect();
        let frame = jaws.go(0.5 * (range[0] + range[1]));
        let direction = |axis: [f64; 3]| frame.inverse_transform_vector(&Vector3::from(axis));
        let point = |at: [f64; 3]| frame.inverse_transform_point(&Point3::from(at)).coords;
        let axis = direction(jaws.data.xaxis()[joint]);
        let (hinge, wrist) = (point(jaws.data.xanchor()[joint]), point(jaws.data.xanchor()[last]));
        let corners = jaws.corners(&frame, &jaws.moved);
        let middle = corners.iter().sum::<Vector3<f64>>() / corners.len() as f64;
        // z points out of the tool: along the axis of the wrist where that turns the tool, else to the tip of the jaw.
        let roll = direction(jaws.data.xaxis()[last]);
        let z = if roll.dot(&axis).abs() < PERPENDICULAR {
            roll * (middle - wrist).dot(&roll).signum()
        } else {
            let far = corners.iter().max_by(|a, b| (*a - hinge).norm().total_cmp(&(*b - hinge).norm()));
            let out = far.map_or(middle, |far| far - hinge);
            let Some(z) = (out - axis * out.dot(&axis)).try_normalize(1e-6) else { return Ok(None) };
            z
        };
        let Some(across) = (axis - z * axis.dot(&z)).try_normalize(1e-6) else { return Ok(None) };
        // A jaw on a hinge moves perpendicular to its axis, and one on a slide along it.
        let closing = if is_hinge { z.cross(&across) } else { across };
        let end = |corners: &[Vector3<f64>], pick: fn(f64, f64) -> f64, start: f64| {
            corners.iter().map(|corner| corner.dot(&z)).fold(start, pick)
        };
        let fixed_tip = end(&jaws.corners(&frame, &jaws.fixed), f64::max, f64::NEG_INFINITY);
        let mut moved_tip = f64::NEG_INFINITY;
        for position in &positions {
            let frame = jaws.go(*position);
            moved_tip = end(&jaws.corners(&frame, &jaws.moved), f64::max, moved_tip);
        }
        let start = if is_hinge { hinge } else { wrist }.dot(&z);
        if fixed_tip - start < FIXED_SHARE * (moved_tip - start) || moved_tip <= start {
            return Ok(None);
        }
        let height = fixed_tip.min(moved_tip) - TIP;
        // The moving jaw is on the side of the fixed one where the opening is larger.
        let (mut most, mut best) = (f64::NEG_INFINITY, None);
        for y in [closing, -closing] {
            let x = y.cross(&z);
            let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
            let line = Isometry3::from_parts(
                Translation3::from(x * middle.dot(&x) + z * height),
                UnitQuaternion::from_rotation_matrix(&rotation),
            );
            let shapes = jaws.fixed.clone();
            let Some(face) = probe::fixed_face(&mut jaws.data, &(frame * line), probe::BESIDE_M, &shapes) else {
                continue;
            };
            let tool = line * Translation3::new(0.0, face, 0.0);
            let openings: Vec<Option<f64>> = positions.iter().map(|at| jaws.opening(*at, &tool)).collect();
            let widest = (0..POSITIONS)
                .filter_map(|k| openings[k].map(|opening| (k, opening)))
                .max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((k, opening)) = widest
                && opening > most
            {
                most = opening;
                best = Some((k, tool, openings));
            }
        }
        let Some((widest, tool, openings)) = best else { return Ok(None) };
        let Some((met, closed)) = closing_end(&positions, &openings, widest) else { return Ok(None) };
        let travel = positions[widest] - met;
        let open = met + if is_hinge { travel.clamp(-MOST_TURN, MOST_TURN) } else { travel };
        let (Some(opening_m), Some(closed_m)) = (jaws.opening(open, &tool), jaws.opening(met, &tool)) else {
            return Ok(None);
        };
        let closed_m = closed_m.max(0.0);
        if opening_m - closed_m < LEAST_OPENING_M {
            return Ok(None);
        }
        let at = |position: f64, jaws: &mut Jaws| {
            jaws.go(position);
            jaws.data.qpos().to_vec()
        };
        let moved = [(opening_m, at(open, &mut jaws)), (closed_m, at(met, &mut jaws))];
        let frame = jaws.go(met);
        let inner = end(&jaws.corners(&frame, &jaws.moved), f64::min, f64::INFINITY);
        let slope = (opening_m - closed_m) / (open - met).abs();
        let measured = Measured {
            opening_m,
            closed_m,
            tcp: tool * Translation3::new(0.0, 0.5 * opening_m, 0.0),
            tips: [height + TIP, fixed_tip.max(moved_tip)],
            base: if is_hinge { inner.max(start + HINGE_ROOM_M) } else { inner },
            moved,
        };
        let mass = pad_mass(model, &measured);
        let driven = (0..model.actuator_trntype().len()).find(|actuator| {
            model.actuator_trntype()[*actuator] == MjtTrn::mjTRN_JOINT
                && model.actuator_trnid()[*actuator][0] == joint as i32
                && model.actuator_forcelimited()[*actuator]
        });
        let torque = driven.map(|actuator| model.actuator_forcerange()[actuator][1]).filter(|limit| *limit > 0.0);
        let name = |kind, id: usize| model.id_to_name(kind, id).unwrap_or_default().to_owned();
        let rounded = |x: f64| (x * 1e6).round() / 1e6;
        Ok(Some(Self {
            slides: None,
            drives: vec![FingerDrive {
                moves: name(MjtObjBase::mjOBJ_JOINT, joint),
                open: rounded(open),
                closed: rounded(closed),
            }],
            bodies: [palm, body].map(|body| name(MjtObjBase::mjOBJ_BODY, body)),
            opening_m,
            fixed_jaw_m: Some(0.5 * opening_m),
            force_n: torque.or_else(|| joint_force(model, joint)).map(|torque| torque / slope),
            stiffness_n_m: STIFFNESS,
            damping_ns_m: (STIFFNESS * mass).sqrt().clamp(LEAST_DAMPING, 10.0 * LEAST_DAMPING).round(),
            tcp: measured.tcp,
            tips: measured.tips,
            base: measured.base,
        }))
    }
}

/// Where the jaws meet, and the end of the closing motion, from the widest position. `openings` belong to `positions`.
fn closing_end(positions: &[f64], openings: &[Option<f64>], widest: usize) -> Option<(f64, f64)> {
    // The jaw closes in the direction in which the opening falls farther.
    let falls = |step: isize| {
        let (mut at, mut lowest) = (widest, openings[widest]?);
        while let Some(next) = at.checked_add_signed(step).filter(|next| *next < positions.len()) {
            let Some(opening) = openings[next].filter(|opening| *opening < lowest) else { break };
            if opening <= 0.0 {
                let share = lowest / (lowest - opening);
                let met = positions[at] + share * (positions[next] - positions[at]);
                let end = if step > 0 { positions[positions.len() - 1] } else { positions[0] };
                return Some((0.0, met, end));
            }
            (at, lowest) = (next, opening);
        }
        Some((lowest, positions[at], positions[at]))
    };
    let (down, up) = (falls(-1)?, falls(1)?);
    let (_, met, end) = if down.0 < up.0 { down } else { up };
    Some((met, end))
}
