//! A robot is a folder: an MJCF model and a `robot.toml` that says what MJCF cannot.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::{fmt, fs};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A robot's description as read, not yet held against its model (an engine does that).
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// The settings of `robot.toml`.
    pub settings: RobotSettings,
    /// Where the model lies.
    pub source: RobotSource,
}

/// Where a robot's model lies.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RobotSource {
    /// In this binary: the text of the MJCF, which refers to no other file.
    BuiltIn {
        /// The MJCF text.
        model: &'static str,
        /// The text of `robot.toml`.
        settings: &'static str,
    },
    /// In a folder; a model may refer to files beside it.
    Folder(PathBuf),
}

/// A file of a robot's folder: its name below the folder, and its bytes.
pub type RobotFile = (String, Cow<'static, [u8]>);

/// The content of `robot.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotSettings {
    /// The robot's name in commands and data.
    pub name: String,
    /// The model's file name, beside `robot.toml`.
    pub model: String,
    /// The arm.
    pub arm: Arm,
    /// The gripper.
    pub gripper: Gripper,
    /// Sites that the model lacks: a URDF has none, and few models have one at the tool centre point.
    #[serde(rename = "site", default, skip_serializing_if = "Vec::is_empty")]
    pub sites: Vec<Site>,
}

/// A frame on a body, to be named as `flange_site` or `tcp_site`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Site {
    /// Its name, one that the model does not have.
    pub name: String,
    /// The body on which it is: an MJCF's `body`, a URDF's `link`.
    pub body: String,
    /// Its position in the body's frame, in metres.
    #[serde(default)]
    pub position_m: [f64; 3],
    /// Its turn in the body's frame: roll, pitch and yaw about the fixed x, y and z, as URDF has it, in radians.
    #[serde(default)]
    pub rpy_rad: [f64; 3],
}

/// The arm. Arrays have one entry per joint, base to tip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// The arm's joints by their names in the model.
    pub joints: Vec<String>,
    /// Where the arm waits, in radians.
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
}

/// The gripper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Gripper {
    /// Two fingers that slide against each other.
    ParallelJaw(ParallelJaw),
    /// A suction cup.
    Suction(SuctionCup),
}

/// Two fingers that slide against each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ParallelJaw {
    /// The fingers' sliding joints; 0 is closed.
    pub finger_joints: [String; 2],
    /// The bodies that carry the pads.
    pub finger_bodies: [String; 2],
    /// Opening between the pads when open, in metres.
    pub opening_m: f64,
    /// Speed of each finger, in m/s.
    pub finger_speed_m_s: f64,
    /// Normal force of each pad, in newtons.
    pub force_n: f64,
    /// What the hand can hold for long, in newtons.
    pub force_limit_n: f64,
    /// Stiffness of a finger's servo, in N/m.
    pub stiffness_n_m: f64,
    /// Damping of a finger's servo, in N s/m.
    pub damping_ns_m: f64,
    /// From the tool centre point to the fingertips, in metres.
    pub tip_m: f64,
    /// From the tool centre point back to the palm, in metres.
    pub palm_m: f64,
}

/// A suction cup: its lip is a circle about the tool centre point, across the tool's z axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SuctionCup {
    /// The body that carries the cup.
    pub cup_body: String,
    /// Diameter of the lip, in metres.
    pub cup_diameter_m: f64,
    /// How far the pump brings the pressure in the cup below that around it, in pascals.
    pub vacuum_pa: f64,
}

impl Gripper {
    /// The fingers, of a gripper that has some.
    pub fn jaw(&self) -> Option<&ParallelJaw> {
        match self {
            Self::ParallelJaw(jaw) => Some(jaw),
            Self::Suction(_) => None,
        }
    }

    /// The cup, of a gripper that has one.
    pub fn cup(&self) -> Option<&SuctionCup> {
        match self {
            Self::ParallelJaw(_) => None,
            Self::Suction(cup) => Some(cup),
        }
    }

