//! The task as an environment on an engine in this process.

use std::sync::Arc;

use robogate_camera::{Cameras, Renderer};
use robogate_core::{
    Action, Assignment, Ending, Environment, Fault, Foresight, Image, Infeasibility, Scenario, Start, Step, TaskSpec,
    Trajectory,
};
use robogate_physics::{Engine, GripperCommand, Plant, SuctionLaw, Visual};

use super::Rules;
use super::cell::{CONTROL_PERIOD_S, ResolvedCell};
use super::foresight::PickPlaceForesight;
use super::judge::{Acting, Judge};
use super::spec::spec;
use crate::arm::{Film, camera_specs, posture, render};

/// The task: pick an object from the table and place it at the target.
pub struct PickPlace<E> {
    task: Arc<TaskSpec>,
    plant: Plant<E>,
    judge: Judge,
    foresight: Arc<PickPlaceForesight>,
    /// The cameras, or the reason why the robot cannot be rendered.
    cameras: Result<Cameras, String>,
    /// A renderer that replaces the cameras.
    renderer: Option<Box<dyn Renderer<E>>>,
    /// The recorder of trajectories, if they are recorded.
    film: Option<Film>,
}

impl<E: Engine> PickPlace<E> {
    /// Creates the task on this engine. `grip_force_n` replaces the robot's setting. A suction cup uses the vacuum law
    /// unless [`Self::with_suction`] changes it.
    ///
    /// # Errors
    /// If the control period is not an integer multiple of the engine's time step, or the gripper cannot apply the grip
    /// force.
    pub fn new(engine: E, grip_force_n: Option<f64>) -> Result<Self, String> {
        let plant = Plant::new(engine, CONTROL_PERIOD_S, grip_force_n)?;
        let judge = Judge::new(plant.engine.robot().clone(), plant.engine.chain().clone(), plant.grip_force_n());
        let cameras = Cameras::new(plant.engine.robot());
        let task = Arc::new(spec(plant.engine.robot(), camera_specs(&cameras), judge.rules()));
        let foresight = Arc::new(judge.foresight());
        Ok(Self { task, plant, judge, foresight, cameras, renderer: None, film: None })
    }

    /// The same task with this law for its suction cup.
    #[must_use]
    pub fn with_suction(mut self, law: SuctionLaw) -> Self {
        self.plant = self.plant.with_suction(law);
        self.judge.set_suction(law);
        self
    }

    /// The same task with images of this size in pixels.
    #[must_use]
    pub fn with_picture_size(mut self, width: usize, height: usize) -> Self {
        self.cameras = self.cameras.map(|cameras| cameras.with_size(width, height));
        self.declare();
        if let Some(renderer) = &mut self.renderer {
            renderer.resize(width, height);
        }
        self
    }

    /// The same task under these rules.
    ///
    /// # Errors
    /// If a rule is out of range.
    pub fn with_rules(mut self, rules: Rules) -> Result<Self, String> {
        rules.check()?;
        self.judge.set_rules(rules);
        self.declare();
        Ok(self)
    }

    fn declare(&mut self) {
        self.task = Arc::new(spec(self.plant.engine.robot(), camera_specs(&self.cameras), self.judge.rules()));
        self.foresight = Arc::new(self.judge.foresight());
    }

    /// The same task with this renderer.
    #[must_use]
    pub fn with_renderer(mut self, renderer: Box<dyn Renderer<E>>) -> Self {
        self.renderer = Some(renderer);
        self
    }

    /// The engine.
    pub fn engine(&self) -> &E {
        &self.plant.engine
    }

    fn run(&mut self, action: &Action) -> Result<Step, Fault> {
        let Self { plant, judge, film, .. } = self;
        let command = judge.command(action)?;
        plant.run(&command, GripperCommand::of(action), &mut |engine, view| {
            judge.observe(view);
            if let Some(film) = film {
                film.observe(engine, view);
            }
        })?;
        if let Some(film) = film {
            film.end_period(&plant.engine);
        }
        let clearance = plant.engine.clearance_below(judge.clearance_bound());
        judge.finish(plant.arm_state(), clearance, plant.state_hash(), |body| plant.engine.robot_body(body))
    }
}

impl<E: Engine> Environment for PickPlace<E> {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        Some(Arc::clone(&self.foresight) as Arc<dyn Foresight>)
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let Self { plant, judge, cameras, renderer, film, .. } = self;
        match (renderer.as_mut(), cameras.as_mut()) {
            (Some(renderer), _) => renderer.clear(),
            (None, Ok(cameras)) => cameras.clear(),
            (None, Err(_)) => {}
        }
        let cell = judge.resolve(scenario)?;
        plant.load(&cell.scene, cell.parameters.grip_threshold_m)?;
        let visual = match renderer {
            Some(renderer) => renderer.set_up(&plant.engine, &cell.scene),
            None => show(cameras, &cell),
        };
        if let (Some(film), Ok(cameras)) = (film, cameras) {
            // Another renderer does not set the cameras up, which know the geometry.
            cameras.set_up(&cell.scene);
            film.start(&plant.engine, &cell.scene);
        }
        let engine = plant.engine.read_back()?;
        let acting = Acting {
            engine: &engine,
            visual: &visual,
            grip_threshold_m: plant.grip_threshold_m(),
            grip_force_scale: plant.grip_force_scale(),
        };
        judge.start(scenario, cell, acting, plant.engine.touches(), plant.arm_state())
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let step = self.run(action);
        if step.is_err() {
            self.judge.abandon();
        }
        step
    }

    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.judge.infeasibility(requested)
    }

    fn foregone_ending(&self) -> Option<Ending> {
        self.judge.foregone_ending()
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let engine = &self.plant.engine;
        if let Some(renderer) = &mut self.renderer {
            return renderer.render(engine);
        }
        render(&self.cameras, |bodies| posture(engine, bodies))
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.film = period_s.map(|period_s| Film::new(period_s, CONTROL_PERIOD_S));
    }

    fn take_trajectory(&mut self) -> Option<Trajectory> {
        self.film.as_mut()?.take(self.cameras.as_ref().ok()?)
    }
}

/// Sets up a cell for the cameras and returns its appearance as the cameras have it. If the robot cannot be rendered,
/// no camera shows the cell, and the requested values are returned.
pub(crate) fn show(cameras: &mut Result<Cameras, String>, cell: &ResolvedCell) -> Visual {
    match cameras {
        Ok(cameras) => {
            cameras.set_up(&cell.scene);
            cameras.visual().unwrap_or(cell.scene.visual)
        }
        Err(_) => cell.scene.visual,
    }
}
