//! The study of boundary focusing as text.

mod answer;
mod markdown;

pub use answer::answer;
pub use markdown::page as study_markdown;
