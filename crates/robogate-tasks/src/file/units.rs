//! Quantities as text: a number with a unit.

use std::fmt;

use crate::settings::unit_of;

/// Exponents of metre, kilogram, second and radian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Dimension([i8; 4]);

impl Dimension {
    pub(super) const NONE: Self = Self([0, 0, 0, 0]);
    pub(super) const LENGTH: Self = Self([1, 0, 0, 0]);
    pub(super) const MASS: Self = Self([0, 1, 0, 0]);
    pub(super) const TIME: Self = Self([0, 0, 1, 0]);
    pub(super) const ANGLE: Self = Self([0, 0, 0, 1]);
    pub(super) const FORCE: Self = Self([1, 1, -2, 0]);
    pub(super) const TORQUE: Self = Self([2, 1, -2, 0]);
    pub(super) const SPEED: Self = Self([1, 0, -1, 0]);
    pub(super) const TURNING: Self = Self([0, 0, -1, 1]);
    pub(super) const ACCELERATION: Self = Self([1, 0, -2, 0]);
    pub(super) const INERTIA: Self = Self([2, 1, 0, 0]);
    pub(super) const DENSITY: Self = Self([-3, 1, 0, 0]);

    pub(super) fn times(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }

    pub(super) fn over(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] - other.0[i]))
    }

    /// The SI unit as text. Empty without a dimension.
    pub(super) fn unit(self) -> String {
        const COMMON: [&str; 9] = ["N", "N m", "N/m", "N s/m", "N m/rad", "N m s/rad", "m/s", "rad/s", "m/s^2"];
        if let Some(common) = COMMON.into_iter().find(|common| unit(common).is_ok_and(|(_, of)| of == self)) {
            return common.to_owned();
        }
        let plain = |sign: i8| {
            let factors =
                ["m", "kg", "s", "rad"].into_iter().zip(self.0).filter_map(|(unit, exponent)| match sign * exponent {
                    1 => Some(unit.to_owned()),
                    power @ 2.. => Some(format!("{unit}^{power}")),
                    _ => None,
                });
            factors.collect::<Vec<_>>().join(" ")
        };
        let (above, below) = (plain(1), plain(-1));
        match (above.is_empty(), below.is_empty()) {
            (_, true) => above,
            (true, false) => format!("1/{below}"),
            (false, false) => format!("{above}/{below}"),
        }
    }
}

/// The unit of the value of a name, if the name ends with another one.
pub(super) fn other_unit(name: &str, dimension: Dimension) -> Option<String> {
    let (of_name, unit) = (unit_of(name), dimension.unit());
    let ending = unit.to_lowercase().replace("n m", "nm").replace('/', "_per_").replace([' ', '^'], "_");
    if of_name.is_empty() || of_name == unit || name.ends_with(&format!("_{ending}")) {
        return None;
    }
    let is = if unit.is_empty() {
        "has no unit".to_owned()
    } else {
        format!("is in {unit}\nHint: end the name with `_{ending}`")
    };
    Some(format!("`{name}` ends with the unit {of_name}, but its value {is}"))
}

impl fmt::Display for Dimension {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match *self {
            Self::NONE => "a number without a unit",
            Self::LENGTH => "a length, such as `10 cm`",
            Self::MASS => "a mass, such as `0.5 kg`",
            Self::TIME => "a duration, such as `0.5 s`",
            Self::ANGLE => "an angle, such as `30 deg`",
            Self::FORCE => "a force, such as `20 N`",
            Self::SPEED => "a speed, such as `5 cm/s`",
            Self::DENSITY => "a density, such as `2.7 g/cm^3`",
            Self::TURNING => "a speed, such as `20 deg/s`",
            _ => return write!(f, "a quantity in {}", self.unit()),
        })
    }
}

/// A number in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Quantity {
    pub(super) value: f64,
    pub(super) dimension: Dimension,
}

/// The symbols of units: factor to SI units, and dimension.
pub(super) const UNITS: [(&str, f64, Dimension); 13] = [
    ("m", 1.0, Dimension::LENGTH),
    ("cm", 0.01, Dimension::LENGTH),
    ("mm", 1e-3, Dimension::LENGTH),
    ("kg", 1.0, Dimension::MASS),
    ("g", 1e-3, Dimension::MASS),
    ("s", 1.0, Dimension::TIME),
    ("ms", 1e-3, Dimension::TIME),
    ("min", 60.0, Dimension::TIME),
    ("rad", 1.0, Dimension::ANGLE),
    ("deg", std::f64::consts::PI / 180.0, Dimension::ANGLE),
    ("N", 1.0, Dimension::FORCE),
    ("Nm", 1.0, Dimension::TORQUE),
    ("%", 0.01, Dimension::NONE),
];

