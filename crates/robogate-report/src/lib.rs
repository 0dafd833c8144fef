//! What people look at: the analysis of a failure dictionary and the gate's answer, as pages, Markdown, JSON and JUnit.
//!
//! [`Source::open`] takes a run's folder, a Parquet dictionary or a published JSON one; [`Analysis::of`] makes one versioned
//! document of it, in which every figure says what population it speaks of and what cannot be estimated
//! says why; [`html`] and [`markdown`] write that document for people. The same rows give the same bytes: there is
//! no clock and no chance here but the fixed seeds of bootstrap and folds.
//!
//! | from | to |
//! |---|---|
//! | a path | [`Source`] |
//! | a source | [`Analysis`], `serde` and JSON Schema |
//! | an analysis | [`html`], [`markdown`], or [`Analysis::to_json`] |
//! | dictionaries of several designs and a test set | [`study::Study`] |
//! | the gate's evaluation | [`junit`], [`evaluation_markdown`] |
//! | a leaderboard | [`leaderboard_html`], [`leaderboard_markdown`] |

mod along;
mod analysis;
mod comparison;
mod drawn;
mod error;
mod failures;
mod gate;
mod headline;
mod limits;
mod models;
mod page;
mod pairs;
mod rate;
mod replay;
mod rows;
mod source;
mod story;
pub mod study;
mod success;
mod words;

pub use along::{Along, AlongKind, Cell, Correlation, CriticalThreshold, ModeBin, ModeChange, ModeChanges, Zone};
pub use analysis::{Analysis, Envelope, Subject};
pub use comparison::{
    ComparedDictionary, Comparison, ComparisonError, ComparisonHeadline, ComparisonOptions, CrossTable,
    DisagreementCell, DisagreementMap, Flip, MassEffect, MassSensitivity, NotShared, PairedComparison, PairedInvalid,
    RateDifference, ReachRow, SharedCell, SharedCurve, SharedParameters, Slope, UniversalZone, UniversalZones,
    ZoneSide,
};
pub use drawn::{DrawnRange, HowDrawn};
pub use error::ReportError;
pub use failures::{DANGER_LIMIT, DangerZone, DangerZones, FailureModes, ModeShare};
pub use gate::{
    DemandRow, evaluation_markdown, how_judged, junit, leaderboard_html, leaderboard_markdown, sign, what_next,
};
pub use headline::Headline;
pub use models::{
    CalibrationFigures, Coefficient, Estimate, Frontier, FrontierPoint, Penalty, PenaltyLevel, Regression,
    ReliabilityBin, RiskModel, RocCurve, RocFigures, Scoring, ScoringTerm,
};
pub use page::{comparison_html, comparison_markdown, html, markdown};
pub use pairs::{Axis, PairCell, PairMap, ZoneCounts};
pub use rate::{Finding, Population, Rate};
pub use replay::{ReplayGroup, WorthReplaying};
pub use source::Source;
pub use success::{FaultCount, InvalidBounds, Reweighted, StageSuccess, Success, WeightedRate};
pub use words::count;
