//! Model servers of vla-eval (protocol version 1): WebSocket, msgpack with text keys, each message with a number.
//!
//! The server greets with what its actions mean, keeps its own buffer of actions for each connection, and batches over
//! connections where it is told to. To `episode_start` it answers only if that fails; answers are found by number.

use std::time::{SystemTime, UNIX_EPOCH};

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::error::ServerError;
use super::exchange::{Chunk, Query};
use super::link::Link;
use super::msgpack::{self, Keys};
use super::profile::{Arm, Part, Profile, Rotation, Side};
use super::websocket::{Answer, Deadline, Socket};

/// A connection to such a server.
#[derive(Debug)]
pub(crate) struct VlaEval {
    socket: Socket,
    declared: Json,
    /// The number of the last message sent.
    number: u64,
    steps: u64,
    begun: bool,
}

impl VlaEval {
    pub(crate) fn connect(url: &str, profile: &Profile, deadline: Deadline) -> Result<Self, ServerError> {
        let socket = Socket::connect(url, deadline)?;
        let mut link = Self { socket, declared: Json::Null, number: 1, steps: 0, begun: false };
        let hello = msgpack::map([
            ("harness_version", ValueRef::from(env!("CARGO_PKG_VERSION"))),
            ("protocol_version", 1.into()),
            ("benchmark", "robogate".into()),
        ]);
        let answer = link.socket.ask(&message("hello", hello, 1, now()), "hello", deadline)?;
        let Answer::Bytes(bytes) = answer else {
            return Err(ServerError::undecodable("the answer to hello", "it is text"));
        };
        if msgpack::decode("the answer to hello", &bytes).is_ok_and(|value| msgpack::get(&value, "type").is_none()) {
            return Err(ServerError::OtherDialect {
                wanted: "vla-eval",
                found:
                    "the WebSocket there sends a map without a `type`, as openpi's does on connection (dialect openpi)"
                        .to_owned(),
            });
        }
        link.declared = decode(&bytes, 1, "hello", |payload| Ok(msgpack::to_json(payload)))?.ok_or_else(|| {
            ServerError::undecodable("the answer to hello", "it is the answer to something else".to_owned())
        })?;
        compare(&link.declared, profile)?;
        Ok(link)
    }

    fn next(&mut self) -> u64 {
        self.number += 1;
        self.number
    }
}

impl Link for VlaEval {
    fn begin(&mut self, instruction: &str, episode: u64, deadline: Deadline) -> Result<(), ServerError> {
        if std::mem::replace(&mut self.begun, true) {
            let payload = msgpack::map([
                ("metrics", ValueRef::Map(Vec::new())),
                ("steps", self.steps.into()),
                ("elapsed_sec", 0.0.into()),
            ]);
            let end = message("episode_end", payload, self.next(), now());
            self.socket.tell(&end, "episode_end", deadline)?;
        }
        self.steps = 0;
        let task = msgpack::map([
            ("name", ValueRef::from(instruction)),
            ("suite", "robogate".into()),
            ("task_id", 0.into()),
            ("episode_idx", episode.into()),
        ]);
        let start = message("episode_start", msgpack::map([("task", task)]), self.next(), now());
        self.socket.tell(&start, "episode_start", deadline)
    }

    fn ask(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, ServerError> {
        let number = self.next();
        self.steps += 1;
        let question = message("observation", observation(query), number, now());
        let mut answer = self.socket.ask(&question, "observation", deadline)?;
        loop {
            let Answer::Bytes(bytes) = &answer else {
                return Err(ServerError::undecodable("the answer to an observation", "it is text".to_owned()));
            };
            if let Some(chunk) = decode(bytes, number, "action", actions)? {
                return Ok(chunk);
            }
            answer = self.socket.hear("observation", deadline)?;
        }
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

/// Seconds since 1970, for the server's log.
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |t| t.as_secs_f64())
}

/// A message.
fn message<'a>(kind: &'a str, payload: ValueRef<'a>, number: u64, timestamp: f64) -> ValueRef<'a> {
    msgpack::map([("type", kind.into()), ("payload", payload), ("seq", number.into()), ("timestamp", timestamp.into())])
}

/// The payload of a question. Pictures go as they are: vla-eval's own client packs them as PNG, its server takes both.
fn observation(query: &Query) -> ValueRef<'_> {
    let arrays = |arrays| msgpack::arrays(arrays, Keys::Text);
    let images = ("images", msgpack::map(arrays(&query.images)));
    let task = ("task_description", query.instruction.as_str().into());
    msgpack::map([images, task].into_iter().chain(arrays(&query.states)))
}

