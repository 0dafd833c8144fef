//! Tests of policies behind WebSocket servers: episodes, and the error for each kind of failure.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "support/direct.rs"]
mod direct;
#[path = "support/openpi.rs"]
mod openpi;
mod support;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use direct::direct;
use openpi::{actions, serve};
use robogate_core::{
    Action, ActionSpace, Command, FaultKind, Observation, Policy, Seed, TaskInstance, TaskSpec, VectorSpec, Word,
};
use robogate_policy::{ExternalPolicy, Profile};
use support::{begin, observation, task};
use tungstenite::{Message, WebSocket, accept};

fn profile(server: &str) -> Profile {
    let text = direct(Profile::built_in("pi0-libero").unwrap()).replace("length = 50", "length = 10");
    Profile::from_toml(&format!("{text}\n[server]\n{server}")).unwrap()
}

/// Starts a server that runs this conversation on each connection.
fn server(converse: impl Fn(usize, &mut WebSocket<TcpStream>) + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    serve(listener, move |number, socket| {
        converse(number, socket);
        ControlFlow::Continue(())
    });
    url
}

/// Starts a server that answers each request.
fn answering(answer: impl Fn(usize) -> Message + Send + 'static) -> String {
    server(move |_, socket| {
        let mut count = 0;
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                if socket.send(answer(count)).is_err() {
                    return;
                }
                count += 1;
            }
        }
    })
}

/// The fault of the first action of an episode.
fn first_fault(url: &str, server: &str) -> (FaultKind, String) {
    let mut policy = ExternalPolicy::connect(url, Arc::new(profile(server))).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    let fault = policy.act(&observation(256)).unwrap_err();
    (fault.kind, fault.detail)
}

#[test]
fn profile_sets_executed_actions() {
    let url = answering(|count| {
        Message::binary(actions(10, 7, |i, j| if j == 6 { [-1.0, 1.0][count] } else { 0.1 * i as f64 }))
    });
    let mut policy = ExternalPolicy::connect(&url, Arc::new(profile(""))).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    for step in 0..10 {
        assert_eq!(policy.wants_images(), step % 5 == 0, "step {step}");
        let action = policy.act(&observation(256)).unwrap();
        let Command::ToolDelta { translation_m, rotation_rad } = action.command else { panic!() };
        let raw = 0.1 * f64::from(step % 5);
        assert_eq!((translation_m, rotation_rad), ([raw * 0.02; 3], [raw * 0.05; 3]));
        assert_eq!(action.gripper, if step < 5 { Some(Action::OPEN) } else { Some(Action::CLOSE) });
    }
}

#[test]
fn errors_are_distinct_faults() {
    let text = answering(|_| Message::text("Traceback (most recent call last):\n  ...\nKeyError: 'observation/image'"));
    let nan = answering(|_| Message::binary(actions(10, 7, |i, j| if (i, j) == (3, 2) { f64::NAN } else { 0.0 })));
    let six = answering(|_| Message::binary(actions(10, 6, |_, _| 0.0)));
    let short = answering(|_| Message::binary(actions(9, 7, |_, _| 0.0)));
    let garbage = answering(|_| Message::binary(b"\xc1garbage".to_vec()));
    let slow = answering(|_| {
        thread::sleep(Duration::from_secs(2));
        Message::binary(actions(10, 7, |_, _| 0.0))
    });
    let dead = server(|_, socket| drop(socket.read()));
    let json = answering(|_| Message::text("{\"actions\": [[0.0]]}"));
    let (bad, away) = (FaultKind::BadAction, FaultKind::Unavailable);
    for (url, kind, start) in [
        (text, away, "policy error: Traceback"),
        (nan, bad, "not finite: number 2 of action 3 is NaN"),
        (six, bad, "wrong shape: an action has 6 numbers, but action.size of the profile is 7"),
        (short, bad, "wrong shape: the reply has 9 actions, but chunk.length of the profile is 10"),
        (garbage, away, "invalid reply: reply to infer: not valid msgpack"),
        (json, away, "invalid reply: reply to infer: the server sent JSON in a text message. Expected"),
        (slow, away, "timeout: infer took longer than 0.5 s"),
        (dead, away, "connection closed: the server closed the connection during infer"),
    ] {
        // Only the slow server may reach the limit, on a busy machine too.
        let limit = if start.starts_with("timeout") { "first_answer_s = 0.5" } else { "first_answer_s = 60" };
        let (got, detail) = first_fault(&url, limit);
        assert_eq!(got, kind, "{detail}");
        assert!(detail.starts_with(start), "{detail}");
    }
}

