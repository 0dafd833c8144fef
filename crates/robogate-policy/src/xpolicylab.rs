//! XPolicyLab's WebSocket server (`client_server/ws`): numbered frames of msgpack, arrays as the package msgpack-numpy writes them.
//!
//! The server has one model for all clients. A reply to `infer` is a list of actions, each a map of parts such as
//! `left_arm_joint_state`. An error is a frame too.

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::access::Access;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::msgpack;
use super::websocket::{Reply, Socket};
use super::{chunk::Chunk, query::Query};

const WHAT: &str = "frame of the server";

/// A connection to an XPolicyLab server.
#[derive(Debug)]
pub(crate) struct XPolicyLab {
    socket: Socket,
    declared: Json,
    action_keys: Vec<String>,
    /// Number of the last frame sent.
    number: u64,
    trial: String,
    step: u64,
}

impl XPolicyLab {
    pub(crate) fn connect(
        url: &str,
        action_keys: Vec<String>,
        access: &Access,
        deadline: Deadline,
    ) -> Result<Self, PolicyError> {
        let socket = Socket::connect(url, access.header("Bearer"), access, deadline)?;
        let (trial, declared) = (String::new(), Json::Null);
        let mut connection = Self { socket, declared, action_keys, number: 0, trial, step: 0 };
        let declared = connection.ask("hello", "hello_ack", ValueRef::Map(Vec::new()), deadline, |payload, _| {
            Ok(msgpack::to_json(payload))
        })?;
        Ok(Self { declared, ..connection })
    }

