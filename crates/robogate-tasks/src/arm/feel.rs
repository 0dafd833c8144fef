//! Motion by touch: brings a part in the hand into a hole.
//!
//! There is no force sensor. The servos are springs: the distance by which the tool lags its command is a force, by the
//! compliance of the arm at the tool (J diag(1/k) J^T; Whitney 1982). With the told stiffness the arm presses with
//! a chosen force by commanding the tool that far beyond its measured position. A suction cup on a spring gives way under that
//! force: the part is higher than the relaxed cup would be by force over stiffness.
//!
//! - **touch**: moves down until the tool lags by the contact force, or is below the mouth of the hole.
//! - **search**: presses lightly and moves on a spiral around the nominal position (Chhatpar and Branicky 2001) until the
//!   tool sinks or, with a suction cup, the edge of the hole holds the part back. The pitch of the spiral follows from clearance
//!   and chamfer. A lateral force at the tip bends the part out of a cup, so the command never leads the tool by more than what
//!   half of the cup's moment allows, and the spiral is slower on a stiffer arm.
//! - **insert**: presses harder. The lateral command follows the measured position, so lateral forces fade. Without
//!   progress, the command moves on a small circle; after some time the part is lifted and inserted again.
//! - **release**: opens the gripper and moves up.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector2, Vector3};
use robogate_physics::{Bellows, Chain, Gripper, Robot};

use super::CONTROL_PERIOD_S;
use super::foresight::compliance;

/// Speed of the way down to the block, in m/s.
const TOUCH_SPEED: f64 = 0.015;
/// Speed of the way into the hole, in m/s.
const INSERT_SPEED: f64 = 0.02;
/// Force that counts as contact, in newtons, and the smallest lag of the tool that is measured, in metres.
const CONTACT_N: f64 = 3.0;
const SMALLEST_LAG_M: f64 = 2e-4;
/// A cup presses sideways with this part of the moment that it holds.
pub(crate) const MOMENT_SHARE: f64 = 0.5;
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
pub(super) const YIELD_SHARE: f64 = 0.5;
/// Control periods without progress before the command circles, and before the part is lifted.
const CIRCLE_TICKS: u32 = 6;
const LIFT_TICKS: u32 = 36;
/// Radius of the circle, in metres, and its rotation per control period, in radians.
const CIRCLE_M: f64 = 6e-4;
const CIRCLE_RAD: f64 = 0.6;
/// Height by which a stuck part is lifted, in metres.
const LIFT_M: f64 = 0.003;
/// The part is seated within this distance of the full depth, in metres.
pub(crate) const SEATED_M: f64 = 0.001;
/// Control periods that the controller waits for the gripper to open.
const OPEN_TICKS: u32 = 25;

/// A part that is brought into a hole.
#[derive(Debug, Clone)]
pub(crate) struct Fit {
    /// The hole catches the part within clearance and twice the chamfer, in metres.
    pub(crate) clearance_m: f64,
    pub(crate) chamfer_m: f64,
    /// Nominal position of the hole's mouth, its depth, and the height of the tool above the part's tip, in metres.
    pub(crate) hole: Vector3<f64>,
    pub(crate) depth_m: f64,
    pub(crate) tool_m: f64,
    /// Orientation of the tool.
    pub(crate) down: UnitQuaternion<f64>,
    /// Forces of search and insertion, in newtons.
    pub(crate) search_n: f64,
    pub(crate) insert_n: f64,
    /// Stiffness of the servos as a multiple of the robot's own.
    pub(crate) stiffness: f64,
    /// Whether a vertical force moves the tip aside, as far as the axes of the arm are coupled. It always does with a cup.
    pub(crate) coupled: bool,
    /// Whether a tool that is deeper than the hole is done: the part slips in the hand.
    pub(crate) slips: bool,
}

/// Motion by touch.
#[derive(Debug, Clone)]
pub(crate) struct Feel {
    robot: Robot,
    fit: Fit,
    /// The spring of a suction cup.
    bellows: Option<Bellows>,
    /// Largest lateral force at the tip of the part, in newtons.
    lateral_n: f64,
    /// Angle on the spiral, in radians.
    angle: f64,
    stage: Feeling,
    /// The last two commanded tool positions, the older one first, and the last joint positions. `None` before the first
    /// command.
    commanded: Option<([Vector3<f64>; 2], Vec<f64>)>,
    /// Lag of the tool in free motion, upwards, in metres.
    free_lag_m: Option<f64>,
}

