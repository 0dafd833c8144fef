//! Parameters of a scenario: one row each, with name, unit, meaning, range, nominal value, setter and reader.

use std::f64::consts::PI;

use robogate_core::Assignment;
use robogate_physics::{Color, Gripper, TableMaterial, Visual};

use super::cell::Told;
use super::scene::OBSTACLE_GAP;
use super::{Disturbance, Placement, Shape, readback};
use crate::arm::{Access, InSurroundings, Needs, Row, Surroundings, Table, Words};

/// The largest number of obstacles.
pub(super) const MOST_OBSTACLES: usize = 12;

/// The decoded parameters of a scenario.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneParameters {
    /// `friction`
    pub friction: f64,
    /// `mass_kg`
    pub mass_kg: f64,
    /// `com_offset`: see [`Shape::object`].
    pub com_offset: f64,
    /// `size_m`
    pub size_m: f64,
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
    /// `table_material`, `background_color`, `object_...`
    pub(crate) looks: Visual,
    /// `ik_noise_rad`, the parameters of the unit and of the cameras, and the light.
    pub(crate) around: Surroundings,
}

impl SceneParameters {
    /// The nominal parameters.
    pub fn nominal() -> Self {
        TABLE.nominal()
    }

    /// Decodes an assignment for a robot with this gripper. A parameter that it does not name has its nominal value.
    ///
    /// # Errors
    /// A setup fault for an unknown parameter, a value that it does not accept, or a gripper that does not have it.
    pub fn from_assignment(assignment: &Assignment, gripper: &Gripper) -> Result<Self, robogate_core::Fault> {
        TABLE.decode(assignment, gripper)
    }

    /// Friction coefficient of the object against the pads.
    pub fn pad_friction(&self) -> f64 {
        self.friction * self.around.gripper.pad_friction_scale
    }

    /// The appearance of the scene.
    pub(crate) fn visual(&self) -> Visual {
        let Visual { table_material, background_color, object_color, object_transparency, .. } = self.looks;
        Visual { table_material, background_color, object_color, object_transparency, ..self.around.visual() }
    }
}

impl InSurroundings for SceneParameters {
    fn around_mut(&mut self) -> &mut Surroundings {
        &mut self.around
    }
}

// Sources of applied values.
const ENGINE: &str = "state of the engine";
const CUP: &str = "suction cup";
const POLICY: &str = "task that the policy receives";
const CAMERAS: &str = "lamp, surfaces and poses of the cameras";

type Parameter = Row<SceneParameters, Told>;

