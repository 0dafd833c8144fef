//! Settings of a task: values that hold for all episodes of a run.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Allowed, Value};

/// A declared setting: a value that holds for all episodes of a run (a time limit, the limit of a force).
///
/// A parameter belongs to a scenario and varies between episodes; a setting belongs to the task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SettingSpec {
    /// The name. It ends with the unit, if there is one (`time_limit_s`).
    pub name: Arc<str>,
    /// The unit as text. Empty for a value without unit.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// The meaning, in one sentence.
    #[serde(default)]
    pub meaning: String,
    /// The accepted values.
    #[serde(flatten)]
    pub allowed: Allowed,
    /// The default value. Absent if the robot determines it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub default: Option<Value>,
    /// The value of this run. Absent if no run is meant, and the robot determines it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<Value>,
}

/// Units in which a value may be given, with the unit of the setting and the factor between them.
const UNITS: [(&str, &str, f64); 5] = [
    ("deg", "rad", std::f64::consts::PI / 180.0),
    ("mm", "m", 1e-3),
    ("cm", "m", 1e-2),
    ("ms", "s", 1e-3),
    ("min", "s", 60.0),
];

impl SettingSpec {
    /// Checks that a value is accepted. The error names the accepted values.
    pub fn accepts(&self, value: &Value) -> Result<(), String> {
        self.allowed.accepts(value).map_err(|expected| format!("setting `{}` = {value}: {expected}", self.name))
    }

    /// Reads a value from text: a word, or a number, with or without a unit (`10deg` for a setting in radians).
    pub fn read(&self, text: &str) -> Result<Value, String> {
        let text = text.trim();
        let value = match self.allowed {
            Allowed::Categorical { .. } => Value::Category(text.into()),
            Allowed::Continuous { .. } | Allowed::Integer { .. } => {
                let number = self.number(text).filter(|number| number.is_finite());
                // Text that is not a number is reported with the accepted values.
                number.map_or_else(|| Value::Category(text.into()), Value::Number)
            }
        };
        self.accepts(&value).map(|()| value)
    }

    fn number(&self, text: &str) -> Option<f64> {
        let in_unit = |unit: &str, factor: f64| Some(text.strip_suffix(unit)?.trim_end().parse::<f64>().ok()? * factor);
        text.parse().ok().or_else(|| in_unit(&self.unit, 1.0).filter(|_| !self.unit.is_empty())).or_else(|| {
            UNITS.iter().filter(|(_, own, _)| *own == self.unit).find_map(|(unit, _, factor)| in_unit(unit, *factor))
        })
    }

    /// Whether the value is another one than the default.
    pub fn is_changed(&self) -> bool {
        self.default.is_some() && self.value != self.default
    }

    /// Name, value and unit as text. `None` without a value.
    pub fn shown(&self) -> Option<String> {
        Some(format!("{} = {} {}", self.name, self.value.as_ref()?, self.unit).trim_end().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn angle() -> SettingSpec {
        SettingSpec {
            name: "tilt_rad".into(),
            unit: "rad".to_owned(),
            meaning: "Largest tilt.".to_owned(),
            allowed: Allowed::Continuous { low: 0.0, high: 1.0 },
            default: None,
            value: None,
        }
    }

    #[test]
    fn numbers_may_have_a_unit() {
        assert_eq!(angle().read("0.5"), Ok(Value::Number(0.5)));
        assert_eq!(angle().read(" 0.5 rad"), Ok(Value::Number(0.5)));
        assert_eq!(angle().read("45deg"), Ok(Value::Number(std::f64::consts::FRAC_PI_4)));
        for wrong in ["2", "90 deg", "0.5 mm", "NaN", "inf", "", "deg", "small"] {
            let why = angle().read(wrong).unwrap_err();
            assert!(why.contains("tilt_rad") && why.contains("a number from 0 to 1"), "{wrong}: {why}");
        }
    }

    #[test]
    fn words_are_choices() {
        let choices = vec!["all".into(), "paper".into()];
        let spec = SettingSpec { allowed: Allowed::Categorical { choices, open: false }, ..angle() };
        assert_eq!(spec.read("paper"), Ok(Value::Category("paper".into())));
        assert!(spec.read("3").unwrap_err().contains("one of all, paper"));
    }
}
