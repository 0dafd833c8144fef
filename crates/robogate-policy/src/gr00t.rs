//! NVIDIA's Isaac GR00T servers over ZeroMQ: msgpack that contains arrays.
//!
//! Arrays are `.npy` files, and since May 2026 (N1.7) maps of the Python package msgpack-numpy. The reply with the
//! configuration shows which of the two a server understands.
//!
//! N1.6 accepts observations in one of two layouts: nested, or flat with its simulation wrapper. Only a request shows
//! which one. N1.5 accepts the flat layout without a batch axis. Both report the names of their images, vectors and
//! actions.

use std::collections::BTreeSet;

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::access::Access;
use super::array::Array;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::msgpack;
use super::npy;
use super::profile::{Gr00t, Profile};
use super::websocket::MAX_REPLY;
use super::{chunk::Chunk, query::Query};
use robogate_zmtp::{Limits, Requester, ZmtpError};

/// Version of the server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Version {
    /// `scripts/inference_service.py`.
    N15,
    /// `gr00t/eval/run_gr00t_server.py`.
    N16,
}

/// Layout of an observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Layout {
    Nested,
    Flat,
}

/// A connection to a GR00T server.
#[derive(Debug)]
pub(crate) struct Gr00tServer {
    requester: Requester,
    key: Option<String>,
    version: Version,
    settings: Gr00t,
    layout: Option<Layout>,
    arrays: Arrays,
    declared: Json,
}

/// How a server writes and reads arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Arrays {
    /// As `.npy` files.
    Npy,
    /// As maps of the Python package msgpack-numpy.
    Numpy,
}

impl Arrays {
    /// The form that a server uses, from its reply to `get_modality_config`: the marker of a configuration changed with it.
    fn of(reply: &ValueRef<'_>) -> Self {
        let kinds = msgpack::entries(reply).unwrap_or_default();
        match kinds.iter().any(|(_, config)| msgpack::get(config, "__ModalityConfig__").is_some()) {
            true => Self::Numpy,
            false => Self::Npy,
        }
    }
}

impl Gr00tServer {
    pub(crate) fn connect(
        url: &str,
        version: Version,
        settings: &Gr00t,
        expected: Option<&Profile>,
        access: &Access,
        deadline: Deadline,
    ) -> Result<Self, PolicyError> {
        let address =
            url.parse().map_err(|e: ZmtpError| PolicyError::Address { url: url.to_owned(), why: e.to_string() })?;
        let limits = Limits { frames: 4, frame_bytes: MAX_REPLY, message_bytes: MAX_REPLY };
        let requester = Requester::new(address, limits);
        let layout = (version == Version::N15).then_some(Layout::Flat);
        let key = access.key().map(str::to_owned);
        let (settings_here, arrays) = (settings.clone(), Arrays::Npy);
        let mut connection =
            Self { requester, key, version, settings: settings_here, layout, arrays, declared: Json::Null };
        connection.call("ping", None, deadline, |_| Ok(()))?;
        (connection.declared, connection.arrays) = connection
            .call("get_modality_config", None, deadline, |reply| Ok((declared(reply)?, Arrays::of(reply))))?;
        if let Some(profile) = expected {
            compare(&connection.declared, settings, profile)?;
        }
        Ok(connection)
    }