/// Every parameter of the task.
pub(super) static TABLE: Table<SceneParameters, Told> = Table(&[
    Parameter::number(
        "friction",
        "Coulomb friction coefficient of the object against everything it touches.",
        ENGINE,
        ([0.0, 10.0], 0.8),
        |p, x| p.friction = x,
        |c| c.found.engine.friction,
    )
    .in_family("object"),
    Parameter::number(
        "mass_kg",
        "Mass of the object.",
        ENGINE,
        ([1e-3, 100.0], 0.3),
        |p, x| p.mass_kg = x,
        |c| c.found.engine.mass_kg,
    )
    .in_family("object"),
    Parameter::number(
        "com_offset",
        "Shift of the centre of mass: the fraction of the object's mass that is a point at the centre of one face.",
        ENGINE,
        ([0.0, 0.9], 0.0),
        |p, x| p.com_offset = x,
        readback::com_offset,
    )
    .in_family("object"),
    Parameter::number(
        "size_m",
        "Edge of the cube that the object fits.",
        ENGINE,
        ([5e-3, 0.2], 0.05),
        |p, x| p.size_m = x,
        readback::size,
    )
    .in_family("object"),
    Parameter::encoder_bias("ik_noise_rad", 1.0),
    Parameter::new(
        "obstacles",
        "Number of obstacles within 0.3 m of the workspace centre.",
        ENGINE,
        Access::Integer {
            range: [0, MOST_OBSTACLES],
            nominal: 0,
            set: |p, n| p.obstacles = n,
            read: readback::obstacles,
        },
    )
    .in_family("obstacles"),
    Parameter::new(
        "shape",
        "Shape of the object.",
        ENGINE,
        Access::Word {
            words: Words { choices: || Shape::ALL.map(Shape::as_str).into(), form: None },
            nominal: "box",
            set: |p, word| Shape::from_name(word).map(|shape| p.shape = shape),
            read: readback::shape,
        },
    )
    .in_family("object"),
    Parameter::new(
        "placement",
        "Nominal position and yaw of the object: a place and an angle in degrees.",
        ENGINE,
        Access::Word {
            words: Words {
                choices: || Placement::NAMES.into(),
                form: Some("center, edge, left, right or rotated with an angle in whole degrees"),
            },
            nominal: "center_0",
            set: |p, word| Placement::from_name(word).map(|_| p.placement = word.to_owned()),
            read: readback::placement,
        },
    )
    .in_family("placement"),
    Parameter {
        needs: Needs::Cup,
        ..Parameter::number(
            "grip_threshold_m",
            "Distance to the object within which a suction cup takes hold.",
            CUP,
            ([0.0, 0.1], 0.01),
            |p, x| p.grip_threshold_m = x,
            |c| c.found.grip_threshold_m.unwrap_or(f64::NAN),
        )
        .in_family("gripper")
    },
    Parameter::new(
        "approach_speed_m_s",
        "Largest speed of the tool on its way down to the object; unset, the policy chooses it.",
        POLICY,
        Access::Number {
            range: [1e-3, 2.0],
            nominal: None,
            set: |p, x| p.approach_speed_m_s = Some(x),
            read: |c| c.settings.briefing.approach_speed_m_s.unwrap_or(f64::NAN),
        },
    ),
    Parameter::new(
        "table_friction",
        "Coulomb friction coefficient of the object against the table; unset, it is `friction`.",
        ENGINE,
        Access::Number {
            range: [0.0, 10.0],
            nominal: None,
            set: |p, x| p.table_friction = Some(x),
            read: |c| c.found.engine.table_friction,
        },
    ),
    Parameter::number(
        "position_jitter_m",
        "Radius of the disc from which the object's offset from its placement is drawn; the policy is not told.",
        ENGINE,
        ([0.0, 0.05], 0.0),
        |p, x| p.position_jitter_m = x,
        readback::position_jitter,
    )
    .in_family("placement"),
    Parameter::number(
        "gravity_scale",
        "Gravity as a multiple of 9.81 m/s^2.",
        ENGINE,
        ([0.01, 10.0], 1.0),
        |p, x| p.gravity_scale = x,
        readback::gravity_scale,
    ),
    Parameter::number(
        "offset_x_m",
        "Offset of the object from its placement along x; the policy is told.",
        ENGINE,
        ([-0.6, 0.6], 0.0),
        |p, x| p.offset_m[0] = x,
        |c| readback::offset(c)[0],
    )
    .in_family("placement"),
    Parameter::number(
        "offset_y_m",
        "Offset of the object from its placement along y; the policy is told.",
        ENGINE,
        ([-0.6, 0.6], 0.0),
        |p, x| p.offset_m[1] = x,
        |c| readback::offset(c)[1],
    )
    .in_family("placement"),
    Parameter::number(
        "obstacle_gap_m",
        "Smallest free space between an obstacle and the object or the target area.",
        ENGINE,
        ([0.0, 0.2], OBSTACLE_GAP),
        |p, x| p.obstacle_gap_m = x,
        readback::obstacle_gap,
    )
    .in_family("obstacles"),
    Parameter::new(
        "occluders",
        "Number of panels between the object and the front camera.",
        ENGINE,
        Access::Integer { range: [0, 3], nominal: 0, set: |p, n| p.occluders = n, read: readback::occluders },
    )
    .in_family("camera"),
    Parameter::number(
        "disturbance_speed_m_s",
        "Speed of a box that crosses the workspace; at 0 there is no box.",
        ENGINE,
        ([0.0, 1.0], 0.0),
        |p, x| p.disturbance.speed_m_s = x,
        |c| readback::disturbance(c).speed_m_s,
    )
    .in_family("disturbance"),
    Parameter::number(
        "disturbance_start_s",
        "Time at which the disturbance starts to move.",
        ENGINE,
        ([0.0, 60.0], 0.0),
        |p, x| p.disturbance.start_s = x,
        |c| readback::disturbance(c).start_s,
    )
    .in_family("disturbance"),
    Parameter::number(
        "disturbance_x_m",
        "Position of the disturbance's centre along x before it moves.",
        ENGINE,
        ([-0.5, 1.5], 0.5),
        |p, x| p.disturbance.from[0] = x,
        |c| readback::disturbance(c).from[0],
    )
    .in_family("disturbance"),
    Parameter::number(
        "disturbance_y_m",
        "Position of the disturbance's centre along y before it moves.",
        ENGINE,
        ([-1.5, 1.5], -0.5),
        |p, x| p.disturbance.from[1] = x,
        |c| readback::disturbance(c).from[1],
    )
    .in_family("disturbance"),
    Parameter::number(
        "disturbance_heading_rad",
        "Direction of the disturbance's motion: 0 along +x, positive towards +y.",
        ENGINE,
        ([-PI, PI], 0.0),
        |p, x| p.disturbance.heading_rad = x,
        |c| readback::disturbance(c).heading_rad,
    )
    .in_family("disturbance"),
    Parameter::number(
        "disturbance_travel_m",
        "Distance that the disturbance moves.",
        ENGINE,
        ([1e-3, 3.0], 0.5),
        |p, x| p.disturbance.travel_m = x,
        |c| readback::disturbance(c).travel_m,
    )
    .in_family("disturbance"),
    Parameter::number(
        "object_transparency",
        "Fraction of the light that passes through the object.",
        CAMERAS,
        ([0.0, 0.95], 0.0),
        |p, x| p.looks.object_transparency = x,
        |c| c.found.visual.object_transparency,
    )
    .in_family("appearance"),
    Parameter::new(
        "table_material",
        "Material of the table's top, as the cameras show it.",
        CAMERAS,
        Access::Word {
            words: Words { choices: || TableMaterial::ALL.map(TableMaterial::as_str).into(), form: None },
            nominal: "wood",
            set: |p, word| TableMaterial::from_name(word).map(|material| p.looks.table_material = material),
            read: |c| c.found.visual.table_material.as_str().to_owned(),
        },
    )
    .in_family("appearance"),
    Parameter::new(
        "background_color",
        "Colour of the background behind the table (sRGB).",
        CAMERAS,
        Access::Word {
            words: Words { choices: || vec!["#b8bcc0"], form: Some(COLOR) },
            nominal: "#b8bcc0",
            set: |p, word| Color::from_hex(word).map(|color| p.looks.background_color = color),
            read: |c| c.found.visual.background_color.to_string(),
        },
    )
    .in_family("appearance"),
    Parameter::new(
        "object_color",
        "Colour of the object (sRGB).",
        CAMERAS,
        Access::Word {
            words: Words { choices: || vec!["#c83c28"], form: Some(COLOR) },
            nominal: "#c83c28",
            set: |p, word| Color::from_hex(word).map(|color| p.looks.object_color = color),
            read: |c| c.found.visual.object_color.to_string(),
        },
    )
    .in_family("appearance"),
]);

