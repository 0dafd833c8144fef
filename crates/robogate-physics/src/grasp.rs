//! The test grasp of a robot check: the gripper takes a part from a pedestal, lifts it and holds it.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Fault;
use serde::Serialize;

use crate::{
    Engine, Fixture, FixtureKind, GRAVITY, Gripper, GripperCommand, GripperState, GripperUnit, MassProperties,
    MujocoEngine, Object, ParallelJaw, Part, Plant, Primitive, Problem, Robot, RobotError, Scene, Visual,
};

/// Time between two commands, in seconds.
const PERIOD_S: f64 = 0.05;
/// Friction coefficient of the part.
const FRICTION: f64 = 0.8;
/// Largest edge and mass of the part, in metres and kilograms.
const LARGEST: (f64, f64) = (0.05, 0.5);
/// Parts at the ends of the opening, as fractions of it.
const ENDS_OF_OPENING: [f64; 2] = [0.15, 0.85];
/// A part is at least this much wider than the closed gripper, in metres.
const ROOM_M: f64 = 2e-3;
/// Gap between the palm and the part, in metres.
const PALM_ROOM_M: f64 = 2e-3;
/// Mass of a light part, in kilograms.
const LIGHTEST_KG: f64 = 0.02;
/// Height by which the part is lifted, in metres, and the duration in seconds.
const LIFT: (f64, f64) = (0.05, 1.0);
/// Duration of holding in the air, in seconds. Forces are averaged over its second half.
const HOLD_S: f64 = 1.0;
/// A part that moves farther in the gripper is not held, in metres.
const SLIP_M: f64 = 0.01;
/// The pads must press with at least this fraction of the stated force.
const FORCE_SHARE: f64 = 0.5;

/// The measurements of a test grasp.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Grasp {
    /// Opening between the pads before the grasp, in metres; `None` for a cup.
    pub opening_m: Option<f64>,
    /// Edge of the part, a cube, in metres.
    pub part_m: f64,
    /// Mass of the part, in kilograms.
    pub mass_kg: f64,
    /// Mean normal force of the pads on the part while it is held in the air, in newtons; `None` for a cup.
    pub force_n: Option<f64>,
    /// How far the part moved in the gripper from the grasp to the end, in metres.
    pub slip_m: f64,
    /// Whether the gripper held the part.
    pub held: bool,
}

/// The test grasps of a robot with this time step in seconds, of which 0.05 s is an integer multiple: parts of a medium size, then those of
/// the ends of the gripper's opening and payload.
///
/// # Errors
/// The problems of the robot's model, or of the first part that it does not hold.
pub fn test_grasps(robot: &Robot, time_step: f64) -> Result<Vec<Grasp>, Vec<Problem>> {
    let engine = MujocoEngine::new(robot.clone(), time_step).map_err(RobotError::into_problems)?;
    let mut problems = Vec::new();
    match test(engine, &mut problems) {
        Some((medium, at_ends)) if problems.is_empty() => Ok([vec![medium], at_ends].concat()),
        _ => Err(problems),
    }
}

