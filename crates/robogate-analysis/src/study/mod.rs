//! The study of boundary focusing: an experiment, evaluated on held-out data.
//!
//! Three designs of equal budget (uniform, two-stage, boundary only) are the training data of each learner. All models
//! are evaluated on one independent uniform test set of the same simulator. [`Study::of`] is a function of the
//! dictionaries only.
//!
//! Each measure is the mean over test episodes of one number per episode (for the AUC, DeLong's contribution). The
//! intervals of means and differences therefore include both sources of variance: repeats and test episodes
//! ([`robogate_stats::crossed`]).

mod evaluate;
mod learners;

use robogate_dictionary::Dictionary;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use learners::Learner;
pub(crate) use learners::flexible_scores;

use crate::table::EpisodeTable;
use crate::task::TaskAnalysis;
use crate::{AnalysisError, Finding, Rate};
use evaluate::{Training, designs, figures, region, subject, test_set, training, weights_of};

/// The dictionaries of one repeat.
#[derive(Debug)]
pub struct Repeat<'a> {
    /// Sampled from the operating space.
    pub uniform: &'a Dictionary,
    /// Sampled in two stages.
    pub two_stage: &'a Dictionary,
    /// The weight of each row of `two_stage`, in order of index, with which both stages together estimate the operating
    /// space.
    pub two_stage_weights: Vec<f64>,
    /// Sampled near the boundary only.
    pub pure_boundary: &'a Dictionary,
}

/// A design, with the weighting of its rows in the fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Arm {
    /// The whole budget in the operating space.
    Uniform,
    /// Two stages, unweighted, as published.
    TwoStage,
    /// Two stages, with weights that restore the operating space.
    TwoStageWeighted,
    /// The whole budget in the region of prior knowledge. All weights would be equal.
    PureBoundary,
}

impl Arm {
    /// All arms, the reference first.
    pub const ALL: [Self; 4] = [Self::Uniform, Self::TwoStage, Self::TwoStageWeighted, Self::PureBoundary];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::TwoStage => "two-stage",
            Self::TwoStageWeighted => "two-stage, weighted",
            Self::PureBoundary => "pure boundary",
        }
    }
}

/// A measure of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// Share of test episodes on the wrong side of the model's 50 % boundary: the primary measure.
    BoundaryError,
    /// Mean of -ln P(observed outcome).
    LogLoss,
    /// Mean of (P - outcome)².
    Brier,
    /// Area under the ROC curve.
    Auc,
}

impl Measure {
    /// All measures, the primary one first.
    pub const ALL: [Self; 4] = [Self::BoundaryError, Self::LogLoss, Self::Brier, Self::Auc];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::BoundaryError => "boundary error",
            Self::LogLoss => "log loss",
            Self::Brier => "Brier score",
            Self::Auc => "AUC",
        }
    }

    /// Whether a larger value is better.
    pub fn larger_is_better(self) -> bool {
        self == Self::Auc
    }
}

/// The result of the experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Study {
    /// The version of this document.
    pub version: u32,
    /// Robot, policy, engine and space.
    pub subject: StudySubject,
    /// Episodes of each design in each repeat.
    pub budget: u64,
    /// Number of repeats, each with its own seeds.
    pub repeats: u64,
    /// The test set.
    pub test: TestSet,
    /// The data of the designs.
    pub designs: Vec<DesignFacts>,
    /// The parameters whose range in the pure-boundary design is narrower than in the operating space.
    pub region: Vec<RegionRange>,
    /// The figures of each learner.
    pub learners: Vec<LearnerFigures>,
}

/// Robot, policy, engine and space of a study.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StudySubject {
    /// The task. Empty if it is unknown.
    pub task: String,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// The engine with its version.
    pub engine: String,
    /// The parameter space.
    pub space: String,
    /// The parameters of the space.
    pub parameters: Vec<String>,
}

/// The independent uniform test set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TestSet {
    /// Number of episodes.
    pub episodes: u64,
    /// Success rate of its valid episodes.
    pub rate: Rate,
    /// Boundary error of always predicting the more frequent outcome, as a reference.
    pub majority_error: f64,
    /// Log loss of always predicting the overall rate.
    pub base_rate_log_loss: f64,
    /// Brier score of always predicting the overall rate.
    pub base_rate_brier: f64,
}

/// A range of the pure-boundary design, in the parameter's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegionRange {
    /// The parameter.
    pub parameter: String,
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

/// The data of one design, over all repeats.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DesignFacts {
    /// The design.
    pub arm: Arm,
    /// Number of episodes in all repeats.
    pub episodes: u64,
    /// Number of these that were sampled in the boundary stage, or in the region of prior knowledge.
    pub focused: u64,
    /// Their success rate. For a focused design it does not estimate the operating space.
    pub rate: Rate,
}

/// One learner on every design.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LearnerFigures {
    /// The learner.
    pub learner: Learner,
    /// Its name in reports.
    pub name: String,
    /// Its description in reports.
    pub about: String,
    /// Its figures for each design.
    pub arms: Vec<ArmFigures>,
}

/// One learner on one design.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ArmFigures {
    /// The design.
    pub arm: Arm,
    /// Its figures. `None` if a repeat could not be fitted.
    pub figures: Finding<Figures>,
}

