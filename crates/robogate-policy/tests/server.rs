//! A policy behind a WebSocket: what goes right, and the name of whatever goes wrong.

#[path = "support/openpi.rs"]
mod openpi;
mod support;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use openpi::{actions, serve};
use robogate_core::{
    Action, ActionSpace, Command, FaultKind, Observation, Policy, Seed, TaskInstance, TaskSpec, VectorSpec, Word,
};
use robogate_policy::{Profile, ServerPolicy};
use support::{begin, observation, task};
use tungstenite::{Message, WebSocket, accept};

fn profile(server: &str) -> Profile {
    let text = Profile::built_in("pi0-libero").expect("it works here").replace("length = 50", "length = 10");
    Profile::from_toml(&format!("{text}\n[server]\n{server}")).expect("it works here")
}

/// A server that does as it is told with each connection.
fn server(converse: impl Fn(usize, &mut WebSocket<TcpStream>) + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("it works here");
    let url = format!("ws://{}", listener.local_addr().expect("it works here"));
    serve(listener, move |number, socket| {
        converse(number, socket);
        ControlFlow::Continue(())
    });
    url
}

/// Answers each question.
fn answering(answer: impl Fn(usize) -> Message + Send + 'static) -> String {
    server(move |_, socket| {
        let mut asked = 0;
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                if socket.send(answer(asked)).is_err() {
                    return;
                }
                asked += 1;
            }
        }
    })
}

/// What the first action of an episode comes to.
fn first_fault(url: &str, server: &str) -> (FaultKind, String) {
    let mut policy = ServerPolicy::connect(url, Arc::new(profile(server))).expect("it works here");
    begin(&mut policy, "pick up the box").expect("it works here");
    let fault = policy.act(&observation(256)).expect_err("it must fail");
    (fault.kind, fault.detail)
}

#[test]
fn a_chunk_is_executed_as_far_as_the_profile_says_and_then_asked_for_anew() {
    let url = answering(|asked| {
        Message::binary(actions(10, 7, |i, j| if j == 6 { [-1.0, 1.0][asked] } else { 0.1 * i as f64 }))
    });
    let mut policy = ServerPolicy::connect(&url, Arc::new(profile(""))).unwrap();
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
fn each_way_of_going_wrong_has_its_name_and_is_no_failure() {
    let text = answering(|_| Message::text("Traceback (most recent call last):\n  ...\nKeyError: 'observation/image'"));
    let nan = answering(|_| Message::binary(actions(10, 7, |i, j| if (i, j) == (3, 2) { f64::NAN } else { 0.0 })));
    let six = answering(|_| Message::binary(actions(10, 6, |_, _| 0.0)));
    let short = answering(|_| Message::binary(actions(9, 7, |_, _| 0.0)));
    let garbage = answering(|_| Message::binary(b"\xc1garbage".to_vec()));
    let deaf = answering(|_| {
        thread::sleep(Duration::from_secs(2));
        Message::binary(actions(10, 7, |_, _| 0.0))
    });
    let dead = server(|_, socket| drop(socket.read()));
    let (bad, away) = (FaultKind::BadAction, FaultKind::Unavailable);
    for (url, kind, words) in [
        (text, away, "refused: the server answers with an error: Traceback"),
        (nan, bad, "not finite: number 2 of action 3 is NaN"),
        (six, bad, "wrong shape: an action has 6 numbers, the profile's action.size is 7"),
        (short, bad, "wrong shape: 9 actions in an answer, the profile's chunk.length is 10"),
        (garbage, away, "undecodable: the answer to infer: no msgpack"),
        (deaf, away, "timeout: infer took longer than 0.5 s"),
        (dead, away, "died: the server closed the connection during infer"),
    ] {
        let (got, detail) = first_fault(&url, "first_answer_s = 0.5");
        assert_eq!(got, kind, "{detail}");
        assert!(detail.starts_with(words), "{detail}");
    }
}

#[test]
fn a_frame_that_claims_four_gigabytes_is_refused_before_memory_is_set_aside() {
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
    assert!(detail.starts_with("too large: an answer of more than 8388608 bytes"), "{detail}");
    assert!(resident_kb() < before + 100_000);
}

/// Memory of this process; zero where the system does not say.
fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

#[test]
fn after_a_fault_the_next_episode_begins_on_a_new_connection() {
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
    let mut policy = ServerPolicy::connect(&url, Arc::new(profile(""))).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    assert!(policy.act(&observation(256)).is_err());
    // Within the episode it stays broken: half an episode on another connection would be no evidence.
    assert!(policy.act(&observation(256)).is_err());
    begin(&mut policy, "pick up the box").unwrap();
    policy.act(&observation(256)).unwrap();
}

#[test]
fn pings_are_answered_while_nobody_asks() {
    let url = server(|_, socket| {
        socket.send(Message::Ping(b"still there?".to_vec().into())).unwrap();
        socket.get_mut().set_read_timeout(Some(Duration::from_secs(4))).unwrap();
        let ponged = matches!(socket.read(), Ok(Message::Pong(_)));
        while let Ok(message) = socket.read() {
            if message.is_binary() && ponged {
                socket.send(Message::binary(actions(10, 7, |_, _| 0.0))).unwrap();
            }
        }
    });
    let mut policy = ServerPolicy::connect(&url, Arc::new(profile("first_answer_s = 3"))).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    thread::sleep(Duration::from_millis(2500));
    policy.act(&observation(256)).unwrap();
}

#[test]
fn another_dialect_on_the_port_is_named() {
    let says = |unasked: &'static [u8], http: &'static str| {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("ws://{}", listener.local_addr().unwrap());
        thread::spawn(move || {
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                drop(stream.write_all(unasked));
                stream.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
                let mut request = [0; 2048];
                if matches!(stream.read(&mut request), Ok(1..)) {
                    drop(stream.write_all(http.as_bytes()));
                }
            }
        });
        url
    };
    let zmq = says(&[0xff, 0, 0, 0, 0, 0, 0, 0, 1, 0x7f], "");
    let fastapi = says(&[], "HTTP/1.1 404 Not Found\r\nContent-Length: 22\r\n\r\n{\"detail\":\"Not Found\"}");
    let rest = says(&[], "HTTP/1.1 200 OK\r\nContent-Length: 20\r\n\r\n{\"status\":\"healthy\"}");
    let grpc = says(&[0, 0, 0, 4, 0, 0, 0, 0, 0], "");
    for (url, name) in [(zmq, "ZeroMQ"), (fastapi, "openvla"), (rest, "dialect rest"), (grpc, "dialect lerobot")] {
        let error = ServerPolicy::connect(&url, Arc::new(profile("connect_s = 2"))).unwrap_err().to_string();
        assert!(error.starts_with("another dialect: the profile says openpi, but"), "{error}");
        assert!(error.contains(name), "{error}");
    }
}

