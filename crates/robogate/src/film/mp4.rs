//! Video by the program `ffmpeg`. No encoder of a common format is small enough to be part of every build.

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, anyhow, bail};

use super::Shot;
use crate::picture;

/// The encoder.
const FFMPEG: &str = "ffmpeg";

/// Returns an error that says how to install `ffmpeg`, if it is missing.
pub(crate) fn check() -> anyhow::Result<()> {
    match Command::new(FFMPEG).arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status()
    {
        Ok(_) => Ok(()),
        Err(e) if e.kind() == ErrorKind::NotFound => Err(anyhow!(
            "--mp4: the program `ffmpeg` is not installed, and it encodes the video\nHint: install it (`apt install ffmpeg`), or \
             write an animation with --gif"
        )),
        Err(e) => Err(anyhow!("--mp4: cannot start the program `ffmpeg`: {e}")),
    }
}

/// Writes shots of equal size and equal distances in time as a new MP4 file.
pub(super) fn write(path: &Path, shots: &[&Shot]) -> anyhow::Result<()> {
    let Some(first) = shots.first() else { bail!("the episode has no image") };
    let last = shots.last().unwrap_or(first);
    let (width, height) = (first.image.width, first.image.height);
    if shots.iter().any(|shot| (shot.image.width, shot.image.height) != (width, height)) {
        bail!("the images of the camera {} have different sizes", first.image.camera);
    }
    let seconds = last.time_s - first.time_s;
    let rate = if shots.len() > 1 && seconds > 0.0 { (shots.len() - 1) as f64 / seconds } else { 1.0 };
    // Keeps an existing file, and reserves the name.
    picture::create(path, &[])?;
    let encoded = encode(path, [width, height], rate, shots);
    if encoded.is_err() {
        // Only the name was reserved. The first error is the one that matters.
        let _ = std::fs::remove_file(path);
    }
    encoded
}

/// Runs `ffmpeg` over the images as raw video.
fn encode(path: &Path, [width, height]: [usize; 2], rate: f64, shots: &[&Shot]) -> anyhow::Result<()> {
    // A name that contains a colon or begins with a dash is a file too.
    let file = format!("file:{}", path.to_str().context("--mp4: the path is not valid UTF-8")?);
    let mut process = Command::new(FFMPEG)
        .args(["-nostdin", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .args(["-video_size", &format!("{width}x{height}"), "-framerate", &format!("{rate:.6}"), "-i", "pipe:0", "-an"])
        // Players expect even sizes and colours at half the resolution.
        .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2,format=yuv420p", "-movflags", "+faststart", "-f", "mp4", &file])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start the program `ffmpeg`")?;
    let sent = process
        .stdin
        .take()
        .map_or(Ok(()), |mut pipe| shots.iter().try_for_each(|shot| pipe.write_all(&shot.image.rgb)));
    let output = process.wait_with_output().context("cannot wait for the program `ffmpeg`")?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        bail!("ffmpeg cannot encode {}: {}", path.display(), said.trim());
    }
    sent.with_context(|| format!("ffmpeg did not read all images of {}", path.display()))
}
