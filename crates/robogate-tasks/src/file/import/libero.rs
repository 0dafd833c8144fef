//! Tasks of LIBERO: objects and regions as MJCF files, and its predicates as conditions with the same numbers.
//!
//! The numbers are those of LIBERO's code (github.com/Lifelong-Robot-Learning/LIBERO, commit 8f1084e): `envs/objects`,
//! `envs/object_states`, `envs/regions` and `envs/problems`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};

use super::bddl::{self, Region, Task};
use super::write::{self, Fragment};
use super::{Imported, Wishes, scene};
use crate::file::meshes::Find;
use crate::file::mjcf::xml::{self, Element};
use crate::file::mjcf::{place_of, plain};

/// The folders of models below LIBERO's assets.
const FOLDERS: [&str; 4] =
    ["stable_hope_objects", "stable_scanned_objects", "turbosquid_objects", "articulated_objects"];

/// How far above the table objects start, in metres, and how far below it fixtures are.
const DROP_M: f64 = 0.01;

/// A workspace: its name, the position of its origin in front of the robot's base (m), how far fixtures are below, and the height of
/// regions above the table.
struct Workspace {
    problem: &'static str,
    name: &'static str,
    ahead_m: f64,
    fixtures_m: f64,
    /// `None` where LIBERO's regions are not where its objects can be.
    regions_m: Option<f64>,
}

const WORKSPACES: [Workspace; 5] = [
    Workspace {
        problem: "libero_tabletop_manipulation",
        name: "main_table",
        ahead_m: 0.66,
        fixtures_m: -0.04,
        regions_m: Some(-0.005),
    },
    Workspace {
        problem: "libero_kitchen_tabletop_manipulation",
        name: "kitchen_table",
        ahead_m: 0.66,
        fixtures_m: -0.04,
        regions_m: None,
    },
    Workspace {
        problem: "libero_living_room_tabletop_manipulation",
        name: "living_room_table",
        ahead_m: 0.51,
        fixtures_m: -0.014,
        regions_m: Some(0.0),
    },
    Workspace {
        problem: "libero_study_tabletop_manipulation",
        name: "study_table",
        ahead_m: 0.55,
        fixtures_m: -0.04,
        regions_m: None,
    },
    Workspace {
        problem: "libero_floor_manipulation",
        name: "floor",
        ahead_m: 0.6,
        fixtures_m: -0.025,
        regions_m: Some(0.02),
    },
];

/// When a joint counts as open, closed, on and off: above or below a value.
struct Joints {
    category: &'static str,
    open: (char, f64),
    close: (char, f64),
}

const JOINTS: [Joints; 6] = [
    Joints { category: "microwave", open: ('<', -1.3), close: ('>', -0.005) },
    Joints { category: "short_cabinet", open: ('>', 0.1), close: ('<', 0.0) },
    Joints { category: "short_fridge", open: ('>', 2.0), close: ('<', 0.0) },
    Joints { category: "wooden_cabinet", open: ('<', -0.14), close: ('>', 0.0) },
    Joints { category: "white_cabinet", open: ('<', -0.14), close: ('>', 0.0) },
    // Turned on and off.
    Joints { category: "flat_stove", open: ('>', 0.5), close: ('<', 0.0) },
];

/// A body of a task.
struct Body {
    name: String,
    category: String,
    is_fixture: bool,
    root: Element,
    file: String,
    path: String,
    /// Where it starts in the frame of the robot's base.
    place: Option<Isometry3<f64>>,
    /// Radius of the disc of its start.
    spread_m: f64,
    spin_rad: f64,
}

/// A named box of a body.
struct Site {
    /// In the frame of the body.
    pose: Isometry3<f64>,
    half: Vector3<f64>,
    /// The body on a joint that it is in.
    part: Option<String>,
}

