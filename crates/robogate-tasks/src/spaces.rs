//! The built-in parameter spaces of the tasks for an arm, as TOML.

use robogate_physics::Gripper;

/// The paper's Franka parameter space, as TOML.
pub const FRANKA_SPACE: &str = include_str!("../../../assets/spaces/franka.toml");

const SPACES: [(&str, &str); 11] = [
    ("cell", include_str!("../../../assets/spaces/cell.toml")),
    ("cup-cell", include_str!("../../../assets/spaces/cup-cell.toml")),
    ("franka", FRANKA_SPACE),
    ("franka-graspable", include_str!("../../../assets/spaces/franka-graspable.toml")),
    ("ur", include_str!("../../../assets/spaces/ur.toml")),
    ("learned", include_str!("../../../assets/spaces/learned.toml")),
    ("ur-wide", include_str!("../../../assets/spaces/ur-wide.toml")),
    ("franka-units", include_str!("../../../assets/spaces/franka-units.toml")),
    ("ur-units", include_str!("../../../assets/spaces/ur-units.toml")),
    ("stacking", include_str!("../../../assets/spaces/stacking.toml")),
    ("insertion", include_str!("insertion/space.toml")),
];

/// Names of the built-in parameter spaces.
pub fn built_in_spaces() -> impl Iterator<Item = &'static str> + Clone {
    SPACES.iter().map(|(name, _)| *name)
}

/// The built-in parameter space with this name, as TOML.
pub fn built_in_space(name: &str) -> Option<&'static str> {
    SPACES.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// The name of the distribution of units for a robot with this gripper.
pub(crate) fn unit_space(gripper: &Gripper) -> &'static str {
    match gripper {
        Gripper::ParallelJaw(_) => "franka-units",
        Gripper::Suction(_) => "ur-units",
    }
}
