//! Contacts: friction coefficients, forces of the last step, rolling friction, and the load on the cup.

use nalgebra::{Isometry3, Point3, Vector3};
use rapier3d_f64::geometry::{ColliderHandle, Contact, ContactManifold, ContactPair};
use rapier3d_f64::math::Vector;
use rapier3d_f64::prelude::CoefficientCombineRule;
use robogate_core::{ContactBetween, ContactPoint, Fault};

use super::{Kind, Loaded, SUBSTEPS};
use crate::contact_sums::Thing;
use crate::description::isometry;
use crate::engine::Collision;
use crate::friction::{Against, Coefficients, Friction};
use crate::{Hit, Side, Touches, Wrench, contact};

impl Loaded {
    /// The friction coefficients that act between the object and every body that it can touch, by Rapier's rule.
    pub(super) fn friction(&self) -> Result<Friction, Fault> {
        let mut friction = Coefficients::default();
        for (handle, kind) in &self.colliders {
            let against = match *kind {
                Kind::Fixture(fixture) => (Side::Fixture(fixture), self.scene.fixtures[fixture].kind.against()),
                Kind::Robot { finger: Some(_), .. } => (Side::Robot, Against::Pad),
                Kind::Robot { finger: None, .. } => (Side::Robot, Against::Other),
                Kind::Object(body) => (Side::Body(body), Against::Other),
            };
            let other = &self.world.colliders[*handle];
            let bodies = self.free.iter().enumerate().filter(|(body, _)| against.0 != Side::Body(*body));
            for (body, part) in bodies.flat_map(|(body, (_, shapes))| shapes.iter().map(move |shape| (body, shape))) {
                let part = &self.world.colliders[*part];
                let coefficient = CoefficientCombineRule::combine(
                    part.friction(),
                    other.friction(),
                    part.friction_combine_rule(),
                    other.friction_combine_rule(),
                );
                friction.contact(&self.scene, body, against, coefficient);
            }
        }
        friction.finish()
    }

    /// Linear (kg m/s) and angular (kg m^2/s) momentum of the object about its centre of mass.
    pub(super) fn momentum(&self) -> [Vector3<f64>; 2] {
        let body = &self.world.bodies[self.object()];
        let (speed, spin) = (body.linvel(), body.angvel());
        let rotation = isometry(body.position()).rotation;
        let mass = &self.scene.free_body(self.selected).mass;
        let spin = rotation.inverse() * Vector3::new(spin.x, spin.y, spin.z);
        [Vector3::new(speed.x, speed.y, speed.z) * mass.mass_kg, rotation * (mass.inertia * spin)]
    }

    /// The wrench on the object in the last step without weight and support, about the tool centre point, by inverse
    /// dynamics (Newton and Euler) from the momentum `before`. The tool centre point is at `lip` in the cup's link.
    /// Rapier's joint impulse cannot be used: it belongs to the last iteration only, along axes chosen by the solver.
    pub(super) fn load_about(&self, lip: &Isometry3<f64>, before: [Vector3<f64>; 2]) -> Wrench {
        let dt = self.world.integration_parameters.dt;
        let tcp = isometry(self.world.bodies[self.tcp].position()) * lip;
        let support = self.support();
        let [linear, angular] = self.momentum();
        let weight = Vector3::new(0.0, 0.0, -self.scene.gravity * self.scene.free_body(self.selected).mass.mass_kg);
        let force = (linear - before[0]) / dt - weight - support.force;
        let centre = self.world.bodies[self.object()].center_of_mass();
        let arm = Vector3::new(centre.x, centre.y, centre.z) - tcp.translation.vector;
        let torque = (angular - before[1]) / dt - support.torque + arm.cross(&force);
        Wrench { force: tcp.inverse_transform_vector(&force), torque: tcp.inverse_transform_vector(&torque) }
    }

    /// Wrench of the fixtures and the other free bodies on the object in the last step, about its centre of mass, along the world's axes.
    pub(super) fn support(&self) -> Wrench {
        let settings = &self.world.integration_parameters;
        let plain = |v: Vector| Vector3::new(v.x, v.y, v.z);
        let mut support = Wrench::ZERO;
        let shapes = &self.free[self.selected].1;
        let pairs = shapes.iter().flat_map(|shape| self.world.narrow_phase.contact_pairs_with(*shape));
        for pair in pairs.filter(|pair| self.on_support(pair)) {
            for manifold in pair.manifolds() {
                let first = manifold.data.rigid_body1 == Some(self.object());
                // The normal points from the first body to the second.
                let sign = if first { -1.0 } else { 1.0 };
                let mut middle = Vector3::zeros();
                let mut pressed = 0.0;
                let mut last = None;
                for point in solved(manifold).filter(|point| point.data.impulse > 0.0) {
                    let arm = plain(if first { point.data.solver_dp1 } else { point.data.solver_dp2 });
                    let force = plain(manifold.data.normal) * (sign * point.data.impulse / settings.dt);
                    support.force += force;
                    support.torque += arm.cross(&force);
                    middle += arm * point.data.impulse;
                    pressed += point.data.impulse;
                    last = Some(&point.data);
                }
                // Friction is solved once for the whole manifold. Each point stores the result of the last iteration.
                if let Some(last) = last {
                    let share = SUBSTEPS as f64 / settings.dt;
                    let tangential = plain(last.warmstart_tangent_world) * (-sign * share);
                    support.force += tangential;
                    support.torque += (middle / pressed).cross(&tangential);
                    support.torque += plain(manifold.data.normal) * (sign * last.warmstart_twist_impulse * share);
                }
            }
        }
        support
    }

