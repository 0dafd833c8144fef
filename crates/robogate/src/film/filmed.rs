//! An environment that renders while an episode runs.

use std::sync::Arc;

use robogate_core::{
    Action, Assignment, Ending, Environment, Fault, Foresight, Image, Infeasibility, Measures, Scenario, Start, Step,
    TaskSpec, Trajectory,
};

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
    /// All of them.
    All,
}

/// An environment that renders cameras after each control period, or at given times. The episode does not change.
pub(crate) struct Filmed<'a> {
    inner: &'a mut dyn Environment,
    cameras: Cameras,
    /// The times of the images that are still missing, the latest first. `None` films after each control period.
    due: Option<Vec<f64>>,
    /// The images so far, in order of time.
    pub(crate) shots: Vec<Shot>,
    /// The first error of rendering. Later images are not requested.
    pub(crate) trouble: Option<Fault>,
}

impl<'a> Filmed<'a> {
    /// Films after each control period.
    pub(crate) fn new(inner: &'a mut dyn Environment, cameras: Cameras) -> Self {
        Self { inner, cameras, due: None, shots: Vec::new(), trouble: None }
    }

    /// Films at the ends of the control periods that contain these times, ascending and in seconds.
    pub(crate) fn at(inner: &'a mut dyn Environment, cameras: Cameras, times: &[f64]) -> Self {
        let due = times.iter().rev().copied().collect();
        Self { inner, cameras, due: Some(due), shots: Vec::new(), trouble: None }
    }

    /// The images of one camera: the named one, or the first.
    pub(crate) fn of(&self, camera: Option<&str>) -> Vec<&Shot> {
        let first = self.shots.first().map(|shot| shot.image.camera.as_str());
        let Some(camera) = camera.or(first) else { return Vec::new() };
        self.shots.iter().filter(|shot| shot.image.camera == camera).collect()
    }

    fn expose(&mut self, time_s: f64) {
        if self.trouble.is_some() {
            return;
        }
        if let Some(due) = &mut self.due {
            if due.last().is_none_or(|next| time_s < next - 1e-9) {
                return;
            }
            while due.pop_if(|next| *next <= time_s + 1e-9).is_some() {}
        }
        match self.inner.render() {
            Ok(images) => {
                let mut images = images.into_iter();
                match &self.cameras {
                    Cameras::First => self.shots.extend(images.next().map(|image| Shot { time_s, image })),
                    Cameras::Named(camera) => {
                        let image = images.find(|image| image.camera == *camera);
                        self.shots.extend(image.map(|image| Shot { time_s, image }));
                    }
                    Cameras::All => self.shots.extend(images.map(|image| Shot { time_s, image })),
                }
            }
            Err(fault) => self.trouble = Some(fault),
        }
    }
}

impl Environment for Filmed<'_> {
    fn task(&self) -> &Arc<TaskSpec> {
        self.inner.task()
    }

    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        self.inner.draws(scenario)
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.inner.foresight()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let start = self.inner.reset(scenario)?;
        self.shots.clear();
        self.expose(0.0);
        Ok(start)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let step = self.inner.step(action)?;
        self.expose(step.observation.time_s);
        Ok(step)
    }

    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.inner.infeasibility(requested)
    }

    fn foregone_ending(&self) -> Option<Ending> {
        self.inner.foregone_ending()
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        self.inner.render()
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.inner.record_trajectory(period_s);
    }

    fn take_trajectory(&mut self) -> Option<Trajectory> {
        self.inner.take_trajectory()
    }
}
