//! Converts observations to queries of a model, according to its profile.

use robogate_core::{Image, Observation, Pose, Word, vectors};

use super::array::{Array, Dtype};
use super::buffers::Buffers;
use super::error::PolicyError;
use super::history::History;
use super::picture::Picture;
use super::profile::{Axes, Camera, Part, Profile, Rotation, State};
use super::rotation;

/// The input of a model: images and vectors under the names that the server uses, in the order of the profile.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// Images by name, 8 bits each of red, green and blue.
    pub images: Vec<(String, Array)>,
    /// Vectors by name.
    pub states: Vec<(String, Array)>,
    /// The instruction.
    pub instruction: String,
    /// Index of the query in the episode, from 0.
    pub step: u64,
    /// Simulated time since the episode's start, in seconds.
    pub time_s: f64,
}

impl Query {
    /// Create the query for an observation.
    pub fn new(
        profile: &Profile,
        observation: &Observation,
        instruction: &str,
        step: u64,
    ) -> Result<Self, PolicyError> {
        Self::with_buffers(profile, observation, &History::default(), instruction, step, &mut Buffers::default())
    }

    /// The same as [`Query::new`], with images in buffers that [`Query::recycle`] returns. `past` has the images and
    /// states of earlier actions.
    pub(crate) fn with_buffers(
        profile: &Profile,
        observation: &Observation,
        past: &History,
        instruction: &str,
        step: u64,
        buffers: &mut Buffers,
    ) -> Result<Self, PolicyError> {
        let images = profile.cameras.iter().map(|camera| {
            let array = match camera.history.as_slice() {
                [] => image(camera, &observation.images, buffers)?,
                history => {
                    let mut stack = buffers.take();
                    let mut shape = vec![history.len()];
                    for offset in history {
                        let one = image(camera, past.images(*offset).unwrap_or(&observation.images), buffers)?;
                        stack.extend_from_slice(one.data());
                        shape.truncate(1);
                        shape.extend_from_slice(one.shape());
                        buffers.recycle(one.into_data());
                    }
                    Array::new(Dtype::U8, shape, stack).map_err(|e| PolicyError::Observation(e.to_string()))?
                }
            };
            Ok((camera.key.clone(), array))
        });
        let images = images.collect::<Result<_, PolicyError>>()?;
        let present = numbers(profile, observation)?;
        let states = profile.states.iter().enumerate().map(|(i, state)| {
            let array = match state.history.as_slice() {
                [] => Array::vector(&present[i], state.dtype),
                history => {
                    let rows = history.iter().map(|offset| &*past.states(*offset).unwrap_or(&present)[i]);
                    Array::stacked(rows, state.dtype).map_err(|e| PolicyError::Observation(e.to_string()))?
                }
            };
            Ok((state.key.clone(), array))
        });
        let states = states.collect::<Result<_, PolicyError>>()?;
        let instruction = profile.instruction.as_deref().unwrap_or(instruction).to_owned();
        Ok(Self { images, states, instruction, step, time_s: observation.time_s })
    }

    /// Return the buffers of the images to the pool.
    pub(crate) fn recycle(self, buffers: &mut Buffers) {
        self.images.into_iter().for_each(|(_, array)| buffers.recycle(array.into_data()));
    }
}