/// Grasps parts of a medium size, and of the ends of the gripper's opening and payload. They are lifted from the tool's place at home,
/// or up to it if the arm cannot move higher. Returns the medium grasp and those at the ends; `None`, with a problem, if the arm
/// can do neither.
pub(crate) fn test(engine: MujocoEngine, problems: &mut Vec<Problem>) -> Option<(Grasp, Vec<Grasp>)> {
    let settings = &engine.robot().settings.clone();
    let (chain, home) = (engine.chain().clone(), settings.arm.home_rad.clone());
    let at_home = chain.tcp_at(&home);
    let moved = |up: f64| {
        let goal = Isometry3::from_parts(Translation3::new(0.0, 0.0, up) * at_home.translation, at_home.rotation);
        chain.reach(&goal, &home).ok()
    };
    let ends = moved(LIFT.0).map(|up| (home.clone(), up)).or_else(|| moved(-LIFT.0).map(|down| (down, home.clone())));
    let Some((low, lifted)) = ends else {
        problems.push(Problem::new(
            format!("the grasp was not tested: from arm.home_rad the tool moves neither {0:.0} mm up nor {0:.0} mm down", 1e3 * LIFT.0),
            "choose an arm.home_rad over the middle of the workspace, away from the ends of the arm's reach and of the joints' ranges",
        ));
        return None;
    };
    // The arm starts where it grasps: on its way there the fingers would hit the part.
    let mut robot = engine.robot().clone();
    robot.settings.arm.home_rad.clone_from(&low);
    let engine = if low == home { engine } else { MujocoEngine::new(robot, engine.time_step()).ok()? };
    let mut plant = Plant::new(engine, PERIOD_S, None).ok()?;
    let path = Path { low, lifted };
    let limit_n = match &settings.gripper {
        Gripper::ParallelJaw(jaw) => FRICTION * jaw.force_n,
        Gripper::Suction(cup) => 0.25 * cup.force_n(),
    };
    let heaviest = (limit_n / GRAVITY).min(settings.arm.payload_kg);
    let lightest = LIGHTEST_KG.min(heaviest);
    let (medium, parts) = match &settings.gripper {
        Gripper::ParallelJaw(jaw) => {
            let [small, large] = ENDS_OF_OPENING.map(|share| share * jaw.opening_m);
            let small = small.max(plant.engine.narrowest_held_m() + ROOM_M);
            (
                (0.5 * jaw.opening_m).min(LARGEST.0),
                vec![(small, lightest), (small, heaviest), (large, lightest), (large, heaviest)],
            )
        }
        Gripper::Suction(cup) => {
            let size = (1.25 * cup.cup_diameter_m).max(0.02);
            (size, vec![(size, lightest), (size, heaviest)])
        }
    };
    let first = attempt(&mut plant, &path, (medium, heaviest.min(LARGEST.1)), problems)?;
    problems.extend(problem(&first, settings.gripper.jaw()));
    let mut at_ends = Vec::new();
    for part in parts {
        if !problems.is_empty() {
            break;
        }
        if let Some(grasp) = attempt(&mut plant, &path, part, problems) {
            // Fingers that turn press with less than their stated force where they are not parallel.
            problems.extend(problem(&grasp, None));
            at_ends.push(grasp);
        }
    }
    Some((first, at_ends))
}

/// Joint positions of a test grasp.
struct Path {
    /// Where the part is grasped, and where it is held.
    low: Vec<f64>,
    lifted: Vec<f64>,
}

/// Grasps one part, given by its edge (m) and mass (kg). `None`, with a problem, if the simulation fails.
fn attempt(
    plant: &mut Plant<MujocoEngine>,
    path: &Path,
    (part_m, mass_kg): (f64, f64),
    problems: &mut Vec<Problem>,
) -> Option<Grasp> {
    match grasped(plant, path, part_m, mass_kg) {
        Ok(grasp) => Some(grasp),
        Err(fault) => {
            problems.push(Problem::new(
                format!("the test grasp of a part of {:.0} mm and {mass_kg:.2} kg fails: {fault}", 1e3 * part_m),
                "look for undamped joints, weak couplings and wrong masses in the model of the gripper, or lower gripper.stiffness_n_m",
            ));
            None
        }
    }
}

