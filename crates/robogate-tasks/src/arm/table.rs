//! Parameter tables: one row per parameter, with its range, setter and reader.

use robogate_core::{Allowed, Assignment, Fault, FaultKind, ParameterSpec, Scenario, Value, Word};
use robogate_physics::{Gripper, GripperUnit, Robot, Visual};

use super::{Found, encoder_bias};

/// One parameter of a task with the settings `S`.
pub(crate) struct Row<S: 'static> {
    pub(crate) name: &'static str,
    pub(crate) unit: &'static str,
    pub(crate) meaning: &'static str,
    /// The source of the applied value.
    pub(crate) read_from: &'static str,
    /// The family of perturbations that it belongs to.
    pub(crate) family: Option<&'static str>,
    /// Whether the gripper must have pads.
    pub(crate) needs_pads: bool,
    pub(crate) access: Access<S>,
}

/// How a parameter is set and read.
pub(crate) enum Access<S: 'static> {
    Number {
        range: [f64; 2],
        nominal: f64,
        set: fn(&mut S, f64),
        read: fn(&Acting<'_, S>) -> f64,
    },
    Word {
        choices: &'static [&'static str],
        nominal: &'static str,
        set: fn(&mut S, &str),
        read: fn(&Acting<'_, S>) -> String,
    },
}

/// The components that act in an episode after its setup.
pub(crate) struct Acting<'a, S> {
    /// The settings, to interpret the state: which direction a draw has, which part a pose belongs to.
    pub(crate) settings: &'a S,
    /// The state from which values are read.
    pub(crate) found: &'a Found<'a>,
    /// Bias of each encoder, in radians.
    pub(crate) bias: &'a [f64],
}

/// Parameters of the arm and the light, which every task has.
#[derive(Debug, Clone, Default)]
pub(crate) struct Surroundings {
    /// Largest encoder bias, in radians.
    pub(crate) encoder_bias_rad: f64,
    /// Illuminance on the table.
    pub(crate) lighting_lux: f64,
    /// Constant bias of each joint's encoder, in radians, which is added to the drawn one.
    pub(crate) unit_bias_rad: [f64; UNIT_BIASES.len()],
    /// Deviations of the gripper.
    pub(crate) gripper: GripperUnit,
    /// Rotation of each camera about its line of sight, and its upward tilt, in radians.
    pub(crate) camera_rad: [f64; 2],
    /// For each joint, a number from -1 to 1: the fraction of the encoder bias.
    pub(crate) encoders: Vec<f64>,
}

/// The names of the constant biases, for the joints from the base on.
const UNIT_BIASES: [&str; 7] = [
    "unit_bias_1_rad",
    "unit_bias_2_rad",
    "unit_bias_3_rad",
    "unit_bias_4_rad",
    "unit_bias_5_rad",
    "unit_bias_6_rad",
    "unit_bias_7_rad",
];

impl Surroundings {
    /// The bias of each encoder in the episode of this scenario, in radians.
    ///
    /// # Errors
    /// A setup fault if a bias belongs to a joint that the arm does not have.
    pub(crate) fn bias(&self, scenario: &Scenario, robot: &Robot) -> Result<Vec<f64>, Fault> {
        let mut bias = encoder_bias(scenario, robot, self.encoder_bias_rad);
        let extra = self.unit_bias_rad.iter().zip(UNIT_BIASES).skip(bias.len()).find(|(bias, _)| bias.abs() > 0.0);
        if let Some((_, name)) = extra {
            return Err(Fault::new(FaultKind::Setup, format!("{name}: the arm has {} joints", bias.len())));
        }
        bias.iter_mut().zip(self.unit_bias_rad).for_each(|(bias, unit)| *bias += unit);
        Ok(bias)
    }

    /// Appearance of a scene with this light and these cameras.
    pub(crate) fn visual(&self) -> Visual {
        let [camera_roll_rad, camera_pitch_rad] = self.camera_rad;
        Visual { lighting_lux: self.lighting_lux, camera_roll_rad, camera_pitch_rad, ..Visual::default() }
    }
}

/// The settings of a task, which contain those of arm and light.
pub(crate) trait InSurroundings {
    fn around(&self) -> &Surroundings;
    fn around_mut(&mut self) -> &mut Surroundings;
}

