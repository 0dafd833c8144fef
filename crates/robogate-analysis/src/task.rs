//! The analysis plug-ins of tasks: published models, default figures, episodes worth replaying.

use robogate_dictionary::Provenance;

use crate::pick_place::PICK_PLACE;
use crate::replay::ReplayGroup;
use crate::table::EpisodeTable;

/// The analysis plug-in of one task. All parts are optional; a task without a plug-in is analysed too.
#[derive(Debug)]
pub struct TaskAnalysis {
    /// Name of the task.
    pub task: &'static str,
    /// The two parameters that the operating envelope maps by default; the frontier is solved for the first.
    pub envelope: Option<[&'static str; 2]>,
    /// The published logistic model of success with interactions.
    pub interactions: Option<InteractionModel>,
    /// The parameters of the published risk model. Empty if there is none.
    pub risk_parameters: &'static [&'static str],
    /// The form of the published risk model, in one sentence.
    pub risk_about: &'static str,
    /// The parameter whose effect is compared between dictionaries, over its logarithm.
    pub sensitivity: Option<&'static str>,
    /// Selects episodes that are worth replaying for this task.
    pub(crate) replay: fn(&EpisodeTable) -> Option<ReplayGroup>,
}

/// A logistic model of success: main effects and products of two of them, all standardised.
#[derive(Debug, Clone, Copy)]
pub struct InteractionModel {
    /// Its name.
    pub name: &'static str,
    /// The parameters of the main effects, all numeric.
    pub main: &'static [&'static str],
    /// Positions in `main` of the two factors of each product.
    pub products: &'static [(usize, usize)],
    /// Its form, in a few words.
    pub about: &'static str,
    /// Sentences on what the publication does not define.
    pub note: &'static str,
}

/// The plug-ins of this build.
static PLUG_INS: [&TaskAnalysis; 1] = [&PICK_PLACE];

/// The plug-in of a task without one.
static NO_PLUG_IN: TaskAnalysis = TaskAnalysis {
    task: "",
    envelope: None,
    interactions: None,
    risk_parameters: &[],
    risk_about: "",
    sensitivity: None,
    replay: |_| None,
};

impl TaskAnalysis {
    /// The plug-in of the task with this name, or an empty one.
    pub fn of(task: &str) -> &'static Self {
        PLUG_INS.into_iter().find(|plug_in| plug_in.task == task).unwrap_or(&NO_PLUG_IN)
    }

    /// The plug-in for the task of a dictionary.
    pub(crate) fn of_dictionary(provenance: &Provenance) -> &'static Self {
        Self::of(provenance.task.name.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_task_adds_nothing() {
        assert_eq!(TaskAnalysis::of("pick_place").sensitivity, Some("mass_kg"));
        assert!(TaskAnalysis::of("stack").interactions.is_none());
    }
}
