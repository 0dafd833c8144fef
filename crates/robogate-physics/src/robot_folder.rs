//! Reads the files of a robot's folder, and checks its models before MuJoCo compiles them.
//!
//! A folder of another author may contain pipes, links in a circle, or a model of a few lines that describes millions of
//! bodies. MuJoCo follows such a model until the memory is used up, which ends the process.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::io::{ErrorKind, Read};
use std::path::Path;

use crate::named_files;
use crate::robot::{RobotError, RobotFile};

/// Most files of a folder, deepest folder in it, and most bytes of all files together.
const MOST_FILES: usize = 10_000;
/// Most files of a folder that are listed, also those that are not the robot's.
const MOST_LISTED: usize = 200_000;
const DEEPEST: usize = 16;
const MOST_BYTES: u64 = 1 << 30;

/// Most elements of a model, with those that it repeats. Models of robots have about a thousand.
const MOST_ELEMENTS: u64 = 500_000;
/// Deepest element. An arm of seven joints has about 15 levels.
const DEEPEST_ELEMENT: usize = 200;
/// Most pixels of a texture, or heights of a height field.
const MOST_CELLS: u64 = 1 << 26;
/// Largest values of the attributes of `size`, for which MuJoCo reserves memory, by the ends of their names. Models of robots have a few user
/// values for each body, and none of the others.
const MOST_USER_VALUES: f64 = 1_000.0;
const MOST_RESERVED: f64 = 1e6;
const MOST_MEMORY_BYTES: f64 = (1_u64 << 30) as f64;

/// The files of a robot below its folder, with their names relative to it and their contents: `robot.toml`, the model, each file whose
/// name a model among them contains, and the licences beside `robot.toml`. Other files, such as results of runs, are not the robot's.
///
/// Names count without their folders, because the compiler looks for them in several, so this may find more files than the compiler
/// opens and never fewer.
pub(crate) fn files(folder: &Path, model: &str) -> Result<Vec<RobotFile>, RobotError> {
    let mut listed = Vec::new();
    list(folder, "", 0, &mut listed)?;
    let mut next: Vec<String> = vec!["robot.toml".to_owned()];
    let mut by_name: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for name in listed {
        match is_licence(&name) {
            true => next.push(name),
            false if name == "robot.toml" => {}
            false => by_name.entry(last(&name)).or_default().push(name),
        }
    }
    next.extend(by_name.remove(&last(model)).unwrap_or_default());
    let (mut found, mut left) = (Vec::new(), MOST_BYTES);
    while let Some(name) = next.pop() {
        let path = folder.join(&name);
        if name == "robot.toml" && !path.exists() {
            continue;
        }
        let content = content(&path, &mut left)?;
        if found.len() == MOST_FILES {
            return Err(error(folder, format!("has more than {MOST_FILES} files. Expected a robot's folder")));
        }
        for name in named_files::names(&content) {
            // A name that the text alone does not show could be any.
            if name.contains('&') {
                next.extend(std::mem::take(&mut by_name).into_values().flatten());
            }
            next.extend(by_name.remove(&last(&name)).unwrap_or_default());
        }
        found.push((name, Cow::Owned(content)));
    }
    found.sort_by(|(a, _), (b, _)| a.cmp(b));
    Ok(found)
}

/// Whether a file beside `robot.toml` has the terms on which the model may be copied, as evidence does.
fn is_licence(name: &str) -> bool {
    let lower = name.to_lowercase();
    !name.contains('/') && ["license", "licence", "copying", "notice"].iter().any(|start| lower.starts_with(start))
}

fn error(path: &Path, why: String) -> RobotError {
    RobotError::Read { path: path.to_owned(), why }
}

/// The last part of a path, in lower case: some file systems ignore the case.
fn last(path: &str) -> String {
    path.trim().rsplit(['/', '\\']).next().unwrap_or_default().to_lowercase()
}

/// Reads a regular text file of a robot: its settings, or a part of its model.
pub(crate) fn text(path: &Path) -> Result<String, RobotError> {
    const LONGEST: u64 = 16 << 20;
    let error = |why: String| error(path, why);
    let metadata = fs::metadata(path).map_err(|e| error(e.to_string()))?;
    if !metadata.is_file() || metadata.len() > LONGEST {
        return Err(error("not a text file of at most 16 MiB".to_owned()));
    }
    fs::read_to_string(path).map_err(|e| match e.kind() {
        ErrorKind::InvalidData => RobotError::Encoding { path: path.to_owned() },
        _ => error(e.to_string()),
    })
}

