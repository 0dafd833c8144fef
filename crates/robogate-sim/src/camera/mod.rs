//! What the cell's cameras show: an analytic ray caster on the CPU.
//!
//! [`Cameras`] hold a robot's looks and, after [`Cameras::set_up`], a scene's. The front camera stands beyond the table and
//! looks back at the workspace ([`crate::FRONT_CAMERA`]); the wrist camera sits on the hand and looks at the
//! fingertips. Where the robot's links are follows from its joints and the neutral description of its model, so that pictures
//! are the same whatever engine moves the bodies. The same world gives the same bytes: no GPU, no threads, and
//! nothing that depends on what was drawn before.
//!
//! Units: metres, radians, lux. Pictures are sRGB, 8 bits a channel.

#[cfg(test)]
mod agreement;
mod body;
mod caster;
mod finish;
mod light;
mod looks;
mod mesh;
mod outfits;
mod pinhole;
mod shadow;
mod stage;
mod table;
mod tiles;

use nalgebra::{Isometry3, Point3, Vector3};
use robogate_core::Image;

pub use pinhole::Pinhole;

use crate::camera::looks::RobotLooks;
use crate::camera::stage::Stage;
use crate::{FRONT_CAMERA, Gripper, Robot, Scene, Visual, WORKSPACE_CENTRE};

/// The cameras' names, in the order of the pictures.
pub const CAMERAS: [&str; 2] = ["front", "wrist"];

/// Pixels along each side of a picture, where nothing else is said.
pub const SIZE_PX: usize = 256;

/// Fields of view of the front and the wrist camera, in radians.
const FIELD_OF_VIEW_RAD: [f64; 2] = [70.0 * RADIANS, 75.0 * RADIANS];
const RADIANS: f64 = std::f64::consts::PI / 180.0;

/// The cell's cameras.
#[derive(Debug)]
pub struct Cameras {
    robot: RobotLooks,
    /// The wrist camera in the frame of the tool centre point, as it is meant to be.
    wrist: Isometry3<f64>,
    size: [usize; 2],
    exhaustive: bool,
    scene: Option<Stage>,
}

/// Where everything that moves is.
#[derive(Debug, Clone)]
pub struct Posture {
    /// True positions of the arm's joints, base to tip, in radians.
    pub joints: Vec<f64>,
    /// Opening between the pads, in metres; `None` for a gripper without fingers.
    pub opening_m: Option<f64>,
    /// The object's pose.
    pub object: Isometry3<f64>,
    /// Poses of the scene's fixtures, in its order.
    pub fixtures: Vec<Isometry3<f64>>,
}

impl Cameras {
    /// The cameras around this robot, their pictures [`SIZE_PX`] wide and high.
    ///
    /// Fails where its model cannot be read without MuJoCo: a URDF, or MJCF with parts that the neutral reader does not know.
    pub fn new(robot: &Robot) -> Result<Self, String> {
        let behind = match &robot.settings.gripper {
            Gripper::ParallelJaw(jaw) => jaw.palm_m + 0.035,
            Gripper::Suction(_) => 0.09,
        };
        // Beside the hand, across the tool's y axis, along which the fingers close; the hand is below in the picture.
        let mounted = |side: f64| {
            let from = Point3::new(side * 0.1, 0.0, -behind);
            Pinhole::looking(from, Point3::new(0.0, 0.0, 0.02), &(Vector3::x() * side))
        };
        let looks = RobotLooks::new(robot)?;
        // On the side from which it looks towards the workspace, and not back at the robot, while the arm waits.
        let waiting = Posture {
            joints: robot.settings.arm.home_rad.clone(),
            opening_m: None,
            object: Isometry3::identity(),
            fixtures: Vec::new(),
        };
        let tool = looks.tool(&waiting);
        let [x, y] = WORKSPACE_CENTRE;
        let ahead = Vector3::new(x, y, 0.0) - tool.translation.vector;
        let sight = tool.rotation * (mounted(1.0).rotation * Vector3::z());
        let side = if sight.xy().dot(&ahead.xy()) >= 0.0 { 1.0 } else { -1.0 };
        Ok(Self { robot: looks, wrist: mounted(side), size: [SIZE_PX; 2], exhaustive: false, scene: None })
    }

    /// The same cameras with pictures of another size, in pixels.
    #[must_use]
    pub fn with_size(mut self, width: usize, height: usize) -> Self {
        self.size = [width.max(1), height.max(1)];
        self
    }

    /// The same cameras without what spares them work: every ray tries every solid, and every point every shadow. Pictures
    /// are the same to the bit; tests and benchmarks hold the others against them.
    #[must_use]
    pub fn exhaustive(mut self) -> Self {
        self.exhaustive = true;
        self
    }

    /// Puts what a scene holds before the cameras.
    pub fn set_up(&mut self, scene: &Scene) {
        self.scene = Some(Stage::new(scene, front_pose()));
    }

    /// Takes the scene away.
    pub fn clear(&mut self) {
        self.scene = None;
    }

    /// How many fixtures the scene has; `None` before [`Self::set_up`].
    pub fn fixtures(&self) -> Option<usize> {
        self.scene.as_ref().map(|scene| scene.fixtures)
    }

    /// How the scene looks, read from lamp, surfaces and cameras as they are; `None` before [`Self::set_up`].
    pub fn visual(&self) -> Option<Visual> {
        self.scene.as_ref()?.visual(&front_pose())
    }

    /// The cameras as they stand in this posture: front and wrist.
    pub fn pinholes(&self, posture: &Posture) -> [Pinhole; 2] {
        let front = self.scene.as_ref().map_or_else(front_pose, |scene| scene.front);
        let [roll, pitch] = Pinhole::turn_between(&front_pose(), &front);
        let wrist = self.robot.tool(posture) * Pinhole::turned(&self.wrist, roll, pitch);
        let [width, height] = self.size;
        let camera = |pose, field_of_view_rad| Pinhole { pose, field_of_view_rad, width, height };
        [camera(front, FIELD_OF_VIEW_RAD[0]), camera(wrist, FIELD_OF_VIEW_RAD[1])]
    }

    /// What the cameras show of this posture, in the order of [`CAMERAS`]; nothing before [`Self::set_up`].
    pub fn render(&self, posture: &Posture) -> Vec<Image> {
        let Some(scene) = &self.scene else { return Vec::new() };
        scene.with_bodies(&self.robot, posture, self.exhaustive, |picture| {
            let image = |name: &str, camera: &Pinhole| Image {
                camera: name.to_owned(),
                width: camera.width,
                height: camera.height,
                rgb: picture.take(camera),
            };
            CAMERAS.iter().zip(&self.pinholes(posture)).map(|(name, camera)| image(name, camera)).collect()
        })
    }

    /// What one camera of one's own shows of this posture; `None` before [`Self::set_up`].
    pub fn view(&self, camera: &Pinhole, posture: &Posture) -> Option<Image> {
        let scene = self.scene.as_ref()?;
        let (width, height) = (camera.width, camera.height);
        let rgb = scene.with_bodies(&self.robot, posture, self.exhaustive, |picture| picture.take(camera));
        Some(Image { camera: "own".to_owned(), width, height, rgb })
    }
}

/// The front camera's pose as it is meant to be.
fn front_pose() -> Isometry3<f64> {
    let (from, at) = FRONT_CAMERA;
    Pinhole::looking(Point3::from(from), Point3::from(at), &Vector3::z())
}
