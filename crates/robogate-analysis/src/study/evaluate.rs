//! Training, evaluation on the test set, and comparison with the uniform design.

use robogate_core::Domain;
use robogate_dictionary::Dictionary;
use robogate_stats::crossed::crossed_mean;
use robogate_stats::roc::{auc, contributions};
use robogate_stats::{Confidence, Trials};

use super::learners::{Learner, Scores};
use super::{
    Arm, ArmFigures, DesignFacts, Figures, LearnerFigures, MIN_REPEATS, MeanFigure, Measure, RegionRange, Repeat,
    Score, StudySubject, TestSet, Verdict,
};
use crate::rate::ends;
use crate::table::{EpisodeTable, Sample};
use crate::task::TaskAnalysis;
use crate::{AnalysisError, Finding, Rate};

/// The training data of one repeat: valid rows only.
pub(super) struct Training {
    pub(super) uniform: Sample,
    pub(super) two_stage: Sample,
    /// Rows of its boundary stage, including invalid ones.
    pub(super) focused: u64,
    /// Weights of the valid rows of `two_stage`.
    pub(super) weights: Vec<f64>,
    pub(super) pure: Sample,
}

impl Training {
    fn arm(&self, arm: Arm) -> (&Sample, Option<&[f64]>) {
        match arm {
            Arm::Uniform => (&self.uniform, None),
            Arm::TwoStage => (&self.two_stage, None),
            Arm::TwoStageWeighted => (&self.two_stage, Some(&self.weights)),
            Arm::PureBoundary => (&self.pure, None),
        }
    }
}

/// The valid rows of a dictionary, and the number of focused rows including invalid ones.
pub(super) fn training(dictionary: &Dictionary, test: &Sample) -> Result<(Sample, u64), AnalysisError> {
    let table = EpisodeTable::read(dictionary)?;
    let sample = table.valid();
    for parameter in &test.parameters {
        let there = sample.parameter(&parameter.name);
        if there.is_none_or(|p| !p.is_like(parameter)) {
            let (path, name) = (dictionary.path().display(), &parameter.name);
            return Err(AnalysisError::NoStudy {
                reason: format!("{path}: parameter `{name}` is missing or of another type than in the test set"),
            });
        }
    }
    Ok((sample, (0..table.len()).filter(|row| table.is_focused(*row)).count() as u64))
}

/// The weights of the rows of a sample. `None` if there are too few weights.
pub(super) fn weights_of(weights: &[f64], sample: &Sample) -> Option<Vec<f64>> {
    sample.rows.iter().map(|row| weights.get(*row as usize).copied()).collect()
}

pub(super) fn subject(test: &Dictionary) -> StudySubject {
    let provenance = test.provenance();
    let version = provenance.engine.version.as_deref();
    StudySubject {
        task: TaskAnalysis::of_dictionary(provenance).task.to_owned(),
        robot: provenance.robot.name.clone(),
        policy: provenance.policy.clone(),
        engine: version.map_or_else(|| provenance.engine.name.clone(), |v| format!("{} {v}", provenance.engine.name)),
        space: provenance.space.name().to_owned(),
        parameters: provenance.space.parameters().iter().map(|p| p.name.to_string()).collect(),
    }
}

/// The numeric parameters whose range is narrower than that of the test set.
pub(super) fn region(pure: &Dictionary, test: &Dictionary) -> Vec<RegionRange> {
    let (own, whole) = (&pure.provenance().space, &test.provenance().space);
    let narrowed = own.parameters().iter().zip(whole.parameters()).filter(|(own, whole)| own != whole);
    narrowed
        .filter_map(|(own, _)| {
            let (low, high) = match own.domain {
                Domain::Continuous { low, high, .. } => (low, high),
                Domain::Integer { low, high } => (low as f64, high as f64),
                Domain::Categorical { .. } => return None,
            };
            Some(RegionRange { parameter: own.name.to_string(), low, high })
        })
        .collect()
}

pub(super) fn test_set(test: &Dictionary, rows: &Sample) -> TestSet {
    let rate = Rate::of(Trials::count(rows.success.iter().copied()));
    let p = rate.rate.unwrap_or(0.5);
    let entropy = |p: f64| if p > 0.0 { -p * p.ln() } else { 0.0 };
    TestSet {
        episodes: test.len(),
        rate,
        majority_error: p.min(1.0 - p),
        base_rate_log_loss: entropy(p) + entropy(1.0 - p),
        base_rate_brier: p * (1.0 - p),
    }
}

pub(super) fn designs(repeats: &[Repeat<'_>], training: &[Training]) -> Vec<DesignFacts> {
    let facts = |arm: Arm| {
        let dictionary = |repeat: &Repeat<'_>| match arm {
            Arm::Uniform => repeat.uniform.len(),
            Arm::TwoStage | Arm::TwoStageWeighted => repeat.two_stage.len(),
            Arm::PureBoundary => repeat.pure_boundary.len(),
        };
        let episodes: u64 = repeats.iter().map(dictionary).sum();
        let successes = training.iter().flat_map(|t| t.arm(arm).0.success.iter().copied());
        let focused = match arm {
            Arm::Uniform => 0,
            Arm::TwoStage | Arm::TwoStageWeighted => training.iter().map(|t| t.focused).sum(),
            Arm::PureBoundary => episodes,
        };
        DesignFacts { arm, episodes, focused, rate: Rate::of(Trials::count(successes)) }
    };
    [Arm::Uniform, Arm::TwoStage, Arm::PureBoundary].map(facts).into()
}

