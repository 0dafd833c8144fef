//! The skills of an expert, as a file names them.

use robogate_core::Word;
use robogate_physics::GripperCommand;

use super::conditions::{Compiler, Value};
use super::numbers::{Frame, Place};
use super::syntax::{Node, What, Wrong};
use super::units::Dimension;

/// A skill with its arguments.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Skill {
    pub(super) phase: Word,
    pub(super) what: Motion,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Motion {
    /// Swing over a place with an open or a closed gripper.
    Approach(Place, Value, GripperCommand),
    /// Swing over a place to a height above the table.
    Over(Place, Value),
    /// Straight up to a height above the table, and straight on over a place, with a speed and an acceleration.
    Transfer(Place, Value, Option<Value>, Option<Value>),
    /// Straight up to a height above the table.
    Rise(Value),
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
    /// Bring the part in the hand by touch into a hole: where it is in the end, the depth of the hole, the force, and the range
    /// within which the hole catches it.
    Insert(Place, Value, Value, Option<Value>),
    /// Turn the tool about the vertical.
    Twist(Value, Option<Value>),
    Wait(Value),
    /// Wait until a part on a belt has come to a place, where it stops.
    Await(usize, Place),
    Home,
}

impl Skill {
    /// Whether it starts from where the tool is and goes nowhere in particular. After `insert`, that is where the part was inserted.
    pub(super) fn is_relative(&self) -> bool {
        use Motion::{Close, Follow, Lift, Press, Release, Rise, Shift, Twist, Wait};
        matches!(
            self.what,
            Close | Release | Lift(_) | Rise(_) | Shift(..) | Follow(..) | Press(..) | Twist(..) | Wait(_)
        )
    }

    /// The part that it grasps.
    pub(super) fn grasped(&self) -> Option<usize> {
        match &self.what {
            Motion::Grasp(Place { on: Frame::Part(of), .. }) => Some(*of),
            _ => None,
        }
    }
}

/// The skills with their arguments.
const SKILLS: [(&str, &str); 20] = [
    ("over", "over(PLACE, HEIGHT)"),
    ("transfer", "transfer(PLACE, HEIGHT[, SPEED[, ACCELERATION]])"),
    ("rise", "rise(HEIGHT)"),
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
    ("insert", "insert(PLACE, DEPTH, FORCE[, CATCH])"),
    ("twist", "twist(ANGLE[, SPEED])"),
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
    let length = |compiler: &mut Compiler<'_>, node: &Node| compiler.constant(node, Dimension::LENGTH);
    let over = |compiler: &mut Compiler<'_>, place: &Node, height: &Node| {
        Ok::<_, Wrong>((compiler.place(place)?, compiler.constant(height, Dimension::LENGTH)?))
    };
    let what = match (&**name, &arguments[..]) {
        ("approach" | "reach", [place, height]) => {
            let command = if name == "reach" { GripperCommand::Close } else { GripperCommand::Open };
            let (place, height) = over(compiler, place, height)?;
            Motion::Approach(place, height, command)
        }
        ("over", [place, height]) => {
            let (place, height) = over(compiler, place, height)?;
            Motion::Over(place, height)
        }
        ("rise", [height]) => Motion::Rise(length(compiler, height)?),
        ("move" | "carry", [place, height, speed @ ..]) if speed.len() < 2 => {
            let (place, height) = over(compiler, place, height)?;
            let speed = optional(compiler, speed, Dimension::SPEED)?;
            if name == "move" { Motion::Move(place, height, speed) } else { Motion::Carry(place, height, speed) }
        }
        ("transfer", [place, height, limits @ ..]) if limits.len() < 3 => {
            let (place, height) = over(compiler, place, height)?;
            let speed = optional(compiler, limits, Dimension::SPEED)?;
            let rest = limits.get(1..).unwrap_or_default();
            Motion::Transfer(place, height, speed, optional(compiler, rest, Dimension::ACCELERATION)?)
        }
        ("grasp", [place]) => Motion::Grasp(compiler.place(place)?),
        ("close", []) => Motion::Close,
        ("release", []) => Motion::Release,
        ("home", []) => Motion::Home,
        ("lift", [height]) => Motion::Lift(length(compiler, height)?),
        ("shift", [x, y, z, speed @ ..]) if speed.len() < 2 => {
            let by = [length(compiler, x)?, length(compiler, y)?, length(compiler, z)?];
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
            names.joint(part.at, of)?;
            Motion::Press(of, compiler.constant(force, Dimension::FORCE)?)
        }
        ("insert", [place, depth, force, catch @ ..]) if catch.len() < 2 => {
            let (place, depth) = over(compiler, place, depth)?;
            let force = compiler.constant(force, Dimension::FORCE)?;
            Motion::Insert(place, depth, force, optional(compiler, catch, Dimension::LENGTH)?)
        }
        ("twist", [angle, speed @ ..]) if speed.len() < 2 => {
            let angle = compiler.constant(angle, Dimension::ANGLE)?;
            Motion::Twist(angle, optional(compiler, speed, Dimension::TURNING)?)
        }
        ("wait", [duration]) => Motion::Wait(compiler.constant(duration, Dimension::TIME)?),
        ("await", [part, place]) => Motion::Await(names.part(part)?, compiler.place(place)?),
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
