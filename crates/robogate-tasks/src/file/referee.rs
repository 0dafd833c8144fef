//! The referee: evaluates the conditions of a file after every time step.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Assignment, FailureMode, Measures, Word};
use robogate_physics::{Collision, GripperCommand, Hit, Part};

use super::conditions::{Body, Now};
use super::model::{Measured, Model};
use super::numbers::{Draws, Layout, Numbers};
use crate::arm::{Acting, Bodies, Found, Grip, GripChange, Record, Sight, Trial, still};

/// The robot touched a fixture that it may not touch, or itself.
pub(super) const COLLISION: FailureMode = FailureMode::constant("collision");
/// A part is dropped if it falls by more than this after its release, in metres.
const FALL_M: f64 = 0.02;
/// Number of stages that were reached.
pub(super) const STAGES: Word = Word::constant("stages");

/// The referee of one episode.
pub(super) struct Referee {
    model: Arc<Model>,
    numbers: Numbers,
    layout: Layout,
    draws: Vec<Draws>,
    /// Positions of the parts at the first step.
    starts: Option<Vec<Vector3<f64>>>,
    grip: Grip,
    selected: usize,
    dropped: Vec<bool>,
    /// Height at which each part was released, in metres.
    released_m: Vec<Option<f64>>,
    memory: Vec<f64>,
    reached: usize,
    measured: Vec<Option<f64>>,
    still: bool,
    record: Record,
}

impl Referee {
    pub(super) fn new(
        model: Arc<Model>,
        numbers: Numbers,
        layout: Layout,
        draws: Vec<Draws>,
        grip_force_n: f64,
    ) -> Self {
        Self {
            grip: Grip::new(grip_force_n * numbers.around.gripper.force_scale),
            starts: None,
            selected: 0,
            dropped: vec![false; model.parts.len()],
            released_m: vec![None; model.parts.len()],
            memory: vec![f64::INFINITY; model.slots],
            reached: 0,
            measured: vec![None; model.measures.len()],
            still: false,
            record: Record::default(),
            model,
            numbers,
            layout,
            draws,
        }
    }

    /// The contact of this step that is a collision.
    fn collision(&self, now: &Now<'_>) -> Option<Collision> {
        let strongest = now.sight.view.touches.collision?;
        let fixture = |index: usize| self.model.fixtures.iter().find(|fixture| fixture.range.contains(&index));
        let allowed = match strongest.hit {
            Hit::Fixture(index) => fixture(index).is_some_and(|fixture| fixture.touch),
            Hit::Itself(_) => false,
        };
        if !allowed {
            return Some(strongest);
        }
        // A weaker contact with another fixture is one too.
        let others = self.model.fixtures.iter().filter(|fixture| !fixture.touch).map(|fixture| fixture.range.clone());
        let mut others = std::iter::once(0..1).chain(others).flatten();
        let hit = others.find(|index| now.force(&Body::Robot, &Body::Fixture(*index..*index + 1)).is_some())?;
        Some(Collision { hit: Hit::Fixture(hit), ..strongest })
    }

    fn follow_grip(&mut self, sight: &Sight<'_>) {
        let name = &self.model.parts[self.selected].name;
        match self.grip.observe(sight.command, sight.time, sight.view) {
            Some(GripChange::Closes) => {
                self.released_m[self.selected] = None;
                self.record.note("gripper closes");
            }
            Some(GripChange::Held) => self.record.note(format!("{name} held")),
            // Closing without a part is no failure here: a closed gripper can push.
            Some(GripChange::Missed) | None => {}
            Some(GripChange::Lost) => {
                self.record.note(format!("{name} lost"));
                self.dropped[self.selected] = true;
            }
            Some(GripChange::Released) => {
                self.record.note(format!("{name} released"));
                self.released_m[self.selected] = Some(sight.view.object.translation.z);
            }
        }
        for (of, released) in self.released_m.iter().enumerate() {
            let falls = |height: f64| sight.bodies.pose(of).translation.z < height - FALL_M;
            self.dropped[of] |= self.numbers.parts[of].joint.is_none() && released.is_some_and(falls);
        }
    }
}

