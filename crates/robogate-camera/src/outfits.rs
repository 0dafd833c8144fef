//! Appearance of the built-in robots beyond their collision shapes.
//!
//! The appearance is defined here and not in the robots' files, because a robot's hash covers its files and must not
//! depend on appearance. Shapes deviate from the collision shapes by a few millimetres at most.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use robogate_physics::description::{Description, LinkLook, Solid};

use crate::body::Form;
use crate::finish::{Finish, Pattern};
use crate::looks::Piece;

/// Appearance of a built-in robot.
pub(crate) enum Outfit {
    /// Parts that replace the model's shapes.
    Whole(&'static [Part]),
    /// The model's shapes, with housings at the joints.
    Housings,
}

/// A solid on one of the model's bodies, in that body's frame (m).
pub(crate) struct Part {
    body: &'static str,
    shape: Shape,
    paint: Paint,
}

enum Shape {
    Capsule([f64; 3], [f64; 3], f64),
    Cylinder([f64; 3], [f64; 3], f64),
    /// Centre and half extents.
    Box([f64; 3], [f64; 3]),
}

#[derive(Clone, Copy)]
enum Paint {
    White,
    Cover,
    Dark,
    Metal,
    Rubber,
    Blue,
}

impl Paint {
    fn finish(self) -> Finish {
        match self {
            Self::White => Finish::new([228, 230, 233], 0.7),
            Self::Cover => Finish::new([176, 180, 186], 0.6),
            Self::Dark => Finish::new([62, 65, 70], 0.5),
            Self::Metal => Finish::new([168, 172, 177], 0.8).with(Pattern::Grain),
            Self::Rubber => Finish::new([34, 34, 37], 0.15).with(Pattern::Grain),
            Self::Blue => Finish::new([104, 150, 190], 0.6),
        }
    }
}

/// The outfit of the built-in robot with this name.
pub(crate) fn of(robot: &str) -> Option<Outfit> {
    match robot {
        "franka" => Some(Outfit::Whole(FRANKA)),
        "ur3e" | "ur5e" | "ur10e" => Some(Outfit::Housings),
        _ => None,
    }
}

/// The pedestal of a robot. It ends below the table's top, outside the physics.
pub(crate) fn pedestal() -> Piece {
    let finish = Finish::new([96, 100, 106], 0.3).with(Pattern::Grain);
    let form = Form::Box { half: [0.12, 0.12, 0.37] };
    Piece { link: 0, form, finish, place: Isometry3::translation(0.0, 0.0, -0.37) }
}

const fn part(body: &'static str, shape: Shape, paint: Paint) -> Part {
    Part { body, shape, paint }
}

use Paint::{Blue, Cover, Dark, Metal, Rubber, White};
use Shape::{Box as Block, Capsule, Cylinder};

/// The Panda: white shells, grey covers on the sides of the joints, dark seams between links.
const FRANKA: &[Part] = &[
    part("link0", Cylinder([0.0, 0.0, 0.0], [0.0, 0.0, 0.02], 0.095), Dark),
    part("link0", Capsule([-0.08, 0.0, 0.06], [0.0, 0.0, 0.06], 0.058), White),
    part("link0", Cylinder([0.0, 0.0, 0.02], [0.0, 0.0, 0.136], 0.062), White),
    part("link0", Block([-0.135, 0.0, 0.06], [0.012, 0.03, 0.02]), Dark),
    part("link1", Cylinder([0.0, 0.0, -0.197], [0.0, 0.0, -0.187], 0.0575), Dark),
    part("link1", Cylinder([0.0, 0.0, -0.187], [0.0, 0.0, 0.0], 0.06), White),
    part("link1", Capsule([0.0, -0.01, 0.0], [0.0, 0.01, 0.0], 0.06), White),
    part("link2", Cylinder([0.0, 0.0, -0.1], [0.0, 0.0, 0.1], 0.06), White),
    part("link2", Cylinder([0.0, 0.0, -0.108], [0.0, 0.0, 0.108], 0.05), Cover),
    part("link2", Capsule([0.0, 0.0, 0.0], [0.0, -0.13, 0.0], 0.058), White),
    part("link3", Cylinder([0.0, 0.0, -0.18], [0.0, 0.0, -0.17], 0.053), Dark),
    part("link3", Cylinder([0.0, 0.0, -0.17], [0.0, 0.0, -0.02], 0.056), White),
    part("link3", Capsule([0.0, 0.0, -0.02], [0.0825, 0.0, 0.0], 0.055), White),
    part("link4", Cylinder([0.0, 0.0, -0.09], [0.0, 0.0, 0.09], 0.056), White),
    part("link4", Cylinder([0.0, 0.0, -0.098], [0.0, 0.0, 0.098], 0.046), Cover),
    part("link4", Capsule([-0.02, 0.01, 0.0], [-0.0825, 0.06, 0.0], 0.052), White),
    part("link4", Capsule([-0.0825, 0.06, 0.0], [-0.0825, 0.12, 0.0], 0.055), White),
    part("link5", Cylinder([0.0, 0.0, -0.252], [0.0, 0.0, -0.242], 0.05), Dark),
    part("link5", Capsule([0.0, 0.0, -0.2], [0.0, 0.02, -0.06], 0.055), White),
    part("link5", Cylinder([0.0, 0.0, -0.242], [0.0, 0.0, -0.18], 0.055), White),
    part("link5", Capsule([0.0, 0.07, -0.17], [0.0, 0.08, -0.02], 0.035), White),
    part("link5", Capsule([0.0, 0.04, -0.06], [0.0, 0.06, -0.01], 0.045), White),
    part("link6", Cylinder([0.0, 0.0, -0.072], [0.0, 0.0, 0.072], 0.05), White),
    part("link6", Cylinder([0.0, 0.0, -0.079], [0.0, 0.0, 0.079], 0.041), Cover),
    part("link6", Capsule([0.02, 0.0, 0.0], [0.088, 0.0, 0.0], 0.049), White),
    part("link7", Cylinder([0.0, 0.0, 0.01], [0.0, 0.0, 0.082], 0.045), White),
    part("link7", Cylinder([0.0, 0.0, 0.082], [0.0, 0.0, 0.092], 0.042), Blue),
    part("link7", Cylinder([0.0, 0.0, 0.092], [0.0, 0.0, 0.107], 0.045), Metal),
    part("hand", Block([0.0, 0.0, 0.024], [0.0315, 0.1, 0.024]), White),
    part("hand", Block([0.0, 0.0, 0.057], [0.022, 0.101, 0.009]), Dark),
    part("left_finger", Block([0.0, 0.0145, 0.0262], [0.009, 0.0065, 0.0262]), Metal),
    part("left_finger", Block([0.0, 0.004, 0.0445], [0.0085, 0.004, 0.0085]), Rubber),
    part("right_finger", Block([0.0, 0.0145, 0.0262], [0.009, 0.0065, 0.0262]), Metal),
    part("right_finger", Block([0.0, 0.004, 0.0445], [0.0085, 0.004, 0.0085]), Rubber),
];

impl Part {
    /// The part on a robot; `None` if the robot has no such body.
    pub(crate) fn on(&self, description: &Description) -> Option<Piece> {
        let (_, link, within) = description.bodies.iter().find(|(name, ..)| name == self.body)?;
        let (form, place) = match self.shape {
            Shape::Capsule(from, to, radius) => {
                let (place, half) = along(from, to);
                (Form::Capsule { radius: radius as f32, half_height: half as f32 }, place)
            }
            Shape::Cylinder(from, to, radius) => {
                let (place, half) = along(from, to);
                (Form::Cylinder { radius: radius as f32, half_height: half as f32 }, place)
            }
            Shape::Box([x, y, z], half) => {
                (Form::Box { half: half.map(|x| x as f32) }, Isometry3::translation(x, y, z))
            }
        };
        Some(Piece { link: *link, form, finish: self.paint.finish(), place: within * place })
    }
}

/// The frame at the middle of a segment with z along it, and half its length.
fn along(from: [f64; 3], to: [f64; 3]) -> (Isometry3<f64>, f64) {
    let (from, to) = (Point3::from(from), Point3::from(to));
    let axis = to - from;
    let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &axis)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    (Isometry3::from_parts(Translation3::from(nalgebra::center(&from, &to).coords), rotation), 0.5 * axis.norm())
}

