//! NVIDIA's Isaac GR00T servers over ZeroMQ: msgpack with `.npy` files in it.
//!
//! N1.6 takes an observation in one of two layouts: nested, or flat behind its simulation wrapper. Which one can only be
//! found out by asking. N1.5 takes the flat one without a batch. Both say which pictures, vectors and actions
//! they know.

use std::collections::BTreeSet;

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::array::Array;
use super::error::ServerError;
use super::exchange::{Chunk, Query};
use super::link::{Link, token};
use super::msgpack;
use super::npy;
use super::profile::{Gr00t, Profile};
use super::websocket::{Deadline, MAX_ANSWER};
use robogate_zmtp::{Limits, Requester, ZmtpError};

/// Which server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Version {
    /// `scripts/inference_service.py`.
    N15,
    /// `gr00t/eval/run_gr00t_server.py`.
    N16,
}

/// How N1.6 wants an observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Layout {
    Nested,
    Flat,
}

/// A connection to such a server.
#[derive(Debug)]
pub(crate) struct Gr00tServer {
    requester: Requester,
    version: Version,
    settings: Gr00t,
    layout: Option<Layout>,
    declared: Json,
}

impl Gr00tServer {
    pub(crate) fn connect(
        url: &str,
        version: Version,
        settings: &Gr00t,
        profile: &Profile,
        deadline: Deadline,
    ) -> Result<Self, ServerError> {
        let address =
            url.parse().map_err(|e: ZmtpError| ServerError::Address { url: url.to_owned(), why: e.to_string() })?;
        let limits = Limits { frames: 4, frame_bytes: MAX_ANSWER, message_bytes: MAX_ANSWER };
        let requester = Requester::new(address, limits);
        let layout = (version == Version::N15).then_some(Layout::Flat);
        let mut link = Self { requester, version, settings: settings.clone(), layout, declared: Json::Null };
        link.call("ping", None, deadline, |_| Ok(()))?;
        link.declared = link.call("get_modality_config", None, deadline, declared)?;
        compare(&link.declared, settings, profile)?;
        Ok(link)
    }

    fn call<T>(
        &mut self,
        endpoint: &'static str,
        data: Option<ValueRef<'_>>,
        deadline: Deadline,
        read: impl FnOnce(&ValueRef<'_>) -> Result<T, ServerError>,
    ) -> Result<T, ServerError> {
        let left = deadline.left().ok_or_else(|| deadline.passed(endpoint))?;
        let frames = self.requester.ask(&[encode(endpoint, data, token())], left).map_err(|error| match error {
            ZmtpError::TimedOut(_) => deadline.passed(endpoint),
            ZmtpError::Closed => ServerError::Closed { when: format!("during {endpoint}"), reason: String::new() },
            ZmtpError::Unreachable { address, why } => ServerError::Unreachable { url: address, why: why.to_string() },
            other => ServerError::undecodable("a ZeroMQ message", other),
        })?;
        let [body] = frames.as_slice() else {
            return Err(ServerError::undecodable("a ZeroMQ message", format!("{} parts, not one", frames.len())));
        };
        read(&answer(endpoint, body)?)
    }
}

impl Link for Gr00tServer {
    fn begin(&mut self, _: &str, _: u64, deadline: Deadline) -> Result<(), ServerError> {
        match self.version {
            // It keeps nothing and knows no reset.
            Version::N15 => Ok(()),
            Version::N16 => {
                let options = msgpack::map([("options", ValueRef::Nil)]);
                self.call("reset", Some(options), deadline, |_| Ok(()))
            }
        }
    }

