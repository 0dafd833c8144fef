//! The checks, with one method each.

use std::collections::BTreeMap;
use std::time::Instant;

use robogate_core::{Action, Command, Scenario, Start, Step, check_applied};
use robogate_zmtp::ZmtpError;
use serde::de::IgnoredAny;

use super::super::connection::{Connection, Timeouts, read_reply};
use super::super::error::RequestError;
use super::super::header::encode;
use super::super::limits::{HEADER_BYTES, VERSION};
use super::super::message::{ActionKind, Empty, ErrorKind, HashReply, ParameterValue, Request, StepRequest};
use super::super::session::Session;
use super::Latency;

/// Number of control periods of the episodes that are compared.
const PERIODS: usize = 20;
/// Number of requests whose latency is measured.
const REQUESTS: usize = 200;
/// Maximum error of a joint after it had time to reach its commanded position, in radians.
const JOINT_TOLERANCE: f64 = 0.03;

/// `Ok`, or a description of the violation.
type Outcome = Result<(), String>;

/// Name, requirement and experiment of a check.
pub(super) type Check<'a> = (&'static str, &'static str, fn(&mut Checker<'a>) -> Outcome);

pub(super) struct Checker<'a> {
    pub(super) connection: Connection,
    pub(super) scenarios: &'a [Scenario],
    pub(super) session: &'a mut dyn Session,
}

fn describe(why: RequestError) -> String {
    match why {
        RequestError::Rejected(error) => format!("rejected with {:?}: {}", error.kind, error.detail),
        other => other.to_string(),
    }
}

/// Check that a request was rejected with one of these kinds of error.
fn expect_rejected<T>(what: &str, reply: Result<T, RequestError>, kinds: &[ErrorKind]) -> Outcome {
    match reply {
        Err(RequestError::Rejected(error)) if kinds.contains(&error.kind) => Ok(()),
        Err(why) => Err(format!("{what}: {}", describe(why))),
        Ok(_) => Err(format!("{what}: not rejected")),
    }
}

impl<'a> Checker<'a> {
    /// All checks, in the order in which they run.
    pub(super) const CHECKS: [Check<'a>; 15] = [
        ("handshake", "hello has the same content each time and for each connection", Self::handshake),
        ("applied", "parameters are read back as requested", Self::applied),
        ("unknown_parameter", "an unknown parameter is rejected with not_applied", Self::unknown_parameter),
        ("declared", "measures and failure modes are those that the task declares", Self::declared),
        ("moves", "joints reach the commanded positions and stay there", Self::moves),
        (
            "deterministic",
            "the same reset and actions give the same replies, if hello declares the server deterministic",
            Self::deterministic,
        ),
        ("other_episode", "a request for another episode is rejected without side effects", Self::other_episode),
        ("other_tick", "a step for another tick is rejected without side effects", Self::other_tick),
        (
            "bad_action",
            "an action that is not finite, out of bounds or of the wrong length is rejected without side effects",
            Self::bad_action,
        ),
        ("order", "step and hash are rejected after close", Self::order),
        ("malformed", "a malformed request is rejected with bad_request", Self::malformed),
        (
            "too_large",
            "a header over the size limit is not accepted, and the next request is answered",
            Self::too_large,
        ),
        (
            "disconnected_client",
            "a client that disconnects during an episode does not affect the next client",
            Self::disconnected_client,
        ),
        ("render", "images have the size given in hello, and rendering has no side effects", Self::render),
        ("motion", "the recorded motion of all bodies begins and ends with the episode", Self::motion),
    ];

    fn scenario(&self, i: usize) -> Result<&Scenario, String> {
        self.scenarios.get(i % self.scenarios.len().max(1)).ok_or_else(|| "no scenario to test".to_owned())
    }

    fn reset(&mut self, i: usize) -> Result<Start, String> {
        let scenario = self.scenario(i)?.clone();
        self.session.reset(&mut self.connection, &scenario).map_err(describe)
    }

    fn step(&mut self, action: &Action) -> Result<Step, RequestError> {
        self.session.step(&mut self.connection, action)
    }

