//! Fixtures and parts from MJCF files beside a task's file.
//!
//! A fragment is translated into the tables of task.toml, so that everything else reads it as if it stood there. What a cell does
//! not simulate is refused with its line. What has no effect on physics is left out and named.

mod attributes;
mod bodies;
mod geoms;
mod known;
#[cfg(test)]
mod tests;
pub(crate) mod xml;

use std::collections::{BTreeMap, BTreeSet};

use self::attributes::{MAIN, Source};
use self::bodies::{Bodies, Translated};
use self::xml::Element;
use super::document::{Document, FixtureTable, FragmentTable, PartTable, Text};
use super::model::Reading;
use super::names::RESERVED;
use super::problem::Problems;

/// Most fragments of a task.
const MOST_FRAGMENTS: usize = 32;

/// What geoms name.
struct Assets {
    /// The folder of mesh files.
    folder: String,
    /// Each mesh with its file.
    meshes: BTreeMap<String, (Element, String)>,
    /// The colours of materials.
    materials: BTreeMap<String, [f64; 4]>,
    pieces: Option<Text>,
}

impl Reading<'_, '_> {
    /// Adds the bodies of all MJCF files to the tables of the document.
    pub(super) fn fragments(&mut self, document: &mut Document) {
        let fragments = std::mem::take(&mut document.mjcf);
        if fragments.len() > MOST_FRAGMENTS {
            let what =
                format!("the file has {} entries of `mjcf`. At most {MOST_FRAGMENTS} are accepted", fragments.len());
            self.problems.at(0, what, "");
            return;
        }
        for table in &fragments {
            let found = xml::read(&table.file.text, &mut |name| self.meshes.file(name, &["xml"]).map(<[u8]>::to_vec));
            let root = match found {
                Ok(root) => root,
                Err(wrong) if wrong.place.line == 0 => {
                    self.problems.at(table.file.at, wrong.what, wrong.hint);
                    continue;
                }
                Err(wrong) => {
                    let at = self.problems.elsewhere(&wrong.place.file, wrong.place.line);
                    self.problems.at(at, wrong.what, wrong.hint);
                    continue;
                }
            };
            let place = self.placed(table.at.as_ref(), table.rotation.as_ref()).pose();
            let translated = translate(self.problems, table, &root, place);
            self.note(&table.file.text, &translated);
            merge(document, translated);
        }
        document.mjcf = fragments;
    }

    /// Notes what was left out of a file.
    fn note(&mut self, file: &str, translated: &Translated) {
        let names = |names: Vec<&str>| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        let fixtures = translated.fixtures.iter().map(|table| table.name.text.as_str()).collect();
        let parts = translated.parts.iter().map(|table| table.name.text.as_str()).collect();
        let mut line = format!("{file}: fixtures: {}; parts: {}", names(fixtures), names(parts));
        let left_out = translated.left_out.iter().map(|(what, count)| match count {
            1 => what.clone(),
            _ => format!("{what} ({count})"),
        });
        let left_out: Vec<String> = left_out.collect();
        if !left_out.is_empty() {
            line.push_str(&format!("; left out: {}", left_out.join("; ")));
        }
        self.left_out.push(line);
    }
}

/// The tables of a file.
fn translate(
    problems: &mut Problems<'_>,
    table: &FragmentTable,
    root: &Element,
    place: nalgebra::Isometry3<f64>,
) -> Translated {
    let mut source = Source::new(root, problems);
    if root.name != "mujoco" {
        let what = format!("the root element is <{}>. Expected <mujoco>", root.name);
        let urdf = "`robogate tasks import` translates a URDF into MJCF";
        source.wrong(root, what, if root.name == "robot" { urdf } else { "" });
        return Translated::default();
    }
    check_sections(&mut source, root);
    let assets = assets(&mut source, table, root);
    let mut bodies = Bodies::new(source, &assets, table, place);
    for world in root.all("worldbody") {
        bodies.world(world);
    }
    bodies.finish(root)
}

fn check_sections(source: &mut Source<'_, '_>, root: &Element) {
    for child in &root.children {
        if let Some((_, what)) = known::ASIDE.iter().find(|(name, _)| *name == child.name) {
            source.leave_out(what);
        } else if let Some((_, hint)) = known::REFUSED.iter().find(|(name, _)| *name == child.name) {
            if let Some(first) = child.children.first() {
                source.wrong(first, format!("<{}> of <{}> is not simulated", first.name, child.name), hint);
            }
        } else if !["compiler", "default", "asset", "worldbody", "contact"].contains(&child.name.as_str()) {
            let known = ["compiler", "default", "asset", "worldbody", "contact", "actuator", "option"];
            let hint = robogate_core::hint(&child.name, known.into_iter());
            source.wrong(child, format!("unknown element <{}>: {hint}", child.name), "");
        }
    }
    for pair in root.all("contact").flat_map(|contact| contact.all("pair")) {
        source.wrong(
            pair,
            "<pair> of <contact> is not simulated",
            "every part touches the robot, free parts and fixtures",
        );
    }
}

