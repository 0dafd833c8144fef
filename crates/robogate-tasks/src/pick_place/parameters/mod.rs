//! Parameters of a scenario.
//!
//! [`table`] has one row per parameter: its name, unit, meaning, range, nominal value, setter and reader. All other
//! code derives from this table.

mod error;
mod readback;
mod table;

use robogate_core::{Assignment, Domain, ParameterSpace, ParameterSpec};
use robogate_physics::{Gripper, GripperUnit, Object, Visual};

use super::{Disturbance, Shape};

pub use error::ParameterError;
pub(crate) use readback::ReadbackContext;
use table::Access;
pub use table::{ActsOn, ParameterRow};

/// The rows of the parameter table, in the order of reports.
pub fn parameters() -> &'static [ParameterRow] {
    &table::TABLE
}

/// The largest number of obstacles.
pub(super) fn most_obstacles() -> usize {
    let most = |row: &ParameterRow| match row.access {
        Access::Integer { range: [_, high], .. } if row.name == "obstacles" => Some(high),
        _ => None,
    };
    parameters().iter().find_map(most).unwrap_or(0)
}

/// The parameters of the task on a robot with this gripper.
pub(super) fn specs(gripper: &Gripper) -> Vec<ParameterSpec> {
    parameters().iter().filter(|row| row.applies_to(gripper)).map(ParameterRow::spec).collect()
}

/// The decoded parameters of a scenario. A parameter that a scenario does not name has its nominal value.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneParameters {
    /// `friction`
    pub friction: f64,
    /// `mass_kg`
    pub mass_kg: f64,
    /// `com_offset`: see [`Shape::object`].
    pub com_offset: f64,
    /// `size_m`
    pub size_m: f64,
    /// `ik_noise_rad`
    pub ik_noise_rad: f64,
    /// `unit_bias_1_rad` to `unit_bias_7_rad`
    pub encoder_bias_rad: [f64; 7],
    /// `grip_force_scale`, `pad_friction_scale`
    pub gripper: GripperUnit,
    /// `obstacles`
    pub obstacles: usize,
    /// `shape`
    pub shape: Shape,
    /// `placement`: the name of a [`super::Placement`].
    pub placement: String,
    /// `grip_threshold_m`
    pub grip_threshold_m: f64,
    /// `approach_speed_m_s`; `None` leaves it to the policy.
    pub approach_speed_m_s: Option<f64>,
    /// `table_friction`; `None` is `friction`.
    pub table_friction: Option<f64>,
    /// `position_jitter_m`
    pub position_jitter_m: f64,
    /// `gravity_scale`
    pub gravity_scale: f64,
    /// `offset_x_m`, `offset_y_m`
    pub offset_m: [f64; 2],
    /// `obstacle_gap_m`
    pub obstacle_gap_m: f64,
    /// `occluders`
    pub occluders: usize,
    /// `disturbance_...`
    pub disturbance: Disturbance,
    /// `lighting_lux`, `camera_...`, `table_material`, `background_color`, `object_...`
    pub visual: Visual,
}

impl Default for SceneParameters {
    /// The nominal values of the table.
    fn default() -> Self {
        let mut nominal = Self::unset();
        for row in parameters() {
            row.set_nominal(&mut nominal);
        }
        nominal
    }
}

impl SceneParameters {
    /// Placeholders that the nominal values of the table replace.
    fn unset() -> Self {
        Self {
            friction: f64::NAN,
            mass_kg: f64::NAN,
            com_offset: f64::NAN,
            size_m: f64::NAN,
            ik_noise_rad: f64::NAN,
            encoder_bias_rad: [f64::NAN; 7],
            gripper: GripperUnit { force_scale: f64::NAN, pad_friction_scale: f64::NAN },
            obstacles: 0,
            shape: Shape::Box,
            placement: String::new(),
            grip_threshold_m: f64::NAN,
            approach_speed_m_s: None,
            table_friction: None,
            position_jitter_m: f64::NAN,
            gravity_scale: f64::NAN,
            offset_m: [f64::NAN; 2],
            obstacle_gap_m: f64::NAN,
            occluders: 0,
            disturbance: Disturbance {
                speed_m_s: f64::NAN,
                start_s: f64::NAN,
                from: [f64::NAN; 2],
                heading_rad: f64::NAN,
                travel_m: f64::NAN,
            },
            visual: Visual::default(),
        }
    }