    /// Whether a pair of shapes of the object contains a fixture or another free body.
    fn on_support(&self, pair: &ContactPair) -> bool {
        [pair.collider1, pair.collider2].into_iter().any(|handle| {
            let collider = self.world.colliders.get(handle);
            let kind = collider.and_then(|collider| self.colliders.get(collider.user_data as usize));
            match kind {
                Some((_, Kind::Fixture(_))) => true,
                Some((_, Kind::Object(body))) => *body != self.selected,
                _ => false,
            }
        })
    }

    /// Rolling friction of a ball: a moment against its rotation, at most [`contact::ROLLING_M`] times the normal force.
    pub(super) fn resist_rolling(&mut self) {
        let object = self.object();
        let dt = self.world.integration_parameters.dt;
        let pressed: f64 = if self.ball { self.pressure() } else { 0.0 };
        let Some(body) = self.world.bodies.get_mut(object) else { return };
        body.reset_torques(false);
        let spin = body.angvel();
        let speed = spin.length();
        if pressed > 0.0 && speed > 0.0 {
            // Limited to the moment that stops the rotation within this step.
            let inertia = body.mass_properties().local_mprops.principal_inertia().x;
            let moment = (contact::ROLLING_M * pressed).min(inertia * speed / dt);
            body.add_torque(spin * (-moment / speed), false);
        }
    }

    /// Sum of the normal forces on the object in the last step, in newtons.
    fn pressure(&self) -> f64 {
        let dt = self.world.integration_parameters.dt;
        let shapes = &self.free[self.selected].1;
        let pairs = shapes.iter().flat_map(|shape| self.world.narrow_phase.contact_pairs_with(*shape));
        pairs.map(|pair| impulse(pair) / dt).sum()
    }

    /// Sum of the normal forces between two sides in the last step, in newtons. `None` if they do not touch.
    pub(super) fn force_between(&self, one: Side, other: Side) -> Option<f64> {
        let is = |handle: ColliderHandle, side: Side| {
            let id = self.world.colliders.get(handle).map(|collider| collider.user_data as usize);
            match (id.and_then(|id| self.colliders.get(id)).map(|(_, kind)| *kind), side) {
                (Some(Kind::Robot { .. }), Side::Robot) => true,
                (Some(Kind::Object(body)), Side::Body(wanted)) => body == wanted,
                (Some(Kind::Fixture(fixture)), Side::Fixture(wanted)) => fixture == wanted,
                _ => false,
            }
        };
        let between = |pair: &&ContactPair| {
            let (first, second) = (pair.collider1, pair.collider2);
            is(first, one) && is(second, other) || is(first, other) && is(second, one)
        };
        let mut sum = None;
        for pair in self.world.narrow_phase.contact_pairs().filter(between) {
            let deepest = pair.find_deepest_contact().map(|(_, contact)| contact.dist);
            if impulse(pair) > 0.0 || deepest.is_some_and(|dist| dist <= 0.0) {
                *sum.get_or_insert(0.0) += impulse(pair) / self.world.integration_parameters.dt;
            }
        }
        sum
    }

    /// The contact points of the last step with their normal forces.
    pub(super) fn contact_points(&self) -> Vec<ContactPoint> {
        let dt = self.world.integration_parameters.dt;
        let mut points = Vec::new();
        for pair in self.world.narrow_phase.contact_pairs() {
            let collider = |handle: ColliderHandle| {
                let collider = self.world.colliders.get(handle)?;
                Some((collider, self.colliders.get(collider.user_data as usize)?.1))
            };
            let (Some((first, one)), Some((_, two))) = (collider(pair.collider1), collider(pair.collider2)) else {
                continue;
            };
            // The normal points from the first shape to the second, and the force acts on the second.
            let (between, sign) = match (one, two) {
                (Kind::Robot { .. }, Kind::Object(_)) => (ContactBetween::RobotAndObject, 1.0),
                (Kind::Object(_), Kind::Robot { .. }) => (ContactBetween::RobotAndObject, -1.0),
                (Kind::Fixture(_), Kind::Robot { .. }) => (ContactBetween::RobotAndSurroundings, 1.0),
                (Kind::Robot { .. }, Kind::Fixture(_)) => (ContactBetween::RobotAndSurroundings, -1.0),
                (Kind::Fixture(_) | Kind::Object(_), Kind::Object(_)) => (ContactBetween::ObjectAndSurroundings, 1.0),
                (Kind::Object(_), Kind::Fixture(_)) => (ContactBetween::ObjectAndSurroundings, -1.0),
                _ => continue,
            };
            let place = isometry(first.position());
            for manifold in pair.manifolds() {
                let normal = manifold.data.normal;
                for point in solved(manifold).filter(|point| point.data.impulse > 0.0) {
                    let force = sign * point.data.impulse / dt;
                    let at = place * Point3::new(point.local_p1.x, point.local_p1.y, point.local_p1.z);
                    points.push(ContactPoint {
                        position: at.coords.into(),
                        force_n: [normal.x, normal.y, normal.z].map(|n| n * force),
                        between,
                    });
                }
            }
        }
        points
    }

