//! The file of a sweep: policies x tasks x robots x engines.

use std::path::Path;

use anyhow::{Context, bail, ensure};
use robogate_campaign::DEFAULT_SEED;
use robogate_session::ENGINES;
use serde::{Deserialize, Serialize};

use crate::place::folder_name;

/// A sweep, as its file describes it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sweep {
    /// The version of the format.
    version: u32,
    /// The name of the sweep.
    name: String,
    /// The seed of every run. Equal seeds give equal scenarios, which makes policies comparable.
    #[serde(default = "default_seed")]
    seed: u64,
    /// The requirements whose score ranks the policies: a built-in set or a TOML file. Without it, the success rate
    /// ranks them.
    requirements: Option<String>,
    task: Vec<Task>,
    policy: Vec<Policy>,
}

/// A task with its robots, engines and scenarios.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Task {
    name: String,
    #[serde(default)]
    robots: Vec<String>,
    #[serde(default)]
    engines: Vec<String>,
    /// Addresses of simulator servers that declare the task.
    #[serde(default)]
    simulators: Vec<String>,
    suite: Option<String>,
    rounds: Option<u64>,
    space: Option<String>,
    plan: Option<String>,
    episodes: Option<u64>,
}

/// A policy, and the tasks and robots that it can drive.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Policy {
    name: String,
    policy: Option<String>,
    profile: Option<String>,
    tasks: Option<Vec<String>>,
    robots: Option<Vec<String>>,
}

fn default_seed() -> u64 {
    DEFAULT_SEED
}

/// One run of a sweep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct SweepRun {
    /// The name in the leaderboard.
    pub(super) name: String,
    /// The folder below that of the sweep.
    pub(super) folder: String,
    /// The options of `robogate run`.
    pub(super) options: Vec<String>,
    /// The addresses of its simulators.
    pub(super) simulators: Vec<String>,
}

/// A sweep with absolute paths: the content of `sweep.json` in its folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct SweepPlan {
    /// The version of the format.
    pub(super) version: u32,
    /// The name of the sweep.
    pub(super) name: String,
    /// The requirements whose score ranks the policies. Without them, the success rate ranks the policies.
    pub(super) requirements: Option<String>,
    /// The number of shards of each round, if the sweep is divided.
    pub(super) shards: Option<u32>,
    /// The runs in order.
    pub(super) runs: Vec<SweepRun>,
}

/// The version of both formats.
pub(super) const VERSION: u32 = 1;
/// More runs are probably a mistake.
const MOST_RUNS: usize = 10_000;

impl Sweep {
    /// Parses the file of a sweep.
    pub(super) fn parse(text: &str) -> anyhow::Result<Self> {
        let sweep: Self = toml::from_str(text)?;
        ensure!(sweep.version == VERSION, "version: {} is unknown. Expected {VERSION}", sweep.version);
        ensure!(
            !sweep.task.is_empty() && !sweep.policy.is_empty(),
            "expected at least one [[task]] and one [[policy]]"
        );
        Ok(sweep)
    }

    /// The plan of the sweep. Paths are relative to the folder `base`.
    pub(super) fn plan(&self, base: &Path, shards: Option<u32>) -> anyhow::Result<SweepPlan> {
        Ok(SweepPlan {
            version: VERSION,
            name: self.name.clone(),
            requirements: self.requirements.as_ref().map(|name| in_folder(base, name)),
            shards,
            runs: self.runs(base)?,
        })
    }

    /// The runs in the order of the file.
    fn runs(&self, base: &Path) -> anyhow::Result<Vec<SweepRun>> {
        let mut runs: Vec<SweepRun> = Vec::new();
        for task in &self.task {
            task.check().with_context(|| format!("task {}", task.name))?;
            for (robot, engine) in task.cells() {
                for policy in self.policy.iter().filter(|policy| policy.drives(task, robot)) {
                    let run = SweepRun {
                        name: parts(policy, task, robot, engine).join(", "),
                        folder: folder_name(&parts(policy, task, robot, engine).join("-")),
                        options: self.options(policy, task, robot, engine, base),
                        simulators: task.simulators.clone(),
                    };
                    if let Some(other) = runs.iter().find(|other| other.folder == run.folder) {
                        bail!("`{}` and `{}` have the same folder: give them different names", other.name, run.name);
                    }
                    runs.push(run);
                    ensure!(runs.len() <= MOST_RUNS, "more than {MOST_RUNS} runs");
                }
            }
        }
        ensure!(!runs.is_empty(), "no policy drives any task: check `tasks` and `robots` of the policies");
        Ok(runs)
    }

    fn options(
        &self,
        policy: &Policy,
        task: &Task,
        robot: Option<&str>,
        engine: Option<&str>,
        base: &Path,
    ) -> Vec<String> {
        let file = |name: &String| in_folder(base, name);
        let number = |number: u64| number.to_string();
        let own_task = if task.simulators.is_empty() { Some(task.name.clone()) } else { None };
        // Another design chooses scenarios by the results of a policy; a sweep compares policies on the same ones.
        let design = task.suite.is_none() && task.plan.is_none();
        let options = [
            ("--task", own_task),
            ("--robot", robot.map(|robot| in_folder(base, robot))),
            ("--engine", engine.map(str::to_owned)),
            ("--suite", task.suite.as_ref().map(file)),
            ("--rounds", task.rounds.map(number)),
            ("--space", task.space.as_ref().map(file)),
            ("--plan", task.plan.as_ref().map(file)),
            ("--design", design.then(|| "uniform".to_owned())),
            ("-n", task.episodes.map(number)),
            ("--policy", policy.policy.as_ref().map(file)),
            ("--profile", policy.profile.as_ref().map(file)),
            ("--seed", Some(number(self.seed))),
        ];
        options.into_iter().filter_map(|(name, value)| Some([name.to_owned(), value?])).flatten().collect()
    }
}

