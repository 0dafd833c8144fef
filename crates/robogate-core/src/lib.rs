//! The words of RoboGate.
//!
//! What varies ([`ParameterSpace`]) or was chosen one by one ([`Suite`]), one fixed assignment of it ([`Scenario`]), a set of points
//! ([`Design`]) and what draws them ([`Sampler`]); what runs an episode ([`Simulator`], [`Policy`],
//! [`rollout`]) and what it leaves behind ([`Episode`], [`Outcome`]).
//!
//! This crate sees no file, socket, thread or clock. Everything random takes a [`Seed`].

mod copula;
mod design;
mod episode;
mod outcome;
mod pose;
mod rollout;
pub mod samplers;
mod scenario;
mod seed;
mod space;
mod suite;

pub use design::{Design, DesignError, Sampler};
pub use episode::{Contact, Episode, Measures};
pub use outcome::{FailureMode, Fault, FaultKind, Outcome};
pub use pose::Pose;
pub use rollout::{
    Action, ArmCommand, Ending, GripperCommand, Image, Observation, Phase, Policy, Simulator, Start, Step, TaskSpec,
    Tick, check_applied, rollout, rollout_with,
};
pub use scenario::{Assignment, Scenario, Value};
pub use seed::{Seed, Stream};
pub use space::{Correlation, Domain, Parameter, ParameterSpace, Scale, SpaceError};
pub use suite::{Case, Spread, Suite, SuiteError, SuiteProblem};
