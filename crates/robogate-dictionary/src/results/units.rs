//! Numbers with a unit, as spreadsheets show them: `45 %`, `0,5 kg`.
//!
//! A column in which every number has the same unit is a column of numbers. Numbers with different units, or with and without one,
//! are refused: their values cannot be compared.

use std::sync::Arc;

/// Units that may follow a number. A single letter needs a space before it, because identifiers end with letters.
const UNITS: [&str; 38] = [
    "%",
    "\u{b0}",
    "\u{b0}C",
    "deg",
    "rad",
    "mrad",
    "mm",
    "cm",
    "m",
    "um",
    "\u{b5}m",
    "s",
    "ms",
    "min",
    "h",
    "kg",
    "g",
    "mg",
    "N",
    "mN",
    "kN",
    "Nm",
    "Hz",
    "kHz",
    "mm/s",
    "m/s",
    "rad/s",
    "deg/s",
    "m/s2",
    "m/s\u{b2}",
    "bar",
    "mbar",
    "Pa",
    "kPa",
    "lx",
    "lux",
    "px",
    "V",
];

/// The number and the unit of a field. `None` if it has no unit.
pub(super) fn parts(text: &str) -> Option<(&str, &'static str)> {
    let text = text.trim();
    if !text.starts_with(|c: char| c.is_ascii_digit() || "-+\u{2212}.,".contains(c)) {
        return None;
    }
    let end = text.rfind(|c: char| c.is_ascii_digit())?;
    // The digit of `m/s2` belongs to the unit.
    let end = if text.ends_with("/s2") { text[..end].rfind(|c: char| c.is_ascii_digit())? } else { end };
    let (number, rest) = text.split_at(end + 1);
    if rest.is_empty() {
        return None;
    }
    let unit = UNITS.into_iter().find(|unit| *unit == rest.trim_start())?;
    let letter = unit.len() == 1 && unit != "%";
    (!letter || rest.starts_with(char::is_whitespace)).then_some((number, unit))
}

/// What the fields of a column say about its unit.
#[derive(Debug, Clone, Default)]
pub(super) struct Column {
    /// The first unit, with its line.
    unit: Option<(&'static str, u64)>,
    /// Another unit after it, with its line.
    other: Option<(&'static str, u64)>,
    /// The line of the first number without a unit.
    bare: Option<u64>,
    /// A field is a word.
    words: bool,
}

impl Column {
    /// Takes a field that is not missing, with its unit, see [`parts`]. `is_number` says whether it is a number without a unit.
    pub(super) fn take(&mut self, line: u64, text: &str, unit: Option<&'static str>, is_number: impl Fn(&str) -> bool) {
        match unit {
            // A number that cannot be read stays a word.
            Some(unit) => match self.unit {
                None => self.unit = Some((unit, line)),
                Some((known, _)) if known != unit => self.other = self.other.or(Some((unit, line))),
                Some(_) => {}
            },
            // Most columns end here: the first field has shown what they are.
            None if self.words || (self.bare.is_some() && self.unit.is_none()) => {
                self.words |= text.starts_with(char::is_alphabetic);
            }
            None if is_number(text) => self.bare = self.bare.or(Some(line)),
            None => self.words = true,
        }
    }

    /// The unit of all of its numbers, if they have one.
    ///
    /// # Errors
    /// Why its numbers cannot be compared.
    pub(super) fn decide(&self, name: &Arc<str>) -> Result<Option<&'static str>, String> {
        let Some((unit, line)) = self.unit.filter(|_| !self.words) else { return Ok(None) };
        let hint = "Hint: write all numbers of a column in one unit, and the unit in the name of the column";
        if let Some((other, at)) = self.other {
            return Err(format!("the column `{name}` has `{unit}` in line {line} and `{other}` in line {at}\n{hint}"));
        }
        match self.bare {
            Some(at) => {
                Err(format!("the column `{name}` has `{unit}` in line {line} and no unit in line {at}\n{hint}"))
            }
            None => Ok(Some(unit)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decided(fields: &[&str]) -> Result<Option<&'static str>, String> {
        let mut column = Column::default();
        for (line, field) in (2..).zip(fields) {
            column.take(line, field, parts(field).map(|(_, unit)| unit), |text| text.parse::<f64>().is_ok());
        }
        column.decide(&"humidity".into())
    }

    #[test]
    fn a_unit_of_all_numbers_is_left_off() {
        assert_eq!(parts("45 %"), Some(("45", "%")));
        assert_eq!(parts("-0,5kg"), Some(("-0,5", "kg")));
        assert_eq!(parts("9.81 m/s2"), Some(("9.81", "m/s2")));
        assert_eq!(parts("1 234,5 mm"), Some(("1 234,5", "mm")));
        assert_eq!(decided(&["45 %", "5%", "99.5 %"]), Ok(Some("%")));
        assert_eq!(decided(&["45", "5"]), Ok(None));
        assert_eq!(decided(&[]), Ok(None));
    }

    #[test]
    fn identifiers_and_words_stay() {
        for text in ["12A", "12s", "3g", "part 5 mm", "mm", "%", "5 parsec", "2026-11-28", "5 % of 20", ""] {
            assert_eq!(parts(text), None, "{text}");
        }
        assert_eq!(decided(&["45 %", "high", "50"]), Ok(None));
        assert_eq!(decided(&["50", "high", "45 %"]), Ok(None));
    }

    #[test]
    fn mixed_units_are_refused_with_both_lines() {
        let error = decided(&["5 g", "0.1 kg"]).unwrap_err();
        assert!(error.starts_with("the column `humidity` has `g` in line 2 and `kg` in line 3\nHint: "), "{error}");
        let error = decided(&["5 g", "7"]).unwrap_err();
        assert!(error.contains("`g` in line 2 and no unit in line 3"), "{error}");
    }
}
