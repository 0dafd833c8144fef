//! The names of a file: fixtures, parts with their points, regions and parameters.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::conditions::Body;
use super::numbers::{Frame, Place};
use super::syntax::{Node, What, Wrong};
use super::units::Dimension;

/// The name of the table, which is the first fixture of every scene.
pub(super) const TABLE: &str = "table";
/// Names with a meaning of their own.
pub(super) const RESERVED: [&str; 5] = ["robot", "tool", TABLE, "scene", "world"];

/// A box in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Region {
    pub(super) on: Frame,
    /// Centre in that frame, and half of the edges, in metres.
    pub(super) at: Vector3<f64>,
    pub(super) half: [f64; 3],
}

/// The names of a file.
#[derive(Debug, Default)]
pub(super) struct Names {
    /// Fixtures with the indices of their shapes in the scene.
    pub(super) fixtures: Vec<(String, std::ops::Range<usize>)>,
    /// Parts with the dimension of their joint.
    pub(super) parts: Vec<(String, Option<Dimension>)>,
    /// Points of parts, as `part.point`.
    pub(super) points: BTreeMap<String, Place>,
    pub(super) regions: Vec<(String, Region)>,
    /// The roles of the file's choice, with the part that has each.
    pub(super) roles: Vec<(String, usize)>,
    /// Named conditions, with the slot of the memory that has their result.
    pub(super) conditions: Vec<(String, usize)>,
    /// Parameters and settings with the dimension of their values.
    pub(super) parameters: Vec<(String, Dimension)>,
    /// The nominal values of the parameters and settings.
    pub(super) nominal: Vec<f64>,
}

fn name(node: &Node) -> Result<&str, Wrong> {
    match &node.what {
        What::Name(name) => Ok(name),
        _ => Err((node.at, "expected a name".to_owned())),
    }
}

fn unknown<'a>(at: usize, what: &str, name: &str, known: impl Iterator<Item = &'a str> + Clone) -> Wrong {
    let hint =
        if known.clone().next().is_some() { robogate_core::hint(name, known) } else { "the file has none".to_owned() };
    (at, format!("unknown {what} `{name}`: {hint}"))
}

impl Names {
    /// The parts, then the roles, with the index of each part.
    fn named_parts(&self) -> impl Iterator<Item = (&str, usize)> + Clone {
        let parts = self.parts.iter().enumerate().map(|(of, (name, _))| (name.as_str(), of));
        parts.chain(self.roles.iter().map(|(role, of)| (role.as_str(), *of)))
    }

    fn part_names(&self) -> impl Iterator<Item = &str> + Clone {
        self.named_parts().map(|(name, _)| name)
    }

    fn find_part(&self, wanted: &str) -> Option<usize> {
        self.named_parts().find(|(name, _)| *name == wanted).map(|(_, of)| of)
    }

    fn fixture_names(&self) -> impl Iterator<Item = &str> + Clone {
        self.fixtures.iter().map(|(name, _)| name.as_str())
    }

    /// The index of a part.
    pub(super) fn part_named(&self, at: usize, wanted: &str) -> Result<usize, Wrong> {
        self.find_part(wanted).ok_or_else(|| unknown(at, "part", wanted, self.part_names()))
    }

    pub(super) fn part(&self, node: &Node) -> Result<usize, Wrong> {
        self.part_named(node.at, name(node)?)
    }

    /// The dimension of the joint of a part.
    pub(super) fn joint(&self, at: usize, part: usize) -> Result<Dimension, Wrong> {
        let (name, dimension) = &self.parts[part];
        dimension.ok_or_else(|| (at, format!("part `{name}` has no joint")))
    }

    pub(super) fn body(&self, node: &Node) -> Result<Body, Wrong> {
        let wanted = name(node)?;
        if wanted == "robot" {
            return Ok(Body::Robot);
        }
        if wanted == TABLE {
            return Ok(Body::Fixture(0..1));
        }
        if let Some((_, shapes)) = self.fixtures.iter().find(|(name, _)| name == wanted) {
            return Ok(Body::Fixture(shapes.clone()));
        }
        let known = self.part_names().chain(self.fixture_names()).chain(["robot", TABLE]);
        match self.find_part(wanted) {
            Some(part) => Ok(Body::Part(part)),
            None => Err(unknown(node.at, "body", wanted, known)),
        }
    }

    pub(super) fn place(&self, node: &Node) -> Result<Place, Wrong> {
        self.place_named(node.at, name(node)?)
    }

    /// A place: a body, a point of a part, a region or the tool.
    pub(super) fn place_named(&self, at: usize, wanted: &str) -> Result<Place, Wrong> {
        let origin = |on| Place::new(on, Vector3::zeros());
        if let Some((owner, point)) = wanted.split_once('.')
            && let Some(of) = self.find_part(owner)
        {
            if let Some(place) = self.points.get(&format!("{}.{point}", self.parts[of].0)) {
                return Ok(place.clone());
            }
            if point == "released" {
                return Ok(origin(Frame::Release(of)));
            }
        }
        if let Some(part) = self.find_part(wanted) {
            return Ok(origin(Frame::Part(part)));
        }
        if let Some(fixture) = self.fixture_names().position(|name| name == wanted) {
            return Ok(origin(Frame::Fixture(fixture)));
        }
        if let Some((_, region)) = self.regions.iter().find(|(name, _)| name == wanted) {
            return Ok(Place::new(region.on, region.at));
        }
        match wanted {
            "tool" => Ok(origin(Frame::Tool)),
            TABLE => Ok(origin(Frame::World)),
            _ => {
                let known = self.points.keys().map(String::as_str).chain(self.part_names());
                let known = known.chain(self.fixture_names()).chain(self.regions.iter().map(|(name, _)| &**name));
                Err(unknown(at, "place", wanted, known.chain(["tool"])))
            }
        }
    }

    pub(super) fn region_named(&self, at: usize, wanted: &str) -> Result<Region, Wrong> {
        let region = self.regions.iter().find(|(name, _)| name == wanted).map(|(_, region)| *region);
        region.ok_or_else(|| unknown(at, "region", wanted, self.regions.iter().map(|(name, _)| name.as_str())))
    }

    pub(super) fn region(&self, node: &Node) -> Result<Region, Wrong> {
        self.region_named(node.at, name(node)?)
    }

    /// The index of a parameter, and the dimension of its values.
    pub(super) fn parameter(&self, at: usize, wanted: &str) -> Result<(usize, Dimension), Wrong> {
        let found = self.parameters.iter().position(|(name, _)| name == wanted);
        match found {
            Some(index) => Ok((index, self.parameters[index].1)),
            None => Err(unknown(at, "parameter", wanted, self.parameters.iter().map(|(name, _)| name.as_str()))),
        }
    }

    /// What a path of a parameter starts with: a fixture or a part.
    pub(super) fn frame_named(&self, at: usize, wanted: &str) -> Result<Frame, Wrong> {
        if let Some(part) = self.find_part(wanted) {
            return Ok(Frame::Part(part));
        }
        let known = self.part_names().chain(self.fixture_names()).chain(["scene"]);
        match self.fixture_names().position(|name| name == wanted) {
            Some(fixture) => Ok(Frame::Fixture(fixture)),
            None => Err(unknown(at, "body", wanted, known)),
        }
    }
}
