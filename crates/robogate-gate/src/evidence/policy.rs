//! Binds evidence to the policy that was judged.

use std::fmt;

use robogate_dictionary::{Place, PolicyRecord, Provenance, PythonPlace};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FileRecord, Problem, Role};

/// How the evidence identifies the policy that was judged. It follows from the provenance of the rows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum PolicyBinding {
    /// RoboGate ran this file.
    File {
        /// SHA-256 (hex) of the file.
        sha256: String,
    },
    /// The server declared the hash of what it runs. RoboGate cannot check that.
    Declared {
        /// SHA-256 (hex).
        sha256: String,
    },
    /// A function in the file of the environment.
    InEnvironment {
        /// SHA-256 (hex) of that file.
        sha256: String,
    },
    /// The policy is a part of RoboGate, whose build the rows name.
    BuiltIn,
    /// Only a name is known.
    Unbound {
        /// Why.
        because: String,
    },
}

impl PolicyBinding {
    /// The policy of these rows.
    pub fn of(provenance: &Provenance) -> Self {
        if provenance.source.is_some() {
            return Self::Unbound { because: "the imported rows record no digest".to_owned() };
        }
        let policy = match provenance.world.as_ref().and_then(|world| world.policy.as_ref()) {
            None | Some(PolicyRecord::BuiltIn { .. }) => return Self::BuiltIn,
            Some(policy) => policy,
        };
        let is_file = matches!(policy, PolicyRecord::External(external) if external.is_file());
        match policy.sha256() {
            Some(sha256) if is_file => Self::File { sha256 },
            Some(sha256) => Self::Declared { sha256 },
            None => match (policy, provenance.world.as_ref().map(|world| &world.place)) {
                (
                    PolicyRecord::Hosted { from: None, .. },
                    Some(Place::Python(PythonPlace { sha256: Some(sha256), .. })),
                ) => Self::InEnvironment { sha256: sha256.clone() },
                _ => Self::Unbound { because: "as declared by the server".to_owned() },
            },
        }
    }

    /// SHA-256 (hex) of the policy, if it is known.
    pub fn sha256(&self) -> Option<&str> {
        match self {
            Self::File { sha256 } | Self::Declared { sha256 } | Self::InEnvironment { sha256 } => Some(sha256),
            Self::BuiltIn | Self::Unbound { .. } => None,
        }
    }
}

impl fmt::Display for PolicyBinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { sha256 } => write!(f, "the file with SHA-256 {sha256}"),
            Self::Declared { sha256 } => write!(f, "SHA-256 {sha256}, as declared by its server"),
            Self::InEnvironment { sha256 } => write!(f, "in the file of the environment, with SHA-256 {sha256}"),
            Self::BuiltIn => f.write_str("built into robogate"),
            Self::Unbound { because } => write!(f, "not bound: {because}"),
        }
    }
}

/// Files of the policy that are not those of the run.
pub(super) fn problems(files: &[FileRecord], provenance: &Provenance) -> Vec<Problem> {
    let binding = PolicyBinding::of(provenance);
    let policy = files.iter().filter(|file| file.role == Role::Policy);
    let wrong = |file: &FileRecord| match &binding {
        PolicyBinding::BuiltIn => {
            Some(format!("the judged policy `{}` is built into robogate and has no file", provenance.policy))
        }
        PolicyBinding::File { sha256 } | PolicyBinding::Declared { sha256 } if *sha256 != file.sha256 => Some(format!(
            "not the policy that was judged: its SHA-256 is {}, but the run recorded {sha256}",
            file.sha256
        )),
        _ => None,
    };
    policy.filter_map(|file| Some(Problem::new(file.path.as_str(), wrong(file)?))).collect()
}
