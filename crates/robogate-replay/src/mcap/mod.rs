//! An episode as an MCAP file with Foxglove's schemas, encoded as JSON.
//!
//! | topic | schema | content |
//! |---|---|---|
//! | `/tf` | `foxglove.FrameTransforms` | pose of each body in the robot's base frame |
//! | `/scene` | `foxglove.SceneUpdate` | shapes of the bodies |
//! | `/contacts/arrows` | `foxglove.SceneUpdate` | normal forces as arrows |
//! | `/contacts` | `robogate.Contacts` | contact points and forces as numbers |
//! | `/joint_states` | `foxglove.JointStates` | positions (rad) and velocities (rad/s) |
//! | `/joint_commands` | `foxglove.JointStates` | commanded joint positions |
//! | `/command` | `robogate.Command` | the action of the policy |
//! | `/observation` | `robogate.Observation` | all observed vectors |
//! | `/measures` | `robogate.Measures` | the task's measures |
//! | `/log` | `foxglove.Log` | phases, events and the outcome |
//! | `/camera/NAME` | `foxglove.CompressedImage` | images as PNG |
//!
//! Times are simulated times from the start of the episode.

mod cdr;
mod file;
mod reader;
mod scene;
mod schemas;

use base64ct::{Base64, Encoding};
use robogate_core::{Action, Command, Measures, Observation, Outcome, TaskSpec, Tick};
use serde_json::{Value, json};

use crate::Recording;
use file::File;
pub use reader::{McapMessage, read_mcap};

/// The frame in which poses are given.
const ROOT: &str = "base_frame";
/// The level of information in a log.
const INFORMATION: u8 = 2;
/// The level of errors in a log.
const ERROR: u8 = 4;

/// One control period: what the policy saw and did, and the measures at its end.
#[derive(Debug, Clone)]
pub struct Sample {
    /// The observation without images.
    pub observation: Observation,
    /// The action.
    pub action: Action,
    /// Simulated time at the end, in seconds.
    pub end_s: f64,
    /// The measures at the end.
    pub measures: Measures,
}

impl Sample {
    /// Copies a control period.
    pub fn of(tick: &Tick<'_>) -> Self {
        let Observation { time_s, vectors, .. } = tick.observation;
        Self {
            observation: Observation { time_s: *time_s, vectors: vectors.clone(), images: Vec::new() },
            action: tick.action.clone(),
            end_s: tick.step.observation.time_s,
            measures: tick.step.measures.clone(),
        }
    }
}

/// An encoded image of a camera.
#[derive(Debug, Clone)]
pub struct EncodedImage {
    /// Simulated time in seconds.
    pub time_s: f64,
    /// The camera.
    pub camera: String,
    /// A PNG file.
    pub png: Vec<u8>,
}

/// An episode with all that is exported.
#[derive(Debug)]
pub struct Export<'a> {
    /// The task.
    pub task: &'a TaskSpec,
    /// The recorded episode.
    pub recording: &'a Recording,
    /// Its control periods.
    pub samples: &'a [Sample],
    /// Its images.
    pub images: &'a [EncodedImage],
    /// Names and values for the file's metadata.
    pub metadata: Vec<(String, String)>,
}

