//! The server's side: a simulator of ours behind the protocol.

use robogate_core::{Action, ArmCommand, Assignment, Fault, GripperCommand, Image, Scenario, Seed, Simulator};
use serde::Serialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use super::bounds::{self, VERSION};
use super::message::{
    ActionSpace, Begun, End, Envelope, ErrorKind, Hashed, Hello, Nothing, Period, Picture, Refusal, Render, Rendered,
    Reply, Request, Reset, Seen, Stepped, Steps, assignment, decode, encode, parameters,
};

/// A simulator that a [`Server`] answers for.
pub trait Host {
    /// What it reads back, where it does not judge.
    type Readback: Serialize;
    /// What it sees in a time step, where it does not judge.
    type Sight: Serialize;

    /// Who it is and what it can do.
    fn hello(&self) -> &Hello;

    /// Sets a scenario up.
    fn reset(&mut self, scenario: &Scenario) -> Result<Begun<Self::Readback, Self::Sight>, Fault>;

    /// Runs one control period.
    fn step(&mut self, arm: ArmCommand, gripper: GripperCommand) -> Result<Period<Self::Sight>, Fault>;

    /// What the cameras show now.
    fn render(&mut self) -> Result<Vec<Image>, Fault>;
}

/// A [`Simulator`] with a world and a task of its own.
pub struct Judging {
    hello: Hello,
    simulator: Box<dyn Simulator>,
}

impl Judging {
    /// This simulator, of which `hello` is true.
    pub fn new(hello: Hello, simulator: Box<dyn Simulator>) -> Self {
        Self { hello: Hello { judges: true, ..hello }, simulator }
    }
}

impl Host for Judging {
    type Readback = Nothing;
    type Sight = Nothing;

