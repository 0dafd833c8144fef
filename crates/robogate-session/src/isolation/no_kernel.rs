//! Systems other than Linux have no sandbox.

use std::process::Command;

use anyhow::anyhow;

use super::sandbox::Rights;

/// Checks that the kernel has the sandbox.
pub(super) fn available() -> anyhow::Result<()> {
    Err(anyhow!("only Linux has the sandbox\nHint: --sandbox=off runs it with all your rights"))
}

/// Restricts nothing, and starts nothing.
pub(super) fn become_restricted(rights: &Rights, command: Command) -> anyhow::Error {
    anyhow!("only Linux has a sandbox for {}: {rights:?}", command.get_program().display())
}
