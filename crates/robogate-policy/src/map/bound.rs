//! A map that is bound to an environment and a profile.

use robogate_core::{
    Action, ActionSpace, ActionSpec, CameraSpec, Command, Fault, FaultKind, GripperKind, Image, Observation, TaskSpec,
    VectorSpec, Word,
};

use super::piece::{Piece, Slice, Source, numbers};
use super::{CameraPiece, TaskMap};
use crate::picture::Picture;
use crate::profile::{Arm, Profile};

/// A map that fits an environment and a profile. It translates the task, the observations and the actions.
#[derive(Debug, Clone)]
pub struct BoundMap {
    task: TaskSpec,
    vectors: Vec<(Word, Vec<Part>)>,
    /// The cameras that the profile uses: name, and where the image comes from.
    cameras: Vec<(String, CameraPiece)>,
    action: Option<ActionMap>,
}

/// A piece of a vector.
#[derive(Debug, Clone)]
enum Part {
    Number(f64),
    Range { name: Word, low: usize, high: usize, scale: f64, offset: f64 },
}

/// How the numbers of the environment's action follow from the action of the profile.
#[derive(Debug, Clone)]
struct ActionMap {
    arm: Arm,
    /// Numbers of the arm that the profile uses, without that of the gripper.
    arms: usize,
    /// One for each number of the environment's action.
    numbers: Vec<Number>,
}

/// A number of the environment's action: `scale * quantity + offset`, within its bounds.
#[derive(Debug, Clone)]
struct Number {
    quantity: Option<Quantity>,
    scale: f64,
    offset: f64,
    low: f64,
    high: f64,
}

/// A quantity of the action that a profile describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quantity {
    /// Translation of the tool along an axis in a control period, in metres.
    Translation(usize),
    /// Number of the rotation vector of the tool in a control period, in radians.
    Rotation(usize),
    /// Position of a joint, in radians.
    Joint(usize),
    /// Number of a vector.
    Element(usize),
    /// Gripper: -1 opens, 1 closes.
    Gripper,
}

impl BoundMap {
    /// Binds a map.
    ///
    /// # Errors
    /// If the map names something that the environment or the profile lacks. The message names what they have.
    pub fn new(map: &TaskMap, profile: &Profile, task: &TaskSpec) -> Result<Self, String> {
        let mut seen = TaskSpec { ..task.clone() };
        let mut vectors = Vec::new();
        for (name, pieces) in &map.vectors {
            let parts = pieces.0.iter().map(|piece| part(piece, task)).collect::<Result<Vec<_>, _>>();
            let parts = parts.map_err(|why| format!("vectors.{name}: {why}"))?;
            seen.observation.vectors.retain(|vector| vector.name != *name);
            let length = parts.iter().map(Part::len).sum();
            seen.observation.vectors.push(VectorSpec { name: *name, length, unit: String::new() });
            vectors.push((*name, parts));
        }
        for (name, piece) in &map.cameras {
            let camera = find_camera(task, &piece.from).map_err(|why| format!("cameras.{name}: {why}"))?;
            let camera = CameraSpec { name: name.clone(), ..camera.clone() };
            seen.observation.cameras.retain(|known| known.name != *name);
            seen.observation.cameras.push(camera);
        }
        let has = |name: &&str| seen.observation.cameras.iter().any(|camera| camera.name == *name);
        let cameras = profile.cameras.iter().filter_map(|camera| camera.sources().find(has)).map(|name| {
            let own = || CameraPiece { from: name.to_owned(), orientation: Default::default() };
            (name.to_owned(), map.cameras.get(name).cloned().unwrap_or_else(own))
        });
        let cameras = cameras.collect();
        let action = match map.action.is_empty() {
            true => None,
            false => {
                let action = ActionMap::new(map, profile, &task.action).map_err(|why| format!("[action]: {why}"))?;
                seen.action = action.spec();
                Some(action)
            }
        };
        Ok(Self { task: seen, vectors, cameras, action })
    }

    /// The task as the profile sees it.
    pub fn task(&self) -> &TaskSpec {
        &self.task
    }

    /// The cameras of the environment whose images the profile uses.
    pub fn cameras(&self) -> Vec<String> {
        let mut names: Vec<String> = self.cameras.iter().map(|(_, piece)| piece.from.clone()).collect();
        names.sort();
        names.dedup();
        names
    }

