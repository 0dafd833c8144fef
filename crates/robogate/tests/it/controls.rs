//! The controls of a gate, and the arm of LIBERO in the cell.

use std::fs;
use std::net::TcpListener;
use std::ops::ControlFlow;
use std::path::Path;
use std::process::Output;

use nalgebra::Isometry3;
use robogate_core::{Observation, vectors};
use robogate_physics::{
    Engine, Fixture, GRAVITY, GripperCommand, GripperUnit, MassProperties, MujocoEngine, Object, Part, Plant,
    Primitive, Scene, Steering, Visual, built_in_robot,
};
use robogate_policy::{Decoder, Profile, state_numbers};
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::pick_place::spec::spec;
use serde_json::Value;
use tempfile::TempDir;
use tungstenite::Message;

use crate::harness::{robogate, text};
use crate::openpi::{actions, serve};

/// A server that keeps the hand where it is.
pub(crate) fn idle() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    let answer = actions(50, 7, |_, j| if j == 6 { -1.0 } else { 0.0 });
    serve(listener, move |_, socket| {
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                socket.send(Message::binary(answer.clone())).unwrap();
            }
        }
        ControlFlow::Continue(())
    });
    url
}

/// The built-in profile with a change, which refers to the built-in one for its conventions.
fn profile(dir: &TempDir, from: &str, to: &str) -> String {
    let built_in = String::from_utf8(robogate(&["list", "profiles", "pi0-libero"]).stdout).unwrap();
    assert!(built_in.contains(from), "{built_in}");
    let changed = built_in.replacen(from, to, 2).replace("[dialect]", "reference = \"pi0-libero\"\n[dialect]");
    let file = dir.path().join("mine.toml");
    fs::write(&file, changed).unwrap();
    file.to_str().unwrap().to_owned()
}

/// A gate of one episode.
fn gate(url: &str, profile: &str, out: &Path, more: &[&str]) -> Output {
    let files = [("requirements", REQUIREMENTS), ("suite", SUITE)].map(|(name, text)| {
        let file = out.with_file_name(format!("{name}.toml"));
        fs::write(&file, text).unwrap();
        file.to_str().unwrap().to_owned()
    });
    let (out, [requirements, suite]) = (out.to_str().unwrap(), &files);
    let gate = ["gate", "--policy", url, "--profile", profile, "--requirements", requirements, "--suite", suite];
    let gate = [&gate[..], &["--out", out]].concat();
    robogate(&[&gate[..], more].concat())
}

fn evaluation(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("gate.json")).unwrap()).unwrap()
}

/// An expert that acts through LIBERO's state, scale, limits and lagging arm succeeds; random actions do not.
#[test]
fn controls_pass_with_the_published_conventions() {
    let (dir, url) = (TempDir::new().unwrap(), idle());
    let profile = profile(&dir, "pi0-libero", "pi0-libero");
    let out = dir.path().join("gate");
    let output = gate(&url, &profile, &out, &["--controls", "3"]);
    // The idle policy fails, and that is a statement about the policy.
    assert_ne!(output.status.code(), Some(4), "{}", text(&output));
    let controls = &evaluation(&out)["controls"];
    assert_eq!(controls["expert"]["successes"], 3, "{controls}");
    assert_eq!(controls["positive"]["successes"], 3, "{controls}");
    assert_eq!(controls["negative"]["successes"], 0, "{controls}");
    for file in ["gate.md", "report.html"] {
        let page = fs::read_to_string(out.join(file)).unwrap();
        assert!(page.contains("Positive control") && page.contains("Negative control"), "{file}");
    }
    let evidence = dir.path().join("evidence");
    let arguments = ["evidence", out.to_str().unwrap(), evidence.to_str().unwrap()];
    let written = robogate(&arguments);
    assert_eq!(written.status.code(), output.status.code(), "{}", text(&written));
    let kept: Value = serde_json::from_slice(&fs::read(evidence.join("evaluation.json")).unwrap()).unwrap();
    assert_eq!(kept["controls"], *controls);
    assert_eq!(robogate(&["verify", evidence.to_str().unwrap()]).status.code(), Some(0));
}

