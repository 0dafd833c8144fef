//! The analysis as pages.

pub(crate) mod charts;
mod heatmap;
mod html;
mod markdown;
mod svg;
pub(crate) mod versus;

pub(crate) use heatmap::{drawable, heatmap, said};
pub use html::{comparison_html, html};
pub use markdown::{comparison_markdown, markdown};
