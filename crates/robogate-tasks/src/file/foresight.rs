//! What the program knows about an episode of a task from a file before it runs. A file names it: `foresight = "stack"`.
//!
//! `stack` knows how the expert stacks cubes, from the bottom up in the order of the roles. The margins follow the expert, which grasps
//! each part at its nominal place and puts it on the nominal place of the stack. Where it comes to rest follows from the displacements
//! of the tool in both postures and from that of the part in the hand.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Better, DrawSpec, Fault, FeatureSpec, Foresight, Measures, Scenario};
use robogate_physics::{Chain, Gripper, Robot};

use super::expert::Expert;
use super::model::Model;
use super::numbers::{Draws, Layout};
use super::stack_claims::CLAIMS;
use super::statics::{self, Level};
use super::{Briefing, Drawn, FileTask};
use crate::arm::claims::Claim;
use crate::arm::{
    GAP_MARGIN, GRIP_THRESHOLD_M, LIP_MARGIN, Memo, OPENING_CLEARANCE, PRESS_MARGIN, Posture, bias_draws, components,
    draw, drawn, feature, grasp_height, holding_n, in_hand, joined, log_ratio, tool_draws, within_quarter,
};

/// Foresight with a name.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlugIn {
    /// Whether it knows such a task. The error says what the task lacks.
    pub(super) suits: fn(&Model) -> Result<(), String>,
    /// The declared draws for this robot.
    pub(super) draws: fn(&FileTask, &Robot) -> Vec<DrawSpec>,
    /// Claims about the physics of such a task.
    pub(super) claims: &'static [Claim],
    pub(super) new: fn(FileTask, &Robot, &Chain, f64) -> Arc<dyn Foresight>,
}

/// Every foresight by its name.
pub(super) static PLUG_INS: [(&str, PlugIn); 1] = [(
    "stack",
    PlugIn {
        suits,
        draws: draw_specs,
        claims: &CLAIMS,
        new: |task, robot, chain, grip| Arc::new(Stack::new(task, robot, chain, grip)),
    },
)];

/// Sizes and overhangs are rounded to this step for the planned postures, in metres. It changes a displacement by less than 0.1 mm.
const STEP_M: f64 = 0.005;
/// Height of a part above the part below it at its release, in metres.
const RELEASE_ROOM_M: f64 = 0.003;
/// Acceleration of a tool that carries a part, in m/s^2.
const CARRY_M_S2: f64 = 1.2;
/// The levels of a stack above the bottom.
const LEVELS: [&str; 5] = ["second", "third", "fourth", "fifth", "sixth"];
/// The numbers that it reads by their names: edge of the cubes, offset of each from the one below as a fraction of it, and tolerance.
const READ: [&str; 3] = ["size_m", "overhang", "tolerance_m"];

fn suits(model: &Model) -> Result<(), String> {
    if let Some(missing) = READ.iter().find(|name| model.number_named(name).is_none()) {
        return Err(format!("`stack` needs a parameter or setting `{missing}`"));
    }
    let roles = model.choice.as_ref().map_or(0, |choice| choice.roles.len());
    if !(2..=LEVELS.len() + 1).contains(&roles) {
        return Err(format!("`stack` needs a choice of 2 to {} roles, from the bottom up", LEVELS.len() + 1));
    }
    if let Some(name) = READ.iter().find(|name| model.lowest(name).is_none_or(|low| low.is_nan() || low < 0.0)) {
        return Err(format!("`stack` needs a `{name}` that is never negative"));
    }
    match model.nominal.parts.iter().all(|part| part.size_m().is_some() && part.joint.is_none()) {
        true => Ok(()),
        false => Err("`stack` needs parts that are cubes".to_owned()),
    }
}

