//! The bodies of an MJCF file: those at rest become fixtures, those on a joint or free become parts.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Isometry3, Matrix3, UnitVector3, Vector3};
use robogate_physics::{Joint, JointKind, MassProperties};

use super::attributes::{MAIN, Source, position_text, rotation_text};
use super::geoms::{Geom, half_edges, permuted};
use super::xml::Element;
use super::{Assets, known, plain, unused};
use crate::file::document::{
    FixtureTable, FragmentTable, JointTable, JointWord, PartTable, PointTable, RegionTable, ShapeTable, Text,
};

/// The widest stops of a joint, in rad or m: those of a joint without any.
const WIDEST: f64 = 10.0;

/// The tables of a file.
#[derive(Default)]
pub(super) struct Translated {
    pub(super) fixtures: Vec<FixtureTable>,
    pub(super) parts: Vec<PartTable>,
    pub(super) regions: Vec<RegionTable>,
    pub(super) left_out: BTreeMap<String, usize>,
}

/// A fixture or a part that is being collected: one body with those that are welded to it.
struct Group<'e> {
    element: &'e Element,
    name: String,
    /// Its frame in that of the robot's base.
    frame: Isometry3<f64>,
    /// The fixture that a part is in.
    parent: Option<usize>,
    moves: bool,
    joint: Option<JointTable>,
    /// Mass properties of each body that states them.
    stated: Vec<MassProperties>,
    /// Whether a body does not state them and has geoms.
    follows: bool,
    geoms: Vec<Geom>,
    points: Vec<(&'e Element, String, Vector3<f64>)>,
    regions: Vec<(&'e Element, String, Vector3<f64>, [f64; 3])>,
}

/// Where an element is.
#[derive(Clone, Copy)]
struct Within<'c> {
    /// The group that it belongs to. `None` in the world.
    group: Option<usize>,
    /// The frame of its body in that of the group, or of the base.
    frame: Isometry3<f64>,
    class: &'c str,
    /// Whether its body states its mass, so that its geoms have none.
    stated: bool,
}

/// The bodies of a file.
pub(super) struct Bodies<'e, 'a, 'p> {
    source: Source<'a, 'p>,
    assets: &'e Assets,
    groups: Vec<Group<'e>>,
    names: BTreeSet<String>,
    /// The name in front of others, and that of the file.
    prefix: Option<String>,
    stem: String,
    /// Whether one body alone is at the top.
    alone: bool,
    free: bool,
    weld: Vec<String>,
    /// The group of the geoms in the world.
    ground: Option<usize>,
    place: Isometry3<f64>,
}

impl<'e, 'a, 'p> Bodies<'e, 'a, 'p> {
    pub(super) fn new(
        source: Source<'a, 'p>,
        assets: &'e Assets,
        table: &FragmentTable,
        place: Isometry3<f64>,
    ) -> Self {
        let stem = table.file.text.rsplit('/').next().unwrap_or_default().trim_end_matches(".xml");
        let weld = table.weld.as_ref().map(|text| text.text.split(',').map(|name| name.trim().to_owned()).collect());
        Self {
            source,
            assets,
            groups: Vec::new(),
            names: BTreeSet::new(),
            prefix: table.name.as_ref().map(|name| name.text.clone()),
            stem: plain(stem),
            alone: false,
            free: table.free,
            weld: weld.unwrap_or_default(),
            ground: None,
            place,
        }
    }

    /// Collects the bodies of a <worldbody>.
    pub(super) fn world(&mut self, world: &'e Element) {
        fn count(element: &Element) -> usize {
            let one = |child: &Element| match child.name.as_str() {
                "body" => 1,
                "frame" => count(child),
                _ => 0,
            };
            element.children.iter().map(one).sum()
        }
        self.alone = count(world) == 1;
        let within =
            Within { group: None, frame: self.place, class: world.get("childclass").unwrap_or(MAIN), stated: false };
        self.children(world, within);
    }