/// The stage of the motion by touch.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Feeling {
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

/// The hole catches a part within this range, in metres.
fn capture(clearance_m: f64, chamfer_m: f64) -> f64 {
    clearance_m + 2.0 * chamfer_m
}

/// Speed on the spiral for a part that the hole catches within this range (m), in m/s.
fn spiral_speed(capture_m: f64) -> f64 {
    (SPIRAL_SHARE * capture_m / CONTROL_PERIOD_S).clamp(SPIRAL_SPEED[0], SPIRAL_SPEED[1])
}

/// Time until the spiral has found a hole at this distance (m), in seconds: the length of a spiral with the pitch p to the radius r is
/// nearly pi r^2 / p.
pub(crate) fn search_time(clearance_m: f64, chamfer_m: f64, distance_m: f64) -> f64 {
    let capture = capture(clearance_m, chamfer_m);
    let radius = (distance_m - 0.5 * capture).max(0.0);
    std::f64::consts::PI * radius * radius / (PITCH_SHARE * capture) / spiral_speed(capture)
}

/// Largest lateral force in newtons at the tip of a part that is `tool_m` metres below the tool: a cup holds a moment up to its force times
/// the radius of its lip ([`robogate_physics::suction`]). Fingers hold more than the search can apply.
fn lateral_limit(gripper: &Gripper, tool_m: f64) -> f64 {
    gripper.cup().map_or(f64::INFINITY, |cup| MOMENT_SHARE * cup.force_n() * 0.5 * cup.cup_diameter_m / tool_m)
}

impl Feel {
    /// The motion of a robot that holds the part above the hole.
    pub(crate) fn new(robot: &Robot, fit: Fit) -> Self {
        let gripper = &robot.settings.gripper;
        Self {
            bellows: gripper.cup().and_then(|cup| cup.bellows),
            lateral_n: lateral_limit(gripper, fit.tool_m),
            robot: robot.clone(),
            fit,
            angle: 0.0,
            stage: Feeling::Touch,
            commanded: None,
            free_lag_m: None,
        }
    }

    pub(crate) fn stage(&self) -> Feeling {
        self.stage
    }

    /// Whether it has commanded a motion.
    pub(crate) fn has_begun(&self) -> bool {
        self.commanded.is_some()
    }

    /// Whether the part is in the hole.
    pub(crate) fn is_done(&self) -> bool {
        matches!(self.stage, Feeling::Release { .. })
    }

    /// The last commanded position of the tool.
    pub(crate) fn at(&self) -> Option<Vector3<f64>> {
        self.commanded.as_ref().map(|([_, last], _)| *last)
    }

    /// The next joint positions (rad). `start` are those that were commanded before the first ones.
    pub(crate) fn joints(&mut self, chain: &Chain, measured: &[f64], start: &[f64]) -> Vec<f64> {
        let at_start = || ([chain.tcp_at(start).translation.vector; 2], start.to_vec());
        let (last, joints) = self.commanded.take().unwrap_or_else(at_start);
        let tool = chain.tcp_at(measured).translation.vector;
        let compliance = self.compliance(chain, measured);
        let at = self.next(last, &tool, &compliance);
        let goal = Isometry3::from_parts(Translation3::from(at), self.fit.down);
        let joints = chain.inverse(&goal, &joints, &self.robot.settings.arm.home_rad).unwrap_or(joints);
        self.commanded = Some(([last[1], at], joints.clone()));
        joints
    }

    /// How far a vertical force moves the tool along the axes of the base frame, as multiples of its vertical motion.
    pub(super) fn aside(&self, chain: &Chain, joints: &[f64]) -> Vector3<f64> {
        let vertical = compliance(&self.robot, chain, joints, self.fit.stiffness).column(2).into_owned();
        vertical / vertical.z
    }

    /// The compliance of the arm at the tool along the axes of the base frame, in m/N. Between fingers the head of a part may turn, and the tip
    /// does not follow the coupling of the axes.
    fn compliance(&self, chain: &Chain, joints: &[f64]) -> Matrix3<f64> {
        let compliance = compliance(&self.robot, chain, joints, self.fit.stiffness);
        let coupled = self.fit.coupled || self.lateral_n.is_finite();
        if coupled { compliance } else { Matrix3::from_diagonal(&compliance.diagonal()) }
    }

