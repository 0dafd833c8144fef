//! The scripted controller: it picks the peg up by a plan from nominal data, then feels its way into the hole.
//!
//! It has no force sensor. The servos are springs: the distance by which the tool lags its command is a force, by the
//! compliance of the arm at the tool (J diag(1/k) J^T; Whitney 1982). With the told stiffness the controller presses with
//! a chosen force by commanding the tool that far beyond its measured position. A suction cup on a spring gives way under that
//! force: the peg is higher than the relaxed cup would be by force over stiffness.
//!
//! - **touch**: moves down until the tool lags by the contact force, or is below the mouth of the hole.
//! - **search**: presses lightly and moves on a spiral around the nominal position (Chhatpar and Branicky 2001) until the
//!   tool sinks or, with a suction cup, the edge of the hole holds the peg back. The pitch of the spiral follows from clearance
//!   and chamfer. A lateral force at the tip bends the peg out of a cup, so the command never leads the tool by more than what
//!   half of the cup's moment allows, and the spiral is slower on a stiffer arm.
//! - **insert**: presses harder. The lateral command follows the measured position, so lateral forces fade. Without
//!   progress, the command moves on a small circle; after some time the peg is lifted and inserted again.
//! - **release**: opens the gripper and moves up.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector2, Vector3};
use robogate_core::{Action, Command, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec, Word};
use robogate_physics::trajectory::ToolLimit;
use robogate_physics::{Bellows, Chain, Gripper, GripperCommand, Robot, Unreachable};

use super::NAME;
use super::parts::{DEPTH_M, HEAD_HEIGHT_M, HEAD_M, SHAFT_M};
use super::spec::{Briefing, phases};
use crate::arm::{
    CONTROL_PERIOD_S, FINELY, FREE, FREELY, Planner, Posture, Script, Way, compliance, drives_task, tool_down,
};

/// Height of the peg's tip above the block before the search, in metres.
const ABOVE_M: f64 = 0.006;
/// Height of the tool above the table on transit paths, in metres.
const TRANSIT_HEIGHT_M: f64 = 0.24;
/// Limits of motion with the peg in the hand.
pub(super) const CARRY: ToolLimit = ToolLimit { speed: 0.4, acceleration: 1.0 };
/// Gap between a cup and the head in the grasp, in metres.
const CUP_ROOM_M: f64 = 0.002;
/// Speed of the way down to the block, in m/s.
const TOUCH_SPEED: f64 = 0.015;
/// Speed of the way into the hole, in m/s.
const INSERT_SPEED: f64 = 0.02;
/// Force that counts as contact, in newtons, and the smallest lag of the tool that is measured, in metres.
const CONTACT_N: f64 = 3.0;
const SMALLEST_LAG_M: f64 = 2e-4;
/// Forces of search and insertion, in newtons.
const SEARCH_N: f64 = 5.0;
pub(super) const INSERT_N: f64 = 14.0;
/// The controller uses this part of the moment that a cup holds.
pub(super) const MOMENT_SHARE: f64 = 0.5;
/// A step of the spiral is at most this part of the way after which the tool counts as held back.
const LEAD_SHARE: f64 = 0.5;
/// Pitch of the spiral as a fraction of the capture range.
const PITCH_SHARE: f64 = 0.8;
/// Speed on the spiral, in widths of the capture range per control period, and its bounds in m/s.
const SPIRAL_SHARE: f64 = 0.35;
const SPIRAL_SPEED: [f64; 2] = [0.002, 0.012];
/// Radius at which the spiral starts again, in metres.
const SPIRAL_RADIUS_M: f64 = 0.012;
/// The tool has found the hole when it sinks by this, in metres.
const SUNK_M: f64 = 7e-4;
/// Part of the lateral lag that the command gives up in each control period.
const YIELD_SHARE: f64 = 0.5;
/// Control periods without progress before the command circles, and before the peg is lifted.
const CIRCLE_TICKS: u32 = 6;
const LIFT_TICKS: u32 = 36;
/// Radius of the circle, in metres, and its rotation per control period, in radians.
const CIRCLE_M: f64 = 6e-4;
const CIRCLE_RAD: f64 = 0.6;
/// Height by which a stuck peg is lifted, in metres.
const LIFT_M: f64 = 0.003;
/// The peg is seated within this distance of the full depth, in metres.
const SEATED_M: f64 = 0.001;
/// Control periods that the controller waits for the gripper to open.
const OPEN_TICKS: u32 = 25;

