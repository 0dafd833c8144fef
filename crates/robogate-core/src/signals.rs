//! The signals of an episode: one row of numbers for each control period.
//!
//! A row contains what the policy saw and did: the observed vectors, the command, and the command of the gripper, in this
//! order. [`Signals`] names the numbers. They follow from the task alone, so a recorded row and a row on the real robot have
//! the same order.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Action, ActionSpace, Command, Measures, Observation, TaskSpec};

/// What the numbers of a group are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SignalKind {
    /// An observed vector.
    Observation,
    /// A command to the arm. Its name is that of its [`ActionSpace`].
    Command,
    /// The command of the gripper: from -1 (open) to 1 (closed).
    Gripper,
}

/// Numbers that belong together.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SignalGroup {
    /// The name of the vector or of the kind of command.
    pub name: String,
    /// What the numbers are.
    pub kind: SignalKind,
    /// How many there are.
    pub length: usize,
    /// The unit. Empty for numbers without unit or with different units.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
}

/// The order of the numbers of a row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Signals {
    /// Time between two rows, in seconds.
    pub period_s: f64,
    /// The groups, in order.
    pub groups: Vec<SignalGroup>,
    /// The number of a vector command that closes the gripper, counted from 0, and the value above which it does. Absent if the
    /// command of the gripper is a group of its own, or if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper_in_vector: Option<(usize, f64)>,
}

impl Signals {
    /// The signals of a task. A number of a vector command whose name contains `grip` is the command of the gripper; it closes
    /// in the upper half of its range.
    pub fn of(task: &TaskSpec) -> Self {
        let group = |name: &str, kind, length, unit: &str| SignalGroup {
            name: name.to_owned(),
            kind,
            length,
            unit: unit.to_owned(),
        };
        let vectors = task.observation.vectors.iter();
        let observed = vectors.map(|of| group(of.name.as_str(), SignalKind::Observation, of.length, &of.unit));
        let commands = task.action.spaces.iter().map(|space| {
            let length = match space {
                ActionSpace::JointPosition { joints } => joints.len(),
                ActionSpace::ToolDelta { .. } => 6,
                ActionSpace::Vector { names, .. } => names.len(),
            };
            group(space.as_str(), SignalKind::Command, length, "")
        });
        let gripper = task.action.gripper.map(|_| group("gripper", SignalKind::Gripper, 1, ""));
        let gripper_in_vector = match (&gripper, task.action.vector_names(), task.action.vector()) {
            (None, Some(names), Some((low, high))) => {
                let at = names.iter().position(|name| name.to_ascii_lowercase().contains("grip"));
                at.map(|at| (at, 0.5 * (low[at] + high[at])))
            }
            _ => None,
        };
        Self {
            period_s: task.control_period_s,
            groups: observed.chain(commands).chain(gripper).collect(),
            gripper_in_vector,
        }
    }

    /// The number of numbers of a row.
    pub fn width(&self) -> usize {
        self.groups.iter().map(|group| group.length).sum()
    }

    /// The number of numbers of a row of groups from a file. `None` if it overflows.
    pub fn checked_width(&self) -> Option<usize> {
        self.groups.iter().try_fold(0_usize, |sum, group| sum.checked_add(group.length))
    }

    /// The groups with the place of their first number.
    pub fn places(&self) -> impl Iterator<Item = (usize, &SignalGroup)> {
        self.groups.iter().scan(0, |next, group| {
            let at = *next;
            *next += group.length;
            Some((at, group))
        })
    }

    /// Writes a row: NaN for what the observation or the action lacks. `row` has [`Self::width`] numbers.
    pub fn write(&self, observation: &Observation, action: &Action, row: &mut [f32]) {
        row.fill(f32::NAN);
        for (at, group) in self.places() {
            let Some(to) = row.get_mut(at..at + group.length) else { return };
            match (group.kind, &action.command) {
                (SignalKind::Observation, _) => fill(to, observation.vector(&group.name).unwrap_or_default()),
                (SignalKind::Gripper, _) => fill(to, action.gripper.as_slice()),
                (SignalKind::Command, Command::JointPosition(values)) if group.name == "joint_position" => {
                    fill(to, values);
                }
                (SignalKind::Command, Command::Vector(values)) if group.name == "vector" => fill(to, values),
                (SignalKind::Command, Command::ToolDelta { translation_m, rotation_rad })
                    if group.name == "tool_delta" =>
                {
                    fill(&mut to[..3], translation_m);
                    fill(&mut to[3..], rotation_rad);
                }
                (SignalKind::Command, _) => {}
            }
        }
    }