/// The payload of a message of this kind; nothing if it answers something before the message of this number.
fn decode<T>(
    bytes: &[u8],
    number: u64,
    kind: &str,
    read: impl FnOnce(&ValueRef<'_>) -> Result<T, ServerError>,
) -> Result<Option<T>, ServerError> {
    const WHAT: &str = "a vla-eval message";
    let message = msgpack::decode(WHAT, bytes)?;
    let missing = |key: &str| ServerError::undecodable(WHAT, format!("its `{key}` is missing or of another type"));
    let got = msgpack::get(&message, "type").and_then(msgpack::name).ok_or_else(|| missing("type"))?;
    let payload = msgpack::get(&message, "payload").ok_or_else(|| missing("payload"))?;
    let seq = msgpack::get(&message, "seq").and_then(ValueRef::as_u64).ok_or_else(|| missing("seq"))?;
    // An episode that could not begin, or a question that could not be answered.
    if got == "error" {
        let text = msgpack::get(payload, "error").and_then(msgpack::name).unwrap_or("an error without words");
        return Err(ServerError::refused(text));
    }
    if seq < number {
        return Ok(None);
    }
    if seq > number || got != kind {
        return Err(ServerError::undecodable(
            WHAT,
            format!("a `{got}` of number {seq} in place of `{kind}` of number {number}"),
        ));
    }
    read(payload).map(Some)
}

/// The actions in a payload: one, or a chunk.
fn actions(payload: &ValueRef<'_>) -> Result<Chunk, ServerError> {
    const WHAT: &str = "an action";
    let actions = msgpack::get(payload, "actions")
        .ok_or_else(|| ServerError::undecodable(WHAT, "it has no `actions`".to_owned()))?;
    Chunk::of_array(&msgpack::read_array(WHAT, actions)?)
}

/// Holds what the server says its actions mean against the profile.
fn compare(declared: &Json, profile: &Profile) -> Result<(), ServerError> {
    let mismatch = |text: String| Err(ServerError::Mismatch(text));
    let form = &profile.action;
    if let Some(spec) = declared.get("action_spec").and_then(Json::as_object).filter(|spec| !spec.is_empty()) {
        let dims = |part: &Json| part.get("dims").and_then(Json::as_u64).unwrap_or(0);
        let sum: u64 = spec.values().map(dims).sum();
        if sum != form.size as u64 {
            return mismatch(format!(
                "the server's actions have {sum} numbers, the profile's action.size is {}",
                form.size
            ));
        }
        let format = |part: &str| spec.get(part).and_then(|p| p.get("format")).and_then(Json::as_str);
        if let Some(position @ ("delta_xyz" | "absolute_xyz")) = format("position")
            && (form.arm != Arm::ToolDelta || position == "absolute_xyz")
        {
            return mismatch(format!(
                "the server's positions are `{position}`, the profile's action.arm is {:?}",
                form.arm
            ));
        }
        if let Some(rotation) = format("rotation") {
            let ours = match form.rotation {
                Rotation::AxisAngle => "axis_angle",
                Rotation::Euler => "euler_xyz",
            };
            if rotation != ours {
                return mismatch(format!(
                    "the server's rotations are `{rotation}`, the profile's action.rotation is {ours}"
                ));
            }
        }
        let gripper = match format("gripper") {
            Some("binary_close_positive") => Some((-1.0, 1.0, Side::Below)),
            Some("binary_close_negative") => Some((-1.0, 1.0, Side::Above)),
            Some("binary_close_01") => Some((0.0, 1.0, Side::Below)),
            _ => None,
        };
        if let Some((low, high, open)) = gripper {
            let name = format("gripper").unwrap_or_default();
            if form.gripper_open != Some(open) {
                return mismatch(format!(
                    "the server's gripper is `{name}`, the profile's gripper_open says the opposite"
                ));
            }
            if let Some(threshold) = form.gripper_threshold.filter(|threshold| !(low..high).contains(threshold)) {
                return mismatch(format!(
                    "the server's gripper is `{name}`, the profile's gripper_threshold {threshold} is not between {low} and {high}"
                ));
            }
        }
    }
    let wanted = |key: &str| declared.get("observation_params").and_then(|p| p.get(key)).and_then(Json::as_bool);
    if wanted("send_wrist_image") == Some(true) && profile.cameras.len() < 2 {
        return mismatch("the server wants a wrist camera, the profile has one camera".to_owned());
    }
    if wanted("send_state") == Some(true) && profile.states.is_empty() {
        return mismatch("the server wants a state, the profile has none".to_owned());
    }
    let dims = declared
        .get("observation_spec")
        .and_then(|o| o.get("state"))
        .and_then(|s| s.get("dims"))
        .and_then(Json::as_u64);
    if let (Some(dims @ 1..), Some(state)) = (dims, profile.states.first()) {
        let size = state.size(0) as u64;
        if !state.parts.contains(&Part::JointPositions) && dims != size {
            return mismatch(format!("the server's state has {dims} numbers, the profile's {} has {size}", state.key));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Capture, fuzz, query};

    const FOLDER: &str = "vla_eval";

    fn captured<'a>(message: &'a ValueRef<'a>, key: &str) -> &'a ValueRef<'a> {
        msgpack::get(message, key).unwrap()
    }

    fn timestamp(message: &ValueRef<'_>) -> f64 {
        let ValueRef::F64(time) = captured(message, "timestamp") else { panic!("no time") };
        *time
    }

    #[test]
    fn messages_are_those_of_vla_evals_own_client_to_the_byte() {
        let capture = Capture::read(FOLDER, "c2s_05_obs_raw.bin");
        let theirs = capture.msgpack();
        let payload = captured(&theirs, "payload");
        let mut asked = query(captured(payload, "images"), "pick up the black bowl");
        asked.states = query(payload, "").states;
        assert_eq!((asked.images.len(), asked.states.len()), (2, 1));
        let ours = message("observation", observation(&asked), 6, timestamp(&theirs));
        assert_eq!(msgpack::encode(&ours), capture.bytes);
        let capture = Capture::read(FOLDER, "c2s_10_episode_end.bin");
        let metrics = msgpack::map([("success", ValueRef::Boolean(true))]);
        let payload = msgpack::map([("metrics", metrics), ("steps", 5.into()), ("elapsed_sec", 1.25.into())]);
        let ours = message("episode_end", payload, 11, timestamp(&capture.msgpack()));
        assert_eq!(msgpack::encode(&ours), capture.bytes);
    }

    #[test]
    fn answers_of_vla_evals_own_server_are_understood() {
        let action = Capture::read(FOLDER, "s2c_01_action0.bin").bytes;
        let chunk = decode(&action, 3, "action", actions).unwrap().unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (1, 7));
        // It answers number 3: to whoever asked number 4 it comes late.
        assert_eq!(decode(&action, 4, "action", actions).unwrap(), None);
        assert!(decode(&action, 2, "action", actions).is_err());
        let error = Capture::read(FOLDER, "s2c_07_error_observation_failed.bin").bytes;
        let error = decode(&error, 9, "action", actions).unwrap_err().to_string();
        assert!(error.contains("observation_failed: ValueError: bad obs"), "{error}");
    }

    #[test]
    fn what_the_server_says_its_actions_mean_is_held_against_the_profile() {
        let hello = Capture::read(FOLDER, "s2c_00_hello_reply.bin").bytes;
        let declared = decode(&hello, 1, "hello", |payload| Ok(msgpack::to_json(payload))).unwrap().unwrap();
        let good = Profile::from_toml(Profile::built_in("smolvla-vla-eval").unwrap()).unwrap();
        compare(&declared, &good).unwrap();
        let wrong = |change: &dyn Fn(&mut Profile)| {
            let mut profile = good.clone();
            change(&mut profile);
            compare(&declared, &profile).unwrap_err().to_string()
        };
        assert!(wrong(&|p| p.action.gripper_open = Some(Side::Above)).contains("the opposite"));
        assert!(wrong(&|p| p.action.gripper_threshold = Some(2.0)).contains("not between -1 and 1"));
        assert!(wrong(&|p| p.action.rotation = Rotation::Euler).contains("`axis_angle`"));
        assert!(wrong(&|p| p.action.size = 8).contains("have 7 numbers"));
        assert!(wrong(&|p| p.cameras.truncate(1)).contains("wrist camera"));
        assert!(wrong(&|p| p.states[0].parts.truncate(1)).contains("has 8 numbers"));
    }

    #[test]
    fn whatever_bytes_come_decoding_returns() {
        let profile = Profile::from_toml(Profile::built_in("smolvla-vla-eval").unwrap()).unwrap();
        let seeds = ["s2c_00_hello_reply.bin", "s2c_01_action0.bin", "s2c_07_error_observation_failed.bin"];
        let seeds = seeds.map(|n| Capture::read(FOLDER, n).bytes);
        fuzz(&seeds, |bytes| {
            let _ = decode(bytes, 3, "action", actions);
            let hello = decode(bytes, 1, "hello", |payload| Ok(msgpack::to_json(payload)));
            let _ = hello.map(|declared| declared.map(|declared| compare(&declared, &profile)));
        });
    }
}