/// The scripted controller.
pub(super) struct Scripted {
    robot: Robot,
    chain: Chain,
    script: Script,
    feel: Option<Feel>,
}

/// Motion by touch.
struct Feel {
    clearance_m: f64,
    chamfer_m: f64,
    stiffness: f64,
    /// Nominal position of the hole's mouth, and the height of the tool above the peg's tip, in metres.
    hole: Vector3<f64>,
    tool_m: f64,
    /// Orientation of the tool.
    down: UnitQuaternion<f64>,
    /// The spring of a suction cup.
    bellows: Option<Bellows>,
    /// Largest lateral force at the tip of the peg, in newtons.
    lateral_n: f64,
    /// Angle on the spiral, in radians.
    angle: f64,
    stage: Stage,
    /// The last two commanded tool positions, the older one first, and the last joint positions. `None` before the first
    /// command.
    commanded: Option<([Vector3<f64>; 2], Vec<f64>)>,
    /// Lag of the tool in free motion, upwards, in metres.
    free_lag_m: Option<f64>,
}

/// The stage of the motion by touch.
#[derive(Debug, Clone, Copy)]
enum Stage {
    Touch,
    /// Height of the tool in contact with the top of the block.
    Search {
        top: f64,
    },
    /// Lowest height of the tool so far, control periods since then, and the number of lifts.
    Insert {
        lowest: f64,
        idle: u32,
        lifts: u32,
    },
    /// Control periods of lifting that remain, and the number of lifts.
    Lift {
        ticks: u32,
        lifts: u32,
    },
    /// Control periods since the gripper opened.
    Release {
        ticks: u32,
    },
}

impl Stage {
    fn phase(self) -> Word {
        match self {
            Self::Touch => phases::TOUCH,
            Self::Search { .. } => phases::SEARCH,
            Self::Insert { .. } | Self::Lift { .. } => phases::INSERT,
            Self::Release { .. } => phases::RELEASE,
        }
    }
}

impl Scripted {
    /// The controller for a robot with these kinematics.
    pub(super) fn new(robot: Robot, chain: Chain) -> Self {
        let chain = chain.holding(&robot.settings.gripper, HEAD_M);
        let script = Script::new(chain.clone(), Vec::new());
        Self { robot, chain, script, feel: None }
    }

    /// The postures in which the arm grasps the peg and arrives over the hole. `None` if one is out of reach.
    pub(super) fn postures(&self, briefing: &Briefing) -> Option<[Posture; 2]> {
        let mut planner = Planner::new(&self.robot, &self.chain, CONTROL_PERIOD_S);
        self.pick(&mut planner, briefing).ok()?;
        Posture::of_plan(&self.chain, &planner.finish()).try_into().ok()
    }

    /// Largest lateral force at the tip of the peg, in newtons: a cup holds a moment up to its force times the radius of its lip
    /// ([`robogate_physics::suction`]). Fingers hold more than the search can apply.
    fn lateral_limit(&self) -> f64 {
        let cup = self.robot.settings.gripper.cup();
        cup.map_or(f64::INFINITY, |cup| {
            MOMENT_SHARE * cup.force_n() * 0.5 * cup.cup_diameter_m / tool_height(&self.robot.settings.gripper)
        })
    }

    /// Appends the motions that bring the peg over the hole. Returns the orientation of the tool there.
    fn pick(&self, planner: &mut Planner<'_>, briefing: &Briefing) -> Result<UnitQuaternion<f64>, Unreachable> {
        use GripperCommand::{Close, Open};
        let ([x, y, _], [hx, hy, hz]) = (briefing.peg.position, briefing.hole.position);
        let tool = tool_height(&self.robot.settings.gripper);
        // The peg is square, so the tool may be rotated by quarters.
        let (yaw, joints) = planner.over([x, y], TRANSIT_HEIGHT_M, planner.square_yaw([x, y]))?;
        planner.swing(phases::PICK, joints, Open);
        planner.straight(phases::PICK, &[tool_down([x, y, tool], yaw)], FREE, Open)?;
        planner.grip(phases::PICK, Close);
        let (turned, _) = planner.over([hx, hy], TRANSIT_HEIGHT_M, yaw)?;
        let goals = [
            tool_down([x, y, TRANSIT_HEIGHT_M], yaw),
            tool_down([hx, hy, TRANSIT_HEIGHT_M], turned),
            tool_down([hx, hy, hz + ABOVE_M + tool], turned),
        ];
        planner.straight(phases::PICK, &goals, CARRY, Close)?;
        Ok(goals[2].rotation)
    }
}

