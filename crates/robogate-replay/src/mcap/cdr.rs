//! Messages of ROS 2 in CDR (XCDR1), decoded by the definition that an MCAP file or a bag has for their type.

use std::collections::BTreeMap;

use serde_json::{Map, Number, Value};

/// Most values of one message, and deepest nesting of its types.
const MOST_VALUES: usize = 100_000;
const DEEPEST: usize = 32;
/// Most fields of all types of one message.
const MOST_FIELDS: usize = 10_000;

/// How many elements a field has.
#[derive(Debug, Clone, Copy)]
enum Count {
    One,
    Array(usize),
    Sequence,
}

#[derive(Debug)]
struct Field {
    name: String,
    type_name: String,
    count: Count,
}

/// The definition of a type, with those that it uses.
#[derive(Debug)]
pub(super) struct Definition {
    root: String,
    types: BTreeMap<String, Vec<Field>>,
}

/// Without the folder that ROS 2 added: `std_msgs/msg/Header` is `std_msgs/Header`.
fn short(name: &str) -> String {
    name.replace("/msg/", "/")
}

impl Definition {
    /// Reads a text in the format `ros2msg`: the fields of a type, then after lines of `=` those of the types that it uses.
    pub(super) fn parse(name: &str, text: &str) -> Result<Self, String> {
        let root = short(name);
        let mut types = BTreeMap::from([(root.clone(), Vec::new())]);
        let (mut current, mut fields) = (root.clone(), 0);
        for line in text.lines() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if let Some(name) = line.strip_prefix("MSG:") {
                current = short(name.trim());
                types.insert(current.clone(), Vec::new());
            } else if !line.is_empty() && !line.starts_with("===") {
                fields += 1;
                if fields > MOST_FIELDS {
                    return Err(format!("the definition of {name} has more than {MOST_FIELDS} fields"));
                }
                let field =
                    Field::parse(line, &current).ok_or_else(|| format!("the definition of {name}: `{line}`"))?;
                types.entry(current.clone()).or_default().extend(field);
            }
        }
        Ok(Self { root, types })
    }

    /// Decodes a message.
    pub(super) fn decode(&self, message: &[u8]) -> Result<Value, String> {
        let little = match message {
            [0, 0, ..] => false,
            [0, 1, ..] => true,
            _ => return Err("not a message in CDR (XCDR1)".to_owned()),
        };
        let body = message.get(4..).ok_or("not a message in CDR: it has no header")?;
        let mut reader = Reader { body, at: 0, little, left: MOST_VALUES };
        reader.structure(self, &self.root, 0)
    }
}

impl Field {
    /// Reads a line. `Some(None)` for a constant.
    fn parse(line: &str, within: &str) -> Option<Option<Self>> {
        let (kind, rest) = line.split_once(char::is_whitespace)?;
        let rest = rest.trim();
        let name = rest.split(|c: char| c.is_whitespace() || c == '=').next().filter(|name| !name.is_empty())?;
        if rest[name.len()..].trim_start().starts_with('=') {
            return Some(None);
        }
        let (base, count) = match kind.split_once('[') {
            None => (kind, Count::One),
            Some((base, bounds)) => match bounds.strip_suffix(']')? {
                "" => (base, Count::Sequence),
                bounds if bounds.starts_with("<=") => (base, Count::Sequence),
                bounds => (base, Count::Array(bounds.parse().ok()?)),
            },
        };
        let base = base.split("<=").next().unwrap_or(base);
        let package = within.rsplit_once('/').map(|(package, _)| package);
        let type_name = match (base, package) {
            _ if is_primitive(base) || base.contains('/') => short(base),
            (_, Some(package)) => format!("{package}/{base}"),
            (_, None) => base.to_owned(),
        };
        Some(Some(Self { name: name.to_owned(), type_name, count }))
    }
}

