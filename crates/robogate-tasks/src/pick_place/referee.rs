//! The referee: determines the outcome of an episode from contacts, motion and gripper commands.
//!
//! It does not use the policy's phases, so the same rules apply to all policies. The first decisive event ends the episode:
//!
//! | event | when |
//! |---|---|
//! | collision | a robot body touches a fixture |
//! | grasp_miss | fingers: after a close command they are at rest, and they do not both press on the object with at least a fifth of the grip force |
//! | grasp_miss | suction: after a grip command the tool has been at rest for 0.2 s and the cup does not hold the object |
//! | grip_loss | the object was held, the gripper has no open command, and for 50 ms no finger touches the object, or the cup has lost it; or the object was released with its centre more than 5 cm above its resting height, and has come to rest |
//! | success | the object was released, has been at rest for 0.2 s within the tolerances of the target, and the robot does not touch it |
//!
//! If none of these events happens, the time limit ends the episode, with the first mode that applies:
//!
//! | mode | when |
//! |---|---|
//! | misplaced | the object was released and is at rest, outside a tolerance of the target |
//! | jam | the robot pressed with more than the force of a jam, without interruption, for the duration of a jam |
//! | timeout | otherwise |
//!
//! A jam does not end an episode before the time limit, because the policy may still recover from it.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use robogate_core::{Contact, Ending, FailureMode, Measures};
use robogate_physics::{Collision, GripperCommand, GripperState, Touches};

use super::spec::{
    COLLISION, GRASP_MISS, GRIP_LOSS, JAM, MIN_CLEARANCE, MISPLACED, PEAK_CONTACT_FORCE, SLIP, TARGET_DISTANCE,
};
use super::{ModeSet, Rules, Shape};

/// The gripper is at rest if its opening changed by less than this within [`SETTLE_S`], in metres.
const SETTLED_M: f64 = 2e-4;
/// A tool with a cup is at rest if it moved by less than this, in metres, because a cup may grip while it moves ...
const TOOL_SETTLED_M: f64 = 2e-3;
/// ... within this time, in seconds, which is longer than the build-up of the vacuum.
const TOOL_SETTLE_S: f64 = 0.2;
/// Time over which the gripper must be at rest, in seconds.
const SETTLE_S: f64 = 0.1;
/// A finger holds the object only if it presses with at least this fraction of the grip force.
const HOLD_SHARE: f64 = 0.2;
/// A held object is lost after this long without contact to a finger, in seconds.
const LOSS_S: f64 = 0.05;
/// The object is at rest below this speed, in m/s ...
const REST_SPEED: f64 = 0.01;
/// ... and this angular speed, in rad/s ...
const REST_SPIN: f64 = 0.2;
/// ... for this long, in seconds.
const REST_S: f64 = 0.2;
/// An object is dropped if it is released more than this above its resting height, in metres.
const DROP_M: f64 = 0.05;
/// A larger contact force is reported as an event if it is this many times the last reported one.
const FORCE_STEP: f64 = 1.5;
/// The episode has come to rest if the object is slower than this, in m/s ...
const STILL_SPEED: f64 = 1e-3;
/// ... and this, in rad/s.
const STILL_SPIN: f64 = 0.02;

/// What the referee judges an object by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Goal {
    /// Target of the object's centre, in metres.
    pub(crate) target: [f64; 3],
    /// Largest horizontal distance from the target, in metres.
    pub(crate) tolerance_m: f64,
    /// The object's shape, for the symmetry of its orientation.
    pub(crate) shape: Shape,
}

/// The state that the referee gets after one time step.
pub(crate) struct Sight<'a> {
    /// Simulated time after the step, in seconds.
    pub(crate) time: f64,
    /// The gripper command.
    pub(crate) gripper: GripperCommand,
    /// State of the gripper.
    pub(crate) hand: GripperState,
    /// Contacts.
    pub(crate) touches: &'a Touches,
    /// Pose of the object.
    pub(crate) object: Isometry3<f64>,
    /// Linear and angular velocity of the object.
    pub(crate) velocity: (Vector3<f64>, Vector3<f64>),
    /// Pose of the tool centre point.
    pub(crate) tcp: Isometry3<f64>,
}

