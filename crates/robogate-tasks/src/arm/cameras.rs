//! Camera images and recorded trajectories of an arm's cell.

use robogate_camera::{Cameras, Posture};
use robogate_core::{CameraSpec, Fault, FaultKind, Image};
use robogate_physics::Engine;

/// Positions of all moving bodies in an engine, for a number of fixtures and of free bodies other than the object.
pub(crate) fn posture(engine: &impl Engine, [fixtures, others]: [usize; 2]) -> Posture {
    Posture {
        joints: engine.joint_positions(),
        opening_m: engine.opening(),
        cup_travel_m: engine.cup_travel(),
        object: engine.free_body(0),
        others: (1..=others).map(|i| engine.free_body(i)).collect(),
        fixtures: (0..fixtures).map(|i| engine.fixture(i)).collect(),
    }
}

/// The cameras as declared by the task. Empty if the robot cannot be rendered.
pub(crate) fn camera_specs(cameras: &Result<Cameras, String>) -> Vec<CameraSpec> {
    let specs = |cameras: &Cameras| {
        let (width, height) = cameras.size();
        cameras.names().map(|name| CameraSpec { name: name.to_owned(), width, height }).collect()
    };
    cameras.as_ref().map(specs).unwrap_or_default()
}

/// Renders the cell. `posture` returns the positions of all moving bodies, for a number of fixtures and of free bodies
/// other than the object.
pub(crate) fn render(
    cameras: &Result<Cameras, String>,
    posture: impl FnOnce([usize; 2]) -> Posture,
) -> Result<Vec<Image>, Fault> {
    let setup = |why: String| Fault::new(FaultKind::Setup, why);
    let cameras = cameras.as_ref().map_err(|why| setup(format!("this robot cannot be rendered: {why}")))?;
    let fixtures = cameras.fixtures().ok_or_else(|| setup("no scenario is set up".to_owned()))?;
    Ok(cameras.render(&posture([fixtures, cameras.others()])))
}