    fn ask(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, ServerError> {
        let keys = self.settings.action_keys.clone();
        let language = self.settings.language_key.clone();
        let (version, settled) = (self.version, self.layout);
        let mut ask = |layout| {
            let files = Files::of(query, version, layout);
            let data = files.observation(&query.instruction, version, layout, &language);
            self.call("get_action", Some(data), deadline, |answer| actions(answer, &keys))
        };
        if let Some(layout) = settled {
            return ask(layout);
        }
        // A wrong layout is refused in words; that question costs no inference.
        let (layout, answer) = match ask(Layout::Nested) {
            Err(ServerError::Refused { text }) if text.contains("must be in observation") => {
                (Layout::Flat, ask(Layout::Flat))
            }
            other => (Layout::Nested, other),
        };
        self.layout = answer.is_ok().then_some(layout);
        answer
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

/// A question as bytes.
fn encode(endpoint: &str, data: Option<ValueRef<'_>>, token: Option<String>) -> Vec<u8> {
    let endpoint = [("endpoint", ValueRef::from(endpoint))];
    let data = data.map(|data| ("data", data));
    let token = token.as_deref().map(|token| ("api_token", ValueRef::from(token)));
    msgpack::encode(&msgpack::map(endpoint.into_iter().chain(data).chain(token)))
}

/// A question's arrays as files, by the names that a layout has for them.
struct Files {
    video: Vec<(String, Vec<u8>)>,
    state: Vec<(String, Vec<u8>)>,
}

impl Files {
    fn of(query: &Query, version: Version, layout: Layout) -> Self {
        // N1.6 has axes for batch and time, N1.5 one for time.
        let ones = if version == Version::N16 { 2 } else { 1 };
        let files = |kind: &str, arrays: &[(String, Array)]| {
            let name = |key: &str| match layout {
                Layout::Nested => key.to_owned(),
                Layout::Flat => format!("{kind}.{key}"),
            };
            arrays.iter().map(|(key, array)| (name(key), npy::write(array, ones))).collect()
        };
        Self { video: files("video", &query.images), state: files("state", &query.states) }
    }

    /// What `get_action` is asked with.
    fn observation<'a>(
        &'a self,
        instruction: &'a str,
        version: Version,
        layout: Layout,
        language: &'a str,
    ) -> ValueRef<'a> {
        fn entries(files: &[(String, Vec<u8>)]) -> impl Iterator<Item = (&str, ValueRef<'_>)> {
            files.iter().map(|(key, file)| {
                let mark = ("__ndarray_class__", ValueRef::Boolean(true));
                (key.as_str(), msgpack::map([mark, ("as_npy", ValueRef::Binary(file))]))
            })
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

/// The answer in a message, unless it is an error.
fn answer<'a>(endpoint: &'static str, body: &'a [u8]) -> Result<ValueRef<'a>, ServerError> {
    if body == b"ERROR" {
        return Err(ServerError::refused("ERROR"));
    }
    let answer = msgpack::decode(endpoint, body)?;
    match msgpack::get(&answer, "error").and_then(msgpack::name) {
        Some("") => Err(ServerError::refused("an error without a word (it could not read the question)")),
        Some(text) => Err(ServerError::refused(text)),
        None => Ok(answer),
    }
}

/// The actions of an answer: N1.6 has an array of actions and remarks, N1.5 the actions alone.
fn actions(answer: &ValueRef<'_>, keys: &[String]) -> Result<Chunk, ServerError> {
    const WHAT: &str = "the answer to get_action";
    let map = match answer {
        ValueRef::Array(items) => items.first().unwrap_or(answer),
        other => other,
    };
    let entries =
        msgpack::entries(map).ok_or_else(|| ServerError::undecodable(WHAT, "it is no map of actions".to_owned()))?;
    let known = || entries.iter().filter_map(|(key, _)| msgpack::name(key)).collect::<Vec<_>>().join(", ");
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for key in keys {
        let prefixed = format!("action.{key}");
        let value = msgpack::get(map, &prefixed)
            .or_else(|| msgpack::get(map, key))
            .ok_or_else(|| ServerError::Shape(format!("the answer has no `{key}`; it has {}", known())))?;
        let Some(ValueRef::Binary(file)) = msgpack::get(value, "as_npy") else {
            return Err(ServerError::undecodable(WHAT, format!("`{key}` is no array")));
        };
        let array = npy::read(file).map_err(|why| ServerError::undecodable(WHAT, why))?;
        Chunk::join(&mut rows, Chunk::columns(&array, key)?, key)?;
    }
    Chunk::of_rows(rows)
}

/// What the server knows, as a map from kind to names, whichever of the two ways it says it in.
fn declared(answer: &ValueRef<'_>) -> Result<Json, ServerError> {
    const WHAT: &str = "the answer to get_modality_config";
    let kinds = msgpack::entries(answer).ok_or_else(|| ServerError::undecodable(WHAT, "it is no map".to_owned()))?;
    let mut all = serde_json::Map::new();
    for (kind, config) in kinds {
        let (Some(kind), Some(config)) = (msgpack::name(kind), msgpack::get(config, "as_json")) else { continue };
        let config = match msgpack::name(config) {
            // N1.5.
            Some(text) => serde_json::from_str(text).map_err(|e| ServerError::undecodable(WHAT, e))?,
            None => msgpack::to_json(config),
        };
        all.insert(kind.to_owned(), config);
    }
    Ok(Json::Object(all))
}

/// Holds what the server knows against the profile.
fn compare(declared: &Json, settings: &Gr00t, profile: &Profile) -> Result<(), ServerError> {
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
        // N1.5's servers leave kinds out.
        let Some(theirs) = names(kind) else { continue };
        // Nobody has to use every action.
        let fits = if *kind == "action" { ours.is_subset(&theirs) } else { *ours == theirs };
        if !fits {
            return Err(ServerError::Mismatch(format!(
                "the server's {kind} is {}; the profile's {field}: {}",
                joined(&theirs),
                joined(ours)
            )));
        }
    }
    let steps = declared.get("action").and_then(|a| a.get("delta_indices")).and_then(Json::as_array).map(Vec::len);
    match (steps, profile.chunk.length) {
        (Some(theirs), Some(ours)) if theirs != ours => Err(ServerError::Mismatch(format!(
            "the server answers {theirs} actions, the profile's chunk.length is {ours}"
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
                let ValueRef::Binary(file) = msgpack::get(value, "as_npy")? else { return None };
                let array = npy::read(file).unwrap();
                let shape = array.shape()[ones..].to_vec();
                Some((key, array.reshaped(shape)))
            })
            .collect()
    }

    #[test]
    fn questions_of_both_versions_and_layouts_are_those_of_the_upstream_clients_to_the_byte() {
        let cases = [
            (
                "gr00t_n16/libero_panda_nested/03_get_action.req.bin",
                Version::N16,
                Layout::Nested,
                "pick up the black bowl",
            ),
            ("gr00t_n16/libero_panda_sim/03_get_action.req.bin", Version::N16, Layout::Flat, "pick up the black bowl"),
            ("gr00t_n15/get_action.req.bin", Version::N15, Layout::Flat, "pick up"),
        ];
        for (name, version, layout, instruction) in cases {
            let capture = Capture::read("", name);
            let question = capture.msgpack();
            let data = msgpack::get(&question, "data").unwrap();
            let seen = msgpack::get(data, "observation").unwrap_or(data);
            let ones = if version == Version::N16 { 2 } else { 1 };
            let arrays = |kind: &str| match layout {
                Layout::Nested => query(msgpack::entries(msgpack::get(seen, kind).unwrap()).unwrap(), "", ones),
                Layout::Flat => query(msgpack::entries(seen).unwrap(), &format!("{kind}."), ones),
            };
            let (images, states) = (arrays("video"), arrays("state"));
            assert_eq!((images.len(), states.len()), (2, 7), "{name}");
            let query = Query { images, states, instruction: instruction.to_owned(), step: 0, time_s: 0.0 };
            let (files, language) = (Files::of(&query, version, layout), settings().language_key);
            let data = files.observation(instruction, version, layout, &language);
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
    fn answers_of_both_versions_and_layouts_are_understood() {
        for (name, length) in [
            ("gr00t_n16/libero_panda_nested/03_get_action.rep.bin", 16),
            ("gr00t_n16/libero_panda_sim/03_get_action.rep.bin", 16),
            ("gr00t_n15/get_action.rep.bin", 16),
        ] {
            let capture = Capture::read("", name);
            let chunk = actions(&answer("get_action", &capture.bytes).unwrap(), &settings().action_keys).unwrap();
            assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (length, 7), "{name}");
        }
    }

    #[test]
    fn errors_are_told_from_answers() {
        for (name, words) in [
            ("gr00t_n16/libero_panda_nested/06_err_other_layout.rep.bin", "must contain a 'video' key"),
            ("gr00t_n16/libero_panda_sim/06_err_other_layout.rep.bin", "must be in observation"),
            ("gr00t_n16/libero_panda_nested/10_err_garbage.rep.bin", "without a word"),
            ("gr00t_n15/err.rep.bin", "video.image"),
        ] {
            let error = answer("get_action", &Capture::read("", name).bytes).unwrap_err();
            assert!(matches!(&error, ServerError::Refused { text } if text.contains(words)), "{error}");
        }
    }

    #[test]
    fn what_the_server_knows_is_held_against_the_profile() {
        let capture = Capture::read("gr00t_n16/libero_panda_nested", "01_get_modality_config.rep.bin");
        let said = declared(&capture.msgpack()).unwrap();
        let mut profile = Profile::from_toml(Profile::built_in("gr00t-n1.6-libero").unwrap()).unwrap();
        compare(&said, &settings(), &profile).unwrap();
        profile.chunk.length = Some(8);
        assert!(compare(&said, &settings(), &profile).unwrap_err().to_string().contains("chunk.length is 8"));
        profile.cameras.pop();
        let error = compare(&said, &settings(), &profile).unwrap_err().to_string();
        assert!(error.contains("video is image, wrist_image; the profile's cameras: image"), "{error}");
    }

    #[test]
    fn n15_says_the_same_in_its_own_way() {
        let capture = Capture::read("gr00t_n15", "get_modality_config.rep.bin");
        let said = declared(&capture.msgpack()).unwrap();
        assert_eq!(said["video"]["modality_keys"][0], "video.image");
        let mut one = settings();
        one.action_keys = vec!["x".to_owned(), "gripper".to_owned()];
        let profile = Profile::from_toml(Profile::built_in("gr00t-n1.6-libero").unwrap()).unwrap();
        compare(&said, &one, &profile).unwrap();
    }

    #[test]
    fn whatever_bytes_come_decoding_returns() {
        let seeds = [
            "gr00t_n16/libero_panda_nested/01_get_modality_config.rep.bin",
            "gr00t_n16/libero_panda_nested/03_get_action.rep.bin",
            "gr00t_n15/get_modality_config.rep.bin",
            "gr00t_n15/get_action.rep.bin",
        ]
        .map(|name| Capture::read("", name).bytes);
        let keys = settings().action_keys;
        fuzz(&seeds, |bytes| {
            if let Ok(answer) = answer("get_action", bytes) {
                let _ = actions(&answer, &keys);
                let _ = declared(&answer);
            }
        });
    }
}
