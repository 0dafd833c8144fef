//! Between the cell and a model: observations into queries, answers into actions, as a profile says.

use robogate_core::{Action, Command, Observation, Pose, vectors};

use super::array::{Array, Dtype};
use super::error::ServerError;
use super::picture::Picture;
use super::profile::{ActionForm, Arm, Axes, MAX_CHUNK, Part, Profile, Rotation, Side};
use super::rotation;
use super::spare::Spare;

/// What a model is asked: pictures and vectors under the server's names, in the profile's order.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// Pictures, 8 bits each of red, green and blue.
    pub images: Vec<(String, Array)>,
    /// Vectors.
    pub states: Vec<(String, Array)>,
    /// What to do, in words.
    pub instruction: String,
    /// Which question of the episode this is, from 0.
    pub step: u64,
    /// Simulated time since the episode's start, in seconds.
    pub time_s: f64,
}

impl Query {
    /// What the profile's model is asked where a cell looks like this.
    pub fn new(
        profile: &Profile,
        observation: &Observation,
        instruction: &str,
        step: u64,
    ) -> Result<Self, ServerError> {
        Self::drawn(profile, observation, instruction, step, &mut Spare::default())
    }

    /// The same, its pictures in buffers that [`Query::give_back`] returns.
    pub(crate) fn drawn(
        profile: &Profile,
        observation: &Observation,
        instruction: &str,
        step: u64,
        spare: &mut Spare,
    ) -> Result<Self, ServerError> {
        let images = profile.cameras.iter().map(|camera| {
            let image = observation.images.iter().find(|image| image.camera == camera.from).ok_or_else(|| {
                let known: Vec<&str> = observation.images.iter().map(|image| image.camera.as_str()).collect();
                let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
                ServerError::Observation(format!(
                    "the profile asks for the camera `{}`; the cell has {known}",
                    camera.from
                ))
            })?;
            let picture = Picture::taken(image, camera, spare).ok_or_else(|| {
                ServerError::Observation(format!(
                    "the picture of `{}` has {} bytes, which are not {} x {} pixels",
                    image.camera,
                    image.rgb.len(),
                    image.width,
                    image.height
                ))
            })?;
            let (w, h) = (picture.width, picture.height);
            let (shape, data) = match camera.axes {
                Axes::Hwc => (vec![h, w, 3], picture.rgb),
                Axes::Chw => {
                    let planes = picture.planes(spare);
                    spare.give(picture.rgb);
                    (vec![3, h, w], planes)
                }
            };
            let array = Array::new(Dtype::U8, shape, data).map_err(|e| ServerError::Observation(e.to_string()))?;
            Ok((camera.key.clone(), array))
        });
        let images = images.collect::<Result<_, ServerError>>()?;
        let states = profile.states.iter().map(|state| {
            let mut numbers = Vec::with_capacity(state.parts.len());
            for part in &state.parts {
                push(&mut numbers, *part, profile, observation)?;
            }
            for name in &state.vectors {
                numbers.extend(observation.vector(name.as_str()).ok_or_else(|| missing(name.as_str()))?);
            }
            if numbers.iter().any(|n| !n.is_finite()) {
                return Err(ServerError::Observation(format!("the state `{}` is not finite", state.key)));
            }
            Ok((state.key.clone(), Array::vector(&numbers, state.dtype)))
        });
        let states = states.collect::<Result<_, ServerError>>()?;
        let instruction = profile.instruction.as_deref().unwrap_or(instruction).to_owned();
        Ok(Self { images, states, instruction, step, time_s: observation.time_s })
    }

    /// Returns the pictures' buffers.
    pub(crate) fn give_back(self, spare: &mut Spare) {
        self.images.into_iter().for_each(|(_, array)| spare.give(array.into_data()));
    }
}

/// The error for a vector that the observation lacks.
fn missing(vector: &str) -> ServerError {
    ServerError::Observation(format!("the profile uses the vector `{vector}`; the observation has none of this name"))
}

