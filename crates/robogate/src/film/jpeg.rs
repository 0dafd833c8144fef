//! Small images for pages.

use anyhow::Context;
use jpeg_encoder::{ColorType, Encoder};
use robogate_core::Image;
use robogate_replay::FilmFrame;

use super::Shot;

/// Number of images of an episode on a page.
pub(crate) const FILM_FRAMES: u32 = 20;
/// The largest width or height of an image, in pixels.
const MOST_PX: usize = 192;
/// The quality of an image, from 1 to 100.
const QUALITY: u8 = 60;
/// The bytes of the images of an episode. Every second one is left out until they fit.
const BUDGET_BYTES: usize = 90_000;

/// The images of an episode for a page.
pub(crate) fn film(shots: &[Shot]) -> anyhow::Result<Vec<FilmFrame>> {
    let frame = |shot: &Shot| {
        let jpeg = jpeg(&smaller(&shot.image, MOST_PX))?;
        Ok(FilmFrame { time_ms: (1e3 * shot.time_s).round() as u32, jpeg })
    };
    let mut frames = shots.iter().map(frame).collect::<anyhow::Result<Vec<FilmFrame>>>()?;
    while frames.len() > 2 && frames.iter().map(|frame| frame.jpeg.len()).sum::<usize>() > BUDGET_BYTES {
        let last = frames.len() - 1;
        let kept = frames.into_iter().enumerate().filter(|(at, _)| at % 2 == 0 || *at == last);
        frames = kept.map(|(_, frame)| frame).collect();
    }
    Ok(frames)
}

fn jpeg(image: &Image) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let [width, height] = [image.width, image.height].map(u16::try_from);
    let (width, height) = (
        width.context("a JPEG is at most 65,535 pixels wide")?,
        height.context("a JPEG is at most 65,535 pixels high")?,
    );
    Encoder::new(&mut bytes, QUALITY).encode(&image.rgb, width, height, ColorType::Rgb)?;
    Ok(bytes)
}

/// The image in a size of at most `most` pixels, each of them the mean of a square of equal size.
fn smaller(image: &Image, most: usize) -> Image {
    let side = image.width.max(image.height).div_ceil(most).max(1);
    let [width, height] = [image.width / side, image.height / side];
    let mut rgb = Vec::with_capacity(3 * width * height);
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        for channel in 0..3 {
            let mut sum = 0;
            for (row, column) in (0..side).flat_map(|row| (0..side).map(move |column| (row, column))) {
                let at = 3 * ((y * side + row) * image.width + x * side + column) + channel;
                sum += image.rgb.get(at).copied().map_or(0, usize::from);
            }
            rgb.push((sum / (side * side)) as u8);
        }
    }
    Image { camera: image.camera.clone(), width, height, rgb }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image with random dots, which hardly compress, or of one grey.
    fn shot(time_s: f64, width: usize, dots: bool) -> Shot {
        let mut state = 7_u32;
        let mut dot = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if dots { (state >> 24) as u8 } else { 128 }
        };
        let rgb = (0..3 * width * width).map(|_| dot()).collect();
        Shot { time_s, image: Image { camera: "front".to_owned(), width, height: width, rgb } }
    }

    #[test]
    fn images_shrink_by_means() {
        let mut image = shot(0.0, 400, false).image;
        image.rgb[..3].fill(255);
        let small = smaller(&image, 192);
        assert_eq!((small.width, small.height), (133, 133));
        assert_eq!((small.rgb[0], small.rgb[3]), (142, 128));
        assert_eq!(smaller(&image, 400), image);
    }

    #[test]
    fn films_are_within_their_budget() {
        let shots: Vec<Shot> = (0..20).map(|i| shot(0.1 * f64::from(i), 192, true)).collect();
        let frames = film(&shots).unwrap();
        assert!(frames.iter().map(|frame| frame.jpeg.len()).sum::<usize>() <= BUDGET_BYTES);
        assert_eq!((frames.first().unwrap().time_ms, frames.last().unwrap().time_ms), (0, 1900));
        let grey: Vec<Shot> = (0..20).map(|i| shot(0.1 * f64::from(i), 192, false)).collect();
        assert_eq!(film(&grey).unwrap().len(), 20);
    }
}