    fn children(&mut self, element: &'e Element, within: Within<'e>) {
        for child in &element.children {
            match child.name.as_str() {
                "body" => self.body(child, within),
                "frame" => {
                    self.source.check(child, within.class);
                    let frame = within.frame * self.source.pose(child, within.class);
                    let class = child.get("childclass").unwrap_or(within.class);
                    self.children(child, Within { frame, class, ..within });
                }
                "geom" => self.geom(child, within),
                "site" => self.site(child, within),
                "camera" | "light" => self.source.leave_out(&format!("<{}>", child.name)),
                "joint" | "freejoint" if within.group.is_none() => {
                    self.source.wrong(child, "a joint of the world", "put it into a <body>");
                }
                "joint" | "freejoint" | "inertial" => {}
                other => {
                    let refused = known::REFUSED.iter().find(|(name, _)| *name == other);
                    let hint = refused.map_or("expected body, joint, geom, site, inertial or frame", |(_, hint)| *hint);
                    self.source.wrong(child, format!("<{other}> is not simulated"), hint);
                }
            }
        }
    }

    fn body(&mut self, element: &'e Element, within: Within<'e>) {
        self.source.check(element, within.class);
        self.source.check_class(element, "childclass");
        let class = element.get("childclass").unwrap_or(within.class);
        let frame = within.frame * self.source.pose(element, MAIN);
        let joints: Vec<&'e Element> = element
            .children
            .iter()
            .filter(|child| matches!(child.name.as_str(), "joint" | "freejoint"))
            .filter(|joint| !joint.get("name").is_some_and(|name| self.weld.iter().any(|weld| weld == name)))
            .collect();
        let fixed_top = within.group.is_none() && joints.is_empty();
        let frees = fixed_top && self.free && !has_joints(element);
        let within = if !joints.is_empty() || frees {
            self.moving(element, &joints, Within { frame, class, ..within })
        } else if fixed_top {
            let group = self.group(element, frame, within.group, false);
            Within { group: Some(group), frame: Isometry3::identity(), class, ..within }
        } else {
            Within { frame, class, ..within }
        };
        let within = Within { stated: element.first("inertial").is_some(), ..within };
        if let Some(group) = within.group {
            self.weigh(element, group, &within.frame);
        }
        self.children(element, within);
    }

    /// A body that moves.
    fn moving(&mut self, element: &'e Element, joints: &[&'e Element], at: Within<'e>) -> Within<'e> {
        let parent = at.group;
        let base = parent.map_or(Isometry3::identity(), |group| self.groups[group].frame);
        if let Some(parent) = parent.filter(|parent| self.groups[*parent].moves) {
            let what = format!("the body moves in the body `{}`, which moves itself", self.groups[parent].name);
            let hint = "let one of the two joints not move: name it in `weld`";
            self.source.wrong(joints.first().copied().unwrap_or(element), what, hint);
        }
        if let [_, second, ..] = joints {
            let hint = "a part has one joint: leave the others out, or name them in `weld`";
            self.source.wrong(second, "a second joint of a body", hint);
        }
        let group = self.group(element, base * at.frame, parent, true);
        if let Some(joint) = joints.first() {
            self.joint(joint, group, at.class);
        }
        Within { group: Some(group), frame: Isometry3::identity(), ..at }
    }

    fn group(&mut self, element: &'e Element, frame: Isometry3<f64>, parent: Option<usize>, moves: bool) -> usize {
        let own = element.get("name").map(plain);
        let top = parent.is_none() && self.alone;
        let wanted = match (&self.prefix, own) {
            (Some(prefix), _) if top => prefix.clone(),
            (Some(prefix), Some(own)) => format!("{prefix}_{own}"),
            (Some(prefix), None) => format!("{prefix}_body"),
            (None, Some(own)) => own,
            (None, None) if top => self.stem.clone(),
            (None, None) => format!("{}_body", self.stem),
        };
        let name = unused(&wanted, &mut self.names);
        self.groups.push(Group {
            element,
            name,
            frame,
            parent,
            moves,
            joint: None,
            stated: Vec::new(),
            follows: false,
            geoms: Vec::new(),
            points: Vec::new(),
            regions: Vec::new(),
        });
        self.groups.len() - 1
    }

    fn weigh(&mut self, element: &'e Element, group: usize, frame: &Isometry3<f64>) {
        match element.first("inertial") {
            Some(inertial) => {
                let stated = self.source.inertial(inertial, frame);
                self.groups[group].stated.extend(stated);
            }
            None => self.groups[group].follows |= element.first("geom").is_some(),
        }
    }

