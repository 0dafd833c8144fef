//! The warning that no episode was valid so far.

use robogate_core::Outcome;

use crate::Warning;

/// Number of invalid episodes from the start after which a warning is issued.
const FROM_START: u64 = 50;

/// Counts the invalid episodes of this process until the first valid one.
#[derive(Debug)]
pub(crate) struct AllInvalid {
    /// The number of episodes and the fault of the first one. `None` after a valid episode or a warning.
    so_far: Option<(u64, String)>,
}

impl Default for AllInvalid {
    fn default() -> Self {
        Self { so_far: Some((0, String::new())) }
    }
}

impl AllInvalid {
    /// Counts one more episode. Returns the warning once enough episodes are invalid.
    pub(crate) fn add(&mut self, outcome: &Outcome) -> Option<Warning> {
        let (Outcome::Invalid(fault), Some((episodes, first))) = (outcome, &mut self.so_far) else {
            self.so_far = None;
            return None;
        };
        if *episodes == 0 {
            *first = fault.to_string();
        }
        *episodes += 1;
        if *episodes == FROM_START { self.warning() } else { None }
    }

    /// The warning, if at least one episode ran and none was valid. It is issued at most once.
    pub(crate) fn warning(&mut self) -> Option<Warning> {
        match self.so_far.take()? {
            (0, _) => None,
            (episodes, first) => Some(Warning::AllInvalid { episodes, first }),
        }
    }
}