    /// An observation of the environment as the profile sees it.
    ///
    /// # Errors
    /// If a vector or an image is missing, or has another size than the environment declared.
    pub fn observation(&self, observation: &Observation) -> Result<Observation, Fault> {
        let mapped = |name: &Word| self.vectors.iter().any(|(known, _)| known == name);
        let mut vectors: Vec<_> = observation.vectors.iter().filter(|(name, _)| !mapped(name)).cloned().collect();
        for (name, parts) in &self.vectors {
            let mut values = Vec::with_capacity(parts.len());
            for part in parts {
                part.append(&mut values, observation)?;
            }
            vectors.push((*name, values));
        }
        let images = match observation.images.is_empty() {
            true => Vec::new(),
            false => self
                .cameras
                .iter()
                .map(|(name, piece)| image(name, piece, &observation.images))
                .collect::<Result<_, _>>()?,
        };
        Ok(Observation { time_s: observation.time_s, vectors, images })
    }

    /// The action of the environment for one of the profile, within the environment's bounds.
    pub fn action(&self, action: Action) -> Action {
        match &self.action {
            None => action,
            Some(map) => map.forward(&action),
        }
    }

    /// The action of the profile for one of the environment: the inverse of [`Self::action`]. Quantities that the
    /// environment does not use are zero.
    pub fn inverse(&self, action: Action) -> Action {
        match (&self.action, &action.command) {
            (Some(map), Command::Vector(numbers)) => map.backward(numbers, &action),
            _ => action,
        }
    }
}

impl Part {
    fn len(&self) -> usize {
        match self {
            Self::Number(_) => 1,
            Self::Range { low, high, .. } => high - low,
        }
    }

    fn append(&self, values: &mut Vec<f64>, observation: &Observation) -> Result<(), Fault> {
        match self {
            Self::Number(number) => values.push(*number),
            Self::Range { name, low, high, scale, offset } => {
                let numbers = observation.vector(name.as_str()).and_then(|vector| vector.get(*low..*high));
                let missing = || format!("the map uses `{name}[{low}:{high}]`, which this observation lacks");
                let numbers = numbers.ok_or_else(|| Fault::new(FaultKind::Setup, missing()))?;
                values.extend(numbers.iter().map(|n| scale * n + offset));
            }
        }
        Ok(())
    }
}

fn part(piece: &Piece, task: &TaskSpec) -> Result<Part, String> {
    match piece {
        Piece::Number(number) => Ok(Part::Number(*number)),
        Piece::From { source, scale, offset } => {
            let known = task.observation.vectors.iter().find(|vector| vector.name == *source.name);
            let known = known.ok_or_else(|| {
                format!("the environment observes no vector `{}`. It observes: {}", source.name, vectors_of(task))
            })?;
            let range = source.resolve(known.length)?;
            Ok(Part::Range { name: known.name, low: range.start, high: range.end, scale: *scale, offset: *offset })
        }
    }
}

/// The vectors of a task with their sizes, as text.
fn vectors_of(task: &TaskSpec) -> String {
    let vectors = task.observation.vectors.iter();
    let texts: Vec<String> = vectors.map(|v| format!("{} ({})", v.name, numbers(v.length))).collect();
    if texts.is_empty() { "nothing".to_owned() } else { texts.join(", ") }
}

fn find_camera<'a>(task: &'a TaskSpec, name: &str) -> Result<&'a CameraSpec, String> {
    let cameras = &task.observation.cameras;
    cameras.iter().find(|camera| camera.name == name).ok_or_else(|| {
        let known: Vec<String> = cameras.iter().map(|c| format!("{} ({} x {})", c.name, c.width, c.height)).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        format!("the environment has no camera `{name}`. Its cameras: {known}")
    })
}

fn image(name: &str, piece: &CameraPiece, images: &[Image]) -> Result<Image, Fault> {
    let missing =
        || Fault::new(FaultKind::Setup, format!("the map uses the camera `{}`, which was not rendered", piece.from));
    let image = images.iter().find(|image| image.camera == piece.from).ok_or_else(missing)?;
    let Image { width, height, rgb, .. } = image;
    let camera = name.to_owned();
    Ok(match Picture::reoriented(image, piece.orientation) {
        Some(rgb) => Image { camera, width: *width, height: *height, rgb },
        None => Image { camera, width: *width, height: *height, rgb: rgb.clone() },
    })
}