    fn joint(&mut self, element: &'e Element, group: usize, class: &str) {
        self.source.check(element, class);
        self.source.check_class(element, "class");
        let kind = self.source.word(element, class, "type").unwrap_or_else(|| "hinge".to_owned());
        let (word, kind) = match (element.name.as_str(), kind.as_str()) {
            ("freejoint", _) | (_, "free") => return,
            (_, "hinge") => (JointWord::Hinge, JointKind::Hinge),
            (_, "slide") => (JointWord::Slide, JointKind::Slide),
            (_, other) => {
                let hint = "a part moves freely, on a hinge or on a slide";
                self.source.wrong(element, format!("joints of type `{other}` are not simulated"), hint);
                return;
            }
        };
        let turns = kind == JointKind::Hinge;
        let axis = self.source.numbers::<3>(element, class, "axis").unwrap_or([0.0, 0.0, 1.0]);
        let Some(axis) = UnitVector3::try_new(Vector3::from(axis), 1e-9) else {
            self.source.wrong(element, "`axis` has no length", "name a direction such as `0 0 1`");
            return;
        };
        let anchor = self.source.numbers::<3>(element, class, "pos").unwrap_or_default();
        let scaled = |source: &Source<'_, '_>, value: f64| if turns { source.angle(value) } else { value };
        let of = |source: &mut Source<'_, '_>, name: &str| source.number(element, class, name).unwrap_or(0.0);
        let reference = of(&mut self.source, "ref");
        let reference = scaled(&self.source, reference);
        let range = self.range(element, class).map(|range| range.map(|end| scaled(&self.source, end)));
        let range = range.unwrap_or_else(|| {
            self.source.leave_out("a joint without stops gets some at 10 m or 10 rad");
            [-WIDEST, WIDEST]
        });
        if let Some(outside) = range.iter().find(|end| end.abs() > WIDEST) {
            let hint = if turns { "angles are in degrees unless <compiler angle=\"radian\"/>" } else { "" };
            self.source.wrong(element, format!("a stop at {outside:.3} is more than {WIDEST} away"), hint);
        }
        let rest = of(&mut self.source, "springref");
        let rest = scaled(&self.source, rest);
        let [damping, friction, stiffness] =
            ["damping", "frictionloss", "stiffness"].map(|name| of(&mut self.source, name));
        let unit = if turns { "rad" } else { "m" };
        let force = if turns { "N m" } else { "N" };
        let start = reference.clamp(range[0], range[1].max(range[0]));
        if (start - reference).abs() > 1e-9 {
            self.source.leave_out("a joint starts at a stop, because it would start beyond it");
        }
        let mut text = |text: String| self.source.text(element, text);
        let table = JointTable {
            kind: word,
            axis: text(format!("{}, {}, {}", axis.x, axis.y, axis.z)),
            anchor: Some(text(position_text(&anchor.into()))),
            range: text(format!("{}, {} {unit}", range[0], range[1])),
            start: Some(text(format!("{start} {unit}"))),
            damping: Some(text(format!("{damping} {force} s/{unit}"))),
            friction: Some(text(format!("{friction} {force}"))),
            stiffness: Some(text(format!("{stiffness} {force}/{unit}"))),
            rest: Some(text(format!("{rest} {unit}"))),
            pitch: None,
            takes: None,
            within: None,
            lean: None,
        };
        // The pose in the file is that where the joint has the value `ref`.
        let joint = Joint {
            kind,
            axis: axis.into_inner(),
            anchor: anchor.into(),
            range,
            start,
            damping,
            friction,
            stiffness,
            rest,
            pitch_m: 0.0,
            thread: None,
        };
        self.groups[group].frame *= joint.motion(-reference);
        self.groups[group].joint = Some(table);
    }

    /// The stops of a joint, if it has some.
    fn range(&mut self, element: &Element, class: &str) -> Option<[f64; 2]> {
        let range = self.source.numbers::<2>(element, class, "range");
        let limited = match self.source.value(element, class, "limited") {
            Some("true") => true,
            Some("false") => false,
            _ => range.is_some() && self.source.autolimits,
        };
        range.filter(|_| limited)
    }

    fn geom(&mut self, element: &'e Element, within: Within<'e>) {
        let is_plane = self.source.value(element, within.class, "type") == Some("plane");
        if is_plane && within.group.is_none_or(|group| !self.groups[group].moves) {
            self.source.leave_out("a plane: the cell has its table at z = 0");
            return;
        }
        let (group, frame) = match within.group {
            Some(group) => (group, within.frame),
            None => (self.ground(element), self.place.inverse() * within.frame),
        };
        let mut geom = self.source.geom(element, within.class, &frame, self.assets);
        if let Some(geom) = geom.as_mut().filter(|_| within.stated) {
            (geom.mass, geom.is_mesh) = (None, false);
        }
        self.groups[group].geoms.extend(geom);
    }