fn grasped(plant: &mut Plant<MujocoEngine>, path: &Path, part_m: f64, mass_kg: f64) -> Result<Grasp, Fault> {
    let Path { low, lifted } = path;
    let settings = plant.engine.robot().settings.clone();
    let scene = scene(&plant.engine.chain().tcp_at(low), &settings.gripper, part_m, mass_kg);
    plant.load(&scene, 0.01)?;
    let opening_m = plant.engine.opening();
    let mut run = |seconds: f64, command: &dyn Fn(f64) -> Vec<f64>, gripper| -> Result<(f64, f64, bool), Fault> {
        let periods = (seconds / PERIOD_S).ceil() as usize;
        let (mut forces, mut steps, mut cup) = (0.0, 0_u32, false);
        for k in 1..=periods {
            let share = k as f64 / periods as f64;
            plant.run(&command(share), gripper, &mut |_, view| {
                if let GripperState::Cup(holds) = view.gripper {
                    cup = holds;
                }
                if share > 0.5 {
                    forces += view.touches.fingers.iter().map(|force| force.unwrap_or(0.0)).sum::<f64>();
                    steps += 1;
                }
            })?;
        }
        let in_hand = plant.engine.tcp().inverse_transform_point(&plant.engine.object().translation.vector.into());
        Ok((0.5 * forces / f64::from(steps.max(1)), in_hand.coords.norm(), cup))
    };
    let between = |from: &[f64], to: &[f64], share: f64| -> Vec<f64> {
        from.iter().zip(to).map(|(a, b)| a + share * (b - a)).collect()
    };
    // Strong damping makes fingers slower than their limit.
    let speed = |jaw: &ParallelJaw| jaw.finger_speed_m_s.min(0.5 * jaw.force_n / jaw.damping_ns_m);
    let closing_s = settings.gripper.jaw().map_or(0.5, |jaw| 0.5 + 0.5 * jaw.opening_m / speed(jaw));
    run(0.2, &|_| low.clone(), GripperCommand::Open)?;
    let (_, before, _) = run(closing_s, &|_| low.clone(), GripperCommand::Close)?;
    run(LIFT.1, &|share| between(low, lifted, share), GripperCommand::Close)?;
    let (force, after, cup) = run(HOLD_S, &|_| lifted.clone(), GripperCommand::Close)?;
    let slip_m = (after - before).abs();
    let has_jaw = settings.gripper.jaw().is_some();
    let held = slip_m < SLIP_M && (has_jaw || cup);
    Ok(Grasp { opening_m, part_m, mass_kg, force_n: has_jaw.then_some(force), slip_m, held })
}

/// The problem of a grasp, if it has one.
fn problem(grasp: &Grasp, jaw: Option<&ParallelJaw>) -> Option<Problem> {
    let Grasp { part_m, mass_kg, force_n, slip_m, held, .. } = grasp;
    if !held {
        return Some(Problem::new(
            format!(
                "the gripper does not hold a part of {:.0} mm and {mass_kg:.2} kg: it moved by {:.0} mm in the gripper",
                1e3 * part_m,
                1e3 * slip_m
            ),
            "check that the site of arm.tcp_site is between the pads or at the lip, with z out of the tool and the fingers along y, that gripper.finger_bodies carry the pads, and that arm.payload_kg and gripper.force_n fit the arm",
        ));
    }
    let (jaw, force) = (jaw?, (*force_n)?);
    (force < FORCE_SHARE * jaw.force_n).then(|| {
        Problem::new(
            format!(
                "each pad presses with {force:.1} N on a held part of {:.0} mm. gripper.force_n is {} N",
                1e3 * part_m,
                jaw.force_n
            ),
            "check the coupling of the fingers and their damping and friction in the model, or lower gripper.force_n",
        )
    })
}

/// A part at the tool, upright, on a pedestal that is narrower than it.
fn scene(tcp: &Isometry3<f64>, gripper: &Gripper, part_m: f64, mass_kg: f64) -> Scene {
    let y = tcp.rotation * Vector3::y();
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), (-y.x).atan2(y.y));
    let half = 0.5 * part_m;
    // The lip of a cup is a little above the part; a jaw has the part in its middle, or lower if the palm is in the way.
    let down = gripper.jaw().map_or(half + 1e-3, |jaw| (half + PALM_ROOM_M - jaw.palm_m).max(0.0));
    let beside = gripper.jaw().map_or(0.0, |jaw| jaw.beside_m(part_m));
    let place = Translation3::from(tcp.translation.vector + y * beside - Vector3::new(0.0, 0.0, down));
    let parts = vec![Part { primitive: Primitive::Box { half: [half; 3] }, pose: Isometry3::identity() }];
    let stand = Primitive::Box { half: [0.7 * half, 0.7 * half, 0.01] };
    let stand = Fixture {
        name: "pedestal".to_owned(),
        kind: FixtureKind::Obstacle,
        part: Part {
            primitive: stand,
            pose: Isometry3::from_parts(Translation3::new(0.0, 0.0, -half - 0.01) * place, yaw),
        },
        motion: None,
        friction: None,
        color: None,
    };
    Scene {
        object: Object { mass: MassProperties::homogeneous(&parts, mass_kg), parts, joint: None, friction: None },
        object_pose: Isometry3::from_parts(place, yaw),
        others: Vec::new(),
        friction: FRICTION,
        table_friction: None,
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
        fixtures: vec![Fixture::table(), stand],
        gravity: GRAVITY,
        marker: None,
        visual: Visual::default(),
    }
}
