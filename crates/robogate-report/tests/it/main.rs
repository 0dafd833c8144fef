//! Tests of pages and documents through the public interface.

#![expect(clippy::disallowed_methods, reason = "tests find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "helpers of tests are tests too")]

mod comparison;
mod degenerate;
#[path = "../../../robogate-analysis/tests/it/designs.rs"]
mod designs;
mod gate;
mod headline;
mod pages;
#[path = "../../../robogate-analysis/tests/it/runs.rs"]
mod runs;
mod study;
#[path = "../../../robogate-analysis/tests/it/synthetic.rs"]
mod synthetic;
