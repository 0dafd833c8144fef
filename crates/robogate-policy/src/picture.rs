//! Image preprocessing, as in the training of models: rotation, crop, resize, padding.

use robogate_core::Image;

use super::buffers::Buffers;
use super::profile::{Camera, Filter, Fit, Orientation};
use super::resample::Taps;

/// An image with rows of red, green and blue, from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `3 x width x height` bytes.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// Convert an image of a camera as the profile says. Returns `None` if its size does not match its data.
    pub(crate) fn from_image(image: &Image, camera: &Camera, buffers: &mut Buffers) -> Option<Self> {
        let Image { width, height, rgb, .. } = image;
        if *width == 0 || *height == 0 || width.checked_mul(*height)?.checked_mul(3)? != rgb.len() {
            return None;
        }
        let original = View { width: *width, height: *height, rgb };
        // The official clients rotate first, too.
        let rotated = original.oriented(camera.orientation(), buffers);
        let upright = rotated.as_ref().map_or(original, Self::view);
        let cropped = (camera.crop < 1.0).then(|| upright.cropped(camera.crop, buffers));
        let middle = cropped.as_ref().map_or(upright, Self::view);
        let picture = match camera.fit {
            Fit::Stretch => middle.resized(camera.width, camera.height, camera.filter, buffers),
            Fit::Pad => middle.padded(camera.width, camera.height, camera.filter, buffers),
        };
        rotated.into_iter().chain(cropped).for_each(|intermediate| buffers.recycle(intermediate.rgb));
        Some(picture)
    }

    /// The pixels of an image in this orientation. `None` if they do not change, or if their number does not match the size.
    pub(crate) fn reoriented(image: &Image, orientation: Orientation) -> Option<Vec<u8>> {
        let Image { width, height, rgb, .. } = image;
        let view = View { width: *width, height: *height, rgb };
        (3 * width * height == rgb.len())
            .then(|| view.oriented(orientation, &mut Buffers::default()))?
            .map(|new| new.rgb)
    }

    /// Exchange top and bottom.
    fn flip(&mut self) {
        let row = 3 * self.width;
        for y in 0..self.height / 2 {
            let (top, bottom) = self.rgb.split_at_mut((self.height - 1 - y) * row);
            top[y * row..][..row].swap_with_slice(&mut bottom[..row]);
        }
    }

    fn view(&self) -> View<'_> {
        View { width: self.width, height: self.height, rgb: &self.rgb }
    }

    /// The colour planes one after the other (channel, height, width).
    pub(crate) fn planes(&self, buffers: &mut Buffers) -> Vec<u8> {
        let (pixels, _) = self.rgb.as_chunks::<3>();
        let mut planes = buffers.take();
        (0..3).for_each(|colour| planes.extend(pixels.iter().map(|pixel| pixel[colour])));
        planes
    }
}

/// A borrowed image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View<'a> {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) rgb: &'a [u8],
}

