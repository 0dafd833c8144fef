//! LeRobot's asynchronous inference server: gRPC with Python pickles as payloads.
//!
//! The client selects the checkpoint that the server loads. The state of the server is global, so only one client may
//! use it. If its inference fails, it sends an empty reply and logs the cause. It executes the pickles that it
//! receives, so only trusted clients may reach it. This client executes no pickles (see `pickle`).

use std::collections::BTreeMap;

use serde_json::Value as Json;

use super::array::Array;
use super::connection::Connection;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::grpc::{self, Channel};
use super::pickle::{self, Value, Writer};
use super::profile::LeRobot;
use super::{chunk::Chunk, query::Query};

const MODULE: &str = "lerobot.async_inference.helpers";
/// Largest part of an observation on the wire, in bytes.
const PART: usize = 2 << 20;

/// A connection to a LeRobot server.
#[derive(Debug)]
pub(crate) struct LeRobotServer {
    channel: Channel,
    settings: LeRobot,
    chunk: usize,
    /// Whether the policy setup was sent.
    configured: bool,
    /// Number of observations sent. The server accepts each number only once.
    sent: u64,
}

impl LeRobotServer {
    pub(crate) fn connect(
        url: &str,
        settings: &LeRobot,
        chunk: usize,
        deadline: Deadline,
    ) -> Result<Self, PolicyError> {
        let mut channel = Channel::connect(url, deadline)?;
        let ready = channel.call("/transport.AsyncInference/Ready", &[Vec::new()], deadline);
        ready.map_err(|error| match error {
            // A server with TLS closes a connection without it.
            PolicyError::Closed { when, reason } => {
                let hint = "Hint: if the server uses TLS, which is not supported for gRPC, use a tunnel";
                PolicyError::Closed { when, reason: format!("{reason}. {hint}") }
            }
            other => other,
        })?;
        Ok(Self { channel, settings: settings.clone(), chunk, configured: false, sent: 0 })
    }
}

impl Connection for LeRobotServer {
    fn begin(&mut self, _: &str, _: u64, deadline: Deadline) -> Result<(), PolicyError> {
        // The server drops pending observations and resets their numbers.
        self.channel.call("/transport.AsyncInference/Ready", &[Vec::new()], deadline).map(drop)
    }

    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError> {
        if !self.configured {
            let setup = grpc::bytes_field(1, &encode_setup(&self.settings, self.chunk, query));
            self.channel.call("/transport.AsyncInference/SendPolicyInstructions", &[setup], deadline)?;
            self.configured = true;
        }
        let number = i32::try_from(self.sent).unwrap_or(i32::MAX);
        self.sent += 1;
        let parts = split(&encode_observation(query, query.time_s, number));
        self.channel.call("/transport.AsyncInference/SendObservations", &parts, deadline)?;
        let reply = self.channel.call("/transport.AsyncInference/GetActions", &[Vec::new()], deadline)?;
        match grpc::read_bytes_field(&reply, 1)? {
            [] => Err(PolicyError::reported(
                "the server sent no actions: its inference failed or exceeded its observation timeout. See the log of the server",
            )),
            actions => decode(actions),
        }
    }

    fn declared(&self) -> &Json {
        &Json::Null
    }
}

/// Split a payload into messages with a transfer state: 1 begin, 2 middle, 3 end.
fn split(payload: &[u8]) -> Vec<Vec<u8>> {
    let last = payload.len().div_ceil(PART).saturating_sub(1);
    let part = |(i, bytes): (usize, &[u8])| {
        let state = if i == last { 3 } else { 1 + u8::from(i > 0) };
        [vec![0x08, state], grpc::bytes_field(2, bytes)].concat()
    };
    payload.chunks(PART).enumerate().map(part).collect()
}

/// The name of each element of the state: the key, with an index if the array has several elements.
fn names(states: &[(String, Array)]) -> Vec<(String, f64)> {
    let each = |(key, array): &(String, Array)| {
        let numbers = array.numbers();
        let several = numbers.len() > 1;
        let name = |i: usize| if several { format!("{key}{i}") } else { key.clone() };
        numbers.into_iter().enumerate().map(|(i, n)| (name(i), n)).collect::<Vec<_>>()
    };
    states.iter().flat_map(each).collect()
}

