//! Simulators behind the bridge: whatever a server does, an episode is right or it is Invalid, and nothing waits for ever.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use robogate_core::{
    Action, ArmCommand, Assignment, Ending, Episode, FailureMode, Fault, FaultKind, GripperCommand, Image, Measures,
    Observation, Outcome, Policy, Pose, Scenario, Seed, Simulator, Start, Step, TaskSpec, Value, rollout,
};
use robogate_remote::bounds::{self, REQUEST};
use robogate_remote::conformance::{Report, examine};
use robogate_remote::message::{
    ActionSpace, Begun, Camera, DeltaScale, Engine, Envelope, Hello, Nothing, Number, Program, Request, Reset, Robot,
    Stepped, Steps, decode, encode,
};
use robogate_remote::{Judging, NoWorld, Patience, Pool, PoolError, Remote, Server};
use robogate_zmtp::{Address, Replier};

#[path = "../../robogate-zmtp/tests/support/mod.rs"]
mod support;

const PERIOD: f64 = 0.05;
const LENGTH: u32 = 12;

/// Three joints that are where they are sent, at once. Once the gripper is told to close, the episode ends as the
/// scenario's seed decides.
#[derive(Default)]
struct Toy {
    scenario: Option<Scenario>,
    joints: Vec<f64>,
    tick: u32,
}

impl Toy {
    fn observation(&self) -> Observation {
        Observation {
            time_s: f64::from(self.tick) * PERIOD,
            joint_positions: self.joints.clone(),
            joint_velocities: vec![0.1; 3],
            gripper_opening_m: Some(0.08),
            tool_pose: Pose::upright([self.joints[0], 0.1, 0.2], self.joints[1]),
            images: Vec::new(),
        }
    }

    fn hash(&self) -> u64 {
        self.joints.iter().fold(u64::from(self.tick), |hash, q| (hash ^ q.to_bits()).wrapping_mul(0x100_0000_01b3))
    }
}

impl Simulator for Toy {
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        if scenario.requested.number("mass_kg").is_some_and(|mass| mass > 100.0) {
            return Err(Fault::new(FaultKind::Setup, "too heavy to stand"));
        }
        let mut stream = scenario.seed.stream("toy");
        self.joints = vec![stream.uniform(), stream.uniform(), 0.0];
        self.tick = 0;
        self.scenario = Some(scenario.clone());
        let task = TaskSpec {
            instruction: "wait".to_owned(),
            control_period_s: PERIOD,
            time_limit_s: 2.0,
            shape: "box".to_owned(),
            object_extent_m: [0.05; 3],
            object_pose: Pose::upright([0.5, 0.0, 0.025], 0.3),
            target_pose: Pose::IDENTITY,
            tolerance_m: 0.03,
            approach_speed_m_s: None,
        };
        Ok(Start { task, observation: self.observation(), applied: scenario.requested.clone() })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        match &action.arm {
            ArmCommand::JointPositions(joints) => self.joints.clone_from(joints),
            ArmCommand::ToolDelta { translation_m, .. } => self.joints[0] += translation_m[0],
        }
        self.tick += 1;
        let over = self.tick >= LENGTH && action.gripper == GripperCommand::Close;
        let failure =
            (self.scenario.as_ref().unwrap().seed.stream("end").below(2) == 1).then_some(FailureMode::GripLoss);
        let contact = failure.map(|_| robogate_core::Contact {
            robot_body: "hand".to_owned(),
            other_body: "table".to_owned(),
            force_n: 3.25,
        });
        Ok(Step {
            observation: self.observation(),
            measures: Measures { slip_m: Some(self.joints[0] / 3.0), ..Measures::default() },
            ending: over.then(|| Ending { failure, time_s: f64::from(self.tick) * PERIOD, contact }),
            events: vec![format!("tick {}", self.tick)],
            state_hash: self.hash(),
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        let rgb = vec![self.tick as u8; 3 * 8 * 6];
        Ok(vec![Image { camera: "front".to_owned(), width: 8, height: 6, rgb }])
    }
}

fn hello() -> Hello {
    Hello {
        server: Program { name: "test".to_owned(), version: "1".to_owned() },
        engine: Engine { name: "toy".to_owned(), version: "1".to_owned(), solver: None },
        robot: Robot { name: "toy".to_owned(), sha256: None },
        time_step_s: PERIOD,
        control_period_s: PERIOD,
        time_limit_s: 2.0,
        joints: ["a", "b", "c"].map(str::to_owned).to_vec(),
        action_spaces: vec![ActionSpace::JointPosition, ActionSpace::ToolDelta],
        tool_delta: Some(DeltaScale { translation_m: 0.02, rotation_rad: 0.05 }),
        cameras: vec![Camera { name: "front".to_owned(), width: 8, height: 6 }],
        quaternion_order: "wxyz".to_owned(),
        image_origin: "top_left".to_owned(),
        parameters: vec!["mass_kg".to_owned(), "shape".to_owned()],
        judges: true,
        deterministic: true,
    }
}

/// Goes a little further each time, and looks at every third tick.
#[derive(Default)]
struct Creep(u32);

impl Policy for Creep {
    fn reset(&mut self, _: &TaskSpec, _: Seed) -> Result<(), Fault> {
        self.0 = 0;
        Ok(())
    }

