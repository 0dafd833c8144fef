//! Is boundary focusing worth it? An experiment, judged on data that no model has seen.
//!
//! Three designs of equal budget - uniform, two-stage, purely at the boundary - give each learner its data; all are judged
//! on one independent uniform test set of the same simulator. [`Study::of`] is a function of the dictionaries alone.
//!
//! Each measure is a mean over test episodes of a number per episode (for the AUC DeLong's contribution), so that
//! means and differences have an interval that knows both chances: another repeat, and another test set
//! ([`robogate_stats::crossed`]).

mod learners;

use robogate_core::Domain;
use robogate_dictionary::Dictionary;
use robogate_stats::crossed::crossed_mean;
use robogate_stats::roc::{auc, contributions};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use learners::Learner;

use crate::rate::ends;
use crate::rows::{Rows, Sample};
use crate::task::TaskAnalysis;
use crate::{AnalysisError, Finding, Rate};
use learners::Scores;

/// The dictionaries of one repeat.
#[derive(Debug)]
pub struct Repeat<'a> {
    /// Drawn from the operating space.
    pub uniform: &'a Dictionary,
    /// Drawn in two stages.
    pub two_stage: &'a Dictionary,
    /// For each row of `two_stage`, in order of index, the weight by which both stages together speak of the
    /// operating space.
    pub two_stage_weights: Vec<f64>,
    /// Drawn near the boundary alone.
    pub pure_boundary: &'a Dictionary,
}

/// A design and how its rows were fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Arm {
    /// The whole budget over the operating space.
    Uniform,
    /// Two stages, every row counted alike: as published.
    TwoStage,
    /// Two stages, rows weighted back to the operating space.
    TwoStageWeighted,
    /// The whole budget in the region of prior knowledge. Weights would be equal there and change nothing.
    PureBoundary,
}

impl Arm {
    /// All, the reference first.
    pub const ALL: [Self; 4] = [Self::Uniform, Self::TwoStage, Self::TwoStageWeighted, Self::PureBoundary];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::TwoStage => "two-stage",
            Self::TwoStageWeighted => "two-stage, weighted",
            Self::PureBoundary => "pure boundary",
        }
    }
}

/// What a model is judged by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// Share of test episodes on the wrong side of the model's 50 % boundary. The question's own measure.
    BoundaryError,
    /// Mean of -ln P(outcome seen).
    LogLoss,
    /// Mean of (P - outcome)².
    Brier,
    /// Area under the ROC curve.
    Auc,
}

impl Measure {
    /// All, the question's own first.
    pub const ALL: [Self; 4] = [Self::BoundaryError, Self::LogLoss, Self::Brier, Self::Auc];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::BoundaryError => "boundary error",
            Self::LogLoss => "log loss",
            Self::Brier => "Brier score",
            Self::Auc => "AUC",
        }
    }

    /// Whether more of it is better.
    pub fn rises(self) -> bool {
        self == Self::Auc
    }
}

/// The result of the experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Study {
    /// The version of this form.
    pub version: u32,
    /// What was judged: robot, policy, engine, space.
    pub subject: StudySubject,
    /// Episodes of each design in each repeat.
    pub budget: u64,
    /// How often the experiment was repeated, each time with seeds of its own.
    pub repeats: u64,
    /// The test set.
    pub test: TestSet,
    /// The designs' data.
    pub designs: Vec<DesignFacts>,
    /// Where the pure-boundary design is narrower than the operating space.
    pub region: Vec<RegionRange>,
    /// What each learner made of them.
    pub learners: Vec<LearnerFigures>,
}

/// What was judged.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StudySubject {
    /// The task; empty where it is not known.
    pub task: String,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// The engine with its version.
    pub engine: String,
    /// The parameter space.
    pub space: String,
    /// What varies.
    pub parameters: Vec<String>,
}

