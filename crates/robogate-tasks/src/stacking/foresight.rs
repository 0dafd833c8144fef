//! The hidden draws of an episode of stacking and its physical margins, from the scenario alone.
//!
//! The margins follow the scripted controller, which grasps each part at its nominal place and puts it on the nominal place of the
//! stack. Where it comes to rest follows from the displacements of the tool in both postures and from that of the part in the hand.

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Better, DrawSpec, Fault, FeatureSpec, Foresight, Measures, Pose, Scenario};
use robogate_physics::{Chain, GRAVITY, Gripper, Robot, isometry};

use super::controller::{CARRY, RELEASE_ROOM_M, Scripted};
use super::parameters::{PARTS, Settings};
use super::scene::{briefing, settings};
use super::statics::{self, Level};
use crate::arm::{
    GAP_MARGIN, GRIP_THRESHOLD_M, LIP_MARGIN, Memo, OPENING_CLEARANCE, PRESS_MARGIN, Posture, bias_draws, components,
    draw, drawn, feature, grasp_height, holding_n, in_hand, joined, log_ratio, tool_draws, within_quarter,
};

/// Sizes and overhangs are rounded to this step for the planned postures, in metres. It changes a displacement by less than 0.1 mm.
const STEP_M: f64 = 0.005;

/// The declared draws for an arm with this number of joints.
pub(super) fn draw_specs(joints: usize) -> Vec<DrawSpec> {
    let tools = ["second", "third"].into_iter().flat_map(|part| {
        let grasp = tool_draws(&format!("grasp_{part}"), &format!("the planned grasp of the {part} part"));
        let place = tool_draws(&format!("place_{part}"), &format!("the planned release of the {part} part"));
        grasp.into_iter().chain(place)
    });
    let parts = PARTS.into_iter().flat_map(|part| {
        let shift = ["x", "y"].into_iter().filter_map(move |axis| {
            let meaning = format!("Offset of part {part} from its place along {axis}.");
            draw(&format!("part_{part}_shift_{axis}_m"), "m", meaning)
        });
        let turn = format!("Rotation of part {part} about the vertical.");
        shift.chain(draw(&format!("part_{part}_turn_rad"), "rad", turn))
    });
    bias_draws(joints).chain(tools).chain(parts).collect()
}

/// The features with any gripper.
const ANY: [FeatureSpec; 6] = [
    feature(
        "place_margin_m",
        Better::Higher,
        "Tolerance minus the largest distance of a part from its place on the part below.",
    ),
    feature(
        "stability_margin_m",
        Better::Higher,
        "Smallest distance from the line of gravity of the parts above a face to the edge of that face.",
    ),
    feature(
        "turn_rad",
        Better::Lower,
        "Largest rotation of a part against the part below, to the nearest quarter of a turn.",
    ),
    feature("tilt_rad", Better::Lower, "Largest tilt of a part at its release."),
    feature("release_room_m", Better::Neither, "Smallest height of a part above the part below at its release."),
    feature(
        "grip_margin",
        Better::Higher,
        "Logarithm of the holding force over the force that carries the heavier part.",
    ),
];

/// The features for fingers.
static FINGERS: [FeatureSpec; 9] = joined(
    &ANY,
    &[
        OPENING_CLEARANCE,
        feature(
            "pad_overlap_m",
            Better::Higher,
            "Smallest distance from the grasp point to the nearer edge of the part, across the fingers.",
        ),
        feature("table_clearance_m", Better::Higher, "Smallest height of the fingertips above the table in a grasp."),
    ],
);

/// The features for a suction cup.
static CUP: [FeatureSpec; 9] = joined(&ANY, &[LIP_MARGIN, GAP_MARGIN, PRESS_MARGIN]);

/// One for grasp and one for release of each part that is moved, from the bottom up.
type Moves<T> = [[T; 2]; 2];

/// Order of the parts, and size and overhang in steps of [`STEP_M`].
type Key = ([usize; 3], u64, u64);

/// The knowledge about episodes of stacking on one robot.
pub(super) struct StackingForesight {
    robot: Robot,
    chain: Chain,
    grip_force_n: f64,
    /// Largest distance of a part from its place, in metres.
    tolerance_m: f64,
    planner: Scripted,
    draws: Vec<DrawSpec>,
    /// `None` where a posture is out of reach.
    postures: Memo<Key, Option<Moves<Posture>>>,
}

/// An episode before it runs.
struct Outlook {
    settings: Settings,
    bias: Vec<f64>,
    moves: Option<Moves<Displaced>>,
}

/// A posture, and the displacement of its tool.
type Displaced = (Posture, Isometry3<f64>);

/// The tool in a grasp.
struct Grasp {
    /// Its place from the middle of the part, in the frame of the planned tool.
    off: Vector3<f64>,
    /// Rotation of the part about the vertical, in radians.
    yaw: f64,
}

impl StackingForesight {
    pub(super) fn new(robot: &Robot, chain: &Chain, grip_force_n: f64, tolerance_m: f64) -> Self {
        Self {
            tolerance_m,
            robot: robot.clone(),
            chain: chain.clone(),
            grip_force_n,
            planner: Scripted::new(robot.clone(), chain.clone()),
            draws: draw_specs(chain.joints.len()),
            postures: Memo::new(),
        }
    }

