//! Compares an image of a cell's camera with the images that the judged policy got from it.

use super::Fingerprint;
use super::changes::{PICTURES, rearranged};
use crate::array::{Array, Dtype};

/// Pixels along each side of the small images that are compared.
const SIDE: usize = 24;
/// The correlation from which on two images show the same, and the distance to the next best reading.
const SAME: f64 = 0.5;
const APART: f64 = 0.15;

/// An image of a camera of a cell: 8 bits each of red, green and blue, row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CellImage {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// The pixels.
    pub rgb: Vec<u8>,
}

/// What an image of a camera tells.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraCheck {
    /// The differences, in words.
    pub differences: Vec<String>,
    /// Whether orientation and colours can be told: the image is more like the judged ones in one reading than in all others.
    pub told: bool,
}

/// Compares the image of the camera with this name. `native` is the size of the judged camera itself (width, height), which the cell may
/// have too. A camera has the name that the server uses, or that of the environment.
pub fn compare_camera(
    judged: &Fingerprint,
    name: &str,
    image: &CellImage,
    native: impl Fn(&str) -> Option<[usize; 2]>,
) -> CameraCheck {
    let mut check = CameraCheck::default();
    let cameras = &judged.profile.cameras;
    let Some(camera) =
        cameras.iter().find(|of| of.key == name || of.from == name || of.or_from.iter().any(|n| n == name))
    else {
        let known: Vec<&str> = cameras.iter().map(|of| of.key.as_str()).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        check.differences.push(format!("the policy has no camera {name}; it has: {known}"));
        return check;
    };
    let [w, h] = [image.width, image.height];
    let sizes = [Some([camera.width, camera.height]), native(&camera.from)];
    if !sizes.contains(&Some([w, h])) {
        let sizes: Vec<String> = sizes.into_iter().flatten().map(|[w, h]| format!("{w} x {h}")).collect();
        check.differences.push(format!("the camera {name} has {w} x {h} pixels in place of {}", sizes.join(" or ")));
    }
    let Some(own) = Array::new(Dtype::U8, vec![h, w, 3], image.rgb.clone()).ok().filter(|_| w > 0 && h > 0) else {
        check.differences.push(format!("the image of the camera {name} is empty"));
        return check;
    };
    let images = judged.probes.iter().flat_map(|probe| &probe.query.images);
    let seen: Vec<Vec<f64>> =
        images.filter(|(key, _)| *key == camera.key).filter_map(|(_, array)| small(array)).collect();
    let score = |array: &Array| {
        let own = small(array)?;
        Some(seen.iter().map(|one| correlation(&own, one)).fold(f64::NEG_INFINITY, f64::max))
    };
    let (_, bgr) = PICTURES[3];
    let exchanged = rearranged(&own, bgr);
    let mut readings: Vec<(String, f64)> = Vec::new();
    for (array, colours) in [(Some(&own), None), (exchanged.as_ref(), Some(PICTURES[3].0))] {
        let Some(array) = array else { continue };
        readings.extend(score(array).map(|s| (colours.unwrap_or_default().to_owned(), s)));
        for (words, source) in &PICTURES[..3] {
            let Some(score) = rearranged(array, *source).and_then(|array| score(&array)) else { continue };
            let words = [Some(*words), colours].into_iter().flatten().collect::<Vec<_>>().join(", ");
            readings.push((words, score));
        }
    }
    let Some((_, plain)) = readings.first().cloned() else { return check };
    readings.sort_by(|a, b| b.1.total_cmp(&a.1));
    let (words, best) = &readings[0];
    let next = readings.get(1).map_or(f64::NEG_INFINITY, |(_, score)| *score);
    check.told = *best >= SAME && best - next >= APART;
    if !words.is_empty() && *best >= SAME && best - plain >= APART {
        check.differences.push(format!("the images of the camera {name} arrive {words}"));
    }
    check
}

