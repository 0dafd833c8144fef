//! Analysis of failure dictionaries, as data: rates, marginal effects, frontiers, risk models, comparisons and studies.
//!
//! [`Source::open`] takes a run's folder, a Parquet dictionary or a published JSON dictionary. [`Analysis::of`] computes one
//! versioned document from it. Every figure names the population that it applies to, and a figure that cannot be
//! estimated states the reason. The same rows give the same figures: the only random numbers are those of bootstrap and
//! folds, with fixed seeds. Sentences and pages are written by `robogate-report`.
//!
//! | from | to |
//! |---|---|
//! | a path | [`Source`] |
//! | a source | [`Analysis`] |
//! | several sources | [`Comparison`] |
//! | dictionaries of two runs | [`learners::predictions`] of one for the other |
//! | a source and trials of the real robot | [`transfer::Transfer`] |
//! | the name of a task | [`TaskAnalysis`]: the additions of that task to the generic analysis |

mod analysis;
mod claims;
mod comparison;
mod conditions;
mod danger;
mod dependence;
mod distance;
mod effects;
mod error;
mod explorer;
mod failures;
pub mod labels;
pub mod learners;
mod marginal;
mod models;
mod pair_counts;
mod pairs;
mod pick_place;
mod rate;
mod replay;
mod safe_box;
mod sampling;
mod source;
mod success;
mod table;
mod task;
pub mod transfer;
mod watch;
mod weighting;

pub use analysis::{Analysis, AnalysisOptions, Envelope, Subject};
pub use claims::{Advice, Claims, FailureRegion};
pub use comparison::{
    ComparedDataset, Comparison, ComparisonError, ComparisonOptions, CrossTable, DisagreementCell, DisagreementMap,
    Effect, Flip, NotShared, PairedComparison, PairedInvalid, RateDifference, ReachRow, Sensitivity, SharedCell,
    SharedCurve, SharedParameters, Slope, UniversalZone, UniversalZones, ZoneSide,
};
pub use conditions::{ConditionPart, Conditions, FailureCondition, ModeRate, Power, SoughtBox};
pub use danger::{DANGER_LIMIT, DangerZone, DangerZones};
pub use dependence::{ClusterReport, GroupingReport};
pub use effects::{EffectShape, Effects, Interaction, LEVEL, ParameterEffect, RateStep, ShapeKind};
pub use error::AnalysisError;
pub use explorer::{ExplorerColumn, ExplorerTable, PassingTwin, Role, RunCounts, ValueKind};
pub use failures::{FailureModes, ModeShare, unrecorded};
pub use marginal::{
    Cell, Correlation, CriticalThreshold, CurvePoint, MarginalEffect, ModeBin, ModeChange, ModeChanges, ParameterType,
    Zone,
};
pub use models::{
    CalibrationFigures, Coefficient, Estimate, Frontier, FrontierPoint, Penalty, PenaltyLevel, Predictor,
    PredictorColumn, Regression, ReliabilityBin, RiskModel, RocCurve, RocFigures, Scoring, ScoringTerm,
};
pub use pair_counts::{ListedEpisode, PairCounts, pair_counts};
pub use pairs::{Axis, ModelRate, PairCell, PairMap, ZoneCounts};
pub use rate::{Finding, Population, Rate, RateClusters};
pub use replay::{HERE, ReplayEpisode, ReplayGroup, ReplayReason, same_subject, shell_word};
/// What an import states about its rows, from the dictionary.
pub use robogate_dictionary::{RowSampling, Stopping};
pub use safe_box::{AvoidedMode, BoxLimit, DEFAULT_TARGET, SafeBox};
pub use sampling::{SampledRange, Sampling};
pub use source::Source;
pub use success::{Adjusted, FaultCount, InvalidBounds, StageSuccess, Success, WeightedRate};
pub use task::{InteractionModel, TaskAnalysis};
pub use watch::{Twin, WatchedEpisode, worth_watching};
pub use weighting::Weighting;
