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

use nalgebra::{Isometry3, UnitQuaternion};
use robogate_core::{Assignment, FailureMode, Measures};
use robogate_physics::{GripperCommand, GripperState};

use super::cell::Told;
use super::parameters::TABLE;
use super::spec::{COLLISION, GRASP_MISS, GRIP_LOSS, JAM, MIN_CLEARANCE, MISPLACED, SLIP, TARGET_DISTANCE};
use super::{ModeSet, PickPlace};
use crate::arm::{
    Acting, CLEARANCE_LIMIT_M, Found, Grip, GripChange, Press, Record, Sight, Trial, displacement, is_still, touching,
};

/// The object is at rest below this speed, in m/s ...
const REST_SPEED: f64 = 0.01;
/// ... and this angular speed, in rad/s ...
const REST_SPIN: f64 = 0.2;
/// ... for this long, in seconds.
const REST_S: f64 = 0.2;
/// An object is dropped if it is released more than this above its resting height, in metres.
const DROP_M: f64 = 0.05;
/// An object is off the table if it is more than this above its resting height, in metres.
const LIFTED_M: f64 = 0.005;

/// An object after its release.
#[derive(Debug, Clone, Copy)]
struct Released {
    /// Height above the resting height at the release, in metres.
    height: f64,
    /// Start of its present rest, in seconds.
    calm_since: Option<f64>,
    /// Whether it has rested long enough.
    rested: bool,
}

/// The measured values so far. `None` without a measurement.
#[derive(Debug, Clone, Copy, Default)]
struct Measured {
    slip_m: Option<f64>,
    min_clearance_m: Option<f64>,
    target_distance_m: Option<f64>,
}

/// The referee of one episode.
pub(super) struct Referee {
    told: Told,
    rules: PickPlace,
    grip_force: f64,
    grip: Grip,
    released: Option<Released>,
    press: Press,
    /// Whether the object hardly moves and no finger closes or holds.
    still: bool,
    measured: Measured,
    record: Record,
    lifted: bool,
}

impl Referee {
    /// The referee of an episode in this cell, for a gripper that holds with `grip_force_n` newtons.
    pub(super) fn new(told: Told, rules: PickPlace, grip_force_n: f64) -> Self {
        let grip_force = grip_force_n * told.cell.parameters.around.gripper.force_scale;
        Self {
            told,
            rules,
            grip_force,
            grip: Grip::new(grip_force),
            released: None,
            press: Press::new(rules.jam_force_n, rules.jam_duration_s),
            still: false,
            measured: Measured::default(),
            record: Record::default(),
            lifted: false,
        }
    }

    /// Reports a gripper that has come to rest, with or without the object.
    fn note_rest(&mut self, sight: &Sight<'_>, held: bool) {
        self.record.note(match sight.view.gripper {
            GripperState::Fingers(opening) => {
                let [left, right] = sight.view.touches.fingers.map(Option::unwrap_or_default);
                let width = 1e3 * opening;
                if held {
                    format!("object held, {width:.1} mm wide, pads press {left:.1} N and {right:.1} N")
                } else {
                    format!("closed to {width:.1} mm without the object between both fingers")
                }
            }
            GripperState::Cup(true) => "object attached to the cup".to_owned(),
            GripperState::Cup(false) => "suction on without an object at the cup".to_owned(),
        });
    }

