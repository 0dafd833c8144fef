//! The parameter table: one row per parameter.

use std::f64::consts::PI;

use robogate_core::{Allowed, ParameterSpec, Value, Word};
use robogate_physics::{Color, Gripper, TableMaterial};

use super::readback::{self, ReadbackContext};
use super::{ParameterError, SceneParameters};
use crate::pick_place::scene::OBSTACLE_GAP;
use crate::pick_place::{Placement, Shape};

/// One parameter of the task.
///
/// Every row has a reader: a parameter without a readable applied value is not allowed.
#[derive(Debug)]
pub struct ParameterRow {
    /// Name, which ends with the unit if there is one.
    pub name: &'static str,
    /// Unit; empty for a dimensionless number or a word.
    pub unit: &'static str,
    /// Meaning, in one sentence.
    pub meaning: &'static str,
    /// The family of perturbations that it belongs to.
    pub family: Option<&'static str>,
    /// The component through which it acts, and from which its applied value is read.
    pub acts_on: ActsOn,
    pub(super) access: Access,
}

/// The component through which a parameter acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ActsOn {
    /// The physics engine.
    Engine,
    /// The suction cup: the parameter needs one.
    Cup,
    /// The drive of the gripper.
    Gripper,
    /// The pads of a jaw: the parameter needs one.
    Pads,
    /// The encoders, whose readings the servo and the policy use.
    Encoders,
    /// The policy, which receives the value with its task.
    Policy,
    /// The cameras.
    Cameras,
}

impl ActsOn {
    /// The source of the applied value, for descriptions.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Engine => "state of the engine",
            Self::Cup => "suction cup",
            Self::Gripper => "drive of the gripper",
            Self::Pads => "contact of the pads",
            Self::Encoders => "encoder biases",
            Self::Policy => "task that the policy receives",
            Self::Cameras => "lamp, surfaces and poses of the cameras",
        }
    }
}

