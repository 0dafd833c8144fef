//! The study of boundary focusing in sentences and as Markdown.

mod answer;
mod markdown;

pub use answer::answer;
pub use markdown::page as study_markdown;
