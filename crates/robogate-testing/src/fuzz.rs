//! Fuzzing: a reader of foreign bytes is tried with damaged and generated inputs.
//!
//! An ordinary test run tries a fixed number of inputs, the same in every run; `scripts/fuzz.sh` tries more. [`FIRST`] sets
//! the first input, so that runs can continue each other. A finding is reported with its number, which reproduces it, and
//! its input is kept in the folder for temporary files.

use std::cell::RefCell;
use std::env;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Environment variable: seconds for each target, in place of the fixed number of inputs.
pub const SECONDS: &str = "ROBOGATE_FUZZ_SECONDS";
/// Environment variable: the number of the first input.
pub const FIRST: &str = "ROBOGATE_FUZZ_SEED";

/// The longest processor time that one input may take.
const LONGEST: Duration = Duration::from_secs(20);

/// Random numbers: SplitMix64 (Steele et al. 2014).
#[derive(Debug, Clone)]
pub struct Draw(u64);

impl Draw {
    /// The numbers of input `number` of a target.
    #[must_use]
    pub fn new(target: &str, number: u64) -> Self {
        // FNV-1a, so that targets differ.
        let name = target
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
        let mut draw = Self(name ^ number.wrapping_mul(0x2545_f491_4f6c_dd1d));
        draw.bits();
        draw
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `limit`, or 0 if the limit is 0.
    pub fn below(&mut self, limit: usize) -> usize {
        ((u128::from(self.bits()) * limit as u128) >> 64) as usize
    }

    /// One of these.
    pub fn of<'a, T>(&mut self, these: &'a [T]) -> &'a T {
        &these[self.below(these.len())]
    }
}

/// One reader under test.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// Its name, for messages.
    pub name: &'a str,
    /// Inputs that the reader accepts.
    pub valid: &'a [Vec<u8>],
    /// Kept inputs: they once found a defect, or a rule of the reader forbids them.
    pub kept: &'a [Vec<u8>],
    /// Words with a meaning for the reader.
    pub words: &'a [&'a str],
    /// Inputs of an ordinary test run.
    pub inputs: u64,
}

/// How a reader treated its inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    /// Inputs that the reader accepted.
    pub read: u64,
    /// Inputs that it refused.
    pub refused: u64,
}

impl Target<'_> {
    /// Tries the reader with these inputs and with mutations of them. `read` returns whether the reader accepted the
    /// input.
    ///
    /// # Panics
    /// If the reader refuses a valid input, panics, or takes too long; and if it accepts or refuses all inputs, because then only
    /// one of its checks was tested.
    pub fn run(&self, mut read: impl FnMut(&[u8]) -> bool) {
        for (i, bytes) in self.valid.iter().enumerate() {
            assert!(read(bytes), "{}: valid input {i} is refused", self.name);
        }
        for bytes in self.kept {
            read(bytes);
        }
        let corpus = [self.valid, self.kept].concat();
        let counts = run(self.name, self.inputs, |draw| mutate(&corpus, self.words, draw), read);
        let enough = counts.read + counts.refused >= self.inputs;
        assert!(!enough || (counts.read > 0 && counts.refused > 0), "{}: {counts:?}", self.name);
    }
}

