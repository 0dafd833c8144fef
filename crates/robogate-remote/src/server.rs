//! The server side: an environment of this process, available over the protocol.

use robogate_core::{Action, ArmCommand, Assignment, Fault, GripperCommand, Image, Scenario, Seed, Simulator};
use serde::Serialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use super::header::{MalformedHeader, check, decode, encode};
use super::limits::{self, VERSION};
use super::message::{
    ActionSpace, Empty, EndingMessage, Envelope, ErrorKind, ErrorReply, HashReply, Hello, ImageInfo,
    ObservationMessage, Period, RenderReply, RenderRequest, Reply, Request, ResetReply, ResetRequest, StepReply,
    StepRequest, from_wire, to_wire,
};

/// What a [`Server`] makes available: an environment with its own task, or physics alone.
pub trait Host {
    /// Properties of the cell as read back from the engine; [`Empty`] for a host that scores itself.
    type Readback: Serialize;
    /// Physical state after one time step; [`Empty`] for a host that scores itself.
    type Sample: Serialize;

    /// Identity and capabilities.
    fn hello(&self) -> &Hello;

    /// Set up a scenario.
    fn reset(&mut self, scenario: &Scenario) -> Result<ResetReply<Self::Readback, Self::Sample>, Fault>;

    /// Run one control period.
    fn step(&mut self, arm: ArmCommand, gripper: GripperCommand) -> Result<Period<Self::Sample>, Fault>;

    /// Render all cameras in the current state.
    fn render(&mut self) -> Result<Vec<Image>, Fault>;
}

/// A [`Host`] for a [`Simulator`], which has its own task.
pub struct EnvironmentHost {
    hello: Hello,
    simulator: Box<dyn Simulator>,
}

impl EnvironmentHost {
    /// A host for this simulator. `hello` describes it; `scores_itself` is set to true.
    pub fn new(hello: Hello, simulator: Box<dyn Simulator>) -> Self {
        Self { hello: Hello { scores_itself: true, ..hello }, simulator }
    }
}

impl Host for EnvironmentHost {
    type Readback = Empty;
    type Sample = Empty;

