//! What cameras will see and physics does not feel.

use std::fmt;

use robogate_core::Value;

/// Where the front camera is meant to stand: beyond the table, looking back at the workspace. Position and the
/// point it looks at, in metres in the base frame. Occluders stand between it and the object.
pub const FRONT_CAMERA: ([f64; 3], [f64; 3]) = ([1.25, 0.0, 0.55], [0.5, 0.0, 0.05]);

/// How a scene looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visual {
    /// `lighting_lux`: illuminance on the table.
    pub lighting_lux: f64,
    /// `camera_roll_rad`: how far each camera is turned about its line of sight, off where it is meant to be.
    pub camera_roll_rad: f64,
    /// `camera_pitch_rad`: how far it is tilted up.
    pub camera_pitch_rad: f64,
    /// `table_material`: what the table's top looks like.
    pub table_material: TableMaterial,
    /// `background_color`: what stands behind the table.
    pub background_color: Color,
    /// `object_color`: the object.
    pub object_color: Color,
    /// `object_transparency`: share of the light that the object lets through, from 0 to below 1.
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
            object_color: Color([0xc8, 0x3c, 0x28]),
            object_transparency: 0.0,
        }
    }
}

impl Visual {
    /// The value of a visual parameter as the scene holds it.
    pub(crate) fn value(&self, parameter: &str) -> Option<Value> {
        Some(match parameter {
            "lighting_lux" => Value::Number(self.lighting_lux),
            "camera_roll_rad" => Value::Number(self.camera_roll_rad),
            "camera_pitch_rad" => Value::Number(self.camera_pitch_rad),
            "object_transparency" => Value::Number(self.object_transparency),
            "table_material" => Value::Category(self.table_material.word().into()),
            "background_color" => Value::Category(self.background_color.to_string().into()),
            "object_color" => Value::Category(self.object_color.to_string().into()),
            _ => return None,
        })
    }
}

/// What a table's top looks like. Its friction is a parameter of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

    /// Its word in data and settings.
    pub fn word(self) -> &'static str {
        match self {
            Self::Wood => "wood",
            Self::Steel => "steel",
            Self::Laminate => "laminate",
            Self::Rubber => "rubber",
            Self::Cardboard => "cardboard",
        }
    }

    /// The material of that word.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|material| material.word() == word)
    }
}

/// A colour: red, green and blue from 0 to 255 (sRGB), written `#rrggbb` in lower case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Color(pub [u8; 3]);

impl Color {
    /// The colour of that word.
    pub fn from_word(word: &str) -> Option<Self> {
        let digits = word.strip_prefix('#')?;
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
    fn a_color_is_six_lower_case_digits_after_a_hash() {
        assert_eq!(Color::from_word("#c83c28"), Some(Color([200, 60, 40])));
        assert_eq!(Color([0, 10, 255]).to_string(), "#000aff");
        for wrong in ["", "c83c28", "#C83C28", "#c83c2", "#c83c289", "#+83c28", "#é3c28"] {
            assert_eq!(Color::from_word(wrong), None, "{wrong}");
        }
    }
}
