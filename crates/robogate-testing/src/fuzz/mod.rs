//! Fuzzing: a reader of foreign bytes is tried with damaged and generated inputs.
//!
//! An ordinary test run tries a fixed number of inputs, the same in every run. `scripts/fuzz.sh` tries more, and builds the readers
//! so that each input tells which code it reached: inputs that reach new code are kept, and later ones are derived from them.
//! [`FIRST`] sets the first input, and [`CORPUS`] the folder of the kept ones, so that runs can continue each other. The input of a
//! finding is stored in the folder for temporary files.

mod coverage;
mod source;

use std::cell::RefCell;
use std::env;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

pub use source::mutate;
use source::{Generated, Mutations, Source};

/// Environment variable: seconds for each target, in place of the fixed number of inputs.
pub const SECONDS: &str = "ROBOGATE_FUZZ_SECONDS";
/// Environment variable: the number of the first input.
pub const FIRST: &str = "ROBOGATE_FUZZ_SEED";
/// Environment variable: the folder with a folder for each target, which contains the inputs that reached new code.
pub const CORPUS: &str = "ROBOGATE_FUZZ_CORPUS";

/// The longest processor time that one input may take.
const LONGEST: Duration = Duration::from_secs(20);

/// Random numbers: SplitMix64 (Steele et al. 2014), after numbers to repeat if there are any.
#[derive(Debug, Clone)]
pub struct Draw {
    state: u64,
    /// The numbers to repeat first, in reverse order.
    repeated: Vec<u64>,
    /// All numbers so far, if the code that inputs reach is counted.
    drawn: Vec<u64>,
}

impl Draw {
    /// The numbers of input `number` of a target.
    #[must_use]
    pub fn new(target: &str, number: u64) -> Self {
        // Targets differ.
        let state = hash(target.as_bytes()) ^ number.wrapping_mul(0x2545_f491_4f6c_dd1d);
        let mut draw = Self { state, repeated: Vec::new(), drawn: Vec::new() };
        draw.fresh();
        draw
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        let bits = self.repeated.pop().unwrap_or_else(|| self.fresh());
        if coverage::IS_COUNTED {
            self.drawn.push(bits);
        }
        bits
    }

    fn fresh(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = (self.state ^ (self.state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
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
        let mut mutations = Mutations::new([self.valid, self.kept].concat(), self.words);
        let counts = try_all(self.name, self.inputs, &mut mutations, &mut read);
        // A longer run may derive most inputs from those that get far and are refused.
        let is_ordinary = number(SECONDS).is_none();
        assert!(!is_ordinary || (counts.read > 0 && counts.refused > 0), "{}: {counts:?}", self.name);
    }
}

/// Tries a reader with the inputs of a generator: `inputs` of them, or what [`SECONDS`] allows. `read` returns whether the
/// reader accepted the input.
///
/// # Panics
/// If the reader panics, or takes too long.
pub fn run(
    name: &str,
    inputs: u64,
    generate: impl FnMut(&mut Draw) -> Vec<u8>,
    mut read: impl FnMut(&[u8]) -> bool,
) -> Counts {
    try_all(name, inputs, &mut Generated::new(generate), &mut read)
}

/// What a run has found so far.
struct Trial<'a> {
    name: &'a str,
    read: &'a mut dyn FnMut(&[u8]) -> bool,
    counts: Counts,
    slowest: (Duration, u64),
    findings: Vec<String>,
}

impl Trial<'_> {
    /// Tries one input. Returns whether it reached code that no earlier one did.
    fn attempt(&mut self, number: u64, bytes: &[u8]) -> bool {
        let before = processor_time();
        match catch_unwind(AssertUnwindSafe(|| (self.read)(bytes))) {
            Ok(true) => self.counts.read += 1,
            Ok(false) => self.counts.refused += 1,
            Err(_) => self.findings.push(finding(self.name, number, bytes)),
        }
        let took = processor_time().saturating_sub(before);
        if took > self.slowest.0 {
            self.slowest = (took, number);
            if took > LONGEST {
                self.findings.push(format!("{took:.1?}: {}", finding(self.name, number, bytes)));
            }
        }
        assert!(self.findings.len() < 20, "{:#?}", self.findings);
        coverage::grew()
    }
}

#[expect(clippy::print_stdout, reason = "the number of inputs is a result of a longer run")]
fn try_all(name: &str, inputs: u64, source: &mut dyn Source, read: &mut dyn FnMut(&[u8]) -> bool) -> Counts {
    let budget = number(SECONDS).map(Duration::from_secs);
    let first = number(FIRST).unwrap_or(0);
    let corpus = env::var_os(CORPUS).map(|folder| Path::new(&folder).join(name.replace(['/', ' '], "-")));
    let counts = Counts { read: 0, refused: 0 };
    let mut trial = Trial { name, read, counts, slowest: (Duration::ZERO, 0), findings: Vec::new() };
    let mut kept = 0;
    if let Some(folder) = &corpus {
        fs::create_dir_all(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
        for stored in self::corpus(folder) {
            let bytes = source.restored(&stored);
            if trial.attempt(first, &bytes) {
                source.keep(&bytes);
                kept += 1;
            }
        }
    }
    let (began, mut next) = (Instant::now(), first);
    while budget.map_or(next - first < inputs, |budget| began.elapsed() < budget) {
        let bytes = source.input(Draw::new(name, next));
        if trial.attempt(next, &bytes)
            && let Some(stored) = source.keep(&bytes)
        {
            kept += 1;
            if let Some(folder) = &corpus {
                store(folder, &stored);
            }
        }
        next += 1;
    }
    let Trial { counts, slowest, findings, .. } = trial;
    println!(
        "{name}: {} inputs from {first}, {} read, {kept} reached new code, slowest {:.1?} ({}), {:.0?}",
        next - first,
        counts.read,
        slowest.0,
        slowest.1,
        began.elapsed()
    );
    assert!(findings.is_empty(), "{findings:#?}");
    counts
}

/// Stores an input under a name that depends on its content.
fn store(folder: &Path, bytes: &[u8]) {
    let path = folder.join(format!("{:016x}", hash(bytes)));
    fs::write(&path, bytes).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
}

/// FNV-1a.
fn hash(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
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
