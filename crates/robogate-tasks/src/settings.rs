//! Tables of settings: one row per setting of a task, with its values and its field.

use std::borrow::Cow;

use robogate_core::{Allowed, Assignment, SettingSpec, Value};
use robogate_physics::SuctionLaw;

/// The unit with which a name ends; empty without one.
pub(crate) const fn unit_of(name: &str) -> &'static str {
    match name.as_bytes() {
        [.., b'_', b'm', b'_', b's'] => "m/s",
        [.., b'_', b'r', b'a', b'd', b'_', b's'] => "rad/s",
        [.., b'_', b'm'] => "m",
        [.., b'_', b's'] => "s",
        [.., b'_', b'n'] => "N",
        [.., b'_', b'k', b'g'] => "kg",
        [.., b'_', b'r', b'a', b'd'] => "rad",
        [.., b'_', b'l', b'u', b'x'] => "lux",
        _ => "",
    }
}

/// One setting of the task `T`.
pub(crate) struct SettingRow<T: 'static> {
    /// The name, which ends with the unit.
    pub(crate) name: &'static str,
    pub(crate) meaning: Cow<'static, str>,
    pub(crate) field: Field<T>,
}

/// The field of a task that a setting sets. The default of the task is that of the setting.
pub(crate) enum Field<T: 'static> {
    /// A number in a range, both ends included.
    Number([f64; 2], fn(&mut T) -> &mut f64),
    /// As [`Self::Number`], the one with this index among those of a task from a file.
    Listed([f64; 2], usize, fn(&mut T, usize) -> &mut f64),
    /// A time in seconds: from one to the given number of periods of the given duration.
    Periods(f64, u32, fn(&mut T) -> &mut f64),
    /// A number in a range. The robot determines the default.
    OfRobot([f64; 2], fn(&mut T) -> &mut Option<f64>),
    /// One of a few words.
    Choice(fn(&mut T) -> &mut dyn Choice),
}

/// A setting that is one of a few words.
pub(crate) trait Choice {
    /// Every word.
    fn words(&self) -> &'static [&'static str];

    /// The present one.
    fn word(&self) -> &'static str;

    /// Chooses one of [`Self::words`]. Any other word changes nothing.
    fn choose(&mut self, word: &str);
}

impl Choice for SuctionLaw {
    fn words(&self) -> &'static [&'static str] {
        &["surface", "vacuum"]
    }

    fn word(&self) -> &'static str {
        self.as_str()
    }

    fn choose(&mut self, word: &str) {
        *self = word.parse().unwrap_or(*self);
    }
}

impl<T> SettingRow<T> {
    /// A number in a range.
    pub(crate) const fn number(
        name: &'static str,
        meaning: &'static str,
        range: [f64; 2],
        field: fn(&mut T) -> &mut f64,
    ) -> Self {
        Self { name, meaning: Cow::Borrowed(meaning), field: Field::Number(range, field) }
    }

    /// The time limit of an episode in control periods of this duration in seconds, at most a day.
    pub(crate) fn time_limit(period_s: f64, field: fn(&mut T) -> &mut f64) -> Self {
        const DAY_S: f64 = 86_400.0;
        Self {
            name: "time_limit_s",
            meaning: Cow::Borrowed("Time limit of an episode, in simulated seconds."),
            field: Field::Periods(period_s, (DAY_S / period_s).round() as u32, field),
        }
    }

    /// One of a few words.
    pub(crate) const fn choice(
        name: &'static str,
        meaning: &'static str,
        field: fn(&mut T) -> &mut dyn Choice,
    ) -> Self {
        Self { name, meaning: Cow::Borrowed(meaning), field: Field::Choice(field) }
    }
}

impl<T: Clone> SettingRow<T> {
    fn allowed(&self, task: &mut T) -> Allowed {
        match &self.field {
            Field::Number([low, high], _) | Field::Listed([low, high], ..) | Field::OfRobot([low, high], _) => {
                Allowed::Continuous { low: *low, high: *high }
            }
            Field::Periods(period_s, most, _) => {
                Allowed::Continuous { low: *period_s, high: period_s * f64::from(*most) }
            }
            Field::Choice(field) => {
                let choices = field(task).words().iter().map(|word| (*word).into()).collect();
                Allowed::Categorical { choices, open: false }
            }
        }
    }

    fn value(&self, task: &mut T) -> Option<Value> {
        match &self.field {
            Field::Number(_, field) | Field::Periods(_, _, field) => Some(Value::Number(*field(task))),
            Field::Listed(_, index, field) => Some(Value::Number(*field(task, *index))),
            Field::OfRobot(_, field) => field(task).map(Value::Number),
            Field::Choice(field) => Some(Value::Category(field(task).word().into())),
        }
    }

    /// The declaration, with the default of `defaults` and the value of this task.
    fn spec(&self, defaults: &mut T, task: &mut T) -> SettingSpec {
        SettingSpec {
            name: self.name.into(),
            unit: unit_of(self.name).to_owned(),
            meaning: self.meaning.clone().into_owned(),
            allowed: self.allowed(task),
            default: self.value(defaults),
            value: self.value(task),
        }
    }

    fn set(&self, task: &mut T, value: &Value) -> Result<(), String> {
        self.spec(&mut task.clone(), task).accepts(value)?;
        match (&self.field, value) {
            (Field::Choice(field), Value::Category(word)) => field(task).choose(word),
            (Field::Number(_, field) | Field::Periods(_, _, field), _) => *field(task) = number(value),
            (Field::Listed(_, index, field), _) => *field(task, *index) = number(value),
            (Field::OfRobot(_, field), _) => *field(task) = Some(number(value)),
            // Not accepted above.
            (Field::Choice(_), _) => {}
        }
        match &self.field {
            Field::Periods(period_s, ..) if !is_whole(number(value) / period_s) => Err(format!(
                "setting `{}` = {value}: expected a multiple of {period_s} {}",
                self.name,
                unit_of(self.name)
            )),
            _ => Ok(()),
        }
    }
}

fn number(value: &Value) -> f64 {
    match value {
        Value::Number(x) => *x,
        Value::Integer(n) => *n as f64,
        Value::Category(_) => f64::NAN,
    }
}

fn is_whole(number: f64) -> bool {
    (number - number.round()).abs() < 1e-6
}

/// The declarations of these settings, with the defaults of `defaults` and the values of this task.
pub(crate) fn setting_specs<T: Clone>(rows: &[SettingRow<T>], mut defaults: T, task: &T) -> Vec<SettingSpec> {
    let mut task = task.clone();
    rows.iter().map(|row| row.spec(&mut defaults, &mut task)).collect()
}

/// The same task with these values of its settings.
///
/// # Errors
/// A setting that the task does not have, or a value that it does not accept. The error names what is accepted.
pub(crate) fn with_settings<T: Clone>(
    name: &str,
    rows: &[SettingRow<T>],
    task: &T,
    values: &Assignment,
) -> Result<T, String> {
    let mut task = task.clone();
    for (setting, value) in values.iter() {
        let row = rows.iter().find(|row| row.name == setting).ok_or_else(|| {
            let known: Vec<&str> = rows.iter().map(|row| row.name).collect();
            format!("{name} has no setting `{setting}`. Expected one of: {}", known.join(", "))
        })?;
        row.set(&mut task, value)?;
    }
    Ok(task)
}
