//! What the parameters of a space mean in this world.

use std::f64::consts::PI;

use robogate_core::{Assignment, Domain, ParameterSpace};
use robogate_physics::{Color, Gripper, Object, TableMaterial, Visual};

use super::scene::OBSTACLE_GAP;
use super::{Disturbance, Placement, Shape};

/// The parameters of a scenario, decoded. One that a space does not name has its nominal value.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneParameters {
    /// `friction`: Coulomb coefficient of the object against pads and table alike.
    pub friction: f64,
    /// `mass_kg`: the object's mass.
    pub mass_kg: f64,
    /// `com_offset`: see [`Shape::object`].
    pub com_offset: f64,
    /// `size_m`: edge of the cube that the object fits.
    pub size_m: f64,
    /// `ik_noise_rad`: largest encoder bias. Each joint's encoder reads its position off by a constant
    /// of the episode, drawn uniformly between minus and plus this value.
    pub ik_noise_rad: f64,
    /// `obstacles`: how many stand within 0.3 m of the workspace centre.
    pub obstacles: usize,
    /// `shape`: the object's shape.
    pub shape: Shape,
    /// `placement`: the name of a [`Placement`].
    pub placement: String,
    /// `grip_threshold_m`: within this distance of the object a suction cup takes hold.
    pub grip_threshold_m: f64,
    /// `approach_speed_m_s`: how fast the tool comes down to the object; `None` is the policy's own.
    pub approach_speed_m_s: Option<f64>,
    /// `table_friction`: Coulomb coefficient of the object against the table; `None` is `friction`.
    pub table_friction: Option<f64>,
    /// `position_jitter_m`: the object stands off its placement by an offset of the episode, drawn uniformly
    /// from the disc of this radius. The policy is told the placement.
    pub position_jitter_m: f64,
    /// `gravity_scale`: gravity as a multiple of the Earth's.
    pub gravity_scale: f64,
    /// `offset_x_m`, `offset_y_m`: how far from its placement the object stands. The policy is told.
    pub offset_m: [f64; 2],
    /// `obstacle_gap_m`: free space between an obstacle and the object or the target's place.
    pub obstacle_gap_m: f64,
    /// `occluders`: how many panels stand between the object and the front camera.
    pub occluders: usize,
    /// `disturbance_...`: a body that crosses the workspace.
    pub disturbance: Disturbance,
    /// How it all looks.
    pub visual: Visual,
}

/// What a parameter may be in this world: the widest range in which it makes physical sense.
enum Meaning {
    Number { low: f64, high: f64 },
    Word(fn(&str) -> bool),
}

const MEANINGS: [(&str, Meaning); 30] = [
    ("friction", Meaning::Number { low: 0.0, high: 10.0 }),
    ("mass_kg", Meaning::Number { low: 1e-3, high: 100.0 }),
    ("com_offset", Meaning::Number { low: 0.0, high: 0.9 }),
    ("size_m", Meaning::Number { low: 5e-3, high: 0.2 }),
    ("ik_noise_rad", Meaning::Number { low: 0.0, high: 1.0 }),
    ("obstacles", Meaning::Number { low: 0.0, high: 12.0 }),
    ("shape", Meaning::Word(|word| Shape::from_name(word).is_some())),
    ("placement", Meaning::Word(|word| Placement::from_name(word).is_some())),
    (GRIP_THRESHOLD, Meaning::Number { low: 0.0, high: 0.1 }),
    ("approach_speed_m_s", Meaning::Number { low: 1e-3, high: 2.0 }),
    ("table_friction", Meaning::Number { low: 0.0, high: 10.0 }),
    ("position_jitter_m", Meaning::Number { low: 0.0, high: 0.05 }),
    ("gravity_scale", Meaning::Number { low: 0.01, high: 10.0 }),
    ("offset_x_m", Meaning::Number { low: -0.6, high: 0.6 }),
    ("offset_y_m", Meaning::Number { low: -0.6, high: 0.6 }),
    ("obstacle_gap_m", Meaning::Number { low: 0.0, high: 0.2 }),
    ("occluders", Meaning::Number { low: 0.0, high: 3.0 }),
    ("disturbance_speed_m_s", Meaning::Number { low: 0.0, high: 1.0 }),
    ("disturbance_start_s", Meaning::Number { low: 0.0, high: 60.0 }),
    ("disturbance_x_m", Meaning::Number { low: -0.5, high: 1.5 }),
    ("disturbance_y_m", Meaning::Number { low: -1.5, high: 1.5 }),
    ("disturbance_heading_rad", Meaning::Number { low: -PI, high: PI }),
    ("disturbance_travel_m", Meaning::Number { low: 1e-3, high: 3.0 }),
    ("lighting_lux", Meaning::Number { low: 1.0, high: 1e5 }),
    ("camera_roll_rad", Meaning::Number { low: -0.5, high: 0.5 }),
    ("camera_pitch_rad", Meaning::Number { low: -0.5, high: 0.5 }),
    ("object_transparency", Meaning::Number { low: 0.0, high: 0.95 }),
    ("table_material", Meaning::Word(|word| TableMaterial::from_name(word).is_some())),
    ("background_color", Meaning::Word(|word| Color::from_hex(word).is_some())),
    ("object_color", Meaning::Word(|word| Color::from_hex(word).is_some())),
];

