//! Camera images of a robot cell, from an analytic ray caster on the CPU.
//!
//! [`Cameras`] store the appearance of a robot and, after [`Cameras::set_up`], of a scene. The front camera is beyond
//! the table and looks back at the workspace ([`FRONT_CAMERA`]). The wrist camera is mounted on the hand and looks at
//! the fingertips. Poses of the robot's links are computed from its joints and the description of its model, so images
//! do not depend on the engine. Equal scenes give equal bytes: the caster uses no GPU and no threads, and has no state
//! between images.
//!
//! Units: metres, radians, lux. Images are sRGB with 8 bits per channel.

#[cfg(test)]
mod agreement;
mod body;
mod caster;
#[cfg(feature = "egl")]
mod egl;
mod finish;
mod light;
mod looks;
mod mesh;
mod mounts;
mod outfits;
mod pinhole;
mod shadow;
mod solids;
mod stage;
mod table;
mod tiles;

use nalgebra::Isometry3;
use robogate_core::{Fault, Image};

#[cfg(feature = "egl")]
pub use egl::EglRenderer;
pub use mounts::FRONT_CAMERA;
pub use pinhole::Pinhole;

use robogate_physics::{Engine, Robot, Scene, Visual};

use crate::looks::RobotLooks;
use crate::mounts::{Mounts, front_pose};
use crate::stage::{Meshes, Stage};

/// The cameras' names, in the order of the images.
pub const CAMERAS: [&str; 2] = ["front", "wrist"];

/// Default width and height of an image, in pixels.
pub const SIZE_PX: usize = 256;

/// A renderer that replaces the embedded caster and renders the state of an engine.
pub trait Renderer {
    /// Sets width and height of the images, in pixels.
    fn resize(&mut self, width: usize, height: usize);

    /// Sets up a scene and returns its applied appearance.
    fn set_up(&mut self, scene: &Scene) -> Visual;

    /// Removes the scene.
    fn clear(&mut self);

    /// Renders the engine's state, one image per camera of [`CAMERAS`].
    fn render(&mut self, engine: &dyn Engine) -> Result<Vec<Image>, Fault>;
}

/// The cameras of a cell.
#[derive(Debug)]
pub struct Cameras {
    robot: RobotLooks,
    mounts: Mounts,
    size: [usize; 2],
    exhaustive: bool,
    scene: Option<Stage>,
    meshes: Meshes,
}

/// Positions of all moving bodies.
#[derive(Debug, Clone)]
pub struct Posture {
    /// True positions of the arm's joints, base to tip, in radians.
    pub joints: Vec<f64>,
    /// Opening between the pads, in metres; `None` for a gripper without fingers.
    pub opening_m: Option<f64>,
    /// How far the lip of a suction cup is pressed back, in metres.
    pub cup_travel_m: f64,
    /// Pose of the object.
    pub object: Isometry3<f64>,
    /// Poses of the other free bodies, in the order of the scene.
    pub others: Vec<Isometry3<f64>>,
    /// Poses of the fixtures, in the order of the scene.
    pub fixtures: Vec<Isometry3<f64>>,
}

impl Cameras {
    /// Creates the cameras of a cell with this robot. Images are [`SIZE_PX`] wide and high.
    ///
    /// # Errors
    /// If the robot's model cannot be read without MuJoCo: a URDF, or MJCF with unsupported elements.
    pub fn new(robot: &Robot) -> Result<Self, String> {
        let looks = RobotLooks::new(robot)?;
        let waiting = Posture {
            joints: robot.settings.arm.home_rad.clone(),
            opening_m: None,
            cup_travel_m: 0.0,
            object: Isometry3::identity(),
            others: Vec::new(),
            fixtures: Vec::new(),
        };
        let mounts = Mounts::new(&robot.settings.gripper, &looks.tool(&waiting));
        Ok(Self { robot: looks, mounts, size: [SIZE_PX; 2], exhaustive: false, scene: None, meshes: Meshes::default() })
    }

    /// The same cameras with another image size, in pixels.
    #[must_use]
    pub fn with_size(mut self, width: usize, height: usize) -> Self {
        self.size = [width.max(1), height.max(1)];
        self
    }

    /// The same cameras without acceleration structures: every ray tests every solid, and every point every shadow. The
    /// images are identical to the bit. Tests and benchmarks compare with them.
    #[must_use]
    pub fn exhaustive(mut self) -> Self {
        self.exhaustive = true;
        self
    }

    /// The names of the cameras, in the order of the images.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        CAMERAS.into_iter()
    }

    /// Width and height of the images, in pixels.
    pub fn size(&self) -> (usize, usize) {
        let [width, height] = self.size;
        (width, height)
    }

    /// Sets up a scene.
    pub fn set_up(&mut self, scene: &Scene) {
        self.scene = Some(Stage::new(scene, front_pose(), &mut self.meshes));
    }

    /// Removes the scene.
    pub fn clear(&mut self) {
        self.scene = None;
    }

    /// Number of fixtures of the scene; `None` before [`Self::set_up`].
    pub fn fixtures(&self) -> Option<usize> {
        self.scene.as_ref().map(|scene| scene.fixtures)
    }

    /// Number of free bodies other than the object; 0 before [`Self::set_up`].
    pub fn others(&self) -> usize {
        self.scene.as_ref().map_or(0, |scene| scene.others.len())
    }

    /// Appearance of the scene, read from lamp, surfaces and camera poses; `None` before [`Self::set_up`].
    pub fn visual(&self) -> Option<Visual> {
        self.scene.as_ref()?.visual(&front_pose())
    }

    /// The pinhole cameras in this posture, in the order of [`CAMERAS`].
    pub fn pinholes(&self, posture: &Posture) -> [Pinhole; 2] {
        let front = self.scene.as_ref().map_or_else(front_pose, |scene| scene.front);
        self.mounts.pinholes(&front, &self.robot.tool(posture), self.size)
    }

    /// Renders this posture, one image per camera of [`CAMERAS`]. Empty before [`Self::set_up`].
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

    /// Renders this posture from another camera; `None` before [`Self::set_up`].
    pub fn view(&self, camera: &Pinhole, posture: &Posture) -> Option<Image> {
        let scene = self.scene.as_ref()?;
        let (width, height) = (camera.width, camera.height);
        let rgb = scene.with_bodies(&self.robot, posture, self.exhaustive, |picture| picture.take(camera));
        Some(Image { camera: "own".to_owned(), width, height, rgb })
    }
}
