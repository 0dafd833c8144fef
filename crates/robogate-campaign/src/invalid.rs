//! The warning that most episodes so far are invalid.

use robogate_core::Outcome;

use crate::Warning;

/// Smallest number of episodes after which a running campaign warns.
const FEWEST: u64 = 20;

/// Counts the episodes of this process until a warning was issued.
#[derive(Debug, Default)]
pub(crate) struct MostlyInvalid {
    episodes: u64,
    invalid: u64,
    /// The fault of the first invalid episode.
    first: String,
    warned: bool,
}

impl MostlyInvalid {
    /// Counts one more episode. Returns the warning once more than half of a sufficient number are invalid.
    pub(crate) fn add(&mut self, outcome: &Outcome) -> Option<Warning> {
        self.episodes += 1;
        if let Outcome::Invalid(fault) = outcome {
            if self.invalid == 0 {
                self.first = fault.to_string();
            }
            self.invalid += 1;
        }
        if self.episodes >= FEWEST { self.warning() } else { None }
    }

    /// The warning, if more than half of the episodes so far are invalid. It is issued at most once.
    pub(crate) fn warning(&mut self) -> Option<Warning> {
        let Self { episodes, invalid, .. } = *self;
        if self.warned || 2 * invalid <= episodes {
            return None;
        }
        self.warned = true;
        let first = std::mem::take(&mut self.first);
        Some(if invalid == episodes {
            Warning::AllInvalid { episodes, first }
        } else {
            Warning::MostlyInvalid { episodes, invalid, first }
        })
    }
}
