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

/// An environment that renders one camera after each control period. The episode does not change.
pub(crate) struct Filmed<'a> {
    inner: &'a mut dyn Environment,
    camera: Option<String>,
    /// The images so far.
    pub(crate) shots: Vec<Shot>,
    /// The first error of rendering. Later images are not requested.
    pub(crate) trouble: Option<Fault>,
}

impl<'a> Filmed<'a> {
    /// Films with this camera, or with the first one.
    pub(crate) fn new(inner: &'a mut dyn Environment, camera: Option<String>) -> Self {
        Self { inner, camera, shots: Vec::new(), trouble: None }
    }

    fn expose(&mut self, time_s: f64) {
        if self.trouble.is_some() {
            return;
        }
        match self.inner.render() {
            Ok(images) => {
                let mut images = images.into_iter();
                let image = images.find(|image| self.camera.as_ref().is_none_or(|camera| image.camera == *camera));
                self.shots.extend(image.map(|image| Shot { time_s, image }));
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
