//! Throughput and validity of many worlds: episodes of a task in MuJoCo Warp beside MuJoCo on all cores, the outcomes of the same
//! scenarios, and a rerun. It needs a Python with mujoco-warp; `scripts/throughput_gpu.sh` runs it.
#![expect(clippy::unwrap_used, clippy::print_stdout, clippy::disallowed_methods, reason = "a benchmark prints times")]

use std::collections::BTreeMap;
use std::io::BufReader;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Instant;

use robogate_core::{
    BatchEnvironment, Episode, Outcome, ParameterSpace, Policy, Sampler, Scenario, Seed, SinglePolicies, Workload,
    rollout, rollout_many, samplers,
};
use robogate_physics::worlds::{Member, Server, Simulator};
use robogate_physics::{Engine, MujocoEngine, built_in_robot};
use robogate_tasks::file::shipped;
use robogate_tasks::insertion::Insertion;
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::{ArmTask, Rig, built_in_space};

/// The arguments, as `NAME=VALUE`.
struct Arguments(BTreeMap<String, String>);

impl Arguments {
    fn text(&self, name: &str, default: &str) -> String {
        self.0.get(name).cloned().unwrap_or_else(|| default.to_owned())
    }

    fn number(&self, name: &str, default: usize) -> usize {
        self.0.get(name).map_or(default, |value| value.parse().unwrap())
    }
}

fn engine() -> MujocoEngine {
    MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap()
}

fn controller(task: &dyn ArmTask, engine: &MujocoEngine) -> Box<dyn Policy> {
    task.controller(engine.robot().clone(), engine.chain().clone())
}

fn scenarios(task: &dyn ArmTask, count: usize, seed: u64) -> Vec<Scenario> {
    let gripper = built_in_robot("franka").unwrap().settings.gripper;
    let space = Arc::new(ParameterSpace::from_toml(built_in_space(task.space(&gripper)).unwrap()).unwrap());
    let design = samplers::Uniform.design(&space, count, Seed::campaign(seed).stream("worlds")).unwrap();
    let scenario = |i: usize| {
        let index = i as u64;
        Scenario { index, seed: Seed::campaign(seed).episode(index), requested: design.assignment(i).unwrap() }
    };
    (0..design.len()).map(scenario).collect()
}

/// Scenarios that several threads take, and the finished episodes.
struct Work<'a> {
    scenarios: &'a [Scenario],
    next: &'a AtomicUsize,
    finished: &'a Mutex<Vec<Episode>>,
}

impl Workload for Work<'_> {
    fn next(&mut self, _: usize) -> Option<Scenario> {
        self.scenarios.get(self.next.fetch_add(1, Ordering::Relaxed)).cloned()
    }

    fn finished(&mut self, _: usize, episode: Episode, _: &mut dyn BatchEnvironment) -> ControlFlow<()> {
        self.finished.lock().unwrap().push(episode);
        ControlFlow::Continue(())
    }
}

/// Runs these scenarios in threads. Returns the episodes in order, and the seconds that it took.
fn run(scenarios: &[Scenario], threads: usize, thread: impl Fn(Work<'_>) + Sync) -> (Vec<Episode>, f64) {
    let (next, finished) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let began = Instant::now();
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| thread(Work { scenarios, next: &next, finished: &finished }));
        }
    });
    let seconds = began.elapsed().as_secs_f64();
    let mut episodes = finished.into_inner().unwrap();
    episodes.sort_by_key(|episode| episode.scenario.index);
    (episodes, seconds)
}

fn on_cores(task: &dyn ArmTask, scenarios: &[Scenario], threads: usize) -> (Vec<Episode>, f64) {
    run(scenarios, threads, |mut work| {
        let engine = engine();
        let mut policy = controller(task, &engine);
        let mut environment = task.environment(Box::new(engine), Rig::default()).unwrap();
        while let Some(scenario) = work.next(0) {
            let episode = rollout(&mut *environment, &mut *policy, &scenario);
            work.finished.lock().unwrap().push(episode);
        }
    })
}

fn in_worlds(
    task: &dyn ArmTask,
    scenarios: &[Scenario],
    threads: usize,
    slots: NonZeroUsize,
    simulator: &Arc<Simulator>,
) -> (Vec<Episode>, f64) {
    let members: Mutex<Vec<Member>> = Mutex::new((0..threads).map(|_| Member::join(Arc::clone(simulator))).collect());
    run(scenarios, threads, |mut work| {
        let engine = engine();
        let policies = (0..slots.get()).map(|_| controller(task, &engine)).collect();
        let member = members.lock().unwrap().pop().unwrap();
        let mut environment = task.worlds(engine, Rig::default(), member, slots).unwrap();
        rollout_many(&mut environment, &mut SinglePolicies::new(policies), &mut work);
    })
}

/// A simulator process.
struct Process(Child, Arc<Simulator>);

impl Process {
    fn start(arguments: &Arguments, deterministic: bool, folder: &Path) -> Self {
        let mut command = Command::new(arguments.text("python", "python3"));
        command.args(["-m", "robogate_worlds"]);
        if let Some(device) = arguments.0.get("device") {
            command.args(["--device", device]);
        }
        if deterministic {
            command.arg("--deterministic");
        }
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (requests, replies) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        let server = Server::new(Box::new(requests), Box::new(replies), folder.to_owned()).unwrap();
        Self(child, Arc::new(Simulator::new(server)))
    }