/// A shape of a UR's model: tubes of brushed aluminium, joints as drums with a blue lid at each end.
pub(crate) fn housing(link: usize, look: &LinkLook) -> Vec<Piece> {
    let name = look.name.as_deref().unwrap_or_default();
    let piece = |radius: f64, half: f64, paint: Paint| Piece {
        link,
        form: Form::Cylinder { radius: radius as f32, half_height: half as f32 },
        finish: paint.finish(),
        place: look.pose,
    };
    match (name, &look.solid) {
        ("shoulder_side" | "upper_arm_elbow", Solid::Cylinder { radius, half_height: half }) => {
            vec![piece(*radius, half - 0.004, Metal), piece(0.86 * radius, half + 0.002, Blue)]
        }
        ("upper_arm_shoulder" | "wrist_1" | "wrist_2", Solid::Capsule { radius, half_height }) => {
            // A drum inside the capsule.
            let half = half_height + 0.75 * radius;
            vec![piece(*radius, half, Metal), piece(0.84 * radius, half + 0.005, Blue)]
        }
        ("shoulder" | "wrist_3" | "suction_plate", Solid::Cylinder { radius, half_height }) => {
            vec![piece(*radius, *half_height, Metal)]
        }
        ("base" | "suction_stem", Solid::Cylinder { radius, half_height }) => vec![piece(*radius, *half_height, Dark)],
        ("suction_cup", Solid::Cylinder { radius, half_height: half }) => {
            vec![piece(*radius, *half, Rubber), piece(0.7 * radius, half - 0.002, Dark)]
        }
        ("upper_arm" | "forearm", Solid::Capsule { radius, half_height }) => {
            let form = Form::Capsule { radius: *radius as f32, half_height: *half_height as f32 };
            vec![Piece { link, form, finish: Metal.finish(), place: look.pose }]
        }
        _ => Piece::new(link, look).into_iter().collect(),
    }
}
