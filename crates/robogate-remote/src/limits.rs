//! Version and limits of the protocol.

use robogate_zmtp::Limits;

/// Version of the protocol.
pub const VERSION: u64 = 3;
/// Maximum size of a header, in bytes.
pub const HEADER_BYTES: usize = 4 << 20;
/// Maximum width or height of an image, in pixels.
pub const PIXELS: usize = 4096;
/// Maximum number of cameras of a server.
pub const CAMERAS: usize = 16;
/// Maximum number of joints of an arm.
pub const JOINTS: usize = 32;
/// Maximum number of elements of an observed vector.
pub const NUMBERS: usize = 4096;
/// Maximum number of control periods of an episode.
pub const TICKS: u32 = 1_000_000;
/// Maximum number of parameters of a scenario.
pub const PARAMETERS: usize = 256;
/// Maximum number of triangles of the solids of a recorded motion.
pub const TRIANGLES: usize = 1_000_000;
/// Maximum number of actions of one `step` request.
pub const ACTIONS: usize = 256;
/// Maximum number of control periods that a server may run ahead.
pub const AHEAD: u32 = 256;
/// Maximum nesting depth of maps and arrays in a header.
pub const NESTING: usize = 16;
/// Maximum length of a string in a header, in bytes of UTF-8.
pub const STRING_BYTES: usize = 4096;
/// Maximum number of entries of a map or an array in a header.
pub const ENTRIES: usize = 65_536;

/// Limits on the message of a reply: a header, and one frame for each image.
pub const REPLY: Limits = Limits { frames: 1 + CAMERAS, frame_bytes: 48 << 20, message_bytes: 64 << 20 };
/// Limits on the message of a request: a header only.
pub const REQUEST: Limits = Limits { frames: 1, frame_bytes: HEADER_BYTES, message_bytes: HEADER_BYTES };
