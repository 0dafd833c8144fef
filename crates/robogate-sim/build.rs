//! Links MuJoCo into this crate's tests.

fn main() -> std::process::ExitCode {
    mujoco_provision::link()
}