#[test]
fn a_roboarena_server_is_told_from_an_openpi_one_by_its_metadata() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let mut socket = accept(listener.accept().unwrap().0).unwrap();
        let config = include_bytes!("captures/roboarena/s2c_00_config_metadata.bin");
        socket.send(Message::binary(config.to_vec())).unwrap();
        drop(socket.read());
    });
    let error = ServerPolicy::connect(&url, Arc::new(profile(""))).unwrap_err().to_string();
    assert!(error.contains("RoboArena"), "{error}");
}

#[test]
fn nobody_there_is_said_at_once_and_not_waited_for_forever() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let start = Instant::now();
    let error = ServerPolicy::connect(&format!("ws://{free}"), Arc::new(profile(""))).unwrap_err().to_string();
    assert!(error.starts_with("unreachable: "), "{error}");
    assert!(start.elapsed() < Duration::from_secs(5));
}

#[test]
fn addresses_are_checked_before_anything_is_sent() {
    for (url, words) in [
        ("wss://host:8000", "TLS"),
        ("ws://host", "port"),
        ("http://host:1", "ws://HOST:PORT"),
        ("ws://:1", "ws://HOST:PORT"),
        ("nonsense", "ws://HOST:PORT"),
    ] {
        let error = ServerPolicy::connect(url, Arc::new(profile(""))).unwrap_err().to_string();
        assert!(error.starts_with("bad address: ") && error.contains(words), "{error}");
    }
}

#[test]
fn a_camera_that_the_cell_has_not_is_named() {
    let url = answering(|_| Message::binary(actions(10, 7, |_, _| 0.0)));
    let mut policy = ServerPolicy::connect(&url, Arc::new(profile(""))).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    let mut blind = observation(256);
    blind.images.remove(1);
    let fault = policy.act(&blind).unwrap_err();
    assert_eq!(fault.kind, FaultKind::Setup);
    assert!(fault.detail.contains("asks for the camera `wrist`; the cell has front"), "{}", fault.detail);
}

#[test]
fn a_task_must_have_what_the_profile_uses() {
    let url = answering(|_| Message::binary(actions(10, 7, |_, _| 0.0)));
    let policy = ServerPolicy::connect(&url, Arc::new(profile(""))).unwrap();
    assert_eq!(policy.check(&task()), Ok(()));
    let lacks = |change: &dyn Fn(&mut TaskSpec)| {
        let mut task = task();
        change(&mut task);
        policy.check(&task).unwrap_err()
    };
    for (why, part) in [
        (lacks(&|task| drop(task.observation.cameras.pop())), "uses the camera `wrist`; the task has front"),
        (lacks(&|task| drop(task.observation.vectors.pop())), "uses the vector `tool_pose`; the task observes joint_"),
        (lacks(&|task| drop(task.action.spaces.pop())), "answers tool_delta; the task takes joint_position"),
        (lacks(&|task| task.action.gripper = None), "commands a gripper; the task has none"),
    ] {
        assert!(why.contains(part), "{why}");
    }
}

/// A task without a robot: the model sees a named vector and answers the numbers of the task's own action.
#[test]
fn a_vector_action_stays_within_its_bounds() {
    let text = Profile::built_in("pi0-libero").unwrap();
    let (head, _) = text.split_once("[[camera]]").unwrap();
    let rest = "[[state]]\nkey = \"state\"\nvectors = [\"levels\"]\n[action]\nsize = 2\narm = \"vector\"\n\
                [chunk]\nexecute = 1\n";
    let url = answering(|_| Message::binary(actions(1, 2, |_, j| if j == 0 { 0.25 } else { 1.5 })));
    let mut policy =
        ServerPolicy::connect(&url, Arc::new(Profile::from_toml(&format!("{head}{rest}")).unwrap())).unwrap();
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
