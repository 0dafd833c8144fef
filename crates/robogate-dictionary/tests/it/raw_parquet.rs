//! Writes Parquet files from their parts, so that each part can state anything.
//!
//! Field numbers: <https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift>. The encoding is
//! Thrift's compact protocol.

use robogate_testing::fuzz::Draw;

pub(crate) const BOOLEAN: i64 = 0;
pub(crate) const INT64: i64 = 2;
pub(crate) const DOUBLE: i64 = 5;
pub(crate) const TEXT: i64 = 6;

pub(crate) const UNCOMPRESSED: i64 = 0;
pub(crate) const SNAPPY: i64 = 1;
pub(crate) const ZSTD: i64 = 6;

pub(crate) const PLAIN: i64 = 0;
pub(crate) const RLE: i64 = 3;
pub(crate) const DELTA_BINARY_PACKED: i64 = 5;
pub(crate) const DELTA_LENGTH_BYTE_ARRAY: i64 = 6;
pub(crate) const DELTA_BYTE_ARRAY: i64 = 7;
pub(crate) const RLE_DICTIONARY: i64 = 8;
pub(crate) const BYTE_STREAM_SPLIT: i64 = 9;

/// A page: its header and its bytes in the file.
#[derive(Debug, Clone)]
pub(crate) struct Page {
    /// 0: data, 2: dictionary, 3: data of version 2.
    pub(crate) kind: i64,
    pub(crate) values: i64,
    pub(crate) encoding: i64,
    /// Size that the header states for the unpacked page.
    pub(crate) unpacked: i64,
    /// Bytes of the levels in a page of version 2.
    pub(crate) levels: i64,
    pub(crate) body: Vec<u8>,
}

impl Page {
    pub(crate) fn data(values: i64, encoding: i64, body: Vec<u8>) -> Self {
        Self { kind: 0, values, encoding, unpacked: body.len() as i64, levels: 0, body }
    }

    pub(crate) fn dictionary(values: i64, body: Vec<u8>) -> Self {
        Self { kind: 2, ..Self::data(values, PLAIN, body) }
    }

    fn write(&self, out: &mut Vec<u8>) {
        let mut header = Thrift::default();
        header.int(1, self.kind).int(2, self.unpacked).int(3, self.body.len() as i64);
        match self.kind {
            0 => header.message(5, |page| {
                page.int(1, self.values).int(2, self.encoding).int(3, RLE).int(4, RLE);
            }),
            2 => header.message(7, |page| {
                page.int(1, self.values).int(2, self.encoding);
            }),
            _ => header.message(8, |page| {
                page.int(1, self.values).int(2, 0).int(3, self.values).int(4, self.encoding);
                page.int(5, self.levels).int(6, 0);
            }),
        };
        header.end();
        out.extend(header.bytes);
        out.extend(&self.body);
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Column {
    pub(crate) name: String,
    pub(crate) physical: i64,
    pub(crate) optional: bool,
}

/// A column chunk.
#[derive(Debug, Clone, Default)]
pub(crate) struct Chunk {
    pub(crate) codec: i64,
    pub(crate) pages: Vec<Page>,
    /// Repeat the position of this chunk of the same group instead of writing pages.
    pub(crate) same_as: Option<usize>,
}

#[derive(Debug, Clone)]
pub(crate) struct Group {
    pub(crate) rows: i64,
    pub(crate) chunks: Vec<Chunk>,
    /// How often the group stands in the footer.
    pub(crate) repeated: usize,
}

/// A file. `pairs` may contain the key [`CHECKSUMS`], whose value is completed with the checksum of each chunk.
#[derive(Debug, Clone)]
pub(crate) struct File {
    pub(crate) columns: Vec<Column>,
    pub(crate) groups: Vec<Group>,
    pub(crate) pairs: Vec<(String, String)>,
}

pub(crate) const CHECKSUMS: &str = "robogate.checksums";

impl File {
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let mut out = b"PAR1".to_vec();
        let (mut groups, mut checksums, mut rows, mut count) = (Vec::<u8>::new(), Vec::<String>::new(), 0_i64, 0);
        for group in &self.groups {
            let mut places = Vec::new();
            for chunk in &group.chunks {
                let place = match chunk.same_as {
                    Some(other) => places[other],
                    None => {
                        let start = out.len();
                        chunk.pages.iter().for_each(|page| page.write(&mut out));
                        (start, out.len(), chunk.pages.first().is_some_and(|page| page.kind == 2))
                    }
                };
                places.push(place);
            }
            let mut written = Thrift::default();
            written.list(1, 12, group.chunks.len());
            for ((chunk, column), (start, end, has_dictionary)) in group.chunks.iter().zip(&self.columns).zip(&places) {
                written.nested(|written| {
                    written.long(2, 0);
                    written.message(3, |written| {
                        written.int(1, column.physical);
                        written.list(2, 5, 0).list(3, 8, 1).raw_text(&column.name);
                        written.int(4, chunk.codec).long(5, group.rows);
                        written.long(6, (end - start) as i64).long(7, (end - start) as i64).long(9, *start as i64);
                        if *has_dictionary {
                            written.long(11, *start as i64);
                        }
                    });
                });
            }
            written.long(2, 0).long(3, group.rows).end();
            for _ in 0..group.repeated {
                groups.extend(&written.bytes);
                checksums.extend(
                    places.iter().map(|(start, end, _)| format!("{:08x}", crc32fast::hash(&out[*start..*end]))),
                );
                rows = rows.saturating_add(group.rows);
                count += 1;
            }
        }
        let mut footer = Thrift::default();
        footer.int(1, 2).list(2, 12, self.columns.len() + 1);
        footer.nested(|root| {
            root.text(4, "dictionary").int(5, self.columns.len() as i64);
        });
        for column in &self.columns {
            footer.nested(|leaf| {
                leaf.int(1, column.physical).int(3, i64::from(column.optional)).text(4, &column.name);
                if column.physical == TEXT {
                    leaf.int(6, 0);
                }
            });
        }
        footer.long(3, rows).list(4, 12, count);
        footer.bytes.extend(groups);
        footer.list(5, 12, self.pairs.len());
        for (key, value) in &self.pairs {
            let value = if key == CHECKSUMS { format!("{value} {}", checksums.join(" ")) } else { value.clone() };
            footer.nested(|pair| {
                pair.text(1, key).text(2, &value);
            });
        }
        footer.end();
        out.extend(&footer.bytes);
        out.extend((footer.bytes.len() as u32).to_le_bytes());
        out.extend(b"PAR1");
        out
    }
}

/// A struct in Thrift's compact protocol.
#[derive(Default)]
struct Thrift {
    bytes: Vec<u8>,
    last: u8,
}

impl Thrift {
    fn field(&mut self, id: u8, kind: u8) -> &mut Self {
        self.bytes.push((id - self.last) << 4 | kind);
        self.last = id;
        self
    }

