//! Tests of pages and documents through the public interface.

#![expect(clippy::disallowed_methods, reason = "tests find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "helpers of tests are tests too")]

mod comparison;
mod degenerate;
mod gate;
mod headline;
mod pages;
#[path = "../../../robogate-analysis/tests/it/runs.rs"]
mod runs;
#[path = "../../../robogate-analysis/tests/it/synthetic.rs"]
mod synthetic;
