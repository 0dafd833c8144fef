//! Conformance tests of conforming servers, and of servers with violations.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use robogate_core::{Assignment, FailureMode, Outcome, Scenario, Value, rollout};
use robogate_remote::conformance::{Report, check, scenarios};
use robogate_remote::header::{decode, encode};
use robogate_remote::message::{Empty, Envelope, ParameterValue, Reply, Request, ResetReply};
use robogate_remote::{Connection, Pool, RemoteEnvironment, ScoredSession, Timeouts};
use robogate_zmtp::Address;

use crate::server::{AnyBody, Running, Tamper, in_steps, joints, op, timeouts, unchanged};
use crate::support;
use crate::toy::{Creep, hello, scenario};

/// The report on a server, and the names of the checks that failed.
fn run(server: &Running) -> (Report, BTreeSet<&'static str>) {
    let scenarios: Vec<Scenario> = (0..3).map(scenario).collect();
    let report = check(&server.address, timeouts(), &scenarios, &mut ScoredSession::default()).unwrap();
    let failed = report.results.iter().filter(|result| result.violation.is_some()).map(|result| result.name).collect();
    (report, failed)
}

#[test]
fn a_conforming_server_passes() {
    let (report, failed) = run(&Running::start(hello(), unchanged));
    assert!(failed.is_empty(), "{:?}", report.results);
    assert_eq!(report.latencies.iter().map(|latency| latency.op).collect::<Vec<_>>(), ["hash", "step", "render"]);
}

