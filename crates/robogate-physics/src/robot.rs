//! Robots: a folder with an MJCF or URDF model, and a `robot.toml` with settings that the model cannot express.

use std::borrow::Cow;
use std::fmt;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::robot_folder;
use robogate_core::budget::Budget;

/// A robot as read from its folder. An engine checks it against its model.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// The settings of `robot.toml`.
    pub settings: RobotSettings,
    /// Location of the model.
    pub source: RobotSource,
}

/// Location of a robot's model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RobotSource {
    /// Embedded in this binary. The MJCF refers to no other file.
    BuiltIn {
        /// Text of the MJCF.
        model: &'static str,
        /// Text of `robot.toml`.
        settings: &'static str,
    },
    /// In a folder. The model may refer to other files of the folder.
    Folder(PathBuf),
}

/// A file of a robot's folder: its path relative to the folder, and its bytes.
pub type RobotFile = (String, Cow<'static, [u8]>);

/// The content of `robot.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotSettings {
    /// The robot's name in commands and data.
    pub name: String,
    /// File name of the model, beside `robot.toml`.
    pub model: String,
    /// The arm.
    pub arm: Arm,
    /// The gripper.
    pub gripper: Gripper,
    /// Sites to add to the model: a URDF has none, and few models have one at the tool centre point.
    #[serde(rename = "site", default, skip_serializing_if = "Vec::is_empty")]
    pub sites: Vec<Site>,
}

/// A frame on a body, for use as `flange_site` or `tcp_site`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Site {
    /// The name. The model must not have a site of this name.
    pub name: String,
    /// The body that carries it: a `body` of an MJCF, a `link` of a URDF.
    pub body: String,
    /// The position in the body's frame, in metres.
    #[serde(default)]
    pub position_m: [f64; 3],
    /// The orientation in the body's frame, in radians: roll, pitch and yaw about the fixed x, y and z axes, as in URDF.
    #[serde(default)]
    pub rpy_rad: [f64; 3],
}

/// The arm. Arrays have one entry per joint, from base to tip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// Names of the arm's joints in the model.
    pub joints: Vec<String>,
    /// Joint positions at the start of an episode, in radians.
    pub home_rad: Vec<f64>,
    /// Largest joint speeds, in rad/s.
    pub velocity_limit_rad_s: Vec<f64>,
    /// Largest joint accelerations, in rad/s^2.
    pub acceleration_limit_rad_s2: Vec<f64>,
    /// Largest joint torques, in N m.
    pub torque_limit_nm: Vec<f64>,
    /// Stiffness of the joint servo, in N m/rad.
    pub stiffness_nm_rad: Vec<f64>,
    /// Damping of the joint servo, in N m s/rad.
    pub damping_nms_rad: Vec<f64>,
    /// The site at the flange.
    pub flange_site: String,
    /// The site at the tool centre point: z out of the tool, fingers along y.
    pub tcp_site: String,
    /// Published reach, in metres.
    pub reach_m: f64,
    /// Published payload, in kilograms.
    pub payload_kg: f64,
    /// Rotation of the model about the vertical axis through its origin, in radians, for a model that does not face the table at +x.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub base_yaw_rad: f64,
    /// Contact force at which the robot's own supervision stops it, in newtons. Tasks take it as the largest accepted force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub collision_force_n: Option<f64>,
}

fn is_zero(number: &f64) -> bool {
    *number == 0.0
}

/// The gripper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Gripper {
    /// Two fingers that close on an object. Give either `finger_joints` or `drive`.
    ParallelJaw(ParallelJaw),
    /// A suction cup.
    Suction(SuctionCup),
}

