//! End-to-end tests of the command, and tests of the repository as a whole.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

/// Counts the memory that readers of untrusted files need.
#[global_allocator]
static MEMORY: robogate_testing::CountingAllocator = robogate_testing::CountingAllocator;

#[cfg(all(feature = "mujoco", feature = "onnx"))]
mod admit;
mod any_task;
#[cfg(all(feature = "mujoco", feature = "rapier"))]
mod arm_table;
mod bridge;
#[cfg(feature = "mujoco")]
#[expect(unreachable_pub, reason = "a module of a test")]
mod browser;
#[cfg(feature = "mujoco")]
mod budgets;
#[cfg(feature = "mujoco")]
mod cells;
mod command;
mod completions;
mod compliance;
mod contributing;
mod controls;
#[cfg(target_os = "linux")]
mod crash;
mod demos;
mod dependencies;
mod environments;
mod fleet;
mod fuzz;
mod fuzz_records;
mod gate;
mod generated;
mod harness;
#[cfg(feature = "onnx")]
mod init;
#[cfg(all(target_os = "linux", feature = "mujoco"))]
mod isolation;
mod layering;
mod library;
mod local_policies;
#[cfg(feature = "mujoco")]
mod media;
#[cfg(feature = "mujoco")]
mod menagerie;
mod monitor;
#[cfg(all(target_os = "linux", target_arch = "x86_64", feature = "mujoco", feature = "rapier", feature = "onnx"))]
mod numerics;
#[path = "../../../robogate-policy/tests/support/openpi.rs"]
mod openpi;
#[cfg(all(feature = "mujoco", feature = "rapier"))]
mod pages;
mod policy;
mod project;
mod rank;
mod rare;
mod requalify;
mod runs;
mod safety_case;
mod settings;
mod shards;
mod signatures;
mod stress;
#[cfg(all(feature = "mujoco", feature = "rapier"))]
mod task_files;
mod terminal;
#[cfg(all(target_os = "linux", feature = "mujoco"))]
mod trial;
#[cfg(all(target_os = "linux", feature = "mujoco", feature = "onnx"))]
mod trust;
#[cfg(all(unix, feature = "mujoco", feature = "onnx"))]
mod tutorials;
mod twins;
mod verbs;
#[cfg(feature = "mujoco")]
mod view;
mod warn;