/// Imports a task file.
pub(super) fn import(path: &str, wishes: &Wishes, find: Find<'_>) -> Result<Imported, String> {
    let text = String::from_utf8(find(path)?).map_err(|_| format!("{path}: not text in UTF-8"))?;
    let task = bddl::parse(&text).map_err(|why| format!("{path}: {why}"))?;
    let workspace = WORKSPACES.iter().find(|of| of.problem == task.problem.to_lowercase());
    let workspace = workspace.ok_or_else(|| {
        let known = WORKSPACES.iter().map(|of| of.problem);
        format!(
            "{path}: unknown problem `{}`: {}",
            task.problem,
            robogate_core::hint(&task.problem.to_lowercase(), known)
        )
    })?;
    let mut cell =
        Cell { task: &task, workspace, bodies: Vec::new(), notes: BTreeSet::new(), regions: BTreeMap::new() };
    cell.read_bodies(path, find)?;
    cell.place_bodies();
    let goal = match cell.goal() {
        Ok(goal) => Some(goal),
        Err(why) => {
            cell.notes.insert(format!("the goal {why}"));
            None
        }
    };
    let tables = cell.tables();
    let mut imported = Imported::default();
    let mut fragments = Vec::new();
    for body in &cell.bodies {
        if !imported.files.contains_key(&body.file) {
            scene::add(&mut imported, body.root.clone(), &body.path, &body.file, &Wishes::default(), find)?;
        }
        fragments.push(Fragment {
            file: body.file.clone(),
            name: Some(body.name.clone()),
            place: Some(body.place.unwrap_or_else(Isometry3::identity)),
            free: !body.is_fixture,
            spread_m: body.spread_m,
            spin_rad: body.spin_rad,
        });
    }
    imported.left_out.extend(cell.notes);
    let instruction = wishes.instruction.clone().unwrap_or_else(|| task.instruction.clone());
    let goal = wishes.goal.clone().or(goal);
    let wishes = Wishes { goal, instruction: Some(instruction), at: None, rotation: None, ..wishes.clone() };
    write::task_with(imported, &wishes, &fragments, &tables)
}

/// A box: the body it is in, its centre and its edges.
type Box3 = (Option<String>, Vector3<f64>, Vector3<f64>);

struct Cell<'t> {
    task: &'t Task,
    workspace: &'static Workspace,
    bodies: Vec<Body>,
    notes: BTreeSet<String>,
    /// Regions of conditions, by name.
    regions: BTreeMap<String, Box3>,
}

/// The orientation in which LIBERO puts an object down: the mean, and how far it varies about the vertical (rad).
fn orientation(category: &str, folder: &str) -> (UnitQuaternion<f64>, f64) {
    use std::f64::consts::{FRAC_1_SQRT_2, PI};
    let yaw = |angle: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
    match category {
        "alphabet_soup" | "tomato_sauce" => {
            (UnitQuaternion::from_quaternion(Quaternion::new(0.0, 0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2)), 0.0)
        }
        "ketchup"
        | "macaroni_and_cheese"
        | "mayo"
        | "milk"
        | "orange_juice"
        | "salad_dressing"
        | "new_salad_dressing" => (UnitQuaternion::from_quaternion(Quaternion::new(0.5, 0.5, 0.5, 0.5)), 0.0),
        "butter" | "chocolate_pudding" | "cream_cheese" | "popcorn" | "simple_rack" => (yaw(PI), 0.0),
        "red_coffee_mug" | "porcelain_mug" | "white_yellow_mug" => (yaw(1.5 * PI), 0.0),
        "black_book" | "yellow_book" => (yaw(1.375 * PI), PI / 8.0),
        _ if folder == "turbosquid_objects" => (yaw(PI), 0.0),
        _ => (yaw(0.5 * PI), 0.0),
    }
}