/// A time as Foxglove writes it.
fn stamp(time_s: f64) -> Value {
    let ns = nanoseconds(time_s);
    json!({ "sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000 })
}

/// The conversion saturates; simulated times are not negative.
fn nanoseconds(time_s: f64) -> u64 {
    (time_s * 1e9).round() as u64
}

/// Writes an episode as MCAP. Equal episodes give equal bytes.
pub fn mcap(export: &Export<'_>) -> Vec<u8> {
    let mut file = File::default();
    motion(&mut file, export.recording);
    samples(&mut file, export.task, export.samples);
    log(&mut file, export.recording);
    for image in export.images {
        let channel = file.channel(&format!("/camera/{}", image.camera), schemas::compressed_image());
        let data = Base64::encode_string(&image.png);
        let message =
            json!({ "timestamp": stamp(image.time_s), "frame_id": image.camera, "data": data, "format": "png" });
        file.message(channel, nanoseconds(image.time_s), &message);
    }
    file.metadata("robogate", export.metadata.clone());
    file.finish()
}

/// Poses, shapes and contacts.
fn motion(file: &mut File, recording: &Recording) {
    let Some(trajectory) = &recording.trajectory else { return };
    let frames = frame_names(&trajectory.bodies);
    let poses = file.channel("/tf", schemas::frame_transforms());
    let shapes = file.channel("/scene", schemas::scene_update());
    let arrows = file.channel("/contacts/arrows", schemas::scene_update());
    let contacts = file.channel("/contacts", schemas::contacts());
    let begin_s = trajectory.frames.first().map_or(0.0, |frame| frame.time_s);
    file.message(shapes, nanoseconds(begin_s), &scene::bodies(trajectory, &frames, begin_s));
    for frame in &trajectory.frames {
        let (time_s, at) = (frame.time_s, nanoseconds(frame.time_s));
        let transforms: Vec<Value> = frames
            .iter()
            .zip(&frame.poses)
            .map(|(name, pose)| {
                json!({
                    "timestamp": stamp(time_s),
                    "parent_frame_id": ROOT,
                    "child_frame_id": name,
                    "translation": scene::vector(pose.position),
                    "rotation": scene::rotation(pose.orientation),
                })
            })
            .collect();
        file.message(poses, at, &json!({ "transforms": transforms }));
        file.message(arrows, at, &scene::arrows(&frame.contacts, time_s));
        file.message(contacts, at, &scene::contacts(&frame.contacts, time_s));
    }
}

/// Names of frames: those of the bodies, with a number where a name is used already.
fn frame_names(bodies: &[String]) -> Vec<String> {
    let mut names: Vec<String> = vec![ROOT.to_owned()];
    for body in bodies {
        let numbered = (2..).map(|n| format!("{body} {n}"));
        let free = std::iter::once(body.clone()).chain(numbered).find(|name| !names.contains(name));
        names.extend(free);
    }
    names.split_off(1)
}

/// Observations, commands and measures.
fn samples(file: &mut File, task: &TaskSpec, samples: &[Sample]) {
    let vectors = || task.observation.vectors.iter().map(|spec| spec.name.as_str());
    let measures = || task.measures.iter().map(|spec| spec.name.as_str());
    for sample in samples {
        let Sample { observation, action, end_s, measures: measured } = sample;
        let (time_s, at) = (observation.time_s, nanoseconds(observation.time_s));
        let (positions, velocities) = (observation.joint_positions(), observation.joint_velocities());
        if !positions.is_empty() {
            let joints = joints(task, positions, velocities);
            let channel = file.channel("/joint_states", schemas::joint_states());
            file.message(channel, at, &json!({ "timestamp": stamp(time_s), "joints": joints }));
        }
        if let Command::JointPosition(wanted) = &action.command {
            let joints = joints(task, wanted, &[]);
            let channel = file.channel("/joint_commands", schemas::joint_states());
            file.message(channel, at, &json!({ "timestamp": stamp(time_s), "joints": joints }));
        }
        let channel = file.channel("/command", schemas::command());
        file.message(channel, at, &command(action, time_s));
        let mut all = json!({ "timestamp": stamp(time_s) });
        for (name, values) in &observation.vectors {
            all[name.as_str()] = json!(values);
        }
        let channel = file.channel("/observation", schemas::observation(vectors()));
        file.message(channel, at, &all);
        if !task.measures.is_empty() {
            let mut all = json!({ "timestamp": stamp(*end_s) });
            for (name, value) in measured.iter() {
                all[name.as_str()] = json!(value);
            }
            let channel = file.channel("/measures", schemas::measures(measures()));
            file.message(channel, nanoseconds(*end_s), &all);
        }
    }
}

/// Joints by name. A task that does not name as many joints gets numbers.
fn joints(task: &TaskSpec, positions: &[f64], velocities: &[f64]) -> Vec<Value> {
    let names = task.action.joints().filter(|names| names.len() == positions.len());
    let one = |(i, position): (usize, &f64)| {
        let name = names.and_then(|names| names.get(i)).cloned().unwrap_or_else(|| format!("joint {}", i + 1));
        let mut joint = json!({ "name": name, "position": position });
        if let Some(velocity) = velocities.get(i) {
            joint["velocity"] = json!(velocity);
        }
        joint
    };
    positions.iter().enumerate().map(one).collect()
}

fn command(action: &Action, time_s: f64) -> Value {
    let kind = match &action.command {
        Command::JointPosition(_) => "joint_position",
        Command::ToolDelta { .. } => "tool_delta",
        Command::Vector(_) => "vector",
    };
    let mut message = json!({ "timestamp": stamp(time_s), "kind": kind, "values": action.command.numbers() });
    if let Some(gripper) = action.gripper {
        message["gripper"] = json!(gripper);
    }
    if let Some(phase) = action.phase {
        message["phase"] = json!(phase.as_str());
    }
    message
}

/// Phases, events and the outcome.
fn log(file: &mut File, recording: &Recording) {
    let channel = file.channel("/log", schemas::log());
    let mut line = |time_s: f64, level: u8, name: &str, message: &str| {
        let message = json!({
            "timestamp": stamp(time_s), "level": level, "message": message, "name": name, "file": "", "line": 0,
        });
        file.message(channel, nanoseconds(time_s), &message);
    };
    for phase in &recording.phases {
        line(phase.time_s, INFORMATION, "phase", &phase.what);
    }
    for event in &recording.events {
        line(event.time_s, INFORMATION, "event", &event.what);
    }
    let episode = &recording.episode;
    let level = if episode.outcome == Outcome::Success { INFORMATION } else { ERROR };
    let end_s = recording.tick_s.last().copied().unwrap_or_default();
    line(end_s, level, "outcome", &format!("{} at {:.3} s", episode.outcome.as_str(), episode.time_s));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_different_names() {
        let bodies = ["link", "base_frame", "link"].map(str::to_owned);
        assert_eq!(frame_names(&bodies), ["link", "base_frame 2", "link 2"]);
    }

    #[test]
    fn times_are_nanoseconds() {
        assert_eq!(stamp(2.05), json!({ "sec": 2, "nsec": 50_000_000 }));
    }
}
