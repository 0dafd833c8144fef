//! The expert: a script of skills, planned from what the policy is told.

mod insert;

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Action, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec, Word};
use robogate_physics::trajectory::{ToolLimit, smooth, smooth_duration};
use robogate_physics::{Chain, Gripper, GripperCommand, Motion as Law, Robot, Unreachable};

use super::Briefing;
use super::conditions::Value;
use super::model::Model;
use super::numbers::{Draws, Frame, Layout, Numbers, Place};
use super::shapes::heights;
use super::skills::{Motion, Skill};
use crate::arm::{
    CONTROL_PERIOD_S, FREE, Planner, Script, Stage, compliance, cup_yaw, drives_task, grasp_height, tool_down,
};

/// Acceleration limit of a tool that holds or pushes something, in m/s^2.
const CAREFUL_M_S2: f64 = 0.8;
/// Speed of a tool that holds or pushes something, in m/s, if the file states none.
const CAREFUL_M_S: f64 = 0.1;
/// Half of the width of two closed fingers, in metres.
const HALF_FINGER_M: f64 = 0.01;
/// Cosine of the angle between tool and slide below which the tips of the gripper press.
const POINTS: f64 = 0.9;
/// Speed of a tool that turns, in rad/s, if the file states none.
const TWIST_RAD_S: f64 = 1.0;
/// Distance of the tool from the axis of a hinge that counts as a way, in metres per radian.
const LEVER_M: f64 = 0.05;

/// A tool is at a place within this distance, in metres.
const THERE_M: f64 = 1e-5;

/// Time between the end of a plan and a meeting with something that moves, in control periods.
const MEETING_TICKS: usize = 10;
/// Duration of a grasp and a release on something that moves, in control periods.
const RIDING_GRIP_TICKS: usize = 20;
/// Longest wait for a part, in control periods.
const LONGEST_WAIT_TICKS: usize = 1200;

/// The expert of a task.
pub(super) struct Expert {
    model: Arc<Model>,
    /// Values of the settings.
    settings: Vec<f64>,
    robot: Robot,
    chain: Chain,
    script: Script,
}

impl Expert {
    pub(super) fn new(model: Arc<Model>, settings: Vec<f64>, robot: Robot, chain: Chain) -> Self {
        let script = Script::new(chain.clone(), Vec::new());
        Self { model, settings, robot, chain, script }
    }

    /// The stages of its plan. `Err` has those before the first pose that is out of reach.
    pub(super) fn stages(&self, briefing: &Briefing) -> Result<Vec<Stage>, Vec<Stage>> {
        let cell = Cell::new(&self.model, &self.settings, &self.robot, briefing);
        let mut plan = Plan::new(cell, &self.chain);
        let reached = self.model.skills(plan.cell.numbers.word).iter().try_for_each(|skill| plan.add(skill));
        let stages = plan.planner.finish();
        if reached.is_ok() { Ok(stages) } else { Err(stages) }
    }
}

impl Policy for Expert {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        if !self.model.has_expert() {
            return Err(format!(
                "the task {} has no expert. Name a policy with --policy, or add [expert] to its file",
                self.model.name
            ));
        }
        drives_task(self.model.name.as_str(), &self.robot, task)
    }

    fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        // If a pose is out of reach, the expert runs the reachable part of its plan and then waits. This is a failure of the
        // expert (a timeout), not a fault of the simulator.
        let (Ok(stages) | Err(stages)) = self.stages(&Briefing::of(&self.model, instance)?);
        self.script = Script::new(self.chain.clone(), stages);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        Ok(self.script.act(observation))
    }
}

/// The first skill of the expert that the arm cannot reach in the nominal scene, by its index.
pub(super) fn unreachable(model: &Model, robot: &Robot, chain: &Chain) -> Option<usize> {
    let settings: Vec<f64> = model.settings.iter().map(|setting| setting.default).collect();
    let mut plan = Plan::new(Cell::new(model, &settings, robot, &Briefing::default()), chain);
    model.skills(model.nominal.word).iter().position(|skill| plan.add(skill).is_err())
}

/// Where the bodies are at the start, as the policy is told.
pub(super) struct Cell<'a> {
    pub(super) model: &'a Model,
    robot: &'a Robot,
    pub(super) numbers: Numbers,
    pub(super) layout: Layout,
    /// Value of the joint of each part.
    joints: Vec<f64>,
}

