//! openpi's WebSocket server (`scripts/serve_policy.py`): one binary message for each request and reply, msgpack with
//! binary keys of arrays.
//!
//! The server sends its metadata on connection. A text message is a Python traceback, after which the server closes the
//! connection. It keeps no state between requests.

use std::sync::Arc;

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::access::Access;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::identify;
use super::msgpack::{self, Keys};
use super::profile::{Chunking, Dialect, Profile};
use super::starvla;
use super::websocket::{Reply, Socket};
use super::{chunk::Chunk, query::Query};

/// A connection to an openpi server.
#[derive(Debug)]
pub(crate) struct Openpi {
    socket: Socket,
    metadata: Json,
    separator: Option<char>,
}

impl Openpi {
    pub(crate) fn connect(
        url: &str,
        separator: Option<char>,
        access: &Access,
        deadline: Deadline,
    ) -> Result<Self, PolicyError> {
        let socket = Socket::connect(url, access.header("Api-Key"), access, deadline)?;
        let metadata = match socket.receive("the metadata of the server", deadline) {
            Ok(Reply::Bytes(bytes)) => metadata(&bytes)?,
            Ok(Reply::Text(text)) => return Err(text_error("metadata of the server", &text)),
            // An openpi server sends its metadata immediately, unless it loads the model after accepting connections.
            Err(PolicyError::Timeout { limit_s, .. }) => {
                return Err(match identify::describe(url, &Dialect::Openpi { separator }) {
                    Some(found) => PolicyError::WrongDialect { expected: "openpi", found },
                    None => PolicyError::NotReady {
                        url: url.to_owned(),
                        why: format!(
                            "the server accepted the connection, but sent no metadata within {limit_s} s. Hint: if it is \
                             still loading, use --wait; a server of vla-eval sends none and needs a profile with the \
                             dialect vla-eval"
                        ),
                    },
                });
            }
            Err(e) => return Err(e),
        };
        if metadata.get("action_space").is_some() && metadata.get("n_external_cameras").is_some() {
            return Err(PolicyError::WrongDialect {
                expected: "openpi",
                found: "the metadata are those of a RoboArena server (dialect roboarena)".to_owned(),
            });
        }
        if metadata.get("env").and_then(Json::as_str) == Some(starvla::ENV) {
            return Err(PolicyError::WrongDialect {
                expected: "openpi",
                found: "the metadata are those of a StarVLA server (dialect starvla)".to_owned(),
            });
        }
        Ok(Self { socket, metadata, separator })
    }
}

impl Connection for Openpi {
    fn begin(&mut self, _: &str, _: u64, _: Deadline) -> Result<(), PolicyError> {
        // A server may close connections that are idle, or after a number of requests.
        self.socket.check_idle()
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        match self.socket.request(&request(query, self.separator), "infer", deadline)? {
            Reply::Bytes(bytes) => decode(&bytes),
            Reply::Text(text) => Err(text_error("reply to infer", &text)),
        }
    }

    fn declared(&self) -> &Json {
        &self.metadata
    }
}

/// The request for actions. Keys with the separator are entries of nested maps.
fn request(query: &Query, separator: Option<char>) -> ValueRef<'_> {
    let arrays = |arrays| msgpack::arrays(arrays, Keys::Binary);
    let prompt = ("prompt", query.instruction.as_str().into());
    let mut entries = Vec::new();
    for (key, array) in arrays(&query.images).chain(arrays(&query.states)) {
        put(&mut entries, key, array, separator);
    }
    put(&mut entries, prompt.0, prompt.1, None);
    ValueRef::Map(entries)
}

/// Put a value at a key, or into the maps that its parts name. A map stands where its first entry does.
fn put<'a>(
    entries: &mut Vec<(ValueRef<'a>, ValueRef<'a>)>,
    key: &'a str,
    value: ValueRef<'a>,
    separator: Option<char>,
) {
    let Some((outer, rest)) = separator.and_then(|separator| key.split_once(separator)) else {
        entries.push((key.into(), value));
        return;
    };
    let at = entries.iter().position(|(known, _)| *known == ValueRef::from(outer)).unwrap_or_else(|| {
        entries.push((outer.into(), ValueRef::Map(Vec::new())));
        entries.len() - 1
    });
    match &mut entries[at].1 {
        ValueRef::Map(inner) => put(inner, rest, value, separator),
        // A profile with the key of a map and of a value: the last one counts.
        other => *other = msgpack::map([(rest, value)]),
    }
}

/// Decode the actions of a reply.
pub(crate) fn decode(bytes: &[u8]) -> Result<Chunk, PolicyError> {
    const WHAT: &str = "reply to infer";
    let reply = msgpack::decode(WHAT, bytes)?;
    let actions = msgpack::get(&reply, "actions")
        .ok_or_else(|| PolicyError::invalid_reply(WHAT, format!("`actions` is missing. The reply {}", keys(&reply))))?;
    Chunk::of_array(&msgpack::read_array(WHAT, actions)?)
}

/// The error for a text message: a Python traceback, or JSON of a server that does not use msgpack.
pub(crate) fn text_error(what: &'static str, text: &str) -> PolicyError {
    if text.starts_with(['{', '[']) {
        let why = "the server sent JSON in a text message. Expected a binary message with msgpack";
        return PolicyError::invalid_reply(what, why);
    }
    PolicyError::reported(text)
}

/// Describe the keys of a reply, for an error.
fn keys(reply: &ValueRef<'_>) -> String {
    let names = msgpack::entries(reply).map(|entries| entries.iter().filter_map(|(key, _)| msgpack::name(key)));
    match names.map(|names| names.take(8).collect::<Vec<_>>()) {
        None => "is not a map".to_owned(),
        Some(names) if names.is_empty() => "is an empty map".to_owned(),
        Some(names) => format!("has the keys {}", names.join(", ")),
    }
}