/// Two fingers that close on an object. Give either `finger_joints` or `drive`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ParallelJaw {
    /// The sliding joints of two fingers; 0 is closed. The opening is the sum of their positions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finger_joints: Option<[String; 2]>,
    /// The bodies that carry the pads. Bodies that are welded to them belong to the finger.
    pub finger_bodies: [String; 2],
    /// Opening between the pads when open, in metres.
    pub opening_m: f64,
    /// Speed of each finger, in m/s.
    pub finger_speed_m_s: f64,
    /// Normal force of each pad, in newtons.
    pub force_n: f64,
    /// Largest continuous force of the hand, in newtons.
    pub force_limit_n: f64,
    /// Stiffness of a finger's servo, in N/m.
    pub stiffness_n_m: f64,
    /// Damping of a finger's servo, in N s/m.
    pub damping_ns_m: f64,
    /// From the tool centre point to the fingertips, in metres.
    pub tip_m: f64,
    /// From the tool centre point back to the palm, in metres.
    pub palm_m: f64,
    /// From the tool centre point along the negative y axis to the inner face of a jaw that does not move, in metres. That jaw is on
    /// the first of `finger_bodies`, and a single drive moves the other one. Without it, both fingers move.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed_jaw_m: Option<f64>,
    /// The drives of all other fingers: rotary linkages, tendons, slides with another zero. The opening is the distance
    /// between the pads in the model. Only MuJoCo simulates them.
    #[serde(rename = "drive", default, skip_serializing_if = "Vec::is_empty")]
    pub drives: Vec<FingerDrive>,
}

/// A drive that moves fingers through the model's joints, equalities and tendons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FingerDrive {
    /// Name of the joint or tendon that the drive moves.
    pub moves: String,
    /// Position of that joint or tendon with the gripper open, in the model's unit: radians or metres.
    pub open: f64,
    /// Its position with the gripper closed.
    pub closed: f64,
}

impl ParallelJaw {
    /// The position of the middle of a part of this width (m) between the fingers, along the y axis of the tool, in metres. It is 0
    /// between two moving fingers. Before the grasp a jaw that does not move keeps a small distance from the part.
    pub fn beside_m(&self, width_m: f64) -> f64 {
        self.fixed_jaw_m.map_or(0.0, |fixed| 0.5 * width_m + FIXED_JAW_ROOM_M - fixed)
    }

    /// The joints of two sliding fingers; empty for fingers with drives.
    pub fn slides(&self) -> &[String] {
        self.finger_joints.as_ref().map_or(&[], |joints| &joints[..])
    }
}

/// A suction cup. Its lip is a circle around the tool centre point, perpendicular to the tool's z axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SuctionCup {
    /// The body that carries the cup.
    pub cup_body: String,
    /// Diameter of the lip, in metres.
    pub cup_diameter_m: f64,
    /// Pressure in the cup below the ambient pressure, in pascals.
    pub vacuum_pa: f64,
    /// The spring of the cup along its axis. Without it the cup is rigid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bellows: Option<Bellows>,
}

/// The spring of a suction cup along the tool's z axis: a bellows, or a plunger that carries the cup. It lets the lip move back
/// and is rigid in all other directions. The site of `arm.tcp_site` is the lip of the relaxed cup.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bellows {
    /// How far the lip can be pressed back, in metres. Beyond, the cup is rigid.
    pub stroke_m: f64,
    /// Stiffness, in N/m.
    pub stiffness_n_m: f64,
}

impl Bellows {
    /// Damping of the spring, in N s/m: critical for a cup of this mass (kg) without a part.
    pub(crate) fn damping_ns_m(&self, cup_kg: f64) -> f64 {
        2.0 * (self.stiffness_n_m * cup_kg).sqrt()
    }

    /// How far a force (N) presses the lip back, in metres.
    pub fn travel_m(&self, force_n: f64) -> f64 {
        (force_n / self.stiffness_n_m).clamp(0.0, self.stroke_m)
    }
}

/// Name of the joint of a cup's spring in models. Its position is 0 if the cup is relaxed and negative if it is pressed.
pub const BELLOWS_JOINT: &str = "robogate/bellows";

impl Gripper {
    /// The fingers, if the gripper has fingers.
    pub fn jaw(&self) -> Option<&ParallelJaw> {
        match self {
            Self::ParallelJaw(jaw) => Some(jaw),
            Self::Suction(_) => None,
        }
    }

    /// The suction cup, if the gripper has one.
    pub fn cup(&self) -> Option<&SuctionCup> {
        match self {
            Self::ParallelJaw(_) => None,
            Self::Suction(cup) => Some(cup),
        }
    }

