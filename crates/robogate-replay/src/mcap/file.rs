//! The MCAP container (version 0: <https://mcap.dev/spec>), as far as a writer needs it.
//!
//! Messages are sorted by time, stored in chunks without compression, and indexed. Checksums are CRC-32.

use std::collections::BTreeMap;

/// The first and last bytes of a file.
pub(super) const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', b'0', b'\r', b'\n'];
/// The size at which a chunk is closed, in bytes.
const CHUNK_BYTES: usize = 1 << 20;

/// Opcodes of records.
pub(super) mod op {
    pub(in crate::mcap) const HEADER: u8 = 0x01;
    pub(in crate::mcap) const FOOTER: u8 = 0x02;
    pub(in crate::mcap) const SCHEMA: u8 = 0x03;
    pub(in crate::mcap) const CHANNEL: u8 = 0x04;
    pub(in crate::mcap) const MESSAGE: u8 = 0x05;
    pub(in crate::mcap) const CHUNK: u8 = 0x06;
    pub(in crate::mcap) const MESSAGE_INDEX: u8 = 0x07;
    pub(in crate::mcap) const CHUNK_INDEX: u8 = 0x08;
    pub(in crate::mcap) const STATISTICS: u8 = 0x0b;
    pub(in crate::mcap) const METADATA: u8 = 0x0c;
    pub(in crate::mcap) const METADATA_INDEX: u8 = 0x0d;
    pub(in crate::mcap) const DATA_END: u8 = 0x0f;
}

/// The content of a record.
#[derive(Default)]
struct Fields(Vec<u8>);

impl Fields {
    fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn u16(self, value: u16) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    fn u32(self, value: u32) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    fn u64(self, value: u64) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    /// A length in 32 bits. All lengths of an episode are far below the limit.
    fn length(self, length: usize) -> Self {
        self.u32(u32::try_from(length).unwrap_or(u32::MAX))
    }

    fn text(self, text: &str) -> Self {
        self.length(text.len()).bytes(text.as_bytes())
    }

    fn map(self, entries: &[(String, String)]) -> Self {
        let inner = entries.iter().fold(Self::default(), |fields, (key, value)| fields.text(key).text(value));
        self.length(inner.0.len()).bytes(&inner.0)
    }

    /// Appends the record to a file, and returns its offset and length.
    fn record(self, file: &mut Vec<u8>, code: u8) -> (u64, u64) {
        let at = file.len();
        file.push(code);
        file.extend_from_slice(&(self.0.len() as u64).to_le_bytes());
        file.extend_from_slice(&self.0);
        (at as u64, (file.len() - at) as u64)
    }
}