    fn varint(&mut self, mut number: u64) -> &mut Self {
        while number > 0x7f {
            self.bytes.push(number as u8 | 0x80);
            number >>= 7;
        }
        self.bytes.push(number as u8);
        self
    }

    /// An integer of 32 bits.
    fn int(&mut self, id: u8, number: i64) -> &mut Self {
        self.field(id, 5).varint((number << 1 ^ number >> 63).cast_unsigned())
    }

    /// An integer of 64 bits. Only its type differs.
    fn long(&mut self, id: u8, number: i64) -> &mut Self {
        self.field(id, 6).varint((number << 1 ^ number >> 63).cast_unsigned())
    }

    fn text(&mut self, id: u8, text: &str) -> &mut Self {
        self.field(id, 8).raw_text(text)
    }

    fn raw_text(&mut self, text: &str) -> &mut Self {
        self.varint(text.len() as u64);
        self.bytes.extend(text.as_bytes());
        self
    }

    fn list(&mut self, id: u8, kind: u8, length: usize) -> &mut Self {
        self.field(id, 9);
        self.bytes.push(0xf0 | kind);
        self.varint(length as u64)
    }

    /// An item of a list of structs.
    fn nested(&mut self, write: impl FnOnce(&mut Self)) -> &mut Self {
        let mut inner = Self::default();
        write(&mut inner);
        inner.end();
        self.bytes.extend(inner.bytes);
        self
    }

    fn message(&mut self, id: u8, write: impl FnOnce(&mut Self)) -> &mut Self {
        self.field(id, 12).nested(write)
    }

    fn end(&mut self) {
        self.bytes.push(0);
    }
}

/// A frame of zstd that unpacks to `blocks` times 128 KiB of zeros. RFC 8878, section 3.1.1: blocks of the kind RLE.
pub(crate) fn zstd_zeros(blocks: u32) -> Vec<u8> {
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0, 0x38];
    for i in 0..blocks {
        let header = (128 << 10) << 3 | 1 << 1 | u32::from(i + 1 == blocks);
        frame.extend(&header.to_le_bytes()[..3]);
        frame.push(0);
    }
    frame
}