#[test]
fn planted_violations_are_found() {
    let cases: [(&[&str], Tamper); 8] = [
        (&["applied"], |_, request, mut reply| {
            if op(request) == "reset"
                && let Ok(mut body) = decode::<ResetReply<Empty, Empty>>(&reply[0])
            {
                let envelope: Envelope = decode(&reply[0]).unwrap();
                body.applied.as_mut().unwrap().insert("mass_kg".to_owned(), ParameterValue::Float(0.2));
                reply[0] = encode(&Reply { envelope, body }).unwrap();
            }
            Some(reply)
        }),
        (&["deterministic"], |n, request, reply| {
            if !decode::<Envelope>(&reply[0]).unwrap().ok {
                return Some(reply);
            }
            Some(in_steps::<Empty>(request, reply, |steps| {
                steps.steps.iter_mut().for_each(|step| step.state_hash ^= n)
            }))
        }),
        (&["moves", "deterministic"], |n, request, reply| {
            if !decode::<Envelope>(&reply[0]).unwrap().ok {
                return Some(reply);
            }
            let drift = 0.01 * n as f64;
            Some(in_steps::<Empty>(request, reply, |steps| joints(&mut steps.steps[0])[2] += drift))
        }),
        // This server rejects no request.
        (
            &["unknown_parameter", "other_episode", "other_tick", "bad_action", "order", "malformed"],
            |_, request, mut reply| {
                let envelope: Envelope = decode(&reply[0]).unwrap();
                if !envelope.ok {
                    let episode = decode::<Request<AnyBody>>(request).map_or(0, |request| request.episode);
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
        (&["motion"], |_, request, mut reply| {
            if op(request) == "motion" && reply.len() > 1 {
                reply[1].truncate(4 * 15);
            }
            Some(reply)
        }),
        (&["declared"], |_, request, reply| {
            if !decode::<Envelope>(&reply[0]).unwrap().ok {
                return Some(reply);
            }
            Some(in_steps::<Empty>(request, reply, |steps| {
                let measures = steps.steps[0].measures.as_mut().unwrap();
                measures.insert("mood".to_owned(), Some(1.0));
            }))
        }),
        (&["handshake"], |n, request, mut reply| {
            if op(request) == "hello" && n > 1 {
                let mut changed = hello();
                changed.task.time_limit_s = 4.0;
                let envelope: Envelope = decode(&reply[0]).unwrap();
                reply[0] = encode(&Reply { envelope, body: changed }).unwrap();
            }
            Some(reply)
        }),
    ];
    for (checks, tamper) in cases {
        let (report, failed) = run(&Running::start(hello(), tamper));
        for name in checks {
            assert!(failed.contains(name), "{name} passed: {:?}", report.results);
        }
        assert!(!report.passed());
    }
}

#[test]
fn invalid_tasks_end_the_check() {
    let tamper: Tamper = |_, request, mut reply| {
        if op(request) == "hello" {
            let mut changed = hello();
            changed.task.parameters.push(changed.task.parameters[0].clone());
            let envelope: Envelope = decode(&reply[0]).unwrap();
            reply[0] = encode(&Reply { envelope, body: changed }).unwrap();
        }
        Some(reply)
    };
    let (report, failed) = run(&Running::start(hello(), tamper));
    assert_eq!((failed, report.results.len()), (BTreeSet::from(["task"]), 1));
    assert!(report.results[0].violation.as_ref().unwrap().contains("`mass_kg` is declared twice"));
}

#[test]
fn scenarios_combine_all_value_sources() {
    let task = hello().task;
    let mut base = Assignment::default();
    base.set("shape", Value::Category("sphere".into()));
    for scenario in scenarios(&task, None, &base, 2).unwrap() {
        assert_eq!(scenario.requested.number("mass_kg"), Some(1.0));
        assert_eq!(scenario.requested.category("shape"), Some("sphere"));
    }
    let space = Arc::new(task.declared_space().unwrap());
    let sampled = scenarios(&task, Some(&space), &base, 2).unwrap();
    assert_ne!(sampled[0].requested.number("mass_kg"), sampled[1].requested.number("mass_kg"));
    assert_eq!(sampled[0].requested.category("shape"), Some("sphere"));
    base.set("colour", Value::Integer(1));
    let why = scenarios(&task, None, &base, 2).unwrap_err();
    assert!(why.contains("no parameter `colour`. Expected one of: mass_kg, shape"), "{why}");
}

/// Starts a Python server of a toy simulator. Returns the process and its address.
fn python(kind: &str) -> Option<(support::Peer, Address)> {
    let python = support::python()?;
    let peer = support::Peer::start(&python, &support::root().join("bridges/common/tests/toy.py"), &["--kind", kind]);
    let line: serde_json::Value = serde_json::from_str(&peer.first_line).unwrap();
    let address = line["listening"].as_str().unwrap().parse().unwrap();
    Some((peer, address))
}

#[test]
fn python_servers_conform_and_repeat() {
    let Some((_peer, address)) = python("gantry") else { return };
    let scenarios: Vec<Scenario> = (0..3)
        .map(|index| {
            let mut scenario = scenario(index);
            scenario.requested = Assignment::default();
            scenario.requested.set("offset_x_m", Value::Number(0.01 * index as f64));
            scenario.requested.set("mass_kg", Value::Integer(1));
            scenario
        })
        .collect();
    let timeouts = Timeouts::from_step(Duration::from_secs(10));
    let report = check(&address, timeouts, &scenarios, &mut ScoredSession::default()).unwrap();
    assert!(report.passed(), "{:?}", report.results);
    let pool = Arc::new(Pool::connect(&[address], timeouts, Box::new(|_| {})).unwrap());
    let mut simulator = RemoteEnvironment::new(pool).unwrap();
    let mut episode = |i: usize| rollout(&mut simulator, &mut Creep::default(), &scenarios[i]);
    let (first, second) = (episode(0), episode(1));
    assert_eq!(episode(0), first);
    assert_ne!(first.trajectory_hash, second.trajectory_hash);
    assert_eq!(first.outcome, Outcome::Failure(FailureMode::TIMEOUT));
}

/// A task without a robot: its own failure modes, measures, parameters and a vector as action.
#[test]
fn python_task_conforms() {
    let Some((_peer, address)) = python("tank") else { return };
    let timeouts = Timeouts::from_step(Duration::from_secs(10));
    let hello = Connection::open(address.clone(), timeouts).unwrap().hello().clone();
    assert!(hello.robot.is_none() && hello.task.name == "tank");
    let space = Arc::new(hello.task.declared_space().unwrap());
    let scenarios = scenarios(&hello.task, Some(&space), &Assignment::default(), 3).unwrap();
    let report = check(&address, timeouts, &scenarios, &mut ScoredSession::default()).unwrap();
    assert!(report.passed(), "{:?}", report.results);
}
