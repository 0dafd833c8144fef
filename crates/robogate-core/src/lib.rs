//! Domain types of RoboGate.
//!
//! What varies ([`ParameterSpace`]) or was chosen one by one ([`Suite`]), one fixed assignment of it ([`Scenario`]), a
//! set of points ([`Design`]) and what draws them ([`Sampler`]); the task as data ([`TaskSpec`]); what runs an episode
//! ([`Environment`], [`Policy`], [`rollout`]) and its record ([`Episode`], [`Outcome`]).
//!
//! This crate uses no file, socket, thread or clock. Everything random takes a [`Seed`].

mod action;
mod copula;
mod design;
mod episode;
mod measures;
mod observation;
mod outcome;
mod pose;
mod rollout;
pub mod samplers;
mod scenario;
mod seed;
mod space;
mod suite;
mod task;
mod word;

pub use action::{Action, ActionSpace, ActionSpec, Command, GripperKind};
pub use design::{Design, DesignError, Sampler};
pub use episode::{Contact, Episode};
pub use measures::Measures;
pub use observation::{Image, Observation, vectors};
pub use outcome::{FailureMode, FailureModeError, Fault, FaultKind, Outcome};
pub use pose::Pose;
pub use rollout::{Ending, Environment, Policy, Start, Step, Tick, check_applied, rollout, rollout_with};
pub use scenario::{Assignment, Scenario, Value};
pub use seed::{Seed, Stream};
pub use space::{Correlation, Domain, Parameter, ParameterSpace, Scale, SpaceError};
pub use suite::{Case, Spread, Suite, SuiteError, SuiteProblem};
pub use task::{
    Allowed, Better, CameraSpec, FailureModeSpec, MeasureSpec, ObservationSpec, ParameterSpec, Severity, TaskError,
    TaskInstance, TaskSpec, VectorSpec,
};
pub use word::{Word, WordError};