    fn looks(&self) -> bool {
        self.0.is_multiple_of(3)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        assert_eq!(observation.images.len(), usize::from(self.looks()));
        self.0 += 1;
        let joints = observation.joint_positions.iter().map(|q| q + 0.01).collect();
        Ok(Action { arm: ArmCommand::JointPositions(joints), gripper: GripperCommand::Close, phase: None })
    }
}

fn scenario(index: u64) -> Scenario {
    let mut requested = Assignment::default();
    requested.set("shape", Value::Category("box".into()));
    requested.set("mass_kg", Value::Number(0.1 + 0.01 * index as f64));
    Scenario { index, seed: Seed::campaign(u64::MAX - 3).episode(index), requested }
}

/// What a server does to the frames of its `n`th reply, to this request. Nothing: it goes away.
type Lie = fn(n: u64, request: &[u8], reply: Vec<Vec<u8>>) -> Option<Vec<Vec<u8>>>;

fn honest(_: u64, _: &[u8], reply: Vec<Vec<u8>>) -> Option<Vec<Vec<u8>>> {
    Some(reply)
}

/// A server in a thread of its own.
struct Running {
    address: Address,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    fn start(hello: Hello, lie: Lie) -> Self {
        let replier = Replier::bind(&"tcp://127.0.0.1:*".parse().unwrap(), REQUEST).unwrap();
        let (address, stop) = (replier.address().clone(), Arc::new(AtomicBool::new(false)));
        let stopping = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut server = Server::new(Judging::new(hello, Box::new(Toy::default())));
            let mut n = 0;
            replier.serve(&stopping, &mut |request| {
                let reply = server.answer(&request);
                n += 1;
                lie(n, request.first().map_or(&[], Vec::as_slice), reply).unwrap_or_else(|| {
                    stopping.store(true, Ordering::Relaxed);
                    Vec::new()
                })
            });
        });
        Self { address, stop, thread: Some(thread) }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

fn patience() -> Patience {
    Patience::of(Duration::from_millis(400))
}

/// All that a pool said of its servers.
type Heard = Arc<Mutex<Vec<String>>>;

fn pool(servers: &[&Running]) -> (Arc<Pool>, Heard) {
    let addresses: Vec<Address> = servers.iter().map(|server| server.address.clone()).collect();
    let heard = Heard::default();
    let listener = Arc::clone(&heard);
    let listener = Box::new(move |what: &str| listener.lock().unwrap().push(what.to_owned()));
    let pool = Pool::connect(&addresses, patience(), listener).unwrap().resting(Duration::from_millis(20));
    (Arc::new(pool), heard)
}

/// Episodes 0 to `count` by `workers` at once, in order.
fn run(pool: &Arc<Pool>, workers: usize, count: u64) -> Vec<Episode> {
    let next = AtomicU64::new(0);
    let mut episodes: Vec<Episode> = std::thread::scope(|scope| {
        let work = || {
            let mut simulator = Remote::<NoWorld>::new(Arc::clone(pool), None).unwrap();
            let mut done = Vec::new();
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= count {
                    return done;
                }
                done.push(rollout(&mut simulator, &mut Creep::default(), &scenario(index)));
            }
        };
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap()).collect()
    });
    episodes.sort_by_key(|episode| episode.scenario.index);
    episodes
}

