//! Model servers of vla-eval (protocol version 1): WebSocket, msgpack with string keys, numbered messages.
//!
//! The server describes its actions in the reply to `hello`. It keeps a buffer of actions for each connection, and can
//! batch requests of several connections. It answers `episode_start` only on failure. A reply has the number of its
//! request.

use std::time::{SystemTime, UNIX_EPOCH};

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::access::Access;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::msgpack::{self, Keys};
use super::profile::{Arm, Part, Profile, Rotation, Side};
use super::websocket::{Reply, Socket};
use super::{chunk::Chunk, query::Query};

/// A connection to a vla-eval server.
#[derive(Debug)]
pub(crate) struct VlaEval {
    socket: Socket,
    declared: Json,
    /// Number of the last message sent.
    number: u64,
    steps: u64,
    begun: bool,
}

impl VlaEval {
    pub(crate) fn connect(
        url: &str,
        expected: Option<&Profile>,
        access: &Access,
        deadline: Deadline,
    ) -> Result<Self, PolicyError> {
        let socket = Socket::connect(url, access.header("Bearer"), access, deadline)?;
        let mut connection = Self { socket, declared: Json::Null, number: 1, steps: 0, begun: false };
        let hello = msgpack::map([
            ("harness_version", ValueRef::from(env!("CARGO_PKG_VERSION"))),
            ("protocol_version", 1.into()),
            ("benchmark", "robogate".into()),
        ]);
        let reply = connection.socket.request(&message("hello", hello, 1, now()), "hello", deadline)?;
        let Reply::Bytes(bytes) = reply else {
            return Err(PolicyError::invalid_reply("reply to hello", "expected a binary message"));
        };
        if msgpack::decode("reply to hello", &bytes).is_ok_and(|value| msgpack::get(&value, "type").is_none()) {
            return Err(PolicyError::WrongDialect {
                expected: "vla-eval",
                found: "the WebSocket server sends a map without `type`, which is typical of openpi (dialect openpi)"
                    .to_owned(),
            });
        }
        connection.declared = decode(&bytes, 1, "hello", |payload| Ok(msgpack::to_json(payload)))?
            .ok_or_else(|| PolicyError::invalid_reply("reply to hello", "the number is that of another request"))?;
        if let Some(profile) = expected {
            compare(&connection.declared, profile)?;
        }
        Ok(connection)
    }

    fn next_number(&mut self) -> u64 {
        self.number += 1;
        self.number
    }
}

impl Connection for VlaEval {
    fn begin(&mut self, instruction: &str, episode: u64, deadline: Deadline) -> Result<(), PolicyError> {
        if std::mem::replace(&mut self.begun, true) {
            let payload = msgpack::map([
                ("metrics", ValueRef::Map(Vec::new())),
                ("steps", self.steps.into()),
                ("elapsed_sec", 0.0.into()),
            ]);
            let end = message("episode_end", payload, self.next_number(), now());
            self.socket.send(&end, "episode_end", deadline)?;
        }
        self.steps = 0;
        let task = msgpack::map([
            ("name", ValueRef::from(instruction)),
            ("suite", "robogate".into()),
            ("task_id", 0.into()),
            ("episode_idx", episode.into()),
        ]);
        let start = message("episode_start", msgpack::map([("task", task)]), self.next_number(), now());
        self.socket.send(&start, "episode_start", deadline)
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        let number = self.next_number();
        self.steps += 1;
        let request = message("observation", observation(query), number, now());
        let mut reply = self.socket.request(&request, "observation", deadline)?;
        loop {
            let Reply::Bytes(bytes) = &reply else {
                return Err(PolicyError::invalid_reply("reply to observation", "expected a binary message"));
            };
            if let Some(chunk) = decode(bytes, number, "action", actions)? {
                return Ok(chunk);
            }
            reply = self.socket.receive("observation", deadline)?;
        }
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

/// Seconds since 1970. The server writes them to its log.
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |t| t.as_secs_f64())
}

/// A message.
fn message<'a>(kind: &'a str, payload: ValueRef<'a>, number: u64, timestamp: f64) -> ValueRef<'a> {
    msgpack::map([("type", kind.into()), ("payload", payload), ("seq", number.into()), ("timestamp", timestamp.into())])
}

