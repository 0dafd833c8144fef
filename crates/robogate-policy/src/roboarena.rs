//! RoboArena's WebSocket server: openpi's encoding, with a description of itself on connection, an `endpoint` in each
//! question and a session for each episode. Here text is no error: `reset` is answered so.

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::error::ServerError;
use super::exchange::{Chunk, Query};
use super::link::Link;
use super::msgpack::{self, Keys};
use super::openpi;
use super::profile::{Arm, Profile};
use super::websocket::{Answer, Deadline, Socket};

/// A connection to such a server.
#[derive(Debug)]
pub(crate) struct RoboArena {
    socket: Socket,
    declared: Json,
    session: String,
}

impl RoboArena {
    pub(crate) fn connect(url: &str, profile: &Profile, deadline: Deadline) -> Result<Self, ServerError> {
        let socket = Socket::connect(url, deadline)?;
        let declared = match socket.hear("the server's description of itself", deadline)? {
            Answer::Bytes(bytes) => openpi::metadata(&bytes)?,
            Answer::Text(text) => return Err(ServerError::refused(&text)),
        };
        compare(&declared, profile)?;
        Ok(Self { socket, declared, session: String::new() })
    }
}

impl Link for RoboArena {
    fn begin(&mut self, _: &str, episode: u64, deadline: Deadline) -> Result<(), ServerError> {
        self.session = format!("robogate-{}-{episode}", std::process::id());
        match self.socket.ask(&reset(&self.session), "reset", deadline)? {
            Answer::Text(text) if text.contains("reset successful") => Ok(()),
            Answer::Text(text) => Err(ServerError::refused(&text)),
            Answer::Bytes(_) => Err(ServerError::undecodable("the answer to reset", "it is not the text of one")),
        }
    }

    fn ask(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, ServerError> {
        match self.socket.ask(&question(query, &self.session), "infer", deadline)? {
            Answer::Bytes(bytes) => openpi::decode(&bytes),
            Answer::Text(traceback) => Err(ServerError::refused(&traceback)),
        }
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

/// A question.
fn question<'a>(query: &'a Query, session: &'a str) -> ValueRef<'a> {
    let arrays = |arrays| msgpack::arrays(arrays, Keys::Binary);
    let words = [("prompt", query.instruction.as_str().into()), ("endpoint", "infer".into())];
    let session = ("session_id", session.into());
    msgpack::map(arrays(&query.images).chain([session]).chain(arrays(&query.states)).chain(words))
}

fn reset(session: &str) -> ValueRef<'_> {
    msgpack::map([("session_id", session.into()), ("endpoint", "reset".into())])
}

/// Holds the server's description of itself against the profile.
fn compare(declared: &Json, profile: &Profile) -> Result<(), ServerError> {
    let mismatch = |text: String| Err(ServerError::Mismatch(text));
    let Some(space) = declared.get("action_space").and_then(Json::as_str) else {
        return Err(ServerError::OtherDialect {
            wanted: "roboarena",
            found: "what the server sends on connection has no `action_space`; plain openpi servers do not (dialect openpi)"
                .to_owned(),
        });
    };
    let arm = match space {
        "joint_position" => Arm::JointPositions,
        "joint_velocity" => Arm::JointDeltas,
        "cartesian_velocity" => Arm::ToolDelta,
        other => return mismatch(format!("the server acts in `{other}`, which no profile can say")),
    };
    if arm != profile.action.arm {
        return mismatch(format!("the server acts in `{space}`, the profile's action.arm is {:?}", profile.action.arm));
    }
    let wants = |key: &str| declared.get(key).and_then(Json::as_bool).unwrap_or(false);
    let has = |word: &str| profile.cameras.iter().filter(|camera| camera.key.contains(word)).count();
    if wants("needs_stereo_camera") {
        return mismatch("the server wants stereo pictures, which no cell has".to_owned());
    }
    if wants("needs_wrist_camera") && has("wrist_image") == 0 {
        return mismatch("the server wants a wrist camera, the profile has no observation/wrist_image_left".to_owned());
    }
    let external = declared.get("n_external_cameras").and_then(Json::as_u64).unwrap_or(0);
    if external != has("exterior_image") as u64 {
        return mismatch(format!(
            "the server wants {external} external cameras, the profile has {} of observation/exterior_image_0_left and so on",
            has("exterior_image")
        ));
    }
    if let Some([height, width]) = declared.get("image_resolution").and_then(Json::as_array).map(Vec::as_slice) {
        let size = (width.as_u64(), height.as_u64());
        let other = |c: &&super::Camera| (Some(c.width as u64), Some(c.height as u64)) != size;
        if let Some(camera) = profile.cameras.iter().find(other) {
            return mismatch(format!(
                "the server wants pictures of {width} x {height}, the profile's {} is {} x {}",
                camera.key, camera.width, camera.height
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Capture, fuzz, query};

    const FOLDER: &str = "roboarena";

    #[test]
    fn questions_and_resets_are_those_of_roboarenas_own_client_to_the_byte() {
        let capture = Capture::read(FOLDER, "c2s_00_infer_obs.bin");
        let query = query(&capture.msgpack(), "test");
        assert_eq!(msgpack::encode(&question(&query, "38DSA3hd3")), capture.bytes);
        assert_eq!(msgpack::encode(&reset("38DSA3hd3")), Capture::read(FOLDER, "c2s_01_reset.bin").bytes);
    }

    #[test]
    fn what_the_captured_server_says_of_itself_fits_its_profile_and_no_other() {
        let declared = openpi::metadata(&Capture::read(FOLDER, "s2c_00_config_metadata.bin").bytes).unwrap();
        let mut profile = Profile::from_toml(Profile::built_in("droid-roboarena").unwrap()).unwrap();
        compare(&declared, &profile).unwrap();
        profile.cameras[0].width = 256;
        assert!(compare(&declared, &profile).unwrap_err().to_string().contains("224 x 224"));
        profile.action.arm = Arm::JointDeltas;
        assert!(compare(&declared, &profile).unwrap_err().to_string().contains("joint_position"));
    }

    #[test]
    fn answers_of_roboarenas_own_server_are_understood() {
        let chunk = openpi::decode(&Capture::read(FOLDER, "s2c_01_action_8x8_f32.bin").bytes).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (8, 8));
    }

    #[test]
    fn whatever_bytes_come_decoding_returns() {
        let profile = Profile::from_toml(Profile::built_in("droid-roboarena").unwrap()).unwrap();
        let seeds = ["s2c_00_config_metadata.bin", "s2c_01_action_8x8_f32.bin"].map(|n| Capture::read(FOLDER, n).bytes);
        fuzz(&seeds, |bytes| {
            let _ = openpi::metadata(bytes).and_then(|declared| compare(&declared, &profile));
            let _ = openpi::decode(bytes);
        });
    }
}
