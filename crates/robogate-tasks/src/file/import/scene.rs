//! Scenes of MuJoCo: what a cell does not need is removed.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Isometry3;

use super::{Imported, Wishes};
use crate::file::meshes::Find;
use crate::file::mjcf::xml::{Element, folder_of, joined};
use crate::file::mjcf::{place_of, plain, state_contacts};

/// A body with at least this many joints one after another is a robot.
const JOINTS_OF_A_ROBOT: usize = 4;

/// What refers to bodies, joints or tendons that are gone is removed with them.
const REFERS: [&str; 12] = [
    "joint",
    "joint1",
    "joint2",
    "body",
    "body1",
    "body2",
    "site",
    "site1",
    "site2",
    "geom",
    "tendon",
    "jointinparent",
];

/// Attributes that a task cannot have, with their value without an effect.
const REMOVED: [(&str, &str, &str); 3] = [
    ("joint", "armature", "rotor inertia of joints (`armature`)"),
    ("joint", "springdamper", "springdamper"),
    ("body", "gravcomp", "gravcomp"),
];

/// Adds the scene to the files of a task under this name. Returns its pose in the frame of the robot that was in it.
pub(super) fn add(
    imported: &mut Imported,
    mut root: Element,
    path: &str,
    name: &str,
    wishes: &Wishes,
    find: Find<'_>,
) -> Result<Option<Isometry3<f64>>, String> {
    let mut notes = BTreeSet::new();
    let place = remove_bodies(&mut root, wishes, &mut notes);
    remove_references(&mut root, &mut notes);
    root.children.retain(|child| {
        let kept = !matches!(
            child.name.as_str(),
            "option" | "size" | "statistic" | "visual" | "custom" | "sensor" | "keyframe" | "extension"
        );
        let empty = child.children.is_empty() && child.attributes.is_empty();
        if !kept && !empty {
            notes.insert(format!("<{}>", child.name));
        }
        kept
    });
    state_contacts(&mut root);
    let colors = colors(&root);
    strip(&mut root, &colors, &mut notes);
    add_meshes(imported, &mut root, path, find)?;
    root.children
        .retain(|child| !child.children.is_empty() || child.name == "compiler" && !child.attributes.is_empty());
    imported.files.insert(name.to_owned(), root.write().into_bytes());
    imported.left_out.extend(notes.into_iter().map(|note| format!("{path}: {note}")));
    Ok(place)
}

/// Removes robots, bodies that only mark a place, and those that the user names.
fn remove_bodies(root: &mut Element, wishes: &Wishes, notes: &mut BTreeSet<String>) -> Option<Isometry3<f64>> {
    let driven: BTreeSet<String> = root
        .all("actuator")
        .flat_map(|actuators| &actuators.children)
        .filter_map(|actuator| actuator.get("joint").map(str::to_owned))
        .collect();
    let mut robot = None;
    let whole = root.clone();
    for world in root.children.iter_mut().filter(|child| child.name == "worldbody") {
        world.children.retain(|body| {
            if body.name != "body" {
                return true;
            }
            let name = body.get("name").unwrap_or("without a name").to_owned();
            if body.get("mocap") == Some("true") {
                notes.insert(format!("body `{name}`, a marker (mocap)"));
                return false;
            }
            let mut joints = Vec::new();
            body.visit(&mut |element| joints.extend((element.name == "joint").then(|| element.get("name")).flatten()));
            let is_robot = depth(body) >= JOINTS_OF_A_ROBOT
                || joints.len() > 1 && joints.iter().all(|joint| driven.contains(*joint));
            if is_robot {
                notes.insert(format!(
                    "robot: body `{name}` with {} joints. RoboGate's own robot is in its place",
                    joints.len()
                ));
                robot.get_or_insert_with(|| place_of(&whole, body).inverse());
            }
            !is_robot
        });
        drop_named(world, &wishes.drop, notes);
    }
    robot
}

fn drop_named(element: &mut Element, names: &[String], notes: &mut BTreeSet<String>) {
    element.children.retain(|child| {
        let named = matches!(child.name.as_str(), "body" | "geom")
            && child
                .get("name")
                .is_some_and(|name| names.iter().any(|dropped| dropped == name || *dropped == plain(name)));
        if named {
            notes.insert(format!("{} `{}`, as requested", child.name, child.get("name").unwrap_or_default()));
        }
        !named
    });
    element.children.iter_mut().for_each(|child| drop_named(child, names, notes));
}

/// The largest number of joints one after another.
fn depth(body: &Element) -> usize {
    let own = body.children.iter().filter(|child| child.name == "joint").count().min(1);
    own + body.all("body").map(depth).max().unwrap_or(0)
}

/// Removes actuators, tendons, equalities and contacts that name something that is gone.
fn remove_references(root: &mut Element, notes: &mut BTreeSet<String>) {
    let mut names = BTreeSet::new();
    for world in root.all("worldbody") {
        world.visit(&mut |element| names.extend(element.get("name").map(str::to_owned)));
    }
    for _ in 0..2 {
        for tendons in root.all("tendon") {
            let gone = |tendon: &Element| refers_to_gone(tendon, &names);
            let kept: Vec<String> = tendons
                .children
                .iter()
                .filter(|of| !gone(of))
                .filter_map(|of| of.get("name"))
                .map(str::to_owned)
                .collect();
            names.extend(kept);
        }
    }
    for section in &mut root.children {
        let what = section.name.clone();
        if matches!(what.as_str(), "actuator" | "tendon" | "equality" | "contact") {
            section.children.retain(|child| {
                let gone = what == "actuator" || refers_to_gone(child, &names);
                if gone {
                    notes.insert(format!("<{what}>"));
                }
                !gone
            });
        }
    }
}

