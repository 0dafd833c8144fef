//! The numbers of a scene that parameters can set, and the poses that follow from them.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_physics::{Joint, MassProperties, Motion, Part, Primitive};

use super::conditions::Value;
use super::units::Dimension;
use crate::arm::{InSurroundings, Surroundings};

/// Every number of a scene that a parameter can set.
#[derive(Debug, Clone, Default)]
pub(super) struct Numbers {
    pub(super) fixtures: Vec<Placed>,
    /// How each fixture moves, in its own frame.
    pub(super) motions: Vec<Option<Motion>>,
    /// The friction coefficient of each fixture that has its own.
    pub(super) frictions: Vec<Option<f64>>,
    pub(super) parts: Vec<PartNumbers>,
    /// That of the parts without their own.
    pub(super) friction: f64,
    pub(super) gravity: f64,
    /// The value of each parameter, then of each setting.
    pub(super) values: Vec<f64>,
    /// Which of the words of the file's choice is chosen.
    pub(super) word: usize,
    /// Scale of the layout for the reach of the arm.
    pub(super) scale: f64,
    /// What every task has.
    pub(super) around: Surroundings,
}

impl InSurroundings for Numbers {
    fn around_mut(&mut self) -> &mut Surroundings {
        &mut self.around
    }
}

/// Position (m), and roll, pitch and yaw (rad).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Placed {
    pub(super) at: [f64; 3],
    pub(super) rotation: [f64; 3],
}

impl Placed {
    pub(super) fn pose(&self) -> Isometry3<f64> {
        let [roll, pitch, yaw] = self.rotation;
        let [x, y, z] = self.at;
        Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
    }
}

/// The numbers of a part.
#[derive(Debug, Clone)]
pub(super) struct PartNumbers {
    pub(super) placed: Placed,
    pub(super) mass_kg: f64,
    /// Centre and inertia, if its shapes do not have equal density. Its mass does not matter.
    pub(super) bulk: Option<MassProperties>,
    pub(super) friction: Option<f64>,
    pub(super) shapes: Vec<Part>,
    /// Radius of the disc of its start, in metres, and largest rotation, in radians.
    pub(super) spread_m: f64,
    pub(super) spin_rad: f64,
    pub(super) joint: Option<Joint>,
}

/// What a parameter sets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Target {
    /// Nothing: it is a number of this dimension for conditions and expert.
    Value(Dimension),
    Friction,
    Gravity,
    /// The coordinate of a fixture: x, y, z, or its yaw.
    Fixture(usize, usize),
    /// The friction coefficient of a fixture.
    FixtureFriction(usize),
    /// The speed of a fixture, of its surface if it is a belt.
    Speed(usize),
    /// The distance between the ends of a fixture that shuttles.
    Distance(usize),
    Part(usize, PartTarget),
}

/// A number of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PartTarget {
    /// x, y, z, or the yaw.
    Placed(usize),
    Mass,
    Friction,
    /// The edges of a part that is one box, or the diameter of one ball.
    Size,
    Spread,
    Spin,
    Damping,
    DryFriction,
    Stiffness,
    Start,
    Rest,
}

/// The index of the yaw among x, y, z and yaw.
pub(super) const YAW: usize = 3;

impl Placed {
    fn number(&mut self, which: usize) -> &mut f64 {
        if which == YAW { &mut self.rotation[2] } else { &mut self.at[which] }
    }
}

impl Target {
    /// The smallest value that it can have in physics.
    pub(super) fn least(self) -> f64 {
        match self {
            Self::Friction | Self::FixtureFriction(_) | Self::Part(_, PartTarget::Friction) => 0.01,
            Self::Distance(_) | Self::Part(_, PartTarget::Size) => 1e-3,
            Self::Part(_, PartTarget::Mass) => 1e-4,
            Self::Part(
                _,
                PartTarget::Spread
                | PartTarget::Spin
                | PartTarget::Damping
                | PartTarget::DryFriction
                | PartTarget::Stiffness,
            ) => 0.0,
            Self::Part(_, PartTarget::Placed(_) | PartTarget::Start | PartTarget::Rest)
            | Self::Value(_)
            | Self::Gravity
            | Self::Fixture(..)
            | Self::Speed(_) => f64::NEG_INFINITY,
        }
    }