    fn call<T>(
        &mut self,
        endpoint: &'static str,
        data: Option<ValueRef<'_>>,
        deadline: Deadline,
        read: impl FnOnce(&ValueRef<'_>) -> Result<T, PolicyError>,
    ) -> Result<T, PolicyError> {
        let left = deadline.left().ok_or_else(|| deadline.passed(endpoint))?;
        let frames =
            self.requester.request(&[encode(endpoint, data, self.key.clone())], left).map_err(|error| match error {
                ZmtpError::TimedOut(_) => deadline.passed(endpoint),
                ZmtpError::Closed => PolicyError::Closed { when: format!("during {endpoint}"), reason: String::new() },
                ZmtpError::Unreachable { address, why } => {
                    PolicyError::Unreachable { url: address, why: why.to_string() }
                }
                other => PolicyError::invalid_reply("ZeroMQ message", other),
            })?;
        let [body] = frames.as_slice() else {
            return Err(PolicyError::invalid_reply(
                "ZeroMQ message",
                format!("expected one frame, got {}", frames.len()),
            ));
        };
        read(&decode_reply(endpoint, body)?)
    }
}

impl Connection for Gr00tServer {
    fn begin(&mut self, _: &str, _: u64, deadline: Deadline) -> Result<(), PolicyError> {
        match self.version {
            // It has no state and no reset.
            Version::N15 => Ok(()),
            Version::N16 => {
                let options = msgpack::map([("options", ValueRef::Nil)]);
                self.call("reset", Some(options), deadline, |_| Ok(()))
            }
        }
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        let keys = self.settings.action_keys.clone();
        let language = self.settings.language_key.clone();
        let (version, known_layout, arrays) = (self.version, self.layout, self.arrays);
        let mut request = |layout| {
            let inputs = Inputs::new(query, version, layout, arrays);
            let data = inputs.observation(&query.instruction, version, layout, &language);
            self.call("get_action", Some(data), deadline, |reply| decode_actions(reply, &keys))
        };
        if let Some(layout) = known_layout {
            return request(layout);
        }
        // The server rejects a wrong layout before it runs the model.
        let (layout, reply) = match request(Layout::Nested) {
            Err(PolicyError::Reported { text }) if text.contains("must be in observation") => {
                (Layout::Flat, request(Layout::Flat))
            }
            other => (Layout::Nested, other),
        };
        self.layout = reply.is_ok().then_some(layout);
        reply
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

/// Encode a request.
fn encode(endpoint: &str, data: Option<ValueRef<'_>>, token: Option<String>) -> Vec<u8> {
    let endpoint = [("endpoint", ValueRef::from(endpoint))];
    let data = data.map(|data| ("data", data));
    let token = token.as_deref().map(|token| ("api_token", ValueRef::from(token)));
    msgpack::encode(&msgpack::map(endpoint.into_iter().chain(data).chain(token)))
}

/// An array of a request.
enum Encoded<'q> {
    /// A `.npy` file.
    File(Vec<u8>),
    /// An array that gets this number of leading axes of size 1.
    Numpy(&'q Array, usize),
}

impl Encoded<'_> {
    fn value(&self) -> ValueRef<'_> {
        match self {
            Self::File(file) => {
                let mark = ("__ndarray_class__", ValueRef::Boolean(true));
                msgpack::map([mark, ("as_npy", ValueRef::Binary(file))])
            }
            Self::Numpy(array, ones) => msgpack::numpy(array, *ones),
        }
    }
}

/// The arrays of a request, under the names that a layout uses.
struct Inputs<'q> {
    video: Vec<(String, Encoded<'q>)>,
    state: Vec<(String, Encoded<'q>)>,
}

impl<'q> Inputs<'q> {
    fn new(query: &'q Query, version: Version, layout: Layout, form: Arrays) -> Self {
        // N1.6 has leading axes for batch and time, N1.5 only for time.
        let ones = if version == Version::N16 { 2 } else { 1 };
        let encoded = |kind: &str, arrays: &'q [(String, Array)], axes: usize| {
            let name = |key: &str| match layout {
                Layout::Nested => key.to_owned(),
                Layout::Flat => format!("{kind}.{key}"),
            };
            // Arrays with a history have the axis for time already.
            let ones = |array: &Array| if array.shape().len() > axes { ones - 1 } else { ones };
            let encoded = |array: &'q Array| match form {
                Arrays::Npy => Encoded::File(npy::write(array, ones(array))),
                Arrays::Numpy => Encoded::Numpy(array, ones(array)),
            };
            arrays.iter().map(|(key, array)| (name(key), encoded(array))).collect()
        };
        Self { video: encoded("video", &query.images, 3), state: encoded("state", &query.states, 1) }
    }

    /// The data of a `get_action` request.
    fn observation<'a>(
        &'a self,
        instruction: &'a str,
        version: Version,
        layout: Layout,
        language: &'a str,
    ) -> ValueRef<'a> {
        fn entries<'v>(arrays: &'v [(String, Encoded<'_>)]) -> impl Iterator<Item = (&'v str, ValueRef<'v>)> {
            arrays.iter().map(|(key, array)| (key.as_str(), array.value()))
        }
        let sentence = ValueRef::Array(vec![instruction.into()]);
        let (video, state) = (entries(&self.video), entries(&self.state));
        let observation = match layout {
            Layout::Nested => {
                let language = msgpack::map([(language, ValueRef::Array(vec![sentence]))]);
                msgpack::map([("video", msgpack::map(video)), ("state", msgpack::map(state)), ("language", language)])
            }
            Layout::Flat => msgpack::map(video.chain(state).chain([(language, sentence)])),
        };
        match version {
            Version::N15 => observation,
            Version::N16 => msgpack::map([("observation", observation), ("options", ValueRef::Nil)]),
        }
    }
}