    /// Ends the process as a client does: by closing its input.
    fn end(self) {
        let Self(mut child, simulator) = self;
        drop(simulator);
        child.wait().unwrap();
    }
}

/// Prints what a run took.
fn speed(what: &str, episodes: &[Episode], seconds: f64) {
    let ticks: u64 = episodes.iter().map(|episode| u64::from(episode.ticks)).sum();
    let invalid = episodes.iter().filter(|episode| matches!(episode.outcome, Outcome::Invalid(_))).count();
    let steps = 25.0 * ticks as f64;
    println!(
        "{what}: {} episodes in {seconds:.1} s: {:.1} per second, {:.3e} steps/s, {invalid} invalid, {:.4} successful",
        episodes.len(),
        episodes.len() as f64 / seconds,
        steps / seconds,
        rate(episodes)
    );
    if let Some(Outcome::Invalid(fault)) =
        episodes.iter().map(|episode| &episode.outcome).find(|outcome| matches!(outcome, Outcome::Invalid(_)))
    {
        println!("  first fault: {fault:?}");
    }
}

fn succeeded(episode: &Episode) -> bool {
    matches!(episode.outcome, Outcome::Success)
}

fn rate(episodes: &[Episode]) -> f64 {
    episodes.iter().filter(|episode| succeeded(episode)).count() as f64 / episodes.len().max(1) as f64
}

/// Prints how the outcomes of the same scenarios differ.
fn pairs(what: &str, one: &[Episode], two: &[Episode]) {
    let valid = |pair: &(&Episode, &Episode)| {
        ![pair.0, pair.1].iter().any(|episode| matches!(episode.outcome, Outcome::Invalid(_)))
    };
    let both: Vec<(&Episode, &Episode)> = one.iter().zip(two).filter(valid).collect();
    assert!(both.iter().all(|(one, two)| one.scenario.index == two.scenario.index));
    let count = |test: &dyn Fn(&Episode, &Episode) -> bool| both.iter().filter(|(one, two)| test(one, two)).count();
    let lost = count(&|one, two| succeeded(one) && !succeeded(two));
    let won = count(&|one, two| !succeeded(one) && succeeded(two));
    let modes = count(&|one, two| one.outcome != two.outcome);
    let same = count(&|one, two| one == two);
    let applied = count(&|one, two| one.applied != two.applied);
    println!(
        "{what}: {} pairs, success only in the first {lost}, only in the second {won}, outcome differs {modes}, all bytes equal {same}, \
         applied parameters differ {applied}",
        both.len()
    );
    let mut kinds: BTreeMap<String, usize> = BTreeMap::new();
    for (one, two) in both.iter().filter(|(one, two)| one.outcome != two.outcome) {
        *kinds.entry(format!("{:?} -> {:?}", one.outcome, two.outcome)).or_default() += 1;
    }
    let mut kinds: Vec<(String, usize)> = kinds.into_iter().collect();
    kinds.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    for (kind, count) in kinds.iter().take(8) {
        println!("  {count} x {kind}");
    }
}

fn main() {
    let given = std::env::args()
        .skip(1)
        .filter_map(|argument| argument.split_once('=').map(|(name, value)| (name.to_owned(), value.to_owned())));
    let arguments = Arguments(given.collect());
    if arguments.0.is_empty() {
        println!("no arguments: nothing is measured (see scripts/throughput_gpu.sh)");
        return;
    }
    let task: &dyn ArmTask = match &*arguments.text("task", "pick_place") {
        "stacking" => shipped().next().expect("it is built in"),
        "insertion" => &Insertion::DEFAULT,
        _ => &PickPlace::DEFAULT,
    };
    let threads = arguments.number("threads", 16);
    let all = scenarios(task, arguments.number("episodes", 256), 7);
    let paired = &all[..arguments.number("paired", all.len()).min(all.len())];
    let slots = NonZeroUsize::new(arguments.number("worlds", 256).div_ceil(threads)).unwrap();
    let folder = PathBuf::from(arguments.text("folder", "/dev/shm"));
    let (cores, seconds) = on_cores(task, paired, threads);
    speed(&format!("mujoco, {threads} threads"), &cores, seconds);
    for deterministic in arguments.text("modes", "fast").split(',').map(|mode| mode == "deterministic") {
        let name = if deterministic { "deterministic" } else { "fast" };
        let process = Process::start(&arguments, deterministic, &folder);
        println!("{name}: {:?}", process.1.identity());
        let runs: Vec<Vec<Episode>> = (0..arguments.number("runs", 2))
            .map(|k| {
                let (episodes, seconds) = in_worlds(task, &all, threads, slots, &process.1);
                speed(&format!("{name}, {} worlds, run {}", threads * slots.get(), k + 1), &episodes, seconds);
                episodes
            })
            .collect();
        pairs(&format!("{name} against mujoco"), &cores, &runs[0][..paired.len()]);
        if let [one, .., two] = &*runs {
            pairs(&format!("{name} against its rerun"), one, two);
        }
        process.end();
    }
}
