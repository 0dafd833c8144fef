//! The answer of a study in sentences.

use robogate_analysis::study::{Arm, FEWEST_REPEATS, Learner, Measure, Study, Verdict};
use robogate_stats::format::{counted, list, sentence};

/// What the study found, in sentences.
pub fn answer(study: &Study) -> Vec<String> {
    let mut answer = Vec::new();
    let fitted = study.learners.iter().flat_map(|of| &of.arms).any(|arm| arm.figures.estimated().is_some());
    if fitted && study.repeats < FEWEST_REPEATS as u64 {
        answer.push(format!(
            "{} cannot tell designs apart: from {FEWEST_REPEATS} on a difference can be shown.",
            sentence(&counted(study.repeats, "repeat"))
        ));
    }
    for arm in [Arm::TwoStage, Arm::PureBoundary] {
        let verdicts: Vec<Verdict> = Learner::ALL
            .iter()
            .filter_map(|learner| study.figures(*learner, arm)?.score(Measure::BoundaryError)?.verdict)
            .collect();
        let with = |verdict| verdicts.iter().filter(|v| **v == verdict).count();
        if verdicts.is_empty() {
            answer.push(format!("The {} design could not be compared with the uniform one.", arm.name()));
            continue;
        }
        let (better, worse, of) = (with(Verdict::Better), with(Verdict::Worse), verdicts.len());
        let arm = arm.name();
        let said: Vec<String> = [(better, "better"), (worse, "worse")]
            .iter()
            .filter(|(learners, _)| *learners > 0)
            .map(|(learners, word)| format!("{word} than the uniform one with {learners} of {of} learners"))
            .collect();
        answer.push(match (said.is_empty(), of - better - worse) {
            (true, _) => format!(
                "At equal budget, none of {of} learners shows a difference between the {arm} and the uniform design."
            ),
            (false, 0) => format!("At equal budget, the {arm} design places the boundary {}.", list(&said)),
            (false, _) => format!(
                "At equal budget, the {arm} design places the boundary {}; the others show no difference.",
                list(&said)
            ),
        });
    }
    let error =
        |learner: &Learner| Some(study.figures(*learner, Arm::Uniform)?.score(Measure::BoundaryError)?.value.mean);
    let errors: Vec<f64> = Learner::ALL.iter().filter_map(error).collect();
    let moved = Learner::ALL.iter().filter_map(|learner| {
        Some(study.figures(*learner, Arm::TwoStage)?.score(Measure::BoundaryError)?.less_uniform.as_ref()?.mean.abs())
    });
    if let (Some(low), Some(high)) = (errors.iter().copied().reduce(f64::min), errors.iter().copied().reduce(f64::max))
        && let Some(moved) = moved.reduce(f64::max)
        && errors.len() > 1
    {
        answer.push(format!(
            "Between learners the boundary error of the uniform design varies by {:.1} percentage points; two stages \
             move it by {:.1} at most.",
            100.0 * (high - low),
            100.0 * moved
        ));
    }
    answer
}