impl ActionMap {
    fn new(map: &TaskMap, profile: &Profile, spec: &ActionSpec) -> Result<Self, String> {
        let space = spec.spaces.iter().find_map(|space| match space {
            ActionSpace::Vector { names, low, high } => Some((names, low, high)),
            _ => None,
        });
        let Some((names, low, high)) = space else {
            return Err(format!(
                "the environment takes {}, and a map writes a vector. Leave [action] out",
                spec.kinds()
            ));
        };
        let all = || {
            let bounds = low.iter().zip(high);
            let texts: Vec<String> = names.iter().zip(bounds).map(|(n, (a, b))| format!("{n} ({a} to {b})")).collect();
            format!("The action of the environment: {}", texts.join(", "))
        };
        if let Some(unknown) = map.action.keys().find(|key| !names.contains(key)) {
            return Err(format!("the environment's action has no number `{unknown}`. {}", all()));
        }
        let form = &profile.action;
        let arms = if form.arm == Arm::Vector { form.used() } else { form.used().saturating_sub(1) };
        let bounds = low.iter().zip(high);
        let numbers = names.iter().zip(bounds).map(|(name, (low, high))| {
            let piece = map.action.get(name).ok_or_else(|| format!("`{name}` is missing. {}", all()))?;
            let (low, high) = (*low, *high);
            match piece {
                Piece::Number(number) => Ok(Number { quantity: None, scale: 0.0, offset: *number, low, high }),
                Piece::From { source, scale, offset } => {
                    let quantity = Quantity::new(source, form.arm, arms).ok_or_else(|| {
                        let (arm, expected) = (form.arm.as_str(), Quantity::expected(form.arm, arms));
                        format!(
                            "{name} = `{source}`: the actions of the profile `{}` (arm = \"{arm}\") have no such quantity. \
                             Expected {expected}",
                            profile.name
                        )
                    })?;
                    Ok(Number { quantity: Some(quantity), scale: *scale, offset: *offset, low, high })
                }
            }
        });
        let numbers = numbers.collect::<Result<_, String>>()?;
        Ok(Self { arm: form.arm, arms, numbers })
    }

    /// The actions that the profile sends, as a task that accepts them.
    fn spec(&self) -> ActionSpec {
        let gripper = (self.arm != Arm::Vector).then_some(GripperKind::Continuous);
        let space = match self.arm {
            Arm::Vector => {
                let (low, high) = (0..self.arms).map(|i| self.range(Quantity::Element(i))).unzip();
                ActionSpace::Vector { names: (0..self.arms).map(|i| format!("action[{i}]")).collect(), low, high }
            }
            Arm::ToolDelta | Arm::OscPose | Arm::ToolPose => {
                ActionSpace::ToolDelta { translation_m: 1.0, rotation_rad: 1.0 }
            }
            Arm::JointPositions | Arm::JointDeltas => {
                ActionSpace::JointPosition { joints: (0..self.arms).map(|i| format!("joint[{i}]")).collect() }
            }
        };
        ActionSpec { spaces: vec![space], gripper }
    }

    /// The range of a quantity that reaches all values within the bounds of the environment. -1 to 1 if it is not used.
    fn range(&self, quantity: Quantity) -> (f64, f64) {
        let users = self.numbers.iter().filter(|number| number.quantity == Some(quantity));
        let ends = users.flat_map(|n| [n.low, n.high].map(|end| (end - n.offset) / n.scale));
        ends.fold(None, |range: Option<(f64, f64)>, end| {
            Some(range.map_or((end, end), |(low, high)| (low.min(end), high.max(end))))
        })
        .unwrap_or((-1.0, 1.0))
    }

    fn forward(&self, action: &Action) -> Action {
        let numbers = self.numbers.iter().map(|number| {
            let value = number.quantity.map_or(0.0, |quantity| quantity.read(action));
            (number.scale * value + number.offset).clamp(number.low, number.high)
        });
        Action { command: Command::Vector(numbers.collect()), gripper: None, phase: action.phase }
    }

    fn backward(&self, numbers: &[f64], action: &Action) -> Action {
        let mut translation_m = [0.0; 3];
        let mut rotation_rad = [0.0; 3];
        let mut others = vec![0.0; self.arms];
        let mut gripper = None;
        for (number, value) in self.numbers.iter().zip(numbers) {
            let value = (value - number.offset) / number.scale;
            match number.quantity {
                Some(Quantity::Translation(axis)) => translation_m[axis] = value,
                Some(Quantity::Rotation(axis)) => rotation_rad[axis] = value,
                Some(Quantity::Joint(i) | Quantity::Element(i)) => others[i] = value,
                Some(Quantity::Gripper) => gripper = Some(value.clamp(Action::OPEN, Action::CLOSE)),
                None => {}
            }
        }
        let command = match self.arm {
            Arm::Vector => Command::Vector(others),
            Arm::JointPositions | Arm::JointDeltas => Command::JointPosition(others),
            Arm::ToolDelta | Arm::OscPose | Arm::ToolPose => Command::ToolDelta { translation_m, rotation_rad },
        };
        let gripper = (self.arm != Arm::Vector).then_some(gripper.unwrap_or(Action::OPEN));
        Action { command, gripper, phase: action.phase }
    }
}

