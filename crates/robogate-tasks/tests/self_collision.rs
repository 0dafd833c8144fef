//! Collisions of a robot with itself, in MuJoCo.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use robogate_core::{
    Action, Assignment, Command, Environment, Fault, Observation, Outcome, Policy, Scenario, Seed, TaskInstance,
    TaskSpec, rollout,
};
use robogate_physics::{Engine, Hit, JointTargets, MujocoEngine, Robot, Scene, built_in_robot, built_in_robots};
use robogate_tasks::pick_place::{self, PickPlace, Placement, SceneParameters};
use robogate_tasks::{ArmTask, Rig};

fn engine(robot: &Robot) -> MujocoEngine {
    MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap()
}

/// The default scene without table and obstacles, which would stop the arm first.
fn scene(robot: &Robot) -> Scene {
    let parameters = SceneParameters::from_assignment(&Assignment::default(), &robot.settings.gripper).unwrap();
    let placement = Placement::from_name(&parameters.placement).unwrap();
    let mut scene =
        pick_place::scene(&parameters, &placement, 1.0, &mut Seed::campaign(1).stream("obstacles")).unwrap();
    scene.fixtures.clear();
    scene
}

/// The pair of bodies that touch, if the robot touches itself.
fn self_touch(engine: &MujocoEngine) -> Option<(String, String)> {
    let collision = engine.touches().collision?;
    let Hit::Itself(other) = collision.hit else { return None };
    Some((engine.robot_body(collision.robot_body), engine.robot_body(other)))
}

/// Random postures in which links of the robot overlap: the first of them, and the number of all.
fn folded(robot: &Robot, count: usize) -> (Vec<Vec<f64>>, usize) {
    let (mut engine, scene) = (engine(robot), scene(robot));
    let joints = engine.chain().joints.clone();
    let mut found = Vec::new();
    let postures = 400;
    for index in 0..postures {
        let mut stream = Seed::campaign(5).episode(index).stream("joints");
        let q: Vec<f64> = joints.iter().map(|joint| stream.between(joint.range[0], joint.range[1])).collect();
        engine.load(&scene, &q).unwrap();
        if self_touch(&engine).is_some() {
            found.push(q);
        }
    }
    let all = found.len();
    found.truncate(count);
    (found, all)
}

#[test]
fn links_stop_each_other() {
    for name in built_in_robots() {
        let robot = built_in_robot(name).unwrap();
        let (mut engine, scene) = (engine(&robot), scene(&robot));
        let home = robot.settings.arm.home_rad.clone();
        let (postures, all) = folded(&robot, 12);
        let mut stopped = 0;
        for goal in &postures {
            engine.load(&scene, &home).unwrap();
            assert_eq!(engine.touches().collision, None, "{name} at home");
            let mut touched = None;
            for k in 1..=2000 {
                let share = f64::from(k) / 2000.0;
                let positions: Vec<f64> = home.iter().zip(goal).map(|(a, b)| a + share * (b - a)).collect();
                let finger = robot.settings.gripper.jaw().map_or(0.0, |jaw| 0.5 * jaw.opening_m);
                engine.advance(&JointTargets { velocities: vec![0.0; home.len()], positions, finger });
                touched = touched.or_else(|| self_touch(&engine));
            }
            engine.health().unwrap();
            let off = engine.joint_positions().iter().zip(goal).map(|(q, goal)| (q - goal).abs()).fold(0.0, f64::max);
            stopped += usize::from(touched.is_some() && off > 0.005);
            println!("{name}: {touched:?}, {off:.3} rad short of the goal");
        }
        println!("{name}: {stopped} of {} stopped, {all} of 400 random postures", postures.len());
        // An arm with strong drives can turn past a link that it touches.
        assert!(2 * stopped > postures.len(), "{name}: {stopped} of {}", postures.len());
    }
}

/// Moves straight to one posture.
struct GoTo(Vec<f64>);

impl Policy for GoTo {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        Ok(())
    }

    fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
        Ok(Action { command: Command::JointPosition(self.0.clone()), gripper: Some(0.0), phase: None })
    }
}

#[test]
fn collision_names_the_robot_itself() {
    let robot = built_in_robot("ur5e").unwrap();
    let (postures, _) = folded(&robot, 12);
    let mut cell = PickPlace::default().on(Box::new(engine(&robot)), Rig::default()).unwrap();
    let requested = Assignment::default();
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested };
    let mut names = Vec::new();
    for goal in postures {
        let episode = rollout(&mut cell, &mut GoTo(goal), &scenario);
        if let (Outcome::Failure(mode), Some(contact)) = (&episode.outcome, &episode.contact) {
            assert_eq!(mode.as_str(), "collision");
            names.push(contact.other_body.clone());
        }
    }
    println!("{names:?}");
    assert!(names.iter().any(|name| name.starts_with("self (") && name.ends_with(')')), "{names:?}");
    let task = Arc::clone(cell.task());
    assert!(task.failure_modes.iter().any(|mode| mode.name.as_str() == "collision"));
}
