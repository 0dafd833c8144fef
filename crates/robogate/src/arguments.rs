//! The arguments that select environment, policy and latency, for all verbs.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use robogate_core::latency::ExecutionMode;
use robogate_dictionary::{OnWarning, RendererRecord};
use robogate_session::{
    CELL_TASK, CheckpointStatistics, ENGINES, EnvironmentChoice, LatencyChoice, PolicyAccess, PolicyChoice,
    PolicyLocation, Reopening, SandboxFolders, Simulators, StressChoice, Trust, WantedLatency, WarnerChoice, duration,
    execution_mode, on_warning,
};
use robogate_zmtp::Address;

/// The arguments that select the environment.
#[derive(Debug, Args)]
pub(crate) struct EnvironmentArguments {
    /// Choose the built-in task (see `robogate list`). With --simulator, the server must compute physics only
    #[arg(long, value_name = "TASK", default_value = CELL_TASK)]
    task: String,
    /// Run in this environment: FAMILY:NAME of a bundled one (see `robogate list environments`), gymnasium:ID, or your own as
    /// FILE.py:ATTRIBUTE or MODULE:ATTRIBUTE
    #[arg(long, value_name = "NAME", conflicts_with_all = ["task", "addresses", "engine", "time_step", "robot"])]
    env: Option<String>,
    /// Choose the robot: a built-in one (see `robogate list robots`), the folder of your own, or menagerie:NAME [default: franka]
    #[arg(long, value_name = "ROBOT")]
    robot: Option<String>,
    #[arg(long, help = engine_help(), value_name = "ENGINE", conflicts_with = "addresses")]
    engine: Option<String>,
    /// Set the engine's time step, in seconds; default: the engine's own
    #[arg(long, value_name = "SECONDS", conflicts_with = "addresses")]
    time_step: Option<f64>,
    /// Set a setting of the task (`robogate list` has them): time_limit_s=20, or with a unit time_limit_s=2min; repeat
    /// for several
    #[arg(long = "set", value_name = "NAME=VALUE")]
    set: Vec<String>,
    /// Choose the renderer of the camera images: the embedded ray caster, or MuJoCo's renderer through EGL
    /// (docs/reference/cameras.md)
    #[arg(long, value_name = "RENDERER", default_value = "embedded")]
    renderer: RendererName,
    #[command(flatten)]
    simulators: SimulatorArguments,
}

/// The help of `--engine`, with the engines of this build.
fn engine_help() -> String {
    let names: Vec<&str> = ENGINES.iter().map(|engine| engine.name).collect();
    format!("Choose the physics engine: {} [default: {}]", names.join(" or "), names[0])
}

impl EnvironmentArguments {
    /// The environment of these arguments.
    pub(crate) fn choice(&self) -> EnvironmentChoice {
        EnvironmentChoice {
            task: self.task.clone(),
            env: self.env.clone(),
            robot: self.robot.clone(),
            engine: self.engine.clone(),
            time_step_s: self.time_step,
            set: self.set.clone(),
            renderer: match self.renderer {
                RendererName::Embedded => None,
                RendererName::Egl => Some(RendererRecord::Egl { device: None }),
            },
            simulators: self.simulators.choice(),
        }
    }
}

/// A renderer.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum RendererName {
    Embedded,
    Egl,
}

/// The arguments that select remote simulators.
#[derive(Debug, Clone, Args)]
pub(crate) struct SimulatorArguments {
    /// Run in these simulators instead of a built-in engine: addresses of bridge protocol servers, tcp://HOST:PORT,
    /// separated by commas
    #[arg(long = "simulator", value_name = "ADDRESSES", value_delimiter = ',')]
    addresses: Vec<Address>,
    /// Set the timeout for a step of such a simulator, in seconds (0.001 to 86400); a reset may take four times as long
    #[arg(long = "simulator-timeout", value_name = "SECONDS", default_value_t = 30.0, value_parser = seconds)]
    timeout_s: f64,
    /// Choose the Python interpreter of --env; default: that of `robogate env setup`, otherwise the active python3
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// Run the Python process of --env, and a policy in it, in a sandbox of Linux (SECURITY.md): it reads only its own files and
    /// packages, writes only to a temporary folder, and has no network and no other processes; default: on for `verify --rerun` of
    /// evidence that you did not make, otherwise off
    #[arg(long, value_name = "on|off", num_args = 0..=1, default_missing_value = "on", require_equals = true)]
    sandbox: Option<Switch>,
    /// Also let processes in the sandbox read these folders, such as those of a dataset, separated by commas; switches --sandbox on
    #[arg(long, value_name = "FOLDERS", value_delimiter = ',')]
    sandbox_read: Vec<PathBuf>,
    /// Also let processes in the sandbox read these folders and change files there, such as those of a cache, separated by commas;
    /// switches --sandbox on
    #[arg(long, value_name = "FOLDERS", value_delimiter = ',')]
    sandbox_write: Vec<PathBuf>,
}

