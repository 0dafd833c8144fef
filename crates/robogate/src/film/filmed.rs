//! An environment that renders while an episode runs.

use std::sync::Arc;

use robogate_core::{Action, Environment, Fault, Image, Scenario, Start, Step, TaskSpec};
use robogate_replay::FRAME_PERIOD_S;

/// An image with its time.
#[derive(Debug, Clone)]
pub(crate) struct Shot {
    /// Simulated time in seconds.
    pub(crate) time_s: f64,
    /// The image.
    pub(crate) image: Image,
}

/// The cameras that are filmed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Cameras {
    /// The first one of the environment.
    First,
    /// The one with this name.
    Named(String),
    /// All of them, or the first [`MOST`] of more.
    All,
}

/// The largest number of cameras that are filmed at a time.
const MOST: usize = 4;

impl Cameras {
    /// The names of the cameras of an environment that are filmed.
    fn of(&self, environment: &dyn Environment) -> Vec<String> {
        let names = environment.task().observation.cameras.iter().map(|camera| camera.name.clone());
        match self {
            Self::First => names.take(1).collect(),
            Self::Named(camera) => vec![camera.clone()],
            Self::All => names.take(MOST).collect(),
        }
    }
}

/// An environment that renders cameras up to 30 times per second, or at given times. The episode does not change.
pub(crate) struct Filmed<'a> {
    inner: &'a mut dyn Environment,
    /// The names of the cameras that are filmed.
    wanted: Vec<String>,
    /// The times of the images that are still missing, the latest first. `None` films up to 30 times per second.
    due: Option<Vec<f64>>,
    /// The images so far, in order of time.
    pub(crate) shots: Vec<Shot>,
    /// The first error of rendering. Later images are not requested.
    pub(crate) trouble: Option<Fault>,
}

impl<'a> Filmed<'a> {
    /// Films up to 30 times per second, and the last state.
    pub(crate) fn new(inner: &'a mut dyn Environment, cameras: Cameras) -> Self {
        Self { wanted: cameras.of(inner), inner, due: None, shots: Vec::new(), trouble: None }
    }

    /// Films at the ends of the control periods that contain these times, ascending and in seconds.
    pub(crate) fn at(inner: &'a mut dyn Environment, cameras: Cameras, times: &[f64]) -> Self {
        let due = times.iter().rev().copied().collect();
        Self { wanted: cameras.of(inner), inner, due: Some(due), shots: Vec::new(), trouble: None }
    }

    /// The images of one camera: the named one, or the first.
    pub(crate) fn of(&self, camera: Option<&str>) -> Vec<&Shot> {
        let first = self.shots.first().map(|shot| shot.image.camera.as_str());
        let Some(camera) = camera.or(first) else { return Vec::new() };
        self.shots.iter().filter(|shot| shot.image.camera == camera).collect()
    }

    /// Films the state at a time, if an image of it is due.
    fn expose(&mut self, time_s: f64, ended: bool) {
        // A server without cameras ends the episode when it is asked for images.
        if self.trouble.is_some() || self.wanted.is_empty() {
            return;
        }
        if let Some(due) = &mut self.due {
            if due.last().is_none_or(|next| time_s < next - 1e-9) {
                return;
            }
            while due.pop_if(|next| *next <= time_s + 1e-9).is_some() {}
        } else if !ended && self.shots.last().is_some_and(|last| time_s < last.time_s + FRAME_PERIOD_S - 1e-9) {
            return;
        }
        let wanted: Vec<&str> = self.wanted.iter().map(String::as_str).collect();
        match self.inner.render_only(&wanted) {
            Ok(images) => self.shots.extend(images.into_iter().map(|image| Shot { time_s, image })),
            Err(fault) => self.trouble = Some(fault),
        }
    }
}

impl Environment for Filmed<'_> {
    fn adapted(&self) -> Option<&dyn Environment> {
        Some(&*self.inner)
    }

    fn adapted_mut(&mut self) -> Option<&mut dyn Environment> {
        Some(&mut *self.inner)
    }

    fn task(&self) -> &Arc<TaskSpec> {
        self.inner.task()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let start = self.inner.reset(scenario)?;
        self.shots.clear();
        self.expose(0.0, false);
        Ok(start)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let step = self.inner.step(action)?;
        self.expose(step.observation.time_s, step.ending.is_some());
        // A server need not render the final state.
        if step.ending.is_some() && !self.shots.is_empty() {
            self.trouble = None;
        }
        Ok(step)
    }
}
