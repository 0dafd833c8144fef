//! The referee: evaluates the conditions of a file after every time step.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Assignment, FailureMode, Measures, Word};
use robogate_physics::{Collision, GripperCommand, Hit, Part};

use super::conditions::{Body, Condition, Hand, Now, Value};
use super::model::{Case, How, Model};
use super::numbers::{Draws, Layout, Numbers};
use crate::arm::{Acting, Bodies, Found, Grip, GripChange, Record, Sight, Trial, displacement, still, touching};

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
    /// Grip force, in newtons.
    grip_force_n: f64,
    hand: Hand,
    /// Height at which each part was released, in metres. A part that the gripper closes at has none.
    released_m: Vec<Option<f64>>,
    memory: Vec<f64>,
    reached: usize,
    measured: Vec<Option<f64>>,
    /// The failure of the episode if the time limit passed now, if the file names one.
    at_limit: Option<FailureMode>,
    still: bool,
    /// Time of the last step, in seconds.
    time: f64,
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
        let (grip_force_n, parts) = (grip_force_n * numbers.around.gripper.force_scale, model.parts.len());
        Self {
            grip: Grip::new(grip_force_n),
            grip_force_n,
            starts: None,
            hand: Hand {
                dropped: vec![false; parts],
                lost: vec![false; parts],
                released_at: vec![None; parts],
                ..Hand::default()
            },
            released_m: vec![None; parts],
            memory: vec![f64::INFINITY; model.cases[numbers.word].slots],
            reached: 0,
            measured: vec![None; model.measures.len()],
            at_limit: None,
            still: false,
            time: 0.0,
            record: Record::default(),
            model,
            numbers,
            layout,
            draws,
        }
    }

    fn case(&self) -> &Case {
        &self.model.cases[self.numbers.word]
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
        let (of, hand) = (self.hand.selected, &mut self.hand);
        let name = &self.model.parts[of].name;
        let in_hand = self.grip.in_hand().filter(|_| touching(sight.view));
        hand.slip_m = in_hand.map(|in_hand| displacement(&in_hand, sight.view));
        hand.grip_n = if self.grip.is_free() { 0.0 } else { sight.view.touches.grip(self.grip_force_n) };
        match self.grip.observe(sight.command, sight.time, sight.view) {
            Some(GripChange::Closes) => {
                (self.released_m[of], hand.released) = (None, None);
                self.record.note(format!("gripper closes at {name}"));
            }
            Some(GripChange::Held) => self.record.note(format!("{name} held")),
            // Closing without a part is a failure only where the file says so: a closed gripper can push.
            Some(GripChange::Missed) => {
                // A gripper that stays closed misses in every step.
                if !hand.missed {
                    self.record.note("the gripper closed without a part");
                }
                hand.missed = true;
            }
            Some(GripChange::Lost) => {
                self.record.note(format!("{name} lost"));
                (hand.dropped[of], hand.lost[of]) = (true, true);
            }
            Some(GripChange::Released) => {
                let at = sight.view.object.translation.vector;
                self.record.note(format!("{name} released"));
                (self.released_m[of], hand.released_at[of], hand.released) = (Some(at.z), Some(at), Some(of));
            }
            None => {}
        }
        for (of, released) in self.released_m.iter().enumerate() {
            let falls = |height: f64| sight.bodies.pose(of).translation.z < height - FALL_M;
            self.hand.dropped[of] |= self.numbers.parts[of].joint.is_none() && released.is_some_and(falls);
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
            let near = |of: usize| distance(&self.numbers.parts[of].shapes, &bodies.pose(of), &tcp.translation.vector);
            let nearest = (0..self.model.parts.len()).min_by(|a, b| near(*a).total_cmp(&near(*b)));
            self.hand.selected = nearest.unwrap_or(self.hand.selected);
        }
        Some(self.hand.selected)
    }

    fn at_rest(&self) -> bool {
        let case = self.case();
        let mut conditions = case.conditions().chain(case.named.iter().map(|(condition, _)| condition));
        let changes = |of: &Condition| of.can_change_at_rest(&self.memory, &self.numbers.values, self.time);
        self.still && !self.record.is_over() && !conditions.any(changes)
    }

    fn observe(&mut self, sight: &Sight<'_>) {
        if self.record.is_over() {
            return;
        }
        let parts = self.model.parts.len();
        self.time = sight.time;
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
            parts: &self.numbers.parts,
            starts: &starts,
            held: self.grip.in_hand().map(|_| self.hand.selected),
            hand: &self.hand,
        };
        let (model, memory) = (&self.model, &mut self.memory);
        let case = &model.cases[self.numbers.word];
        for (condition, slot) in &case.named {
            memory[*slot] = if condition.now(&now, memory) { sight.time } else { f64::INFINITY };
        }
        for (measure, so_far) in case.measures.iter().zip(&mut self.measured) {
            for of in measure {
                let counts = of.when.as_ref().is_none_or(|when| when.now(&now, memory));
                let known = |value: &Value| Some(value.now(&now)).filter(|value| counts && !value.is_nan());
                *so_far = match &of.how {
                    How::Max(value) => known(value).map(|x| so_far.map_or(x, |so_far| so_far.max(x))).or(*so_far),
                    How::Min(value) => known(value).map(|x| so_far.map_or(x, |so_far| so_far.min(x))).or(*so_far),
                    How::Final(value) => known(value).or(*so_far),
                    How::First(condition) => {
                        let holds = condition.now(&now, memory) && counts;
                        so_far.or_else(|| holds.then_some(sight.time))
                    }
                };
            }
        }
        for (index, (name, when)) in model.stages.iter().zip(&case.stages).enumerate() {
            if when.now(&now, memory) && index == self.reached {
                self.reached += 1;
                self.record.note(format!("stage {name}"));
            }
        }
        let success = case.success.as_ref().is_some_and(|success| success.now(&now, memory));
        let (mut failure, mut at_limit) = (None, None);
        for ((mode, table), when) in model.failures.iter().zip(&model.document.failure).zip(&case.failures) {
            let first = if table.at_limit { &mut at_limit } else { &mut failure };
            if when.now(&now, memory) {
                *first = first.or(Some(*mode));
            }
        }
        self.at_limit = at_limit;
        match self.collision(&now) {
            Some(collision) => self.record.end(Some(COLLISION), sight.time, Some(collision)),
            None if failure.is_some() => self.record.end(failure, sight.time, None),
            None if success => self.record.end(None, sight.time, None),
            None => {}
        }
        self.starts = Some(starts);
    }

    fn measures(&self) -> Measures {
        let own = self.model.measures.iter().zip(&self.measured).map(|((name, _), value)| (*name, *value));
        let stages = (!self.model.stages.is_empty()).then_some((STAGES, Some(self.reached as f64)));
        own.chain(stages).collect()
    }

    fn record(&mut self) -> &mut Record {
        &mut self.record
    }

    fn mode_at_limit(&self) -> FailureMode {
        self.at_limit.unwrap_or(FailureMode::TIMEOUT)
    }
}
