//! What became of watched episodes, and whether the promise still holds.

use robogate_stats::Trials;
use robogate_stats::anytime::ln_evidence_above;
use serde::Serialize;

/// The probability that warnings are ever suspended although the promise holds.
const FALSE_SUSPENSION: f64 = 0.05;

/// Counts of watched episodes.
///
/// Warnings are suspended when the successes contradict the promise: when the evidence against "the share of warned successes is at
/// most the promised one" reaches 20. If the promise holds, this ever happens with a probability of at most 5 %, for any number of
/// episodes (Ville 1939; [`robogate_stats::anytime`]).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tally {
    /// Successes without a warning.
    pub quiet_successes: u64,
    /// Successes with a warning.
    pub warned_successes: u64,
    /// Failures with an earlier warning.
    pub warned_failures: u64,
    /// Failures without a warning: missed.
    pub missed_failures: u64,
    /// Episodes that a warning stopped. Whether they would have failed is unknown.
    pub stopped: u64,
    /// Whether warnings are suspended.
    pub suspended: bool,
    #[serde(skip)]
    promised: f64,
}

impl Tally {
    /// No episodes yet.
    pub fn new(promised: f64) -> Self {
        Self {
            quiet_successes: 0,
            warned_successes: 0,
            warned_failures: 0,
            missed_failures: 0,
            stopped: 0,
            suspended: false,
            promised,
        }
    }

    /// The counts with their names.
    pub fn counts_mut(&mut self) -> [(&'static str, &mut u64); 5] {
        [
            ("quiet_successes", &mut self.quiet_successes),
            ("warned_successes", &mut self.warned_successes),
            ("warned_failures", &mut self.warned_failures),
            ("missed_failures", &mut self.missed_failures),
            ("stopped", &mut self.stopped),
        ]
    }

    /// Counts an episode that ended by itself. Returns whether warnings are suspended from now on.
    pub fn ended(&mut self, success: bool, warned: bool) -> bool {
        *match (success, warned) {
            (true, false) => &mut self.quiet_successes,
            (true, true) => &mut self.warned_successes,
            (false, true) => &mut self.warned_failures,
            (false, false) => &mut self.missed_failures,
        } += 1;
        let successes = Trials::new(self.warned_successes, self.warned_successes + self.quiet_successes);
        let evidence = ln_evidence_above(successes.unwrap_or(Trials::NONE), self.promised);
        let begins = !self.suspended && evidence >= -FALSE_SUSPENSION.ln();
        self.suspended |= begins;
        begins
    }
}
