//! Conditions and values over an episode, compiled once.

use nalgebra::{Isometry3, Point3, Vector3};
use robogate_physics::Side;

use super::names::{Names, Region};
use super::numbers::{Frame, Layout, PartNumbers, Place};
use super::statics::{self, Level};
use super::syntax::{Node, Operator, What, Wrong};
use super::units::Dimension;
use crate::arm::{Bodies, Sight, touching};

/// A body is at rest below this speed, in m/s ...
const REST_SPEED: f64 = 0.01;
/// ... and this angular speed, in rad/s.
const REST_SPIN: f64 = 0.2;
/// A part is upright if its axis leans by less than this, in radians.
const UPRIGHT_RAD: f64 = 0.262;

/// A side of a contact: the robot, or a body with all of its shapes.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Body {
    Robot,
    Part(usize),
    /// Indices of its shapes in the scene.
    Fixture(std::ops::Range<usize>),
}

impl Body {
    /// Its shapes in the scene.
    fn sides(&self) -> impl Iterator<Item = Side> {
        let (side, shapes): (fn(usize) -> Side, _) = match self {
            Self::Robot => (|_| Side::Robot, 0..1),
            Self::Part(of) => (Side::Body, *of..of + 1),
            Self::Fixture(shapes) => (Side::Fixture, shapes.clone()),
        };
        shapes.map(side)
    }
}

/// A number during an episode.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    Constant(f64),
    Parameter(usize),
    /// Value of a joint.
    Joint(usize),
    Speed(usize),
    Force(Body, Body),
    Distance(Place, Place),
    /// A coordinate of a place in the frame of the robot's base: x, y or z.
    Coordinate(Place, usize),
    /// The length of the vector with these two coordinates.
    Hypot(Box<Value>, Box<Value>),
    Tilt(usize),
    /// How far the part in the hand has moved there. `NaN` without one.
    Slip,
    /// The largest contact force on the robot, less the grip force while the gripper closes or holds.
    Press,
    /// How far a stack of these parts is from tipping.
    Stability(Vec<usize>),
    Moved(usize),
    Time,
    Binary(Operator, Box<Value>, Box<Value>),
}

/// A condition. Conditions over time have a slot in the memory of the episode.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Condition {
    Less(Value, Value),
    Contact(Body, Body),
    Held(usize),
    Dropped(usize),
    /// The gripper closed without a part.
    Missed,
    /// A part left the closed gripper.
    Lost(usize),
    /// The gripper let go of a part, and has not closed since.
    Released(usize),
    /// The robot touches the part that the gripper acts on, and it is this one.
    Touched(usize),
    /// The part that the gripper acts on is this one, and touches something else than the robot.
    Supported(usize),
    AtRest(usize),
    /// The condition with a name whose result this slot has: the time of the step if it holds there.
    Named(usize),
    Inside(Place, Region),
    /// A part touches a body below its middle.
    On(usize, Body, Place),
    And(Box<Condition>, Box<Condition>),
    Or(Box<Condition>, Box<Condition>),
    Not(Box<Condition>),
    /// It has held for so long without a break. The slot has the time at which it began.
    For(Box<Condition>, Value, usize),
    /// It has held at some time. The slot has that time.
    Once(Box<Condition>, usize),
    /// The first one holds, and the second one has held in so long a time. The slot has the last time of the second one.
    Within(Box<Condition>, Value, Box<Condition>, usize),
    /// The first one has held when the second one had not yet held. The slots have their first times.
    Before(Box<Condition>, Box<Condition>, [usize; 2]),
}

/// What conditions are about, in one time step.
pub(super) struct Now<'a> {
    pub(super) sight: &'a Sight<'a>,
    pub(super) layout: &'a Layout,
    /// Values of the parameters and settings.
    pub(super) values: &'a [f64],
    pub(super) parts: &'a [PartNumbers],
    /// Positions of the parts at the start.
    pub(super) starts: &'a [Vector3<f64>],
    /// The part in the hand.
    pub(super) held: Option<usize>,
    /// What the gripper did so far.
    pub(super) hand: &'a Hand,
}

