//! The hidden draws of an episode of insertion and its physical margins, from the scenario alone.
//!
//! The margins follow the scripted controller: it grasps the peg at its nominal place and brings it over the nominal place of the hole.
//! There the tip is off the true hole by the displacement of the tool, by that of the peg in the hand, and by the shift of the hole.

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Better, DrawSpec, Fault, FeatureSpec, Foresight, Measures, Pose, Scenario};
use robogate_physics::{Chain, GRAVITY, Gripper, Robot, isometry};

use super::controller::{self, CARRY, INSERT_N, Scripted};
use super::parameters::Settings;
use super::parts::{DEPTH_M, HEAD_HEIGHT_M, HEAD_M, SHAFT_M};
use super::scene::{GRIP_FRICTION, nominal_poses, settings};
use super::spec::Briefing;
use super::whitney;
use crate::arm::{
    GAP_MARGIN, GRIP_THRESHOLD_M, LIP_MARGIN, MOMENT_SHARE, OPENING_CLEARANCE, PRESS_MARGIN, Posture, bias_draws,
    components, draw, drawn, feature, holding_n, in_hand, joined, log_ratio, search_time, tool_draws, within_quarter,
};

/// Longest time of a search, in seconds: longer than an episode.
const LONGEST_SEARCH_S: f64 = 60.0;

/// The declared draws for an arm with this number of joints.
pub(super) fn draw_specs(joints: usize) -> Vec<DrawSpec> {
    let shifts = [("peg_shift", "peg"), ("hole_shift", "hole")].into_iter().flat_map(|(name, part)| {
        ["x", "y"].into_iter().filter_map(move |axis| {
            draw(&format!("{name}_{axis}_m"), "m", format!("Offset of the {part} from its place along {axis}."))
        })
    });
    let turns = ["x", "y"].into_iter().filter_map(|axis| {
        draw(&format!("hole_turn_{axis}_rad"), "rad", format!("Tilt of the hole's axis about {axis}."))
    });
    bias_draws(joints)
        .chain(tool_draws("grasp", "the planned grasp of the peg"))
        .chain(tool_draws("arrival", "the planned arrival over the hole"))
        .chain(shifts)
        .chain(turns)
        .collect()
}

/// The features with any gripper.
const ANY: [FeatureSpec; 9] = [
    feature("entry_offset_m", Better::Lower, "Distance of the peg's tip from the middle of the mouth on arrival."),
    feature(
        "chamfer_margin_m",
        Better::Higher,
        "Half of the clearance plus the chamfer, minus the offset of the tip along the worse side of the hole.",
    ),
    feature("search_time_s", Better::Lower, "Time of the spiral from its centre to the hole, at most 60 s."),
    feature("relative_tilt_rad", Better::Lower, "Angle between the axes of peg and hole on arrival."),
    feature("yaw_offset_rad", Better::Lower, "Rotation of the peg in the hole about its axis, to the nearest fit."),
    feature(
        "fit_margin_m",
        Better::Higher,
        "Clearance minus what tilt and rotation need for the full depth, without bending the arm.",
    ),
    feature(
        "binding_margin",
        Better::Higher,
        "Logarithm of the insertion force over the friction of the walls that straighten the peg.",
    ),
    feature("wedging_depth_m", Better::Lower, "Depth down to which the peg can wedge: friction times width."),
    feature(
        "grip_margin",
        Better::Higher,
        "Logarithm of the holding force over the larger one of insertion force and weight of the carried peg.",
    ),
];

/// The features for fingers.
static FINGERS: [FeatureSpec; 11] = joined(
    &ANY,
    &[
        OPENING_CLEARANCE,
        feature("head_overlap_m", Better::Higher, "Distance from the grasp point to the nearer edge of the head."),
    ],
);

/// The features for a suction cup.
static CUP: [FeatureSpec; 13] = joined(
    &ANY,
    &[
        feature(
            "bending_margin",
            Better::Higher,
            "Logarithm of the force at the tip that the cup's moment allows over the force that straightens the peg.",
        ),
        LIP_MARGIN,
        GAP_MARGIN,
        PRESS_MARGIN,
    ],
);

/// The knowledge about episodes of insertion on one robot.
pub(super) struct InsertionForesight {
    robot: Robot,
    chain: Chain,
    grip_force_n: f64,
    draws: Vec<DrawSpec>,
    /// Nominal poses of peg and hole.
    nominal: [Isometry3<f64>; 2],
    /// The postures of grasp and arrival. `None` if they are out of reach.
    postures: Option<[Posture; 2]>,
    /// Compliance of the arm with its own servos across the peg on arrival, in m/N. 1 without an arrival.
    compliance: f64,
}

/// An episode before it runs.
struct Outlook {
    settings: Settings,
    bias: Vec<f64>,
    /// Displacements of the tool in the grasp and on arrival, each in its own frame.
    off: Option<[Isometry3<f64>; 2]>,
}

