//! Reads the bodies of a file: fixtures, parts, and the regions in them.

use robogate_physics::{Color, Motion};

use super::document::{Document, Text};
use super::model::{FixtureModel, PartModel, Reading};
use super::names::Region;
use super::numbers::{Frame, Numbers, PartNumbers, Place};
use super::units::Dimension;

impl Reading<'_, '_> {
    fn friction(&mut self, text: Option<&Text>) -> Option<f64> {
        text.and_then(|text| self.number(text, Dimension::NONE, [0.01, 10.0]))
    }

    fn color(&mut self, text: Option<&Text>) -> Option<Color> {
        let text = text?;
        let color = Color::from_hex(&text.text);
        self.problems.take(text, color.ok_or_else(|| format!("`{}`: expected #rrggbb", text.text)))
    }

    pub(super) fn fixtures(&mut self, document: &Document, nominal: &mut Numbers) -> Vec<FixtureModel> {
        let mut fixtures = Vec::new();
        // The table comes first.
        let mut next = 1;
        for table in &document.fixture {
            let name = self.name(&table.name);
            nominal.fixtures.push(self.placed(table.at.as_ref(), table.rotation.as_ref()));
            let motion = self.motion(table);
            nominal.motions.push(motion);
            let shapes = self.shapes(&table.shapes, &table.name).concat();
            for text in table.shapes.iter().flat_map(|shape| [&shape.mass, &shape.density]).flatten() {
                self.problems.of(text, "a fixture has no mass. Leave it out");
            }
            nominal.frictions.push(self.friction(table.friction.as_ref()));
            let color = self.color(table.color.as_ref());
            let range = next..next + shapes.len();
            next = range.end;
            self.names.fixtures.push((name.clone(), range.clone()));
            fixtures.push(FixtureModel { name, shapes, range, touch: table.touch, color });
        }
        fixtures
    }

    pub(super) fn parts(&mut self, document: &Document, nominal: &mut Numbers) -> Vec<PartModel> {
        let mut parts = Vec::new();
        for (index, table) in document.part.iter().enumerate() {
            let name = self.name(&table.name);
            let parent = table.parent.as_ref().and_then(|parent| self.frame(parent, false));
            let placed = self.placed(table.at.as_ref(), table.rotation.as_ref());
            let joint = table.joint.as_ref().map(|joint| self.joint(joint));
            let carried = |motion: &Motion| !matches!(motion, Motion::Belt { .. });
            if let (Some(text), Some(Frame::Fixture(of)), Some(_)) = (&table.parent, parent, joint)
                && nominal.motions[of].as_ref().is_some_and(carried)
            {
                let why =
                    format!("`{}` moves, so a part on a joint cannot be in it. Leave out `in` or `joint`", text.text);
                self.problems.of(text, why);
            }
            let shapes = self.shapes(&table.shapes, &table.name);
            let (mass_kg, bulk) = self.mass(table, &shapes);
            nominal.parts.push(PartNumbers {
                placed,
                mass_kg,
                bulk,
                friction: self.friction(table.friction.as_ref()),
                shapes: shapes.concat(),
                spread_m: self.optional(table.spread.as_ref(), Dimension::LENGTH, [0.0, 1.0], 0.0),
                spin_rad: self.optional(table.spin.as_ref(), Dimension::ANGLE, [0.0, 3.2], 0.0),
                joint: joint.map(|(joint, _)| joint),
            });
            for (point, of) in &table.points {
                let at = self.triple(Some(&of.at), Dimension::LENGTH).into();
                let close_rad = of.close.as_ref().and_then(|text| self.number(text, Dimension::ANGLE, [-6.3, 6.3]));
                let place = Place { close_rad, ..Place::new(Frame::Part(index), at) };
                if point.contains('.') {
                    self.problems.of(&of.at, format!("`{point}` has a dot. Expected a name without one"));
                }
                self.names.points.insert(format!("{name}.{point}"), place);
            }
            let color = self.color(table.color.as_ref());
            self.names.parts.push((name.clone(), joint.map(|(_, dimension)| dimension)));
            let parent = match parent {
                Some(Frame::Fixture(parent)) => Some(parent),
                _ => None,
            };
            parts.push(PartModel { name, parent, start: None, color });
        }
        parts
    }

    /// The frame that `in` names: a fixture, or a part where `parts` allows it.
    fn frame(&mut self, text: &Text, parts: bool) -> Option<Frame> {
        match self.names.frame_named(0, &text.text) {
            Ok(Frame::Part(_)) if !parts => {
                self.problems.of(text, format!("`{}` is a part. Expected a fixture", text.text));
                None
            }
            Ok(frame) => Some(frame),
            Err((_, why)) => {
                self.problems.of(text, why);
                None
            }
        }
    }

    pub(super) fn regions(&mut self, document: &Document) {
        for table in &document.region {
            let name = self.name(&table.name);
            let on = table.parent.as_ref().and_then(|parent| self.frame(parent, true)).unwrap_or(Frame::World);
            let at = self.triple(table.at.as_ref(), Dimension::LENGTH).into();
            let half = self.triple(Some(&table.size), Dimension::LENGTH).map(|edge| 0.5 * edge);
            if half.iter().any(|half| *half <= 0.0) {
                self.problems.of(&table.size, format!("`{}`: expected three edges above 0", table.size.text));
            }
            self.names.regions.push((name, Region { on, at, half }));
        }
    }

    pub(super) fn with_starts(&mut self, document: &Document, mut parts: Vec<PartModel>) -> Vec<PartModel> {
        for (table, part) in document.part.iter().zip(&mut parts) {
            let Some(text) = &table.start else { continue };
            match self.names.region_named(0, &text.text) {
                Ok(Region { on: Frame::Part(_), .. }) => {
                    self.problems.of(text, format!("the region `{}` moves with a part", text.text));
                }
                Ok(_) if table.joint.is_some() => {
                    self.problems.of(text, "a part on a joint does not start in a region. Leave out `start`");
                }
                Ok(region) => {
                    part.start = Some(region);
                    // The draw of the region takes the place of these numbers.
                    for parameter in &document.parameter {
                        let Some(sets) = &parameter.sets else { continue };
                        let own =
                            sets.text.strip_prefix(table.name.text.as_str()).and_then(|rest| rest.strip_prefix('.'));
                        if own.is_some_and(|own| ["at.x", "at.y", "spread"].contains(&own)) {
                            let why = format!(
                                "`{}` has no effect: the part starts anywhere in the region `{}`",
                                sets.text, text.text
                            );
                            self.problems.of(sets, why);
                        }
                    }
                }
                Err((_, why)) => self.problems.of(text, why),
            }
        }
        parts
    }
}
