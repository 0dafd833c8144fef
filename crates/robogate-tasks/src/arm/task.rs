//! A task for an arm, as the command selects it.

#[cfg(feature = "mujoco")]
use std::num::NonZeroUsize;
use std::sync::Arc;

use robogate_core::{
    Assignment, Environment, Fault, ParameterSpace, Policy, SettingSpec, Suite, TaskInstance, TaskSpec,
};
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "mujoco")]
use robogate_physics::worlds::Member;
use robogate_physics::{Chain, Engine, Gripper, Robot};

use super::rules::Rules;
use super::settings::has_effect;
#[cfg(feature = "mujoco")]
use super::ArmWorlds;
use super::{ArmEnvironment, HasSettings, Rig};
use crate::settings::{setting_specs, with_settings};

/// A built-in task for an arm in the cell. The user chooses robot and engine.
pub trait ArmTask: Send + Sync {
    /// The name on the command line, as in the declaration.
    fn name(&self) -> &'static str;

    /// A short description.
    fn summary(&self) -> &'static str;

    /// The name of the parameter space for a robot with this gripper.
    fn space(&self, gripper: &Gripper) -> &'static str;

    /// The name of the distribution of units of a robot with this gripper.
    fn unit_space(&self, gripper: &Gripper) -> &'static str;

    /// The name of the task's built-in suite.
    fn suite(&self) -> &'static str;

    /// The problems of a space with this gripper that the declared ranges do not show.
    ///
    /// # Errors
    /// The first problem.
    fn check_space(&self, space: &ParameterSpace, gripper: &Gripper) -> Result<(), String>;

    /// As [`Self::check_space`], all problems of a suite.
    fn check_suite(&self, suite: &Suite, gripper: &Gripper) -> Vec<String>;

    /// The name of the parameter space of demonstrations with this gripper.
    fn demonstration_space(&self, gripper: &Gripper) -> &'static str;

    /// The part that the gripper picks first, for demonstrations: position of its centre and edge, in metres.
    ///
    /// # Errors
    /// A setup fault if the details are not those of this task.
    fn first_part(&self, instance: &TaskInstance) -> Result<[f64; 4], Fault>;

    /// The controller that moves the tool in small steps. `None` if the task has none.
    fn tool_expert(&self, robot: Robot) -> Option<Box<dyn Policy>>;

    /// The reason why engines that only compute physics cannot run the task.
    ///
    /// # Errors
    /// The reason.
    fn physics_only(&self) -> Result<(), &'static str>;

    /// The settings, with the values of this task.
    fn settings(&self) -> Vec<SettingSpec>;

    /// Whether a setting has an effect with this gripper.
    fn has_effect(&self, setting: &str, gripper: &Gripper) -> bool {
        has_effect(setting, gripper)
    }

    /// The settings of the published paper for this gripper. Empty if the task is not in it.
    fn published(&self, gripper: &Gripper) -> Assignment;

    /// The same task with these values of its settings.
    ///
    /// # Errors
    /// A setting that the task does not have, or a value that it does not accept. The error names what is accepted.
    fn with(&self, settings: &Assignment) -> Result<Arc<dyn ArmTask>, String>;

    /// Creates an environment on this engine.
    ///
    /// # Errors
    /// If the control period is not an integer multiple of the engine's time step, or the gripper cannot apply the grip
    /// force.
    fn environment(&self, engine: Box<dyn Engine>, rig: Rig) -> Result<Box<dyn Environment>, String> {
        Ok(Box::new(self.on(engine, rig)?))
    }

    /// As [`Self::environment`], with access to the engine.
    ///
    /// # Errors
    /// As [`Self::environment`].
    fn on(&self, engine: Box<dyn Engine>, rig: Rig) -> Result<ArmEnvironment, String>;

    /// Creates an environment of many worlds in a simulator, with this many slots.
    ///
    /// # Errors
    /// As [`Self::environment`], or if the robot has a part that such worlds cannot simulate.
    #[cfg(feature = "mujoco")]
    fn worlds(&self, engine: MujocoEngine, rig: Rig, member: Member, slots: NonZeroUsize)
    -> Result<ArmWorlds, String>;

    /// The scripted controller for a robot with these kinematics.
    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy>;
}

impl<R: Rules + HasSettings + 'static> ArmTask for R {
    fn name(&self) -> &'static str {
        Rules::name(self)
    }

    fn summary(&self) -> &'static str {
        Rules::summary(self)
    }

    fn space(&self, gripper: &Gripper) -> &'static str {
        Rules::space(self, gripper)
    }

    fn unit_space(&self, gripper: &Gripper) -> &'static str {
        Rules::unit_space(self, gripper)
    }

    fn suite(&self) -> &'static str {
        Rules::suite(self)
    }

    fn check_space(&self, space: &ParameterSpace, gripper: &Gripper) -> Result<(), String> {
        Rules::check_space(self, space, gripper)
    }

    fn check_suite(&self, suite: &Suite, gripper: &Gripper) -> Vec<String> {
        Rules::check_suite(self, suite, gripper)
    }

    fn demonstration_space(&self, gripper: &Gripper) -> &'static str {
        Rules::demonstration_space(self, gripper)
    }

    fn first_part(&self, instance: &TaskInstance) -> Result<[f64; 4], Fault> {
        Rules::first_part(self, instance)
    }

    fn tool_expert(&self, robot: Robot) -> Option<Box<dyn Policy>> {
        Rules::tool_expert(self, robot)
    }

    fn physics_only(&self) -> Result<(), &'static str> {
        Rules::physics_only(self)
    }

    fn settings(&self) -> Vec<SettingSpec> {
        setting_specs(&R::rows(), self)
    }

    fn published(&self, gripper: &Gripper) -> Assignment {
        Rules::published(self, gripper)
    }

    fn with(&self, settings: &Assignment) -> Result<Arc<dyn ArmTask>, String> {
        Ok(Arc::new(with_settings(Rules::name(self), &R::rows(), self, settings)?))
    }

    fn on(&self, engine: Box<dyn Engine>, rig: Rig) -> Result<ArmEnvironment, String> {
        ArmEnvironment::new(self, engine, rig)
    }

    #[cfg(feature = "mujoco")]
    fn worlds(
        &self,
        engine: MujocoEngine,
        rig: Rig,
        member: Member,
        slots: NonZeroUsize,
    ) -> Result<ArmWorlds, String> {
        ArmWorlds::new(self, engine, rig, member, slots)
    }

    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy> {
        self.scripted(robot, chain)
    }
}

/// Checks that a scripted controller of the task `name` for this robot drives `task`.
pub(crate) fn drives_task(name: &str, robot: &Robot, task: &TaskSpec) -> Result<(), String> {
    if task.name != *name || task.action.joints() != Some(&*robot.settings.arm.joints) {
        return Err(format!("the scripted controller drives {name} on {}, not {}", robot.name(), task.name));
    }
    Ok(())
}