fn push(numbers: &mut Vec<f64>, part: Part, profile: &Profile, observation: &Observation) -> Result<(), ServerError> {
    let tool = match (part.vector() == Some(vectors::TOOL_POSE), observation.tool_pose()) {
        (true, None) => return Err(missing(vectors::TOOL_POSE.as_str())),
        (_, pose) => rotation::seen(&pose.unwrap_or(Pose::IDENTITY), profile.tool.shift_m, profile.tool.turn_rad),
    };
    let [w, x, y, z] = tool.orientation;
    let opening = || {
        observation.gripper_opening_m().ok_or_else(|| {
            ServerError::Observation("the profile asks for the opening of the fingers; the gripper has none".to_owned())
        })
    };
    let openness = || Ok((opening()? / profile.tool.stroke_m.unwrap_or(1.0)).clamp(0.0, 1.0));
    match part {
        Part::ToolPosition => numbers.extend(tool.position),
        Part::ToolX => numbers.push(tool.position[0]),
        Part::ToolY => numbers.push(tool.position[1]),
        Part::ToolZ => numbers.push(tool.position[2]),
        Part::ToolAxisAngle => numbers.extend(rotation::axis_angle(tool.orientation)),
        Part::ToolEuler => numbers.extend(rotation::euler(tool.orientation)),
        Part::ToolRoll => numbers.push(rotation::euler(tool.orientation)[0]),
        Part::ToolPitch => numbers.push(rotation::euler(tool.orientation)[1]),
        Part::ToolYaw => numbers.push(rotation::euler(tool.orientation)[2]),
        Part::ToolQuaternionXyzw => numbers.extend([x, y, z, w]),
        Part::ToolQuaternionWxyz => numbers.extend([w, x, y, z]),
        Part::JointPositions => numbers.extend(
            observation
                .vector(vectors::JOINT_POSITIONS.as_str())
                .ok_or_else(|| missing(vectors::JOINT_POSITIONS.as_str()))?,
        ),
        Part::GripperFingers => numbers.extend([0.5 * opening()?, -0.5 * opening()?]),
        Part::GripperOpenness => numbers.push(openness()?),
        Part::GripperClosedness => numbers.push(1.0 - openness()?),
        Part::GripperOpening => numbers.push(opening()?),
        Part::Zero => numbers.push(0.0),
    }
    Ok(())
}

/// What a model answers: actions one after the other, as raw numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Chunk {
    rows: Vec<Vec<f64>>,
}

impl Chunk {
    /// From one array: `(length, size)`, or `(size,)` for a single action. Axes of one before these are a batch of one.
    pub(crate) fn of_array(array: &Array) -> Result<Self, ServerError> {
        let mut shape = array.shape();
        while let (3.., [1, rest @ ..]) = (shape.len(), shape) {
            shape = rest;
        }
        let width = match shape {
            [width] | [_, width] if *width > 0 => *width,
            _ => return Err(ServerError::Shape(format!("actions of shape {array} are no list of actions"))),
        };
        Self::of_rows(array.numbers().chunks_exact(width).map(<[f64]>::to_vec).collect())
    }

    /// From actions one after the other.
    pub(crate) fn of_rows(rows: Vec<Vec<f64>>) -> Result<Self, ServerError> {
        if rows.is_empty() || rows.len() > MAX_CHUNK {
            return Err(ServerError::Shape(format!("{} actions in an answer: 1 to {MAX_CHUNK} are one", rows.len())));
        }
        Ok(Self { rows })
    }

    /// One part of each action, from an array of that part: `(1, T, D)`, `(T, D)` or `(T,)`.
    pub(crate) fn columns(array: &Array, key: &str) -> Result<Vec<Vec<f64>>, ServerError> {
        let width = match array.shape() {
            [1, _, width] | [_, width] if *width > 0 => *width,
            [_] => 1,
            _ => return Err(ServerError::Shape(format!("`{key}` of shape {array} is no list of actions"))),
        };
        Ok(array.numbers().chunks_exact(width).map(<[f64]>::to_vec).collect())
    }

    /// Appends one part to each action, the first one to none.
    pub(crate) fn join(rows: &mut Vec<Vec<f64>>, part: Vec<Vec<f64>>, key: &str) -> Result<(), ServerError> {
        if rows.is_empty() {
            *rows = part;
        } else if rows.len() == part.len() {
            rows.iter_mut().zip(part).for_each(|(row, more)| row.extend(more));
        } else {
            let (theirs, others) = (part.len(), rows.len());
            return Err(ServerError::Shape(format!("`{key}` has {theirs} actions, the parts before it {others}")));
        }
        Ok(())
    }

