//! Contacts: friction coefficients, forces of the last step, and the load on the cup.

use std::cmp::Ordering;

use mujoco_rs::prelude::*;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use robogate_core::{ContactBetween, ContactPoint, Fault, Region};

use super::{Kind, Loaded};
use crate::contact_sums::Thing;
use crate::friction::{Against, Coefficients, Friction};
use crate::{Hit, Side, Touches, Wrench};

impl Loaded {
    /// The friction coefficients that act between the object and every body that it can touch.
    pub(super) fn friction(&self) -> Result<Friction, Fault> {
        let model = self.data.model();
        let object: Vec<(usize, usize)> = self.kinds.iter().enumerate().filter_map(object_geom).collect();
        let mut friction = Coefficients::default();
        for (geom, kind) in self.kinds.iter().enumerate() {
            let other = match *kind {
                Kind::Fixture(fixture) => (Side::Fixture(fixture), self.scene.fixtures[fixture].kind.against()),
                Kind::Robot { finger: Some(_), .. } => (Side::Robot, Against::Pad),
                Kind::Robot { finger: None, .. } => (Side::Robot, Against::Other),
                Kind::Object(body) => (Side::Body(body), Against::Other),
                Kind::Visual => continue,
            };
            for (part, body) in object.iter().filter(|(_, body)| other.0 != Side::Body(*body)) {
                friction.contact(&self.scene, *body, other, contact_friction(model, *part, geom));
            }
        }
        friction.finish()
    }

    /// Sums up the contacts of the last step. If two bodies touch at several points, their forces are added.
    pub(super) fn read_touches(&mut self) {
        let selected = self.selected;
        let touches = &mut self.touches;
        *touches = Touches::default();
        self.forces.clear();
        for (i, contact) in self.data.contact().iter().enumerate() {
            // Bodies that are close but do not touch have no constraint.
            if contact.efc_address < 0 || contact.geom1 < 0 || contact.geom2 < 0 {
                continue;
            }
            let force = self.data.contact_force(i)[0];
            // The normal points from the first shape to the second, and the force acts on the second.
            let normal = Vector3::new(contact.frame[0], contact.frame[1], contact.frame[2]);
            let is_robot = |geom: i32| matches!(self.kinds[geom as usize], Kind::Robot { .. });
            let (body, thing, normal) = match (self.kinds[contact.geom1 as usize], self.kinds[contact.geom2 as usize]) {
                (Kind::Robot { body, finger }, Kind::Object(object))
                | (Kind::Object(object), Kind::Robot { body, finger }) => {
                    match finger {
                        _ if object != selected => {}
                        Some(finger) => *touches.fingers[finger].get_or_insert(0.0) += force,
                        None => touches.body_on_object = true,
                    }
                    (body, Thing::Part(object), if is_robot(contact.geom1) { normal } else { -normal })
                }
                (Kind::Robot { body, .. }, Kind::Fixture(fixture)) => {
                    (body, Thing::Surroundings(Hit::Fixture(fixture)), normal)
                }
                (Kind::Fixture(fixture), Kind::Robot { body, .. }) => {
                    (body, Thing::Surroundings(Hit::Fixture(fixture)), -normal)
                }
                // The body nearer to the tool hits the other one.
                (Kind::Robot { body: one, .. }, Kind::Robot { body: two, .. }) => (
                    one.max(two),
                    Thing::Surroundings(Hit::Itself(one.min(two))),
                    if one > two { normal } else { -normal },
                ),
                (first, second) if first == Kind::Object(selected) || second == Kind::Object(selected) => {
                    touches.object_on_fixture = true;
                    continue;
                }
                _ => continue,
            };
            self.forces.add(body, self.regions[body], thing, force, normal);
        }
        self.forces.write(&self.regions, touches);
    }

    /// Wrench of the fixtures and the other free bodies on the object in the last step, about its centre of mass.
    pub(super) fn support(&self) -> Wrench {
        let object = Kind::Object(self.selected);
        let about = Vector3::from(self.data.xipos()[self.free[self.selected].body]);
        self.contact_wrench(about, |kind| kind == object, |kind| matches!(kind, Kind::Fixture(_) | Kind::Object(_)))
    }

    /// Wrench of everything but the robot on hand and fingers in the last step, about the tool centre point `tcp` and along its axes.
    /// `cup_load` is the wrench of the cup on the object that it holds.
    pub(super) fn hand_wrench(&self, tcp: &Isometry3<f64>, cup_load: Option<Wrench>) -> Wrench {
        let on_hand = |kind| matches!(kind, Kind::Robot { body, .. } if self.regions[body] != Region::Arm);
        // The load of the cup contains its contact with the object.
        let held = cup_load.map(|_| Kind::Object(self.selected));
        let outside = |kind| matches!(kind, Kind::Fixture(_) | Kind::Object(_)) && Some(kind) != held;
        self.contact_wrench(tcp.translation.vector, on_hand, outside).in_frame(tcp).minus(cup_load)
    }

    /// Wrench in the last step on shapes of one kind from those of another one, about the point `about`.
    fn contact_wrench(&self, about: Vector3<f64>, on: impl Fn(Kind) -> bool, from: impl Fn(Kind) -> bool) -> Wrench {
        let mut sum = Wrench::ZERO;
        for (i, contact) in self.data.contact().iter().enumerate() {
            if contact.efc_address < 0 || contact.geom1 < 0 || contact.geom2 < 0 {
                continue;
            }
            // The force acts on the second shape; the rows of the frame are its axes.
            let sign = match (self.kinds[contact.geom1 as usize], self.kinds[contact.geom2 as usize]) {
                (first, second) if on(first) && from(second) => -1.0,
                (first, second) if on(second) && from(first) => 1.0,
                _ => continue,
            };
            let axes = Matrix3::from_column_slice(&contact.frame) * sign;
            let [n, t1, t2, twist, r1, r2] = self.data.contact_force(i);
            let force = axes * Vector3::new(n, t1, t2);
            let arm = Vector3::from(contact.pos) - about;
            sum.force += force;
            sum.torque += axes * Vector3::new(twist, r1, r2) + arm.cross(&force);
        }
        sum
    }

