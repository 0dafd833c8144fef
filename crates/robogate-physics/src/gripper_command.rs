//! What a gripper is told.

use robogate_core::Action;

/// What a gripper is told. Every gripper here is binary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GripperCommand {
    /// Open fully, or let go.
    Open,
    /// Close with the set force, or take hold.
    Close,
}

impl GripperCommand {
    /// The command of an action: above 0 it closes. Without one the gripper opens.
    pub fn of(action: &Action) -> Self {
        if action.gripper.is_some_and(|command| command > 0.0) { Self::Close } else { Self::Open }
    }

    /// The same as the number in an [`Action`].
    pub fn number(self) -> f64 {
        match self {
            Self::Open => Action::OPEN,
            Self::Close => Action::CLOSE,
        }
    }
}
