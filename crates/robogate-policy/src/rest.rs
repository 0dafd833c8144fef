//! HTTP servers that accept JSON with arrays at `/act`: OpenVLA, OpenVLA-OFT, GR00T N1.5 over HTTP, and servers for
//! Octo with the `/act`, `/reset`, `/health` convention.

use serde_json::Value as Json;

use super::access::Access;
use super::array::Array;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::http::{Http, Reply};
use super::json_numpy;
use super::{chunk::Chunk, query::Query};

/// Variants of the format of `/act`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Api {
    /// OpenVLA's `vla-scripts/deploy.py`: images, instruction and the key of the statistics; one action.
    OpenVla {
        /// Training set whose statistics scale the actions.
        unnorm_key: Option<String>,
    },
    /// OpenVLA-OFT's `vla-scripts/deploy.py`: images, vectors and instruction in one map; a list of actions.
    OpenVlaOft,
    /// AutoEval's servers: the format of OpenVLA, with `/reset` and `/health`.
    Rest {
        /// Training set whose statistics scale the actions, for servers that need it.
        unnorm_key: Option<String>,
    },
    /// GR00T N1.5's `scripts/inference_service.py --http-server`: an observation with flat keys; a map of arrays.
    Gr00tN15 {
        /// Arrays that make up an action, in order.
        action_keys: Vec<String>,
        /// Key of the instruction.
        language_key: String,
    },
}

/// A server with one of these formats.
#[derive(Debug)]
pub(crate) struct RestServer {
    http: Http,
    api: Api,
    declared: Json,
}

impl RestServer {
    pub(crate) fn connect(url: &str, api: Api, access: &Access, deadline: Deadline) -> Result<Self, PolicyError> {
        let http = Http::new(url, access)?;
        // OpenVLA's server has no /health. The OpenAPI description of FastAPI identifies it.
        let declared = match api {
            Api::Rest { .. } | Api::Gr00tN15 { .. } => {
                let reply = http.get("/health", deadline)?;
                let health = json_numpy::parse("reply to /health", &reply.body).unwrap_or_default();
                if let Some("loading" | "starting" | "initializing") = health.get("status").and_then(Json::as_str) {
                    let why = format!("its /health reports {}", health["status"]);
                    return Err(PolicyError::NotReady { url: url.to_owned(), why });
                }
                if reply.status != 200 || health.get("status").and_then(Json::as_str) != Some("healthy") {
                    let (status, body) = (reply.status, json_numpy::excerpt(&reply.body));
                    return Err(PolicyError::invalid_reply(
                        "reply to /health",
                        format!("HTTP {status} with {body}. Expected HTTP 200 with {{\"status\": \"healthy\"}}"),
                    ));
                }
                health
            }
            Api::OpenVla { .. } | Api::OpenVlaOft => {
                let reply = http.get("/openapi.json", deadline)?;
                let api = json_numpy::parse("reply to /openapi.json", &reply.body).unwrap_or_default();
                let paths = api.get("paths").and_then(Json::as_object);
                match paths {
                    Some(paths) if reply.status == 200 && paths.contains_key("/act") => {
                        serde_json::json!({"paths": paths.keys().collect::<Vec<_>>()})
                    }
                    _ => {
                        let status = reply.status;
                        return Err(PolicyError::invalid_reply(
                            "reply to /openapi.json",
                            format!("HTTP {status}. Expected the description of a FastAPI server with the path /act"),
                        ));
                    }
                }
            }
        };
        Ok(Self { http, api, declared })
    }
}

