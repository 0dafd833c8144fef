//! Meshes of a task: files beside the task's file, divided into convex pieces for contacts.

use std::collections::BTreeMap;
use std::rc::Rc;

use base64ct::{Base64, Encoding};
use robogate_physics::{MOST_PIECES, Mesh, Part, Pieces, Triangles};

use super::document::{ShapeTable, Text};
use super::model::Reading;
use super::units::{Dimension, quantities};

/// The largest number of bytes and triangles of all files of a task together: every record of the task contains the files, and every
/// reader of a record divides the meshes.
pub const MOST_FILE_BYTES: usize = 2 << 20;
const MOST_TRIANGLES: usize = 50_000;

/// The largest number of pieces of a mesh, if the file states none.
const PIECES: f64 = 16.0;

/// How names of meshes end.
const ENDS: [&str; 2] = ["stl", "obj"];

/// The files beside a task's file, by their names.
pub type Files = BTreeMap<String, Vec<u8>>;

/// Finds the content of a file beside the task's file.
///
/// # Errors
/// Why it cannot be read.
pub type Find<'a> = &'a mut dyn FnMut(&str) -> Result<Vec<u8>, String>;

/// The meshes of a file that is being read.
pub(super) struct Meshes<'a> {
    find: Find<'a>,
    pub(super) files: Files,
    /// The number of triangles so far.
    triangles: usize,
    /// The pieces of each mesh, by its file, unit, scale and number of pieces.
    known: BTreeMap<(String, [u64; 3], usize), Rc<Pieces>>,
    /// What was measured for each mesh.
    pub(super) figures: Vec<String>,
}

impl<'a> Meshes<'a> {
    pub(super) fn new(find: Find<'a>) -> Self {
        Self { find, files: Files::new(), triangles: 0, known: BTreeMap::new(), figures: Vec::new() }
    }

    /// Reads a file, if it was not read yet.
    pub(super) fn file(&mut self, name: &str, ends: &[&str]) -> Result<&[u8], String> {
        if !self.files.contains_key(name) {
            check_name(name, ends)?;
            let content = (self.find)(name).map_err(|why| format!("{name}: {why}"))?;
            let size = content.len() + self.files.values().map(Vec::len).sum::<usize>();
            if size > MOST_FILE_BYTES {
                return Err(format!(
                    "{name}: the files of the task have more than {} MiB. Reduce the number of triangles in a mesh editor (`decimate`), \
                     or write a binary STL",
                    MOST_FILE_BYTES >> 20
                ));
            }
            self.files.insert(name.to_owned(), content);
        }
        Ok(&self.files[name])
    }

    /// The pieces of a mesh whose file has this unit, in metres, and this scale.
    fn pieces(&mut self, name: &str, unit_m: f64, scale: [f64; 3], most: usize) -> Result<Rc<Pieces>, String> {
        let key = (name.to_owned(), scale.map(|scale| (unit_m * scale).to_bits()), most);
        if let Some(known) = self.known.get(&key) {
            return Ok(Rc::clone(known));
        }
        let left = MOST_TRIANGLES - self.triangles;
        let mut read = Triangles::read(self.file(name, &ENDS)?, left).map_err(|why| format!("{name}: {why}"))?;
        self.triangles += read.faces.len();
        let [first, second, third] = scale;
        let even = first == second && second == third;
        if !even {
            read.vertices
                .iter_mut()
                .for_each(|point| *point = [point.x * first, point.y * second, point.z * third].into());
        }
        let unit_m = if even { unit_m * first } else { unit_m };
        let mesh = match Mesh::new(&read, unit_m) {
            // A surface that is not closed has a convex hull, too.
            Err(_) if most == 1 => read.hull().ok_or_else(|| "it has no volume".to_owned()),
            _ => Ok(read),
        };
        let mesh = mesh.and_then(|read| Mesh::new(&read, unit_m)).map_err(|why| format!("{name}: {why}"))?;
        let pieces = Rc::new(Pieces::of(&mesh, most).map_err(|why| format!("{name}: {why}"))?);
        let (triangles, count) = (mesh.triangles().count(), pieces.parts.len());
        self.figures.push(format!(
            "mesh {name}: {triangles} triangles, {:.4} litres; {count} convex pieces in contacts, with {:.1} % of its volume and at most \
             {:.2} mm off its surface",
            1e3 * mesh.bulk().volume_m3,
            1e2 * pieces.volume,
            1e3 * pieces.distance_m
        ));
        self.known.insert(key, Rc::clone(&pieces));
        Ok(pieces)
    }
}