impl Sight<'_> {
    /// Whether a finger touches the object, or the cup holds it.
    fn in_touch(&self) -> bool {
        match self.hand {
            GripperState::Fingers(_) => self.touches.fingers.iter().any(Option::is_some),
            GripperState::Cup(holding) => holding,
        }
    }

    /// The position that must come to rest for a grasp, the largest motion that counts as rest (m), and the required
    /// time (s).
    fn settling(&self) -> (Vector3<f64>, f64, f64) {
        match self.hand {
            GripperState::Fingers(opening) => (Vector3::new(opening, 0.0, 0.0), SETTLED_M, SETTLE_S),
            GripperState::Cup(_) => (self.tcp.translation.vector, TOOL_SETTLED_M, TOOL_SETTLE_S),
        }
    }
}

/// The state of the grasp.
#[derive(Debug, Clone, PartialEq)]
enum Grip {
    /// Not closed on anything yet.
    Free,
    /// Closing; the position that must come to rest, and the time of its last motion.
    Closing { at: Vector3<f64>, moved_at: f64 },
    /// The object is held. Its first pose in the hand, and the time since it has no contact.
    Held { in_hand: Isometry3<f64>, untouched_since: Option<f64> },
    /// Released at this height of the object above its resting height; the start of its present rest; whether it has
    /// rested long enough.
    Released { height: f64, calm_since: Option<f64>, rested: bool },
}

/// The measured values so far. `None` without a measurement.
#[derive(Debug, Clone, Copy, Default)]
struct Measured {
    peak_contact_force_n: Option<f64>,
    slip_m: Option<f64>,
    min_clearance_m: Option<f64>,
    target_distance_m: Option<f64>,
}

/// The referee of one episode.
#[derive(Debug, Clone)]
pub(crate) struct Referee {
    goal: Goal,
    rules: Rules,
    grip_force: f64,
    grip: Grip,
    /// Start of the present press and its largest force (N).
    press: Option<(f64, f64)>,
    jammed: bool,
    /// The largest contact force that was reported as an event, in newtons.
    reported_force: f64,
    /// Whether the object hardly moves and no finger closes or holds.
    still: bool,
    collision: Option<(f64, Collision)>,
    ending: Option<(Option<FailureMode>, f64)>,
    measured: Measured,
    events: Vec<String>,
    lifted: bool,
}

impl Referee {
    /// Creates a referee for an object that must come to rest at this goal. `grip_force` (N) holds it.
    pub(crate) fn new(goal: Goal, rules: Rules, grip_force: f64) -> Self {
        Self {
            goal,
            rules,
            grip_force,
            grip: Grip::Free,
            press: None,
            jammed: false,
            reported_force: rules.jam_force_n / FORCE_STEP,
            still: false,
            collision: None,
            ending: None,
            measured: Measured::default(),
            events: Vec::new(),
            lifted: false,
        }
    }

    /// The failure mode if the time limit passes in the present state.
    pub(crate) fn mode_at_limit(&self) -> FailureMode {
        match self.grip {
            _ if self.rules.modes == ModeSet::Paper => FailureMode::TIMEOUT,
            Grip::Released { rested: true, .. } => MISPLACED,
            _ if self.jammed => JAM,
            _ => FailureMode::TIMEOUT,
        }
    }

    /// Whether no later event can happen if gripper and arm do not move any more: the object is at rest, and no hand
    /// holds it or closes on it.
    pub(crate) fn at_rest(&self) -> bool {
        self.still && self.ending.is_none() && self.collision.is_none()
    }

    /// The measures so far.
    pub(crate) fn measures(&self) -> Measures {
        let Measured { peak_contact_force_n, slip_m, min_clearance_m, target_distance_m } = self.measured;
        [
            (PEAK_CONTACT_FORCE, peak_contact_force_n),
            (SLIP, slip_m),
            (MIN_CLEARANCE, min_clearance_m),
            (TARGET_DISTANCE, target_distance_m),
        ]
        .into_iter()
        .collect()
    }

    /// The smallest clearance so far, in metres.
    pub(crate) fn min_clearance(&self) -> Option<f64> {
        self.measured.min_clearance_m
    }

    /// Takes the events since the last call.
    pub(crate) fn take_events(&mut self) -> Vec<String> {
        std::mem::take(&mut self.events)
    }

    /// Records a clearance (m).
    pub(crate) fn note_clearance(&mut self, clearance: f64) {
        let smallest = self.measured.min_clearance_m.get_or_insert(f64::INFINITY);
        *smallest = smallest.min(clearance.max(0.0));
    }

