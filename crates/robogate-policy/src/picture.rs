//! Pictures as the models were shown them: cropped, resized, padded, turned.

use robogate_core::Image;

use super::profile::{Camera, Filter, Fit};
use super::resample::Taps;
use super::spare::Spare;

/// Rows of red, green and blue, from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `3 x width x height` bytes.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// What a camera shows, as the profile wants it; `None` where the image is not as large as it says.
    pub(crate) fn taken(image: &Image, camera: &Camera, spare: &mut Spare) -> Option<Self> {
        let Image { width, height, rgb, .. } = image;
        if *width == 0 || *height == 0 || width.checked_mul(*height)?.checked_mul(3)? != rgb.len() {
            return None;
        }
        let shown = View { width: *width, height: *height, rgb };
        // Official clients turn the picture before anything else.
        let turned = camera.turned.then(|| shown.turned(spare));
        let upright = turned.as_ref().map_or(shown, Self::view);
        let cropped = (camera.crop < 1.0).then(|| upright.cropped(camera.crop, spare));
        let middle = cropped.as_ref().map_or(upright, Self::view);
        let picture = match camera.fit {
            Fit::Stretch => middle.resized(camera.width, camera.height, camera.filter, spare),
            Fit::Pad => middle.padded(camera.width, camera.height, camera.filter, spare),
        };
        turned.into_iter().chain(cropped).for_each(|between| spare.give(between.rgb));
        Some(picture)
    }

    fn view(&self) -> View<'_> {
        View { width: self.width, height: self.height, rgb: &self.rgb }
    }

    /// One plane for each colour, one after the other.
    pub(crate) fn planes(&self, spare: &mut Spare) -> Vec<u8> {
        let (pixels, _) = self.rgb.as_chunks::<3>();
        let mut planes = spare.take();
        (0..3).for_each(|colour| planes.extend(pixels.iter().map(|pixel| pixel[colour])));
        planes
    }
}

/// A picture that belongs to somebody else.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View<'a> {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) rgb: &'a [u8],
}

impl View<'_> {
    /// By 180 degrees.
    fn turned(self, spare: &mut Spare) -> Picture {
        let mut rgb = spare.take();
        rgb.extend_from_slice(self.rgb);
        rgb.as_chunks_mut::<3>().0.reverse();
        Picture { width: self.width, height: self.height, rgb }
    }

    /// The middle, with `share` of each side.
    fn cropped(self, share: f64, spare: &mut Spare) -> Picture {
        let cut = |side: usize| ((side as f64 * share).round() as usize).clamp(1, side);
        let (width, height) = (cut(self.width), cut(self.height));
        let (x, y) = ((self.width - width) / 2, (self.height - height) / 2);
        let mut rgb = spare.take();
        let rows = self.rgb.chunks_exact(3 * self.width).skip(y).take(height);
        rows.for_each(|row| rgb.extend_from_slice(&row[3 * x..3 * (x + width)]));
        Picture { width, height, rgb }
    }

    /// Made to fit without distortion, with black about it (openpi-client's `resize_with_pad`).
    fn padded(self, width: usize, height: usize, filter: Filter, spare: &mut Spare) -> Picture {
        let ratio = (self.width as f64 / width as f64).max(self.height as f64 / height as f64);
        let fitted = |side: usize, limit: usize| ((side as f64 / ratio) as usize).clamp(1, limit);
        let inner = self.resized(fitted(self.width, width), fitted(self.height, height), filter, spare);
        if (inner.width, inner.height) == (width, height) {
            return inner;
        }
        let (left, top) = ((width - inner.width) / 2, (height - inner.height) / 2);
        let mut rgb = spare.take();
        rgb.resize(3 * width * height, 0);
        let rows = rgb.chunks_exact_mut(3 * width).skip(top).zip(inner.rgb.chunks_exact(3 * inner.width));
        rows.for_each(|(row, inner_row)| row[3 * left..3 * (left + inner.width)].copy_from_slice(inner_row));
        spare.give(inner.rgb);
        Picture { width, height, rgb }
    }

    /// Resampled as Pillow does it, to the bit: first along the rows, then along the columns.
    fn resized(self, width: usize, height: usize, filter: Filter, spare: &mut Spare) -> Picture {
        let mut rgb = spare.take();
        match (width == self.width, height == self.height) {
            (true, true) => rgb.extend_from_slice(self.rgb),
            (false, true) => Taps::new(self.width, width, filter).across(self, &mut rgb),
            (true, false) => Taps::new(self.height, height, filter).down(self, &mut rgb),
            (false, false) => {
                let mut between = spare.take();
                Taps::new(self.width, width, filter).across(self, &mut between);
                let narrow = View { width, height: self.height, rgb: &between };
                Taps::new(self.height, height, filter).down(narrow, &mut rgb);
                spare.give(between);
            }
        }
        Picture { width, height, rgb }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The picture that `tests/pillow.py` resizes.
    fn picture() -> Picture {
        let (width, height) = (13, 9);
        let rgb = (0..3 * width * height).map(|i| (i * i * 7 + i * 31) as u8).collect();
        Picture { width, height, rgb }
    }

    /// FNV-1a, as in `tests/pillow.py`.
    fn hash(bytes: &[u8]) -> u64 {
        bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3))
    }

    #[test]
    fn pictures_are_resized_as_pillow_resizes_them_to_the_bit() {
        let expected: Vec<(usize, usize, &str, u64)> = include_str!("../tests/pillow.txt")
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| {
                let words: Vec<&str> = line.split_whitespace().collect();
                (words[1].parse().unwrap(), words[2].parse().unwrap(), words[0], words[3].parse().unwrap())
            })
            .collect();
        assert_eq!(expected.len(), 8);
        let mut spare = Spare::default();
        for (width, height, what, want) in expected {
            let got = match what {
                "bilinear" => picture().view().resized(width, height, Filter::Bilinear, &mut spare),
                "lanczos" => picture().view().resized(width, height, Filter::Lanczos, &mut spare),
                _ => picture().view().padded(width, height, Filter::Bilinear, &mut spare),
            };
            assert_eq!(hash(&got.rgb), want, "{what} {width}x{height}");
            // Whatever the memory held before.
            spare.give(got.rgb);
        }
    }

    #[test]
    fn turning_twice_changes_nothing_and_once_brings_the_last_pixel_first() {
        let original = picture();
        let turned = original.view().turned(&mut Spare::default());
        assert_eq!(turned.rgb[..3], original.rgb[original.rgb.len() - 3..]);
        assert_eq!(turned.view().turned(&mut Spare::default()), original);
    }

    #[test]
    fn a_crop_keeps_the_middle() {
        let cropped = picture().view().cropped(0.5, &mut Spare::default());
        assert_eq!((cropped.width, cropped.height), (7, 5));
        let original = picture();
        assert_eq!(cropped.rgb[..3], original.rgb[3 * (2 * 13 + 3)..3 * (2 * 13 + 3) + 3]);
    }
}