    fn outlook(&self, scenario: &Scenario) -> Result<Outlook, Fault> {
        let settings = settings(scenario, &self.robot)?;
        let bias = settings.around.bias(scenario, &self.robot)?;
        let steps = |metres: f64| (metres / STEP_M).round().max(0.0);
        let (size, overhang) = (steps(settings.size_m).max(1.0), steps(settings.overhang * settings.size_m));
        let postures = self.postures.get((settings.order, size as u64, overhang as u64), || {
            let size_m = size * STEP_M;
            let rounded = Settings { size_m, overhang: overhang * STEP_M / size_m, ..settings.clone() };
            self.planner.postures(&briefing(&rounded, self.tolerance_m))
        });
        let moves =
            postures.map(|moves| moves.map(|both| both.map(|one| (one.clone(), one.displacement(&self.chain, &bias)))));
        Ok(Outlook { settings, bias, moves })
    }

    fn fill(&self, outlook: &Outlook) -> Vec<f64> {
        let settings = &outlook.settings;
        let size = settings.size_m;
        let gripper = &self.robot.settings.gripper;
        let nominal = briefing(settings, self.tolerance_m);
        let at = |pose: &Pose| isometry(&pose.position, &pose.orientation);
        let base = settings.pose(settings.order[0]);
        let mut placed = vec![base];
        let (mut tilt, mut room) = (0.0_f64, RELEASE_ROOM_M);
        let mut grasps = Vec::new();
        for (level, [(grasp, off), (place, off_there)]) in (1..).zip(outlook.moves.iter().flatten()) {
            let part = settings.order[level];
            let (from, truly) = (at(&nominal.parts[part]), settings.pose(part));
            let held = in_hand(&grasp.tool, off, &(truly * from.inverse()), gripper);
            // The postures belong to a rounded size and overhang: only the displacements are used.
            let goal = at(&nominal.parts[settings.order[0]]).translation.vector
                + level as f64 * Vector3::new(nominal.offset_m[0], nominal.offset_m[1], size);
            let turned = place.tool.rotation * off_there.rotation * held.rotation * place.tool.rotation.inverse();
            let moved =
                place.tool.rotation * (off_there.translation.vector + off_there.rotation * held.translation.vector);
            tilt = tilt.max((turned * Vector3::z()).xy().norm());
            room = room.min(RELEASE_ROOM_M + moved.z);
            placed.push(Isometry3::from_parts((goal + moved).into(), turned));
            let middle = grasp.tool.rotation.inverse() * (truly.translation.vector - from.translation.vector);
            let yaw = within_quarter(truly.rotation.euler_angles().2 - from.rotation.euler_angles().2);
            grasps.push(Grasp { off: off.translation.vector - middle, yaw });
        }
        let pairs = || placed.windows(2);
        let apart = |two: &[Isometry3<f64>]| {
            let off = two[1].translation.vector - two[0].translation.vector;
            (off.x - nominal.offset_m[0]).hypot(off.y - nominal.offset_m[1])
        };
        let turn = |two: &[Isometry3<f64>]| {
            within_quarter(two[1].rotation.euler_angles().2 - two[0].rotation.euler_angles().2).abs()
        };
        let levels: Vec<Level> = placed
            .iter()
            .enumerate()
            .map(|(level, at)| Level { at: [at.translation.x, at.translation.y], mass_kg: settings.mass(level) })
            .collect();
        let least = |of: &dyn Fn(&Grasp) -> f64| grasps.iter().map(of).fold(size, f64::min);
        let holding_n = holding_n(gripper, settings.friction, self.grip_force_n, &settings.around.gripper);
        let carried_n =
            settings.mass(1).max(settings.mass(2)) * (GRAVITY * settings.gravity_scale + CARRY.acceleration);
        let mut row = vec![
            self.tolerance_m - pairs().map(apart).fold(0.0, f64::max),
            statics::margin(&levels, size).clamp(-size, size),
            pairs().map(turn).fold(0.0, f64::max),
            tilt,
            room,
            log_ratio(holding_n, carried_n),
        ];
        let height = grasp_height(gripper, size);
        match gripper {
            Gripper::ParallelJaw(jaw) => row.extend([
                least(&|Grasp { off, yaw }| 0.5 * (jaw.opening_m - size * (yaw.cos() + yaw.sin().abs())) - off.y.abs()),
                least(&|Grasp { off, .. }| 0.5 * size - off.x.abs()),
                least(&|Grasp { off, .. }| height - off.z - jaw.tip_m),
            ]),
            Gripper::Suction(cup) => {
                let gap = |off: &Vector3<f64>| height - size - off.z;
                row.extend([
                    least(&|Grasp { off, .. }| 0.5 * (size - cup.cup_diameter_m) - off.xy().norm()),
                    least(&|Grasp { off, .. }| GRIP_THRESHOLD_M - gap(off)),
                    least(&|Grasp { off, .. }| gap(off)),
                ]);
            }
        }
        row
    }
}

impl Foresight for StackingForesight {
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        let Outlook { settings, bias, moves } = self.outlook(scenario)?;
        let tools = (0..4).flat_map(|at| components(moves.as_ref().map(|moves| &moves[at / 2][at % 2].1)));
        let parts = (0..PARTS.len()).flat_map(|part| {
            let [x, y] = settings.shift[part].map(|x| settings.position_jitter_m * x);
            [x, y, settings.yaw_jitter_rad * settings.turn[part]].map(Some)
        });
        Ok(drawn(&self.draws, bias.into_iter().map(Some).chain(tools).chain(parts)))
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
