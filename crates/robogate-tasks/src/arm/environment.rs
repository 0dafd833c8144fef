//! A task for an arm as an environment on an engine in this process.

use std::sync::Arc;

use robogate_camera::{Cameras, Renderer, SIZE_PX};
use robogate_core::{
    Action, Assignment, Ending, Environment, Fault, Foresight, Image, Infeasibility, Scenario, Start, Step, TaskSpec,
    Trajectory,
};
use robogate_physics::{Engine, GripperCommand, Plant, Robot, Scene, Visual};

use super::forces::no_wrist_sensor;
use super::judge::Judge;
use super::rules::{Found, Rules};
use super::{Film, HasSettings, camera_specs, posture, render};

/// Distance to the part within which a suction cup takes hold, in metres.
pub(crate) const GRIP_THRESHOLD_M: f64 = 0.01;

/// Time between two actions, in seconds (paper, section 4.1).
pub const CONTROL_PERIOD_S: f64 = 0.05;

/// The choices for an environment that do not depend on the task.
pub struct Rig {
    /// Width and height of the camera images, in pixels.
    pub picture_px: [usize; 2],
    /// A renderer that replaces the embedded one.
    pub renderer: Option<Box<dyn Renderer>>,
}

impl Default for Rig {
    fn default() -> Self {
        Self { picture_px: [SIZE_PX; 2], renderer: None }
    }
}

/// A task for an arm as an environment.
pub struct ArmEnvironment {
    plant: Plant<Box<dyn Engine>>,
    judge: Judge,
    /// The cameras, or the reason why the robot cannot be rendered.
    cameras: Result<Cameras, String>,
    /// A renderer that replaces the cameras.
    renderer: Option<Box<dyn Renderer>>,
    /// The recorder of trajectories, if they are recorded.
    film: Option<Film>,
}

impl ArmEnvironment {
    /// Creates the task on this engine, see [`super::ArmTask::environment`].
    pub(crate) fn new<T: Rules + HasSettings + 'static>(
        task: &T,
        engine: Box<dyn Engine>,
        rig: Rig,
    ) -> Result<Self, String> {
        let Rig { picture_px, mut renderer } = rig;
        let settings = task.arm();
        if engine.build().name != "mujoco" {
            no_wrist_sensor(settings)?;
        }
        let plant = Plant::new(engine, CONTROL_PERIOD_S, settings.grip_force_n)?.with_suction(settings.suction);
        let (robot, chain) = (plant.engine.robot().clone(), plant.engine.chain().clone());
        let cameras = cameras(&robot, picture_px);
        if let Some(renderer) = &mut renderer {
            renderer.resize(picture_px[0], picture_px[1]);
        }
        let judge = Judge::new(task, (robot, chain), plant.grip_force_n(), camera_specs(&cameras));
        Ok(Self { plant, judge, cameras, renderer, film: None })
    }

    /// The engine.
    pub fn engine(&self) -> &dyn Engine {
        &*self.plant.engine
    }

    fn run(&mut self, action: &Action) -> Result<Step, Fault> {
        let Self { plant, judge, film, .. } = self;
        let command = judge.command(action)?;
        if let Some(body) = judge.select(&plant.engine.tcp(), &plant.engine) {
            plant.select(body);
        }
        plant.run(&command, GripperCommand::of(action), &mut |engine, view| {
            judge.observe(view, engine);
            if let Some(film) = film {
                film.observe(engine, view);
            }
        })?;
        if let Some(film) = film {
            film.end_period(&plant.engine);
        }
        let clearance = judge.clearance_bound().and_then(|bound| plant.engine.clearance_below(bound));
        judge.finish(plant.arm_state(), clearance, plant.state_hash(), |body| plant.engine.robot_body(body))
    }
}

impl Environment for ArmEnvironment {
    fn task(&self) -> &Arc<TaskSpec> {
        self.judge.task()
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.judge.foresight()
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let Self { plant, judge, cameras, renderer, film } = self;
        match (renderer.as_mut(), cameras.as_mut()) {
            (Some(renderer), _) => renderer.clear(),
            (None, Ok(cameras)) => cameras.clear(),
            (None, Err(_)) => {}
        }
        let resolved = judge.resolve(scenario)?;
        plant.load(&resolved.scene, resolved.grip_threshold_m)?;
        let visual = match renderer {
            Some(renderer) => renderer.set_up(&resolved.scene),
            None => show(cameras, &resolved.scene),
        };
        if let (Some(film), Ok(cameras)) = (film, cameras) {
            // Another renderer does not set the cameras up, which know the geometry.
            cameras.set_up(&resolved.scene);
            film.start(&plant.engine, &resolved.scene);
        }
        let found = Found {
            engine: &plant.engine.read_back()?,
            visual: &visual,
            grip_threshold_m: plant.grip_threshold_m(),
            grip_force_scale: Some(plant.acting_force_n() / plant.grip_force_n()),
        };
        judge.start(scenario, resolved, &found, plant.engine.touches(), plant.arm_state())
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
            return renderer.render(&**engine);
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

/// The cameras of this robot with images of this size, or the reason why it cannot be rendered.
pub(crate) fn cameras(robot: &Robot, [width, height]: [usize; 2]) -> Result<Cameras, String> {
    Cameras::new(robot).map(|cameras| cameras.with_size(width, height))
}

/// Sets up a scene for the cameras and returns its appearance as the cameras have it. If the robot cannot be rendered,
/// no camera shows the scene, and the requested values are returned.
pub(crate) fn show(cameras: &mut Result<Cameras, String>, scene: &Scene) -> Visual {
    match cameras {
        Ok(cameras) => {
            cameras.set_up(scene);
            cameras.visual().unwrap_or(scene.visual)
        }
        Err(_) => scene.visual,
    }
}
