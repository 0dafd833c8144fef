//! Plans that come with RoboGate.

use std::fmt;

use super::{Plan, PlanError};

/// A built-in plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// A quick overview with the active design: 3,000 episodes.
    #[default]
    Quick,
    /// The paper's two stages: 10,000 + 10,000 episodes.
    Paper,
}

impl Preset {
    /// Every preset.
    pub const ALL: [Self; 2] = [Self::Quick, Self::Paper];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quick => "quick",
            Self::Paper => "paper",
        }
    }

    /// The preset with this name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| preset.name() == name)
    }

    /// The commented TOML text, which documents every setting.
    pub fn text(self) -> &'static str {
        match self {
            Self::Quick => include_str!("../../../../assets/presets/quick.toml"),
            Self::Paper => include_str!("../../../../assets/presets/paper.toml"),
        }
    }

    /// Parses the preset into a plan.
    pub fn plan(self) -> Result<Plan, PlanError> {
        Plan::from_toml(self.text())
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
