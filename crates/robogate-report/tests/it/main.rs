//! Claims about analyses and reports, from the outside.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests too")]

mod anchors;
mod comparison;
mod degenerate;
mod pages;
mod populations;
mod study;
mod synthetic;