/// A small image without its mean. The last of a stack of images.
fn small(image: &Array) -> Option<Vec<f64>> {
    let size = &image.shape()[image.shape().len().checked_sub(3)?..];
    let (h, w, planes) = match size {
        [h, w, 3] => (*h, *w, false),
        [3, h, w] => (*h, *w, true),
        _ => return None,
    };
    if image.dtype() != Dtype::U8 || h == 0 || w == 0 {
        return None;
    }
    let data = &image.data()[image.data().len().checked_sub(3 * h * w)?..];
    let at = |y: usize, x: usize, c: usize| if planes { (c * h + y) * w + x } else { (y * w + x) * 3 + c };
    let mut values = Vec::with_capacity(3 * SIDE * SIDE);
    // The mean of each part; of an image with fewer pixels, the nearest one.
    let part = |i: usize, n: usize| (i * n / SIDE)..((i + 1) * n / SIDE).max(i * n / SIDE + 1).min(n);
    for (i, j) in (0..SIDE).flat_map(|i| (0..SIDE).map(move |j| (i, j))) {
        for c in 0..3 {
            let pixels = part(i, h).flat_map(|y| part(j, w).map(move |x| (y, x)));
            let (sum, n) = pixels.fold((0.0, 0.0), |(sum, n), (y, x)| (sum + f64::from(data[at(y, x, c)]), n + 1.0));
            values.push(sum / f64::max(n, 1.0));
        }
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter_mut().for_each(|x| *x -= mean);
    Some(values)
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let scale = (dot(a, a) * dot(b, b)).sqrt();
    if scale > 1e-9 { dot(a, b) / scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk::Chunk;
    use crate::fingerprint::Probe;
    use crate::profile::Profile;
    use crate::query::Query;

    const SIZE: usize = 32;

    /// A scene with a red corner, a green edge and a grey floor; `shift` moves a part.
    fn scene(shift: usize) -> Vec<u8> {
        let pixel = |y: usize, x: usize| -> [u8; 3] {
            match (y, x) {
                (0..10, 0..12) => [220, 40, 30],
                (_, 26..) => [30, 200, 60],
                (y, x) if y > 20 && x.abs_diff(10 + shift) < 3 => [250, 250, 250],
                _ => [90, 90, 100],
            }
        };
        (0..SIZE).flat_map(|y| (0..SIZE).flat_map(move |x| pixel(y, x))).collect()
    }

    fn judged() -> Fingerprint {
        let text = "name = \"p\"\nmodel = \"m\"\n[dialect]\nname = \"openpi\"\n[[camera]]\nfrom = \"front\"\nkey = \"image\"\nwidth = 32\nheight = 32\n\
                    [action]\nsize = 1\narm = \"vector\"\n[chunk]\nexecute = 1\n";
        let probe = |shift: usize| {
            let image = Array::new(Dtype::U8, vec![SIZE, SIZE, 3], scene(shift)).unwrap();
            let query = Query {
                images: vec![("image".to_owned(), image)],
                states: Vec::new(),
                instruction: String::new(),
                step: 0,
                time_s: 0.0,
            };
            Probe { query, answers: vec![Chunk::of_rows(vec![vec![0.0]]).unwrap()] }
        };
        Fingerprint {
            profile: Profile::from_toml(text).unwrap(),
            declared: serde_json::Value::Null,
            control_period_s: 0.05,
            used: Vec::new(),
            probes: (0..4).map(probe).collect(),
        }
    }

    fn check(rgb: Vec<u8>, size: [usize; 2]) -> CameraCheck {
        let image = CellImage { width: size[0], height: size[1], rgb };
        compare_camera(&judged(), "front", &image, |_| Some([640, 480]))
    }

    #[test]
    fn orientation_and_colours_are_told() {
        let fine = check(scene(5), [SIZE; 2]);
        assert!(fine.told && fine.differences.is_empty(), "{fine:?}");
        let original = Array::new(Dtype::U8, vec![SIZE, SIZE, 3], scene(2)).unwrap();
        for (words, source) in PICTURES {
            let wrong = check(rearranged(&original, source).unwrap().data().to_vec(), [SIZE; 2]);
            assert_eq!(wrong.differences.len(), 1, "{words}: {wrong:?}");
            assert!(wrong.differences[0].ends_with(words), "{words}: {wrong:?}");
        }
    }

    #[test]
    fn sizes_and_names_are_compared() {
        let grey = check(vec![128; 3 * 640 * 480], [640, 480]);
        assert_eq!((grey.differences.len(), grey.told), (0, false), "a grey image tells nothing: {grey:?}");
        let other = check(vec![128; 3 * 320 * 240], [320, 240]);
        assert_eq!(other.differences, ["the camera front has 320 x 240 pixels in place of 32 x 32 or 640 x 480"]);
        let image = CellImage { width: 0, height: 0, rgb: Vec::new() };
        let unknown = compare_camera(&judged(), "wrist", &image, |_| None);
        assert_eq!(unknown.differences, ["the policy has no camera wrist; it has: image"]);
        assert!(!compare_camera(&judged(), "front", &image, |_| None).differences.is_empty());
    }
}
