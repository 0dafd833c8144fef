//! The referee: determines the outcome of an episode from forces, motion and gripper commands.
//!
//! It does not use the policy's phases, so the same rules apply to all policies. The first decisive event ends the episode:
//!
//! | event | when |
//! |---|---|
//! | collision | a robot body touches the table or the block |
//! | slipped | instead of collision, missed or timeout: the peg had moved by more than 5 mm in the hand |
//! | missed | after a close command the gripper is at rest and does not hold the peg; or the released peg has come to rest outside the hole |
//! | dropped | the peg left the closed gripper before it was seated |
//! | wedge, jam | the peg is stuck: pressed in the hole with at least `stuck_force_n` for `stuck_duration_s` at less than 0.5 mm/s on average, or released in the hole and at rest before its seat. It is a wedge at a depth where friction can hold it against any load ([`super::whitney::can_wedge`]), a jam otherwise |
//! | jam | the peg is pressed with more than `jam_force_n` for `jam_duration_s` |
//! | success | the tip is within `seat_tolerance_m` of the hole's full depth for 0.1 s |
//!
//! The rollout reports a timeout if none of these events happens within the time limit.

use nalgebra::{Isometry3, Point3};
use robogate_core::{Assignment, FailureMode, Measures};
use robogate_physics::{GRAVITY, GripperCommand};

use super::parameters::{Settings, TABLE};
use super::parts::DEPTH_M;
use super::spec::{COLLISION, DEPTH, DROPPED, DURATION, JAM, LATERAL, MISSED, PRESS, SLIP, SLIPPED, WEDGE};
use super::{Insertion, whitney};
use crate::arm::{Acting, Found, Grip, GripChange, Record, Sight, Trial, displacement, still, touching};

/// The tip must be at its seat for this long, in seconds.
const SEAT_S: f64 = 0.1;
/// The tip is in the hole beyond this depth, in metres.
const INSIDE_M: f64 = 0.0005;
/// A pressed peg makes progress if it is at least this fast on average, in m/s. A slower one creeps, and is stuck.
const PROGRESS_M_S: f64 = 0.0005;
/// A peg that moved by more than this in the hand has slipped, in metres.
const SLIPPED_M: f64 = 0.005;
/// A released peg is at rest below this speed, in m/s, ...
const REST_SPEED: f64 = 0.005;
/// ... for this long, in seconds.
const REST_S: f64 = 0.4;

/// The referee of one episode.
pub(crate) struct Referee {
    rules: Insertion,
    settings: Settings,
    /// Pose of the hole's frame in the base frame.
    mouth: Isometry3<f64>,
    grip: Grip,
    was_held: bool,
    /// Time of the last time step, in seconds.
    before: f64,
    seated_since: Option<f64>,
    calm_since: Option<f64>,
    /// Largest depth that counts as progress, in metres, and the time of pressing since then, in seconds.
    progress: (f64, f64),
    /// Time of pressing with too much force, in seconds.
    crushed_s: f64,
    /// Time of the first contact of the held peg with the block, in seconds.
    touched_at: Option<f64>,
    record: Record,
    depth_m: Option<f64>,
    press_n: Option<f64>,
    lateral_n: Option<f64>,
    duration_s: Option<f64>,
    slip_m: Option<f64>,
    /// Whether the peg hardly moves and was never held, and the gripper is open.
    still: bool,
}

impl Referee {
    /// The referee of an episode with these settings under these rules, for a gripper that holds with `grip_force_n` newtons.
    pub(super) fn new(settings: Settings, rules: Insertion, grip_force_n: f64) -> Self {
        Self {
            rules,
            mouth: settings.mouth(),
            grip: Grip::new(grip_force_n * settings.around.gripper.force_scale),
            settings,
            was_held: false,
            before: 0.0,
            seated_since: None,
            calm_since: None,
            progress: (0.0, 0.0),
            crushed_s: 0.0,
            touched_at: None,
            record: Record::default(),
            depth_m: None,
            press_n: None,
            lateral_n: None,
            duration_s: None,
            slip_m: None,
            still: false,
        }
    }

    /// Depth of the tip in the hole, in metres; `None` if the tip is not over the hole.
    fn depth(&self, peg: &Isometry3<f64>) -> Option<f64> {
        let tip = self.mouth.inverse_transform_point(&Point3::from(peg.translation.vector));
        let reach = 0.5 * self.settings.clearance_m + self.settings.chamfer_m + 0.001;
        (tip.x.hypot(tip.y) <= reach * std::f64::consts::SQRT_2).then_some(-tip.z)
    }

    /// The mode of a peg that is stuck at this depth.
    fn stuck(&self, depth: f64) -> FailureMode {
        if whitney::can_wedge(depth, self.settings.width_m, self.settings.friction) { WEDGE } else { JAM }
    }

    /// The mode of a failure that follows from a slip of the peg in the hand, if there was one.
    fn or_slipped(&self, mode: FailureMode) -> FailureMode {
        if self.slip_m.is_some_and(|slip| slip > SLIPPED_M) { SLIPPED } else { mode }
    }

