//! What takes the cameras' pictures, by its name on the command line and in records.

use anyhow::bail;
use clap::ValueEnum;
#[cfg(feature = "mujoco")]
use robogate_camera::Renderer;
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
use serde::{Deserialize, Serialize};

/// A renderer on the command line.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum RendererName {
    Embedded,
    Egl,
}

impl RendererName {
    /// The renderer where it is not the embedded one.
    pub(crate) fn drawn(self) -> Option<Drawn> {
        match self {
            Self::Embedded => None,
            Self::Egl => Some(Drawn::Egl { device: None }),
        }
    }
}

/// A renderer other than the embedded one, in a run's record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "name", rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum Drawn {
    /// MuJoCo's own, by EGL.
    Egl {
        /// OpenGL's renderer and version: another one makes other pixels.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        device: Option<String>,
    },
}

impl Drawn {
    /// Its name on the command line.
    pub(crate) fn name(&self) -> &'static str {
        let Self::Egl { .. } = self;
        "egl"
    }

    /// Refuses what it cannot draw.
    pub(crate) fn check(&self, engine: &str, far: bool) -> anyhow::Result<()> {
        let Self::Egl { .. } = self;
        if far {
            bail!(
                "--renderer egl draws what MuJoCo holds in this process: with --simulator the pictures are embedded ones"
            );
        }
        if engine != "mujoco" {
            bail!("--renderer egl draws what MuJoCo holds: it is for --engine mujoco and not for {engine}");
        }
        Ok(())
    }
}

#[cfg(feature = "mujoco")]
impl Drawn {
    /// The renderer of this engine's world, and itself with the device that it has here. Another than the recorded one
    /// is refused.
    pub(crate) fn open(&self, engine: &MujocoEngine) -> anyhow::Result<(Box<dyn Renderer<MujocoEngine>>, Self)> {
        let Self::Egl { device: recorded } = self;
        let (renderer, device) = egl(engine)?;
        match recorded {
            Some(recorded) if *recorded != device => {
                bail!("the run's pictures were drawn by {recorded}, and this is {device}: it would see other pixels")
            }
            _ => Ok((renderer, Self::Egl { device: Some(device) })),
        }
    }
}

#[cfg(feature = "egl")]
fn egl(engine: &MujocoEngine) -> anyhow::Result<(Box<dyn Renderer<MujocoEngine>>, String)> {
    let renderer = robogate_camera::EglRenderer::new(engine).map_err(|why| anyhow::anyhow!("--renderer egl: {why}"))?;
    let device = renderer.device().to_owned();
    Ok((Box::new(renderer), device))
}

#[cfg(all(feature = "mujoco", not(feature = "egl")))]
fn egl(_: &MujocoEngine) -> anyhow::Result<(Box<dyn Renderer<MujocoEngine>>, String)> {
    bail!("this build has no EGL renderer\n  hint: build it with --features egl, as docs/cameras.md says")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embedded_renderer_leaves_no_trace_and_another_its_name_and_device() {
        assert_eq!(RendererName::Embedded.drawn(), None);
        assert_eq!(RendererName::Egl.drawn(), Some(Drawn::Egl { device: None }));
        let drawn = Drawn::Egl { device: Some("llvmpipe".to_owned()) };
        let recorded = serde_json::json!({ "name": "egl", "device": "llvmpipe" });
        assert_eq!(serde_json::to_value(&drawn).unwrap(), recorded);
        assert_eq!(serde_json::from_value::<Drawn>(recorded).unwrap(), drawn);
        assert!(serde_json::from_value::<Drawn>(serde_json::json!({ "name": "vulkan" })).is_err());
    }

    #[test]
    fn only_what_mujoco_holds_in_this_process_is_drawn_by_it() {
        let egl = Drawn::Egl { device: None };
        assert!(egl.check("mujoco", false).is_ok());
        assert!(egl.check("rapier", false).unwrap_err().to_string().contains("rapier"));
        assert!(egl.check("mujoco", true).unwrap_err().to_string().contains("--simulator"));
    }
}
