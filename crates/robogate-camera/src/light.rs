//! The lamp over the cell, and the camera's exposure.

use std::sync::OnceLock;

use nalgebra::Vector3;
use robogate_physics::Color;

/// Share of the table's illuminance that comes from the lamp itself; the rest comes from all around.
const KEY_SHARE: f32 = 0.62;

/// The sine of half the angle under which the lamp is seen: a panel of 40 cm in 2.5 m.
pub(crate) const LAMP_SPREAD: f32 = 0.08;

/// At this illuminance a surface that reflects a third of the light is exposed to the curve's middle, in lux.
const MIDDLE_LUX: f32 = 500.0;
pub(crate) const MIDDLE_ALBEDO: f32 = 0.34;

/// The light in the cell: a lamp far off and light from all around.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Light {
    /// Illuminance on the table, in lux.
    pub(crate) lux: f64,
    /// Towards the lamp.
    pub(crate) towards: Vector3<f32>,
    /// Of a surface that faces the lamp, as exposed.
    pub(crate) key: f32,
    /// Of an upward surface by the light from all around, as exposed.
    pub(crate) around: f32,
}

impl Light {
    pub(crate) fn new(lux: f64) -> Self {
        // From above, from the camera's side and from its left: shadows fall to the right, where they can be seen.
        let towards = Vector3::new(0.38_f32, -0.46, 0.8).normalize();
        let exposed = lux as f32 / (MIDDLE_LUX * MIDDLE_ALBEDO);
        let key = exposed * KEY_SHARE / towards.z;
        Self { lux, towards, key, around: exposed * (1.0 - KEY_SHARE) }
    }

    /// Of an upward surface in full light, as exposed.
    pub(crate) fn full(&self) -> f32 {
        self.key * self.towards.z + self.around
    }
}

/// A colour's reflectances.
pub(crate) fn linear(color: Color) -> Vector3<f32> {
    let channel = |c: u8| {
        let c = f64::from(c) / 255.0;
        (if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }) as f32
    };
    Vector3::from(color.0.map(channel))
}

/// The colour of these reflectances.
pub(crate) fn color(linear: &Vector3<f32>) -> Color {
    Color([linear.x, linear.y, linear.z].map(|x| (255.0 * encode(f64::from(x))).round() as u8))
}

/// The transfer function of sRGB (IEC 61966-2-1).
fn encode(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// The curve is kept for exposures from 2^-12 to 2^12, in so many steps to a doubling.
const OCTAVES: u32 = 24;
const STEP_BITS: u32 = 7;

/// What the camera's sensor makes of light: x / (1 + x), a little steeper in its middle, which no light clips, and sRGB
/// on top. 1 is the middle of the curve.
///
/// The form is that of Naka and Rushton (1966) for photoreceptors: x^n / (x^n + 1), here with n = 1.15.
pub(crate) fn exposed(radiance: &Vector3<f32>) -> [u8; 3] {
    static CURVE: OnceLock<Vec<u8>> = OnceLock::new();
    let lowest = (127 - OCTAVES / 2) << STEP_BITS;
    let curve = CURVE.get_or_init(|| {
        let value = |i: u32| {
            let x = f64::from(f32::from_bits(((lowest + i) << (23 - STEP_BITS)) + (1 << (22 - STEP_BITS)))).powf(1.15);
            (255.0 * encode(x / (1.0 + x))).round() as u8
        };
        (0..OCTAVES << STEP_BITS).map(value).collect()
    });
    // A number's exponent and first binary digits say in which step it lies.
    let channel = |x: f32| {
        let step = (x.max(0.0).to_bits() >> (23 - STEP_BITS)).saturating_sub(lowest);
        curve[(step as usize).min(curve.len() - 1)]
    };
    [channel(radiance.x), channel(radiance.y), channel(radiance.z)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat unshadowed surface of this colour on the table.
    fn seen(color: [u8; 3], lux: f64) -> [u8; 3] {
        let light = Light::new(lux);
        exposed(&(linear(Color(color)) * light.full()))
    }

    #[test]
    fn two_thousand_lux_do_not_clip_and_fifty_are_dark() {
        let [white, grey] = [[240; 3], [225; 3]];
        assert!(seen(white, 2000.0)[0] < 250 && seen(white, 2000.0)[0] > seen(grey, 2000.0)[0]);
        assert!(seen([128; 3], 50.0)[0] < 60, "{:?}", seen([128; 3], 50.0));
        let middle = seen([128; 3], 500.0)[0];
        assert!((90..170).contains(&middle), "{middle}");
    }

    #[test]
    fn more_light_is_never_darker() {
        let mut last = 0;
        for lux in [1.0, 10.0, 50.0, 200.0, 500.0, 2000.0, 1e4, 1e5] {
            let now = seen([100; 3], lux)[0];
            assert!(now > last, "{lux} lux");
            last = now;
        }
    }

    #[test]
    fn colours_come_back_from_their_reflectances() {
        for value in 0..=255 {
            assert_eq!(color(&linear(Color([value; 3]))), Color([value; 3]));
        }
    }
}
