//! The file of a task, as it is written: keys and texts, without meaning.

use std::borrow::Cow;
use std::collections::BTreeMap;

use robogate_core::{Better, Severity};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer};
use toml::Spanned;

/// A text of the file, and where it stands.
#[derive(Debug, Clone, Default)]
pub(super) struct Text {
    pub(super) text: String,
    /// Its first byte in the file.
    pub(super) at: usize,
}

impl<'de> Deserialize<'de> for Text {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let spanned = Spanned::<toml::Value>::deserialize(deserializer)?;
        let at = spanned.span().start;
        Self::new(spanned.into_inner(), at)
    }
}

impl Text {
    fn new<E: serde::de::Error>(value: toml::Value, at: usize) -> Result<Self, E> {
        match value {
            toml::Value::String(text) => Ok(Self { text, at }),
            number @ (toml::Value::Integer(_) | toml::Value::Float(_)) => Ok(Self { text: number.to_string(), at }),
            other => {
                let found = other.type_str();
                Err(E::custom(format!("found {found}. Expected a text in quotes or a number")))
            }
        }
    }
}

impl JsonSchema for Text {
    fn schema_name() -> Cow<'static, str> {
        "Text".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": ["string", "number"],
            "description": "A number, numbers with a unit such as `40, 30, 2 cm`, a name, or an expression."
        })
    }
}

/// One text, or a list of them.
#[derive(Debug)]
pub(super) struct Texts(pub(super) Vec<Text>);

impl<'de> Deserialize<'de> for Texts {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let spanned = Spanned::<toml::Value>::deserialize(deserializer)?;
        let at = spanned.span().start;
        match spanned.into_inner() {
            toml::Value::Array(values) => values.into_iter().map(|value| Text::new(value, at)).collect(),
            value => Text::new(value, at).map(|text| vec![text]),
        }
        .map(Self)
    }
}

impl JsonSchema for Texts {
    fn schema_name() -> Cow<'static, str> {
        "Texts".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": ["string", "array"], "items": { "type": "string" } })
    }
}

/// A task for an arm in the cell, as a file.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Document {
    /// The format: `robogate-task/1`.
    pub(super) format: Text,
    /// The name of the task: lower-case letters, digits and `_`.
    pub(super) name: Text,
    /// The version. Increase it when success, a failure or a measure changes its meaning.
    #[serde(default = "one")]
    pub(super) version: u32,
    /// A short description.
    #[serde(default)]
    pub(super) summary: String,
    /// The task in natural language. `{name}` is replaced by the value of a parameter.
    pub(super) instruction: Text,
    /// Time limit of an episode.
    pub(super) time_limit: Text,
    /// Properties of the whole scene.
    #[serde(default)]
    pub(super) scene: SceneTable,
    /// Bodies that stand still or move by a law. The table is always there: its top is the plane z = 0.
    #[serde(default)]
    pub(super) fixture: Vec<FixtureTable>,
    /// Bodies that move freely or on a joint. At least one, here or in an MJCF file.
    #[serde(default)]
    pub(super) part: Vec<PartTable>,
    /// Fixtures and parts from MJCF files beside this one.
    #[serde(default)]
    pub(super) mjcf: Vec<FragmentTable>,
    /// Boxes in space, for starts and conditions.
    #[serde(default)]
    pub(super) region: Vec<RegionTable>,
    /// What varies between episodes.
    #[serde(default)]
    pub(super) parameter: Vec<ParameterTable>,
    /// A parameter that is a word: which parts have which roles.
    pub(super) choice: Option<ChoiceTable>,
    /// Numbers of the task that a user can set with `--set`, the same in all episodes.
    #[serde(default)]
    pub(super) setting: Vec<SettingTable>,
    /// Numbers of bodies that follow from parameters.
    #[serde(default)]
    pub(super) set: Vec<SetTable>,
    /// The built-in parameter space that campaigns sample. Default: the whole range of every parameter of the file.
    pub(super) space: Option<Text>,
    /// Conditions with a name, which other conditions below them can contain.
    #[serde(default)]
    pub(super) condition: Vec<ConditionTable>,
    /// What is known about an episode before it runs: draws, and features for the risk model. The name of one that the program
    /// has: `stack` knows how the expert stacks cubes.
    pub(super) foresight: Option<Text>,
    /// The built-in suite of the task, if it has one.
    pub(super) suite: Option<Text>,
    /// When the task is done.
    pub(super) success: SuccessTable,
    /// Failures. The first one that holds ends the episode.
    #[serde(default)]
    pub(super) failure: Vec<FailureTable>,
    /// Stages in their order, for partial progress.
    #[serde(default)]
    pub(super) stage: Vec<StageTable>,
    /// Numbers that are recorded for each episode.
    #[serde(default)]
    pub(super) measure: Vec<MeasureTable>,
    /// A script that solves the task: the positive control.
    pub(super) expert: Option<ExpertTable>,
}

