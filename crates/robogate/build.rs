//! Links MuJoCo into the command.

fn main() -> std::process::ExitCode {
    mujoco_provision::link()
}