impl<S: InSurroundings> Row<S> {
    /// The bias of the encoders.
    pub(crate) const fn encoder_bias() -> Self {
        Self::number(
            "encoder_bias_rad",
            "rad",
            "Largest encoder bias: each joint's encoder has a constant bias, drawn uniformly between minus and plus this value.",
            "the biases of the encoders",
            ([0.0, 0.1], 0.0),
            |s, x| s.around_mut().encoder_bias_rad = x,
            |a| {
                let units = a.settings.around().unit_bias_rad;
                let drawn: Vec<f64> = a.bias.iter().zip(units).map(|(bias, unit)| bias - unit).collect();
                scale(&a.settings.around().encoders, &drawn)
            },
        )
        .in_family("encoders")
    }

    /// The constant bias of the encoder of joint `J`, counted from 0.
    pub(crate) const fn unit_bias<const J: usize>() -> Self {
        Self::number(
            UNIT_BIASES[J],
            "rad",
            "Constant bias of this joint's encoder (counted from the base): measured minus true position. It is added to that of `encoder_bias_rad`.",
            "the biases of the encoders",
            ([-0.1, 0.1], 0.0),
            |s, x| s.around_mut().unit_bias_rad[J] = x,
            |a| {
                let Surroundings { encoder_bias_rad, encoders, .. } = a.settings.around();
                let drawn = encoders.get(J).map(|fraction| encoder_bias_rad * fraction);
                a.bias.get(J).zip(drawn).map_or(f64::NAN, |(bias, drawn)| bias - drawn)
            },
        )
        .in_family("encoders")
    }

    /// The force of the gripper.
    pub(crate) const fn grip_force_scale() -> Self {
        Self::number(
            "grip_force_scale",
            "",
            "Force of the pads, or vacuum of the cup, as a multiple of the robot's setting.",
            "the drive of the gripper",
            ([0.05, 2.0], 1.0),
            |s, x| s.around_mut().gripper.force_scale = x,
            |a| a.found.grip_force_scale.unwrap_or(f64::NAN),
        )
        .in_family("gripper")
    }

    /// The friction of the pads, for a gripper that has them.
    pub(crate) const fn pad_friction_scale() -> Self {
        let row = Self::number(
            "pad_friction_scale",
            "",
            "Friction coefficient of the parts against the pads, as a multiple of that against the gripper.",
            "the contact of the pads",
            ([0.05, 2.0], 1.0),
            |s, x| s.around_mut().gripper.pad_friction_scale = x,
            |a| a.found.engine.pad_friction.map_or(f64::NAN, |pads| pads / a.found.engine.friction),
        );
        Self { needs_pads: true, ..row.in_family("gripper") }
    }

    /// The rotation of the cameras about their lines of sight.
    pub(crate) const fn camera_roll() -> Self {
        Self::number(
            "camera_roll_rad",
            "rad",
            "Rotation of each camera about its line of sight, from its nominal pose.",
            "the cameras",
            ([-0.5, 0.5], 0.0),
            |s, x| s.around_mut().camera_rad[0] = x,
            |a| a.found.visual.camera_roll_rad,
        )
        .in_family("camera")
    }

    /// The upward tilt of the cameras.
    pub(crate) const fn camera_pitch() -> Self {
        Self::number(
            "camera_pitch_rad",
            "rad",
            "Upward tilt of each camera from its nominal pose.",
            "the cameras",
            ([-0.5, 0.5], 0.0),
            |s, x| s.around_mut().camera_rad[1] = x,
            |a| a.found.visual.camera_pitch_rad,
        )
        .in_family("camera")
    }

    /// The illuminance on the table.
    pub(crate) const fn lighting() -> Self {
        Self::number(
            "lighting_lux",
            "lux",
            "Illuminance on the table.",
            "the cameras",
            ([1.0, 1e5], 500.0),
            |s, x| s.around_mut().lighting_lux = x,
            |a| a.found.visual.lighting_lux,
        )
        .in_family("light")
    }
}

