//! The lamp over the cell, and the camera's exposure.

use std::sync::OnceLock;

use nalgebra::Vector3;
use robogate_physics::Color;

/// Fraction of the table's illuminance that comes from the lamp; the rest is ambient light.
const KEY_SHARE: f32 = 0.62;

/// Sine of half the angular size of the lamp: a panel of 40 cm at 2.5 m.
pub(crate) const LAMP_SPREAD: f32 = 0.08;

/// Illuminance in lux at which a surface with [`MIDDLE_ALBEDO`] is exposed to the middle of the curve.
const MIDDLE_LUX: f32 = 500.0;
pub(crate) const MIDDLE_ALBEDO: f32 = 0.34;

/// The light in the cell: a distant lamp and ambient light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Light {
    /// Illuminance on the table, in lux.
    pub(crate) lux: f64,
    /// Direction towards the lamp.
    pub(crate) towards: Vector3<f32>,
    /// Exposed light on a surface that faces the lamp.
    pub(crate) key: f32,
    /// Exposed ambient light on an upward surface.
    pub(crate) around: f32,
}

impl Light {
    pub(crate) fn new(lux: f64) -> Self {
        // From above, from the camera's side and from its left. Shadows fall to the right, where they are visible.
        let towards = Vector3::new(0.38_f32, -0.46, 0.8).normalize();
        let exposed = lux as f32 / (MIDDLE_LUX * MIDDLE_ALBEDO);
        let key = exposed * KEY_SHARE / towards.z;
        Self { lux, towards, key, around: exposed * (1.0 - KEY_SHARE) }
    }

    /// Exposed light on an upward surface in full light.
    pub(crate) fn full(&self) -> f32 {
        self.key * self.towards.z + self.around
    }
}

/// Reflectances of a colour.
pub(crate) fn linear(color: Color) -> Vector3<f32> {
    let channel = |c: u8| {
        let c = f64::from(c) / 255.0;
        (if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }) as f32
    };
    Vector3::from(color.0.map(channel))
}

/// Colour of these reflectances.
pub(crate) fn color(linear: &Vector3<f32>) -> Color {
    Color([linear.x, linear.y, linear.z].map(|x| (255.0 * encode(f64::from(x))).round() as u8))
}

/// The transfer function of sRGB (IEC 61966-2-1).
fn encode(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// The curve is tabulated for exposures from 2^-12 to 2^12, with 2^[`STEP_BITS`] steps to a doubling.
const OCTAVES: u32 = 24;
const STEP_BITS: u32 = 7;

/// The response of the camera's sensor in sRGB: x^n / (x^n + 1) with n = 1.15, the form of Naka and Rushton (1966) for
/// photoreceptors. It never saturates. 1 is the middle of the curve.
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
    // Exponent and leading mantissa bits of a number give its step.
    let channel = |x: f32| {
        let step = (x.max(0.0).to_bits() >> (23 - STEP_BITS)).saturating_sub(lowest);
        curve[(step as usize).min(curve.len() - 1)]
    };
    [channel(radiance.x), channel(radiance.y), channel(radiance.z)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixel of a flat surface of this colour on the table without shadow.
    fn seen(color: [u8; 3], lux: f64) -> [u8; 3] {
        let light = Light::new(lux);
        exposed(&(linear(Color(color)) * light.full()))
    }

    #[test]
    fn exposure_covers_usual_light() {
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
    fn colours_can_be_read_back() {
        for value in 0..=255 {
            assert_eq!(color(&linear(Color([value; 3]))), Color([value; 3]));
        }
    }
}
