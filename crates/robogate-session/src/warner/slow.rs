//! Slow motion: after a warning, each action of the policy takes several control periods.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use robogate_core::{
    Action, ActionSpec, Assignment, Command, Fault, Observation, Policy, Seed, TaskInstance, TaskSpec,
};

/// Parts of the names of numbers that are forces: a part of a force is not a slow motion.
const FORCES: [&str; 4] = ["torque", "force", "effort", "current"];

/// Whether the actions of a task can be slowed down.
///
/// # Errors
/// Says which number cannot.
pub(super) fn check(spec: &ActionSpec) -> Result<(), String> {
    let names = spec.vector_names().unwrap_or_default();
    let force = names.iter().find(|name| FORCES.iter().any(|of| name.to_ascii_lowercase().contains(of)));
    force
        .map_or(Ok(()), |name| Err(format!("`{name}` of the action is a force, and a part of it is not a slow motion")))
}

/// A policy in slow motion after a warning. It is asked again when its action is complete, and its clock runs with its actions.
pub(super) struct Slowed {
    policy: Box<dyn Policy>,
    periods: u32,
    warned: Arc<AtomicBool>,
    spec: ActionSpec,
    period_s: f64,
    /// Control periods that are left of the present action.
    left: u32,
    /// Where the present action begins, and the action.
    from: Option<Action>,
    to: Option<Action>,
    /// The time that the policy sees, since the first slow action.
    clock_s: Option<f64>,
}

impl Slowed {
    pub(super) fn new(policy: Box<dyn Policy>, periods: u32, warned: Arc<AtomicBool>) -> Self {
        let spec = ActionSpec::default();
        Self { policy, periods, warned, spec, period_s: 0.0, left: 0, from: None, to: None, clock_s: None }
    }

    fn is_slow(&self) -> bool {
        self.warned.load(Ordering::Relaxed)
    }

    /// The part of the present action in this control period.
    fn part(&self, action: &Action, observation: &Observation) -> Action {
        let (n, done) = (f64::from(self.periods), f64::from(self.periods - self.left));
        let between = |from: f64, to: f64| if self.left == 0 { to } else { from + (to - from) * done / n };
        let before = self.from.as_ref().map(|from| &from.command);
        let command = match (&action.command, before) {
            (Command::JointPosition(to), Some(Command::JointPosition(from))) => {
                Command::JointPosition(from.iter().zip(to).map(|(from, to)| between(*from, *to)).collect())
            }
            (Command::JointPosition(to), _) => {
                let measured = observation.joint_positions();
                let from = |i: usize, to: f64| measured.get(i).copied().unwrap_or(to);
                Command::JointPosition(to.iter().enumerate().map(|(i, to)| between(from(i, *to), *to)).collect())
            }
            (Command::ToolDelta { translation_m, rotation_rad }, _) => Command::ToolDelta {
                translation_m: translation_m.map(|x| x / n),
                rotation_rad: rotation_rad.map(|x| x / n),
            },
            (Command::Vector(to), before) => {
                let from = if let Some(Command::Vector(from)) = before { from } else { to };
                let numbers = to.iter().zip(from).enumerate();
                Command::Vector(numbers.map(|(i, (to, from))| self.number(i, *from, *to, &between)).collect())
            }
        };
        Action { command, ..action.clone() }
    }

    /// A number of a vector: the command of a gripper as it is, a part of a velocity or change, and a position on the way.
    fn number(&self, i: usize, from: f64, to: f64, between: &impl Fn(f64, f64) -> f64) -> f64 {
        let name = self.spec.vector_names().and_then(|names| names.get(i)).map(|name| name.to_ascii_lowercase());
        let bound = |of: &[f64]| of.get(i).copied().unwrap_or(0.0);
        let (low, high) = self.spec.vector().map_or((0.0, 0.0), |(low, high)| (bound(low), bound(high)));
        match name {
            Some(name) if name.contains("grip") => to,
            // As for a robot that waits: symmetric bounds are those of a velocity or a change.
            _ if (low + high).abs() <= 1e-9 * (high - low) => to / f64::from(self.periods),
            _ => between(from, to),
        }
    }
}

impl Policy for Slowed {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.policy.check(task)
    }

    fn note_applied(&mut self, applied: &Assignment) {
        self.policy.note_applied(applied);
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.spec = task.action.clone();
        self.period_s = task.control_period_s;
        (self.left, self.from, self.to, self.clock_s) = (0, None, None, None);
        self.policy.reset(task, instance, seed)
    }

    fn wants_images(&self) -> bool {
        (!self.is_slow() || self.left == 0) && self.policy.wants_images()
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        if !self.is_slow() {
            let action = self.policy.act(observation)?;
            self.to = Some(action.clone());
            return Ok(action);
        }
        if self.left == 0 {
            let time_s = self.clock_s.unwrap_or(observation.time_s);
            let action = self.policy.act(&Observation { time_s, ..observation.clone() })?;
            self.from = self.to.replace(action);
            self.clock_s = Some(time_s + self.period_s);
            self.left = self.periods;
        }
        self.left -= 1;
        match &self.to {
            Some(action) => Ok(self.part(action, observation)),
            None => self.policy.act(observation),
        }
    }

    fn gave_up(&self) -> bool {
        !self.is_slow() && self.policy.gave_up()
    }
}