/// The independent uniform test set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TestSet {
    /// Its episodes.
    pub episodes: u64,
    /// How many are evidence; the others are left out.
    pub rate: Rate,
    /// The boundary error of always stating the commoner outcome: what a model must beat.
    pub error_of_the_commoner: f64,
    /// The log loss of always stating the overall rate.
    pub log_loss_of_the_rate: f64,
    /// The Brier score of always stating the overall rate.
    pub brier_of_the_rate: f64,
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
    /// Episodes of all repeats.
    pub episodes: u64,
    /// Of them drawn in the boundary stage, or in the region of prior knowledge.
    pub focused: u64,
    /// Their successes. Of a focused design no rate of the operating space.
    pub rate: Rate,
}

/// One learner on every design.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LearnerFigures {
    /// The learner.
    pub learner: Learner,
    /// Its name for people.
    pub name: String,
    /// What it is, for people.
    pub about: String,
    /// Its figures by design.
    pub arms: Vec<ArmFigures>,
}

/// One learner on one design.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ArmFigures {
    /// The design.
    pub arm: Arm,
    /// Its figures, unless a repeat could not be fitted.
    pub figures: Finding<Figures>,
}

/// How the models of one learner and design did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Figures {
    /// On the test set, by measure.
    pub test: Vec<Score>,
    /// DeLong's 95 % interval of the test AUC of each repeat.
    pub auc_95: Vec<[f64; 2]>,
    /// The AUC of each repeat on the very rows that the model was fitted to.
    pub auc_in_sample: Vec<f64>,
}

impl Figures {
    /// The score by a measure.
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
    /// This less uniform, repeat by repeat and test episode by test episode; absent for uniform itself.
    pub less_uniform: Option<MeanFigure>,
    /// What the difference says; absent for uniform itself.
    pub verdict: Option<Verdict>,
}

/// A mean over repeats and test episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MeanFigure {
    /// The mean.
    pub mean: f64,
    /// Its 95 % interval over repeats and test sets; absent with one repeat, or where nothing varies.
    pub interval_95: Option<[f64; 2]>,
    /// The figure of each repeat.
    pub repeats: Vec<f64>,
    /// Standard error from the repeats; absent with one repeat.
    pub se_repeats: Option<f64>,
    /// Standard error from the test set.
    pub se_test: Option<f64>,
}

/// What a difference to uniform says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The interval, its level shared over all designs and learners, lies on the better side of 0.
    Better,
    /// The same interval lies on the worse side of 0.
    Worse,
    /// The same interval holds 0, or there are fewer than three repeats.
    NotShown,
}

/// Repeats below which no difference is stated: two have an interval of one degree of freedom.
pub const FEWEST_REPEATS: usize = 3;

impl Verdict {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Worse => "worse",
            Self::NotShown => "no difference shown",
        }
    }
}

impl Study {
    /// The version of this form that is written here.
    pub const VERSION: u32 = 2;