impl Cell<'_> {
    fn read_bodies(&mut self, path: &str, find: Find<'_>) -> Result<(), String> {
        // The task files are in bddl_files/SUITE beside assets.
        let above = path.rsplitn(4, '/').nth(3).map_or_else(|| "../..".to_owned(), str::to_owned);
        let fixtures = self.task.fixtures.iter().map(|of| (of, true));
        let all: Vec<_> = fixtures.chain(self.task.objects.iter().map(|of| (of, false))).collect();
        for ((name, category), is_fixture) in all {
            if name == self.workspace.name {
                continue;
            }
            let mut found = None;
            for folder in FOLDERS {
                let own = if folder == "articulated_objects" { String::new() } else { format!("{category}/") };
                let candidate = format!("{above}/assets/{folder}/{own}{category}.xml");
                if find(&candidate).is_ok() {
                    found = Some((candidate, folder));
                    break;
                }
            }
            let Some((model, folder)) = found else {
                return Err(format!(
                    "{path}: no model of `{category}` in {above}/assets\nHint: the file must lie in LIBERO's folder \
                     libero/libero/bddl_files/SUITE, beside libero/libero/assets"
                ));
            };
            let whole = xml::read(&model, find).map_err(|wrong| super::shown(&wrong))?;
            let (_, spin_rad) = orientation(category, folder);
            self.bodies.push(Body {
                name: plain(name),
                category: category.clone(),
                is_fixture,
                root: unwrapped(whole, &model)?,
                file: format!("{}.xml", plain(category)),
                path: model,
                place: None,
                spread_m: 0.0,
                spin_rad: if is_fixture { 0.0 } else { spin_rad },
            });
        }
        Ok(())
    }

    fn body(&self, name: &str) -> Option<usize> {
        self.bodies.iter().position(|body| body.name == plain(name))
    }

    fn region(&self, name: &str) -> Option<&Region> {
        self.task.regions.iter().find(|region| region.name == name)
    }

    /// Where each body starts.
    fn place_bodies(&mut self) {
        let starts = self.task.start.clone();
        let mut moved: Vec<&Vec<String>> = starts.iter().filter(|of| matches!(of[0].as_str(), "on" | "in")).collect();
        // A body that others are on comes first.
        for _ in 0..self.bodies.len() {
            moved.retain(|of| of.len() == 3 && !self.place_body(of));
        }
        for left in moved {
            self.notes.insert(format!("start ({})", left.join(" ")));
        }
        for body in self.bodies.iter().filter(|body| body.place.is_none()) {
            self.notes.insert(format!("the start of `{}`, which is at the origin", body.name));
        }
    }

    fn place_body(&mut self, start: &[String]) -> bool {
        let Some(index) = self.body(&start[1]) else { return true };
        let folder = self.bodies[index].path.rsplit('/').nth(2).unwrap_or_default();
        let folder = if FOLDERS.contains(&folder) { folder.to_owned() } else { String::new() };
        let bottom = height_of(&self.bodies[index].root, "bottom_site");
        let (turn, _) = orientation(&self.bodies[index].category, &folder);
        let region = self.region(&start[2]).cloned();
        let is_fixture = self.bodies[index].is_fixture;
        match region {
            Some(region) if region.target == self.workspace.name => {
                let Some([x, y, right, top]) = region.range else { return true };
                let (middle_x, middle_y) = (0.5 * (x + right) + self.workspace.ahead_m, 0.5 * (y + top));
                let z = if is_fixture { self.workspace.fixtures_m } else { DROP_M } - bottom;
                let yaw = 0.5 * (region.yaw[0] + region.yaw[1]);
                let turn = if is_fixture { UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) } else { turn };
                let place = Isometry3::from_parts(Translation3::new(middle_x, middle_y, z), turn);
                self.bodies[index].place = Some(place);
                if is_fixture {
                    if right - x + top - y > 1e-3 || region.yaw[1] - region.yaw[0] > 1e-3 {
                        self.notes
                            .insert(format!("the range of the place of fixture `{}`: it is in the middle", start[1]));
                    }
                } else {
                    self.bodies[index].spread_m = 0.25 * (right - x + top - y);
                }
                true
            }
            Some(region) => {
                let Some(target) = self.body(&region.target) else { return true };
                let Some(frame) = self.bodies[target].place else { return false };
                let Some(site) = self.site(target, &region) else { return true };
                let at = frame * site.pose;
                let half = (at.rotation.to_rotation_matrix().into_inner() * site.half).abs();
                let edge = if start[0] == "on" { half.z } else { -half.z };
                let shift = self.opened(target, &site, &frame);
                let z = at.translation.z + edge - bottom;
                let xy = at.translation.vector + shift;
                self.bodies[index].place =
                    Some(Isometry3::from_parts(Translation3::new(xy.x, xy.y, z + shift.z), turn));
                true
            }
            None => {
                let Some(target) = self.body(&start[2]) else { return true };
                let Some(below) = self.bodies[target].place else { return false };
                let z = below.translation.z + height_of(&self.bodies[target].root, "top_site") - bottom;
                let at = below.translation.vector;
                // It starts where the one below it does.
                self.bodies[index].place = Some(Isometry3::from_parts(Translation3::new(at.x, at.y, z), turn));
                if std::mem::take(&mut self.bodies[target].spread_m) > 0.0 {
                    self.notes
                        .insert(format!("the range of the start of `{}`, which carries `{}`", start[2], start[1]));
                }
                true
            }
        }
    }

    /// How far the body of a site is moved at the start, in the frame of the base.
    fn opened(&self, target: usize, site: &Site, frame: &Isometry3<f64>) -> Vector3<f64> {
        let Some(part) = &site.part else { return Vector3::zeros() };
        let (name, root) = (&self.bodies[target].name, &self.bodies[target].root);
        let value = self.values_at_start().into_iter().find(|(of, _)| *of == format!("{name}_{part}"));
        let axis =
            parts_of(root).into_iter().find(|(of, ..)| of == part).and_then(|(_, axis, slides)| slides.then_some(axis));
        match (value, axis) {
            (Some((_, value)), Some(axis)) => frame.rotation * (axis * value),
            _ => Vector3::zeros(),
        }
    }

    /// Values of joints that the start states: the middle of LIBERO's range.
    fn values_at_start(&self) -> Vec<(String, f64)> {
        let ranges = |category: &str, open: bool| match (category, open) {
            ("microwave", true) => Some(-1.697),
            ("microwave", false) => Some(-0.0025),
            ("short_cabinet", true) => Some(0.13),
            ("short_fridge", true) => Some(2.35),
            ("wooden_cabinet" | "white_cabinet", true) => Some(-0.15),
            ("wooden_cabinet" | "white_cabinet", false) => Some(0.0025),
            ("flat_stove", true) => Some(1.3),
            ("flat_stove", false) => Some(-0.0025),
            _ => None,
        };
        let stated = self.task.start.iter().filter(|of| of.len() == 2);
        let mut found = Vec::new();
        for start in stated {
            let open = matches!(start[0].as_str(), "open" | "turnon");
            let Some((target, parts)) = self.joints(&start[1]) else { continue };
            let Some(value) = ranges(&self.bodies[target].category, open) else { continue };
            found.extend(parts.into_iter().map(|part| (part, value)));
        }
        found
    }

    /// The fixture that a name means or is in, and the parts whose joints it means.
    fn joints(&self, name: &str) -> Option<(usize, Vec<String>)> {
        let named = |target: usize, part: &str| format!("{}_{part}", self.bodies[target].name);
        if let Some(target) = self.body(name) {
            let parts = parts_of(&self.bodies[target].root).into_iter().map(|(part, ..)| named(target, &part));
            return Some((target, parts.collect()));
        }
        let region = self.region(name)?;
        let target = self.body(&region.target)?;
        let part = self.site(target, region)?.part?;
        Some((target, vec![named(target, &part)]))
    }

    fn site(&self, target: usize, region: &Region) -> Option<Site> {
        let name = region.name.strip_prefix(&format!("{}_", region.target))?;
        site_of(&self.bodies[target].root, name)
    }

    /// The condition of the goal.
    fn goal(&mut self) -> Result<String, String> {
        let goal = self.task.goal.clone();
        let parts = goal.iter().map(|of| self.predicate(of)).collect::<Result<Vec<_>, _>>()?;
        Ok(parts.join(" and "))
    }

    fn predicate(&mut self, of: &[String]) -> Result<String, String> {
        let shown = of.join(" ");
        let unknown = |what: &str| format!("({shown}): {what}");
        match (of[0].as_str(), &of[1..]) {
            ("on", [object, place]) => {
                self.on(object, place).ok_or_else(|| unknown("the place is unknown, or its box is turned"))
            }
            ("in", [object, place]) => {
                let region = self.region(place).cloned().ok_or_else(|| unknown("an unknown region"))?;
                let target =
                    self.body(&region.target).ok_or_else(|| unknown("a region of the table contains nothing"))?;
                let site = self.site(target, &region).ok_or_else(|| unknown("a region without a site in the model"))?;
                // The box is along the axes of the world, and reaches 1 cm further down.
                let frame = self.bodies[target].place.unwrap_or_else(Isometry3::identity);
                let axes = (frame * site.pose).rotation.to_rotation_matrix().into_inner();
                let half = (axes * site.half).abs();
                let centre = Vector3::new(0.0, 0.0, -0.005);
                let name =
                    self.add_region(place, target, &site, &frame, (centre, half + Vector3::new(0.0, 0.0, 0.005)));
                name.map(|name| format!("inside({}, {name})", plain(object)))
                    .ok_or_else(|| unknown("a region that is turned"))
            }
            ("open" | "close" | "turnon" | "turnoff", [name]) => {
                let (target, parts) = self.joints(name).ok_or_else(|| unknown("it has no joint"))?;
                let category = &self.bodies[target].category;
                let joints = JOINTS.iter().find(|of| of.category == category);
                let joints = joints.ok_or_else(|| unknown("when this object is open is not known"))?;
                let any = matches!(of[0].as_str(), "open" | "turnon");
                let (side, value) = if any { joints.open } else { joints.close };
                let unit = |part: &str| {
                    let own = part.strip_prefix(&format!("{}_", self.bodies[target].name)).unwrap_or(part);
                    let slides =
                        parts_of(&self.bodies[target].root).into_iter().any(|(name, _, slides)| name == own && slides);
                    if slides { "m" } else { "rad" }
                };
                let all: Vec<String> =
                    parts.iter().map(|part| format!("joint({part}) {side} {value} {}", unit(part))).collect();
                let joined = all.join(if any { " or " } else { " and " });
                Ok(if all.len() > 1 { format!("({joined})") } else { joined })
            }
            _ => Err(unknown("an unknown predicate. Expected On, In, Open, Close, TurnOn or TurnOff")),
        }
    }

    fn on(&mut self, object: &str, place: &str) -> Option<String> {
        self.body(object)?;
        let object = plain(object);
        if let Some(below) = self.body(place) {
            let below = &self.bodies[below].name;
            return Some(format!(
                "not (height({below}) > height({object})) and contact({object}, {below}) and \
                 hypot(x({object}) - x({below}), y({object}) - y({below})) < 3 cm"
            ));
        }
        let region = self.region(place)?.clone();
        if region.target == self.workspace.name {
            // A thin box on the table: up to 10 cm above it counts.
            let ([x, y, right, top], z) = (region.range?, self.workspace.regions_m?);
            let centre = Vector3::new(0.5 * (x + right) + self.workspace.ahead_m, 0.5 * (y + top), z + 0.0545);
            let name = format!("{}_on", plain(place));
            self.regions.insert(name.clone(), (None, centre, Vector3::new(right - x, top - y, 0.105)));
            return Some(format!("inside({object}, {name})"));
        }
        let target = self.body(&region.target)?;
        let site = self.site(target, &region)?;
        let frame = self.bodies[target].place.unwrap_or_else(Isometry3::identity);
        // In the frame of the site, from 5 mm below its top to 10 cm above it. LIBERO turns the difference by the rotation of the site
        // and not by its inverse.
        let axes = (frame * site.pose).rotation.to_rotation_matrix().into_inner();
        if !straight(&axes) {
            return None;
        }
        let half = Vector3::new(site.half.x, site.half.y, 0.0525);
        let centre = Vector3::new(0.0, 0.0, site.half.z + 0.0475);
        let back = axes.transpose();
        let name = self.add_region(place, target, &site, &frame, (back * centre, (back * half).abs()))?;
        let parts = parts_of(&self.bodies[target].root)
            .into_iter()
            .map(|(part, ..)| format!("{}_{part}", self.bodies[target].name));
        let bodies: Vec<String> = std::iter::once(self.bodies[target].name.clone()).chain(parts).collect();
        let touches: Vec<String> = bodies.iter().map(|body| format!("contact({object}, {body})")).collect();
        Some(format!("inside({object}, {name}) and ({})", touches.join(" or ")))
    }

    /// Adds a box about a site, given along the axes of the world: its centre from that of the site, and half of its edges.
    fn add_region(
        &mut self,
        place: &str,
        target: usize,
        site: &Site,
        frame: &Isometry3<f64>,
        (centre, half): (Vector3<f64>, Vector3<f64>),
    ) -> Option<String> {
        let turn: Matrix3<f64> = frame.rotation.inverse().to_rotation_matrix().into_inner();
        let name = format!("{}_goal", plain(place));
        let owner = match &site.part {
            Some(part) => format!("{}_{part}", self.bodies[target].name),
            None => self.bodies[target].name.clone(),
        };
        let at = site.pose.translation.vector + turn * centre;
        self.regions.insert(name.clone(), (Some(owner), at, 2.0 * (turn * half).abs()));
        straight(&turn).then_some(name)
    }

    /// Regions, and values of joints at the start.
    fn tables(&self) -> String {
        let mut text = String::new();
        for (name, (owner, at, size)) in &self.regions {
            let _ = write!(text, "\n[[region]]\nname = \"{name}\"\n");
            if let Some(owner) = owner {
                let _ = writeln!(text, "in = \"{owner}\"");
            }
            let list = |of: &Vector3<f64>| of.map(|x| (x * 1e7).round() / 1e7 + 0.0);
            let (at, size) = (list(at), list(size));
            let _ = writeln!(
                text,
                "at = \"{}, {}, {} m\"\nsize = \"{}, {}, {} m\"",
                at.x, at.y, at.z, size.x, size.y, size.z
            );
        }
        for (part, value) in self.values_at_start() {
            let target = self.bodies.iter().find(|body| part.starts_with(&body.name));
            let unit = target.map_or("m", |body| {
                if matches!(body.category.as_str(), "microwave" | "short_fridge" | "flat_stove") { "rad" } else { "m" }
            });
            let _ = write!(text, "\n[[set]]\nnumbers = \"{part}.joint.start\"\nto = \"{value} {unit}\"\n");
        }
        text
    }
}

