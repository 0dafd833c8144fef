//! Finds the mesh files of a URDF: `package://` addresses and relative paths.
//!
//! MuJoCo drops the folders of mesh files in a URDF. This module replaces each address whose file is in the robot's folder
//! by the full path. A package may be the robot's folder itself, a folder below it, or a path whose end exists there: for
//! `package://arm_description/meshes/visual/link1.stl` it tries `arm_description/meshes/visual/link1.stl`,
//! `meshes/visual/link1.stl`, `visual/link1.stl` and `link1.stl`. Files outside of the robot's folder are not used, because
//! the robot's hash does not contain them.

use std::path::{Path, PathBuf};

/// The text of a URDF with full paths of mesh files, for MuJoCo. `None` if it refers to no file in the folder.
pub(crate) fn with_full_paths(text: &str, folder: &Path) -> Option<String> {
    let text = without_comments(text);
    let folder = folder.canonicalize().ok()?;
    // Meshes may also lie in the folder that an element <mujoco><compiler meshdir=".."/></mujoco> names.
    let mesh_folder = tags(&text, "compiler").find_map(|tag| attribute(tag, "meshdir")).map(|name| folder.join(name));
    let mut out = String::with_capacity(text.len());
    let (mut rest, mut found) = (text.as_str(), false);
    while let Some(at) = rest.find("filename=") {
        let (before, value) = rest.split_at(at + "filename=".len());
        out.push_str(before);
        let quote = value.chars().next().filter(|quote| "\"'".contains(*quote))?;
        let (address, after) = value[1..].split_once(quote)?;
        out.push(quote);
        match file_of(address, &folder).or_else(|| file_of(address, mesh_folder.as_deref()?)) {
            Some(file) => {
                found = true;
                out.push_str(&escaped(&file.to_string_lossy()));
            }
            None => out.push_str(address),
        }
        out.push(quote);
        rest = after;
    }
    out.push_str(rest);
    found.then(|| keeping_paths(&out)).flatten()
}

/// The pairs of links that the elements `<exclude>` of a URDF's `<mujoco>` element exclude from contact. MuJoCo ignores them.
pub(crate) fn excluded(text: &str) -> Vec<[String; 2]> {
    let text = without_comments(text);
    let pair = |tag: &str| Some([attribute(tag, "body1")?.to_owned(), attribute(tag, "body2")?.to_owned()]);
    tags(&text, "exclude").filter_map(pair).collect()
}

/// Tells MuJoCo's compiler to keep the folders of mesh files, in the first `<mujoco>` element, which is the only one that it reads.
fn keeping_paths(text: &str) -> Option<String> {
    const KEEP: &str = " strippath=\"false\"";
    let start = |name: &str| tags(text, name).next().map(|tag| tag.as_ptr() as usize - text.as_ptr() as usize);
    let mut out = text.to_owned();
    if let Some(compiler) = start("compiler") {
        let tag = tags(text, "compiler").next()?;
        if let Some(value) = attribute(tag, "strippath") {
            let at = value.as_ptr() as usize - text.as_ptr() as usize;
            out.replace_range(at..at + value.len(), "false");
        } else {
            out.insert_str(compiler + "<compiler".len(), KEEP);
        }
    } else if let Some(mujoco) = start("mujoco") {
        let tag = tags(text, "mujoco").next()?;
        let element = format!("<compiler{KEEP}/>");
        match tag.strip_suffix("/>") {
            Some(open) => out.replace_range(mujoco..mujoco + tag.len(), &format!("{open}>{element}</mujoco>")),
            None => out.insert_str(mujoco + tag.len(), &element),
        }
    } else {
        let robot = out.find("<robot")?;
        let end = robot + out[robot..].find('>')? + 1;
        out.insert_str(end, &format!("<mujoco><compiler{KEEP}/></mujoco>"));
    }
    Some(out)
}

/// The start tags of the elements of this name.
fn tags<'a>(text: &'a str, name: &str) -> impl Iterator<Item = &'a str> {
    let start = format!("<{name}");
    let at: Vec<usize> = text.match_indices(&start).map(|(at, _)| at).collect();
    let ends =
        move |rest: &str| rest[start.len()..].starts_with(|next: char| next.is_whitespace() || "/>".contains(next));
    at.into_iter()
        .map(|at| &text[at..])
        .filter(move |rest| ends(rest))
        .filter_map(|rest| Some(&rest[..=rest.find('>')?]))
}

/// The value of an attribute of a start tag.
fn attribute<'a>(tag: &'a str, name: &str) -> Option<&'a str> {
    let value = tag.match_indices(name).find_map(|(at, _)| {
        let value = tag[at + name.len()..].trim_start().strip_prefix('=')?.trim_start();
        tag[..at].ends_with(char::is_whitespace).then_some(value)
    })?;
    let quote = value.chars().next().filter(|quote| "\"'".contains(*quote))?;
    value[1..].split_once(quote).map(|(value, _)| value)
}

fn without_comments(text: &str) -> String {
    let (mut out, mut rest) = (String::with_capacity(text.len()), text);
    while let Some((before, after)) = rest.split_once("<!--") {
        out.push_str(before);
        rest = after.split_once("-->").map_or("", |(_, after)| after);
    }
    out.push_str(rest);
    out
}

/// The file of an address in a folder, if it exists.
fn file_of(address: &str, folder: &Path) -> Option<PathBuf> {
    let path = address.strip_prefix("package://").or_else(|| address.strip_prefix("file://")).unwrap_or(address);
    let parts: Vec<&str> = path.split('/').filter(|part| !part.is_empty() && *part != ".").collect();
    if parts.contains(&"..") {
        return None;
    }
    (0..parts.len()).map(|from| folder.join(parts[from..].join("/"))).find(|file| file.is_file())
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;").replace('\'', "&apos;")
}
