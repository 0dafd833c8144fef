//! Tests against a simulator that does no physics: it answers requests and fills tables.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixStream;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Barrier};
use std::thread;

use nalgebra::Isometry3;
use robogate_core::FaultKind;
use serde_json::{Value, json};

use super::{Member, Server, Simulator, World};
use crate::inspect::trial_scene;
use crate::{
    Engine, Fixture, FixtureKind, GripperCommand, Motion, MujocoEngine, Part, Primitive, Scene, built_in_robot,
};

/// How the simulator differs from a good one.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Flaw {
    Nothing,
    /// It keeps another friction.
    WrongNumbers,
    /// It ran out of room for contacts.
    Overflow,
}

/// A simulator. Each request is passed on too.
fn simulator(flaw: Flaw) -> (Arc<Simulator>, Receiver<Value>) {
    let (ours, theirs) = UnixStream::pair().unwrap();
    let (told, requests) = channel();
    thread::spawn(move || {
        let mut replies = theirs.try_clone().unwrap();
        let mut groups: BTreeMap<u64, (File, usize, usize)> = BTreeMap::new();
        for line in BufReader::new(theirs).lines() {
            let request: Value = serde_json::from_str(&line.unwrap()).unwrap();
            let reply = match request["do"].as_str().unwrap() {
                "hello" => {
                    let version = mujoco_rs::mujoco_version();
                    json!({"device": "none", "alias": "none", "warp": "1", "mujoco": version, "mujoco_warp": "1",
                           "deterministic": true})
                }
                "group" => create(&request, &mut groups),
                _ => {
                    step(&request, &groups, flaw);
                    json!({})
                }
            };
            let _ = told.send(request);
            writeln!(replies, "{reply}").unwrap();
        }
    });
    let folder = std::env::temp_dir().join(format!("robogate-worlds-{}-{flaw:?}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    crate::load_mujoco().unwrap();
    let replies = BufReader::new(ours.try_clone().unwrap());
    let server = Server::new(Box::new(ours), Box::new(replies), folder).unwrap();
    (Arc::new(Simulator::new(server)), requests)
}

/// Sizes of the rows of a group: numbers, command, reports, qpos, qvel, lost.
const STEPS: usize = 25;
const REPORT: usize = 28 + 13;

fn create(request: &Value, groups: &mut BTreeMap<u64, (File, usize, usize)>) -> Value {
    let worlds = request["worlds"].as_u64().unwrap() as usize;
    let path = request["file"].as_str().unwrap();
    let file = File::options().read(true).write(true).create(true).truncate(true).open(path).unwrap();
    let engine = loaded(&scene(&[]));
    let fields = engine.numbers().fields;
    let width: usize = fields.iter().map(|(_, count)| count).sum();
    let (mut layout, mut offset) = (serde_json::Map::new(), 0);
    for (name, row) in [
        ("numbers", width),
        ("held", width),
        ("command", 28),
        ("reports", STEPS * REPORT),
        ("qpos", 16),
        ("qvel", 15),
        ("lost", 1),
    ] {
        layout.insert(name.to_owned(), json!({"offset": offset, "shape": [worlds, row]}));
        offset += worlds * row;
    }
    file.set_len(4 * offset as u64).unwrap();
    groups.insert(request["group"].as_u64().unwrap(), (file, worlds, width));
    json!({"layout": layout, "fields": fields})
}

/// Copies the numbers, and leaves every world where it is.
fn step(request: &Value, groups: &BTreeMap<u64, (File, usize, usize)>, flaw: Flaw) {
    for reset in request["resets"].as_array().unwrap() {
        let (file, worlds, width) = &groups[&reset[0].as_u64().unwrap()];
        for world in reset[1].as_array().unwrap() {
            let mut row = vec![0; 4 * width];
            let at = world.as_u64().unwrap() * row.len() as u64;
            file.read_exact_at(&mut row, at).unwrap();
            // The positions are the last numbers.
            let (qpos, start) = (row[4 * (width - 16)..].to_vec(), worlds * (2 * width + 28 + STEPS * REPORT));
            file.write_all_at(&qpos, 4 * (start as u64 + 16 * world.as_u64().unwrap())).unwrap();
            if flaw == Flaw::WrongNumbers {
                row[0] ^= 1;
            }
            file.write_all_at(&row, 4 * (worlds * width) as u64 + at).unwrap();
        }
    }
    for group in request["groups"].as_array().unwrap() {
        let (file, worlds, width) = &groups[&group.as_u64().unwrap()];
        let mut report = [0.0_f32; REPORT];
        // Nothing touches; tool and object have unit rotations.
        for (i, value) in [
            (1, -1.0),
            (2, -1.0),
            (4, -1.0),
            (5, -1.0),
            (6, -1.0),
            (7, -1.0),
            (11, 1.0),
            (15, 1.0),
            (19, 1.0),
            (31, 1.0),
        ] {
            report[i] = value;
        }
        let bytes: Vec<u8> = report.repeat(STEPS * worlds).iter().flat_map(|x| x.to_le_bytes()).collect();
        file.write_all_at(&bytes, 4 * (worlds * (2 * width + 28)) as u64).unwrap();
        let lost: Vec<u8> = vec![if flaw == Flaw::Overflow { 8.0_f32 } else { 0.0 }; *worlds]
            .iter()
            .flat_map(|x| x.to_le_bytes())
            .collect();
        file.write_all_at(&lost, 4 * (worlds * (2 * width + 28 + STEPS * REPORT + 31)) as u64).unwrap();
    }
}

fn part(primitive: Primitive, x: f64, y: f64) -> Part {
    Part { primitive, pose: Isometry3::translation(x, y, 0.06) }
}

fn obstacle(name: &str, part: Part) -> Fixture {
    Fixture { name: name.to_owned(), kind: FixtureKind::Obstacle, part, motion: None, friction: None, color: None }
}

fn scene(fixtures: &[Fixture]) -> Scene {
    Scene { fixtures: std::iter::once(Fixture::table()).chain(fixtures.iter().cloned()).collect(), ..trial_scene() }
}

fn engine() -> MujocoEngine {
    MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap()
}

/// An engine with the world of a scene.
fn loaded(scene: &Scene) -> MujocoEngine {
    let mut engine = engine();
    World::new(&mut engine, scene, 30.0, 0.05).unwrap();
    engine
}

const BOX: Primitive = Primitive::Box { half: [0.02, 0.02, 0.06] };
const CAN: Primitive = Primitive::Cylinder { radius: 0.03, half_height: 0.06 };

#[test]
fn obstacles_do_not_change_the_topology() {
    let none = loaded(&scene(&[])).numbers();
    let some = scene(&[
        obstacle("a", part(CAN, 0.4, 0.2)),
        obstacle("b", part(BOX, 0.6, -0.2)),
        obstacle("c", part(BOX, 0.3, 0.3)),
    ]);
    let some = loaded(&Scene { friction: 0.2, gravity: 3.7, ..some }).numbers();
    assert_eq!((none.topology, &none.fields), (some.topology, &some.fields));
    assert_ne!(none.values, some.values);
    // A fixture that moves does.
    let motion = Some(Motion::Straight { velocity: [0.0, 0.2, 0.0].into(), starts_s: 1.0, ends_s: 2.0 });
    let moving = loaded(&scene(&[Fixture { motion, ..obstacle("d", part(BOX, 0.6, -0.2)) }])).numbers();
    assert_ne!(moving.topology, none.topology);
}

#[test]
fn objects_of_all_shapes_have_one_topology() {
    let mut engine = engine();
    let mut read = |parts: &[&Part]| {
        let mut scene = scene(&[]);
        scene.object.parts = parts.iter().map(|part| (*part).clone()).collect();
        let world = World::new(&mut engine, &scene, 30.0, 0.05).unwrap();
        assert_eq!(
            world.read_back(&engine).unwrap().parts,
            parts.iter().map(|part| part.primitive.clone()).collect::<Vec<_>>()
        );
        engine.numbers().topology
    };
    let ball = part(Primitive::Sphere { radius: 0.02 }, 0.01, 0.0);
    let (cuboid, can) = (part(BOX, 0.0, 0.0), part(CAN, 0.0, 0.0));
    let alone = read(&[&cuboid]);
    for parts in [vec![&ball], vec![&can], vec![&ball, &cuboid, &cuboid]] {
        assert_eq!(read(&parts), alone, "{parts:?}");
    }
    // More parts than there are spare ones have a topology of their own.
    assert_ne!(read(&[&ball, &ball, &cuboid]), alone);
}

#[test]
fn fixtures_keep_their_numbers() {
    let mut engine = engine();
    let fixtures = [obstacle("a", part(CAN, 0.4, 0.2)), obstacle("b", part(BOX, 0.6, -0.2))];
    let world = World::new(&mut engine, &scene(&fixtures), 30.0, 0.05).unwrap();
    let found = world.read_back(&engine).unwrap();
    let mut read: Vec<(usize, Option<Primitive>)> =
        found.fixtures.iter().map(|it| (it.fixture, it.primitive.clone())).collect();
    read.sort_by_key(|(fixture, _)| *fixture);
    assert_eq!(read, [(0, Some(Fixture::table().part.primitive)), (1, Some(CAN)), (2, Some(BOX))]);
    let poses = world.fixture_poses(&engine);
    assert!((poses[1].translation.x - 0.4).abs() < 1e-9 && (poses[2].translation.x - 0.6).abs() < 1e-9);
}

/// One control period of one world.
fn period(flaw: Flaw) -> Result<usize, FaultKind> {
    let (simulator, _) = simulator(flaw);
    let mut engine = engine();
    let mut world = World::new(&mut engine, &scene(&[]), 30.0, 0.05).unwrap();
    world.leave(&mut engine);
    let home = engine.robot().settings.arm.home_rad.clone();
    let command = world.command(&engine, &home, GripperCommand::Open);
    let mut member = Member::join(simulator);
    let mut replies = member.exchange(&mut [(&mut world, command)]).unwrap();
    let period = replies.remove(0).map_err(|fault| fault.kind)?;
    let mut seen = 0;
    world.read(&mut engine, &period, GripperCommand::Open, &mut |_, _| seen += 1).map_err(|fault| fault.kind)?;
    assert_eq!(engine.joint_positions(), home.iter().map(|q| f64::from(*q as f32)).collect::<Vec<_>>());
    Ok(seen)
}

#[test]
fn every_time_step_is_observed() {
    assert_eq!(period(Flaw::Nothing), Ok(STEPS));
}

#[test]
fn lost_contacts_are_a_fault() {
    assert_eq!(period(Flaw::Overflow), Err(FaultKind::Diverged));
}

#[test]
fn numbers_that_the_device_does_not_have_are_a_fault() {
    assert_eq!(period(Flaw::WrongNumbers), Err(FaultKind::NotApplied));
}

/// Members wait for each other, and not for those that have left. One message runs a period of all.
#[test]
fn members_step_together() {
    let (simulator, requests) = simulator(Flaw::Nothing);
    let members: Vec<Member> = (0..3).map(|_| Member::join(Arc::clone(&simulator))).collect();
    let ready = Barrier::new(members.len());
    thread::scope(|scope| {
        for (k, mut member) in members.into_iter().enumerate() {
            let ready = &ready;
            scope.spawn(move || {
                let mut engine = engine();
                let mut world = World::new(&mut engine, &scene(&[]), 30.0, 0.05).unwrap();
                world.leave(&mut engine);
                let home = engine.robot().settings.arm.home_rad.clone();
                ready.wait();
                // The last member leaves after one period, the first after three.
                for _ in k..3 {
                    let command = world.command(&engine, &home, GripperCommand::Open);
                    assert!(member.exchange(&mut [(&mut world, command)]).unwrap()[0].is_ok());
                }
            });
        }
    });
    drop(simulator);
    let steps = requests.iter().filter(|request| request["do"] == "step").count();
    assert_eq!(steps, 3);
}
