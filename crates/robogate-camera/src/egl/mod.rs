//! MuJoCo's rasteriser as the second renderer: OpenGL, offscreen with EGL.
//!
//! It renders the same cameras and colours as the embedded caster, with MuJoCo's kinematics and code. This separates
//! the effect of images on a policy from the effect of physics. It renders a separate model: the engine's model with
//! added appearance. It changes neither the engine's model nor its state.

mod device;
mod dress;

use std::any::Any;

use mujoco_rs::prelude::*;
use nalgebra::Vector3;
use robogate_core::{Fault, FaultKind, Image};
use robogate_physics::{Engine, MujocoEngine, Scene, Visual};

use crate::egl::device::Gl;
use crate::looks::RobotLooks;
use crate::mounts::{Mounts, front_pose};
use crate::stage::{Meshes, Stage};
use crate::{CAMERAS, Pinhole, Renderer, SIZE_PX};

/// Nearest and farthest visible depth, in metres.
const DEPTHS: [f32; 2] = [0.01, 20.0];

/// MuJoCo's renderer on an EGL device.
///
/// It must stay in the thread that created it, as OpenGL contexts must.
pub struct EglRenderer {
    gl: Gl,
    mounts: Mounts,
    /// The robot's outfit. `None` if the model is rendered as in MuJoCo.
    outfit: Option<RobotLooks>,
    size: [usize; 2],
    scene: Option<(Scene, Stage)>,
    /// The scene on the device, from the first image on.
    drawn: Option<Drawn>,
}

/// A scene on the device.
struct Drawn {
    data: MjData<Box<MjModel>>,
    scene: MjvScene,
    context: MjrContext,
}

impl EglRenderer {
    /// Creates a renderer for this engine's robot. Images are [`SIZE_PX`] wide and high.
    ///
    /// # Errors
    /// If the system has no EGL library, or no device that supports OpenGL.
    pub fn new(engine: &dyn Engine) -> Result<Self, String> {
        let robot = engine.robot();
        let waiting = engine.chain().tcp_at(&robot.settings.arm.home_rad);
        let mounts = Mounts::new(&robot.settings.gripper, &waiting);
        let outfit = RobotLooks::new(robot).ok().filter(|looks| looks.dressed);
        Ok(Self { gl: Gl::new()?, mounts, outfit, size: [SIZE_PX; 2], scene: None, drawn: None })
    }

    /// OpenGL's renderer and version.
    pub fn device(&self) -> &str {
        self.gl.name()
    }

    /// Compiles the scene to a model for rendering, and uploads it to the device.
    fn draw(&self, engine: &MujocoEngine, scene: &Scene, stage: &Stage) -> Result<Drawn, String> {
        let model = dress::model(engine, scene, stage, self.outfit.as_ref(), self.size)
            .map_err(|error| format!("MuJoCo cannot compile the scene for rendering: {error}"))?;
        let geoms = model.geom_bodyid().len();
        let mut seen = MjvScene::new(&model, geoms + 64);
        self.gl.make_current()?;
        // SAFETY: the context has just been made current in this thread, which this value cannot leave, and it is made
        // current again before the context is dropped (`EglRenderer::discard`). Only this model is drawn with it.
        #[expect(unsafe_code, reason = "OpenGL contexts belong to a thread, which the binding cannot check")]
        let context = unsafe { MjrContext::new(&model) };
        seen.clear_geom();
        Ok(Drawn { data: MjData::new(Box::new(model)), scene: seen, context })
    }

    fn discard(&mut self) {
        let Some(Drawn { context, .. }) = self.drawn.take() else { return };
        // OpenGL resources can only be freed while their context is current.
        match self.gl.make_current() {
            Ok(()) => drop(context),
            Err(_) => std::mem::forget(context),
        }
    }
}

impl Drawn {
    /// Renders these joint positions from a camera.
    fn take(&mut self, positions: &[f64], camera: &Pinhole) -> Result<Vec<u8>, String> {
        let own = self.data.qpos_mut();
        if own.len() != positions.len() {
            return Err(format!("the rendered model has {} joint positions. Expected {}", own.len(), positions.len()));
        }
        own.copy_from_slice(positions);
        self.data.kinematics();
        self.data.com_pos();
        self.data.camlight();
        let options = dress::options();
        // MuJoCo does not move a user camera.
        let mut user = MjvCamera::new_user();
        self.scene.update(&mut self.data, &options, &MjvPerturb::default(), &mut user);
        // SAFETY: only numbers of the two cameras change, no pointer or count.
        #[expect(unsafe_code, reason = "the binding has no safe setter for a user camera")]
        let cameras = unsafe { &mut self.scene.ffi_mut().camera };
        let half = (0.5 * camera.field_of_view_rad).tan() as f32 * DEPTHS[0];
        let rotation = camera.pose.rotation;
        let single = |v: Vector3<f64>| v.map(|x| x as f32).into();
        for eye in cameras {
            eye.pos = single(camera.pose.translation.vector);
            eye.forward = single(rotation * Vector3::z());
            eye.up = single(rotation * -Vector3::y());
            eye.frustum_center = 0.0;
            // Zero, because the width follows from the aspect ratio.
            eye.frustum_width = 0.0;
            (eye.frustum_bottom, eye.frustum_top) = (-half, half);
            [eye.frustum_near, eye.frustum_far] = DEPTHS;
            eye.orthographic = 0;
        }
        let (width, height) = (camera.width, camera.height);
        let whole = MjrRectangle::new(0, 0, width as i32, height as i32);
        self.context.offscreen();
        self.scene.render(&whole, &self.context);
        let mut rows = vec![0_u8; 3 * width * height];
        self.context.read_pixels(Some(&mut rows), None, &whole).map_err(|error| error.to_string())?;
        // OpenGL's first row is the lowest.
        Ok(rows.chunks_exact(3 * width).rev().flatten().copied().collect())
    }
}

impl Renderer for EglRenderer {
    fn resize(&mut self, width: usize, height: usize) {
        self.discard();
        self.size = [width.max(1), height.max(1)];
    }

    fn set_up(&mut self, scene: &Scene) -> Visual {
        self.discard();
        let stage = Stage::new(scene, front_pose(), &mut Meshes::default());
        let visual = stage.visual(&front_pose()).unwrap_or(scene.visual);
        self.scene = Some((scene.clone(), stage));
        visual
    }

    fn clear(&mut self) {
        self.discard();
        self.scene = None;
    }

    fn render(&mut self, engine: &dyn Engine) -> Result<Vec<Image>, Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
        let Some(engine) = (engine as &dyn Any).downcast_ref::<MujocoEngine>() else {
            return Err(setup("this renderer reads the state of MuJoCo only".to_owned()));
        };
        let Some((scene, stage)) = &self.scene else { return Err(setup("no scenario is set up".to_owned())) };
        let pinholes = self.mounts.pinholes(&stage.front, &engine.tcp(), self.size);
        if self.drawn.is_none() {
            self.drawn = Some(self.draw(engine, scene, stage).map_err(setup)?);
        }
        let Some(drawn) = &mut self.drawn else { return Ok(Vec::new()) };
        self.gl.make_current().map_err(setup)?;
        let mut image = |(name, camera): (&&str, &Pinhole)| {
            let rgb = drawn.take(engine.positions(), camera).map_err(setup)?;
            Ok(Image { camera: (*name).to_owned(), width: camera.width, height: camera.height, rgb })
        };
        CAMERAS.iter().zip(&pinholes).map(&mut image).collect()
    }
}

impl Drop for EglRenderer {
    fn drop(&mut self) {
        self.discard();
    }
}
