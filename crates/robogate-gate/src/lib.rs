//! The gate: decides whether a policy may run in a cell.
//!
//! [`Requirements`] set limits, [`Trial`]s are the episodes. An [`Evaluation`] contains every figure with its interval, and
//! ends in a [`Verdict`]. It is a pure function of requirements and trials (and of the [`Baseline`] of relative
//! requirements): it uses no file, no clock and no random numbers. [`evidence`] stores all of it in a folder that
//! others can check.
//!
//! | from | to |
//! |---|---|
//! | a TOML file | [`Requirements`] |
//! | rows of a dictionary | [`Record`] of [`Trial`]s |
//! | scenarios and requirements, before a run | [`GatePlan`] |
//! | several records | [`Leaderboard`] |
//! | a record and its control arm | [`Twins`] |
//! | evaluations of the units of a fleet | [`Fleet`] |
//! | a record and requirements ([`Question`]) | [`Evaluation`], with [`ConfidenceScore`] and [`Verdict`] |

mod asked;
mod baseline;
mod cases;
mod comparison;
mod conditions;
mod dependence;
mod error;
mod evaluation;
pub mod evidence;
mod figure;
mod fleet;
mod force_limits;
mod joint_plan;
mod leaderboard;
mod metric;
mod next_budget;
mod nominal;
mod operating_domain;
mod pair_plan;
mod plan;
mod production;
mod ranking;
mod real;
mod record;
mod remarks;
mod requalification;
mod requirement;
mod requirement_test;
mod requirements;
mod rounds;
mod ruled_out;
mod scope;
mod score;
mod trial;
mod twins;
mod verdict;
mod warner;

pub use asked::{Asked, AskedAgainst};
pub use baseline::{Baseline, BaselineFigure};
pub use cases::NewCases;
pub use comparison::{Against, Comparison, Planned, StageComparison, check_pairing, check_repeats};
pub use conditions::Conditions;
pub use dependence::RowGroups;
pub use error::GateError;
pub use evaluation::{
    Counts, Dropped, EndingCount, Evaluation, FeasibleRate, GroupResult, Question, RequirementResult, Sampling, Status,
};
pub use figure::Extremes;
pub use fleet::{DriverForm, Fleet, FleetSubject, FleetUnit, UnitDriver, UnitPlaces, UnitShare};
pub use force_limits::{ExcessContact, ForceLimit, ForceLimitResult, ForceLimits};
pub use joint_plan::JointOperating;
pub use leaderboard::{Leaderboard, Standing};
pub use metric::{Metric, Production, Statistic};
pub use next_budget::NextBudget;
pub use nominal::NominalRate;
pub use operating_domain::{operating_domain, operating_ranges};
pub use pair_plan::{PairOperating, PairPlan};
pub use plan::{GatePlan, Operating, RequirementPlan};
pub use production::{ProductionFigure, ProductionFigures, UNLIMITED};
pub use ranking::{DroppedPolicy, RankedPair, RankedPolicy, Ranking, RankingDesign, RankingGuarantee, RankingOutcome};
pub use real::{RealEvidence, RealStratum};
pub use record::{Population, REPEATED, Record};
pub use remarks::CLIPPED_ACTIONS;
pub use requalification::{
    Answer, Change as RequalifiedChange, Divergence, Explanation, Group, Part, PropertyChange, Requalification,
    Requalifier, Seen, SignalChange, Starts, SuccessChange, Trace,
};
pub use requirement::{Bound, Each, Requirement, Sense};
pub use requirements::{Budget, Family, Mode, Requirements};
pub use ruled_out::{FrequentFault, RuledOut};
pub use score::{ConfidenceScore, ScoreTerm, ScoredTerm, Scoring};
pub use trial::{Ending, Trial};
pub use twins::{Effect, Family as TwinFamily, Twins};
pub use verdict::Verdict;
pub use warner::{ActingWarner, Endings, HANDOVER, WARNED_S, WARNED_STOP, WarnerEffect};
// A part of each evaluation.
pub use robogate_dictionary::{Controls, Repeats};
