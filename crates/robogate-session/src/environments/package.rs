//! The Python package that serves environments. It is part of the command, so that both have the same version.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// One embedded file: its path in the package, and its content.
macro_rules! embedded {
    ($path:literal) => {
        ($path, include_str!(concat!("../../../../python/src/", $path)))
    };
}

/// The files of the packages `robogate_eval`, `robogate_bridge` and `robogate_worlds` that a server needs, by their paths.
const PACKAGE: &[(&str, &str)] = &[
    embedded!("robogate_eval/__init__.py"),
    embedded!("robogate_eval/_command.py"),
    embedded!("robogate_eval/environments/__init__.py"),
    embedded!("robogate_eval/environments/__main__.py"),
    embedded!("robogate_eval/environments/dm_control.py"),
    embedded!("robogate_eval/environments/family.py"),
    embedded!("robogate_eval/environments/fetch.py"),
    embedded!("robogate_eval/environments/libero.py"),
    embedded!("robogate_eval/environments/metaworld.py"),
    embedded!("robogate_eval/environments/robosuite.py"),
    embedded!("robogate_eval/environments/robosuite_world.py"),
    embedded!("robogate_eval/environments/warp.py"),
    embedded!("robogate_eval/lerobot/__init__.py"),
    embedded!("robogate_eval/lerobot/policy.py"),
    embedded!("robogate_eval/lerobot/world.py"),
    embedded!("robogate_eval/libero/__init__.py"),
    embedded!("robogate_eval/libero/bddl.py"),
    embedded!("robogate_eval/libero/controller.py"),
    embedded!("robogate_eval/libero/initial_states.py"),
    embedded!("robogate_eval/libero/installation.py"),
    embedded!("robogate_eval/libero/knobs.py"),
    embedded!("robogate_eval/libero/plans.py"),
    embedded!("robogate_eval/libero/scoring.py"),
    embedded!("robogate_eval/libero/suites.py"),
    embedded!("robogate_eval/libero/world.py"),
    embedded!("robogate_eval/policies.py"),
    embedded!("robogate_eval/scripted/__init__.py"),
    embedded!("robogate_eval/scripted/clearance.py"),
    embedded!("robogate_eval/scripted/grasp.py"),
    embedded!("robogate_eval/scripted/motion.py"),
    embedded!("robogate_eval/scripted/scene.py"),
    embedded!("robogate_eval/scripted/skills.py"),
    embedded!("robogate_eval/serving/__init__.py"),
    embedded!("robogate_eval/serving/adapter.py"),
    embedded!("robogate_eval/serving/cameras.py"),
    embedded!("robogate_eval/serving/declaration.py"),
    embedded!("robogate_eval/serving/default_space.py"),
    embedded!("robogate_eval/serving/disturbances.py"),
    embedded!("robogate_eval/serving/environment.py"),
    embedded!("robogate_eval/serving/foreign.py"),
    embedded!("robogate_eval/serving/friction.py"),
    embedded!("robogate_eval/serving/hints.py"),
    embedded!("robogate_eval/serving/image_changes.py"),
    embedded!("robogate_eval/serving/imported.py"),
    embedded!("robogate_eval/serving/knobs.py"),
    embedded!("robogate_eval/serving/layers.py"),
    embedded!("robogate_eval/serving/model.py"),
    embedded!("robogate_eval/serving/motion.py"),
    embedded!("robogate_eval/serving/mujoco_knobs.py"),
    embedded!("robogate_eval/serving/offer.py"),
    embedded!("robogate_eval/serving/process.py"),
    embedded!("robogate_eval/serving/opened.py"),
    embedded!("robogate_eval/serving/probe.py"),
    embedded!("robogate_eval/serving/rendering.py"),
    embedded!("robogate_eval/serving/sandbox.py"),
    embedded!("robogate_eval/serving/scoring.py"),
    embedded!("robogate_eval/serving/spaces.py"),
    embedded!("robogate_eval/serving/starting.py"),
    embedded!("robogate_eval/serving/timing.py"),
    embedded!("robogate_eval/serving/trajectory.py"),
    embedded!("robogate_eval/serving/view_knobs.py"),
    embedded!("robogate_eval/serving/watch.py"),
    embedded!("robogate_eval/stable_baselines.py"),
    embedded!("robogate_bridge/__init__.py"),
    embedded!("robogate_bridge/cell.py"),
    embedded!("robogate_bridge/client.py"),
    embedded!("robogate_bridge/codec.py"),
    embedded!("robogate_bridge/declaration.py"),
    embedded!("robogate_bridge/errors.py"),
    embedded!("robogate_bridge/identity.py"),
    embedded!("robogate_bridge/server.py"),
    embedded!("robogate_bridge/servo.py"),
    embedded!("robogate_bridge/shape.py"),
    embedded!("robogate_worlds/__init__.py"),
    embedded!("robogate_worlds/__main__.py"),
    embedded!("robogate_worlds/group.py"),
    embedded!("robogate_worlds/kernels.py"),
    embedded!("robogate_worlds/tables.py"),
];

