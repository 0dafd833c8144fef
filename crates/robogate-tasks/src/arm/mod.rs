//! What the tasks of an arm's cell share: environment, observations and actions, parameter rows, the gripper's state,
//! scripted motion, camera images and recordings.
//!
//! A task adds its scene, its rules for an outcome, its parameters and its plan. Its rules make it an [`ArmTask`].

mod cameras;
pub mod claims;
mod environment;
mod feasibility;
mod feel;
mod film;
mod forces;
mod foresight;
#[cfg(all(test, feature = "mujoco"))]
#[path = "../../tests/support/foresight.rs"]
mod foresight_tests;
mod grip;
mod interface;
mod judge;
mod layout;
mod press;
pub mod remote;
mod rules;
mod script;
mod settings;
mod table;
mod task;
mod tool_expert;
mod words;
#[cfg(feature = "mujoco")]
mod worlds;

pub(crate) use cameras::{camera_specs, posture, render};
pub use environment::{ArmEnvironment, CONTROL_PERIOD_S, Rig};
pub(crate) use environment::{GRIP_THRESHOLD_M, cameras, show};
pub(crate) use feasibility::{Load, cannot_carry, out_of_reach};
pub(crate) use feel::{Feel, Feeling, Fit, MOMENT_SHARE, SEATED_M, search_time};
pub(crate) use film::Film;
pub(crate) use foresight::{
    GAP_MARGIN, LIP_MARGIN, Memo, OPENING_CLEARANCE, PRESS_MARGIN, Posture, bias_draws, compliance, components, draw,
    drawn, feature, holding_n, in_hand, joined, log_ratio, tool_draws, within_quarter,
};
pub(crate) use grip::{Grip, GripChange, displacement, is_still, still, touching};
pub(crate) use interface::{action_spec, observation, observed_vectors};
pub(crate) use judge::{CLEARANCE_LIMIT_M, Judge};
pub(crate) use layout::{disc_point, encoder_bias, within_reach};
pub(crate) use press::Press;
pub(crate) use rules::{Bodies, Found, Record, Resolved, Rules, Sight, Trial};
pub(crate) use script::{FREE, Planner, Script, Stage, carry_yaw, cup_yaw, grasp_height, nearest, tool_down};
pub use settings::{ArmSettings, WristSensor};
pub(crate) use settings::{HasSettings, OnArm, jam_rows, on_arm, rows};
pub(crate) use table::{Access, Acting, InSurroundings, Needs, Row, Surroundings, Table, Words, scale};
pub(crate) use task::drives_task;
pub use task::{ArmDeclaration, ArmTask, Parameters};
pub(crate) use tool_expert::{FINELY, FREELY, ToolExpert, Way};
pub(crate) use words::{base_spec, briefing, common_measures, instance, measure, mode};
#[cfg(feature = "mujoco")]
pub use worlds::ArmWorlds;