fn here(index: u64) -> Episode {
    rollout(&mut Toy::default(), &mut Creep::default(), &scenario(index))
}

#[test]
fn an_episode_behind_the_bridge_is_the_episode_before_it_to_the_bit() {
    let (one, other) = (Running::start(hello(), honest), Running::start(hello(), honest));
    let (pool, heard) = pool(&[&one, &other]);
    for workers in [1, 2, 5] {
        let episodes = run(&pool, workers, 30);
        for (index, episode) in (0..).zip(&episodes) {
            assert_eq!(*episode, here(index));
        }
    }
    assert_eq!(*heard.lock().unwrap(), Vec::<String>::new());
}

/// The request's op.
fn op(request: &[u8]) -> String {
    decode::<Request<Rest>>(request).map_or_else(|_| String::new(), |request| request.op)
}

#[derive(serde::Serialize, serde::Deserialize)]
struct Rest {}

/// Changes the steps of a reply to a step.
fn in_steps(request: &[u8], mut reply: Vec<Vec<u8>>, change: impl Fn(&mut Stepped<Nothing>)) -> Vec<Vec<u8>> {
    if op(request) == "step" {
        let mut steps: Stepped<Nothing> = decode(&reply[0]).unwrap();
        let envelope: Envelope = decode(&reply[0]).unwrap();
        change(&mut steps);
        reply[0] = encode(&robogate_remote::message::Reply { envelope, body: steps }).unwrap();
    }
    reply
}

/// Lies told in the middle of an episode, and the word by which they are known.
const LIES: [(&str, Lie); 13] = [
    ("closed the connection", |n, _, reply| (n < 8).then_some(reply)),
    ("no answer within", |n, _, reply| {
        if n == 8 {
            std::thread::sleep(Duration::from_millis(900));
        }
        Some(reply)
    }),
    ("not finite", |_, request, reply| {
        Some(in_steps(request, reply, |s| s.steps[0].observation.joint_positions[1] = f64::NAN))
    }),
    ("not finite", |_, request, reply| {
        Some(in_steps(request, reply, |s| s.steps[0].observation.tool_pose.position[0] = f64::INFINITY))
    }),
    ("joint positions", |_, request, reply| {
        Some(in_steps(request, reply, |s| s.steps[0].observation.joint_positions.push(0.0)))
    }),
    ("no rotation", |_, request, reply| {
        Some(in_steps(request, reply, |s| s.steps[0].observation.tool_pose.orientation = [1.0, 0.2, 0.0, 0.0]))
    }),
    ("was due", |_, request, reply| Some(in_steps(request, reply, |s| s.steps[0].observation.time_s += PERIOD))),
    ("no measures", |_, request, reply| Some(in_steps(request, reply, |s| s.steps[0].measures = None))),
    ("one step", |_, request, reply| Some(in_steps(request, reply, |s| s.steps.clear()))),
    ("of episode", |n, _, mut reply| {
        let envelope: Envelope = decode(&reply[0]).unwrap();
        if n == 8 {
            reply[0] = encode(&Envelope { episode: envelope.episode ^ 8, ..envelope }).unwrap();
        }
        Some(reply)
    }),
    ("at most", |n, _, mut reply| {
        if n == 8 {
            reply[0] = vec![0x80; (48 << 20) + 1];
        }
        Some(reply)
    }),
    ("breaks the protocol", |n, _, mut reply| {
        if n == 8 {
            reply[0].truncate(20);
        }
        Some(reply)
    }),
    ("8 x 6 pixels", |_, request, mut reply| {
        if op(request) == "render" {
            reply[1].pop();
        }
        Some(reply)
    }),
];

