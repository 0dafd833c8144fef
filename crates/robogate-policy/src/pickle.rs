//! The subset of Python pickles that LeRobot's policy server uses.
//!
//! A pickle is a program. This reader does not execute it: classes and functions stay names, and calls stay lists of
//! arguments. Any instruction that a LeRobot server does not use is an error.
//!
//! The size of the pickle limits time and memory. Lengths are checked against the remaining bytes, a value that is
//! referenced twice is stored once, and every byte that an instruction copies is charged to a budget of [`COPIES`] bytes per
//! byte of the pickle. Without that budget, references to one long string build many long names.

use std::rc::Rc;

/// A value in a pickle.
#[derive(Debug, Clone)]
pub(crate) enum Value {
    /// None, or a value that actions do not need: a boolean, a float, a long integer.
    None,
    Int(i64),
    Text(Rc<str>),
    Bytes(Rc<[u8]>),
    List(Rc<Vec<Value>>),
    /// Alternating keys and values.
    Dict(Rc<Vec<Value>>),
    /// The module and name of a class or function, never imported.
    Global(Rc<str>),
    /// A call or an object: callee, arguments and state. Never executed.
    Call(Rc<(Value, Value, Value)>),
    /// A reference to an external object, such as the storage of a tensor.
    External(Rc<Value>),
}

/// Maximum number of values in a pickle. A chunk of a thousand actions has about thirty per action.
const MAX_VALUES: usize = 200_000;
/// Bytes that may be copied for each byte of the pickle. A reader copies each byte once, and names at most once more.
const COPIES: usize = 4;
/// Size of a list item in memory, in bytes: what a copy of a list charges for each of them.
const ITEM: usize = size_of::<Value>();
/// Maximum length of the name of a class or function, in bytes. Python's own are far shorter.
const MAX_NAME: usize = 1_024;
/// Maximum nesting depth. Dropping a value uses a stack frame for each level.
const MAX_DEPTH: u32 = 64;

/// A value with its depth.
type Deep = (Value, u32);

struct Machine<'a> {
    bytes: &'a [u8],
    stack: Vec<Deep>,
    marks: Vec<usize>,
    memo: Vec<Option<Deep>>,
    count: usize,
    /// Bytes that may still be copied.
    budget: usize,
}

/// Read one pickle. Returns its value and the bytes after it.
pub(crate) fn read(bytes: &[u8]) -> Result<(Value, &[u8]), String> {
    let budget = COPIES * bytes.len();
    let mut machine = Machine { bytes, stack: Vec::new(), marks: Vec::new(), memo: Vec::new(), count: 0, budget };
    while !machine.step()? {}
    let (value, _) = machine.pop()?;
    Ok((value, machine.bytes))
}

