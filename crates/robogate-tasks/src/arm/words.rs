//! The declaration of a task for an arm, and its briefings.

use robogate_core::{
    Better, CameraSpec, FEASIBLE, FailureMode, FailureModeSpec, Fault, FaultKind, GAVE_UP, MeasureSpec,
    ObservationSpec, PEAK_CONTACT_FORCE, Severity, TaskInstance, TaskSpec, Word,
};
use robogate_physics::Robot;
use serde::{Deserialize, Serialize};

use super::{CONTROL_PERIOD_S, action_spec, observed_vectors};

/// The specification that every task on this robot with these cameras extends.
pub(crate) fn base_spec(name: &'static str, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
    TaskSpec {
        name: Word::constant(name),
        version: 1,
        instruction: String::new(),
        control_period_s: CONTROL_PERIOD_S,
        time_limit_s: 0.0,
        failure_modes: Vec::new(),
        draws: Vec::new(),
        measures: Vec::new(),
        phases: Vec::new(),
        stages: Vec::new(),
        parameters: Vec::new(),
        settings: Vec::new(),
        observation: ObservationSpec { vectors: observed_vectors(robot), cameras },
        action: action_spec(robot),
        details: serde_json::Value::Null,
    }
}

/// An episode whose details are a briefing.
pub(crate) fn instance(instruction: String, briefing: &impl Serialize) -> TaskInstance {
    // Strings and finite numbers cannot fail to serialise.
    TaskInstance { instruction, details: serde_json::to_value(briefing).unwrap_or_default() }
}

/// Reads the briefing of the task `name` from the details of an episode.
///
/// # Errors
/// A setup fault if the details are not a briefing of this task.
pub(crate) fn briefing<'a, B: Deserialize<'a>>(name: &str, instance: &'a TaskInstance) -> Result<B, Fault> {
    B::deserialize(&instance.details).map_err(|why| not_a_briefing(name, &why.to_string()))
}

/// The fault of an episode whose details are not a briefing of the task `name`.
pub(crate) fn not_a_briefing(name: &str, why: &str) -> Fault {
    Fault::new(FaultKind::Setup, format!("the episode details are not a briefing of {name}: {why}"))
}

/// A failure mode that published exports name by its own word.
pub(crate) fn mode(name: FailureMode, severity: Severity, meaning: &str) -> FailureModeSpec {
    FailureModeSpec { name, meaning: meaning.to_owned(), severity, published_as: None }
}

/// Measures that every task on an arm has: the largest contact force, whether a scenario is feasible, and when the policy gave up.
pub(crate) fn common_measures() -> [MeasureSpec; 3] {
    [
        measure(PEAK_CONTACT_FORCE, "N", Better::Lower, "Largest normal force between the robot and anything."),
        measure(FEASIBLE, "", Better::Neither, "1 if some policy may complete the scenario, 0 if none can."),
        measure(GAVE_UP, "s", Better::Neither, "Time at which the policy gave up."),
    ]
}

/// A measure.
pub(crate) fn measure(name: Word, unit: &str, better: Better, meaning: &str) -> MeasureSpec {
    MeasureSpec { name, unit: unit.to_owned(), meaning: meaning.to_owned(), better }
}