impl<'a> Cell<'a> {
    pub(super) fn new(model: &'a Model, settings: &[f64], robot: &'a Robot, briefing: &Briefing) -> Self {
        let mut numbers = model.nominal.clone();
        for (index, parameter) in model.parameters.iter().enumerate() {
            if let Some(value) = briefing.parameters.get(parameter.name.as_str()) {
                model.set(&mut numbers, index, *value);
            }
        }
        model.choose(&mut numbers, &briefing.choice);
        model.complete(&mut numbers, settings, robot);
        let mut layout = Layout::new(&numbers, &model.parents(), &vec![Draws::default(); model.parts.len()]);
        let mut parts = std::mem::take(&mut layout.parts);
        for (part, pose) in model.parts.iter().zip(&mut parts) {
            if let Some(told) = briefing.parts.get(&part.name) {
                *pose = robogate_physics::isometry(&told.position, &told.orientation);
            } else if let Some(region) = part.start {
                let frame = match region.on {
                    Frame::Fixture(of) => layout.fixtures[of],
                    _ => Isometry3::identity(),
                };
                let centre = frame * nalgebra::Point3::from(region.at);
                (pose.translation.x, pose.translation.y) = (centre.x, centre.y);
            }
        }
        layout.parts = parts;
        let joints = numbers.parts.iter().map(|part| part.joint.map_or(0.0, |joint| joint.start)).collect();
        Self { model, robot, numbers, layout, joints }
    }

    fn number(&self, value: &Value) -> f64 {
        value.constant(&self.numbers.values).unwrap_or_default()
    }

    fn part(&self, of: usize, value: f64) -> Isometry3<f64> {
        let motion = self.numbers.parts[of].joint.map_or_else(Isometry3::identity, |joint| joint.motion(value));
        self.layout.parts[of] * motion
    }

    /// The frame of a place, moved to the place.
    fn at(&self, place: &Place, frame: &Isometry3<f64>) -> Isometry3<f64> {
        let mut at = frame * Translation3::from(place.point);
        if let [x, y, z] = &place.shift[..] {
            at.translation.vector += Vector3::new(self.number(x), self.number(y), self.number(z));
        }
        at
    }

    /// Where the tool is at a place of this frame, in metres. At the origin of a free part it is where it grasps the part. A cup takes
    /// a free part from above, at any place.
    fn target(&self, place: &Place, frame: &Isometry3<f64>) -> Vector3<f64> {
        let at = self.at(place, frame).translation.vector;
        let gripper = &self.robot.settings.gripper;
        let Frame::Part(of) = place.on else { return at };
        let (shapes, origin) = (&self.numbers.parts[of].shapes, place.point == Vector3::zeros());
        let free = self.numbers.parts[of].joint.is_none();
        if !free || gripper.jaw().is_some() && !origin {
            return at;
        }
        let over = |part: &&robogate_physics::Part| {
            let local = part.pose.inverse_transform_point(&place.point.into());
            let half = part.primitive.half_extent();
            origin || local.x.abs() <= half[0] && local.y.abs() <= half[1]
        };
        let [low, high] = if shapes.iter().any(|part| over(&part)) {
            heights(shapes.iter().filter(over))
        } else {
            heights(shapes.iter())
        };
        Vector3::new(at.x, at.y, at.z - place.point.z + low + grasp_height(gripper, high - low))
    }
}

/// A plan under construction: the arm's path, and where the parts will be.
struct Plan<'a> {
    cell: Cell<'a>,
    chain: &'a Chain,
    planner: Planner<'a>,
    gripper: GripperCommand,
    /// The part in the hand, with its pose in the frame of the tool.
    in_hand: Option<(usize, Isometry3<f64>)>,
    /// By how many quarters it may be turned where it is put down.
    quarters: usize,
    /// The fixture that carries each part. The layout has the pose that such a part would have had at the start.
    carriers: Vec<Option<usize>>,
    /// What the tool moves with, and the control period from which on it does.
    tracked: Option<(Law, usize)>,
    /// What the part in the hand was brought to.
    over: Frame,
}