fn one() -> u32 {
    1
}

/// Properties of the whole scene.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneTable {
    /// Coulomb friction coefficient of the parts that state none, against everything. Default: 0.7.
    pub(super) friction: Option<Text>,
    /// Gravity. Default: 9.81 m/s^2.
    pub(super) gravity: Option<Text>,
    /// Whether an arm with less than 0.6 m of reach works on a smaller layout: the positions x and y of fixtures and of parts
    /// in the frame of the robot's base are multiplied by 0.7. Default: no.
    #[serde(default)]
    pub(super) fit_reach: bool,
}

/// Fixtures and parts from an MJCF file beside this one: bodies without a joint become fixtures, bodies with one become parts.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct FragmentTable {
    /// The file: `cabinet.xml`.
    pub(super) file: Text,
    /// The name in front of the names of its bodies and sites: `cabinet` makes the body `drawer` `cabinet_drawer`. The only body at
    /// the top has this name itself. Default: bodies have the names of the file.
    pub(super) name: Option<Text>,
    /// Where the origin of the file is in the frame of the robot's base. Default: 0.
    pub(super) at: Option<Text>,
    /// Roll, pitch and yaw about the fixed axes. Default: 0.
    pub(super) rotation: Option<Text>,
    /// Joints of the file that do not move here: `latch, knob`.
    pub(super) weld: Option<Text>,
    /// Whether bodies at the top without joints move freely. Default: no.
    #[serde(default)]
    pub(super) free: bool,
    /// The largest number of convex pieces of its meshes. Default: 1, the convex hull, as in MuJoCo.
    pub(super) pieces: Option<Text>,
}

/// A body that stands still or moves by a law.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct FixtureTable {
    pub(super) name: Text,
    /// Position in the frame of the robot's base: x, y, z. Default: 0.
    pub(super) at: Option<Text>,
    /// Roll, pitch and yaw about the fixed axes. Default: 0.
    pub(super) rotation: Option<Text>,
    /// The shapes. Without any, the table adds keys to a fixture of an MJCF file.
    #[serde(default)]
    pub(super) shapes: Vec<ShapeTable>,
    /// Coulomb friction coefficient. A contact has the larger one of its two bodies. Default: that of the part.
    pub(super) friction: Option<Text>,
    /// Colour in images, as `#rrggbb`.
    pub(super) color: Option<Text>,
    /// A conveyor: direction and speed of its surface, which carries the parts on it: `x, 10 cm/s`. The direction is in
    /// the frame of the fixture: x, y, z, -x, -y or -z.
    pub(super) belt: Option<Text>,
    /// Back and forth: direction, distance and largest speed, `y, 20 cm, 5 cm/s`. It starts at rest at `at`.
    pub(super) shuttle: Option<Text>,
    /// A turn about an axis through its origin: direction and speed, `z, 20 deg/s`.
    pub(super) turn: Option<Text>,
    /// Whether the robot may touch it. Otherwise a contact is the failure `collision`. Default: no.
    #[serde(default)]
    pub(super) touch: bool,
}

/// A shape of a body. Exactly one of box, cylinder, capsule, sphere and mesh.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ShapeTable {
    /// The three edges.
    #[serde(rename = "box")]
    pub(super) cuboid: Option<Text>,
    /// Diameter and height; the axis is z.
    pub(super) cylinder: Option<Text>,
    /// Diameter, and length between the centres of its round ends; the axis is z.
    pub(super) capsule: Option<Text>,
    /// Diameter.
    pub(super) sphere: Option<Text>,
    /// A file beside this one, STL or OBJ: a closed surface. Contacts act on convex pieces of it, images show the mesh itself.
    pub(super) mesh: Option<Text>,
    /// The unit of a mesh's file: m, cm or mm. Default: m.
    pub(super) unit: Option<Text>,
    /// By how much a mesh is larger than its file: one factor, or those along x, y and z. Default: 1.
    pub(super) scale: Option<Text>,
    /// The largest number of convex pieces of a mesh: 1 is its convex hull. Default: 16.
    pub(super) pieces: Option<Text>,
    /// Position of its centre, or of the origin of a mesh, in the frame of the body. Default: 0.
    pub(super) at: Option<Text>,
    /// Roll, pitch and yaw in the frame of the body. Default: 0.
    pub(super) rotation: Option<Text>,
    /// Mass of this shape of a part, if its shapes differ in density. Either this or the density.
    pub(super) mass: Option<Text>,
    /// Density of this shape of a part.
    pub(super) density: Option<Text>,
}