const COLOR: &str = "a colour as #rrggbb in lower case";

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use robogate_core::{Allowed, Value};
    use robogate_physics::built_in_robot;

    use super::*;
    use crate::arm::Parameters;

    fn grippers() -> [Gripper; 2] {
        ["franka", "ur5e"].map(|robot| built_in_robot(robot).unwrap().settings.gripper)
    }

    #[test]
    fn names_are_unique() {
        for gripper in grippers() {
            let specs = TABLE.specs(&gripper);
            let names: BTreeSet<_> = specs.iter().map(|spec| spec.name.clone()).collect();
            assert_eq!(names.len(), specs.len());
        }
    }

    #[test]
    fn nominal_values_are_accepted_and_change_nothing() {
        for gripper in grippers() {
            let nominal: Assignment =
                TABLE.specs(&gripper).into_iter().filter_map(|spec| Some((spec.name, spec.nominal?))).collect();
            assert_eq!(SceneParameters::from_assignment(&nominal, &gripper).unwrap(), SceneParameters::nominal());
        }
    }

    #[test]
    fn values_outside_a_range_are_rejected() {
        for gripper in grippers() {
            for spec in TABLE.specs(&gripper) {
                let outside = match spec.allowed {
                    Allowed::Continuous { high, .. } => Value::Number(high + 1.0),
                    Allowed::Integer { high, .. } => Value::Integer(high + 1),
                    Allowed::Categorical { .. } => Value::Category("no such word".into()),
                };
                let error = TABLE.accepts(&spec.name, &outside, Some(&gripper)).unwrap_err();
                assert!(error.contains(&*spec.name), "{error}");
            }
        }
    }

    #[test]
    fn count_must_be_an_integer() {
        let error = TABLE.accepts("obstacles", &Value::Number(2.5), None).unwrap_err();
        assert!(error.contains("an integer"), "{error}");
    }
}