/// Encode the policy setup: the checkpoint to load, and the features of the observations.
fn encode_setup(settings: &LeRobot, chunk: usize, query: &Query) -> Vec<u8> {
    fn feature(w: &mut Writer, kind: &str, shape: &[usize], names: &[&str]) {
        w.dict(|w| {
            w.text("dtype").text(kind).text("shape").tuple(|w| sizes(w, shape));
            w.text("names").list(|w| {
                for name in names {
                    w.text(name);
                }
            });
        });
    }
    let named = names(&query.states);
    let mut w = Writer::new();
    w.call(MODULE, "RemotePolicyConfig", |w| {
        w.text(&settings.policy_type).text(&settings.checkpoint);
        w.dict(|w| {
            let names: Vec<&str> = named.iter().map(|(name, _)| name.as_str()).collect();
            if !names.is_empty() {
                feature(w.text("observation.state"), "float32", &[names.len()], &names);
            }
            for (key, array) in &query.images {
                let w = w.text(&format!("observation.images.{key}"));
                feature(w, "image", array.shape(), &["height", "width", "channels"]);
            }
        });
        w.int(i32::try_from(chunk).unwrap_or(i32::MAX)).text(&settings.device);
    });
    w.end()
}

fn sizes(w: &mut Writer, shape: &[usize]) {
    for n in shape {
        w.int(i32::try_from(*n).unwrap_or(i32::MAX));
    }
}

/// Encode an observation: named numbers, images, and the instruction.
fn encode_observation(query: &Query, time_s: f64, number: i32) -> Vec<u8> {
    let mut w = Writer::new();
    w.call(MODULE, "TimedObservation", |w| {
        w.float(time_s).int(number);
        w.dict(|w| {
            for (name, n) in names(&query.states) {
                w.text(&name).float(n);
            }
            for (key, array) in &query.images {
                // Uses public functions, because NumPy's own pickles refer to a private module that moved in version 2.
                w.text(key).call("numpy", "reshape", |w| {
                    w.call("numpy", "frombuffer", |w| {
                        w.bytes(array.data()).text(array.dtype().name());
                    });
                    w.tuple(|w| sizes(w, array.shape()));
                });
            }
            w.text("task").text(&query.instruction);
        });
        // `must_go`: without it the server drops observations that are similar to the last one.
        w.bool_true();
    });
    w.end()
}

/// Decode the actions of a reply: a list of timed tensors.
fn decode(bytes: &[u8]) -> Result<Chunk, PolicyError> {
    const WHAT: &str = "reply to GetActions";
    let wrong = |why: String| PolicyError::invalid_reply(WHAT, why);
    let (list, rest) = pickle::read(bytes).map_err(wrong)?;
    if !rest.is_empty() {
        return Err(wrong(format!("{} bytes after the end", rest.len())));
    }
    let items = list.list().ok_or_else(|| wrong("it is not a list".to_owned()))?;
    if items.len() > MAX_ACTIONS {
        return Err(wrong(format!("{} actions. At most {MAX_ACTIONS} are accepted", items.len())));
    }
    let mut tensors = Tensors { storages: BTreeMap::new(), budget: NUMBERS * bytes.len() };
    let mut rows = Vec::new();
    for item in items {
        let (_, state) = item
            .call(&format!("{MODULE}.TimedAction"))
            .ok_or_else(|| wrong("an item is not a TimedAction".to_owned()))?;
        let action = state.get("action").ok_or_else(|| wrong("a TimedAction has no action".to_owned()))?;
        rows.push(tensors.read(action).map_err(wrong)?);
    }
    Chunk::of_rows(rows)
}

/// Maximum number of actions in a reply.
const MAX_ACTIONS: usize = 10_000;
/// Numbers that may be read for each byte of a reply. A float takes four bytes, and tensors may overlap.
const NUMBERS: usize = 1;

