//! What a run of RoboGate consists of: environment, policy, robot, and the records of them.
//!
//! A program chooses an environment ([`EnvironmentChoice`]) and a policy ([`PolicyChoice`]) and makes a [`Subject`] of them, which
//! creates workers for a campaign and its provenance. A recorded run becomes a subject again by [`Subject::recorded`], which
//! starts only what a [`Reopening`] permits. [`GateRequest::decide`] decides whether a policy may run, and compares two of them.
//!
//! The library parses no arguments and prints nothing. It returns a [`Failure`] with its kind, and tells everything else
//! through the `log` crate, with the target [`NOTICES`].

mod arms;
mod cell;
mod checkpoint_statistics;
mod compared;
mod contest;
mod controls;
pub mod duration;
mod environment_choice;
mod environments;
mod failure;
pub mod families;
mod fingerprint;
mod first_episodes;
mod first_requests;
mod fleet;
mod gate;
mod hopeless;
mod in_flight;
pub mod init;
mod isolation;
mod latency;
mod loaded_policy;
mod lost_episodes;
#[cfg(feature = "mujoco")]
mod menagerie;
mod nominal_episodes;
mod notice;
#[cfg(feature = "object-store")]
mod object_store;
mod origin;
mod pictures;
mod policy_record;
mod policy_source;
mod registry;
mod rehearsal;
mod remote;
mod renderer;
mod reopening;
mod repetition;
mod requalify;
mod rerun;
mod rival;
mod rounds;
mod runs;
mod sharded;
mod signals;
mod source;
mod store;
mod stress;
mod subject;
pub mod task_folder;
pub mod text;
mod twins;
mod warner;
mod workers;
#[cfg(feature = "mujoco")]
mod worlds;

pub use arms::Arms;
pub use cell::{Cell, engine, identity, nominal, robot, robot_files};
pub use checkpoint_statistics::CheckpointStatistics;
pub use compared::{built_in_baseline, compared_with, judged, record_of};
pub use contest::{AfterRound, Contest, ContestEnd, Contestant};
pub use controls::{CONTROL_EPISODES, run_controls};
pub use environment_choice::EnvironmentChoice;
pub use environments::{BUNDLED, ENVIRONMENT, Interpreter, Servers, installed, installed_marker};
pub use failure::{Failure, FailureKind, OrFailure, chain};
pub use fingerprint::{CHECKPOINT, FINGERPRINT, MOST_FINGERPRINT_BYTES, checkpoint, read_checkpoint, read_fingerprint};
pub use first_requests::ServerComparison;
pub use fleet::{FleetEnd, FleetPlan, FleetRequest, OnUnit, is_fleet, unit_space};
pub use gate::{GateRequest, Look, MARGIN, SAMPLED_SCENARIOS, begun, question, rounds_and_sampling, with_plan};
pub use hopeless::{Reaction, Watched};
pub use isolation::{Entered, SandboxFolders, enter, in_child};
pub use latency::{LatencyChoice, WantedLatency, describe, execution_mode};
pub use loaded_policy::LoadedPolicy;
pub use lost_episodes::{Outage, RunsLostAgain};
#[cfg(feature = "mujoco")]
pub use menagerie::resolved as menagerie_robot;
pub use nominal_episodes::{default_nominal_episodes, nominal_rate_of, nominal_suite};
pub use notice::TARGET as NOTICES;
pub use origin::{Origin, is_remote, register, register_copy};
pub use pictures::picture_problems;
pub use policy_record::POLICY;
pub use policy_source::{
    ExternalSource, PolicyAccess, PolicyChoice, PolicyLocation, PolicySource, connect, mapped, policy_error, profile,
    task_map, without_profile,
};
pub use registry::{
    ARM_TASKS, CELL_TASK, ENGINES, EngineEntry, POLICIES, TASKS, arm_task, has_robots, spaces, task, tasks,
};
pub use rehearsal::{Rehearsal, is_rehearsed};
pub use remote::{CellTask, PhysicsHost, Simulators};
pub use reopening::{Permit, Program, Reopening, Trust};
pub use repetition::repeats;
pub use requalify::{Packages, RecordedRun, Requalified, Requalifying, Upgrade, VersionChange};
pub use rerun::{Rerun, rerun};
pub use rival::Rival;
pub use rounds::{Rounds, ruled_out};
pub use runs::{Run, runs_below};
pub use sharded::ShardedCampaign;
pub use signals::{EpisodeSignals, Header as SignalHeader, SIGNALS, read_signals};
pub use source::open_source;
pub use store::{create_store, open_store};
pub use stress::StressChoice;
#[cfg(feature = "mujoco")]
pub use subject::WrittenScene;
pub use subject::{
    BuiltIn, EnvironmentSource, Subject, check_declared, named_space, named_suite, programs, recorded_robot,
    starts_processes,
};
pub use twins::twins_of;
pub use warner::{UnwarnedEnd, WarnerChoice, on_warning, read_detector, unwarned, warner_effect_of};
pub use workers::{Workers, guarded};

/// The SHA-256 of the source files that results depend on.
pub const SOURCE_SHA256: &str = env!("ROBOGATE_SOURCE_SHA256");