/// The figures of one fitted model: for each measure, one number per test episode; and the in-sample AUC.
struct Evaluated {
    per_episode: [Vec<f64>; 4],
    auc_95: [f64; 2],
    auc_in_sample: f64,
}

pub(super) fn figures(learner: Learner, training: &[Training], test: &Sample, task: &TaskAnalysis) -> LearnerFigures {
    let evaluated: Vec<Result<Vec<Evaluated>, String>> = Arm::ALL
        .iter()
        .map(|arm| {
            let one = |(r, t): (usize, &Training)| {
                let (sample, weights) = t.arm(*arm);
                learner
                    .scores(sample, weights, test, task)
                    .and_then(|scores| evaluate(&scores, sample, test))
                    .map_err(|why| format!("in repeat {}, {why}", r + 1))
            };
            training.iter().enumerate().map(one).collect()
        })
        .collect();
    let uniform = evaluated.first().and_then(|found| found.as_ref().ok());
    let arms = Arm::ALL.iter().zip(&evaluated).map(|(arm, found)| ArmFigures {
        arm: *arm,
        figures: match found {
            Ok(models) => compared(models, uniform.filter(|_| *arm != Arm::Uniform)).into(),
            Err(why) => Finding::not(why.clone()),
        },
    });
    let (name, about) = (learner.name(task).to_owned(), learner.about(task).to_owned());
    LearnerFigures { learner, name, about, arms: arms.collect() }
}

fn evaluate(scores: &Scores, sample: &Sample, test: &Sample) -> Result<Evaluated, String> {
    let per = |value: &dyn Fn(f64, bool) -> f64| -> Vec<f64> {
        scores.test.iter().zip(&test.success).map(|(t, y)| value(*t, *y)).collect()
    };
    // The log-odds of the observed outcome.
    let signed = |t: f64, y: bool| if y { t } else { -t };
    // ln(1 + e^-t) without overflow.
    let loss = |t: f64| (-t).max(0.0) + (-t.abs()).exp().ln_1p();
    let probability = |t: f64| 1.0 / (1.0 + (-t).exp());
    let reason = |error: robogate_stats::roc::RocError| error.to_string();
    let on_test = auc(&scores.test, &test.success, None, Confidence::P95).map_err(reason)?;
    Ok(Evaluated {
        per_episode: [
            per(&|t, y| f64::from(u8::from((t >= 0.0) != y))),
            per(&|t, y| loss(signed(t, y))),
            per(&|t, y| probability(-signed(t, y)).powi(2)),
            contributions(&scores.test, &test.success).map_err(reason)?,
        ],
        auc_95: ends(on_test.interval),
        auc_in_sample: auc(&scores.own, &sample.success, None, Confidence::P95).map_err(reason)?.auc,
    })
}

fn compared(models: &[Evaluated], uniform: Option<&Vec<Evaluated>>) -> Result<Figures, String> {
    let mut test = Vec::new();
    for (i, measure) in Measure::ALL.into_iter().enumerate() {
        let table: Vec<Vec<f64>> = models.iter().map(|m| m.per_episode[i].clone()).collect();
        let difference_to_uniform = match uniform {
            Some(uniform) => {
                let differences: Vec<Vec<f64>> = table
                    .iter()
                    .zip(uniform)
                    .map(|(own, of)| own.iter().zip(&of.per_episode[i]).map(|(a, b)| a - b).collect())
                    .collect();
                // Simultaneous 95 % confidence for all comparisons of a measure (Bonferroni).
                let shared = Confidence::P95.shared_by((Arm::ALL.len() - 1) * Learner::ALL.len());
                let interval = if differences.len() < MIN_REPEATS {
                    None
                } else {
                    crossed_mean(&differences, shared).map_err(|error| error.to_string())?.interval.map(ends)
                };
                Some((mean_figure(&differences)?, verdict(measure, interval)))
            }
            None => None,
        };
        let (difference_to_uniform, verdict) = difference_to_uniform.unzip();
        test.push(Score { measure, value: mean_figure(&table)?, difference_to_uniform, verdict });
    }
    Ok(Figures {
        test,
        auc_95: models.iter().map(|m| m.auc_95).collect(),
        auc_in_sample: models.iter().map(|m| m.auc_in_sample).collect(),
    })
}

fn mean_figure(table: &[Vec<f64>]) -> Result<MeanFigure, String> {
    let found = crossed_mean(table, Confidence::P95).map_err(|error| error.to_string())?;
    Ok(MeanFigure {
        mean: found.mean,
        interval_95: found.interval.map(ends),
        repeats: found.repeats,
        se_repeats: found.se_repeats,
        se_test: found.se_rows,
    })
}

/// The verdict on the difference from the uniform design, from its interval.
fn verdict(measure: Measure, interval: Option<[f64; 2]>) -> Verdict {
    match interval {
        Some([low, _]) if low > 0.0 => {
            if measure.larger_is_better() {
                Verdict::Better
            } else {
                Verdict::Worse
            }
        }
        Some([_, high]) if high < 0.0 => {
            if measure.larger_is_better() {
                Verdict::Worse
            } else {
                Verdict::Better
            }
        }
        _ => Verdict::NotSignificant,
    }
}