/// The names of the axes of a translation, and of a rotation vector.
const TRANSLATION: [&str; 3] = ["x", "y", "z"];
const ROTATION: [&str; 3] = ["rx", "ry", "rz"];

impl Quantity {
    /// The quantity of this name. `None` if the actions of this arm mode have none of this name.
    fn new(source: &Source, arm: Arm, arms: usize) -> Option<Self> {
        let name = source.name.as_str();
        let axis = |names: [&str; 3]| names.iter().position(|known| *known == name);
        match (arm, source.slice) {
            (Arm::Vector, Some(Slice::At(_))) if name == "action" => {
                source.resolve(arms).ok().map(|range| Self::Element(range.start))
            }
            (Arm::JointPositions | Arm::JointDeltas, Some(Slice::At(_))) if name == "joint" => {
                source.resolve(arms).ok().map(|range| Self::Joint(range.start))
            }
            (Arm::Vector, _) | (_, Some(_)) => None,
            (_, None) if name == "gripper" => Some(Self::Gripper),
            (Arm::ToolDelta | Arm::OscPose | Arm::ToolPose, None) => {
                axis(TRANSLATION).map(Self::Translation).or_else(|| axis(ROTATION).map(Self::Rotation))
            }
            (Arm::JointPositions | Arm::JointDeltas, None) => None,
        }
    }

    /// The quantities of this arm mode, as text.
    fn expected(arm: Arm, arms: usize) -> String {
        let last = arms.saturating_sub(1);
        match arm {
            Arm::Vector => format!("action[0] to action[{last}]"),
            Arm::ToolDelta | Arm::OscPose | Arm::ToolPose => {
                "x, y, z (translation in a control period, in metres), rx, ry, rz \
                 (rotation vector, in radians), gripper (-1 opens, 1 closes), or a number"
                    .to_owned()
            }
            Arm::JointPositions | Arm::JointDeltas => {
                format!("joint[0] to joint[{last}] (in radians), gripper (-1 opens, 1 closes), or a number")
            }
        }
    }

