//! A robot that presses on something: events, and the jam that follows.

use super::rules::{Record, Sight};

/// A larger contact force is reported as an event if it is this many times the last reported one.
const FORCE_STEP: f64 = 1.5;

/// Contact forces above the force of a jam.
#[derive(Debug, Clone)]
pub(crate) struct Press {
    /// Force of a jam, in newtons, and its duration in seconds.
    jam: (f64, f64),
    /// Start of the present press and its largest force (N).
    press: Option<(f64, f64)>,
    jammed: bool,
    /// The largest contact force that was reported as an event, in newtons.
    reported_n: f64,
}

impl Press {
    /// Before the first step. A press with more than `force_n` newtons for `duration_s` seconds is a jam.
    pub(crate) fn new(force_n: f64, duration_s: f64) -> Self {
        Self { jam: (force_n, duration_s), press: None, jammed: false, reported_n: force_n / FORCE_STEP }
    }

    /// Observes one time step. `grip_n` is the grip force (N) of a gripper that holds a part.
    pub(crate) fn feel(&mut self, sight: &Sight<'_>, grip_n: f64, record: &mut Record) {
        let force = sight.view.touches.peak_force.unwrap_or(0.0);
        if force >= FORCE_STEP * self.reported_n {
            self.reported_n = force;
            record.note(format!("contact force {force:.0} N"));
        }
        let (jam_n, duration) = self.jam;
        if force <= jam_n + grip_n {
            self.press = None;
            return;
        }
        let (since, largest) = self.press.get_or_insert((sight.time, 0.0));
        *largest = largest.max(force);
        if !self.jammed && sight.time - *since >= duration {
            self.jammed = true;
            record.note(format!("jam: pressed for {duration} s with up to {largest:.0} N"));
        }
    }

    /// Whether the robot has pressed for the duration of a jam.
    pub(crate) fn jammed(&self) -> bool {
        self.jammed
    }
}
