//! What a run records about its environment and its policy, in addition to task, engine and robot.

mod controls;
mod place;
mod policy;
mod repeats;
mod warner;

use robogate_core::latency::Execution;
use robogate_core::stress::Stress;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, de::Error};

pub use controls::{ControlProblem, ControlResult, Controls};
pub use place::{CellPlace, Place, PythonPlace, RendererRecord};
pub use policy::{ComparedServers, ExternalPolicyRecord, PolicyRecord};
pub use repeats::Repeats;
pub use warner::{OnWarning, WarnerRecord};

/// The version of [`World`] that this crate writes and reads.
pub const WORLD_VERSION: u32 = 1;

/// Where the episodes of a run took place, who acted in them, and how both were connected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct World {
    /// The version of this record.
    #[serde(deserialize_with = "known_version")]
    pub version: u32,
    /// What computes the episodes.
    pub place: Place,
    /// The policy. Absent for the scripted controller of the environment.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<PolicyRecord>,
    /// The latency of the policy. Absent if the world waits for its actions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub execution: Option<Execution>,
    /// What varied between environment and policy. Absent if nothing did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stress: Option<Stress>,
    /// The warner that acted in the episodes. Absent if there was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warner: Option<WarnerRecord>,
    /// The controls of the gate that started the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controls: Option<Controls>,
}

impl World {
    /// The scripted controller in this place.
    pub fn new(place: Place) -> Self {
        Self {
            version: WORLD_VERSION,
            place,
            policy: None,
            execution: None,
            stress: None,
            warner: None,
            controls: None,
        }
    }

    /// This record without the versions of installed packages, to compare two records: other versions can compute the same episodes.
    pub fn without_packages(&self) -> Self {
        let mut world = self.clone();
        if let Place::Python(python) = &mut world.place {
            python.packages.clear();
        }
        world
    }
}

fn known_version<'de, D: Deserializer<'de>>(source: D) -> Result<u32, D::Error> {
    match u32::deserialize(source)? {
        WORLD_VERSION => Ok(WORLD_VERSION),
        other => Err(D::Error::custom(format!("the version of `world` is {other}. Expected {WORLD_VERSION}"))),
    }
}