impl<'a> Plan<'a> {
    fn new(cell: Cell<'a>, chain: &'a Chain) -> Self {
        let planner = Planner::new(cell.robot, chain, CONTROL_PERIOD_S);
        let carriers = cell.model.parents();
        let (gripper, in_hand, tracked, over) = (GripperCommand::Open, None, None, Frame::World);
        Self { cell, chain, planner, gripper, in_hand, quarters: 1, carriers, tracked, over }
    }

    fn number(&self, value: &Value) -> f64 {
        self.cell.number(value)
    }

    fn tool(&self) -> Isometry3<f64> {
        self.chain.tcp_at(self.planner.at())
    }

    fn frame(&self, frame: Frame) -> Isometry3<f64> {
        match frame {
            Frame::World | Frame::Release(_) => Isometry3::identity(),
            Frame::Tool => self.tool(),
            Frame::Fixture(of) => self.cell.layout.fixture(of, self.time_s()),
            Frame::Part(of) => {
                let part = self.cell.part(of, self.cell.joints[of]);
                self.law(frame).map_or(part, |law| law.riding(self.time_s()) * part)
            }
        }
    }

    /// The time to which the plan belongs, in seconds: of the last control period in which the tool moves with something.
    fn time_s(&self) -> f64 {
        self.tracked.map_or(0.0, |(_, clock)| clock as f64 * CONTROL_PERIOD_S)
    }

    /// How a frame moves. The frame of a belt stands still; the parts on it move.
    fn law(&self, frame: Frame) -> Option<Law> {
        match frame {
            Frame::Fixture(of) => self.cell.layout.motions[of].filter(|law| !matches!(law, Law::Belt { .. })),
            Frame::Part(of) if self.cell.numbers.parts[of].joint.is_none() => {
                self.carriers[of].and_then(|carrier| self.cell.layout.motions[carrier])
            }
            _ => None,
        }
    }

    /// Lets the tool move with a frame from the next stage on, if the frame moves.
    fn track(&mut self, frame: Frame) {
        let law = self.law(frame);
        if self.tracked.map(|(known, _)| known) != law {
            self.tracked = law.map(|law| (law, self.planner.ticks() + MEETING_TICKS));
        }
    }

    /// Brings the tool above a place that moves: where the place will be when the tool is there.
    fn meet(&mut self, phase: Word, law: Law, poses: &dyn Fn(&Self) -> Vec<Isometry3<f64>>) -> Result<(), Unreachable> {
        let start = self.planner.ticks() + MEETING_TICKS;
        self.tracked = Some((law, start));
        let mut joints = self.planner.nearest(&poses(self))?.1;
        for _ in 0..5 {
            self.tracked = Some((law, start + self.planner.swing_ticks(&joints)));
            joints = self.planner.nearest(&poses(self))?.1;
        }
        self.planner.swing(phase, joints, self.gripper);
        Ok(())
    }

    /// A straight line of the tool to a pose, relative to what it moves with.
    fn ride(&mut self, phase: Word, to: &Isometry3<f64>, limit: ToolLimit) -> Result<(), Unreachable> {
        let way = (to.translation.vector - self.tool().translation.vector).norm();
        let ticks = (smooth_duration(way, limit) / CONTROL_PERIOD_S).ceil().max(1.0);
        self.ride_for(phase, to, ticks as usize)
    }

    fn ride_for(&mut self, phase: Word, to: &Isometry3<f64>, ticks: usize) -> Result<(), Unreachable> {
        let Some((law, clock)) = self.tracked else { return Ok(()) };
        let riding = |ticks: f64| law.riding((clock as f64 + ticks) * CONTROL_PERIOD_S);
        let back = riding(0.0).inverse();
        let (from, to) = (back * self.tool(), back * to);
        // The servo lags the commands by half a control period.
        let pose = |k: usize| riding(k as f64 + 0.5) * from.lerp_slerp(&to, smooth(k as f64 / ticks as f64));
        self.planner.timed(phase, clock, (ticks, &pose), self.gripper)?;
        self.tracked = Some((law, clock + ticks));
        Ok(())
    }

    fn target(&self, place: &Place) -> Vector3<f64> {
        self.cell.target(place, &self.frame(place.on))
    }

