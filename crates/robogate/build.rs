//! Links MuJoCo into the command, where it has it.

#[cfg(feature = "mujoco")]
fn main() -> std::process::ExitCode {
    mujoco_provision::link()
}

#[cfg(not(feature = "mujoco"))]
fn main() {}
