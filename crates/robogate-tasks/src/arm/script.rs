//! Scripted motion of an arm: stages of planned joint paths with gripper commands.
//!
//! A stage ends when its path has been commanded, the measured tool pose is within 5 mm and 0.05 rad of the end, and the
//! gripper is at rest if it moves in this stage. A tool that is pushed more than 10 mm off its path stops there and
//! waits, like a robot with a contact guard.
//!
//! A stage by touch ([`Feel`]) ends when the part is in the hole. Where that is may differ from the plan: stages that are relative to it
//! begin where it ended.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Action, Command, Observation, Word};
use robogate_physics::trajectory::{ToolLimit, curved_path, joint_path, straight_path, timed_path};
use robogate_physics::{Chain, Gripper, GripperCommand, Robot, Unreachable};

use super::feel::{Feel, Fit, YIELD_SHARE};

/// A stage ends within this distance of its goal, in metres ...
const POSITION_TOLERANCE_M: f64 = 0.005;
/// ... and this angle, in radians.
const ANGLE_TOLERANCE_RAD: f64 = 0.05;
/// The tool stops if it is off its path by more than this, in metres.
const GUARD_M: f64 = 0.01;
/// The gripper is at rest if its opening changed by less than this in a control period, in metres ...
const GRIPPER_SETTLED_M: f64 = 1e-4;
/// ... for this many control periods: it needs time to start and to build up its force.
const SETTLE_TICKS: usize = 4;
/// A gripper has carried out a command within this many control periods.
const GRIP_TICKS: usize = 20;
/// The last stage has run out this many control periods after its end.
const IDLE_TICKS: usize = 10;
/// In each control period a tool that leaves the place it found keeps this part of its distance from the path ...
const FADE: f64 = 0.8;
/// ... until it is below this, in metres.
const FADED_M: f64 = 1e-5;
/// A tool that holds an inserted part gives way by at most this, in metres.
const MOST_GIVEN_M: f64 = 0.005;
/// Gap between fingertips and table in the grasp, in metres.
const TIP_ROOM_M: f64 = 0.004;
/// Gap between palm and part in the grasp, in metres.
const PALM_ROOM_M: f64 = 0.002;
/// Gap between a cup and the top of the part, in metres. It is well below the grip threshold.
const CUP_ROOM_M: f64 = 0.002;
/// Limits of motion without a part.
pub(crate) const FREE: ToolLimit = ToolLimit { speed: 0.5, acceleration: 2.0 };

/// One stage of a plan.
#[derive(Debug, Clone)]
pub(crate) struct Stage {
    /// The phase that the stage belongs to.
    pub(crate) phase: Word,
    /// Joint positions for every control period, in radians. The last one is kept until the stage ends.
    pub(crate) path: Vec<Vec<f64>>,
    /// The gripper command.
    pub(crate) gripper: GripperCommand,
    /// Whether the gripper must be at rest for the stage to end.
    pub(crate) settles: bool,
    /// The control period of the episode in which it begins, if it keeps time with something that moves. Its path then
    /// follows the clock, and a stage of this kind that follows another one begins on time.
    pub(crate) clock: Option<usize>,
    /// Motion by touch, in place of the path. The path is the one without contact.
    pub(crate) feel: Option<Box<Feel>>,
    /// Whether it is relative to where the last stage by touch ended.
    pub(crate) relative: bool,
}

impl Stage {
    /// A stage that follows a path.
    pub(crate) fn of(phase: Word, path: Vec<Vec<f64>>, gripper: GripperCommand) -> Self {
        Self { phase, path, gripper, settles: false, clock: None, feel: None, relative: false }
    }
}

/// Where a stage by touch ended.
#[derive(Debug, Clone, Copy)]
struct Found {
    /// From the planned to the commanded position of the tool, in metres.
    shift: Vector3<f64>,
    /// From the commanded to the measured one, in metres: the tool presses.
    lag: Vector3<f64>,
    /// How far a vertical force moves the tool along x, y and z, as multiples of z.
    aside: Vector3<f64>,
    /// How far the tool has given way to lateral forces since then, in metres.
    given: Vector3<f64>,
}

/// A plan and the progress in it.
#[derive(Debug, Clone)]
pub(crate) struct Script {
    chain: Chain,
    stages: Vec<Stage>,
    current: usize,
    tick: usize,
    last_opening: Option<f64>,
    /// The last two commands, the older one first.
    commanded: Option<[Vec<f64>; 2]>,
    /// Joint positions at which the guard stopped the arm.
    stopped: Option<Vec<f64>>,
    /// Number of control periods for which the gripper has been at rest.
    rest: usize,
    /// Number of actions so far.
    now: usize,
    found: Option<Found>,
}

