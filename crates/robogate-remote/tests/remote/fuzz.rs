//! Fuzz tests with mutated requests and replies.

use std::cell::Cell;

use robogate_remote::header::{check, decode, encode};
use robogate_remote::limits::VERSION;
use robogate_remote::message::{
    ActionKind, Empty, Envelope, Hello, MotionReply, ParameterValue, Request, ResetReply, ResetRequest, StepReply,
    StepRequest,
};
use robogate_remote::{EnvironmentHost, Server};
use robogate_testing::fuzz::{self, Draw, mutate};

use crate::toy::{Toy, hello};

#[test]
fn fuzzed_requests_get_a_reply() {
    let mut server = Server::new(EnvironmentHost::new(hello(), Box::new(Toy::default())));
    let reset = ResetRequest::<Empty> {
        index: 1,
        seed: 2,
        parameters: [("mass_kg".to_owned(), ParameterValue::Float(1.0))].into(),
        cell: None,
        policy: None,
        record_s: Some(0.1),
    };
    let steps = StepRequest {
        tick: 0,
        action_space: ActionKind::JointPosition,
        actions: vec![vec![0.1, 0.2, 0.3, 1.0]; 2],
        ahead: 0,
        object: None,
        packed: false,
    };
    let reset = request("reset", reset);
    let requests = [
        reset.clone(),
        request("step", steps),
        request("hello", Empty {}),
        request("render", Empty {}),
        request("hash", Empty {}),
        request("motion", Empty {}),
        request("close", Empty {}),
    ];
    let accepted = |server: &mut Server<EnvironmentHost>, frames: &[Vec<u8>]| {
        let reply = server.answer(frames);
        check(&reply[0]).unwrap();
        decode::<Envelope>(&reply[0]).unwrap().ok
    };
    for request in [&requests[0], &requests[1]] {
        assert!(accepted(&mut server, std::slice::from_ref(request)));
    }
    let mut draw = Draw::new("order of the requests", 0);
    let counts = fuzz::run(
        "requests",
        20_000,
        |draw| mutate(&requests, &[], draw),
        |bytes| {
            let twice = draw.below(50) == 0;
            let carried_out = accepted(&mut server, &vec![bytes.to_vec(); 1 + usize::from(twice)]);
            if draw.below(8) == 0 {
                accepted(&mut server, std::slice::from_ref(&reset));
            }
            carried_out
        },
    );
    assert!(counts.read > 0 && counts.refused > 0, "{counts:?}");
}

#[test]
fn fuzzed_replies_are_finite_or_refused() {
    let mut toy = Server::new(EnvironmentHost::new(hello(), Box::new(Toy::default())));
    let reset = ResetRequest::<Empty> {
        index: 1,
        seed: 2,
        parameters: [].into(),
        cell: None,
        policy: None,
        record_s: Some(0.1),
    };
    let steps = StepRequest {
        tick: 0,
        action_space: ActionKind::JointPosition,
        actions: vec![vec![0.1; 4]; 3],
        ahead: 0,
        object: None,
        packed: false,
    };
    let requests = [request("hello", Empty {}), request("reset", reset), request("step", steps)];
    let replies = requests.map(|request| toy.answer(&[request]).swap_remove(0));
    let motion = toy.answer(&[request("motion", Empty {})]);
    assert!(replies.iter().all(|reply| decode::<Envelope>(reply).unwrap().ok));
    let counts = fuzz::run(
        "replies",
        20_000,
        |draw| mutate(&replies, &[], draw),
        |bytes| {
            let hello = decode::<Hello>(bytes).is_ok_and(|hello| hello.check().is_ok());
            let reset = decode::<ResetReply<Empty, Empty>>(bytes);
            let step = decode::<StepReply<Empty>>(bytes);
            for reply in reset.iter() {
                assert!(reply.observation.vectors.values().flatten().all(|q| q.is_finite()));
            }
            for reply in step.iter() {
                assert!(reply.steps.iter().all(|step| step.observation.time_s.is_finite()));
            }
            hello || reset.is_ok() || step.is_ok()
        },
    );
    assert!(counts.read > 0 && counts.refused > 0, "{counts:?}");
    // A recorded motion has four frames: one of them is changed.
    let changed = Cell::new(0);
    let change = |draw: &mut Draw| {
        let at = draw.below(motion.len());
        changed.set(at);
        mutate(&motion[at..=at], &[], draw)
    };
    let counts = fuzz::run("motions", 20_000, change, |bytes| {
        let mut frames = motion.clone();
        frames[changed.get()] = bytes.to_vec();
        let Ok(header) = decode::<MotionReply>(&frames[0]) else { return false };
        let Ok(motion) = header.unpack(&frames[1..]) else { return false };
        let mut poses = motion.frames.iter().flat_map(|frame| &frame.poses);
        assert!(poses.all(|pose| pose.to_array().iter().all(|x| x.is_finite())));
        true
    });
    assert!(counts.read > 0 && counts.refused > 0, "{counts:?}");
}

fn request(op: &str, body: impl serde::Serialize) -> Vec<u8> {
    encode(&Request { v: VERSION, op: op.to_owned(), episode: 5, body }).unwrap()
}