    /// The kind of gripper as text with an article, for messages.
    pub fn description(&self) -> &'static str {
        match self {
            Self::ParallelJaw(jaw) if jaw.fixed_jaw_m.is_some() => "a jaw with one moving finger",
            Self::ParallelJaw(_) => "a parallel jaw",
            Self::Suction(_) => "a suction cup",
        }
    }

    /// All names of the model that the gripper refers to.
    fn names(&self) -> Vec<&String> {
        match self {
            Self::ParallelJaw(jaw) => {
                let drives = jaw.drives.iter().map(|drive| &drive.moves);
                jaw.slides().iter().chain(&jaw.finger_bodies).chain(drives).collect()
            }
            Self::Suction(cup) => vec![&cup.cup_body],
        }
    }

    /// The quantities with their keys. All must be positive.
    fn quantities(&self) -> Vec<(&'static str, f64)> {
        match self {
            Self::ParallelJaw(jaw) => vec![
                ("gripper.opening_m", jaw.opening_m),
                ("gripper.finger_speed_m_s", jaw.finger_speed_m_s),
                ("gripper.force_n", jaw.force_n),
                ("gripper.force_limit_n", jaw.force_limit_n),
                ("gripper.stiffness_n_m", jaw.stiffness_n_m),
                ("gripper.damping_ns_m", jaw.damping_ns_m),
                ("gripper.tip_m", jaw.tip_m),
                ("gripper.palm_m", jaw.palm_m),
            ],
            Self::Suction(cup) => {
                let cup_itself = [("gripper.cup_diameter_m", cup.cup_diameter_m), ("gripper.vacuum_pa", cup.vacuum_pa)];
                let spring = cup.bellows.iter().flat_map(|bellows| {
                    [
                        ("gripper.bellows.stroke_m", bellows.stroke_m),
                        ("gripper.bellows.stiffness_n_m", bellows.stiffness_n_m),
                    ]
                });
                cup_itself.into_iter().chain(spring).collect()
            }
        }
    }

    /// Describes a contradiction between the quantities.
    fn contradiction(&self) -> Option<String> {
        match self {
            Self::ParallelJaw(jaw) => jaw.contradiction(),
            Self::Suction(SuctionCup { vacuum_pa, .. }) => (*vacuum_pa > ATMOSPHERE_PA).then(|| {
                format!("gripper.vacuum_pa = {vacuum_pa} is more than the ambient pressure of {ATMOSPHERE_PA} Pa")
            }),
        }
    }
}

impl ParallelJaw {
    /// Describes a contradiction between the settings.
    fn contradiction(&self) -> Option<String> {
        let Self { force_n, force_limit_n, .. } = self;
        if let Some(fixed) = self.fixed_jaw_m
            && !(fixed.is_finite() && fixed > 0.0 && fixed < self.opening_m && self.drives.len() == 1)
        {
            return Some(format!(
                "gripper.fixed_jaw_m = {fixed}: a gripper with one moving jaw needs a distance above 0 and below opening_m, and one [[gripper.drive]]"
            ));
        }
        if force_n > force_limit_n {
            return Some(format!("gripper.force_n = {force_n} exceeds gripper.force_limit_n = {force_limit_n}"));
        }
        if self.finger_joints.is_some() != self.drives.is_empty() {
            return Some(
                "[gripper] needs either finger_joints (two slides whose zero is closed) or [[gripper.drive]] (all others)"
                    .to_owned(),
            );
        }
        self.drives.iter().find_map(|FingerDrive { moves, open, closed }| {
            let moved = open.is_finite() && closed.is_finite() && (open - closed).abs() > 1e-6;
            (!moved).then(|| format!("[[gripper.drive]] `{moves}`: open = {open} and closed = {closed} must differ"))
        })
    }
}

/// Distance between a jaw that does not move and the part before the grasp, in metres.
const FIXED_JAW_ROOM_M: f64 = 0.002;

/// A hinge of the arm without limits turns by at most this angle to each side, in radians. The controllers of continuous joints count
/// their turns too, and cables end them.
pub(crate) const CONTINUOUS_RAD: f64 = std::f64::consts::TAU;

/// Standard atmosphere, in pascals.
const ATMOSPHERE_PA: f64 = 101_325.0;

