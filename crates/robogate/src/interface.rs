//! What a task observes and takes, as text.

use robogate_core::{ActionSpace, TaskSpec};

/// The names and lengths of the observed vectors.
pub(crate) fn observes(task: &TaskSpec) -> String {
    list(task.observation.vectors.iter().map(|vector| format!("{} ({})", vector.name, vector.length)).collect())
}

/// The names and sizes of the cameras.
pub(crate) fn cameras(task: &TaskSpec) -> String {
    let cameras = task.observation.cameras.iter();
    list(cameras.map(|camera| format!("{} ({} x {})", camera.name, camera.width, camera.height)).collect())
}

/// The accepted actions: the names and bounds of a vector, or the kind of a motion.
pub(crate) fn takes(task: &TaskSpec) -> String {
    let spaces = task.action.spaces.iter().map(|space| match space {
        ActionSpace::Vector { names, low, high } => {
            let bounds = low.iter().zip(high);
            list(names.iter().zip(bounds).map(|(name, (low, high))| format!("{name} ({low} to {high})")).collect())
        }
        other => other.as_str().to_owned(),
    });
    spaces.collect::<Vec<_>>().join("; ")
}

fn list(texts: Vec<String>) -> String {
    if texts.is_empty() { "none".to_owned() } else { texts.join(", ") }
}
