//! Errors in parameters.

/// The reason why the task does not accept a parameter.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParameterError {
    /// The task has no parameter of this name.
    #[error("unknown parameter `{parameter}`. Expected one of: {known}")]
    Unknown {
        /// The name.
        parameter: String,
        /// The known names.
        known: String,
    },
    /// This robot's gripper does not have the parameter.
    #[error("parameter `{parameter}` does not apply to this robot: its gripper is {gripper}")]
    Gripper {
        /// The name.
        parameter: String,
        /// The gripper's kind.
        gripper: &'static str,
    },
    /// The value has the wrong kind.
    #[error("parameter `{parameter}` has a value of the wrong kind. Expected {expected}")]
    Kind {
        /// The name.
        parameter: String,
        /// The expected kind.
        expected: &'static str,
    },
    /// The value is out of range.
    #[error("parameter `{parameter}` = {value} is out of range. Expected {low} to {high}")]
    Range {
        /// The name.
        parameter: String,
        /// The value.
        value: f64,
        /// Smallest accepted value.
        low: f64,
        /// Largest accepted value.
        high: f64,
    },
    /// The word is not one of the parameter's choices.
    #[error("parameter `{parameter}`: unknown value `{choice}`. Expected {expected}")]
    Choice {
        /// The name.
        parameter: String,
        /// The word.
        choice: String,
        /// The expected words.
        expected: String,
    },
}