/// Decode a reply, unless it reports an error.
fn decode_reply<'a>(endpoint: &'static str, body: &'a [u8]) -> Result<ValueRef<'a>, PolicyError> {
    if body == b"ERROR" {
        return Err(PolicyError::reported("ERROR"));
    }
    let reply = msgpack::decode(endpoint, body)?;
    match msgpack::get(&reply, "error").and_then(msgpack::name) {
        Some("") => Err(PolicyError::reported("an error without a message (the server could not decode the request)")),
        Some(text) => Err(PolicyError::reported(text)),
        None => Ok(reply),
    }
}

/// Decode the actions of a reply. N1.6 sends an array of actions and information, N1.5 only the actions.
fn decode_actions(reply: &ValueRef<'_>, keys: &[String]) -> Result<Chunk, PolicyError> {
    const WHAT: &str = "reply to get_action";
    let map = match reply {
        ValueRef::Array(items) => items.first().unwrap_or(reply),
        other => other,
    };
    let entries =
        msgpack::entries(map).ok_or_else(|| PolicyError::invalid_reply(WHAT, "not a map of actions".to_owned()))?;
    let known = || entries.iter().filter_map(|(key, _)| msgpack::name(key)).collect::<Vec<_>>().join(", ");
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for key in keys {
        let prefixed = format!("action.{key}");
        let value = msgpack::get(map, &prefixed)
            .or_else(|| msgpack::get(map, key))
            .ok_or_else(|| PolicyError::Shape(format!("the reply has no `{key}`; it has {}", known())))?;
        let array = match msgpack::get(value, "as_npy") {
            Some(ValueRef::Binary(file)) => npy::read(file).map_err(|why| PolicyError::invalid_reply(WHAT, why))?,
            Some(_) => return Err(PolicyError::invalid_reply(WHAT, format!("`{key}` is not an array"))),
            None => msgpack::read_numpy(WHAT, value)?,
        };
        Chunk::join(&mut rows, Chunk::columns(&array, key)?, key)?;
    }
    Chunk::of_rows(rows)
}

/// Decode the configuration of a server: a map from kinds to names. The two versions encode it differently.
fn declared(reply: &ValueRef<'_>) -> Result<Json, PolicyError> {
    const WHAT: &str = "reply to get_modality_config";
    let kinds = msgpack::entries(reply).ok_or_else(|| PolicyError::invalid_reply(WHAT, "not a map".to_owned()))?;
    let mut all = serde_json::Map::new();
    for (kind, config) in kinds {
        let (Some(kind), Some(config)) = (msgpack::name(kind), msgpack::get(config, "as_json")) else { continue };
        let config = match msgpack::name(config) {
            // N1.5.
            Some(text) => super::json_numpy::parse(WHAT, text.as_bytes())?,
            None => msgpack::to_json(config),
        };
        all.insert(kind.to_owned(), config);
    }
    Ok(Json::Object(all))
}

/// The offsets of the frames of a kind of input, or of the actions.
pub(crate) fn indices(declared: &Json, kind: &str) -> Option<Vec<i64>> {
    let indices = declared.get(kind)?.get("delta_indices")?.as_array()?;
    Some(indices.iter().filter_map(Json::as_i64).collect())
}