impl<'a> Machine<'a> {
    /// Process one instruction. Returns whether it was the last one.
    fn step(&mut self) -> Result<bool, String> {
        let opcode = self.take(1)?[0];
        match opcode {
            b'.' => return Ok(true),
            // PROTO, FRAME.
            0x80 => drop(self.take(1)?),
            0x95 => drop(self.take(8)?),
            // NONE, NEWTRUE, NEWFALSE.
            b'N' | 0x88 | 0x89 => self.push(Value::None, 0)?,
            b'J' => {
                let n = i32::from_le_bytes(self.array()?);
                self.push(Value::Int(n.into()), 0)?;
            }
            b'K' => {
                let n = self.take(1)?[0];
                self.push(Value::Int(n.into()), 0)?;
            }
            b'M' => {
                let n = u16::from_le_bytes(self.array()?);
                self.push(Value::Int(n.into()), 0)?;
            }
            // LONG1: used for torch's magic number and for large counts. Those of up to 64 bits are kept.
            0x8a => {
                let length = usize::from(self.take(1)?[0]);
                let digits = self.take(length)?;
                self.push(long(digits), 0)?;
            }
            b'G' => {
                self.take(8)?;
                self.push(Value::None, 0)?;
            }
            // BINUNICODE, SHORT_BINUNICODE.
            b'X' | 0x8c => {
                let bytes = self.counted(opcode == 0x8c)?;
                let text = std::str::from_utf8(bytes).map_err(|_| "a string is not UTF-8")?;
                self.charge(text.len())?;
                self.push(Value::Text(text.into()), 0)?;
            }
            // BINBYTES, SHORT_BINBYTES.
            b'B' | b'C' => {
                let bytes = self.counted(opcode == b'C')?;
                self.charge(bytes.len())?;
                self.push(Value::Bytes(bytes.into()), 0)?;
            }
            b']' => self.push(Value::List(Rc::default()), 0)?,
            b'}' => self.push(Value::Dict(Rc::default()), 0)?,
            b')' => self.push(Value::List(Rc::default()), 0)?,
            b'(' => {
                self.count_one()?;
                self.marks.push(self.stack.len());
            }
            b't' => {
                let items = self.since_mark()?;
                self.push_list(items)?;
            }
            0x85..=0x87 => {
                let length = usize::from(opcode - 0x84);
                let from = self.stack.len().checked_sub(length).ok_or("a tuple has more items than the stack")?;
                self.above_mark(from)?;
                let items = self.stack.split_off(from);
                self.push_list(items)?;
            }
            b'a' | b'e' => {
                let items = if opcode == b'a' { vec![self.pop()?] } else { self.since_mark()? };
                self.extend(items, false)?;
            }
            b's' | b'u' => {
                let items = if opcode == b's' {
                    let value = self.pop()?;
                    vec![self.pop()?, value]
                } else {
                    self.since_mark()?
                };
                if items.len() % 2 != 0 {
                    return Err("a dictionary has a key without a value".to_owned());
                }
                self.extend(items, true)?;
            }
            // GLOBAL: two lines.
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                self.push_global(module, name)?;
            }
            // STACK_GLOBAL.
            0x93 => {
                let ((name, _), (module, _)) = (self.pop()?, self.pop()?);
                let (Value::Text(module), Value::Text(name)) = (module, name) else {
                    return Err("a class has no name".to_owned());
                };
                self.push_global(&module, &name)?;
            }
            // REDUCE, NEWOBJ: recorded, not executed.
            b'R' | 0x81 => {
                let ((arguments, deep), (callee, deep_too)) = (self.pop()?, self.pop()?);
                if !matches!(callee, Value::Global(_)) {
                    return Err("a call of a value that is not a function".to_owned());
                }
                self.push(Value::Call(Rc::new((callee, arguments, Value::None))), deep.max(deep_too) + 1)?;
            }
            // BUILD.
            b'b' => {
                let ((state, deep), (object, deep_too)) = (self.pop()?, self.pop()?);
                let Value::Call(call) = object else {
                    return Err("a state for a value that is not an object".to_owned());
                };
                let call = Rc::new((call.0.clone(), call.1.clone(), state));
                self.push(Value::Call(call), deep.max(deep_too) + 1)?;
            }
            // BINPERSID.
            b'Q' => {
                let (id, deep) = self.pop()?;
                self.push(Value::External(Rc::new(id)), deep + 1)?;
            }
            // MEMOIZE, BINPUT, LONG_BINPUT.
            0x94 => self.memoize(self.memo.len())?,
            b'q' => {
                let at = self.take(1)?[0];
                self.memoize(at.into())?;
            }
            b'r' => {
                let at = u32::from_le_bytes(self.array()?);
                self.memoize(at as usize)?;
            }
            // BINGET, LONG_BINGET.
            b'h' => {
                let at = self.take(1)?[0];
                self.get_memo(at.into())?;
            }
            b'j' => {
                let at = u32::from_le_bytes(self.array()?);
                self.get_memo(at as usize)?;
            }
            other => return Err(format!("unsupported instruction 0x{other:02x}")),
        }
        Ok(false)
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.bytes.split_at_checked(length).ok_or("the pickle is truncated")?;
        self.bytes = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.take(N)?.try_into().map_err(|_| "the pickle is truncated".to_owned())
    }

    fn counted(&mut self, short: bool) -> Result<&'a [u8], String> {
        let length = if short { usize::from(self.take(1)?[0]) } else { u32::from_le_bytes(self.array()?) as usize };
        self.take(length)
    }

    fn line(&mut self) -> Result<&'a str, String> {
        let end = self.bytes.iter().position(|byte| *byte == b'\n').ok_or("the pickle is truncated")?;
        let line = self.take(end)?;
        self.take(1)?;
        std::str::from_utf8(line).map_err(|_| "a name is not UTF-8".to_owned())
    }

    fn push(&mut self, value: Value, depth: u32) -> Result<(), String> {
        self.count_one()?;
        if depth > MAX_DEPTH {
            return Err("the pickle has too many levels of nesting".to_owned());
        }
        self.stack.push((value, depth));
        Ok(())
    }

    /// Counts a value.
    fn count_one(&mut self) -> Result<(), String> {
        self.count += 1;
        if self.count > MAX_VALUES { Err("the pickle has too many values".to_owned()) } else { Ok(()) }
    }

    /// Charges the copy of `bytes` bytes, before it is made.
    fn charge(&mut self, bytes: usize) -> Result<(), String> {
        match self.budget.checked_sub(bytes) {
            Some(left) => {
                self.budget = left;
                Ok(())
            }
            None => Err("the pickle copies its values too often".to_owned()),
        }
    }

    /// Pushes the name of a class or function.
    fn push_global(&mut self, module: &str, name: &str) -> Result<(), String> {
        let length = module.len() + name.len() + 1;
        if length > MAX_NAME {
            return Err(format!("the name of a class has {length} bytes. At most {MAX_NAME} are accepted"));
        }
        self.charge(length)?;
        self.push(Value::Global(format!("{module}.{name}").into()), 0)
    }

    fn push_list(&mut self, items: Vec<Deep>) -> Result<(), String> {
        let depth = items.iter().map(|(_, depth)| depth + 1).max().unwrap_or(0);
        self.push(Value::List(Rc::new(items.into_iter().map(|(value, _)| value).collect())), depth)
    }

    fn above_mark(&self, from: usize) -> Result<(), String> {
        if self.marks.last().is_some_and(|mark| from < *mark) {
            return Err("the stack is empty".to_owned());
        }
        Ok(())
    }

    fn pop(&mut self) -> Result<Deep, String> {
        let from = self.stack.len().checked_sub(1).ok_or("the stack is empty")?;
        self.above_mark(from)?;
        self.stack.pop().ok_or_else(|| "the stack is empty".to_owned())
    }

    fn since_mark(&mut self) -> Result<Vec<Deep>, String> {
        let mark = self.marks.pop().filter(|mark| *mark <= self.stack.len()).ok_or("no matching mark")?;
        Ok(self.stack.split_off(mark))
    }

    /// Extend the list or dictionary on top of the stack.
    fn extend(&mut self, items: Vec<Deep>, dict: bool) -> Result<(), String> {
        let (top, mut depth) = self.pop()?;
        depth = items.iter().map(|(_, d)| d + 1).fold(depth, u32::max);
        // A memoised list is copied before it is extended.
        if let Value::List(list) | Value::Dict(list) = &top
            && Rc::strong_count(list) > 1
        {
            self.charge(list.len() * ITEM)?;
        }
        let items = items.into_iter().map(|(value, _)| value);
        let value = match (top, dict) {
            (Value::List(mut list), false) => {
                Rc::make_mut(&mut list).extend(items);
                Value::List(list)
            }
            (Value::Dict(mut entries), true) => {
                Rc::make_mut(&mut entries).extend(items);
                Value::Dict(entries)
            }
            _ => return Err("an item for a value that is not a list".to_owned()),
        };
        self.push(value, depth)
    }

    fn memoize(&mut self, at: usize) -> Result<(), String> {
        let top = self.stack.last().cloned().ok_or("the stack is empty")?;
        // Python numbers the entries in order. A list or dictionary is memoised while it is empty and filled later,
        // which the memo does not contain. A LeRobot server never refers to such an entry again, and `get_memo` rejects
        // it.
        if at > self.memo.len() {
            return Err("a memo entry is out of order".to_owned());
        }
        if at == self.memo.len() {
            self.memo.push(Some(top));
        } else {
            self.memo[at] = Some(top);
        }
        Ok(())
    }

    fn get_memo(&mut self, at: usize) -> Result<(), String> {
        let (value, depth) = self.memo.get(at).cloned().flatten().ok_or("an undefined memo entry")?;
        if matches!(&value, Value::List(items) | Value::Dict(items) if items.is_empty()) {
            return Err("a reference to a list that may have been extended".to_owned());
        }
        self.push(value, depth)
    }
}