    fn read(self, action: &Action) -> f64 {
        let number = match (self, &action.command) {
            (Self::Translation(axis), Command::ToolDelta { translation_m, .. }) => translation_m.get(axis).copied(),
            (Self::Rotation(axis), Command::ToolDelta { rotation_rad, .. }) => rotation_rad.get(axis).copied(),
            (Self::Joint(i), Command::JointPosition(numbers)) | (Self::Element(i), Command::Vector(numbers)) => {
                numbers.get(i).copied()
            }
            (Self::Gripper, _) => action.gripper,
            _ => None,
        };
        // An action without the number is not one of the profile. NaN makes the episode invalid.
        number.unwrap_or(f64::NAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An environment with a vector of 6 numbers, two cameras and an action of 3.
    fn task() -> TaskSpec {
        serde_json::from_str(
            r#"{"name": "push", "version": 1, "instruction": "push", "control_period_s": 0.05, "time_limit_s": 1.0, "failure_modes": [], "measures": [], "phases": [], "parameters": [],
                "observation": {"vectors": [{"name": "observation", "length": 6}, {"name": "goal", "length": 2}],
                    "cameras": [{"name": "corner", "width": 2, "height": 1}, {"name": "hand", "width": 2, "height": 1}]},
                "action": {"spaces": [{"kind": "vector", "names": ["dx", "dy", "grip"], "low": [-1, -1, 0], "high": [1, 1, 1]}]}}"#,
        )
        .unwrap()
    }

    fn profile(name: &str) -> Profile {
        Profile::from_toml(Profile::built_in(name).unwrap()).unwrap()
    }

    const MAP: &str = "[vectors]\n\
        eef_pos = [\"observation[:2]\", 0.3]\n\
        eef_axis_angle = [3.14, 0, 0]\n\
        gripper_qpos = [{ from = \"observation[2]\", scale = 0.5, offset = 0.1 }, { from = \"observation[2]\", scale = -0.5 }]\n\
        [cameras]\nfront = \"corner\"\nwrist = { from = \"hand\", orientation = \"mirrored\" }\n\
        [action]\ndx = { from = \"y\", scale = -100 }\ndy = { from = \"x\", scale = 100 }\n\
        grip = { from = \"gripper\", scale = 0.5, offset = 0.5 }\n";

    fn bound(text: &str) -> Result<BoundMap, String> {
        BoundMap::new(&TaskMap::from_toml(text)?, &profile("pi0-libero"), &task())
    }

    fn observation() -> Observation {
        let image =
            |camera: &str| Image { camera: camera.to_owned(), width: 2, height: 1, rgb: vec![1, 2, 3, 4, 5, 6] };
        let task = task();
        let vectors = task.observation.vectors.iter().map(|v| (v.name, (0..v.length).map(|i| i as f64).collect()));
        Observation { time_s: 0.0, vectors: vectors.collect(), images: vec![image("corner"), image("hand")] }
    }

    #[test]
    fn observations_are_assembled() {
        let bound = bound(MAP).unwrap();
        let seen = bound.observation(&observation()).unwrap();
        assert_eq!(seen.vector("eef_pos"), Some(&[0.0, 1.0, 0.3][..]));
        assert_eq!(seen.vector("gripper_qpos"), Some(&[1.1, -1.0][..]));
        // A vector that is not mapped keeps its name.
        assert_eq!(seen.vector("goal"), Some(&[0.0, 1.0][..]));
        assert_eq!(seen.images[0].camera, "front");
        assert_eq!(seen.images[1].rgb, [4, 5, 6, 1, 2, 3]);
        assert_eq!(bound.cameras(), ["corner", "hand"]);
        // The task that the profile sees has the same sizes.
        for vector in &bound.task().observation.vectors {
            assert_eq!(seen.vector(vector.name.as_str()).unwrap().len(), vector.length);
        }
    }

    #[test]
    fn actions_are_reordered_scaled_and_clipped() {
        let bound = bound(MAP).unwrap();
        let command = Command::ToolDelta { translation_m: [0.004, 0.02, 0.1], rotation_rad: [0.0; 3] };
        let action = bound.action(Action { command, gripper: Some(-1.0), phase: None });
        assert_eq!(action, Action { command: Command::Vector(vec![-1.0, 0.4, 0.0]), gripper: None, phase: None });
        let back = bound.inverse(action);
        let Command::ToolDelta { translation_m, .. } = back.command else { panic!("{back:?}") };
        assert!((translation_m[0] - 0.004).abs() < 1e-12 && (translation_m[1] - 0.01).abs() < 1e-12);
        assert_eq!((translation_m[2], back.gripper), (0.0, Some(-1.0)));
    }

    #[test]
    fn vectors_of_a_model_keep_their_range() {
        let learned = Profile::from_toml(
            &Profile::built_in("pi0-libero")
                .unwrap()
                .replace("osc_pose", "vector")
                .replace("gripper_threshold = 0.0\n", "")
                .replace("gripper_open = \"below\"\n", ""),
        )
        .unwrap();
        let map =
            TaskMap::from_toml("[action]\ndx = \"action[1]\"\ndy = { from = \"action[0]\", scale = 2 }\ngrip = 1\n")
                .unwrap();
        let bound = BoundMap::new(&map, &learned, &task()).unwrap();
        let (low, high) = bound.task().action.vector().unwrap();
        assert_eq!((&low[..3], &high[..3]), (&[-0.5, -1.0, -1.0][..], &[0.5, 1.0, 1.0][..]));
        let raw =
            Action { command: Command::Vector(vec![0.1, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0]), gripper: None, phase: None };
        assert_eq!(bound.action(raw).command, Command::Vector(vec![0.2, 0.2, 1.0]));
    }

    #[test]
    fn errors_name_what_exists() {
        for (from, to, part) in [
            (
                "observation[:2]",
                "obs[:2]",
                "vectors.eef_pos: the environment observes no vector `obs`. It observes: observation (6 numbers), goal (2 numbers)",
            ),
            (
                "observation[:2]",
                "observation[:9]",
                "vectors.eef_pos: `observation[:9]`: out of range, because `observation` has 6 numbers",
            ),
            (
                "\"corner\"",
                "\"top\"",
                "cameras.front: the environment has no camera `top`. Its cameras: corner (2 x 1), hand (2 x 1)",
            ),
            (
                "dx =",
                "dz =",
                "[action]: the environment's action has no number `dz`. The action of the environment: dx (-1 to 1), dy (-1 to 1), grip (0 to 1)",
            ),
            (
                "dx = { from = \"y\", scale = -100 }\n",
                "",
                "[action]: `dx` is missing. The action of the environment: dx",
            ),
            (
                "\"gripper\"",
                "\"joint[0]\"",
                "grip = `joint[0]`: the actions of the profile `pi0-libero` (arm = \"osc_pose\") have no such quantity. Expected x, y, z",
            ),
        ] {
            let error = bound(&MAP.replacen(from, to, 1)).unwrap_err();
            assert!(error.starts_with(part) || error.contains(part), "{error}");
        }
    }
}