/// The factor and the dimension of a unit such as `N s/m` or `m/s^2`.
///
/// # Errors
/// An unknown symbol.
pub(super) fn unit(text: &str) -> Result<(f64, Dimension), String> {
    let (mut factor, mut dimension) = (1.0, Dimension::NONE);
    for (part, text) in text.split('/').enumerate() {
        for symbol in text.split_whitespace() {
            let (name, power) = match symbol.split_once('^') {
                Some((name, power)) => (name, power.parse::<u8>().ok().filter(|power| (1..=3).contains(power))),
                None => (symbol, Some(1)),
            };
            if symbol.contains(',') {
                return Err(format!("`{text}` has several units. Write one after the last number, as in `0.05, 1 kg`"));
            }
            let known = UNITS.iter().find(|(known, ..)| *known == name);
            let (Some((_, scale, of)), Some(power)) = (known, power) else {
                let hint = robogate_core::hint(name, UNITS.iter().map(|(known, ..)| *known));
                return Err(format!("unknown unit `{symbol}`: {hint}"));
            };
            for _ in 0..power {
                (factor, dimension) = match part {
                    0 => (factor * scale, dimension.times(*of)),
                    _ => (factor / scale, dimension.over(*of)),
                };
            }
        }
    }
    Ok((factor, dimension))
}

/// Splits a text into numbers, which commas separate, and the text of their unit.
fn split(text: &str) -> (Vec<&str>, &str) {
    let end = text.find(|c: char| c.is_alphabetic() && c != 'e' || c == '%').unwrap_or(text.len());
    // The exponent of a number belongs to it.
    let (numbers, unit) = text.split_at(end);
    (numbers.split(',').map(str::trim).collect(), unit.trim())
}

fn number(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number.abs() <= 1e9 => Ok(number),
        _ => Err(format!("`{text}` is not a number")),
    }
}

/// Numbers with one unit in SI units: `40, 30, 2 cm`.
///
/// # Errors
/// What is wrong with the text.
pub(super) fn quantities<const N: usize>(text: &str, dimension: Dimension) -> Result<[f64; N], String> {
    let (numbers, unit_text) = split(text);
    let (factor, found) = unit(unit_text)?;
    let values = numbers.iter().map(|text| number(text).map(|x| x * factor)).collect::<Result<Vec<_>, _>>()?;
    // Zero is zero in any unit.
    let zero = unit_text.is_empty() && values.iter().all(|value| *value == 0.0);
    if found != dimension && !zero {
        return Err(format!("`{text}` does not fit. Expected {dimension}"));
    }
    let count = values.len();
    values.try_into().map_err(|_| format!("`{text}` has {count} numbers. Expected {N}, separated by commas"))
}

/// A number with a unit of any dimension.
///
/// # Errors
/// What is wrong with the text.
pub(super) fn quantity(text: &str) -> Result<Quantity, String> {
    let (numbers, unit_text) = split(text);
    let (factor, dimension) = unit(unit_text)?;
    match numbers[..] {
        [one] => Ok(Quantity { value: number(one)? * factor, dimension }),
        _ => Err(format!("`{text}` has {} numbers. Expected one", numbers.len())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_convert_to_si() {
        for (text, value, unit) in [
            ("15 cm", 0.15, "m"),
            ("1.5e-3 m", 0.0015, "m"),
            ("180 deg", std::f64::consts::PI, "rad"),
            ("5 N s/m", 5.0, "N s/m"),
            ("0.2 N m s/rad", 0.2, "N m s/rad"),
            ("3 N m/rad", 3.0, "N m/rad"),
            ("40 N/m", 40.0, "N/m"),
            ("2 cm/s", 0.02, "m/s"),
            ("9.81 m/s^2", 9.81, "m/s^2"),
            ("500 g", 0.5, "kg"),
            ("12 N", 12.0, "N"),
            ("2 N m", 2.0, "N m"),
            ("50 %", 0.5, ""),
            ("-3", -3.0, ""),
        ] {
            let found = quantity(text).unwrap();
            assert!((found.value - value).abs() < 1e-12, "{text}: {found:?}");
            assert_eq!(found.dimension.unit(), unit, "{text}");
        }
        assert_eq!(quantities::<3>("40, 30, 2 cm", Dimension::LENGTH).unwrap(), [0.4, 0.3, 0.02]);
    }

    #[test]
    fn misfits_name_what_fits() {
        assert_eq!(quantity("3 cmm").unwrap_err(), "unknown unit `cmm`: did you mean `cm`?");
        let wrong = quantities::<1>("3 kg", Dimension::LENGTH).unwrap_err();
        assert_eq!(wrong, "`3 kg` does not fit. Expected a length, such as `10 cm`");
        let two = quantities::<3>("3, 4 cm", Dimension::LENGTH).unwrap_err();
        assert_eq!(two, "`3, 4 cm` has 2 numbers. Expected 3, separated by commas");
        for text in ["", "1e99 m", "inf m", "NaN", "- m", "3 m^9", "1//m m"] {
            assert!(quantity(text).is_err() || text == "1//m m", "{text}");
        }
    }
}
