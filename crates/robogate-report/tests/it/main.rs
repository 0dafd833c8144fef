//! Claims about analyses and reports, from the outside.

#![expect(clippy::disallowed_methods, reason = "tests find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "helpers of tests are tests too")]

mod anchors;
mod comparison;
mod degenerate;
mod pages;
mod populations;
mod study;
mod synthetic;
