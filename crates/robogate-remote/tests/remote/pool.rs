//! Episodes in pools of servers, some of which fail.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use robogate_core::{Action, Command, Environment, Episode, FailureMode, FaultKind, Outcome, Value, rollout};
use robogate_remote::header::{decode, encode};
use robogate_remote::message::{Empty, EndingMessage, Envelope, ErrorKind, ErrorReply};
use robogate_remote::{Pool, PoolError, RemoteEnvironment, Timeouts};
use robogate_zmtp::Address;

use crate::server::{Running, Tamper, in_steps, joints, op, timeouts, unchanged, vector};
use crate::toy::{Creep, PERIOD, Toy, hello, scenario};

/// The lines that a pool reported about its servers.
type Messages = Arc<Mutex<Vec<String>>>;

fn pool(servers: &[&Running]) -> (Arc<Pool>, Messages) {
    pool_with(servers, timeouts())
}

fn pool_with(servers: &[&Running], timeouts: Timeouts) -> (Arc<Pool>, Messages) {
    let addresses: Vec<Address> = servers.iter().map(|server| server.address.clone()).collect();
    let messages = Messages::default();
    let listener = Arc::clone(&messages);
    let listener = Box::new(move |line: &str| {
        if line.contains(NO_ANSWER) {
            GIVEN_UP.store(true, Ordering::Relaxed);
        }
        listener.lock().unwrap().push(line.to_owned());
    });
    let pool = Pool::connect(&addresses, timeouts, listener).unwrap().with_backoff(Duration::from_millis(20));
    (Arc::new(pool), messages)
}

