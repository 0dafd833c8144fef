//! Tests of every profile for LIBERO against what robosuite 1.4.1 itself returns (`scripts/libero_fixture.py`).
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "support/direct.rs"]
mod direct;
mod support;

use std::path::Path;

use direct::direct;
use robogate_core::{Action, Command, Image, Observation, Policy, Pose, Word, vectors};
use robogate_policy::{
    Arm, Decoder, Encoder, MappingStep, Part, Profile, Query, RandomModel, compare_mappings, read_pose, state_numbers,
};
use serde_json::Value;
use support::task;

/// The built-in profiles whose models were trained on LIBERO.
fn profiles() -> Vec<Profile> {
    let all = Profile::built_in_names().map(|name| Profile::from_toml(Profile::built_in(name).unwrap()).unwrap());
    let libero: Vec<Profile> = all.filter(|profile| profile.action.arm == Arm::OscPose).collect();
    assert!(libero.len() >= 8, "{}", libero.len());
    libero
}

fn folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/libero")
}

fn fixture() -> Value {
    serde_json::from_slice(&std::fs::read(folder().join("robosuite.json")).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
}

fn three(value: &Value) -> [f64; 3] {
    numbers(value).try_into().unwrap()
}

/// An image of robosuite's frame buffer, and the same image upright, as the cameras of a cell return it.
fn picture(index: usize) -> (usize, Vec<u8>, Vec<u8>) {
    let side = fixture()["pictures"]["side"].as_u64().unwrap() as usize;
    let all = std::fs::read(folder().join("pictures.rgb")).unwrap();
    let buffer = all.chunks_exact(3 * side * side).nth(index).unwrap().to_vec();
    let upright = buffer.chunks_exact(3 * side).rev().flatten().copied().collect();
    (side, buffer, upright)
}

/// The column of the centre of the red cube.
fn red_column(side: usize, rgb: &[u8]) -> f64 {
    let pixels = rgb.as_chunks::<3>().0.iter().enumerate();
    let red = |[r, g, b]: [u8; 3]| r > 90 && u16::from(r) > 2 * u16::from(g) && u16::from(r) > 2 * u16::from(b);
    let columns: Vec<usize> = pixels.filter(|(_, pixel)| red(**pixel)).map(|(at, _)| at % side).collect();
    columns.iter().sum::<usize>() as f64 / columns.len() as f64
}

#[test]
fn images_equal_those_of_clients() {
    let fixture = fixture();
    for mut profile in profiles() {
        profile.cameras.iter_mut().for_each(|camera| (camera.width, camera.height, camera.crop) = (96, 96, 1.0));
        for (index, cube) in fixture["pictures"]["cubes"].as_array().unwrap().iter().enumerate() {
            let (side, buffer, upright) = picture(index);
            let images = ["front", "wrist"].map(|camera| Image {
                camera: camera.to_owned(),
                width: side,
                height: side,
                rgb: upright.clone(),
            });
            let vectors = support::observation(2).vectors;
            let observation = Observation { vectors, images: images.to_vec(), time_s: 0.0 };
            let query = Query::new(&profile, &observation, "", 0).unwrap();
            // The clients reverse both axes of the frame buffer.
            let mut sent = buffer.clone();
            sent.as_chunks_mut::<3>().0.reverse();
            assert!(query.images[0].1.data() == sent, "{} {cube}", profile.name);
            // The cube at +y is on the left of the base frame's x axis, but the model sees the mirrored scene.
            let y = cube["cube_m"][1].as_f64().unwrap();
            let column = red_column(side, query.images[0].1.data());
            let mirrored = (side - 1) as f64 - cube["column"].as_f64().unwrap();
            assert!((column - mirrored).abs() < 0.02, "{column} {mirrored}");
            assert!(y.abs() < 0.1 || (y > 0.0) == (column < 48.0), "{y} {column}");
        }
    }
}

/// The state of robosuite as vectors of LIBERO's own environment, and as a pose in the base frame of a cell.
fn observations(state: &Value, base: [f64; 3]) -> (Observation, Observation) {
    let fingers = numbers(&state["gripper_m"]);
    let position = three(&state["position_m"]);
    let [x, y, z, w] = numbers(&state["quaternion_xyzw"]).try_into().unwrap();
    let own = Observation {
        vectors: ["eef_pos", "eef_axis_angle", "gripper_qpos", "joint_pos"]
            .map(Word::constant)
            .into_iter()
            .zip([position.to_vec(), numbers(&state["axis_angle_rad"]), fingers.clone(), numbers(&state["joints_rad"])])
            .collect(),
        ..Observation::default()
    };
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    // The other sign of the quaternion: the profile must restore that of robosuite.
    let orientation = [w, x, y, z].map(|n| -n / norm);
    let mut local = position;
    local.iter_mut().zip(base).for_each(|(p, b)| *p -= b);
    let cell = Observation {
        vectors: vec![
            (vectors::TOOL_POSE, Pose { position: local, orientation }.to_array().to_vec()),
            (vectors::GRIPPER_OPENING, vec![fingers[0] - fingers[1]]),
            (vectors::JOINT_POSITIONS, numbers(&state["joints_rad"])),
        ],
        ..Observation::default()
    };
    (own, cell)
}

#[test]
fn states_equal_those_of_clients() {
    let fixture = fixture();
    let lift = (&fixture["base_m"], fixture["states"].as_array().unwrap().iter().collect::<Vec<_>>());
    let libero = fixture["libero"].as_array().unwrap();
    let suites = libero.iter().map(|suite| (&suite["base_m"], vec![&suite["state"]]));
    for (base, states) in std::iter::once(lift).chain(suites) {
        let base = three(base);
        for state in states {
            let (own, cell) = observations(state, base);
            let expected: Vec<f64> = [&state["position_m"], &state["axis_angle_rad"], &state["gripper_m"]]
                .into_iter()
                .flat_map(numbers)
                .collect();
            for mut profile in profiles() {
                profile.tool.shift_m = base;
                for observation in [&own, &cell] {
                    let got = state_numbers(&profile, observation).unwrap();
                    let plain = profile.states.iter().flat_map(|state| &state.parts).all(|part| {
                        !matches!(part, Part::GripperOpenness | Part::GripperClosedness | Part::JointPositions)
                    });
                    if profile.states.is_empty() || !plain || got.len() != expected.len() {
                        continue;
                    }
                    // A cell has one opening, so both fingers are half of it. In robosuite they may differ.
                    let near = |at: usize| if at < 6 { 2e-4 } else { 1e-3 };
                    let pairs = got.iter().zip(&expected).enumerate();
                    let close = pairs.into_iter().all(|(at, (got, want))| (got - want).abs() < near(at));
                    assert!(close, "{}: {got:?} instead of {expected:?}", profile.name);
                }
            }
        }
    }
}

#[test]
fn bases_are_those_of_the_suites() {
    let fixture = fixture();
    let base = |suite: &str| {
        let all = fixture["libero"].as_array().unwrap();
        three(&all.iter().find(|entry| entry["suite"] == suite).unwrap()["base_m"])
    };
    assert_eq!(base("libero_spatial"), base("libero_goal"));
    for profile in profiles().iter().filter(|profile| !profile.states.is_empty()) {
        assert_eq!(profile.tool.shift_m, base("libero_spatial"), "{}", profile.name);
        assert!(profile.notes.contains("[-0.6, 0.0, 0.0]"), "{}", profile.name);
    }
    assert_eq!(base("libero_object"), [-0.6, 0.0, 0.0]);
}

/// The numbers of an action that moves one axis, as a client sends them to robosuite.
fn raw(profile: &Profile, axis: &str, magnitude: f64) -> Vec<f64> {
    let at = match axis {
        "x" => 0,
        "y" => 1,
        "z" => 2,
        _ => 5,
    };
    let mut raw = vec![0.0; profile.action.size];
    raw[at] = magnitude;
    raw
}

#[test]
fn motions_lag_like_those_of_robosuite() {
    for profile in profiles() {
        for motion in fixture()["motions"].as_array().unwrap() {
            let (axis, magnitude) = (motion["axis"].as_str().unwrap(), motion["magnitude"].as_f64().unwrap());
            let steps = motion["steps"].as_u64().unwrap() as usize;
            let turns = axis == "about_z";
            let index = ["x", "y", "z"].iter().position(|name| *name == axis).unwrap_or(2);
            let column = if turns { "rotation_rad" } else { "translation_m" };
            let theirs: Vec<f64> = motion[column].as_array().unwrap().iter().map(|row| numbers(row)[index]).collect();
            let mut decoder = Decoder::new(&profile);
            decoder.begin(&task()).unwrap();
            let mut commanded = vec![0.0];
            for _ in 0..steps {
                decoder.put(raw(&profile, axis, magnitude));
                let Command::ToolDelta { translation_m, rotation_rad } =
                    decoder.next(&support::observation(2)).unwrap().command
                else {
                    panic!()
                };
                let moved = if turns { rotation_rad[index] } else { translation_m[index] };
                commanded.push(commanded[commanded.len() - 1] + moved);
            }
            // The servo of a cell is in the middle of the last two commands at the end of a control period.
            let moved: Vec<f64> = commanded.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
            let (total, last) = (theirs[steps - 1], theirs[steps - 1] - theirs[steps - 2]);
            let name = format!("{} {axis} {magnitude}", profile.name);
            for (step, (ours, theirs)) in moved.iter().zip(&theirs).enumerate() {
                assert!((ours - theirs).abs() < 0.1 * total, "{name}, step {step}: {ours} instead of {theirs}");
            }
            assert!((moved[steps - 1] / total - 1.0).abs() < 0.1, "{name}: {} instead of {total}", moved[steps - 1]);
            assert!(((moved[steps - 1] - moved[steps - 2]) / last - 1.0).abs() < 0.12, "{name}: last step");
        }
    }
}

/// Changes of a profile, and the step that each breaks.
#[test]
fn broken_conventions_are_named() {
    let text = Profile::built_in("pi0-libero").unwrap();
    let reference = Profile::from_toml(text).unwrap();
    assert_eq!(compare_mappings(&reference, &reference), []);
    let quaternion = text.replace("tool_axis_angle\"", "tool_quaternion_xyzw\"");
    let known = Profile::from_toml(&quaternion).unwrap();
    let swapped = Profile::from_toml(&quaternion.replace("quaternion_xyzw", "quaternion_wxyz")).unwrap();
    let steps = |profile: &Profile, reference: &Profile| -> Vec<MappingStep> {
        compare_mappings(profile, reference).into_iter().map(|problem| problem.step).collect()
    };
    assert_eq!(steps(&swapped, &known), [MappingStep::StateRotation]);
    for (from, to, step) in [
        ("position_scale_m = 0.05", "position_scale_m = -0.05", MappingStep::Sign),
        ("position_scale_m = 0.05", "position_scale_m = 0.1", MappingStep::Scale),
        ("rotation_scale_rad = 0.5", "rotation_scale_rad = 1.0", MappingStep::Scale),
        ("clip = 1.0", "clip = 2.0", MappingStep::Scale),
        ("clip = 1.0", "clip = 1.0\nframe = \"tool\"", MappingStep::Frame),
        ("control_hz = 20.0", "control_hz = 10.0", MappingStep::Rate),
        ("gripper_open = \"below\"", "gripper_open = \"above\"", MappingStep::Gripper),
        ("gripper_threshold = 0.0", "gripper_threshold = -1.5", MappingStep::Gripper),
        ("orientation = \"mirrored\"", "orientation = \"upright\"", MappingStep::Image),
        ("shift_m = [-0.66, 0.0, 0.912]", "shift_m = [0.0, 0.0, 0.0]", MappingStep::StateFrame),
        ("tool_axis_angle", "tool_euler", MappingStep::StateRotation),
        ("arm = \"osc_pose\"", "arm = \"tool_delta\"", MappingStep::Arm),
        ("rotation = \"axis_angle\"", "rotation = \"euler\"", MappingStep::Rotation),
        ("\"gripper_fingers\"", "\"gripper_opening\", \"zero\"", MappingStep::State),
    ] {
        assert!(text.contains(from), "{from}");
        let broken = Profile::from_toml(&text.replacen(from, to, 2)).unwrap();
        let found = steps(&broken, &reference);
        assert!(!found.is_empty() && found.iter().all(|found| *found == step), "{from} -> {to}: {found:?}");
    }
}

/// The negative control moves the arm, with actions that the task accepts, and differs between episodes.
#[test]
fn random_models_send_valid_actions() {
    let task = task();
    for profile in profiles() {
        let mut random = RandomModel::new(&profile);
        support::begin(&mut random, "pick up the box").unwrap();
        let actions: Vec<Action> = (0..50).map(|_| random.act(&support::observation(2)).unwrap()).collect();
        assert!(actions.iter().all(|action| task.check_action(action).is_ok()), "{}", profile.name);
        assert!(actions.iter().any(|action| action.gripper == Some(Action::OPEN)));
        assert!(actions.iter().any(|action| action.gripper == Some(Action::CLOSE)));
    }
}

/// A repeatable sequence of numbers from -1 to 1.
fn sequence(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// The property of the positive control: what an expert wants is what the robot is commanded, if the convention can
/// express it.
#[test]
fn encoding_inverts_decoding() {
    let mut profiles: Vec<Profile> = Profile::built_in_names()
        .map(|name| Profile::from_toml(Profile::built_in(name).unwrap()).unwrap())
        .filter(|profile| !matches!(profile.action.arm, Arm::Vector) && profile.action.control_hz != Some(15.0))
        .collect();
    let delta = direct(Profile::built_in("pi0-libero").unwrap());
    for (from, to) in [
        ("clip = 1.0", "clip = 1.0\nframe = \"tool\""),
        ("size = 7\n", "size = 10\n"),
        ("control_hz = 20.0", "control_hz = 5.0"),
    ] {
        let changed = delta.replace(from, to);
        let changed = if to.contains("10") {
            changed.replace("rotation = \"axis_angle\"", "rotation = \"rot6d_rows\"")
        } else {
            changed
        };
        profiles.push(Profile::from_toml(&changed).unwrap());
    }
    let mut next = sequence(3);
    for profile in profiles {
        let (mut encoder, mut decoder) = (Encoder::new(&profile), Decoder::new(&profile));
        let mut task = task();
        task.control_period_s = if profile.action.control_hz == Some(10.0) { 0.1 } else { 0.05 };
        encoder.begin(&task).unwrap();
        decoder.begin(&task).unwrap();
        let joints = matches!(profile.action.arm, Arm::JointPositions | Arm::JointDeltas);
        let count = if joints { profile.action.used() - 1 } else { 7 };
        for step in 0..60 {
            let mut observation = support::observation(2);
            let turn = [next(), next(), next()].map(|n| 0.2 * n);
            observation.vectors[0].1 = (0..count).map(|_| next()).collect();
            let half = turn.map(|n| 0.5 * n);
            let norm = (1.0 + half.iter().map(|n| n * n).sum::<f64>()).sqrt();
            // Pointing down, with a small tilt.
            observation.vectors[2].1 =
                vec![0.5, 0.0, 0.3, -half[0] / norm, 1.0 / norm, half[2] / norm, -half[1] / norm];
            let command = if joints {
                Command::JointPosition(observation.vectors[0].1.iter().map(|q| q + 0.01 * next()).collect())
            } else {
                let mut small = |limit: f64| [next(), next(), next()].map(|n| limit * n);
                // Within the acceleration of the arm.
                Command::ToolDelta { translation_m: small(0.0015), rotation_rad: small(0.003) }
            };
            let gripper = if next() > 0.0 { Action::OPEN } else { Action::CLOSE };
            let wanted = Action { command, gripper: Some(gripper), phase: None };
            let raw = encoder.encode(&wanted, &observation).unwrap();
            assert_eq!(raw.len(), profile.action.size);
            decoder.put(raw);
            while !decoder.is_empty() {
                let got = decoder.next(&observation).unwrap();
                let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
                let same = match (&got.command, &wanted.command) {
                    (Command::JointPosition(a), Command::JointPosition(b)) => near(a, b),
                    (
                        Command::ToolDelta { translation_m: a, rotation_rad: p },
                        Command::ToolDelta { translation_m: b, rotation_rad: q },
                    ) => near(a, b) && near(p, q),
                    _ => false,
                };
                assert!(same && got.gripper == wanted.gripper, "{} {step}: {got:?} {wanted:?}", profile.name);
            }
        }
        let observation = support::observation(2);
        let numbers = state_numbers(&profile, &observation).unwrap();
        if let Some(pose) = read_pose(&profile, &numbers, 7) {
            let close = pose.position.iter().zip([0.5, 0.0, 0.3]).all(|(a, b)| (a - b).abs() < 1e-12);
            let same: f64 = pose.orientation.iter().zip([0.0, 1.0, 0.0, 0.0]).map(|(a, b)| a * b).sum();
            assert!(close && (same.abs() - 1.0).abs() < 1e-9, "{}: {pose:?}", profile.name);
        }
    }
}