impl Script {
    /// A script of these stages, for an arm with these kinematics. Without a stage it commands nothing but the measured
    /// joint positions.
    pub(crate) fn new(chain: Chain, stages: Vec<Stage>) -> Self {
        Self {
            chain,
            stages,
            current: 0,
            tick: 0,
            last_opening: None,
            commanded: None,
            stopped: None,
            rest: 0,
            now: 0,
            found: None,
        }
    }

    /// The next action.
    pub(crate) fn act(&mut self, observation: &Observation) -> Action {
        let opening = observation.gripper_opening_m();
        let measured = observation.joint_positions();
        let moved = match (self.last_opening, opening) {
            (Some(before), Some(now)) => (before - now).abs(),
            _ => 0.0,
        };
        self.rest = if moved < GRIPPER_SETTLED_M { self.rest + 1 } else { 0 };
        self.last_opening = opening;
        if self.pushed_off(measured) {
            self.stopped.get_or_insert_with(|| measured.to_vec());
        }
        if self.stopped.is_none() && self.stage_is_done(measured) {
            self.find(measured);
            (self.current, self.tick) = (self.current + 1, 0);
        }
        self.give_way(measured);
        let joints = self.stopped.clone().or_else(|| self.felt(measured)).or_else(|| self.planned());
        let joints = joints.unwrap_or_else(|| measured.to_vec());
        let stage = self.stages.get(self.current);
        self.tick += 1;
        self.now += 1;
        let last = self.commanded.take().map_or_else(|| measured.to_vec(), |[_, last]| last);
        self.commanded = Some([last, joints.clone()]);
        Action {
            command: Command::JointPosition(joints),
            gripper: Some(stage.map_or(GripperCommand::Open, |stage| stage.gripper).number()),
            phase: stage.map(|stage| stage.phase),
        }
    }

    /// The next joint positions of the path.
    fn planned(&mut self) -> Option<Vec<f64>> {
        let stage = self.stages.get(self.current)?;
        let tick = stage.clock.map_or(self.tick, |clock| self.now.saturating_sub(clock));
        let planned = stage.path.get(tick.min(stage.path.len().saturating_sub(1)))?.clone();
        if let Some(found) = self.found.as_mut().filter(|_| !stage.relative) {
            // The tool goes over to the path in a few control periods.
            found.shift *= FADE;
            if found.shift.norm() < FADED_M {
                self.found = None;
            }
        }
        let Some(Found { shift, .. }) = self.found else { return Some(planned) };
        let mut goal = self.chain.tcp_at(&planned);
        goal.translation.vector += shift;
        Some(self.chain.inverse(&goal, &planned, &planned).unwrap_or(planned))
    }

    /// The next joint positions of a stage by touch.
    fn felt(&mut self, measured: &[f64]) -> Option<Vec<f64>> {
        let feel = self.stages.get_mut(self.current)?.feel.as_mut()?;
        let start = self.commanded.as_ref().map_or(measured, |[_, last]| last);
        Some(feel.joints(&self.chain, measured, start))
    }

    /// A tool that holds an inserted part gives way to lateral forces: where the part turns, its axis is not that of the tool.
    fn give_way(&mut self, measured: &[f64]) {
        let stage = self.stages.get(self.current).filter(|stage| stage.relative);
        let holds = stage.is_some_and(|stage| stage.gripper == GripperCommand::Close && !stage.settles);
        if let (true, Some(found), Some([_, last])) = (holds, &mut self.found, &self.commanded) {
            let tool = |joints: &[f64]| self.chain.tcp_at(joints).translation.vector;
            let off = tool(measured) - tool(last);
            let aside = YIELD_SHARE * (off - found.aside * off.z);
            let given = (found.given + Vector3::new(aside.x, aside.y, 0.0)).cap_magnitude(MOST_GIVEN_M);
            found.shift += given - found.given;
            found.given = given;
        }
    }

    /// Keeps where a stage by touch ended.
    fn find(&mut self, measured: &[f64]) {
        let Some(stage) = self.stages.get(self.current) else { return };
        let Some(feel) = &stage.feel else { return };
        if let (Some(at), Some(end)) = (feel.at(), stage.path.last()) {
            let tool = |joints: &[f64]| self.chain.tcp_at(joints).translation.vector;
            self.found = Some(Found {
                shift: at - tool(end),
                lag: tool(measured) - at,
                aside: feel.aside(&self.chain, measured),
                given: Vector3::zeros(),
            });
        }
    }