/// The scale of draws that gives these displacements: the component along the largest draw. `NaN` if another
/// displacement disagrees by more than a micrometre or microradian.
pub(crate) fn scale(draws: &[f64], displacements: &[f64]) -> f64 {
    let largest = (0..draws.len()).max_by(|a, b| draws[*a].abs().total_cmp(&draws[*b].abs())).unwrap_or_default();
    let scale = displacements[largest] / draws[largest];
    let agrees = draws.iter().zip(displacements).all(|(draw, found)| (draw * scale - found).abs() < 1e-6);
    if agrees { scale } else { f64::NAN }
}

/// The parameters as a task declares them for a robot with this gripper.
pub(crate) fn specs<S>(rows: &[Row<S>], gripper: &Gripper) -> Vec<ParameterSpec> {
    rows.iter().filter(|row| !row.needs_pads || gripper.jaw().is_some()).map(Row::spec).collect()
}

/// The settings of a scenario. Parameters that it does not name are nominal.
///
/// # Errors
/// A setup fault for an unknown parameter or a value out of its range.
pub(crate) fn decode<S: Default>(rows: &[Row<S>], requested: &Assignment) -> Result<S, Fault> {
    let setup = |why: String| Fault::new(FaultKind::Setup, why);
    let mut settings = S::default();
    for row in rows {
        match &row.access {
            Access::Number { nominal, set, .. } => set(&mut settings, *nominal),
            Access::Word { nominal, set, .. } => set(&mut settings, nominal),
        }
    }
    for (name, value) in requested.iter() {
        let row = rows.iter().find(|row| row.name == name).ok_or_else(|| {
            let known: Vec<&str> = rows.iter().map(|row| row.name).collect();
            setup(format!("unknown parameter `{name}`. Expected one of: {}", known.join(", ")))
        })?;
        row.spec().accepts(value).map_err(setup)?;
        match (&row.access, value) {
            (Access::Number { set, .. }, Value::Number(x)) => set(&mut settings, *x),
            (Access::Number { set, .. }, Value::Integer(n)) => set(&mut settings, *n as f64),
            (Access::Word { set, .. }, Value::Category(word)) => set(&mut settings, word),
            // `accepts` has rejected all other kinds.
            _ => {}
        }
    }
    Ok(settings)
}

/// The applied values of the requested parameters.
pub(crate) fn applied<S>(rows: &[Row<S>], requested: &Assignment, acting: &Acting<'_, S>) -> Assignment {
    let mut applied = Assignment::default();
    for (name, value) in requested.iter() {
        let Some(row) = rows.iter().find(|row| row.name == name) else { continue };
        let read = match (&row.access, value) {
            (Access::Number { read, .. }, Value::Integer(_)) => {
                let x = read(acting);
                // An integer request is returned as an integer.
                if (x - x.round()).abs() < 1e-6 { Value::Integer(x.round() as i64) } else { Value::Number(x) }
            }
            (Access::Number { read, .. }, _) => Value::Number(read(acting)),
            (Access::Word { read, .. }, _) => Value::Category(read(acting).into()),
        };
        applied.set(name, read);
    }
    applied
}

impl<S> Row<S> {
    /// A parameter that is a number.
    pub(crate) const fn number(
        name: &'static str,
        unit: &'static str,
        meaning: &'static str,
        read_from: &'static str,
        (range, nominal): ([f64; 2], f64),
        set: fn(&mut S, f64),
        read: fn(&Acting<'_, S>) -> f64,
    ) -> Self {
        Self {
            name,
            unit,
            meaning,
            read_from,
            family: None,
            needs_pads: false,
            access: Access::Number { range, nominal, set, read },
        }
    }

    pub(crate) const fn in_family(self, family: &'static str) -> Self {
        Self { family: Some(family), ..self }
    }

    fn spec(&self) -> ParameterSpec {
        let (allowed, nominal) = match &self.access {
            Access::Number { range: [low, high], nominal, .. } => {
                (Allowed::Continuous { low: *low, high: *high }, Value::Number(*nominal))
            }
            Access::Word { choices, nominal, .. } => {
                let choices = choices.iter().map(|word| (*word).into()).collect();
                (Allowed::Categorical { choices, open: false }, Value::Category((*nominal).into()))
            }
        };
        ParameterSpec {
            name: self.name.into(),
            unit: self.unit.to_owned(),
            meaning: self.meaning.to_owned(),
            allowed,
            nominal: Some(nominal),
            read_from: self.read_from.to_owned(),
            family: self.family.map(Word::constant),
        }
    }
}