fn long(digits: &[u8]) -> Value {
    if digits.len() > 8 {
        return Value::None;
    }
    let negative = digits.last().is_some_and(|digit| digit & 0x80 != 0);
    let mut bytes = [if negative { 0xff } else { 0 }; 8];
    bytes[..digits.len()].copy_from_slice(digits);
    Value::Int(i64::from_le_bytes(bytes))
}

impl Value {
    /// The value of a key in a dictionary.
    pub(crate) fn get(&self, key: &str) -> Option<&Value> {
        let Value::Dict(entries) = self else { return None };
        entries
            .chunks_exact(2)
            .find(|pair| matches!(&pair[0], Value::Text(text) if **text == *key))
            .map(|pair| &pair[1])
    }

    /// The arguments and the state of a call of this function or class.
    pub(crate) fn call(&self, name: &str) -> Option<(&[Value], &Value)> {
        let Value::Call(call) = self else { return None };
        match (&call.0, &call.1) {
            (Value::Global(global), Value::List(arguments)) if **global == *name => Some((arguments, &call.2)),
            _ => None,
        }
    }

    pub(crate) fn list(&self) -> Option<&[Value]> {
        if let Value::List(items) = self { Some(items) } else { None }
    }

    pub(crate) fn size(&self) -> Option<usize> {
        if let Value::Int(n) = self { usize::try_from(*n).ok() } else { None }
    }
}