    /// Distance of the measured tool (m) from where it should be. A tool that presses lags.
    fn distance(&self, off: Vector3<f64>) -> f64 {
        self.found.map_or(off.norm(), |found| off.norm().min((off - found.lag).norm()))
    }

    /// Whether the last stage has ended and the arm has settled there.
    pub(crate) fn is_done(&self, measured: &[f64]) -> bool {
        let Some(stage) = self.stages.last().filter(|_| self.current + 1 == self.stages.len()) else { return false };
        let Some(end) = stage.path.last().filter(|_| self.stopped.is_none()) else { return false };
        let off = self.chain.tcp_at(end).translation.vector - self.chain.tcp_at(measured).translation.vector;
        self.tick >= stage.path.len() + SETTLE_TICKS && off.norm() <= POSITION_TOLERANCE_M
    }

    /// Whether nothing but waiting follows: the guard has stopped the arm, which keeps its position and its phase, or the
    /// last stage has run out.
    pub(crate) fn gave_up(&self) -> bool {
        let ran_out = |stage: &Stage| self.tick >= stage.path.len() + IDLE_TICKS;
        self.stopped.is_some()
            || self.stages.get(self.current..).is_some_and(|rest| matches!(rest, [last] if ran_out(last)))
    }

    /// Joint positions at the end of the script, in radians.
    pub(crate) fn end(&self) -> Option<&[f64]> {
        self.stages.last()?.path.last().map(Vec::as_slice)
    }

    /// Whether the current stage has ended and another one follows.
    fn stage_is_done(&self, measured: &[f64]) -> bool {
        let Some(stage) = self.stages.get(self.current) else { return false };
        let Some(next) = self.stages.get(self.current + 1) else { return false };
        if let Some(clock) = next.clock
            && (self.now < clock || stage.clock.is_some())
        {
            return self.now >= clock;
        }
        let Some(end) = stage.path.last().filter(|_| stage.clock.is_none_or(|clock| self.now >= clock)) else {
            return false;
        };
        if let Some(feel) = &stage.feel {
            return feel.is_done();
        }
        let (end, tool) = (self.chain.tcp_at(end), self.chain.tcp_at(measured));
        let shift = self.found.map_or_else(Vector3::zeros, |found| found.shift);
        let off = self.distance(tool.translation.vector - end.translation.vector - shift);
        let there = off <= POSITION_TOLERANCE_M && end.rotation.angle_to(&tool.rotation) <= ANGLE_TOLERANCE_RAD;
        self.tick >= stage.path.len() && there && (!stage.settles || self.rest.min(self.tick) >= SETTLE_TICKS)
    }

    /// Whether the tool is off its commanded path. The servo lags the commands by half a control period, so the tool
    /// should be halfway between the last two.
    fn pushed_off(&self, measured: &[f64]) -> bool {
        let Some([before, last]) = &self.commanded else { return false };
        // A tool that feels its way is held back by what it touches.
        if self.stages.get(self.current).is_some_and(|stage| stage.feel.is_some()) {
            return false;
        }
        let middle: Vec<f64> = before.iter().zip(last).map(|(a, b)| 0.5 * (a + b)).collect();
        let off = self.chain.tcp_at(measured).translation.vector - self.chain.tcp_at(&middle).translation.vector;
        self.distance(off) > GUARD_M
    }
}

/// Plans stages one after another, each from the end of the one before.
pub(crate) struct Planner<'a> {
    robot: &'a Robot,
    chain: &'a Chain,
    control_period_s: f64,
    /// Joint positions at the end of the plan so far.
    at: Vec<f64>,
    stages: Vec<Stage>,
    /// Whether the next stages are relative to where the last stage by touch ended.
    relative: bool,
}

impl<'a> Planner<'a> {
    /// An empty plan that starts at the arm's home position.
    pub(crate) fn new(robot: &'a Robot, chain: &'a Chain, control_period_s: f64) -> Self {
        let at = robot.settings.arm.home_rad.clone();
        Self { robot, chain, control_period_s, at, stages: Vec::new(), relative: false }
    }

    fn push(&mut self, stage: Stage) {
        self.stages.push(Stage { relative: self.relative, ..stage });
    }

    /// Lets the next stages begin where the last stage by touch ended, or not.
    pub(crate) fn relative(&mut self, relative: bool) {
        self.relative = relative && self.stages.iter().any(|stage| stage.feel.is_some());
    }