/// Encode the payload of a request. Images are sent uncompressed. vla-eval's client sends PNG; its server accepts both.
fn observation(query: &Query) -> ValueRef<'_> {
    let arrays = |arrays| msgpack::arrays(arrays, Keys::Text);
    let images = ("images", msgpack::map(arrays(&query.images)));
    let task = ("task_description", query.instruction.as_str().into());
    msgpack::map([images, task].into_iter().chain(arrays(&query.states)))
}

/// Decode the payload of a message of this kind. Returns `None` for a reply to an earlier request.
fn decode<T>(
    bytes: &[u8],
    number: u64,
    kind: &str,
    read: impl FnOnce(&ValueRef<'_>) -> Result<T, PolicyError>,
) -> Result<Option<T>, PolicyError> {
    const WHAT: &str = "vla-eval message";
    let message = msgpack::decode(WHAT, bytes)?;
    let missing = |key: &str| PolicyError::invalid_reply(WHAT, format!("`{key}` is missing or has the wrong type"));
    let got = msgpack::get(&message, "type").and_then(msgpack::name).ok_or_else(|| missing("type"))?;
    let payload = msgpack::get(&message, "payload").ok_or_else(|| missing("payload"))?;
    let seq = msgpack::get(&message, "seq").and_then(ValueRef::as_u64).ok_or_else(|| missing("seq"))?;
    // The episode could not begin, or the request failed.
    if got == "error" {
        let text = msgpack::get(payload, "error").and_then(msgpack::name).unwrap_or("an error without a message");
        return Err(PolicyError::reported(text));
    }
    if seq < number {
        return Ok(None);
    }
    if seq > number || got != kind {
        return Err(PolicyError::invalid_reply(
            WHAT,
            format!("expected `{kind}` with number {number}, got `{got}` with number {seq}"),
        ));
    }
    read(payload).map(Some)
}

/// Decode the actions of a payload: one action or a chunk.
fn actions(payload: &ValueRef<'_>) -> Result<Chunk, PolicyError> {
    const WHAT: &str = "vla-eval action";
    let actions = msgpack::get(payload, "actions")
        .ok_or_else(|| PolicyError::invalid_reply(WHAT, "`actions` is missing".to_owned()))?;
    Chunk::of_array(&msgpack::read_array(WHAT, actions)?)
}

/// Check the server's description of its actions against the profile.
fn compare(declared: &Json, profile: &Profile) -> Result<(), PolicyError> {
    let mismatch = |text: String| Err(PolicyError::Mismatch(text));
    let form = &profile.action;
    if let Some(spec) = declared.get("action_spec").and_then(Json::as_object).filter(|spec| !spec.is_empty()) {
        // Size 0 means that the server does not say.
        let dims = |part: &Json| part.get("dims").and_then(Json::as_u64).filter(|dims| *dims > 0);
        let sizes: Vec<Option<u64>> = spec.values().map(dims).collect();
        let sum: u64 = sizes.iter().flatten().sum();
        let all = sizes.iter().all(Option::is_some);
        if (all && sum != form.size as u64) || sum > form.size as u64 {
            return mismatch(format!(
                "the actions of the server have {sum} numbers, but action.size of the profile is {}",
                form.size
            ));
        }
        let format = |part: &str| spec.get(part).and_then(|p| p.get("format")).and_then(Json::as_str);
        let fits = match format("position") {
            Some("delta_xyz") => matches!(form.arm, Arm::ToolDelta | Arm::OscPose),
            Some("absolute_xyz") => form.arm == Arm::ToolPose,
            _ => true,
        };
        if !fits {
            return mismatch(format!(
                "the positions of the server are `{}`, but action.arm of the profile is {}",
                format("position").unwrap_or_default(),
                form.arm.as_str()
            ));
        }
        if let Some(rotation) = format("rotation").filter(|format| *format != "raw") {
            let ours = match form.rotation {
                Rotation::AxisAngle => "axis_angle",
                Rotation::Euler => "euler_xyz",
                Rotation::QuaternionXyzw => "quaternion_xyzw",
                Rotation::QuaternionWxyz => "quaternion_wxyz",
                Rotation::Rot6dColumns => "rot6d_contiguous",
                Rotation::Rot6dInterleaved => "rot6d_interleaved",
                Rotation::Rot6dRows => "rot6d_rows",
            };
            if rotation != ours {
                return mismatch(format!(
                    "the rotations of the server are `{rotation}`, but action.rotation of the profile is {ours}"
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
                    "the gripper of the server is `{name}`, but action.gripper_open of the profile is the opposite"
                ));
            }
            if let Some(threshold) = form.gripper_threshold.filter(|threshold| !(low..high).contains(threshold)) {
                return mismatch(format!(
                    "the gripper of the server is `{name}`, but action.gripper_threshold of the profile is {threshold}. Expected a number from {low} to below {high}"
                ));
            }
        }
    }
    let wanted = |key: &str| declared.get("observation_params").and_then(|p| p.get(key)).and_then(Json::as_bool);
    if wanted("send_wrist_image") == Some(true) && profile.cameras.len() < 2 {
        return mismatch("the server requires a wrist camera, but the profile has one camera".to_owned());
    }
    if wanted("send_state") == Some(true) && profile.states.is_empty() {
        return mismatch("the server requires a state, but the profile has none".to_owned());
    }
    let dims = declared
        .get("observation_spec")
        .and_then(|o| o.get("state"))
        .and_then(|s| s.get("dims"))
        .and_then(Json::as_u64);
    if let (Some(dims @ 1..), Some(state)) = (dims, profile.states.first()) {
        let size = state.size(0) as u64;
        if !state.parts.contains(&Part::JointPositions) && dims != size {
            return mismatch(format!(
                "the state of the server has {dims} numbers, but {} of the profile has {size}",
                state.key
            ));
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
    fn messages_equal_captured_ones() {
        let capture = Capture::read(FOLDER, "c2s_05_obs_raw.bin");
        let theirs = capture.msgpack();
        let payload = captured(&theirs, "payload");
        let mut request = query(captured(payload, "images"), "pick up the black bowl");
        request.states = query(payload, "").states;
        assert_eq!((request.images.len(), request.states.len()), (2, 1));
        let ours = message("observation", observation(&request), 6, timestamp(&theirs));
        assert_eq!(msgpack::encode(&ours), capture.bytes);
        let capture = Capture::read(FOLDER, "c2s_10_episode_end.bin");
        let metrics = msgpack::map([("success", ValueRef::Boolean(true))]);
        let payload = msgpack::map([("metrics", metrics), ("steps", 5.into()), ("elapsed_sec", 1.25.into())]);
        let ours = message("episode_end", payload, 11, timestamp(&capture.msgpack()));
        assert_eq!(msgpack::encode(&ours), capture.bytes);
    }

    #[test]
    fn captured_replies_are_decoded() {
        let action = Capture::read(FOLDER, "s2c_01_action0.bin").bytes;
        let chunk = decode(&action, 3, "action", actions).unwrap().unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (1, 7));
        // A reply to request 3 is too late for a client that waits for number 4.
        assert_eq!(decode(&action, 4, "action", actions).unwrap(), None);
        assert!(decode(&action, 2, "action", actions).is_err());
        let error = Capture::read(FOLDER, "s2c_07_error_observation_failed.bin").bytes;
        let error = decode(&error, 9, "action", actions).unwrap_err().to_string();
        assert!(error.contains("observation_failed: ValueError: bad obs"), "{error}");
    }

    #[test]
    fn descriptions_are_compared_with_the_profile() {
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
        assert!(wrong(&|p| p.action.gripper_threshold = Some(2.0)).contains("from -1 to below 1"));
        assert!(wrong(&|p| p.action.rotation = Rotation::Euler).contains("`axis_angle`"));
        assert!(wrong(&|p| p.action.size = 8).contains("have 7 numbers"));
        // A server that does not say its sizes and formats fits every profile.
        let raw = serde_json::json!({"actions": {"name": "actions", "dims": 0, "format": "raw"}});
        compare(&serde_json::json!({"action_spec": raw}), &good).unwrap();
        assert!(wrong(&|p| p.cameras.truncate(1)).contains("wrist camera"));
        assert!(wrong(&|p| p.states[0].parts.truncate(1)).contains("has 8 numbers"));
    }

    #[test]
    fn fuzzed_replies_are_read_or_refused() {
        let profile = Profile::from_toml(Profile::built_in("smolvla-vla-eval").unwrap()).unwrap();
        let seeds = ["s2c_00_hello_reply.bin", "s2c_01_action0.bin"].map(|n| Capture::read(FOLDER, n).bytes);
        fuzz("vla_eval replies", &seeds, |bytes| {
            let hello = decode(bytes, 1, "hello", |payload| Ok(msgpack::to_json(payload)));
            let declared = hello.is_ok_and(|declared| {
                let _ = declared.map(|declared| compare(&declared, &profile));
                true
            });
            decode(bytes, 3, "action", actions).is_ok() || declared
        });
    }
}
