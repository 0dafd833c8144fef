//! Gripper commands.

use robogate_core::Action;

/// A gripper command. All grippers are binary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GripperCommand {
    /// Open fully, or release.
    Open,
    /// Close with the set force, or grip.
    Close,
}

impl GripperCommand {
    /// The command of an action: close if its number is above 0. Without a number the gripper opens.
    pub fn of(action: &Action) -> Self {
        if action.gripper.is_some_and(|command| command > 0.0) { Self::Close } else { Self::Open }
    }

    /// The command as the number in an [`Action`].
    pub fn number(self) -> f64 {
        match self {
            Self::Open => Action::OPEN,
            Self::Close => Action::CLOSE,
        }
    }
}
