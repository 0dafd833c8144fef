//! The expert: a script of skills, planned from what the policy is told.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Action, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec, Word};
use robogate_physics::trajectory::{ToolLimit, smooth, smooth_duration};
use robogate_physics::{Chain, Gripper, GripperCommand, Motion as Law, Robot, Unreachable};

use super::Briefing;
use super::conditions::{Compiler, Value};
use super::model::{Model, heights};
use super::numbers::{Draws, Frame, Layout, Numbers, Place};
use super::syntax::{Node, What, Wrong};
use super::units::Dimension;
use crate::arm::{CONTROL_PERIOD_S, FREE, Planner, Script, compliance, cup_yaw, drives_task, grasp_height, tool_down};

/// Acceleration limit of a tool that holds or pushes something, in m/s^2.
const CAREFUL_M_S2: f64 = 0.8;
/// Speed of a tool that holds or pushes something, in m/s, if the file states none.
const CAREFUL_M_S: f64 = 0.1;
/// Distance of the tool from the axis of a hinge that counts as a way, in metres per radian.
const LEVER_M: f64 = 0.05;

/// Time between the end of a plan and a meeting with something that moves, in control periods.
const MEETING_TICKS: usize = 10;
/// Duration of a grasp and a release on something that moves, in control periods.
const RIDING_GRIP_TICKS: usize = 20;
/// Longest wait for a part, in control periods.
const LONGEST_WAIT_TICKS: usize = 1200;

/// A skill with its arguments.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Skill {
    pub(super) phase: Word,
    what: Motion,
}

#[derive(Debug, Clone, PartialEq)]
enum Motion {
    /// Swing over a place with an open or a closed gripper.
    Approach(Place, Value, GripperCommand),
    /// A straight line to a height above a place.
    Move(Place, Value, Option<Value>),
    /// A straight line to a place, where the gripper closes.
    Grasp(Place),
    Close,
    Release,
    Lift(Value),
    Shift([Value; 3], Option<Value>),
    /// Bring the part in the hand to a height above a place.
    Carry(Place, Value, Option<Value>),
    /// Move with a part along its joint to a value.
    Follow(usize, Value, Option<Value>),
    /// Move with a part along its joint to its upper stop, and press with a force.
    Press(usize, Value),
    Wait(Value),
    /// Wait until a part on a belt has come to a place, where it stops.
    Await(usize, Place),
    Home,
}

/// The skills with their arguments.
const SKILLS: [(&str, &str); 15] = [
    ("approach", "approach(PLACE, HEIGHT)"),
    ("reach", "reach(PLACE, HEIGHT)"),
    ("move", "move(PLACE, HEIGHT[, SPEED])"),
    ("grasp", "grasp(PLACE)"),
    ("close", "close()"),
    ("release", "release()"),
    ("lift", "lift(HEIGHT)"),
    ("shift", "shift(X, Y, Z[, SPEED])"),
    ("carry", "carry(PLACE, HEIGHT[, SPEED])"),
    ("pull", "pull(PART, VALUE[, SPEED])"),
    ("push", "push(PART, VALUE[, SPEED])"),
    ("turn", "turn(PART, VALUE[, SPEED])"),
    ("press", "press(PART, FORCE)"),
    ("wait", "wait(DURATION)"),
    ("await", "await(PART, PLACE)"),
];

