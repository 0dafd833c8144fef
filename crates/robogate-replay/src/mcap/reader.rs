//! Reads the messages of an MCAP file (version 0), in the order of the file.
//!
//! Messages are JSON or CDR with a definition in the format `ros2msg`; those of other topics are not decoded. A file is read as
//! a stream: memory is bounded by the largest record.

use std::collections::BTreeMap;
use std::io::{self, Read};

use robogate_core::budget::Budget;
use serde_json::Value;

use super::cdr::Definition;
use super::file::{MAGIC, op};

/// Largest record, and largest chunk without compression, in bytes.
const LARGEST: u64 = 256 << 20;
/// Most schemas, and most channels, of a file.
const MOST_DECLARED: usize = 10_000;
/// Most bytes of all schemas together.
const LARGEST_DECLARED: usize = 16 << 20;
/// Limits on a message in JSON.
const MESSAGE: Budget = Budget { bytes: 8 << 20, values: 1 << 18, depth: 64 };

/// A message of a topic.
#[derive(Debug, Clone, PartialEq)]
pub struct McapMessage {
    /// The topic.
    pub topic: String,
    /// The time at which it was recorded, in seconds since 1970.
    pub time_s: f64,
    /// The message.
    pub message: Value,
}

/// A receiver of messages. An error ends the reading.
type Each<'a> = &'a mut dyn FnMut(McapMessage) -> Result<(), String>;

/// Reads the messages of some topics.
///
/// # Errors
/// The problem with the file, or that of `each`, as text.
pub fn read_mcap(mut input: impl Read, topics: &dyn Fn(&str) -> bool, each: Each<'_>) -> Result<(), String> {
    let mut magic = [0; MAGIC.len()];
    if input.read_exact(&mut magic).is_err() || magic != MAGIC {
        return Err("not an MCAP file".to_owned());
    }
    let mut decoder = Decoder { topics, schemas: BTreeMap::new(), declared: 0, channels: BTreeMap::new() };
    let mut record = Vec::new();
    loop {
        match next(&mut input, &mut record)? {
            Some(op::CHUNK) => decoder.chunk(&record, each)?,
            // What follows repeats the declarations.
            Some(op::DATA_END | op::FOOTER) => return Ok(()),
            Some(code) => decoder.record(code, &record, each)?,
            None => {
                return Err(
                    "it ends early. It was not closed, or only a part of it was copied\nHint: mcap recover".to_owned()
                );
            }
        }
    }
}

/// Reads the next record, and returns its opcode. `None` at the end.
fn next(input: &mut impl Read, record: &mut Vec<u8>) -> Result<Option<u8>, String> {
    let mut head = [0; 9];
    match input.read_exact(&mut head) {
        Ok(()) => {}
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        Err(error) => return Err(error.to_string()),
    }
    let [code, length @ ..] = head;
    let length = u64::from_le_bytes(length);
    if length > LARGEST {
        return Err(format!("a record has {length} bytes. At most {LARGEST} are accepted"));
    }
    record.clear();
    // Grows with the bytes that are there, not with the length that the file states.
    let found = input.take(length).read_to_end(record).map_err(|error| error.to_string())?;
    if (found as u64) < length { Err("it ends within a record".to_owned()) } else { Ok(Some(code)) }
}

/// How the messages of a schema are decoded.
enum Encoding {
    Json,
    Cdr(Definition),
}

struct Decoder<'a> {
    topics: &'a dyn Fn(&str) -> bool,
    /// Name, encoding and text of each schema.
    schemas: BTreeMap<u16, (String, String, String)>,
    /// Bytes of all schemas so far.
    declared: usize,
    /// Channels of the topics that are read. `None` for the others.
    channels: BTreeMap<u16, Option<(String, Encoding)>>,
}

