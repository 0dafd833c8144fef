//! Links MuJoCo into this crate's tests if the feature is enabled.

#[cfg(feature = "egl")]
fn main() -> std::process::ExitCode {
    mujoco_provision::link()
}

#[cfg(not(feature = "egl"))]
fn main() {}
