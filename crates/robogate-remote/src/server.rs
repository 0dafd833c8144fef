//! The server: makes an environment of this process available over the protocol.

use robogate_core::{
    Action, Assignment, Command, Environment, Fault, GripperKind, Image, Scenario, Seed, TaskSpec, Trajectory,
};
use serde::Serialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use super::header::{MalformedHeader, check, decode, encode};
use super::limits::{self, VERSION};
use super::message::{
    ActionKind, Empty, EndingMessage, Envelope, ErrorKind, ErrorReply, HashReply, Hello, ImageInfo, MotionReply,
    ObservationMessage, Period, RenderReply, RenderRequest, Reply, Request, ResetReply, ResetRequest, StepReply,
    StepRequest, from_wire, to_wire,
};

/// What a [`Server`] makes available: an environment with its own task, or physics only.
pub trait Host {
    /// The cell that a host for physics sets up; [`IgnoredAny`] for a host that scores itself.
    type Cell: DeserializeOwned;
    /// Properties of the cell as read back from the engine; [`Empty`] for a host that scores itself.
    type Readback: Serialize;
    /// Physical state after one time step; [`Empty`] for a host that scores itself.
    type Sample: Serialize;

    /// Identity and capabilities.
    fn hello(&self) -> &Hello;

    /// Set up a scenario. A host for physics gets its cell.
    fn reset(
        &mut self,
        scenario: &Scenario,
        cell: Option<Self::Cell>,
    ) -> Result<ResetReply<Self::Readback, Self::Sample>, Fault>;

    /// Choose the object that the gripper acts on. Only called if the host does not score itself.
    fn select(&mut self, _object: usize) {}

    /// Run one control period. `action` is one that the task of [`Host::hello`] takes.
    fn step(&mut self, action: &Action) -> Result<Period<Self::Sample>, Fault>;

    /// Render all cameras in the current state.
    fn render(&mut self) -> Result<Vec<Image>, Fault>;

    /// Record the motion of all bodies in every later episode, as [`Environment::record_trajectory`].
    fn record(&mut self, _period_s: Option<f64>) {}

    /// The recorded motion of the last episode, empty without one. Only called if [`Host::hello`] offers it.
    fn motion(&mut self) -> Trajectory {
        Trajectory::default()
    }
}

/// A [`Host`] for an [`Environment`] of this process.
pub struct EnvironmentHost {
    hello: Hello,
    environment: Box<dyn Environment>,
}

impl EnvironmentHost {
    /// A host for this environment. `hello` describes the server; its task is replaced by that of the environment, and
    /// `scores_itself` and `records_motion` are set to true.
    pub fn new(hello: Hello, environment: Box<dyn Environment>) -> Self {
        let task = TaskSpec::clone(environment.task());
        Self { hello: Hello { scores_itself: true, records_motion: true, task, ..hello }, environment }
    }
}

impl Host for EnvironmentHost {
    type Cell = IgnoredAny;
    type Readback = Empty;
    type Sample = Empty;

    fn hello(&self) -> &Hello {
        &self.hello
    }

    fn reset(&mut self, scenario: &Scenario, _: Option<IgnoredAny>) -> Result<ResetReply<Empty, Empty>, Fault> {
        let start = self.environment.reset(scenario)?;
        let draws = self.environment.draws(scenario)?;
        Ok(ResetReply {
            observation: ObservationMessage::from(&start.observation),
            instance: Some(start.instance),
            applied: Some(to_wire(&start.applied)),
            draws: (!draws.is_empty()).then(|| draws.iter().map(|(name, x)| (name.to_string(), Some(x))).collect()),
            readback: None,
            sample: None,
            proposed: None,
        })
    }

    fn step(&mut self, action: &Action) -> Result<Period<Empty>, Fault> {
        let step = self.environment.step(action)?;
        let measures = step.measures.iter().map(|(name, value)| (name.to_string(), Some(value)));
        Ok(Period {
            observation: ObservationMessage::from(&step.observation),
            state_hash: step.state_hash,
            measures: Some(measures.collect()),
            foregone: self.environment.foregone_ending().filter(|_| step.ending.is_none()).map(EndingMessage::from),
            ending: step.ending.map(EndingMessage::from),
            events: Some(step.events),
            samples: None,
            clearance_m: None,
            proposed: None,
        })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        self.environment.render()
    }

    fn record(&mut self, period_s: Option<f64>) {
        self.environment.record_trajectory(period_s);
    }

    fn motion(&mut self) -> Trajectory {
        self.environment.take_trajectory().unwrap_or_default()
    }
}

/// Answers requests for a host.
pub struct Server<H> {
    host: H,
    running: Option<Running>,
    /// The episode whose motion is recorded.
    recorded: Option<u64>,
    /// The episode that has ended, and the control periods that it ran. Its final state may be rendered.
    ended: Option<(u64, u64)>,
}