/// A switch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Switch {
    On,
    Off,
}

impl SimulatorArguments {
    /// The simulators of these arguments.
    pub(crate) fn choice(&self) -> Simulators {
        let folders = SandboxFolders { read: self.sandbox_read.clone(), write: self.sandbox_write.clone() };
        let wanted = (!folders.is_empty()).then_some(true);
        Simulators {
            addresses: self.addresses.clone(),
            timeout_s: self.timeout_s,
            python: self.python.clone(),
            sandbox: self.sandbox.map(|switch| switch == Switch::On).or(wanted),
            sandbox_folders: folders,
            loads: None,
            probe: None,
        }
    }
}

/// Parses a timeout.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if (1e-3..=86_400.0).contains(&seconds) { Ok(seconds) } else { Err("expected 0.001 to 86400 seconds".to_owned()) }
}

/// The arguments that select the policy.
#[derive(Debug, Args)]
pub(crate) struct PolicyArguments {
    /// Choose the policy: scripted (the environment's own controller, the default), a policy that the environment
    /// declares (see `robogate env inspect`), random (actions drawn within the bounds of the task), the address of a
    /// policy server such as ws://127.0.0.1:8000, an ONNX file, or, in an environment in Python, lerobot:FOLDER (a checkpoint of
    /// LeRobot) or sb3:FILE (a model of Stable-Baselines3), which its process loads
    #[arg(long, value_name = "URL|FILE|NAME|random|scripted")]
    policy: Option<String>,
    /// Choose the observation and action mapping of that policy: a built-in profile (see `robogate list profiles`),
    /// or a TOML file
    #[arg(long, value_name = "NAME|FILE", requires = "policy")]
    profile: Option<String>,
    /// Map the observations, cameras and actions of the environment to those of the profile with this TOML file
    /// (docs/guides/environments.md)
    #[arg(long, value_name = "FILE", requires = "profile")]
    map: Option<PathBuf>,
    #[command(flatten)]
    statistics: StatisticsArguments,
}

impl PolicyArguments {
    /// The policy of these arguments.
    pub(crate) fn choice(&self) -> PolicyChoice {
        PolicyChoice {
            policy: self.policy.clone(),
            profile: self.profile.clone(),
            map: self.map.clone(),
            statistics: self.statistics.choice(),
        }
    }
}

/// The arguments that select the statistics of a checkpoint.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct StatisticsArguments {
    /// Read the range of each state in the training data from the statistics that are published with the checkpoint:
    /// openpi's norm_stats.json, OpenVLA's dataset_statistics.json, GR00T's statistics.json or LeRobot's stats.json.
    /// A run counts the states outside of it
    #[arg(long, value_name = "FILE")]
    statistics: Option<PathBuf>,
    /// Choose the training set or the embodiment in that file, if it has several
    #[arg(long, value_name = "NAME", requires = "statistics")]
    statistics_group: Option<String>,
}

impl StatisticsArguments {
    /// The statistics of these arguments.
    pub(crate) fn choice(&self) -> CheckpointStatistics {
        CheckpointStatistics { file: self.statistics.clone(), group: self.statistics_group.clone() }
    }
}

/// The argument that says where this process reaches an external policy.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct LocationArguments {
    /// Reach the policy at this address, or in this ONNX file, while the run records the address of --policy: the
    /// servers of one run may have different addresses on different machines
    #[arg(long = "policy-at", value_name = "URL|FILE")]
    at: Option<String>,
    #[command(flatten)]
    access: AccessArguments,
}

impl LocationArguments {
    /// The location of these arguments.
    pub(crate) fn choice(&self) -> PolicyLocation {
        PolicyLocation { at: self.at.clone(), access: self.access.choice() }
    }
}

/// The arguments that say how this process reaches a policy server, in addition to its address. They are not recorded.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct AccessArguments {
    /// Wait up to this time (such as 90s or 10m) for a policy server that does not answer yet, at the start and after a
    /// restart of the server; default: 0s at the start, the attempts of the profile later
    #[arg(long, value_name = "TIME", value_parser = duration::parse)]
    wait: Option<Duration>,
    /// Read the key of the policy server from this file; default: the environment variable ROBOGATE_POLICY_TOKEN. A text
    /// of the form `NAME: VALUE` sets the header NAME, another text the header Authorization
    #[arg(long, value_name = "FILE")]
    policy_key: Option<PathBuf>,
    /// Trust the certificates in this file (PEM) for wss:// and https://; default: those of the system
    #[arg(long, value_name = "FILE")]
    policy_ca: Option<PathBuf>,
}