impl InsertionForesight {
    pub(super) fn new(robot: &Robot, chain: &Chain, grip_force_n: f64) -> Self {
        let [peg, hole] = nominal_poses(robot);
        let at = |pose: &Pose| isometry(&pose.position, &pose.orientation);
        let nominal = [at(&peg), at(&hole)];
        let briefing = Briefing { peg, hole, clearance_m: 0.0, chamfer_m: 0.0, arm_stiffness: 1.0 };
        let postures = Scripted::new(robot.clone(), chain.clone()).postures(&briefing);
        let compliance = postures.as_ref().map_or(1.0, |[_, arrival]| {
            let compliance = arrival.compliance(robot, chain);
            0.5 * (compliance[(0, 0)] + compliance[(1, 1)])
        });
        Self {
            robot: robot.clone(),
            chain: chain.clone(),
            grip_force_n,
            draws: draw_specs(chain.joints.len()),
            nominal,
            postures,
            compliance,
        }
    }

    fn outlook(&self, scenario: &Scenario) -> Result<Outlook, Fault> {
        let settings = settings(scenario, &self.robot)?;
        let bias = settings.around.bias(scenario, &self.robot)?;
        let off = self.postures.as_ref().map(|both| both.each_ref().map(|one| one.displacement(&self.chain, &bias)));
        Ok(Outlook { settings, bias, off })
    }

    /// The pose of the peg in the frame of the true hole on arrival.
    fn arrival(&self, outlook: &Outlook) -> Isometry3<f64> {
        let settings = &outlook.settings;
        let [peg, hole] = &self.nominal;
        let shift = settings.peg_pose() * peg.inverse();
        let (Some([grasp, arrival]), Some([off, off_there])) = (&self.postures, &outlook.off) else {
            return settings.mouth().inverse() * hole;
        };
        let held = in_hand(&grasp.tool, off, &shift, &self.robot.settings.gripper);
        // The arm arrives above the hole. This is where the peg would be in its mouth.
        let mut over = arrival.tool;
        over.translation.z = hole.translation.z + self.tool_height();
        let at = over * off_there * held * grasp.tool.inverse() * peg;
        settings.mouth().inverse() * at
    }

    fn tool_height(&self) -> f64 {
        controller::tool_height(&self.robot.settings.gripper)
    }

    fn fill(&self, outlook: &Outlook) -> Vec<f64> {
        let settings = &outlook.settings;
        let at = self.arrival(outlook);
        let [x, y, _] = at.translation.vector.into();
        let axis = at.rotation * Vector3::z();
        let tilt = axis.x.hypot(axis.y);
        let yaw = within_quarter(at.rotation.euler_angles().2).abs();
        let fit = settings.clearance_m - DEPTH_M * tilt - settings.width_m * yaw;
        // The walls bend the arm by what does not fit.
        let straighten_n = (-fit).max(0.0) * settings.arm_stiffness / self.compliance;
        let weight_n = settings.mass_kg * (GRAVITY + CARRY.acceleration);
        let gripper = &self.robot.settings.gripper;
        let holding_n = holding_n(gripper, GRIP_FRICTION, self.grip_force_n, &settings.around.gripper);
        let search_s = search_time(settings.clearance_m, settings.chamfer_m, x.hypot(y));
        let mut row = vec![
            x.hypot(y),
            0.5 * settings.clearance_m + settings.chamfer_m - x.abs().max(y.abs()),
            search_s.min(LONGEST_SEARCH_S),
            tilt,
            yaw,
            fit,
            log_ratio(INSERT_N, 2.0 * settings.friction * straighten_n),
            whitney::wedging_depth(settings.width_m, settings.friction),
            log_ratio(holding_n, weight_n.max(INSERT_N)),
        ];
        // The true tool in the grasp, from the middle of the peg's head.
        let grasp = match (&self.postures, &outlook.off) {
            (Some([grasp, _]), Some([off, _])) => {
                let head = settings.peg_pose() * Isometry3::translation(0.0, 0.0, SHAFT_M + HEAD_HEIGHT_M);
                let tool = grasp.tool * off;
                grasp.tool.rotation.inverse() * (tool.translation.vector - head.translation.vector)
            }
            _ => Vector3::zeros(),
        };
        match gripper {
            Gripper::ParallelJaw(jaw) => {
                row.extend([0.5 * (jaw.opening_m - HEAD_M) - grasp.y.abs(), 0.5 * HEAD_M - grasp.x.abs()]);
            }
            Gripper::Suction(cup) => {
                let radius = 0.5 * cup.cup_diameter_m;
                let at_tip_n = MOMENT_SHARE * cup.force_n() * radius / self.tool_height();
                let gap = -grasp.z;
                row.extend([
                    log_ratio(at_tip_n, straighten_n),
                    0.5 * HEAD_M - radius - grasp.xy().norm(),
                    GRIP_THRESHOLD_M - gap,
                    gap,
                ]);
            }
        }
        row
    }
}

impl Foresight for InsertionForesight {
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        let Outlook { settings, bias, off } = self.outlook(scenario)?;
        let [grasp, arrival] = [0, 1].map(|at| components(off.as_ref().map(|both| &both[at])));
        let [peg, hole] = [(settings.shift[0], settings.peg_jitter_m), (settings.shift[1], settings.hole_jitter_m)]
            .map(|(shift, jitter)| shift.map(|x| Some(jitter * x)));
        let turn = settings.hole_turn();
        let values = bias.into_iter().map(Some).chain(grasp).chain(arrival).chain(peg).chain(hole);
        Ok(drawn(&self.draws, values.chain([Some(turn.x), Some(turn.y)])))
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