    /// Its kind as text with an article, for messages.
    pub fn description(&self) -> &'static str {
        match self {
            Self::ParallelJaw(_) => "a parallel jaw",
            Self::Suction(_) => "a suction cup",
        }
    }

    /// The names by which it refers to the model.
    fn names(&self) -> Vec<&String> {
        match self {
            Self::ParallelJaw(jaw) => jaw.finger_joints.iter().chain(&jaw.finger_bodies).collect(),
            Self::Suction(cup) => vec![&cup.cup_body],
        }
    }

    /// Its quantities, which are positive, by their keys.
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
                vec![("gripper.cup_diameter_m", cup.cup_diameter_m), ("gripper.vacuum_pa", cup.vacuum_pa)]
            }
        }
    }

    /// What is wrong with quantities that are positive each.
    fn contradiction(&self) -> Option<String> {
        match self {
            Self::ParallelJaw(ParallelJaw { force_n, force_limit_n, .. }) => (force_n > force_limit_n)
                .then(|| format!("gripper.force_n = {force_n} exceeds gripper.force_limit_n = {force_limit_n}")),
            Self::Suction(SuctionCup { vacuum_pa, .. }) => (*vacuum_pa > ATMOSPHERE_PA).then(|| {
                format!("gripper.vacuum_pa = {vacuum_pa}: no pump goes further than {ATMOSPHERE_PA} Pa below the air")
            }),
        }
    }
}

/// Standard atmosphere, in pascals.
const ATMOSPHERE_PA: f64 = 101_325.0;

/// Every robot in the binary: name, MJCF, `robot.toml`.
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

/// The names of the robots that come with RoboGate.
pub fn built_in_robots() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, ..)| *name)
}

/// Whether a robot is named by its folder: a built-in one's name is that robot, whatever folders lie about.
pub fn is_folder(robot: &str) -> bool {
    Path::new(robot).is_dir() && !built_in_robots().any(|name| name == robot)
}

/// The built-in robot of that name.
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

    /// Reads a robot that may have something wrong in its settings, and what that is.
    pub(crate) fn read(folder: &Path) -> Result<(Self, Vec<Problem>), RobotError> {
        let file = folder.join("robot.toml");
        let text =
            fs::read_to_string(&file).map_err(|e| RobotError::Read { path: file.clone(), why: e.to_string() })?;
        let settings = RobotSettings::parse(&text, &file)?;
        let mut problems = settings.problems();
        if problems.is_empty() && !folder.join(&settings.model).is_file() {
            problems.push(Problem::new(
                format!("model = \"{}\": there is no such file beside robot.toml", settings.model),
                "put the MJCF or URDF into the robot's folder and name it here",
            ));
        }
        Ok((Self { settings, source: RobotSource::Folder(folder.to_owned()) }, problems))
    }

    /// The robot's name.
    pub fn name(&self) -> &str {
        &self.settings.name
    }

    /// The bytes that define the robot, file by file with their names, in a fixed order: what its
    /// hash in the provenance is taken over.
    pub fn files(&self) -> Result<Vec<RobotFile>, RobotError> {
        match &self.source {
            RobotSource::BuiltIn { model, settings } => Ok(vec![
                (self.settings.model.clone(), Cow::Borrowed(model.as_bytes())),
                ("robot.toml".to_owned(), Cow::Borrowed(settings.as_bytes())),
            ]),
            RobotSource::Folder(folder) => {
                let mut files = Vec::new();
                collect_files(folder, "", &mut files)?;
                files.sort_by(|(a, _), (b, _)| a.cmp(b));
                Ok(files)
            }
        }
    }
}

fn collect_files(folder: &Path, prefix: &str, files: &mut Vec<RobotFile>) -> Result<(), RobotError> {
    let read = |e: std::io::Error, path: &Path| RobotError::Read { path: path.to_owned(), why: e.to_string() };
    for entry in fs::read_dir(folder).map_err(|e| read(e, folder))? {
        let path = entry.map_err(|e| read(e, folder))?.path();
        let name = format!("{prefix}{}", path.file_name().unwrap_or_default().to_string_lossy());
        if path.is_dir() {
            collect_files(&path, &format!("{name}/"), files)?;
        } else {
            files.push((name, Cow::Owned(fs::read(&path).map_err(|e| read(e, &path))?)));
        }
    }
    Ok(())
}

