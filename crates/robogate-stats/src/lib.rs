//! What may be claimed from episodes: numbers in, numbers out.
//!
//! Slices of `f64`, `bool` and `usize` go in; estimates come out together with how sure they are, or with the
//! reason why they cannot be had. Nothing here reads a file, a clock or another crate of this project,
//! and randomness is a seed that the caller gives.

pub mod calibration;
pub(crate) mod dense;
pub mod interval;
pub mod limit_state;
pub mod logistic;
pub mod roc;
pub(crate) mod special;

pub use interval::{Confidence, Interval, IntervalError, Trials, clopper_pearson, wilson};