    /// The place of the gripper's command in a row, and the value above which it closes. `None` if the task has no gripper.
    pub fn gripper(&self) -> Option<(usize, f64)> {
        self.places().find_map(|(at, group)| match (group.kind, self.gripper_in_vector) {
            (SignalKind::Gripper, _) => Some((at, 0.0)),
            (SignalKind::Command, Some((of, above))) if group.name == "vector" => Some((at + of, above)),
            _ => None,
        })
    }
}

/// The measures of a control period as numbers, in the order of the task: NaN for one that was not measured.
pub fn measure_row(task: &TaskSpec, measures: &Measures, row: &mut [f32]) {
    for (to, spec) in row.iter_mut().zip(&task.measures) {
        *to = measures.get(spec.name.as_str()).map_or(f32::NAN, |x| x as f32);
    }
}

fn fill(to: &mut [f32], from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, x)| *to = *x as f32);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ActionSpec, ObservationSpec, VectorSpec, Word};

    fn task(action: ActionSpec) -> TaskSpec {
        let word = Word::constant("position");
        let vectors = vec![VectorSpec { name: word, length: 2, unit: "m".to_owned() }];
        TaskSpec {
            name: Word::constant("reach"),
            version: 1,
            instruction: String::new(),
            control_period_s: 0.05,
            time_limit_s: 1.0,
            failure_modes: Vec::new(),
            measures: Vec::new(),
            draws: Vec::new(),
            phases: Vec::new(),
            stages: Vec::new(),
            parameters: Vec::new(),
            settings: Vec::new(),
            observation: ObservationSpec { vectors, cameras: Vec::new() },
            action,
            details: serde_json::Value::Null,
        }
    }

    /// Whether a row commands the gripper to close.
    fn closes_in(signals: &Signals, row: &[f32]) -> Option<bool> {
        signals.gripper().map(|(at, above)| f64::from(row[at]) > above)
    }

    #[test]
    fn vector_with_a_gripper_closes() {
        let names = ["x".to_owned(), "Gripper_effort".to_owned()].to_vec();
        let vector = ActionSpace::Vector { names, low: vec![-1.0, 0.0], high: vec![1.0, 1.0] };
        let signals = Signals::of(&task(ActionSpec { spaces: vec![vector], gripper: None }));
        assert_eq!(signals.width(), 4);
        let observation =
            Observation { vectors: vec![(Word::constant("position"), vec![0.1, 0.2])], ..Default::default() };
        let mut row = [0.0; 4];
        for (effort, closes) in [(0.4, false), (0.6, true)] {
            let command = Command::Vector(vec![0.5, effort]);
            signals.write(&observation, &Action { command, gripper: None, phase: None }, &mut row);
            assert_eq!(row, [0.1, 0.2, 0.5, effort as f32]);
            assert_eq!(closes_in(&signals, &row), Some(closes));
        }
    }

    #[test]
    fn command_of_another_kind_is_missing() {
        let joints = ActionSpace::JointPosition { joints: vec!["a".to_owned()] };
        let delta = ActionSpace::ToolDelta { translation_m: 0.1, rotation_rad: 0.1 };
        let spec = ActionSpec { spaces: vec![joints, delta], gripper: Some(crate::GripperKind::Binary) };
        let signals = Signals::of(&task(spec));
        let mut row = [0.0; 10];
        let action = Action { command: Command::JointPosition(vec![0.7]), gripper: Some(1.0), phase: None };
        signals.write(&Observation::default(), &action, &mut row);
        assert!(row[..2].iter().chain(&row[3..9]).all(|x| x.is_nan()), "{row:?}");
        assert_eq!((row[2], row[9], closes_in(&signals, &row)), (0.7, 1.0, Some(true)));
    }
}