/// The array of one camera.
fn image(camera: &Camera, images: &[Image], buffers: &mut Buffers) -> Result<Array, PolicyError> {
    let find = |name: &str| images.iter().find(|image| image.camera == name);
    let image = camera.sources().find_map(find).ok_or_else(|| {
        let known: Vec<&str> = images.iter().map(|image| image.camera.as_str()).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        PolicyError::Observation(format!("the profile requires the camera `{}`; the cell has {known}", camera.from))
    })?;
    let picture = Picture::from_image(image, camera, buffers).ok_or_else(|| {
        PolicyError::Observation(format!(
            "the image of `{}` has {} bytes, which does not match {} x {} pixels",
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
            let planes = picture.planes(buffers);
            buffers.recycle(picture.rgb);
            (vec![3, h, w], planes)
        }
    };
    Array::new(Dtype::U8, shape, data).map_err(|e| PolicyError::Observation(e.to_string()))
}

/// The numbers of each state of the profile.
pub(crate) fn numbers(profile: &Profile, observation: &Observation) -> Result<Vec<Vec<f64>>, PolicyError> {
    let of = |state: &State| {
        let mut numbers = Vec::with_capacity(state.parts.len());
        for part in &state.parts {
            push(&mut numbers, *part, profile, observation)?;
        }
        for name in &state.vectors {
            numbers.extend(vector(observation, *name)?);
        }
        if numbers.iter().any(|n| !n.is_finite()) {
            return Err(PolicyError::Observation(format!("the state `{}` is not finite", state.key)));
        }
        Ok(numbers)
    };
    profile.states.iter().map(of).collect()
}

/// Find a vector of the observation.
fn vector(observation: &Observation, name: Word) -> Result<&[f64], PolicyError> {
    observation.vector(name.as_str()).ok_or_else(|| missing(name))
}

/// The error for a vector that the observation lacks.
fn missing(name: Word) -> PolicyError {
    PolicyError::Observation(format!(
        "the profile requires the vector `{name}`, but the observation has none of this name"
    ))
}

/// Append the numbers of one part of a state.
fn push(numbers: &mut Vec<f64>, part: Part, profile: &Profile, observation: &Observation) -> Result<(), PolicyError> {
    let tool = match tool_pose(profile, observation) {
        None if part.vector() == Some(vectors::TOOL_POSE) => return Err(missing(vectors::TOOL_POSE)),
        pose => pose.unwrap_or(Pose::IDENTITY),
    };
    let opening = || {
        opening_m(observation).ok_or_else(|| {
            PolicyError::Observation(
                "the profile requires the gripper opening, but this gripper has no fingers".to_owned(),
            )
        })
    };
    let openness = || Ok((opening()? / profile.tool.stroke_m.unwrap_or(1.0)).clamp(0.0, 1.0));
    let rotated = |form| rotation::write(form, tool.orientation);
    match part {
        Part::ToolPosition => numbers.extend(tool.position),
        Part::ToolX => numbers.push(tool.position[0]),
        Part::ToolY => numbers.push(tool.position[1]),
        Part::ToolZ => numbers.push(tool.position[2]),
        Part::ToolAxisAngle => numbers.extend(rotation::axis_angle(tool.orientation)),
        Part::ToolAxisAngleX => numbers.push(rotation::axis_angle(tool.orientation)[0]),
        Part::ToolAxisAngleY => numbers.push(rotation::axis_angle(tool.orientation)[1]),
        Part::ToolAxisAngleZ => numbers.push(rotation::axis_angle(tool.orientation)[2]),
        Part::ToolEuler => numbers.extend(rotation::euler(tool.orientation)),
        Part::ToolRoll => numbers.push(rotation::euler(tool.orientation)[0]),
        Part::ToolPitch => numbers.push(rotation::euler(tool.orientation)[1]),
        Part::ToolYaw => numbers.push(rotation::euler(tool.orientation)[2]),
        Part::ToolQuaternionXyzw => numbers.extend(rotated(Rotation::QuaternionXyzw)),
        Part::ToolQuaternionWxyz => numbers.extend(rotated(Rotation::QuaternionWxyz)),
        Part::ToolRot6dColumns => numbers.extend(rotated(Rotation::Rot6dColumns)),
        Part::ToolRot6dInterleaved => numbers.extend(rotated(Rotation::Rot6dInterleaved)),
        Part::ToolRot6dRows => numbers.extend(rotated(Rotation::Rot6dRows)),
        Part::JointPositions => {
            let joints = observation.vector("joint_pos").ok_or(());
            let joints = joints.or_else(|()| vector(observation, vectors::JOINT_POSITIONS))?;
            let unit = profile.tool.joint_unit_rad.unwrap_or(1.0);
            numbers.extend(joints.iter().map(|q| q / unit));
        }
        Part::GripperFingers => match observation.vector("gripper_qpos") {
            Some(fingers) => numbers.extend(fingers),
            None => numbers.extend([0.5 * opening()?, -0.5 * opening()?]),
        },
        Part::GripperOpenness => numbers.push(openness()?),
        Part::GripperClosedness => numbers.push(1.0 - openness()?),
        Part::GripperPercent => numbers.push(100.0 * openness()?),
        Part::GripperOpening => numbers.push(opening()?),
        Part::Zero => numbers.push(0.0),
    }
    Ok(())
}

/// Opening between the fingers in metres: observed, or from the positions of the two fingers of robosuite's Panda.
fn opening_m(observation: &Observation) -> Option<f64> {
    let fingers = || match observation.vector("gripper_qpos") {
        Some([left, right]) => Some(left - right),
        _ => None,
    };
    observation.gripper_opening_m().or_else(fingers)
}

/// Pose of the tool in the conventions of the model: that of the cell with the profile's offset and tool frame, or that
/// of LIBERO's own environment, which has these conventions.
///
/// The sign of the quaternion is that of robosuite's forward kinematics for a tool that points down.
pub fn tool_pose(profile: &Profile, observation: &Observation) -> Option<Pose> {
    if let Some(pose) = observation.tool_pose() {
        let pose = rotation::model_pose(&pose, profile.tool.shift_m, profile.tool.turn_rad);
        return Some(Pose { orientation: rotation::downwards(pose.orientation), ..pose });
    }
    let three = |name: &str| <[f64; 3]>::try_from(observation.vector(name)?).ok();
    let orientation = rotation::from_axis_angle(three("eef_axis_angle")?);
    Some(Pose { position: three("eef_pos")?, orientation })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observation() -> Observation {
        let image = |camera: &str| Image { camera: camera.to_owned(), width: 2, height: 2, rgb: (0..12).collect() };
        Observation {
            time_s: 0.0,
            vectors: vec![
                (vectors::JOINT_POSITIONS, (1..=7).map(f64::from).collect()),
                (vectors::GRIPPER_OPENING, vec![0.06]),
                // A rotation of 90 degrees about z.
                (vectors::TOOL_POSE, Pose::upright([0.1, 0.2, 0.3], std::f64::consts::FRAC_PI_2).to_array().to_vec()),
            ],
            images: vec![image("front"), image("wrist")],
        }
    }

    fn profile(change: impl Fn(String) -> String) -> Profile {
        let upright = Profile::built_in("pi0-libero").unwrap().replace("orientation = \"mirrored\"\n", "");
        let (head, tail) = upright.split_once("[tool]").unwrap();
        let (_, action) = tail.split_once("[action]").unwrap();
        Profile::from_toml(&change(format!("{head}[action]{action}"))).unwrap()
    }

    #[test]
    fn states_follow_the_profile() {
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
    fn image_axes_follow_the_profile() {
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
    fn history_is_the_first_axis() {
        let profile = profile(|text| {
            let text = text.replace("224", "2").replacen("width", "history = [-2, 0]\nwidth", 1);
            let parts = "\"tool_position\", \"tool_axis_angle\", \"gripper_fingers\"";
            text.replacen(parts, "\"gripper_opening\", \"zero\"]\nhistory = [-2, -1, 0", 1)
        });
        let mut past = History::new(&profile);
        for shade in [1, 2, 3, 4] {
            let mut now = observation();
            now.images[0].rgb.fill(shade);
            now.vectors[1].1 = vec![f64::from(shade)];
            past.push(&profile, &now).unwrap();
            let query = Query::with_buffers(&profile, &now, &past, "go", 0, &mut Buffers::default()).unwrap();
            assert_eq!(query.images[0].1.shape(), [2, 2, 2, 3]);
            let first = shade.saturating_sub(2).max(1);
            assert_eq!(query.images[0].1.data(), [[first; 12], [shade; 12]].concat());
            // The first state repeats until there are enough.
            let openings = [first, shade.saturating_sub(1).max(1), shade].map(|n| [f64::from(n), 0.0]);
            assert_eq!((query.states[0].1.shape(), query.states[0].1.numbers()), (&[3, 2][..], openings.concat()));
        }
    }

    #[test]
    fn wrong_image_sizes_are_errors() {
        let mut observation = observation();
        observation.images[0].rgb.pop();
        let error = Query::new(&profile(|text| text), &observation, "go", 0).unwrap_err().to_string();
        assert!(error.contains("`front` has 11 bytes, which does not match 2 x 2 pixels"), "{error}");
    }
}
