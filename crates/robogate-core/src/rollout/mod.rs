//! Runs episodes: an environment and a policy take turns.
//!
//! [`Rollout`] is one episode as a state machine. [`rollout`] is a loop around one of them, and [`rollout_many`] is a loop
//! around as many as a [`BatchEnvironment`] steps at once. Both give the same episodes bit for bit.

mod applied;
mod batch;
mod environment;
mod policy;
mod single;
mod singles;
mod slots;
mod state;

pub use applied::{check_applied, is_applied};
pub use batch::{Workload, rollout_all, rollout_many};
pub use environment::{Ending, Environment, Start, Step};
pub use policy::{Policy, PredictedStep, Prediction};
pub use single::{rollout, rollout_with};
pub use singles::{SingleEnvironments, SinglePolicies};
pub use slots::{BatchEnvironment, BatchPolicy};
pub use state::{GAVE_UP, Request, Rollout, Tick};