type Read<T> = fn(&ReadbackContext<'_>) -> T;

/// The setter and reader of a parameter.
#[derive(Debug)]
pub(super) enum Access {
    /// A number. Without a nominal value it is unset, as `meaning` says.
    Number { range: [f64; 2], nominal: Option<f64>, set: fn(&mut SceneParameters, f64), read: Read<f64> },
    /// A count.
    Integer { range: [usize; 2], nominal: usize, set: fn(&mut SceneParameters, usize), read: Read<usize> },
    /// A word. `set` returns `None` for an unknown word.
    Word { words: Words, nominal: &'static str, set: fn(&mut SceneParameters, &str) -> Option<()>, read: Read<String> },
}

/// The accepted words of a parameter.
#[derive(Debug)]
pub(super) struct Words {
    choices: fn() -> Vec<&'static str>,
    /// The pattern of further accepted words.
    form: Option<&'static str>,
}

impl ParameterRow {
    /// The values that the parameter accepts.
    pub fn allowed(&self) -> Allowed {
        match &self.access {
            Access::Number { range: [low, high], .. } => Allowed::Continuous { low: *low, high: *high },
            Access::Integer { range: [low, high], .. } => Allowed::Integer { low: *low as i64, high: *high as i64 },
            Access::Word { words, .. } => Allowed::Categorical {
                choices: (words.choices)().into_iter().map(Into::into).collect(),
                open: words.form.is_some(),
            },
        }
    }

    /// The row as a declaration of the task.
    pub(super) fn spec(&self) -> ParameterSpec {
        ParameterSpec {
            name: self.name.into(),
            unit: self.unit.to_owned(),
            meaning: self.meaning.to_owned(),
            allowed: self.allowed(),
            nominal: self.nominal(),
            read_from: self.acts_on.as_str().to_owned(),
            family: self.family.map(Word::constant),
        }
    }

    /// The default value. `None` if the default depends on another value, as the meaning states.
    pub fn nominal(&self) -> Option<Value> {
        match &self.access {
            Access::Number { nominal, .. } => nominal.map(Value::Number),
            Access::Integer { nominal, .. } => Some(Value::Integer(*nominal as i64)),
            Access::Word { nominal, .. } => Some(Value::Category((*nominal).into())),
        }
    }

    /// Whether the parameter applies to a robot with this gripper.
    pub fn applies_to(&self, gripper: &Gripper) -> bool {
        match self.acts_on {
            ActsOn::Cup => gripper.cup().is_some(),
            ActsOn::Pads => gripper.jaw().is_some(),
            _ => true,
        }
    }

    pub(super) fn set(&self, parameters: &mut SceneParameters, value: &Value) -> Result<(), ParameterError> {
        let number = || match value {
            Value::Number(x) => Ok(*x),
            Value::Integer(n) => Ok(*n as f64),
            Value::Category(_) => Err(self.wrong_kind("a number")),
        };
        match &self.access {
            Access::Number { set, .. } => {
                let x = number()?;
                self.check_range(x)?;
                set(parameters, x);
            }
            Access::Integer { set, .. } => {
                let x = number()?;
                self.check_range(x)?;
                if x.fract() != 0.0 {
                    return Err(self.wrong_kind("an integer"));
                }
                set(parameters, x as usize);
            }
            Access::Word { .. } => self.set_word(parameters, &value.to_string())?,
        }
        Ok(())
    }

    pub(super) fn set_nominal(&self, parameters: &mut SceneParameters) {
        match &self.access {
            Access::Number { nominal, set, .. } => nominal.iter().for_each(|x| set(parameters, *x)),
            Access::Integer { nominal, set, .. } => set(parameters, *nominal),
            // A test checks that every nominal word is known.
            Access::Word { nominal, set, .. } => set(parameters, nominal).unwrap_or_default(),
        }
    }

    pub(super) fn set_word(&self, parameters: &mut SceneParameters, word: &str) -> Result<(), ParameterError> {
        let Access::Word { words, set, .. } = &self.access else { return Err(self.wrong_kind("a number")) };
        set(parameters, word).ok_or_else(|| {
            let choices = (words.choices)().join(", ");
            let expected = match words.form {
                Some(form) => format!("{form}, such as {choices}"),
                None => format!("one of: {choices}"),
            };
            ParameterError::Choice { parameter: self.name.to_owned(), choice: word.to_owned(), expected }
        })
    }

    pub(super) fn check_range(&self, value: f64) -> Result<(), ParameterError> {
        let [low, high] = match &self.access {
            Access::Number { range, .. } => *range,
            Access::Integer { range, .. } => range.map(|n| n as f64),
            Access::Word { .. } => return Err(self.wrong_kind("categorical values")),
        };
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(ParameterError::Range { parameter: self.name.to_owned(), value, low, high })
    }

    pub(super) fn wrong_kind(&self, expected: &'static str) -> ParameterError {
        ParameterError::Kind { parameter: self.name.to_owned(), expected }
    }

    /// The applied value, of the same kind as the `requested` one.
    pub(super) fn read(&self, context: &ReadbackContext<'_>, requested: &Value) -> Value {
        // An integer request is returned as an integer.
        let number = |x: f64| match requested {
            Value::Integer(_) if (x - x.round()).abs() < 1e-6 => Value::Integer(x.round() as i64),
            _ => Value::Number(x),
        };
        match &self.access {
            Access::Number { read, .. } => number(read(context)),
            Access::Integer { read, .. } => number(read(context) as f64),
            Access::Word { read, .. } => Value::Category(read(context).into()),
        }
    }
}

const fn row(
    name: &'static str,
    unit: &'static str,
    acts_on: ActsOn,
    meaning: &'static str,
    access: Access,
) -> ParameterRow {
    ParameterRow { name, unit, meaning, family: None, acts_on, access }
}

impl ParameterRow {
    const fn in_family(self, family: &'static str) -> Self {
        Self { family: Some(family), ..self }
    }
}

const fn number([low, high]: [f64; 2], nominal: f64, set: fn(&mut SceneParameters, f64), read: Read<f64>) -> Access {
    Access::Number { range: [low, high], nominal: Some(nominal), set, read }
}

/// The row of the constant bias of joint `J`'s encoder.
const fn encoder_bias<const J: usize>(name: &'static str) -> ParameterRow {
    row(
        name,
        "rad",
        Encoders,
        "Constant bias of this joint's encoder (counted from the base): measured minus true position. It is added to that of `ik_noise_rad`.",
        number([-0.1, 0.1], 0.0, |p, x| p.encoder_bias_rad[J] = x, readback::unit_bias::<J>),
    )
    .in_family("encoders")
}

use ActsOn::{Cameras, Cup, Encoders, Engine, Pads, Policy};

/// Every parameter of the task.
pub(super) static TABLE: [ParameterRow; 39] = [
    row(
        "friction",
        "",
        Engine,
        "Coulomb friction coefficient of the object against everything it touches.",
        number([0.0, 10.0], 0.8, |p, x| p.friction = x, |c| c.found.engine.friction),
    )
    .in_family("object"),
    row(
        "mass_kg",
        "kg",
        Engine,
        "Mass of the object.",
        number([1e-3, 100.0], 0.3, |p, x| p.mass_kg = x, |c| c.found.engine.mass_kg),
    )
    .in_family("object"),
    row(
        "com_offset",
        "",
        Engine,
        "Shift of the centre of mass: the fraction of the object's mass that is a point at the centre of one face.",
        number([0.0, 0.9], 0.0, |p, x| p.com_offset = x, readback::com_offset),
    )
    .in_family("object"),
    row(
        "size_m",
        "m",
        Engine,
        "Edge of the cube that the object fits.",
        number([5e-3, 0.2], 0.05, |p, x| p.size_m = x, readback::size),
    )
    .in_family("object"),
    row(
        "ik_noise_rad",
        "rad",
        Encoders,
        "Largest encoder bias: each joint's encoder has a constant bias, drawn uniformly between minus and plus this value.",
        number([0.0, 1.0], 0.0, |p, x| p.ik_noise_rad = x, readback::encoder_bias),
    )
    .in_family("encoders"),
    row(
        "obstacles",
        "",
        Engine,
        "Number of obstacles within 0.3 m of the workspace centre.",
        Access::Integer { range: [0, 12], nominal: 0, set: |p, n| p.obstacles = n, read: readback::obstacles },
    )
    .in_family("obstacles"),
    row(
        "shape",
        "",
        Engine,
        "Shape of the object.",
        Access::Word {
            words: Words { choices: || Shape::ALL.map(Shape::as_str).into(), form: None },
            nominal: "box",
            set: |p, word| Shape::from_name(word).map(|shape| p.shape = shape),
            read: readback::shape,
        },
    )
    .in_family("object"),
    row(
        "placement",
        "",
        Engine,
        "Nominal position and yaw of the object: a place and an angle in degrees.",
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
    row(
        "grip_threshold_m",
        "m",
        Cup,
        "Distance to the object within which a suction cup takes hold.",
        number([0.0, 0.1], 0.01, |p, x| p.grip_threshold_m = x, |c| c.found.grip_threshold_m.unwrap_or(f64::NAN)),
    )
    .in_family("gripper"),
    row(
        "approach_speed_m_s",
        "m/s",
        Policy,
        "Largest speed of the tool on its way down to the object; unset, the policy chooses it.",
        Access::Number {
            range: [1e-3, 2.0],
            nominal: None,
            set: |p, x| p.approach_speed_m_s = Some(x),
            read: |c| c.briefing.approach_speed_m_s.unwrap_or(f64::NAN),
        },
    ),
    row(
        "table_friction",
        "",
        Engine,
        "Coulomb friction coefficient of the object against the table; unset, it is `friction`.",
        Access::Number {
            range: [0.0, 10.0],
            nominal: None,
            set: |p, x| p.table_friction = Some(x),
            read: |c| c.found.engine.table_friction,
        },
    ),
    row(
        "position_jitter_m",
        "m",
        Engine,
        "Radius of the disc from which the object's offset from its placement is drawn; the policy is not told.",
        number([0.0, 0.05], 0.0, |p, x| p.position_jitter_m = x, readback::position_jitter),
    )
    .in_family("placement"),
    row(
        "gravity_scale",
        "",
        Engine,
        "Gravity as a multiple of 9.81 m/s^2.",
        number([0.01, 10.0], 1.0, |p, x| p.gravity_scale = x, readback::gravity_scale),
    ),
    row(
        "offset_x_m",
        "m",
        Engine,
        "Offset of the object from its placement along x; the policy is told.",
        number([-0.6, 0.6], 0.0, |p, x| p.offset_m[0] = x, |c| readback::offset(c)[0]),
    )
    .in_family("placement"),
    row(
        "offset_y_m",
        "m",
        Engine,
        "Offset of the object from its placement along y; the policy is told.",
        number([-0.6, 0.6], 0.0, |p, x| p.offset_m[1] = x, |c| readback::offset(c)[1]),
    )
    .in_family("placement"),
    row(
        "obstacle_gap_m",
        "m",
        Engine,
        "Smallest free space between an obstacle and the object or the target area.",
        number([0.0, 0.2], OBSTACLE_GAP, |p, x| p.obstacle_gap_m = x, readback::obstacle_gap),
    )
    .in_family("obstacles"),
    row(
        "occluders",
        "",
        Engine,
        "Number of panels between the object and the front camera.",
        Access::Integer { range: [0, 3], nominal: 0, set: |p, n| p.occluders = n, read: readback::occluders },
    )
    .in_family("camera"),
    row(
        "disturbance_speed_m_s",
        "m/s",
        Engine,
        "Speed of a box that crosses the workspace; at 0 there is no box.",
        number([0.0, 1.0], 0.0, |p, x| p.disturbance.speed_m_s = x, |c| readback::disturbance(c).speed_m_s),
    )
    .in_family("disturbance"),
    row(
        "disturbance_start_s",
        "s",
        Engine,
        "Time at which the disturbance starts to move.",
        number([0.0, 60.0], 0.0, |p, x| p.disturbance.start_s = x, |c| readback::disturbance(c).start_s),
    )
    .in_family("disturbance"),
    row(
        "disturbance_x_m",
        "m",
        Engine,
        "Position of the disturbance's centre along x before it moves.",
        number([-0.5, 1.5], 0.5, |p, x| p.disturbance.from[0] = x, |c| readback::disturbance(c).from[0]),
    )
    .in_family("disturbance"),
    row(
        "disturbance_y_m",
        "m",
        Engine,
        "Position of the disturbance's centre along y before it moves.",
        number([-1.5, 1.5], -0.5, |p, x| p.disturbance.from[1] = x, |c| readback::disturbance(c).from[1]),
    )
    .in_family("disturbance"),
    row(
        "disturbance_heading_rad",
        "rad",
        Engine,
        "Direction of the disturbance's motion: 0 along +x, positive towards +y.",
        number([-PI, PI], 0.0, |p, x| p.disturbance.heading_rad = x, |c| readback::disturbance(c).heading_rad),
    )
    .in_family("disturbance"),
    row(
        "disturbance_travel_m",
        "m",
        Engine,
        "Distance that the disturbance moves.",
        number([1e-3, 3.0], 0.5, |p, x| p.disturbance.travel_m = x, |c| readback::disturbance(c).travel_m),
    )
    .in_family("disturbance"),
    row(
        "lighting_lux",
        "lux",
        Cameras,
        "Illuminance on the table.",
        number([1.0, 1e5], 500.0, |p, x| p.visual.lighting_lux = x, |c| c.found.visual.lighting_lux),
    )
    .in_family("light"),
    row(
        "camera_roll_rad",
        "rad",
        Cameras,
        "Rotation of each camera about its line of sight, from its nominal pose.",
        number([-0.5, 0.5], 0.0, |p, x| p.visual.camera_roll_rad = x, |c| c.found.visual.camera_roll_rad),
    )
    .in_family("camera"),
    row(
        "camera_pitch_rad",
        "rad",
        Cameras,
        "Upward tilt of each camera from its nominal pose.",
        number([-0.5, 0.5], 0.0, |p, x| p.visual.camera_pitch_rad = x, |c| c.found.visual.camera_pitch_rad),
    )
    .in_family("camera"),
    row(
        "object_transparency",
        "",
        Cameras,
        "Fraction of the light that passes through the object.",
        number([0.0, 0.95], 0.0, |p, x| p.visual.object_transparency = x, |c| c.found.visual.object_transparency),
    )
    .in_family("appearance"),
    row(
        "table_material",
        "",
        Cameras,
        "Material of the table's top, as the cameras show it.",
        Access::Word {
            words: Words { choices: || TableMaterial::ALL.map(TableMaterial::as_str).into(), form: None },
            nominal: "wood",
            set: |p, word| TableMaterial::from_name(word).map(|material| p.visual.table_material = material),
            read: |c| c.found.visual.table_material.as_str().to_owned(),
        },
    )
    .in_family("appearance"),
    row(
        "background_color",
        "",
        Cameras,
        "Colour of the background behind the table (sRGB).",
        Access::Word {
            words: Words { choices: || vec!["#b8bcc0"], form: Some(COLOR) },
            nominal: "#b8bcc0",
            set: |p, word| Color::from_hex(word).map(|color| p.visual.background_color = color),
            read: |c| c.found.visual.background_color.to_string(),
        },
    )
    .in_family("appearance"),
    row(
        "object_color",
        "",
        Cameras,
        "Colour of the object (sRGB).",
        Access::Word {
            words: Words { choices: || vec!["#c83c28"], form: Some(COLOR) },
            nominal: "#c83c28",
            set: |p, word| Color::from_hex(word).map(|color| p.visual.object_color = color),
            read: |c| c.found.visual.object_color.to_string(),
        },
    )
    .in_family("appearance"),
    encoder_bias::<0>("unit_bias_1_rad"),
    encoder_bias::<1>("unit_bias_2_rad"),
    encoder_bias::<2>("unit_bias_3_rad"),
    encoder_bias::<3>("unit_bias_4_rad"),
    encoder_bias::<4>("unit_bias_5_rad"),
    encoder_bias::<5>("unit_bias_6_rad"),
    encoder_bias::<6>("unit_bias_7_rad"),
    row(
        "grip_force_scale",
        "",
        ActsOn::Gripper,
        "Force of the pads, or vacuum of the cup, as a multiple of the robot's setting.",
        number([0.05, 2.0], 1.0, |p, x| p.gripper.force_scale = x, |c| c.found.grip_force_scale.unwrap_or(f64::NAN)),
    )
    .in_family("gripper"),
    row(
        "pad_friction_scale",
        "",
        Pads,
        "Friction coefficient of the object against the pads, as a multiple of `friction`.",
        number([0.05, 2.0], 1.0, |p, x| p.gripper.pad_friction_scale = x, readback::pad_friction_scale),
    )
    .in_family("gripper"),
];

const COLOR: &str = "a colour as #rrggbb in lower case";