/// A body that moves freely or on a joint.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PartTable {
    pub(super) name: Text,
    /// Mass. Either this or the density, or those of its shapes.
    pub(super) mass: Option<Text>,
    /// Density, from which the mass follows: `2.7 g/cm^3`.
    pub(super) density: Option<Text>,
    /// Centre of mass in its frame, if the inertia is stated. Default: 0.
    pub(super) centre: Option<Text>,
    /// Inertia about the centre of mass: xx, yy, zz, xy, xz, yz. Default: that of shapes with equal density.
    pub(super) inertia: Option<Text>,
    /// Coulomb friction coefficient against everything. Default: that of the scene.
    pub(super) friction: Option<Text>,
    /// The fixture whose frame `at` and `rotation` refer to. Default: the robot's base.
    #[serde(rename = "in")]
    pub(super) parent: Option<Text>,
    /// Position of its frame at the start, or where its joint has the value 0. Default: 0.
    pub(super) at: Option<Text>,
    /// Roll, pitch and yaw at the start. Default: 0.
    pub(super) rotation: Option<Text>,
    /// Radius of the disc from which the offset of its start is drawn. Default: 0.
    pub(super) spread: Option<Text>,
    /// Largest rotation about the vertical at the start, in both directions. Default: 0.
    pub(super) spin: Option<Text>,
    /// A region over whose area its start is drawn evenly. The policy is told where it is.
    pub(super) start: Option<Text>,
    /// The shapes, of equal density if they state none. Without any, the table adds keys to a part of an MJCF file.
    #[serde(default)]
    pub(super) shapes: Vec<ShapeTable>,
    /// Named points in its frame.
    #[serde(default)]
    pub(super) points: BTreeMap<String, PointTable>,
    /// The joint that holds it. Without one it moves freely.
    pub(super) joint: Option<JointTable>,
    /// Colour in images, as `#rrggbb`.
    pub(super) color: Option<Text>,
}

/// A named point of a part.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PointTable {
    /// Position in the frame of the part.
    pub(super) at: Text,
    /// Direction about the vertical in which fingers close there, from the x axis of the part. Default: 0.
    pub(super) close: Option<Text>,
}

/// The joint of a part. Quantities of a slide are in m and N, those of a hinge and a screw in rad and N m.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct JointTable {
    pub(super) kind: JointWord,
    /// Direction in the frame of the part: x, y, z, -x, -y, -z, or three numbers.
    pub(super) axis: Text,
    /// A point of a hinge's axis in the frame of the part. Default: 0.
    pub(super) anchor: Option<Text>,
    /// Values of the two stops: `0, 25 cm`.
    pub(super) range: Text,
    /// Value at the start. Default: 0.
    pub(super) start: Option<Text>,
    /// Force per speed against the motion. Default: 0.
    pub(super) damping: Option<Text>,
    /// Dry friction. Default: 0.
    pub(super) friction: Option<Text>,
    /// Stiffness of a spring. Default: 0.
    pub(super) stiffness: Option<Text>,
    /// Value at which the spring has no force. Default: 0.
    pub(super) rest: Option<Text>,
    /// How far a screw moves along its axis in one turn.
    pub(super) pitch: Option<Text>,
    /// What the thread of a screw takes up: a part that moves freely, or a point of one. It takes the part up at its lower stop
    /// when the point is at its origin, the axes are parallel, and the part turns in its direction. Then both move as one body until the
    /// screw is turned back.
    pub(super) takes: Option<Text>,
    /// How far that point may be from the origin. Default: 1 mm.
    pub(super) within: Option<Text>,
    /// How much the axes may lean. Default: 5 deg.
    pub(super) lean: Option<Text>,
}