    /// The raw numbers of each action.
    pub fn rows(&self) -> &[Vec<f64>] {
        &self.rows
    }

    pub(crate) fn into_rows(self) -> Vec<Vec<f64>> {
        self.rows
    }

    /// Whether it is what the profile says: length, size, finite numbers.
    pub fn check(&self, profile: &Profile) -> Result<(), ServerError> {
        let size = profile.action.size;
        if let Some(row) = self.rows.iter().find(|row| row.len() != size) {
            return Err(ServerError::Shape(format!(
                "an action has {} numbers, the profile's action.size is {size}",
                row.len()
            )));
        }
        let got = self.rows.len();
        match (profile.chunk.length, profile.chunk.execute) {
            (Some(length), _) if length != got => {
                return Err(ServerError::Shape(format!(
                    "{got} actions in an answer, the profile's chunk.length is {length}"
                )));
            }
            (_, execute) if got < execute => {
                return Err(ServerError::Shape(format!(
                    "{got} actions in an answer, the profile's chunk.execute is {execute}"
                )));
            }
            _ => {}
        }
        for (row, numbers) in self.rows.iter().enumerate() {
            if let Some(column) = numbers.iter().position(|n| !n.is_finite()) {
                return Err(ServerError::NotFinite { row, column, value: numbers[column].to_string() });
            }
        }
        Ok(())
    }
}

impl ActionForm {
    /// What an action's raw numbers tell the robot, whose joints are at `joints`. The numbers are finite and as many as
    /// [`ActionForm::size`].
    pub fn action(&self, raw: &[f64], joints: &[f64]) -> Result<Action, ServerError> {
        if self.arm == Arm::Vector {
            return Ok(Action { command: Command::Vector(raw.to_vec()), gripper: None, phase: None });
        }
        let Some((gripper, arm)) = raw.split_last() else {
            return Err(ServerError::Shape("an action without numbers".to_owned()));
        };
        let (Some(threshold), Some(side)) = (self.gripper_threshold, self.gripper_open) else {
            return Err(ServerError::Shape("the profile has no action.gripper_threshold or gripper_open".to_owned()));
        };
        let open = match side {
            Side::Above => *gripper > threshold,
            Side::Below => *gripper < threshold,
        };
        let gripper = Some(if open { Action::OPEN } else { Action::CLOSE });
        let cut = |n: f64| self.clip.map_or(n, |limit| n.clamp(-limit, limit));
        if self.arm != Arm::ToolDelta && arm.len() != joints.len() {
            return Err(ServerError::Shape(format!(
                "an action for {} joints, the arm has {}",
                arm.len(),
                joints.len()
            )));
        }
        let command = match (self.arm, arm) {
            (Arm::ToolDelta, [x, y, z, a, b, c]) => {
                let turn = [*a, *b, *c].map(|n| cut(n) * self.rotation_scale_rad);
                Command::ToolDelta {
                    translation_m: [*x, *y, *z].map(|n| cut(n) * self.position_scale_m),
                    rotation_rad: match self.rotation {
                        Rotation::AxisAngle => turn,
                        Rotation::Euler => rotation::euler_to_vector(turn),
                    },
                }
            }
            (Arm::ToolDelta, other) => {
                return Err(ServerError::Shape(format!("{} numbers for a tool's way and turn: 6 are", other.len())));
            }
            (Arm::JointPositions | Arm::Vector, arm) => Command::JointPosition(arm.to_vec()),
            (Arm::JointDeltas, arm) => Command::JointPosition(
                joints.iter().zip(arm).map(|(q, n)| q + cut(*n) * self.rotation_scale_rad).collect(),
            ),
        };
        Ok(Action { command, gripper, phase: None })
    }
}

#[cfg(test)]
mod tests {
    use robogate_core::Image;

    use super::*;

    fn observation() -> Observation {
        let image = |camera: &str| Image { camera: camera.to_owned(), width: 2, height: 2, rgb: (0..12).collect() };
        Observation {
            time_s: 0.0,
            vectors: vec![
                (vectors::JOINT_POSITIONS, (1..=7).map(f64::from).collect()),
                (vectors::GRIPPER_OPENING, vec![0.06]),
                // A rotation by 90 degrees about z.
                (vectors::TOOL_POSE, Pose::upright([0.1, 0.2, 0.3], std::f64::consts::FRAC_PI_2).to_array().to_vec()),
            ],
            images: vec![image("front"), image("wrist")],
        }
    }

