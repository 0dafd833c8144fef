//! What may be claimed from episodes: numbers in, numbers out.
//!
//! Slices of `f64`, `bool` and `usize` go in; estimates come out together with how sure they are, or with the
//! reason why they cannot be had. Nothing here reads a file, a clock or another crate of this project,
//! and randomness is a seed that the caller gives.
//!
//! | question | module |
//! |---|---|
//! | how sure is a success rate? | [`interval`] |
//! | per bin, category, pair of parameters? | [`binning`] |
//! | is this cell safe? | [`zone`] |
//! | how does it depend on the parameters? | [`logistic`], [`correlation`] |
//! | the same, where no line will do? | [`ridge`] on [`fourier`] features |
//! | where is the frontier of two parameters? | [`limit_state`] |
//! | where does one parameter become critical? | [`threshold`], by [`resample`] |
//! | does the risk score tell failures apart, and is it true? | [`roc`], [`calibration`] |
//! | which way does it fail, and where does that change? | [`modes`] |
//! | are two of them different? | [`compare`], [`multiplicity`], [`crossed`] |
//! | is it good enough, looked at as often as one likes? | [`anytime`], [`bounded_mean`] |
//! | what will such a gate do? | [`operating`] |
//! | may B replace A? | [`non_inferiority`] |
//! | what holds for the operating space, when the rows were drawn elsewhere? | [`weighted`] |
//! | how is a figure written for people? | [`mod@format`] |

pub mod anytime;
pub mod binning;
pub mod bounded_mean;
pub mod calibration;
pub mod compare;
pub mod correlation;
pub mod crossed;
pub(crate) mod dense;
pub mod format;
pub mod fourier;
pub mod interval;
pub mod limit_state;
pub mod logistic;
pub mod modes;
pub mod multiplicity;
pub mod non_inferiority;
pub mod operating;
pub mod resample;
pub mod ridge;
pub mod roc;
pub(crate) mod special;
pub mod threshold;
pub mod weighted;
pub mod zone;

pub use interval::{Confidence, Interval, IntervalError, Trials, clopper_pearson, wilson};
