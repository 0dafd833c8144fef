//! The parameter table of the pendulum: one row per parameter.

use robogate_core::{Allowed, Assignment, Fault, FaultKind, ParameterSpec, Value, Word};
use robogate_physics::MujocoModel;

/// The settings from which an episode's model is built.
#[derive(Debug, Clone, Copy)]
pub(super) struct Settings {
    /// Mass of the pole, in kg.
    pub(super) mass: f64,
    /// Length of the pole, in m.
    pub(super) length: f64,
    /// Damping of the hinge, in N m s/rad.
    pub(super) damping: f64,
    /// Largest torque of the motor, in N m.
    pub(super) torque_limit: f64,
    /// Gravity as a multiple of standard gravity.
    pub(super) gravity: f64,
    /// Angle at the start, from hanging, in rad.
    pub(super) start: f64,
    /// Bias of the encoder: reading minus true angle, in rad.
    pub(super) bias: f64,
}

/// Gravity on Earth, in m/s².
pub(super) const GRAVITY: f64 = 9.81;

/// The sources of applied values.
pub(super) struct Applied<'a> {
    /// The compiled model.
    pub(super) model: &'a MujocoModel,
    /// The encoder bias of the episode.
    pub(super) bias: f64,
}

/// One parameter: its declaration, its setter and its reader.
struct Row {
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    low: f64,
    high: f64,
    nominal: f64,
    read_from: &'static str,
    family: Option<&'static str>,
    set: fn(&mut Settings) -> &mut f64,
    read: fn(&Applied<'_>) -> f64,
}

const ROWS: [Row; 7] = [
    Row {
        name: "mass_kg",
        unit: "kg",
        meaning: "Mass of the pole.",
        low: 0.05,
        high: 5.0,
        nominal: 0.5,
        read_from: "the compiled model's body mass",
        family: Some("pole"),
        set: |settings| &mut settings.mass,
        read: |applied| applied.model.data().model().body_mass()[1],
    },
    Row {
        name: "length_m",
        unit: "m",
        meaning: "Length of the pole.",
        low: 0.1,
        high: 2.0,
        nominal: 0.5,
        read_from: "the compiled model's geom size",
        family: Some("pole"),
        set: |settings| &mut settings.length,
        read: |applied| 2.0 * applied.model.data().model().geom_size()[0][1],
    },
    Row {
        name: "damping_nms_rad",
        unit: "N m s/rad",
        meaning: "Viscous damping of the hinge.",
        low: 0.0,
        high: 1.0,
        nominal: 0.01,
        read_from: "the compiled model's joint damping",
        family: Some("drive"),
        set: |settings| &mut settings.damping,
        read: |applied| applied.model.data().model().dof_damping()[0],
    },
    Row {
        name: "torque_limit_nm",
        unit: "N m",
        meaning: "Largest torque of the motor: what an action of 1 commands.",
        low: 0.05,
        high: 5.0,
        nominal: 0.5,
        read_from: "the compiled model's actuator gear",
        family: Some("drive"),
        set: |settings| &mut settings.torque_limit,
        read: |applied| applied.model.data().model().actuator_gear()[0][0],
    },
    Row {
        name: "gravity_scale",
        unit: "",
        meaning: "Gravity as a multiple of the Earth's.",
        low: 0.1,
        high: 3.0,
        nominal: 1.0,
        read_from: "the compiled model's gravity",
        family: None,
        set: |settings| &mut settings.gravity,
        read: |applied| -applied.model.data().model_opt().gravity[2] / GRAVITY,
    },
    Row {
        name: "start_rad",
        unit: "rad",
        meaning: "Angle of the pole at the start, from hanging.",
        low: -1.5,
        high: 1.5,
        nominal: 0.0,
        read_from: "the joint position after the reset",
        family: Some("start"),
        set: |settings| &mut settings.start,
        read: |applied| applied.model.data().qpos()[0],
    },
    Row {
        name: "angle_bias_rad",
        unit: "rad",
        meaning: "Bias of the encoder: reading minus true angle.",
        low: -0.5,
        high: 0.5,
        nominal: 0.0,
        read_from: "the encoder of the episode",
        family: Some("encoder"),
        set: |settings| &mut settings.bias,
        read: |applied| applied.bias,
    },
];

/// The parameters as declared by the task.
pub(super) fn specs() -> Vec<ParameterSpec> {
    let spec = |row: &Row| ParameterSpec {
        name: row.name.into(),
        unit: row.unit.to_owned(),
        meaning: row.meaning.to_owned(),
        allowed: Allowed::Continuous { low: row.low, high: row.high },
        nominal: Some(Value::Number(row.nominal)),
        read_from: row.read_from.to_owned(),
        family: row.family.map(Word::constant),
    };
    ROWS.iter().map(spec).collect()
}

impl Settings {
    /// The settings of a scenario. Parameters that it does not name are nominal.
    pub(super) fn of(requested: &Assignment) -> Result<Self, Fault> {
        let mut settings =
            Self { mass: 0.0, length: 0.0, damping: 0.0, torque_limit: 0.0, gravity: 0.0, start: 0.0, bias: 0.0 };
        for row in &ROWS {
            *(row.set)(&mut settings) = row.nominal;
        }
        for ((name, value), spec) in
            requested.iter().map(|pair| (pair, specs().into_iter().find(|spec| *spec.name == *pair.0)))
        {
            let setup = |why: String| Fault::new(FaultKind::Setup, why);
            let spec = spec.ok_or_else(|| setup(format!("the pendulum has no parameter `{name}`")))?;
            spec.accepts(value).map_err(setup)?;
            if let (Some(row), Some(x)) = (ROWS.iter().find(|row| row.name == name), requested.number(name)) {
                *(row.set)(&mut settings) = x;
            }
        }
        Ok(settings)
    }
}

/// The applied values of the requested parameters.
pub(super) fn applied(requested: &Assignment, of: &Applied<'_>) -> Assignment {
    let read = |name: &str| ROWS.iter().find(|row| row.name == name).map(|row| (row.read)(of));
    requested.iter().filter_map(|(name, _)| Some((name.into(), Value::Number(read(name)?)))).collect()
}