#[test]
fn claimed_frame_sizes_allocate_nothing() {
    let url = server(|_, socket| {
        drop(socket.read());
        let mut header = vec![0x82, 127];
        header.extend(u64::to_be_bytes(4 << 30));
        drop(socket.get_mut().write_all(&header));
        drop(socket.get_mut().write_all(&[0; 1 << 16]));
        thread::sleep(Duration::from_secs(1));
    });
    let before = resident_kb();
    let (_, detail) = first_fault(&url, "");
    assert!(detail.starts_with("too large: the reply has more than 8388608 bytes"), "{detail}");
    assert!(resident_kb() < before + 100_000);
}

/// Memory of this process in kB. Zero on systems that do not report it.
fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

#[test]
fn faults_open_a_new_connection() {
    let url = server(|number, socket| {
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                if number == 0 {
                    return;
                }
                socket.send(Message::binary(actions(10, 7, |_, _| 0.0))).unwrap();
            }
        }
    });
    let mut policy = ExternalPolicy::connect(&url, Arc::new(profile(""))).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    assert!(policy.act(&observation(256)).is_err());
    // The rest of the episode fails too, because it must not continue on another connection.
    assert!(policy.act(&observation(256)).is_err());
    begin(&mut policy, "pick up the box").unwrap();
    policy.act(&observation(256)).unwrap();
}

#[test]
fn connections_closed_between_episodes_lose_nothing() {
    let (closed, until_closed) = std::sync::mpsc::channel();
    let url = server(move |_, socket| {
        if matches!(socket.read(), Ok(message) if message.is_binary()) {
            socket.send(Message::binary(actions(10, 7, |_, _| 0.0))).unwrap();
            drop(socket.close(None).and_then(|()| socket.flush()));
            closed.send(()).unwrap();
        }
    });
    let mut policy = ExternalPolicy::connect(&url, Arc::new(profile("attempts = 1"))).unwrap();
    for _ in 0..3 {
        begin(&mut policy, "pick up the box").unwrap();
        policy.act(&observation(256)).unwrap();
        until_closed.recv().unwrap();
    }
}

#[test]
fn servers_without_metadata_are_not_ready() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let mut silent = accept(listener.accept().unwrap().0).unwrap();
        drop(silent.read());
        drop(listener);
    });
    let error = ExternalPolicy::connect(&url, Arc::new(profile("connect_s = 0.2"))).unwrap_err().to_string();
    assert!(error.starts_with("not ready: ws://") && error.contains("no metadata within 0.2 s"), "{error}");
    assert!(error.contains("use --wait") && error.contains("dialect vla-eval"), "{error}");
}

#[test]
fn pings_are_answered_between_requests() {
    let (sender, ponged) = std::sync::mpsc::channel();
    let url = server(move |_, socket| {
        socket.send(Message::Ping(b"still there?".to_vec().into())).unwrap();
        sender.send(matches!(socket.read(), Ok(Message::Pong(_)))).unwrap();
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                socket.send(Message::binary(actions(10, 7, |_, _| 0.0))).unwrap();
            }
        }
    });
    let mut policy = ExternalPolicy::connect(&url, Arc::new(profile("first_answer_s = 60"))).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    // The answer comes before the next request.
    assert_eq!(ponged.recv_timeout(Duration::from_secs(60)), Ok(true));
    policy.act(&observation(256)).unwrap();
}

#[test]
fn other_dialects_are_identified() {
    let serve_bytes = |greeting: &'static [u8], http: &'static str| {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("ws://{}", listener.local_addr().unwrap());
        thread::spawn(move || {
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                drop(stream.write_all(greeting));
                stream.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
                let mut request = [0; 2048];
                if matches!(stream.read(&mut request), Ok(1..)) {
                    drop(stream.write_all(http.as_bytes()));
                }
            }
        });
        url
    };
    let zmq = serve_bytes(&[0xff, 0, 0, 0, 0, 0, 0, 0, 1, 0x7f], "");
    let fastapi = serve_bytes(&[], "HTTP/1.1 404 Not Found\r\nContent-Length: 22\r\n\r\n{\"detail\":\"Not Found\"}");
    let rest = serve_bytes(&[], "HTTP/1.1 200 OK\r\nContent-Length: 20\r\n\r\n{\"status\":\"healthy\"}");
    let grpc = serve_bytes(&[0, 0, 0, 4, 0, 0, 0, 0, 0], "");
    // A server of the user may have openpi's dialect without openpi's /healthz.
    let plain = serve_bytes(&[], "HTTP/1.1 426 Upgrade Required\r\nContent-Length: 0\r\n\r\n");
    let error = ExternalPolicy::connect(&plain, Arc::new(profile("connect_s = 2"))).unwrap_err().to_string();
    assert_eq!(error, "invalid reply: WebSocket handshake: HTTP 426 Upgrade Required");
    for (url, name) in [(zmq, "ZeroMQ"), (fastapi, "openvla"), (rest, "dialect rest"), (grpc, "dialect lerobot")] {
        let error = ExternalPolicy::connect(&url, Arc::new(profile("connect_s = 2"))).unwrap_err().to_string();
        assert!(error.starts_with("wrong dialect: the profile expects openpi, but"), "{error}");
        assert!(error.contains(name), "{error}");
    }
}