    /// The fixture of the geoms that are in the world itself.
    fn ground(&mut self, element: &'e Element) -> usize {
        if let Some(ground) = self.ground {
            return ground;
        }
        let wanted = self.prefix.clone().unwrap_or_else(|| self.stem.clone());
        let wanted = if self.names.contains(&wanted) || self.alone { format!("{wanted}_ground") } else { wanted };
        let name = unused(&wanted, &mut self.names);
        let ground = self.group(element, self.place, None, false);
        self.names.remove(&self.groups[ground].name);
        self.groups[ground].name = name;
        self.ground = Some(ground);
        ground
    }

    fn site(&mut self, element: &'e Element, within: Within<'e>) {
        self.source.check(element, within.class);
        let Some(name) = element.get("name").map(plain) else { return };
        let Some(solid) = self.source.solid(element, within.class) else { return };
        let pose = within.frame * solid.pose;
        let at = pose.translation.vector;
        let Some(group) = within.group else { return };
        let is_point = self.groups[group].moves && solid.kind != "box";
        let half = half_edges(&solid).and_then(|half| permuted(&pose.rotation, half));
        match half {
            _ if is_point => self.groups[group].points.push((element, name, at)),
            Some(half) if half.iter().all(|half| *half > 0.0) => {
                self.groups[group].regions.push((element, name, at, half));
            }
            _ => self.source.leave_out("a site whose edges are not along the axes of its body"),
        }
    }

    /// The tables.
    pub(super) fn finish(mut self, root: &Element) -> Translated {
        self.check_excluded(root);
        self.check_welded(root);
        let mut found = Translated::default();
        let groups = std::mem::take(&mut self.groups);
        let shaped: Vec<bool> =
            groups.iter().map(|group| group.geoms.iter().any(|geom| geom.shape.is_some())).collect();
        let places: Vec<(String, Isometry3<f64>)> =
            groups.iter().map(|group| (group.name.clone(), group.frame)).collect();
        for (mut group, has_shapes) in groups.into_iter().zip(&shaped) {
            let parent = group.parent.filter(|parent| shaped[*parent]).map(|parent| &places[parent]);
            let in_frame = |pose: Isometry3<f64>| parent.map_or(pose, |(_, frame)| frame.inverse() * pose);
            let (regions, points) = (std::mem::take(&mut group.regions), std::mem::take(&mut group.points));
            for (element, name, at, half) in regions {
                // Without a shape there is no fixture to be in.
                let own = (group.moves || *has_shapes).then(|| self.source.text(element, group.name.clone()));
                let turned = permuted(&group.frame.rotation, half).filter(|_| own.is_none());
                let at = if own.is_some() { at } else { (group.frame * nalgebra::Point3::from(at)).coords };
                let [x, y, z] = turned.unwrap_or(half).map(|half| 2.0 * half);
                let name = self.prefix.as_ref().map_or(name.clone(), |prefix| format!("{prefix}_{name}"));
                let name = unused(&name, &mut self.names);
                found.regions.push(RegionTable {
                    name: self.source.text(element, name),
                    parent: own,
                    at: Some(self.source.text(element, position_text(&at))),
                    size: self.source.text(element, format!("{x}, {y}, {z} m")),
                });
            }
            let element = group.element;
            let pose = in_frame(group.frame);
            let at = Some(self.source.text(element, position_text(&pose.translation.vector)));
            let rotation = Some(self.source.text(element, rotation_text(&pose.rotation)));
            let name = self.source.text(element, group.name.clone());
            let friction = self.friction(&group);
            let color = group.geoms.iter().find_map(|geom| geom.color.clone()).map(|of| self.source.text(element, of));
            if !group.moves {
                let shapes: Vec<ShapeTable> = group.geoms.into_iter().filter_map(|geom| geom.shape).collect();
                let shapes =
                    shapes.into_iter().map(|shape| ShapeTable { mass: None, density: None, ..shape }).collect();
                if *has_shapes {
                    found.fixtures.push(FixtureTable {
                        name,
                        at,
                        rotation,
                        shapes,
                        friction,
                        color,
                        ..FixtureTable::default()
                    });
                }
                continue;
            }
            let mut names = BTreeSet::new();
            let points = points.into_iter().map(|(element, name, at)| {
                let at = self.source.text(element, position_text(&at));
                (unused(&name, &mut names), PointTable { at, close: None })
            });
            let points = points.collect();
            let parent = parent.map(|(name, _)| self.source.text(element, name.clone()));
            let mut part = PartTable {
                name,
                parent,
                at,
                rotation,
                friction,
                color,
                points,
                joint: group.joint.take(),
                ..PartTable::default()
            };
            self.masses(&mut part, group);
            found.parts.push(part);
        }
        found.left_out = self.source.left_out;
        found
    }

