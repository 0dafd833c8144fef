//! Contact forces of the robot by region, and contacts that are too hard.

use std::collections::VecDeque;

use robogate_core::{
    Better, Contacting, FailureMode, MeasureSpec, Measures, PEAK_CONTACT_FORCE, QUASI_STATIC_S, Region, Touched,
    VectorSpec, Word, region_pairs, vectors,
};
use robogate_physics::{GripperCommand, Robot, Wrench};

use super::grip::touching;
use super::rules::{Record, Sight};
use super::{ArmSettings, WristSensor, measure};

/// A contact with too much force.
pub(crate) const STRUCK: FailureMode = FailureMode::constant("struck");
/// Time with a contact force above the limit, in seconds.
const OVER_LIMIT: Word = Word::constant("contact_over_limit_s");
/// Impulse of the contact with the largest force, in N s.
const IMPULSE: Word = Word::constant("peak_contact_impulse_n_s");
/// The limit for robots whose file states none, in newtons: the factory setting of the controllers of Universal Robots.
const USUAL_LIMIT_N: f64 = 150.0;

/// The limit of contact forces on this robot, in newtons. `chosen` is that of the task's settings.
pub(crate) fn limit_n(robot: &Robot, chosen: Option<f64>) -> f64 {
    chosen.or(robot.settings.arm.collision_force_n).unwrap_or(USUAL_LIMIT_N)
}

/// The contact forces of one episode.
#[derive(Debug, Clone)]
pub(crate) struct Forces {
    /// `None` if no contact is too hard.
    limit_n: Option<f64>,
    /// Normal force of each pad, in newtons.
    grip_force_n: f64,
    /// Whether the gripper closes or holds, or has not let go yet.
    grips: bool,
    /// Time of the last time step, in seconds.
    before: f64,
    peak_n: Option<f64>,
    over_limit_s: f64,
    /// The forces of each region of the robot on parts and on its surroundings, as [`region_pairs`] lists them.
    loads: [Load; 6],
    /// The largest force of all regions (N), and the impulse of its contact so far (N s).
    hardest: Option<(f64, f64)>,
    /// The index of that contact's load, until it ends.
    hardest_load: Option<usize>,
}

/// The force of one region of the robot on one kind of thing.
#[derive(Debug, Clone, Default)]
struct Load {
    peak_n: Option<f64>,
    /// The largest mean force over [`QUASI_STATIC_S`], in newtons.
    held_n: f64,
    /// Time (s) and impulse (N s) of each step of the last [`QUASI_STATIC_S`] with a contact.
    window: VecDeque<(f64, f64)>,
    /// Impulse of the present contact, in N s.
    impulse: f64,
}

impl Load {
    /// Observes the force (N) of a time step that ends at `time` and lasts `step` (s).
    fn feel(&mut self, force: Option<f64>, time: f64, step: f64) {
        while self.window.front().is_some_and(|(at, _)| *at <= time - QUASI_STATIC_S + 0.5 * step) {
            self.window.pop_front();
        }
        let Some(force) = force else {
            self.impulse = 0.0;
            return;
        };
        self.impulse += force * step;
        self.window.push_back((time, force * step));
        self.peak_n = Some(self.peak_n.unwrap_or(0.0).max(force));
        // A sum that only grows and shrinks would collect rounding errors.
        let held_n = self.window.iter().map(|(_, impulse)| impulse).sum::<f64>() / QUASI_STATIC_S;
        self.held_n = self.held_n.max(held_n);
    }
}

impl Forces {
    /// Before the first step. The pads press with `grip_force_n` newtons each.
    pub(crate) fn new(limit_n: Option<f64>, grip_force_n: f64) -> Self {
        Self {
            limit_n,
            grip_force_n,
            grips: false,
            before: 0.0,
            peak_n: None,
            over_limit_s: 0.0,
            loads: Default::default(),
            hardest: None,
            hardest_load: None,
        }
    }

    /// Observes one time step. A contact above the limit ends the episode, however short it is. While the gripper closes, holds or
    /// lets go, its force is added to the limit.
    pub(crate) fn feel(&mut self, sight: &Sight<'_>, record: &mut Record) {
        let step = sight.time - self.before;
        self.before = sight.time;
        self.feel_regions(sight, step);
        let force = sight.view.touches.peak_force;
        self.peak_n = force.map_or(self.peak_n, |force| Some(self.peak_n.unwrap_or(0.0).max(force)));
        let Some(limit_n) = self.limit_n else { return };
        self.grips = sight.command == GripperCommand::Close || self.grips && touching(sight.view);
        let grip = if self.grips { sight.view.touches.grip(self.grip_force_n) } else { 0.0 };
        let Some(force) = force.filter(|force| *force > limit_n + grip) else { return };
        self.over_limit_s += step;
        if !record.is_over() {
            record.note(format!("struck: contact force {force:.0} N"));
            record.end(Some(STRUCK), sight.time, sight.view.touches.collision);
        }
    }

