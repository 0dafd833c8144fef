//! RoboArena's WebSocket server: the encoding of openpi, with server metadata on connection, an `endpoint` in each
//! request and a session for each episode. A text message is not always an error: the reply to `reset` is a text.

use rmpv::ValueRef;
use serde_json::Value as Json;

use super::access::Access;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::msgpack::{self, Keys};
use super::openpi;
use super::profile::{Arm, Profile};
use super::websocket::{Reply, Socket};
use super::{chunk::Chunk, query::Query};

/// A connection to a RoboArena server.
#[derive(Debug)]
pub(crate) struct RoboArena {
    socket: Socket,
    declared: Json,
    session: String,
}

impl RoboArena {
    pub(crate) fn connect(
        url: &str,
        expected: Option<&Profile>,
        access: &Access,
        deadline: Deadline,
    ) -> Result<Self, PolicyError> {
        let socket = Socket::connect(url, access.header("Api-Key"), access, deadline)?;
        let declared = match socket.receive("the metadata of the server", deadline)? {
            Reply::Bytes(bytes) => openpi::metadata(&bytes)?,
            Reply::Text(text) => return Err(PolicyError::reported(&text)),
        };
        if let Some(profile) = expected {
            compare(&declared, profile)?;
        }
        Ok(Self { socket, declared, session: String::new() })
    }
}

impl Connection for RoboArena {
    fn begin(&mut self, _: &str, episode: u64, deadline: Deadline) -> Result<(), PolicyError> {
        self.session = format!("robogate-{}-{episode}", std::process::id());
        match self.socket.request(&reset(&self.session), "reset", deadline)? {
            Reply::Text(text) if text.contains("reset successful") => Ok(()),
            Reply::Text(text) => Err(PolicyError::reported(&text)),
            Reply::Bytes(_) => Err(PolicyError::invalid_reply("reply to reset", "expected a text message")),
        }
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        match self.socket.request(&request(query, &self.session), "infer", deadline)? {
            Reply::Bytes(bytes) => openpi::decode(&bytes),
            Reply::Text(traceback) => Err(PolicyError::reported(&traceback)),
        }
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

/// The request for actions.
fn request<'a>(query: &'a Query, session: &'a str) -> ValueRef<'a> {
    let arrays = |arrays| msgpack::arrays(arrays, Keys::Binary);
    let words = [("prompt", query.instruction.as_str().into()), ("endpoint", "infer".into())];
    let session = ("session_id", session.into());
    msgpack::map(arrays(&query.images).chain([session]).chain(arrays(&query.states)).chain(words))
}

fn reset(session: &str) -> ValueRef<'_> {
    msgpack::map([("session_id", session.into()), ("endpoint", "reset".into())])
}

/// Check the server's metadata against the profile.
fn compare(declared: &Json, profile: &Profile) -> Result<(), PolicyError> {
    let mismatch = |text: String| Err(PolicyError::Mismatch(text));
    let Some(space) = declared.get("action_space").and_then(Json::as_str) else {
        return Err(PolicyError::WrongDialect {
            expected: "roboarena",
            found: "the server sends no `action_space` on connection, which is typical of openpi (dialect openpi)"
                .to_owned(),
        });
    };
    let arm = match space {
        "joint_position" => Arm::JointPositions,
        "joint_velocity" => Arm::JointDeltas,
        "cartesian_velocity" => Arm::ToolDelta,
        other => return mismatch(format!("the action space of the server is `{other}`, which is not supported")),
    };
    if arm != profile.action.arm {
        return mismatch(format!(
            "the action space of the server is `{space}`, but action.arm of the profile is {:?}",
            profile.action.arm
        ));
    }
    let wants = |key: &str| declared.get(key).and_then(Json::as_bool).unwrap_or(false);
    let has = |word: &str| profile.cameras.iter().filter(|camera| camera.key.contains(word)).count();
    if wants("needs_stereo_camera") {
        return mismatch("the server requires stereo images, which are not supported".to_owned());
    }
    if wants("needs_wrist_camera") && has("wrist_image") == 0 {
        return mismatch(
            "the server requires a wrist camera, but the profile has no observation/wrist_image_left".to_owned(),
        );
    }
    let external = declared.get("n_external_cameras").and_then(Json::as_u64).unwrap_or(0);
    if external != has("exterior_image") as u64 {
        return mismatch(format!(
            "the server requires {external} external cameras (observation/exterior_image_0_left and so on), but the profile has {}",
            has("exterior_image")
        ));
    }
    if let Some([height, width]) = declared.get("image_resolution").and_then(Json::as_array).map(Vec::as_slice) {
        let size = (width.as_u64(), height.as_u64());
        let other = |c: &&super::Camera| (Some(c.width as u64), Some(c.height as u64)) != size;
        if let Some(camera) = profile.cameras.iter().find(other) {
            return mismatch(format!(
                "the server requires images of {width} x {height}, but {} of the profile is {} x {}",
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
    fn requests_equal_captured_ones() {
        let capture = Capture::read(FOLDER, "c2s_00_infer_obs.bin");
        let query = query(&capture.msgpack(), "test");
        assert_eq!(msgpack::encode(&request(&query, "38DSA3hd3")), capture.bytes);
        assert_eq!(msgpack::encode(&reset("38DSA3hd3")), Capture::read(FOLDER, "c2s_01_reset.bin").bytes);
    }

    #[test]
    fn metadata_are_compared_with_the_profile() {
        let declared = openpi::metadata(&Capture::read(FOLDER, "s2c_00_config_metadata.bin").bytes).unwrap();
        let mut profile = Profile::from_toml(Profile::built_in("droid-roboarena").unwrap()).unwrap();
        compare(&declared, &profile).unwrap();
        profile.cameras[0].width = 256;
        assert!(compare(&declared, &profile).unwrap_err().to_string().contains("224 x 224"));
        profile.action.arm = Arm::JointDeltas;
        assert!(compare(&declared, &profile).unwrap_err().to_string().contains("joint_position"));
    }

    #[test]
    fn captured_replies_are_decoded() {
        let chunk = openpi::decode(&Capture::read(FOLDER, "s2c_01_action_8x8_f32.bin").bytes).unwrap();
        assert_eq!((chunk.rows().len(), chunk.rows()[0].len()), (8, 8));
    }

    #[test]
    fn fuzzed_replies_are_read_or_refused() {
        let profile = Profile::from_toml(Profile::built_in("droid-roboarena").unwrap()).unwrap();
        let seeds = ["s2c_00_config_metadata.bin", "s2c_01_action_8x8_f32.bin"].map(|n| Capture::read(FOLDER, n).bytes);
        fuzz("roboarena", &seeds, |bytes| {
            let declared = openpi::metadata(bytes).is_ok_and(|declared| {
                let _ = compare(&declared, &profile);
                true
            });
            openpi::decode(bytes).is_ok() || declared
        });
    }
}
