//! Test grasps of hands whose fingers have any mass, at any time step. With `--nocapture` the test prints what docs/results/grippers.md
//! summarises.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::Path;

use robogate_physics::{Grasp, Robot, draft, test_grasps};

/// Masses of a finger, in kilograms.
const MASSES: [f64; 3] = [0.005, 0.1, 0.5];
/// Time steps in seconds.
const STEPS: [f64; 3] = [0.0005, 0.002, 0.005];

/// Height (m), axis and inertia of the motor of each joint of an arm.
const JOINTS: [(f64, &str); 6] =
    [(0.12, "0 0 1"), (0.06, "0 1 0"), (0.36, "0 1 0"), (0.30, "0 0 1"), (0.03, "0 1 0"), (0.06, "0 0 1")];

/// An arm with this hand, and these couplings.
fn arm(hand: &str, couplings: &str, armature: f64) -> String {
    let mut bodies = String::new();
    for (i, (z, axis)) in JOINTS.into_iter().enumerate() {
        let limit = if i < 3 { 150 } else { 30 };
        bodies += &format!(
            "<body name=\"l{i}\" pos=\"0 0 {z}\"><joint name=\"j{i}\" axis=\"{axis}\" range=\"-2.6 2.6\" armature=\"{armature}\" \
             actuatorfrcrange=\"-{limit} {limit}\"/><geom type=\"cylinder\" size=\"0.03 0.01\" mass=\"{}\"/>",
            3.0 - 0.4 * i as f64
        );
    }
    format!(
        "<mujoco><compiler angle=\"radian\"/><worldbody><body name=\"base\"><geom type=\"cylinder\" size=\"0.06 0.04\" pos=\"0 0 0.04\"/>\
         {bodies}<body name=\"hand\"><geom type=\"box\" size=\"0.02 0.05 0.01\" pos=\"0 0 0.06\" mass=\"0.5\"/>{hand}</body>{}</body>\
         </worldbody><equality>{couplings}</equality></mujoco>",
        "</body>".repeat(JOINTS.len())
    )
}

/// Two fingers of this mass (kg) that slide or turn.
fn fingers(mass: f64, armature: f64, turn: bool) -> String {
    let finger = |name: &str, side: f64| {
        let (at, axis, range, shape) = if turn {
            let range = if side < 0.0 { "-0.02 0.7" } else { "-0.7 0.02" };
            (0.012, "hinge\" axis=\"1 0 0".to_owned(), range, "size=\"0.01 0.004 0.035\" pos=\"0 0 0.045\"")
        } else {
            (0.005, format!("slide\" axis=\"0 {side} 0"), "0 0.04", "size=\"0.01 0.005 0.025\" pos=\"0 0 0.035\"")
        };
        format!(
            "<body name=\"{name}\" pos=\"0 {} {}\"><joint name=\"{name}\" type=\"{axis}\" range=\"{range}\" armature=\"{armature}\" \
             actuatorfrcrange=\"-50 50\"/><geom type=\"box\" {shape} mass=\"{mass}\"/></body>",
            side * at,
            if turn { 0.08 } else { 0.07 }
        )
    };
    finger("right", -1.0) + &finger("left", 1.0)
}

/// The test grasps of a hand.
fn grasps(name: &str, model: &str, step: f64) -> Vec<Grasp> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("finger_masses").join(name);
    fs::create_dir_all(&folder).unwrap();
    let file = folder.join("model.xml");
    fs::write(&file, model).unwrap();
    fs::write(folder.join("robot.toml"), draft(&file, name).unwrap().text).unwrap();
    test_grasps(&Robot::from_folder(&folder).unwrap(), step).unwrap_or_default()
}

#[test]
fn grasp_does_not_depend_on_masses_or_steps() {
    let mimic = |factor: f64| format!("<joint joint1=\"left\" joint2=\"right\" polycoef=\"0 {factor} 0 0 0\"/>");
    let hands = [
        ("two slides", false, String::new()),
        ("two slides, coupled", false, mimic(1.0)),
        ("two hinges, coupled", true, mimic(-1.0)),
    ];
    let mut bad = Vec::new();
    println!("| fingers | armature | mass | time step | force of the pads | largest motion of a part |");
    println!("|---|---:|---:|---:|---:|---:|");
    for (hand, turn, coupling) in &hands {
        for armature in [0.0, 0.02] {
            for mass in MASSES {
                // The armature of a hinge is a moment of inertia.
                let own = if *turn { 0.005 * armature } else { armature };
                let model = arm(&fingers(mass, own, *turn), coupling, armature);
                for step in STEPS {
                    let all = grasps(&format!("{}-{armature}-{mass}", hand.replace([' ', ','], "")), &model, step);
                    let force = all.first().and_then(|grasp| grasp.force_n).unwrap_or(0.0);
                    let slip = all.iter().map(|grasp| grasp.slip_m).fold(0.0, f64::max);
                    println!(
                        "| {hand} | {armature} kg | {:.0} g | {:.1} ms | {force:.1} N | {:.2} mm |",
                        1e3 * mass,
                        1e3 * step,
                        1e3 * slip
                    );
                    let good = all.len() == 5 && all.iter().all(|grasp| grasp.held) && slip < 3e-3;
                    if !good || (force - 30.0).abs() > 4.5 {
                        bad.push(format!("{hand}, {armature} kg, {mass} kg, {step} s: {all:?}"));
                    }
                }
            }
        }
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}