/// Reads tensors. Each storage is parsed once, because any number of tensors may refer to it.
struct Tensors {
    /// The storages by the address of their bytes, which the reply keeps alive.
    storages: BTreeMap<*const u8, Storage>,
    /// Numbers that may still be read.
    budget: usize,
}

/// Where the elements of a storage are in its file.
#[derive(Clone, Copy)]
struct Storage {
    start: usize,
    /// Size of an element in bytes: 4 or 8.
    width: usize,
}

impl Tensors {
    /// The numbers of a tensor with one axis.
    fn read(&mut self, value: &Value) -> Result<Vec<f64>, String> {
        let (arguments, _) = value.call("torch._utils._rebuild_tensor_v2").ok_or("an action is not a tensor")?;
        let [storage, offset, size, stride, ..] = arguments else { return Err("a tensor has no shape".to_owned()) };
        let one = |value: &Value| match value.list() {
            Some([n]) => n.size(),
            _ => None,
        };
        let (Some(offset), Some(size), Some(1)) = (offset.size(), one(size), one(stride)) else {
            return Err("an action is not a vector".to_owned());
        };
        let Some(([Value::Bytes(file)], _)) = storage.call("torch.storage._load_from_bytes") else {
            return Err("a tensor has no storage".to_owned());
        };
        let Storage { start, width } = match self.storages.get(&file.as_ptr()) {
            Some(known) => *known,
            None => {
                let storage = storage_of(file)?;
                self.storages.insert(file.as_ptr(), storage);
                storage
            }
        };
        self.budget = self.budget.checked_sub(size).ok_or("the tensors have more numbers than the reply can hold")?;
        let range = offset.checked_mul(width).zip(size.checked_mul(width));
        let part = range.and_then(|(from, length)| file.get(start..)?.get(from..from.checked_add(length)?));
        let part = part.ok_or("a tensor exceeds its storage")?;
        Ok(match width {
            4 => part.as_chunks().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes))).collect(),
            _ => part.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(),
        })
    }
}