    /// From where a tool of this rotation holds a part between two moving fingers to where it holds it against a fixed jaw, in metres.
    fn beside(&self, place: &Place, rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
        let (Some(jaw), Frame::Part(of)) = (self.cell.robot.settings.gripper.jaw(), place.on) else {
            return Vector3::zeros();
        };
        if jaw.fixed_jaw_m.is_none() || place.point != Vector3::zeros() || self.cell.numbers.parts[of].joint.is_some() {
            return Vector3::zeros();
        }
        let closing = rotation * Vector3::y();
        let across = self.frame(place.on).rotation.inverse() * closing;
        let reach = |part: &robogate_physics::Part| {
            let (local, at) = (part.pose.rotation.inverse() * across, part.pose.translation.vector.dot(&across));
            part.primitive.extent(&local).into_iter().map(|end| (at + end).abs()).fold(0.0, f64::max)
        };
        let half = self.cell.numbers.parts[of].shapes.iter().map(reach).fold(0.0, f64::max);
        -closing * jaw.beside_m(2.0 * half)
    }

    /// The yaws (rad) of a tool that points down and closes at a place.
    fn yaws(&self, place: &Place) -> Vec<f64> {
        let x = self.frame(place.on).rotation * Vector3::x();
        let of_frame = x.y.atan2(x.x);
        let at = self.target(place);
        match (&self.cell.robot.settings.gripper, place.close_rad) {
            (Gripper::Suction(_), _) => vec![cup_yaw(self.cell.robot, self.chain, [at.x, at.y])],
            // Fingers close at a right angle to the yaw of the tool.
            (Gripper::ParallelJaw(_), Some(close)) => [0.0, PI].map(|turn| of_frame + close - FRAC_PI_2 + turn).into(),
            (Gripper::ParallelJaw(_), None) => (0..4).map(|turn| of_frame + f64::from(turn) * FRAC_PI_2).collect(),
        }
    }

    fn careful(&self, speed: Option<&Value>) -> ToolLimit {
        let speed = speed.map_or(CAREFUL_M_S, |speed| self.number(speed));
        ToolLimit { speed, acceleration: CAREFUL_M_S2 }
    }

    /// The limit of a straight line. A tool without a part in its hand may move freely.
    fn limit(&self, speed: Option<&Value>) -> ToolLimit {
        if speed.is_none() && self.in_hand.is_none() { FREE } else { self.careful(speed) }
    }

    fn line(&mut self, phase: Word, to: Vector3<f64>, limit: ToolLimit) -> Result<(), Unreachable> {
        self.to(phase, &Isometry3::from_parts(Translation3::from(to), self.tool().rotation), limit)
    }

    /// A straight line to a pose.
    fn to(&mut self, phase: Word, goal: &Isometry3<f64>, limit: ToolLimit) -> Result<(), Unreachable> {
        match self.tracked {
            Some(_) => self.ride(phase, goal, limit),
            None => self.planner.straight(phase, &[*goal], limit, self.gripper),
        }
    }

    fn grip(&mut self, phase: Word, command: GripperCommand) -> Result<(), Unreachable> {
        self.gripper = command;
        if self.tracked.is_some() {
            return self.ride_for(phase, &self.tool(), RIDING_GRIP_TICKS);
        }
        self.planner.grip(phase, command);
        Ok(())
    }