impl Connection for RestServer {
    fn begin(&mut self, _: &str, _: u64, deadline: Deadline) -> Result<(), PolicyError> {
        if !matches!(self.api, Api::Rest { .. }) {
            return Ok(());
        }
        match self.http.post("/reset", "{}", deadline)? {
            // A server without state has no /reset.
            Reply { status: 200 | 404, .. } => Ok(()),
            Reply { status, body } => Err(http_error(status, &body)),
        }
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        let reply = self.http.post("/act", &encode(query, &self.api), deadline)?;
        decode(&reply, &self.api)
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

fn http_error(status: u16, body: &[u8]) -> PolicyError {
    PolicyError::reported(&format!("HTTP {status}: {}", String::from_utf8_lossy(body)))
}

/// Encode a request.
fn encode(query: &Query, api: &Api) -> String {
    let mut json =
        String::with_capacity(64 + query.images.iter().map(|(_, array)| array.data().len() * 4 / 3).sum::<usize>());
    let mut first = true;
    let mut entry = |json: &mut String, key: &str| {
        json.push_str(if std::mem::take(&mut first) { "{" } else { ", " });
        json_numpy::write_text(json, key);
        json.push_str(": ");
    };
    match api {
        Api::Gr00tN15 { language_key, .. } => {
            // Arrays with a history have the axis for time already.
            let time = |array: &Array, axes: usize| usize::from(array.shape().len() == axes);
            json.push_str("{\"observation\": ");
            for (key, array) in &query.images {
                entry(&mut json, &format!("video.{key}"));
                json_numpy::write(&mut json, array, time(array, 3));
            }
            for (key, array) in &query.states {
                entry(&mut json, &format!("state.{key}"));
                json_numpy::write(&mut json, array, time(array, 1));
            }
            entry(&mut json, language_key);
            json.push('[');
            json_numpy::write_text(&mut json, &query.instruction);
            json.push_str("]}}");
        }
        Api::OpenVla { unnorm_key } | Api::Rest { unnorm_key } => {
            for (key, array) in &query.images {
                entry(&mut json, key);
                json_numpy::write(&mut json, array, 0);
            }
            entry(&mut json, "instruction");
            json_numpy::write_text(&mut json, &query.instruction);
            for (key, array) in &query.states {
                entry(&mut json, key);
                json_numpy::write(&mut json, array, 0);
            }
            if let Some(unnorm_key) = unnorm_key {
                entry(&mut json, "unnorm_key");
                json_numpy::write_text(&mut json, unnorm_key);
            }
            json.push('}');
        }
        Api::OpenVlaOft => {
            for (key, array) in query.images.iter().chain(&query.states) {
                entry(&mut json, key);
                json_numpy::write(&mut json, array, 0);
            }
            entry(&mut json, "instruction");
            json_numpy::write_text(&mut json, &query.instruction);
            json.push('}');
        }
    }
    json
}

/// Decode the actions of a reply.
fn decode(reply: &Reply, api: &Api) -> Result<Chunk, PolicyError> {
    const WHAT: &str = "reply to /act";
    if reply.status != 200 {
        return Err(http_error(reply.status, &reply.body));
    }
    let json = json_numpy::parse(WHAT, &reply.body)?;
    match (&json, api) {
        // OpenVLA's server reports every error in this way, with status 200.
        (Json::String(text), _) if text == "error" => {
            Err(PolicyError::reported("the server reported an error without details. See the log of the server"))
        }
        (Json::String(_), _) => Err(PolicyError::invalid_reply(
            WHAT,
            format!("expected actions, got the text {}", json_numpy::excerpt(&reply.body)),
        )),
        (Json::Array(items), _) if items.iter().all(Json::is_object) => {
            let rows = items.iter().map(|item| Ok(json_numpy::read(WHAT, item)?.numbers()));
            Chunk::of_rows(rows.collect::<Result<_, PolicyError>>()?)
        }
        (Json::Object(map), Api::Gr00tN15 { action_keys, .. }) => {
            let mut rows: Vec<Vec<f64>> = Vec::new();
            for key in action_keys {
                let value = map
                    .get(&format!("action.{key}"))
                    .ok_or_else(|| PolicyError::Shape(format!("the reply has no `action.{key}`")))?;
                Chunk::join(&mut rows, Chunk::columns(&json_numpy::read(WHAT, value)?, key)?, key)?;
            }
            Chunk::of_rows(rows)
        }
        (Json::Object(map), _) if !map.contains_key("__numpy__") => {
            let actions = ["actions", "action"].iter().find_map(|key| map.get(*key));
            let actions = actions.ok_or_else(|| match map.get("error").and_then(Json::as_str) {
                Some(error) => PolicyError::reported(error),
                None => PolicyError::invalid_reply(
                    WHAT,
                    format!(
                        "expected a list of numbers, a NumPy array, or a map with `actions` or `action`, got {}",
                        json_numpy::excerpt(&reply.body)
                    ),
                ),
            })?;
            Chunk::of_array(&json_numpy::read(WHAT, actions)?)
        }
        _ => Chunk::of_array(&json_numpy::read(WHAT, &json)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Capture, fuzz};
    use crate::{Array, Dtype};

    fn openvla() -> Api {
        Api::OpenVla { unnorm_key: Some("bridge_orig".to_owned()) }
    }

    fn gr00t() -> Api {
        Api::Gr00tN15 {
            action_keys: ["x", "y", "z", "roll", "pitch", "yaw", "gripper"].map(str::to_owned).to_vec(),
            language_key: "annotation.human.action.task_description".to_owned(),
        }
    }

    fn query(images: Vec<(String, Array)>, states: Vec<(String, Array)>, instruction: &str) -> Query {
        Query { images, states, instruction: instruction.to_owned(), step: 0, time_s: 0.0 }
    }

    fn picture(bytes: impl Iterator<Item = u8>) -> Array {
        Array::new(Dtype::U8, vec![4, 4, 3], bytes.take(48).collect()).unwrap()
    }

    #[test]
    fn requests_equal_captured_ones() {
        let image = vec![("image".to_owned(), picture(0..))];
        let request = encode(&query(image, vec![], "Pick up the block"), &openvla());
        assert_eq!(request.as_bytes(), Capture::read("openvla", "ok.req.body").bytes);
        let black = || picture(std::iter::repeat(0));
        let images = vec![("full_image".to_owned(), black()), ("wrist_image".to_owned(), black())];
        let state = vec![("state".to_owned(), Array::vector(&[0.0; 8], Dtype::F64))];
        let request = encode(&query(images, state, "pick up"), &Api::OpenVlaOft);
        assert_eq!(request.as_bytes(), Capture::read("openvla_oft", "ok.req.json").bytes);
        let capture = Capture::read("gr00t_n15", "http_ok.req.json");
        let captured: Json = serde_json::from_slice(&capture.bytes).unwrap();
        let arrays = |prefix: &str, names: &[&str]| {
            let array = |name: &&str| {
                let array = json_numpy::read("capture", &captured["observation"][format!("{prefix}.{name}")]).unwrap();
                let shape = array.shape()[1..].to_vec();
                ((*name).to_owned(), array.reshaped(shape))
            };
            names.iter().map(array).collect::<Vec<_>>()
        };
        let images = arrays("video", &["image", "wrist_image"]);
        let states = arrays("state", &["x", "y", "z", "roll", "pitch", "yaw", "gripper"]);
        assert_eq!(encode(&query(images, states, "pick up"), &gr00t()).as_bytes(), capture.bytes);
    }

    fn answer(folder: &str, name: &str, status: u16, api: &Api) -> Result<Chunk, PolicyError> {
        decode(&Reply { status, body: Capture::read(folder, name).bytes }, api)
    }

    #[test]
    fn captured_replies_are_decoded() {
        let chunk = answer("openvla", "ok.rep.body", 200, &openvla()).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (1, 7));
        assert_eq!(chunk.rows()[0][0], 0.01);
        let chunk = answer("openvla_oft", "ok.rep.json", 200, &Api::OpenVlaOft).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (8, 7));
        let chunk = answer("gr00t_n15", "http_ok.rep.json", 200, &gr00t()).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (16, 7));
    }

