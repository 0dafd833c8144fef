//! Memory that pictures were in, for the next ones.

/// Buffers that nobody uses at the moment.
///
/// A fresh buffer of a picture's size comes from the system and goes back to it, and touching its pages for the first time
/// takes longer than all that is done with the picture.
#[derive(Debug, Default)]
pub(crate) struct Spare(Vec<Vec<u8>>);

impl Spare {
    /// An empty buffer.
    pub(crate) fn take(&mut self) -> Vec<u8> {
        let mut buffer = self.0.pop().unwrap_or_default();
        buffer.clear();
        buffer
    }

    /// Takes a buffer back. Only what was taken from here should come back: nothing else bounds how many there are.
    pub(crate) fn give(&mut self, buffer: Vec<u8>) {
        self.0.push(buffer);
    }
}
