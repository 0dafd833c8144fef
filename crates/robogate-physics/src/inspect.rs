//! Inspects a robot before use: reports all problems at once, and the robot's measurements.

use std::f64::consts::{FRAC_PI_4, PI};
use std::path::Path;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Seed;
use serde::Serialize;

use crate::grasp::{self, Grasp};
use crate::trajectory::TRANSIT_HEIGHTS_M;
use crate::{
    Chain, Engine, Fixture, GRAVITY, GripperUnit, JointTargets, MassProperties, MujocoEngine, Object, ParallelJaw,
    Part, Primitive, Problem, Robot, RobotError, RobotSettings, Scene, Visual, WORKSPACE_CENTRE, built_in_robot,
    is_folder,
};

/// Number of random postures from which the reach is measured.
const POSTURES: usize = 20_000;

/// A stated reach is accepted up to this multiple of the reach of random postures, which miss the last few percent.
const REACH_MARGIN: f64 = 1.1;

/// Joints of an arm that reaches a position with every yaw of its tool.
const FEWEST_JOINTS: usize = 5;

/// Spacing of the grid of tool positions over the table, in metres.
const GRID_M: f64 = 0.05;

/// Two bodies are in contact if they penetrate each other deeper than this, in metres. Shapes of neighbouring links
/// overlap by less.
pub(crate) const DEEP_M: f64 = 1e-3;

/// How long the arm holds its position before and after it moves, in seconds.
const HOLD_S: f64 = 1.0;
/// Duration of the trial's motion out and back, in seconds.
const MOTION_S: f64 = 2.0;
/// Amplitude of each joint's motion in the trial, in radians.
const MOTION_RAD: f64 = 0.1;
/// Largest allowed tracking error of a joint, in radians.
const FOLLOWS_RAD: f64 = 0.05;
/// Largest allowed speed of a joint that should be at rest, in rad/s.
const STILL_RAD_S: f64 = 0.05;
/// Largest allowed error of the opening between the fingers, in metres.
const FINGERS_M: f64 = 2e-3;

/// The result of an inspection.
#[derive(Debug, Clone, PartialEq)]
pub struct Inspection {
    /// All problems; empty if the robot can be used.
    pub problems: Vec<Problem>,
    /// The settings, if they could be read.
    pub settings: Option<RobotSettings>,
    /// The measurements, if the robot could be loaded.
    pub measured: Option<Measured>,
}

/// Measurements of a robot that loads.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// Mass of each moving body that has one, base to tip, in kilograms.
    pub masses_kg: Vec<(String, f64)>,
    /// Largest distance of the flange from the first joint's axis over many random postures, in metres.
    pub flange_reach_m: f64,
    /// Largest distance of the tool centre point from the first joint's axis over the same postures, in metres.
    pub tool_reach_m: f64,
    /// Fraction of the positions over the table that the tool reaches pointing down, low and high above the table:
    /// 0.30 to 0.70 m in front of the base, 0.30 m to the right to 0.40 m to the left, times the scale of the workspace.
    pub workspace_share: f64,
    /// For each position of the caller, whether the tool reaches it pointing down.
    #[serde(skip)]
    pub reaches: Vec<bool>,
    /// Largest tracking error of any joint in a short trial of holding and moving, in radians; `None` without a trial.
    pub tracking_error_rad: Option<f64>,
    /// The grasp of a test part; `None` without a trial.
    pub grasp: Option<Grasp>,
    /// The grasps of small and large, light and heavy parts at the ends of the gripper's opening and payload.
    pub grasps_at_ends: Vec<Grasp>,
}

