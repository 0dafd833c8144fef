//! Pick and place with grippers that are not two slides: rotary linkages and tendons.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use robogate_core::{Assignment, Environment, Outcome, Scenario, Seed, rollout};
use robogate_physics::{Engine, MujocoEngine, Robot, draft};
use robogate_tasks::pick_place::{PickPlace, Scripted, inspect};
use robogate_tasks::{ArmTask, Rig};

const UR5E: &str = include_str!("../../../assets/robots/ur5e/robot.toml");

/// A folder with this model, for its drafted settings.
fn folder(name: &str, model: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("grippers").join(name);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("model.xml"), model).unwrap();
    folder
}

/// The outcomes of the scripted controller on these scenarios, with their counts.
fn outcomes(robot: &Robot, scenarios: &[Scenario]) -> BTreeMap<String, usize> {
    let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap();
    let mut policy = Scripted::new(robot.clone(), engine.chain().clone());
    let mut cell = PickPlace::default().on(Box::new(engine), Rig::default()).unwrap();
    let mut counts = BTreeMap::new();
    for scenario in scenarios {
        let outcome = match rollout(&mut cell, &mut policy, scenario).outcome {
            Outcome::Success => "success".to_owned(),
            Outcome::Failure(mode) => mode.as_str().to_owned(),
            Outcome::Invalid(fault) => format!("invalid: {fault}"),
        };
        *counts.entry(outcome).or_insert(0) += 1;
    }
    assert_eq!(cell.render().unwrap().len(), 2);
    counts
}

fn nominal(count: u64) -> Vec<Scenario> {
    let scenario = |index| Scenario { index, seed: Seed::campaign(1).episode(index), requested: Assignment::default() };
    (0..count).map(scenario).collect()
}

/// The gripper is drafted from the model; the arm has the published figures of the UR5e.
fn picks_and_places(name: &str, model: &str) {
    let folder = folder(name, model);
    let text = draft(&folder.join("model.xml"), name).unwrap().text;
    let (arm, _) = UR5E.split_once("[gripper]").unwrap();
    let arm = arm.replace("model = \"ur5e.xml\"", "model = \"model.xml\"").replace("\"tcp\"", "\"pinch\"");
    succeeds(&folder, name, &format!("{arm}{}", &text[text.find("[gripper]").unwrap()..]));
}

/// The robot with these settings passes its check and succeeds in all nominal episodes.
fn succeeds(folder: &Path, name: &str, settings: &str) {
    fs::write(folder.join("robot.toml"), settings).unwrap();
    let inspection = inspect(folder.to_str().unwrap());
    assert!(inspection.problems.is_empty(), "{:#?}", inspection.problems);
    let episode = inspection.measured.unwrap().episode.unwrap();
    assert!(episode.failure.is_none() && (episode.part_m - 0.05).abs() < 1e-9, "{episode:?}");
    let robot = Robot::from_folder(folder).unwrap();
    let counts = outcomes(&robot, &nominal(4));
    assert_eq!(counts, BTreeMap::from([("success".to_owned(), 4)]), "{name}");
}

#[test]
fn linkage_picks_and_places() {
    picks_and_places("linkage", include_str!("../../robogate-physics/tests/robots/linkage.xml"));
}

#[test]
fn tendon_picks_and_places() {
    picks_and_places("tendon", include_str!("../../robogate-physics/tests/robots/tendon.xml"));
}

#[test]
fn drafted_robot_picks_and_places() {
    let folder = folder("drafted", include_str!("../../robogate-physics/tests/robots/linkage.xml"));
    let text = draft(&folder.join("model.xml"), "drafted").unwrap().text;
    succeeds(&folder, "drafted", &text);
}

#[test]
fn light_arm_picks_and_places() {
    // The joints have no inertia of motors, and the drafted servos are strongly damped.
    let light =
        include_str!("../../robogate-physics/tests/robots/linkage.xml").replace("armature=\"0.1\" damping", "damping");
    let folder = folder("light", &light);
    let text = draft(&folder.join("model.xml"), "light").unwrap().text;
    succeeds(&folder, "light", &text);
}
