//! What the cycles of a recipe do not report, so that nothing watches it.

use super::Recipe;
use crate::cycle::{Cycle, MOST_PARAMETERS};
use crate::explanation;
use crate::metric::Metric;
use crate::settings::Settings;

/// Cycles after which a quantity that none reports is named.
const FIRST: u64 = 10;

impl Recipe {
    /// What the detectors do not watch, and why the promise on false alarms is approximate: one sentence each.
    pub fn doubts(&self, settings: &Settings) -> Vec<String> {
        let unreported = self.unreported().map(|names| {
            let foreign = self.state.foreign.as_ref();
            let instead = foreign.map_or_else(String::new, |name| {
                format!(" Cycles report {name}, which is not a parameter of the validated region.")
            });
            format!(
                "No cycle reported {}: nothing watches whether it stays in the validated region.{instead}",
                names.join(", ")
            )
        });
        let metrics = Metric::all(settings).filter(|metric| *metric != Metric::Robot);
        let doubt = |metric: Metric| {
            let depends = explanation::depends(self.inflation(metric)?);
            Some(format!("The promise is approximate for the {}: {depends}.", metric.label(settings)))
        };
        unreported.into_iter().chain(metrics.filter_map(doubt)).collect()
    }

    /// Notes the events that a cycle reports.
    pub(super) fn note_events(&mut self, cycle: &Cycle) {
        let known = &mut self.state.reported_events;
        if let Some(new) = cycle.events.keys().find(|name| !known.contains(*name))
            && known.len() < MOST_PARAMETERS
        {
            known.insert(new.clone());
        }
    }

    /// Whether no cycle has reported a parameter of the validated region, which this metric needs.
    pub(super) fn lacks_parameters(&self, metric: Metric) -> bool {
        matches!(metric, Metric::Outside | Metric::Risk)
            && self.unreported().is_some_and(|names| names.len() + 1 == self.state.outside.len())
    }

    /// Whether no cycle has reported an event, after the first ones.
    pub(super) fn lacks_event(&self, metric: Metric, settings: &Settings) -> bool {
        let Metric::Event(index) = metric else { return false };
        let name = settings.events.keys().nth(index.into());
        self.state.cycles >= FIRST && name.is_some_and(|name| !self.state.reported_events.contains(name))
    }

    /// The parameters of the envelope that no cycle has reported, after the first ones.
    fn unreported(&self) -> Option<Vec<&str>> {
        let named = self.outside().filter_map(|(parameter, tally)| (!tally.reported).then_some(parameter?.0));
        let names: Vec<&str> = named.collect();
        (self.state.cycles - self.state.began[Metric::Outside.index()] >= FIRST && !names.is_empty()).then_some(names)
    }
}