/// What the gripper did so far.
#[derive(Debug, Default)]
pub(super) struct Hand {
    /// The part that the gripper acts on.
    pub(super) selected: usize,
    /// Whether each part was lost, or fell after its release.
    pub(super) dropped: Vec<bool>,
    pub(super) lost: Vec<bool>,
    /// Where each part was released for the last time, in metres.
    pub(super) released_at: Vec<Option<Vector3<f64>>>,
    /// The part that it let go of, if it has not closed since.
    pub(super) released: Option<usize>,
    /// Whether it closed without a part.
    pub(super) missed: bool,
    /// How far the part in the hand has moved there, in metres.
    pub(super) slip_m: Option<f64>,
    /// The grip force while it closes or holds, in newtons.
    pub(super) grip_n: f64,
}

impl Now<'_> {
    fn bodies(&self) -> &dyn Bodies {
        self.sight.bodies
    }

    fn frame(&self, frame: Frame) -> Isometry3<f64> {
        match frame {
            Frame::World => Isometry3::identity(),
            Frame::Tool => self.sight.view.tcp,
            Frame::Fixture(of) => self.layout.fixture(of, self.sight.time),
            Frame::Part(of) => self.bodies().pose(of),
            Frame::Release(of) => {
                let at = self.hand.released_at[of].unwrap_or_else(|| self.bodies().pose(of).translation.vector);
                Isometry3::from_parts(at.into(), nalgebra::UnitQuaternion::identity())
            }
        }
    }

    fn point(&self, place: &Place) -> Point3<f64> {
        let at = self.frame(place.on) * Point3::from(place.point);
        match &place.shift[..] {
            [x, y, z] => at + Vector3::new(x.now(self), y.now(self), z.now(self)),
            _ => at,
        }
    }

    /// How far a stack of cubes is from tipping, in metres.
    fn stability(&self, parts: &[usize]) -> f64 {
        let level = |of: &usize| {
            let at = self.bodies().pose(*of).translation;
            Level { at: [at.x, at.y], mass_kg: self.parts[*of].mass_kg }
        };
        let size = parts.first().and_then(|of| self.parts[*of].size_m());
        size.map_or(f64::NAN, |size| statics::margin(&parts.iter().map(level).collect::<Vec<_>>(), size))
    }

    /// Force between two bodies, in newtons. `None` if they do not touch.
    pub(super) fn force(&self, one: &Body, other: &Body) -> Option<f64> {
        let mut sum = None;
        for one in one.sides() {
            for other in other.sides() {
                if let Some(force) = self.bodies().force_between(one, other) {
                    *sum.get_or_insert(0.0) += force;
                }
            }
        }
        sum
    }

    fn is_inside(&self, place: &Place, region: &Region) -> bool {
        let point = self.frame(region.on).inverse_transform_point(&self.point(place)) - region.at;
        point.coords.iter().zip(region.half).all(|(x, half)| x.abs() <= half)
    }
}

impl Value {
    pub(super) fn now(&self, now: &Now<'_>) -> f64 {
        match self {
            Self::Constant(value) => *value,
            Self::Parameter(of) => now.values[*of],
            Self::Joint(of) => now.bodies().joint(*of).map_or(0.0, |[value, _]| value),
            Self::Speed(of) => match now.bodies().joint(*of) {
                Some([_, speed]) => speed.abs(),
                None => now.bodies().velocity(*of).0.norm(),
            },
            Self::Force(one, other) => now.force(one, other).unwrap_or(0.0),
            Self::Distance(one, other) => (now.point(one) - now.point(other)).norm(),
            Self::Coordinate(place, axis) => now.point(place)[*axis],
            Self::Hypot(one, other) => one.now(now).hypot(other.now(now)),
            Self::Slip => now.hand.slip_m.unwrap_or(f64::NAN),
            Self::Press => now.sight.view.touches.peak_force.unwrap_or(0.0) - now.hand.grip_n,
            Self::Stability(parts) => now.stability(parts),
            Self::Tilt(of) => (now.bodies().pose(*of).rotation * Vector3::z()).z.clamp(-1.0, 1.0).acos(),
            Self::Moved(of) => (now.bodies().pose(*of).translation.vector - now.starts[*of]).norm(),
            Self::Time => now.sight.time,
            Self::Binary(operator, one, other) => apply(*operator, one.now(now), other.now(now)),
        }
    }

    /// The value if it follows from the parameters alone.
    pub(super) fn constant(&self, values: &[f64]) -> Option<f64> {
        match self {
            Self::Constant(value) => Some(*value),
            Self::Parameter(of) => values.get(*of).copied(),
            Self::Binary(operator, one, other) => {
                Some(apply(*operator, one.constant(values)?, other.constant(values)?))
            }
            _ => None,
        }
    }

