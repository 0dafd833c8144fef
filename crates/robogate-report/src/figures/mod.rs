//! Figures as SVG.

mod comparison;
mod danger;
mod export;
mod failures;
mod heatmap;
mod marginal;
mod models;
mod modes;
#[cfg(feature = "print")]
mod print;
mod rate;
mod requirement;
mod svg;

pub(crate) use comparison::{
    ForestRow, disagreement, failure_modes as compared_failure_modes, forest, rates, reach, sensitivity, shared_curve,
    universal_zones,
};
pub(crate) use danger::danger_zones;
pub use export::{FigureFile, figure_files};
pub(crate) use failures::{failure_modes, mode_changes};
pub(crate) use heatmap::{Boundary, drawable, heatmap};
pub(crate) use marginal::marginal_effect;
pub(crate) use models::{coefficients, reliability, roc};
#[cfg(feature = "print")]
pub use print::{PrintError, pdf, png};
pub(crate) use rate::rate_scale;
pub(crate) use requirement::requirement_bar;

/// The limits of the zones as success rates, as in the paper.
const ZONES: [f64; 2] = [0.3, 0.7];
