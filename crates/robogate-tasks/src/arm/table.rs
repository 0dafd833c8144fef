//! Parameter tables: one row per parameter, with its range, setter and reader.

use robogate_core::{Allowed, Assignment, Domain, Fault, FaultKind, ParameterSpec, Scenario, Value, Word};
use robogate_physics::{Gripper, GripperUnit, Robot, Visual};

use super::{Found, Parameters, encoder_bias};
use crate::settings::unit_of;

/// One parameter of a task with the settings `S`, whose applied value is interpreted with `C`.
pub(crate) struct Row<S: 'static, C: 'static = S> {
    /// The name, which ends with the unit.
    pub(crate) name: &'static str,
    pub(crate) meaning: &'static str,
    /// The source of the applied value.
    pub(crate) read_from: &'static str,
    /// The family of perturbations that it belongs to.
    pub(crate) family: Option<&'static str>,
    pub(crate) needs: Needs,
    pub(crate) access: Access<S, C>,
}

/// The gripper that a parameter needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Needs {
    Any,
    Pads,
    Cup,
}

type Read<C, T> = fn(&Acting<'_, C>) -> T;

/// How a parameter is set and read.
pub(crate) enum Access<S: 'static, C: 'static = S> {
    /// A number. Without a nominal value it is unset, as the meaning says.
    Number { range: [f64; 2], nominal: Option<f64>, set: fn(&mut S, f64), read: Read<C, f64> },
    /// A count.
    Integer { range: [usize; 2], nominal: usize, set: fn(&mut S, usize), read: Read<C, usize> },
    /// A word. `set` returns `None` for an unknown one.
    Word { words: Words, nominal: &'static str, set: fn(&mut S, &str) -> Option<()>, read: Read<C, String> },
}

/// The accepted words of a parameter.
pub(crate) struct Words {
    pub(crate) choices: fn() -> Vec<&'static str>,
    /// The pattern of further accepted words.
    pub(crate) form: Option<&'static str>,
}

/// The components that act in an episode after its setup.
pub(crate) struct Acting<'a, C> {
    /// What interprets the state: which direction a draw has, which part a pose belongs to.
    pub(crate) settings: &'a C,
    pub(crate) around: &'a Surroundings,
    /// The state from which values are read.
    pub(crate) found: &'a Found<'a>,
    /// Bias of each encoder, in radians.
    pub(crate) bias: &'a [f64],
}

/// Parameters of the arm and the light, which every task has.
#[derive(Debug, Clone, Default, PartialEq)]
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

const ENCODERS: &str = "the biases of the encoders";

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

/// Whether a parameter belongs to a joint that an arm with this number of joints does not have.
pub(crate) fn is_of_missing_joint(name: &str, joints: usize) -> bool {
    UNIT_BIASES.iter().skip(joints).any(|bias| *bias == name)
}

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
    fn around_mut(&mut self) -> &mut Surroundings;
}

