//! Reads text files of other tools and converts them to UTF-8 from the encodings of spreadsheets and shells.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use crate::DictionaryError;
use crate::raw::{Meter, Metered};

/// Bytes that are decoded at a time.
const CHUNK: usize = 1 << 16;

/// How a file encodes text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Encoding {
    Utf8,
    Utf16 {
        big_endian: bool,
    },
    /// The single-byte encoding of Windows in Western Europe, which contains Latin-1 except its control characters.
    Windows1252,
}

impl Encoding {
    /// Detects the encoding: by the byte-order mark, by the zero bytes of UTF-16, or from all bytes.
    ///
    /// A file that is not UTF-8 counts as Windows-1252 only if each of its special characters stands alone between
    /// ASCII characters. Encodings with several bytes per character, and alphabets other than the Latin one, have
    /// special characters side by side. Such a file is refused, with the line.
    fn of(path: &Path) -> Result<Self, DictionaryError> {
        let mut file = File::open(path).map_err(DictionaryError::io(path, "open"))?;
        let mut chunk = vec![0; CHUNK];
        let mut n = fill(&mut file, &mut chunk).map_err(DictionaryError::io(path, "read"))?;
        if let Some(encoding) = Self::of_start(&chunk[..n]) {
            return Ok(encoding);
        }
        let (mut line, mut after_special, mut mixed) = (1_u64, false, None);
        let (mut utf8, mut rest) = (true, 0);
        while n > 0 {
            for byte in &chunk[rest..n] {
                let special = !byte.is_ascii();
                let undefined = matches!(byte, 0x81 | 0x8D | 0x8F | 0x90 | 0x9D);
                if special && (after_special || undefined) {
                    mixed.get_or_insert(line);
                }
                after_special = special;
                line += u64::from(*byte == b'\n');
            }
            let bytes = &chunk[..n];
            let left = match std::str::from_utf8(bytes) {
                Ok(_) => 0,
                // A character that the chunk cuts.
                Err(error) if utf8 && error.error_len().is_none() => n - error.valid_up_to(),
                Err(_) => {
                    utf8 = false;
                    0
                }
            };
            chunk.copy_within(n - left..n, 0);
            rest = left;
            let more = fill(&mut file, &mut chunk[left..]).map_err(DictionaryError::io(path, "read"))?;
            if more == 0 {
                utf8 &= left == 0;
                break;
            }
            n = left + more;
        }
        match mixed {
            _ if utf8 => Ok(Self::Utf8),
            None => Ok(Self::Windows1252),
            Some(line) => Err(DictionaryError::results(
                path,
                format!(
                    "line {line}: the text is not UTF-8, and its encoding cannot be recognised. Expected UTF-8\nHint: \
                     convert the file, for example with `iconv -f GB18030 -t UTF-8`"
                ),
            )),
        }
    }

    /// The encoding that the first bytes prove.
    fn of_start(start: &[u8]) -> Option<Self> {
        match start {
            [0xFF, 0xFE, ..] => return Some(Self::Utf16 { big_endian: false }),
            [0xFE, 0xFF, ..] => return Some(Self::Utf16 { big_endian: true }),
            _ => {}
        }
        let (pairs, _) = start[..start.len().min(256)].as_chunks::<2>();
        let zeros = |at: usize| pairs.iter().filter(|pair| pair[at] == 0).count();
        // Most characters of a table are ASCII, which have one zero byte.
        match (zeros(0), zeros(1)) {
            (0, n) if n > 1 && 2 * n > pairs.len() => Some(Self::Utf16 { big_endian: false }),
            (n, 0) if n > 1 && 2 * n > pairs.len() => Some(Self::Utf16 { big_endian: true }),
            _ => None,
        }
    }
}

/// Reads until the buffer is full or the file ends.
fn fill(file: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut n = 0;
    while n < buffer.len() {
        match file.read(&mut buffer[n..])? {
            0 => break,
            more => n += more,
        }
    }
    Ok(n)
}

/// The characters of the bytes 0x80 to 0x9F in Windows-1252. Those without a character keep their number.
const WINDOWS: [char; 32] = [
    '\u{20AC}', '\u{81}', '\u{201A}', '\u{192}', '\u{201E}', '\u{2026}', '\u{2020}', '\u{2021}', '\u{2C6}', '\u{2030}',
    '\u{160}', '\u{2039}', '\u{152}', '\u{8D}', '\u{17D}', '\u{8F}', '\u{90}', '\u{2018}', '\u{2019}', '\u{201C}',
    '\u{201D}', '\u{2022}', '\u{2013}', '\u{2014}', '\u{2DC}', '\u{2122}', '\u{161}', '\u{203A}', '\u{153}', '\u{9D}',
    '\u{17E}', '\u{178}',
];

