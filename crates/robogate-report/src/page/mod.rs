//! The analysis as pages.

pub(crate) mod charts;
mod heatmap;
mod html;
mod markdown;
mod prose;
mod svg;
pub(crate) mod versus;

pub(crate) use heatmap::{drawable, heatmap};
pub(crate) use html::frame;
pub use html::{comparison_html, html};
pub(crate) use markdown::escape as escape_markdown;
pub use markdown::{comparison_markdown, markdown};
pub(crate) use prose::prose;