/// A file in memory. Identifiers of schemas and channels count from 1 and 0.
#[derive(Default)]
pub(super) struct File {
    schemas: Vec<(&'static str, String)>,
    channels: Vec<(u16, String)>,
    messages: Vec<Message>,
    metadata: Vec<(String, Vec<(String, String)>)>,
}

struct Message {
    time_ns: u64,
    channel: u16,
    data: Vec<u8>,
}

impl File {
    /// Adds a channel of JSON messages, unless its topic exists, and returns it.
    pub(super) fn channel(&mut self, topic: &str, schema: (&'static str, String)) -> u16 {
        let at = self.channels.iter().position(|(_, known)| known == topic).unwrap_or_else(|| {
            let known = self.schemas.iter().position(|known| *known == schema).unwrap_or_else(|| {
                self.schemas.push(schema);
                self.schemas.len() - 1
            });
            self.channels.push((id(known + 1), topic.to_owned()));
            self.channels.len() - 1
        });
        id(at)
    }

    /// Adds a message. The time is in nanoseconds.
    pub(super) fn message(&mut self, channel: u16, time_ns: u64, message: &serde_json::Value) {
        self.messages.push(Message { time_ns, channel, data: message.to_string().into_bytes() });
    }

    /// Adds named texts.
    pub(super) fn metadata(&mut self, name: &str, entries: Vec<(String, String)>) {
        self.metadata.push((name.to_owned(), entries));
    }

    /// The bytes of the file.
    pub(super) fn finish(mut self) -> Vec<u8> {
        // Stable: messages of one time keep their order.
        self.messages.sort_by_key(|message| message.time_ns);
        let mut file = MAGIC.to_vec();
        let library = concat!("robogate ", env!("CARGO_PKG_VERSION"));
        Fields::default().text("").text(library).record(&mut file, op::HEADER);
        self.declarations(&mut file);
        let mut counts: BTreeMap<u16, u64> = BTreeMap::new();
        let mut sequences: BTreeMap<u16, u32> = BTreeMap::new();
        let mut indices: Vec<Fields> = Vec::new();
        let mut rest = &self.messages[..];
        while !rest.is_empty() {
            let mut size = 0;
            let within = |message: &&Message| {
                let fits = size < CHUNK_BYTES;
                size += message.data.len();
                fits
            };
            let (chunk, others) = rest.split_at(rest.iter().take_while(within).count());
            indices.push(write_chunk(&mut file, chunk, &mut sequences));
            chunk.iter().for_each(|message| *counts.entry(message.channel).or_default() += 1);
            rest = others;
        }
        let mut notes = Vec::new();
        for (name, entries) in &self.metadata {
            let (at, length) = Fields::default().text(name).map(entries).record(&mut file, op::METADATA);
            notes.push(Fields::default().u64(at).u64(length).text(name));
        }
        let crc = crc32fast::hash(&file);
        Fields::default().u32(crc).record(&mut file, op::DATA_END);
        let summary = file.len();
        self.declarations(&mut file);
        self.statistics(&counts, indices.len()).record(&mut file, op::STATISTICS);
        indices.into_iter().for_each(|index| {
            index.record(&mut file, op::CHUNK_INDEX);
        });
        notes.into_iter().for_each(|note| {
            note.record(&mut file, op::METADATA_INDEX);
        });
        // The checksum of the summary includes the footer up to the checksum itself.
        let mut footer = vec![op::FOOTER];
        footer.extend_from_slice(&Fields::default().u64(20).u64(summary as u64).u64(0).0);
        file.extend_from_slice(&footer);
        let crc = crc32fast::hash(&file[summary..]);
        file.extend_from_slice(&crc.to_le_bytes());
        file.extend_from_slice(&MAGIC);
        file
    }

    /// Writes all schemas and channels.
    fn declarations(&self, file: &mut Vec<u8>) {
        for (at, (name, schema)) in self.schemas.iter().enumerate() {
            let fields = Fields::default().u16(id(at + 1)).text(name).text("jsonschema").text(schema);
            fields.record(file, op::SCHEMA);
        }
        for (at, (schema, topic)) in self.channels.iter().enumerate() {
            let fields = Fields::default().u16(id(at)).u16(*schema).text(topic).text("json").map(&[]);
            fields.record(file, op::CHANNEL);
        }
    }

    fn statistics(&self, counts: &BTreeMap<u16, u64>, chunks: usize) -> Fields {
        let [first, last] = [self.messages.first(), self.messages.last()].map(|m| m.map_or(0, |m| m.time_ns));
        let channels = counts.iter().fold(Fields::default(), |fields, (channel, n)| fields.u16(*channel).u64(*n));
        Fields::default()
            .u64(self.messages.len() as u64)
            .u16(id(self.schemas.len()))
            .length(self.channels.len())
            .u32(0)
            .length(self.metadata.len())
            .length(chunks)
            .u64(first)
            .u64(last)
            .length(channels.0.len())
            .bytes(&channels.0)
    }
}

/// An identifier. An episode has a few dozen of them.
fn id(at: usize) -> u16 {
    u16::try_from(at).unwrap_or(u16::MAX)
}

/// Writes a chunk with its message indices, and returns the content of its index in the summary.
fn write_chunk(file: &mut Vec<u8>, messages: &[Message], sequences: &mut BTreeMap<u16, u32>) -> Fields {
    let mut records = Vec::new();
    let mut places: BTreeMap<u16, Fields> = BTreeMap::new();
    for Message { time_ns, channel, data } in messages {
        let sequence = sequences.entry(*channel).or_default();
        let fields = Fields::default().u16(*channel).u32(*sequence).u64(*time_ns).u64(*time_ns).bytes(data);
        *sequence += 1;
        let (at, _) = fields.record(&mut records, op::MESSAGE);
        let place = places.remove(channel).unwrap_or_default();
        places.insert(*channel, place.u64(*time_ns).u64(at));
    }
    let [first, last] = [messages.first(), messages.last()].map(|m| m.map_or(0, |m| m.time_ns));
    let size = records.len() as u64;
    let head = Fields::default().u64(first).u64(last).u64(size).u32(crc32fast::hash(&records)).text("");
    let (at, length) = head.u64(size).bytes(&records).record(file, op::CHUNK);
    let begin = file.len() as u64;
    let mut offsets = Fields::default();
    for (channel, place) in places {
        offsets = offsets.u16(channel).u64(file.len() as u64);
        Fields::default().u16(channel).length(place.0.len()).bytes(&place.0).record(file, op::MESSAGE_INDEX);
    }
    let index = Fields::default().u64(first).u64(last).u64(at).u64(length);
    let index = index.length(offsets.0.len()).bytes(&offsets.0).u64(file.len() as u64 - begin);
    index.text("").u64(size).u64(size)
}
