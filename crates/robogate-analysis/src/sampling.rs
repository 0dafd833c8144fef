//! How the points of a dictionary were sampled.

use robogate_core::{Domain, Scale};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Source;
use crate::table::EpisodeTable;
use robogate_stats::format::{count, range};

/// How the points of a dictionary were sampled. The success figures list the stages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sampling {
    /// The campaign's seed.
    pub seed: u64,
    /// The operating space and, if it is known, the part that the focused stage sampled.
    pub ranges: Vec<SampledRange>,
    /// Share of the operating distribution that the focused stage covers, from the run's boundary report.
    pub focused_share: Option<f64>,
    /// Warnings about the design, in sentences.
    pub warnings: Vec<String>,
}

/// The range of one parameter.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SampledRange {
    /// The parameter.
    pub parameter: String,
    /// Its operating range, or its levels.
    pub operating: String,
    /// The scale on which it is sampled uniformly.
    pub scale: String,
    /// The range of the focused stage. `None` without one, or if it is unknown.
    pub focused: Option<String>,
    /// The origin of that range: `bins`, `fallback` or `whole_range`.
    pub focused_from: Option<String>,
}

pub(crate) fn sampling(source: &Source, table: &EpisodeTable) -> Sampling {
    let provenance = source.dictionary().provenance();
    let boundary = source.boundary();
    let parameters = provenance.space.parameters();
    let ranges = parameters.iter().map(|parameter| {
        let (operating, scale) = match &parameter.domain {
            Domain::Continuous { low, high, scale } => {
                let scale = if *scale == Scale::Log { "logarithmic" } else { "linear" };
                (range([*low, *high]), scale)
            }
            Domain::Integer { low, high } => (format!("{low} to {high}"), "integers"),
            Domain::Categorical { choices } if choices.len() > 24 => (format!("{} levels", choices.len()), "levels"),
            Domain::Categorical { choices } => (choices.join(", "), "levels"),
        };
        let span = boundary.and_then(|b| b.parameters.iter().find(|span| *span.parameter == *parameter.name));
        SampledRange {
            parameter: parameter.name.to_string(),
            operating,
            scale: scale.to_owned(),
            focused: span.map(|span| range(span.drawn)),
            focused_from: span.map(|span| span.drawn_from.clone()),
        }
    });
    let ranges = ranges.collect();
    let d = parameters.len();
    let mut warnings = Vec::new();
    let operating: usize = (0..table.len()).filter(|row| !table.is_focused(*row)).count();
    if d > 12 && operating < 2_000 * d {
        warnings.push(format!(
            "{d} parameters need at least {} episodes (2,000 for each: the paper's advice beyond 12 dimensions); there are only \
             {}. Use fewer parameters, or their principal components.",
            count(2_000 * d as u64),
            count(operating as u64)
        ));
    }
    Sampling {
        seed: provenance.seed,
        ranges,
        focused_share: boundary.map(|b| b.volume.share_of_operating_space),
        warnings,
    }
}
