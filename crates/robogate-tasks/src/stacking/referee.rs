//! The referee: determines the outcome of an episode from contacts, motion and gripper commands.
//!
//! It does not use the policy's phases, so the same rules apply to all policies. The first decisive event ends the episode:
//!
//! | event | when |
//! |---|---|
//! | collision | a robot body touches the table |
//! | missed | after a close command the gripper is at rest and does not hold a part |
//! | dropped | a part left the closed gripper, or was released more than 3 cm above its resting height |
//! | toppled | a part of the stack tilts by more than `tilt_limit_rad` or sinks by more than a quarter of its size; a part that was released over the stack falls or comes to rest elsewhere |
//! | misplaced | a released part has come to rest out of order or farther than `tolerance_m` from its place |
//! | success | all parts are in their places, have been at rest for 0.4 s, and the robot does not touch the last one |
//!
//! If none of these events happens, the time limit ends the episode: with a jam if the robot pressed with more than `jam_force_n`,
//! without interruption, for `jam_duration_s`, and otherwise with a timeout.

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Assignment, FailureMode, Measures};
use robogate_physics::GripperCommand;

use super::Stacking;
use super::parameters::{PARTS, Settings, TABLE};
use super::spec::{COLLISION, DROPPED, JAM, MARGIN, MISPLACED, MISSED, OFFSET, SLIP, TOPPLED};
use super::statics::{self, Level};
use crate::arm::{Acting, Bodies, Found, Grip, GripChange, Press, Record, Sight, Trial, displacement, still, touching};

/// A part is dropped if it is released more than this above its resting height, in metres.
const DROP_M: f64 = 0.03;
/// A part is no longer at its level if its centre is off by more than this fraction of its size.
const LEVEL_SHARE: f64 = 0.25;
/// The parts are at rest below this speed, in m/s ...
const REST_SPEED: f64 = 0.01;
/// ... and this angular speed, in rad/s ...
const REST_SPIN: f64 = 0.2;
/// ... for this long, in seconds.
const REST_S: f64 = 0.4;

/// The referee of one episode.
pub(crate) struct Referee {
    rules: Stacking,
    settings: Settings,
    grip: Grip,
    /// The part that the gripper acts on.
    selected: usize,
    /// Number of levels that are complete. The bottom one is complete from the start.
    complete: usize,
    released: Option<Released>,
    record: Record,
    offset_m: Option<f64>,
    margin_m: Option<f64>,
    slip_m: Option<f64>,
    press: Press,
    /// Grip force in newtons.
    grip_force_n: f64,
    /// Whether the parts hardly move and the gripper is open.
    still: bool,
}

/// A part after its release.
#[derive(Debug, Clone, Copy)]
struct Released {
    /// Height above the resting height at its level, in metres.
    height: f64,
    /// Whether it was released over the stack.
    over_stack: bool,
    calm_since: Option<f64>,
}

impl Referee {
    /// The referee of an episode with these settings under these rules, for a gripper that holds with `grip_force_n` newtons.
    pub(super) fn new(settings: Settings, rules: Stacking, grip_force_n: f64) -> Self {
        let grip_force_n = grip_force_n * settings.around.gripper.force_scale;
        Self {
            rules,
            selected: settings.order[1],
            grip: Grip::new(grip_force_n),
            grip_force_n,
            press: Press::new(rules.jam_force_n, rules.jam_duration_s),
            settings,
            complete: 1,
            released: None,
            record: Record::default(),
            offset_m: None,
            margin_m: None,
            slip_m: None,
            still: false,
        }
    }

    /// The part at a level of the stack.
    fn part_at(&self, level: usize, bodies: &dyn Bodies) -> Isometry3<f64> {
        bodies.pose(self.settings.order[level])
    }

    /// Height of the centre of a part at this level, in metres.
    fn level_height(&self, level: usize) -> f64 {
        (level as f64 + 0.5) * self.settings.size_m
    }

    /// Whether a part is upright at this level.
    fn stands(&self, part: &Isometry3<f64>, level: usize) -> bool {
        let off = (part.translation.z - self.level_height(level)).abs();
        off <= LEVEL_SHARE * self.settings.size_m && tilt(part) <= self.rules.tilt_limit_rad
    }

    /// Horizontal distance of a part from its place on the part below, in metres.
    fn off_place(&self, part: &Isometry3<f64>, below: &Isometry3<f64>) -> f64 {
        let off = part.translation.vector - below.translation.vector;
        (off.x - self.settings.overhang * self.settings.size_m).hypot(off.y)
    }

    /// Whether no free body moves.
    fn calm(bodies: &dyn Bodies) -> bool {
        (0..PARTS.len()).all(|part| {
            let (linear, angular) = bodies.velocity(part);
            linear.norm() < REST_SPEED && angular.norm() < REST_SPIN
        })
    }

