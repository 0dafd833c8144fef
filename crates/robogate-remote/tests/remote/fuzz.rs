//! Fuzz tests with mutated requests and replies.

use std::time::Instant;

use robogate_remote::header::{check, decode, encode};
use robogate_remote::limits::VERSION;
use robogate_remote::message::{
    ActionKind, Empty, Envelope, Hello, MotionReply, ParameterValue, Request, ResetReply, ResetRequest, StepReply,
    StepRequest,
};
use robogate_remote::{EnvironmentHost, Server};

use crate::support;
use crate::toy::{Toy, hello};

#[test]
fn every_request_gets_a_reply() {
    let (began, time) = (Instant::now(), support::fuzz_time());
    let mut random = support::Random(7);
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
    let (mut runs, mut carried_out) = (0_u64, 0_u64);
    while began.elapsed() < time {
        let mut bytes = requests[random.below(requests.len())].clone();
        random.mutate(&mut bytes);
        let frames = if random.below(50) == 0 { vec![bytes.clone(), bytes] } else { vec![bytes] };
        carried_out += u64::from(accepted(&mut server, &frames));
        if random.below(8) == 0 {
            accepted(&mut server, std::slice::from_ref(&reset));
        }
        runs += 1;
    }
    eprintln!("{runs} requests, {carried_out} of them carried out");
    assert!(carried_out > 0);
}

#[test]
fn decoded_replies_are_finite() {
    let (began, time) = (Instant::now(), support::fuzz_time());
    let mut random = support::Random(8);
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
        packed: false,
    };
    let requests = [request("hello", Empty {}), request("reset", reset), request("step", steps)];
    let replies = requests.map(|request| toy.answer(&[request]).swap_remove(0));
    let motion = toy.answer(&[request("motion", Empty {})]);
    assert!(replies.iter().all(|reply| decode::<Envelope>(reply).unwrap().ok));
    let (mut runs, mut read) = (0_u64, 0_u64);
    while began.elapsed() < time {
        let mut bytes = replies[random.below(replies.len())].clone();
        random.mutate(&mut bytes);
        if let Ok(hello) = decode::<Hello>(&bytes) {
            read += u64::from(hello.check().is_ok());
        }
        if let Ok(reply) = decode::<ResetReply<Empty, Empty>>(&bytes) {
            assert!(reply.observation.vectors.values().flatten().all(|q| q.is_finite()));
            read += 1;
        }
        if let Ok(reply) = decode::<StepReply<Empty>>(&bytes) {
            assert!(reply.steps.iter().all(|step| step.observation.time_s.is_finite()));
            read += 1;
        }
        let mut frames = motion.clone();
        random.mutate(&mut frames[runs as usize % 4]);
        if let Ok(motion) =
            decode::<MotionReply>(&frames[0]).map_err(drop).and_then(|header| header.unpack(&frames[1..]).map_err(drop))
        {
            assert!(
                motion
                    .frames
                    .iter()
                    .flat_map(|frame| &frame.poses)
                    .all(|pose| pose.to_array().iter().all(|x| x.is_finite()))
            );
            read += 1;
        }
        runs += 1;
    }
    eprintln!("{runs} replies, {read} of them read");
    assert!(read > 0);
}

fn request(op: &str, body: impl serde::Serialize) -> Vec<u8> {
    encode(&Request { v: VERSION, op: op.to_owned(), episode: 5, body }).unwrap()
}
