//! Decides when the thread of a body on a screw takes up a free body, and when it lets go of it. The rules are the same for all
//! engines: [`crate::Thread`].

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::{Engine, Joint, Scene, Thread};

/// A body is taken up once it has turned by this in place, in radians.
const TURNED_RAD: f64 = 0.05;
/// The screw is at its lower stop within this angle, in radians.
const AT_STOP_RAD: f64 = 0.02;
/// The thread lets go of a body at the stop only after the screw has been beyond this angle, in radians.
const BEYOND_RAD: f64 = 0.1;

/// The threads of a scene.
#[derive(Debug, Default)]
pub(crate) struct Threads(Vec<State>);

/// A thread, and what it holds.
#[derive(Debug)]
struct State {
    /// The body on the screw.
    screw: usize,
    joint: Joint,
    thread: Thread,
    hold: Hold,
}

#[derive(Debug, Clone, Copy)]
enum Hold {
    /// The angle of the free body about the axis and how far it has turned in place, in radians. `None` if it is not there.
    Free(Option<(f64, f64)>),
    /// Whether the screw has been away from its stop.
    Taken { moved: bool },
}

impl Threads {
    pub(crate) fn of(scene: &Scene) -> Self {
        let threads = scene.free_bodies().enumerate().filter_map(|(screw, (object, _))| {
            let joint = object.joint?;
            Some(State { screw, joint, thread: joint.thread?, hold: Hold::Free(None) })
        });
        Self(threads.collect())
    }

    /// Takes bodies up and lets go of them after a time step.
    pub(crate) fn step(&mut self, engine: &mut impl Engine) {
        for state in &mut self.0 {
            state.step(engine);
        }
    }
}

impl State {
    fn step(&mut self, engine: &mut impl Engine) {
        let Some([value, _]) = engine.body_joint(self.screw) else { return };
        let beyond = value - self.joint.range[0];
        match &mut self.hold {
            Hold::Free(before) => {
                let in_screw = engine.free_body(self.screw).inverse() * engine.free_body(self.thread.body);
                let there = beyond < AT_STOP_RAD && self.thread.is_in_place(&in_screw, &self.joint.direction());
                let angle = about(&in_screw.rotation, &self.joint.direction());
                *before = there.then(|| {
                    let turned = before.map_or(0.0, |(last, so_far)| so_far + wrapped(angle - last));
                    // A turn in the other direction does not count.
                    (angle, turned.max(0.0))
                });
                if before.is_some_and(|(_, turned)| turned > TURNED_RAD) {
                    engine.take_up(self.screw, self.thread.body);
                    self.hold = Hold::Taken { moved: false };
                }
            }
            Hold::Taken { moved } => {
                *moved |= beyond > BEYOND_RAD;
                if *moved && beyond < AT_STOP_RAD {
                    engine.let_go(self.screw);
                    self.hold = Hold::Free(None);
                }
            }
        }
    }
}

impl Thread {
    /// Whether the free body, at this pose in the frame of the body on the screw, is in place for a screw with this axis.
    fn is_in_place(&self, in_screw: &Isometry3<f64>, axis: &Vector3<f64>) -> bool {
        let off = in_screw * nalgebra::Point3::from(self.point);
        off.coords.norm() <= self.within_m && (in_screw.rotation * axis).angle(axis) <= self.lean_rad
    }
}

/// The part of a rotation that is about an axis, in radians.
fn about(rotation: &UnitQuaternion<f64>, axis: &Vector3<f64>) -> f64 {
    2.0 * rotation.imag().dot(axis).atan2(rotation.w)
}

/// An angle between -pi and pi, in radians.
fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use nalgebra::Translation3;

    use super::*;

    #[test]
    fn angles_pass_through_half_a_turn() {
        let axis = Vector3::z();
        let at = |angle: f64| about(&UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle), &axis);
        assert!((wrapped(at(PI + 0.1) - at(PI - 0.1)) - 0.2).abs() < 1e-12);
        assert!((wrapped(at(0.3) - at(TAU - 0.1)) - 0.4).abs() < 1e-12);
    }

    #[test]
    fn place_has_tolerances() {
        let thread = Thread { body: 1, point: -Vector3::z(), within_m: 0.01, lean_rad: 0.05 };
        let there = |x: f64, lean: f64| {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), lean);
            let tip = Translation3::new(x, 0.0, 0.0);
            thread.is_in_place(&(tip * rotation * Translation3::new(0.0, 0.0, 1.0)), &Vector3::z())
        };
        assert!(there(0.009, 0.0) && there(0.0, 0.049));
        assert!(!there(0.011, 0.0) && !there(0.0, 0.051));
    }
}