/// Only a plain path within the folder is a name: the record of the task has the same names everywhere.
fn check_name(name: &str, ends: &[&str]) -> Result<(), String> {
    let shown: String = name.chars().take(80).collect();
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-. ()+".contains(&byte);
    let inside = name.split('/').all(|part| !part.is_empty() && !part.starts_with('.') && part.bytes().all(plain));
    if !inside || name.len() > 200 {
        return Err(format!(
            "`{shown}` is not a file in the folder of the task. Expected a name such as `hook.stl` or `meshes/hook.stl`, of ASCII \
             letters, digits, spaces and `_-.()+`"
        ));
    }
    let end = name.rsplit_once('.').map_or_else(String::new, |(_, end)| end.to_ascii_lowercase());
    match (ends.contains(&end.as_str()), ends) {
        (true, _) => Ok(()),
        (false, ["xml"]) => Err(format!("`{shown}` does not end with `.xml`. Expected an MJCF file")),
        (false, _) => {
            Err(format!("`{shown}` is neither STL nor OBJ. Let a mesh editor or a CAD program write one of them"))
        }
    }
}

impl Reading<'_, '_> {
    /// The pieces of a mesh in the frame of its shape.
    pub(super) fn mesh(&mut self, shape: &ShapeTable, name: &Text) -> Option<Vec<Part>> {
        let unit_m = match shape.unit.as_ref() {
            Some(text) => {
                let found = super::units::unit(&text.text);
                let (factor, dimension) = self.problems.take(text, found)?;
                if dimension != Dimension::LENGTH {
                    self.problems.of(text, format!("`{}` is not a unit of length. Expected m, cm or mm", text.text));
                    return None;
                }
                factor
            }
            None => 1.0,
        };
        let scale = shape.scale.as_ref().map_or([1.0; 3], |text| self.mesh_scale(text));
        let most = self.optional(shape.pieces.as_ref(), Dimension::NONE, [1.0, MOST_PIECES as f64], PIECES);
        let found = self.meshes.pieces(&name.text, unit_m, scale, most as usize);
        self.problems.take(name, found).map(|pieces| pieces.parts.clone())
    }

    fn mesh_scale(&mut self, text: &Text) -> [f64; 3] {
        let found = match text.text.contains(',') {
            true => quantities::<3>(&text.text, Dimension::NONE),
            false => quantities::<1>(&text.text, Dimension::NONE).map(|[scale]| [scale; 3]),
        };
        let scale = self.problems.take(text, found).unwrap_or([1.0; 3]);
        if !scale.iter().all(|scale| (1e-4..=1e4).contains(scale)) {
            self.problems.of(text, format!("`{}` is out of range. Expected 0.0001 to 10000", text.text));
            return [1.0; 3];
        }
        scale
    }
}

/// Files as a record contains them.
pub(super) fn recorded(files: &Files) -> BTreeMap<&str, String> {
    files.iter().map(|(name, content)| (name.as_str(), Base64::encode_string(content))).collect()
}

/// A file of a record.
///
/// # Errors
/// If the record does not contain it.
pub(super) fn of_record(files: Option<&serde_json::Value>, name: &str) -> Result<Vec<u8>, String> {
    let text = files.and_then(|files| files.get(name)?.as_str()).ok_or("the record does not contain the file")?;
    // Base64 has four characters for three bytes.
    if text.len() / 4 * 3 > MOST_FILE_BYTES + 3 {
        return Err(format!("it has more than {} MiB", MOST_FILE_BYTES >> 20));
    }
    Base64::decode_vec(text).map_err(|_| "the record does not contain it as Base64".to_owned())
}