fn is_primitive(name: &str) -> bool {
    matches!(
        name,
        "bool"
            | "byte"
            | "char"
            | "string"
            | "wstring"
            | "int8"
            | "uint8"
            | "int16"
            | "uint16"
            | "int32"
            | "uint32"
            | "int64"
            | "uint64"
            | "float32"
            | "float64"
    )
}

struct Reader<'a> {
    body: &'a [u8],
    at: usize,
    little: bool,
    /// Values that may still be decoded.
    left: usize,
}

impl Reader<'_> {
    fn structure(&mut self, types: &Definition, name: &str, depth: usize) -> Result<Value, String> {
        let fields = types.types.get(name).ok_or_else(|| format!("its definition lacks the type {name}"))?;
        if depth > DEEPEST {
            return Err(format!("its types are nested more than {DEEPEST} levels deep"));
        }
        if fields.is_empty() {
            // A type without fields has one byte.
            self.take::<1>()?;
        }
        let mut object = Map::new();
        for Field { name, type_name, count } in fields {
            self.left = self.left.checked_sub(1).ok_or_else(|| format!("it has more than {MOST_VALUES} values"))?;
            let length = match count {
                Count::One => {
                    object.insert(name.clone(), self.value(types, type_name, depth)?);
                    continue;
                }
                Count::Array(length) => *length,
                Count::Sequence => self.u32()? as usize,
            };
            let values = (0..length).map(|_| self.value(types, type_name, depth)).collect::<Result<_, _>>()?;
            object.insert(name.clone(), Value::Array(values));
        }
        Ok(Value::Object(object))
    }

    fn value(&mut self, types: &Definition, type_name: &str, depth: usize) -> Result<Value, String> {
        self.left = self.left.checked_sub(1).ok_or_else(|| format!("it has more than {MOST_VALUES} values"))?;
        /// Reads a number of this type.
        macro_rules! number {
            ($type:ty) => {{
                let bytes = self.take()?;
                if self.little { <$type>::from_le_bytes(bytes) } else { <$type>::from_be_bytes(bytes) }
            }};
        }
        // JSON has no infinity and no NaN.
        let real = |number: f64| Number::from_f64(number).map_or(Value::Null, Value::Number);
        Ok(match type_name {
            "bool" => (self.take::<1>()? != [0]).into(),
            "byte" | "char" | "uint8" => number!(u8).into(),
            "int8" => number!(i8).into(),
            "uint16" => number!(u16).into(),
            "int16" => number!(i16).into(),
            "uint32" => self.u32()?.into(),
            "int32" => number!(i32).into(),
            "uint64" => number!(u64).into(),
            "int64" => number!(i64).into(),
            "float32" => real(number!(f32).into()),
            "float64" => real(number!(f64)),
            "string" => self.string()?.into(),
            "wstring" => return Err("texts of the type wstring are not supported".to_owned()),
            other => self.structure(types, other, depth + 1)?,
        })
    }

    fn u32(&mut self) -> Result<u32, String> {
        let bytes = self.take()?;
        Ok(if self.little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    /// A text with a zero at its end.
    fn string(&mut self) -> Result<String, String> {
        let length = self.u32()? as usize;
        let bytes = self.body.get(self.at..).and_then(|rest| rest.get(..length)).ok_or("it ends within a text")?;
        self.at += length;
        Ok(String::from_utf8_lossy(bytes.strip_suffix(&[0]).unwrap_or(bytes)).into_owned())
    }

    /// The next bytes, which are aligned to their number.
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let at = self.at.next_multiple_of(N);
        let bytes =
            self.body.get(at..).and_then(|rest| rest.first_chunk()).ok_or("it is shorter than its definition")?;
        self.at = at + N;
        Ok(*bytes)
    }
}

#[cfg(test)]
mod tests {
    use robogate_testing::fuzz::Target;
    use serde_json::json;

    use super::*;

