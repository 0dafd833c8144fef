//! The pendulum environment: a pole on a hinge with a motor, in MuJoCo.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use robogate_core::{
    Action, Command, Ending, Environment, FailureMode, Fault, FaultKind, Observation, Scenario, Start, Step,
    TaskInstance, TaskSpec, Trajectory,
};
use robogate_physics::MujocoModel;

use super::film::Film;
use super::parameters::{self, Applied, GRAVITY, Settings};
use super::{ANGLE, ENERGY, ERROR, FELL, OVERSPEED, PEAK_SPEED, Pendulum, SPEED};

/// Time between two actions, in seconds.
pub(super) const CONTROL_PERIOD_S: f64 = 0.02;
/// The engine's time step, in seconds. A control period has ten.
const TIME_STEP_S: f64 = 0.002;
const STEPS_PER_PERIOD: u32 = 10;

/// The pole has reached upright after this long within its tolerance, in seconds ...
const REACHED_S: f64 = 0.1;
/// ... and has fallen if it then exceeds this angle, in rad.
pub(super) const FALLEN_RAD: f64 = 0.6;

/// The test bench: a pole, a motor and a referee.
pub(super) struct Bench {
    task: Arc<TaskSpec>,
    rules: Pendulum,
    episode: Option<Episode>,
    /// The recorder of trajectories, if they are recorded.
    film: Option<Film>,
}

struct Episode {
    rules: Pendulum,
    model: MujocoModel,
    settings: Settings,
    ticks: u32,
    /// Time since which the pole is upright, in seconds.
    upright_since: Option<f64>,
    reached: bool,
    peak_speed: f64,
    energy: f64,
}

impl Bench {
    pub(super) fn new(task: Arc<TaskSpec>, rules: Pendulum) -> Self {
        Self { task, rules, episode: None, film: None }
    }
}

/// The MJCF model of an episode: hanging down at angle 0, rotating about the y axis.
fn mjcf(settings: &Settings) -> String {
    let Settings { mass, length, damping, torque_limit, gravity, .. } = settings;
    let g = GRAVITY * gravity;
    format!(
        r#"<mujoco model="pendulum">
  <option timestep="{TIME_STEP_S}" gravity="0 0 -{g}" integrator="implicitfast"/>
  <worldbody>
    <body name="pole" pos="0 0 1">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{damping}"/>
      <geom name="pole" type="capsule" fromto="0 0 0 0 0 -{length}" size="0.02" mass="{mass}" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="hinge" gear="{torque_limit}" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>"#
    )
}

/// The angle from upright, from -pi to pi.
pub(super) fn from_upright(angle: f64) -> f64 {
    angle.rem_euclid(TAU) - PI
}

impl Episode {
    fn angle(&self) -> f64 {
        self.model.data().qpos()[0]
    }

    fn speed(&self) -> f64 {
        self.model.data().qvel()[0]
    }

    fn observation(&self) -> Observation {
        Observation {
            time_s: f64::from(self.ticks) * CONTROL_PERIOD_S,
            vectors: vec![(ANGLE, vec![self.angle() + self.settings.bias]), (SPEED, vec![self.speed()])],
            images: Vec::new(),
        }
    }

    /// Advances one time step that ends at `time`. Returns the decisive event, if it occurred in this step.
    fn advance(&mut self, torque: f64, time: f64) -> Result<Option<Option<FailureMode>>, Fault> {
        self.model.data_mut().ctrl_mut()[0] = torque;
        self.model.step()?;
        let (error, speed) = (from_upright(self.angle()).abs(), self.speed().abs());
        self.peak_speed = self.peak_speed.max(speed);
        self.energy += (torque * self.settings.torque_limit * speed).abs() * TIME_STEP_S;
        if speed > self.rules.speed_limit_rad_s {
            return Ok(Some(Some(OVERSPEED)));
        }
        if error > self.rules.tolerance_rad {
            self.upright_since = None;
            return Ok((self.reached && error > FALLEN_RAD).then_some(Some(FELL)));
        }
        let held = time - *self.upright_since.get_or_insert(time);
        self.reached |= held >= REACHED_S;
        Ok((held >= self.rules.hold_s).then_some(None))
    }
}

impl Environment for Bench {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.episode = None;
        let settings = Settings::of(&scenario.requested)?;
        let mut model = MujocoModel::from_xml(&mjcf(&settings))?;
        model.data_mut().qpos_mut()[0] = settings.start;
        model.data_mut().forward();
        let applied = parameters::applied(&scenario.requested, &Applied { model: &model, bias: settings.bias });
        let episode = Episode {
            rules: self.rules,
            model,
            settings,
            ticks: 0,
            upright_since: None,
            reached: false,
            peak_speed: 0.0,
            energy: 0.0,
        };
        let observation = episode.observation();
        if let Some(film) = &mut self.film {
            film.start(episode.settings.length, episode.angle());
        }
        self.episode = Some(episode);
        let instance = TaskInstance { instruction: self.task.instruction.clone(), details: serde_json::Value::Null };
        Ok(Start { instance, observation, applied })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let (Some(mut episode), Command::Vector(command)) = (self.episode.take(), &action.command) else {
            return Err(Fault::new(FaultKind::Setup, "no episode is running, or the action is not a vector"));
        };
        let torque = command.first().copied().unwrap_or_default();
        let begun = f64::from(episode.ticks) * CONTROL_PERIOD_S;
        let mut ending = None;
        for k in 1..=STEPS_PER_PERIOD {
            let time_s = begun + f64::from(k) * TIME_STEP_S;
            if let Some(failure) = episode.advance(torque, time_s)? {
                ending = Some(Ending { failure, time_s, contact: None });
                break;
            }
        }
        episode.ticks += 1;
        if let Some(film) = &mut self.film {
            film.note(f64::from(episode.ticks) * CONTROL_PERIOD_S, episode.angle(), ending.is_some());
        }
        let step = Step {
            observation: episode.observation(),
            measures: [
                (PEAK_SPEED, Some(episode.peak_speed)),
                (ENERGY, Some(episode.energy)),
                (ERROR, Some(from_upright(episode.angle()).abs())),
            ]
            .into_iter()
            .collect(),
            events: ending.iter().map(|_| format!("{:.2} rad from upright", from_upright(episode.angle()))).collect(),
            state_hash: episode.model.state_hash(),
            ending,
        };
        if step.ending.is_none() {
            self.episode = Some(episode);
        }
        Ok(step)
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.film = period_s.map(Film::new);
    }

    fn take_trajectory(&mut self) -> Option<Trajectory> {
        self.film.as_mut()?.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upright_is_half_a_rotation() {
        assert!(
            from_upright(PI).abs() < 1e-12 && from_upright(-PI).abs() < 1e-12 && from_upright(3.0 * PI).abs() < 1e-12
        );
        assert!((from_upright(0.0).abs() - PI).abs() < 1e-12);
        assert!((from_upright(PI + 0.1) - 0.1).abs() < 1e-12);
    }
}