/// Checks the models of a robot, the files whose names end with `.xml`, `.urdf` or `.mjcf`, and the sizes of its images. All files that a
/// model names must be in the folder: the hash of the robot contains no others.
pub(crate) fn check(folder: &Path, model: &str) -> Result<(), RobotError> {
    for (name, content) in files(folder, model)? {
        let lower = name.to_ascii_lowercase();
        let is_model = [".xml", ".urdf", ".mjcf"].iter().any(|ending| lower.ends_with(ending));
        let checked = match (is_model, png_pixels(&content)) {
            (true, _) => check_model(&content).and_then(|()| named_files::check(&content)),
            (false, Some(pixels)) if pixels > MOST_CELLS => {
                Err(format!("the image has {pixels} pixels. At most {MOST_CELLS} are accepted"))
            }
            _ => Ok(()),
        };
        checked.map_err(|why| RobotError::Read { path: folder.join(&name), why })?;
    }
    Ok(())
}

/// The number of pixels of a PNG, from its header (PNG specification, 11.2.2). `None` for another file.
fn png_pixels(content: &[u8]) -> Option<u64> {
    let header = content.strip_prefix(b"\x89PNG\r\n\x1a\n")?.get(8..16)?;
    let number = |at: usize| Some(u64::from(u32::from_be_bytes(header.get(at..at + 4)?.try_into().ok()?)));
    Some(number(0)?.saturating_mul(number(4)?))
}

/// Checks the sizes that a model tells MuJoCo to reserve.
fn check_size(tag: &[u8]) -> Result<(), String> {
    for (name, value) in attributes(tag) {
        let most = match &*name {
            name if name.starts_with("nuser_") => MOST_USER_VALUES,
            "memory" => MOST_MEMORY_BYTES,
            _ => MOST_RESERVED,
        };
        let unit = |letter: char| "KMGTPE".find(letter.to_ascii_uppercase()).map(|at| 1024_f64.powi(at as i32 + 1));
        let value = value.trim();
        let factor = value.chars().last().and_then(unit);
        let number = if factor.is_some() { &value[..value.len() - 1] } else { value };
        // What is not a number is an error that MuJoCo reports.
        let number = number.trim().parse::<f64>().unwrap_or_default() * factor.unwrap_or(1.0);
        if number > most {
            return Err(format!("<size {name}=\"{value}\"/>: at most {most} is accepted"));
        }
    }
    Ok(())
}

/// The names of all files below a folder, relative to it.
fn list(folder: &Path, prefix: &str, depth: usize, names: &mut Vec<String>) -> Result<(), RobotError> {
    if depth > DEEPEST {
        return Err(error(folder, format!("nested more than {DEEPEST} folders deep. Expected a robot's folder")));
    }
    for entry in fs::read_dir(folder).map_err(|e| error(folder, e.to_string()))? {
        let entry = entry.map_err(|e| error(folder, e.to_string()))?;
        let path = entry.path();
        let name = format!("{prefix}{}", path.file_name().unwrap_or_default().to_string_lossy());
        let kind = entry.file_type().map_err(|e| error(&path, e.to_string()))?;
        // The compiler would follow a link to a folder, which could also lead in a circle.
        if kind.is_symlink() && path.is_dir() {
            return Err(error(
                &path,
                "a link to a folder. Expected only files and folders in a robot's folder".to_owned(),
            ));
        }
        if kind.is_dir() {
            list(&path, &format!("{name}/"), depth + 1, names)?;
        } else if names.len() == MOST_LISTED {
            return Err(error(folder, format!("has more than {MOST_LISTED} files. Expected a robot's folder")));
        } else {
            names.push(name);
        }
    }
    Ok(())
}

/// Reads a file of at most `left` bytes, which are then fewer.
fn content(path: &Path, left: &mut u64) -> Result<Vec<u8>, RobotError> {
    let read = |e: std::io::Error| error(path, e.to_string());
    // A link to a file counts as this file. One to a folder could lead in a circle.
    if !fs::metadata(path).map_err(read)?.is_file() {
        return Err(error(path, "not a regular file. Expected only files and folders in a robot's folder".to_owned()));
    }
    let mut content = Vec::new();
    fs::File::open(path).map_err(read)?.take(*left + 1).read_to_end(&mut content).map_err(read)?;
    let too_large = || error(path, format!("the robot's files have more than {} MiB", MOST_BYTES >> 20));
    *left = left.checked_sub(content.len() as u64).ok_or_else(too_large)?;
    Ok(content)
}

