//! What people look at: analyses, comparisons, studies and the gate's answer, as pages, Markdown, JSON and JUnit.
//!
//! Everything here is a function of the figures: the same figures give the same bytes.
//!
//! | from | to |
//! |---|---|
//! | an [`Analysis`](robogate_analysis::Analysis) | [`html`], [`markdown`], [`analysis_json`] |
//! | a [`Comparison`](robogate_analysis::Comparison) | [`comparison_html`], [`comparison_markdown`], [`comparison_json`] |
//! | a [`Study`](robogate_analysis::study::Study) | [`study_markdown`], [`study_json`] |
//! | the gate's [`Evaluation`](robogate_gate::Evaluation) | [`junit`], [`evaluation_markdown`] |
//! | a [`Leaderboard`](robogate_gate::Leaderboard) | [`leaderboard_html`], [`leaderboard_markdown`] |

mod gate;
mod json;
mod page;
mod story;
mod study;
mod text;

pub use gate::{
    RequirementRow, evaluation_markdown, how_judged, junit, leaderboard_html, leaderboard_markdown, sign, what_next,
};
pub use json::{AnalysisDocument, ComparisonDocument, StudyDocument, analysis_json, comparison_json, study_json};
pub use page::{comparison_html, comparison_markdown, html, markdown};
pub use study::{answer as study_answer, study_markdown};
pub use text::{ComparisonHeadline, Headline, comparison_limits, limits};