    /// Contacts before the first step, determined by distance because no force has acted yet.
    pub(super) fn read_touches_at_start(&mut self) {
        self.touches = Touches::default();
        for (robot, kind) in &self.colliders {
            let Kind::Robot { body, finger, fixed } = *kind else { continue };
            for (other, kind) in &self.colliders {
                let (robot, other) = (&self.world.colliders[*robot], &self.world.colliders[*other]);
                let touch = || {
                    let (a, b) = (robot.position(), other.position());
                    rapier3d_f64::parry::query::contact(a, robot.shape(), b, other.shape(), 0.0).ok().flatten()
                };
                match kind {
                    Kind::Object(_) if touch().is_some() => match finger {
                        Some(finger) => self.touches.fingers[finger] = Some(0.0),
                        None => self.touches.body_on_object = true,
                    },
                    Kind::Fixture(fixture) if !fixed && touch().is_some() => {
                        self.touches.collision =
                            Some(Collision { robot_body: body, hit: Hit::Fixture(*fixture), force: 0.0 });
                    }
                    _ => {}
                }
            }
        }
    }

    /// Sums up the contacts of the last step. If two bodies touch at several points, their forces are added.
    pub(super) fn read_touches(&mut self) {
        let dt = self.world.integration_parameters.dt;
        self.touches = Touches::default();
        self.forces.clear();
        for pair in self.world.narrow_phase.contact_pairs() {
            let kind = |handle: ColliderHandle| {
                let id = self.world.colliders.get(handle).map(|collider| collider.user_data as usize);
                id.and_then(|id| self.colliders.get(id)).map(|(_, kind)| *kind)
            };
            let (Some(one), Some(two)) = (kind(pair.collider1), kind(pair.collider2)) else { continue };
            let deepest = pair.find_deepest_contact().map(|(_, contact)| contact.dist);
            // Bodies that are close but do not touch have no force.
            if deepest.is_none_or(|dist| dist > 0.0) && impulse(pair) == 0.0 {
                continue;
            }
            let force = impulse(pair) / dt;
            let touches = &mut self.touches;
            let (body, thing, sign) = match (one, two) {
                (Kind::Robot { body, finger, .. }, Kind::Object(object))
                | (Kind::Object(object), Kind::Robot { body, finger, .. }) => {
                    match finger {
                        _ if object != self.selected => {}
                        Some(finger) => *touches.fingers[finger].get_or_insert(0.0) += force,
                        None => touches.body_on_object = true,
                    }
                    (body, Thing::Part(object), if matches!(one, Kind::Robot { .. }) { 1.0 } else { -1.0 })
                }
                (Kind::Robot { body, .. }, Kind::Fixture(fixture)) => {
                    (body, Thing::Surroundings(Hit::Fixture(fixture)), 1.0)
                }
                (Kind::Fixture(fixture), Kind::Robot { body, .. }) => {
                    (body, Thing::Surroundings(Hit::Fixture(fixture)), -1.0)
                }
                (one, two) if one == Kind::Object(self.selected) || two == Kind::Object(self.selected) => {
                    touches.object_on_fixture = true;
                    continue;
                }
                _ => continue,
            };
            self.forces.add(body, self.regions[body], thing, force, sign * direction(pair));
        }
        self.forces.write(&self.regions, &mut self.touches);
    }
}

/// The points of a manifold that the last step solved. The others contain old values.
fn solved(manifold: &ContactManifold) -> impl Iterator<Item = &Contact> {
    let ids = manifold.data.solver_contacts.iter().flat_map(|contact| contact.contact_indices());
    ids.filter_map(|id| manifold.points.get(id as usize))
}

/// The direction of the normal impulse of a pair over the last step, from the first body to the second. Zero without one.
fn direction(pair: &ContactPair) -> Vector3<f64> {
    let along = |manifold: &ContactManifold| {
        let normal = manifold.data.normal;
        Vector3::new(normal.x, normal.y, normal.z) * solved(manifold).map(|point| point.data.impulse).sum::<f64>()
    };
    let sum: Vector3<f64> = pair.manifolds().iter().map(along).sum();
    sum.try_normalize(0.0).unwrap_or_default()
}

/// The normal impulse of a pair over the last step, in N s.
fn impulse(pair: &ContactPair) -> f64 {
    pair.manifolds().iter().flat_map(solved).map(|point| point.data.impulse).sum()
}