    /// The position (x, y) on the spiral around the hole, for a part that the hole catches within this range, in metres.
    fn on_spiral(&self, capture_m: f64) -> [f64; 2] {
        let radius = PITCH_SHARE * capture_m * self.angle / TAU;
        let (sin, cos) = self.angle.sin_cos();
        [self.fit.hole.x + radius * cos, self.fit.hole.y + radius * sin]
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
            Feeling::Search { .. } => self.fit.search_n,
            Feeling::Insert { .. } => self.fit.insert_n,
            Feeling::Touch | Feeling::Lift { .. } | Feeling::Release { .. } => 0.0,
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
        let tip = height - self.fit.tool_m;
        let capture = capture(self.fit.clearance_m, self.fit.chamfer_m);
        let step = |speed: f64| speed * CONTROL_PERIOD_S;
        // Presses with a force, but moves no faster than `speed`.
        let press = |at: &mut Vector3<f64>, force: f64, speed: f64| {
            let goal = measured.z - force * per_newton;
            at.z = goal.max(at.z - step(speed)).min(at.z.max(goal));
        };
        match self.stage {
            Feeling::Touch => {
                let mouth = self.fit.hole.z;
                if self.free_lag_m.is_some() && lag > (CONTACT_N * per_newton).max(SMALLEST_LAG_M) {
                    self.stage = Feeling::Search { top: height };
                } else if tip < mouth - 2.0 * SUNK_M - self.fit.chamfer_m - 0.003 {
                    self.stage = Feeling::Insert { lowest: height, idle: 0, lifts: 0 };
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
            Feeling::Search { top } => {
                press(&mut at, self.fit.search_n, TOUCH_SPEED);
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
                    self.stage = Feeling::Insert { lowest: height, idle: 0, lifts: 0 };
                }
            }
            Feeling::Insert { lowest, idle, lifts } => {
                press(&mut at, self.fit.insert_n, INSERT_SPEED);
                at.x += YIELD_SHARE * (neutral.x - at.x);
                at.y += YIELD_SHARE * (neutral.y - at.y);
                let progress = height < lowest - 1e-4;
                let idle = if progress { 0 } else { idle + 1 };
                if idle >= CIRCLE_TICKS {
                    let (sin, cos) = (CIRCLE_RAD * f64::from(idle)).sin_cos();
                    (at.x, at.y) = (at.x + CIRCLE_M * cos, at.y + CIRCLE_M * sin);
                }
                let over = tip - (self.fit.hole.z - self.fit.depth_m);
                let slips = self.fit.slips && over <= -SEATED_M;
                self.stage = if over <= SEATED_M && idle >= 2 || slips {
                    Feeling::Release { ticks: 0 }
                } else if idle >= LIFT_TICKS {
                    Feeling::Lift { ticks: 8, lifts: lifts + 1 }
                } else {
                    Feeling::Insert { lowest: lowest.min(height), idle, lifts }
                };
            }
            Feeling::Lift { ticks, lifts } => {
                at.z = at.z.max(height) + LIFT_M / 8.0;
                at.x += YIELD_SHARE * (measured.x - at.x);
                at.y += YIELD_SHARE * (measured.y - at.y);
                self.stage = match ticks {
                    // A peg that is not in the hole continues its search.
                    0 if tip > self.fit.hole.z => Feeling::Touch,
                    0 => Feeling::Insert { lowest: height, idle: 0, lifts },
                    _ => Feeling::Lift { ticks: ticks - 1, lifts },
                };
            }
            Feeling::Release { ticks } => {
                if ticks >= OPEN_TICKS && at.z < self.fit.hole.z + self.fit.tool_m + 0.05 {
                    at.z += step(4.0 * INSERT_SPEED);
                }
                self.stage = Feeling::Release { ticks: ticks + 1 };
            }
        }
        if !matches!(self.stage, Feeling::Release { .. }) {
            for axis in [0, 1] {
                at[axis] = at[axis].max(neutral[axis] - lead[axis]).min(neutral[axis] + lead[axis]);
            }
        }
        at
    }
}
