//! What the cell's cameras show: an analytic ray caster on the CPU.
//!
//! [`Cameras`] hold a robot's looks and, after [`Cameras::set_up`], a scene's. The front camera stands beyond the table and
//! looks back at the workspace ([`FRONT_CAMERA`]); the wrist camera sits on the hand and looks at the
//! fingertips. Where the robot's links are follows from its joints and the neutral description of its model, so that pictures
//! are the same whatever engine moves the bodies. The same world gives the same bytes: no GPU, no threads, and
//! nothing that depends on what was drawn before.
//!
//! Units: metres, radians, lux. Pictures are sRGB, 8 bits a channel.

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
mod stage;
mod table;
mod tiles;

use nalgebra::Isometry3;
use robogate_core::{Fault, Image};

#[cfg(feature = "egl")]
pub use egl::EglRenderer;
pub use mounts::FRONT_CAMERA;
pub use pinhole::Pinhole;

use robogate_physics::{Robot, Scene, Visual};

use crate::looks::RobotLooks;
use crate::mounts::{Mounts, front_pose};
use crate::stage::Stage;

/// The cameras' names, in the order of the pictures.
pub const CAMERAS: [&str; 2] = ["front", "wrist"];

/// Pixels along each side of a picture, where nothing else is said.
pub const SIZE_PX: usize = 256;

/// Takes a cell's pictures in place of the embedded caster, from what an engine holds.
pub trait Renderer<E> {
    /// Width and height of its pictures from now on, in pixels.
    fn resize(&mut self, width: usize, height: usize);

    /// Puts a scene before the cameras, and says how it looks: what of the visual parameters is applied.
    fn set_up(&mut self, engine: &E, scene: &Scene) -> Visual;

    /// Takes the scene away.
    fn clear(&mut self);

    /// What the cameras show of the engine's world, in the order of [`CAMERAS`].
    fn render(&mut self, engine: &E) -> Result<Vec<Image>, Fault>;
}

/// The cell's cameras.
#[derive(Debug)]
pub struct Cameras {
    robot: RobotLooks,
    mounts: Mounts,
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
        let looks = RobotLooks::new(robot)?;
        let waiting = Posture {
            joints: robot.settings.arm.home_rad.clone(),
            opening_m: None,
            object: Isometry3::identity(),
            fixtures: Vec::new(),
        };
        let mounts = Mounts::new(&robot.settings.gripper, &looks.tool(&waiting));
        Ok(Self { robot: looks, mounts, size: [SIZE_PX; 2], exhaustive: false, scene: None })
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

    /// The names of the cameras, in the order of the images.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        CAMERAS.into_iter()
    }

    /// Width and height of the images, in pixels.
    pub fn size(&self) -> (usize, usize) {
        let [width, height] = self.size;
        (width, height)
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
        self.mounts.pinholes(&front, &self.robot.tool(posture), self.size)
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