/// A text file as UTF-8 without a byte-order mark, hashed as it is stored.
#[derive(Debug)]
pub(crate) struct Text {
    metered: Metered,
    encoding: Encoding,
    json: Option<Tokens>,
    /// Bytes of a character that a chunk cuts.
    cut: Vec<u8>,
    first: bool,
    /// Decoded bytes, and how many of them were read.
    decoded: Vec<u8>,
    read: usize,
    ended: bool,
}

impl Text {
    /// Opens a text file. Reading fails if more than `most` bytes pass without a row.
    pub(crate) fn open(path: &Path, most: u64) -> Result<Self, DictionaryError> {
        Ok(Self {
            encoding: Encoding::of(path)?,
            metered: Metered::open(path, most)?,
            json: None,
            cut: Vec::new(),
            first: true,
            decoded: Vec::new(),
            read: 0,
            ended: false,
        })
    }

    /// Opens a JSON file, with the extensions that Python's `json` writes ([`Tokens`]).
    pub(crate) fn open_json(path: &Path, most: u64) -> Result<Self, DictionaryError> {
        Ok(Self { json: Some(Tokens::default()), ..Self::open(path, most)? })
    }

    /// What the reader of the file should know about its encoding.
    pub(crate) fn note(&self) -> Option<String> {
        let named = match self.encoding {
            Encoding::Utf8 => return None,
            Encoding::Utf16 { .. } => "UTF-16",
            Encoding::Windows1252 => "Windows-1252, which contains Latin-1",
        };
        Some(format!("The file is not UTF-8. Its text is read as {named}."))
    }

    pub(crate) fn meter(&self) -> Meter {
        self.metered.meter()
    }

    pub(crate) fn sha256(self) -> String {
        self.metered.sha256()
    }

    fn decode(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut text: Vec<u8> = Vec::with_capacity(bytes.len() + 4);
        let mut push = |c: char| text.extend_from_slice(c.encode_utf8(&mut [0; 4]).as_bytes());
        match self.encoding {
            Encoding::Utf8 => text.extend_from_slice(bytes),
            Encoding::Windows1252 => bytes.iter().for_each(|byte| {
                push(match byte {
                    0x80..=0x9F => WINDOWS[usize::from(byte - 0x80)],
                    _ => char::from(*byte),
                });
            }),
            Encoding::Utf16 { big_endian } => {
                self.cut.extend_from_slice(bytes);
                let (pairs, _) = self.cut.as_chunks::<2>();
                let unit =
                    |pair: &[u8; 2]| if big_endian { u16::from_be_bytes(*pair) } else { u16::from_le_bytes(*pair) };
                let mut units: Vec<u16> = pairs.iter().map(unit).collect();
                // The second half of a pair of surrogates may be in the next chunk.
                if !bytes.is_empty() && units.last().is_some_and(|unit| (0xD800..0xDC00).contains(unit)) {
                    units.pop();
                }
                let wrong = || io::Error::new(io::ErrorKind::InvalidData, "the file is not valid UTF-16");
                for c in char::decode_utf16(units.iter().copied()) {
                    push(c.map_err(|_| wrong())?);
                }
                self.cut.drain(..2 * units.len());
                if bytes.is_empty() && !self.cut.is_empty() {
                    return Err(wrong());
                }
            }
        }
        let text = match text.strip_prefix(b"\xef\xbb\xbf") {
            Some(text) if self.first => text,
            _ => &text,
        };
        self.first &= bytes.is_empty();
        self.decoded.clear();
        self.read = 0;
        match &mut self.json {
            Some(tokens) => tokens.take(text, bytes.is_empty(), &mut self.decoded),
            None => self.decoded.extend_from_slice(text),
        }
        Ok(())
    }
}

impl Read for Text {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut chunk = [0; CHUNK / 8];
        while self.read == self.decoded.len() && !self.ended {
            let n = self.metered.read(&mut chunk)?;
            self.ended = n == 0;
            self.decode(&chunk[..n])?;
        }
        let n = (&self.decoded[self.read..]).read(buffer)?;
        self.read += n;
        Ok(n)
    }
}