/// The kind of a joint.
#[derive(Debug, Clone, Copy, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum JointWord {
    Hinge,
    Slide,
    Screw,
}

/// A box in space.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct RegionTable {
    pub(super) name: Text,
    /// The fixture or part that it moves with. Default: the robot's base.
    #[serde(rename = "in")]
    pub(super) parent: Option<Text>,
    /// Position of its centre. Default: 0.
    pub(super) at: Option<Text>,
    /// The three edges.
    pub(super) size: Text,
}

/// What varies between episodes.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ParameterTable {
    /// The name, which ends with the SI unit: `drawer_mass_kg`.
    pub(super) name: Text,
    /// What it sets: `drawer.mass`, `drawer.at.y`, `drawer.joint.damping`. Without it, it is a number for the
    /// instruction, the conditions and the expert.
    pub(super) sets: Option<Text>,
    /// Smallest and largest value: `0.5, 4 kg`.
    pub(super) range: Text,
    /// The nominal value. Default for one that sets something: the value in the file.
    pub(super) nominal: Option<Text>,
    /// The meaning, in one sentence.
    #[serde(default)]
    pub(super) meaning: String,
    /// The family of perturbations that it belongs to.
    pub(super) family: Option<Text>,
    /// Whether the policy is told its value. Default: only if it sets nothing.
    pub(super) told: Option<bool>,
}

/// A parameter that is a word: which parts have which roles. Conditions, skills and `[[set]]` can name a role instead of a part.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ChoiceTable {
    /// The name of the parameter.
    pub(super) name: Text,
    /// The roles: `bottom, middle, top`.
    pub(super) roles: Text,
    /// For each word the parts that have the roles: `abc = "a, b, c"`. The policy is told the word.
    pub(super) words: BTreeMap<String, Text>,
    /// The nominal word.
    pub(super) nominal: Text,
    /// The meaning, in one sentence.
    #[serde(default)]
    pub(super) meaning: String,
    /// The family of perturbations that it belongs to.
    pub(super) family: Option<Text>,
}

/// A number of the task that a user can set with `--set`. Conditions and skills contain it like a parameter: `{tolerance_m}`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SettingTable {
    /// The name, which ends with the SI unit: `tolerance_m`.
    pub(super) name: Text,
    /// Smallest and largest value: `0.1, 50 mm`.
    pub(super) range: Text,
    pub(super) default: Text,
    /// The meaning, in one sentence.
    #[serde(default)]
    pub(super) meaning: String,
}

/// Numbers of bodies that follow from parameters.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SetTable {
    /// What it sets, with commas between: `left.mass, right.mass`.
    pub(super) numbers: Text,
    /// The value: `2 * {mass_kg}`.
    pub(super) to: Text,
}

/// A condition with a name.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ConditionTable {
    pub(super) name: Text,
    pub(super) when: Text,
}

/// When the task is done.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SuccessTable {
    pub(super) when: Text,
    /// Parts that every policy must grasp and carry: `lid, box`. A scenario in which the robot cannot is not feasible.
    pub(super) carried: Option<Text>,
}

/// A failure.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct FailureTable {
    pub(super) name: Text,
    pub(super) when: Text,
    /// Whether it does not end the episode, but names the failure of an episode that reaches the time limit. Default: no.
    #[serde(default)]
    pub(super) at_limit: bool,
    #[serde(default)]
    pub(super) severity: Severity,
    /// What happened, in one sentence.
    #[serde(default)]
    pub(super) meaning: String,
}

/// A stage.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct StageTable {
    pub(super) name: Text,
    pub(super) when: Text,
}

/// A number that is recorded for each episode.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct MeasureTable {
    /// The name, which ends with the SI unit: `pull_n`.
    pub(super) name: Text,
    /// `max VALUE`, `min VALUE`, `final VALUE`, or `first CONDITION` for the time at which it first held. A value counts in all
    /// steps, or with `when CONDITION` after it in those in which the condition holds. A list of several texts is one measure.
    pub(super) value: Texts,
    #[serde(default)]
    pub(super) better: Better,
    /// The meaning, in one sentence.
    #[serde(default)]
    pub(super) meaning: String,
}

/// A script that solves the task.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ExpertTable {
    /// The skills, one after another.
    #[serde(rename = "do")]
    pub(super) skills: Vec<Text>,
}