    /// Whether it is, or contains, a value of this kind.
    fn has(&self, kind: &dyn Fn(&Self) -> bool) -> bool {
        kind(self)
            || match self {
                Self::Binary(_, one, other) | Self::Hypot(one, other) => one.has(kind) || other.has(kind),
                _ => false,
            }
    }

    pub(super) fn depends_on(&self, parameter: usize) -> bool {
        self.has(&|value| *value == Self::Parameter(parameter))
    }

    /// Whether only an engine of this process reports it.
    pub(super) fn is_local(&self) -> bool {
        self.has(&|value| matches!(value, Self::Joint(_) | Self::Force(..)))
    }
}

fn apply(operator: Operator, one: f64, other: f64) -> f64 {
    match operator {
        Operator::Plus => one + other,
        Operator::Minus => one - other,
        Operator::Times => one * other,
        Operator::Over => one / other,
        Operator::Or | Operator::And | Operator::Before | Operator::Less | Operator::Greater => f64::NAN,
    }
}

impl Condition {
    /// Whether it holds now. Every part of it is evaluated in every step, so that its memory is complete.
    pub(super) fn now(&self, now: &Now<'_>, memory: &mut [f64]) -> bool {
        let time = now.sight.time;
        match self {
            Self::Less(one, other) => one.now(now) < other.now(now),
            Self::Contact(one, other) => now.force(one, other).is_some(),
            Self::Held(of) => now.held == Some(*of),
            Self::Dropped(of) => now.hand.dropped[*of],
            Self::Missed => now.hand.missed,
            Self::Lost(of) => now.hand.lost[*of],
            Self::Released(of) => now.hand.released == Some(*of),
            Self::Touched(of) => {
                let view = now.sight.view;
                now.hand.selected == *of && (view.touches.body_on_object || touching(view))
            }
            Self::Supported(of) => now.hand.selected == *of && now.sight.view.touches.object_on_fixture,
            Self::Named(slot) => memory[*slot].is_finite(),
            Self::AtRest(of) => {
                let (linear, angular) = now.bodies().velocity(*of);
                linear.norm() < REST_SPEED && angular.norm() < REST_SPIN
            }
            Self::Inside(place, region) => now.is_inside(place, region),
            Self::On(of, body, below) => {
                let height = now.bodies().pose(*of).translation.z;
                now.force(&Body::Part(*of), body).is_some() && height > now.point(below).z
            }
            Self::And(one, other) => one.now(now, memory) & other.now(now, memory),
            Self::Or(one, other) => one.now(now, memory) | other.now(now, memory),
            Self::Not(of) => !of.now(now, memory),
            Self::For(of, duration, slot) => {
                let holds = of.now(now, memory);
                memory[*slot] = if holds { memory[*slot].min(time) } else { f64::INFINITY };
                holds && time - memory[*slot] >= duration.now(now) - 1e-9
            }
            Self::Once(of, slot) => {
                if of.now(now, memory) {
                    memory[*slot] = memory[*slot].min(time);
                }
                memory[*slot].is_finite()
            }
            Self::Within(of, duration, other, slot) => {
                let holds = of.now(now, memory);
                if other.now(now, memory) {
                    memory[*slot] = time;
                }
                holds && time - memory[*slot] <= duration.now(now) + 1e-9 && memory[*slot].is_finite()
            }
            Self::Before(one, other, [first, second]) => {
                for (condition, slot) in [(one, *first), (other, *second)] {
                    if condition.now(now, memory) {
                        memory[slot] = memory[slot].min(time);
                    }
                }
                memory[*first] < memory[*second]
            }
        }
    }

    /// Whether it can change while nothing moves and nothing touches anew, after this time (s).
    pub(super) fn can_change_at_rest(&self, memory: &[f64], values: &[f64], time: f64) -> bool {
        let can = |of: &Self| of.can_change_at_rest(memory, values, time);
        let timed = |value: &Value| value.has(&|value| *value == Value::Time);
        match self {
            Self::Less(one, other) => timed(one) || timed(other),
            Self::And(one, other) | Self::Or(one, other) | Self::Before(one, other, _) => can(one) || can(other),
            Self::Not(of) | Self::Once(of, _) => can(of),
            // A time that has passed has no second effect.
            Self::For(of, duration, slot) => {
                let passes = duration.constant(values).is_none_or(|duration| time - memory[*slot] < duration - 1e-9);
                can(of) || memory[*slot].is_finite() && passes
            }
            Self::Within(..) => true,
            _ => false,
        }
    }

