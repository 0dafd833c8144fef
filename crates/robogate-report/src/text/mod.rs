//! What figures say, in sentences.

mod analysis;
mod analysis_limits;
mod comparison;

pub use analysis::Headline;
pub use analysis_limits::limits;
pub use comparison::{ComparisonHeadline, comparison_limits};