/// Writes a pickle of protocol 3.
#[derive(Debug)]
pub(crate) struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    pub(crate) fn new() -> Self {
        Self { bytes: vec![0x80, 3] }
    }

    pub(crate) fn end(mut self) -> Vec<u8> {
        self.bytes.push(b'.');
        self.bytes
    }

    pub(crate) fn text(&mut self, text: &str) -> &mut Self {
        self.counted(b'X', text.as_bytes())
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.counted(b'B', bytes)
    }

    fn counted(&mut self, opcode: u8, bytes: &[u8]) -> &mut Self {
        self.bytes.push(opcode);
        // An image has at most 48 MiB, which fits.
        self.bytes.extend(u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_le_bytes());
        self.bytes.extend(bytes);
        self
    }

    pub(crate) fn int(&mut self, n: i32) -> &mut Self {
        self.bytes.push(b'J');
        self.bytes.extend(n.to_le_bytes());
        self
    }

    pub(crate) fn float(&mut self, n: f64) -> &mut Self {
        self.bytes.push(b'G');
        self.bytes.extend(n.to_be_bytes());
        self
    }

    pub(crate) fn bool_true(&mut self) -> &mut Self {
        self.bytes.push(0x88);
        self
    }

    fn between(&mut self, before: &[u8], content: impl FnOnce(&mut Self), after: u8) -> &mut Self {
        self.bytes.extend(before);
        content(self);
        self.bytes.push(after);
        self
    }

    pub(crate) fn tuple(&mut self, content: impl FnOnce(&mut Self)) -> &mut Self {
        self.between(b"(", content, b't')
    }

    pub(crate) fn list(&mut self, content: impl FnOnce(&mut Self)) -> &mut Self {
        self.between(b"](", content, b'e')
    }

    pub(crate) fn dict(&mut self, content: impl FnOnce(&mut Self)) -> &mut Self {
        self.between(b"}(", content, b'u')
    }

    /// A call. The server executes it.
    pub(crate) fn call(&mut self, module: &str, name: &str, arguments: impl FnOnce(&mut Self)) -> &mut Self {
        self.bytes.extend(format!("c{module}\n{name}\n").into_bytes());
        self.tuple(arguments);
        self.bytes.push(b'R');
        self
    }
}

#[cfg(test)]
mod tests {
    use robogate_testing::fuzz::{self, Draw, Target};

    use super::*;
    use crate::tests::MESSAGES;

    #[test]
    fn hostile_pickles_are_not_executed() {
        // `pickle.dumps` of an object whose __reduce__ returns (os.system, ("touch robogate-was-here",)).
        let hostile = b"\x80\x04\x95\x36\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x94\x8c\x06system\x94\x93\x94\x8c\x17touch robogate-was-here\x94\x85\x94R\x94.";
        let (value, rest) = read(hostile).unwrap();
        assert!(rest.is_empty());
        let (arguments, _) = value.call("posix.system").unwrap();
        assert!(matches!(arguments, [Value::Text(_)]));
        assert!(!std::path::Path::new("robogate-was-here").exists());
    }

    #[test]
    fn claimed_lengths_are_checked() {
        for bytes in [&b"\x80\x03X\xff\xff\xff\x7f"[..], b"\x80\x03B\xff\xff\xff\xff.", b"\x80\x03r\xff\xff\xff\x7f"] {
            assert!(read(bytes).is_err());
        }
    }

