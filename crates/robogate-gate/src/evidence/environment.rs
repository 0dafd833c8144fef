//! Binds evidence to the environment: task, world, simulator and robot, as one hash.

use robogate_dictionary::{Provenance, TaskIdentity, hex};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

/// The identity of the environment that the policy was judged in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EnvironmentBinding {
    /// SHA-256 (hex) over task, world, engine, robot and parameter space of the rows as JSON. Two runs with the same hash
    /// can be compared.
    pub sha256: String,
    /// Whether the build of the simulator is known by its hash. Otherwise name and version identify it, as declared.
    pub simulator_build_known: bool,
}

impl EnvironmentBinding {
    /// The environment of these rows.
    pub fn of(provenance: &Provenance) -> Self {
        // The policy is bound on its own, and controls are results.
        let world = provenance.world.as_ref().map(|world| {
            let mut bound = json!({ "place": world.place, "execution": world.execution });
            if let Some(stress) = &world.stress {
                bound["stress"] = json!(stress);
            }
            if let Some(warner) = &world.warner {
                bound["warner"] = json!([warner.on_warning, warner.sha256]);
            }
            bound
        });
        let identity: Value = json!({
            "task": TaskIdentity::of(&provenance.task),
            "world": world,
            "engine": provenance.engine,
            "robot": provenance.robot,
            "space": provenance.space,
        });
        Self {
            sha256: hex(&Sha256::digest(identity.to_string())),
            simulator_build_known: provenance.engine.build_sha256.is_some(),
        }
    }
}
