//! The contact forces of one time step, summed by bodies and by region of the robot.

use nalgebra::Vector3;
use robogate_core::{Region, Touched};

use crate::engine::Collision;
use crate::{Hit, Touches};

/// What a body of the robot touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Thing {
    /// A body that moves freely or on a joint, by its index.
    Part(usize),
    /// A fixture, or the robot itself.
    Surroundings(Hit),
}

/// The forces of one time step.
#[derive(Debug, Clone, Default)]
pub(crate) struct ContactSums {
    /// Sum of the normal forces (N) between each body of the robot and each thing.
    pairs: Vec<((usize, Thing), f64)>,
    /// Sum of the normal forces (N) of each region on each thing, as vectors along the axes of the world.
    regions: Vec<((Region, Thing), Vector3<f64>)>,
}

impl ContactSums {
    pub(crate) fn clear(&mut self) {
        self.pairs.clear();
        self.regions.clear();
    }

    /// Adds a contact of a body of the robot, in a region of it. `direction` is that of the force on the thing.
    pub(crate) fn add(&mut self, body: usize, region: Region, thing: Thing, force: f64, direction: Vector3<f64>) {
        add(&mut self.pairs, (body, thing), force);
        add(&mut self.regions, (region, thing), direction * force);
    }

    /// Writes the largest forces. That of a region on a thing is the larger one of the sum of its bodies, which is what the thing
    /// feels, and of that of one body: two fingers that squeeze a thing have no sum.
    pub(crate) fn write(&self, regions: &[Region], touches: &mut Touches) {
        for ((robot_body, thing), force) in self.pairs.iter().copied() {
            touches.peak_force = Some(touches.peak_force.unwrap_or(0.0).max(force));
            touches.regions.raise(regions[robot_body], touched(thing), force);
            if let Thing::Surroundings(hit) = thing
                && touches.collision.is_none_or(|strongest| force > strongest.force)
            {
                touches.collision = Some(Collision { robot_body, hit, force });
            }
        }
        let mut squeeze: f64 = 0.0;
        for ((region, thing), force) in &self.regions {
            touches.regions.raise(*region, touched(*thing), force.norm());
            if *region == Region::Fingers {
                let of_one = self.pairs.iter().filter(|((body, other), _)| regions[*body] == *region && other == thing);
                let largest = of_one.map(|(_, force)| *force).fold(0.0, f64::max);
                squeeze = squeeze.max(largest - force.norm());
            }
        }
        touches.squeeze = Some(squeeze);
    }
}

fn touched(thing: Thing) -> Touched {
    match thing {
        Thing::Part(_) => Touched::Part,
        Thing::Surroundings(_) => Touched::Surroundings,
    }
}

fn add<K: PartialEq, F: std::ops::AddAssign>(sums: &mut Vec<(K, F)>, key: K, force: F) {
    match sums.iter_mut().find(|(known, _)| *known == key) {
        Some((_, sum)) => *sum += force,
        None => sums.push((key, force)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODIES: [Region; 2] = [Region::Fingers; 2];

    /// The force of the fingers on a part, and what they press against each other.
    fn force(of: &[(usize, usize, f64, [f64; 3])]) -> (Option<f64>, f64) {
        let mut sums = ContactSums::default();
        for (body, part, force, direction) in of {
            sums.add(*body, Region::Fingers, Thing::Part(*part), *force, (*direction).into());
        }
        let mut touches = Touches::default();
        sums.write(&BODIES, &mut touches);
        assert_eq!(touches.peak_force, of.iter().map(|(_, _, force, _)| *force).reduce(f64::max));
        (touches.regions.get(Region::Fingers, Touched::Part), touches.grip(100.0))
    }

    #[test]
    fn a_thing_feels_the_sum_of_what_pushes_it() {
        let (down, left, right) = ([0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]);
        assert_eq!(force(&[(0, 3, 26.5, down), (1, 3, 26.5, down)]), (Some(53.0), 0.0));
        assert_eq!(force(&[(0, 3, 30.0, left), (1, 3, 30.0, right)]), (Some(30.0), 30.0));
        assert_eq!(force(&[(0, 3, 20.0, down), (1, 4, 25.0, down)]), (Some(25.0), 0.0));
        assert_eq!(force(&[]), (None, 0.0));
    }
}
