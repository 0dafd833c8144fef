//! XML files as elements with their lines. Files of strangers: size, number and depth of elements are limited, and there are no
//! entities.

use std::fmt::Write;
use std::rc::Rc;

use robogate_core::guard::guarded;
use roxmltree::{Document, Node, ParsingOptions};

use crate::file::meshes::Find;

/// The largest number of nodes of a file, the deepest nesting of elements, and the largest number of files that one file includes.
const MOST_NODES: u32 = 100_000;
const DEEPEST: usize = 64;
const MOST_INCLUDES: usize = 64;

/// An element of an XML file.
#[derive(Debug, Clone, Default)]
pub(crate) struct Element {
    /// Its name.
    pub(crate) name: String,
    /// Names and values of its attributes.
    pub(crate) attributes: Vec<(String, String)>,
    /// The elements in it.
    pub(crate) children: Vec<Element>,
    /// The file that it is in, and its line, from 1.
    pub(crate) place: Place,
}

/// A line of a file.
#[derive(Debug, Clone, Default)]
pub(crate) struct Place {
    /// The name of the file.
    pub(crate) file: Rc<str>,
    /// The line, from 1.
    pub(crate) line: usize,
}

/// What is wrong with a file, and where.
#[derive(Debug, Clone)]
pub(crate) struct Wrong {
    /// Where.
    pub(crate) place: Place,
    /// What is wrong.
    pub(crate) what: String,
    /// What to do.
    pub(crate) hint: String,
}

impl Element {
    /// A new element with these attributes.
    pub(crate) fn new(name: &str, attributes: &[(&str, &str)], place: &Place) -> Self {
        let attributes = attributes.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        Self { name: name.to_owned(), attributes, children: Vec::new(), place: place.clone() }
    }

    /// The value of an attribute.
    pub(crate) fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// Sets an attribute.
    pub(crate) fn set(&mut self, name: &str, value: &str) {
        match self.attributes.iter_mut().find(|(known, _)| known == name) {
            Some((_, old)) => value.clone_into(old),
            None => self.attributes.push((name.to_owned(), value.to_owned())),
        }
    }

    /// The elements in it with this name.
    pub(crate) fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Self> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// The first element in it with this name.
    pub(crate) fn first(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }

    /// Calls `visit` for the element and all elements in it.
    pub(crate) fn visit<'a>(&'a self, visit: &mut dyn FnMut(&'a Self)) {
        visit(self);
        self.children.iter().for_each(|child| child.visit(visit));
    }

    /// The text of the element and of all elements in it.
    pub(crate) fn write(&self) -> String {
        let mut text = String::new();
        self.write_at(&mut text, 0);
        text
    }

    fn write_at(&self, text: &mut String, depth: usize) {
        let _ = write!(text, "{:1$}<{2}", "", 2 * depth, self.name);
        for (name, value) in &self.attributes {
            let escaped = value.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
            let _ = write!(text, " {name}=\"{escaped}\"");
        }
        if self.children.is_empty() {
            text.push_str("/>\n");
            return;
        }
        text.push_str(">\n");
        self.children.iter().for_each(|child| child.write_at(text, depth + 1));
        let _ = writeln!(text, "{:1$}</{2}>", "", 2 * depth, self.name);
    }
}

/// Reads a file with the files that it includes, as MuJoCo does: their names are relative to the folder of the first file, and the
/// name of a file's root element does not matter.
///
/// # Errors
/// What is wrong with which line.
pub(crate) fn read(name: &str, find: Find<'_>) -> Result<Element, Wrong> {
    let content = find(name).map_err(|what| Wrong { place: at(name, 0), what, hint: String::new() })?;
    let root = parsed(name, &content)?;
    let mut seen = vec![name.to_owned()];
    let mut includes = Includes { folder: folder_of(name), find, seen: &mut seen };
    includes.replaced(root, 0)
}

/// The folder of a file, with its slash.
pub(crate) fn folder_of(name: &str) -> &str {
    name.rfind('/').map_or("", |slash| &name[..=slash])
}

/// A name in a folder, without `.` and with `..` resolved as far as it goes.
pub(crate) fn joined(folder: &str, name: &str) -> String {
    let whole = if name.starts_with('/') || folder.is_empty() { name.to_owned() } else { format!("{folder}/{name}") };
    let mut parts: Vec<&str> = Vec::new();
    for part in whole.split('/').filter(|part| !part.is_empty() && *part != ".") {
        match part {
            ".." if parts.last().is_some_and(|last| *last != "..") => drop(parts.pop()),
            _ => parts.push(part),
        }
    }
    format!("{}{}", if whole.starts_with('/') { "/" } else { "" }, parts.join("/"))
}

