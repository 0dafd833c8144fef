//! Appearance of a scene: properties that affect cameras but not physics.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::plain;

/// Appearance of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Visual {
    /// Illuminance on the table, in lux.
    pub lighting_lux: f64,
    /// Rotation of each camera about its line of sight, from its nominal pose, in radians.
    pub camera_roll_rad: f64,
    /// Upward tilt of each camera from its nominal pose, in radians.
    pub camera_pitch_rad: f64,
    /// Material of the table's top.
    pub table_material: TableMaterial,
    /// Colour of the background behind the table.
    #[serde(with = "plain")]
    pub background_color: Color,
    /// Colour of the object. In messages it is part of the object.
    #[serde(skip, default = "object_color")]
    pub object_color: Color,
    /// Fraction of the light that passes through the object, from 0 to below 1.
    pub object_transparency: f64,
}

impl Default for Visual {
    fn default() -> Self {
        Self {
            lighting_lux: 500.0,
            camera_roll_rad: 0.0,
            camera_pitch_rad: 0.0,
            table_material: TableMaterial::Wood,
            background_color: Color([0xb8, 0xbc, 0xc0]),
            object_color: object_color(),
            object_transparency: 0.0,
        }
    }
}

/// The colour of an object that has none of its own.
fn object_color() -> Color {
    Color([0xc8, 0x3c, 0x28])
}

/// Material of a table's top. It has no effect on friction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TableMaterial {
    /// Varnished wood.
    Wood,
    /// Brushed steel.
    Steel,
    /// White laminate.
    Laminate,
    /// A black rubber mat.
    Rubber,
    /// Cardboard.
    Cardboard,
}

impl TableMaterial {
    /// Every material.
    pub const ALL: [Self; 5] = [Self::Wood, Self::Steel, Self::Laminate, Self::Rubber, Self::Cardboard];

    /// The name in data files and settings.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Wood => "wood",
            Self::Steel => "steel",
            Self::Laminate => "laminate",
            Self::Rubber => "rubber",
            Self::Cardboard => "cardboard",
        }
    }

    /// The material with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|material| material.as_str() == name)
    }
}

/// A colour: red, green and blue from 0 to 255 (sRGB), written `#rrggbb` in lower case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Color(pub [u8; 3]);

impl Color {
    /// Parses a colour.
    pub fn from_hex(text: &str) -> Option<Self> {
        let digits = text.strip_prefix('#')?;
        if digits.len() != 6 || !digits.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b)) {
            return None;
        }
        let [_, red, green, blue] = u32::from_str_radix(digits, 16).ok()?.to_be_bytes();
        Some(Self([red, green, blue]))
    }
}

impl fmt::Display for Color {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [red, green, blue] = self.0;
        write!(f, "#{red:02x}{green:02x}{blue:02x}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn color_syntax_is_strict() {
        assert_eq!(Color::from_hex("#c83c28"), Some(Color([200, 60, 40])));
        assert_eq!(Color([0, 10, 255]).to_string(), "#000aff");
        for wrong in ["", "c83c28", "#C83C28", "#c83c2", "#c83c289", "#+83c28", "#é3c28"] {
            assert_eq!(Color::from_hex(wrong), None, "{wrong}");
        }
    }
}