/// Compiles a skill.
///
/// # Errors
/// The first problem.
pub(super) fn skill(compiler: &mut Compiler<'_>, node: &Node) -> Result<Skill, Wrong> {
    let What::Call(name, arguments) = &node.what else {
        return Err((node.at, "expected a skill, such as `approach(drawer.handle, 10 cm)`".to_owned()));
    };
    let names = compiler.names;
    let mut length = |node: &Node| compiler.constant(node, Dimension::LENGTH);
    let what = match (&**name, &arguments[..]) {
        ("approach", [place, height]) => Motion::Approach(names.place(place)?, length(height)?, GripperCommand::Open),
        ("reach", [place, height]) => Motion::Approach(names.place(place)?, length(height)?, GripperCommand::Close),
        ("move", [place, height, speed @ ..]) if speed.len() < 2 => {
            Motion::Move(names.place(place)?, length(height)?, optional(compiler, speed, Dimension::SPEED)?)
        }
        ("carry", [place, height, speed @ ..]) if speed.len() < 2 => {
            Motion::Carry(names.place(place)?, length(height)?, optional(compiler, speed, Dimension::SPEED)?)
        }
        ("grasp", [place]) => Motion::Grasp(names.place(place)?),
        ("close", []) => Motion::Close,
        ("release", []) => Motion::Release,
        ("home", []) => Motion::Home,
        ("lift", [height]) => Motion::Lift(length(height)?),
        ("shift", [x, y, z, speed @ ..]) if speed.len() < 2 => {
            let by = [length(x)?, length(y)?, length(z)?];
            Motion::Shift(by, optional(compiler, speed, Dimension::SPEED)?)
        }
        ("pull" | "push" | "turn", [part, value, speed @ ..]) if speed.len() < 2 => {
            let of = names.part(part)?;
            let dimension = names.joint(part.at, of)?;
            let value = compiler.constant(value, dimension)?;
            Motion::Follow(of, value, optional(compiler, speed, dimension.over(Dimension::TIME))?)
        }
        ("press", [part, force]) => {
            let of = names.part(part)?;
            if names.joint(part.at, of)? != Dimension::LENGTH {
                return Err((part.at, "a part on a hinge cannot be pressed. Expected one on a slide".to_owned()));
            }
            Motion::Press(of, compiler.constant(force, Dimension::FORCE)?)
        }
        ("wait", [duration]) => Motion::Wait(compiler.constant(duration, Dimension::TIME)?),
        ("await", [part, place]) => Motion::Await(names.part(part)?, names.place(place)?),
        _ => {
            let form = SKILLS.iter().find(|(known, _)| known == name);
            let why = match form {
                Some((_, form)) => format!("`{name}` has other arguments. Expected `{form}`"),
                None => {
                    let known = SKILLS.iter().map(|(known, _)| *known).chain(["home"]);
                    format!("unknown skill `{name}`: {}", robogate_core::hint(name, known))
                }
            };
            return Err((node.at, why));
        }
    };
    let phase = Word::new(name).map_err(|why| (node.at, why.to_string()))?;
    Ok(Skill { phase, what })
}

fn optional(compiler: &mut Compiler<'_>, node: &[Node], dimension: Dimension) -> Result<Option<Value>, Wrong> {
    node.first().map(|node| compiler.constant(node, dimension)).transpose()
}

/// The expert of a task.
pub(super) struct Expert {
    model: Arc<Model>,
    robot: Robot,
    chain: Chain,
    script: Script,
}

impl Expert {
    pub(super) fn new(model: Arc<Model>, robot: Robot, chain: Chain) -> Self {
        let script = Script::new(chain.clone(), Vec::new());
        Self { model, robot, chain, script }
    }
}

impl Policy for Expert {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        if self.model.skills.is_none() {
            return Err(format!(
                "the task {} has no expert. Name a policy with --policy, or add [expert] to its file",
                self.model.name
            ));
        }
        drives_task(self.model.name.as_str(), &self.robot, task)
    }

    fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
        let mut plan = Plan::new(&self.model, &self.robot, &self.chain, &Briefing::of(&self.model, instance)?);
        // If a pose is out of reach, the expert runs the reachable part of its plan and then waits. This is a failure of the
        // expert (a timeout), not a fault of the simulator.
        let skills = self.model.skills.as_deref().unwrap_or_default();
        let _unreachable = skills.iter().try_for_each(|skill| plan.add(skill));
        self.script = Script::new(self.chain.clone(), plan.planner.finish());
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        Ok(self.script.act(observation))
    }
}

