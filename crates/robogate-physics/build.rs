//! Links MuJoCo into this crate's tests, where the crate has it.

#[cfg(feature = "mujoco")]
fn main() -> std::process::ExitCode {
    mujoco_provision::link()
}

#[cfg(not(feature = "mujoco"))]
fn main() {}