    /// Appends a straight motion by touch.
    ///
    /// # Errors
    /// If its end is out of reach. The plan so far is kept.
    pub(crate) fn feel(
        &mut self,
        phase: Word,
        goal: Isometry3<f64>,
        limit: ToolLimit,
        gripper: GripperCommand,
        fit: Fit,
    ) -> Result<(), Unreachable> {
        self.straight(phase, &[goal], limit, gripper)?;
        let feel = Box::new(Feel::new(self.robot, fit));
        if let Some(last) = self.stages.last_mut() {
            last.feel = Some(feel);
        }
        Ok(())
    }

    /// The control period in which the plan so far ends at the latest, if nothing delays it.
    pub(crate) fn ticks(&self) -> usize {
        self.stages.iter().fold(0, |before, stage| match stage.clock {
            Some(clock) => clock + stage.path.len(),
            None => before + stage.path.len() + if stage.settles { GRIP_TICKS } else { SETTLE_TICKS },
        })
    }

    /// Appends a motion that begins in the control period `clock`: the tool is at `poses(k)` after its k-th period.
    ///
    /// # Errors
    /// If a pose is out of reach, or a joint would be too fast. The plan so far is kept.
    pub(crate) fn timed(
        &mut self,
        phase: Word,
        clock: usize,
        (ticks, poses): (usize, &dyn Fn(usize) -> Isometry3<f64>),
        gripper: GripperCommand,
    ) -> Result<(), Unreachable> {
        let path = timed_path(self.chain, &self.at, ticks, poses, &self.robot.settings.arm, self.control_period_s)?;
        self.at = path.last().cloned().unwrap_or_else(|| self.at.clone());
        self.push(Stage { clock: Some(clock), ..Stage::of(phase, path, gripper) });
        Ok(())
    }

    /// Appends a stage that waits for the control period `clock`.
    pub(crate) fn wait_for(&mut self, phase: Word, clock: usize, gripper: GripperCommand) {
        let path = vec![self.at.clone()];
        self.push(Stage { clock: Some(clock), ..Stage::of(phase, path, gripper) });
    }

    /// The number of control periods of a motion in joint space to `goal`.
    pub(crate) fn swing_ticks(&self, goal: &[f64]) -> usize {
        joint_path(&self.at, goal, &self.robot.settings.arm, self.control_period_s).len()
    }

    /// The stages so far.
    pub(crate) fn finish(self) -> Vec<Stage> {
        self.stages
    }

    /// Appends a motion in joint space to `goal`.
    pub(crate) fn swing(&mut self, phase: Word, goal: Vec<f64>, gripper: GripperCommand) {
        let path = joint_path(&self.at, &goal, &self.robot.settings.arm, self.control_period_s);
        self.at = goal;
        self.push(Stage::of(phase, path, gripper));
    }

    /// Appends a straight motion of the tool through `goals`, which is one stage.
    ///
    /// # Errors
    /// If a pose is out of reach. The plan so far is kept.
    pub(crate) fn straight(
        &mut self,
        phase: Word,
        goals: &[Isometry3<f64>],
        limit: ToolLimit,
        gripper: GripperCommand,
    ) -> Result<(), Unreachable> {
        let arm = &self.robot.settings.arm;
        let mut path = Vec::new();
        let mut at = self.at.clone();
        for goal in goals {
            path.extend(straight_path(self.chain, &at, goal, &arm.home_rad, arm, limit, self.control_period_s)?);
            at = path.last().cloned().unwrap_or(at);
        }
        self.at = at;
        self.push(Stage::of(phase, path, gripper));
        Ok(())
    }

    /// Appends a motion of the tool through the poses that `pose` gives for the shares 0 to 1 of a way of `length_m` metres.
    ///
    /// # Errors
    /// If a pose is out of reach. The plan so far is kept.
    pub(crate) fn along(
        &mut self,
        phase: Word,
        pose: &dyn Fn(f64) -> Isometry3<f64>,
        length_m: f64,
        limit: ToolLimit,
        gripper: GripperCommand,
    ) -> Result<(), Unreachable> {
        let arm = &self.robot.settings.arm;
        let path = curved_path(self.chain, &self.at, pose, length_m, &arm.home_rad, arm, limit, self.control_period_s)?;
        self.at = path.last().cloned().unwrap_or_else(|| self.at.clone());
        self.push(Stage::of(phase, path, gripper));
        Ok(())
    }

    /// Appends a stage that waits for a number of control periods.
    pub(crate) fn wait(&mut self, phase: Word, periods: usize, gripper: GripperCommand) {
        self.push(Stage::of(phase, vec![self.at.clone(); periods], gripper));
    }

    /// Appends a stage that waits until the gripper has carried out a command.
    pub(crate) fn grip(&mut self, phase: Word, gripper: GripperCommand) {
        let path = vec![self.at.clone()];
        self.push(Stage { settles: true, ..Stage::of(phase, path, gripper) });
    }

