//! The limits of a comparison in sentences.

use robogate_analysis::{Comparison, Population};
use robogate_stats::format::{counted, percent};

use super::comparison::different_parameters;
use super::labels;

/// The limits of a comparison, in sentences.
pub fn comparison_limits(of: &Comparison) -> Vec<String> {
    let mut lines = Vec::new();
    for dataset in &of.datasets {
        if let Some(because) = &dataset.excluded_because {
            lines.push(format!("{} is listed but not compared: {because}.", dataset.name));
        }
        let bounds = &dataset.success.bounds;
        if let (1.., Some(worst), Some(best)) = (bounds.invalid, bounds.worst_case, bounds.best_case) {
            lines.push(format!(
                "The rate of {} excludes {}. Including them, it is between {} and {}.",
                dataset.name,
                counted(bounds.invalid, "invalid episode"),
                percent(worst),
                percent(best)
            ));
        }
    }
    if of.datasets.iter().any(|d| d.excluded_because.is_none() && d.population == Population::AsImported) {
        lines.push("Imported rows are treated as a sample of their operating space.".to_owned());
    }
    if !of.restricted.is_empty() {
        lines.push(format!(
            "The spaces differ, so only rows in the shared ranges are compared. {} No rate here applies to a whole space.",
            of.restricted.join(" ")
        ));
    }
    let parameters = different_parameters(of);
    if !parameters.is_empty() {
        lines.push(format!(
            "The operating spaces differ in {}, so a difference of success rates may come from the spaces.",
            labels(&parameters)
        ));
    }
    for of in of.differences.iter().filter(|of| of.clusters.is_some()) {
        let too_few = if of.clusters < Some(8) { " At least 8 are needed for a claim." } else { "" };
        lines.push(format!(
            "Episodes of {} or {} depend on each other. Their difference counts {} once each, and applies to new ones of the same kind, not \
             to exactly these.{too_few}",
            of.first,
            of.second,
            counted(of.clusters.unwrap_or_default(), "scenario")
        ));
    }
    for of in of.differences.iter().filter(|of| of.valid_pairs.is_some()) {
        lines.push(format!(
            "{} and {} ran the same scenarios, so their difference is a paired one. Use --paired to list the scenarios that \
             differ.",
            of.first, of.second
        ));
    }
    lines.push(
        "A curve shows one parameter while the others vary as each dataset sampled them. If the spaces differ, it is not the effect \
         of that parameter only."
            .to_owned(),
    );
    lines.push(
        "Universal zones are cells of a grid. They apply to the compared robots, and not to points within a cell."
            .to_owned(),
    );
    if of.reach.iter().any(|row| row.ratio.is_some()) {
        lines.push("Robots differ in more than their reach; a few robots do not show an effect of reach.".to_owned());
    }
    lines
}
