//! A server held to the protocol by experiment: what anyone can run against their own.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use robogate_core::{Action, ArmCommand, GripperCommand, Scenario, Start, Step, check_applied};
use serde::de::IgnoredAny;

use super::bounds::{HEADER_BYTES, VERSION};
use super::client::World;
use super::link::{AskError, Link, Patience, read};
use super::message::{ActionSpace, ErrorKind, Hashed, Hello, Nothing, Number, Request, Reset, Steps, encode};
use robogate_zmtp::{Address, ZmtpError};

/// Control periods of the episodes that are compared.
const PERIODS: usize = 20;
/// Questions whose times are taken.
const QUESTIONS: usize = 200;
/// How far a joint may be from where it was sent, once it had time to get there, in radians.
const JOINT_OFF: f64 = 0.03;

/// What an experiment found.
#[derive(Debug, Clone, PartialEq)]
pub struct Clause {
    /// Its name.
    pub name: &'static str,
    /// What is demanded.
    pub demand: &'static str,
    /// What happened, where the demand is not met.
    pub broken: Option<String>,
}

/// Times of questions and their answers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Speed {
    /// What was asked.
    pub op: &'static str,
    /// The median.
    pub median: Duration,
    /// 99 of 100 are answered within this.
    pub p99: Duration,
}

/// All that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Who answered.
    pub hello: Hello,
    /// Every clause.
    pub clauses: Vec<Clause>,
    /// How fast.
    pub speeds: Vec<Speed>,
}

impl Report {
    /// Whether the server keeps the contract.
    pub fn holds(&self) -> bool {
        self.clauses.iter().all(|clause| clause.broken.is_none())
    }
}

/// Why a demand is not met, in words.
type Found = Result<(), String>;

/// A clause: its name, its demand, its experiment.
type Experiment<'a, W> = (&'static str, &'static str, fn(&mut Examiner<'a, W>) -> Found);

/// Holds the server at `address` to the protocol. `scenarios` (two at least) are those that its parameters are
/// tried with; `world` is there for a server that does not judge.
pub fn examine<W: World>(
    address: &Address,
    patience: Patience,
    scenarios: &[Scenario],
    world: Option<&mut W>,
) -> Result<Report, AskError> {
    let link = Link::connect(address.clone(), patience)?;
    let hello = link.hello().clone();
    let mut examiner = Examiner { link, scenarios, world };
    let experiments: [Experiment<'_, W>; 13] = [
        ("handshake", "hello says the same again, and for another connection", Examiner::handshake),
        ("applied", "parameters come back as they were asked for", Examiner::applied),
        ("unknown_parameter", "a parameter that there is not is refused with not_applied", Examiner::unknown_parameter),
        ("moves", "joints go where they are sent, and stay there", Examiner::moves),
        (
            "deterministic",
            "the same reset and actions give the same answers, if hello says so",
            Examiner::deterministic,
        ),
        ("other_episode", "a request for another episode is refused and changes nothing", Examiner::other_episode),
        ("other_tick", "a step of another tick is refused and changes nothing", Examiner::other_tick),
        (
            "bad_action",
            "an action of the wrong length or not finite is refused and changes nothing",
            Examiner::bad_action,
        ),
        ("order", "nothing is run before a reset and after a close", Examiner::order),
        ("malformed", "bytes that are no request are answered with bad_request", Examiner::malformed),
        ("too_large", "a header beyond the bound is not taken, and the next request is answered", Examiner::too_large),
        ("gone_client", "a client that goes away in the middle does not hinder the next", Examiner::gone_client),
        ("render", "pictures have the size that hello says, and looking changes nothing", Examiner::render),
    ];
    let mut clauses = Vec::new();
    for (name, demand, experiment) in experiments {
        let broken = experiment(&mut examiner).err();
        clauses.push(Clause { name, demand, broken });
    }
    // Times of a server that does not answer as it should mean nothing.
    let speeds = if clauses.iter().all(|clause| clause.broken.is_none()) { examiner.speeds() } else { Ok(Vec::new()) };
    let speeds = speeds.unwrap_or_else(|why| {
        clauses.push(Clause { name: "speed", demand: "questions are answered", broken: Some(why) });
        Vec::new()
    });
    Ok(Report { hello, clauses, speeds })
}

