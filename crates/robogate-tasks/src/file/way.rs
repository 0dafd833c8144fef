//! The way of a tool that moves in small steps, from the skills of an expert.

use nalgebra::{Isometry3, Vector3};

use super::expert::Cell;
use super::model::Model;
use super::numbers::{Frame, Place};
use super::skills::{Motion, Skill};
use crate::arm::{FINELY, FREELY, Way};

/// Distance to the end of a careful motion with a part from which a tool goes finely, in metres.
const APPROACH_M: f64 = 0.01;

/// Whether every skill of the expert is one that a tool in small steps has: nothing moves, and no part is on a joint.
pub(super) fn exists(model: &Model) -> bool {
    let known = |skill: &Skill| {
        !matches!(
            skill.what,
            Motion::Follow(..) | Motion::Press(..) | Motion::Wait(_) | Motion::Await(..) | Motion::Home
        )
    };
    let moves = model.nominal.motions.iter().any(Option::is_some);
    !moves && model.nominal.parts.iter().all(|part| part.joint.is_none()) && model.skills(0).iter().all(known)
}

/// The way of an episode.
pub(super) fn way(cell: &Cell<'_>) -> Way {
    let mut walk = Walk { cell, way: Way::for_square(cell.gripper()), at: Vector3::zeros(), closed: false, held: None };
    cell.model.skills(cell.numbers.word).iter().for_each(|skill| walk.add(skill));
    walk.way
}

struct Walk<'a> {
    cell: &'a Cell<'a>,
    way: Way,
    at: Vector3<f64>,
    closed: bool,
    /// The part in the hand, and its origin from the tool, in metres.
    held: Option<(usize, Vector3<f64>)>,
}

impl Walk<'_> {
    fn frame(&self, place: &Place) -> Isometry3<f64> {
        match place.on {
            Frame::World | Frame::Release(_) => Isometry3::identity(),
            Frame::Tool => Isometry3::translation(self.at.x, self.at.y, self.at.z),
            Frame::Fixture(of) => self.cell.layout.fixtures[of],
            Frame::Part(of) => {
                let pose = self.cell.layout.parts[of];
                match self.held {
                    Some((held, from_tool)) if held == of => {
                        Isometry3::from_parts((self.at + from_tool).into(), pose.rotation)
                    }
                    _ => pose,
                }
            }
        }
    }

    fn target(&self, place: &Place) -> Vector3<f64> {
        self.cell.target(place, &self.frame(place))
    }

    fn go(&mut self, skill: &Skill, to: Vector3<f64>) {
        self.way.go(skill.phase, to.into(), &FREELY, self.closed);
        self.at = to;
    }

    fn grip(&mut self, skill: &Skill, closed: bool) {
        self.closed = closed;
        self.way.grip(skill.phase, closed);
    }

    /// Where the tool is when the part in the hand is at a place.
    fn over(&self, place: &Place) -> Vector3<f64> {
        let at = self.cell.at(place, &self.frame(place)).translation.vector;
        at - self.held.map_or_else(Vector3::zeros, |(_, from_tool)| from_tool)
    }

    /// Brings the part in the hand down to a place.
    fn lower(&mut self, skill: &Skill, to: Vector3<f64>) {
        if (self.at - to).norm() > APPROACH_M {
            self.go(skill, to + Vector3::new(0.0, 0.0, APPROACH_M));
        }
        self.way.go(skill.phase, to.into(), &FINELY, self.closed);
        self.at = to;
    }

    fn add(&mut self, skill: &Skill) {
        let up = |height: &super::conditions::Value| Vector3::new(0.0, 0.0, self.cell.number(height));
        match &skill.what {
            Motion::Move(place, height, _) if self.held.is_some() => self.lower(skill, self.target(place) + up(height)),
            Motion::Approach(place, height, _) | Motion::Move(place, height, _) => {
                let to = self.target(place) + up(height);
                self.go(skill, to);
            }
            Motion::Over(place, height) => {
                let to = self.target(place);
                self.go(skill, Vector3::new(to.x, to.y, self.cell.number(height)));
            }
            Motion::Rise(height) => self.go(skill, Vector3::new(self.at.x, self.at.y, self.cell.number(height))),
            Motion::Transfer(place, height, ..) => {
                let (height, to) = (self.cell.number(height), self.over(place));
                self.go(skill, Vector3::new(self.at.x, self.at.y, height));
                self.go(skill, Vector3::new(to.x, to.y, height));
            }
            Motion::Carry(place, height, _) => self.lower(skill, self.over(place) + up(height)),
            Motion::Grasp(place) => {
                let to = self.target(place);
                if (self.at - to).norm() > super::expert::THERE_M {
                    self.go(skill, to);
                }
                self.grip(skill, true);
                if let Frame::Part(of) = place.on {
                    self.held = Some((of, self.frame(place).translation.vector - self.at));
                }
            }
            Motion::Close => self.grip(skill, true),
            Motion::Release => {
                self.grip(skill, false);
                self.held = None;
            }
            Motion::Lift(height) => {
                let to = self.at + up(height);
                self.go(skill, to);
            }
            Motion::Shift(by, _) => {
                let to = self.at + Vector3::from([0, 1, 2].map(|axis| self.cell.number(&by[axis])));
                self.go(skill, to);
            }
            // `exists` refuses these.
            Motion::Follow(..) | Motion::Press(..) | Motion::Wait(_) | Motion::Await(..) | Motion::Home => {}
        }
    }
}
