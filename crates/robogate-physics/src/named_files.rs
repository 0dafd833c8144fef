//! Checks the names of files in a model: everything that the compiler opens must be in the robot's folder, because the hash
//! of a robot and its evidence contain nothing else.

use crate::robot_folder::{attributes, tags};

/// Attributes that name folders, for the files in other attributes.
const FOLDERS: [&str; 3] = ["assetdir", "meshdir", "texturedir"];
/// Attributes that name files: `file`, those of the six sides of a texture, and that of a URDF.
const FILES: [&str; 8] = ["file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback", "filename"];

/// The names of files in an MJCF or URDF text. Empty for other content.
pub(crate) fn names(content: &[u8]) -> Vec<String> {
    let text = content.strip_prefix(b"\xef\xbb\xbf").unwrap_or(content).trim_ascii_start();
    if !text.starts_with(b"<") {
        return Vec::new();
    }
    let of_files = |(name, value): (String, String)| FILES.contains(&&*name).then_some(value);
    tags(text).flat_map(attributes).filter_map(of_files).collect()
}

/// Checks the names in an MJCF or URDF text.
///
/// # Errors
/// With the first name that leads out of the folder.
pub(crate) fn check(text: &[u8]) -> Result<(), String> {
    let mut folders: Vec<String> = Vec::new();
    let mut files: Vec<(bool, String)> = Vec::new();
    for tag in tags(text) {
        let includes = tag.starts_with(b"include");
        for (name, value) in attributes(tag) {
            if FOLDERS.contains(&&*name) {
                folders.push(value);
            } else if FILES.contains(&&*name) {
                files.push((includes, value));
            }
        }
    }
    for folder in &folders {
        inside(folder, 0).ok_or_else(|| outside(folder))?;
    }
    // The parts of a model may have several folders. The shallowest one allows the fewest steps upwards.
    let deep = folders.iter().filter_map(|folder| inside(folder, 0)).min().unwrap_or_default();
    for (includes, file) in &files {
        // An address of a package is looked for in the folder only.
        if file.starts_with("package://") || file.starts_with("file://") || file.starts_with("model://") {
            continue;
        }
        inside(file, if *includes { 0 } else { deep }).ok_or_else(|| outside(file))?;
    }
    Ok(())
}

/// How deep a path ends, if it starts so many folders deep and leads out of the root nowhere. `None` for others, and for
/// absolute paths.
fn inside(path: &str, start: usize) -> Option<usize> {
    let path = path.trim().replace('\\', "/");
    if path.starts_with('/') || path.as_bytes().get(1) == Some(&b':') {
        return None;
    }
    path.split('/').try_fold(start, |depth, part| match part {
        "" | "." => Some(depth),
        ".." => depth.checked_sub(1),
        _ => Some(depth + 1),
    })
}

fn outside(name: &str) -> String {
    format!(
        "it uses {name}, which is not in the robot's folder. The hash of the robot would not contain it: copy it into the \
         folder, and name it relative to the model"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_in_the_folder_are_accepted() {
        for text in [
            "<mujoco><include file=\"parts/a.xml\"/></mujoco>",
            "<mujoco><compiler meshdir='meshes'/><asset><mesh file='../shapes/a.stl'/></asset></mujoco>",
            "<robot><mesh filename=\"package://arm/meshes/a.stl\"/></robot>",
            "<mujoco><!-- <include file=\"/etc/passwd\"/> --><include file='./a/../b.xml'/></mujoco>",
        ] {
            assert_eq!(check(text.as_bytes()), Ok(()), "{text}");
        }
    }

    #[test]
    fn files_outside_are_refused() {
        for text in [
            "<mujoco><include file=\"../x.xml\"/></mujoco>",
            "<mujoco><include file='/etc/x.xml'></include></mujoco>",
            "<mujoco><include file = 'C:\\x.xml'/></mujoco>",
            "<mujoco><compiler meshdir=\"../meshes\"/></mujoco>",
            "<mujoco><compiler meshdir='meshes'/><include file='../x.xml'/></mujoco>",
            "<mujoco><compiler assetdir='/usr/share'/></mujoco>",
            "<mujoco><compiler meshdir='meshes'/><asset><mesh file='../../a.stl'/></asset></mujoco>",
            "<mujoco><asset><texture type='cube' fileup='../sky.png'/><hfield file='a/../../b.png'/></asset></mujoco>",
            "<robot><mesh filename='/tmp/a.stl'/></robot>",
        ] {
            assert!(check(text.as_bytes()).is_err_and(|why| why.contains("not in the robot's folder")), "{text}");
        }
    }
}
