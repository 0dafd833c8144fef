//! Sentences about figures.

mod analysis;
mod analysis_limits;
mod comparison;
mod comparison_limits;
mod transfer;

pub use analysis::Headline;
pub(crate) use analysis::{advise, condition, low_side, main_modes, predictor_about, rounded_up};
pub use analysis_limits::limits;
pub use comparison::ComparisonHeadline;
pub use comparison_limits::comparison_limits;
pub use transfer::TransferHeadline;
pub(crate) use transfer::next_trials;

use robogate_analysis::labels::parameter_label;
use robogate_stats::format::list;

/// The labels of parameters as a list.
fn labels(parameters: &[String]) -> String {
    let labels: Vec<String> = parameters.iter().map(|parameter| parameter_label(parameter)).collect();
    list(&labels)
}