#[test]
fn a_server_that_dies_hangs_or_lies_costs_invalid_episodes_and_never_a_wrong_one() {
    for (word, lie) in LIES {
        let (good, bad) = (Running::start(hello(), honest), Running::start(hello(), lie));
        let (pool, heard) = pool(&[&bad, &good]);
        let began = Instant::now();
        let episodes = run(&pool, 2, 60);
        assert!(began.elapsed() < Duration::from_secs(10), "{word}: {:?}", began.elapsed());
        let mut invalid = 0;
        for (index, episode) in (0..).zip(&episodes) {
            if let Outcome::Invalid(fault) = &episode.outcome {
                assert_eq!(fault.kind, FaultKind::Unavailable, "{fault}");
                assert!(fault.detail.starts_with("tcp://127.0.0.1:"), "{fault}");
                invalid += 1;
            } else {
                assert_eq!(*episode, here(index), "{word}");
            }
        }
        let heard = heard.lock().unwrap();
        assert!((1..=5).contains(&invalid), "{word}: {invalid} invalid; {heard:?}");
        assert!(heard.iter().any(|what| what.contains(word)), "{word}: {heard:?}");
        assert!(heard.iter().all(|what| what.contains(&bad.address.to_string())), "{heard:?}");
    }
}

#[test]
fn a_failure_at_the_reset_costs_nothing_while_another_server_is_there() {
    let lie: Lie = |_, request, mut reply| {
        if op(request) == "reset" {
            reply[0].truncate(30);
        }
        Some(reply)
    };
    let (good, bad) = (Running::start(hello(), honest), Running::start(hello(), lie));
    let (pool, heard) = pool(&[&bad, &good]);
    for (index, episode) in (0..).zip(run(&pool, 2, 60)) {
        assert_eq!(episode, here(index));
    }
    assert!(!heard.lock().unwrap().is_empty());
}

#[test]
fn when_no_server_is_left_every_episode_is_invalid_at_once() {
    let bad = Running::start(hello(), |n, _, reply| (n < 8).then_some(reply));
    let (pool, heard) = pool(&[&bad]);
    let began = Instant::now();
    let episodes = run(&pool, 3, 200);
    assert!(began.elapsed() < Duration::from_secs(8), "{:?}", began.elapsed());
    assert!(episodes.iter().all(|episode| matches!(episode.outcome, Outcome::Invalid(_))));
    let Outcome::Invalid(fault) = &episodes[199].outcome else { unreachable!() };
    assert!(fault.detail.starts_with("no simulator is left: tcp://"), "{fault}");
    assert!(heard.lock().unwrap().last().unwrap().contains("not asked again after 5 failures"));
}

#[test]
fn what_a_scenario_or_an_action_has_done_wrong_is_not_blamed_on_the_server() {
    let server = Running::start(hello(), honest);
    let (pool, heard) = pool(&[&server]);
    let mut simulator = Remote::<NoWorld>::new(Arc::clone(&pool), None).unwrap();
    let mut heavy = scenario(0);
    heavy.requested.set("mass_kg", Value::Number(101.0));
    let mut unknown = scenario(0);
    unknown.requested.set("friction", Value::Number(0.5));
    for _ in 0..10 {
        let fault = simulator.reset(&heavy).unwrap_err();
        assert!(fault.kind == FaultKind::Setup && fault.detail.contains("too heavy"), "{fault}");
        assert_eq!(simulator.reset(&unknown).unwrap_err().kind, FaultKind::NotApplied);
        simulator.reset(&scenario(0)).unwrap();
        let far = ArmCommand::ToolDelta { translation_m: [0.021, 0.0, 0.0], rotation_rad: [0.0; 3] };
        let fault = simulator.step(&Action { arm: far, gripper: GripperCommand::Open, phase: None }).unwrap_err();
        assert!(fault.kind == FaultKind::BadAction && fault.detail.contains("up to 0.02 m"), "{fault}");
    }
    assert!(heard.lock().unwrap().is_empty());
}

