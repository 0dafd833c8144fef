//! The pendulum task: swing a hanging pole upright with a motor that is too weak to lift it directly, and hold it
//! there.
//!
//! A small task without a robot, with separate failure modes, measures and actions. It is the shortest example of a
//! built-in task.

mod controller;
mod environment;
mod film;
mod parameters;

use std::sync::Arc;

use robogate_core::{
    ActionSpace, ActionSpec, Assignment, Better, Environment, FailureMode, FailureModeSpec, Fault, MeasureSpec,
    ObservationSpec, Policy, SettingSpec, Severity, TaskSpec, VectorSpec, Word,
};
use robogate_physics::{EngineBuild, MujocoModel};

use self::controller::SwingUp;
use self::environment::{Bench, CONTROL_PERIOD_S, FALLEN_RAD};
use crate::SelfContained;
use crate::settings::{SettingRow, setting_specs, with_settings};

/// The pole was upright and fell again.
const FELL: FailureMode = FailureMode::constant("fell");
/// The pole exceeded the speed limit.
const OVERSPEED: FailureMode = FailureMode::constant("overspeed");

const PEAK_SPEED: Word = Word::constant("peak_speed_rad_s");
const ENERGY: Word = Word::constant("energy_j");
const ERROR: Word = Word::constant("upright_error_rad");

const ANGLE: Word = Word::constant("angle");
const SPEED: Word = Word::constant("speed");

const SWING: Word = Word::constant("swing");
const BALANCE: Word = Word::constant("balance");

/// The pendulum swing-up task.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pendulum {
    /// Time limit of an episode, in seconds.
    pub time_limit_s: f64,
    /// The pole counts as upright within this angle, in radians ...
    pub tolerance_rad: f64,
    /// ... and the episode succeeds after it has been upright for this long, in seconds.
    pub hold_s: f64,
    /// The largest speed that the bench allows, in rad/s.
    pub speed_limit_rad_s: f64,
}

impl Pendulum {
    /// The task with its default settings.
    pub const DEFAULT: Self = Self { time_limit_s: 10.0, tolerance_rad: 0.2, hold_s: 0.5, speed_limit_rad_s: 25.0 };

    fn rows() -> [SettingRow<Self>; 4] {
        [
            SettingRow::time_limit(CONTROL_PERIOD_S, |task: &mut Self| &mut task.time_limit_s),
            SettingRow::number(
                "tolerance_rad",
                "The pole is upright within this angle.",
                [1e-3, FALLEN_RAD],
                |task: &mut Self| &mut task.tolerance_rad,
            ),
            SettingRow::number(
                "hold_s",
                "The episode succeeds after the pole has been upright for this long.",
                [CONTROL_PERIOD_S, 3600.0],
                |task| &mut task.hold_s,
            ),
            SettingRow::number(
                "speed_limit_rad_s",
                "The largest speed of the pole that the bench allows.",
                [0.1, 1000.0],
                |task| &mut task.speed_limit_rad_s,
            ),
        ]
    }
}

impl Default for Pendulum {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl SelfContained for Pendulum {
    fn name(&self) -> &'static str {
        "pendulum"
    }

    fn summary(&self) -> &'static str {
        "swing a hanging pole upright with a weak motor and hold it there"
    }

    fn task(&self) -> Arc<TaskSpec> {
        let mode = |name, meaning: &str, severity| FailureModeSpec {
            name,
            meaning: meaning.to_owned(),
            severity,
            published_as: None,
        };
        let measure = |name, unit: &str, meaning: &str| MeasureSpec {
            name,
            unit: unit.to_owned(),
            meaning: meaning.to_owned(),
            better: Better::Lower,
        };
        let vector = |name, unit: &str| VectorSpec { name, length: 1, unit: unit.to_owned() };
        Arc::new(TaskSpec {
            name: Word::constant("pendulum"),
            version: 1,
            instruction: "swing the pole upright and hold it there".to_owned(),
            control_period_s: CONTROL_PERIOD_S,
            time_limit_s: self.time_limit_s,
            failure_modes: vec![
                mode(FELL, "The pole was upright and came down again.", Severity::Major),
                mode(OVERSPEED, "The pole turned faster than the bench allows.", Severity::Critical),
                mode(FailureMode::TIMEOUT, "The pole was never held upright.", Severity::Minor),
            ],
            measures: vec![
                measure(PEAK_SPEED, "rad/s", "Largest speed of the pole."),
                measure(ENERGY, "J", "Work that the motor did, in both directions."),
                measure(ERROR, "rad", "Distance of the pole from upright at the end."),
            ],
            draws: Vec::new(),
            phases: vec![SWING, BALANCE],
            stages: Vec::new(),
            parameters: parameters::specs(),
            settings: self.settings(),
            observation: ObservationSpec {
                vectors: vec![vector(ANGLE, "rad"), vector(SPEED, "rad/s")],
                cameras: Vec::new(),
            },
            action: ActionSpec {
                spaces: vec![ActionSpace::Vector {
                    names: vec!["torque".to_owned()],
                    low: vec![-1.0],
                    high: vec![1.0],
                }],
                gripper: None,
            },
            details: serde_json::Value::Null,
        })
    }

    fn settings(&self) -> Vec<SettingSpec> {
        setting_specs(&Self::rows(), Self::DEFAULT, self)
    }

    fn with(&self, settings: &Assignment) -> Result<Arc<dyn SelfContained>, String> {
        Ok(Arc::new(with_settings(self.name(), &Self::rows(), self, settings)?))
    }

    fn space(&self) -> &'static str {
        include_str!("space.toml")
    }

    fn engine(&self) -> Result<EngineBuild, Fault> {
        MujocoModel::build()
    }

    fn environment(&self) -> Result<Box<dyn Environment>, Fault> {
        Ok(Box::new(Bench::new(self.task(), *self)))
    }

    fn controller(&self) -> Box<dyn Policy> {
        Box::new(SwingUp)
    }
}