fn refers_to_gone(element: &Element, names: &BTreeSet<String>) -> bool {
    let own = element.attributes.iter().any(|(name, value)| {
        REFERS.contains(&name.as_str()) && value != "world" && !value.is_empty() && !names.contains(value)
    });
    own || element.children.iter().any(|child| refers_to_gone(child, names))
}

/// The colours of materials that have one.
fn colors(root: &Element) -> BTreeMap<String, String> {
    let materials = root.all("asset").flat_map(|assets| assets.all("material"));
    materials.filter_map(|of| Some((of.get("name")?.to_owned(), of.get("rgba")?.to_owned()))).collect()
}

/// Removes pictures: cameras, lights, textures, geoms that only show, and attributes that a task cannot have.
fn strip(element: &mut Element, colors: &BTreeMap<String, String>, notes: &mut BTreeSet<String>) {
    for (of, attribute, what) in REMOVED {
        if element.name == of && element.get(attribute).is_some_and(|value| value.parse() != Ok(0.0)) {
            notes.insert(what.to_owned());
            element.attributes.retain(|(name, _)| name != attribute);
        }
    }
    // What can be seen gives the colour of the shapes beside it.
    let shown = element.children.iter().filter(|child| child.name == "geom" && is_visual(child));
    let color = shown.filter_map(|geom| geom.get("rgba").or_else(|| colors.get(geom.get("material")?).map(|of| &**of)));
    let color = color.map(str::to_owned).next();
    element.children.retain(|child| {
        let picture = match child.name.as_str() {
            "camera" | "light" | "texture" => true,
            "geom" => is_visual(child),
            _ => false,
        };
        if picture {
            let what = if child.name == "geom" {
                "shapes that nothing touches".to_owned()
            } else {
                format!("<{}>", child.name)
            };
            notes.insert(what);
        }
        !picture
    });
    for geom in element.children.iter_mut().filter(|child| child.name == "geom") {
        let own = geom.get("material").and_then(|name| colors.get(name)).cloned();
        geom.attributes.retain(|(name, _)| name != "material");
        if let Some(color) = color.as_ref().or(own.as_ref()) {
            geom.set("rgba", color);
        }
    }
    element.children.retain(|child| child.name != "material");
    element.children.iter_mut().for_each(|child| strip(child, colors, notes));
}

/// Whether a geom states itself that nothing touches it.
fn is_visual(geom: &Element) -> bool {
    geom.get("contype") == Some("0") && geom.get("conaffinity") == Some("0")
}

/// Adds the files of the meshes that geoms use, and removes the other meshes.
fn add_meshes(imported: &mut Imported, root: &mut Element, path: &str, find: Find<'_>) -> Result<(), String> {
    let folder = |name: &str| root.all("compiler").filter_map(|of| of.get(name)).last().map(str::to_owned);
    let folder = joined(folder_of(path), &folder("meshdir").or_else(|| folder("assetdir")).unwrap_or_default());
    let mut used = BTreeSet::new();
    root.visit(&mut |element| {
        if element.name == "geom" {
            used.extend(element.get("mesh").map(str::to_owned));
        }
    });
    for asset in root.children.iter_mut().filter(|child| child.name == "asset") {
        asset.children.retain(|mesh| {
            let stem = mesh.get("file").and_then(|file| file.rsplit('/').next()).and_then(|file| file.rsplit_once('.'));
            mesh.name != "mesh"
                || mesh.get("name").or(stem.map(|(stem, _)| stem)).is_some_and(|name| used.contains(name))
        });
        for mesh in asset.children.iter_mut().filter(|child| child.name == "mesh") {
            let Some(file) = mesh.get("file").map(str::to_owned) else { continue };
            let content = find(&joined(&folder, &file)).map_err(|why| format!("{path}: mesh {file}: {why}"))?;
            let stem = file.rsplit('/').next().unwrap_or(&file).to_owned();
            let (stem, end) = stem.rsplit_once('.').unwrap_or((&stem, ""));
            if mesh.get("name").is_none() {
                mesh.set("name", stem);
            }
            let mut name = format!("meshes/{}.{}", plain(stem), end.to_ascii_lowercase());
            let mut count = 1;
            while imported.files.get(&name).is_some_and(|known| *known != content) {
                count += 1;
                name = format!("meshes/{}_{count}.{}", plain(stem), end.to_ascii_lowercase());
            }
            mesh.set("file", &name);
            imported.files.insert(name, content);
        }
    }
    for compiler in root.children.iter_mut().filter(|child| child.name == "compiler") {
        compiler.attributes.retain(|(name, _)| {
            ["angle", "eulerseq", "autolimits", "inertiafromgeom", "coordinate", "settotalmass"]
                .contains(&name.as_str())
        });
    }
    Ok(())
}