    /// A released object moves, or has come to rest.
    fn watch_released(&mut self, sight: &Sight<'_>) {
        let Some(Released { height, calm_since, rested }) = &mut self.released else { return };
        let touches = sight.view.touches;
        let (linear, angular) = sight.view.velocity;
        let calm = !touches.body_on_object
            && !touching(sight.view)
            && touches.object_on_fixture
            && linear.norm() < REST_SPEED
            && angular.norm() < REST_SPIN;
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
            self.record.note("object was released in the air");
            self.record.end(Some(GRIP_LOSS), sight.time, None);
            return;
        }
        let object = &sight.view.object;
        let distance = self.distance(object);
        let angle = self.told.cell.parameters.shape.angle_between(&object.rotation, &UnitQuaternion::identity());
        let aligned = self.rules.orientation_limit_rad().is_none_or(|most| angle <= most);
        let placed = distance <= self.rules.tolerance_m && aligned;
        if first || placed {
            let turned = match self.rules.orientation_limit_rad() {
                Some(_) => format!(" and {:.1} degrees", angle.to_degrees()),
                None => String::new(),
            };
            self.record.note(format!("object at rest, {:.1} mm{turned} from the target", 1e3 * distance));
        }
        if placed {
            self.record.end(None, sight.time, None);
        }
    }

    /// Observes contact forces and rest.
    fn feel(&mut self, sight: &Sight<'_>) {
        let grip = if self.grip.is_free() { 0.0 } else { sight.view.touches.grip(self.grip_force) };
        self.press.feel(sight, grip, &mut self.record);
        let idle = match self.released {
            Some(Released { rested, .. }) => rested || sight.view.touches.body_on_object || touching(sight.view),
            None => self.grip.is_free() && sight.command == GripperCommand::Open,
        };
        self.still = idle && is_still(sight.view.velocity);
    }

    fn measure(&mut self, sight: &Sight<'_>) {
        let (view, over) = (sight.view, self.record.is_over());
        self.measured.target_distance_m = Some(self.distance(&view.object));
        if let (Some(in_hand), Some(slip)) = (self.grip.in_hand(), &mut self.measured.slip_m)
            && touching(view)
            && !over
        {
            *slip = slip.max(displacement(&in_hand, view));
            let height = view.object.translation.z - self.told.cell.target[2];
            if !self.lifted && !view.touches.object_on_fixture && height > LIFTED_M {
                self.lifted = true;
                self.record.note("object off the table");
            }
        }
        // The first collision counts. Its force is the largest of that contact until the end of the control period.
        self.record.strengthen(view.touches.collision);
    }

    fn distance(&self, object: &Isometry3<f64>) -> f64 {
        let [x, y, _] = self.told.cell.target;
        (object.translation.x - x).hypot(object.translation.y - y)
    }
}

impl Trial for Referee {
    fn applied(&self, requested: &Assignment, found: &Found<'_>, bias: &[f64]) -> Assignment {
        TABLE.applied(
            requested,
            &Acting { settings: &self.told, around: &self.told.cell.parameters.around, found, bias },
        )
    }

    fn observe(&mut self, sight: &Sight<'_>) {
        self.measure(sight);
        if self.record.is_over() {
            return;
        }
        self.feel(sight);
        let view = sight.view;
        if let Some(collision) = view.touches.collision {
            self.measured.min_clearance_m = Some(0.0);
            self.record.end(Some(COLLISION), sight.time, Some(collision));
            return;
        }
        // Closing without the object after the release, for example on the path home, has no effect. Another grasp has.
        let again = self.released.is_some() && sight.command == GripperCommand::Close;
        if again {
            if !touching(view) {
                self.watch_released(sight);
                return;
            }
            self.released = None;
        }
        let cup = matches!(view.gripper, GripperState::Cup(_));
        match self.grip.observe(sight.command, sight.time, view) {
            Some(GripChange::Closes) if again => {}
            Some(GripChange::Closes) => self.record.note(if cup { "suction on" } else { "gripper closes" }),
            Some(GripChange::Held) => {
                self.note_rest(sight, true);
                self.measured.slip_m = Some(0.0);
            }
            Some(GripChange::Missed) => {
                self.note_rest(sight, false);
                self.record.end(Some(GRASP_MISS), sight.time, None);
            }
            Some(GripChange::Lost) => {
                self.record.note("object lost");
                self.record.end(Some(GRIP_LOSS), sight.time, None);
            }
            Some(GripChange::Released) => {
                let height = view.object.translation.z - self.told.cell.target[2];
                let what = if cup { "suction off" } else { "gripper opens" };
                self.record.note(format!("{what}, object {:.0} mm above the table", 1e3 * height.max(0.0)));
                self.released = Some(Released { height, calm_since: None, rested: false });
            }
            None => self.watch_released(sight),
        }
    }

    fn measures(&self) -> Measures {
        let Measured { slip_m, min_clearance_m, target_distance_m } = self.measured;
        [(SLIP, slip_m), (MIN_CLEARANCE, min_clearance_m), (TARGET_DISTANCE, target_distance_m)].into_iter().collect()
    }

    fn record(&mut self) -> &mut Record {
        &mut self.record
    }

    fn mode_at_limit(&self) -> FailureMode {
        match self.released {
            _ if self.rules.modes == ModeSet::Paper => FailureMode::TIMEOUT,
            Some(Released { rested: true, .. }) => MISPLACED,
            _ if self.press.jammed() => JAM,
            _ => FailureMode::TIMEOUT,
        }
    }

    fn at_rest(&self) -> bool {
        self.still && !self.record.is_over()
    }

    fn clearance_bound(&self) -> Option<f64> {
        Some(self.measured.min_clearance_m.unwrap_or(CLEARANCE_LIMIT_M))
    }

    fn note_clearance(&mut self, clearance_m: f64) {
        let smallest = self.measured.min_clearance_m.get_or_insert(f64::INFINITY);
        *smallest = smallest.min(clearance_m.max(0.0));
    }
}
