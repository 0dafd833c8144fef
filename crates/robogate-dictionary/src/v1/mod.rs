//! The implied task of dictionaries with schema 1.
//!
//! RoboGate 0.1 had one task, pick and place, and did not record it. Its dictionaries and the published ones have the
//! failure modes, measures and phases of this task.

use std::sync::OnceLock;

use robogate_core::TaskSpec;

/// The task of every dictionary of schema 1.
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
