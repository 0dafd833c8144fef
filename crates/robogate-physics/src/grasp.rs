//! The test grasp of a robot check: the gripper takes a part from a pedestal, lifts it and holds it.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::Serialize;

use crate::{
    Engine, Fixture, FixtureKind, GRAVITY, Gripper, GripperCommand, GripperState, GripperUnit, MassProperties,
    MujocoEngine, Object, Part, Plant, Primitive, Problem, Robot, Scene, Visual,
};

/// Time between two commands, in seconds.
const PERIOD_S: f64 = 0.05;
/// Friction coefficient of the part.
const FRICTION: f64 = 0.8;
/// Largest edge and mass of the part, in metres and kilograms.
const LARGEST: (f64, f64) = (0.05, 0.5);
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

/// Grasps a part. The part is lifted from the tool's place at home, or up to it if the arm cannot move higher. `None`, with a
/// problem, if the arm can do neither.
pub(crate) fn test(robot: &Robot, problems: &mut Vec<Problem>) -> Option<Grasp> {
    let settings = robot.settings.clone();
    let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).ok()?;
    let mut plant = Plant::new(engine, PERIOD_S, None).ok()?;
    let (chain, home) = (plant.engine.chain().clone(), settings.arm.home_rad.clone());
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
    let tcp = chain.tcp_at(&low);
    let (part_m, limit_n) = match &settings.gripper {
        Gripper::ParallelJaw(jaw) => ((0.5 * jaw.opening_m).min(LARGEST.0), FRICTION * jaw.force_n),
        Gripper::Suction(cup) => ((1.25 * cup.cup_diameter_m).max(0.02), 0.25 * cup.force_n()),
    };
    let mass_kg = (limit_n / GRAVITY).min(LARGEST.1).min(settings.arm.payload_kg);
    let scene = scene(&tcp, &settings.gripper, part_m, mass_kg);
    plant.load(&scene, 0.01).ok()?;
    let opening_m = plant.engine.opening();
    let mut run = |seconds: f64, command: &dyn Fn(f64) -> Vec<f64>, gripper| -> Option<(f64, f64, bool)> {
        let periods = (seconds / PERIOD_S).ceil() as usize;
        let (mut forces, mut steps, mut cup) = (0.0, 0_u32, false);
        for k in 1..=periods {
            let share = k as f64 / periods as f64;
            plant
                .run(&command(share), gripper, &mut |_, view| {
                    if let GripperState::Cup(holds) = view.gripper {
                        cup = holds;
                    }
                    if share > 0.5 {
                        forces += view.touches.fingers.iter().map(|force| force.unwrap_or(0.0)).sum::<f64>();
                        steps += 1;
                    }
                })
                .ok()?;
        }
        let in_hand = plant.engine.tcp().inverse_transform_point(&plant.engine.object().translation.vector.into());
        Some((0.5 * forces / f64::from(steps.max(1)), in_hand.coords.norm(), cup))
    };
    let path = |from: &[f64], to: &[f64], share: f64| -> Vec<f64> {
        from.iter().zip(to).map(|(a, b)| a + share * (b - a)).collect()
    };
    let closing_s = settings.gripper.jaw().map_or(0.5, |jaw| 0.5 + 0.5 * jaw.opening_m / jaw.finger_speed_m_s);
    if low != home {
        run(LIFT.1, &|share| path(&home, &low, share), GripperCommand::Open)?;
    }
    run(0.2, &|_| low.clone(), GripperCommand::Open)?;
    let (_, before, _) = run(closing_s, &|_| low.clone(), GripperCommand::Close)?;
    run(LIFT.1, &|share| path(&low, &lifted, share), GripperCommand::Close)?;
    let (force, after, cup) = run(HOLD_S, &|_| lifted.clone(), GripperCommand::Close)?;
    let slip_m = (after - before).abs();
    let jaw = settings.gripper.jaw();
    let held = slip_m < SLIP_M && (jaw.is_some() || cup);
    let grasp = Grasp { opening_m, part_m, mass_kg, force_n: jaw.map(|_| force), slip_m, held };
    if !held {
        problems.push(Problem::new(
            format!(
                "the gripper does not hold a part of {:.0} mm and {mass_kg:.2} kg: it moved by {:.0} mm in the gripper",
                1e3 * part_m,
                1e3 * slip_m
            ),
            "check that the site of arm.tcp_site is between the pads or at the lip, with z out of the tool and the fingers along y, and that gripper.finger_bodies carry the pads",
        ));
    } else if let Some(jaw) = jaw.filter(|jaw| force < FORCE_SHARE * jaw.force_n) {
        problems.push(Problem::new(
            format!("each pad presses with {force:.1} N on a held part. gripper.force_n is {} N", jaw.force_n),
            "check the coupling of the fingers and their damping and friction in the model, or lower gripper.force_n",
        ));
    }
    Some(grasp)
}

/// A part at the tool, upright, on a pedestal that is narrower than it.
fn scene(tcp: &Isometry3<f64>, gripper: &Gripper, part_m: f64, mass_kg: f64) -> Scene {
    let y = tcp.rotation * Vector3::y();
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), (-y.x).atan2(y.y));
    let half = 0.5 * part_m;
    // The lip of a cup is a little above the part; a jaw has the part in its middle.
    let down = if gripper.cup().is_some() { half + 1e-3 } else { 0.0 };
    let place = Translation3::from(tcp.translation.vector - Vector3::new(0.0, 0.0, down));
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
    };
    Scene {
        object: Object { mass: MassProperties::homogeneous(&parts, mass_kg), parts },
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