    /// The number that it sets. `None` for a value, and for a joint that a part does not have.
    pub(super) fn number(self, numbers: &mut Numbers) -> Option<&mut f64> {
        match self {
            Self::Value(_) => None,
            Self::Friction => Some(&mut numbers.friction),
            Self::Gravity => Some(&mut numbers.gravity),
            Self::Fixture(of, which) => Some(numbers.fixtures[of].number(which)),
            Self::FixtureFriction(of) => numbers.frictions[of].as_mut(),
            Self::Speed(of) => numbers.motions[of].as_mut().and_then(speed),
            Self::Distance(of) => match numbers.motions[of].as_mut() {
                Some(Motion::Shuttle { distance_m, .. }) => Some(distance_m),
                _ => None,
            },
            Self::Part(of, which) => {
                let part = &mut numbers.parts[of];
                match which {
                    PartTarget::Placed(which) => Some(part.placed.number(which)),
                    PartTarget::Mass => Some(&mut part.mass_kg),
                    PartTarget::Friction => part.friction.as_mut(),
                    PartTarget::Size => None,
                    PartTarget::Spread => Some(&mut part.spread_m),
                    PartTarget::Spin => Some(&mut part.spin_rad),
                    PartTarget::Damping => part.joint.as_mut().map(|joint| &mut joint.damping),
                    PartTarget::DryFriction => part.joint.as_mut().map(|joint| &mut joint.friction),
                    PartTarget::Stiffness => part.joint.as_mut().map(|joint| &mut joint.stiffness),
                    PartTarget::Start => part.joint.as_mut().map(|joint| &mut joint.start),
                    PartTarget::Rest => part.joint.as_mut().map(|joint| &mut joint.rest),
                }
            }
        }
    }
}

impl Target {
    /// The value of the number that it sets.
    pub(super) fn get(self, numbers: &mut Numbers) -> Option<f64> {
        match self {
            Self::Part(of, PartTarget::Size) => numbers.parts[of].size_m(),
            _ => self.number(numbers).map(|number| *number),
        }
    }

    pub(super) fn set(self, numbers: &mut Numbers, value: f64) {
        match (self, self.number(numbers)) {
            (_, Some(number)) => *number = value,
            (Self::Part(of, PartTarget::Size), None) => numbers.parts[of].resize(value),
            _ => {}
        }
    }
}

impl PartNumbers {
    /// Mass, centre of mass and inertia.
    pub(super) fn mass(&self) -> MassProperties {
        match self.bulk {
            Some(bulk) => bulk.with_mass(self.mass_kg),
            None => MassProperties::homogeneous(&self.shapes, self.mass_kg),
        }
    }

    /// The edge of a cube or the diameter of a ball, in metres. `None` for another part.
    pub(super) fn size_m(&self) -> Option<f64> {
        edge_m(self.shapes.iter().map(|part| &part.primitive))
    }

    fn resize(&mut self, size_m: f64) {
        for part in &mut self.shapes {
            match &mut part.primitive {
                Primitive::Box { half } => *half = [0.5 * size_m; 3],
                Primitive::Sphere { radius } => *radius = 0.5 * size_m,
                Primitive::Cylinder { .. } | Primitive::Hull(_) => {}
            }
        }
    }
}

/// The edge of one cube or the diameter of one ball, in metres. `None` for other shapes.
pub(super) fn edge_m<'a>(mut shapes: impl Iterator<Item = &'a Primitive>) -> Option<f64> {
    let shape = shapes.next().filter(|shape| matches!(shape, Primitive::Box { .. } | Primitive::Sphere { .. }))?;
    let [x, y, z] = shape.half_extent();
    (shapes.next().is_none() && (x - y).abs() + (x - z).abs() < 1e-9).then_some(2.0 * x)
}

/// The speed that a file states for a motion.
pub(super) fn speed(motion: &mut Motion) -> Option<&mut f64> {
    match motion {
        Motion::Belt { speed_m_s: speed, .. }
        | Motion::Turn { speed_rad_s: speed, .. }
        | Motion::Shuttle { largest_speed_m_s: speed, .. } => Some(speed),
        Motion::Straight { .. } => None,
    }
}

