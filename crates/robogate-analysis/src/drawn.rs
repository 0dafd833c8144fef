//! How the points were drawn.

use robogate_core::{Domain, Scale};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Source;
use crate::rows::Rows;
use robogate_stats::format::{number, range};

/// How the points were drawn. The stages themselves are among the success figures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HowDrawn {
    /// The campaign's seed.
    pub seed: u64,
    /// The operating space and, where it is known, the part of it that the focused stage was drawn in.
    pub ranges: Vec<DrawnRange>,
    /// How much of the operating distribution the focused stage covers, from the run's boundary report.
    pub focused_share: Option<f64>,
    /// What is worth a warning about the design.
    pub remarks: Vec<String>,
}

/// The range of one parameter.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DrawnRange {
    /// The parameter.
    pub parameter: String,
    /// What it may be.
    pub operating: String,
    /// In which scale it is even.
    pub scale: String,
    /// What the focused stage draws from; absent where there is none or it is not known.
    pub focused: Option<String>,
    /// Why: `bins`, `fallback` or `whole_range`.
    pub focused_from: Option<String>,
}

pub(crate) fn drawn(source: &Source, rows: &Rows) -> HowDrawn {
    let provenance = source.dictionary().provenance();
    let boundary = source.boundary();
    let parameters = provenance.space.parameters();
    let ranges = parameters.iter().map(|parameter| {
        let (operating, scale) = match &parameter.domain {
            Domain::Continuous { low, high, scale } => {
                let scale = if *scale == Scale::Log { "logarithmic" } else { "linear" };
                (range([*low, *high]), scale)
            }
            Domain::Integer { low, high } => (format!("{low} to {high}"), "whole numbers"),
            Domain::Categorical { choices } if choices.len() > 24 => (format!("{} words", choices.len()), "words"),
            Domain::Categorical { choices } => (choices.join(", "), "words"),
        };
        let span = boundary.and_then(|b| b.parameters.iter().find(|span| *span.parameter == *parameter.name));
        DrawnRange {
            parameter: parameter.name.to_string(),
            operating,
            scale: scale.to_owned(),
            focused: span.map(|span| range(span.drawn)),
            focused_from: span.map(|span| span.drawn_from.clone()),
        }
    });
    let ranges = ranges.collect();
    let d = parameters.len();
    let mut remarks = Vec::new();
    let operating: usize = (0..rows.len()).filter(|row| !rows.is_focused(*row)).count();
    if d > 12 && operating < 2_000 * d {
        remarks.push(format!(
            "{d} parameters ask for at least {} episodes (2,000 for each, the paper's advice beyond 12 dimensions); there \
             are {}. Consider fewer parameters, or their principal components.",
            number(2_000.0 * d as f64),
            number(operating as f64)
        ));
    }
    HowDrawn {
        seed: provenance.seed,
        ranges,
        focused_share: boundary.map(|b| b.volume.share_of_operating_space),
        remarks,
    }
}