const REQUIREMENTS: &str = r#"
name = "easy"
mode = "point"

[budget]
rounds = 1

[[requirement]]
metric = "success"
at_least = 0.5
"#;

const SUITE: &str = r#"
schema = 1
name = "one"
version = "1.0.0"
description = "One scenario."

[defaults]
shape = "box"
size_m = 0.05
mass_kg = 0.3

[[group]]
name = "nominal"
category = "nominal"
description = "One box."
scenarios = [{ id = "nominal-1" }]
"#;

/// Each broken convention makes the verdict invalid and is named.
#[test]
fn broken_conventions_are_invalid() {
    let (dir, url) = (TempDir::new().unwrap(), idle());
    for (number, (from, to, step)) in [
        ("position_scale_m = 0.05", "position_scale_m = -0.05", "action sign"),
        ("position_scale_m = 0.05", "position_scale_m = 0.1", "action scale"),
        ("clip = 1.0", "clip = 1.0\nframe = \"tool\"", "action frame"),
        ("control_hz = 20.0", "control_hz = 10.0", "control rate"),
        ("gripper_open = \"below\"", "gripper_open = \"above\"", "gripper sign"),
        ("tool_axis_angle", "tool_euler", "state rotation"),
        ("orientation = \"mirrored\"", "orientation = \"upright\"", "image orientation"),
    ]
    .into_iter()
    .enumerate()
    {
        let out = dir.path().join(format!("gate-{number}"));
        let output = gate(&url, &profile(&dir, from, to), &out, &[]);
        assert_eq!(output.status.code(), Some(4), "{step}: {}", text(&output));
        let evaluation = evaluation(&out);
        let because = evaluation["because"].as_str().unwrap();
        assert!(because.contains("the positive control failed") && because.contains(step), "{step}: {because}");
        assert_eq!(evaluation["verdict"], "invalid");
    }
}

/// Without a reference the profile's own conventions are used. An action space in which the task cannot be solved fails.
#[test]
fn impossible_action_spaces_are_invalid() {
    let (dir, url) = (TempDir::new().unwrap(), idle());
    let file = profile(&dir, "position_scale_m = 0.05", "position_scale_m = 0.002");
    let own = fs::read_to_string(&file).unwrap().replace("reference = \"pi0-libero\"\n", "");
    fs::write(&file, own).unwrap();
    let out = dir.path().join("gate");
    let output = gate(&url, &file, &out, &["--controls", "1"]);
    assert_eq!(output.status.code(), Some(4), "{}", text(&output));
    assert!(text(&output).contains("through the profile in 0 of 1"), "{}", text(&output));
    // Shards would run all rounds for this verdict.
    let shards = dir.path().join("shards");
    let output = gate(&url, &file, &shards, &["--controls", "1", "--divide", "2"]);
    assert_eq!(output.status.code(), Some(4), "{}", text(&output));
    assert!(!shards.join("plan.json").exists());
}

#[test]
fn skipped_controls_are_recorded() {
    let (dir, url) = (TempDir::new().unwrap(), idle());
    let out = dir.path().join("gate");
    let output = gate(&url, "pi0-libero", &out, &["--controls", "0"]);
    assert_ne!(output.status.code(), Some(4), "{}", text(&output));
    assert!(evaluation(&out)["controls"]["without"].as_str().unwrap().contains("skipped"));
}

/// A Franka of the cell beside a small box.
fn cell() -> (Plant<MujocoEngine>, Steering) {
    let engine = MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    let mut plant = Plant::new(engine, 0.05, None).unwrap();
    let parts = vec![Part { primitive: Primitive::Box { half: [0.025; 3] }, pose: Isometry3::identity() }];
    let scene = Scene {
        object: Object { mass: MassProperties::homogeneous(&parts, 0.3), parts, joint: None, friction: None },
        object_pose: Isometry3::translation(0.5, -0.4, 0.025),
        friction: 0.8,
        table_friction: None,
        fixtures: vec![Fixture::table()],
        gravity: GRAVITY,
        marker: None,
        visual: Visual::default(),
        others: Vec::new(),
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
    };
    plant.load(&scene, 0.01).unwrap();
    (plant, Steering::default())
}

