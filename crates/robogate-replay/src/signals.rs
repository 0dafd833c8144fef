//! Signals: one number per control period or per frame.

use robogate_core::{ContactBetween, Trajectory};

/// A signal over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Signal {
    /// The name.
    pub name: String,
    /// The unit; empty for a number without one.
    pub unit: String,
    /// The times of the values.
    pub clock: Clock,
    /// The values. `None` where nothing was measured.
    pub values: Vec<Option<f64>>,
}

/// The times of a signal's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// The ends of the control periods.
    Ticks,
    /// The frames of the trajectory.
    Frames,
}

impl Signal {
    /// Whether any value was measured.
    pub fn is_known(&self) -> bool {
        self.values.iter().any(Option::is_some)
    }

    /// The sum of the normal forces on the robot at each frame, in newtons.
    pub(crate) fn contact_force(trajectory: &Trajectory) -> Self {
        let norm = |force: [f64; 3]| force.iter().map(|x| x * x).sum::<f64>().sqrt();
        let values = trajectory.frames.iter().map(|frame| {
            let on_robot = frame.contacts.iter().filter(|c| c.between != ContactBetween::ObjectAndSurroundings);
            Some(on_robot.map(|contact| norm(contact.force_n)).sum())
        });
        Self { name: "contact force".to_owned(), unit: "N".to_owned(), clock: Clock::Frames, values: values.collect() }
    }
}