/// Writes the package below `cache`, unless it is there, and returns the folder to put on `PYTHONPATH`.
pub(crate) fn unpack(cache: &Path) -> io::Result<PathBuf> {
    let folder = cache.join(format!("python-{}-{:016x}", env!("CARGO_PKG_VERSION"), fingerprint()));
    if folder.is_dir() {
        return Ok(folder);
    }
    // Several processes may do this at once. The first that renames its copy wins.
    let own = cache.join(format!("python-{}.part", std::process::id()));
    for (path, text) in PACKAGE {
        let file = own.join(path);
        fs::create_dir_all(file.parent().unwrap_or(&own))?;
        fs::write(file, text)?;
    }
    match fs::rename(&own, &folder) {
        Err(_) if folder.is_dir() => fs::remove_dir_all(&own)?,
        other => other?,
    }
    Ok(folder)
}

/// FNV-1a hash of all files. It only tells builds apart.
fn fingerprint() -> u64 {
    let bytes = PACKAGE.iter().flat_map(|(path, text)| path.bytes().chain(text.bytes()));
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The Python files of a folder, relative to `root`.
    fn files(root: &Path, folder: &str, found: &mut Vec<String>) {
        for entry in fs::read_dir(root.join(folder)).unwrap() {
            let entry = entry.unwrap();
            let path = format!("{folder}/{}", entry.file_name().to_string_lossy());
            if entry.file_type().unwrap().is_dir() && !path.ends_with("__pycache__") {
                files(root, &path, found);
            } else if path.ends_with(".py") {
                found.push(path);
            }
        }
    }

    #[test]
    fn package_is_complete() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut found = Vec::new();
        for folder in ["environments", "lerobot", "libero", "scripted", "serving"] {
            files(&root.join("python/src"), &format!("robogate_eval/{folder}"), &mut found);
        }
        files(&root.join("python/src"), "robogate_bridge", &mut found);
        let missing: Vec<_> = found.iter().filter(|path| PACKAGE.iter().all(|(known, _)| known != path)).collect();
        assert!(missing.is_empty(), "not embedded: {missing:?}");
    }

    #[test]
    fn bundled_families_are_those_of_the_package() {
        let file =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python/src/robogate_eval/environments/__init__.py");
        let text = fs::read_to_string(file).unwrap();
        let line = text.lines().find(|line| line.starts_with("FAMILIES = ")).unwrap();
        let names: Vec<&str> = line.split('"').skip(1).step_by(2).collect();
        assert_eq!(names, crate::environments::BUNDLED);
    }

    #[test]
    fn unpacking_twice_gives_one_folder() {
        let cache = tempfile::tempdir().unwrap();
        let first = unpack(cache.path()).unwrap();
        assert_eq!(unpack(cache.path()).unwrap(), first);
        assert!(first.join("robogate_eval/environments/__main__.py").is_file());
    }
}