    /// Mass, centre of mass and inertia of a part, or those of its shapes.
    fn masses(&mut self, part: &mut PartTable, group: Group<'_>) {
        let element = group.element;
        if !group.stated.is_empty() {
            let mut bodies = group.stated;
            if group.follows {
                if group.geoms.iter().any(|geom| geom.is_mesh) {
                    let what = "some of the welded bodies have <inertial> and some have meshes";
                    self.source.wrong(element, what, "give all of them an <inertial>");
                }
                bodies.extend(group.geoms.iter().filter_map(|geom| geom.mass));
            }
            let of = MassProperties::together(&bodies);
            let m: &Matrix3<f64> = &of.inertia;
            let all = [m[(0, 0)], m[(1, 1)], m[(2, 2)], m[(0, 1)], m[(0, 2)], m[(1, 2)]];
            let all: Vec<String> = all.iter().map(f64::to_string).collect();
            part.mass = Some(self.source.text(element, format!("{} kg", of.mass_kg)));
            part.centre = Some(self.source.text(element, position_text(&of.centre)));
            part.inertia = Some(self.source.text(element, format!("{} kg m^2", all.join(", "))));
        }
        let stated = part.mass.is_some();
        part.shapes = group.geoms.into_iter().filter_map(|geom| geom.shape).collect();
        let densities: Vec<Option<&Text>> = part.shapes.iter().map(|shape| shape.density.as_ref()).collect();
        let even = densities.windows(2).all(|pair| pair[0].map(|of| &of.text) == pair[1].map(|of| &of.text));
        match part.shapes.first() {
            Some(first) if !stated && even && first.density.is_some() => part.density.clone_from(&first.density),
            Some(first) if !stated && part.shapes.len() == 1 => part.mass.clone_from(&first.mass),
            _ if !stated => return,
            _ => {}
        }
        part.shapes.iter_mut().for_each(|shape| (shape.mass, shape.density) = (None, None));
    }

    /// The friction coefficient of a body: the largest one that its geoms state.
    fn friction(&mut self, group: &Group<'_>) -> Option<Text> {
        let stated: Vec<f64> = group.geoms.iter().filter_map(|geom| geom.friction).collect();
        let largest = stated.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if stated.iter().any(|friction| *friction < largest) {
            self.source.leave_out("smaller friction coefficients of single geoms: a body has its largest one");
        }
        (!stated.is_empty()).then(|| self.source.text(group.element, largest.to_string()))
    }

    /// Excluded contacts have no effect unless a part is free.
    fn check_excluded(&mut self, root: &Element) {
        for exclude in root.all("contact").flat_map(|contact| contact.all("exclude")) {
            let names: Vec<String> =
                ["body1", "body2"].iter().filter_map(|name| exclude.get(name)).map(plain).collect();
            let free = |group: &Group<'_>| {
                let own = group.element.get("name").map(plain);
                group.moves && group.joint.is_none() && own.is_some_and(|own| names.contains(&own))
            };
            if self.groups.iter().any(free) {
                let hint = "a body that moves freely touches everything";
                self.source.wrong(exclude, "an excluded contact of a free body is not simulated", hint);
            }
        }
    }

    fn check_welded(&mut self, root: &Element) {
        let mut joints: Vec<&str> = Vec::new();
        root.visit(&mut |element| joints.extend(element.get("name").filter(|_| element.name == "joint")));
        for name in self.weld.clone().iter().filter(|name| !joints.contains(&name.as_str())) {
            let hint = robogate_core::hint(name, joints.iter().copied());
            self.source.wrong(
                root,
                format!("`weld` names the joint `{name}`, which the file does not have: {hint}"),
                "",
            );
        }
    }
}

/// Whether something in a body moves.
fn has_joints(element: &Element) -> bool {
    let mut found = false;
    element.visit(&mut |child| found |= matches!(child.name.as_str(), "joint" | "freejoint"));
    found
}
