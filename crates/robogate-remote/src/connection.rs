//! A connection to one server.

use std::collections::BTreeSet;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::time::Duration;

use robogate_core::{CameraSpec, Fault, FaultKind, Image, Observation, Trajectory};
use robogate_zmtp::{Address, Requester, ZmtpError};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::{RequestError, violation};
use super::header::{decode, encode};
use super::limits::{self, VERSION};
use super::message::{
    ActionKind, Empty, Envelope, ErrorKind, ErrorReply, Hello, MotionReply, ObservationMessage, Period, RenderReply,
    RenderRequest, Request, StepReply, StepRequest,
};

/// How long the client waits for each kind of reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timeouts {
    /// Timeout for connecting, and for the reply to `hello`.
    pub hello: Duration,
    /// Timeout for the reply to `reset`.
    pub reset: Duration,
    /// Timeout for the reply to any other request.
    pub step: Duration,
}

impl Timeouts {
    /// Timeouts derived from that of a step: `hello` has the same, `reset` four times as long.
    pub fn from_step(step: Duration) -> Self {
        Self { hello: step, reset: step.saturating_mul(4), step }
    }
}

impl Default for Timeouts {
    fn default() -> Self {
        Self::from_step(Duration::from_secs(30))
    }
}

/// A connection to a server, with the state of the running episode.
#[derive(Debug)]
pub struct Connection {
    requester: Requester,
    timeouts: Timeouts,
    hello: Hello,
    /// Identifier of the running episode.
    pub(crate) episode: u64,
    /// Number of control periods run in it.
    pub(crate) tick: u64,
    /// Deviations from the declared task that do not make an episode invalid.
    notes: BTreeSet<String>,
}

/// Maximum number of notes of a connection.
const NOTES: usize = 64;

impl Connection {
    /// Connect to a server and check its reply to `hello`.
    pub fn open(address: Address, timeouts: Timeouts) -> Result<Self, RequestError> {
        let connection = Self::open_unchecked(address, timeouts)?;
        connection.hello.check().map_err(violation)?;
        Ok(connection)
    }

    /// Connect to a server whose reply to `hello` may violate the protocol.
    pub(crate) fn open_unchecked(address: Address, timeouts: Timeouts) -> Result<Self, RequestError> {
        let mut requester = Requester::new(address, limits::REPLY);
        let (hello, _): (Hello, _) = send(&mut requester, "hello", 0, Empty {}, timeouts.hello)?;
        Ok(Self { requester, timeouts, hello, episode: 0, tick: 0, notes: BTreeSet::new() })
    }

    /// Keep a note on a deviation from the declared task.
    pub(crate) fn note(&mut self, note: String) {
        if self.notes.len() < NOTES {
            self.notes.insert(note);
        }
    }

    /// Take the notes that were kept.
    pub(crate) fn take_notes(&mut self) -> BTreeSet<String> {
        std::mem::take(&mut self.notes)
    }

    /// The server's reply to `hello`.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Address of the server.
    pub fn address(&self) -> &Address {
        self.requester.address()
    }

    /// Request a new episode under a new random identifier.
    pub(crate) fn begin<T: DeserializeOwned>(&mut self, body: impl Serialize) -> Result<T, RequestError> {
        // The identifier only has to be unique among clients. It does not influence results, so the random numbers of
        // the standard library are sufficient.
        self.episode = RandomState::new().build_hasher().finish() | 1;
        self.tick = 0;
        let (reply, frames) = send(&mut self.requester, "reset", self.episode, body, self.timeouts.reset)?;
        self.expect_no_frames(&frames)?;
        Ok(reply)
    }

    /// Send a request of the running episode. The reply must consist of a header only.
    pub(crate) fn request<T: DeserializeOwned>(&mut self, op: &str, body: impl Serialize) -> Result<T, RequestError> {
        let (reply, frames) = self.request_with_frames(op, body)?;
        self.expect_no_frames(&frames)?;
        Ok(reply)
    }