fn fixture() -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robogate-policy/tests/libero/robosuite.json");
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
}

/// Ten actions of a LIBERO profile move the arm of the cell as robosuite's own controller moves its arm.
#[test]
fn the_cell_moves_like_robosuite() {
    let profile = Profile::from_toml(Profile::built_in("pi05-libero").unwrap()).unwrap();
    let task = spec(&built_in_robot("franka").unwrap(), Vec::new(), &PickPlace::DEFAULT);
    for motion in fixture()["motions"].as_array().unwrap() {
        let (axis, magnitude) = (motion["axis"].as_str().unwrap(), motion["magnitude"].as_f64().unwrap());
        let turns = axis == "about_z";
        let at = ["x", "y", "z"].iter().position(|name| *name == axis).unwrap_or(5);
        let (mut plant, mut steering) = cell();
        let mut decoder = Decoder::new(&profile);
        decoder.begin(&task).unwrap();
        let start = plant.engine.tcp();
        let mut moved = vec![0.0];
        for _ in 0..10 {
            let mut raw = vec![0.0; 7];
            (raw[at], raw[6]) = (magnitude, -1.0);
            decoder.put(raw);
            let action = decoder.next(&Observation::default()).unwrap();
            let engine = &plant.engine;
            let (measured, home) = (engine.joint_positions(), &engine.robot().settings.arm.home_rad);
            let joints = steering.joints(&action.command, &measured, engine.chain(), home).unwrap();
            plant.run(&joints, GripperCommand::Open, &mut |_, _| {}).unwrap();
            let now = plant.engine.tcp();
            let turn = (now.rotation * start.rotation.inverse()).scaled_axis();
            let way = now.translation.vector - start.translation.vector;
            moved.push(if turns { turn[2] } else { way[at] });
        }
        let column = if turns { "rotation_rad" } else { "translation_m" };
        let theirs: Vec<f64> =
            motion[column].as_array().unwrap().iter().map(|row| numbers(row)[if turns { 2 } else { at }]).collect();
        let (total, last) = (theirs[9], theirs[9] - theirs[8]);
        let (ours, step) = (moved[10], moved[10] - moved[9]);
        assert!((ours / total - 1.0).abs() < 0.1, "{axis} {magnitude}: {ours} instead of {total}");
        assert!((step / last - 1.0).abs() < 0.12, "{axis} {magnitude}: last step {step} instead of {last}");
    }
}

/// The tool frame of the cell's Franka is that of robosuite's Panda: the same joints give the same state.
#[test]
fn the_cell_has_the_frames_of_robosuite() {
    let (plant, _) = cell();
    let fixture = fixture();
    let mut profile = Profile::from_toml(Profile::built_in("pi05-libero").unwrap()).unwrap();
    profile.tool.shift_m = numbers(&fixture["base_m"]).try_into().unwrap();
    for state in fixture["states"].as_array().unwrap() {
        let tool = plant.engine.chain().tcp_at(&numbers(&state["joints_rad"]));
        let (at, turn) = (tool.translation, tool.rotation);
        let observation = Observation {
            vectors: vec![
                (vectors::TOOL_POSE, vec![at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k]),
                (vectors::GRIPPER_OPENING, vec![0.08]),
            ],
            ..Observation::default()
        };
        let got = state_numbers(&profile, &observation).unwrap();
        let expected = [numbers(&state["position_m"]), numbers(&state["axis_angle_rad"])].concat();
        for (at, (got, want)) in got.iter().zip(&expected).enumerate() {
            // robosuite measures the position between the pads, 6 mm above the fingertips' centre of the cell.
            let tolerance = if at < 3 { 0.008 } else { 0.003 };
            assert!((got - want).abs() < tolerance, "number {at}: {got} instead of {want}");
        }
    }
}
