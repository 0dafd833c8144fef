//! The recorded motion of episodes in servers.

use std::sync::{Arc, Mutex};

use robogate_core::{Environment, Episode, Pose, Scenario, Trajectory, rollout};
use robogate_remote::message::{MotionReply, ShapeMessage, SolidMessage};
use robogate_remote::{Pool, RemoteEnvironment};

use crate::server::{Running, Tamper, op, timeouts, unchanged};
use crate::toy::{Creep, Toy, hello, scenario};

fn recorded(environment: &mut dyn Environment, scenario: &Scenario) -> (Episode, Option<Trajectory>) {
    environment.record_trajectory(Some(1.0 / 30.0));
    let episode = rollout(environment, &mut Creep::default(), scenario);
    (episode, environment.take_trajectory())
}

/// The result of an episode in a server, and what was reported about the server.
fn remote(tamper: Tamper) -> (Episode, Option<Trajectory>, Vec<String>) {
    let server = Running::start(hello(), tamper);
    let messages = Arc::new(Mutex::new(Vec::new()));
    let listener = Arc::clone(&messages);
    let listener = Box::new(move |line: &str| listener.lock().unwrap().push(line.to_owned()));
    let pool = Pool::connect(std::slice::from_ref(&server.address), timeouts(), listener).unwrap();
    let mut simulator = RemoteEnvironment::new(Arc::new(pool)).unwrap();
    let (episode, motion) = recorded(&mut simulator, &scenario(3));
    let messages = messages.lock().unwrap().clone();
    (episode, motion, messages)
}

#[test]
fn remote_motion_equals_local_motion() {
    let (episode, motion, messages) = remote(unchanged);
    let (local, expected) = recorded(&mut Toy::default(), &scenario(3));
    // The protocol has 32-bit floats.
    let (header, frames) = MotionReply::pack(&expected.unwrap());
    let expected = header.unpack(&frames).unwrap();
    assert!(expected.frames.len() > 10 && expected.solids.len() == 6 && expected.frames[2].contacts.len() == 1);
    assert_eq!((episode, motion, messages), (local, Some(expected), Vec::new()));
}

#[test]
fn invalid_motion_leaves_the_episode_valid() {
    let (episode, motion, messages) = remote(|_, request, mut reply| {
        if op(request) == "motion" {
            reply[1].pop();
        }
        Some(reply)
    });
    let (local, _) = recorded(&mut Toy::default(), &scenario(3));
    assert_eq!((episode, motion), (local, None));
    assert!(messages.iter().any(|line| line.contains("expected 32-bit floats")), "{messages:?}");
}

/// A reply with one body, one mesh of one triangle, one frame and one contact.
fn reply() -> (MotionReply, Vec<Vec<f32>>) {
    let solid = SolidMessage {
        body: 0,
        pose: Pose::IDENTITY,
        shape: ShapeMessage::Mesh { first: 0, count: 1 },
        color: [0; 3],
        opacity: 1.0,
    };
    let header = MotionReply { bodies: vec!["hand".to_owned()], solids: vec![solid], frames: 1 };
    let motion = vec![0.0, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0];
    (header, vec![motion, vec![0.5; 9], vec![0.0, 2.0, 1.0, 1.0, 1.0, 0.0, 0.0, 9.81]])
}

fn unpacked(change: impl FnOnce(&mut MotionReply, &mut Vec<Vec<f32>>)) -> Result<Trajectory, String> {
    let (mut header, mut frames) = reply();
    change(&mut header, &mut frames);
    let bytes = frames.iter().map(|frame| frame.iter().flat_map(|x| x.to_le_bytes()).collect());
    header.unpack(&bytes.collect::<Vec<Vec<u8>>>())
}

#[test]
fn contradictory_motion_is_rejected() {
    let valid = unpacked(|_, _| {}).unwrap();
    assert_eq!((valid.frames[0].poses[0].position, valid.frames[0].contacts.len()), ([1.0, 2.0, 3.0], 1));
    let mesh = |header: &mut MotionReply, first, count| header.solids[0].shape = ShapeMessage::Mesh { first, count };
    let cases = [
        (unpacked(|_, frames| drop(frames.pop())), "2 frames after the header"),
        (unpacked(|header, _| header.frames = usize::MAX), "the motion has 8 numbers"),
        (unpacked(|_, frames| frames[0][1] = f32::NAN), "number 1 of the motion is not finite"),
        (unpacked(|_, frames| frames[0][4] = 2.0), "not a unit quaternion"),
        (unpacked(|header, _| header.solids[0].body = 1), "solids[0]: the body does not exist"),
        (unpacked(|header, _| header.solids[0].pose.orientation[0] = 0.0), "solids[0]: its orientation"),
        (unpacked(|header, _| mesh(header, 1, 1)), "solids[0]: it has triangles that were not sent"),
        (unpacked(|header, _| mesh(header, usize::MAX, 2)), "solids[0]: it has triangles that were not sent"),
        (unpacked(|_, frames| frames[2][0] = 1.0), "a contact in frame 1"),
        (unpacked(|_, frames| frames[2][1] = 3.0), "a contact of the kind 3"),
        (unpacked(|_, frames| frames[2].truncate(7)), "the contacts have 7 numbers"),
    ];
    for (result, says) in cases {
        let why = result.unwrap_err();
        assert!(why.contains(says), "{why}; expected {says}");
    }
    // Many solids with the same triangles are bounded too.
    let many = unpacked(|header, frames| {
        frames[1] = vec![0.5; 9 * 1_000];
        mesh(header, 0, 1_000);
        header.solids = vec![header.solids[0].clone(); 1_001];
    });
    assert!(many.unwrap_err().contains("more than 1000000 triangles"));
}