    fn hello(&self) -> &Hello {
        &self.hello
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Begun<Nothing, Nothing>, Fault> {
        let start = self.simulator.reset(scenario)?;
        Ok(Begun {
            observation: Seen::from(&start.observation),
            task: Some(start.task),
            applied: Some(parameters(&start.applied)),
            readback: None,
            sight: None,
        })
    }

    fn step(&mut self, arm: ArmCommand, gripper: GripperCommand) -> Result<Period<Nothing>, Fault> {
        let step = self.simulator.step(&Action { arm, gripper, phase: None })?;
        Ok(Period {
            observation: Seen::from(&step.observation),
            state_hash: step.state_hash,
            measures: Some(step.measures),
            ending: step.ending.map(End::from),
            events: Some(step.events),
            sights: None,
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
    under_way: Option<UnderWay>,
}

/// The episode under way.
#[derive(Debug, Clone, Copy)]
struct UnderWay {
    episode: u64,
    tick: u64,
    state_hash: Option<u64>,
}

/// An answer's header and what follows it, or why there is none.
type Answer = Result<Vec<Vec<u8>>, Refusal>;

fn refuse<T>(kind: ErrorKind, detail: impl Into<String>) -> Result<T, Refusal> {
    Err(Refusal { kind, detail: detail.into() })
}

impl<H: Host> Server<H> {
    /// A server for this host.
    pub fn new(host: H) -> Self {
        Self { host, under_way: None }
    }

    /// Who it answers for.
    pub fn hello(&self) -> &Hello {
        self.host.hello()
    }

    /// Answers the frames of one request, whatever they are.
    pub fn answer(&mut self, frames: &[Vec<u8>]) -> Vec<Vec<u8>> {
        let mut episode = 0;
        let refusal = match self.try_answer(frames, &mut episode) {
            Ok(answer) => return answer,
            Err(refusal) => refusal,
        };
        if refusal.kind.ends_episode() {
            self.under_way = None;
        }
        let detail: String = refusal.detail.chars().map(|c| if c.is_control() { ' ' } else { c }).take(1000).collect();
        let error = Some(Refusal { kind: refusal.kind, detail });
        vec![encode(&Envelope { v: VERSION, episode, ok: false, error }).unwrap_or_default()]
    }

    fn try_answer(&mut self, frames: &[Vec<u8>], episode: &mut u64) -> Answer {
        let [header] = frames else {
            return refuse(ErrorKind::BadRequest, format!("a request has one frame, not {}", frames.len()));
        };
        let request: Request<Rest> = read(header)?;
        *episode = request.episode;
        if request.v != VERSION {
            return refuse(ErrorKind::BadRequest, format!("this server speaks version {VERSION} of the protocol"));
        }
        match request.op.as_str() {
            "hello" => reply(*episode, self.host.hello().clone()),
            "reset" => self.reset(header, *episode),
            "step" => {
                let (request, row_length) = (read::<Steps>(header)?, self.host.hello().joints.len() + 1);
                self.under_way(*episode)?;
                self.step(&request, row_length, *episode)
            }
            "render" => {
                self.under_way(*episode)?;
                self.render(&read(header)?, *episode)
            }
            "hash" => {
                let now = self.under_way(*episode)?;
                reply(*episode, Hashed { tick: now.tick, state_hash: now.state_hash })
            }
            "close" => {
                self.under_way(*episode)?;
                self.under_way = None;
                reply(*episode, Nothing {})
            }
            other => {
                let known = "hello, reset, step, render, hash, close";
                let other: String = other.chars().take(40).collect();
                refuse(ErrorKind::BadRequest, format!("there is no op `{other}`; there are {known}"))
            }
        }
    }

    fn under_way(&self, episode: u64) -> Result<UnderWay, Refusal> {
        match self.under_way {
            None => refuse(ErrorKind::BadRequest, "no episode is under way"),
            Some(now) if now.episode != episode => {
                refuse(ErrorKind::BadRequest, format!("episode {episode} is not the one under way"))
            }
            Some(now) => Ok(now),
        }
    }

    fn reset(&mut self, header: &[u8], episode: u64) -> Answer {
        let request: Reset<IgnoredAny> = read(header)?;
        let hello = self.host.hello();
        if request.parameters.len() > bounds::PARAMETERS {
            return refuse(ErrorKind::BadRequest, format!("more than {} parameters", bounds::PARAMETERS));
        }
        if hello.judges == request.cell.is_some() {
            let what = if hello.judges { "has a world of its own and takes no cell" } else { "needs a cell" };
            return refuse(ErrorKind::BadRequest, format!("this server {what}"));
        }
        if let Some(name) = request.parameters.keys().find(|name| !hello.parameters.contains(name)) {
            return refuse(ErrorKind::NotApplied, format!("this server cannot apply the parameter {name}"));
        }
        self.under_way = None;
        let requested = assignment(&request.parameters, &Assignment::default());
        let seed = Seed::campaign(request.seed).episode(request.index);
        let scenario = Scenario { index: request.index, seed, requested };
        let begun = self.host.reset(&scenario).map_err(|fault| Refusal::from(&fault))?;
        let answer = reply(episode, begun)?;
        self.under_way = Some(UnderWay { episode, tick: 0, state_hash: None });
        Ok(answer)
    }

    fn step(&mut self, request: &Steps, row_length: usize, episode: u64) -> Answer {
        let hello = self.host.hello().clone();
        let mut now = self.under_way(episode)?;
        if request.tick != now.tick {
            let detail = format!("tick {} was asked for, {} is due", request.tick, now.tick);
            return refuse(ErrorKind::BadRequest, detail);
        }
        if !hello.action_spaces.contains(&request.action_space) {
            return refuse(ErrorKind::BadRequest, "this server does not take that action space");
        }
        if !(1..=bounds::ACTIONS).contains(&request.actions.len()) {
            return refuse(ErrorKind::BadRequest, format!("a step has 1 to {} actions", bounds::ACTIONS));
        }
        let due = match request.action_space {
            ActionSpace::JointPosition => row_length,
            ActionSpace::ToolDelta => 7,
        };
        if let Some(row) = request.actions.iter().find(|row| row.len() != due) {
            return refuse(ErrorKind::BadAction, format!("an action has {due} numbers, got {}", row.len()));
        }
        let mut steps = Vec::with_capacity(request.actions.len());
        for row in &request.actions {
            let Some((grip, arm)) = row.split_last() else { break };
            let gripper = if *grip > 0.0 { GripperCommand::Close } else { GripperCommand::Open };
            let step = self.host.step(command(&hello, request.action_space, arm), gripper);
            let step = step.map_err(|fault| {
                // Some of its actions may have been run: the episode is no longer what the client thinks it is.
                self.under_way = None;
                Refusal::from(&fault)
            })?;
            now.tick += 1;
            now.state_hash = Some(step.state_hash);
            let over = step.ending.is_some();
            steps.push(step);
            self.under_way = Some(now).filter(|_| !over);
            if over {
                break;
            }
        }
        reply(episode, Stepped { steps })
    }

    fn render(&mut self, request: &Render, episode: u64) -> Answer {
        let cameras = &self.host.hello().cameras;
        if cameras.is_empty() {
            return refuse(ErrorKind::Unsupported, "this simulator has no cameras");
        }
        let known = |name: &String| cameras.iter().any(|camera| camera.name == *name);
        if let Some(name) = request.cameras.iter().flatten().find(|name| !known(name)) {
            let name: String = name.chars().take(40).collect();
            return refuse(ErrorKind::BadRequest, format!("there is no camera `{name}`"));
        }
        let wanted = |image: &Image| request.cameras.as_ref().is_none_or(|names| names.contains(&image.camera));
        let tick = self.under_way(episode)?.tick;
        let shown = self.host.render().map_err(|fault| Refusal::from(&fault))?;
        let (mut images, mut frames) = (Vec::new(), vec![Vec::new()]);
        for Image { camera, width, height, rgb } in shown.into_iter().filter(wanted) {
            images.push(Picture { camera, width, height, frame: frames.len() });
            frames.push(rgb);
        }
        frames[0] = reply(episode, Rendered { tick, images })?.swap_remove(0);
        Ok(frames)
    }
}

/// What a request begins with; the rest is read once it is known what it is.
#[derive(serde::Deserialize)]
struct Rest {}

fn read<T: DeserializeOwned>(header: &[u8]) -> Result<T, Refusal> {
    decode(header).map_err(|why| Refusal { kind: ErrorKind::BadRequest, detail: why.to_string() })
}

fn reply(episode: u64, body: impl Serialize) -> Answer {
    let envelope = Envelope { v: VERSION, episode, ok: true, error: None };
    let header = encode(&Reply { envelope, body }).and_then(|header| bounds::check(&header).map(|()| header));
    // An answer that breaks the protocol does not leave the house: a number that is not finite, above all.
    match header {
        Ok(header) => Ok(vec![header]),
        Err(why @ bounds::Malformed::NotFinite(_)) => refuse(ErrorKind::Diverged, why.to_string()),
        Err(why) => refuse(ErrorKind::Internal, why.to_string()),
    }
}

fn command(hello: &Hello, space: ActionSpace, arm: &[f64]) -> ArmCommand {
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
