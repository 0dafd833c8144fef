//! What an analysis does not say.

use super::analysis::labels;
use robogate_analysis::{Analysis, Population};
use robogate_stats::format::{count, counted, percent};

/// What an analysis does not say, in sentences.
pub fn limits(analysis: &Analysis) -> Vec<String> {
    let together = analysis.jointly_sampled();
    let mut limits = Vec::new();
    let success = &analysis.success;
    limits.push(match analysis.population {
        Population::AsImported => "How the imported rows were drawn is not known here. The ranges are the observed ones, \
             every row counts once, and each rate speaks of whatever distribution the rows came from."
            .to_owned(),
        Population::Suite => "The scenarios of a suite were chosen, each as often as any other. No rate here is one of an operating \
             space, and what a bin, a map or a model shows along one parameter is also the doing of all the others in which \
             the scenarios differ."
            .to_owned(),
        Population::FocusedDesign => "Every row comes from a focused design, crowded where success turns into failure. \
             No rate here is one of the operating space."
            .to_owned(),
        _ if !together.is_empty() => format!(
            "The operating space is the one that was asked for: {} drawn together by rank, every other parameter on its own, \
             each even in its own scale. A real cell draws its parts otherwise, and where its parts differ the rate differs.",
            labels(&together)
        ),
        _ => "The operating space is the one that was asked for: each parameter on its own, even in its own scale. A real \
             cell draws its parts otherwise, and where its parts differ the rate differs."
            .to_owned(),
    });
    limits.push(format!(
        "The episodes are simulated ({}). What the simulator does not model (lighting, wear, cables, people) took no part, \
         and no figure here was checked against a real robot.",
        analysis.subject.engine
    ));
    if success.stages.iter().any(|s| s.population == Population::FocusedDesign)
        && analysis.population != Population::FocusedDesign
    {
        limits.push(
            "The focused stage looks where the boundary was expected from the first stage; what lies outside its region it \
             has not seen. Its plain success rate says nothing about operation, and its episodes take part in no bin, \
             threshold or model here; they enter the reweighted rate alone."
                .to_owned(),
        );
    }
    if success.bounds.invalid > 0 {
        limits.push(format!(
            "{} of these rows are invalid and in no rate. Had all of them failed, the rate would be {}; had all \
             succeeded, {}.",
            counted(success.bounds.invalid, "episode"),
            success.bounds.worst_case.map_or_else(|| "-".to_owned(), percent),
            success.bounds.best_case.map_or_else(|| "-".to_owned(), percent)
        ));
    }
    limits.push(
        "Intervals are for independent episodes and a number of them fixed in advance. Points of a Latin hypercube are \
         dependent, for which these intervals are usually too wide; looking again and again while episodes \
         come in makes them too narrow."
            .to_owned(),
    );
    limits.push(
        "A rate in a bin is an average over all other parameters as they were drawn. A threshold along one parameter moves \
         when the others are drawn otherwise."
            .to_owned(),
    );
    if analysis.envelopes.iter().any(|e| e.frontier.estimated().is_some()) {
        limits.push(
            "The frontier is that of a logistic model with four coefficients. Where the real boundary has a corner, the \
             curve cuts it; the observed rates beside it show where. Its band holds point by point, if the \
             model is right; outside the range of validity it is extrapolation."
                .to_owned(),
        );
    }
    if analysis.risk.estimated().is_some() {
        limits.push(
            "The risk model is linear in each parameter. Its AUC belongs to these rows: an AUC of another design or another \
             dictionary is no comparison. The in-sample figures flatter it; the cross-validated ones count. The \
             paper does not define its shape and placement penalties; here they are failure rates learnt \
             from the training rows."
                .to_owned(),
        );
    }
    limits.push(format!(
        "Bins below 40 % are sure one with another (Holm over {} bins and levels), yet only for the bins that were cut. Where \
         none is surely below, that is no proof of safety.",
        count(analysis.danger_zones.looked_at)
    ));
    let drawn = if !together.is_empty() {
        "Some parameters were drawn together, as the space says, so a rate along one of them holds what the other does too"
    } else {
        "Parameters were drawn independently, so here that is cause; on a line where they move together it need not be"
    };
    limits.push(format!(
        "Correlations, coefficients and thresholds say what goes together with failure in this simulator. {drawn}."
    ));
    limits
}