fn at(file: &str, line: usize) -> Place {
    Place { file: file.into(), line }
}

/// The root element of a file.
fn parsed(name: &str, content: &[u8]) -> Result<Element, Wrong> {
    let wrong = |line: usize, what: String| Wrong {
        place: at(name, line),
        what,
        hint: "the file must be XML in UTF-8, without a DTD".to_owned(),
    };
    let text = std::str::from_utf8(content).map_err(|_| wrong(0, "it is not text in UTF-8".to_owned()))?;
    let text = text.trim_start_matches('\u{feff}');
    // The library recurses into elements.
    if let Some(at) = too_deep(text) {
        let line = 1 + text[..at].bytes().filter(|byte| *byte == b'\n').count();
        return Err(wrong(line, format!("the elements are nested in more than {DEEPEST} levels")));
    }
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MOST_NODES };
    let document = guarded(|| Document::parse_with_options(text, options))
        .map_err(|why| wrong(0, why))?
        .map_err(|error| wrong(error.pos().row as usize, error.to_string()))?;
    let lines: Vec<usize> = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect();
    element(document.root_element(), &Rc::from(name), &lines, 0)
}

/// The first byte at which elements are nested too deeply.
fn too_deep(text: &str) -> Option<usize> {
    let bytes = text.as_bytes();
    let (mut at, mut depth) = (0, 0_usize);
    while let Some(start) = bytes[at..].iter().position(|byte| *byte == b'<').map(|offset| at + offset) {
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        if let Some((_, end)) = skipped.iter().find(|(open, _)| text[start..].starts_with(open)) {
            at = start + text[start..].find(end)? + end.len();
            continue;
        }
        // The end of the tag is outside of its quotes.
        let mut quote = None;
        let end = bytes[start..].iter().position(|byte| {
            match quote {
                Some(open) if open == *byte => quote = None,
                None if b"\"'".contains(byte) => quote = Some(*byte),
                _ => {}
            }
            quote.is_none() && *byte == b'>'
        })?;
        let tag = &bytes[start..=start + end];
        match (tag.starts_with(b"</"), tag.ends_with(b"/>")) {
            (true, _) => depth = depth.saturating_sub(1),
            (false, true) => {}
            (false, false) => depth += 1,
        }
        if depth > DEEPEST + 1 {
            return Some(start);
        }
        at = start + end + 1;
    }
    None
}

fn element(node: Node<'_, '_>, file: &Rc<str>, lines: &[usize], depth: usize) -> Result<Element, Wrong> {
    let line = 1 + lines.partition_point(|end| *end < node.range().start);
    let place = Place { file: Rc::clone(file), line };
    if depth > DEEPEST {
        let what = format!("the elements are nested in more than {DEEPEST} levels");
        return Err(Wrong { place, what, hint: String::new() });
    }
    let children = node.children().filter(Node::is_element);
    Ok(Element {
        name: node.tag_name().name().to_owned(),
        attributes: node.attributes().map(|of| (of.name().to_owned(), of.value().to_owned())).collect(),
        children: children.map(|child| element(child, file, lines, depth + 1)).collect::<Result<_, _>>()?,
        place,
    })
}

struct Includes<'a, 'b> {
    folder: &'a str,
    find: Find<'b>,
    seen: &'a mut Vec<String>,
}

impl Includes<'_, '_> {
    /// An element with the elements of included files in place of the includes.
    fn replaced(&mut self, mut of: Element, depth: usize) -> Result<Element, Wrong> {
        let wrong =
            |place: &Place, what: String, hint: &str| Wrong { place: place.clone(), what, hint: hint.to_owned() };
        if depth > DEEPEST {
            return Err(wrong(&of.place, format!("includes and elements have more than {DEEPEST} levels"), ""));
        }
        let mut children = Vec::with_capacity(of.children.len());
        for child in std::mem::take(&mut of.children) {
            if child.name != "include" {
                children.push(self.replaced(child, depth + 1)?);
                continue;
            }
            let missing = || wrong(&child.place, "<include> without `file`".to_owned(), "name a file beside this one");
            let name = joined(self.folder, child.get("file").ok_or_else(missing)?);
            if self.seen.contains(&name) {
                return Err(wrong(&child.place, format!("{name} is included twice"), "include each file once"));
            }
            if self.seen.len() > MOST_INCLUDES {
                return Err(wrong(&child.place, format!("there are more than {MOST_INCLUDES} includes"), ""));
            }
            self.seen.push(name.clone());
            let content = (self.find)(&name).map_err(|why| wrong(&child.place, format!("{name}: {why}"), ""))?;
            children.extend(self.replaced(parsed(&name, &content)?, depth + 1)?.children);
        }
        of.children = children;
        Ok(of)
    }
}
