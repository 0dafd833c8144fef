//! Domain types of RoboGate.
//!
//! - [`ParameterSpace`]: the parameters that vary, with their ranges and correlations.
//! - [`Suite`]: scenarios that were chosen one by one.
//! - [`Scenario`]: one assignment of values to the parameters.
//! - [`Design`] and [`Sampler`]: a set of points of a space, and the method that draws it.
//! - [`TaskSpec`]: a task as data.
//! - [`Environment`], [`Policy`] and [`rollout`]: the components and the loop of an episode.
//! - [`BatchEnvironment`], [`BatchPolicy`] and [`rollout_many`]: the same for many episodes at once.
//! - [`Episode`] and [`Outcome`]: the record of an episode and how it ended.
//! - [`budget`] and [`guard`]: limits on text that another program wrote, and panics of libraries that read it.
//!
//! The crate uses no file, socket, thread or clock. All randomness comes from a [`Seed`].

mod action;
pub mod budget;
mod contact_forces;
mod copula;
mod design;
mod episode;
mod feasibility;
mod foresight;
pub mod guard;
mod hint;
pub mod latency;
mod measures;
mod observation;
mod outcome;
mod outside_range;
mod pose;
mod rollout;
pub mod samplers;
mod scenario;
mod seed;
mod setting;
mod signals;
mod space;
pub mod stress;
mod suite;
mod task;
mod trajectory;
mod word;

pub use action::{Action, ActionSpace, ActionSpec, Command, GripperKind};
pub use contact_forces::{Contacting, PEAK_CONTACT_FORCE, QUASI_STATIC_S, Region, RegionForces, Touched, region_pairs};
pub use design::{Design, DesignError, Sampler};
pub use episode::{Contact, Episode};
pub use feasibility::{FEASIBLE, Infeasibility, InfeasibleShare, SpaceFeasibility, is_feasible};
pub use foresight::{FeatureSpec, Foresight};
pub use hint::hint;
pub use measures::Measures;
pub use observation::{Image, Observation, vectors};
pub use outcome::{FailureMode, FailureModeError, Fault, FaultKind, Outcome};
pub use outside_range::{OUTSIDE_RANGE, OutsideNumber, OutsideRange, outside_any_range, outside_range_measure};
pub use pose::Pose;
pub use rollout::{
    BatchEnvironment, BatchPolicy, Ending, Environment, GAVE_UP, Policy, PredictedStep, Prediction, Request, Rollout,
    SingleEnvironments, SinglePolicies, Start, Step, Tick, Workload, check_applied, is_applied, rollout, rollout_all,
    rollout_many, rollout_with,
};
pub use scenario::{Assignment, Scenario, Value};
pub use seed::{Seed, Stream};
pub use setting::SettingSpec;
pub use signals::{SignalGroup, SignalKind, Signals, measure_row};
pub use space::{Correlation, Domain, Parameter, ParameterSpace, Scale, SpaceError};
pub use suite::{Case, Published, Spread, Suite, SuiteError, SuiteProblem};
pub use task::{
    Allowed, Better, CameraSpec, DrawSpec, FailureModeSpec, MeasureSpec, ObservationSpec, ParameterSpec, Severity,
    TaskError, TaskInstance, TaskSpec, VectorSpec,
};
pub use trajectory::{ContactBetween, ContactPoint, Frame, Solid, SolidShape, Trajectory};
pub use word::{Word, WordError};