#[test]
fn ways_of_the_tool_arrive_as_they_were_meant() {
    let server = Running::start(hello(), honest);
    let mut simulator = Remote::<NoWorld>::new(pool(&[&server]).0, None).unwrap();
    let start = simulator.reset(&scenario(0)).unwrap();
    let way = ArmCommand::ToolDelta { translation_m: [0.01, 0.0, 0.0], rotation_rad: [0.0; 3] };
    let step = simulator.step(&Action { arm: way, gripper: GripperCommand::Open, phase: None }).unwrap();
    assert!((step.observation.joint_positions[0] - start.observation.joint_positions[0] - 0.01).abs() < 1e-15);
}

#[test]
fn a_pool_is_one_simulator() {
    let one = Running::start(hello(), honest);
    let mut newer = hello();
    newer.engine.version = "2".to_owned();
    let other = Running::start(newer, honest);
    let connect = |addresses: &[&Address]| {
        let addresses: Vec<Address> = addresses.iter().copied().cloned().collect();
        Pool::connect(&addresses, patience(), Box::new(|_| {})).map(drop)
    };
    assert!(matches!(connect(&[&one.address, &other.address]), Err(PoolError::Differ { .. })));
    assert!(matches!(connect(&[&one.address, &one.address]), Err(PoolError::Servers(_))));
    assert!(matches!(connect(&[]), Err(PoolError::Servers(_))));
    let nobody: Address = "tcp://127.0.0.1:1".parse().unwrap();
    assert!(matches!(connect(&[&nobody]), Err(PoolError::Ask { .. })));
}

fn broken(server: &Running) -> (Report, BTreeSet<&'static str>) {
    let scenarios: Vec<Scenario> = (0..3).map(scenario).collect();
    let report = examine::<NoWorld>(&server.address, patience(), &scenarios, None).unwrap();
    let broken = report.clauses.iter().filter(|c| c.broken.is_some()).map(|c| c.name).collect();
    (report, broken)
}

#[test]
fn the_contract_holds_for_an_honest_server() {
    let (report, broken) = broken(&Running::start(hello(), honest));
    assert!(broken.is_empty(), "{:?}", report.clauses);
    assert_eq!(report.speeds.iter().map(|speed| speed.op).collect::<Vec<_>>(), ["hash", "step", "render"]);
}

