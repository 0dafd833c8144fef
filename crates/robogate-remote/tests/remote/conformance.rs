//! Conformance tests of servers that keep the protocol, and of servers that do not.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use robogate_core::{Assignment, FailureMode, Outcome, Scenario, Value, rollout};
use robogate_remote::conformance::{Report, check};
use robogate_remote::header::{decode, encode};
use robogate_remote::message::{Empty, Envelope, Hello, ParameterValue, Reply, Request, ResetReply};
use robogate_remote::{Pool, RemoteEnvironment, ScoredSession, Timeouts};
use robogate_zmtp::Address;

use crate::server::{AnyBody, Running, Tamper, in_steps, op, timeouts, unchanged};
use crate::support;
use crate::toy::{Creep, hello, scenario};

/// The report on a server, and the names of the checks that failed.
fn run(server: &Running) -> (Report, BTreeSet<&'static str>) {
    let scenarios: Vec<Scenario> = (0..3).map(scenario).collect();
    let report = check(&server.address, timeouts(), &scenarios, &mut ScoredSession).unwrap();
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
    let cases: [(&[&str], Tamper); 6] = [
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
            Some(in_steps::<Empty>(request, reply, |steps| steps.steps[0].observation.joint_positions[2] += drift))
        }),
        // It rejects nothing.
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
        (&["handshake"], |n, request, mut reply| {
            if op(request) == "hello" && n > 1 {
                let changed = Hello { time_limit_s: 4.0, ..hello() };
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
fn a_python_server_passes_and_repeats_episodes() {
    let Some(python) = support::python() else { return };
    let script = support::root().join("bridges/common/tests/toy.py");
    let peer = support::Peer::start(&python, Path::new(&script), &[]);
    let line: serde_json::Value = serde_json::from_str(&peer.first_line).unwrap();
    let address: Address = line["listening"].as_str().unwrap().parse().unwrap();
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
    let report = check(&address, timeouts, &scenarios, &mut ScoredSession).unwrap();
    assert!(report.passed(), "{:?}", report.results);
    let pool = Arc::new(Pool::connect(&[address], timeouts, Box::new(|_| {})).unwrap());
    let mut simulator = RemoteEnvironment::new(pool).unwrap();
    let mut episode = |i: usize| rollout(&mut simulator, &mut Creep::default(), &scenarios[i]);
    let (first, second) = (episode(0), episode(1));
    assert_eq!(episode(0), first);
    assert_ne!(first.trajectory_hash, second.trajectory_hash);
    assert_eq!(first.outcome, Outcome::Failure(FailureMode::Timeout));
}
