//! The task of the published dictionaries, which do not name one: pick and place, with its failure modes, measures and
//! phases.

use std::sync::OnceLock;

use robogate_core::TaskSpec;

/// The task of every published dictionary.
pub fn task() -> TaskSpec {
    static TASK: OnceLock<TaskSpec> = OnceLock::new();
    // The file is part of this crate, and a test parses it.
    #[expect(clippy::expect_used, reason = "the embedded file is valid")]
    TASK.get_or_init(|| serde_json::from_str(include_str!("pick_place.json")).expect("valid task")).clone()
}

#[cfg(test)]
mod tests {
    #[test]
    fn task_is_valid() {
        let task = super::task();
        let modes: Vec<&str> = task.modes().map(|mode| mode.as_str()).collect();
        assert_eq!(modes, ["grasp_miss", "grip_loss", "collision", "timeout"]);
        assert_eq!((task.measures.len(), task.phases.len()), (4, 6));
    }
}
