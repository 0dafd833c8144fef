//! Measures where the jaws of a gripper with one moving jaw meet a line.
//!
//! Such jaws touch at their hinge in every state, so the smallest distance between their shapes is not the opening. A small ball
//! that touches nothing is moved along the line until it meets one of the shapes.

use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Point3, Vector3};

use super::{PREFIX, sweep};

/// Radius of the ball, in metres.
const RADIUS_M: f64 = 1e-3;
/// The ball has met a shape at this distance, in metres.
const MET_M: f64 = 1e-5;
/// The ball starts this far beside the tool centre point, in metres.
pub(crate) const BESIDE_M: f64 = 0.3;
/// The contact mask of the ball: no other shape has it, and the compiler of a URDF discards shapes without one.
const ALONE: i32 = 1 << 20;
/// Most steps of the ball.
const MOST_STEPS: usize = 300;

fn name() -> String {
    format!("{PREFIX}probe")
}

/// Adds the ball to a robot's model, behind everything else.
pub(crate) fn add(spec: &mut MjSpec) {
    let body = spec.world_body_mut().add_body().with_name(&name());
    body.set_mocap(true);
    let geom = body.add_geom().with_name(&name());
    geom.set_type(MjtGeomBase::mjGEOM_SPHERE);
    *geom.size_mut() = [RADIUS_M, 0.0, 0.0];
    geom.set_contype(ALONE);
    geom.set_conaffinity(ALONE);
}

/// How far the front of the ball goes from `from` along a direction until it meets one of these shapes, in metres. `None` if it does
/// not within twice [`BESIDE_M`].
fn met(data: &mut MjData<Box<MjModel>>, from: &Point3<f64>, along: &Vector3<f64>, shapes: &[usize]) -> Option<f64> {
    let ball = data.model().name_to_id(MjtObjBase::mjOBJ_GEOM, &name())?;
    let mut gone = 0.0;
    for _ in 0..MOST_STEPS {
        data.mocap_pos_mut()[0] = (from + along * gone).coords.into();
        data.kinematics();
        let distance = sweep::gap(data, [&[ball], shapes]);
        if distance < MET_M {
            return Some(gone + RADIUS_M);
        }
        gone += distance;
        if gone > 2.0 * BESIDE_M {
            return None;
        }
    }
    None
}

/// The position of the face of these shapes that looks along the negative y axis of a frame, on that axis, in metres.
pub(crate) fn moving_face(data: &mut MjData<Box<MjModel>>, tool: &Isometry3<f64>, shapes: &[usize]) -> Option<f64> {
    let y = tool * Vector3::y();
    met(data, &(tool * Point3::new(0.0, -BESIDE_M, 0.0)), &y, shapes).map(|gone| gone - BESIDE_M)
}

/// The position of the face of these shapes that looks along the positive y axis of a frame, on that axis, in metres. Shapes
/// beyond `from` (m) on that axis do not count.
pub(crate) fn fixed_face(
    data: &mut MjData<Box<MjModel>>,
    tool: &Isometry3<f64>,
    from: f64,
    shapes: &[usize],
) -> Option<f64> {
    let y = tool * Vector3::y();
    met(data, &(tool * Point3::new(0.0, from, 0.0)), &-y, shapes).map(|gone| from - gone)
}