    /// Among tool poses, the index of the one with the smallest largest joint motion from the arm's home position, with
    /// its joint positions.
    ///
    /// # Errors
    /// If no pose is in reach.
    pub(crate) fn nearest(&self, poses: &[Isometry3<f64>]) -> Result<(usize, Vec<f64>), Unreachable> {
        nearest(self.chain, &self.robot.settings.arm.home_rad, poses)
    }

    /// Joint positions at the end of the plan so far, in radians.
    pub(crate) fn at(&self) -> &[f64] {
        &self.at
    }

    /// The yaw of the tool over (x, y) for a square part, in radians, and the joint positions there: among `first` and its
    /// quarter turns the one with the smallest largest joint motion from home.
    ///
    /// # Errors
    /// If no pose is in reach.
    pub(crate) fn over(&self, [x, y]: [f64; 2], height: f64, first: f64) -> Result<(f64, Vec<f64>), Unreachable> {
        let yaws = [0, 1, 2, 3].map(|k| first + f64::from(k) * std::f64::consts::FRAC_PI_2);
        let (chosen, joints) = self.nearest(&yaws.map(|yaw| tool_down([x, y, height], yaw)))?;
        Ok((yaws[chosen], joints))
    }

    /// The first yaw of a tool that grasps a square part without a yaw at (x, y), in radians. A cup can have any yaw: its yaw
    /// follows the arm's base.
    pub(crate) fn square_yaw(&self, at: [f64; 2]) -> f64 {
        match &self.robot.settings.gripper {
            Gripper::ParallelJaw(_) => 0.0,
            Gripper::Suction(_) => cup_yaw(self.robot, self.chain, at),
        }
    }
}

/// The yaw of a cup over (x, y) that keeps the wrist posture of the arm's home position, in radians.
pub(crate) fn cup_yaw(robot: &Robot, chain: &Chain, at: [f64; 2]) -> f64 {
    let home = &robot.settings.arm.home_rad;
    let axis = chain.tcp_at(home).rotation * Vector3::x();
    carry_yaw(chain, home, axis.y.atan2(axis.x), at)
}

/// The yaw of a tool at (x, y) that has `yaw` at `joints`, in radians. It follows the arm's base, which keeps the wrist posture.
pub(crate) fn carry_yaw(chain: &Chain, joints: &[f64], yaw: f64, [x, y]: [f64; 2]) -> f64 {
    let from = chain.tcp_at(joints).translation.vector;
    yaw + y.atan2(x) - from.y.atan2(from.x)
}

/// Height of the tool above the underside of an upright part of this height (m) in the grasp. For fingers it is the
/// part's centre, but high enough to keep the fingertips off the table and the palm off the part. For a cup it is
/// just above the part.
pub(crate) fn grasp_height(gripper: &Gripper, height: f64) -> f64 {
    match gripper {
        Gripper::ParallelJaw(jaw) => {
            (0.5 * height).max(height - (jaw.palm_m - PALM_ROOM_M)).max(jaw.tip_m + TIP_ROOM_M)
        }
        Gripper::Suction(_) => height + CUP_ROOM_M,
    }
}

/// Among tool poses, the index of the one with the smallest largest joint motion from the arm's home position, with its
/// joint positions.
///
/// # Errors
/// If no pose is in reach.
pub(crate) fn nearest(chain: &Chain, home: &[f64], poses: &[Isometry3<f64>]) -> Result<(usize, Vec<f64>), Unreachable> {
    let mut best: Option<(f64, usize, Vec<f64>)> = None;
    let mut failure = None;
    for (index, pose) in poses.iter().enumerate() {
        match chain.reach(pose, home) {
            Ok(q) => {
                let bend = q.iter().zip(home).map(|(q, home)| (q - home).abs()).fold(0.0, f64::max);
                if best.as_ref().is_none_or(|(least, ..)| bend < *least) {
                    best = Some((bend, index, q));
                }
            }
            Err(unreachable) => failure = Some(unreachable),
        }
    }
    match (best, failure) {
        (Some((_, index, q)), _) => Ok((index, q)),
        (None, Some(unreachable)) => Err(unreachable),
        (None, None) => Err(Unreachable { position: [f64::NAN; 3], position_error_m: 0.0, angle_error_rad: 0.0 }),
    }
}

/// The tool at `at` (m), pointing down. Fingers close along the direction `yaw` + 90 degrees.
pub(crate) fn tool_down(at: [f64; 3], yaw: f64) -> Isometry3<f64> {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::new(at[0], at[1], at[2]), rotation * down)
}