/// Checks an MJCF or URDF text: number and depth of its elements, and the sizes that attributes request.
pub(crate) fn check_model(text: &[u8]) -> Result<(), String> {
    let mut elements = 0_u64;
    // How often each open element is repeated.
    let mut open: Vec<u64> = vec![1];
    for tag in tags(text) {
        if tag.starts_with(b"!") {
            return Err("it has a document type declaration, which models do not need. Remove it".to_owned());
        }
        if tag.starts_with(b"/") {
            if open.len() > 1 {
                open.pop();
            }
            continue;
        }
        let copies = open.last().copied().unwrap_or(1);
        elements = elements.saturating_add(copies);
        let name = tag.split(|byte| byte.is_ascii_whitespace() || *byte == b'/').next().unwrap_or_default();
        let counts = |attribute: &str| numbers(tag, attribute).into_iter().fold(1_u64, u64::saturating_mul);
        let repeated = match name {
            b"replicate" | b"composite" | b"flexcomp" => counts("count"),
            _ => 1,
        };
        if name != b"replicate" {
            elements = elements.saturating_add(copies.saturating_mul(repeated - repeated.min(1)));
        }
        if elements > MOST_ELEMENTS || copies.saturating_mul(repeated) > MOST_ELEMENTS {
            return Err(format!("it describes more than {MOST_ELEMENTS} elements, with those that it repeats"));
        }
        let cells = match name {
            b"hfield" => counts("nrow").saturating_mul(counts("ncol")),
            b"texture" => counts("width").saturating_mul(counts("height")),
            _ => 0,
        };
        if name == b"size" {
            check_size(tag)?;
        }
        if cells > MOST_CELLS {
            let name = String::from_utf8_lossy(name);
            return Err(format!("a {name} has {cells} values. At most {MOST_CELLS} are accepted"));
        }
        if !tag.ends_with(b"/") {
            open.push(if name == b"replicate" { copies.saturating_mul(repeated) } else { copies });
            if open.len() > DEEPEST_ELEMENT {
                return Err(format!("its elements are nested more than {DEEPEST_ELEMENT} levels deep"));
            }
        }
    }
    Ok(())
}

/// The tags of a model without comments: openings, closings (`/`) and declarations (`!`).
pub(crate) fn tags(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = text;
    std::iter::from_fn(move || {
        loop {
            let start = rest.iter().position(|byte| *byte == b'<')?;
            rest = &rest[start..];
            let skipped = [(&b"<!--"[..], &b"-->"[..]), (b"<![CDATA[", b"]]>"), (b"<?", b"?>")];
            let Some((_, end)) = skipped.iter().find(|(start, _)| rest.starts_with(start)) else { break };
            rest = after(rest, end);
        }
        let (tag, end) = tag(rest);
        rest = end;
        Some(tag)
    })
}

/// The attributes of a tag: names and values.
pub(crate) fn attributes(tag: &[u8]) -> Vec<(String, String)> {
    let text = String::from_utf8_lossy(tag);
    let mut rest = text.trim_start_matches(|c: char| !c.is_ascii_whitespace());
    let mut found = Vec::new();
    while let Some((name, value)) = rest.split_once('=') {
        let value = value.trim_start();
        let Some(quote) = value.chars().next().filter(|c| matches!(c, '"' | '\'')) else { break };
        let Some((value, after)) = value[1..].split_once(quote) else { break };
        found.push((name.trim().to_owned(), value.to_owned()));
        rest = after;
    }
    found
}

/// The text after the first `end`.
fn after<'a>(text: &'a [u8], end: &[u8]) -> &'a [u8] {
    let at = text.windows(end.len()).position(|window| window == end);
    at.map_or(&[], |at| &text[at + end.len()..])
}

/// The content of the tag at the start of a text, and the text after it. Quoted values may contain `>`.
fn tag(text: &[u8]) -> (&[u8], &[u8]) {
    let mut quote = None;
    for (at, byte) in text.iter().enumerate().skip(1) {
        match (quote, byte) {
            (None, b'>') => return (&text[1..at], &text[at + 1..]),
            (None, b'"' | b'\'') => quote = Some(*byte),
            (Some(open), _) if open == *byte => quote = None,
            _ => {}
        }
    }
    (text.get(1..).unwrap_or_default(), &[])
}