/// The robots in the binary: name, MJCF, `robot.toml`.
const BUILT_IN: [(&str, &str, &str); 4] = [
    (
        "franka",
        include_str!("../../../assets/robots/franka/franka.xml"),
        include_str!("../../../assets/robots/franka/robot.toml"),
    ),
    (
        "ur3e",
        include_str!("../../../assets/robots/ur3e/ur3e.xml"),
        include_str!("../../../assets/robots/ur3e/robot.toml"),
    ),
    (
        "ur5e",
        include_str!("../../../assets/robots/ur5e/ur5e.xml"),
        include_str!("../../../assets/robots/ur5e/robot.toml"),
    ),
    (
        "ur10e",
        include_str!("../../../assets/robots/ur10e/ur10e.xml"),
        include_str!("../../../assets/robots/ur10e/robot.toml"),
    ),
];

/// Names of the built-in robots.
pub fn built_in_robots() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, ..)| *name)
}

/// Whether `robot` is a folder. The name of a built-in robot never counts as one, even if such a folder exists.
pub fn is_folder(robot: &str) -> bool {
    Path::new(robot).is_dir() && !built_in_robots().any(|name| name == robot)
}

/// The built-in robot with this name.
pub fn built_in_robot(name: &str) -> Result<Robot, RobotError> {
    let Some((_, model, settings)) = BUILT_IN.iter().find(|(n, ..)| *n == name) else {
        let known = built_in_robots().collect::<Vec<_>>().join(", ");
        return Err(RobotError::Unknown { name: name.to_owned(), known });
    };
    let parsed = RobotSettings::from_toml(settings, Path::new("robot.toml"))?;
    Ok(Robot { settings: parsed, source: RobotSource::BuiltIn { model, settings } })
}

impl Robot {
    /// Reads a robot from its folder.
    pub fn from_folder(folder: &Path) -> Result<Self, RobotError> {
        let (robot, problems) = Self::read(folder)?;
        if problems.is_empty() {
            Ok(robot)
        } else {
            Err(RobotError::Invalid { path: folder.join("robot.toml"), problems })
        }
    }

    /// Reads a robot together with all problems of its settings.
    pub(crate) fn read(folder: &Path) -> Result<(Self, Vec<Problem>), RobotError> {
        let file = folder.join("robot.toml");
        let text = robot_folder::text(&file)?;
        let settings = RobotSettings::parse(&text, &file)?;
        robot_folder::check(folder, &settings.model)?;
        let mut problems = settings.problems();
        if problems.is_empty() && !folder.join(&settings.model).is_file() {
            problems.push(Problem::new(
                format!("model = \"{}\": the file does not exist beside robot.toml", settings.model),
                "put the MJCF or URDF into the robot's folder and give its file name here",
            ));
        }
        Ok((Self { settings, source: RobotSource::Folder(folder.to_owned()) }, problems))
    }

    /// The robot's name.
    pub fn name(&self) -> &str {
        &self.settings.name
    }

    /// The files that define the robot, in a fixed order: its settings, its model, and all that these name. The robot's hash in the provenance is computed over them.
    pub fn files(&self) -> Result<Vec<RobotFile>, RobotError> {
        match &self.source {
            RobotSource::BuiltIn { model, settings } => Ok(vec![
                (self.settings.model.clone(), Cow::Borrowed(model.as_bytes())),
                ("robot.toml".to_owned(), Cow::Borrowed(settings.as_bytes())),
            ]),
            RobotSource::Folder(folder) => robot_folder::files(folder, &self.settings.model),
        }
    }
}