/// Inspects a robot: a built-in one by its name, any other by its folder. `positions` (x, y in metres on the table) are
/// tested for whether the tool reaches them. The workspace of a short arm is the usual one times `scale`.
pub fn inspect(robot: &str, scale: f64, positions: &[[f64; 2]]) -> Inspection {
    let folder = Path::new(robot);
    let read = if is_folder(robot) { Robot::read(folder) } else { built_in_robot(robot).map(|r| (r, Vec::new())) };
    let (robot, mut problems) = match read {
        Ok(read) => read,
        Err(error) => return Inspection { problems: error.into_problems(), settings: None, measured: None },
    };
    let settings = Some(robot.settings.clone());
    let measured = if problems.is_empty() {
        match MujocoEngine::new(robot, MujocoEngine::TIME_STEP_S) {
            Ok(mut engine) => Some(measure(&mut engine, scale, positions, &mut problems)),
            Err(error) => {
                problems.extend(error.into_problems());
                None
            }
        }
    } else {
        if folder.join(&robot.settings.model).is_file() {
            problems.extend(MujocoEngine::problems(&robot));
        }
        None
    };
    Inspection { problems, settings, measured }
}

impl RobotError {
    /// Converts the error to problems.
    pub(crate) fn into_problems(self) -> Vec<Problem> {
        match self {
            Self::Invalid { problems, .. } => problems,
            Self::Engine { why } => {
                let (what, hint) = why.split_once("\nHint: ").unwrap_or((&why, "use the Rapier engine"));
                vec![Problem::new(what, hint)]
            }
            other => vec![Problem::new(other.to_string(), "name a folder with a robot.toml and the model beside it")],
        }
    }
}

fn measure(engine: &mut MujocoEngine, scale: f64, positions: &[[f64; 2]], problems: &mut Vec<Problem>) -> Measured {
    let (chain, settings) = (engine.chain().clone(), engine.robot().settings.clone());
    let [flange_reach_m, tool_reach_m] = reach(&chain);
    let stated = settings.arm.reach_m;
    if stated > REACH_MARGIN * tool_reach_m {
        problems.push(Problem::new(
            format!(
                "arm.reach_m = {stated}, but in {POSTURES} random postures the tool is at most {tool_reach_m:.3} m from the first joint's axis"
            ),
            "give the reach in metres, and check the joints' ranges and the links' offsets in the model",
        ));
    }
    tool_direction(&chain, &settings, problems);
    let (workspace_share, reaches) = workspace(&chain, &settings.arm.home_rad, scale, positions);
    if workspace_share <= 0.0 {
        problems.push(Problem::new(
            format!(
                "the tool cannot reach any position over the table pointing down, {:.2} to {:.2} m in front of the base",
                0.3 * scale,
                0.7 * scale
            ),
            "the base is at the origin and the table in front of it, at +x and z = 0: check the pose of the base, the tool's z axis and the joints' ranges in the model",
        ));
    }
    let tracking_error_rad = trial(engine, &settings, problems);
    let grasps = match tracking_error_rad {
        Some(_) if problems.is_empty() => MujocoEngine::new(engine.robot().clone(), engine.time_step())
            .ok()
            .and_then(|engine| grasp::test(engine, problems)),
        _ => None,
    };
    let (grasp, grasps_at_ends) = grasps.map_or((None, Vec::new()), |(grasp, at_ends)| (Some(grasp), at_ends));
    Measured {
        masses_kg: engine.masses(),
        flange_reach_m,
        tool_reach_m,
        workspace_share,
        reaches,
        tracking_error_rad,
        grasp,
        grasps_at_ends,
    }
}

/// Largest distances of flange and tool from the first joint's axis, in metres.
pub(crate) fn reach(chain: &Chain) -> [f64; 2] {
    let mut stream = Seed::campaign(0).stream("reach");
    let mut farthest = [0.0_f64; 2];
    let Some(first) = chain.joints.first() else { return farthest };
    for _ in 0..POSTURES {
        let q: Vec<f64> = chain.joints.iter().map(|joint| stream.between(joint.range[0], joint.range[1])).collect();
        for (farthest, at) in farthest.iter_mut().zip([chain.flange_at(&q), chain.tcp_at(&q)]) {
            let local = first.placement.inverse_transform_point(&Point3::from(at.translation.vector)).coords;
            *farthest = farthest.max(local.cross(&first.axis).norm());
        }
    }
    farthest
}