fn assets(source: &mut Source<'_, '_>, table: &FragmentTable, root: &Element) -> Assets {
    let compiler = |name: &str| root.all("compiler").filter_map(|of| of.get(name)).last().map(str::to_owned);
    let folder = compiler("meshdir").or_else(|| compiler("assetdir")).unwrap_or_default();
    let folder = xml::joined(xml::folder_of(&table.file.text), &folder);
    let (mut meshes, mut materials) = (BTreeMap::new(), BTreeMap::new());
    for asset in root.all("asset").flat_map(|assets| &assets.children) {
        match asset.name.as_str() {
            "mesh" => {
                let file = asset.get("file").unwrap_or_default().to_owned();
                let stem = file.rsplit('/').next().and_then(|name| name.rsplit_once('.')).map(|(stem, _)| stem);
                let name = asset.get("name").or(stem).unwrap_or_default().to_owned();
                // The class of a mesh can state its scale.
                let mut asset = asset.clone();
                if let Some(scale) = source.word(&asset, MAIN, "scale") {
                    asset.set("scale", &scale);
                }
                meshes.insert(name, (asset, file));
            }
            "material" => {
                let rgba = source.numbers::<4>(asset, MAIN, "rgba").unwrap_or([1.0; 4]);
                let textured = asset.get("texture").is_some() && asset.get("rgba").is_none();
                if let Some(name) = asset.get("name").filter(|_| !textured) {
                    materials.insert(name.to_owned(), rgba);
                }
            }
            _ => {}
        }
    }
    Assets { folder, meshes, materials, pieces: table.pieces.clone() }
}

/// Adds the tables of a file to those of the document. A table of the document without shapes adds its keys to the body of its name.
fn merge(document: &mut Document, translated: Translated) {
    for mut part in translated.parts {
        match document.part.iter_mut().find(|own| own.name.text == part.name.text && own.shapes.is_empty()) {
            Some(own) => {
                let keys = std::mem::take(own);
                // A mass replaces what the file says about it.
                if keys.mass.is_some() || keys.density.is_some() {
                    (part.mass, part.density, part.centre, part.inertia) = (None, None, None, None);
                    part.shapes.iter_mut().for_each(|shape| (shape.mass, shape.density) = (None, None));
                }
                part.points.extend(keys.points);
                *own = PartTable {
                    name: keys.name,
                    mass: keys.mass.or(part.mass),
                    density: keys.density.or(part.density),
                    centre: keys.centre.or(part.centre),
                    inertia: keys.inertia.or(part.inertia),
                    friction: keys.friction.or(part.friction),
                    parent: keys.parent.or(part.parent),
                    at: keys.at.or(part.at),
                    rotation: keys.rotation.or(part.rotation),
                    spread: keys.spread,
                    spin: keys.spin,
                    start: keys.start,
                    shapes: part.shapes,
                    points: part.points,
                    joint: keys.joint.or(part.joint),
                    color: keys.color.or(part.color),
                };
            }
            None => document.part.push(part),
        }
    }
    for fixture in translated.fixtures {
        match document.fixture.iter_mut().find(|own| own.name.text == fixture.name.text && own.shapes.is_empty()) {
            Some(own) => {
                let keys = std::mem::take(own);
                *own = FixtureTable {
                    at: keys.at.clone().or(fixture.at),
                    rotation: keys.rotation.clone().or(fixture.rotation),
                    shapes: fixture.shapes,
                    friction: keys.friction.clone().or(fixture.friction),
                    color: keys.color.clone().or(fixture.color),
                    ..keys
                };
            }
            None => document.fixture.push(fixture),
        }
    }
    document.region.extend(translated.regions);
}

/// The pose of a body at the top of a file.
pub(crate) fn place_of(root: &Element, body: &Element) -> nalgebra::Isometry3<f64> {
    let mut problems = Problems::new("");
    let mut source = Source::new(root, &mut problems);
    source.pose(body, MAIN)
}

/// States the contact bits of every geom in the geom itself, in place of its class.
pub(crate) fn state_contacts(root: &mut Element) {
    fn state(source: &Source<'_, '_>, element: &mut Element, class: &str) {
        let class = element.get("childclass").unwrap_or(class).to_owned();
        if element.name == "geom" {
            for bits in ["contype", "conaffinity"] {
                if let Some(value) = source.word(element, &class, bits) {
                    element.set(bits, &value);
                }
            }
        }
        element.children.iter_mut().for_each(|child| state(source, child, &class));
    }
    let (whole, mut problems) = (root.clone(), Problems::new(""));
    let source = Source::new(&whole, &mut problems);
    root.children.iter_mut().filter(|child| child.name == "worldbody").for_each(|world| state(&source, world, MAIN));
}

/// A pose as task.toml writes it: `at` and `rotation`.
pub(crate) fn pose_texts(pose: &nalgebra::Isometry3<f64>) -> (String, String) {
    (attributes::position_text(&pose.translation.vector), attributes::rotation_text(&pose.rotation))
}

/// A name as task.toml writes it: lower-case letters, digits and `_`.
pub(crate) fn plain(name: &str) -> String {
    let letters = name.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '_' });
    let mut plain: String = letters.take(60).collect();
    if !plain.starts_with(|c: char| c.is_ascii_lowercase()) {
        plain.insert_str(0, "b_");
    }
    if RESERVED.contains(&plain.as_str()) {
        plain.push_str("_body");
    }
    plain
}

/// A name that is not taken yet.
fn unused(wanted: &str, taken: &mut BTreeSet<String>) -> String {
    let mut name = wanted.to_owned();
    let mut count = 1;
    while !taken.insert(name.clone()) {
        count += 1;
        name = format!("{wanted}_{count}");
    }
    name
}