impl RobotSettings {
    /// Parses and checks the text of a `robot.toml`; `path` is for messages.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, RobotError> {
        let settings = Self::parse(text, path)?;
        let problems = settings.problems();
        if problems.is_empty() { Ok(settings) } else { Err(RobotError::Invalid { path: path.to_owned(), problems }) }
    }

    fn parse(text: &str, path: &Path) -> Result<Self, RobotError> {
        Budget::FILE.toml(text).map_err(|e| RobotError::Invalid {
            path: path.to_owned(),
            problems: vec![Problem::new(
                e.to_string().trim_end(),
                "see docs/guides/robots.md and schemas/robot.schema.json for the keys",
            )],
        })
    }

    /// All problems of the settings alone.
    fn problems(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut problem = |what: String, hint: &str| problems.push(Problem::new(what, hint));
        if Path::new(&self.model).components().count() != 1 || self.model.starts_with('.') {
            problem(
                format!("model = {:?} is not the name of a file in the robot's folder", self.model),
                "put the model beside robot.toml and give only its file name",
            );
        }
        let arm = &self.arm;
        if arm.joints.is_empty() {
            problem("arm.joints is empty".to_owned(), "list every joint of the arm, base to tip");
        }
        let sites = [&arm.flange_site, &arm.tcp_site];
        let added = self.sites.iter().flat_map(|site| [&site.name, &site.body]);
        for name in arm.joints.iter().chain(sites).chain(added).chain(self.gripper.names()) {
            if name.is_empty() || name.contains('\0') {
                problem(format!("{name:?} is not a valid name in a model"), "give a name from the model");
            }
        }
        for (key, values, positive) in [
            ("home_rad", &arm.home_rad, false),
            ("velocity_limit_rad_s", &arm.velocity_limit_rad_s, true),
            ("acceleration_limit_rad_s2", &arm.acceleration_limit_rad_s2, true),
            ("torque_limit_nm", &arm.torque_limit_nm, true),
            ("stiffness_nm_rad", &arm.stiffness_nm_rad, true),
            ("damping_nms_rad", &arm.damping_nms_rad, true),
        ] {
            if values.len() != arm.joints.len() {
                let (got, want) = (values.len(), arm.joints.len());
                problem(
                    format!("arm.{key} has {got} entries, arm.joints has {want}"),
                    "give one entry for each joint, in the order of arm.joints",
                );
            }
            // No arm has a value below 0.001. A smaller value indicates wrong units.
            if let Some(bad) = values.iter().find(|v| !v.is_finite() || (positive && **v < 1e-3)) {
                let wanted = if positive { "a number of at least 0.001" } else { "a finite number" };
                problem(
                    format!("arm.{key} contains {bad}. Expected {wanted}"),
                    "the key ends with its unit: rad, s, N m",
                );
            }
        }
        if !self.arm.base_yaw_rad.is_finite() {
            problem("arm.base_yaw_rad is not finite".to_owned(), "give the rotation in radians");
        }
        for site in &self.sites {
            if site.position_m.iter().chain(&site.rpy_rad).any(|x| !x.is_finite()) {
                problem(format!("the pose of site `{}` is not finite", site.name), "give metres and radians");
            }
        }
        let force_n = arm.collision_force_n.unwrap_or(1.0);
        let arm =
            [("arm.reach_m", arm.reach_m), ("arm.payload_kg", arm.payload_kg), ("arm.collision_force_n", force_n)];
        for (key, value) in arm.into_iter().chain(self.gripper.quantities()) {
            if !value.is_finite() || value <= 0.0 {
                problem(
                    format!("{key} = {value} is out of range. Expected a positive number"),
                    "the key ends with its unit",
                );
            }
        }
        if let Some(why) = self.gripper.contradiction() {
            problem(why, "see docs/guides/robots.md and the gripper's data sheet");
        }
        problems
    }
}

/// A problem of a robot, with a hint.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// The problem and the affected input.
    pub what: String,
    /// The hint.
    pub hint: String,
}

impl Problem {
    /// Creates a problem with its hint.
    pub fn new(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { what: what.into(), hint: hint.into() }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}\nHint: {}", self.what, self.hint)
    }
}

/// What is wrong with a text file in another encoding.
pub(crate) const NOT_UTF_8: &str = "not UTF-8 text. Convert it, for example with `iconv -t utf-8`";

/// The reason why a robot cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RobotError {
    /// The physics engine cannot be used.
    #[error("{why}")]
    Engine {
        /// The reason, with a hint.
        why: String,
    },
    /// No such built-in robot.
    #[error("unknown robot `{name}`. Expected a built-in robot ({known}) or the folder of a robot")]
    Unknown {
        /// The requested name.
        name: String,
        /// The built-in robots.
        known: String,
    },
    /// A file cannot be read.
    #[error("{}: {why}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason.
        why: String,
    },
    /// A text file has another encoding.
    #[error("{}: {NOT_UTF_8}", path.display())]
    Encoding {
        /// The file.
        path: PathBuf,
    },
    /// A file has invalid content.
    #[error("{}: {}", path.display(), problems.iter().map(Problem::to_string).collect::<Vec<_>>().join("\n"))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// All problems.
        problems: Vec<Problem>,
    },
}