fn tool_direction(chain: &Chain, settings: &RobotSettings, problems: &mut Vec<Problem>) {
    if settings.gripper.jaw().is_some() && chain.joints.len() < FEWEST_JOINTS {
        problems.push(Problem::new(
            format!("the arm has {} joints: it cannot turn its fingers to the yaw of a part", chain.joints.len()),
            "fingers need an arm with at least five joints; a suction cup needs four",
        ));
    }
    let home = &settings.arm.home_rad;
    let (flange, tcp) = (chain.flange_at(home), chain.tcp_at(home));
    let site = &settings.arm.tcp_site;
    let z = tcp * Vector3::z();
    if (flange.inverse() * tcp).translation.vector.norm() > 1e-3
        && z.dot(&(tcp.translation.vector - flange.translation.vector)) < 0.0
    {
        problems.push(Problem::new(
            format!("the z axis of site `{site}` points from the tool back to the flange"),
            "rotate the site so that its z axis points out of the tool (rpy_rad = [3.141593, 0, 0] turns it around)",
        ));
    }
    let angle = (-z.z).clamp(-1.0, 1.0).acos();
    if angle > FRAC_PI_4 {
        problems.push(Problem::new(
            format!("at home the z axis of site `{site}` points {:.0} degrees off straight down", angle.to_degrees()),
            "choose an arm.home_rad with the tool pointing down, or rotate the site: its z axis must point out of the tool",
        ));
    }
}

/// The fraction of positions over the table that the tool reaches, and whether it reaches each of `positions`.
fn workspace(chain: &Chain, home: &[f64], scale: f64, positions: &[[f64; 2]]) -> (f64, Vec<bool>) {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let at_home = chain.tcp_at(home);
    let x = at_home.rotation * Vector3::x();
    // The tool rotates with the arm's base, which keeps the wrist posture.
    let heading = x.y.atan2(x.x) - at_home.translation.y.atan2(at_home.translation.x);
    let reached = |high: f64, [x, y]: [f64; 2]| {
        [GRID_M, high].iter().all(|z| {
            let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading + y.atan2(x));
            chain.reach(&Isometry3::from_parts(Translation3::new(x, y, *z), yaw * down), home).is_ok()
        })
    };
    let grid = || {
        let at = |x: i32, y: i32| [GRID_M * f64::from(x), GRID_M * f64::from(y)].map(|x| scale * x);
        (6..=14).flat_map(move |x| (-6..=8).map(move |y| at(x, y)))
    };
    // An arm whose wrist points down near the table only lifts its tool as high as it can.
    let all = |high: &f64| positions.iter().all(|at| reached(*high, *at)) && grid().any(|at| reached(*high, at));
    let high = TRANSIT_HEIGHTS_M.into_iter().find(all).unwrap_or(TRANSIT_HEIGHTS_M[0]);
    let places: Vec<bool> = grid().map(|at| reached(high, at)).collect();
    let share = places.iter().filter(|reached| **reached).count() as f64 / places.len() as f64;
    (share, positions.iter().map(|at| reached(high, *at)).collect())
}

/// The scene of the trial: a table with a 5 cm box at the workspace centre.
pub(crate) fn trial_scene() -> Scene {
    let [x, y] = WORKSPACE_CENTRE;
    let parts = vec![Part { primitive: Primitive::Box { half: [0.025; 3] }, pose: Isometry3::identity() }];
    Scene {
        object: Object { mass: MassProperties::homogeneous(&parts, 0.3), parts, joint: None, friction: None },
        object_pose: Isometry3::translation(x, y, 0.025),
        others: Vec::new(),
        friction: 0.8,
        table_friction: None,
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
        fixtures: vec![Fixture::table()],
        gravity: GRAVITY,
        marker: None,
        visual: Visual::default(),
    }
}