#[test]
fn the_contract_finds_planted_lies() {
    let lies: [(&[&str], Lie); 6] = [
        (&["applied"], |_, request, mut reply| {
            if op(request) == "reset"
                && let Ok(mut begun) = decode::<Begun<Nothing, Nothing>>(&reply[0])
            {
                let envelope: Envelope = decode(&reply[0]).unwrap();
                begun.applied.as_mut().unwrap().insert("mass_kg".to_owned(), Number::Float(0.2));
                reply[0] = encode(&robogate_remote::message::Reply { envelope, body: begun }).unwrap();
            }
            Some(reply)
        }),
        (&["deterministic"], |n, request, reply| {
            if !decode::<Envelope>(&reply[0]).unwrap().ok {
                return Some(reply);
            }
            Some(in_steps(request, reply, |steps| steps.steps.iter_mut().for_each(|step| step.state_hash ^= n)))
        }),
        (&["moves", "deterministic"], |n, request, reply| {
            if !decode::<Envelope>(&reply[0]).unwrap().ok {
                return Some(reply);
            }
            let drift = 0.01 * n as f64;
            Some(in_steps(request, reply, |steps| steps.steps[0].observation.joint_positions[2] += drift))
        }),
        // It refuses nothing: what is wrong is done as if it had been asked for rightly.
        (
            &["unknown_parameter", "other_episode", "other_tick", "bad_action", "order", "malformed"],
            |_, request, mut reply| {
                let envelope: Envelope = decode(&reply[0]).unwrap();
                if !envelope.ok {
                    let episode = decode::<Request<Rest>>(request).map_or(0, |request| request.episode);
                    reply[0] = encode(&Envelope { ok: true, error: None, episode, ..envelope }).unwrap();
                }
                Some(reply)
            },
        ),
        (&["render"], |n, request, mut reply| {
            if op(request) == "render" && reply.len() > 1 {
                reply[1][0] ^= n as u8;
            }
            Some(reply)
        }),
        (&["handshake"], |n, request, mut reply| {
            if op(request) == "hello" && n > 1 {
                let changed = Hello { time_limit_s: 4.0, ..hello() };
                let envelope: Envelope = decode(&reply[0]).unwrap();
                reply[0] = encode(&robogate_remote::message::Reply { envelope, body: changed }).unwrap();
            }
            Some(reply)
        }),
    ];
    for (found, lie) in lies {
        let (report, broken) = broken(&Running::start(hello(), lie));
        for clause in found {
            assert!(broken.contains(clause), "{clause} is not found: {:?}", report.clauses);
        }
        assert!(!report.holds());
    }
}

#[test]
fn a_python_server_keeps_the_contract_and_gives_the_same_episodes_each_time() {
    let Some(python) = support::python() else { return };
    let script = support::root().join("bridges/common/tests/toy.py");
    let peer = support::Peer::start(&python, Path::new(&script), &[]);
    let said: serde_json::Value = serde_json::from_str(&peer.said).unwrap();
    let address: Address = said["listening"].as_str().unwrap().parse().unwrap();
    let scenarios: Vec<Scenario> = (0..3)
        .map(|index| {
            let mut scenario = scenario(index);
            scenario.requested = Assignment::default();
            scenario.requested.set("offset_x_m", Value::Number(0.01 * index as f64));
            scenario.requested.set("mass_kg", Value::Integer(1));
            scenario
        })
        .collect();
    let patience = Patience::of(Duration::from_secs(10));
    let report = examine::<NoWorld>(&address, patience, &scenarios, None).unwrap();
    assert!(report.holds(), "{:?}", report.clauses);
    let pool = Arc::new(Pool::connect(&[address], patience, Box::new(|_| {})).unwrap());
    let mut simulator = Remote::<NoWorld>::new(pool, None).unwrap();
    let mut episode = |i: usize| rollout(&mut simulator, &mut Creep::default(), &scenarios[i]);
    let (first, second) = (episode(0), episode(1));
    assert_eq!(episode(0), first);
    assert_ne!(first.trajectory_hash, second.trajectory_hash);
    assert_eq!(first.outcome, Outcome::Failure(FailureMode::Timeout));
}