fn draw_specs(task: &FileTask, robot: &Robot) -> Vec<DrawSpec> {
    let tools = LEVELS[..task.roles() - 1].iter().flat_map(|part| {
        let grasp = tool_draws(&format!("grasp_{part}"), &format!("the planned grasp of the {part} part"));
        let place = tool_draws(&format!("place_{part}"), &format!("the planned release of the {part} part"));
        grasp.into_iter().chain(place)
    });
    let parts = task.model.parts.iter().flat_map(|part| {
        let name = &part.name;
        let shift = ["x", "y"].into_iter().filter_map(move |axis| {
            let meaning = format!("Offset of {} from its place along {axis}.", name.replace('_', " "));
            draw(&format!("{name}_shift_{axis}_m"), "m", meaning)
        });
        let turn = format!("Rotation of {} about the vertical.", name.replace('_', " "));
        shift.chain(draw(&format!("{name}_turn_rad"), "rad", turn))
    });
    bias_draws(robot.settings.arm.joints.len()).chain(tools).chain(parts).collect()
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
type Moves<T> = Vec<[T; 2]>;

/// Word of the order, and size and overhang in steps of [`STEP_M`].
type Key = (usize, u64, u64);

/// The knowledge about episodes of a stack on one robot.
struct Stack {
    task: FileTask,
    robot: Robot,
    chain: Chain,
    grip_force_n: f64,
    planner: Expert,
    draws: Vec<DrawSpec>,
    /// `None` where a posture is out of reach.
    postures: Memo<Key, Option<Moves<Posture>>>,
}

/// An episode before it runs.
struct Outlook {
    drawn: Drawn,
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

impl Stack {
    fn new(task: FileTask, robot: &Robot, chain: &Chain, grip_force_n: f64) -> Self {
        let (model, settings) = (Arc::clone(&task.model), task.settings.clone());
        Self {
            draws: draw_specs(&task, robot),
            planner: Expert::new(model, settings, robot.clone(), chain.clone()),
            robot: robot.clone(),
            chain: chain.clone(),
            grip_force_n,
            postures: Memo::new(),
            task,
        }
    }

    fn read(&self, drawn: &Drawn) -> [f64; 3] {
        READ.map(|name| self.task.model.number_named(name).map_or(f64::NAN, |index| drawn.numbers.values[index]))
    }

    /// The postures in which the arm grasps and releases each part. `None` if one is out of reach.
    fn plan(&self, word: usize, size_m: f64, overhang: f64) -> Option<Moves<Posture>> {
        let told = READ.iter().zip([size_m, overhang]).map(|(name, value)| ((*name).to_owned(), value));
        let choice = self.task.model.choice.as_ref()?.words.get(word)?.0.clone();
        let briefing = Briefing { parameters: told.collect(), choice, ..Briefing::default() };
        let stages = self.planner.stages(&briefing).ok()?;
        // The last posture is that after the last release.
        let stops = Posture::of_plan(&self.chain, &stages);
        let moves: Moves<Posture> = stops.chunks_exact(2).map(|both| [both[0].clone(), both[1].clone()]).collect();
        (moves.len() + 1 == self.task.roles()).then_some(moves)
    }

    fn outlook(&self, scenario: &Scenario) -> Result<Outlook, Fault> {
        let drawn = self.task.drawn(scenario, &self.robot)?;
        let bias = drawn.numbers.around.bias(scenario, &self.robot)?;
        let [size_m, overhang, _] = self.read(&drawn);
        let steps = |metres: f64| (metres / STEP_M).round().max(0.0);
        let (size, overhang) = (steps(size_m).max(1.0), steps(overhang * size_m));
        let word = drawn.numbers.word;
        let postures = self.postures.get((word, size as u64, overhang as u64), || {
            let size_m = size * STEP_M;
            self.plan(word, size_m, overhang * STEP_M / size_m)
        });
        let displaced = |one: Posture| (one.clone(), one.displacement(&self.chain, &bias));
        let moves = postures.map(|moves| moves.into_iter().map(|both| both.map(displaced)).collect());
        Ok(Outlook { drawn, bias, moves })
    }

    fn fill(&self, outlook: &Outlook) -> Vec<f64> {
        let Drawn { numbers, layout, .. } = &outlook.drawn;
        let [size, overhang, tolerance_m] = self.read(&outlook.drawn);
        let gripper = &self.robot.settings.gripper;
        let nominal = Layout::new(numbers, &self.task.model.parents(), &vec![Draws::default(); layout.parts.len()]);
        let order = self.task.order(numbers.word);
        let mass = |level: usize| numbers.parts[order[level]].mass_kg;
        let offset_m = overhang * size;
        let mut placed = vec![layout.parts[order[0]]];
        let (mut tilt, mut room) = (0.0_f64, RELEASE_ROOM_M);
        let mut grasps = Vec::new();
        for (level, [(grasp, off), (place, off_there)]) in (1..).zip(outlook.moves.iter().flatten()) {
            let (from, truly) = (nominal.parts[order[level]], layout.parts[order[level]]);
            let held = in_hand(&grasp.tool, off, &(truly * from.inverse()), gripper);
            // The postures belong to a rounded size and overhang: only the displacements are used.
            let goal = nominal.parts[order[0]].translation.vector + level as f64 * Vector3::new(offset_m, 0.0, size);
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
            (off.x - offset_m).hypot(off.y)
        };
        let turn = |two: &[Isometry3<f64>]| {
            within_quarter(two[1].rotation.euler_angles().2 - two[0].rotation.euler_angles().2).abs()
        };
        let levels: Vec<Level> = placed
            .iter()
            .enumerate()
            .map(|(level, at)| Level { at: [at.translation.x, at.translation.y], mass_kg: mass(level) })
            .collect();
        let least = |of: &dyn Fn(&Grasp) -> f64| grasps.iter().map(of).fold(size, f64::min);
        let holding_n = holding_n(gripper, numbers.friction, self.grip_force_n, &numbers.around.gripper);
        let heaviest = (1..order.len()).map(mass).fold(0.0, f64::max);
        let carried_n = heaviest * (numbers.gravity + CARRY_M_S2);
        let mut row = vec![
            tolerance_m - pairs().map(apart).fold(0.0, f64::max),
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

impl Foresight for Stack {
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        let Outlook { drawn: Drawn { numbers, draws, .. }, bias, moves } = self.outlook(scenario)?;
        let tools = (0..2 * (self.task.roles() - 1))
            .flat_map(|at| components(moves.as_ref().map(|moves| &moves[at / 2][at % 2].1)));
        let parts = numbers.parts.iter().zip(&draws).flat_map(|(part, draws)| {
            let [x, y] = draws.shift.map(|x| part.spread_m * x);
            [x, y, part.spin_rad * draws.turn].map(Some)
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
