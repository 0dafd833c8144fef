//! Servers that take JSON with arrays in it at `/act`: OpenVLA, OpenVLA-OFT, GR00T N1.5 over HTTP, and the `/act`,
//! `/reset`, `/health` convention by which Octo is served.

use serde_json::Value as Json;

use super::error::ServerError;
use super::exchange::{Chunk, Query};
use super::http::{Http, Reply};
use super::json_numpy;
use super::link::Link;
use super::websocket::Deadline;

/// What `/act` takes and gives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Form {
    /// `vla-scripts/deploy.py` of OpenVLA: pictures, instruction and the statistics' key; one action.
    OpenVla {
        /// Which training set's statistics scale the answer.
        unnorm_key: Option<String>,
    },
    /// That of OpenVLA-OFT: pictures, vectors and instruction in one map; a list of actions.
    OpenVlaOft,
    /// AutoEval's servers: like OpenVLA's, with `/reset` and `/health`.
    Rest {
        /// Which training set's statistics scale the answer, for servers that take it.
        unnorm_key: Option<String>,
    },
    /// `scripts/inference_service.py --http-server` of GR00T N1.5: an observation of flat keys; a map of arrays.
    Gr00tN15 {
        /// The arrays that make an action, in order.
        action_keys: Vec<String>,
        /// The instruction's key.
        language_key: String,
    },
}

/// Such a server.
#[derive(Debug)]
pub(crate) struct Rest {
    http: Http,
    form: Form,
    declared: Json,
}

impl Rest {
    pub(crate) fn connect(url: &str, form: Form, deadline: Deadline) -> Result<Self, ServerError> {
        let http = Http::new(url)?;
        // OpenVLA's server has no /health; FastAPI's description of the paths says what there is.
        let declared = match form {
            Form::Rest { .. } | Form::Gr00tN15 { .. } => {
                let reply = http.get("/health", deadline)?;
                let health: Json = serde_json::from_slice(&reply.body).unwrap_or_default();
                if reply.status != 200 || health.get("status").and_then(Json::as_str) != Some("healthy") {
                    return Err(ServerError::undecodable("the answer to /health", format!("HTTP {}", reply.status)));
                }
                health
            }
            Form::OpenVla { .. } | Form::OpenVlaOft => {
                let reply = http.get("/openapi.json", deadline)?;
                let api: Json = serde_json::from_slice(&reply.body).unwrap_or_default();
                let paths = api.get("paths").and_then(Json::as_object);
                match paths {
                    Some(paths) if reply.status == 200 && paths.contains_key("/act") => {
                        serde_json::json!({"paths": paths.keys().collect::<Vec<_>>()})
                    }
                    _ => {
                        return Err(ServerError::undecodable(
                            "the answer to /openapi.json",
                            format!("HTTP {}", reply.status),
                        ));
                    }
                }
            }
        };
        Ok(Self { http, form, declared })
    }
}

impl Link for Rest {
    fn begin(&mut self, _: &str, _: u64, deadline: Deadline) -> Result<(), ServerError> {
        if !matches!(self.form, Form::Rest { .. }) {
            return Ok(());
        }
        match self.http.post("/reset", "{}", deadline)? {
            // A server without memory has no /reset.
            Reply { status: 200 | 404, .. } => Ok(()),
            Reply { status, body } => Err(refused(status, &body)),
        }
    }