/// Distance of a point (m) to the nearest box around a shape of a part at this pose, in metres.
fn distance(shapes: &[Part], pose: &Isometry3<f64>, point: &Vector3<f64>) -> f64 {
    let of = |part: &Part| {
        let local = (pose * part.pose).inverse_transform_point(&(*point).into());
        (local.coords.abs() - Vector3::from(part.primitive.half_extent())).sup(&Vector3::zeros()).norm()
    };
    shapes.iter().map(of).fold(f64::INFINITY, f64::min)
}

impl Trial for Referee {
    fn applied(&self, requested: &Assignment, found: &Found<'_>, bias: &[f64]) -> Assignment {
        let acting = Acting { settings: &self.numbers, around: &self.numbers.around, found, bias };
        self.model.applied(requested, &acting, &self.draws)
    }

    fn select(&mut self, command: GripperCommand, tcp: &Isometry3<f64>, bodies: &dyn Bodies) -> Option<usize> {
        // An open gripper that closes acts on the nearest part.
        if command == GripperCommand::Close && self.grip.is_free() {
            let near = |of: usize| distance(&self.model.parts[of].shapes, &bodies.pose(of), &tcp.translation.vector);
            let nearest = (0..self.model.parts.len()).min_by(|a, b| near(*a).total_cmp(&near(*b)));
            self.selected = nearest.unwrap_or(self.selected);
        }
        Some(self.selected)
    }

    fn at_rest(&self) -> bool {
        let model = &self.model;
        let conditions = std::iter::once(&model.success).chain(model.failures.iter().map(|failure| &failure.when));
        let mut conditions = conditions.chain(model.stages.iter().map(|(_, when)| when));
        self.still && !self.record.is_over() && !conditions.any(|of| of.can_change_at_rest(&self.memory))
    }

    fn observe(&mut self, sight: &Sight<'_>) {
        if self.record.is_over() {
            return;
        }
        let parts = self.model.parts.len();
        self.still = self.grip.is_free() && sight.command == GripperCommand::Open && still(sight.bodies, parts);
        self.follow_grip(sight);
        let starts = self
            .starts
            .take()
            .unwrap_or_else(|| (0..parts).map(|of| sight.bodies.pose(of).translation.vector).collect());
        let now = Now {
            sight,
            layout: &self.layout,
            values: &self.numbers.values,
            starts: &starts,
            held: self.grip.in_hand().map(|_| self.selected),
            dropped: &self.dropped,
        };
        let (model, memory) = (&self.model, &mut self.memory);
        for (measure, so_far) in model.measures.iter().zip(&mut self.measured) {
            *so_far = match &measure.of {
                Measured::Max(value) => Some(so_far.unwrap_or(f64::NEG_INFINITY).max(value.now(&now))),
                Measured::Min(value) => Some(so_far.unwrap_or(f64::INFINITY).min(value.now(&now))),
                Measured::Final(value) => Some(value.now(&now)),
                Measured::First(condition) => {
                    let holds = condition.now(&now, memory);
                    so_far.or_else(|| holds.then_some(sight.time))
                }
            };
        }
        for (index, (name, when)) in model.stages.iter().enumerate() {
            if when.now(&now, memory) && index == self.reached {
                self.reached += 1;
                self.record.note(format!("stage {name}"));
            }
        }
        let success = model.success.now(&now, memory);
        let mut failure = None;
        for of in &model.failures {
            if of.when.now(&now, memory) {
                failure = failure.or(Some(of.mode));
            }
        }
        match self.collision(&now) {
            Some(collision) => self.record.end(Some(COLLISION), sight.time, Some(collision)),
            None if failure.is_some() => self.record.end(failure, sight.time, None),
            None if success => self.record.end(None, sight.time, None),
            None => {}
        }
        self.starts = Some(starts);
    }

    fn measures(&self) -> Measures {
        let own = self.model.measures.iter().zip(&self.measured).map(|(measure, value)| (measure.name, *value));
        let stages = (!self.model.stages.is_empty()).then_some((STAGES, Some(self.reached as f64)));
        own.chain(stages).collect()
    }

    fn record(&mut self) -> &mut Record {
        &mut self.record
    }
}
