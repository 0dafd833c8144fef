//! Reusable memory for images.

/// Buffers that are not in use.
///
/// Allocating a buffer of the size of an image and touching its pages for the first time takes longer than all
/// processing of the image.
#[derive(Debug, Default)]
pub(crate) struct Buffers(Vec<Vec<u8>>);

impl Buffers {
    /// Take an empty buffer.
    pub(crate) fn take(&mut self) -> Vec<u8> {
        let mut buffer = self.0.pop().unwrap_or_default();
        buffer.clear();
        buffer
    }

    /// Return a buffer. It must come from [`Buffers::take`], because nothing else limits their number.
    pub(crate) fn recycle(&mut self, buffer: Vec<u8>) {
        self.0.push(buffer);
    }
}
