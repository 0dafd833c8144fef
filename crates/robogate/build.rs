//! Links MuJoCo into the command, if the feature `mujoco` is enabled.

#[cfg(feature = "mujoco")]
fn main() -> std::process::ExitCode {
    mujoco_provision::link()
}

#[cfg(not(feature = "mujoco"))]
fn main() {}