/// The number of actions in the metadata of a server: the name of the setting in openpi's configurations.
pub(crate) const LENGTH: &str = "action_horizon";

/// The profile with the number of actions that the server declares in its metadata under this name.
pub(crate) fn with_declared_length(
    profile: Arc<Profile>,
    declared: &Json,
    name: &str,
) -> Result<Arc<Profile>, PolicyError> {
    let declared = declared.get(name).and_then(Json::as_u64).and_then(|n| usize::try_from(n).ok());
    match declared {
        Some(length) if length < profile.chunk.execute => Err(PolicyError::Mismatch(format!(
            "the server sends {length} actions, but chunk.execute of the profile is {}",
            profile.chunk.execute
        ))),
        Some(length) if profile.chunk.length.is_some_and(|known| known != length) => {
            let chunk = Chunking { length: Some(length), ..profile.chunk };
            Ok(Arc::new(Profile { chunk, ..Profile::clone(&profile) }))
        }
        _ => Ok(profile),
    }
}

/// Decode the metadata of a server.
pub(crate) fn metadata(bytes: &[u8]) -> Result<Json, PolicyError> {
    const WHAT: &str = "metadata of the server";
    let value = msgpack::decode(WHAT, bytes)?;
    if msgpack::entries(&value).is_none() {
        return Err(PolicyError::invalid_reply(WHAT, "not a map".to_owned()));
    }
    Ok(msgpack::to_json(&value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Capture, query};

    const FOLDER: &str = "openpi";

    #[test]
    fn requests_equal_captured_ones() {
        for (name, instruction) in
            [("c2s_00_obs_libero_4x4.bin", "pick up the black bowl"), ("c2s_02_obs_droid_4x4.bin", "do something")]
        {
            let capture = Capture::read(FOLDER, name);
            let query = query(&capture.msgpack(), instruction);
            assert_eq!(msgpack::encode(&request(&query, None)), capture.bytes, "{name}");
        }
    }

    /// The request of openpi's own client for ALOHA, whose images are in a map.
    #[test]
    fn nested_keys_equal_captured_ones() {
        let capture = Capture::read(FOLDER, "c2s_04_obs_aloha_sim_4x4.bin");
        let asked = capture.msgpack();
        let images = query(msgpack::get(&asked, "images").unwrap(), "").images;
        let images = images.into_iter().map(|(name, array)| (format!("images/{name}"), array)).collect();
        let query = Query { images, ..query(&asked, "Transfer cube") };
        let sent = msgpack::encode(&request(&query, Some('/')));
        let in_order = |bytes: &[u8]| {
            let value = msgpack::decode("request", bytes).unwrap();
            let mut entries: Vec<String> =
                msgpack::entries(&value).unwrap().iter().map(|(key, value)| format!("{key} {value}")).collect();
            entries.sort();
            entries
        };
        assert_eq!(in_order(&sent), in_order(&capture.bytes));
    }

    #[test]
    fn captured_replies_are_decoded() {
        let libero = decode(&Capture::read(FOLDER, "s2c_01_action_libero_10x7_f64.bin").bytes).unwrap();
        assert_eq!((libero.rows().len(), libero.rows()[0].len()), (10, 7));
        // The model stub of the captured server returns multiples of 0.01.
        assert_eq!(libero.rows()[0][..3], [0.0, 0.01, 0.02]);
        let droid = decode(&Capture::read(FOLDER, "s2c_03_action_droid_10x8.bin").bytes).unwrap();
        assert_eq!((droid.rows().len(), droid.rows()[0].len()), (10, 8));
        let aloha = decode(&Capture::read(FOLDER, "s2c_05_action_aloha_50x14.bin").bytes).unwrap();
        assert_eq!((aloha.rows().len(), aloha.rows()[0].len()), (50, 14));
    }

    #[test]
    fn replies_without_actions_are_described() {
        let reply = msgpack::encode(&msgpack::map([("action", 1.into()), ("time", 2.into())]));
        let error = decode(&reply).unwrap_err().to_string();
        assert!(error.ends_with("`actions` is missing. The reply has the keys action, time"), "{error}");
    }

    #[test]
    fn metadata_become_json() {
        let metadata = metadata(&Capture::read(FOLDER, "s2c_00_metadata.bin").bytes).unwrap();
        assert_eq!(metadata, serde_json::json!({"reset_pose": [0, -1.5, 1.5, 0, 0, 0]}));
    }

    #[test]
    fn servers_can_declare_the_length() {
        let profile = Arc::new(Profile::from_toml(Profile::built_in("pi05-droid").unwrap()).unwrap());
        let length =
            |declared: Json| with_declared_length(Arc::clone(&profile), &declared, LENGTH).map(|p| p.chunk.length);
        assert_eq!(length(serde_json::json!({})), Ok(Some(15)));
        assert_eq!(length(serde_json::json!({"action_horizon": 16})), Ok(Some(16)));
        assert_eq!(length(serde_json::json!({"action_horizon": "many"})), Ok(Some(15)));
        let error = length(serde_json::json!({"action_horizon": 4})).unwrap_err().to_string();
        assert!(error.contains("sends 4 actions, but chunk.execute of the profile is 8"), "{error}");
    }

    #[test]
    fn fuzzed_replies_are_read_or_refused() {
        let seeds =
            ["s2c_00_metadata.bin", "s2c_01_action_libero_10x7_f64.bin"].map(|n| Capture::read(FOLDER, n).bytes);
        crate::tests::fuzz("openpi", &seeds, |bytes| {
            let declared = metadata(bytes).is_ok();
            decode(bytes).is_ok() || declared
        });
    }
}