    /// The action of tick `k`, a small motion: of the first joint back and forth, of the tool up and down, or of each
    /// number of a vector around the middle of its bounds.
    fn action(&self, start: &Start, k: usize) -> Action {
        let spec = &self.connection.hello().task.action;
        let swing = (0.4 * k as f64).sin();
        let joints = start.observation.joint_positions();
        let command = match (spec.joints(), spec.vector(), spec.tool_delta()) {
            (Some(_), ..) if !joints.is_empty() => {
                let mut joints = joints.to_vec();
                joints[0] += 0.02 * swing;
                Command::JointPosition(joints)
            }
            (_, Some((low, high)), _) => {
                let number = |(low, high): (&f64, &f64)| 0.5 * (low + high) + 0.05 * swing * (high - low);
                Command::Vector(low.iter().zip(high).map(number).collect())
            }
            (_, _, Some((metres, _))) => {
                let up = if k.is_multiple_of(2) { 0.5 * metres } else { -0.5 * metres };
                Command::ToolDelta { translation_m: [0.0, 0.0, up], rotation_rad: [0.0; 3] }
            }
            (joints, None, None) => Command::JointPosition(vec![0.0; joints.map_or(0, <[String]>::len)]),
        };
        let gripper = if k > PERIODS / 2 { Action::CLOSE } else { Action::OPEN };
        Action { command, gripper: spec.gripper.map(|_| gripper), phase: None }
    }

    /// The kind and the numbers of an action with a small motion and an open gripper.
    fn hold(&self, start: &Start) -> (ActionKind, Vec<f64>) {
        let action = self.action(start, 0);
        let kind = ActionKind::of(&action.command);
        let mut numbers = match action.command {
            Command::JointPosition(numbers) | Command::Vector(numbers) => numbers,
            Command::ToolDelta { .. } => vec![0.0; 6],
        };
        numbers.extend(action.gripper);
        (kind, numbers)
    }

    fn send_step(
        &mut self,
        tick: u64,
        action_space: ActionKind,
        numbers: Vec<f64>,
    ) -> Result<IgnoredAny, RequestError> {
        self.connection.request(
            "step",
            StepRequest { tick, action_space, actions: vec![numbers], ahead: 0, object: None, packed: false },
        )
    }

    /// Check that the episode continues after a request that was rejected.
    fn expect_continues(&mut self, start: &Start) -> Outcome {
        let action = self.action(start, 0);
        let step = self.step(&action).map(drop);
        step.map_err(|why| format!("the episode cannot be continued afterwards: {}", describe(why)))
    }

    fn handshake(&mut self) -> Outcome {
        for _ in 0..2 {
            let address = self.connection.address().clone();
            let other = Connection::open(address, Timeouts::default()).map_err(describe)?;
            if other.hello() != self.connection.hello() {
                return Err("the reply to hello differs between connections".to_owned());
            }
        }
        self.session.accepts(self.connection.hello())
    }

    fn applied(&mut self) -> Outcome {
        for i in 0..self.scenarios.len() {
            let start = self.reset(i)?;
            let requested = &self.scenario(i)?.requested;
            check_applied(requested, &start.applied).map_err(|fault| fault.detail)?;
        }
        Ok(())
    }

    fn unknown_parameter(&mut self) -> Outcome {
        let scenario = self.scenario(0)?.clone();
        let parameters = BTreeMap::from([("robogate_no_such_parameter".to_owned(), ParameterValue::Float(1.0))]);
        let reply = self.session.send_reset(&mut self.connection, &scenario, parameters);
        expect_rejected("reset with an unknown parameter", reply, &[ErrorKind::NotApplied])
    }

    fn declared(&mut self) -> Outcome {
        self.run(0)?;
        let notes: Vec<String> = self.connection.take_notes().into_iter().collect();
        if notes.is_empty() { Ok(()) } else { Err(notes.join("; ")) }
    }

