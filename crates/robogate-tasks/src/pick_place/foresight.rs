//! The hidden draws of an episode and its physical margins, from the scenario alone.
//!
//! The draws come from [`ResolvedCell`], as in the episode itself. The planned grasp is that of the scripted controller, whose inverse
//! kinematics is solved for the object's size rounded to 5 mm. This changes the displacement of the tool by less than 0.1 mm.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use robogate_core::{Better, DrawSpec, Fault, FeatureSpec, Foresight, Measures, Scenario};
use robogate_physics::{Chain, FixtureKind, GRAVITY, Gripper, Robot, isometry};

use super::cell::ResolvedCell;
use super::scripted::{CARRY_ACCELERATION_M_S2, Scripted, grasp_height};
use super::{PickPlace, parameters};
use crate::arm::{
    GAP_MARGIN, LIP_MARGIN, Memo, OPENING_CLEARANCE, PRESS_MARGIN, Posture, bias_draws, components, draw, drawn,
    feature, log_ratio, tool_draws,
};

/// Sizes are rounded to this step for the planned grasp, in metres.
const SIZE_STEP_M: f64 = 0.005;

/// Distance of obstacles that do not matter, in metres.
const FAR_M: f64 = 0.5;

/// Effective radius of the friction torque of a pad, in metres: two thirds of a patch of 5 mm.
const PAD_RADIUS_M: f64 = 0.005 * 2.0 / 3.0;

/// The declared draws for an arm with this number of joints.
pub(super) fn draw_specs(joints: usize) -> Vec<DrawSpec> {
    let jitter = ["x", "y"].into_iter().filter_map(|axis| {
        draw(&format!("jitter_{axis}_m"), "m", format!("Offset of the object along {axis} by the position jitter."))
    });
    let nearest = [
        (
            "obstacle_distance_m",
            "Horizontal distance from the displaced tool to the bounding circle of the nearest obstacle.",
        ),
        ("obstacle_height_m", "Height of the nearest obstacle."),
    ]
    .into_iter()
    .filter_map(|(name, meaning)| draw(name, "m", meaning));
    let positions = (1..=parameters::MOST_OBSTACLES).flat_map(|obstacle| {
        ["x", "y"].into_iter().filter_map(move |axis| {
            let meaning = format!("Position of the centre of obstacle {obstacle} along {axis}.");
            draw(&format!("obstacle_{obstacle}_{axis}_m"), "m", meaning)
        })
    });
    bias_draws(joints)
        .chain(tool_draws("tool", "the planned grasp"))
        .chain(jitter)
        .chain(nearest)
        .chain(positions)
        .collect()
}

const REACH: FeatureSpec =
    feature("reach_margin_m", Better::Higher, "Reach of the arm minus the distance of the object from the base.");

const OBSTACLE: FeatureSpec = feature(
    "obstacle_clearance_m",
    Better::Higher,
    "Horizontal distance from the displaced tool to the nearest obstacle.",
);

/// The features for fingers.
static FINGERS: [FeatureSpec; 14] = [
    feature("grip_margin", Better::Higher, "Logarithm of the friction force over the force that carries the object."),
    feature(
        "torque_margin",
        Better::Higher,
        "Logarithm of the friction torque of the pads over the moment of the weight.",
    ),
    OPENING_CLEARANCE,
    feature(
        "pad_overlap_m",
        Better::Higher,
        "Distance from the grasp point to the nearer edge of the object, across the fingers.",
    ),
    feature("table_clearance_m", Better::Higher, "Height of the fingertips above the table in the grasp."),
    REACH,
    OBSTACLE,
    feature(
        "obstacle_height_over_tool_m",
        Better::Lower,
        "Height of the nearest obstacle above the tool in the grasp.",
    ),
    feature(
        "obstacle_along_closing_m",
        Better::Neither,
        "Distance of the nearest obstacle along the closing direction.",
    ),
    feature(
        "closing_offset_m",
        Better::Lower,
        "Distance of the object from the middle of the fingers, along the closing direction.",
    ),
    feature("across_offset_m", Better::Lower, "Distance of the object from the middle of the fingers, across them."),
    feature("height_offset_m", Better::Neither, "Displacement of the tool out of the tool, which is down."),
    feature("tilt_closing_rad", Better::Lower, "Tilt of the tool about the direction across the fingers."),
    feature("yaw_offset_rad", Better::Lower, "Rotation of the tool about its axis."),
];

