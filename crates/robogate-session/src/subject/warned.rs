//! A subject with a warner.

use std::path::Path;

use robogate_campaign::Worker;
use robogate_core::{Environment, Fault, Policy};
use robogate_dictionary::{OnWarning, Provenance, WarnerRecord};

use super::Subject;
use crate::failure::{Failure, OrFailure};
use crate::notice::note;
use crate::policy_source::PolicySource;
use crate::warner::{Given, SimulatedWarner, WarnedAgain, WarnerChoice};

impl Subject {
    /// The same subject with the warner of this choice.
    ///
    /// # Errors
    /// A file that is not a detector of this task, and a reaction that the task or the policy does not allow.
    pub fn with_warner(self, choice: &WarnerChoice) -> Result<Self, Failure> {
        self.warned(choice.record()?)
    }

    pub(super) fn warned(mut self, record: Option<WarnerRecord>) -> Result<Self, Failure> {
        let Some(record) = record else { return Ok(self) };
        let inside = matches!(&self.policy, Some(PolicySource::Declared(_)));
        let (execution, stress) = (self.execution.as_ref(), self.stress.as_ref());
        let warner = SimulatedWarner::new(record, &Given { task: &self.task, execution, stress, inside })?;
        self.task = warner.declared_in(&self.task).or_request()?;
        self.warner = Some(warner);
        Ok(self)
    }

    /// The episodes of the campaign in `dir` that run again after it, because a warner acted in them.
    pub(crate) fn warned_again(&self, dir: &Path) -> Option<WarnedAgain> {
        let warner = self.warner.as_ref().filter(|of| of.record().on_warning != OnWarning::Record)?;
        if !self.is_deterministic() {
            note("warned episodes do not run again without the warner, because the environment is not deterministic");
            return None;
        }
        Some(WarnedAgain::new(dir, warner.acts()))
    }

    /// Notes in what a run with this provenance differs from the calibration of its warner.
    pub fn note_warner(&self, provenance: &Provenance) {
        if let Some(warner) = &self.warner {
            warner.note_differences(robogate_gate::evidence::conditions(provenance));
        }
    }

    /// A worker with the warner, if there is one.
    pub(super) fn beside(&self, environment: Box<dyn Environment>, policy: Box<dyn Policy>) -> Result<Worker, Fault> {
        match &self.warner {
            None => Ok(Worker { environment, policy }),
            Some(warner) => warner.between(environment, policy),
        }
    }
}