/// The first skill of the expert that the arm cannot reach in the nominal scene, by its index.
pub(super) fn unreachable(model: &Model, robot: &Robot, chain: &Chain) -> Option<usize> {
    let mut plan = Plan::new(model, robot, chain, &Briefing::default());
    let skills = model.skills.as_deref().unwrap_or_default();
    skills.iter().position(|skill| plan.add(skill).is_err())
}

/// A plan under construction: the arm's path, and where the parts will be.
struct Plan<'a> {
    model: &'a Model,
    robot: &'a Robot,
    chain: &'a Chain,
    planner: Planner<'a>,
    numbers: Numbers,
    layout: Layout,
    /// Value of the joint of each part.
    joints: Vec<f64>,
    gripper: GripperCommand,
    /// The part in the hand, with its pose in the frame of the tool.
    in_hand: Option<(usize, Isometry3<f64>)>,
    /// The fixture that carries each part. The layout has the pose that such a part would have had at the start.
    carriers: Vec<Option<usize>>,
    /// What the tool moves with, and the control period from which on it does.
    tracked: Option<(Law, usize)>,
    /// What the part in the hand was brought to.
    over: Frame,
}

impl<'a> Plan<'a> {
    fn new(model: &'a Model, robot: &'a Robot, chain: &'a Chain, briefing: &Briefing) -> Self {
        let mut numbers = model.nominal.clone();
        for (index, parameter) in model.parameters.iter().enumerate() {
            if let Some(value) = briefing.parameters.get(parameter.name.as_str()) {
                model.set(&mut numbers, index, *value);
            }
        }
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
        let planner = Planner::new(robot, chain, CONTROL_PERIOD_S);
        let carriers = model.parents();
        let (gripper, in_hand, tracked, over) = (GripperCommand::Open, None, None, Frame::World);
        Self { model, robot, chain, planner, numbers, layout, joints, gripper, in_hand, carriers, tracked, over }
    }

    fn number(&self, value: &Value) -> f64 {
        value.constant(&self.numbers.values).unwrap_or_default()
    }

    fn tool(&self) -> Isometry3<f64> {
        self.chain.tcp_at(self.planner.at())
    }

    fn part(&self, of: usize, value: f64) -> Isometry3<f64> {
        let motion = self.numbers.parts[of].joint.map_or_else(Isometry3::identity, |joint| joint.motion(value));
        self.layout.parts[of] * motion
    }