    fn feel_regions(&mut self, sight: &Sight<'_>, step: f64) {
        for (index, ((region, touched), load)) in region_pairs().zip(&mut self.loads).enumerate() {
            let force = sight.view.touches.regions.get(region, touched);
            load.feel(force, sight.time, step);
            let largest = self.hardest.map_or(-1.0, |(largest, _)| largest);
            match force {
                Some(force) if force > largest => {
                    self.hardest = Some((force, load.impulse));
                    self.hardest_load = Some(index);
                }
                Some(_) if self.hardest_load == Some(index) => self.hardest = Some((largest, load.impulse)),
                None if self.hardest_load == Some(index) => self.hardest_load = None,
                _ => {}
            }
        }
    }

    /// Adds its measures.
    pub(crate) fn measure(&self, measures: &mut Measures) {
        measures.set(PEAK_CONTACT_FORCE, self.peak_n);
        measures.set(OVER_LIMIT, self.limit_n.map(|_| self.over_limit_s));
        measures.set(IMPULSE, self.hardest.map(|(_, impulse)| impulse));
        for ((region, touched), load) in region_pairs().zip(&self.loads) {
            measures.set(Contacting::Transient.measure(region, touched), load.peak_n);
            measures.set(Contacting::QuasiStatic.measure(region, touched), load.peak_n.map(|_| load.held_n));
        }
    }
}

/// The measures of this robot beside [`PEAK_CONTACT_FORCE`], for a task with or without a limit of forces.
pub(crate) fn force_measures(robot: &Robot, limited: bool) -> Vec<MeasureSpec> {
    let over = measure(OVER_LIMIT, "s", Better::Lower, "Time with a contact force above the limit.");
    let impulse = measure(IMPULSE, "N s", Better::Lower, "Impulse of the contact with the largest force.");
    let mut measures: Vec<MeasureSpec> = limited.then_some(over).into_iter().chain([impulse]).collect();
    let has_fingers = robot.settings.gripper.jaw().is_some();
    for (region, touched) in region_pairs().filter(|(region, _)| has_fingers || *region != Region::Fingers) {
        let one = match region {
            Region::Arm => "a link of the arm",
            Region::Hand => "the hand",
            Region::Fingers => "a finger",
        };
        let other = match touched {
            Touched::Part => "parts",
            Touched::Surroundings => "anything but a part",
        };
        for kind in Contacting::ALL {
            let what = match kind {
                Contacting::Transient => "Largest normal force".to_owned(),
                Contacting::QuasiStatic => format!("Largest mean normal force over {QUASI_STATIC_S} s"),
            };
            let meaning = format!("{what} of {one} on {other}.");
            measures.push(measure(kind.measure(region, touched), "N", Better::Lower, &meaning));
        }
    }
    measures
}

/// A sensor of force and torque at the wrist.
#[derive(Debug, Clone, Default)]
pub(crate) struct Wrist {
    sum: [f64; 6],
    steps: u32,
}

impl Wrist {
    /// The vector that policies observe.
    pub(crate) fn spec() -> VectorSpec {
        VectorSpec { name: vectors::WRIST_WRENCH, length: 6, unit: "N, N m".to_owned() }
    }

    /// Measures one time step.
    pub(crate) fn feel(&mut self, wrench: &Wrench) {
        let now = wrench.force.iter().chain(&wrench.torque);
        self.sum.iter_mut().zip(now).for_each(|(sum, now)| *sum += now);
        self.steps += 1;
    }

    /// The mean over the control period that ends: force (N) and torque (N m). Zero before the first one.
    pub(crate) fn take(&mut self) -> Vec<f64> {
        let Self { sum, steps } = std::mem::take(self);
        sum.iter().map(|sum| sum / f64::from(steps.max(1))).collect()
    }
}

/// Checks that an engine which does not report the force at the wrist can run a task with these settings.
///
/// # Errors
/// If the task has a sensor at the wrist.
pub(crate) fn no_wrist_sensor(settings: &ArmSettings) -> Result<(), String> {
    match settings.wrist_sensor {
        WristSensor::Off => Ok(()),
        WristSensor::On => Err("wrist_sensor: only MuJoCo in this process reports the force at the wrist\n\
                                Hint: use --engine mujoco, or leave --set wrist_sensor=on out"
            .to_owned()),
    }
}
