//! StarVLA's WebSocket server (`deployment/model_server/server_policy.py`): the arrays of openpi, in a list of examples.
//!
//! The server sends its metadata on connection. It scales the actions back with the statistics of the training set, and keeps no
//! state between requests. A reply says whether the request succeeded; a text message is a Python traceback.

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::access::Access;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::msgpack::{self, Keys};
use super::openpi;
use super::websocket::{Reply, Socket};
use super::{chunk::Chunk, query::Query};

/// The kind of server in its metadata.
pub(crate) const ENV: &str = "starvla_policy_server";
/// The number of actions in its metadata.
pub(crate) const LENGTH: &str = "action_chunk_size";
/// What upstream's client for LIBERO asks of models with diffusion.
const DDIM_STEPS: u64 = 10;

/// A connection to a StarVLA server.
#[derive(Debug)]
pub(crate) struct StarVla {
    socket: Socket,
    declared: Json,
    unnorm_key: Option<String>,
}

impl StarVla {
    pub(crate) fn connect(
        url: &str,
        unnorm_key: Option<String>,
        access: &Access,
        deadline: Deadline,
    ) -> Result<Self, PolicyError> {
        let socket = Socket::connect(url, access.header("Api-Key"), access, deadline)?;
        let declared = match socket.receive("the metadata of the server", deadline)? {
            Reply::Bytes(bytes) => openpi::metadata(&bytes)?,
            Reply::Text(text) => return Err(openpi::text_error("metadata of the server", &text)),
        };
        check(&declared, unnorm_key.as_deref())?;
        Ok(Self { socket, declared, unnorm_key })
    }
}

/// Check the metadata of a server.
fn check(declared: &Json, unnorm_key: Option<&str>) -> Result<(), PolicyError> {
    if declared.get(LENGTH).is_none() {
        let found =
            format!("the server sends no `{LENGTH}` on connection, which is typical of openpi (dialect openpi)");
        return Err(PolicyError::WrongDialect { expected: "starvla", found });
    }
    let known: Option<Vec<&str>> = declared
        .get("available_unnorm_keys")
        .and_then(Json::as_array)
        .map(|keys| keys.iter().filter_map(Json::as_str).collect());
    match (known, unnorm_key) {
        (Some(known), Some(key)) if !known.contains(&key) => Err(PolicyError::Mismatch(format!(
            "the server has no statistics of `{key}` (dialect.unnorm_key). Expected one of: {}",
            known.join(", ")
        ))),
        (Some(known), None) if known.len() > 1 && declared.get("default_unnorm_key").is_none_or(Json::is_null) => {
            Err(PolicyError::Mismatch(format!(
                "the checkpoint has several training sets. Set dialect.unnorm_key in a copy of the profile to one of: {}",
                known.join(", ")
            )))
        }
        _ => Ok(()),
    }
}

impl Connection for StarVla {
    fn begin(&mut self, _: &str, _: u64, _: Deadline) -> Result<(), PolicyError> {
        self.socket.check_idle()
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        match self.socket.request(&request(query, self.unnorm_key.as_deref()), "predict_action", deadline)? {
            Reply::Bytes(bytes) => decode(&bytes),
            Reply::Text(text) => Err(openpi::text_error(WHAT, &text)),
        }
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

const WHAT: &str = "reply to predict_action";

/// The request for actions: one example, whose images are a list in the order of the profile. Vectors have the names of their keys,
/// and a first axis for the history.
fn request<'a>(query: &'a Query, unnorm_key: Option<&'a str>) -> ValueRef<'a> {
    let images = query.images.iter().map(|(_, image)| msgpack::array(image, Keys::Binary)).collect();
    let words = [("image", ValueRef::Array(images)), ("lang", query.instruction.as_str().into())];
    let example = msgpack::map(words.into_iter().chain(msgpack::arrays(&query.states, Keys::Binary)));
    msgpack::map([
        ("examples", ValueRef::Array(vec![example])),
        ("unnorm_key", unnorm_key.map_or(ValueRef::Nil, ValueRef::from)),
        ("do_sample", ValueRef::Boolean(false)),
        ("use_ddim", ValueRef::Boolean(true)),
        ("num_ddim_steps", DDIM_STEPS.into()),
    ])
}

/// Decode the actions of a reply.
fn decode(bytes: &[u8]) -> Result<Chunk, PolicyError> {
    let reply = msgpack::decode(WHAT, bytes)?;
    if let Some(error) = msgpack::get(&reply, "error") {
        let message = msgpack::get(error, "message").and_then(|message| match message {
            ValueRef::String(text) => text.as_str(),
            _ => None,
        });
        return Err(PolicyError::reported(message.unwrap_or("the server sent an error without a message")));
    }
    let actions = msgpack::get(&reply, "data").and_then(|data| msgpack::get(data, "actions"));
    let actions = actions.ok_or_else(|| PolicyError::invalid_reply(WHAT, "`data.actions` is missing".to_owned()))?;
    Chunk::of_array(&msgpack::read_array(WHAT, actions)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Capture, query};

    const FOLDER: &str = "starvla";

    #[test]
    fn requests_equal_captured_ones() {
        let capture = Capture::read(FOLDER, "c2s_00_predict_action_libero_4x4.bin");
        let asked = capture.msgpack();
        let Some(ValueRef::Array(examples)) = msgpack::get(&asked, "examples") else { panic!("no examples") };
        let Some(ValueRef::Array(images)) = msgpack::get(&examples[0], "image") else { panic!("no images") };
        let images =
            images.iter().map(|image| (String::new(), msgpack::read_array("capture", image).unwrap())).collect();
        let query = Query { images, ..query(&examples[0], "pick up the black bowl") };
        assert_eq!(msgpack::encode(&request(&query, None)), capture.bytes);
    }

    #[test]
    fn captured_replies_are_decoded() {
        let chunk = decode(&Capture::read(FOLDER, "s2c_01_actions_1x8x7.bin").bytes).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (8, 7));
        // What the stub of the live servers returns to its first request.
        assert!((chunk.rows()[0][0] - 0.212_461_18).abs() < 1e-6, "{:?}", chunk.rows()[0]);
        let error = decode(&Capture::read(FOLDER, "s2c_02_error.bin").bytes).unwrap_err();
        assert!(error.to_string().contains("the stub refuses this instruction"), "{error}");
    }

    #[test]
    fn metadata_are_compared() {
        let declared = openpi::metadata(&Capture::read(FOLDER, "s2c_00_metadata.bin").bytes).unwrap();
        assert_eq!(declared["env"], ENV);
        assert_eq!(check(&declared, None), Ok(()));
        let error = check(&declared, Some("bridge")).unwrap_err().to_string();
        assert!(error.contains("no statistics of `bridge`") && error.contains("franka"), "{error}");
        let several = serde_json::json!({LENGTH: 8, "available_unnorm_keys": ["a", "b"], "default_unnorm_key": null});
        assert!(check(&several, None).unwrap_err().to_string().contains("one of: a, b"));
        assert_eq!(check(&several, Some("b")), Ok(()));
        assert!(matches!(check(&serde_json::json!({}), None), Err(PolicyError::WrongDialect { .. })));
    }

    #[test]
    fn fuzzed_replies_are_read_or_refused() {
        let seeds = ["s2c_00_metadata.bin", "s2c_01_actions_1x8x7.bin", "s2c_02_error.bin"];
        let seeds = seeds.map(|name| Capture::read(FOLDER, name).bytes);
        crate::tests::fuzz("starvla", &seeds, |bytes| {
            let declared = openpi::metadata(bytes).is_ok();
            decode(bytes).is_ok() || declared
        });
    }
}