/// Run the episodes 0 to `count` with this many workers. Returns them in order.
fn run(pool: &Arc<Pool>, workers: usize, count: u64) -> Vec<Episode> {
    let next = AtomicU64::new(0);
    let mut episodes: Vec<Episode> = std::thread::scope(|scope| {
        let work = || {
            let mut simulator = RemoteEnvironment::new(Arc::clone(pool)).unwrap();
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

/// The same episode in this process.
fn local(index: u64) -> Episode {
    rollout(&mut Toy::default(), &mut Creep::default(), &scenario(index))
}

#[test]
fn remote_episodes_equal_local_ones() {
    let (one, other) = (Running::start(hello(), unchanged), Running::start(hello(), unchanged));
    let (pool, messages) = pool(&[&one, &other]);
    for workers in [1, 2, 5] {
        let episodes = run(&pool, workers, 30);
        for (index, episode) in (0..).zip(&episodes) {
            assert_eq!(*episode, local(index));
        }
    }
    assert_eq!(*messages.lock().unwrap(), Vec::<String>::new());
}

/// The message of a timeout.
const NO_ANSWER: &str = "no answer within";
/// The timeout of a step where a server answers too late. The sound one answers far earlier, even on a busy machine.
const LATE: Duration = Duration::from_secs(10);
/// Whether a client has given up waiting for a server.
static GIVEN_UP: AtomicBool = AtomicBool::new(false);

/// Failures of a server during an episode, with a part of the expected message.
const FAILURES: [(&str, Tamper); 14] = [
    ("closed the connection", |n, _, reply| (n < 8).then_some(reply)),
    (NO_ANSWER, |n, _, reply| {
        let begun = Instant::now();
        // The limit is for a client that never gives up: the test then fails instead of waiting forever.
        while n == 8 && !GIVEN_UP.load(Ordering::Relaxed) && begun.elapsed() < 10 * LATE {
            std::thread::sleep(Duration::from_millis(20));
        }
        Some(reply)
    }),
    ("not finite", |_, request, reply| {
        Some(in_steps::<Empty>(request, reply, |s| joints(&mut s.steps[0])[1] = f64::NAN))
    }),
    ("not finite", |_, request, reply| {
        Some(in_steps::<Empty>(request, reply, |s| vector(&mut s.steps[0], "tool_pose")[0] = f64::INFINITY))
    }),
    ("`joint_positions` has 4 numbers", |_, request, reply| {
        Some(in_steps::<Empty>(request, reply, |s| joints(&mut s.steps[0]).push(0.0)))
    }),
    ("not a unit quaternion", |_, request, reply| {
        Some(in_steps::<Empty>(request, reply, |s| vector(&mut s.steps[0], "tool_pose")[4] = 0.2))
    }),
    ("a vector `mood`, which the task does not declare", |_, request, reply| {
        Some(in_steps::<Empty>(request, reply, |s| {
            s.steps[0].observation.vectors.insert("mood".to_owned(), vec![1.0]);
        }))
    }),
    ("expected 0.", |_, request, reply| {
        Some(in_steps::<Empty>(request, reply, |s| s.steps[0].observation.time_s += PERIOD))
    }),
    ("no `measures`", |_, request, reply| Some(in_steps::<Empty>(request, reply, |s| s.steps[0].measures = None))),
    ("0 steps for one action", |_, request, reply| Some(in_steps::<Empty>(request, reply, |s| s.steps.clear()))),
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
    ("malformed reply", |n, _, mut reply| {
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
fn server_failures_never_change_results() {
    for (part, tamper) in FAILURES {
        let (good, bad) = (Running::start(hello(), unchanged), Running::start(hello(), tamper));
        let late = part == NO_ANSWER;
        let timeouts = if late { Timeouts { step: LATE, ..timeouts() } } else { timeouts() };
        let (pool, messages) = pool_with(&[&bad, &good], timeouts);
        let episodes = run(&pool, 2, 60);
        let mut invalid = 0;
        for (index, episode) in (0..).zip(&episodes) {
            if let Outcome::Invalid(fault) = &episode.outcome {
                assert_eq!(fault.kind, FaultKind::Unavailable, "{fault}");
                assert!(fault.detail.starts_with("tcp://127.0.0.1:"), "{fault}");
                invalid += 1;
            } else {
                assert_eq!(*episode, local(index), "{part}");
            }
        }
        let messages = messages.lock().unwrap();
        assert!((1..=5).contains(&invalid), "{part}: {invalid} invalid; {messages:?}");
        assert!(messages.iter().any(|line| line.contains(part)), "{part}: {messages:?}");
        // Other failures do not cost a timeout.
        assert!(late || !messages.iter().any(|line| line.contains(NO_ANSWER)), "{part}: {messages:?}");
        assert!(messages.iter().all(|line| line.contains(&bad.address.to_string())), "{messages:?}");
    }
}

#[test]
fn failed_resets_move_to_another_server() {
    let tamper: Tamper = |_, request, mut reply| {
        if op(request) == "reset" {
            reply[0].truncate(30);
        }
        Some(reply)
    };
    let (good, bad) = (Running::start(hello(), unchanged), Running::start(hello(), tamper));
    let (pool, messages) = pool(&[&bad, &good]);
    for (index, episode) in (0..).zip(run(&pool, 2, 60)) {
        assert_eq!(episode, local(index));
    }
    assert!(!messages.lock().unwrap().is_empty());
}

#[test]
fn episodes_without_servers_are_invalid() {
    let bad = Running::start(hello(), |n, _, reply| (n < 8).then_some(reply));
    let (pool, messages) = pool(&[&bad]);
    let episodes = run(&pool, 3, 200);
    assert!(episodes.iter().all(|episode| matches!(episode.outcome, Outcome::Invalid(_))));
    let Outcome::Invalid(fault) = &episodes[199].outcome else { unreachable!() };
    assert!(fault.detail.starts_with("no simulator is left: tcp://"), "{fault}");
    let messages = messages.lock().unwrap();
    assert!(messages.last().unwrap().contains("not used again after 5 consecutive failures"));
    // No episode waited for a server.
    assert!(!messages.iter().any(|line| line.contains(NO_ANSWER)), "{messages:?}");
}

#[test]
fn bad_scenarios_are_not_server_failures() {
    let server = Running::start(hello(), unchanged);
    let (pool, messages) = pool(&[&server]);
    let mut simulator = RemoteEnvironment::new(Arc::clone(&pool)).unwrap();
    let mut heavy = scenario(0);
    heavy.requested.set("mass_kg", Value::Number(101.0));
    let mut unknown = scenario(0);
    unknown.requested.set("friction", Value::Number(0.5));
    for _ in 0..10 {
        let fault = simulator.reset(&heavy).unwrap_err();
        assert!(fault.kind == FaultKind::Setup && fault.detail.contains("too heavy"), "{fault}");
        assert_eq!(simulator.reset(&unknown).unwrap_err().kind, FaultKind::NotApplied);
        simulator.reset(&scenario(0)).unwrap();
        let fault = simulator.step(&move_tool(0.021)).unwrap_err();
        assert!(fault.kind == FaultKind::BadAction && fault.detail.contains("up to 0.02 m"), "{fault}");
    }
    assert!(messages.lock().unwrap().is_empty());
}

#[test]
fn tool_deltas_keep_their_size() {
    let server = Running::start(hello(), unchanged);
    let mut simulator = RemoteEnvironment::new(pool(&[&server]).0).unwrap();
    let start = simulator.reset(&scenario(0)).unwrap();
    let step = simulator.step(&move_tool(0.01)).unwrap();
    assert!((step.observation.joint_positions()[0] - start.observation.joint_positions()[0] - 0.01).abs() < 1e-15);
}

fn move_tool(metres: f64) -> Action {
    let command = Command::ToolDelta { translation_m: [metres, 0.0, 0.0], rotation_rad: [0.0; 3] };
    Action { command, gripper: Some(Action::OPEN), phase: None }
}

/// A server that ends each episode in its second control period, with this value as failure. A name in angle brackets
/// represents a value that is not a string.
fn ending(value: &'static str) -> Tamper {
    match value {
        "jammed at 40 N" => {
            |_, request, reply| Some(with_failure(request, reply, |out| out.extend(b"\xaejammed at 40 N")))
        }
        "<number>" => |_, request, reply| Some(with_failure(request, reply, |out| out.push(7))),
        "<map>" => |_, request, reply| Some(with_failure(request, reply, |out| out.extend(b"\x81\xa1a\xc3"))),
        "<list>" => |_, request, reply| Some(with_failure(request, reply, |out| out.push(0x90))),
        _ => |_, request, reply| Some(with_failure(request, reply, |out| out.extend(b"\xa7success"))),
    }
}

/// The reply to the second step, with an ending whose failure is written by `write`.
fn with_failure(request: &[u8], reply: Vec<Vec<u8>>, write: fn(&mut Vec<u8>)) -> Vec<Vec<u8>> {
    let mark = b"replace-me";
    let mut reply = in_steps::<Empty>(request, reply, |steps| {
        let step = &mut steps.steps[0];
        if step.observation.time_s > 1.5 * PERIOD {
            let failure = Some(FailureMode::constant("replace-me"));
            step.ending = Some(EndingMessage { failure, time_s: 2.0 * PERIOD, contact: None });
        }
    });
    let header = &mut reply[0];
    if let Some(at) = header.windows(mark.len()).position(|window| window == mark) {
        let rest = header.split_off(at + mark.len());
        header.truncate(at - 1);
        write(header);
        header.extend(rest);
    }
    reply
}

#[test]
fn failures_stay_failures() {
    for (value, name) in [
        ("jammed at 40 N", "jammed_at_40_N"),
        ("success", "unknown"),
        ("<number>", "unknown"),
        ("<map>", "unknown"),
        ("<list>", "unknown"),
    ] {
        let server = Running::start(hello(), ending(value));
        let (pool, messages) = pool(&[&server]);
        for episode in run(&pool, 1, 3) {
            assert_eq!(episode.outcome, Outcome::Failure(FailureMode::from_foreign(name)), "{value}");
        }
        let messages = messages.lock().unwrap();
        assert!(messages.len() == 1 && messages[0].contains(name), "{messages:?}");
    }
}

#[test]
fn undeclared_measures_are_reported_once() {
    let server = Running::start(hello(), |_, request, reply| {
        Some(in_steps::<Empty>(request, reply, |s| {
            s.steps[0].measures.as_mut().unwrap().insert("mood".to_owned(), Some(1.0));
        }))
    });
    let (pool, messages) = pool(&[&server]);
    for (index, episode) in (0..).zip(run(&pool, 2, 10)) {
        assert_eq!(episode, local(index));
    }
    let messages = messages.lock().unwrap();
    assert!(messages.len() == 1 && messages[0].contains("`mood` is ignored"), "{messages:?}");
}

#[test]
fn older_servers_are_rejected() {
    let server = Running::start(hello(), |_, _, mut reply| {
        let detail = "this server speaks version 2 of the protocol".to_owned();
        let error = Some(ErrorReply { kind: ErrorKind::BadRequest, detail });
        reply[0] = encode(&Envelope { v: 2, episode: 0, ok: false, error }).unwrap();
        Some(reply)
    });
    let why = Pool::connect(std::slice::from_ref(&server.address), timeouts(), Box::new(|_| {})).err().unwrap();
    let why = why.to_string();
    assert!(why.ends_with(
        "the server uses protocol version 2, but this robogate uses version 3. Upgrade the server (bridges/common of \
         this release)"
    ), "{why}");
}

#[test]
fn pool_servers_must_be_equal() {
    let one = Running::start(hello(), unchanged);
    let mut newer = hello();
    newer.engine.version = "2".to_owned();
    let other = Running::start(newer, unchanged);
    let connect = |addresses: &[&Address]| {
        let addresses: Vec<Address> = addresses.iter().copied().cloned().collect();
        Pool::connect(&addresses, timeouts(), Box::new(|_| {})).map(drop)
    };
    assert!(matches!(connect(&[&one.address, &other.address]), Err(PoolError::Mismatch { .. })));
    assert!(matches!(connect(&[&one.address, &one.address]), Err(PoolError::Duplicate(_))));
    assert!(matches!(connect(&[]), Err(PoolError::NoServer)));
    let unused: Address = "tcp://127.0.0.1:1".parse().unwrap();
    assert!(matches!(connect(&[&unused]), Err(PoolError::Request { .. })));
}

/// A server that fails is replaced by the one that the restart gives.
#[test]
fn failed_servers_are_started_again() {
    let broken = Running::start(hello(), |n, _, reply| (n < 8).then_some(reply));
    let fresh = Running::start(hello(), unchanged);
    let (address, starts) = (fresh.address.clone(), Arc::new(AtomicU64::new(0)));
    let counted = Arc::clone(&starts);
    let pool = Pool::connect(std::slice::from_ref(&broken.address), timeouts(), Box::new(|_| ())).unwrap();
    let pool = pool.with_backoff(Duration::from_millis(20)).with_restart(Box::new(move |position| {
        assert_eq!(position, 0);
        counted.fetch_add(1, Ordering::Relaxed);
        Ok(address.clone())
    }));
    let episodes = run(&Arc::new(pool), 1, 6);
    let invalid = episodes.iter().filter(|episode| matches!(episode.outcome, Outcome::Invalid(_))).count();
    assert_eq!((invalid, starts.load(Ordering::Relaxed)), (1, 1), "{episodes:?}");
    assert_eq!(episodes[5], local(5));
}

#[test]
fn servers_join_a_pool_later() {
    let (one, other) = (Running::start(hello(), unchanged), Running::start(hello(), unchanged));
    let (pool, _) = pool(&[&one]);
    pool.add(other.address.clone()).unwrap();
    assert_eq!(pool.len(), 2);
    assert!(matches!(pool.add(other.address.clone()), Err(PoolError::Duplicate(_))));
    let mut newer = hello();
    newer.engine.version = "2".to_owned();
    let different = Running::start(newer, unchanged);
    let added = pool.add(different.address.clone());
    assert!(matches!(added, Err(PoolError::Mismatch { .. })), "{added:?}");
}

#[test]
fn undeclared_policies_are_refused() {
    let server = Running::start(hello(), unchanged);
    let (pool, _) = pool(&[&server]);
    let why = RemoteEnvironment::with_policy(pool, "expert").err().unwrap().to_string();
    assert!(why.contains("declares no policy `expert`"), "{why}");
}
