//! Statistical inference on episodes: numbers in, numbers out.
//!
//! The inputs are slices of `f64`, `bool` and `usize`. The outputs are estimates with their uncertainty, or the reason
//! why there is no estimate. No function reads a file or a clock, and all randomness comes from a seed that the caller
//! gives.
//!
//! | question | module |
//! |---|---|
//! | what is the interval of a success rate? | [`interval`] |
//! | the same with a smaller interval, from the known distribution of the parameters? | [`adjusted`] |
//! | per bin, category, pair of parameters? | [`binning`] |
//! | is this cell safe? | [`zone`] |
//! | does it depend on a parameter at all, in any shape? | [`scan`] |
//! | which shape, and where does it change? | [`segments`] |
//! | do two parameters interact? | [`score_test`] |
//! | in which box of parameters is the rate high enough? | [`safe_box`] |
//! | how does it depend on the parameters? | [`logistic`], [`correlation`] |
//! | the same for a nonlinear dependence? | [`ridge`] on [`fourier`] features, [`spline_logistic`], [`boosting`], and the best mean of both, calibrated: [`flexible`] |
//! | do further coefficients improve a model? | [`likelihood_ratio`] |
//! | where is the frontier of two parameters? | [`limit_state`] |
//! | what is the rate over two parameters, with its uncertainty? | [`surface`] |
//! | where does one parameter become critical? | [`threshold`], by [`resample`] |
//! | does the risk score separate failures, and is it calibrated? | [`roc`], [`calibration`] |
//! | how far are predicted probabilities from the true ones? | [`model_error`] |
//! | which failure mode dominates, and where does that change? | [`modes`] |
//! | which rows depend on each other, and what is the rate over new clusters? | [`clusters`] |
//! | do several groups share one rate, and which one is an outlier? | [`overdispersion`] |
//! | do two rates differ? | [`difference`], [`compare`], [`multiplicity`], [`crossed`] |
//! | is it good enough, with any number of looks? | [`stratified`], [`anytime`], [`bounded_mean`] |
//! | does an outcome depend on the rows before it? | [`serial`] |
//! | the same, with a known largest number of looks? | [`budgeted`] |
//! | how often does such a gate pass or fail? | [`operating`] |
//! | which share of the units of a fleet meets the requirements, and what do the others have in common? | [`unit_share`], [`max_statistic`] |
//! | which of two policies is better, or which of several the best, block by block? | [`contest`] |
//! | may B replace A? | [`non_inferiority`], [`group_sequential`] after each round |
//! | what is the estimate for the operating space if the rows were sampled elsewhere? | [`weighted`] |
//! | the same for a rare event? | [`weighted_events`] |
//! | what is the rate of the real robot, from simulation and a few real trials? | [`prediction_powered`], [`exact_strata`] |
//! | how must the simulation be corrected for it? | [`recalibration`] |
//! | how long does a cycle take, if some ran into the time limit? | [`survival`] |
//! | how many units per hour, how long a run without a failure? | [`renewal`] |
//! | how probable is a rare event? | [`rare`] |
//! | how is a figure written for people? | [`mod@format`] |

pub mod adjusted;
pub mod anytime;
pub mod binning;
pub mod boosting;
pub mod bounded_mean;
pub mod budgeted;
pub mod calibration;
pub mod clusters;
pub mod compare;
pub mod contest;
pub mod correlation;
pub mod crossed;
pub mod difference;
pub mod effect_test;
pub mod exact_strata;
pub mod families;
pub mod flexible;
pub mod format;
pub mod fourier;
pub mod group_sequential;
pub mod interval;
mod jump;
pub mod likelihood_ratio;
pub mod limit_state;
pub mod logistic;
pub mod max_statistic;
pub mod model_error;
pub mod modes;
pub mod multiplicity;
pub mod non_inferiority;
pub mod operating;
pub mod overdispersion;
pub mod parallel;
pub mod pocket;
pub mod prediction_powered;
pub mod rare;
pub mod recalibration;
pub mod renewal;
pub mod resample;
pub mod ridge;
pub mod roc;
pub mod safe_box;
pub mod scan;
pub mod score_test;
pub mod segments;
pub mod serial;
pub mod spline_logistic;
pub mod stratified;
pub mod surface;
pub mod survival;
pub mod threshold;
pub mod unit_share;
pub mod weighted;
pub mod weighted_events;
pub mod zone;

pub use interval::{Confidence, Interval, IntervalError, Trials, clopper_pearson, wilson};
