//! The settings of every task for an arm.

use robogate_core::{Allowed, SettingSpec, Value};
use robogate_physics::{Gripper, Robot, SuctionLaw};

use super::{CONTROL_PERIOD_S, forces};
use crate::settings::{Choice, Field, SettingRow};

/// The settings of every task for an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmSettings {
    /// Time limit of an episode, in seconds: an integer multiple of the control period.
    pub time_limit_s: f64,
    /// Normal force of each pad of the gripper, in newtons. `None` for the robot's own.
    pub grip_force_n: Option<f64>,
    /// How a suction cup holds a part.
    pub suction: SuctionLaw,
    /// Contact force above which a contact is a failure, in newtons. `None` for the robot's own.
    pub contact_force_limit_n: Option<f64>,
    /// Whether policies observe the force and torque at the wrist.
    pub wrist_sensor: WristSensor,
}

/// Whether the robot has a sensor of force and torque at its wrist.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum WristSensor {
    /// No sensor.
    #[default]
    Off,
    /// Policies observe [`robogate_core::vectors::WRIST_WRENCH`].
    On,
}

impl Choice for WristSensor {
    fn words(&self) -> &'static [&'static str] {
        &["off", "on"]
    }

    fn word(&self) -> &'static str {
        self.words()[*self as usize]
    }

    fn choose(&mut self, word: &str) {
        *self = if word == "on" { Self::On } else { Self::Off };
    }
}

impl ArmSettings {
    /// The default settings of a task with this time limit in seconds.
    pub(crate) const fn lasting(time_limit_s: f64) -> Self {
        Self {
            time_limit_s,
            grip_force_n: None,
            suction: SuctionLaw::Vacuum,
            contact_force_limit_n: None,
            wrist_sensor: WristSensor::Off,
        }
    }
}

/// A task with the settings of an arm.
pub(crate) trait OnArm {
    fn arm(&self) -> &ArmSettings;
    fn arm_mut(&mut self) -> &mut ArmSettings;

    /// The same task with the default of each setting.
    fn defaults(&self) -> Self
    where
        Self: Sized;
}

/// Implements [`OnArm`] and `Default` for a task with the field `arm` and the constant `DEFAULT`.
macro_rules! on_arm {
    ($task:ty) => {
        impl Default for $task {
            fn default() -> Self {
                Self::DEFAULT
            }
        }

        impl $crate::arm::OnArm for $task {
            fn arm(&self) -> &$crate::arm::ArmSettings {
                &self.arm
            }

            fn arm_mut(&mut self) -> &mut $crate::arm::ArmSettings {
                &mut self.arm
            }

            fn defaults(&self) -> Self {
                Self::DEFAULT
            }
        }
    };
}
pub(crate) use on_arm;

/// A task with a table of settings.
pub(crate) trait HasSettings: OnArm + Clone + Sized {
    /// Every setting: those of the arm, and those of the task.
    fn rows(&self) -> Vec<SettingRow<Self>>;
}

/// Names of the settings that depend on the gripper.
const GRIP_FORCE: &str = "grip_force_n";
const SUCTION: &str = "suction";
/// Name of the setting that depends on the arm.
const FORCE_LIMIT: &str = "contact_force_limit_n";

/// The settings of the arm, and `own` ones.
pub(crate) fn rows<T: OnArm>(own: impl IntoIterator<Item = SettingRow<T>>) -> Vec<SettingRow<T>> {
    let arm = [
        SettingRow::time_limit(CONTROL_PERIOD_S, |task: &mut T| &mut task.arm_mut().time_limit_s),
        SettingRow {
            name: GRIP_FORCE,
            meaning: "Normal force of each pad of the gripper.".into(),
            field: Field::OfRobot([0.0, 1e4], |task: &mut T| &mut task.arm_mut().grip_force_n),
        },
        SettingRow::choice(
            SUCTION,
            "How a suction cup holds a part: by a joint that never breaks (surface), or by pressure and friction up to \
             their limits (vacuum).",
            |task: &mut T| &mut task.arm_mut().suction,
        ),
        SettingRow {
            name: FORCE_LIMIT,
            meaning:
                "A contact of the robot with more force is a failure (struck). The force of a gripper that closes is \
                      added. Default: `collision_force_n` of the robot's file, or 150 N."
                    .into(),
            field: Field::OfRobot([1.0, 1e6], |task: &mut T| &mut task.arm_mut().contact_force_limit_n),
        },
        SettingRow::choice(
            "wrist_sensor",
            "Whether policies observe the force and torque at the wrist, as the vector wrist_wrench (on), or not (off).",
            |task: &mut T| &mut task.arm_mut().wrist_sensor,
        ),
    ];
    arm.into_iter().chain(own).collect()
}

/// The settings of a jam: force (N) and duration (s).
pub(crate) fn jam_rows<T>(force: fn(&mut T) -> &mut f64, duration: fn(&mut T) -> &mut f64) -> [SettingRow<T>; 2] {
    [
        SettingRow::number(
            "jam_force_n",
            "The robot presses if a contact force is above this. The grip force is added while it holds \
             the part.",
            [0.1, 1e6],
            force,
        ),
        SettingRow::number("jam_duration_s", "Duration of pressing that is a jam.", [1e-3, 3600.0], duration),
    ]
}

/// Whether a setting has an effect with this gripper.
pub(crate) fn has_effect(setting: &str, gripper: &Gripper) -> bool {
    match gripper {
        Gripper::ParallelJaw(_) => setting != SUCTION,
        Gripper::Suction(_) => setting != GRIP_FORCE,
    }
}

/// The declaration of a setting for a robot whose gripper holds with `grip_force_n` newtons. `None` if it has no effect there.
pub(crate) fn on_robot(spec: SettingSpec, robot: &Robot, grip_force_n: f64) -> Option<SettingSpec> {
    let gripper = &robot.settings.gripper;
    match gripper.jaw() {
        _ if !has_effect(&spec.name, gripper) => None,
        _ if *spec.name == *FORCE_LIMIT => {
            let chosen = match &spec.value {
                Some(Value::Number(newtons)) => Some(*newtons),
                _ => None,
            };
            Some(SettingSpec { value: Some(Value::Number(forces::limit_n(robot, chosen))), ..spec })
        }
        Some(jaw) if *spec.name == *GRIP_FORCE => Some(SettingSpec {
            allowed: Allowed::Continuous { low: 0.0, high: jaw.force_limit_n },
            value: Some(Value::Number(grip_force_n)),
            ..spec
        }),
        _ => Some(spec),
    }
}