    /// Appends a skill.
    fn add(&mut self, skill: &Skill) -> Result<(), Unreachable> {
        let phase = skill.phase;
        let above = |at: Vector3<f64>, height: f64| at + Vector3::new(0.0, 0.0, height);
        self.planner.relative(skill.is_relative());
        match &skill.what {
            Motion::Approach(place, height, _) | Motion::Over(place, height) => {
                let (absolute, command) = match &skill.what {
                    Motion::Approach(.., command) => (false, *command),
                    _ => (true, GripperCommand::Open),
                };
                let poses = |plan: &Self| {
                    let at = match absolute {
                        true => Vector3::new(plan.target(place).x, plan.target(place).y, plan.number(height)),
                        false => above(plan.target(place), plan.number(height)),
                    };
                    let pose = |yaw: f64| {
                        let pose = tool_down(at.into(), yaw);
                        Translation3::from(plan.beside(place, &pose.rotation)) * pose
                    };
                    plan.yaws(place).into_iter().map(pose).collect::<Vec<_>>()
                };
                self.tracked = None;
                let law = self.law(place.on);
                let joints = match law {
                    Some(_) => Vec::new(),
                    None => self.planner.nearest(&poses(self))?.1,
                };
                if self.gripper != command {
                    self.grip(phase, command)?;
                }
                match law {
                    Some(law) => self.meet(phase, law, &poses)?,
                    None => self.planner.swing(phase, joints, self.gripper),
                }
            }
            Motion::Move(place, height, speed) => {
                self.track(place.on);
                let at = above(self.target(place), self.number(height)) + self.beside(place, &self.tool().rotation);
                self.line(phase, at, self.limit(speed.as_ref()))?;
            }
            Motion::Grasp(place) => {
                self.track(place.on);
                let at = self.target(place) + self.beside(place, &self.tool().rotation);
                // A tool that is there already stays.
                if (at - self.tool().translation.vector).norm() > THERE_M || self.tracked.is_some() {
                    self.line(phase, at, self.careful(None))?;
                }
                self.grip(phase, GripperCommand::Close)?;
                if let Frame::Part(of) = place.on {
                    self.in_hand = Some((of, self.tool().inverse() * self.frame(place.on)));
                    // A part with a direction in which fingers close is not the same after a quarter turn.
                    self.quarters = if place.close_rad.is_some() { 2 } else { 1 };
                    self.carriers[of] = None;
                }
            }
            Motion::Close => self.grip(phase, GripperCommand::Close)?,
            Motion::Release => {
                self.grip(phase, GripperCommand::Open)?;
                self.leave();
            }
            Motion::Lift(height) => {
                let at = above(self.tool().translation.vector, self.number(height));
                self.line(phase, at, self.limit(None))?;
            }
            Motion::Rise(height) => {
                let at = self.tool().translation.vector;
                self.line(phase, Vector3::new(at.x, at.y, self.number(height)), self.limit(None))?;
            }
            Motion::Transfer(place, height, speed, acceleration) => {
                let limit = self.limit(speed.as_ref());
                let acceleration = acceleration.as_ref().map_or(limit.acceleration, |value| self.number(value));
                self.transfer(phase, place, self.number(height), ToolLimit { acceleration, ..limit })?;
            }
            Motion::Shift(by, speed) => {
                let by = Vector3::from([0, 1, 2].map(|axis| self.number(&by[axis])));
                self.line(phase, self.tool().translation.vector + by, self.limit(speed.as_ref()))?;
            }
            Motion::Carry(place, height, speed) => self.carry(phase, place, self.number(height), speed.as_ref())?,
            Motion::Follow(of, value, speed) => {
                self.tracked = None;
                self.follow(phase, *of, self.number(value), speed.as_ref())?;
            }
            Motion::Press(of, force) => self.press(phase, *of, self.number(force))?,
            Motion::Insert(place, depth, force, catch) => {
                self.tracked = None;
                self.insert(phase, place, [self.number(depth), self.number(force)], catch.as_ref())?;
            }
            Motion::Twist(angle, speed) => {
                self.tracked = None;
                let (tool, angle) = (self.tool(), self.number(angle));
                let speed = speed.as_ref().map_or(TWIST_RAD_S, |speed| self.number(speed));
                let limit = ToolLimit { speed: speed * LEVER_M, acceleration: CAREFUL_M_S2 };
                let pose = |share: f64| {
                    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), share * angle);
                    Isometry3::from_parts(tool.translation, turn * tool.rotation)
                };
                self.planner.along(phase, &pose, LEVER_M * angle.abs(), limit, self.gripper)?;
            }
            Motion::Wait(duration) => {
                let periods =
                    (self.number(duration) / CONTROL_PERIOD_S).ceil().clamp(1.0, LONGEST_WAIT_TICKS as f64) as usize;
                match self.tracked {
                    Some(_) => self.ride_for(phase, &self.tool(), periods)?,
                    None => self.planner.wait(phase, periods, self.gripper),
                }
            }
            Motion::Await(of, place) => self.await_part(phase, *of, place)?,
            Motion::Home => {
                self.tracked = None;
                let home = self.cell.robot.settings.arm.home_rad.clone();
                self.planner.swing(phase, home, self.gripper);
            }
        }
        if let Some((of, in_tool)) = self.in_hand
            && self.cell.numbers.parts[of].joint.is_none()
        {
            self.cell.layout.parts[of] = self.tool() * in_tool;
        }
        Ok(())
    }

    /// Leaves the part in the hand where it is. On a fixture that moves it is carried away.
    fn leave(&mut self) {
        let Some((of, in_tool)) = self.in_hand.take() else { return };
        if let Frame::Fixture(carrier) = self.over
            && let Some(law) = self.cell.layout.motions[carrier]
        {
            let estimate = self.planner.ticks() as f64 * CONTROL_PERIOD_S;
            let time_s = self.tracked.map_or(estimate, |_| self.time_s());
            self.carriers[of] = Some(carrier);
            self.cell.layout.parts[of] = law.riding(time_s).inverse() * self.tool() * in_tool;
        }
    }

    /// Waits until a part on a belt has come to a place.
    fn await_part(&mut self, phase: Word, of: usize, place: &Place) -> Result<(), Unreachable> {
        self.tracked = None;
        let goal = self.cell.at(place, &self.frame(place.on)).translation.vector;
        let far = Unreachable { position: goal.into(), position_error_m: 0.0, angle_error_rad: 0.0 };
        let Some(Law::Belt { direction, speed_m_s }) = self.law(Frame::Part(of)) else { return Err(far) };
        let way = (goal - self.cell.layout.parts[of].translation.vector).dot(&direction);
        let ticks = (way / speed_m_s / CONTROL_PERIOD_S).ceil();
        if !(0.0..=LONGEST_WAIT_TICKS as f64).contains(&ticks) {
            return Err(far);
        }
        self.planner.wait_for(phase, ticks as usize + MEETING_TICKS, self.gripper);
        self.cell.layout.parts[of].translation.vector += direction * way;
        self.carriers[of] = None;
        Ok(())
    }

    /// Straight up to a height above the table, and straight on with the part in the hand over a place.
    fn transfer(&mut self, phase: Word, place: &Place, height: f64, limit: ToolLimit) -> Result<(), Unreachable> {
        self.tracked = None;
        self.over = place.on;
        let raised = |pose: &Isometry3<f64>| {
            let [x, y, _] = pose.translation.vector.into();
            Isometry3::from_parts(Translation3::new(x, y, height), pose.rotation)
        };
        let poses: Vec<_> = self.turned(place, height).iter().map(raised).collect();
        let (chosen, _) = self.planner.nearest(&poses)?;
        self.planner.straight(phase, &[raised(&self.tool()), poses[chosen]], limit, self.gripper)
    }

    /// The poses of the tool in which the part in the hand is at a height above a place, with its yaw or some quarter turns of it.
    fn turned(&self, place: &Place, height: f64) -> Vec<Isometry3<f64>> {
        let frame = self.cell.at(place, &self.frame(place.on));
        let goal = frame.translation.vector + Vector3::new(0.0, 0.0, height);
        let part = self.in_hand.map_or_else(Isometry3::identity, |(_, in_tool)| in_tool);
        let yaw = |rotation: &UnitQuaternion<f64>| rotation.euler_angles().2;
        let now = self.tool() * part;
        let pose = |turn: i32| {
            let by = yaw(&frame.rotation) + f64::from(turn) * FRAC_PI_2 - yaw(&now.rotation);
            let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, by) * self.tool().rotation;
            let offset = rotation * part.translation.vector;
            Isometry3::from_parts(Translation3::from(goal - offset), rotation)
        };
        (0..4).step_by(self.quarters).map(pose).collect()
    }

    /// Brings the part in the hand to a height above a place, with the yaw of the place or a quarter turn of it.
    fn carry(&mut self, phase: Word, place: &Place, height: f64, speed: Option<&Value>) -> Result<(), Unreachable> {
        self.track(place.on);
        self.over = place.on;
        let poses = self.turned(place, height);
        let (chosen, _) = self.planner.nearest(&poses)?;
        let limit = self.careful(speed);
        // A wrist that is turned already may not turn on to the most comfortable pose.
        let first = self.to(phase, &poses[chosen], limit);
        poses.iter().fold(first, |done, pose| done.or_else(|_| self.to(phase, pose, limit)))
    }

    /// Moves with a part to its upper stop, and presses against the stop with a force (N).
    fn press(&mut self, phase: Word, of: usize, force: f64) -> Result<(), Unreachable> {
        let Some(joint) = self.cell.numbers.parts[of].joint else { return Ok(()) };
        self.tracked = None;
        let mut force = force;
        let along = if joint.kind == robogate_physics::JointKind::Slide {
            force += (joint.stiffness * (joint.range[1] - joint.rest)).max(0.0);
            if let Some(before) = self.before_contact(of, &joint) {
                self.cell.joints[of] = -before;
            }
            self.follow(phase, of, joint.range[1], None)?;
            self.cell.part(of, 0.0).rotation * joint.motion(1.0).translation.vector
        } else {
            // The tool is at a point of the part, and its tips follow this point. It keeps its rotation, so that the edge of the fingers
            // meets a part that leans first.
            let (tool, along) = (self.tool(), self.tool().rotation * Vector3::z());
            let in_part = self.cell.part(of, self.cell.joints[of]).inverse() * tool;
            let at = self.cell.part(of, joint.range[1]) * in_part;
            let first = if self.tip_m() > 0.0 { HALF_FINGER_M * joint.range[1].sin().abs() } else { 0.0 };
            self.line(phase, at.translation.vector - along * (self.tip_m() + first), self.careful(None))?;
            self.cell.joints[of] = joint.range[1];
            along
        };
        // The arm yields under the force, so the command goes on by as much. Friction holds the tips: they do not evade sideways.
        let soft = compliance(self.cell.robot, self.chain, self.planner.at(), 1.0);
        let yields = soft.try_inverse().map_or((soft * along).dot(&along), |stiff| 1.0 / (stiff * along).dot(&along));
        self.line(phase, self.tool().translation.vector + along * yields * force, self.careful(None))
    }

    /// The distance from the tool centre point to the tips of the fingers. 0 for a cup.
    fn tip_m(&self) -> f64 {
        self.cell.robot.settings.gripper.jaw().map_or(0.0, |jaw| jaw.tip_m)
    }

    /// The distance from the tips of the gripper to a part at the start of its slide, in metres. `None` if the tool does not point along
    /// the slide: its side presses then.
    fn before_contact(&self, of: usize, joint: &robogate_physics::Joint) -> Option<f64> {
        let (part, tool) = (self.cell.part(of, 0.0), self.tool());
        let local = joint.motion(1.0).translation.vector;
        let along = part.rotation * local;
        let facing = (tool.rotation * Vector3::z()).dot(&along);
        let nearest = |shape: &robogate_physics::Part| {
            let at = shape.pose.translation.vector.dot(&local);
            at + shape.primitive.extent(&(shape.pose.rotation.inverse() * local))[0]
        };
        let face = self.cell.numbers.parts[of].shapes.iter().map(nearest).fold(f64::INFINITY, f64::min);
        let tip = tool.translation.vector.dot(&along) + self.tip_m() * facing;
        (facing > POINTS).then(|| part.translation.vector.dot(&along) + face - tip)
    }

    /// Moves with a part along its joint.
    fn follow(&mut self, phase: Word, of: usize, to: f64, speed: Option<&Value>) -> Result<(), Unreachable> {
        let (from, tool) = (self.cell.joints[of], self.tool());
        let Some(joint) = self.cell.numbers.parts[of].joint else { return Ok(()) };
        let in_part = self.cell.part(of, from).inverse() * tool;
        // A hinge moves the tool by its distance from the axis.
        let lever = match joint.kind {
            robogate_physics::JointKind::Slide => 1.0,
            robogate_physics::JointKind::Hinge | robogate_physics::JointKind::Screw => {
                let from_axis = (joint.motion(from) * in_part).translation.vector - joint.anchor;
                from_axis.cross(&joint.axis.normalize()).norm().max(LEVER_M)
            }
        };
        let speed = speed.map_or(CAREFUL_M_S, |speed| self.number(speed) * lever);
        let limit = ToolLimit { speed, acceleration: CAREFUL_M_S2 };
        let zero = self.cell.layout.parts[of];
        let pose = |share: f64| zero * joint.motion(from + share * (to - from)) * in_part;
        self.planner.along(phase, &pose, lever * (to - from).abs(), limit, self.gripper)?;
        // The stops end its way. A tool with room in a handle goes farther.
        self.cell.joints[of] = to.clamp(joint.range[0], joint.range[1]);
        Ok(())
    }
}