    fn profile(change: impl Fn(String) -> String) -> Profile {
        Profile::from_toml(&change(Profile::built_in("pi0-libero").unwrap().to_owned())).unwrap()
    }

    #[test]
    fn a_state_has_its_parts_in_the_profiles_order_as_the_model_sees_the_tool() {
        let parts = [
            "tool_position",
            "tool_yaw",
            "tool_quaternion_xyzw",
            "gripper_fingers",
            "gripper_openness",
            "gripper_closedness",
            "gripper_opening",
            "zero",
            "joint_positions",
        ]
        .map(|part| format!("\"{part}\""));
        let profile = profile(|text| {
            let text = text.replace("\"tool_position\", \"tool_axis_angle\", \"gripper_fingers\"", &parts.join(", "));
            text + "\n[tool]\nshift_m = [1.0, 0.0, 0.0]\nturn_rad = [0.0, 0.0, 0.5]\nstroke_m = 0.08\n"
        });
        let query = Query::new(&profile, &observation(), "go", 3).unwrap();
        let got = query.states[0].1.numbers();
        let yaw = std::f64::consts::FRAC_PI_2 + 0.5;
        let quaternion = [0.0, 0.0, (0.5 * yaw).sin(), (0.5 * yaw).cos()];
        let want: Vec<f64> = [1.1, 0.2, 0.3, yaw]
            .into_iter()
            .chain(quaternion)
            .chain([0.03, -0.03, 0.75, 0.25, 0.06, 0.0])
            .chain((1..=7).map(f64::from))
            .collect();
        assert_eq!(got.len(), want.len());
        got.iter().zip(&want).for_each(|(a, b)| assert!((a - b).abs() < 1e-12, "{got:?}"));
        assert_eq!((query.instruction.as_str(), query.step), ("go", 3));
    }

    #[test]
    fn pictures_have_the_axes_that_the_profile_says() {
        let small = |text: String| {
            text.replace("224", "2")
                .replace("key = \"observation/image\"", "axes = \"chw\"\nkey = \"observation/image\"")
        };
        let query = Query::new(&profile(small), &observation(), "go", 0).unwrap();
        assert_eq!(query.images[0].1.shape(), [3, 2, 2]);
        assert_eq!(query.images[0].1.data(), [0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11]);
        assert_eq!(query.images[1].1.data(), (0..12).collect::<Vec<u8>>());
    }

    #[test]
    fn a_picture_of_another_size_than_it_says_is_no_observation() {
        let mut observation = observation();
        observation.images[0].rgb.pop();
        let error = Query::new(&profile(|text| text), &observation, "go", 0).unwrap_err().to_string();
        assert!(error.contains("`front` has 11 bytes, which are not 2 x 2 pixels"), "{error}");
    }

    #[test]
    fn numbers_are_cut_then_scaled_and_the_gripper_has_its_side() {
        let mut form = profile(|text| text).action;
        let action = form.action(&[0.5, -3.0, 0.0, 0.0, 0.0, 1.0, 0.2], &[]).unwrap();
        let delta = Command::ToolDelta { translation_m: [0.01, -0.02, 0.0], rotation_rad: [0.0, 0.0, 0.05] };
        assert_eq!((action.command, action.gripper), (delta, Some(Action::CLOSE)));
        form.gripper_open = Some(Side::Above);
        assert_eq!(form.action(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2], &[]).unwrap().gripper, Some(Action::OPEN));
        form.arm = Arm::JointDeltas;
        let action = form.action(&[1.0, -9.0, 0.0], &[0.5, 0.5]).unwrap();
        assert_eq!(action.command, Command::JointPosition(vec![0.55, 0.45]));
        form.arm = Arm::JointPositions;
        assert_eq!(
            form.action(&[1.0, -9.0, 0.0], &[0.5, 0.5]).unwrap().command,
            Command::JointPosition(vec![1.0, -9.0])
        );
        let error = form.action(&[1.0, 0.0], &[0.5, 0.5]).unwrap_err().to_string();
        assert!(error.contains("an action for 1 joints, the arm has 2"), "{error}");
    }
}