    fn moves(&mut self) -> Outcome {
        let spec = self.connection.hello().task.action.clone();
        let start = self.reset(0)?;
        let home = start.observation.joint_positions().to_vec();
        if spec.joints().is_none() || home.is_empty() {
            return Ok(());
        }
        for (goal, periods) in [(0.0, 10_u32), (0.1, 30)] {
            for k in 1..=periods {
                let mut joints = home.clone();
                if let Some(first) = joints.first_mut() {
                    // A ramp for two thirds of the periods, then constant.
                    *first += goal * f64::from(k.min(periods * 2 / 3)) / f64::from(periods * 2 / 3);
                }
                let command = Command::JointPosition(joints.clone());
                let gripper = spec.gripper.map(|_| Action::OPEN);
                let step = self.step(&Action { command, gripper, phase: None }).map_err(describe)?;
                if step.ending.is_some() {
                    return Err("the episode ended although the arm made a small motion only".to_owned());
                }
                if k == periods {
                    let reached = step.observation.joint_positions();
                    let off = |(is, commanded): (&f64, &f64)| (is - commanded).abs() > JOINT_TOLERANCE;
                    if let Some(i) = reached.iter().zip(&joints).position(off) {
                        let (commanded, is) = (joints[i], reached[i]);
                        return Err(format!("joint {i} was commanded to {commanded:.4} rad but is at {is:.4} rad"));
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
            let step = self.step(&action).map_err(describe)?;
            let ended = step.ending.is_some();
            steps.push(step);
            if ended {
                break;
            }
        }
        Ok(steps)
    }

    fn deterministic(&mut self) -> Outcome {
        let first = self.run(0)?;
        self.run(1)?;
        let again = self.run(0)?;
        if first == again || !self.connection.hello().deterministic {
            return Ok(());
        }
        let tick = first.iter().zip(&again).position(|(a, b)| a != b);
        Err(match tick {
            Some(tick) => format!("two runs of the same scenario differ from tick {tick}"),
            None => "two runs of the same scenario have different lengths".to_owned(),
        })
    }

    fn other_episode(&mut self) -> Outcome {
        let start = self.reset(0)?;
        let (space, numbers) = self.hold(&start);
        let episode = self.connection.episode;
        self.connection.episode = episode ^ 2;
        let reply = self.send_step(0, space, numbers);
        self.connection.episode = episode;
        expect_rejected("step of another episode", reply, &[ErrorKind::BadRequest])?;
        self.expect_continues(&start)
    }

    fn other_tick(&mut self) -> Outcome {
        let start = self.reset(0)?;
        let (space, numbers) = self.hold(&start);
        let early = self.send_step(1, space, numbers.clone());
        expect_rejected("tick 1 before tick 0", early, &[ErrorKind::BadRequest])?;
        self.expect_continues(&start)?;
        expect_rejected("tick 0 twice", self.send_step(0, space, numbers), &[ErrorKind::BadRequest])?;
        self.expect_continues(&start)
    }

    fn bad_action(&mut self) -> Outcome {
        let start = self.reset(0)?;
        let (space, numbers) = self.hold(&start);
        let (mut long, mut nan, mut beyond) = (numbers.clone(), numbers.clone(), numbers);
        long.push(0.0);
        if let Some(first) = nan.first_mut() {
            *first = f64::NAN;
        }
        let reply = self.send_step(0, space, long);
        expect_rejected("action with one number too many", reply, &[ErrorKind::BadAction])?;
        self.expect_continues(&start)?;
        let kinds = [ErrorKind::BadAction, ErrorKind::BadRequest];
        expect_rejected("action with NaN", self.send_step(1, space, nan), &kinds)?;
        self.expect_continues(&start)?;
        let Some((_, high)) = self.connection.hello().task.action.vector() else { return Ok(()) };
        if space == ActionKind::Vector {
            beyond[0] = high[0] + 1.0 + high[0].abs();
            expect_rejected("action out of bounds", self.send_step(2, space, beyond), &kinds)?;
            self.expect_continues(&start)?;
        }
        Ok(())
    }

    fn order(&mut self) -> Outcome {
        let start = self.reset(0)?;
        self.connection.request::<IgnoredAny>("close", Empty {}).map_err(describe)?;
        let (space, numbers) = self.hold(&start);
        expect_rejected("step after close", self.send_step(0, space, numbers), &[ErrorKind::BadRequest])?;
        let hash = self.connection.request::<HashReply>("hash", Empty {});
        expect_rejected("hash after close", hash, &[ErrorKind::BadRequest])
    }

    fn malformed(&mut self) -> Outcome {
        let request = |v: u64, op: &str| encode(&Request { v, op: op.to_owned(), episode: 0, body: Empty {} });
        let (version, op) = (request(VERSION + 1, "hello"), request(VERSION, "no_such_op"));
        let hello = request(VERSION, "hello").map_err(|why| why.to_string())?;
        let mut deep = b"\x82\xa1v\x01\xa1x".to_vec();
        deep.extend_from_slice(&[0x91; 1000]);
        deep.push(0xc0);
        let cases: [(&str, Vec<Vec<u8>>); 8] = [
            ("empty header", vec![Vec::new()]),
            ("text", vec![b"GET / HTTP/1.1".to_vec()]),
            ("array", vec![b"\x93\x01\x02\x03".to_vec()]),
            ("truncated map", vec![b"\x83\xa1v".to_vec()]),
            ("map nested 1000 levels deep", vec![deep]),
            ("another protocol version", vec![version.map_err(|why| why.to_string())?]),
            ("unknown operation", vec![op.map_err(|why| why.to_string())?]),
            ("two frames", vec![hello.clone(), hello]),
        ];
        for (what, frames) in cases {
            let reply = match self.connection.request_raw(&frames) {
                // A server may close the connection of a client that sends too many frames.
                Err(ZmtpError::Closed | ZmtpError::Io(_)) if frames.len() > 1 => continue,
                reply => reply.map_err(|why| format!("{what}: {why}"))?,
            };
            let header = reply.first().map_or(&[][..], Vec::as_slice);
            expect_rejected(what, read_reply::<IgnoredAny>(header, 0), &[ErrorKind::BadRequest])?;
        }
        Ok(())
    }

    fn too_large(&mut self) -> Outcome {
        match self.connection.request_raw(&[vec![0x80; HEADER_BYTES + 1]]) {
            Err(ZmtpError::Closed | ZmtpError::Io(_)) => {}
            Err(why) => return Err(why.to_string()),
            Ok(reply) => {
                let header = reply.first().map_or(&[][..], Vec::as_slice);
                let reply = read_reply::<IgnoredAny>(header, 0);
                expect_rejected("header of 4 MiB and 1 byte", reply, &[ErrorKind::BadRequest])?;
            }
        }
        self.reset(0).map(drop)
    }

    fn disconnected_client(&mut self) -> Outcome {
        self.reset(0)?;
        self.connection.disconnect();
        self.reset(1).map(drop)
    }

    fn render(&mut self) -> Outcome {
        if self.connection.hello().task.observation.cameras.is_empty() {
            return Ok(());
        }
        let start = self.reset(0)?;
        let action = self.action(&start, 0);
        let step = self.step(&action).map_err(describe)?;
        let first = self.connection.render().map_err(describe)?;
        if self.connection.render().map_err(describe)? != first {
            return Err("two renderings of the same state differ".to_owned());
        }
        let reply: HashReply = self.connection.request("hash", Empty {}).map_err(describe)?;
        if reply.state_hash != Some(step.state_hash) {
            return Err("the state hash differs after rendering".to_owned());
        }
        Ok(())
    }

    fn motion(&mut self) -> Outcome {
        if !self.connection.hello().records_motion {
            return Ok(());
        }
        let period_s = self.connection.hello().task.control_period_s;
        self.session.record(Some(period_s));
        let start = self.reset(0);
        self.session.record(None);
        let start = start?;
        for k in 0..3 {
            let action = self.action(&start, k);
            self.step(&action).map_err(describe)?;
        }
        let frames = self.connection.motion().map_err(describe)?.frames;
        let expected = [0.0, 3.0 * period_s];
        let times = [frames.first(), frames.last()].map(|frame| frame.map_or(f64::NAN, |frame| frame.time_s));
        // Times are 32-bit floats.
        if frames.len() == 4 && times.iter().zip(expected).all(|(time_s, due_s)| (time_s - due_s).abs() < 1e-5) {
            return Ok(());
        }
        let count = frames.len();
        Err(format!("{count} frames from {times:?} s after three control periods; expected 4 from {expected:?} s"))
    }

    pub(super) fn latencies(&mut self) -> Result<Vec<Latency>, String> {
        let start = self.reset(0)?;
        let action = self.action(&start, 0);
        let mut latencies = vec![measure("hash", || {
            self.connection.request::<HashReply>("hash", Empty {}).map(drop).map_err(describe)
        })?];
        latencies.push(measure("step", || {
            let step = self.step(&action).map_err(describe)?;
            if step.ending.is_some() { self.reset(0).map(drop) } else { Ok(()) }
        })?);
        self.reset(0)?;
        if !self.connection.hello().task.observation.cameras.is_empty() {
            latencies.push(measure("render", || self.connection.render().map(drop).map_err(describe))?);
        }
        Ok(latencies)
    }
}

fn measure(op: &'static str, mut request: impl FnMut() -> Outcome) -> Result<Latency, String> {
    let mut times = Vec::with_capacity(REQUESTS);
    for _ in 0..REQUESTS {
        let began = Instant::now();
        request()?;
        times.push(began.elapsed());
    }
    times.sort_unstable();
    Ok(Latency { op, median: times[REQUESTS / 2], p99: times[REQUESTS * 99 / 100] })
}
