//! The settings of every task for an arm.

use robogate_core::{Allowed, SettingSpec, Value};
use robogate_physics::{Gripper, Robot, SuctionLaw};

use super::{CONTROL_PERIOD_S, forces};
use crate::settings::{Field, SettingRow};

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
}

impl ArmSettings {
    /// The default settings of a task with this time limit in seconds.
    pub(crate) const fn lasting(time_limit_s: f64) -> Self {
        Self { time_limit_s, grip_force_n: None, suction: SuctionLaw::Vacuum, contact_force_limit_n: None }
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
    fn rows() -> Vec<SettingRow<Self>>;
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
            meaning: "Normal force of each pad of the gripper.",
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
            meaning: "A contact of the robot with more force is a failure (struck). The force of a gripper that closes is \
                      added. Default: `collision_force_n` of the robot's file, or 150 N.",
            field: Field::OfRobot([1.0, 1e6], |task: &mut T| &mut task.arm_mut().contact_force_limit_n),
        },
    ];
    arm.into_iter().chain(own).collect()
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
