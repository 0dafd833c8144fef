//! Version and limits of the protocol.

use robogate_zmtp::Limits;

/// Version of the protocol.
pub const VERSION: u64 = 2;
/// Largest header, in bytes.
pub const HEADER_BYTES: usize = 4 << 20;
/// Largest width or height of an image, in pixels.
pub const PIXELS: usize = 4096;
/// Most cameras of a server.
pub const CAMERAS: usize = 16;
/// Most joints of an arm.
pub const JOINTS: usize = 32;
/// Most numbers of an observed vector.
pub const NUMBERS: usize = 4096;
/// Most control periods of an episode.
pub const TICKS: u32 = 1_000_000;
/// Most parameters of a scenario.
pub const PARAMETERS: usize = 256;
/// Most actions of one `step` request.
pub const ACTIONS: usize = 256;
/// Most levels of maps and arrays in a header.
pub const NESTING: usize = 16;
/// Longest string in a header, in bytes of UTF-8.
pub const STRING_BYTES: usize = 4096;
/// Most entries of a map or an array in a header.
pub const ENTRIES: usize = 65_536;

/// Limits on the message of a reply: a header, and one frame for each image.
pub const REPLY: Limits = Limits { frames: 1 + CAMERAS, frame_bytes: 48 << 20, message_bytes: 64 << 20 };
/// Limits on the message of a request: a header alone.
pub const REQUEST: Limits = Limits { frames: 1, frame_bytes: HEADER_BYTES, message_bytes: HEADER_BYTES };
