//! Reports: analyses, comparisons, studies and gate evaluations as HTML, Markdown, JSON and JUnit.
//!
//! Every report is a pure function of its figures: equal figures give equal bytes.
//!
//! | from | to |
//! |---|---|
//! | an [`Analysis`](robogate_analysis::Analysis) | [`html`], [`markdown`], [`analysis_text`], [`analysis_json`] |
//! | a [`Comparison`](robogate_analysis::Comparison) | [`comparison_html`], [`comparison_markdown`], [`comparison_text`], [`comparison_json`] |
//! | a [`Transfer`](robogate_analysis::transfer::Transfer) | [`transfer_html`], [`transfer_text`], [`transfer_json`] |
//! | an [`Evaluation`] of the gate | [`junit`], [`verdict_html`], [`evaluation_markdown`], [`evaluation_markdown_with`] |
//! | [`Judged`](robogate_gate::evidence::Judged) evidence | [`SafetyCase`], [`safety_case_html`] |
//! | a [`Requalification`](robogate_gate::Requalification) | [`requalification_html`] |
//! | episodes of runs | [`explorer_page`], [`replay_page`] |
//! | a [`Leaderboard`](robogate_gate::Leaderboard) | [`leaderboard_html`], [`leaderboard_markdown`] |
//! | a [`Fleet`](robogate_gate::Fleet) | [`fleet_html`], [`fleet_markdown`] |

mod document;
mod figures;
mod gate;
mod html;
mod json;
mod markdown;
mod plain;
mod safety;
mod text;
mod watch;

use robogate_analysis::PairCounts;
use robogate_gate::{Evaluation, ForceLimitResult, NominalRate, Twins, WarnerEffect};

pub use document::{RequalificationPage, answer_label};
pub use figures::{FigureFile, figure_files};
#[cfg(feature = "print")]
pub use figures::{PrintError, pdf, png};
pub use gate::{
    Again, Change, RequirementRow, TwinRow, evaluation_markdown, evaluation_markdown_with, evidence_html,
    feasible_part, fleet_drivers, fleet_headline, fleet_html, fleet_markdown, fleet_share, how_judged, junit,
    leaderboard_html, leaderboard_markdown, leaderboard_text, leaderboards_html, leaderboards_markdown, new_cases,
    of_invalid, required_success, sign, verdict_html, what_next, what_to_change,
};
pub use html::{
    comparison_html, comparison_html_with, explorer_page, html, html_with, replay_page, requalification_html,
    script_data, transfer_html,
};
pub use json::{
    AnalysisReport, ComparisonReport, TransferReport, analysis_json, analysis_json_with, comparison_json, transfer_json,
};
pub use markdown::{comparison_markdown, markdown, markdown_with};
pub use plain::{Line, analysis_text, comparison_text, transfer_text};
pub use safety::{
    Answered, Claim, Clause, Defeater, Note, NoteKind, OPERATING_DOMAIN, SafetyCase, Solution, Support,
    safety_case_html,
};
pub use text::{ComparisonHeadline, Headline, TransferHeadline, comparison_limits, limits};
pub use watch::{Strip, Watch, WatchItem};

/// Additions to the page of an analysis.
#[derive(Debug, Clone, Copy, Default)]
pub struct Additions<'a> {
    /// The evaluation of the gate that the run belongs to. Its verdict opens the page.
    pub evaluation: Option<&'a Evaluation>,
    /// What to change, if the gate did not pass.
    pub changes: &'a [Change],
    /// Episodes worth watching.
    pub watch: Option<&'a Watch>,
    /// Counts for a map of any two parameters.
    pub pairs: Option<&'a PairCounts>,
    /// The episodes compared with their nominal twins.
    pub twins: Option<&'a Twins>,
    /// The success rate with nothing varied.
    pub nominal: Option<NominalRate>,
    /// What a warner changed.
    pub warner: Option<&'a WarnerEffect>,
    /// The contacts that exceed each force limit.
    pub forces: &'a [ForceLimitResult],
    /// The risk model that chose the episodes.
    pub active: Option<&'a ActiveModel>,
}

/// The risk model of an active design.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ActiveModel {
    /// Its score and its certificate, as sentences without a full stop.
    pub sentences: Vec<String>,
    /// The rounds. The last one, without episodes, is the model of all episodes.
    pub rounds: Vec<ActiveModelRound>,
}

/// The model before a round. Figures that do not exist are absent.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ActiveModelRound {
    /// Episodes of the round.
    pub episodes: u64,
    /// Episodes to which the model was fitted.
    pub trained_on: u64,
    /// Share of gradient boosting; the rest is logistic regression on splines.
    pub boosting_share: Option<f64>,
    /// Brier score of the cross-validation.
    pub brier: Option<f64>,
    /// Mean log loss of the cross-validation.
    pub log_loss: Option<f64>,
}
