//! The result of a study in sentences.

use robogate_analysis::study::{Arm, Learner, MIN_REPEATS, Measure, Study, Verdict};
use robogate_stats::format::{counted, list, sentence};

/// The result of a study, in sentences.
pub fn answer(study: &Study) -> Vec<String> {
    let mut answer = Vec::new();
    let fitted = study.learners.iter().flat_map(|of| &of.arms).any(|arm| arm.figures.estimated().is_some());
    if fitted && study.repeats < MIN_REPEATS as u64 {
        answer.push(format!(
            "{} cannot show a difference of designs: at least {MIN_REPEATS} are needed.",
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
        let parts: Vec<String> = [(better, "significantly better"), (worse, "significantly worse")]
            .iter()
            .filter(|(learners, _)| *learners > 0)
            .map(|(learners, verdict)| format!("{verdict} than the uniform one with {learners} of {of} learners"))
            .collect();
        answer.push(match (parts.is_empty(), of - better - worse) {
            (true, _) => format!(
                "At equal budget, none of {of} learners shows a significant difference between the {arm} and the uniform design."
            ),
            (false, 0) => format!("At equal budget, the {arm} design places the boundary {}.", list(&parts)),
            (false, _) => format!(
                "At equal budget, the {arm} design places the boundary {}; the others show no significant difference.",
                list(&parts)
            ),
        });
    }
    let error =
        |learner: &Learner| Some(study.figures(*learner, Arm::Uniform)?.score(Measure::BoundaryError)?.value.mean);
    let errors: Vec<f64> = Learner::ALL.iter().filter_map(error).collect();
    let changes = Learner::ALL.iter().filter_map(|learner| {
        Some(
            study
                .figures(*learner, Arm::TwoStage)?
                .score(Measure::BoundaryError)?
                .difference_to_uniform
                .as_ref()?
                .mean
                .abs(),
        )
    });
    if let (Some(low), Some(high)) = (errors.iter().copied().reduce(f64::min), errors.iter().copied().reduce(f64::max))
        && let Some(change) = changes.reduce(f64::max)
        && errors.len() > 1
    {
        answer.push(format!(
            "The boundary error of the uniform design varies by {:.1} percentage points between learners. Two stages \
             change it by at most {:.1}.",
            100.0 * (high - low),
            100.0 * change
        ));
    }
    answer
}
