//! Replaces the includes of an MJCF by the elements of the included files, as MuJoCo does. The name of a file's root element
//! does not matter, and names of files are relative to the folder of the model.

use std::path::Path;

use crate::{RobotError, robot_folder};

/// Most includes of a model, and longest text with all of them, in bytes. Models of robots have a handful of files.
const MOST_INCLUDES: usize = 1_000;
const LONGEST: usize = 64 << 20;

/// The text of a model in this folder with its includes replaced. An include without a readable file stays, so that the
/// reader of the model reports it.
///
/// # Errors
/// If a file is included twice, which MuJoCo rejects too, has no root element, or is not UTF-8; if there are too many includes, or too
/// much text.
pub(crate) fn replaced(text: &str, folder: &Path) -> Result<String, String> {
    replaced_once(text, folder, &mut Vec::new())
}

/// As [`replaced`]. `seen` are the files that were included before.
fn replaced_once(text: &str, folder: &Path, seen: &mut Vec<String>) -> Result<String, String> {
    let (mut out, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(start) = rest.find('<') {
        out.push_str(&rest[..start]);
        rest = &rest[start..];
        let end = if rest.starts_with("<!--") {
            rest.find("-->").map_or(rest.len(), |end| end + 3)
        } else {
            rest.find('>').map_or(rest.len(), |end| end + 1)
        };
        let (tag, after) = rest.split_at(end);
        rest = after;
        let found = match included(tag).map(|file| (file, robot_folder::text(&folder.join(file)))) {
            Some((file, Ok(content))) => Some((file, content)),
            Some((_, Err(error @ RobotError::Encoding { .. }))) => return Err(error.to_string()),
            _ => None,
        };
        match found {
            Some((file, _)) if seen.iter().any(|known| known == file) => {
                return Err(format!("{file} is included twice. Include each file once"));
            }
            Some(_) if seen.len() == MOST_INCLUDES => return Err(format!("it has more than {MOST_INCLUDES} includes")),
            Some((file, content)) => {
                let elements =
                    elements(&content).ok_or_else(|| format!("{file}: not an XML file with a root element"))?;
                seen.push(file.to_owned());
                out.push_str(&replaced_once(elements, folder, seen)?);
                if !tag.ends_with("/>") {
                    rest = rest.trim_start().strip_prefix("</include>").unwrap_or(rest);
                }
                if out.len() > LONGEST {
                    return Err(format!("it has more than {} MiB with its includes", LONGEST >> 20));
                }
            }
            None => out.push_str(tag),
        }
    }
    out.push_str(rest);
    Ok(out)
}

/// The file that a tag includes.
fn included(tag: &str) -> Option<&str> {
    let attributes = tag.strip_prefix("<include").filter(|rest| rest.starts_with(|c: char| c.is_ascii_whitespace()))?;
    let value = attributes.split("file").nth(1)?.trim_start().strip_prefix('=')?.trim_start();
    let quote = value.chars().next().filter(|quote| "\"'".contains(*quote))?;
    value[1..].split(quote).next()
}

/// The text between the tags of the root element.
fn elements(text: &str) -> Option<&str> {
    let mut rest = text;
    loop {
        rest = &rest[rest.find('<')?..];
        let end = match rest {
            _ if rest.starts_with("<!--") => rest.find("-->")? + 3,
            _ if rest.starts_with("<?") => rest.find("?>")? + 2,
            _ => break,
        };
        rest = &rest[end..];
    }
    let open = rest.find('>')?;
    if rest[..open].ends_with('/') {
        return Some("");
    }
    let close = rest.rfind("</")?;
    rest.get(open + 1..close)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn includes_are_replaced() {
        let folder = std::env::temp_dir().join(format!("robogate-includes-{}", std::process::id()));
        fs::create_dir_all(folder.join("parts")).unwrap();
        fs::write(
            folder.join("parts/a.xml"),
            "<?xml version='1.0'?>\n<mujocoinclude><b/><include file='c.xml'/></mujocoinclude>",
        )
        .unwrap();
        fs::write(folder.join("c.xml"), "<!-- <x> --><mujoco model=\"c\"><c/></mujoco>").unwrap();
        fs::write(folder.join("round.xml"), "<mujoco><include file=\"round.xml\"/></mujoco>").unwrap();
        let of = |text: &str| replaced(text, &folder);
        let found = of("<mujoco><!-- <include file=\"c.xml\"/> --><include file=\"parts/a.xml\"/></mujoco>");
        assert_eq!(found.unwrap(), "<mujoco><!-- <include file=\"c.xml\"/> --><b/><c/></mujoco>");
        assert_eq!(of("<m><include file=\"c.xml\"></include></m>").unwrap(), "<m><c/></m>");
        for same in ["<m><include file=\"missing.xml\"/></m>", "<m><includes file=\"c.xml\"/>", "no model", "<m a='"] {
            assert_eq!(of(same).unwrap(), same);
        }
        assert!(of("<include file=\"round.xml\"/>").unwrap_err().contains("twice"));
        // A file that is included under another spelling of its name counts as another file. A device is not read.
        let spellings =
            |n: usize| (1..=n).map(|i| format!("<include file=\"{}c.xml\"/>", "./".repeat(i))).collect::<String>();
        assert_eq!(of(&spellings(3)).unwrap(), "<c/><c/><c/>");
        assert!(of(&spellings(1_001)).unwrap_err().contains("more than 1000 includes"));
        fs::write(folder.join("long.xml"), format!("<m>{}</m>", " ".repeat(9 << 20))).unwrap();
        assert!(of(&spellings(8).replace("c.xml", "long.xml")).unwrap_err().contains("more than 64 MiB"));
        assert_eq!(of("<include file=\"/dev/zero\"/>").unwrap(), "<include file=\"/dev/zero\"/>");
        fs::write(folder.join("latin.xml"), b"<m><body name=\"\xe4\"/></m>").unwrap();
        assert!(of("<include file=\"latin.xml\"/>").unwrap_err().contains("latin.xml: not UTF-8"));
        fs::remove_dir_all(&folder).unwrap();
    }
}