/// The way of a tool that moves in small steps. It does not feel its way, so it needs a peg and a hole at their places.
pub(super) fn way(robot: &Robot, instance: &TaskInstance) -> Result<Way, Fault> {
    let briefing = Briefing::of(instance)?;
    let gripper = &robot.settings.gripper;
    let ([x, y, _], [hx, hy, hz]) = (briefing.peg.position, briefing.hole.position);
    let tool = tool_height(gripper);
    let mut way = Way::for_square(gripper);
    way.go(phases::PICK, [x, y, TRANSIT_HEIGHT_M], &FREELY, false);
    way.go(phases::PICK, [x, y, tool], &FINELY, false);
    way.grip(phases::PICK, true);
    way.go(phases::PICK, [x, y, TRANSIT_HEIGHT_M], &FREELY, true);
    way.go(phases::PICK, [hx, hy, TRANSIT_HEIGHT_M], &FREELY, true);
    way.go(phases::TOUCH, [hx, hy, hz + ABOVE_M + tool], &FINELY, true);
    way.go(phases::INSERT, [hx, hy, hz - DEPTH_M + SEATED_M + tool], &FINELY, true);
    way.grip(phases::RELEASE, false);
    way.go(phases::RELEASE, [hx, hy, TRANSIT_HEIGHT_M], &FREELY, false);
    Ok(way)
}

/// Height of the tool above the peg's tip in the grasp, in metres.
pub(super) fn tool_height(gripper: &Gripper) -> f64 {
    match gripper {
        Gripper::ParallelJaw(_) => SHAFT_M + 0.5 * HEAD_HEIGHT_M,
        Gripper::Suction(_) => SHAFT_M + HEAD_HEIGHT_M + CUP_ROOM_M,
    }
}

/// The hole catches a peg within this range, in metres.
fn capture(clearance_m: f64, chamfer_m: f64) -> f64 {
    clearance_m + 2.0 * chamfer_m
}

/// Speed on the spiral for a peg that the hole catches within this range (m), in m/s.
fn spiral_speed(capture_m: f64) -> f64 {
    (SPIRAL_SHARE * capture_m / CONTROL_PERIOD_S).clamp(SPIRAL_SPEED[0], SPIRAL_SPEED[1])
}

/// Time until the spiral has found a hole at this distance (m), in seconds: the length of a spiral with the pitch p to the radius r is
/// nearly pi r^2 / p.
pub(super) fn search_time(clearance_m: f64, chamfer_m: f64, distance_m: f64) -> f64 {
    let capture = capture(clearance_m, chamfer_m);
    let radius = (distance_m - 0.5 * capture).max(0.0);
    std::f64::consts::PI * radius * radius / (PITCH_SHARE * capture) / spiral_speed(capture)
}

impl Feel {
    /// The compliance of the arm at the tool along the axes of the base frame, in m/N. The coupling of the axes counts for a cup
    /// only: between fingers the head turns, and the tip does not follow it.
    fn compliance(&self, robot: &Robot, chain: &Chain, joints: &[f64]) -> Matrix3<f64> {
        let compliance = compliance(robot, chain, joints, self.stiffness);
        if self.lateral_n.is_finite() { compliance } else { Matrix3::from_diagonal(&compliance.diagonal()) }
    }

    /// The position (x, y) on the spiral around the hole, for a peg that the hole catches within this range, in metres.
    fn on_spiral(&self, capture_m: f64) -> [f64; 2] {
        let radius = PITCH_SHARE * capture_m * self.angle / TAU;
        let (sin, cos) = self.angle.sin_cos();
        [self.hole.x + radius * cos, self.hole.y + radius * sin]
    }