    fn ask(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, ServerError> {
        let reply = self.http.post("/act", &encode(query, &self.form), deadline)?;
        decode(&reply, &self.form)
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

fn refused(status: u16, body: &[u8]) -> ServerError {
    ServerError::refused(&format!("HTTP {status}: {}", String::from_utf8_lossy(body)))
}

/// A question as JSON.
fn encode(query: &Query, form: &Form) -> String {
    let mut json =
        String::with_capacity(64 + query.images.iter().map(|(_, array)| array.data().len() * 4 / 3).sum::<usize>());
    let mut first = true;
    let mut entry = |json: &mut String, key: &str| {
        json.push_str(if std::mem::take(&mut first) { "{" } else { ", " });
        json_numpy::write_text(json, key);
        json.push_str(": ");
    };
    match form {
        Form::Gr00tN15 { language_key, .. } => {
            json.push_str("{\"observation\": ");
            for (key, array) in &query.images {
                entry(&mut json, &format!("video.{key}"));
                json_numpy::write(&mut json, array, 1);
            }
            for (key, array) in &query.states {
                entry(&mut json, &format!("state.{key}"));
                json_numpy::write(&mut json, array, 1);
            }
            entry(&mut json, language_key);
            json.push('[');
            json_numpy::write_text(&mut json, &query.instruction);
            json.push_str("]}}");
        }
        Form::OpenVla { unnorm_key } | Form::Rest { unnorm_key } => {
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
        Form::OpenVlaOft => {
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

/// The actions in an answer.
fn decode(reply: &Reply, form: &Form) -> Result<Chunk, ServerError> {
    const WHAT: &str = "the answer to /act";
    if reply.status != 200 {
        return Err(refused(reply.status, &reply.body));
    }
    let json: Json =
        serde_json::from_slice(&reply.body).map_err(|e| ServerError::undecodable(WHAT, format!("no JSON: {e}")))?;
    match (&json, form) {
        // Whatever went wrong, OpenVLA's server says only this, with status 200; the cause is in its log.
        (Json::String(text), _) if text == "error" => {
            Err(ServerError::refused("\"error\", no more; the cause is in the server's log"))
        }
        (Json::String(_), _) => Err(ServerError::undecodable(WHAT, "a text in place of actions".to_owned())),
        (Json::Array(items), _) => {
            let rows = items.iter().map(|item| Ok(json_numpy::read(WHAT, item)?.numbers()));
            Chunk::of_rows(rows.collect::<Result<_, ServerError>>()?)
        }
        (Json::Object(map), Form::Gr00tN15 { action_keys, .. }) => {
            let mut rows: Vec<Vec<f64>> = Vec::new();
            for key in action_keys {
                let value = map
                    .get(&format!("action.{key}"))
                    .ok_or_else(|| ServerError::Shape(format!("the answer has no `action.{key}`")))?;
                Chunk::join(&mut rows, Chunk::columns(&json_numpy::read(WHAT, value)?, key)?, key)?;
            }
            Chunk::of_rows(rows)
        }
        _ => Chunk::of_array(&json_numpy::read(WHAT, &json)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Capture, fuzz};
    use crate::{Array, Dtype};

    fn openvla() -> Form {
        Form::OpenVla { unnorm_key: Some("bridge_orig".to_owned()) }
    }

    fn gr00t() -> Form {
        Form::Gr00tN15 {
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
    fn questions_are_those_that_python_clients_send_to_the_byte() {
        let image = vec![("image".to_owned(), picture(0..))];
        let asked = encode(&query(image, vec![], "Pick up the block"), &openvla());
        assert_eq!(asked.as_bytes(), Capture::read("openvla", "ok.req.body").bytes);
        let black = || picture(std::iter::repeat(0));
        let images = vec![("full_image".to_owned(), black()), ("wrist_image".to_owned(), black())];
        let state = vec![("state".to_owned(), Array::vector(&[0.0; 8], Dtype::F64))];
        let asked = encode(&query(images, state, "pick up"), &Form::OpenVlaOft);
        assert_eq!(asked.as_bytes(), Capture::read("openvla_oft", "ok.req.json").bytes);
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

    fn answer(folder: &str, name: &str, status: u16, form: &Form) -> Result<Chunk, ServerError> {
        decode(&Reply { status, body: Capture::read(folder, name).bytes }, form)
    }

    #[test]
    fn answers_of_the_upstream_servers_are_understood() {
        let chunk = answer("openvla", "ok.rep.body", 200, &openvla()).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (1, 7));
        assert_eq!(chunk.rows()[0][0], 0.01);
        let chunk = answer("openvla_oft", "ok.rep.json", 200, &Form::OpenVlaOft).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (8, 7));
        let chunk = answer("gr00t_n15", "http_ok.rep.json", 200, &gr00t()).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (16, 7));
    }

    #[test]
    fn an_error_with_status_200_is_an_error() {
        for (folder, name, status) in [
            ("openvla", "no_unnorm.rep.body", 200),
            ("openvla_oft", "err.rep.json", 200),
            ("openvla", "not_json.rep.body", 422),
            ("gr00t_n15", "http_err.rep.json", 500),
        ] {
            let error = answer(folder, name, status, &openvla()).unwrap_err();
            assert!(matches!(error, ServerError::Refused { .. }), "{name}: {error}");
        }
        // Sent encoded twice, the answer is encoded twice; nobody here asks so.
        assert!(answer("openvla", "double.rep.body", 200, &openvla()).is_err());
    }

    #[test]
    fn whatever_bytes_come_decoding_returns() {
        let seeds = [("openvla", "ok.rep.body"), ("openvla_oft", "ok.rep.json"), ("gr00t_n15", "http_ok.rep.json")];
        let seeds = seeds.map(|(folder, name)| Capture::read(folder, name).bytes);
        let forms = [openvla(), Form::OpenVlaOft, gr00t()];
        fuzz(&seeds, |bytes| {
            for form in &forms {
                let _ = decode(&Reply { status: 200, body: bytes.to_vec() }, form);
            }
        });
    }
}