    const TEXT: &str = "# a comment\nuint8 OK=0\nstd_msgs/Header header\nint8 state 3\nfloat64[] angles\nstring<=10 word\n\
        Part[2] parts\nint16[<=4] few\n================\nMSG: std_msgs/msg/Header\nuint32 sec\nstring frame_id\n\
        ================\nMSG: cell_msgs/Part\nbool good\nfloat32 mass\n";

    fn message() -> Vec<u8> {
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend(7_u32.to_le_bytes());
        bytes.extend(2_u32.to_le_bytes());
        bytes.extend(*b"a\0\xfe\0"); // frame, state -2, padding
        bytes.extend(2_u32.to_le_bytes());
        bytes.extend(0.5_f64.to_le_bytes());
        bytes.extend(f64::NAN.to_le_bytes());
        bytes.extend(3_u32.to_le_bytes());
        bytes.extend(*b"ok\0\x01"); // word, then the first part
        bytes.extend(1.5_f32.to_le_bytes());
        bytes.extend([0; 4]);
        bytes.extend(0.25_f32.to_le_bytes());
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend((-3_i16).to_le_bytes());
        bytes
    }

    #[test]
    fn messages_follow_their_definition() {
        let definition = Definition::parse("cell_msgs/msg/Result", TEXT).unwrap();
        let expected = json!({ "header": { "sec": 7, "frame_id": "a" }, "state": -2, "angles": [0.5, null], "word": "ok",
            "parts": [{ "good": true, "mass": 1.5 }, { "good": false, "mass": 0.25 }], "few": [-3] });
        assert_eq!(definition.decode(&message()).unwrap(), expected);
        for end in 0..message().len() {
            assert!(definition.decode(&message()[..end]).is_err(), "{end}");
        }
    }

    /// The first byte says where the definition ends and the message begins.
    #[test]
    fn fuzzed_messages_are_read_or_refused() {
        let both = |text: &str, message: &[u8]| [text.as_bytes(), b"\0\0\0\0", message].concat();
        let valid = [both(TEXT, &message()), both("float64[3] a\nwstring b", &[0, 1, 0, 0])];
        let words = ["uint8", "[]", "[<=4]", "string", "wstring", "MSG: ", "====", "[4000000000]", "a/A a", "\n"];
        let read = |bytes: &[u8]| {
            let cut = bytes.windows(4).position(|part| part == b"\0\0\0\0").unwrap_or(bytes.len());
            let text = String::from_utf8_lossy(&bytes[..cut]);
            let message = bytes.get(cut + 4..).unwrap_or_default();
            Definition::parse("cell_msgs/msg/Result", &text).is_ok_and(|definition| definition.decode(message).is_ok())
        };
        Target { name: "cdr", valid: &valid[..1], kept: &valid[1..], words: &words, inputs: 500 }.run(read);
    }

    #[test]
    fn hostile_definitions_are_bounded() {
        let decode = |text: &str, body: &[u8]| {
            Definition::parse("a/A", text).and_then(|d| d.decode(&[&[0, 1, 0, 0], body].concat()))
        };
        assert!(decode("A a", &[0; 100]).unwrap_err().contains("nested"));
        assert!(decode("uint8[4000000000] a", &vec![0; 1 << 20]).unwrap_err().contains("values"));
        assert!(decode("uint8[] a", &[255; 8]).unwrap_err().contains("shorter"));
        assert!(decode("b/B b", &[0; 8]).unwrap_err().contains("lacks the type b/B"));
        let empty: String = (0..2_000).map(|i| format!("uint8[0] x{i}\n")).collect();
        let many = format!("b/B[90000] b\n================\nMSG: b/B\n{empty}");
        assert!(decode(&many, &[0; 8]).unwrap_err().contains("values"));
        assert!(Definition::parse("a/A", "nonsense").is_err());
        assert!(Definition::parse("a/A", "uint8[x] a").is_err());
        assert!(Definition::parse("a/A", &"uint8 a\n".repeat(20_000)).is_err());
    }
}