    /// The next tool position, from the last two commanded ones and the measured one. `compliance` is in m/N.
    fn next(
        &mut self,
        [before, mut at]: [Vector3<f64>; 2],
        measured: &Vector3<f64>,
        compliance: &Matrix3<f64>,
    ) -> Vector3<f64> {
        let per_newton = compliance[(2, 2)];
        // A vertical force also moves the tool aside, because the axes of a bent arm are coupled. Without a lateral force, the
        // command is at this distance from the tool.
        let pressed = match self.stage {
            Stage::Search { .. } => SEARCH_N,
            Stage::Insert { .. } => INSERT_N,
            Stage::Touch | Stage::Lift { .. } | Stage::Release { .. } => 0.0,
        };
        let neutral = measured.xy() - pressed * Vector2::new(compliance[(0, 2)], compliance[(1, 2)]);
        // The command leads the tool by at most this much across the peg.
        let lead = self.lateral_n * compliance.diagonal().xy();
        let aside = neutral - 0.5 * (before + at).xy();
        // The servo lags the commands by half a control period.
        let held_up = measured.z - 0.5 * (before.z + at.z);
        let lag = held_up - self.free_lag_m.unwrap_or(0.0);
        // The true height of the lip or the pads. Without a free lag, nothing has been touched.
        let touched = self.free_lag_m.and(self.bellows);
        let height = measured.z + touched.map_or(0.0, |bellows| bellows.travel_m(lag / per_newton));
        let tip = height - self.tool_m;
        let capture = capture(self.clearance_m, self.chamfer_m);
        let step = |speed: f64| speed * CONTROL_PERIOD_S;
        // Presses with a force, but moves no faster than `speed`.
        let press = |at: &mut Vector3<f64>, force: f64, speed: f64| {
            let goal = measured.z - force * per_newton;
            at.z = goal.max(at.z - step(speed)).min(at.z.max(goal));
        };
        match self.stage {
            Stage::Touch => {
                let mouth = self.hole.z;
                if self.free_lag_m.is_some() && lag > (CONTACT_N * per_newton).max(SMALLEST_LAG_M) {
                    self.stage = Stage::Search { top: height };
                } else if tip < mouth - 2.0 * SUNK_M - self.chamfer_m - 0.003 {
                    self.stage = Stage::Insert { lowest: height, idle: 0, lifts: 0 };
                } else {
                    self.free_lag_m.get_or_insert(held_up);
                    at.z -= step(TOUCH_SPEED);
                    if self.angle > 0.0 {
                        let [x, y] = self.on_spiral(capture);
                        at.x += YIELD_SHARE * (x - at.x);
                        at.y += YIELD_SHARE * (y - at.y);
                    }
                }
            }
            Stage::Search { top } => {
                press(&mut at, SEARCH_N, TOUCH_SPEED);
                let pitch = PITCH_SHARE * capture;
                // Before a tool that is held back is noticed, the force grows by that of one step.
                let speed = spiral_speed(capture).min(LEAD_SHARE * lead.min() / CONTROL_PERIOD_S);
                let held_back = aside.x.abs() > lead.x || aside.y.abs() > lead.y;
                let radius = pitch * self.angle / TAU;
                let turned = self.angle + step(speed) / radius.max(0.5 * pitch);
                let next = pitch * turned / TAU;
                self.angle = if next > SPIRAL_RADIUS_M { 0.0 } else { turned };
                [at.x, at.y] = self.on_spiral(capture);
                if height < top - SUNK_M || held_back {
                    self.stage = Stage::Insert { lowest: height, idle: 0, lifts: 0 };
                }
            }
            Stage::Insert { lowest, idle, lifts } => {
                press(&mut at, INSERT_N, INSERT_SPEED);
                at.x += YIELD_SHARE * (neutral.x - at.x);
                at.y += YIELD_SHARE * (neutral.y - at.y);
                let progress = height < lowest - 1e-4;
                let idle = if progress { 0 } else { idle + 1 };
                if idle >= CIRCLE_TICKS {
                    let (sin, cos) = (CIRCLE_RAD * f64::from(idle)).sin_cos();
                    (at.x, at.y) = (at.x + CIRCLE_M * cos, at.y + CIRCLE_M * sin);
                }
                self.stage = if tip <= self.hole.z - DEPTH_M + SEATED_M && idle >= 2 {
                    Stage::Release { ticks: 0 }
                } else if idle >= LIFT_TICKS {
                    Stage::Lift { ticks: 8, lifts: lifts + 1 }
                } else {
                    Stage::Insert { lowest: lowest.min(height), idle, lifts }
                };
            }
            Stage::Lift { ticks, lifts } => {
                at.z = at.z.max(height) + LIFT_M / 8.0;
                at.x += YIELD_SHARE * (measured.x - at.x);
                at.y += YIELD_SHARE * (measured.y - at.y);
                self.stage = match ticks {
                    // A peg that is not in the hole continues its search.
                    0 if tip > self.hole.z => Stage::Touch,
                    0 => Stage::Insert { lowest: height, idle: 0, lifts },
                    _ => Stage::Lift { ticks: ticks - 1, lifts },
                };
            }
            Stage::Release { ticks } => {
                if ticks >= OPEN_TICKS && at.z < self.hole.z + self.tool_m + 0.05 {
                    at.z += step(4.0 * INSERT_SPEED);
                }
                self.stage = Stage::Release { ticks: ticks + 1 };
            }
        }
        if !matches!(self.stage, Stage::Release { .. }) {
            for axis in [0, 1] {
                at[axis] = at[axis].max(neutral[axis] - lead[axis]).min(neutral[axis] + lead[axis]);
            }
        }
        at
    }
}