/// A motion in the frame of a fixture at this pose, in the base frame.
fn in_base(motion: Motion, frame: &Isometry3<f64>) -> Motion {
    match motion {
        Motion::Belt { direction, speed_m_s } => Motion::Belt { direction: frame * direction, speed_m_s },
        Motion::Turn { axis, anchor, speed_rad_s } => {
            Motion::Turn { axis: frame * axis, anchor: (frame * nalgebra::Point3::from(anchor)).coords, speed_rad_s }
        }
        Motion::Shuttle { direction, distance_m, largest_speed_m_s } => {
            Motion::Shuttle { direction: frame * direction, distance_m, largest_speed_m_s }
        }
        Motion::Straight { velocity, starts_s, ends_s } => {
            Motion::Straight { velocity: frame * velocity, starts_s, ends_s }
        }
    }
}

/// The draws of a part's start.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Draws {
    /// A point of the unit disc, and a number from -1 to 1.
    pub(super) shift: [f64; 2],
    pub(super) turn: f64,
    /// Where it starts in its region, if it has one: x and y in metres in the frame of the base.
    pub(super) place: Option<[f64; 2]>,
}

/// The poses of a scene.
#[derive(Debug, Clone, Default)]
pub(super) struct Layout {
    /// Poses of the fixtures at the start.
    pub(super) fixtures: Vec<Isometry3<f64>>,
    /// How each fixture moves, in the base frame.
    pub(super) motions: Vec<Option<Motion>>,
    /// Poses of the parts at the start, or where their joints have the value 0.
    pub(super) parts: Vec<Isometry3<f64>>,
}

impl Layout {
    /// The poses of a scene with these numbers and these draws, whose parts are in the frames of these fixtures.
    pub(super) fn new(numbers: &Numbers, parents: &[Option<usize>], draws: &[Draws]) -> Self {
        let fixtures: Vec<_> = numbers.fixtures.iter().map(Placed::pose).collect();
        let frame = |parent: Option<usize>| parent.map_or_else(Isometry3::identity, |parent| fixtures[parent]);
        let parts = numbers.parts.iter().zip(parents).zip(draws);
        let parts = parts.map(|((part, parent), draws)| {
            let mut placed = part.placed;
            placed.at[0] += part.spread_m * draws.shift[0];
            placed.at[1] += part.spread_m * draws.shift[1];
            placed.rotation[2] += part.spin_rad * draws.turn;
            let mut pose = frame(*parent) * placed.pose();
            if let Some([x, y]) = draws.place {
                (pose.translation.x, pose.translation.y) = (x, y);
            }
            pose
        });
        let parts = parts.collect();
        let motions = numbers.motions.iter().zip(&fixtures);
        let motions = motions.map(|(motion, frame)| motion.map(|motion| in_base(motion, frame))).collect();
        Self { fixtures, motions, parts }
    }

    /// The pose of a fixture after `time_s` seconds.
    pub(super) fn fixture(&self, of: usize, time_s: f64) -> Isometry3<f64> {
        let pose = self.fixtures[of];
        self.motions[of].map_or(pose, |motion| motion.at(time_s) * pose)
    }
}

/// A place of a scene: the tool, or a point of a body.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Place {
    pub(super) on: Frame,
    /// The point in the frame, in metres.
    pub(super) point: Vector3<f64>,
    /// Direction in which fingers close there, from the x axis of the part, in radians. `None` if any face will do.
    pub(super) close_rad: Option<f64>,
    /// Its distance from that point along x, y and z of the robot's base. Empty without one.
    pub(super) shift: Vec<Value>,
}

impl Place {
    /// A point of a frame.
    pub(super) fn new(on: Frame, point: Vector3<f64>) -> Self {
        Self { on, point, close_rad: None, shift: Vec::new() }
    }
}

/// What a place moves with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Frame {
    World,
    Tool,
    Fixture(usize),
    Part(usize),
    /// Where the gripper released a part for the last time, without a rotation.
    Release(usize),
}