#[test]
fn no_request_makes_a_server_panic_or_stay_silent() {
    let (began, time) = (Instant::now(), support::fuzz_time());
    let mut random = support::Random(7);
    let mut server = Server::new(Judging::new(hello(), Box::new(Toy::default())));
    let reset = Reset::<Nothing> {
        index: 1,
        seed: 2,
        parameters: [("mass_kg".to_owned(), Number::Float(1.0))].into(),
        cell: None,
    };
    let steps = Steps { tick: 0, action_space: ActionSpace::JointPosition, actions: vec![vec![0.1, 0.2, 0.3, 1.0]; 2] };
    let request = |op: &str, body: Vec<u8>| -> Vec<u8> {
        // A request's map and its body's, made one: both have fewer than 16 entries.
        let head = encode(&Request { v: 1, op: op.to_owned(), episode: 5, body: Nothing {} }).unwrap();
        let mut whole = vec![0x80 | ((head[0] & 0x0f) + (body[0] & 0x0f))];
        whole.extend_from_slice(&head[1..]);
        whole.extend_from_slice(&body[1..]);
        whole
    };
    let reset = request("reset", encode(&reset).unwrap());
    let requests = [
        reset.clone(),
        request("step", encode(&steps).unwrap()),
        request("hello", encode(&Nothing {}).unwrap()),
        request("render", encode(&Nothing {}).unwrap()),
        request("hash", encode(&Nothing {}).unwrap()),
        request("close", encode(&Nothing {}).unwrap()),
    ];
    let answered = |server: &mut Server<Judging>, frames: &[Vec<u8>]| {
        let reply = server.answer(frames);
        bounds::check(&reply[0]).unwrap();
        decode::<Envelope>(&reply[0]).unwrap().ok
    };
    for request in [&requests[0], &requests[1]] {
        assert!(answered(&mut server, std::slice::from_ref(request)));
    }
    let (mut runs, mut done) = (0_u64, 0_u64);
    while began.elapsed() < time {
        let mut bytes = requests[random.below(requests.len())].clone();
        random.mutate(&mut bytes);
        let frames = if random.below(50) == 0 { vec![bytes.clone(), bytes] } else { vec![bytes] };
        done += u64::from(answered(&mut server, &frames));
        if random.below(8) == 0 {
            answered(&mut server, std::slice::from_ref(&reset));
        }
        runs += 1;
    }
    eprintln!("{runs} requests, {done} of them done");
    assert!(done > 0);
}

#[test]
fn no_reply_makes_a_client_panic_and_none_with_a_number_that_is_not_finite_is_read() {
    let (began, time) = (Instant::now(), support::fuzz_time());
    let mut random = support::Random(8);
    let mut toy = Server::new(Judging::new(hello(), Box::new(Toy::default())));
    let reset = Reset::<Nothing> { index: 1, seed: 2, parameters: [].into(), cell: None };
    let steps = Steps { tick: 0, action_space: ActionSpace::JointPosition, actions: vec![vec![0.1; 4]; 3] };
    let ask = |server: &mut Server<Judging>, op: &str, body: &dyn erased::Body| {
        server.answer(&[body.request(op)]).swap_remove(0)
    };
    let replies = [
        ask(&mut toy, "hello", &erased::Of(Nothing {})),
        ask(&mut toy, "reset", &erased::Of(reset)),
        ask(&mut toy, "step", &erased::Of(steps)),
    ];
    assert!(replies.iter().all(|reply| decode::<Envelope>(reply).unwrap().ok));
    let (mut runs, mut read) = (0_u64, 0_u64);
    while began.elapsed() < time {
        let mut bytes = replies[random.below(replies.len())].clone();
        random.mutate(&mut bytes);
        if let Ok(hello) = decode::<Hello>(&bytes) {
            read += u64::from(hello.check().is_ok());
        }
        if let Ok(begun) = decode::<Begun<Nothing, Nothing>>(&bytes) {
            assert!(begun.observation.joint_positions.iter().all(|q| q.is_finite()));
            read += 1;
        }
        if let Ok(stepped) = decode::<Stepped<Nothing>>(&bytes) {
            assert!(stepped.steps.iter().all(|step| step.observation.time_s.is_finite()));
            read += 1;
        }
        runs += 1;
    }
    eprintln!("{runs} replies, {read} of them read");
    assert!(read > 0);
}

/// Bodies of several types behind one.
mod erased {
    use robogate_remote::message::{Request, encode};

    pub(super) trait Body {
        fn request(&self, op: &str) -> Vec<u8>;
    }

    pub(super) struct Of<T>(pub(super) T);

    impl<T: serde::Serialize + Clone> Body for Of<T> {
        fn request(&self, op: &str) -> Vec<u8> {
            encode(&Request { v: 1, op: op.to_owned(), episode: 5, body: self.0.clone() }).unwrap()
        }
    }
}