    /// Send a request of the running episode. The reply may have frames after its header.
    fn request_with_frames<T: DeserializeOwned>(
        &mut self,
        op: &str,
        body: impl Serialize,
    ) -> Result<(T, Vec<Vec<u8>>), RequestError> {
        send(&mut self.requester, op, self.episode, body, self.timeouts.step)
    }

    /// Send these bytes unchecked and return the reply unchecked.
    pub(crate) fn request_raw(&mut self, frames: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, ZmtpError> {
        self.requester.request(frames, self.timeouts.step)
    }

    /// Run one action, with a gripper that acts on this object. Returns the result of its control period and the checked
    /// observation.
    pub(crate) fn run<S: DeserializeOwned>(
        &mut self,
        action_space: ActionKind,
        action: Vec<f64>,
        object: Option<usize>,
    ) -> Result<(Period<S>, Observation), RequestError> {
        let request =
            StepRequest { tick: self.tick, action_space, actions: vec![action], ahead: 0, object, packed: false };
        let (mut period, _) = self.send_step(request)?;
        let observation = self.advance(&mut period)?;
        Ok((period, observation))
    }

    /// Run one action, and let the server run up to `ahead` further control periods with the actions of its own policy.
    /// Returns the result of the first control period, and those of the others. [`Connection::advance`] checks each.
    pub(crate) fn run_ahead<S: DeserializeOwned>(
        &mut self,
        action_space: ActionKind,
        action: Vec<f64>,
        ahead: u32,
    ) -> Result<(Period<S>, Vec<Period<S>>), RequestError> {
        let request = StepRequest {
            tick: self.tick,
            action_space,
            actions: vec![action],
            ahead,
            object: None,
            packed: ahead > 0,
        };
        self.send_step(request)
    }

    fn send_step<S: DeserializeOwned>(
        &mut self,
        request: StepRequest,
    ) -> Result<(Period<S>, Vec<Period<S>>), RequestError> {
        let ahead = request.ahead;
        let (reply, frames): (StepReply<S>, _) = self.request_with_frames("step", request)?;
        let mut steps = reply.steps;
        match reply.packed {
            Some(packed) => {
                let before = self.tick + steps.len() as u64;
                steps.extend(packed.unpack(&frames, &self.hello.task, before).map_err(violation)?);
                steps.extend(reply.later);
            }
            None => self.expect_no_frames(&frames)?,
        }
        let count = steps.len();
        let mut steps = steps.into_iter();
        match steps.next() {
            Some(first) if count <= 1 + ahead as usize => Ok((first, steps.collect())),
            _ if ahead == 0 => Err(violation(format!("the reply has {count} steps for one action"))),
            _ => Err(violation(format!("the reply has {count} steps; expected 1 to {}", 1 + ahead))),
        }
    }

    /// Count a control period that was run, and check its observation.
    pub(crate) fn advance<S>(&mut self, period: &mut Period<S>) -> Result<Observation, RequestError> {
        self.tick += 1;
        let time_s = self.tick as f64 * self.hello.task.control_period_s;
        let vectors = std::mem::take(&mut period.observation.vectors);
        let message = ObservationMessage { time_s: period.observation.time_s, vectors };
        message.checked(&self.hello.task, time_s).map_err(violation)
    }

    /// Render all cameras of the server in its current state.
    pub fn render(&mut self) -> Result<Vec<Image>, RequestError> {
        self.render_some(None)
    }

    /// Render the cameras of these names, or all.
    pub(crate) fn render_some(&mut self, wanted: Option<&[String]>) -> Result<Vec<Image>, RequestError> {
        if self.hello.task.observation.cameras.is_empty() {
            return Err(RequestError::Local(Fault::new(FaultKind::Setup, "this simulator has no cameras")));
        }
        let declared = self.hello.task.observation.cameras.iter();
        let cameras: Vec<CameraSpec> =
            declared.filter(|camera| wanted.is_none_or(|names| names.contains(&camera.name))).cloned().collect();
        let names = wanted.map(|_| cameras.iter().map(|camera| camera.name.clone()).collect());
        let (reply, frames): (RenderReply, _) = self.request_with_frames("render", RenderRequest { cameras: names })?;
        if reply.tick != self.tick {
            return Err(violation(format!("the images are of tick {}; expected tick {}", reply.tick, self.tick)));
        }
        if reply.images.len() != cameras.len() || frames.len() != cameras.len() {
            let (images, sent, expected) = (reply.images.len(), frames.len(), cameras.len());
            return Err(violation(format!("the reply has {images} images in {sent} frames; expected {expected}")));
        }
        let mut frames: Vec<Option<Vec<u8>>> = frames.into_iter().map(Some).collect();
        let mut images = Vec::with_capacity(cameras.len());
        for (camera, info) in cameras.iter().zip(reply.images) {
            let rgb = info.frame.checked_sub(1).and_then(|i| frames.get_mut(i)).and_then(Option::take);
            let rgb = rgb.ok_or_else(|| violation(format!("the image of {} has no separate frame", camera.name)))?;
            let same = (&info.camera, info.width, info.height) == (&camera.name, camera.width, camera.height);
            if !same || rgb.len() != 3 * camera.width * camera.height {
                let (name, width, height) = (&camera.name, camera.width, camera.height);
                return Err(violation(format!("the image of {name} is not {width} x {height} pixels of 3 bytes")));
            }
            images.push(Image { camera: info.camera, width: info.width, height: info.height, rgb });
        }
        Ok(images)
    }

    /// The recorded motion of the last episode.
    pub(crate) fn motion(&mut self) -> Result<Trajectory, RequestError> {
        let (reply, frames): (MotionReply, _) = self.request_with_frames("motion", Empty {})?;
        reply.unpack(&frames).map_err(violation)
    }

    /// Close the connection, so that a late reply is never read.
    pub(crate) fn disconnect(&mut self) {
        self.requester.disconnect();
    }

    fn expect_no_frames(&mut self, frames: &[Vec<u8>]) -> Result<(), RequestError> {
        if frames.is_empty() {
            return Ok(());
        }
        self.requester.disconnect();
        Err(violation(format!("{} unexpected frames after the header", frames.len())))
    }
}

fn send<T: DeserializeOwned>(
    requester: &mut Requester,
    op: &str,
    episode: u64,
    body: impl Serialize,
    timeout: Duration,
) -> Result<(T, Vec<Vec<u8>>), RequestError> {
    let request = encode(&Request { v: VERSION, op: op.to_owned(), episode, body })?;
    let mut frames = requester.request(&[request], timeout)?;
    let header = if frames.is_empty() { Vec::new() } else { frames.remove(0) };
    let reply = read_reply(&header, episode);
    // After an invalid reply the state of the server is unknown, so the client opens a new connection.
    let usable = !matches!(
        reply,
        Err(RequestError::Malformed(_) | RequestError::ProtocolViolation(_) | RequestError::OtherVersion { .. })
    );
    if !usable {
        requester.disconnect();
    }
    Ok((reply?, frames))
}

/// Decode the header of a reply of this episode.
pub(crate) fn read_reply<T: DeserializeOwned>(header: &[u8], episode: u64) -> Result<T, RequestError> {
    let envelope: Envelope = decode(header)?;
    if envelope.v != VERSION {
        return Err(RequestError::OtherVersion { server: envelope.v });
    }
    // A server that could not decode the request does not know its episode.
    let unknown = episode != 0 && !envelope.ok && envelope.episode == 0;
    if envelope.episode != episode && !unknown {
        return Err(violation(format!("the reply is of episode {}; expected {episode}", envelope.episode)));
    }
    match (envelope.ok, envelope.error) {
        (true, _) => Ok(decode(header)?),
        (false, Some(mut error)) => {
            error.detail = error.detail.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
            Err(RequestError::Rejected(error))
        }
        (false, None) => {
            let detail = "the server gave no reason".to_owned();
            Err(RequestError::Rejected(ErrorReply { kind: ErrorKind::Internal, detail }))
        }
    }
}