    /// A peg that does not move although it is pressed.
    fn watch_pressing(&mut self, depth: Option<f64>, press: f64, time: f64) {
        let elapsed = time - self.before;
        self.crushed_s = if press > self.rules.jam_force_n { self.crushed_s + elapsed } else { 0.0 };
        if self.crushed_s >= self.rules.jam_duration_s {
            self.record.note(format!("peg pressed with {press:.0} N"));
            self.record.end(Some(JAM), time, None);
            return;
        }
        let Some(depth) = depth.filter(|depth| *depth > INSIDE_M) else { return };
        if depth > self.progress.0 + PROGRESS_M_S * self.rules.stuck_duration_s {
            self.progress = (depth, 0.0);
        } else if press >= self.rules.stuck_force_n {
            self.progress.1 += elapsed;
            if self.progress.1 >= self.rules.stuck_duration_s {
                self.record.note(format!("peg stuck {:.1} mm deep", 1e3 * depth));
                self.record.end(Some(self.stuck(depth)), time, None);
            }
        }
    }

    /// A released peg that has come to rest before its seat.
    fn watch_released(&mut self, sight: &Sight<'_>, depth: Option<f64>) {
        let touched = sight.view.touches.body_on_object || touching(sight.view);
        let (linear, _) = sight.view.velocity;
        if touched || !sight.view.touches.object_on_fixture || linear.norm() >= REST_SPEED {
            self.calm_since = None;
            return;
        }
        let since = *self.calm_since.get_or_insert(sight.time);
        if sight.time - since < REST_S {
            return;
        }
        match depth.filter(|depth| *depth > 0.0) {
            Some(depth) => {
                self.record.note(format!("released peg at rest {:.1} mm deep", 1e3 * depth));
                self.record.end(Some(self.stuck(depth)), sight.time, None);
            }
            None => {
                self.record.note("released peg at rest outside the hole");
                self.record.end(Some(self.or_slipped(MISSED)), sight.time, None);
            }
        }
    }
}

impl Trial for Referee {
    fn applied(&self, requested: &Assignment, found: &Found<'_>, bias: &[f64]) -> Assignment {
        TABLE.applied(requested, &Acting { settings: &self.settings, around: &self.settings.around, found, bias })
    }

    fn at_rest(&self) -> bool {
        self.still && !self.record.is_over()
    }

    fn observe(&mut self, sight: &Sight<'_>) {
        if self.record.is_over() {
            return;
        }
        if let Some(collision) = sight.view.touches.collision {
            self.record.end(Some(self.or_slipped(COLLISION)), sight.time, Some(collision));
            return;
        }
        match self.grip.observe(sight.command, sight.time, sight.view) {
            Some(GripChange::Closes) => self.record.note("gripper closes at the peg"),
            Some(GripChange::Held) => {
                self.was_held = true;
                self.record.note("peg held");
            }
            Some(GripChange::Missed) => {
                self.record.note("the gripper closed without the peg");
                self.record.end(Some(MISSED), sight.time, None);
                return;
            }
            Some(GripChange::Lost) => {
                self.record.note("peg lost");
                self.record.end(Some(DROPPED), sight.time, None);
                return;
            }
            Some(GripChange::Released) => self.record.note("gripper opens"),
            None => {}
        }
        if self.was_held {
            self.watch(sight);
        }
        let idle = !self.was_held && self.grip.is_free() && sight.command == GripperCommand::Open;
        self.still = idle && still(sight.bodies, 1);
        self.before = sight.time;
    }

    fn measures(&self) -> Measures {
        [
            (DEPTH, self.depth_m),
            (PRESS, self.press_n),
            (LATERAL, self.lateral_n),
            (DURATION, self.duration_s),
            (SLIP, self.slip_m),
        ]
        .into_iter()
        .collect()
    }

    fn record(&mut self) -> &mut Record {
        &mut self.record
    }

    fn mode_at_limit(&self) -> FailureMode {
        self.or_slipped(FailureMode::TIMEOUT)
    }
}

impl Referee {
    /// Observes a peg that has been picked up.
    fn watch(&mut self, sight: &Sight<'_>) {
        let depth = self.depth(&sight.view.object);
        if let Some(depth) = depth {
            self.depth_m = Some(self.depth_m.unwrap_or(0.0).max(depth));
        }
        let held = self.grip.in_hand();
        if let Some(in_hand) = held.filter(|_| touching(sight.view)) {
            self.slip_m = Some(self.slip_m.unwrap_or(0.0).max(displacement(&in_hand, sight.view)));
        }
        let held = held.is_some();
        let mut press = 0.0;
        // On its way up from the table, the peg still touches it.
        let near = (sight.view.object.translation.vector - self.mouth.translation.vector).xy().norm();
        if sight.view.touches.object_on_fixture && near < 2.0 * self.settings.width_m {
            let force = self.mouth.inverse_transform_vector(&sight.bodies.support());
            press = if held { force.z } else { (force.z - GRAVITY * self.settings.mass_kg).max(0.0) };
            self.press_n = Some(self.press_n.unwrap_or(0.0).max(force.z));
            self.lateral_n = Some(self.lateral_n.unwrap_or(0.0).max(force.xy().norm()));
            if held && self.touched_at.is_none() {
                self.touched_at = Some(sight.time);
                self.record.note("peg touches the block");
            }
        }
        if depth.is_some_and(|depth| depth >= DEPTH_M - self.rules.seat_tolerance_m) {
            let since = *self.seated_since.get_or_insert(sight.time);
            if sight.time - since >= SEAT_S {
                self.duration_s = self.touched_at.map(|touched| sight.time - touched);
                self.record.note("peg seated");
                self.record.end(None, sight.time, None);
            }
            return;
        }
        self.seated_since = None;
        self.watch_pressing(depth, press, sight.time);
        if !self.record.is_over() && self.grip.is_free() {
            self.watch_released(sight, depth);
        }
    }
}