/// Holds at home, moves a little and holds again, then closes the empty gripper.
fn trial(engine: &mut MujocoEngine, settings: &RobotSettings, problems: &mut Vec<Problem>) -> Option<f64> {
    let arm = &settings.arm;
    let home = &arm.home_rad;
    let scene = trial_scene();
    if let Err(fault) = engine.load(&scene, home) {
        problems.push(Problem::new(
            fault.to_string(),
            "the robot loads alone but not in a scene: look for names in its model that the scene also uses",
        ));
        return None;
    }
    let before = problems.len();
    home_is_free(engine, &scene, problems);
    if problems.len() > before {
        // While the arm is in contact, its motion does not show the quality of its servos.
        return None;
    }

    let ranges: Vec<[f64; 2]> = engine.chain().joints.iter().map(|joint| joint.range).collect();
    let amplitudes: Vec<f64> = (0..home.len())
        .map(|i| {
            // A cosine out and back, within the joint's speed and acceleration limits.
            let rate = 2.0 * PI / MOTION_S;
            let amplitude = MOTION_RAD
                .min(arm.velocity_limit_rad_s[i] / rate)
                .min(arm.acceleration_limit_rad_s2[i] / (rate * rate));
            if home[i] + amplitude <= ranges[i][1] { amplitude } else { -amplitude.min(home[i] - ranges[i][0]) }
        })
        .collect();
    let open = settings.gripper.jaw().map_or(0.0, |jaw| 0.5 * jaw.opening_m);
    let mut targets = JointTargets { positions: home.clone(), velocities: vec![0.0; home.len()], finger: open };
    let mut worst = vec![0.0_f64; home.len()];
    let step = engine.time_step();
    let steps = |seconds: f64| (seconds / step).round() as usize;
    for k in 0..steps(2.0 * HOLD_S + MOTION_S) {
        let time = (k as f64 * step - HOLD_S).clamp(0.0, MOTION_S);
        let angle = 2.0 * PI * time / MOTION_S;
        let rate = if (0.0..MOTION_S).contains(&(k as f64 * step - HOLD_S)) { 2.0 * PI / MOTION_S } else { 0.0 };
        for (i, amplitude) in amplitudes.iter().enumerate() {
            targets.positions[i] = home[i] + 0.5 * amplitude * (1.0 - angle.cos());
            targets.velocities[i] = 0.5 * amplitude * rate * angle.sin();
        }
        engine.advance(&targets);
        if let Err(fault) = engine.health() {
            problems.push(Problem::new(
                format!("the arm does not hold its home position: {fault}"),
                "the servo is unstable at a time step of 2 ms: lower arm.stiffness_nm_rad, raise arm.damping_nms_rad, or give the joints armature (the motors' inertia) in the model",
            ));
            return None;
        }
        for ((worst, q), target) in worst.iter_mut().zip(engine.joint_positions()).zip(&targets.positions) {
            *worst = worst.max((q - target).abs());
        }
    }
    for ((name, worst), speed) in arm.joints.iter().zip(&worst).zip(engine.joint_velocities()) {
        if *worst > FOLLOWS_RAD {
            problems.push(Problem::new(
                format!("joint `{name}` is up to {worst:.3} rad off its target while it holds and moves slowly"),
                "raise arm.stiffness_nm_rad or arm.torque_limit_nm of this joint, or check what it collides with",
            ));
        }
        if speed.abs() > STILL_RAD_S {
            problems.push(Problem::new(
                format!("joint `{name}` oscillates at {:.2} rad/s when it should be at rest", speed.abs()),
                "raise arm.damping_nms_rad of this joint, or lower its stiffness",
            ));
        }
    }
    if let Some(jaw) = settings.gripper.jaw() {
        let reached = |engine: &MujocoEngine| engine.opening().unwrap_or(f64::NAN);
        let opened = reached(engine);
        let loose = engine.farthest_off(jaw.opening_m);
        if let Some(gap) = engine.pad_gap().filter(|gap| jaw.drives.is_empty() && (gap - opened).abs() > FINGERS_M) {
            problems.push(Problem::new(
                format!(
                    "with the gripper open, the fingers' shapes are {:.1} mm apart, and their joints stand for {:.1} mm",
                    1e3 * gap,
                    1e3 * opened
                ),
                "describe these fingers by [[gripper.drive]] instead of gripper.finger_joints: the opening is then read from the pads",
            ));
        }
        let finger_step = jaw.finger_speed_m_s * step;
        for _ in 0..steps(0.5 + 0.5 * jaw.opening_m / jaw.finger_speed_m_s) {
            targets.finger = (targets.finger - finger_step).max(0.0);
            engine.advance(&targets);
        }
        let closed = [engine.narrowest_m(), reached(engine)];
        let ends =
            [("open", [jaw.opening_m, opened], loose), ("close", closed, engine.farthest_off(engine.narrowest_m()))];
        for (command, [wanted, reached], loose) in ends {
            if (reached - wanted).abs() > FINGERS_M || reached.is_nan() {
                problems.push(not_reached(jaw, command, [wanted, reached], loose));
            }
        }
    }
    Some(worst.into_iter().fold(0.0, f64::max))
}

