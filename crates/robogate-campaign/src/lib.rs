//! Many episodes.
//!
//! A [`Plan`] says how many and where; [`start`] runs them in a folder and [`resume`] goes on where
//! a run was stopped or killed. The first stage covers the operating space. From its results
//! [`boundary`] finds where success turns into failure, and the second stage looks closer there:
//! the only loop in the flow from space to dictionary.
//!
//! Episode `i` depends on the plan's seed and on `i`, and every file of a finished run depends on the
//! plan and its provenance: neither on the number of threads, nor on the order in which
//! episodes finish, nor on where a run was interrupted.
//!
//! ```
//! let plan = robogate_campaign::Preset::Quick.plan()?.with_total(300);
//! assert_eq!((plan.uniform.episodes, plan.boundary.episodes), (200, 100));
//! # Ok::<(), robogate_campaign::PlanError>(())
//! ```
//!
//! In place of both stages a plan may name a suite ([`Plan::of_suite`]): every scenario once in each round, and
//! [`start_in_rounds`] asks after each whether that is enough.
//!
//! Episodes are run by an [`Executor`], whose workers come from a [`WorkerFactory`]: this crate knows no environment and
//! no policy by name. What happens is reported in one stream of [`Event`]s.

pub mod boundary;
mod events;
mod executor;
pub mod folder;
mod plan;
mod run;
mod stage;
mod suite;
mod summary;
mod tally;
mod threads;

pub use boundary::{
    BoundaryReport, DrawnFrom, EmphasisFound, Focus, ParameterBoundary, PooledWeights, Region, Restricted,
};
pub use events::{Event, Warning};
pub use executor::{ExecuteError, Executor, Worker, WorkerFactory};
pub use plan::{BoundaryStage, DEFAULT_SEED, Emphasis, Plan, PlanError, Preset, Range, UniformStage};
pub use run::{Completion, RunError, Settings, recorded, resume, resume_in_rounds, settings, start, start_in_rounds};
pub use stage::{Points, Stage};
pub use suite::{
    BUILT_IN_SUITES, GroupSummary, INDUSTRIAL_68, Round, SuiteStage, SuiteSummary, built_in_suite, suite_sha256,
};
pub use summary::{Estimate, FaultCount, ModeCount, Population, StageSummary, Summary};
pub use tally::{Bin, Bins, MarginalEffect, OutcomeCounts};
pub use threads::ThreadPool;