/// The figures of the models of one learner and design.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Figures {
    /// Scores on the test set, one for each measure.
    pub test: Vec<Score>,
    /// DeLong's 95 % interval of the test AUC of each repeat.
    pub auc_95: Vec<[f64; 2]>,
    /// The in-sample AUC of each repeat, on the training rows.
    pub auc_in_sample: Vec<f64>,
}

impl Figures {
    /// The score of one measure.
    pub fn score(&self, measure: Measure) -> Option<&Score> {
        self.test.iter().find(|score| score.measure == measure)
    }

    /// The mean in-sample AUC.
    pub fn mean_auc_in_sample(&self) -> f64 {
        self.auc_in_sample.iter().sum::<f64>() / self.auc_in_sample.len() as f64
    }
}

/// One measure of one learner on one design.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Score {
    /// The measure.
    pub measure: Measure,
    /// Mean over repeats.
    #[serde(flatten)]
    pub value: MeanFigure,
    /// Difference from the uniform design, paired by repeat and test episode. `None` for the uniform design itself.
    pub difference_to_uniform: Option<MeanFigure>,
    /// The verdict on the difference. `None` for the uniform design itself.
    pub verdict: Option<Verdict>,
}

/// A mean over repeats and test episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MeanFigure {
    /// The mean.
    pub mean: f64,
    /// Its 95 % interval over repeats and test episodes. `None` with one repeat, or if nothing varies.
    pub interval_95: Option<[f64; 2]>,
    /// The figure of each repeat.
    pub repeats: Vec<f64>,
    /// Standard error from the repeats. `None` with one repeat.
    pub se_repeats: Option<f64>,
    /// Standard error from the test set.
    pub se_test: Option<f64>,
}

/// The verdict on a difference from the uniform design.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The interval lies on the better side of 0, at a simultaneous confidence for all designs and learners.
    Better,
    /// The same interval lies on the worse side of 0.
    Worse,
    /// The same interval includes 0, or there are fewer than three repeats.
    NotSignificant,
}

/// Smallest number of repeats for a significant difference. Two repeats leave one degree of freedom.
pub const MIN_REPEATS: usize = 3;

impl Verdict {
    /// The verdict in reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Worse => "worse",
            Self::NotSignificant => "no significant difference",
        }
    }
}

/// The chance of success of each valid row of `test`, in their order, by a learner that is fitted to all valid rows of `train`
/// with equal weights.
///
/// # Errors
/// A dictionary that cannot be read or whose parameters differ from the test set, or a failed fit.
pub fn predictions(learner: Learner, train: &Dictionary, test: &Dictionary) -> Result<Vec<f64>, AnalysisError> {
    let rows = EpisodeTable::read(test)?.valid();
    let (sample, _) = training(train, &rows)?;
    let task = TaskAnalysis::of_dictionary(test.provenance());
    let scores = learner
        .scores(&sample, None, &rows, task)
        .map_err(|reason| AnalysisError::NoStudy { reason: format!("{}: {reason}", train.path().display()) })?;
    Ok(scores.test.iter().map(|log_odds| 1.0 / (1.0 + (-log_odds).exp())).collect())
}

impl Study {
    /// The version of the document that this build writes.
    pub const VERSION: u32 = 2;

    /// Evaluates the repeats on the test set.
    ///
    /// # Errors
    /// A dictionary that cannot be read or whose parameters differ from the test set, or a wrong number of weights. A
    /// failed fit is not an error but a [`Finding`].
    pub fn of(test: &Dictionary, repeats: &[Repeat<'_>]) -> Result<Self, AnalysisError> {
        let test_rows = EpisodeTable::read(test)?.valid();
        let mut data_of_repeats = Vec::new();
        for repeat in repeats {
            let weights = &repeat.two_stage_weights;
            let data = [repeat.uniform, repeat.two_stage, repeat.pure_boundary];
            let (uniform, _) = training(data[0], &test_rows)?;
            let (two_stage, focused) = training(data[1], &test_rows)?;
            let (pure, _) = training(data[2], &test_rows)?;
            let weights = weights_of(weights, &two_stage).ok_or_else(|| AnalysisError::NoStudy {
                reason: format!("{} weights for the {} rows of the two-stage design", weights.len(), data[1].len()),
            })?;
            data_of_repeats.push(Training { uniform, two_stage, focused, weights, pure });
        }
        let task = TaskAnalysis::of_dictionary(test.provenance());
        let learners = Learner::ALL.map(|learner| figures(learner, &data_of_repeats, &test_rows, task)).into();
        Ok(Self {
            version: Self::VERSION,
            subject: subject(test),
            budget: repeats.first().map_or(0, |repeat| repeat.uniform.len()),
            repeats: repeats.len() as u64,
            test: test_set(test, &test_rows),
            designs: designs(repeats, &data_of_repeats),
            region: repeats.first().map_or_else(Vec::new, |repeat| region(repeat.pure_boundary, test)),
            learners,
        })
    }

    /// The figures of one learner on one design, if they exist.
    pub fn figures(&self, learner: Learner, arm: Arm) -> Option<&Figures> {
        let learner = self.learners.iter().find(|of| of.learner == learner)?;
        learner.arms.iter().find(|of| of.arm == arm)?.figures.estimated()
    }
}
