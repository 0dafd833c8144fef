//! JSON documents: the figures, with the sentences that summarise them.

use robogate_analysis::transfer::Transfer;
use robogate_analysis::{Analysis, Comparison};
use robogate_gate::Twins;
use schemars::JsonSchema;
use serde::Serialize;

use crate::text::{ComparisonHeadline, Headline, TransferHeadline, comparison_limits, limits};

/// The JSON document of an analysis.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct AnalysisReport<'a> {
    /// The figures.
    #[serde(flatten)]
    pub analysis: &'a Analysis,
    /// The headline in sentences.
    pub headline: Headline,
    /// The limits of the figures, in sentences.
    pub limits: Vec<String>,
    /// The episodes compared with their nominal twins. Absent without a control arm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub twins: Option<&'a Twins>,
}

/// The JSON document of a comparison.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ComparisonReport<'a> {
    /// The figures.
    #[serde(flatten)]
    pub comparison: &'a Comparison,
    /// The headline in sentences.
    pub headline: ComparisonHeadline,
    /// The limits of the figures, in sentences.
    pub limits: Vec<String>,
}

/// The JSON document of a transfer to the real robot.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct TransferReport<'a> {
    /// The figures.
    #[serde(flatten)]
    pub transfer: &'a Transfer,
    /// The headline in sentences.
    pub headline: TransferHeadline,
}

/// An analysis as one versioned JSON document. Equal rows give equal bytes.
pub fn analysis_json(analysis: &Analysis) -> String {
    analysis_json_with(analysis, None)
}

/// The same with the comparison of its control arm.
pub fn analysis_json_with(analysis: &Analysis, twins: Option<&Twins>) -> String {
    text(&AnalysisReport { analysis, headline: Headline::of(analysis), limits: limits(analysis), twins })
}

/// A comparison as one versioned JSON document with the same properties.
pub fn comparison_json(comparison: &Comparison) -> String {
    let headline = ComparisonHeadline::of(comparison);
    text(&ComparisonReport { comparison, headline, limits: comparison_limits(comparison) })
}

/// A transfer to the real robot as one versioned JSON document with the same properties.
pub fn transfer_json(transfer: &Transfer) -> String {
    text(&TransferReport { transfer, headline: TransferHeadline::of(transfer) })
}

fn text(document: &impl Serialize) -> String {
    // Strings, finite numbers and maps with string keys always serialise.
    serde_json::to_string_pretty(document).unwrap_or_default()
}