    /// The decisive event. `name` gives the names of the bodies of a collision.
    pub(crate) fn ending(&self, name: impl FnOnce(&Collision) -> (String, String)) -> Option<Ending> {
        let (failure, time_s) = self.ending?;
        let contact = self.collision.filter(|_| failure == Some(COLLISION)).map(|(_, collision)| {
            let (robot_body, other_body) = name(&collision);
            Contact { robot_body, other_body, force_n: collision.force }
        });
        Some(Ending { failure, time_s, contact })
    }

    /// Observes one time step.
    pub(crate) fn observe(&mut self, sight: &Sight<'_>) {
        self.measure(sight);
        if self.ending.is_some() {
            return;
        }
        self.feel(sight);
        if self.collision.is_some() {
            self.end(Some(COLLISION), sight.time);
            return;
        }
        match (sight.gripper, &mut self.grip) {
            (GripperCommand::Close, Grip::Free) => {
                self.grip = Grip::Closing { at: sight.settling().0, moved_at: sight.time };
                let what = if let GripperState::Cup(_) = sight.hand { "suction on" } else { "gripper closes" };
                self.events.push(what.to_owned());
            }
            (GripperCommand::Close, Grip::Closing { at, moved_at }) => {
                let (now, still, duration) = sight.settling();
                if sight.hand == GripperState::Cup(true) {
                    self.settle(sight);
                } else if (*at - now).norm() > still {
                    (*at, *moved_at) = (now, sight.time);
                } else if sight.time - *moved_at >= duration {
                    self.settle(sight);
                }
            }
            (GripperCommand::Close, Grip::Held { untouched_since, .. }) => {
                if sight.in_touch() {
                    *untouched_since = None;
                } else {
                    let since = *untouched_since.get_or_insert(sight.time);
                    if sight.time - since >= LOSS_S {
                        self.events.push("object lost".to_owned());
                        self.end(Some(GRIP_LOSS), sight.time);
                    }
                }
            }
            // Closing without the object after the release, for example on the path home, has no effect. Another grasp
            // has.
            (GripperCommand::Close, Grip::Released { .. }) => {
                if sight.in_touch() {
                    self.grip = Grip::Closing { at: sight.settling().0, moved_at: sight.time };
                } else {
                    self.watch_released(sight);
                }
            }
            (GripperCommand::Open, Grip::Held { .. }) => {
                let height = sight.object.translation.z - self.goal.target[2];
                let what = if let GripperState::Cup(_) = sight.hand { "suction off" } else { "gripper opens" };
                self.events.push(format!("{what}, object {:.0} mm above the table", 1e3 * height.max(0.0)));
                self.grip = Grip::Released { height, calm_since: None, rested: false };
            }
            (GripperCommand::Open, Grip::Closing { .. }) => self.grip = Grip::Free,
            (GripperCommand::Open, Grip::Released { .. }) => self.watch_released(sight),
            (GripperCommand::Open, Grip::Free) => {}
        }
    }

    /// The gripper has come to rest, with or without the object.
    fn settle(&mut self, sight: &Sight<'_>) {
        let (held, what) = match sight.hand {
            GripperState::Fingers(opening) => {
                let enough = |force: &Option<f64>| force.is_some_and(|force| force >= HOLD_SHARE * self.grip_force);
                let held = sight.touches.fingers.iter().all(enough);
                let [left, right] = sight.touches.fingers.map(Option::unwrap_or_default);
                let width = 1e3 * opening;
                let what = if held {
                    format!("object held, {width:.1} mm wide, pads press {left:.1} N and {right:.1} N")
                } else {
                    format!("closed to {width:.1} mm without the object between both fingers")
                };
                (held, what)
            }
            GripperState::Cup(true) => (true, "object attached to the cup".to_owned()),
            GripperState::Cup(false) => (false, "suction on without an object at the cup".to_owned()),
        };
        self.events.push(what);
        if held {
            let in_hand = sight.tcp.inverse() * sight.object;
            self.measured.slip_m = Some(0.0);
            self.grip = Grip::Held { in_hand, untouched_since: None };
        } else {
            self.end(Some(GRASP_MISS), sight.time);
        }
    }