/// Whether a rotation only permutes axes.
fn straight(turn: &Matrix3<f64>) -> bool {
    turn.iter().all(|x| x.abs() < 1e-3 || x.abs() > 1.0 - 1e-3)
}

/// The model with its body `object` at the top, whose frame is that of the object.
fn unwrapped(mut root: Element, path: &str) -> Result<Element, String> {
    fn object(element: &Element) -> Option<Element> {
        let own = element.children.iter().find(|child| child.name == "body" && child.get("name") == Some("object"));
        own.cloned().or_else(|| element.children.iter().find_map(object))
    }
    let world = root.children.iter_mut().find(|child| child.name == "worldbody");
    let world = world.ok_or_else(|| format!("{path}: it has no <worldbody>"))?;
    let mut body = object(world).ok_or_else(|| format!("{path}: it has no body `object`"))?;
    body.attributes.retain(|(name, _)| !["pos", "quat", "euler", "axisangle"].contains(&name.as_str()));
    // Marks of the size of the object are in the body around it.
    let mut marks = Vec::new();
    world.visit(&mut |element| {
        if element.name == "site" && element.get("name").is_some_and(|name| ["bottom_site", "top_site"].contains(&name))
        {
            marks.push(element.clone());
        }
    });
    world.children = vec![body];
    world.children.extend(marks);
    Ok(root)
}

