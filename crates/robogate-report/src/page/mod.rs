//! The analysis as pages.

pub(crate) mod charts;
mod heatmap;
mod html;
mod markdown;
mod svg;

pub(crate) use heatmap::{drawable, heatmap, said};
pub use html::html;
pub use markdown::markdown;