/// Tries a reader with the inputs of a generator: `inputs` of them, or what [`SECONDS`] allows. `read` returns whether the
/// reader accepted the input.
///
/// # Panics
/// If the reader panics, or takes too long.
#[expect(clippy::print_stdout, reason = "the number of inputs is a result of a longer run")]
pub fn run(
    name: &str,
    inputs: u64,
    mut generate: impl FnMut(&mut Draw) -> Vec<u8>,
    mut read: impl FnMut(&[u8]) -> bool,
) -> Counts {
    let budget = number(SECONDS).map(Duration::from_secs);
    let first = number(FIRST).unwrap_or(0);
    let mut counts = Counts { read: 0, refused: 0 };
    let mut slowest = (Duration::ZERO, 0);
    let mut findings = Vec::new();
    let (began, mut next) = (Instant::now(), first);
    while budget.map_or(next - first < inputs, |budget| began.elapsed() < budget) {
        let bytes = generate(&mut Draw::new(name, next));
        let before = processor_time();
        match catch_unwind(AssertUnwindSafe(|| read(&bytes))) {
            Ok(true) => counts.read += 1,
            Ok(false) => counts.refused += 1,
            Err(_) => findings.push(finding(name, next, &bytes)),
        }
        let took = processor_time() - before;
        if took > slowest.0 {
            slowest = (took, next);
            if took > LONGEST {
                findings.push(format!("{took:.1?}: {}", finding(name, next, &bytes)));
            }
        }
        next += 1;
        assert!(findings.len() < 20, "{findings:#?}");
    }
    println!(
        "{name}: {} inputs from {first}, {} read, slowest {:.1?} ({}), {:.0?}",
        next - first,
        counts.read,
        slowest.0,
        slowest.1,
        began.elapsed()
    );
    assert!(findings.is_empty(), "{findings:#?}");
    counts
}

/// Applies one to four mutations to one of these inputs.
///
/// # Panics
/// If there are none.
pub fn mutate(corpus: &[Vec<u8>], words: &[&str], draw: &mut Draw) -> Vec<u8> {
    /// Bytes with a meaning for binary formats: tags, lengths near the limits of their types.
    const BYTES: [u8; 16] = [0, 1, 2, 4, 6, 0x7f, 0x80, 0x81, 0x91, 0xc0, 0xca, 0xcb, 0xdd, 0xff, b'0', b'"'];
    const LENGTHS: [&[u8]; 4] = [&[0xff; 4], &[0xff, 0xff, 0xff, 0x7f], &[0xff; 8], &[0x80; 9]];
    let mut bytes = draw.of(corpus).clone();
    for _ in 0..=draw.below(4) {
        if bytes.is_empty() {
            break;
        }
        let at = draw.below(bytes.len());
        // Half of the mutations are near the end, where some formats store their index.
        let at = if draw.below(2) == 0 { at } else { bytes.len() - 1 - at / 4 };
        match draw.below(11) {
            0 => bytes[at] ^= 1 << draw.below(8),
            1 => bytes[at] = *draw.of(&BYTES),
            2 => bytes[at] = draw.bits() as u8,
            3 => bytes.truncate(at),
            4 => {
                let end = (at + 1 + draw.below(32)).min(bytes.len());
                bytes.drain(at..end);
            }
            5 => {
                let more: Vec<u8> = (0..1 + draw.below(16)).map(|_| draw.bits() as u8).collect();
                bytes.splice(at..at, more);
            }
            6 => {
                bytes.splice(at..at, draw.of(&LENGTHS).iter().copied());
            }
            7 | 8 if !words.is_empty() => {
                let word = draw.of(words).as_bytes();
                let end = if draw.below(2) == 0 { at } else { (at + word.len()).min(bytes.len()) };
                bytes.splice(at..end, word.iter().copied());
            }
            9 => {
                // Repeats a piece of the input, once or many times.
                let piece = bytes[at..(at + 1 + draw.below(64)).min(bytes.len())].to_vec();
                let again = piece.repeat(1 << draw.below(10));
                let to = draw.below(bytes.len());
                bytes.splice(to..to, again);
            }
            _ => {
                let other = draw.of(corpus);
                let from = draw.below(other.len());
                let piece = &other[from..(from + draw.below(200)).min(other.len())];
                bytes.splice(at..at, piece.iter().copied());
            }
        }
    }
    bytes
}

/// The kept inputs of a folder, in order of their names: inputs that once found a defect, or that a rule of a reader forbids.
///
/// # Panics
/// If the folder cannot be read.
#[must_use]
pub fn corpus(folder: &Path) -> Vec<Vec<u8>> {
    let problem = |e: std::io::Error| -> ! { panic!("{}: {e}", folder.display()) };
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap_or_else(|e| problem(e))
        .map(|file| file.unwrap_or_else(|e| problem(e)).path())
        .collect();
    paths.sort();
    paths.iter().map(|path| fs::read(path).unwrap_or_else(|e| problem(e))).collect()
}