    /// Sum of the normal forces between two sides in the last step, in newtons. `None` if they do not touch.
    pub(super) fn force_between(&self, one: Side, other: Side) -> Option<f64> {
        let is = |geom: i32, side: Side| match (self.kinds[geom as usize], side) {
            (Kind::Robot { .. }, Side::Robot) => true,
            (Kind::Object(body), Side::Body(wanted)) => body == wanted,
            (Kind::Fixture(fixture), Side::Fixture(wanted)) => fixture == wanted,
            _ => false,
        };
        let mut sum = None;
        for (i, contact) in self.data.contact().iter().enumerate() {
            let [first, second] = [contact.geom1, contact.geom2];
            if contact.efc_address < 0 || first < 0 || second < 0 {
                continue;
            }
            if is(first, one) && is(second, other) || is(first, other) && is(second, one) {
                *sum.get_or_insert(0.0) += self.data.contact_force(i)[0];
            }
        }
        sum
    }

    /// The contact points of the last step with their normal forces.
    pub(super) fn contact_points(&self) -> Vec<ContactPoint> {
        let mut points = Vec::new();
        for (i, contact) in self.data.contact().iter().enumerate() {
            if contact.efc_address < 0 || contact.geom1 < 0 || contact.geom2 < 0 {
                continue;
            }
            let (first, second) = (self.kinds[contact.geom1 as usize], self.kinds[contact.geom2 as usize]);
            // The normal points from the first shape to the second, and the force acts on the second.
            let (between, sign) = match (first, second) {
                (Kind::Robot { .. }, Kind::Object(_)) => (ContactBetween::RobotAndObject, 1.0),
                (Kind::Object(_), Kind::Robot { .. }) => (ContactBetween::RobotAndObject, -1.0),
                (Kind::Fixture(_), Kind::Robot { .. }) => (ContactBetween::RobotAndSurroundings, 1.0),
                (Kind::Robot { .. }, Kind::Fixture(_)) => (ContactBetween::RobotAndSurroundings, -1.0),
                (Kind::Robot { .. }, Kind::Robot { .. }) => (ContactBetween::RobotAndSurroundings, 1.0),
                (Kind::Fixture(_) | Kind::Object(_), Kind::Object(_)) => (ContactBetween::ObjectAndSurroundings, 1.0),
                (Kind::Object(_), Kind::Fixture(_)) => (ContactBetween::ObjectAndSurroundings, -1.0),
                _ => continue,
            };
            let force = sign * self.data.contact_force(i)[0];
            let normal = [contact.frame[0], contact.frame[1], contact.frame[2]];
            points.push(ContactPoint { position: contact.pos, force_n: normal.map(|n| n * force), between });
        }
        points
    }

    /// The wrench on the object in the last step without weight and support, about the tool centre point, by inverse
    /// dynamics (Newton and Euler). The force of the weld alone is insufficient: if the cup also presses on the object,
    /// weld and contact forces oppose each other.
    pub(super) fn load_about(&self, tcp: &Isometry3<f64>, object: &Isometry3<f64>) -> Wrench {
        let mass = &self.scene.free_body(self.selected).mass;
        let qvel = self.free[self.selected].qvel;
        let (rotation, support) = (object.rotation, self.support());
        // MuJoCo gives a free body's linear velocity along the world's axes and its angular velocity along its own.
        let (acceleration, speed) = (&self.data.qacc()[qvel..], &self.data.qvel()[qvel..]);
        let linear = Vector3::new(acceleration[0], acceleration[1], acceleration[2]);
        let angular = Vector3::new(acceleration[3], acceleration[4], acceleration[5]);
        let spin = Vector3::new(speed[3], speed[4], speed[5]);
        let of_centre = linear + rotation * (angular.cross(&mass.centre) + spin.cross(&spin.cross(&mass.centre)));
        let weight = Vector3::new(0.0, 0.0, -self.scene.gravity);
        let force = (of_centre - weight) * mass.mass_kg - support.force;
        let moment = rotation * (mass.inertia * angular + spin.cross(&(mass.inertia * spin)));
        let centre = (object * Point3::from(mass.centre)).coords;
        let torque = moment - support.torque + (centre - tcp.translation.vector).cross(&force);
        Wrench { force, torque }.in_frame(tcp)
    }
}

/// A geom of a free body, with the body's index.
fn object_geom((geom, kind): (usize, &Kind)) -> Option<(usize, usize)> {
    match kind {
        Kind::Object(body) => Some((geom, *body)),
        Kind::Robot { .. } | Kind::Fixture(_) | Kind::Visual => None,
    }
}

/// The sliding friction coefficient of a contact of two geoms, by MuJoCo's rule ("Computation", "Contact"): the
/// coefficient of the geom with the higher priority, or the larger one at equal priority.
fn contact_friction(model: &MjModel, a: usize, b: usize) -> f64 {
    let [(first, friction), (second, other)] =
        [a, b].map(|geom| (model.geom_priority()[geom], model.geom_friction()[geom][0]));
    match first.cmp(&second) {
        Ordering::Greater => friction,
        Ordering::Less => other,
        Ordering::Equal => friction.max(other),
    }
}
