//! The renderer of the camera images.

use anyhow::bail;
use robogate_camera::Renderer;
use robogate_dictionary::RendererRecord;
use robogate_physics::Engine;

/// Returns an error if the renderer cannot be used with this engine.
pub(crate) fn check(record: &RendererRecord, engine: &str, remote: bool) -> anyhow::Result<()> {
    let RendererRecord::Egl { .. } = record;
    if remote {
        bail!("--renderer egl needs MuJoCo in this process; with --simulator only the embedded renderer is available");
    }
    if engine != "mujoco" {
        bail!("--renderer egl cannot be used with --engine {engine}. Expected --engine mujoco");
    }
    Ok(())
}

/// Opens the renderer for this engine, and returns it with its record, which names the device. Returns an error if the run
/// was recorded with another device.
pub(crate) fn open(
    record: &RendererRecord,
    engine: &dyn Engine,
) -> anyhow::Result<(Box<dyn Renderer>, RendererRecord)> {
    let RendererRecord::Egl { device: recorded } = record;
    let (renderer, device) = egl(engine)?;
    match recorded {
        Some(recorded) if *recorded != device => {
            bail!(
                "the run's images were rendered by {recorded}, but this machine has {device}, whose pixels may differ"
            )
        }
        _ => Ok((renderer, RendererRecord::Egl { device: Some(device) })),
    }
}

#[cfg(feature = "egl")]
fn egl(engine: &dyn Engine) -> anyhow::Result<(Box<dyn Renderer>, String)> {
    let renderer = robogate_camera::EglRenderer::new(engine).map_err(|why| anyhow::anyhow!("--renderer egl: {why}"))?;
    let device = renderer.device().to_owned();
    Ok((Box::new(renderer), device))
}

#[cfg(not(feature = "egl"))]
fn egl(_: &dyn Engine) -> anyhow::Result<(Box<dyn Renderer>, String)> {
    bail!("this build has no EGL renderer\nHint: build it with --features egl (docs/reference/cameras.md)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_round_trip() {
        let record = RendererRecord::Egl { device: Some("llvmpipe".to_owned()) };
        let recorded = serde_json::json!({ "name": "egl", "device": "llvmpipe" });
        assert_eq!(serde_json::to_value(&record).unwrap(), recorded);
        assert_eq!(serde_json::from_value::<RendererRecord>(recorded).unwrap(), record);
        assert!(serde_json::from_value::<RendererRecord>(serde_json::json!({ "name": "vulkan" })).is_err());
    }

    #[test]
    fn egl_requires_local_mujoco() {
        let egl = RendererRecord::Egl { device: None };
        assert!(check(&egl, "mujoco", false).is_ok());
        assert!(check(&egl, "rapier", false).unwrap_err().to_string().contains("rapier"));
        assert!(check(&egl, "mujoco", true).unwrap_err().to_string().contains("--simulator"));
    }
}
