//! JSON documents: the figures, and what they say in words.

use robogate_analysis::study::Study;
use robogate_analysis::{Analysis, Comparison};
use schemars::JsonSchema;
use serde::Serialize;

use crate::study::answer;
use crate::text::{ComparisonHeadline, Headline, comparison_limits, limits};

/// The document of an analysis.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct AnalysisDocument<'a> {
    /// The figures.
    #[serde(flatten)]
    pub analysis: &'a Analysis,
    /// The answer in plain words.
    pub headline: Headline,
    /// What these figures do not say.
    pub limits: Vec<String>,
}

/// The document of a comparison.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ComparisonDocument<'a> {
    /// The figures.
    #[serde(flatten)]
    pub comparison: &'a Comparison,
    /// The answer in plain words.
    pub headline: ComparisonHeadline,
    /// What these figures do not say.
    pub limits: Vec<String>,
}

/// The document of a study.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct StudyDocument<'a> {
    /// The figures.
    #[serde(flatten)]
    pub study: &'a Study,
    /// The answer in words.
    pub answer: Vec<String>,
}

/// An analysis as one versioned JSON document: the same bytes for the same rows.
pub fn analysis_json(analysis: &Analysis) -> String {
    text(&AnalysisDocument { analysis, headline: Headline::of(analysis), limits: limits(analysis) })
}

/// A comparison as one versioned JSON document, in the same way.
pub fn comparison_json(comparison: &Comparison) -> String {
    let headline = ComparisonHeadline::of(comparison);
    text(&ComparisonDocument { comparison, headline, limits: comparison_limits(comparison) })
}

/// A study as one versioned JSON document, in the same way.
pub fn study_json(study: &Study) -> String {
    text(&StudyDocument { study, answer: answer(study) })
}

fn text(document: &impl Serialize) -> String {
    // Trees of strings, finite numbers and maps with string keys cannot fail to serialise.
    serde_json::to_string_pretty(document).unwrap_or_default()
}