/// A storage in torch's legacy format: three pickles that are skipped, a pickle that describes the storage, a pickle of its
/// keys, the number of elements, and the elements.
fn storage_of(file: &[u8]) -> Result<Storage, String> {
    let mut rest = file;
    for _ in 0..3 {
        (_, rest) = pickle::read(rest)?;
    }
    let (storage, after) = pickle::read(rest)?;
    (_, rest) = pickle::read(after)?;
    let Value::External(id) = storage else { return Err("a storage has no description".to_owned()) };
    let kind = match id.list() {
        Some([Value::Text(word), Value::Global(kind), ..]) if &**word == "storage" => kind,
        _ => return Err("a storage has no type".to_owned()),
    };
    let width = match &**kind {
        "torch.FloatStorage" => 4,
        "torch.DoubleStorage" => 8,
        other => return Err(format!("unsupported storage type {other}")),
    };
    let (count, data) = rest.split_first_chunk().ok_or("a storage is truncated")?;
    let count = usize::try_from(i64::from_le_bytes(*count)).map_err(|_| "a storage has a negative size")?;
    if count.checked_mul(width) != Some(data.len()) {
        return Err("the size of a storage does not match its header".to_owned());
    }
    Ok(Storage { start: file.len() - data.len(), width })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Dtype;
    use crate::tests::{Capture, fuzz};

    const FOLDER: &str = "lerobot";

    /// The query of the captured bytes.
    fn query(side: usize) -> Query {
        let numbers =
            [0.0, 0.1, 0.2, 0.300_000_000_000_000_04, 0.4, 0.5, 0.600_000_000_000_000_1, 0.700_000_000_000_000_1];
        let names = ["x", "y", "z", "rx", "ry", "rz", "g0", "g1"];
        let states = names.iter().zip(numbers).map(|(name, n)| ((*name).to_owned(), Array::vector(&[n], Dtype::F64)));
        let bytes = (0..3 * side * side).map(|i| i as u8).collect();
        let image = Array::new(Dtype::U8, vec![side, side, 3], bytes).unwrap();
        Query {
            images: vec![("image".to_owned(), image)],
            states: states.collect(),
            instruction: "pick up the black bowl".to_owned(),
            step: 0,
            time_s: 0.0,
        }
    }

    #[test]
    fn requests_equal_captured_pickles() {
        let settings = LeRobot {
            policy_type: "act".to_owned(),
            checkpoint: "/opt/upstream/lr/act".to_owned(),
            device: "cpu".to_owned(),
        };
        let setup = Capture::read(FOLDER, "handmade_policy_setup.pickle").bytes;
        assert_eq!(encode_setup(&settings, 5, &query(64)), setup);
        let observation = Capture::read(FOLDER, "handmade_observation.pickle").bytes;
        assert_eq!(encode_observation(&query(8), 1000.5, 0), observation);
    }

    #[test]
    fn captured_tensors_are_decoded() {
        let chunk = decode(&Capture::read(FOLDER, "actions.pickle").bytes).unwrap();
        let expected = String::from_utf8(Capture::read(FOLDER, "actions_expected.txt").bytes).unwrap();
        let expected: Vec<Vec<f64>> =
            expected.lines().map(|line| serde_json::from_str(&line[line.find('[').unwrap()..]).unwrap()).collect();
        assert_eq!(chunk.rows(), expected);
    }

    #[test]
    fn other_pickles_are_errors() {
        let call = b"\x80\x03cos\nsystem\n(X\x02\x00\x00\x00lstR.".to_vec();
        let item = b"\x80\x03](cos\nsystem\n(X\x02\x00\x00\x00idtRe.".to_vec();
        for (bytes, part) in [
            (call, "not a list"),
            (b"\x80\x03(S'ls'\nios\nsystem\n.".to_vec(), "unsupported instruction 0x53"),
            (item, "not a TimedAction"),
            (b"\x80\x03}.".to_vec(), "not a list"),
            (b"\x80\x04\x95".to_vec(), "truncated"),
        ] {
            let error = decode(&bytes).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    /// Any number of actions may refer to one storage, which is parsed once.
    #[test]
    fn shared_storages_are_parsed_once() {
        let reply = Capture::read(FOLDER, "actions.pickle").bytes;
        let honest = decode(&reply).unwrap();
        // The last action of the capture is memoised as entry 66, and more references to it follow.
        let memo = 66_u32;
        let mut bytes = reply[..reply.len() - 2].to_vec();
        bytes.push(0x94);
        let many = |n: usize| {
            let mut bytes = bytes.clone();
            for _ in 0..n {
                bytes.extend(b"j");
                bytes.extend(memo.to_le_bytes());
            }
            bytes.extend(b"e.");
            bytes
        };
        assert_eq!(decode(&many(9)).unwrap().rows().len(), honest.rows().len() + 9);
        let error = decode(&many(150_000)).unwrap_err().to_string();
        assert!(error.contains("At most 10000 are accepted"), "{error}");
    }

    #[test]
    fn long_observations_are_split() {
        let states = |length: usize| split(&vec![0; length]).iter().map(|part| part[1]).collect::<Vec<_>>();
        assert_eq!(states(10), [3]);
        assert_eq!(states(PART + 1), [1, 3]);
        assert_eq!(states(2 * PART + 1), [1, 2, 3]);
        let field = grpc::bytes_field(1, &[7; 300]);
        assert_eq!(grpc::read_bytes_field(&field, 1).unwrap(), [7; 300]);
    }

    #[test]
    fn fuzzed_replies_are_read_or_refused() {
        let actions = Capture::read(FOLDER, "actions.pickle").bytes;
        let field = grpc::bytes_field(1, &actions);
        let seeds = [actions, field];
        fuzz("lerobot replies", &seeds, |bytes| {
            let _ = grpc::message(bytes);
            decode(bytes).is_ok() || grpc::read_bytes_field(bytes, 1).is_ok_and(|actions| decode(actions).is_ok())
        });
    }
}