impl RobotSettings {
    /// Parses and checks the text of a `robot.toml`; `path` is for messages.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, RobotError> {
        let settings = Self::parse(text, path)?;
        let problems = settings.problems();
        if problems.is_empty() { Ok(settings) } else { Err(RobotError::Invalid { path: path.to_owned(), problems }) }
    }

    fn parse(text: &str, path: &Path) -> Result<Self, RobotError> {
        toml::from_str(text).map_err(|e| RobotError::Invalid {
            path: path.to_owned(),
            problems: vec![Problem::new(
                e.to_string().trim_end(),
                "docs/robots.md and schemas/robot.schema.json say which keys there are",
            )],
        })
    }

    /// All that is wrong with the settings alone.
    fn problems(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut problem = |what: String, hint: &str| problems.push(Problem::new(what, hint));
        if Path::new(&self.model).components().count() != 1 || self.model.starts_with('.') {
            problem(
                format!("model = {:?} is not the name of a file in the robot's folder", self.model),
                "put the model beside robot.toml and give its name alone",
            );
        }
        let arm = &self.arm;
        if arm.joints.is_empty() {
            problem("arm.joints is empty".to_owned(), "name every joint of the arm, base to tip");
        }
        let sites = [&arm.flange_site, &arm.tcp_site];
        let added = self.sites.iter().flat_map(|site| [&site.name, &site.body]);
        for name in arm.joints.iter().chain(sites).chain(added).chain(self.gripper.names()) {
            if name.is_empty() || name.contains('\0') {
                problem(format!("{name:?} can be no name in a model"), "give the name that the model has");
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
                    "give one for each joint, in the order of arm.joints",
                );
            }
            // Below a thousandth there is no arm: such a value is a slip of units.
            if let Some(bad) = values.iter().find(|v| !v.is_finite() || (positive && **v < 1e-3)) {
                let wanted = if positive { "a number of at least 0.001" } else { "a finite number" };
                problem(
                    format!("arm.{key} holds {bad}, which is not {wanted}"),
                    "the key's last words are its unit: rad, s, N m",
                );
            }
        }
        for site in &self.sites {
            if site.position_m.iter().chain(&site.rpy_rad).any(|x| !x.is_finite()) {
                problem(format!("site `{}` stands at no finite pose", site.name), "give metres and radians");
            }
        }
        let arm = [("arm.reach_m", arm.reach_m), ("arm.payload_kg", arm.payload_kg)];
        for (key, value) in arm.into_iter().chain(self.gripper.quantities()) {
            if !value.is_finite() || value <= 0.0 {
                problem(format!("{key} = {value} is not a positive number"), "the key's last letters are its unit");
            }
        }
        if let Some(why) = self.gripper.contradiction() {
            problem(why, "see the gripper's data sheet");
        }
        problems
    }
}

/// Something that is wrong with a robot, and what to do about it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// What is wrong, and where.
    pub what: String,
    /// What to do about it.
    pub hint: String,
}

impl Problem {
    /// A problem with its remedy.
    pub(crate) fn new(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { what: what.into(), hint: hint.into() }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}\n  hint: {}", self.what, self.hint)
    }
}

/// Why a robot cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RobotError {
    /// No such built-in robot.
    #[error("there is no robot `{name}`; built in: {known}; a robot of your own is named by its folder")]
    Unknown {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A file cannot be read.
    #[error("{}: {why}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's words.
        why: String,
    },
    /// A file says something that cannot be.
    #[error("{}: {}", path.display(), problems.iter().map(Problem::to_string).collect::<Vec<_>>().join("\n"))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong, all of it.
        problems: Vec<Problem>,
    },
}
