//! Tasks from the files that other simulators read: scenes of MuJoCo, URDF, and task files of LIBERO.
//!
//! The bodies stay an MJCF file beside task.toml. What a cell does not simulate and no body needs is removed from it and named.

mod bddl;
mod libero;
mod scene;
mod urdf;
mod write;

use std::collections::BTreeMap;

pub use self::write::UNFINISHED;
use super::meshes::Find;
use super::mjcf::{plain, xml};

/// What the user says about an imported task.
#[derive(Debug, Clone, Default)]
pub struct Wishes {
    /// The name of the task.
    pub name: String,
    /// When the task is done. Without it, the file has a line that must be filled in.
    pub goal: Option<String>,
    /// The task in natural language.
    pub instruction: Option<String>,
    /// Where the origin of the scene is in the frame of the robot's base, and its rotation, as in task.toml.
    pub at: Option<String>,
    /// See `at`.
    pub rotation: Option<String>,
    /// Bodies to leave out, by their names.
    pub drop: Vec<String>,
    /// Joints that do not move.
    pub weld: Vec<String>,
    /// Whether bodies without joints move freely.
    pub free: bool,
}

/// An imported task.
#[derive(Debug, Clone, Default)]
pub struct Imported {
    /// The text of task.toml.
    pub text: String,
    /// The files beside it.
    pub files: BTreeMap<String, Vec<u8>>,
    /// What was left out, as lines.
    pub left_out: Vec<String>,
    /// What conditions can name: fixtures, parts with their joints, and regions, as lines.
    pub bodies: Vec<String>,
}

/// Imports a file by its kind: `.xml` and `.mjcf` of MuJoCo, `.urdf`, or `.bddl` of LIBERO. `find` returns the content of a file by its
/// path.
///
/// # Errors
/// Why the file cannot be imported.
pub fn import(path: &str, wishes: &Wishes, find: Find<'_>) -> Result<Imported, String> {
    let end = path.rsplit_once('.').map_or("", |(_, end)| end).to_ascii_lowercase();
    match end.as_str() {
        "bddl" => libero::import(path, wishes, find),
        "xml" | "mjcf" | "urdf" => {
            let root = xml::read(path, find).map_err(|wrong| shown(&wrong))?;
            let root = match root.name.as_str() {
                "mujoco" => root,
                "robot" => urdf::to_mjcf(&root, path, find)?,
                other => return Err(format!("{path}: the root element is <{other}>. Expected <mujoco> or <robot>")),
            };
            let mut imported = Imported::default();
            // Names of bodies without one follow from that of the file.
            let file = format!("{}.xml", plain(&wishes.name));
            let place = scene::add(&mut imported, root, path, &file, wishes, find)?;
            write::task(imported, wishes, &[write::Fragment { file, place, ..Default::default() }])
        }
        _ => Err(format!("{path}: unknown kind of file. Expected .xml or .mjcf (MuJoCo), .urdf, or .bddl (LIBERO)")),
    }
}

fn shown(wrong: &xml::Wrong) -> String {
    let line = if wrong.place.line > 0 { format!(", line {}", wrong.place.line) } else { String::new() };
    let hint = if wrong.hint.is_empty() { String::new() } else { format!("\nHint: {}", wrong.hint) };
    format!("{}{line}: {}{hint}", wrong.place.file, wrong.what)
}
