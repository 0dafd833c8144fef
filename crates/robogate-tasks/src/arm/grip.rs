//! The state of a grasp, from gripper commands and contacts. It does not use the policy's phases.

use nalgebra::{Isometry3, Vector3};
use robogate_physics::{GripperCommand, GripperState, StepView};

use super::Bodies;

/// The gripper is at rest if its opening changed by less than this within [`SETTLE_S`], in metres.
const SETTLED_M: f64 = 2e-4;
/// Time over which the gripper must be at rest, in seconds.
const SETTLE_S: f64 = 0.1;
/// A tool with a cup is at rest if it moved by less than this, in metres, because a cup may grip while it moves ...
const TOOL_SETTLED_M: f64 = 2e-3;
/// ... within this time, in seconds, which is longer than the build-up of the vacuum.
const TOOL_SETTLE_S: f64 = 0.2;
/// A finger holds the part only if it presses with at least this fraction of the grip force.
const HOLD_SHARE: f64 = 0.2;
/// A held part is lost after this long without contact to a finger, in seconds.
const LOSS_S: f64 = 0.05;

/// A body hardly moves if it is slower than this, in m/s ...
const STILL_SPEED: f64 = 1e-3;
/// ... and this, in rad/s.
const STILL_SPIN: f64 = 0.02;

/// A change of the grasp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum GripChange {
    /// The gripper begins to close.
    Closes,
    /// The gripper holds the part.
    Held,
    /// The gripper closed without the part.
    Missed,
    /// The part left the closed gripper.
    Lost,
    /// The gripper opens with the part in it.
    Released,
}

/// The state of the grasp of one part after another.
#[derive(Debug, Clone)]
pub(crate) struct Grip {
    grip_force_n: f64,
    state: State,
}

#[derive(Debug, Clone, Copy)]
enum State {
    Free,
    /// The position that must come to rest, and the time of its last motion in seconds.
    Closing {
        at: Vector3<f64>,
        moved_at: f64,
    },
    /// The first pose of the part in the hand, and the time since it has no contact.
    Held {
        in_hand: Isometry3<f64>,
        untouched_since: Option<f64>,
    },
}

impl Grip {
    /// A free gripper that holds with this force in newtons.
    pub(crate) fn new(grip_force_n: f64) -> Self {
        Self { grip_force_n, state: State::Free }
    }

    /// The first pose of the held part in the hand. `None` without a part.
    pub(crate) fn in_hand(&self) -> Option<Isometry3<f64>> {
        match self.state {
            State::Held { in_hand, .. } => Some(in_hand),
            State::Free | State::Closing { .. } => None,
        }
    }

    /// Whether the gripper neither closes nor holds a part.
    pub(crate) fn is_free(&self) -> bool {
        matches!(self.state, State::Free)
    }

    /// Observes one time step that ends at `time` (s).
    pub(crate) fn observe(&mut self, command: GripperCommand, time: f64, view: &StepView<'_>) -> Option<GripChange> {
        match (command, &mut self.state) {
            (GripperCommand::Close, State::Free) => {
                self.state = State::Closing { at: settling(view).0, moved_at: time };
                Some(GripChange::Closes)
            }
            (GripperCommand::Close, State::Closing { at, moved_at }) => {
                let (now, still, duration) = settling(view);
                if view.gripper == GripperState::Cup(true) {
                    return Some(self.settle(view));
                }
                if (*at - now).norm() > still {
                    (*at, *moved_at) = (now, time);
                } else if time - *moved_at >= duration {
                    return Some(self.settle(view));
                }
                None
            }
            (GripperCommand::Close, State::Held { untouched_since, .. }) => {
                if touching(view) {
                    *untouched_since = None;
                    return None;
                }
                let since = *untouched_since.get_or_insert(time);
                (time - since >= LOSS_S).then_some(GripChange::Lost)
            }
            (GripperCommand::Open, State::Held { .. }) => {
                self.state = State::Free;
                Some(GripChange::Released)
            }
            (GripperCommand::Open, State::Closing { .. } | State::Free) => {
                self.state = State::Free;
                None
            }
        }
    }

    /// The gripper has come to rest, with or without the part.
    fn settle(&mut self, view: &StepView<'_>) -> GripChange {
        let held = match view.gripper {
            GripperState::Fingers(_) => {
                let enough = |force: &Option<f64>| force.is_some_and(|force| force >= HOLD_SHARE * self.grip_force_n);
                view.touches.fingers.iter().all(enough)
            }
            GripperState::Cup(holding) => holding,
        };
        if !held {
            return GripChange::Missed;
        }
        self.state = State::Held { in_hand: view.tcp.inverse() * view.object, untouched_since: None };
        GripChange::Held
    }
}

/// How far the part has moved in the hand since it was at `in_hand`, in metres.
pub(crate) fn displacement(in_hand: &Isometry3<f64>, view: &StepView<'_>) -> f64 {
    ((view.tcp.inverse() * view.object).translation.vector - in_hand.translation.vector).norm()
}

/// Whether the first `count` free bodies hardly move.
pub(crate) fn still(bodies: &dyn Bodies, count: usize) -> bool {
    (0..count).all(|body| is_still(bodies.velocity(body)))
}

/// Whether a body with this linear (m/s) and angular (rad/s) velocity hardly moves.
pub(crate) fn is_still((linear, angular): (Vector3<f64>, Vector3<f64>)) -> bool {
    linear.norm() < STILL_SPEED && angular.norm() < STILL_SPIN
}

/// Whether a finger touches the part, or the cup holds it.
pub(crate) fn touching(view: &StepView<'_>) -> bool {
    match view.gripper {
        GripperState::Fingers(_) => view.touches.fingers.iter().any(Option::is_some),
        GripperState::Cup(holding) => holding,
    }
}

/// The position that must come to rest for a grasp, the largest motion that counts as rest (m), and the time (s).
fn settling(view: &StepView<'_>) -> (Vector3<f64>, f64, f64) {
    match view.gripper {
        GripperState::Fingers(opening) => (Vector3::new(opening, 0.0, 0.0), SETTLED_M, SETTLE_S),
        GripperState::Cup(_) => (view.tcp.translation.vector, TOOL_SETTLED_M, TOOL_SETTLE_S),
    }
}
