//! Warnings within an episode: a detector that speaks before a failure.
//!
//! [`train`] makes a [`Detector`] from recorded episodes, [`calibrate`] gives it a threshold with a promise about successes, and a
//! [`Warner`] runs it in one robot: a few microseconds and no allocation in each control period. [`view`] says what it sees
//! before failures. A [`WarnFile`] contains all of it, and a [`Feed`] watches several
//! robots with it.

mod detector;
mod evaluate;
mod features;
mod feed;
mod file;
mod tally;
mod train;

pub use detector::{Detector, Distance, Model, Moments, Warner};
pub use evaluate::{
    Auroc, DETECTED_S, EARLY_S, FalseWarnings, LEADS_S, ModeView, View, false_warnings, random_early, seconds, view,
};
pub use features::{Features, LAST_PHASE, MOST_SIGNALS, Moment, Window};
pub use feed::{Feed, FeedError, FeedEvent, MOST_ROBOTS, Period, Warning};
pub use file::{Baselines, Conditions, EventRule, KnownParameter, WarnFile};
pub use tally::Tally;
pub use train::{
    Calibration, PROMISED, Scored, Track, WarnError, calibrate, divided, independent_successes, score, train,
    upper_bound,
};
