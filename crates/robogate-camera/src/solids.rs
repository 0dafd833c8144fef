//! The visible solids of a cell and the poses of their bodies, for viewers that do their own rendering.

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Pose, Solid, SolidShape};
use robogate_physics::pose;

use crate::body::Form;
use crate::finish::{Finish, MARK, Pattern};
use crate::light::color;
use crate::looks::RobotLooks;
use crate::stage::{Stage, With};
use crate::table::Texture;
use crate::{Cameras, Posture};

/// Rings of the target mark, from the bottom up: radius in metres and colour.
const RINGS: [(f64, [u8; 3]); 4] =
    [(MARK as f64, [231, 231, 231]), (0.058, [39, 140, 97]), (0.042, [231, 231, 231]), (0.022, [39, 140, 97])];
/// Thickness of a ring, in metres.
const RING_M: f64 = 4e-4;

impl Cameras {
    /// Names of the bodies of the cell: the robot's links, the fixtures, the object, other free bodies. Empty before [`Self::set_up`].
    pub fn bodies(&self) -> Vec<String> {
        let Some(stage) = &self.scene else { return Vec::new() };
        let links = (0..self.robot.link_count()).map(|link| format!("robot/link{link}"));
        links
            .chain(stage.names.iter().cloned())
            .chain(["object".to_owned()])
            .chain(stage.others.iter().cloned())
            .collect()
    }

    /// The visible solids of the bodies. Empty before [`Self::set_up`].
    pub fn solids(&self) -> Vec<Solid> {
        let Some(stage) = &self.scene else { return Vec::new() };
        let mut solids = robot_solids(&self.robot);
        stage_solids(stage, self.robot.link_count(), &mut solids);
        solids
    }

    /// Poses of the bodies in the base frame, in the order of [`Self::bodies`].
    pub fn poses(&self, posture: &Posture) -> Vec<Pose> {
        let links = self.robot.links(posture);
        links.iter().chain(&posture.fixtures).chain([&posture.object]).chain(&posture.others).map(pose).collect()
    }
}

fn robot_solids(robot: &RobotLooks) -> Vec<Solid> {
    robot.pieces.iter().map(|piece| solid(piece.link, &piece.form, &piece.finish, &piece.place)).collect()
}

fn stage_solids(stage: &Stage, links: usize, solids: &mut Vec<Solid>) {
    for prop in &stage.props {
        let body = links
            + match prop.with {
                With::Fixture(i) | With::Table(i) => i,
                With::Object => stage.fixtures,
                With::Other(i) => stage.fixtures + 1 + i,
            };
        solids.push(solid(body, prop.form(), &prop.finish, prop.place()));
        if let (Pattern::Table { marker: Some([x, y]), .. }, Form::Box { half }) = (prop.finish.pattern, prop.form()) {
            for (i, (radius, color)) in RINGS.into_iter().enumerate() {
                let height = f64::from(half[2]) + RING_M * (i as f64 + 0.5);
                solids.push(Solid {
                    body,
                    shape: SolidShape::Cylinder { radius, half_height: 0.5 * RING_M },
                    pose: Pose { position: [f64::from(x), f64::from(y), height], ..Pose::IDENTITY },
                    color,
                    opacity: 1.0,
                });
            }
        }
    }
}

fn solid(body: usize, form: &Form, finish: &Finish, place: &Isometry3<f64>) -> Solid {
    let shape = match form {
        Form::Box { half } => SolidShape::Box { half: half.map(rounded) },
        Form::Sphere { radius } => SolidShape::Sphere { radius: rounded(*radius) },
        Form::Capsule { radius, half_height } => {
            SolidShape::Capsule { radius: rounded(*radius), half_height: rounded(*half_height) }
        }
        Form::Cylinder { radius, half_height } => {
            SolidShape::Cylinder { radius: rounded(*radius), half_height: rounded(*half_height) }
        }
        Form::Mesh(mesh) => SolidShape::Mesh { triangles: mesh.corners() },
    };
    let albedo: Vector3<f32> = match finish.pattern {
        Pattern::Table { material, .. } => Texture::of(material).mean(),
        _ => finish.albedo,
    };
    Solid { body, shape, pose: pose(place), color: color(&albedo).0, opacity: 1.0 - finish.transparency }
}

/// A length without the digits that single precision adds.
fn rounded(x: f32) -> f64 {
    (f64::from(x) * 1e6).round() / 1e6
}