/// The numbers in an attribute of a tag. Those that are not positive count as 1.
fn numbers(tag: &[u8], attribute: &str) -> Vec<u64> {
    let text = String::from_utf8_lossy(tag);
    let value = text.match_indices(attribute).find_map(|(at, _)| {
        let is_start = text[..at].ends_with(|c: char| c.is_ascii_whitespace());
        let value = text[at + attribute.len()..].trim_start().strip_prefix('=')?.trim_start();
        let quote = value.chars().next().filter(|c| is_start && matches!(c, '"' | '\''))?;
        value[1..].split(quote).next()
    });
    let number = |word: &str| word.parse::<f64>().map_or(1, |n| n.max(1.0) as u64);
    value.unwrap_or_default().split_whitespace().map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_of_robots_are_accepted() {
        let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/robots");
        for robot in ["franka", "ur3e", "ur5e", "ur10e"] {
            check(&here.join(robot), &format!("{robot}.xml")).unwrap();
        }
        let text =
            b"<?xml version='1.0'?><mujoco><!-- <!DOCTYPE --> <replicate count='20'><geom name='a>b'/></replicate>\
            <composite count=\"3 4 5\" type=\"particle\"/></mujoco>";
        assert_eq!(check_model(text), Ok(()));
    }

    #[test]
    fn usual_sizes_are_accepted() {
        let text = b"<mujoco><size memory=\"100M\" nuser_geom='3' njmax='500' nconmax='-1'/></mujoco>";
        assert_eq!(check_model(text), Ok(()));
    }

    #[test]
    fn pixels_are_counted_from_the_header() {
        let png = |width: u32, height: u32| {
            let start: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR";
            [start, &width.to_be_bytes(), &height.to_be_bytes(), b"\x08\x02\0\0\0"].concat()
        };
        assert_eq!(png_pixels(&png(30_000, 30_000)), Some(900_000_000));
        assert_eq!(png_pixels(&png(u32::MAX, u32::MAX)), Some(u64::from(u32::MAX).saturating_mul(u32::MAX.into())));
        assert_eq!(png_pixels(b"\x89PNG"), None);
    }

    #[test]
    fn models_with_many_elements_are_rejected() {
        let repeated = |levels: usize, count: &str| {
            let open = format!("<replicate count=\"{count}\">").repeat(levels);
            format!("<mujoco>{open}<geom/>{}</mujoco>", "</replicate>".repeat(levels))
        };
        for (text, part) in [
            (repeated(1, "100000000"), "more than 500000 elements"),
            (repeated(4, "100"), "more than 500000 elements"),
            ("<mujoco><composite type='grid' count='1000 1000 1000'/></mujoco>".to_owned(), "more than 500000"),
            ("<mujoco><size nuser_body=\"1000000000\"/></mujoco>".to_owned(), "nuser_body"),
            ("<mujoco><size nuser_jnt='2147483647'/></mujoco>".to_owned(), "at most 1000"),
            ("<mujoco><size memory='100G'/></mujoco>".to_owned(), "memory"),
            ("<mujoco><size nuserdata='1e9'/></mujoco>".to_owned(), "nuserdata"),
            ("<mujoco><flexcomp count = '1e9 1 1'/></mujoco>".to_owned(), "more than 500000 elements"),
            ("<mujoco><geom/>".to_owned() + &"<geom/>".repeat(500_000), "more than 500000 elements"),
            ("<mujoco><hfield nrow='100000' ncol='100000'/></mujoco>".to_owned(), "a hfield has 10000000000 values"),
            ("<mujoco><texture width='99999' height='99999'/></mujoco>".to_owned(), "a texture has"),
            ("<body>".repeat(100_000), "nested more than 200 levels"),
            ("<!DOCTYPE lolz [<!ENTITY lol \"lol\">]><robot/>".to_owned(), "document type declaration"),
        ] {
            let why = check_model(text.as_bytes()).unwrap_err();
            assert!(why.contains(part), "{why}");
        }
    }

    #[test]
    fn damaged_texts_are_left_to_the_parser() {
        for text in
            ["", "<", "<a", "</a></a></a>", "<a b='", "<!--", "<![CDATA[", "<a count=>", "\u{fffd}<\u{e4} count='"]
        {
            assert_eq!(check_model(text.as_bytes()), Ok(()), "{text}");
        }
    }

    #[test]
    fn results_beside_the_model_are_not_the_robot() {
        let folder = std::env::temp_dir().join(format!("robogate-used-{}", std::process::id()));
        let write = |name: &str, text: &str| {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        write("robot.toml", "");
        write("arm.xml", "<mujoco><include file='parts/hand.inc'/></mujoco>");
        write("parts/hand.inc", "<mujoco><asset><mesh file=\"Finger.STL\"/></asset></mujoco>");
        write("meshes/finger.stl", "");
        write("requirements.toml", "");
        write("LICENSE.txt", "");
        write("runs/a/gate.junit.xml", "<testsuite/>");
        let names =
            || -> Vec<String> { files(&folder, "arm.xml").unwrap().into_iter().map(|(name, _)| name).collect() };
        assert_eq!(names(), ["LICENSE.txt", "arm.xml", "meshes/finger.stl", "parts/hand.inc", "robot.toml"]);
        // The text does not show which file this is.
        write("arm.xml", "<mujoco><include file='parts/h&#97;nd.inc'/></mujoco>");
        assert_eq!(names().len(), 7);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn links_in_a_circle_are_rejected() {
        let folder = std::env::temp_dir().join(format!("robogate-circle-{}", std::process::id()));
        fs::create_dir_all(folder.join("a")).unwrap();
        for name in ["b", "c"] {
            std::os::unix::fs::symlink(&folder, folder.join("a").join(name)).unwrap();
        }
        let why = files(&folder, "arm.xml").unwrap_err().to_string();
        fs::remove_dir_all(&folder).unwrap();
        assert!(why.contains("a link to a folder"), "{why}");
    }
}
