//! The limits of an analysis in sentences.

use robogate_analysis::{Analysis, Finding, Population, RowSampling, Stopping};
use robogate_stats::format::{count, counted, percent_or_dash};

use super::labels;

/// The limits of an analysis, in sentences.
pub fn limits(analysis: &Analysis) -> Vec<String> {
    let joint = analysis.jointly_sampled();
    let success = &analysis.success;
    let mut limits = vec![population(analysis, &joint), origin(analysis)];
    let focused = |population| population == Population::FocusedDesign;
    if success.stages.iter().any(|s| focused(s.population)) && !focused(analysis.population) {
        let active = success.stages.iter().any(|s| s.stage == "active");
        let focused = if active {
            "The active stage chooses episodes whose outcome its risk model does not know."
        } else {
            "The focused stage samples near the boundary that the first stage estimated, and nowhere else."
        };
        let counted = match &success.weighting {
            Some(Finding::Estimated(of)) => format!(
                "Their plain success rate does not estimate the operating space: rates, effects, boxes and models count {}.",
                of.method
            ),
            _ => "They are left out of every rate, effect, box and model.".to_owned(),
        };
        limits.push(format!("{focused} {counted}"));
    }
    if success.bounds.invalid > 0 {
        limits.push(format!(
            "{} are excluded from every rate. If all of them had failed, the rate would be {}; if all had succeeded, {}.",
            counted(success.bounds.invalid, "invalid episode"),
            percent_or_dash(success.bounds.worst_case),
            percent_or_dash(success.bounds.best_case)
        ));
    }
    limits.extend(analysis.outside_range.as_ref().map(ToString::to_string));
    limits.push(intervals(analysis));
    limits.push(
        "The rate of a bin is an average over all other parameters as they were sampled. With another distribution of these \
         parameters, rates and thresholds change."
            .to_owned(),
    );
    if analysis.envelopes.iter().any(|e| e.frontier.estimated().is_some()) {
        limits.push(
            "The frontier comes from a logistic model with four coefficients, which cannot follow a corner of the real boundary: \
             compare it with the observed rates. Its band is pointwise and assumes that the model is correct. Outside the range of \
             validity the frontier is an extrapolation."
                .to_owned(),
        );
    }
    if analysis.risk.estimated().is_some() {
        limits.push(
            "The logistic risk model is linear in each parameter or its logarithm. An AUC applies to these rows and must not be compared with the AUC of \
             another design or dataset. The in-sample figures are biased upwards: use the cross-validated ones. The paper does not \
             define its penalties; here they are failure rates estimated from the training rows."
                .to_owned(),
        );
    }
    if analysis.effects.tested > 0 {
        limits.push(format!(
            "A parameter is named only if a permutation test finds a trend or an effect of any other shape, at 2.5 % for all {} and {} together \
             (Holm). A parameter that is not named may still have an effect that these episodes do not show.",
            counted(analysis.effects.tested, "parameter"),
            counted(analysis.effects.pairs_tested, "pair")
        ));
    }
    limits.push(format!(
        "A danger zone is significantly below 40 % and below the other bins of its parameter, for all {} tested bins and levels \
         together (Holm). If no bin is significant, this does not prove safety.",
        count(analysis.danger_zones.tested)
    ));
    limits.push(causes(analysis, !joint.is_empty()));
    limits
}

fn population(analysis: &Analysis, joint: &[String]) -> String {
    let real = "A real cell has another distribution of parts, and hence another rate.";
    match analysis.population {
        Population::AsImported => imported(analysis),
        Population::Suite => "The scenarios of a suite are chosen, and each counts equally. No rate here applies to an operating \
                              space. Scenarios differ in several parameters at once, so the effect of one parameter may be caused \
                              by the others."
            .to_owned(),
        Population::FocusedDesign => "Every row comes from a focused design, which samples near the failure boundary. No rate here applies \
                                      to the operating space."
            .to_owned(),
        _ if !joint.is_empty() => format!(
            "The operating space is the requested one: {} are sampled jointly (rank correlation), every other parameter \
             independently, each uniformly on its own scale. {real}",
            labels(joint)
        ),
        _ => format!(
            "The operating space is the requested one: each parameter is sampled independently and uniformly on its own scale. \
             {real}"
        ),
    }
}