impl Policy for Scripted {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        drives_task(NAME, &self.robot, task)
    }

    fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let briefing = Briefing::of(instance)?;
        let mut planner = Planner::new(&self.robot, &self.chain, CONTROL_PERIOD_S);
        let [x, y, z] = briefing.hole.position;
        // If a pose is out of reach, the controller runs the reachable part of its plan and then waits. This is a failure
        // of the controller (a timeout), not a fault of the simulator.
        let down = self.pick(&mut planner, &briefing);
        if down.is_err() {
            planner.swing(phases::PICK, self.robot.settings.arm.home_rad.clone(), GripperCommand::Open);
        }
        self.feel = down.ok().map(|down| Feel {
            clearance_m: briefing.clearance_m,
            chamfer_m: briefing.chamfer_m,
            stiffness: briefing.arm_stiffness,
            hole: Vector3::new(x, y, z),
            tool_m: tool_height(&self.robot.settings.gripper),
            down,
            bellows: self.robot.settings.gripper.cup().and_then(|cup| cup.bellows),
            lateral_n: self.lateral_limit(),
            angle: 0.0,
            stage: Stage::Touch,
            commanded: None,
            free_lag_m: None,
        });
        self.script = Script::new(self.chain.clone(), planner.finish());
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let measured = observation.joint_positions();
        let Some(feel) = self.feel.as_mut().filter(|feel| feel.commanded.is_some() || self.script.is_done(measured))
        else {
            return Ok(self.script.act(observation));
        };
        let home = &self.robot.settings.arm.home_rad;
        let (last, joints) = feel
            .commanded
            .take()
            .or_else(|| {
                let joints = self.script.end()?.to_vec();
                Some(([self.chain.tcp_at(&joints).translation.vector; 2], joints))
            })
            .unwrap_or_else(|| ([self.chain.tcp_at(measured).translation.vector; 2], measured.to_vec()));
        let tool = self.chain.tcp_at(measured).translation.vector;
        let compliance = feel.compliance(&self.robot, &self.chain, measured);
        let at = feel.next(last, &tool, &compliance);
        let goal = Isometry3::from_parts(Translation3::from(at), feel.down);
        let joints = self.chain.inverse(&goal, &joints, home).unwrap_or(joints);
        let gripper =
            if matches!(feel.stage, Stage::Release { .. }) { GripperCommand::Open } else { GripperCommand::Close };
        feel.commanded = Some(([last[1], at], joints.clone()));
        Ok(Action {
            command: Command::JointPosition(joints),
            gripper: Some(gripper.number()),
            phase: Some(feel.stage.phase()),
        })
    }
}