impl Task {
    fn check(&self) -> anyhow::Result<()> {
        let drawn = self.space.is_some() || self.plan.is_some() || self.episodes.is_some();
        ensure!(!(self.suite.is_some() && drawn), "`suite` cannot be used with `space`, `plan` or `episodes`");
        ensure!(self.rounds.is_none() || self.suite.is_some(), "`rounds` needs `suite`");
        ensure!(self.episodes != Some(0), "`episodes` must be at least 1");
        let chosen = robogate_session::has_robots(&self.name) || !self.simulators.is_empty();
        let name = &self.name;
        ensure!(chosen || (self.robots.is_empty() && self.engines.is_empty()), "{name} has no robots and engines");
        ensure!(self.simulators.is_empty() || self.engines.is_empty(), "`engines` cannot be used with `simulators`");
        Ok(())
    }

    /// Robots and engines in all combinations.
    fn cells(&self) -> Vec<(Option<&str>, Option<&str>)> {
        let own = robogate_session::has_robots(&self.name) && self.simulators.is_empty();
        let robots: Vec<Option<&str>> = match self.robots.as_slice() {
            [] => vec![own.then_some("franka")],
            robots => robots.iter().map(|robot| Some(robot.as_str())).collect(),
        };
        let engines: Vec<Option<&str>> = match self.engines.as_slice() {
            [] => vec![own.then_some(ENGINES[0].name)],
            engines => engines.iter().map(|engine| Some(engine.as_str())).collect(),
        };
        robots.iter().flat_map(|robot| engines.iter().map(move |engine| (*robot, *engine))).collect()
    }
}

impl Policy {
    fn drives(&self, task: &Task, robot: Option<&str>) -> bool {
        let lists = |names: &Option<Vec<String>>, name: &str| {
            names.as_ref().is_none_or(|names| names.iter().any(|known| known == name))
        };
        lists(&self.tasks, &task.name) && robot.is_none_or(|robot| lists(&self.robots, robot))
    }
}

fn parts<'a>(policy: &'a Policy, task: &'a Task, robot: Option<&'a str>, engine: Option<&'a str>) -> Vec<&'a str> {
    [Some(policy.name.as_str()), Some(task.name.as_str()), robot, engine].into_iter().flatten().collect()
}

/// The absolute path of a file beside the sweep. Names of built-in items and addresses stay as they are.
fn in_folder(base: &Path, name: &str) -> String {
    let path = base.join(name);
    let full = if path.exists() && name.contains(['/', '.']) { path.canonicalize().ok() } else { None };
    full.map_or_else(|| name.to_owned(), |path| path.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SWEEP: &str = r#"
        version = 1
        name = "two robots"
        seed = 7
        [[task]]
        name = "pick_place"
        robots = ["franka", "ur5e"]
        episodes = 60
        [[task]]
        name = "pendulum"
        [[policy]]
        name = "scripted"
        [[policy]]
        name = "learned policy"
        policy = "ws://127.0.0.1:8000"
        profile = "pi0-libero"
        tasks = ["pick_place"]
        robots = ["franka"]
    "#;

    #[test]
    fn product_leaves_out_what_policies_cannot_drive() {
        let runs = Sweep::parse(SWEEP).unwrap().runs(Path::new(".")).unwrap();
        let folders: Vec<&str> = runs.iter().map(|run| run.folder.as_str()).collect();
        assert_eq!(
            folders,
            [
                "scripted-pick_place-franka-mujoco",
                "learned-policy-pick_place-franka-mujoco",
                "scripted-pick_place-ur5e-mujoco",
                "scripted-pendulum"
            ]
        );
        assert_eq!(
            runs[1].options.join(" "),
            "--task pick_place --robot franka --engine mujoco --design uniform -n 60 --policy ws://127.0.0.1:8000 --profile pi0-libero \
             --seed 7"
        );
        assert_eq!(runs[3].options.join(" "), "--task pendulum --design uniform --seed 7");
        assert_eq!(runs[3].name, "scripted, pendulum");
    }

    #[test]
    fn wrong_sweeps_are_explained() {
        for (change, to, part) in [
            ("version = 1", "version = 2", "version: 2 is unknown"),
            ("seed = 7", "sead = 7", "unknown field `sead`"),
            ("name = \"pendulum\"", "name = \"pendulum\"\nrobots = [\"franka\"]", "pendulum has no robots"),
            ("episodes = 60", "episodes = 60\nsuite = \"industrial-68\"", "cannot be used with"),
            ("episodes = 60", "rounds = 2", "`rounds` needs `suite`"),
            ("episodes = 60", "episodes = 0", "`episodes` must be at least 1"),
            ("\"ur5e\"", "\"franka\"", "same folder"),
        ] {
            let text = SWEEP.replace(change, to);
            let error = Sweep::parse(&text).and_then(|sweep| sweep.runs(Path::new("."))).unwrap_err();
            assert!(format!("{error:#}").contains(part), "{to}: {error:#}");
        }
    }
}
