//! Where the inputs of a target come from.

use super::Draw;

/// The largest number of draws of a generated input that is kept.
const MOST_DRAWS: usize = 20_000;

/// Inputs, derived from those that reached new code if that is known.
pub(super) trait Source {
    /// The next input.
    fn input(&mut self, draw: Draw) -> Vec<u8>;

    /// Keeps the last input. Returns what restores it, or `None` if it is too large to be useful.
    fn keep(&mut self, input: &[u8]) -> Option<Vec<u8>>;

    /// An input that an earlier run kept.
    fn restored(&mut self, stored: &[u8]) -> Vec<u8>;
}

/// Mutations of a corpus.
pub(super) struct Mutations<'a> {
    /// The given inputs, and then those that reached new code.
    corpus: Vec<Vec<u8>>,
    given: usize,
    words: &'a [&'a str],
    /// The most bytes of an input that is kept. Mutations of long inputs take long, and most of them change nothing.
    most: usize,
}

impl<'a> Mutations<'a> {
    pub(super) fn new(corpus: Vec<Vec<u8>>, words: &'a [&'a str]) -> Self {
        let longest = corpus.iter().map(Vec::len).max().unwrap_or(0);
        Self { given: corpus.len(), corpus, words, most: (2 * longest).max(4096) }
    }
}

impl Source for Mutations<'_> {
    fn input(&mut self, mut draw: Draw) -> Vec<u8> {
        // Most inputs that were kept are damaged, so one in four is derived from a given one.
        let has_more = self.corpus.len() > self.given;
        let from = if has_more && draw.below(4) == 0 { &self.corpus[..self.given] } else { &self.corpus };
        mutate(from, self.words, &mut draw)
    }

    fn keep(&mut self, input: &[u8]) -> Option<Vec<u8>> {
        (input.len() <= self.most).then(|| {
            self.corpus.push(input.to_vec());
            input.to_vec()
        })
    }

    fn restored(&mut self, stored: &[u8]) -> Vec<u8> {
        stored.to_vec()
    }
}

/// Inputs that a generator builds from random draws. Where one reached new code, its draws are repeated with changes.
pub(super) struct Generated<G> {
    generate: G,
    sequences: Vec<Vec<u64>>,
    last: Vec<u64>,
}

impl<G: FnMut(&mut Draw) -> Vec<u8>> Generated<G> {
    pub(super) fn new(generate: G) -> Self {
        Self { generate, sequences: Vec::new(), last: Vec::new() }
    }

    /// The input of these draws, followed by fresh ones.
    fn repeated(&mut self, mut sequence: Vec<u64>, fresh: &Draw) -> Vec<u8> {
        sequence.reverse();
        let mut draw = Draw { state: fresh.state, repeated: sequence, drawn: Vec::new() };
        let input = (self.generate)(&mut draw);
        self.last = draw.drawn;
        input
    }
}

impl<G: FnMut(&mut Draw) -> Vec<u8>> Source for Generated<G> {
    fn input(&mut self, mut draw: Draw) -> Vec<u8> {
        // One input in four is a fresh one.
        let sequence = if self.sequences.is_empty() || draw.below(4) == 0 {
            Vec::new()
        } else {
            let sequence = draw.of(&self.sequences).clone();
            changed(sequence, &mut draw)
        };
        self.repeated(sequence, &draw)
    }

    fn keep(&mut self, _input: &[u8]) -> Option<Vec<u8>> {
        (self.last.len() <= MOST_DRAWS).then(|| {
            self.sequences.push(self.last.clone());
            self.last.iter().flat_map(|draw| draw.to_le_bytes()).collect()
        })
    }

    fn restored(&mut self, stored: &[u8]) -> Vec<u8> {
        let draws = stored.chunks_exact(8).map(|draw| u64::from_le_bytes(draw.try_into().expect("eight bytes")));
        self.repeated(draws.collect(), &Draw::new("restored", 0))
    }
}

/// Cuts a sequence of draws, or draws, removes or inserts some of them again.
fn changed(mut sequence: Vec<u64>, draw: &mut Draw) -> Vec<u64> {
    for _ in 0..=draw.below(3) {
        if sequence.is_empty() {
            break;
        }
        let at = draw.below(sequence.len());
        match draw.below(8) {
            0 => sequence.truncate(at),
            1 => {
                sequence.remove(at);
            }
            2 => sequence.insert(at, draw.bits()),
            _ => sequence[at] = draw.bits(),
        }
    }
    sequence
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The input lists its draws below 100.
    fn listed(draw: &mut Draw) -> Vec<u8> {
        (0..8).map(|_| draw.below(100) as u8).collect()
    }

    #[test]
    fn kept_draws_restore_their_input() {
        let mut source = Generated::new(listed);
        let sequence: Vec<u64> = (0..8).map(|i| i << 60).collect();
        let input = source.repeated(sequence.clone(), &Draw::new("target", 1));
        assert_eq!(input, [0, 6, 12, 18, 25, 31, 37, 43]);
        // What `keep` would store where the reached code is counted.
        let stored: Vec<u8> = sequence.iter().flat_map(|draw| draw.to_le_bytes()).collect();
        assert_eq!(source.restored(&stored), input);
    }

    #[test]
    fn changes_keep_most_draws() {
        let mut source = Generated::new(listed);
        source.sequences.push((0..8).map(|i| i << 60).collect());
        let kept = [0, 6, 12, 18, 25, 31, 37, 43];
        let near = (0..1000).filter(|number| {
            let input = source.input(Draw::new("target", *number));
            input.iter().zip(kept).filter(|(a, b)| **a == *b).count() >= 4
        });
        assert!(near.count() > 300);
    }

    #[test]
    fn long_inputs_are_not_kept() {
        let mut source = Mutations::new(vec![vec![1; 100]], &[]);
        assert_eq!(source.keep(&[2; 4097]), None);
        assert_eq!(source.keep(&[3; 5]), Some(vec![3; 5]));
        assert_eq!(source.corpus.len(), 2);
    }
}