struct Examiner<'a, W> {
    link: Link,
    scenarios: &'a [Scenario],
    world: Option<&'a mut W>,
}

fn words(why: AskError) -> String {
    match why {
        AskError::Refused(refusal) => format!("refused with {:?}: {}", refusal.kind, refusal.detail),
        other => other.to_string(),
    }
}

/// Whether an answer is a refusal of one of these kinds.
fn refused<T>(what: &str, answer: Result<T, AskError>, kinds: &[ErrorKind]) -> Found {
    match answer {
        Err(AskError::Refused(refusal)) if kinds.contains(&refusal.kind) => Ok(()),
        Err(why) => Err(format!("{what}: {}", words(why))),
        Ok(_) => Err(format!("{what} was not refused")),
    }
}

impl<W: World> Examiner<'_, W> {
    fn scenario(&self, i: usize) -> Result<&Scenario, String> {
        self.scenarios.get(i % self.scenarios.len().max(1)).ok_or_else(|| "no scenario to try it with".to_owned())
    }

    fn reset(&mut self, i: usize) -> Result<Start, String> {
        let scenario = self.scenario(i)?.clone();
        self.link.reset(&scenario, self.world.as_deref_mut()).map_err(words)
    }

    fn step(&mut self, action: &Action) -> Result<Step, AskError> {
        self.link.step(action, self.world.as_deref_mut())
    }

    fn speaks_joints(&self) -> bool {
        self.link.hello().action_spaces.contains(&ActionSpace::JointPosition)
    }

    /// An action at tick `k`: the first joint to and fro, or the tool up and down.
    fn action(&self, start: &Start, k: usize) -> Action {
        let arm = if self.speaks_joints() {
            let mut joints = start.observation.joint_positions.clone();
            if let Some(first) = joints.first_mut() {
                *first += 0.02 * (0.4 * k as f64).sin();
            }
            ArmCommand::JointPositions(joints)
        } else {
            let step = self.link.hello().tool_delta.map_or(0.0, |scale| 0.5 * scale.translation_m);
            let up = if k.is_multiple_of(2) { step } else { -step };
            ArmCommand::ToolDelta { translation_m: [0.0, 0.0, up], rotation_rad: [0.0; 3] }
        };
        let gripper = if k > PERIODS / 2 { GripperCommand::Close } else { GripperCommand::Open };
        Action { arm, gripper, phase: None }
    }

    /// A row of numbers that moves nothing.
    fn still(&self, start: &Start) -> (ActionSpace, Vec<f64>) {
        let mut row = if self.speaks_joints() { start.observation.joint_positions.clone() } else { vec![0.0; 6] };
        row.push(-1.0);
        (if self.speaks_joints() { ActionSpace::JointPosition } else { ActionSpace::ToolDelta }, row)
    }

    fn send(&mut self, tick: u64, action_space: ActionSpace, row: Vec<f64>) -> Result<IgnoredAny, AskError> {
        self.link.ask("step", Steps { tick, action_space, actions: vec![row] })
    }

    /// Whether the episode goes on as if nothing had been.
    fn goes_on(&mut self, start: &Start) -> Found {
        let action = self.action(start, 0);
        self.step(&action).map(drop).map_err(|why| format!("afterwards the episode does not go on: {}", words(why)))
    }

    fn handshake(&mut self) -> Found {
        for _ in 0..2 {
            let other = Link::connect(self.link.address().clone(), Patience::default()).map_err(words)?;
            if other.hello() != self.link.hello() {
                return Err("another connection is told something else".to_owned());
            }
        }
        let Some(world) = &self.world else { return Ok(()) };
        world.accepts(self.link.hello())
    }

    fn applied(&mut self) -> Found {
        for i in 0..self.scenarios.len() {
            let start = self.reset(i)?;
            let requested = &self.scenario(i)?.requested;
            check_applied(requested, &start.applied).map_err(|fault| fault.detail)?;
        }
        Ok(())
    }

    fn unknown_parameter(&mut self) -> Found {
        let scenario = self.scenario(0)?.clone();
        let parameters = BTreeMap::from([("robogate_no_such_parameter".to_owned(), Number::Float(1.0))]);
        let cell = match self.world.as_deref_mut() {
            Some(world) => Some(world.brief(&scenario).map_err(|fault| fault.to_string())?),
            None => None,
        };
        let request = Reset { index: 0, seed: 0, parameters, cell };
        refused("the parameter", self.link.begin::<IgnoredAny>(request), &[ErrorKind::NotApplied])
    }

    fn moves(&mut self) -> Found {
        if !self.speaks_joints() {
            return Ok(());
        }
        let start = self.reset(0)?;
        let home = start.observation.joint_positions.clone();
        for (goal, periods) in [(0.0, 10_u32), (0.1, 30)] {
            for k in 1..=periods {
                let mut joints = home.clone();
                if let Some(first) = joints.first_mut() {
                    // Gently, and then there for the last third.
                    *first += goal * f64::from(k.min(periods * 2 / 3)) / f64::from(periods * 2 / 3);
                }
                let arm = ArmCommand::JointPositions(joints.clone());
                let step = self.step(&Action { arm, gripper: GripperCommand::Open, phase: None }).map_err(words)?;
                if step.ending.is_some() {
                    return Err("the episode ends while the arm hardly moves".to_owned());
                }
                if k == periods {
                    let there = step.observation.joint_positions;
                    if let Some((i, (is, due))) =
                        there.iter().zip(&joints).enumerate().find(|(_, (is, due))| (*is - *due).abs() > JOINT_OFF)
                    {
                        return Err(format!("joint {i} was sent to {due:.4} and is at {is:.4}"));
                    }
                }
            }
        }
        Ok(())
    }

    fn run(&mut self, scenario: usize) -> Result<Vec<Step>, String> {
        let start = self.reset(scenario)?;
        let mut steps = Vec::new();
        for k in 0..PERIODS {
            let action = self.action(&start, k);
            let step = self.step(&action).map_err(words)?;
            let over = step.ending.is_some();
            steps.push(step);
            if over {
                break;
            }
        }
        Ok(steps)
    }

    fn deterministic(&mut self) -> Found {
        let first = self.run(0)?;
        self.run(1)?;
        let again = self.run(0)?;
        if first == again || !self.link.hello().deterministic {
            return Ok(());
        }
        let tick = first.iter().zip(&again).position(|(a, b)| a != b);
        Err(match tick {
            Some(tick) => format!("the second run differs from tick {tick} on"),
            None => "the second run has another length".to_owned(),
        })
    }

    fn other_episode(&mut self) -> Found {
        let start = self.reset(0)?;
        let (space, row) = self.still(&start);
        let episode = self.link.episode;
        self.link.episode = episode ^ 2;
        let answer = self.send(0, space, row);
        self.link.episode = episode;
        refused("a step of another episode", answer, &[ErrorKind::BadRequest])?;
        self.goes_on(&start)
    }

    fn other_tick(&mut self) -> Found {
        let start = self.reset(0)?;
        let (space, row) = self.still(&start);
        refused("tick 1 before tick 0", self.send(1, space, row.clone()), &[ErrorKind::BadRequest])?;
        self.goes_on(&start)?;
        refused("tick 0 again", self.send(0, space, row), &[ErrorKind::BadRequest])?;
        self.goes_on(&start)
    }

    fn bad_action(&mut self) -> Found {
        let start = self.reset(0)?;
        let (space, row) = self.still(&start);
        let (mut long, mut nan) = (row.clone(), row);
        long.push(0.0);
        if let Some(first) = nan.first_mut() {
            *first = f64::NAN;
        }
        refused("a number too many", self.send(0, space, long), &[ErrorKind::BadAction])?;
        self.goes_on(&start)?;
        let kinds = [ErrorKind::BadAction, ErrorKind::BadRequest];
        refused("a number that is not finite", self.send(1, space, nan), &kinds)?;
        self.goes_on(&start)
    }

    fn order(&mut self) -> Found {
        let start = self.reset(0)?;
        self.link.ask::<IgnoredAny>("close", Nothing {}).map_err(words)?;
        let (space, row) = self.still(&start);
        refused("a step after close", self.send(0, space, row), &[ErrorKind::BadRequest])?;
        refused("a hash after close", self.link.ask::<Hashed>("hash", Nothing {}), &[ErrorKind::BadRequest])
    }

    fn malformed(&mut self) -> Found {
        let other = |v: u64, op: &str| encode(&Request { v, op: op.to_owned(), episode: 0, body: Nothing {} });
        let (version, op) = (other(VERSION + 1, "hello"), other(VERSION, "no_such_op"));
        let hello = other(VERSION, "hello").map_err(|why| why.to_string())?;
        let mut deep = b"\x82\xa1v\x01\xa1x".to_vec();
        deep.extend_from_slice(&[0x91; 1000]);
        deep.push(0xc0);
        let cases: [(&str, Vec<Vec<u8>>); 8] = [
            ("nothing", vec![Vec::new()]),
            ("text", vec![b"GET / HTTP/1.1".to_vec()]),
            ("a list", vec![b"\x93\x01\x02\x03".to_vec()]),
            ("a map that is cut off", vec![b"\x83\xa1v".to_vec()]),
            ("a map nested 1000 deep", vec![deep]),
            ("another version", vec![version.map_err(|why| why.to_string())?]),
            ("an op that there is not", vec![op.map_err(|why| why.to_string())?]),
            ("two frames", vec![hello.clone(), hello]),
        ];
        for (what, frames) in cases {
            let answer = match self.link.ask_raw(&frames) {
                // Whoever sends more frames than there can be may lose the connection.
                Err(ZmtpError::Closed | ZmtpError::Io(_)) if frames.len() > 1 => continue,
                answer => answer.map_err(|why| format!("{what}: {why}"))?,
            };
            let header = answer.first().map_or(&[][..], Vec::as_slice);
            refused(what, read::<IgnoredAny>(header, 0), &[ErrorKind::BadRequest])?;
        }
        Ok(())
    }

    fn too_large(&mut self) -> Found {
        let answer = self.link.ask_raw(&[vec![0x80; HEADER_BYTES + 1]]);
        match answer {
            Err(ZmtpError::Closed | ZmtpError::Io(_)) => {}
            Err(why) => return Err(why.to_string()),
            Ok(answer) => {
                let header = answer.first().map_or(&[][..], Vec::as_slice);
                refused("4 MiB and a byte", read::<IgnoredAny>(header, 0), &[ErrorKind::BadRequest])?;
            }
        }
        self.reset(0).map(drop)
    }

    fn gone_client(&mut self) -> Found {
        self.reset(0)?;
        self.link.disconnect();
        self.reset(1).map(drop)
    }

    fn render(&mut self) -> Found {
        if self.link.hello().cameras.is_empty() {
            return Ok(());
        }
        let start = self.reset(0)?;
        let action = self.action(&start, 0);
        let step = self.step(&action).map_err(words)?;
        let (one, other) = (self.link.render().map_err(words)?, self.link.render().map_err(words)?);
        if one != other {
            return Err("two looks at the same moment show different pictures".to_owned());
        }
        let hashed: Hashed = self.link.ask("hash", Nothing {}).map_err(words)?;
        if hashed.state_hash != Some(step.state_hash) {
            return Err("the state's hash is another after looking".to_owned());
        }
        Ok(())
    }

    fn speeds(&mut self) -> Result<Vec<Speed>, String> {
        let start = self.reset(0)?;
        let action = Action { gripper: GripperCommand::Open, ..self.action(&start, 0) };
        let mut speeds = vec![time("hash", || self.link.ask::<Hashed>("hash", Nothing {}).map(drop).map_err(words))?];
        speeds.push(time("step", || {
            let step = self.step(&action).map_err(words)?;
            if step.ending.is_some() { self.reset(0).map(drop) } else { Ok(()) }
        })?);
        self.reset(0)?;
        if !self.link.hello().cameras.is_empty() {
            speeds.push(time("render", || self.link.render().map(drop).map_err(words))?);
        }
        Ok(speeds)
    }
}

fn time(op: &'static str, mut ask: impl FnMut() -> Found) -> Result<Speed, String> {
    let mut times = Vec::with_capacity(QUESTIONS);
    for _ in 0..QUESTIONS {
        let began = Instant::now();
        ask()?;
        times.push(began.elapsed());
    }
    times.sort_unstable();
    Ok(Speed { op, median: times[QUESTIONS / 2], p99: times[QUESTIONS * 99 / 100] })
}