    /// Sends a frame, and reads the payload of the reply.
    fn ask<T>(
        &mut self,
        kind: &'static str,
        reply_kind: &'static str,
        payload: ValueRef<'_>,
        deadline: Deadline,
        read: impl FnOnce(&ValueRef<'_>, &[String]) -> Result<T, PolicyError>,
    ) -> Result<T, PolicyError> {
        self.number += 1;
        let number = self.number.to_string();
        let request = frame(kind, &number, &self.trial, self.step, payload);
        match self.socket.request(&request, kind, deadline)? {
            Reply::Bytes(bytes) => decode(&bytes, &number, reply_kind, |payload| read(payload, &self.action_keys)),
            Reply::Text(_) => Err(PolicyError::invalid_reply(WHAT, "expected a binary message")),
        }
    }
}

impl Connection for XPolicyLab {
    fn begin(&mut self, _: &str, episode: u64, deadline: Deadline) -> Result<(), PolicyError> {
        (self.trial, self.step) = (episode.to_string(), 0);
        let trial = self.trial.clone();
        self.ask("reset", "reset_result", msgpack::map([("trial_id", (&*trial).into())]), deadline, |_, _| Ok(()))
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        let chunk = self.ask("infer", "infer_result", observation(query), deadline, actions)?;
        self.step += 1;
        Ok(chunk)
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

/// A frame, with the fields of upstream's client. The server fills in the time.
fn frame<'a>(kind: &'a str, number: &'a str, trial: &'a str, step: u64, payload: ValueRef<'a>) -> ValueRef<'a> {
    let trial = if trial.is_empty() { ValueRef::Nil } else { trial.into() };
    msgpack::map([
        ("message_type", kind.into()),
        ("evaluation_id", "robogate".into()),
        ("action_case_id", ValueRef::Nil),
        ("trial_id", trial),
        ("repeat_index", ValueRef::Nil),
        ("step", step.into()),
        ("sent_at", ValueRef::Nil),
        ("message_id", number.into()),
        ("payload", payload),
    ])
}

/// The payload of a request for actions: XPolicyLab's observation format 1.0.
fn observation(query: &Query) -> ValueRef<'_> {
    let vision =
        query.images.iter().map(|(key, image)| (key.as_str(), msgpack::map([("color", msgpack::numpy(image, 0))])));
    let state = query.states.iter().map(|(key, state)| (key.as_str(), msgpack::numpy(state, 0)));
    let seen = msgpack::map([
        ("instruction", query.instruction.as_str().into()),
        ("vision", msgpack::map(vision)),
        ("state", msgpack::map(state)),
    ]);
    msgpack::map([("observation", seen)])
}

/// Decode the payload of a frame of this kind that answers the request of this number.
fn decode<T>(
    bytes: &[u8],
    number: &str,
    kind: &str,
    read: impl FnOnce(&ValueRef<'_>) -> Result<T, PolicyError>,
) -> Result<T, PolicyError> {
    let reply = msgpack::decode(WHAT, bytes)?;
    let text = |key: &str| msgpack::get(&reply, key).and_then(msgpack::name);
    let payload = msgpack::get(&reply, "payload");
    let Some(found) = text("message_type") else {
        return Err(PolicyError::WrongDialect {
            expected: "xpolicylab",
            found:
                "the WebSocket server sends a map without `message_type`, which is typical of openpi (dialect openpi)"
                    .to_owned(),
        });
    };
    if found == "error" {
        let message = payload.and_then(|payload| msgpack::get(payload, "message")).and_then(msgpack::name);
        return Err(PolicyError::reported(message.unwrap_or("the server sent an error without a message")));
    }
    if found != kind || text("message_id") != Some(number) {
        return Err(PolicyError::invalid_reply(WHAT, format!("expected `{kind}` for request {number}, got `{found}`")));
    }
    let empty = ValueRef::Map(Vec::new());
    read(payload.unwrap_or(&empty))
}

/// The actions of a reply: the parts of each action in the order of the keys, or an array.
fn actions(payload: &ValueRef<'_>, keys: &[String]) -> Result<Chunk, PolicyError> {
    let wrong = |why: String| PolicyError::invalid_reply(WHAT, why);
    let found = msgpack::get(payload, "actions").ok_or_else(|| wrong("`actions` is missing".to_owned()))?;
    let ValueRef::Array(list) = found else { return Chunk::of_array(&msgpack::read_numpy(WHAT, found)?) };
    let row = |action: &ValueRef<'_>| -> Result<Vec<f64>, PolicyError> {
        let mut row = Vec::new();
        for key in keys {
            let part = msgpack::get(action, key).ok_or_else(|| {
                let known =
                    msgpack::entries(action).unwrap_or_default().iter().filter_map(|(key, _)| msgpack::name(key));
                let known: Vec<&str> = known.take(8).collect();
                wrong(format!("an action has no `{key}` (dialect.action_keys). It has: {}", known.join(", ")))
            })?;
            match part {
                ValueRef::F32(number) => row.push(f64::from(*number)),
                ValueRef::F64(number) => row.push(*number),
                _ => row.extend(msgpack::read_numpy(WHAT, part)?.numbers()),
            }
        }
        Ok(row)
    };
    Chunk::of_rows(list.iter().map(row).collect::<Result<_, _>>()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::array::Array;
    use crate::tests::Capture;

    const FOLDER: &str = "xpolicylab";

    fn keys() -> Vec<String> {
        ["left_arm", "left_ee", "right_arm", "right_ee"].map(|part| format!("{part}_joint_state")).to_vec()
    }

    /// The entries of a frame without its time.
    fn without_time(bytes: &[u8]) -> Vec<String> {
        let value = msgpack::decode("frame", bytes).unwrap();
        let entries = msgpack::entries(&value).unwrap().iter();
        entries.map(|(key, value)| format!("{key} {value}")).filter(|text| !text.contains("sent_at")).collect()
    }

    #[test]
    fn requests_equal_captured_ones() {
        let sent = |name: &str, kind: &str, trial: &str, payload: &dyn Fn(&ValueRef<'_>) -> Vec<u8>| {
            let capture = Capture::read(FOLDER, name);
            let asked = capture.msgpack();
            let number = msgpack::get(&asked, "message_id").and_then(msgpack::name).unwrap();
            let payload = payload(msgpack::get(&asked, "payload").unwrap());
            let payload = msgpack::decode("payload", &payload).unwrap();
            let ours = msgpack::encode(&frame(kind, number, trial, 0, payload));
            assert_eq!(without_time(&ours), without_time(&capture.bytes), "{name}");
        };
        sent("c2s_00_hello.bin", "hello", "", &|_| msgpack::encode(&ValueRef::Map(Vec::new())));
        sent("c2s_01_reset.bin", "reset", "0", &|_| msgpack::encode(&msgpack::map([("trial_id", "0".into())])));
        sent("c2s_02_infer_4x4.bin", "infer", "0", &|asked| {
            let seen = msgpack::get(asked, "observation").unwrap();
            let parts = |key: &str, inner: Option<&str>| -> Vec<(String, Array)> {
                let entries = msgpack::entries(msgpack::get(seen, key).unwrap()).unwrap().iter();
                let value = |value| inner.map_or(Some(value), |inner| msgpack::get(value, inner)).unwrap();
                entries
                    .map(|(key, part)| {
                        (msgpack::name(key).unwrap().to_owned(), msgpack::read_numpy("capture", value(part)).unwrap())
                    })
                    .collect()
            };
            let (images, states) = (parts("vision", Some("color")), parts("state", None));
            let instruction = "stack the bowls".to_owned();
            msgpack::encode(&observation(&Query { images, states, instruction, step: 0, time_s: 0.0 }))
        });
    }

    #[test]
    fn captured_replies_are_decoded() {
        let read = |name: &str, kind: &str, keys: &[String]| {
            let capture = Capture::read(FOLDER, name);
            let number = msgpack::get(&capture.msgpack(), "message_id").and_then(msgpack::name).unwrap().to_owned();
            decode(&capture.bytes, &number, kind, |payload| actions(payload, keys))
        };
        let chunk = read("s2c_02_actions_5x14.bin", "infer_result", &keys()).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (5, 14));
        // What the stub of the live servers returns to its first request.
        assert!((chunk.rows()[0][0] - 0.212_461_18).abs() < 1e-6, "{:?}", chunk.rows()[0]);
        let error = read("s2c_03_error.bin", "infer_result", &keys()).unwrap_err().to_string();
        assert!(error.contains("the stub refuses this instruction"), "{error}");
        let error = read("s2c_02_actions_5x14.bin", "infer_result", &["ee_pose".to_owned()]).unwrap_err().to_string();
        assert!(error.contains("no `ee_pose`") && error.contains("left_ee_joint_state"), "{error}");
        let reset = Capture::read(FOLDER, "s2c_01_reset_result.bin").bytes;
        let error = decode(&reset, "1", "reset_result", |_| Ok(())).unwrap_err().to_string();
        assert!(error.contains("expected `reset_result` for request 1"), "{error}");
    }

    #[test]
    fn fuzzed_replies_are_read_or_refused() {
        let seeds = ["s2c_00_hello_ack.bin", "s2c_02_actions_5x14.bin", "s2c_03_error.bin"];
        let seeds = seeds.map(|name| Capture::read(FOLDER, name).bytes);
        let keys = keys();
        let number = |bytes: &[u8]| {
            let value = msgpack::decode("frame", bytes).ok()?;
            msgpack::get(&value, "message_id").and_then(msgpack::name).map(str::to_owned)
        };
        crate::tests::fuzz("xpolicylab", &seeds, |bytes| {
            let number = number(bytes).unwrap_or_default();
            let said = decode(bytes, &number, "hello_ack", |_| Ok(())).is_ok();
            let error = matches!(decode(bytes, &number, "", |_| Ok(())), Err(PolicyError::Reported { .. }));
            decode(bytes, &number, "infer_result", |payload| actions(payload, &keys)).is_ok() || said || error
        });
    }
}