/// The problem of fingers that are not at an end after a command. `loose` is the joint that is farthest off its position there.
fn not_reached(
    jaw: &ParallelJaw,
    command: &str,
    [wanted, reached]: [f64; 2],
    loose: Option<(String, [f64; 2])>,
) -> Problem {
    let apart = format!(
        "after the command to {command}, the fingers are {:.1} mm apart. Expected {:.1} mm",
        1e3 * reached,
        1e3 * wanted
    );
    let driven = |name: &String| jaw.drives.iter().any(|drive| drive.moves == *name);
    match loose.filter(|(name, _)| !driven(name)) {
        Some((name, [at, rest])) => Problem::new(
            format!("{apart}: joint `{name}` is at {at:.3} instead of {rest:.3}"),
            "if nothing holds this joint but a weak spring, couple it to the drive in the model (<equality> with <joint> or <connect>), or remove the joint",
        ),
        None => Problem::new(
            apart,
            "check the coupling of the fingers (equality, tendon), their friction, and gripper.stiffness_n_m and damping_ns_m; with gripper.finger_joints, 0 must be closed and opening_m the sum of their ranges",
        ),
    }
}

/// Checks that the robot at home touches neither the scene nor itself.
fn home_is_free(engine: &mut MujocoEngine, scene: &Scene, problems: &mut Vec<Problem>) {
    let touches = engine.touches();
    let on_object = touches.body_on_object || touches.fingers.iter().any(Option::is_some);
    if let Some(collision) = touches.collision {
        let body = engine.robot_body(collision.robot_body);
        let fixture = |index: usize| scene.fixtures.get(index).map_or_else(String::new, |fixture| fixture.name.clone());
        let hit = collision.hit.name(fixture, |body| engine.robot_body(body));
        problems.push(Problem::new(
            format!("at home `{body}` touches the {hit}"),
            "choose another arm.home_rad; the table's top is the plane z = 0 and starts 0.15 m in front of the base",
        ));
    }
    if on_object {
        problems.push(Problem::new(
            "at home the robot touches a box 0.5 m in front of the base",
            "choose an arm.home_rad with the tool higher up",
        ));
    }
    for (a, b, depth) in engine.self_contacts(DEEP_M) {
        problems.push(Problem::new(
            format!("at home `{a}` and `{b}` penetrate each other by {:.1} mm", 1e3 * depth),
            "choose another arm.home_rad, or, if their shapes overlap by design, exclude the pair in the model: <contact><exclude body1=\"..\" body2=\"..\"/></contact>, in a URDF within <mujoco>",
        ));
    }
}