/// The running episode.
#[derive(Debug, Clone, Copy)]
struct Running {
    episode: u64,
    tick: u64,
    state_hash: Option<u64>,
}

/// The frames of a reply, or the error that is sent instead.
type Frames = Result<Vec<Vec<u8>>, ErrorReply>;

fn reject<T>(kind: ErrorKind, detail: impl Into<String>) -> Result<T, ErrorReply> {
    Err(ErrorReply { kind, detail: detail.into() })
}

impl<H: Host> Server<H> {
    /// Create a server for this host.
    pub fn new(host: H) -> Self {
        Self { host, running: None, recorded: None, ended: None }
    }

    /// Identity and capabilities of the host.
    pub fn hello(&self) -> &Hello {
        self.host.hello()
    }

    /// Answer a request. Every request gets a reply, even if it is malformed.
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
                let request = read::<StepRequest>(header)?;
                self.running(*episode)?;
                self.step(&request, *episode)
            }
            "render" => self.render(&read(header)?, *episode),
            "hash" => {
                let running = self.running(*episode)?;
                reply(*episode, HashReply { tick: running.tick, state_hash: running.state_hash })
            }
            "motion" => self.motion(*episode),
            "close" => {
                self.running(*episode)?;
                (self.running, self.ended) = (None, None);
                reply(*episode, Empty {})
            }
            other => {
                let known = "hello, reset, step, render, hash, motion, close";
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
        let request: ResetRequest<H::Cell> = read(header)?;
        let hello = self.host.hello();
        if request.parameters.len() > limits::PARAMETERS {
            return reject(ErrorKind::BadRequest, format!("more than {} parameters", limits::PARAMETERS));
        }
        if hello.scores_itself == request.cell.is_some() {
            let what = if hello.scores_itself { "has its own task and takes no cell" } else { "needs a cell" };
            return reject(ErrorKind::BadRequest, format!("this server {what}"));
        }
        if let Some(policy) = &request.policy {
            let policy: String = policy.chars().take(40).collect();
            return reject(ErrorKind::Setup, format!("this server declares no policy `{policy}`"));
        }
        if let Some(name) = request.parameters.keys().find(|name| hello.task.parameter(name).is_none()) {
            let detail = format!("the task `{}` declares no parameter `{name}`", hello.task.name);
            return reject(ErrorKind::NotApplied, detail);
        }
        if request.record_s.is_some_and(|period_s| period_s <= 0.0) {
            return reject(ErrorKind::BadRequest, "record_s must be above 0");
        }
        (self.running, self.ended) = (None, None);
        self.recorded = request.record_s.map(|_| episode).filter(|_| hello.records_motion);
        self.host.record(request.record_s);
        let requested = from_wire(&request.parameters, &Assignment::default());
        let seed = Seed::campaign(request.seed).episode(request.index);
        let scenario = Scenario { index: request.index, seed, requested };
        let start = self.host.reset(&scenario, request.cell).map_err(|fault| ErrorReply::from(&fault))?;
        let frames = reply(episode, start)?;
        self.running = Some(Running { episode, tick: 0, state_hash: None });
        Ok(frames)
    }

    fn step(&mut self, request: &StepRequest, episode: u64) -> Frames {
        let mut running = self.running(episode)?;
        if request.tick != running.tick {
            let detail = format!("the request is for tick {}; expected tick {}", request.tick, running.tick);
            return reject(ErrorKind::BadRequest, detail);
        }
        if !(1..=limits::ACTIONS).contains(&request.actions.len()) {
            return reject(ErrorKind::BadRequest, format!("a step must have 1 to {} actions", limits::ACTIONS));
        }
        if request.object.is_some() && self.host.hello().scores_itself {
            return reject(ErrorKind::BadRequest, "this server has its own task, which chooses the object");
        }
        // All actions are checked before one is run: a rejected request has no effect.
        let task = &self.host.hello().task;
        let actions = request.actions.iter().map(|numbers| decode_action(task, request.action_space, numbers));
        let actions: Vec<Action> = actions.collect::<Result<_, _>>()?;
        if let Some(object) = request.object {
            self.host.select(object);
        }
        let mut steps = Vec::with_capacity(actions.len());
        for action in &actions {
            let step = self.host.step(action).map_err(|fault| {
                // Earlier actions of this request have run, so the client cannot know the state of the episode.
                self.running = None;
                ErrorReply::from(&fault)
            })?;
            running.tick += 1;
            running.state_hash = Some(step.state_hash);
            let ended = step.ending.is_some();
            steps.push(step);
            self.running = Some(running).filter(|_| !ended);
            if ended {
                self.ended = Some((episode, running.tick));
                break;
            }
        }
        reply(episode, StepReply { steps, packed: None, later: Vec::new() })
    }

    fn render(&mut self, request: &RenderRequest, episode: u64) -> Frames {
        let tick = match self.ended {
            Some((ended, tick)) if ended == episode => tick,
            _ => self.running(episode)?.tick,
        };
        let cameras = &self.host.hello().task.observation.cameras;
        if cameras.is_empty() {
            return reject(ErrorKind::Unsupported, "this simulator has no cameras");
        }
        let known = |name: &String| cameras.iter().any(|camera| camera.name == *name);
        if let Some(name) = request.cameras.iter().flatten().find(|name| !known(name)) {
            let name: String = name.chars().take(40).collect();
            return reject(ErrorKind::BadRequest, format!("unknown camera `{name}`"));
        }
        let requested = |image: &Image| request.cameras.as_ref().is_none_or(|names| names.contains(&image.camera));
        let rendered = self.host.render().map_err(|fault| ErrorReply::from(&fault))?;
        let (mut images, mut frames) = (Vec::new(), vec![Vec::new()]);
        for Image { camera, width, height, rgb } in rendered.into_iter().filter(requested) {
            images.push(ImageInfo { camera, width, height, frame: frames.len() });
            frames.push(rgb);
        }
        frames[0] = reply(episode, RenderReply { tick, images })?.swap_remove(0);
        Ok(frames)
    }

    fn motion(&mut self, episode: u64) -> Frames {
        // An episode that has ended is still the recorded one.
        if self.recorded != Some(episode) {
            return reject(ErrorKind::BadRequest, format!("the motion of episode {episode} is not recorded"));
        }
        self.recorded = None;
        let (header, [motion, triangles, contacts]) = MotionReply::pack(&self.host.motion());
        let header = reply(episode, header)?.swap_remove(0);
        Ok(vec![header, motion, triangles, contacts])
    }
}