impl AccessArguments {
    /// The access of these arguments.
    pub(crate) fn choice(&self) -> PolicyAccess {
        PolicyAccess { wait: self.wait, key_file: self.policy_key.clone(), certificates_file: self.policy_ca.clone() }
    }
}

/// The arguments that select latency and execution.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct LatencyArguments {
    /// Delay the actions of the policy in simulated time (docs/concepts/latency.md): fixed:80ms, uniform:50ms,150ms,
    /// normal:MEAN,SD, gamma:MEAN,SD, measured (of this policy on this machine, before the run), varied (by the parameter
    /// `inference_latency_s` of the space or suite) or varied:0ms,500ms (adds this parameter to the space); default: the
    /// world waits for the policy
    #[arg(long, value_name = "LATENCY")]
    latency: Option<WantedLatency>,
    /// Choose what the robot does while the policy computes: hold (wait), queue (asynchronous inference as in LeRobot) or
    /// overlap (overlapping chunks, after real-time chunking); default: hold
    #[arg(long, value_name = "MODE", value_parser = execution_mode)]
    execution: Option<ExecutionMode>,
    /// Vary what the policy receives and what the robot executes, for any environment (docs/guides/stress.md): all, images, state,
    /// actions, language, or single parameters such as noise or delayed_frames. Adds them to the space
    #[arg(long, value_name = "WHAT", value_delimiter = ',')]
    stress: Vec<String>,
    /// Read other wordings of the instruction from this file, one in each line, for --stress language
    #[arg(long, value_name = "FILE")]
    wordings: Option<PathBuf>,
}

impl LatencyArguments {
    /// Latency and execution of these arguments.
    pub(crate) fn choice(&self) -> LatencyChoice {
        let stress = StressChoice { wanted: self.stress.clone(), wordings: self.wordings.clone() };
        LatencyChoice { latency: self.latency.clone(), execution: self.execution, stress }
    }
}

/// The arguments that put a warner into the episodes.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct WarnerArguments {
    /// Let this detector of `robogate warn train` warn in each episode (docs/guides/warn.md)
    #[arg(long, value_name = "FILE", requires = "on_warning")]
    warner: Option<PathBuf>,
    /// Choose what happens at a warning: stop (the episode ends), slow or slow:N (each action takes 2 or N control periods), handover
    /// (the episode ends, and a person takes over) or record (nothing changes)
    #[arg(long, value_name = "WHAT", requires = "warner", value_parser = on_warning)]
    on_warning: Option<OnWarning>,
}

impl WarnerArguments {
    /// The warner of these arguments.
    pub(crate) fn choice(&self) -> WarnerChoice {
        WarnerChoice { detector: self.warner.clone(), on_warning: self.on_warning }
    }
}

/// The arguments that say how a recorded run is set up again.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReopeningArguments {
    /// Start this environment for the run, whose files must be the recorded ones: the name of the run, or your own copy as
    /// FILE.py:ATTRIBUTE. Only needed for a run that you did not make on this machine
    #[arg(long, value_name = "NAME")]
    env: Option<String>,
    /// Use this policy for the run, which must be the recorded one: the address of its server, or its ONNX file. Only needed for a
    /// run that you did not make on this machine, or if the policy has another address now
    #[arg(long, visible_alias = "policy-at", value_name = "URL|FILE")]
    policy: Option<String>,
    /// Use this folder of the robot for the run, whose files must be the recorded ones. Only needed for a run that you did
    /// not make on this machine
    #[arg(long, value_name = "FOLDER")]
    robot: Option<String>,
    #[command(flatten)]
    trust: TrustArguments,
    #[command(flatten)]
    access: AccessArguments,
    #[command(flatten)]
    simulators: SimulatorArguments,
}

impl ReopeningArguments {
    /// How the run is set up again.
    pub(crate) fn choice(&self) -> Reopening {
        Reopening {
            env: self.env.clone(),
            policy: self.policy.clone(),
            robot: self.robot.clone(),
            trust: self.trust.choice(),
            access: self.access.choice(),
            simulators: self.simulators.choice(),
            continues: false,
            upgraded: false,
        }
    }
}

/// The argument that trusts a record.
#[derive(Debug, Clone, Copy, Default, Args)]
pub(crate) struct TrustArguments {
    /// Start the environment, the policy and the robot that the files of the run name, although you did not make the run on this
    /// machine. They can run any code: use it only if you trust their author
    #[arg(long = "trust")]
    given: bool,
}

impl TrustArguments {
    /// Whether the record is trusted.
    pub(crate) fn choice(self) -> Trust {
        Trust { given: self.given }
    }
}
