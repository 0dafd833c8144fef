//! Images of an episode: an animation, or a strip of frames.

mod filmed;
mod gif;

use std::path::Path;

use anyhow::{Context, bail};
use robogate_core::Image;

pub(crate) use filmed::{Filmed, Shot};

use crate::picture;

/// Number of frames of a strip.
const STRIP_FRAMES: usize = 6;

/// Writes the images of one camera as an animated GIF that repeats without end.
pub(crate) fn write_gif(path: &Path, shots: &[Shot]) -> anyhow::Result<()> {
    let bytes = gif::encode(shots)?;
    create(path, &bytes)
}

/// Writes frames at equal distances in time as one PNG, each with its time.
pub(crate) fn write_strip(path: &Path, shots: &[Shot]) -> anyhow::Result<()> {
    if shots.is_empty() {
        bail!("the episode has no image");
    }
    let last = shots.len() - 1;
    let count = STRIP_FRAMES.min(shots.len());
    let at = |i: usize| &shots[if count > 1 { i * last / (count - 1) } else { 0 }];
    let frames: Vec<(String, Image)> =
        (0..count).map(at).map(|shot| (format!("{:.2} s", shot.time_s), shot.image.clone())).collect();
    picture::write(path, &picture::sheet(&frames, count))
}

/// Writes a new file. Returns an error if it already exists.
fn create(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    use std::io::Write;
    let mut file = match std::fs::File::create_new(path) {
        Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {
            bail!("{}: already exists. Remove it, or choose another path", path.display())
        }
        file => file.with_context(|| format!("cannot write {}", path.display()))?,
    };
    file.write_all(bytes).with_context(|| format!("cannot write {}", path.display()))
}