/// The keys of an unknown operation.
#[derive(serde::Deserialize)]
struct AnyBody {}

fn read<T: DeserializeOwned>(header: &[u8]) -> Result<T, ErrorReply> {
    decode(header).map_err(|why| ErrorReply { kind: ErrorKind::BadRequest, detail: why.to_string() })
}

fn reply(episode: u64, body: impl Serialize) -> Frames {
    let envelope = Envelope { v: VERSION, episode, ok: true, error: None };
    let header = encode(&Reply { envelope, body }).and_then(|header| check(&header).map(|()| header));
    // A reply that violates the protocol is never sent. The usual cause is a number that is not finite.
    match header {
        Ok(header) => Ok(vec![header]),
        Err(why @ MalformedHeader::NotFinite(_)) => reject(ErrorKind::Diverged, why.to_string()),
        Err(why) => reject(ErrorKind::Internal, why.to_string()),
    }
}

/// The action of these numbers.
pub(crate) fn decode_action(task: &TaskSpec, kind: ActionKind, numbers: &[f64]) -> Result<Action, ErrorReply> {
    let spec = &task.action;
    let (length, scale) = match kind {
        ActionKind::JointPosition => (spec.joints().map(<[String]>::len), None),
        ActionKind::ToolDelta => (spec.tool_delta().map(|_| 6), spec.tool_delta()),
        ActionKind::Vector => (spec.vector().map(|(low, _)| low.len()), None),
    };
    let Some(length) = length else {
        let detail = format!("this task does not take {kind}. Expected {}", spec.kinds());
        return reject(ErrorKind::BadRequest, detail);
    };
    let expected = length + usize::from(spec.gripper.is_some());
    if numbers.len() != expected {
        let detail = format!("an action of kind {kind} must have {expected} numbers, not {}", numbers.len());
        return reject(ErrorKind::BadAction, detail);
    }
    let (command, gripper) = numbers.split_at(length);
    let command = match (kind, scale, command) {
        (ActionKind::ToolDelta, Some((metres, radians)), [x, y, z, a, b, c]) => Command::ToolDelta {
            translation_m: [x, y, z].map(|n| n.clamp(-1.0, 1.0) * metres),
            rotation_rad: [a, b, c].map(|n| n.clamp(-1.0, 1.0) * radians),
        },
        (ActionKind::Vector, ..) => Command::Vector(command.to_vec()),
        _ => Command::JointPosition(command.to_vec()),
    };
    let gripper = spec.gripper.zip(gripper.first()).map(|(kind, number)| match kind {
        GripperKind::Binary if *number > 0.0 => Action::CLOSE,
        GripperKind::Binary => Action::OPEN,
        GripperKind::Continuous => number.clamp(Action::OPEN, Action::CLOSE),
    });
    let action = Action { command, gripper, phase: None };
    match task.check_action(&action) {
        Ok(()) => Ok(action),
        Err(why) => reject(ErrorKind::BadAction, why),
    }
}
