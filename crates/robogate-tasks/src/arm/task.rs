//! A task for an arm, as the command selects it.

use std::collections::BTreeMap;
#[cfg(feature = "mujoco")]
use std::num::NonZeroUsize;
use std::sync::Arc;

use robogate_core::{
    Assignment, Domain, Environment, Fault, ParameterSpace, ParameterSpec, Policy, SettingSpec, SpaceError, Spread,
    Suite, TaskInstance, TaskSpec, Value,
};
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "mujoco")]
use robogate_physics::worlds::Member;
use robogate_physics::{Chain, Engine, Gripper, Robot};

#[cfg(feature = "mujoco")]
use super::ArmWorlds;
use super::claims::{self, Claim};
use super::remote::RemoteArm;
use super::rules::Rules;
use super::settings::has_effect;
use super::{ArmEnvironment, HasSettings, Rig};
use crate::settings::{setting_specs, with_settings};
use crate::spaces;

/// What a task for an arm declares itself.
pub trait ArmDeclaration: Send + Sync {
    /// The name on the command line, as in the declaration.
    fn name(&self) -> &'static str;

    /// A short description.
    fn summary(&self) -> &str;

    /// The name of the parameter space for a robot with this gripper.
    fn space(&self, _gripper: &Gripper) -> &'static str {
        self.name()
    }

    /// The same space with ends that suit this robot.
    ///
    /// # Errors
    /// Ends that do not form a range.
    fn fitted(&self, space: ParameterSpace, _robot: &Robot) -> Result<ParameterSpace, SpaceError> {
        Ok(space)
    }

    /// The name of the parameter space of the paper for a robot with this gripper, if the task is from there.
    fn published_space(&self, _gripper: &Gripper) -> Option<&'static str> {
        None
    }

    /// The name of the distribution of units of a robot with this gripper.
    fn unit_space(&self, gripper: &Gripper) -> &'static str {
        spaces::unit_space(gripper)
    }

    /// The name of the task's built-in suite, if it has one.
    fn suite(&self) -> Option<&'static str> {
        None
    }

    /// The parameter space that the task brings itself, in place of a named one.
    fn brought_space(&self) -> Option<ParameterSpace> {
        None
    }

    /// The parameters.
    fn parameters(&self) -> &dyn Parameters;

    /// The name of the parameter space of demonstrations with this gripper.
    fn demonstration_space(&self, gripper: &Gripper) -> &'static str {
        self.space(gripper)
    }

    /// The part that the gripper picks first, for demonstrations: position of its centre and edge, in metres.
    ///
    /// # Errors
    /// A setup fault if the details are not those of this task.
    fn first_part(&self, instance: &TaskInstance, robot: &Robot) -> Result<[f64; 4], Fault>;

    /// The claims about the physics of this task with this gripper.
    fn own_claims(&self, gripper: &Gripper) -> Vec<Claim>;

    /// The settings of the published paper for this gripper. Empty if the task is not in it.
    fn published(&self, _gripper: &Gripper) -> Assignment {
        Assignment::default()
    }

    /// The scripted controller for a robot with these kinematics.
    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy>;

    /// The controller that moves the tool in small steps, if the task has one.
    fn tool_expert(&self, robot: Robot, chain: Chain) -> Option<Box<dyn Policy>>;
}

/// The parameters of a task for an arm.
pub trait Parameters {
    /// Their declarations for a robot with this gripper.
    fn specs(&self, gripper: &Gripper) -> Vec<ParameterSpec>;

    /// Whether there is a parameter of this name, with any gripper.
    fn knows(&self, name: &str) -> bool;

    /// Checks a value of a parameter, for a robot with this gripper if one is given.
    ///
    /// # Errors
    /// The reason why it is not accepted.
    fn accepts(&self, name: &str, value: &Value, gripper: Option<&Gripper>) -> Result<(), String>;

    /// As [`Self::accepts`], for all values of a domain.
    ///
    /// # Errors
    /// The first problem.
    fn accepts_all(&self, name: &str, domain: &Domain, gripper: Option<&Gripper>) -> Result<(), String>;