    /// Checks that the task accepts every parameter of `space` over its whole range, and that they apply to this
    /// gripper.
    pub fn check_space(space: &ParameterSpace, gripper: Option<&Gripper>) -> Result<(), ParameterError> {
        for parameter in space.parameters() {
            let row = row_for(&parameter.name, gripper)?;
            match (&row.access, &parameter.domain) {
                (Access::Number { .. }, Domain::Continuous { low, high, .. }) => {
                    row.check_range(*low)?;
                    row.check_range(*high)?;
                }
                (Access::Number { .. } | Access::Integer { .. }, Domain::Integer { low, high }) => {
                    row.check_range(*low as f64)?;
                    row.check_range(*high as f64)?;
                }
                (Access::Word { .. }, Domain::Categorical { choices }) => {
                    let mut scratch = Self::unset();
                    choices.iter().try_for_each(|choice| row.set_word(&mut scratch, choice))?;
                }
                (Access::Integer { .. }, Domain::Continuous { .. }) => return Err(row.wrong_kind("an integer")),
                (Access::Number { .. } | Access::Integer { .. }, Domain::Categorical { .. }) => {
                    return Err(row.wrong_kind("a number"));
                }
                (Access::Word { .. }, _) => return Err(row.wrong_kind("categorical values")),
            }
        }
        Ok(())
    }

    /// The names of the parameters for a robot with this gripper.
    pub fn names(gripper: &Gripper) -> impl Iterator<Item = &'static str> {
        parameters().iter().filter(|row| row.applies_to(gripper)).map(|row| row.name)
    }

    /// Decodes an assignment, for a robot with this gripper if one is given.
    pub fn from_assignment(assignment: &Assignment, gripper: Option<&Gripper>) -> Result<Self, ParameterError> {
        let mut parameters = Self::default();
        for (name, value) in assignment.iter() {
            row_for(name, gripper)?.set(&mut parameters, value)?;
        }
        Ok(parameters)
    }

    /// Friction coefficient of the object against the pads.
    pub fn pad_friction(&self) -> f64 {
        self.friction * self.gripper.pad_friction_scale
    }

    /// The object described by these parameters.
    pub fn object(&self) -> Object {
        self.shape.object(self.size_m, self.mass_kg, self.com_offset)
    }
}

impl ReadbackContext<'_> {
    /// The applied values of the requested parameters, read by their rows.
    pub(crate) fn applied(&self, requested: &Assignment) -> Assignment {
        let mut applied = Assignment::default();
        for (name, value) in requested.iter() {
            // A name without a row was rejected when the scenario was decoded.
            if let Some(row) = find(name) {
                applied.set(name, row.read(self, value));
            }
        }
        applied
    }
}

fn find(name: &str) -> Option<&'static ParameterRow> {
    parameters().iter().find(|row| row.name == name)
}

fn row_for(name: &str, gripper: Option<&Gripper>) -> Result<&'static ParameterRow, ParameterError> {
    let row = find(name).ok_or_else(|| {
        let known = parameters().iter().map(|row| row.name).collect::<Vec<_>>().join(", ");
        ParameterError::Unknown { parameter: name.to_owned(), known }
    })?;
    match gripper {
        Some(gripper) if !row.applies_to(gripper) => {
            Err(ParameterError::Gripper { parameter: name.to_owned(), gripper: gripper.description() })
        }
        _ => Ok(row),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use robogate_core::{Allowed, Value};

    use super::*;

    #[test]
    fn names_are_unique() {
        let names: BTreeSet<_> = parameters().iter().map(|row| row.name).collect();
        assert_eq!(names.len(), parameters().len());
    }

    #[test]
    fn every_field_has_a_nominal_value() {
        // A field that no row sets keeps its placeholder, and `NaN` does not equal itself.
        let nominal = SceneParameters::default();
        assert_eq!(nominal, nominal.clone());
        assert!(!nominal.placement.is_empty());
    }

    #[test]
    fn nominal_values_are_accepted() {
        for row in parameters() {
            let Some(nominal) = row.nominal() else { continue };
            let mut set = SceneParameters::default();
            row.set(&mut set, &nominal).unwrap();
            assert_eq!(set, SceneParameters::default(), "{}", row.name);
        }
    }

    #[test]
    fn values_outside_a_range_are_rejected() {
        for row in parameters() {
            let outside = match row.allowed() {
                Allowed::Continuous { high, .. } => Value::Number(high + 1.0),
                Allowed::Integer { high, .. } => Value::Integer(high + 1),
                Allowed::Categorical { .. } => Value::Category("no such word".into()),
            };
            let assignment = [(row.name.into(), outside)].into_iter().collect();
            let error = SceneParameters::from_assignment(&assignment, None).unwrap_err().to_string();
            assert!(error.contains(row.name), "{error}");
        }
    }

    #[test]
    fn count_must_be_an_integer() {
        let half = [("obstacles".into(), Value::Number(2.5))].into_iter().collect();
        let error = SceneParameters::from_assignment(&half, None).unwrap_err();
        assert!(error.to_string().contains("an integer"), "{error}");
    }
}