/// The height of a mark.
fn height_of(root: &Element, name: &str) -> f64 {
    let mut found = 0.0;
    root.visit(&mut |element| {
        if element.name == "site" && element.get("name") == Some(name) {
            found = place_of(root, element).translation.z;
        }
    });
    found
}

/// The bodies on a joint: name, axis, and whether it slides.
fn parts_of(root: &Element) -> Vec<(String, Vector3<f64>, bool)> {
    let mut found = Vec::new();
    root.visit(&mut |element| {
        if let ("body", Some(joint)) = (element.name.as_str(), element.first("joint")) {
            let axis: Vec<f64> =
                joint.get("axis").unwrap_or("0 0 1").split_whitespace().filter_map(|x| x.parse().ok()).collect();
            let axis = if axis.len() == 3 { Vector3::from_column_slice(&axis) } else { Vector3::z() };
            found.push((plain(element.get("name").unwrap_or("body")), axis, joint.get("type") == Some("slide")));
        }
    });
    found
}

/// A box site in the frame of the object.
fn site_of(root: &Element, name: &str) -> Option<Site> {
    fn search(
        root: &Element,
        element: &Element,
        frame: Isometry3<f64>,
        part: Option<&str>,
        name: &str,
    ) -> Option<Site> {
        for child in &element.children {
            if child.name == "site" && child.get("name") == Some(name) {
                let size: Vec<f64> =
                    child.get("size").unwrap_or_default().split_whitespace().filter_map(|x| x.parse().ok()).collect();
                let half = (size.len() == 3).then(|| Vector3::from_column_slice(&size))?;
                return Some(Site { pose: frame * place_of(root, child), half, part: part.map(str::to_owned) });
            }
            if child.name == "body" {
                let moves = child.first("joint").is_some();
                let own = child.get("name").map(plain);
                let part = if moves { own.as_deref() } else { part };
                let within = if moves { Isometry3::identity() } else { frame * place_of(root, child) };
                // A body on a joint has its own frame, which the models put at that of the object.
                if let Some(site) = search(root, child, within, part, name) {
                    return Some(site);
                }
            }
        }
        None
    }
    let world = root.first("worldbody")?;
    search(root, world.first("body")?, Isometry3::identity(), None, name)
}