    /// Whether only an engine of this process reports what it depends on.
    pub(super) fn is_local(&self) -> bool {
        match self {
            Self::Contact(..) | Self::On(..) => true,
            Self::Less(one, other) => one.is_local() || other.is_local(),
            Self::And(one, other) | Self::Or(one, other) | Self::Before(one, other, _) => {
                one.is_local() || other.is_local()
            }
            Self::Within(one, _, other, _) => one.is_local() || other.is_local(),
            Self::Not(of) | Self::Once(of, _) | Self::For(of, ..) => of.is_local(),
            _ => false,
        }
    }

    /// Passes every comparison of a joint with a number to `sink`: the part, and the number.
    pub(super) fn thresholds(&self, sink: &mut dyn FnMut(usize, &Value)) {
        match self {
            Self::Less(Value::Joint(of), number) | Self::Less(number, Value::Joint(of)) => sink(*of, number),
            Self::And(one, other) | Self::Or(one, other) | Self::Before(one, other, _) => {
                one.thresholds(sink);
                other.thresholds(sink);
            }
            Self::Within(one, _, other, _) => {
                one.thresholds(sink);
                other.thresholds(sink);
            }
            Self::Not(of) | Self::Once(of, _) | Self::For(of, ..) => of.thresholds(sink),
            _ => {}
        }
    }
}

/// The functions that are values, with their arguments.
const VALUES: [(&str, &str); 14] = [
    ("x", "x(PLACE)"),
    ("y", "y(PLACE)"),
    ("hypot", "hypot(VALUE, VALUE)"),
    ("slip", "slip()"),
    ("press", "press()"),
    ("stability", "stability(PART, PART, ...)"),
    ("joint", "joint(PART)"),
    ("speed", "speed(PART)"),
    ("force", "force(BODY, BODY)"),
    ("distance", "distance(PLACE, PLACE)"),
    ("height", "height(PLACE)"),
    ("tilt", "tilt(PART)"),
    ("moved", "moved(PART)"),
    ("time", "time()"),
];

/// The functions that are conditions, with their arguments.
const CONDITIONS: [(&str, &str); 13] = [
    ("missed", "missed()"),
    ("lost", "lost(PART)"),
    ("released", "released(PART)"),
    ("touched", "touched(PART)"),
    ("supported", "supported(PART)"),
    ("contact", "contact(BODY, BODY)"),
    ("held", "held(PART)"),
    ("dropped", "dropped(PART)"),
    ("at_rest", "at_rest(PART)"),
    ("inside", "inside(PLACE, REGION)"),
    ("on", "on(PART, BODY)"),
    ("upright", "upright(PART)"),
    ("once", "once(CONDITION)"),
];

/// Compiles conditions and values, and counts the slots of their memory.
pub(super) struct Compiler<'a> {
    pub(super) names: &'a Names,
    pub(super) slots: usize,
}