impl View<'_> {
    /// The image in this orientation. `None` if it does not change.
    fn oriented(self, orientation: Orientation, buffers: &mut Buffers) -> Option<Picture> {
        match orientation {
            Orientation::Upright => None,
            Orientation::Rotated => Some(self.rotated(buffers)),
            Orientation::Mirrored => {
                let mut picture = self.rotated(buffers);
                picture.flip();
                Some(picture)
            }
            Orientation::Flipped => {
                let Self { width, height, rgb } = self;
                let mut copy = buffers.take();
                copy.extend_from_slice(rgb);
                let mut picture = Picture { width, height, rgb: copy };
                picture.flip();
                Some(picture)
            }
        }
    }

    /// Rotate by 180 degrees.
    fn rotated(self, buffers: &mut Buffers) -> Picture {
        let mut rgb = buffers.take();
        rgb.extend_from_slice(self.rgb);
        rgb.as_chunks_mut::<3>().0.reverse();
        Picture { width: self.width, height: self.height, rgb }
    }

    /// Crop to the centre, which keeps this fraction of the width and the height.
    fn cropped(self, fraction: f64, buffers: &mut Buffers) -> Picture {
        let cut = |side: usize| ((side as f64 * fraction).round() as usize).clamp(1, side);
        let (width, height) = (cut(self.width), cut(self.height));
        let (x, y) = ((self.width - width) / 2, (self.height - height) / 2);
        let mut rgb = buffers.take();
        let rows = self.rgb.chunks_exact(3 * self.width).skip(y).take(height);
        rows.for_each(|row| rgb.extend_from_slice(&row[3 * x..3 * (x + width)]));
        Picture { width, height, rgb }
    }

    /// Resize with the same aspect ratio and pad with black (openpi-client's `resize_with_pad`).
    fn padded(self, width: usize, height: usize, filter: Filter, buffers: &mut Buffers) -> Picture {
        let ratio = (self.width as f64 / width as f64).max(self.height as f64 / height as f64);
        let fitted = |side: usize, limit: usize| ((side as f64 / ratio) as usize).clamp(1, limit);
        let inner = self.resized(fitted(self.width, width), fitted(self.height, height), filter, buffers);
        if (inner.width, inner.height) == (width, height) {
            return inner;
        }
        let (left, top) = ((width - inner.width) / 2, (height - inner.height) / 2);
        let mut rgb = buffers.take();
        rgb.resize(3 * width * height, 0);
        let rows = rgb.chunks_exact_mut(3 * width).skip(top).zip(inner.rgb.chunks_exact(3 * inner.width));
        rows.for_each(|(row, inner_row)| row[3 * left..3 * (left + inner.width)].copy_from_slice(inner_row));
        buffers.recycle(inner.rgb);
        Picture { width, height, rgb }
    }

    /// Resample exactly as Pillow does: first along the rows, then along the columns.
    fn resized(self, width: usize, height: usize, filter: Filter, buffers: &mut Buffers) -> Picture {
        let mut rgb = buffers.take();
        match (width == self.width, height == self.height) {
            (true, true) => rgb.extend_from_slice(self.rgb),
            (false, true) => Taps::new(self.width, width, filter).across(self, &mut rgb),
            (true, false) => Taps::new(self.height, height, filter).down(self, &mut rgb),
            (false, false) => {
                let mut intermediate = buffers.take();
                Taps::new(self.width, width, filter).across(self, &mut intermediate);
                let narrow = View { width, height: self.height, rgb: &intermediate };
                Taps::new(self.height, height, filter).down(narrow, &mut rgb);
                buffers.recycle(intermediate);
            }
        }
        Picture { width, height, rgb }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The image that `tests/pillow.py` resizes.
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
    fn resizing_matches_pillow() {
        let expected: Vec<(usize, usize, &str, u64)> = include_str!("../tests/pillow.txt")
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| {
                let words: Vec<&str> = line.split_whitespace().collect();
                (words[1].parse().unwrap(), words[2].parse().unwrap(), words[0], words[3].parse().unwrap())
            })
            .collect();
        assert_eq!(expected.len(), 8);
        let mut buffers = Buffers::default();
        for (width, height, what, want) in expected {
            let got = match what {
                "bilinear" => picture().view().resized(width, height, Filter::Bilinear, &mut buffers),
                "lanczos" => picture().view().resized(width, height, Filter::Lanczos, &mut buffers),
                _ => picture().view().padded(width, height, Filter::Bilinear, &mut buffers),
            };
            assert_eq!(hash(&got.rgb), want, "{what} {width}x{height}");
            // The next image must not depend on the content of the buffer.
            buffers.recycle(got.rgb);
        }
    }

    #[test]
    fn rotation_reverses_pixels() {
        let original = picture();
        let rotated = original.view().rotated(&mut Buffers::default());
        assert_eq!(rotated.rgb[..3], original.rgb[original.rgb.len() - 3..]);
        assert_eq!(rotated.view().rotated(&mut Buffers::default()), original);
    }

    #[test]
    fn mirroring_exchanges_left_and_right() {
        let original = picture();
        let mirrored = original.view().oriented(Orientation::Mirrored, &mut Buffers::default()).unwrap();
        let flipped = mirrored.view().oriented(Orientation::Flipped, &mut Buffers::default()).unwrap();
        assert_eq!(mirrored.rgb[..3], original.rgb[3 * 12..3 * 13]);
        assert_eq!(flipped, original.view().rotated(&mut Buffers::default()));
    }

    #[test]
    fn crops_keep_the_centre() {
        let cropped = picture().view().cropped(0.5, &mut Buffers::default());
        assert_eq!((cropped.width, cropped.height), (7, 5));
        let original = picture();
        assert_eq!(cropped.rgb[..3], original.rgb[3 * (2 * 13 + 3)..3 * (2 * 13 + 3) + 3]);
    }
}
