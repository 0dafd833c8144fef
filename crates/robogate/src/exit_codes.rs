//! The exit codes of the command. They are an API: scripts and CI depend on them.

/// The command is done, and every requirement that it judged is met.
pub const PASS: u8 = 0;
/// A requirement is violated, or a check failed.
pub const FAIL: u8 = 1;
/// Wrong usage or configuration: an argument, a file or a combination of both. Nothing was evaluated.
pub const USAGE: u8 = 2;
/// The evidence supports neither pass nor fail.
pub const INCONCLUSIVE: u8 = 3;
/// The evidence is invalid, or nothing was evaluated.
pub const INVALID: u8 = 4;
/// Infrastructure failed (a simulator, a policy server, a disk), or the work is incomplete.
pub const INFRASTRUCTURE: u8 = 5;
/// Interrupted by a signal. `robogate resume` continues the campaign.
pub const INTERRUPTED: u8 = 130;

#[cfg(test)]
mod tests {
    use robogate_gate::Verdict;

    use super::*;

    #[test]
    fn verdicts_use_these_codes() {
        let codes = [Verdict::Pass, Verdict::Fail, Verdict::Inconclusive, Verdict::Invalid].map(Verdict::exit_code);
        assert_eq!(codes, [PASS, FAIL, INCONCLUSIVE, INVALID]);
    }

    #[test]
    fn values_never_change() {
        let codes = [PASS, FAIL, USAGE, INCONCLUSIVE, INVALID, INFRASTRUCTURE, INTERRUPTED];
        assert_eq!(codes, [0, 1, 2, 3, 4, 5, 130]);
    }
}