/// How the imported rows were sampled, as far as the user stated it.
fn sampling(analysis: &Analysis) -> Option<RowSampling> {
    analysis.provenance.source.as_ref()?.sampling
}

fn imported(analysis: &Analysis) -> String {
    let ranges = "The ranges are the observed ones, and every row counts once.";
    match sampling(analysis) {
        Some(RowSampling::Uniform) => format!(
            "According to the import, each parameter was sampled independently and uniformly over its range. {ranges}"
        ),
        Some(RowSampling::Observed) => {
            format!("According to the import, the scenarios are those that occurred. {ranges}")
        }
        None => format!(
            "How the imported rows were sampled is not known: state it with `robogate import --sampling`. {ranges} Each rate applies to \
             the unknown distribution of the rows."
        ),
    }
}

/// Where the episodes come from.
fn origin(analysis: &Analysis) -> String {
    let engine = &analysis.subject.engine;
    let real = ["real", "robot", "hardware"].iter().any(|word| engine.eq_ignore_ascii_case(word));
    match &analysis.provenance.source {
        Some(_) if real => "According to the import, the episodes are of a real robot.".to_owned(),
        Some(_) if engine == "unknown" => {
            "The import does not state whether the episodes are simulated or of a real robot.".to_owned()
        }
        _ => format!(
            "The episodes are simulated ({engine}). Effects that the simulator does not model (lighting, wear, cables, people) are \
             not included, and no figure was compared with a real robot."
        ),
    }
}

fn intervals(analysis: &Analysis) -> String {
    if analysis.clusters.is_some() && analysis.population != Population::Suite {
        return "Intervals and tests assume that clusters are independent of each other, and a number of them that was fixed in advance. \
                Dependence that no column, no equal settings and no order of the rows shows is not found."
            .to_owned();
    }
    let narrow = "They are too narrow if the results are checked repeatedly while episodes are added";
    match analysis.provenance.source.as_ref().map(|source| source.stopping) {
        None => format!(
            "Intervals assume independent episodes and a number of episodes that was fixed in advance. For the points of a Latin \
             hypercube they are usually too wide, except the interval with the known distribution of the parameters. {narrow}; the bounds \
             of a gate allow for that."
        ),
        Some(Some(Stopping::Fixed)) => {
            "Intervals assume independent episodes. According to the import, their number was fixed in \
                                        advance."
                .to_owned()
        }
        Some(Some(Stopping::Monitored)) => format!(
            "Intervals assume independent episodes and a fixed number of them. {narrow}, as it was here according to the import."
        ),
        Some(None) => format!(
            "Intervals assume independent episodes and a fixed number of them; the import does not state how the number was chosen. \
             {narrow}."
        ),
    }
}

fn causes(analysis: &Analysis, joint: bool) -> String {
    if analysis.provenance.source.is_some() {
        return "Correlations, coefficients and thresholds describe the imported rows. Parameters may be correlated with each other \
                and with causes that were not recorded, so an effect need not be causal. What the import states about the sampling \
                is not checked."
            .to_owned();
    }
    let sampling = if analysis.population == Population::Suite {
        "The scenarios were chosen and differ in several parameters at once, so an effect need not be causal"
    } else if joint {
        "Some parameters were sampled jointly, so the effect of one of them includes those of the others"
    } else {
        "Parameters were sampled independently, so these effects are causal in the simulator; on a real line parameters may be \
         correlated"
    };
    format!("Correlations, coefficients and thresholds describe failure in this simulator. {sampling}.")
}
