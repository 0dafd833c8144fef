//! Animated GIF.

use anyhow::{Context, bail};
use gif::{Encoder, Frame, Repeat};

use super::Shot;

/// The quality of the palette, from 1 (best) to 30 (fastest).
const PALETTE_SPEED: i32 = 10;
/// How long the last frame stays, in hundredths of a second.
const LAST_CS: u16 = 150;

/// Encodes shots of equal size. Times are rounded to hundredths of a second, the unit of the format.
pub(super) fn encode(shots: &[&Shot]) -> anyhow::Result<Vec<u8>> {
    let Some(first) = shots.first() else { bail!("the episode has no image") };
    let width = u16::try_from(first.image.width).context("a GIF is at most 65,535 pixels wide")?;
    let height = u16::try_from(first.image.height).context("a GIF is at most 65,535 pixels high")?;
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, width, height, &[])?;
    encoder.set_repeat(Repeat::Infinite)?;
    for (i, shot) in shots.iter().enumerate() {
        if (shot.image.width, shot.image.height) != (first.image.width, first.image.height) {
            bail!("the images of the camera {} have different sizes", first.image.camera);
        }
        let mut frame = Frame::from_rgb_speed(width, height, &shot.image.rgb, PALETTE_SPEED);
        let hundredths = |time_s: f64| (100.0 * time_s).round();
        frame.delay = match shots.get(i + 1) {
            Some(next) => (hundredths(next.time_s) - hundredths(shot.time_s)).clamp(1.0, 6000.0) as u16,
            None => LAST_CS,
        };
        encoder.write_frame(&frame)?;
    }
    drop(encoder);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use robogate_core::Image;

    use super::*;

    #[test]
    fn frames_keep_their_times() {
        let shot = |time_s: f64, grey: u8| Shot {
            time_s,
            image: Image { camera: "front".to_owned(), width: 8, height: 6, rgb: vec![grey; 3 * 48] },
        };
        let shots = [shot(0.0, 10), shot(0.05, 120), shot(0.2, 250)];
        let bytes = encode(&shots.iter().collect::<Vec<_>>()).unwrap();
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(&*bytes).unwrap();
        let mut delays = Vec::new();
        let mut greys = Vec::new();
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            delays.push(frame.delay);
            greys.push(frame.buffer[0]);
        }
        assert_eq!(delays, [5, 15, LAST_CS]);
        assert_eq!(greys, [10, 120, 250]);
    }

    #[test]
    fn empty_episodes_are_refused() {
        assert!(encode(&[]).unwrap_err().to_string().contains("no image"));
    }
}