/// Rewrites the tokens of Python's `json` that no other reader accepts, or that others round.
///
/// `NaN` becomes `null`, a missing value. Infinities, and integers that need more than 64 bits, become texts, so that
/// nothing is rounded.
#[derive(Debug, Default)]
struct Tokens {
    state: State,
    token: Vec<u8>,
}

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
enum State {
    #[default]
    Outside,
    Text,
    Escaped,
}

impl Tokens {
    fn take(&mut self, text: &[u8], last: bool, out: &mut Vec<u8>) {
        /// A longer token is not a number that can be stored.
        const LONGEST: usize = 1000;
        for byte in text {
            if self.state == State::Outside {
                if byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'+' | b'.') {
                    if self.token.len() < LONGEST {
                        self.token.push(*byte);
                    } else {
                        out.push(*byte);
                    }
                    continue;
                }
                self.finish(out);
            }
            self.state = match (self.state, byte) {
                (State::Outside, b'"') | (State::Escaped, _) => State::Text,
                (State::Text, b'"') => State::Outside,
                (State::Text, b'\\') => State::Escaped,
                (state, _) => state,
            };
            out.push(*byte);
        }
        if last {
            self.finish(out);
        }
    }

    fn finish(&mut self, out: &mut Vec<u8>) {
        let token = std::mem::take(&mut self.token);
        let integer = || {
            let digits = token.strip_prefix(b"-").unwrap_or(&token);
            let text = std::str::from_utf8(&token).unwrap_or_default();
            digits.len() > 18
                && digits.iter().all(u8::is_ascii_digit)
                && text.parse::<i64>().is_err()
                && text.parse::<u64>().is_err()
        };
        match token.as_slice() {
            b"NaN" => out.extend_from_slice(b"null"),
            b"Infinity" | b"-Infinity" => {
                out.push(b'"');
                out.extend_from_slice(&token);
                out.push(b'"');
            }
            _ if integer() => {
                out.push(b'"');
                out.extend_from_slice(&token);
                out.push(b'"');
            }
            _ => out.extend_from_slice(&token),
        }
    }
}

/// The first bytes of a file. Empty if it cannot be read: its reader reports the error.
pub(crate) fn start_of(path: &Path) -> Vec<u8> {
    let mut start = vec![0; 40];
    let n = File::open(path).and_then(|mut file| fill(&mut file, &mut start)).unwrap_or(0);
    start.truncate(n);
    start
}

/// Why a file does not hold the rows themselves: it stands for a file that was not downloaded, or is compressed.
pub(crate) fn placeholder(path: &Path) -> Option<&'static str> {
    const OTHER: [(&[u8], &str); 7] = [
        (
            b"version https://git-lfs.github.com/spec/",
            "it is a Git LFS pointer, not the file itself\nHint: download the file with `git lfs pull`",
        ),
        (
            b"/annex/objects/",
            "it is a git-annex pointer, not the file itself\nHint: download the file with `git annex get`",
        ),
        (b"\x1f\x8b", "it is compressed with gzip\nHint: decompress it first, with `gunzip` or `zcat`"),
        (b"BZh", "it is compressed with bzip2\nHint: decompress it first, with `bunzip2` or `bzcat`"),
        (b"\xfd7zXZ\0", "it is compressed with xz\nHint: decompress it first, with `unxz` or `xzcat`"),
        (b"\x28\xb5\x2f\xfd", "it is compressed with zstd\nHint: decompress it first, with `unzstd` or `zstdcat`"),
        (
            b"PK\x03\x04",
            "it is a zip archive, such as a workbook of a spreadsheet\nHint: extract the file, or save the sheet as CSV",
        ),
    ];
    let start = start_of(path);
    OTHER.iter().find(|(magic, _)| start.starts_with(magic)).map(|(_, why)| *why)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens(pieces: &[&str]) -> String {
        let (mut tokens, mut out) = (Tokens::default(), Vec::new());
        pieces.iter().for_each(|piece| tokens.take(piece.as_bytes(), false, &mut out));
        tokens.take(b"", true, &mut out);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn python_tokens_are_rewritten() {
        assert_eq!(
            tokens(&["[NaN, -Inf", "inity, \"NaN \\\" NaN\", 1e5]"]),
            r#"[null, "-Infinity", "NaN \" NaN", 1e5]"#
        );
        assert_eq!(
            tokens(&["[18446744073709551615, -9223372036854775808]"]),
            "[18446744073709551615, -9223372036854775808]"
        );
        assert_eq!(tokens(&["{\"a\": 1844674407370955", "1616}"]), r#"{"a": "18446744073709551616"}"#);
        assert_eq!(tokens(&["NaN"]), "null");
    }
}
