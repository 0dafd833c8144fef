//! The task that dictionaries of schema 1 do not name.
//!
//! RoboGate 0.1 knew one task, pick and place, and did not write it down. Its dictionaries and the published ones
//! have this task's failure modes, measures and phases.

use std::sync::OnceLock;

use robogate_core::TaskSpec;

/// The task of every dictionary of schema 1.
pub fn task() -> TaskSpec {
    static TASK: OnceLock<TaskSpec> = OnceLock::new();
    // The file is a part of this crate, and a test reads it.
    #[expect(clippy::expect_used, reason = "the embedded file is valid")]
    TASK.get_or_init(|| serde_json::from_str(include_str!("pick_place.json")).expect("valid task")).clone()
}

#[cfg(test)]
mod tests {
    #[test]
    fn task_can_be_read() {
        let task = super::task();
        let modes: Vec<&str> = task.modes().map(|mode| mode.as_str()).collect();
        assert_eq!(modes, ["grasp_miss", "grip_loss", "collision", "timeout"]);
        assert_eq!((task.measures.len(), task.phases.len()), (4, 6));
    }
}