/// A snappy text that states `size` bytes and contains a literal and `copies` copies of 64 bytes.
pub(crate) fn snappy(size: u64, copies: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut rest = size;
    while rest > 0x7f {
        bytes.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    bytes.extend([rest as u8, 0, 0]);
    bytes.extend([0xfe, 1, 0].repeat(copies));
    bytes
}

/// `count` equal values in the hybrid of run lengths and bit packing, with a width of one bit.
pub(crate) fn run(count: u64) -> Vec<u8> {
    let mut run = Thrift::default();
    run.varint(count << 1);
    run.bytes.push(0);
    run.bytes
}

/// Definition levels of version 1: `count` values that are present.
pub(crate) fn present(count: u64) -> Vec<u8> {
    let mut run = Thrift::default();
    run.varint(count << 1);
    run.bytes.push(1);
    [&(run.bytes.len() as u32).to_le_bytes()[..], run.bytes.as_slice()].concat()
}

/// The header of a delta encoding: 128 values in 4 blocks, `values` in all, then anything.
pub(crate) fn delta(values: u64, first: u64, rest: &[u8]) -> Vec<u8> {
    let mut header = Thrift::default();
    header.varint(128).varint(4).varint(values).varint(2 * first);
    header.bytes.extend(rest);
    header.bytes
}

/// A number that a header may state: often a plausible one, sometimes an extreme one.
fn stated(draw: &mut Draw, plausible: i64) -> i64 {
    match draw.below(12) {
        0 => [0, -1, 1, 127, i64::from(i32::MAX), i64::from(i32::MIN), 1 << 20][draw.below(7)],
        1 => plausible + draw.below(9) as i64 - 4,
        2 => plausible.saturating_mul(draw.below(1_000) as i64),
        _ => plausible,
    }
}

fn random_body(draw: &mut Draw, values: i64, physical: i64, encoding: i64, optional: bool) -> Vec<u8> {
    let values = values.clamp(0, 2_000) as u64;
    let mut body = if optional { present(values) } else { Vec::new() };
    match encoding {
        RLE_DICTIONARY => {
            body.push([0, 1, 1, 1, 32, 33][draw.below(6)]);
            body.extend(run(values + draw.below(2) as u64));
        }
        RLE => {
            let run = run(values);
            body.extend((run.len() as u32).to_le_bytes());
            body.extend(run);
        }
        DELTA_BINARY_PACKED | DELTA_LENGTH_BYTE_ARRAY | DELTA_BYTE_ARRAY => {
            let claimed = [values, values + 1, 1 << 40, 0][draw.below(4)];
            let rest: Vec<u8> = (0..draw.below(80)).map(|_| [0, 1, 8, 0xff][draw.below(4)]).collect();
            body.extend(delta(claimed, 0, &rest));
        }
        _ if physical == TEXT => {
            for _ in 0..values {
                let length = [1, 3, 5, 7][draw.below(4)];
                body.extend(u32::to_le_bytes(if draw.below(400) == 0 { u32::MAX } else { length }));
                body.extend(vec![b'a' + draw.below(3) as u8; length as usize]);
            }
        }
        _ => {
            let bytes = if physical == BOOLEAN { values.div_ceil(8) } else { 8 * values };
            body.extend((0..bytes).map(|_| [0, 1, 0x3f, draw.below(256) as u8][draw.below(4)]));
        }
    }
    body
}

/// A file whose parts fit together mostly, so that a reader gets far into it.
pub(crate) fn random(draw: &mut Draw) -> File {
    let names = ["success", "mass", "count", "failure_mode", "note", "success"];
    let kinds = [BOOLEAN, DOUBLE, INT64, TEXT, TEXT, INT64];
    let columns: Vec<Column> = (0..1 + draw.below(names.len()))
        .map(|i| Column { name: names[i].to_owned(), physical: kinds[i], optional: draw.below(3) == 0 })
        .collect();
    let groups = (0..1 + draw.below(3)).map(|_| {
        let rows = 1 + draw.below(300) as i64;
        let chunks = columns.iter().enumerate().map(|(i, column)| {
            let codec = [UNCOMPRESSED, UNCOMPRESSED, SNAPPY, ZSTD, 2][draw.below(5)];
            let encodings: &[i64] = match column.physical {
                BOOLEAN => &[PLAIN, PLAIN, RLE],
                TEXT => &[PLAIN, PLAIN, RLE_DICTIONARY, DELTA_LENGTH_BYTE_ARRAY, DELTA_BYTE_ARRAY],
                _ => &[PLAIN, PLAIN, RLE_DICTIONARY, DELTA_BINARY_PACKED, BYTE_STREAM_SPLIT],
            };
            let encoding = encodings[draw.below(encodings.len())];
            let mut pages = Vec::new();
            if encoding == RLE_DICTIONARY {
                let body = random_body(draw, 4, column.physical, PLAIN, false);
                pages.push(Page::dictionary(stated(draw, 4), body));
            }
            let body = random_body(draw, rows, column.physical, encoding, column.optional);
            let kind = [0, 0, 0, 3][draw.below(4)];
            let levels = if kind == 3 { stated(draw, 0) } else { 0 };
            pages.push(Page { kind, levels, ..Page::data(stated(draw, rows), encoding, body) });
            for page in &mut pages {
                page.unpacked = stated(draw, page.body.len() as i64);
                page.body = match (codec, draw.below(8)) {
                    (SNAPPY, 0) => snappy(stated(draw, 500).unsigned_abs(), 8),
                    (SNAPPY, _) => snap::raw::Encoder::new().compress_vec(&page.body).unwrap(),
                    (ZSTD, _) => zstd_zeros(1 + draw.below(4) as u32),
                    _ => std::mem::take(&mut page.body),
                };
            }
            let same_as = (i > 0 && draw.below(20) == 0).then(|| draw.below(i));
            Chunk { codec, pages, same_as }
        });
        let chunks = chunks.collect();
        Group { rows: stated(draw, rows), chunks, repeated: if draw.below(20) == 0 { 50 } else { 1 } }
    });
    File { groups: groups.collect(), columns: columns.clone(), pairs: Vec::new() }
}
