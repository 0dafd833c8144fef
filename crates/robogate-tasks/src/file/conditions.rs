//! Conditions and values over an episode, compiled once.

use nalgebra::{Isometry3, Point3, Vector3};
use robogate_physics::Side;

use super::names::{Names, Region};
use super::numbers::{Frame, Layout, Place};
use super::syntax::{Node, Operator, What, Wrong};
use super::units::Dimension;
use crate::arm::{Bodies, Sight};

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
    Height(Place),
    Tilt(usize),
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
    AtRest(usize),
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
    /// Values of the parameters.
    pub(super) values: &'a [f64],
    /// Positions of the parts at the start.
    pub(super) starts: &'a [Vector3<f64>],
    /// The part in the hand.
    pub(super) held: Option<usize>,
    /// Whether each part was lost, or fell after its release.
    pub(super) dropped: &'a [bool],
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
        }
    }

    fn point(&self, place: &Place) -> Point3<f64> {
        self.frame(place.on) * Point3::from(place.point)
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
            Self::Height(place) => now.point(place).z,
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

    fn has_time(&self) -> bool {
        match self {
            Self::Time => true,
            Self::Binary(_, one, other) => one.has_time() || other.has_time(),
            _ => false,
        }
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
            Self::Dropped(of) => now.dropped[*of],
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

    /// Whether it can change while nothing moves and nothing touches anew.
    pub(super) fn can_change_at_rest(&self, memory: &[f64]) -> bool {
        match self {
            Self::Less(one, other) => one.has_time() || other.has_time(),
            Self::And(one, other) | Self::Or(one, other) | Self::Before(one, other, _) => {
                one.can_change_at_rest(memory) || other.can_change_at_rest(memory)
            }
            Self::Not(of) | Self::Once(of, _) => of.can_change_at_rest(memory),
            Self::For(of, _, slot) => of.can_change_at_rest(memory) || memory[*slot].is_finite(),
            Self::Within(..) => true,
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
const VALUES: [(&str, &str); 8] = [
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
const CONDITIONS: [(&str, &str); 8] = [
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
            What::Number(_) | What::Parameter(_) | What::Name(_) | What::Negative(_) | What::Binary(..) => {
                Err((node.at, "found a value. Expected a condition, such as `joint(drawer) > 10 cm`".to_owned()))
            }
        }
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
            ("dropped", [part]) => Ok(Condition::Dropped(names.part(part)?)),
            ("at_rest", [part]) => Ok(Condition::AtRest(names.part(part)?)),
            ("inside", [place, region]) => Ok(Condition::Inside(names.place(place)?, names.region(region)?)),
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
                    Ok((Value::Distance(names.place(one)?, names.place(other)?), Dimension::LENGTH))
                }
                ("height", [place]) => Ok((Value::Height(names.place(place)?), Dimension::LENGTH)),
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
