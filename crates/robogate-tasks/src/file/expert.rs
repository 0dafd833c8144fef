//! The expert: a script of skills, planned from what the policy is told.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Action, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec, Word};
use robogate_physics::trajectory::ToolLimit;
use robogate_physics::{Chain, Gripper, GripperCommand, Robot, Unreachable};

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
    Home,
}

/// The skills with their arguments.
const SKILLS: [(&str, &str); 14] = [
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
        for (part, pose) in model.parts.iter().zip(&mut layout.parts) {
            if let Some(told) = briefing.parts.get(&part.name) {
                *pose = robogate_physics::isometry(&told.position, &told.orientation);
            }
        }
        let joints = numbers.parts.iter().map(|part| part.joint.map_or(0.0, |joint| joint.start)).collect();
        let planner = Planner::new(robot, chain, CONTROL_PERIOD_S);
        Self { model, robot, chain, planner, numbers, layout, joints, gripper: GripperCommand::Open, in_hand: None }
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
            Frame::Fixture(of) => self.layout.fixtures[of],
            Frame::Part(of) => self.part(of, self.joints[of]),
        }
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
        let goal = Isometry3::from_parts(Translation3::from(to), self.tool().rotation);
        self.planner.straight(phase, &[goal], limit, self.gripper)
    }

    fn grip(&mut self, phase: Word, command: GripperCommand) {
        self.gripper = command;
        self.planner.grip(phase, command);
    }

    /// Appends a skill.
    fn add(&mut self, skill: &Skill) -> Result<(), Unreachable> {
        let phase = skill.phase;
        let above = |at: Vector3<f64>, height: f64| at + Vector3::new(0.0, 0.0, height);
        match &skill.what {
            Motion::Approach(place, height, command) => {
                let at = above(self.target(place), self.number(height));
                let pose = |yaw: f64| {
                    let pose = tool_down(at.into(), yaw);
                    Translation3::from(self.beside(place, &pose.rotation)) * pose
                };
                let poses: Vec<_> = self.yaws(place).into_iter().map(pose).collect();
                let (_, joints) = self.planner.nearest(&poses)?;
                if self.gripper != *command {
                    self.grip(phase, *command);
                }
                self.planner.swing(phase, joints, self.gripper);
            }
            Motion::Move(place, height, speed) => {
                let at = above(self.target(place), self.number(height)) + self.beside(place, &self.tool().rotation);
                self.line(phase, at, self.limit(speed.as_ref()))?;
            }
            Motion::Grasp(place) => {
                let at = self.target(place) + self.beside(place, &self.tool().rotation);
                self.line(phase, at, self.careful(None))?;
                self.grip(phase, GripperCommand::Close);
                if let Frame::Part(of) = place.on {
                    self.in_hand = Some((of, self.tool().inverse() * self.part(of, self.joints[of])));
                }
            }
            Motion::Close => self.grip(phase, GripperCommand::Close),
            Motion::Release => {
                self.grip(phase, GripperCommand::Open);
                self.in_hand = None;
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
                self.follow(phase, *of, self.number(value), speed.as_ref())?;
            }
            Motion::Press(of, force) => {
                let Some(joint) = self.numbers.parts[*of].joint else { return Ok(()) };
                self.follow(phase, *of, joint.range[1], None)?;
                // The arm yields under the force, so the command goes on by as much.
                let along = self.part(*of, 0.0).rotation * joint.motion(1.0).translation.vector;
                let soft = compliance(self.robot, self.chain, self.planner.at(), 1.0);
                let further = along * (soft * along).dot(&along) * self.number(force);
                self.line(phase, self.tool().translation.vector + further, self.careful(None))?;
            }
            Motion::Wait(duration) => {
                let periods = (self.number(duration) / CONTROL_PERIOD_S).ceil().clamp(1.0, 1200.0) as usize;
                self.planner.wait(phase, periods, self.gripper);
            }
            Motion::Home => {
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

    /// Brings the part in the hand to a height above a place, with the yaw of the place or a quarter turn of it.
    fn carry(&mut self, phase: Word, place: &Place, height: f64, speed: Option<&Value>) -> Result<(), Unreachable> {
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
        self.planner.straight(phase, &[poses[chosen]], self.careful(speed), self.gripper)
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
        self.joints[of] = to;
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