/// Check the configuration of a server against the profile.
fn compare(declared: &Json, settings: &Gr00t, profile: &Profile) -> Result<(), PolicyError> {
    let names = |kind: &str| -> Option<BTreeSet<&str>> {
        let keys = declared.get(kind)?.get("modality_keys")?.as_array()?;
        Some(
            keys.iter()
                .filter_map(Json::as_str)
                .map(|name| name.strip_prefix(kind).and_then(|n| n.strip_prefix('.')).unwrap_or(name))
                .collect(),
        )
    };
    let joined = |set: &BTreeSet<&str>| set.iter().copied().collect::<Vec<_>>().join(", ");
    let ours: [(&str, &str, BTreeSet<&str>); 4] = [
        ("video", "cameras", profile.cameras.iter().map(|camera| camera.key.as_str()).collect()),
        ("state", "states", profile.states.iter().map(|state| state.key.as_str()).collect()),
        ("action", "dialect.action_keys", settings.action_keys.iter().map(String::as_str).collect()),
        ("language", "dialect.language_key", [settings.language_key.as_str()].into()),
    ];
    for (kind, field, ours) in &ours {
        // N1.5 servers omit some kinds.
        let Some(theirs) = names(kind) else { continue };
        // A profile may ignore some actions.
        let fits = if *kind == "action" { ours.is_subset(&theirs) } else { *ours == theirs };
        if !fits {
            return Err(PolicyError::Mismatch(format!(
                "{kind} of the server is {}, but {field} of the profile is {}",
                joined(&theirs),
                joined(ours)
            )));
        }
    }
    // The server counts frames from the present one backwards, in actions.
    if let Some(theirs) = indices(declared, "video") {
        let other = profile.cameras.iter().find(|camera| {
            let ours: &[i32] = if camera.history.is_empty() { &[0] } else { &camera.history };
            !ours.iter().map(|offset| i64::from(*offset)).eq(theirs.iter().copied())
        });
        if let Some(camera) = other {
            return Err(PolicyError::Mismatch(format!(
                "the server requires the images {theirs:?} of each camera, but history of the camera `{}` is {:?}",
                camera.key, camera.history
            )));
        }
    }
    let steps = declared.get("action").and_then(|a| a.get("delta_indices")).and_then(Json::as_array).map(Vec::len);
    match (steps, profile.chunk.length) {
        (Some(theirs), Some(ours)) if theirs != ours => Err(PolicyError::Mismatch(format!(
            "the server sends {theirs} actions, but chunk.length of the profile is {ours}"
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Capture, fuzz};

    fn settings() -> Gr00t {
        Gr00t {
            action_keys: ["x", "y", "z", "roll", "pitch", "yaw", "gripper"].map(str::to_owned).to_vec(),
            language_key: "annotation.human.action.task_description".to_owned(),
        }
    }

    /// The arrays of a captured observation without the axes for batch and time.
    fn query(arrays: &[(ValueRef<'_>, ValueRef<'_>)], prefix: &str, ones: usize) -> Vec<(String, Array)> {
        arrays
            .iter()
            .filter_map(|(key, value)| {
                let key = msgpack::name(key)?.strip_prefix(prefix)?.to_owned();
                let array = match msgpack::get(value, "as_npy") {
                    Some(ValueRef::Binary(file)) => npy::read(file).unwrap(),
                    _ => msgpack::read_numpy("capture", value).ok()?,
                };
                let shape = array.shape()[ones..].to_vec();
                Some((key, array.reshaped(shape)))
            })
            .collect()
    }

    #[test]
    fn requests_equal_captured_ones() {
        let cases = [
            (
                "gr00t_n16/libero_panda_nested/03_get_action.req.bin",
                Version::N16,
                Layout::Nested,
                Arrays::Npy,
                "pick up the black bowl",
            ),
            (
                "gr00t_n16/libero_panda_sim/03_get_action.req.bin",
                Version::N16,
                Layout::Flat,
                Arrays::Npy,
                "pick up the black bowl",
            ),
            ("gr00t_n15/get_action.req.bin", Version::N15, Layout::Flat, Arrays::Npy, "pick up"),
            ("gr00t_n17/get_action.req.bin", Version::N16, Layout::Nested, Arrays::Numpy, "pick up the black bowl"),
        ];
        for (name, version, layout, form, instruction) in cases {
            let capture = Capture::read("", name);
            let question = capture.msgpack();
            let data = msgpack::get(&question, "data").unwrap();
            let captured = msgpack::get(data, "observation").unwrap_or(data);
            let ones = if version == Version::N16 { 2 } else { 1 };
            let arrays = |kind: &str| match layout {
                Layout::Nested => query(msgpack::entries(msgpack::get(captured, kind).unwrap()).unwrap(), "", ones),
                Layout::Flat => query(msgpack::entries(captured).unwrap(), &format!("{kind}."), ones),
            };
            let (images, states) = (arrays("video"), arrays("state"));
            assert_eq!((images.len(), states.len()), (2, 7), "{name}");
            let query = Query { images, states, instruction: instruction.to_owned(), step: 0, time_s: 0.0 };
            let (inputs, language) = (Inputs::new(&query, version, layout, form), settings().language_key);
            let data = inputs.observation(instruction, version, layout, &language);
            assert_eq!(encode("get_action", Some(data), None), capture.bytes, "{name}");
        }
        let folder = "gr00t_n16/libero_panda_nested";
        assert_eq!(encode("ping", None, None), Capture::read(folder, "00_ping.req.bin").bytes);
        let modalities = Capture::read(folder, "01_get_modality_config.req.bin");
        assert_eq!(encode("get_modality_config", None, None), modalities.bytes);
        let options = msgpack::map([("options", ValueRef::Nil)]);
        assert_eq!(encode("reset", Some(options), None), Capture::read(folder, "02_reset.req.bin").bytes);
    }

    #[test]
    fn captured_replies_are_decoded() {
        for (name, length) in [
            ("gr00t_n16/libero_panda_nested/03_get_action.rep.bin", 16),
            ("gr00t_n16/libero_panda_sim/03_get_action.rep.bin", 16),
            ("gr00t_n15/get_action.rep.bin", 16),
            ("gr00t_n17/get_action.rep.bin", 16),
        ] {
            let capture = Capture::read("", name);
            let chunk =
                decode_actions(&decode_reply("get_action", &capture.bytes).unwrap(), &settings().action_keys).unwrap();
            assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (length, 7), "{name}");
        }
    }

    #[test]
    fn error_replies_are_errors() {
        for (name, part) in [
            ("gr00t_n16/libero_panda_nested/06_err_other_layout.rep.bin", "must contain a 'video' key"),
            ("gr00t_n16/libero_panda_sim/06_err_other_layout.rep.bin", "must be in observation"),
            ("gr00t_n16/libero_panda_nested/10_err_garbage.rep.bin", "without a message"),
            ("gr00t_n15/err.rep.bin", "video.image"),
        ] {
            let error = decode_reply("get_action", &Capture::read("", name).bytes).unwrap_err();
            assert!(matches!(&error, PolicyError::Reported { text } if text.contains(part)), "{error}");
        }
    }

    #[test]
    fn configurations_are_compared_with_the_profile() {
        let capture = Capture::read("gr00t_n16/libero_panda_nested", "01_get_modality_config.rep.bin");
        let declared = super::declared(&capture.msgpack()).unwrap();
        let mut profile = Profile::from_toml(Profile::built_in("gr00t-n1.6-libero").unwrap()).unwrap();
        compare(&declared, &settings(), &profile).unwrap();
        profile.chunk.length = Some(8);
        assert!(
            compare(&declared, &settings(), &profile)
                .unwrap_err()
                .to_string()
                .contains("chunk.length of the profile is 8")
        );
        profile.cameras.pop();
        let error = compare(&declared, &settings(), &profile).unwrap_err().to_string();
        assert!(
            error.contains("video of the server is image, wrist_image, but cameras of the profile is image"),
            "{error}"
        );
    }

    #[test]
    fn configurations_show_how_arrays_are_written() {
        for (name, form) in [
            ("gr00t_n15/get_modality_config.rep.bin", Arrays::Npy),
            ("gr00t_n16/libero_panda_nested/01_get_modality_config.rep.bin", Arrays::Npy),
            ("gr00t_n17/get_modality_config.rep.bin", Arrays::Numpy),
        ] {
            let capture = Capture::read("", name);
            assert_eq!(Arrays::of(&capture.msgpack()), form, "{name}");
        }
        let capture = Capture::read("gr00t_n17", "get_modality_config.rep.bin");
        let profile = Profile::from_toml(Profile::built_in("gr00t-n1.7-libero").unwrap()).unwrap();
        compare(&super::declared(&capture.msgpack()).unwrap(), &settings(), &profile).unwrap();
    }

    #[test]
    fn n15_configurations_are_decoded() {
        let capture = Capture::read("gr00t_n15", "get_modality_config.rep.bin");
        let declared = super::declared(&capture.msgpack()).unwrap();
        assert_eq!(declared["video"]["modality_keys"][0], "video.image");
        let mut one = settings();
        one.action_keys = vec!["x".to_owned(), "gripper".to_owned()];
        let profile = Profile::from_toml(Profile::built_in("gr00t-n1.6-libero").unwrap()).unwrap();
        compare(&declared, &one, &profile).unwrap();
    }

    #[test]
    fn fuzzed_replies_are_read_or_refused() {
        let seeds = [
            "gr00t_n16/libero_panda_nested/01_get_modality_config.rep.bin",
            "gr00t_n16/libero_panda_nested/03_get_action.rep.bin",
            "gr00t_n15/get_modality_config.rep.bin",
            "gr00t_n15/get_action.rep.bin",
            "gr00t_n17/get_modality_config.rep.bin",
            "gr00t_n17/get_action.rep.bin",
        ]
        .map(|name| Capture::read("", name).bytes);
        let keys = settings().action_keys;
        fuzz("gr00t", &seeds, |bytes| {
            decode_reply("get_action", bytes).is_ok_and(|reply| {
                let _ = decode_actions(&reply, &keys);
                let _ = declared(&reply);
                true
            })
        });
    }
}
