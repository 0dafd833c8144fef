//! What the tasks of an arm's cell share: environment, observations and actions, parameter rows, the gripper's state,
//! scripted motion, camera images and recordings.
//!
//! A task adds its scene, its rules for an outcome, its parameters and its plan. It implements [`ArmTask`].

mod cameras;
mod environment;
mod film;
mod grip;
mod interface;
mod layout;
mod script;
mod table;
mod task;
mod words;

pub(crate) use cameras::{camera_specs, posture, render};
pub(crate) use environment::{ArmEnvironment, Resolved, Rules, Ruling, Sight, Trial, encoder_bias};
pub(crate) use film::Film;
pub(crate) use grip::{Grip, GripChange, touching};
pub use interface::TOOL_DELTA;
pub(crate) use interface::{action_spec, observation, observed_vectors};
pub(crate) use layout::{disc_point, within_reach};
pub(crate) use script::{FREE, Planner, Script, Stage, grasp_height, nearest, tool_down};
pub(crate) use table::{Access, Acting, Row, applied, decode, specs};
pub use task::ArmTask;
pub(crate) use words::{measure, mode};
