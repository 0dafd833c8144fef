//! Checks the structure of an ONNX file before the library reads it.
//!
//! The library allocates what a length field claims, and follows nested messages by recursion. A length that exceeds the
//! file, or a deep nesting, would end the process.

/// Most messages and texts in a file. The library needs up to 300 bytes for each. A network of 50,000 nodes has about half a
/// million.
const MAX_MESSAGES: usize = 1_000_000;

/// Deepest nesting of graphs and sequence types.
const MAX_DEPTH: usize = 8;

/// The messages of an ONNX file that contain other messages.
#[derive(Clone, Copy)]
enum Message {
    Model,
    Graph,
    Node,
    Attribute,
    Tensor,
    Value,
    Type,
    TensorType,
    Sequence,
    Shape,
    /// A message without further messages.
    Leaf,
}

impl Message {
    /// The message in a field; `None` for texts, bytes and packed numbers.
    fn field(self, number: u64) -> Option<Self> {
        Some(match (self, number) {
            (Self::Model, 7) | (Self::Attribute, 6) => Self::Graph,
            (Self::Graph, 1) => Self::Node,
            (Self::Graph, 5) | (Self::Attribute, 5) => Self::Tensor,
            (Self::Graph, 11..=13) => Self::Value,
            (Self::Node, 5) => Self::Attribute,
            (Self::Value, 2) | (Self::Sequence, 1) => Self::Type,
            (Self::Type, 1) => Self::TensorType,
            (Self::Type, 4) => Self::Sequence,
            (Self::TensorType, 2) => Self::Shape,
            (Self::Model, 8 | 14) | (Self::Tensor, 13) | (Self::Shape, 1) => Self::Leaf,
            _ => return None,
        })
    }

    /// Whether this message can contain itself.
    fn nests(self) -> bool {
        matches!(self, Self::Graph | Self::Sequence)
    }
}

/// Check that all lengths are within the file and that neither number nor depth of messages is excessive.
pub(super) fn check(bytes: &[u8]) -> Result<(), String> {
    let mut messages = 0;
    walk(bytes, Message::Model, 0, &mut messages)
}

fn walk(mut bytes: &[u8], message: Message, depth: usize, messages: &mut usize) -> Result<(), String> {
    let depth = depth + usize::from(message.nests());
    if depth > MAX_DEPTH {
        return Err(format!("its graphs or types are nested more than {MAX_DEPTH} times"));
    }
    while !bytes.is_empty() {
        let tag = varint(&mut bytes)?;
        match tag & 7 {
            0 => drop(varint(&mut bytes)?),
            1 => drop(take(&mut bytes, 8)?),
            5 => drop(take(&mut bytes, 4)?),
            2 => {
                *messages += 1;
                if *messages > MAX_MESSAGES {
                    return Err(format!("it has more than {MAX_MESSAGES} messages"));
                }
                let length = varint(&mut bytes)?;
                let content = take(&mut bytes, length)?;
                if let Some(message) = message.field(tag >> 3) {
                    walk(content, message, depth, messages)?;
                }
            }
            _ => return Err("it is damaged: a field has an unknown encoding".to_owned()),
        }
    }
    Ok(())
}

/// Read a number of variable length.
fn varint(bytes: &mut &[u8]) -> Result<u64, String> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let byte = take(bytes, 1)?[0];
        number |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Ok(number);
        }
    }
    Err("it is damaged: a number has more than 64 bits".to_owned())
}

/// Take bytes from the front.
fn take<'a>(bytes: &mut &'a [u8], count: u64) -> Result<&'a [u8], String> {
    let split = usize::try_from(count).ok().and_then(|count| bytes.split_at_checked(count));
    let (taken, rest) = split.ok_or("it is damaged or cut off: a field is longer than what contains it")?;
    *bytes = rest;
    Ok(taken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_must_fit_into_the_file() {
        // A name of the producer with 2^40 bytes, in a file of seven.
        let why = check(&[0x12, 0x80, 0x80, 0x80, 0x80, 0x80, 0x20]).unwrap_err();
        assert!(why.contains("longer than"), "{why}");
    }

    #[test]
    fn many_messages_are_an_error() {
        // Each text of two bytes needs up to 300 bytes in the library.
        let bytes = [0x12, 0].repeat(MAX_MESSAGES + 1);
        let (why, peak) = robogate_testing::peak_memory(|| check(&bytes).unwrap_err());
        assert!(why.contains("more than 1000000 messages"), "{why}");
        assert!(peak < 1_000, "{peak}");
    }

    #[test]
    fn deep_nesting_is_an_error() {
        let mut bytes = Vec::new();
        for _ in 0..20 {
            // A graph in an attribute in a node; the outermost is cut off, and too deep before that.
            for field in [6, 5, 1] {
                let mut outer = vec![field << 3 | 2];
                let mut length = bytes.len();
                while length >= 0x80 {
                    outer.push((length % 0x80) as u8 | 0x80);
                    length /= 0x80;
                }
                outer.push(length as u8);
                outer.extend(&bytes);
                bytes = outer;
            }
        }
        let why = walk(&bytes, Message::Graph, 0, &mut 0).unwrap_err();
        assert!(why.contains("nested more than 8 times"), "{why}");
    }
}