impl<S: InSurroundings + 'static, C: 'static> Row<S, C> {
    /// The parameters of every task, after its own ones.
    const COMMON: &'static [Self] = &[
        Self::lighting(),
        Self::unit_bias::<0>(),
        Self::unit_bias::<1>(),
        Self::unit_bias::<2>(),
        Self::unit_bias::<3>(),
        Self::unit_bias::<4>(),
        Self::unit_bias::<5>(),
        Self::unit_bias::<6>(),
        Self::grip_force_scale(),
        Self::pad_friction_scale(),
        Self::camera_roll(),
        Self::camera_pitch(),
    ];

    /// The bias of the encoders, under this name and with this largest value (rad).
    pub(crate) const fn encoder_bias(name: &'static str, most: f64) -> Self {
        Self::number(
            name,
            "Largest encoder bias: each joint's encoder has a constant bias, drawn uniformly between minus and plus this value.",
            ENCODERS,
            ([0.0, most], 0.0),
            |s, x| s.around_mut().encoder_bias_rad = x,
            |a| {
                let units = a.around.unit_bias_rad;
                let drawn: Vec<f64> = a.bias.iter().zip(units).map(|(bias, unit)| bias - unit).collect();
                scale(&a.around.encoders, &drawn)
            },
        )
        .in_family("encoders")
    }

    /// The constant bias of the encoder of joint `J`, counted from 0.
    const fn unit_bias<const J: usize>() -> Self {
        Self::number(
            UNIT_BIASES[J],
            "Constant bias of this joint's encoder (counted from the base): measured minus true position. It is added to the drawn one.",
            ENCODERS,
            ([-0.1, 0.1], 0.0),
            |s, x| s.around_mut().unit_bias_rad[J] = x,
            |a| {
                let Surroundings { encoder_bias_rad, encoders, .. } = a.around;
                let drawn = encoders.get(J).map(|fraction| encoder_bias_rad * fraction);
                a.bias.get(J).zip(drawn).map_or(f64::NAN, |(bias, drawn)| bias - drawn)
            },
        )
        .in_family("encoders")
    }

    /// The force of the gripper.
    const fn grip_force_scale() -> Self {
        Self::number(
            "grip_force_scale",
            "Force of the pads, or vacuum of the cup, as a multiple of the robot's setting.",
            "the drive of the gripper",
            ([0.05, 2.0], 1.0),
            |s, x| s.around_mut().gripper.force_scale = x,
            |a| a.found.grip_force_scale.unwrap_or(f64::NAN),
        )
        .in_family("gripper")
    }

    /// The friction of the pads, for a gripper that has them.
    const fn pad_friction_scale() -> Self {
        let row = Self::number(
            "pad_friction_scale",
            "Friction coefficient of the parts against the pads, as a multiple of that against the gripper.",
            "the contact of the pads",
            ([0.05, 2.0], 1.0),
            |s, x| s.around_mut().gripper.pad_friction_scale = x,
            |a| match (a.found.engine.pad_friction, a.found.engine.friction) {
                // A multiple of no friction cannot be read, and has no effect.
                (Some(pads), others) if pads.abs() + others.abs() <= 0.0 => a.around.gripper.pad_friction_scale,
                (Some(pads), others) => pads / others,
                (None, _) => f64::NAN,
            },
        );
        Self { needs: Needs::Pads, ..row.in_family("gripper") }
    }

    /// The rotation of the cameras about their lines of sight.
    const fn camera_roll() -> Self {
        Self::number(
            "camera_roll_rad",
            "Rotation of each camera about its line of sight, from its nominal pose.",
            "the cameras",
            ([-0.5, 0.5], 0.0),
            |s, x| s.around_mut().camera_rad[0] = x,
            |a| a.found.visual.camera_roll_rad,
        )
        .in_family("camera")
    }

    /// The upward tilt of the cameras.
    const fn camera_pitch() -> Self {
        Self::number(
            "camera_pitch_rad",
            "Upward tilt of each camera from its nominal pose.",
            "the cameras",
            ([-0.5, 0.5], 0.0),
            |s, x| s.around_mut().camera_rad[1] = x,
            |a| a.found.visual.camera_pitch_rad,
        )
        .in_family("camera")
    }

    /// The illuminance on the table.
    const fn lighting() -> Self {
        Self::number(
            "lighting_lux",
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
/// displacement disagrees by more than a micrometre or microradian, or a millionth of a larger one.
pub(crate) fn scale(draws: &[f64], displacements: &[f64]) -> f64 {
    let largest = (0..draws.len()).max_by(|a, b| draws[*a].abs().total_cmp(&draws[*b].abs())).unwrap_or_default();
    let scale = displacements.get(largest).map_or(f64::NAN, |displacement| displacement / draws[largest]);
    let agrees =
        draws.iter().zip(displacements).all(|(draw, found)| (draw * scale - found).abs() < 1e-6 * found.abs().max(1.0));
    if agrees && draws.len() == displacements.len() { scale } else { f64::NAN }
}

/// A value computed from doubles equals the request within this relative distance.
const ROUNDING: f64 = 1e-9;

/// The parameters of a task: its own rows, then those of every task.
pub(crate) struct Table<S: 'static, C: 'static = S>(pub(crate) &'static [Row<S, C>]);

impl<S: InSurroundings + Default + 'static, C: 'static> Table<S, C> {
    fn rows(&self) -> impl Iterator<Item = &'static Row<S, C>> {
        self.0.iter().chain(Row::COMMON)
    }

    /// The row of a parameter, for a robot with this gripper if one is given.
    fn row(&self, name: &str, gripper: Option<&Gripper>) -> Result<&'static Row<S, C>, String> {
        let row = self.rows().find(|row| row.name == name).ok_or_else(|| {
            let known: Vec<&str> = self.rows().map(|row| row.name).collect();
            format!("unknown parameter `{name}`. Expected one of: {}", known.join(", "))
        })?;
        match gripper.filter(|gripper| !row.applies_to(gripper)) {
            Some(gripper) => {
                let gripper = gripper.description();
                Err(format!("parameter `{name}` does not apply to this robot: its gripper is {gripper}"))
            }
            None => Ok(row),
        }
    }

    /// The settings of a scenario. Parameters that it does not name are nominal.
    ///
    /// # Errors
    /// A setup fault for an unknown parameter, a value that it does not accept, or a gripper that does not have it.
    pub(crate) fn decode(&self, requested: &Assignment, gripper: &Gripper) -> Result<S, Fault> {
        let mut settings = self.nominal();
        for (name, value) in requested.iter() {
            let row = self.row(name, Some(gripper));
            row.and_then(|row| row.set(&mut settings, value)).map_err(|why| Fault::new(FaultKind::Setup, why))?;
        }
        Ok(settings)
    }

    /// The nominal settings.
    pub(crate) fn nominal(&self) -> S {
        let mut settings = S::default();
        self.rows().for_each(|row| row.set_nominal(&mut settings));
        settings
    }

    /// The applied values of the requested parameters.
    pub(crate) fn applied(&self, requested: &Assignment, acting: &Acting<'_, C>) -> Assignment {
        // A name without a row was rejected when the scenario was decoded.
        let read = |(name, value): (&str, &Value)| {
            let row = self.rows().find(|row| row.name == name)?;
            Some((name.into(), row.read(acting, value)))
        };
        requested.iter().filter_map(read).collect()
    }
}

impl<S: InSurroundings + Default, C> Parameters for Table<S, C> {
    fn specs(&self, gripper: &Gripper) -> Vec<ParameterSpec> {
        self.rows().filter(|row| row.applies_to(gripper)).map(Row::spec).collect()
    }

    fn knows(&self, name: &str) -> bool {
        self.rows().any(|row| row.name == name)
    }

    fn accepts(&self, name: &str, value: &Value, gripper: Option<&Gripper>) -> Result<(), String> {
        self.row(name, gripper)?.set(&mut S::default(), value)
    }

    fn accepts_all(&self, name: &str, domain: &Domain, gripper: Option<&Gripper>) -> Result<(), String> {
        let row = self.row(name, gripper)?;
        if let (Access::Integer { .. }, Domain::Continuous { .. }) = (&row.access, domain) {
            return Err(format!("parameter `{name}` has a value of the wrong kind. Expected an integer"));
        }
        domain.extremes().iter().try_for_each(|value| row.set(&mut S::default(), value))
    }
}

impl<S, C> Row<S, C> {
    /// A parameter that is a number.
    pub(crate) const fn number(
        name: &'static str,
        meaning: &'static str,
        read_from: &'static str,
        (range, nominal): ([f64; 2], f64),
        set: fn(&mut S, f64),
        read: Read<C, f64>,
    ) -> Self {
        let access = Access::Number { range, nominal: Some(nominal), set, read };
        Self::new(name, meaning, read_from, access)
    }

    pub(crate) const fn new(
        name: &'static str,
        meaning: &'static str,
        read_from: &'static str,
        access: Access<S, C>,
    ) -> Self {
        Self { name, meaning, read_from, family: None, needs: Needs::Any, access }
    }

    pub(crate) const fn in_family(self, family: &'static str) -> Self {
        Self { family: Some(family), ..self }
    }

    /// Whether the parameter applies to a robot with this gripper.
    fn applies_to(&self, gripper: &Gripper) -> bool {
        match self.needs {
            Needs::Any => true,
            Needs::Pads => gripper.jaw().is_some(),
            Needs::Cup => gripper.cup().is_some(),
        }
    }

    fn spec(&self) -> ParameterSpec {
        let (allowed, nominal) = match &self.access {
            Access::Number { range: [low, high], nominal, .. } => {
                (Allowed::Continuous { low: *low, high: *high }, nominal.map(Value::Number))
            }
            Access::Integer { range: [low, high], nominal, .. } => {
                let allowed = Allowed::Integer { low: *low as i64, high: *high as i64 };
                (allowed, Some(Value::Integer(*nominal as i64)))
            }
            Access::Word { words, nominal, .. } => {
                let choices = (words.choices)().into_iter().map(Into::into).collect();
                let allowed = Allowed::Categorical { choices, open: words.form.is_some() };
                (allowed, Some(Value::Category((*nominal).into())))
            }
        };
        ParameterSpec {
            name: self.name.into(),
            unit: unit_of(self.name).to_owned(),
            meaning: self.meaning.to_owned(),
            allowed,
            nominal,
            read_from: self.read_from.to_owned(),
            family: self.family.map(Word::constant),
        }
    }

    fn set_nominal(&self, settings: &mut S) {
        match &self.access {
            Access::Number { nominal, set, .. } => nominal.iter().for_each(|x| set(settings, *x)),
            Access::Integer { nominal, set, .. } => set(settings, *nominal),
            // A test checks that every nominal word is known.
            Access::Word { nominal, set, .. } => set(settings, nominal).unwrap_or_default(),
        }
    }

    fn set(&self, settings: &mut S, value: &Value) -> Result<(), String> {
        self.spec().accepts(value)?;
        match (&self.access, value) {
            (Access::Number { set, .. }, Value::Number(x)) => set(settings, *x),
            (Access::Number { set, .. }, Value::Integer(n)) => set(settings, *n as f64),
            (Access::Integer { set, .. }, Value::Number(x)) => set(settings, *x as usize),
            (Access::Integer { set, .. }, Value::Integer(n)) => set(settings, *n as usize),
            (Access::Word { words, set, .. }, Value::Category(word)) => set(settings, word).ok_or_else(|| {
                let (choices, form) = ((words.choices)().join(", "), words.form.unwrap_or_default());
                format!("parameter `{}`: unknown value `{word}`. Expected {form}, such as {choices}", self.name)
            })?,
            // `accepts` has rejected all other kinds.
            _ => {}
        }
        Ok(())
    }

    /// The applied value, of the same kind as the requested one.
    fn read(&self, acting: &Acting<'_, C>, requested: &Value) -> Value {
        let number = |x: f64| match requested {
            Value::Integer(_) if (x - x.round()).abs() < 1e-6 => Value::Integer(x.round() as i64),
            // A value that follows from several others has fewer digits than the request.
            Value::Number(wanted) if (x - wanted).abs() < ROUNDING * wanted.abs().max(1e-3) => Value::Number(*wanted),
            _ => Value::Number(x),
        };
        match &self.access {
            Access::Number { read, .. } => number(read(acting)),
            Access::Integer { read, .. } => number(read(acting) as f64),
            Access::Word { read, .. } => Value::Category(read(acting).into()),
        }
    }
}