    /// Checks that every parameter of a space is accepted over its whole range, with this gripper or with any.
    ///
    /// # Errors
    /// The first problem.
    fn check_space(&self, space: &ParameterSpace, gripper: Option<&Gripper>) -> Result<(), String> {
        let mut parameters = space.parameters().iter();
        parameters.try_for_each(|parameter| self.accepts_all(&parameter.name, &parameter.domain, gripper))
    }

    /// As [`Self::check_space`], all problems of a suite. Each names the scenarios that have it.
    fn check_suite(&self, suite: &Suite, gripper: Option<&Gripper>) -> Vec<String> {
        let mut found: BTreeMap<(String, String), Vec<&str>> = BTreeMap::new();
        for case in suite.cases() {
            for (name, spread) in &case.parameters {
                let checked = match spread {
                    Spread::Fixed(value) => self.accepts(name, value, gripper),
                    Spread::Drawn(domain) => self.accepts_all(name, domain, gripper),
                };
                if let Err(problem) = checked {
                    found.entry((name.to_string(), problem)).or_default().push(&case.id);
                }
            }
        }
        let line = |((_, problem), cases): ((String, String), Vec<&str>)| match cases[..] {
            [first] => format!("scenario `{first}`: {problem}"),
            _ => format!("scenario `{}` and {} more: {problem}", cases[0], cases.len() - 1),
        };
        found.into_iter().map(line).collect()
    }
}

/// A built-in task for an arm in the cell. The user chooses robot and engine.
pub trait ArmTask: ArmDeclaration {
    /// The claims about the physics with this gripper.
    fn claims(&self, gripper: &Gripper) -> Vec<Claim> {
        self.own_claims(gripper).into_iter().chain(claims::COMMON).collect()
    }

    /// The settings, with the values of this task.
    fn settings(&self) -> Vec<SettingSpec>;

    /// Whether a setting has an effect with this gripper.
    fn has_effect(&self, setting: &str, gripper: &Gripper) -> bool {
        has_effect(setting, gripper)
    }

    /// Why only an engine of this process can simulate the task. `None` if worlds of a simulator and engines in other processes
    /// can do so too.
    fn only_here(&self) -> Option<&'static str>;

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
    fn worlds(&self, engine: MujocoEngine, rig: Rig, member: Member, slots: NonZeroUsize) -> Result<ArmWorlds, String>;

    /// The task on an engine in another process, for this robot with these kinematics and the file hash `sha256`, with
    /// images of this width and height in pixels.
    ///
    /// # Errors
    /// If the gripper cannot apply the grip force.
    fn remote(
        &self,
        robot: Robot,
        chain: Chain,
        sha256: Option<String>,
        picture_px: [usize; 2],
    ) -> Result<RemoteArm, String>;
}

impl<R: Rules + HasSettings + 'static> ArmTask for R {
    fn settings(&self) -> Vec<SettingSpec> {
        setting_specs(&self.rows(), self.defaults(), self)
    }

    fn only_here(&self) -> Option<&'static str> {
        Rules::only_here(self)
    }

    fn with(&self, settings: &Assignment) -> Result<Arc<dyn ArmTask>, String> {
        Ok(Arc::new(with_settings(self.name(), &self.rows(), self, settings)?))
    }

    fn on(&self, engine: Box<dyn Engine>, rig: Rig) -> Result<ArmEnvironment, String> {
        ArmEnvironment::new(self, engine, rig)
    }

    #[cfg(feature = "mujoco")]
    fn worlds(&self, engine: MujocoEngine, rig: Rig, member: Member, slots: NonZeroUsize) -> Result<ArmWorlds, String> {
        ArmWorlds::new(self, engine, rig, member, slots)
    }

    fn remote(
        &self,
        robot: Robot,
        chain: Chain,
        sha256: Option<String>,
        picture_px: [usize; 2],
    ) -> Result<RemoteArm, String> {
        RemoteArm::new(self, (robot, chain), sha256, picture_px)
    }
}

/// Checks that a scripted controller of the task `name` for this robot drives `task`.
pub(crate) fn drives_task(name: &str, robot: &Robot, task: &TaskSpec) -> Result<(), String> {
    if task.name != *name || task.action.joints() != Some(&*robot.settings.arm.joints) {
        return Err(format!("the scripted controller drives {name} on {}, not {}", robot.name(), task.name));
    }
    Ok(())
}
