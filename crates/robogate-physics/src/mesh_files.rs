//! Finds the mesh files of a URDF: `package://` addresses and relative paths.
//!
//! MuJoCo drops the folders of mesh files in a URDF. This module replaces each address whose file is in the robot's folder
//! by the full path. A package may be the robot's folder itself, a folder below it, or a path whose end exists there: for
//! `package://arm_description/meshes/visual/link1.stl` it tries `arm_description/meshes/visual/link1.stl`,
//! `meshes/visual/link1.stl`, `visual/link1.stl` and `link1.stl`. Files outside of the robot's folder are not used, because
//! the robot's hash does not contain them.

use std::path::{Path, PathBuf};

/// The text of a URDF with full paths of mesh files, for MuJoCo. `None` if the text itself configures the compiler
/// (`<mujoco>`), or if it refers to no file in a folder.
pub(crate) fn with_full_paths(text: &str, folder: &Path) -> Option<String> {
    if text.contains("<mujoco") {
        return None;
    }
    let folder = folder.canonicalize().ok()?;
    let mut out = String::with_capacity(text.len());
    let (mut rest, mut found) = (text, false);
    while let Some(at) = rest.find("filename=") {
        let (before, value) = rest.split_at(at + "filename=".len());
        out.push_str(before);
        let quote = value.chars().next().filter(|quote| "\"'".contains(*quote))?;
        let (address, after) = value[1..].split_once(quote)?;
        out.push(quote);
        match file_of(address, &folder) {
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
    // Without this setting MuJoCo drops the folders again.
    let robot = out.find("<robot")?;
    let end = robot + out[robot..].find('>')? + 1;
    out.insert_str(end, "<mujoco><compiler strippath=\"false\"/></mujoco>");
    found.then_some(out)
}

/// The file of an address in the robot's folder, if it exists.
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