/// Those that count something.
const WHOLE: [&str; 2] = ["obstacles", "occluders"];

/// Of suction cups alone.
const GRIP_THRESHOLD: &str = "grip_threshold_m";

impl Default for SceneParameters {
    fn default() -> Self {
        Self {
            friction: 0.8,
            mass_kg: 0.3,
            com_offset: 0.0,
            size_m: 0.05,
            ik_noise_rad: 0.0,
            obstacles: 0,
            shape: Shape::Box,
            placement: "center_0".to_owned(),
            grip_threshold_m: 0.01,
            approach_speed_m_s: None,
            table_friction: None,
            position_jitter_m: 0.0,
            gravity_scale: 1.0,
            offset_m: [0.0; 2],
            obstacle_gap_m: OBSTACLE_GAP,
            occluders: 0,
            disturbance: Disturbance::default(),
            visual: Visual::default(),
        }
    }
}

impl SceneParameters {
    /// Whether every parameter of `space` means something here over its whole range, and to this gripper where one is given.
    pub fn check_space(space: &ParameterSpace, gripper: Option<&Gripper>) -> Result<(), ParameterError> {
        for parameter in space.parameters() {
            let name = &*parameter.name;
            let wrong_kind = |expected| Err(ParameterError::Kind { parameter: name.to_owned(), expected });
            match (meaning_for(name, gripper)?, &parameter.domain) {
                (Meaning::Number { low, high }, Domain::Continuous { low: from, high: to, .. }) => {
                    if WHOLE.contains(&name) {
                        return wrong_kind("an integer");
                    }
                    in_range(name, *from, *low, *high)?;
                    in_range(name, *to, *low, *high)?;
                }
                (Meaning::Number { low, high }, Domain::Integer { low: from, high: to }) => {
                    in_range(name, *from as f64, *low, *high)?;
                    in_range(name, *to as f64, *low, *high)?;
                }
                (Meaning::Word(known), Domain::Categorical { choices }) => {
                    if let Some(choice) = choices.iter().find(|choice| !known(choice)) {
                        return Err(unknown_choice(name, choice));
                    }
                }
                (Meaning::Number { .. }, Domain::Categorical { .. }) => return wrong_kind("a number"),
                (Meaning::Word(_), _) => return wrong_kind("categorical"),
            }
        }
        Ok(())
    }