    /// The names of STACK_GLOBAL are copied, and the strings may be references.
    #[test]
    fn long_names_are_not_copied() {
        for length in [1_000_u32, 400_000] {
            let mut bytes = b"\x80\x04X".to_vec();
            bytes.extend(length.to_le_bytes());
            bytes.extend(vec![b'a'; length as usize]);
            bytes.push(0x94);
            for _ in 0..60_000 {
                bytes.extend(b"h\0h\0\x93");
            }
            bytes.push(b'.');
            let error = read(&bytes).unwrap_err();
            assert!(error.contains("At most 1024") || error.contains("too often"), "{error}");
        }
    }

    #[test]
    fn extended_references_are_charged() {
        // A list of 1,000 items is memoised, and every `h 0, N, a` copies it.
        let mut bytes = b"\x80\x04](".to_vec();
        bytes.extend([b'N'; 1_000]);
        bytes.extend(b"e\x94");
        bytes.extend(b"h\0Na".repeat(10_000));
        bytes.push(b'.');
        assert!(read(&bytes).unwrap_err().contains("too often"));
    }

    #[test]
    fn marks_are_limited() {
        let marks: Vec<u8> = [b'('].repeat(MAX_VALUES + 1);
        assert!(read(&marks).unwrap_err().contains("too many values"));
    }

    #[test]
    fn references_do_not_copy() {
        // Each tuple contains the previous one twice, so copying would create 2^59 leaves.
        let mut bytes = b"\x80\x04]\x94K\x01a".to_vec();
        bytes.extend(b"\x94");
        for i in 1..60_u8 {
            bytes.extend([b'h', i, b'h', i, 0x86, 0x94]);
        }
        bytes.push(b'.');
        assert!(read(&bytes).is_ok());
        // Deep nesting is an error.
        let deep: Vec<u8> = [b'N'].into_iter().chain([0x85; 1000]).chain([b'.']).collect();
        assert!(read(&deep).is_err());
    }

    /// A program of valid instructions with random operands, so that the machine gets further than with random bytes.
    fn program(draw: &mut Draw) -> Vec<u8> {
        let mut bytes = vec![0x80, 4];
        let mut memo = 0_usize;
        for _ in 0..draw.below(200) {
            match draw.below(16) {
                0 => bytes.extend([b'K', draw.below(256) as u8]),
                1 => {
                    let length = draw.below(40);
                    bytes.extend([0x8c, length as u8]);
                    bytes.extend(vec![b'a'; length]);
                }
                2 => {
                    let length = draw.below(2_000);
                    bytes.push(if draw.below(2) == 0 { b'X' } else { b'B' });
                    bytes.extend((length as u32).to_le_bytes());
                    bytes.extend(vec![b'b'; length]);
                }
                3 => bytes.push([b']', b'}', b')'][draw.below(3)]),
                4 => bytes.push(b'('),
                5 => bytes.push([b't', b'e', b'u'][draw.below(3)]),
                6 => bytes.push([b'a', b's', b'b', b'R', 0x81, b'Q'][draw.below(6)]),
                7 => bytes.push(0x85 + draw.below(3) as u8),
                8 => bytes.push(0x93),
                9 => bytes.extend(b"cmodule\nname\n"),
                10 | 11 => {
                    bytes.push(0x94);
                    memo += 1;
                }
                12 | 13 => bytes.extend([b'h', draw.below(memo + 1) as u8]),
                14 => bytes.push([b'N', 0x88, 0x89][draw.below(3)]),
                _ => bytes.extend([0x8a, 2, draw.below(256) as u8, draw.below(256) as u8]),
            }
        }
        bytes.push(b'.');
        bytes
    }

    #[test]
    fn fuzzed_programs_are_read_or_refused() {
        let corpus = crate::tests::corpus("pickle");
        assert!(corpus.len() >= 7);
        corpus.iter().for_each(|bytes| drop(read(bytes)));
        let counts = fuzz::run("pickle parts", MESSAGES, program, |bytes| read(bytes).is_ok());
        assert!(counts.read > 0 && counts.refused > 0, "{counts:?}");
        let valid = [b"\x80\x04](K\x01K\x02e.".to_vec()];
        Target { name: "pickle", valid: &valid, kept: &corpus, words: &[], inputs: MESSAGES }
            .run(|bytes| read(bytes).is_ok());
    }
}
