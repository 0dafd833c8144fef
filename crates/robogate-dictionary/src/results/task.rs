//! The task of an imported dictionary.

use robogate_core::{
    ActionSpec, Better, DrawSpec, FailureMode, FailureModeSpec, MeasureSpec, ObservationSpec, Severity, TaskSpec, Word,
};

use super::About;

/// The name of a task that the source does not name.
const UNNAMED: Word = Word::constant("imported");

/// Builds a task from the rows of a source. Control period, time limit, observation and action are unknown.
pub(super) fn of_rows(
    about: &About,
    modes: impl IntoIterator<Item = FailureMode>,
    measures: &[Word],
    phases: Vec<Word>,
) -> TaskSpec {
    let mode = |name| FailureModeSpec {
        name,
        meaning: match name {
            FailureMode::UNKNOWN => "The source does not say how the episode failed.".to_owned(),
            _ => String::new(),
        },
        severity: Severity::default(),
        published_as: None,
    };
    let measure =
        |name: &Word| MeasureSpec { name: *name, unit: String::new(), meaning: String::new(), better: Better::Neither };
    TaskSpec {
        name: about.task.unwrap_or(UNNAMED),
        version: 1,
        instruction: String::new(),
        control_period_s: 0.0,
        time_limit_s: 0.0,
        failure_modes: modes.into_iter().map(mode).collect(),
        measures: measures.iter().map(measure).collect(),
        draws: Vec::new(),
        phases,
        stages: Vec::new(),
        parameters: Vec::new(),
        settings: Vec::new(),
        observation: ObservationSpec::default(),
        action: ActionSpec::default(),
        details: serde_json::Value::Null,
    }
}

/// A hidden draw of which only the name is known.
pub(super) fn draw(name: Word) -> DrawSpec {
    DrawSpec { name, unit: String::new(), meaning: String::new() }
}