    /// The parameters that there are for a robot with this gripper.
    pub fn names(gripper: &Gripper) -> impl Iterator<Item = &'static str> {
        let cup = gripper.cup().is_some();
        MEANINGS.iter().map(|(name, _)| *name).filter(move |name| cup || *name != GRIP_THRESHOLD)
    }

    /// The parameters of an assignment, for a robot with this gripper where one is given.
    pub fn from_assignment(assignment: &Assignment, gripper: Option<&Gripper>) -> Result<Self, ParameterError> {
        let mut parameters = Self::default();
        for (name, value) in assignment.iter() {
            match meaning_for(name, gripper)? {
                Meaning::Number { low, high } => {
                    let Some(x) = assignment.number(name) else {
                        return Err(ParameterError::Kind { parameter: name.to_owned(), expected: "a number" });
                    };
                    in_range(name, x, *low, *high)?;
                    match name {
                        "friction" => parameters.friction = x,
                        "mass_kg" => parameters.mass_kg = x,
                        "com_offset" => parameters.com_offset = x,
                        "size_m" => parameters.size_m = x,
                        "ik_noise_rad" => parameters.ik_noise_rad = x,
                        GRIP_THRESHOLD => parameters.grip_threshold_m = x,
                        "approach_speed_m_s" => parameters.approach_speed_m_s = Some(x),
                        "table_friction" => parameters.table_friction = Some(x),
                        "position_jitter_m" => parameters.position_jitter_m = x,
                        "gravity_scale" => parameters.gravity_scale = x,
                        "offset_x_m" => parameters.offset_m[0] = x,
                        "offset_y_m" => parameters.offset_m[1] = x,
                        "obstacle_gap_m" => parameters.obstacle_gap_m = x,
                        "lighting_lux" => parameters.visual.lighting_lux = x,
                        "camera_roll_rad" => parameters.visual.camera_roll_rad = x,
                        "camera_pitch_rad" => parameters.visual.camera_pitch_rad = x,
                        "object_transparency" => parameters.visual.object_transparency = x,
                        _ if WHOLE.contains(&name) && x.fract() != 0.0 => {
                            return Err(ParameterError::Kind { parameter: name.to_owned(), expected: "an integer" });
                        }
                        "occluders" => parameters.occluders = x as usize,
                        _ => match parameters.disturbance.value_mut(name) {
                            Some(value) => *value = x,
                            None => parameters.obstacles = x as usize,
                        },
                    }
                }
                Meaning::Word(_) => {
                    let word = value.to_string();
                    let unknown = || unknown_choice(name, &word);
                    let visual = &mut parameters.visual;
                    match name {
                        "shape" => parameters.shape = Shape::from_name(&word).ok_or_else(unknown)?,
                        "table_material" => {
                            visual.table_material = TableMaterial::from_name(&word).ok_or_else(unknown)?
                        }
                        "background_color" => visual.background_color = Color::from_hex(&word).ok_or_else(unknown)?,
                        "object_color" => visual.object_color = Color::from_hex(&word).ok_or_else(unknown)?,
                        _ => {
                            Placement::from_name(&word).ok_or_else(unknown)?;
                            parameters.placement = word;
                        }
                    }
                }
            }
        }
        Ok(parameters)
    }

    /// The object of these parameters.
    pub fn object(&self) -> Object {
        self.shape.object(self.size_m, self.mass_kg, self.com_offset)
    }
}

fn meaning(name: &str) -> Result<&'static Meaning, ParameterError> {
    MEANINGS.iter().find(|(known, _)| *known == name).map(|(_, meaning)| meaning).ok_or_else(|| {
        let known = MEANINGS.iter().map(|(known, _)| *known).collect::<Vec<_>>().join(", ");
        ParameterError::Unknown { parameter: name.to_owned(), known }
    })
}

fn meaning_for(name: &str, gripper: Option<&Gripper>) -> Result<&'static Meaning, ParameterError> {
    if let Some(gripper) = gripper.filter(|gripper| name == GRIP_THRESHOLD && gripper.cup().is_none()) {
        return Err(ParameterError::Gripper { parameter: name.to_owned(), gripper: gripper.description() });
    }
    meaning(name)
}

fn in_range(name: &str, value: f64, low: f64, high: f64) -> Result<(), ParameterError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ParameterError::Range { parameter: name.to_owned(), value, low, high })
}

fn unknown_choice(name: &str, choice: &str) -> ParameterError {
    let known = match name {
        "shape" => Shape::ALL.map(Shape::as_str).join(", "),
        "table_material" => TableMaterial::ALL.map(TableMaterial::as_str).join(", "),
        "background_color" | "object_color" => "colours written #rrggbb, in lower case".to_owned(),
        _ => Placement::NAMES.join(", "),
    };
    ParameterError::Choice { parameter: name.to_owned(), choice: choice.to_owned(), known }
}

/// Why parameters mean nothing in this world.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParameterError {
    /// A name that the world does not know.
    #[error("parameter `{parameter}` means nothing in this world; it knows {known}")]
    Unknown {
        /// The name.
        parameter: String,
        /// The names it knows.
        known: String,
    },
    /// A parameter that this robot's gripper does not have.
    #[error("parameter `{parameter}` means nothing to this robot: its gripper is {gripper}")]
    Gripper {
        /// The name.
        parameter: String,
        /// The gripper's kind.
        gripper: &'static str,
    },
    /// A parameter of another kind.
    #[error("parameter `{parameter}` must be {expected}")]
    Kind {
        /// The name.
        parameter: String,
        /// What it must be.
        expected: &'static str,
    },
    /// A value without physical sense.
    #[error("parameter `{parameter}` = {value} is outside {low} to {high}")]
    Range {
        /// The name.
        parameter: String,
        /// The value.
        value: f64,
        /// Smallest sensible value.
        low: f64,
        /// Largest sensible value.
        high: f64,
    },
    /// A word that the world does not know.
    #[error("parameter `{parameter}`: there is no `{choice}`; there are {known}")]
    Choice {
        /// The name.
        parameter: String,
        /// The word.
        choice: String,
        /// The words it knows.
        known: String,
    },
}