    #[test]
    fn errors_with_status_200_are_errors() {
        for (folder, name, status) in [
            ("openvla", "no_unnorm.rep.body", 200),
            ("openvla_oft", "err.rep.json", 200),
            ("openvla", "not_json.rep.body", 422),
            ("gr00t_n15", "http_err.rep.json", 500),
        ] {
            let error = answer(folder, name, status, &openvla()).unwrap_err();
            assert!(matches!(error, PolicyError::Reported { .. }), "{name}: {error}");
        }
        // A reply that is encoded twice, to a request that was encoded twice.
        assert!(answer("openvla", "double.rep.body", 200, &openvla()).is_err());
    }

    #[test]
    fn fuzzed_replies_are_read_or_refused() {
        let seeds = [("openvla", "ok.rep.body"), ("openvla_oft", "ok.rep.json"), ("gr00t_n15", "http_ok.rep.json")];
        let seeds = seeds.map(|(folder, name)| Capture::read(folder, name).bytes);
        let apis = [openvla(), Api::OpenVlaOft, gr00t()];
        fuzz("rest", &seeds, |bytes| {
            let reply = Reply { status: 200, body: bytes.to_vec() };
            apis.iter().filter(|api| decode(&reply, api).is_ok()).count() > 0
        });
    }
}