    /// A released part moves, or has come to rest.
    fn watch_released(&mut self, sight: &Sight<'_>) {
        let Some(released) = self.released else { return };
        let (part, below) = (sight.view.object, self.part_at(self.complete - 1, sight.bodies));
        let expected = self.selected == self.settings.order[self.complete];
        let fell = part.translation.z < self.level_height(self.complete) - 0.5 * self.settings.size_m
            || tilt(&part) > 2.0 * self.rules.tilt_limit_rad;
        if expected && released.over_stack && released.height <= DROP_M && fell {
            self.record.note(format!("part {} falls off the stack", PARTS[self.selected]));
            self.record.end(Some(TOPPLED), sight.time, None);
            return;
        }
        let touched = sight.view.touches.body_on_object || touching(sight.view);
        if touched || !sight.view.touches.object_on_fixture || !Self::calm(sight.bodies) {
            self.released = Some(Released { calm_since: None, ..released });
            return;
        }
        let since = released.calm_since.unwrap_or(sight.time);
        self.released = Some(Released { calm_since: Some(since), ..released });
        if sight.time - since < REST_S {
            return;
        }
        let off = self.off_place(&part, &below);
        let name = PARTS[self.selected];
        let failure = if released.height > DROP_M {
            self.record.note(format!("part {name} was released in the air"));
            Some(DROPPED)
        } else if !expected {
            self.record.note(format!("part {name} is out of order"));
            Some(MISPLACED)
        } else if !self.stands(&part, self.complete) {
            self.record.note(format!("part {name} is not on the stack"));
            Some(if released.over_stack { TOPPLED } else { MISPLACED })
        } else {
            self.record.note(format!("part {name} at rest, {:.1} mm from its place", 1e3 * off));
            self.offset_m = Some(self.offset_m.unwrap_or(0.0).max(off));
            (off > self.rules.tolerance_m).then_some(MISPLACED)
        };
        if failure.is_some() {
            self.record.end(failure, sight.time, None);
            return;
        }
        self.released = None;
        self.complete += 1;
        let margin = statics::margin(&self.levels(sight.bodies), self.settings.size_m);
        self.margin_m = Some(margin);
        if self.complete == PARTS.len() {
            self.record.note(format!("the stack is complete, {:.1} mm from tipping", 1e3 * margin));
            self.record.end(None, sight.time, None);
        }
    }

    /// The complete levels of the stack.
    fn levels(&self, bodies: &dyn Bodies) -> Vec<Level> {
        let level = |level: usize| {
            let at = self.part_at(level, bodies).translation;
            Level { at: [at.x, at.y], mass_kg: self.settings.mass_kg * self.settings.mass_step.powi(level as i32) }
        };
        (0..self.complete).map(level).collect()
    }

    fn measure(&mut self, sight: &Sight<'_>) {
        if let Some(in_hand) = self.grip.in_hand().filter(|_| touching(sight.view)) {
            self.slip_m = Some(self.slip_m.unwrap_or(0.0).max(displacement(&in_hand, sight.view)));
        }
    }
}

/// Angle between the vertical and the axis of a part that is nearest to it, in radians.
fn tilt(part: &Isometry3<f64>) -> f64 {
    (part.rotation * Vector3::z()).z.clamp(-1.0, 1.0).acos()
}

impl Trial for Referee {
    fn applied(&self, requested: &Assignment, found: &Found<'_>, bias: &[f64]) -> Assignment {
        TABLE.applied(requested, &Acting { settings: &self.settings, around: &self.settings.around, found, bias })
    }

    fn select(&mut self, command: GripperCommand, tcp: &Isometry3<f64>, bodies: &dyn Bodies) -> Option<usize> {
        // An open gripper that closes acts on the nearest part.
        if command == GripperCommand::Close && self.grip.is_free() {
            let distance = |body: &usize| (bodies.pose(*body).translation.vector - tcp.translation.vector).norm();
            let nearest = (0..PARTS.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
            self.selected = nearest.unwrap_or(self.selected);
        }
        Some(self.selected)
    }

    fn at_rest(&self) -> bool {
        self.still && self.released.is_none() && !self.record.is_over()
    }

    fn observe(&mut self, sight: &Sight<'_>) {
        self.measure(sight);
        self.still = self.grip.is_free() && sight.command == GripperCommand::Open && still(sight.bodies, PARTS.len());
        if self.record.is_over() {
            return;
        }
        if let Some(collision) = sight.view.touches.collision {
            self.record.end(Some(COLLISION), sight.time, Some(collision));
            return;
        }
        let grip = if self.grip.is_free() { 0.0 } else { self.grip_force_n };
        self.press.feel(sight, grip, &mut self.record);
        let name = PARTS[self.selected];
        match self.grip.observe(sight.command, sight.time, sight.view) {
            Some(GripChange::Closes) => {
                self.released = None;
                self.record.note(format!("gripper closes at part {name}"));
            }
            Some(GripChange::Held) => self.record.note(format!("part {name} held")),
            Some(GripChange::Missed) => {
                self.record.note("the gripper closed without a part");
                self.record.end(Some(MISSED), sight.time, None);
            }
            Some(GripChange::Lost) => {
                self.record.note(format!("part {name} lost"));
                self.record.end(Some(DROPPED), sight.time, None);
            }
            Some(GripChange::Released) => {
                let (part, below) = (sight.view.object, self.part_at(self.complete - 1, sight.bodies));
                let height = part.translation.z - self.level_height(self.complete);
                let over_stack = self.off_place(&part, &below) <= self.settings.size_m;
                // A part beside the stack rests on the table.
                let height = if over_stack { height } else { part.translation.z - self.level_height(0) };
                self.record.note(format!("gripper opens, part {name} {:.0} mm above its rest", 1e3 * height));
                self.released = Some(Released { height, over_stack, calm_since: None });
            }
            None => {}
        }
        for level in 0..self.complete {
            let held = self.grip.in_hand().is_some() && self.settings.order[level] == self.selected;
            if !held && !self.stands(&self.part_at(level, sight.bodies), level) {
                self.record.note(format!("part {} of the stack tips over", PARTS[self.settings.order[level]]));
                self.record.end(Some(TOPPLED), sight.time, None);
                return;
            }
        }
        self.watch_released(sight);
    }

    fn measures(&self) -> Measures {
        [(OFFSET, self.offset_m), (MARGIN, self.margin_m), (SLIP, self.slip_m)].into_iter().collect()
    }

    fn record(&mut self) -> &mut Record {
        &mut self.record
    }

    fn mode_at_limit(&self) -> FailureMode {
        if self.press.jammed() { JAM } else { FailureMode::TIMEOUT }
    }
}