impl Compiler<'_> {
    fn slot(&mut self) -> usize {
        self.slots += 1;
        self.slots - 1
    }

    fn boxed(&mut self, node: &Node) -> Result<Box<Condition>, Wrong> {
        self.condition(node).map(Box::new)
    }

    /// Compiles a condition.
    ///
    /// # Errors
    /// The first problem.
    pub(super) fn condition(&mut self, node: &Node) -> Result<Condition, Wrong> {
        match &node.what {
            What::Binary(Operator::Or, one, other) => Ok(Condition::Or(self.boxed(one)?, self.boxed(other)?)),
            What::Binary(Operator::And, one, other) => Ok(Condition::And(self.boxed(one)?, self.boxed(other)?)),
            What::Binary(Operator::Before, one, other) => {
                Ok(Condition::Before(self.boxed(one)?, self.boxed(other)?, [self.slot(), self.slot()]))
            }
            What::Binary(operator @ (Operator::Less | Operator::Greater), one, other) => {
                let ((one, first), (other, second)) = (self.value(one)?, self.value(other)?);
                if first != second {
                    return Err((node.at, format!("the sides do not fit: {first}, and {second}")));
                }
                Ok(if *operator == Operator::Less { Condition::Less(one, other) } else { Condition::Less(other, one) })
            }
            What::Not(of) => Ok(Condition::Not(self.boxed(of)?)),
            What::For(of, time) => Ok(Condition::For(self.boxed(of)?, self.duration(time)?, self.slot())),
            What::Within(one, time, other) => {
                Ok(Condition::Within(self.boxed(one)?, self.duration(time)?, self.boxed(other)?, self.slot()))
            }
            What::Call(name, arguments) => self.call(node.at, name, arguments),
            What::Name(name) if !self.names.conditions.is_empty() => {
                let known = self.names.conditions.iter();
                let found = known.clone().find(|(known, _)| known == name).map(|(_, slot)| Condition::Named(*slot));
                let hint = || robogate_core::hint(name, known.map(|(known, _)| known.as_str()));
                found.ok_or_else(|| (node.at, format!("unknown condition `{name}`: {}", hint())))
            }
            What::Number(_) | What::Parameter(_) | What::Name(_) | What::Negative(_) | What::Binary(..) => {
                Err((node.at, "found a value. Expected a condition, such as `joint(drawer) > 10 cm`".to_owned()))
            }
        }
    }

    /// A place: a name, or `offset(PLACE, X, Y, Z)`.
    ///
    /// # Errors
    /// The first problem.
    pub(super) fn place(&mut self, node: &Node) -> Result<Place, Wrong> {
        let What::Call(name, arguments) = &node.what else { return self.names.place(node) };
        let (true, [place, by @ ..]) = (name == "offset" && arguments.len() == 4, &arguments[..]) else {
            return Err((node.at, "expected a place, such as `lid` or `offset(lid, 0 cm, 0 cm, 5 cm)`".to_owned()));
        };
        let place = self.names.place(place)?;
        let shift = by.iter().map(|by| self.constant(by, Dimension::LENGTH)).collect::<Result<_, _>>()?;
        Ok(Place { shift, ..place })
    }

    fn duration(&mut self, node: &Node) -> Result<Value, Wrong> {
        self.constant(node, Dimension::TIME)
    }

    /// Compiles a value of this dimension that follows from the parameters alone.
    ///
    /// # Errors
    /// The first problem.
    pub(super) fn constant(&mut self, node: &Node, dimension: Dimension) -> Result<Value, Wrong> {
        let (value, found) = self.value(node)?;
        let zero = value == Value::Constant(0.0);
        if found != dimension && !zero {
            return Err((node.at, format!("the number does not fit. Expected {dimension}")));
        }
        match value.constant(&self.names.nominal) {
            Some(number) if number.is_finite() => Ok(value),
            _ => Err((node.at, "the number depends on the episode. Expected a number or a parameter".to_owned())),
        }
    }

    fn call(&mut self, at: usize, name: &str, arguments: &[Node]) -> Result<Condition, Wrong> {
        let names = self.names;
        match (name, arguments) {
            ("contact", [one, other]) => Ok(Condition::Contact(names.body(one)?, names.body(other)?)),
            ("held", [part]) => Ok(Condition::Held(names.part(part)?)),
            ("missed", []) => Ok(Condition::Missed),
            ("lost", [part]) => Ok(Condition::Lost(names.part(part)?)),
            ("released", [part]) => Ok(Condition::Released(names.part(part)?)),
            ("touched", [part]) => Ok(Condition::Touched(names.part(part)?)),
            ("supported", [part]) => Ok(Condition::Supported(names.part(part)?)),
            ("dropped", [part]) => Ok(Condition::Dropped(names.part(part)?)),
            ("at_rest", [part]) => Ok(Condition::AtRest(names.part(part)?)),
            ("inside", [place, region]) => Ok(Condition::Inside(self.place(place)?, names.region(region)?)),
            ("on", [part, body]) => Ok(Condition::On(names.part(part)?, names.body(body)?, names.place(body)?)),
            ("upright", [part]) => Ok(Condition::Less(Value::Tilt(names.part(part)?), Value::Constant(UPRIGHT_RAD))),
            ("once", [condition]) => Ok(Condition::Once(self.boxed(condition)?, self.slot())),
            _ => Err(misuse(at, name, &CONDITIONS, &VALUES, "a condition")),
        }
    }

    /// Compiles a value, and returns its dimension.
    ///
    /// # Errors
    /// The first problem.
    pub(super) fn value(&mut self, node: &Node) -> Result<(Value, Dimension), Wrong> {
        let names = self.names;
        match &node.what {
            What::Number(quantity) => Ok((Value::Constant(quantity.value), quantity.dimension)),
            What::Parameter(name) => {
                let (of, dimension) = names.parameter(node.at, name)?;
                Ok((Value::Parameter(of), dimension))
            }
            What::Negative(of) => {
                let (value, dimension) = self.value(of)?;
                let minus = Value::Constant(-1.0);
                Ok((Value::Binary(Operator::Times, Box::new(minus), Box::new(value)), dimension))
            }
            What::Binary(operator, one, other) => {
                let ((one, first), (other, second)) = (self.value(one)?, self.value(other)?);
                let dimension = match operator {
                    Operator::Plus | Operator::Minus if first == second => first,
                    Operator::Times => first.times(second),
                    Operator::Over => first.over(second),
                    Operator::Plus | Operator::Minus => {
                        return Err((node.at, format!("the sides do not fit: {first}, and {second}")));
                    }
                    _ => return Err((node.at, "found a condition. Expected a value".to_owned())),
                };
                Ok((Value::Binary(*operator, Box::new(one), Box::new(other)), dimension))
            }
            What::Call(name, arguments) => match (&**name, &arguments[..]) {
                ("joint", [part]) => {
                    let of = names.part(part)?;
                    Ok((Value::Joint(of), names.joint(part.at, of)?))
                }
                ("speed", [part]) => {
                    let of = names.part(part)?;
                    Ok((Value::Speed(of), names.joint(0, of).unwrap_or(Dimension::LENGTH).over(Dimension::TIME)))
                }
                ("force", [one, other]) => Ok((Value::Force(names.body(one)?, names.body(other)?), Dimension::FORCE)),
                ("distance", [one, other]) => {
                    Ok((Value::Distance(self.place(one)?, self.place(other)?), Dimension::LENGTH))
                }
                ("x", [place]) => Ok((Value::Coordinate(self.place(place)?, 0), Dimension::LENGTH)),
                ("y", [place]) => Ok((Value::Coordinate(self.place(place)?, 1), Dimension::LENGTH)),
                ("height", [place]) => Ok((Value::Coordinate(self.place(place)?, 2), Dimension::LENGTH)),
                ("hypot", [one, other]) => {
                    let ((one, first), (other, second)) = (self.value(one)?, self.value(other)?);
                    if first != second {
                        return Err((node.at, format!("the sides do not fit: {first}, and {second}")));
                    }
                    Ok((Value::Hypot(Box::new(one), Box::new(other)), first))
                }
                ("slip", []) => Ok((Value::Slip, Dimension::LENGTH)),
                ("press", []) => Ok((Value::Press, Dimension::FORCE)),
                ("stability", parts @ [_, _, ..]) => {
                    let parts = parts.iter().map(|part| names.part(part)).collect::<Result<_, _>>()?;
                    Ok((Value::Stability(parts), Dimension::LENGTH))
                }
                ("tilt", [part]) => Ok((Value::Tilt(names.part(part)?), Dimension::ANGLE)),
                ("moved", [part]) => Ok((Value::Moved(names.part(part)?), Dimension::LENGTH)),
                ("time", []) => Ok((Value::Time, Dimension::TIME)),
                _ => Err(misuse(node.at, name, &VALUES, &CONDITIONS, "a value")),
            },
            What::Name(name) => {
                Err((node.at, format!("found `{name}`. Expected a number, or a value such as `joint({name})`")))
            }
            What::Not(_) | What::For(..) | What::Within(..) => {
                Err((node.at, "found a condition. Expected a value".to_owned()))
            }
        }
    }
}

/// The error of a function that is unknown, is of the other kind, or has other arguments.
fn misuse(at: usize, name: &str, own: &[(&str, &str)], others: &[(&str, &str)], wanted: &str) -> Wrong {
    if let Some((_, form)) = own.iter().find(|(known, _)| *known == name) {
        return (at, format!("`{name}` has other arguments. Expected `{form}`"));
    }
    if others.iter().any(|(known, _)| *known == name) {
        return (at, format!("`{name}` is not {wanted}. Expected {wanted} here"));
    }
    (at, format!("unknown word `{name}`: {}", robogate_core::hint(name, own.iter().map(|(known, _)| *known))))
}