#[test]
fn roboarena_servers_are_identified() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let mut socket = accept(listener.accept().unwrap().0).unwrap();
        let config = include_bytes!("captures/roboarena/s2c_00_config_metadata.bin");
        socket.send(Message::binary(config.to_vec())).unwrap();
        drop(socket.read());
    });
    let error = ExternalPolicy::connect(&url, Arc::new(profile(""))).unwrap_err().to_string();
    assert!(error.contains("RoboArena"), "{error}");
}

#[test]
fn unreachable_servers_are_reported_quickly() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let start = Instant::now();
    let error = ExternalPolicy::connect(&format!("ws://{free}"), Arc::new(profile(""))).unwrap_err().to_string();
    assert!(error.starts_with("unreachable: "), "{error}");
    assert!(start.elapsed() < Duration::from_secs(20));
}

#[test]
fn addresses_are_checked_first() {
    for (url, part) in [
        ("wss://", "port"),
        ("ws://host", "port"),
        ("http://host:1", "ws://HOST:PORT"),
        ("ws://:1", "ws://HOST:PORT"),
        ("nonsense", "ws://HOST:PORT"),
    ] {
        let error = ExternalPolicy::connect(url, Arc::new(profile(""))).unwrap_err().to_string();
        assert!(error.starts_with("invalid address: ") && error.contains(part), "{error}");
    }
}

#[test]
fn missing_cameras_are_named() {
    let url = answering(|_| Message::binary(actions(10, 7, |_, _| 0.0)));
    let mut policy = ExternalPolicy::connect(&url, Arc::new(profile(""))).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    let mut blind = observation(256);
    blind.images.remove(1);
    let fault = policy.act(&blind).unwrap_err();
    assert_eq!(fault.kind, FaultKind::Setup);
    assert!(fault.detail.contains("requires the camera `wrist`; the cell has front"), "{}", fault.detail);
}

#[test]
fn task_must_match_the_profile() {
    let url = answering(|_| Message::binary(actions(10, 7, |_, _| 0.0)));
    let policy = ExternalPolicy::connect(&url, Arc::new(profile(""))).unwrap();
    assert_eq!(policy.check(&task()), Ok(()));
    let lacks = |change: &dyn Fn(&mut TaskSpec)| {
        let mut task = task();
        change(&mut task);
        policy.check(&task).unwrap_err()
    };
    for (why, part) in [
        (lacks(&|task| drop(task.observation.cameras.pop())), "uses the camera `wrist`; the task has front"),
        (lacks(&|task| drop(task.observation.vectors.pop())), "uses the vector `tool_pose`; the task observes joint_"),
        (lacks(&|task| drop(task.action.spaces.pop())), "commands tool_delta; the task takes joint_position"),
        (lacks(&|task| task.action.gripper = None), "commands a gripper; the task has none"),
    ] {
        assert!(why.contains(part), "{why}");
    }
}

/// A task without a robot: the model observes a named vector and returns the task's own action vector.
#[test]
fn vector_actions_stay_within_bounds() {
    let text = Profile::built_in("pi0-libero").unwrap();
    let (head, _) = text.split_once("[[camera]]").unwrap();
    let rest = "[[state]]\nkey = \"state\"\nvectors = [\"levels\"]\n[action]\nsize = 2\narm = \"vector\"\n\
                [chunk]\nexecute = 1\n";
    let url = answering(|_| Message::binary(actions(1, 2, |_, j| if j == 0 { 0.25 } else { 1.5 })));
    let mut policy =
        ExternalPolicy::connect(&url, Arc::new(Profile::from_toml(&format!("{head}{rest}")).unwrap())).unwrap();
    let mut task = task();
    let levels = Word::constant("levels");
    task.observation.vectors = vec![VectorSpec { name: levels, length: 2, unit: "m".to_owned() }];
    task.action.gripper = None;
    let names = ["in", "out"].map(str::to_owned).to_vec();
    task.action.spaces = vec![ActionSpace::Vector { names, low: vec![0.0; 2], high: vec![1.0; 2] }];
    policy.check(&task).unwrap();
    policy.reset(&task, &TaskInstance::default(), Seed::campaign(1)).unwrap();
    let seen = Observation { time_s: 0.0, vectors: vec![(levels, vec![0.1, 0.2])], images: Vec::new() };
    let action = policy.act(&seen).unwrap();
    assert_eq!(action, Action { command: Command::Vector(vec![0.25, 1.0]), gripper: None, phase: None });
    task.check_action(&action).unwrap();
}
