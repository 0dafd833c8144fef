//! openpi's WebSocket server (`scripts/serve_policy.py`): one binary message each way, msgpack with binary array keys.
//!
//! On connection the server sends its metadata. Any text message is a Python traceback, after which it hangs up. It
//! keeps no state between questions.

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::error::ServerError;
use super::exchange::{Chunk, Query};
use super::link::Link;
use super::msgpack::{self, Keys};
use super::websocket::{Answer, Deadline, Socket};

/// A connection to such a server.
#[derive(Debug)]
pub(crate) struct Openpi {
    socket: Socket,
    metadata: Json,
}

impl Openpi {
    pub(crate) fn connect(url: &str, deadline: Deadline) -> Result<Self, ServerError> {
        let socket = Socket::connect(url, deadline)?;
        let metadata = match socket.hear("the server's metadata", deadline) {
            Ok(Answer::Bytes(bytes)) => metadata(&bytes)?,
            Ok(Answer::Text(text)) => return Err(ServerError::refused(&text)),
            // An openpi server sends them at once.
            Err(ServerError::Timeout { .. }) => {
                return Err(ServerError::OtherDialect {
                    wanted: "openpi",
                    found: "the WebSocket there sends no metadata; a vla-eval server does not (dialect vla-eval)"
                        .to_owned(),
                });
            }
            Err(e) => return Err(e),
        };
        if metadata.get("action_space").is_some() && metadata.get("n_external_cameras").is_some() {
            return Err(ServerError::OtherDialect {
                wanted: "openpi",
                found: "the metadata are those of a RoboArena server (dialect roboarena)".to_owned(),
            });
        }
        Ok(Self { socket, metadata })
    }
}

impl Link for Openpi {
    fn begin(&mut self, _: &str, _: u64, _: Deadline) -> Result<(), ServerError> {
        Ok(())
    }

    fn ask(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, ServerError> {
        match self.socket.ask(&question(query), "infer", deadline)? {
            Answer::Bytes(bytes) => decode(&bytes),
            Answer::Text(traceback) => Err(ServerError::refused(&traceback)),
        }
    }

    fn declared(&self) -> &Json {
        &self.metadata
    }
}

/// A question.
fn question(query: &Query) -> ValueRef<'_> {
    let arrays = |arrays| msgpack::arrays(arrays, Keys::Binary);
    let prompt = ("prompt", query.instruction.as_str().into());
    msgpack::map(arrays(&query.images).chain(arrays(&query.states)).chain([prompt]))
}

/// The actions in an answer.
pub(crate) fn decode(bytes: &[u8]) -> Result<Chunk, ServerError> {
    const WHAT: &str = "the answer to infer";
    let answer = msgpack::decode(WHAT, bytes)?;
    let actions = msgpack::get(&answer, "actions")
        .ok_or_else(|| ServerError::undecodable(WHAT, "it has no `actions`".to_owned()))?;
    Chunk::of_array(&msgpack::read_array(WHAT, actions)?)
}

/// What the server says of itself.
pub(crate) fn metadata(bytes: &[u8]) -> Result<Json, ServerError> {
    const WHAT: &str = "the server's metadata";
    let value = msgpack::decode(WHAT, bytes)?;
    if msgpack::entries(&value).is_none() {
        return Err(ServerError::undecodable(WHAT, "it is no map".to_owned()));
    }
    Ok(msgpack::to_json(&value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Capture, query};

    const FOLDER: &str = "openpi";

    #[test]
    fn questions_are_those_of_openpis_own_client_to_the_byte() {
        for (name, instruction) in
            [("c2s_00_obs_libero_4x4.bin", "pick up the black bowl"), ("c2s_02_obs_droid_4x4.bin", "do something")]
        {
            let capture = Capture::read(FOLDER, name);
            let query = query(&capture.msgpack(), instruction);
            assert_eq!(msgpack::encode(&question(&query)), capture.bytes, "{name}");
        }
    }

    #[test]
    fn answers_of_openpis_own_server_are_understood() {
        let libero = decode(&Capture::read(FOLDER, "s2c_01_action_libero_10x7_f64.bin").bytes).unwrap();
        assert_eq!((libero.rows().len(), libero.rows()[0].len()), (10, 7));
        // The stub behind the captured server counts in hundredths.
        assert_eq!(libero.rows()[0][..3], [0.0, 0.01, 0.02]);
        let droid = decode(&Capture::read(FOLDER, "s2c_03_action_droid_10x8.bin").bytes).unwrap();
        assert_eq!((droid.rows().len(), droid.rows()[0].len()), (10, 8));
    }

    #[test]
    fn metadata_are_kept_as_they_are() {
        let metadata = metadata(&Capture::read(FOLDER, "s2c_00_metadata.bin").bytes).unwrap();
        assert_eq!(metadata, serde_json::json!({"reset_pose": [0, -1.5, 1.5, 0, 0, 0]}));
    }

    #[test]
    fn whatever_bytes_come_decoding_returns() {
        let seeds =
            ["s2c_00_metadata.bin", "s2c_01_action_libero_10x7_f64.bin"].map(|n| Capture::read(FOLDER, n).bytes);
        crate::tests::fuzz(&seeds, |bytes| {
            let _ = decode(bytes);
            let _ = metadata(bytes);
        });
    }
}