    fn hello(&self) -> &Hello {
        &self.hello
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<ResetReply<Empty, Empty>, Fault> {
        let start = self.simulator.reset(scenario)?;
        Ok(ResetReply {
            observation: ObservationMessage::from(&start.observation),
            task: Some(start.task),
            applied: Some(to_wire(&start.applied)),
            readback: None,
            sample: None,
        })
    }

    fn step(&mut self, arm: ArmCommand, gripper: GripperCommand) -> Result<Period<Empty>, Fault> {
        let step = self.simulator.step(&Action { arm, gripper, phase: None })?;
        Ok(Period {
            observation: ObservationMessage::from(&step.observation),
            state_hash: step.state_hash,
            measures: Some(step.measures),
            ending: step.ending.map(EndingMessage::from),
            events: Some(step.events),
            samples: None,
            clearance_m: None,
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        self.simulator.render()
    }
}

/// Answers requests for a host.
pub struct Server<H> {
    host: H,
    running: Option<Running>,
}

/// The running episode.
#[derive(Debug, Clone, Copy)]
struct Running {
    episode: u64,
    tick: u64,
    state_hash: Option<u64>,
}

/// The frames of a reply, or the error to send in their place.
type Frames = Result<Vec<Vec<u8>>, ErrorReply>;

fn reject<T>(kind: ErrorKind, detail: impl Into<String>) -> Result<T, ErrorReply> {
    Err(ErrorReply { kind, detail: detail.into() })
}

impl<H: Host> Server<H> {
    /// A server for this host.
    pub fn new(host: H) -> Self {
        Self { host, running: None }
    }

    /// Identity and capabilities of the host.
    pub fn hello(&self) -> &Hello {
        self.host.hello()
    }

    /// Answer a request. Any frames get a reply.
    pub fn answer(&mut self, frames: &[Vec<u8>]) -> Vec<Vec<u8>> {
        let mut episode = 0;
        let error = match self.try_answer(frames, &mut episode) {
            Ok(reply) => return reply,
            Err(error) => error,
        };
        if error.kind.ends_episode() {
            self.running = None;
        }
        let detail: String = error.detail.chars().map(|c| if c.is_control() { ' ' } else { c }).take(1000).collect();
        let error = Some(ErrorReply { kind: error.kind, detail });
        vec![encode(&Envelope { v: VERSION, episode, ok: false, error }).unwrap_or_default()]
    }

    fn try_answer(&mut self, frames: &[Vec<u8>], episode: &mut u64) -> Frames {
        let [header] = frames else {
            return reject(ErrorKind::BadRequest, format!("a request must have one frame, not {}", frames.len()));
        };
        let request: Request<AnyBody> = read(header)?;
        *episode = request.episode;
        if request.v != VERSION {
            let detail = format!("this server uses version {VERSION} of the protocol, the request has {}", request.v);
            return reject(ErrorKind::BadRequest, detail);
        }
        match request.op.as_str() {
            "hello" => reply(*episode, self.host.hello().clone()),
            "reset" => self.reset(header, *episode),
            "step" => {
                let (request, joint_numbers) = (read::<StepRequest>(header)?, self.host.hello().joints.len() + 1);
                self.running(*episode)?;
                self.step(&request, joint_numbers, *episode)
            }
            "render" => {
                self.running(*episode)?;
                self.render(&read(header)?, *episode)
            }
            "hash" => {
                let running = self.running(*episode)?;
                reply(*episode, HashReply { tick: running.tick, state_hash: running.state_hash })
            }
            "close" => {
                self.running(*episode)?;
                self.running = None;
                reply(*episode, Empty {})
            }
            other => {
                let known = "hello, reset, step, render, hash, close";
                let other: String = other.chars().take(40).collect();
                reject(ErrorKind::BadRequest, format!("unknown operation `{other}`. Expected one of: {known}"))
            }
        }
    }

    fn running(&self, episode: u64) -> Result<Running, ErrorReply> {
        match self.running {
            None => reject(ErrorKind::BadRequest, "no episode is running"),
            Some(running) if running.episode != episode => {
                reject(ErrorKind::BadRequest, format!("episode {episode} is not running"))
            }
            Some(running) => Ok(running),
        }
    }

    fn reset(&mut self, header: &[u8], episode: u64) -> Frames {
        let request: ResetRequest<IgnoredAny> = read(header)?;
        let hello = self.host.hello();
        if request.parameters.len() > limits::PARAMETERS {
            return reject(ErrorKind::BadRequest, format!("more than {} parameters", limits::PARAMETERS));
        }
        if hello.scores_itself == request.cell.is_some() {
            let what = if hello.scores_itself { "has its own task and takes no cell" } else { "needs a cell" };
            return reject(ErrorKind::BadRequest, format!("this server {what}"));
        }
        if let Some(name) = request.parameters.keys().find(|name| !hello.parameters.contains(name)) {
            return reject(ErrorKind::NotApplied, format!("this server cannot apply the parameter {name}"));
        }
        self.running = None;
        let requested = from_wire(&request.parameters, &Assignment::default());
        let seed = Seed::campaign(request.seed).episode(request.index);
        let scenario = Scenario { index: request.index, seed, requested };
        let start = self.host.reset(&scenario).map_err(|fault| ErrorReply::from(&fault))?;
        let frames = reply(episode, start)?;
        self.running = Some(Running { episode, tick: 0, state_hash: None });
        Ok(frames)
    }

    fn step(&mut self, request: &StepRequest, joint_numbers: usize, episode: u64) -> Frames {
        let hello = self.host.hello().clone();
        let mut running = self.running(episode)?;
        if request.tick != running.tick {
            let detail = format!("the request is for tick {}; expected tick {}", request.tick, running.tick);
            return reject(ErrorKind::BadRequest, detail);
        }
        if !hello.action_spaces.contains(&request.action_space) {
            return reject(ErrorKind::BadRequest, "this server does not take this action space");
        }
        if !(1..=limits::ACTIONS).contains(&request.actions.len()) {
            return reject(ErrorKind::BadRequest, format!("a step must have 1 to {} actions", limits::ACTIONS));
        }
        let expected = match request.action_space {
            ActionSpace::JointPosition => joint_numbers,
            ActionSpace::ToolDelta => 7,
        };
        if let Some(numbers) = request.actions.iter().find(|numbers| numbers.len() != expected) {
            let detail = format!("an action must have {expected} numbers, not {}", numbers.len());
            return reject(ErrorKind::BadAction, detail);
        }
        let mut steps = Vec::with_capacity(request.actions.len());
        for numbers in &request.actions {
            let Some((gripper, arm)) = numbers.split_last() else { break };
            let gripper = if *gripper > 0.0 { GripperCommand::Close } else { GripperCommand::Open };
            let step = self.host.step(decode_arm(&hello, request.action_space, arm), gripper);
            let step = step.map_err(|fault| {
                // Earlier actions of this request have run, so that the client cannot know the state of the episode.
                self.running = None;
                ErrorReply::from(&fault)
            })?;
            running.tick += 1;
            running.state_hash = Some(step.state_hash);
            let ended = step.ending.is_some();
            steps.push(step);
            self.running = Some(running).filter(|_| !ended);
            if ended {
                break;
            }
        }
        reply(episode, StepReply { steps })
    }

    fn render(&mut self, request: &RenderRequest, episode: u64) -> Frames {
        let cameras = &self.host.hello().cameras;
        if cameras.is_empty() {
            return reject(ErrorKind::Unsupported, "this simulator has no cameras");
        }
        let known = |name: &String| cameras.iter().any(|camera| camera.name == *name);
        if let Some(name) = request.cameras.iter().flatten().find(|name| !known(name)) {
            let name: String = name.chars().take(40).collect();
            return reject(ErrorKind::BadRequest, format!("unknown camera `{name}`"));
        }
        let requested = |image: &Image| request.cameras.as_ref().is_none_or(|names| names.contains(&image.camera));
        let tick = self.running(episode)?.tick;
        let rendered = self.host.render().map_err(|fault| ErrorReply::from(&fault))?;
        let (mut images, mut frames) = (Vec::new(), vec![Vec::new()]);
        for Image { camera, width, height, rgb } in rendered.into_iter().filter(requested) {
            images.push(ImageInfo { camera, width, height, frame: frames.len() });
            frames.push(rgb);
        }
        frames[0] = reply(episode, RenderReply { tick, images })?.swap_remove(0);
        Ok(frames)
    }
}

/// The keys of an operation that is not known yet.
#[derive(serde::Deserialize)]
struct AnyBody {}

fn read<T: DeserializeOwned>(header: &[u8]) -> Result<T, ErrorReply> {
    decode(header).map_err(|why| ErrorReply { kind: ErrorKind::BadRequest, detail: why.to_string() })
}

fn reply(episode: u64, body: impl Serialize) -> Frames {
    let envelope = Envelope { v: VERSION, episode, ok: true, error: None };
    let header = encode(&Reply { envelope, body }).and_then(|header| check(&header).map(|()| header));
    // A reply that breaks the protocol is never sent. The common case is a number that is not finite.
    match header {
        Ok(header) => Ok(vec![header]),
        Err(why @ MalformedHeader::NotFinite(_)) => reject(ErrorKind::Diverged, why.to_string()),
        Err(why) => reject(ErrorKind::Internal, why.to_string()),
    }
}

fn decode_arm(hello: &Hello, space: ActionSpace, arm: &[f64]) -> ArmCommand {
    match (space, hello.tool_delta) {
        (ActionSpace::ToolDelta, Some(scale)) => {
            let at = |i: usize| arm.get(i).map_or(0.0, |x| x.clamp(-1.0, 1.0));
            ArmCommand::ToolDelta {
                translation_m: [0, 1, 2].map(|i| at(i) * scale.translation_m),
                rotation_rad: [3, 4, 5].map(|i| at(i) * scale.rotation_rad),
            }
        }
        _ => ArmCommand::JointPositions(arm.to_vec()),
    }
}