/// The features for a suction cup.
static CUP: [FeatureSpec; 9] = [
    feature("grip_margin", Better::Higher, "Logarithm of the holding force over the force that carries the object."),
    feature(
        "torque_margin",
        Better::Higher,
        "Logarithm of the holding torque of the cup over the moment of the weight.",
    ),
    LIP_MARGIN,
    GAP_MARGIN,
    PRESS_MARGIN,
    REACH,
    OBSTACLE,
    feature("lateral_offset_m", Better::Lower, "Horizontal distance of the cup from the planned grasp point."),
    feature("tilt_rad", Better::Lower, "Angle of the tool's axis to the vertical."),
];

/// The knowledge about episodes of pick and place on one robot.
pub(super) struct PickPlaceForesight {
    robot: Robot,
    rules: PickPlace,
    chain: Chain,
    grip_force_n: f64,
    planner: Scripted,
    draws: Vec<DrawSpec>,
    /// Planned grasps. `None` where the grasp is out of reach.
    grasps: Memo<Key, Option<Posture>>,
}

/// Shape, rounded size, position and yaw of the object, as bits.
type Key = (&'static str, u64, [u64; 3]);

/// The obstacle nearest to the tool.
struct Nearest {
    distance_m: f64,
    height_m: f64,
    /// Its centre relative to the tool.
    offset: Vector3<f64>,
}

/// An episode before it runs.
struct Outlook {
    cell: ResolvedCell,
    /// Planned tool pose and its displacement in its own frame.
    grasp: Option<(Isometry3<f64>, Isometry3<f64>)>,
}

impl PickPlaceForesight {
    pub(super) fn new(robot: &Robot, chain: &Chain, grip_force_n: f64, rules: &PickPlace) -> Self {
        Self {
            robot: robot.clone(),
            rules: *rules,
            chain: chain.clone(),
            grip_force_n,
            planner: Scripted::new(robot.clone(), chain.clone()),
            draws: draw_specs(chain.joints.len()),
            grasps: Memo::new(),
        }
    }

    fn outlook(&self, scenario: &Scenario) -> Result<Outlook, Fault> {
        let cell = ResolvedCell::new(scenario, &self.robot, &self.rules)?;
        let grasp = self.grasp(&cell).map(|posture| {
            let off = posture.displacement(&self.chain, &cell.bias);
            // The height follows the true size.
            let mut planned = posture.tool;
            planned.translation.z = grasp_height(&self.robot, &[cell.parameters.size_m; 3]);
            (planned, off)
        });
        Ok(Outlook { cell, grasp })
    }

    /// The planned grasp. `None` if it is out of reach.
    fn grasp(&self, cell: &ResolvedCell) -> Option<Posture> {
        let mut briefing = cell.briefing();
        let rounded = (cell.parameters.size_m / SIZE_STEP_M).round().max(1.0) * SIZE_STEP_M;
        let pose = &briefing.object_pose;
        let [w, _, _, z] = pose.orientation;
        let key = (
            cell.parameters.shape.as_str(),
            rounded.to_bits(),
            [pose.position[0], pose.position[1], z.atan2(w)].map(f64::to_bits),
        );
        self.grasps.get(key, || {
            briefing.object_extent_m = [rounded; 3];
            let joints = self.planner.planned_grasp(&briefing).ok()?;
            Some(Posture::new(&self.chain, joints))
        })
    }

    fn nearest(&self, outlook: &Outlook) -> Option<Nearest> {
        let at = match &outlook.grasp {
            Some((planned, off)) => (planned * off).translation.vector,
            None => outlook.cell.scene.object_pose.translation.vector,
        };
        let obstacles = outlook.cell.scene.fixtures.iter().filter(|fixture| fixture.kind == FixtureKind::Obstacle);
        obstacles
            .map(|obstacle| {
                let [x, y, half_height] = obstacle.part.primitive.half_extent();
                let radius = match obstacle.part.primitive {
                    robogate_physics::Primitive::Box { .. } => x.hypot(y),
                    _ => x,
                };
                let offset = obstacle.part.pose.translation.vector - at;
                Nearest { distance_m: offset.xy().norm() - radius, height_m: 2.0 * half_height, offset }
            })
            .min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
    }

    /// Weight force with the acceleration of the carried object, in newtons.
    fn carried_n(&self, cell: &ResolvedCell) -> f64 {
        cell.parameters.mass_kg * (GRAVITY * cell.parameters.gravity_scale + CARRY_ACCELERATION_M_S2)
    }

    fn fill(&self, outlook: &Outlook) -> Vec<f64> {
        let cell = &outlook.cell;
        let p = &cell.parameters;
        let (planned, off) = outlook.grasp.unwrap_or((cell.scene.object_pose, Isometry3::identity()));
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let planned = if outlook.grasp.is_some() {
            planned
        } else {
            Isometry3::from_parts(planned.translation, planned.rotation * down)
        };
        let tool = planned * off;
        let object = cell.scene.object_pose;
        // Displacement of the tool from the object in the planned tool frame, without the planned offset of a cup.
        let nominal = isometry(&cell.briefing().object_pose.position, &cell.briefing().object_pose.orientation);
        let moved = planned.rotation.inverse() * (object.translation.vector - nominal.translation.vector);
        let lateral = off.translation.vector - moved;
        let tilt = off.rotation.scaled_axis();
        let weight_n = p.mass_kg * GRAVITY * p.gravity_scale;
        let centre = object * nalgebra::Point3::from(cell.scene.object.mass.centre);
        let lever = tool.rotation.inverse() * (centre.coords - tool.translation.vector);
        let [x, y, _] = nominal.translation.vector.into();
        let reach_margin = self.robot.settings.arm.reach_m - x.hypot(y);
        let nearest = self.nearest(outlook);
        let clearance = nearest.as_ref().map_or(FAR_M, |near| near.distance_m.min(FAR_M));
        match &self.robot.settings.gripper {
            Gripper::ParallelJaw(jaw) => {
                let force = 2.0 * p.pad_friction() * self.grip_force_n * p.around.gripper.force_scale;
                let width = p.size_m * p.shape.grasp_width();
                let closing = lateral.y.abs();
                let over = nearest.as_ref().map_or(-FAR_M, |near| near.height_m - tool.translation.z);
                let along =
                    nearest.as_ref().map_or(FAR_M, |near| (tool.rotation.inverse() * near.offset).y.abs().min(FAR_M));
                vec![
                    log_ratio(force, self.carried_n(cell)),
                    log_ratio(force * PAD_RADIUS_M, weight_n * lever.x.abs() + 1e-4),
                    0.5 * (jaw.opening_m - width) - closing,
                    0.5 * p.size_m - lateral.x.abs(),
                    tool.translation.z - jaw.tip_m,
                    reach_margin,
                    clearance,
                    over,
                    along,
                    closing,
                    lateral.x.abs(),
                    lateral.z,
                    tilt.x.abs(),
                    tilt.z.abs(),
                ]
            }
            Gripper::Suction(cup) => {
                let radius = 0.5 * cup.cup_diameter_m;
                let force = cup.vacuum_pa * std::f64::consts::PI * radius * radius;
                let sideways = lateral.x.hypot(lateral.y);
                let [top_x, _] = p.shape.top(p.size_m);
                let half = if top_x.abs() > 0.0 { 0.25 * p.size_m } else { 0.5 * p.size_m };
                let gap = tool.translation.z - p.size_m;
                vec![
                    log_ratio(force, self.carried_n(cell)),
                    log_ratio(force * radius, weight_n * lever.x.hypot(lever.y) + 1e-4),
                    half - radius - sideways,
                    p.grip_threshold_m - gap,
                    gap,
                    reach_margin,
                    clearance,
                    sideways,
                    tilt.x.hypot(tilt.y),
                ]
            }
        }
    }
}

impl Foresight for PickPlaceForesight {
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        let outlook = self.outlook(scenario)?;
        let bias = outlook.cell.bias.iter().copied().map(Some);
        let tool = components(outlook.grasp.as_ref().map(|(_, off)| off));
        let jitter = outlook.cell.jitter.map(|fraction| Some(fraction * outlook.cell.parameters.position_jitter_m));
        let near = self.nearest(&outlook);
        let nearest = [near.as_ref().map(|near| near.distance_m), near.as_ref().map(|near| near.height_m)];
        let obstacles = outlook.cell.scene.fixtures.iter().filter(|fixture| fixture.kind == FixtureKind::Obstacle);
        let places = obstacles.flat_map(|fixture| {
            let at = fixture.part.pose.translation;
            [Some(at.x), Some(at.y)]
        });
        Ok(drawn(&self.draws, bias.chain(tool).chain(jitter).chain(nearest).chain(places)))
    }

    fn feature_specs(&self) -> &[FeatureSpec] {
        match self.robot.settings.gripper {
            Gripper::ParallelJaw(_) => &FINGERS,
            Gripper::Suction(_) => &CUP,
        }
    }

    fn features(&self, scenario: &Scenario) -> Result<Vec<f64>, Fault> {
        Ok(self.fill(&self.outlook(scenario)?))
    }
}