    fn watch_released(&mut self, sight: &Sight<'_>) {
        let Grip::Released { height, calm_since, rested } = &mut self.grip else { return };
        let touched = sight.touches.body_on_object || sight.in_touch();
        let (linear, angular) = sight.velocity;
        let calm =
            !touched && sight.touches.object_on_fixture && linear.norm() < REST_SPEED && angular.norm() < REST_SPIN;
        if !calm {
            (*calm_since, *rested) = (None, false);
            return;
        }
        let since = *calm_since.get_or_insert(sight.time);
        if sight.time - since < REST_S {
            return;
        }
        let first = !std::mem::replace(rested, true);
        if *height > DROP_M {
            self.events.push("object was released in the air".to_owned());
            self.end(Some(GRIP_LOSS), sight.time);
            return;
        }
        let distance = self.distance(&sight.object);
        let angle = self.goal.shape.angle_between(&sight.object.rotation, &UnitQuaternion::identity());
        let aligned = self.rules.orientation_tolerance_rad.is_none_or(|most| angle <= most);
        let placed = distance <= self.goal.tolerance_m && aligned;
        if first || placed {
            let turned = match self.rules.orientation_tolerance_rad {
                Some(_) => format!(" and {:.1} degrees", angle.to_degrees()),
                None => String::new(),
            };
            self.events.push(format!("object at rest, {:.1} mm{turned} from the target", 1e3 * distance));
        }
        if placed {
            self.end(None, sight.time);
        }
    }

    /// Observes contact forces and rest.
    fn feel(&mut self, sight: &Sight<'_>) {
        let force = sight.touches.peak_force.unwrap_or(0.0);
        if force >= FORCE_STEP * self.reported_force {
            self.reported_force = force;
            self.events.push(format!("contact force {force:.0} N"));
        }
        let grips = matches!(self.grip, Grip::Closing { .. } | Grip::Held { .. });
        if force > self.rules.jam_force_n + if grips { self.grip_force } else { 0.0 } {
            let (since, largest) = self.press.get_or_insert((sight.time, 0.0));
            *largest = largest.max(force);
            if !self.jammed && sight.time - *since >= self.rules.jam_duration_s {
                self.jammed = true;
                let (largest, duration) = (*largest, self.rules.jam_duration_s);
                self.events.push(format!("jam: pressed for {duration} s with up to {largest:.0} N"));
            }
        } else {
            self.press = None;
        }
        let (linear, angular) = sight.velocity;
        self.still = match self.grip {
            Grip::Free => sight.gripper == GripperCommand::Open,
            Grip::Released { rested, .. } => rested || sight.touches.body_on_object || sight.in_touch(),
            Grip::Closing { .. } | Grip::Held { .. } => false,
        } && linear.norm() < STILL_SPEED
            && angular.norm() < STILL_SPIN;
    }

    fn measure(&mut self, sight: &Sight<'_>) {
        self.measured.target_distance_m = Some(self.distance(&sight.object));
        if let Some(force) = sight.touches.peak_force {
            let peak = self.measured.peak_contact_force_n.get_or_insert(0.0);
            *peak = peak.max(force);
        }
        let touched = sight.in_touch();
        if let (Grip::Held { in_hand, .. }, Some(slip)) = (&self.grip, &mut self.measured.slip_m)
            && touched
            && self.ending.is_none()
        {
            let moved = (sight.tcp.inverse() * sight.object).translation.vector - in_hand.translation.vector;
            *slip = slip.max(moved.norm());
            if !self.lifted && !sight.touches.object_on_fixture {
                self.lifted = true;
                self.events.push("object off the table".to_owned());
            }
        }
        // The first collision counts. Its force is the largest of that contact until the end of the control period.
        match (&mut self.collision, sight.touches.collision) {
            (None, Some(found)) if self.ending.is_none() => {
                self.collision = Some((sight.time, found));
                self.measured.min_clearance_m = Some(0.0);
            }
            (Some((_, first)), Some(now)) if (first.robot_body, first.hit) == (now.robot_body, now.hit) => {
                first.force = first.force.max(now.force);
            }
            _ => {}
        }
    }

    fn distance(&self, object: &Isometry3<f64>) -> f64 {
        (object.translation.x - self.goal.target[0]).hypot(object.translation.y - self.goal.target[1])
    }

    fn end(&mut self, failure: Option<FailureMode>, time: f64) {
        self.ending = Some((failure, time));
    }
}
