//! The recorded motion of all bodies of an episode, for a viewer.

use crate::Pose;

/// The motion of all bodies in one episode.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trajectory {
    /// Names of the bodies.
    pub bodies: Vec<String>,
    /// The visible solids of the bodies.
    pub solids: Vec<Solid>,
    /// The frames, in order of time.
    pub frames: Vec<Frame>,
}

/// A visible solid that moves with a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    /// Index of the body in [`Trajectory::bodies`].
    pub body: usize,
    /// The shape.
    pub shape: SolidShape,
    /// The pose in the body's frame.
    pub pose: Pose,
    /// Colour in sRGB.
    pub color: [u8; 3],
    /// From 0 (invisible) to 1 (opaque).
    pub opacity: f64,
}

/// A shape, centred at its origin with its axis along z. Lengths are in metres.
#[derive(Debug, Clone, PartialEq)]
pub enum SolidShape {
    /// A box by its half extents.
    Box {
        /// Half extents along x, y, z.
        half: [f64; 3],
    },
    /// A ball.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A cylinder with a half ball at each end.
    Capsule {
        /// Radius.
        radius: f64,
        /// Half the height of the cylinder.
        half_height: f64,
    },
    /// A cylinder.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Half the height.
        half_height: f64,
    },
    /// A triangle mesh.
    Mesh {
        /// The corners of each triangle.
        triangles: Vec<[[f32; 3]; 3]>,
    },
}

/// The state of all bodies at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Simulated time in seconds.
    pub time_s: f64,
    /// The pose of each body in the base frame, in the order of [`Trajectory::bodies`].
    pub poses: Vec<Pose>,
    /// The contacts since the last frame, at the time step with the largest force on the robot.
    pub contacts: Vec<ContactPoint>,
}

/// A contact point with its normal force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactPoint {
    /// Position in the base frame, in metres.
    pub position: [f64; 3],
    /// Normal force on the object, or on the robot if the object is not involved, in newtons.
    pub force_n: [f64; 3],
    /// The bodies that touch.
    pub between: ContactBetween,
}

/// The kinds of bodies that touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContactBetween {
    /// The robot and the object.
    RobotAndObject,
    /// The robot and its surroundings.
    RobotAndSurroundings,
    /// The object and its surroundings.
    ObjectAndSurroundings,
}