    /// Judges the repeats on the test set.
    ///
    /// # Errors
    /// A dictionary that cannot be read, or that has other parameters than the test set; weights that do not fit. A fit
    /// that is impossible is no error but a [`Finding`].
    pub fn of(test: &Dictionary, repeats: &[Repeat<'_>]) -> Result<Self, AnalysisError> {
        let test_rows = Rows::read(test)?;
        let judge = test_rows.valid();
        let mut trained = Vec::new();
        for repeat in repeats {
            let weights = &repeat.two_stage_weights;
            let data = [repeat.uniform, repeat.two_stage, repeat.pure_boundary];
            let (uniform, _) = training(data[0], &judge)?;
            let (two_stage, focused) = training(data[1], &judge)?;
            let (pure, _) = training(data[2], &judge)?;
            let weights = pick(weights, &two_stage).ok_or_else(|| AnalysisError::NoStudy {
                reason: format!("{} weights for {} rows of the two-stage design", weights.len(), data[1].len()),
            })?;
            trained.push(Trained { uniform, two_stage, focused, weights, pure });
        }
        let task = TaskAnalysis::of_dictionary(test.provenance());
        let learners = Learner::ALL.map(|learner| figures(learner, &trained, &judge, task)).into();
        Ok(Self {
            version: Self::VERSION,
            subject: subject(test),
            budget: repeats.first().map_or(0, |repeat| repeat.uniform.len()),
            repeats: repeats.len() as u64,
            test: test_set(test, &judge),
            designs: designs(repeats, &trained),
            region: repeats.first().map_or_else(Vec::new, |repeat| region(repeat.pure_boundary, test)),
            learners,
        })
    }

    /// The figures of one learner on one design, where there are any.
    pub fn figures(&self, learner: Learner, arm: Arm) -> Option<&Figures> {
        let learner = self.learners.iter().find(|of| of.learner == learner)?;
        learner.arms.iter().find(|of| of.arm == arm)?.figures.estimated()
    }
}

/// The data of one repeat, valid rows alone.
struct Trained {
    uniform: Sample,
    two_stage: Sample,
    /// Rows of its boundary stage, invalid ones included.
    focused: u64,
    /// Of the valid rows of `two_stage`.
    weights: Vec<f64>,
    pure: Sample,
}

impl Trained {
    fn arm(&self, arm: Arm) -> (&Sample, Option<&[f64]>) {
        match arm {
            Arm::Uniform => (&self.uniform, None),
            Arm::TwoStage => (&self.two_stage, None),
            Arm::TwoStageWeighted => (&self.two_stage, Some(&self.weights)),
            Arm::PureBoundary => (&self.pure, None),
        }
    }
}

/// Its valid rows, and how many of all are focused.
fn training(dictionary: &Dictionary, judge: &Sample) -> Result<(Sample, u64), AnalysisError> {
    let rows = Rows::read(dictionary)?;
    let sample = rows.valid();
    for parameter in &judge.parameters {
        let there = sample.parameter(&parameter.name);
        if there.is_none_or(|p| !p.is_like(parameter)) {
            let (path, name) = (dictionary.path().display(), &parameter.name);
            return Err(AnalysisError::NoStudy { reason: format!("`{name}` in {path} is not as in the test set") });
        }
    }
    Ok((sample, (0..rows.len()).filter(|row| rows.is_focused(*row)).count() as u64))
}

/// The weights of a sample's rows.
fn pick(weights: &[f64], sample: &Sample) -> Option<Vec<f64>> {
    sample.rows.iter().map(|row| weights.get(*row as usize).copied()).collect()
}

fn subject(test: &Dictionary) -> StudySubject {
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

/// The numbers whose range is not that of the test set.
fn region(pure: &Dictionary, test: &Dictionary) -> Vec<RegionRange> {
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

fn test_set(test: &Dictionary, judge: &Sample) -> TestSet {
    let rate = Rate::of(Trials::count(judge.success.iter().copied()));
    let p = rate.rate.unwrap_or(0.5);
    let entropy = |p: f64| if p > 0.0 { -p * p.ln() } else { 0.0 };
    TestSet {
        episodes: test.len(),
        rate,
        error_of_the_commoner: p.min(1.0 - p),
        log_loss_of_the_rate: entropy(p) + entropy(1.0 - p),
        brier_of_the_rate: p * (1.0 - p),
    }
}

fn designs(repeats: &[Repeat<'_>], trained: &[Trained]) -> Vec<DesignFacts> {
    let facts = |arm: Arm| {
        let dictionary = |repeat: &Repeat<'_>| match arm {
            Arm::Uniform => repeat.uniform.len(),
            Arm::TwoStage | Arm::TwoStageWeighted => repeat.two_stage.len(),
            Arm::PureBoundary => repeat.pure_boundary.len(),
        };
        let episodes: u64 = repeats.iter().map(dictionary).sum();
        let successes = trained.iter().flat_map(|t| t.arm(arm).0.success.iter().copied());
        let focused = match arm {
            Arm::Uniform => 0,
            Arm::TwoStage | Arm::TwoStageWeighted => trained.iter().map(|t| t.focused).sum(),
            Arm::PureBoundary => episodes,
        };
        DesignFacts { arm, episodes, focused, rate: Rate::of(Trials::count(successes)) }
    };
    [Arm::Uniform, Arm::TwoStage, Arm::PureBoundary].map(facts).into()
}

/// What one fitted model scored: on the test set by measure, a number per episode; and in sample.
struct Judged {
    per_episode: [Vec<f64>; 4],
    auc_95: [f64; 2],
    auc_in_sample: f64,
}

fn figures(learner: Learner, trained: &[Trained], judge: &Sample, task: &TaskAnalysis) -> LearnerFigures {
    let judged: Vec<Result<Vec<Judged>, String>> = Arm::ALL
        .iter()
        .map(|arm| {
            let one = |(r, t): (usize, &Trained)| {
                let (sample, weights) = t.arm(*arm);
                learner
                    .scores(sample, weights, judge, task)
                    .and_then(|scores| judged(&scores, sample, judge))
                    .map_err(|why| format!("in repeat {}, {why}", r + 1))
            };
            trained.iter().enumerate().map(one).collect()
        })
        .collect();
    let uniform = judged.first().and_then(|found| found.as_ref().ok());
    let arms = Arm::ALL.iter().zip(&judged).map(|(arm, found)| ArmFigures {
        arm: *arm,
        figures: match found {
            Ok(models) => compared(models, uniform.filter(|_| *arm != Arm::Uniform)).into(),
            Err(why) => Finding::not(why.clone()),
        },
    });
    let (name, about) = (learner.name(task).to_owned(), learner.about(task).to_owned());
    LearnerFigures { learner, name, about, arms: arms.collect() }
}

fn judged(scores: &Scores, sample: &Sample, judge: &Sample) -> Result<Judged, String> {
    let per = |value: &dyn Fn(f64, bool) -> f64| -> Vec<f64> {
        scores.test.iter().zip(&judge.success).map(|(t, y)| value(*t, *y)).collect()
    };
    // The log-odds of the outcome seen.
    let signed = |t: f64, y: bool| if y { t } else { -t };
    // ln(1 + e^-t) without overflow.
    let loss = |t: f64| (-t).max(0.0) + (-t.abs()).exp().ln_1p();
    let chance = |t: f64| 1.0 / (1.0 + (-t).exp());
    let said = |error: robogate_stats::roc::RocError| error.to_string();
    let on_test = auc(&scores.test, &judge.success, Confidence::P95).map_err(said)?;
    Ok(Judged {
        per_episode: [
            per(&|t, y| f64::from(u8::from((t >= 0.0) != y))),
            per(&|t, y| loss(signed(t, y))),
            per(&|t, y| chance(-signed(t, y)).powi(2)),
            contributions(&scores.test, &judge.success).map_err(said)?,
        ],
        auc_95: ends(on_test.interval),
        auc_in_sample: auc(&scores.own, &sample.success, Confidence::P95).map_err(said)?.auc,
    })
}

fn compared(models: &[Judged], uniform: Option<&Vec<Judged>>) -> Result<Figures, String> {
    let mut test = Vec::new();
    for (i, measure) in Measure::ALL.into_iter().enumerate() {
        let table: Vec<Vec<f64>> = models.iter().map(|m| m.per_episode[i].clone()).collect();
        let less_uniform = match uniform {
            Some(uniform) => {
                let differences: Vec<Vec<f64>> = table
                    .iter()
                    .zip(uniform)
                    .map(|(own, of)| own.iter().zip(&of.per_episode[i]).map(|(a, b)| a - b).collect())
                    .collect();
                // All comparisons of a measure together are wrong at most once in twenty (Bonferroni).
                let shared = Confidence::P95.shared_by((Arm::ALL.len() - 1) * Learner::ALL.len());
                let interval = if differences.len() < FEWEST_REPEATS {
                    None
                } else {
                    crossed_mean(&differences, shared).map_err(|error| error.to_string())?.interval.map(ends)
                };
                Some((mean_figure(&differences)?, verdict(measure, interval)))
            }
            None => None,
        };
        let (less_uniform, verdict) = less_uniform.unzip();
        test.push(Score { measure, value: mean_figure(&table)?, less_uniform, verdict });
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

/// Of an interval for a difference to uniform.
fn verdict(measure: Measure, interval: Option<[f64; 2]>) -> Verdict {
    match interval {
        Some([low, _]) if low > 0.0 => {
            if measure.rises() {
                Verdict::Better
            } else {
                Verdict::Worse
            }
        }
        Some([_, high]) if high < 0.0 => {
            if measure.rises() {
                Verdict::Worse
            } else {
                Verdict::Better
            }
        }
        _ => Verdict::NotShown,
    }
}