    fn frame(&self, frame: Frame) -> Isometry3<f64> {
        match frame {
            Frame::World => Isometry3::identity(),
            Frame::Tool => self.tool(),
            Frame::Fixture(of) => self.layout.fixture(of, self.time_s()),
            Frame::Part(of) => {
                let part = self.part(of, self.joints[of]);
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
            Frame::Fixture(of) => self.layout.motions[of].filter(|law| !matches!(law, Law::Belt { .. })),
            Frame::Part(of) if self.numbers.parts[of].joint.is_none() => {
                self.carriers[of].and_then(|carrier| self.layout.motions[carrier])
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

    /// Where the tool is at a place, in metres. At the origin of a free part it is where it grasps the part. A cup takes a free
    /// part from above, at any place.
    fn target(&self, place: &Place) -> Vector3<f64> {
        let at = (self.frame(place.on) * Translation3::from(place.point)).translation.vector;
        let gripper = &self.robot.settings.gripper;
        let Frame::Part(of) = place.on else { return at };
        let (shapes, origin) = (&self.model.parts[of].shapes, place.point == Vector3::zeros());
        let free = self.numbers.parts[of].joint.is_none();
        if !free || gripper.jaw().is_some() && !origin {
            return at;
        }
        let over = |part: &&robogate_physics::Part| {
            let local = part.pose.inverse_transform_point(&place.point.into());
            let half = part.primitive.half_extent();
            origin || local.x.abs() <= half[0] && local.y.abs() <= half[1]
        };
        let under: Vec<_> = shapes.iter().filter(over).copied().collect();
        let [low, high] = heights(if under.is_empty() { shapes } else { &under });
        Vector3::new(at.x, at.y, at.z - place.point.z + low + grasp_height(gripper, high - low))
    }

    /// From where a tool of this rotation holds a part between two moving fingers to where it holds it against a fixed jaw, in metres.
    fn beside(&self, place: &Place, rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
        let (Some(jaw), Frame::Part(of)) = (self.robot.settings.gripper.jaw(), place.on) else {
            return Vector3::zeros();
        };
        if jaw.fixed_jaw_m.is_none() || place.point != Vector3::zeros() || self.numbers.parts[of].joint.is_some() {
            return Vector3::zeros();
        }
        let closing = rotation * Vector3::y();
        let across = self.frame(place.on).rotation.inverse() * closing;
        let reach = |part: &robogate_physics::Part| {
            let (local, half) = (part.pose.rotation.inverse() * across, part.primitive.half_extent());
            let half: f64 = (0..3).map(|axis| (local[axis] * half[axis]).abs()).sum();
            part.pose.translation.vector.dot(&across).abs() + half
        };
        let half = self.model.parts[of].shapes.iter().map(reach).fold(0.0, f64::max);
        -closing * jaw.beside_m(2.0 * half)
    }

    /// The yaws (rad) of a tool that points down and closes at a place.
    fn yaws(&self, place: &Place) -> Vec<f64> {
        let x = self.frame(place.on).rotation * Vector3::x();
        let of_frame = x.y.atan2(x.x);
        let at = self.target(place);
        match (&self.robot.settings.gripper, place.close_rad) {
            (Gripper::Suction(_), _) => vec![cup_yaw(self.robot, self.chain, [at.x, at.y])],
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
        match &skill.what {
            Motion::Approach(place, height, command) => {
                let poses = |plan: &Self| {
                    let at = above(plan.target(place), plan.number(height));
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
                if self.gripper != *command {
                    self.grip(phase, *command)?;
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
                self.line(phase, at, self.careful(None))?;
                self.grip(phase, GripperCommand::Close)?;
                if let Frame::Part(of) = place.on {
                    self.in_hand = Some((of, self.tool().inverse() * self.frame(place.on)));
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
            Motion::Shift(by, speed) => {
                let by = Vector3::from([0, 1, 2].map(|axis| self.number(&by[axis])));
                self.line(phase, self.tool().translation.vector + by, self.limit(speed.as_ref()))?;
            }
            Motion::Carry(place, height, speed) => self.carry(phase, place, self.number(height), speed.as_ref())?,
            Motion::Follow(of, value, speed) => {
                self.tracked = None;
                self.follow(phase, *of, self.number(value), speed.as_ref())?;
            }
            Motion::Press(of, force) => {
                let Some(joint) = self.numbers.parts[*of].joint else { return Ok(()) };
                self.tracked = None;
                self.follow(phase, *of, joint.range[1], None)?;
                // The arm yields under the force, so the command goes on by as much.
                let along = self.part(*of, 0.0).rotation * joint.motion(1.0).translation.vector;
                let soft = compliance(self.robot, self.chain, self.planner.at(), 1.0);
                let further = along * (soft * along).dot(&along) * self.number(force);
                self.line(phase, self.tool().translation.vector + further, self.careful(None))?;
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
                let home = self.robot.settings.arm.home_rad.clone();
                self.planner.swing(phase, home, self.gripper);
            }
        }
        if let Some((of, in_tool)) = self.in_hand
            && self.numbers.parts[of].joint.is_none()
        {
            self.layout.parts[of] = self.tool() * in_tool;
        }
        Ok(())
    }

    /// Leaves the part in the hand where it is. On a fixture that moves it is carried away.
    fn leave(&mut self) {
        let Some((of, in_tool)) = self.in_hand.take() else { return };
        if let Frame::Fixture(carrier) = self.over
            && let Some(law) = self.layout.motions[carrier]
        {
            let estimate = self.planner.ticks() as f64 * CONTROL_PERIOD_S;
            let time_s = self.tracked.map_or(estimate, |_| self.time_s());
            self.carriers[of] = Some(carrier);
            self.layout.parts[of] = law.riding(time_s).inverse() * self.tool() * in_tool;
        }
    }

    /// Waits until a part on a belt has come to a place.
    fn await_part(&mut self, phase: Word, of: usize, place: &Place) -> Result<(), Unreachable> {
        self.tracked = None;
        let goal = (self.frame(place.on) * Translation3::from(place.point)).translation.vector;
        let far = Unreachable { position: goal.into(), position_error_m: 0.0, angle_error_rad: 0.0 };
        let Some(Law::Belt { direction, speed_m_s }) = self.law(Frame::Part(of)) else { return Err(far) };
        let way = (goal - self.layout.parts[of].translation.vector).dot(&direction);
        let ticks = (way / speed_m_s / CONTROL_PERIOD_S).ceil();
        if !(0.0..=LONGEST_WAIT_TICKS as f64).contains(&ticks) {
            return Err(far);
        }
        self.planner.wait_for(phase, ticks as usize + MEETING_TICKS, self.gripper);
        self.layout.parts[of].translation.vector += direction * way;
        self.carriers[of] = None;
        Ok(())
    }

    /// Brings the part in the hand to a height above a place, with the yaw of the place or a quarter turn of it.
    fn carry(&mut self, phase: Word, place: &Place, height: f64, speed: Option<&Value>) -> Result<(), Unreachable> {
        self.track(place.on);
        self.over = place.on;
        let frame = self.frame(place.on) * Translation3::from(place.point);
        let goal = frame.translation.vector + Vector3::new(0.0, 0.0, height);
        let part = self.in_hand.map_or_else(Isometry3::identity, |(_, in_tool)| in_tool);
        let yaw = |rotation: &UnitQuaternion<f64>| rotation.euler_angles().2;
        let now = self.tool() * part;
        let poses: Vec<_> = (0..4)
            .map(|turn| {
                let by = yaw(&frame.rotation) + f64::from(turn) * FRAC_PI_2 - yaw(&now.rotation);
                let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, by) * self.tool().rotation;
                let offset = rotation * part.translation.vector;
                Isometry3::from_parts(Translation3::from(goal - offset), rotation)
            })
            .collect();
        let (chosen, _) = self.planner.nearest(&poses)?;
        let limit = self.careful(speed);
        // A wrist that is turned already may not turn on to the most comfortable pose.
        let first = self.to(phase, &poses[chosen], limit);
        poses.iter().fold(first, |done, pose| done.or_else(|_| self.to(phase, pose, limit)))
    }

    /// Moves with a part along its joint.
    fn follow(&mut self, phase: Word, of: usize, to: f64, speed: Option<&Value>) -> Result<(), Unreachable> {
        let (from, tool) = (self.joints[of], self.tool());
        let Some(joint) = self.numbers.parts[of].joint else { return Ok(()) };
        let in_part = self.part(of, from).inverse() * tool;
        // A hinge moves the tool by its distance from the axis.
        let lever = match joint.kind {
            robogate_physics::JointKind::Slide => 1.0,
            robogate_physics::JointKind::Hinge => {
                let from_axis = (joint.motion(from) * in_part).translation.vector - joint.anchor;
                from_axis.cross(&joint.axis.normalize()).norm().max(LEVER_M)
            }
        };
        let speed = speed.map_or(CAREFUL_M_S, |speed| self.number(speed) * lever);
        let limit = ToolLimit { speed, acceleration: CAREFUL_M_S2 };
        let zero = self.layout.parts[of];
        let pose = |share: f64| zero * joint.motion(from + share * (to - from)) * in_part;
        self.planner.along(phase, &pose, lever * (to - from).abs(), limit, self.gripper)?;
        // The stops end its way. A tool with room in a handle goes farther.
        self.joints[of] = to.clamp(joint.range[0], joint.range[1]);
        Ok(())
    }
}

/// The phases of the skills, each once, in their order.
pub(super) fn phases(skills: &[Skill]) -> Vec<Word> {
    let mut phases: Vec<Word> = Vec::new();
    for skill in skills {
        if !phases.contains(&skill.phase) {
            phases.push(skill.phase);
        }
    }
    phases
}