/// Keeps an input, and returns the line that reports it.
fn finding(name: &str, number: u64, bytes: &[u8]) -> String {
    let path = env::temp_dir().join(format!("robogate-fuzz-{}-{number}", name.replace(['/', ' '], "-")));
    let kept = fs::write(&path, bytes);
    format!("{name}, input {number}: {} ({kept:?})", path.display())
}

fn number(variable: &str) -> Option<u64> {
    let text = env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable} is `{text}`, not an integer of at least 0")))
}

/// The processor time of this thread, which other programs do not lengthen. Elsewhere than on Linux, the time since the first call.
fn processor_time() -> Duration {
    thread_local! {
        static BEGAN: RefCell<Option<Instant>> = const { RefCell::new(None) };
    }
    // Nanoseconds on a processor, nanoseconds waiting for one, and time slices.
    let on_linux = fs::read_to_string("/proc/thread-self/schedstat").ok();
    match on_linux.and_then(|line| line.split(' ').next()?.parse().ok()) {
        Some(nanoseconds) => Duration::from_nanos(nanoseconds),
        None => BEGAN.with_borrow_mut(|began| began.get_or_insert_with(Instant::now).elapsed()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &[&str] = &["number", "0", "-1", "\n"];

    fn target(valid: &[Vec<u8>]) -> Target<'_> {
        Target { name: "numbers", valid, kept: &[], words: TEXT, inputs: 500 }
    }

    fn valid() -> Vec<Vec<u8>> {
        vec![b"number 12\n".to_vec(), b"number 7\nnumber 8\n".to_vec()]
    }

    fn accepts(bytes: &[u8]) -> bool {
        bytes.starts_with(b"number ")
    }

    #[test]
    fn inputs_are_the_same_in_every_run() {
        let inputs = |name| {
            let mut seen = Vec::new();
            run(
                name,
                50,
                |draw| mutate(&valid(), TEXT, draw),
                |bytes| {
                    seen.push(bytes.to_vec());
                    accepts(bytes)
                },
            );
            seen
        };
        assert_eq!(inputs("one"), inputs("one"));
        assert_ne!(inputs("one"), inputs("two"));
    }

    #[test]
    fn sound_reader_passes() {
        target(&valid()).run(accepts);
    }

    #[test]
    fn panics_are_kept() {
        // Other processes may run this test at the same time.
        let name = format!("panics-{}", std::process::id());
        let panicking = || {
            run(
                &name,
                500,
                |draw| mutate(&valid(), TEXT, draw),
                |bytes| {
                    assert!(bytes.len() < 200, "too long for this reader");
                    accepts(bytes)
                },
            )
        };
        let message = *catch_unwind(panicking).unwrap_err().downcast::<String>().unwrap();
        let kept: Vec<PathBuf> = fs::read_dir(env::temp_dir())
            .unwrap()
            .map(|file| file.unwrap().path())
            .filter(|path| path.to_string_lossy().contains(&format!("robogate-fuzz-{name}-")))
            .collect();
        assert!(!kept.is_empty());
        for path in kept {
            assert!(message.contains(&*path.to_string_lossy()), "{message}");
            assert!(fs::read(&path).unwrap().len() >= 200);
            fs::remove_file(path).unwrap();
        }
    }

    #[test]
    #[should_panic(expected = "valid input 1 is refused")]
    fn valid_inputs_are_read() {
        target(&[b"number 1".to_vec(), b"word".to_vec()]).run(accepts);
    }

    #[test]
    #[should_panic(expected = "refused: 500")]
    fn reader_that_refuses_every_change_is_not_tested() {
        let mut calls = 0;
        target(&valid()).run(|_| {
            calls += 1;
            calls <= 2
        });
    }
}
