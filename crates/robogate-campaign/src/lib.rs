//! Campaigns: sets of episodes with a plan, stages, execution and resume.
//!
//! A [`Plan`] defines the number of episodes and their region. [`start`] runs them in a folder, and [`resume`]
//! continues a run that was stopped or killed. The first stage covers the operating space. From its results,
//! [`boundary`] finds the region where success turns into failure, and the second stage samples that region. This loop, and
//! that of the active stage, are the only ones in the flow from space to dictionary.
//!
//! Episode `i` depends only on the plan's seed and on `i`. Every file of a finished run depends only on the plan and
//! its provenance: the number of threads, the order in which episodes finish, and interruptions have no effect.
//! The summary and `lost_episodes.jsonl` also record the attempts that infrastructure faults lost ([`RunAgain`]).
//!
//! ```
//! let plan = robogate_campaign::Preset::Quick.plan()?.with_total(300).with_two_stages();
//! assert_eq!((plan.uniform.episodes, plan.boundary.episodes), (200, 100));
//! # Ok::<(), robogate_campaign::PlanError>(())
//! ```
//!
//! Instead of the boundary stage, a plan may have an active stage ([`ActiveStage`]): rounds that sample where a risk model
//! of all earlier episodes is least certain.
//!
//! Instead of all stages, a plan may name a suite ([`Plan::of_suite`]). Every scenario then runs once per round, and
//! [`start_in_rounds`] calls a closure after each round to decide whether to stop.
//!
//! A plan with `twins` has a control arm ([`NominalArm`]): the same episodes with the nominal values of the task. If the task
//! declares families of perturbations, a second arm has episodes with one family each ([`family_arm`]).
//!
//! Many machines can share a campaign: each runs some [`shards`], and the merged files are those of one machine.
//!
//! An [`Executor`] runs the episodes with workers from a [`WorkerFactory`]: [`ThreadPool`] with one episode in progress in each
//! thread, [`BatchPool`] with several. This crate knows no specific environment or
//! policy. Progress is reported as one stream of [`Event`]s.

mod active;
mod batch;
pub mod boundary;
mod events;
mod executor;
pub mod folder;
mod follow;
mod invalid;
mod lost;
mod plan;
mod rows;
mod run;
pub mod shards;
mod stage;
mod suite;
mod summary;
mod tally;
mod threads;
mod twins;

pub use active::{ActiveReport, ActiveRound, ActiveStage, Certificate, ModelScore};
pub use batch::BatchPool;
pub use boundary::{BoundaryReport, DrawnFrom, EmphasisFound, Focus, ParameterBoundary, Region, Restricted};
pub use events::{Event, Warning};
pub use executor::{BatchWorker, EpisodeObserver, ExecuteError, Executor, Worker, WorkerFactory, single_workers};
pub use follow::{FollowError, Follower, Progress};
pub use lost::RunAgain;
pub use plan::{BoundaryStage, DEFAULT_SEED, Emphasis, Plan, PlanError, Preset, Range, UniformStage};
pub use rows::{RowsError, check_rows};
pub use run::{
    AfterRound, Completion, RunError, Settings, not_in_shards, recorded, resume, resume_in_rounds, settings, start,
    start_in_rounds,
};
pub use stage::{Points, Stage};
pub use suite::{
    BUILT_IN_SUITES, GroupSummary, INDUSTRIAL_68, Round, SuiteStage, SuiteSummary, built_in_suite, suite_sha256,
};
pub use summary::{Estimate, FaultCount, FeasiblePart, ModeCount, Population, Sought, StageSummary, Summary};
pub use tally::{Bin, Bins, MarginalEffect, OutcomeCounts};
pub use threads::ThreadPool;
pub use twins::{FAMILIES, NOMINAL, NominalArm, family_arm};