impl Decoder<'_> {
    fn record(&mut self, code: u8, record: &[u8], each: Each<'_>) -> Result<(), String> {
        let mut fields = Fields(record);
        match code {
            op::SCHEMA => {
                let id = fields.u16()?;
                let schema = (fields.text()?, fields.text()?, fields.text()?);
                self.declared += schema.0.len() + schema.1.len() + schema.2.len();
                if self.schemas.len() >= MOST_DECLARED || self.declared > LARGEST_DECLARED {
                    return Err("it has too many schemas, or too large ones".to_owned());
                }
                self.schemas.insert(id, schema);
            }
            op::CHANNEL => {
                let (id, schema) = (fields.u16()?, fields.u16()?);
                let (topic, encoding) = (fields.text()?, fields.text()?);
                if self.channels.contains_key(&id) {
                    return Ok(());
                }
                if self.channels.len() >= MOST_DECLARED {
                    return Err(format!("it has more than {MOST_DECLARED} channels"));
                }
                let channel = if (self.topics)(&topic) {
                    let encoding = self.encoding(&encoding, schema).map_err(|error| format!("{topic}: {error}"))?;
                    Some((topic, encoding))
                } else {
                    None
                };
                self.channels.insert(id, channel);
            }
            op::MESSAGE => {
                let (channel, _, time_ns, _) = (fields.u16()?, fields.u32()?, fields.u64()?, fields.u64()?);
                let channel = self.channels.get(&channel).ok_or("a message belongs to no channel")?;
                let Some((topic, encoding)) = channel else { return Ok(()) };
                let message = match encoding {
                    Encoding::Json => MESSAGE.json(fields.0).map_err(|error| error.to_string()),
                    Encoding::Cdr(definition) => definition.decode(fields.0),
                };
                let message = message.map_err(|error| format!("a message of {topic}: {error}"))?;
                each(McapMessage { topic: topic.clone(), time_s: time_ns as f64 * 1e-9, message })?;
            }
            _ => {}
        }
        Ok(())
    }

    fn encoding(&self, encoding: &str, schema: u16) -> Result<Encoding, String> {
        match (encoding, self.schemas.get(&schema)) {
            ("json", _) => Ok(Encoding::Json),
            ("cdr", Some((name, kind, text))) if kind == "ros2msg" => Definition::parse(name, text).map(Encoding::Cdr),
            ("cdr", schema) => {
                let found = schema.map_or("no schema", |(_, kind, _)| kind);
                Err(format!("its definition is {found}. Expected ros2msg"))
            }
            (other, _) => Err(format!("its messages are {other}. Expected json or cdr")),
        }
    }

    fn chunk(&mut self, record: &[u8], each: Each<'_>) -> Result<(), String> {
        let mut fields = Fields(record);
        let (_, _, size, _) = (fields.u64()?, fields.u64()?, fields.u64()?, fields.u32()?);
        let (compression, length) = (fields.text()?, fields.u64()?);
        if size > LARGEST {
            return Err(format!("a chunk has {size} bytes. At most {LARGEST} are accepted"));
        }
        let bytes = fields.take(usize::try_from(length).unwrap_or(usize::MAX))?;
        match compression.as_str() {
            "" => self.records(bytes, each),
            "zstd" => {
                let failed = |error: String| format!("a chunk cannot be decompressed: {error}");
                let stream =
                    ruzstd::decoding::StreamingDecoder::new(bytes).map_err(|error| failed(error.to_string()))?;
                self.records(stream.take(size), each)
            }
            other => Err(format!(
                "its chunks are compressed with {other}. Expected zstd or none\nHint: mcap compress --compression zstd"
            )),
        }
    }

    fn records(&mut self, mut input: impl Read, each: Each<'_>) -> Result<(), String> {
        let mut record = Vec::new();
        while let Some(code) = next(&mut input, &mut record)? {
            self.record(code, &record, each)?;
        }
        Ok(())
    }
}

/// The content of a record that was not read yet.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.0.split_at_checked(length).ok_or("a record is shorter than its content")?;
        self.0 = rest;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.take(N)?.try_into().map_err(|_| "a record is shorter than its content".to_owned())
    }

    fn u16(&mut self) -> Result<u16, String> {
        self.number().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.number().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, String> {
        self.number().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Result<String, String> {
        let length = self.u32()? as usize;
        String::from_utf8(self.take(length)?.to_vec()).map_err(|_| "a name is not UTF-8".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use robogate_testing::fuzz::Target;
    use serde_json::json;

    use super::*;

    fn written() -> Vec<u8> {
        let mut file = super::super::file::File::default();
        let channel = file.channel("/cell/result", ("cell.Result", "{}".to_owned()));
        let other = file.channel("/camera", ("cell.Image", "{}".to_owned()));
        for i in 0..3_u64 {
            file.message(other, i * 1_000_000_000, &json!("x".repeat(100)));
            file.message(channel, i * 1_000_000_000, &json!({ "serial": i }));
        }
        file.finish()
    }

    fn messages(bytes: &[u8]) -> Result<Vec<McapMessage>, String> {
        let mut all = Vec::new();
        read_mcap(bytes, &|topic| topic == "/cell/result", &mut |message| {
            all.push(message);
            Ok(())
        })?;
        Ok(all)
    }

    #[test]
    fn reader_finds_what_was_written() {
        let all = messages(&written()).unwrap();
        assert_eq!(all.len(), 3);
        let expected = McapMessage { topic: "/cell/result".to_owned(), time_s: 2.0, message: json!({ "serial": 2 }) };
        assert_eq!(all[2], expected);
    }

    #[test]
    fn fuzzed_files_are_read_or_refused() {
        let valid = [written()];
        let words = ["json", "cdr", "ros2msg", "zstd", "lz4", "/cell/result", "\u{5}\0\0\0\0\0\0\0\0"];
        Target { name: "mcap", valid: &valid, kept: &[], words: &words, inputs: 500 }
            .run(|bytes| messages(bytes).is_ok());
    }

    #[test]
    fn damaged_files_are_errors_or_read() {
        let bytes = written();
        assert!(messages(b"PK\x03\x04").unwrap_err().contains("not an MCAP file"));
        for end in 0..200 {
            assert!(messages(&bytes[..end]).is_err(), "{end}");
        }
        // No change of a byte ends the process.
        for at in 0..bytes.len() {
            for value in [0, 1, 0x7f, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] = value;
                let _ = messages(&damaged);
            }
        }
        let mut large = MAGIC.to_vec();
        large.extend([op::MESSAGE, 0xff, 0xff, 0xff, 0xff, 0xff, 0, 0, 0]);
        assert!(messages(&large).unwrap_err().contains("At most"));
    }
}
