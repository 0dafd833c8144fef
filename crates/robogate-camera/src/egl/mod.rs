//! MuJoCo's own rasteriser as the second renderer: OpenGL, offscreen, by EGL.
//!
//! It draws the same cameras and the same colours as the embedded caster, from MuJoCo's own kinematics and by MuJoCo's own
//! code, so that what a policy makes of the pictures can be told from what it makes of the physics. A model of its
//! own is drawn: that of the engine with looks added. The engine's own is not touched, and neither is its state.

mod device;
mod dress;

use mujoco_rs::prelude::*;
use nalgebra::Vector3;
use robogate_core::{Fault, FaultKind, Image};
use robogate_physics::{Engine, MujocoEngine, Scene, Visual};

use crate::egl::device::Gl;
use crate::looks::RobotLooks;
use crate::mounts::{Mounts, front_pose};
use crate::stage::Stage;
use crate::{CAMERAS, Pinhole, Renderer, SIZE_PX};

/// Nothing nearer or farther than this is drawn, in metres.
const DEPTHS: [f32; 2] = [0.01, 20.0];

/// MuJoCo's renderer on an EGL device.
///
/// It belongs to the thread that made it, as OpenGL's contexts do.
pub struct EglRenderer {
    gl: Gl,
    mounts: Mounts,
    /// The robot's outfit; `None` where its model is shown as MuJoCo shows it.
    outfit: Option<RobotLooks>,
    size: [usize; 2],
    scene: Option<(Scene, Stage)>,
    /// The scene as OpenGL has it, from the first picture on.
    drawn: Option<Drawn>,
}

/// A scene on the device.
struct Drawn {
    data: MjData<Box<MjModel>>,
    scene: MjvScene,
    context: MjrContext,
}

impl EglRenderer {
    /// A renderer of this engine's robot, its pictures [`SIZE_PX`] wide and high.
    ///
    /// Fails where there is no EGL, or no device that draws with OpenGL.
    pub fn new(engine: &MujocoEngine) -> Result<Self, String> {
        let robot = engine.robot();
        let waiting = engine.chain().tcp_at(&robot.settings.arm.home_rad);
        let mounts = Mounts::new(&robot.settings.gripper, &waiting);
        let outfit = RobotLooks::new(robot).ok().filter(|looks| looks.dressed);
        Ok(Self { gl: Gl::new()?, mounts, outfit, size: [SIZE_PX; 2], scene: None, drawn: None })
    }

    /// What draws: OpenGL's renderer and version.
    pub fn device(&self) -> &str {
        self.gl.name()
    }

    /// The scene as a model that MuJoCo draws, and on the device.
    fn draw(&self, engine: &MujocoEngine, scene: &Scene, stage: &Stage) -> Result<Drawn, String> {
        let model = dress::model(engine, scene, stage, self.outfit.as_ref(), self.size)
            .map_err(|error| format!("MuJoCo does not compile what is to be drawn: {error}"))?;
        let geoms = model.geom_bodyid().len();
        let mut seen = MjvScene::new(&model, geoms + 64);
        self.gl.make_current()?;
        // SAFETY: the context has just been made current in this thread, which this value cannot leave, and it is
        // current again when the context is dropped (`EglRenderer::put_away`). Only this model is drawn with it.
        #[expect(unsafe_code, reason = "OpenGL's context is a matter of the thread, which the binding cannot see")]
        let context = unsafe { MjrContext::new(&model) };
        seen.clear_geom();
        Ok(Drawn { data: MjData::new(Box::new(model)), scene: seen, context })
    }

    fn put_away(&mut self) {
        let Some(Drawn { context, .. }) = self.drawn.take() else { return };
        // What OpenGL holds can only be given back where its context is current.
        match self.gl.make_current() {
            Ok(()) => drop(context),
            Err(_) => std::mem::forget(context),
        }
    }
}

impl Drawn {
    /// What a camera shows of these joint positions.
    fn take(&mut self, positions: &[f64], camera: &Pinhole) -> Result<Vec<u8>, String> {
        let own = self.data.qpos_mut();
        if own.len() != positions.len() {
            return Err(format!("the drawn model has {} joint positions and not {}", own.len(), positions.len()));
        }
        own.copy_from_slice(positions);
        self.data.kinematics();
        self.data.com_pos();
        self.data.camlight();
        let options = dress::options();
        // A camera of the user's: MuJoCo leaves it where it is put.
        let mut user = MjvCamera::new_user();
        self.scene.update(&mut self.data, &options, &MjvPerturb::default(), &mut user);
        // SAFETY: only numbers of the two cameras change; no pointer or count is touched.
        #[expect(unsafe_code, reason = "the binding has no safe way to place a camera of the user's")]
        let cameras = unsafe { &mut self.scene.ffi_mut().camera };
        let half = (0.5 * camera.field_of_view_rad).tan() as f32 * DEPTHS[0];
        let turn = camera.pose.rotation;
        let single = |v: Vector3<f64>| v.map(|x| x as f32).into();
        for eye in cameras {
            eye.pos = single(camera.pose.translation.vector);
            eye.forward = single(turn * Vector3::z());
            eye.up = single(turn * -Vector3::y());
            eye.frustum_center = 0.0;
            // Zero: as wide as the picture's shape makes it.
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

impl Renderer<MujocoEngine> for EglRenderer {
    fn resize(&mut self, width: usize, height: usize) {
        self.put_away();
        self.size = [width.max(1), height.max(1)];
    }

    fn set_up(&mut self, _: &MujocoEngine, scene: &Scene) -> Visual {
        self.put_away();
        let stage = Stage::new(scene, front_pose());
        let visual = stage.visual(&front_pose()).unwrap_or(scene.visual);
        self.scene = Some((scene.clone(), stage));
        visual
    }

    fn clear(&mut self) {
        self.put_away();
        self.scene = None;
    }

    fn render(&mut self, engine: &MujocoEngine) -> Result<Vec<Image>, Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
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
        self.put_away();
    }
}
