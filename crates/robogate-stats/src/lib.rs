//! What may be claimed from episodes: numbers in, numbers out.
//!
//! Slices of `f64`, `bool` and `usize` go in; estimates come out together with how sure they are, or with the
//! reason why they cannot be had. Nothing here reads a file, a clock or another crate of this project,
//! and randomness is a seed that the caller gives.

pub mod binning;
pub mod calibration;
pub(crate) mod dense;
pub mod interval;
pub mod limit_state;
pub mod logistic;
pub mod resample;
pub mod roc;
pub(crate) mod special;
pub mod threshold;

pub use interval::{Confidence, Interval, IntervalError, Trials, clopper_pearson, wilson};
