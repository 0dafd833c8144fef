//! Images of an episode: an animation, a video, or a strip of frames.

mod filmed;
mod gif;
mod jpeg;
mod mp4;

use std::path::Path;

use anyhow::bail;
use robogate_core::Image;

pub(crate) use filmed::{Cameras, Filmed, Shot};
pub(crate) use jpeg::{FILM_FRAMES, film};
pub(crate) use mp4::check as check_mp4;

use crate::picture;

/// Number of frames of a strip.
const STRIP_FRAMES: usize = 6;

/// Writes the images of one camera as an animated GIF that repeats without end.
pub(crate) fn write_gif(path: &Path, shots: &[&Shot]) -> anyhow::Result<()> {
    let bytes = gif::encode(shots)?;
    picture::create(path, &bytes)
}

/// Writes the images of one camera as a video.
pub(crate) fn write_mp4(path: &Path, shots: &[&Shot]) -> anyhow::Result<()> {
    mp4::write(path, shots)
}

/// Writes frames at equal distances in time as one PNG, each with its time.
pub(crate) fn write_strip(path: &Path, shots: &[&Shot]) -> anyhow::Result<()> {
    if shots.is_empty() {
        bail!("the episode has no image");
    }
    let last = shots.len() - 1;
    let count = STRIP_FRAMES.min(shots.len());
    let chosen: Vec<&Shot> = (0..count).map(|i| shots[if count > 1 { i * last / (count - 1) } else { 0 }]).collect();
    picture::write(path, &strip(&chosen))
}

/// Shots of equal size in one row, each with its time.
pub(crate) fn strip(shots: &[&Shot]) -> Image {
    let frames: Vec<(String, Image)> =
        shots.iter().map(|shot| (format!("{:.2} s", shot.time_s), shot.image.clone())).collect();
    picture::sheet(&frames, frames.len())
}
