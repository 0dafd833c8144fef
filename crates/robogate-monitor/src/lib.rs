//! Monitoring after deployment: detects changes of a robot's behaviour, with a bounded false-alarm rate.
//!
//! The input is one cycle at a time, the output are [`Alarm`]s. In addition to the paper's moving window ([`paper`]),
//! each metric of each recipe has a mixture Shiryaev-Roberts e-detector ([`detector`]). The mean number of cycles until
//! a false alarm is at least the configured one, over all metrics and recipes together.
//!
//! The library uses no clock, file, socket or thread and allocates no memory per cycle, so it can run on a robot
//! controller:
//!
//! ```
//! use robogate_monitor::{Baseline, Count, Cycle, Monitor, Settings};
//!
//! let normal = Baseline { success: Some(Count { count: 9_500, of: 10_000 }), ..Baseline::default() };
//! let mut monitor = Monitor::new(Settings { baseline: normal, ..Settings::default() })?;
//! let mut cycle = Cycle {
//!     id: String::new(),
//!     robot: "cell-1".to_owned(),
//!     recipe: "bracket".to_owned(),
//!     time_s: 0.0,
//!     success: true,
//!     failure_mode: None,
//!     events: Default::default(),
//!     cycle_time_s: None,
//!     parameters: Default::default(),
//! };
//! for i in 0..1_000 {
//!     cycle.time_s += 4.0;
//!     cycle.success = i < 500 || i % 4 != 0; // one in four fails from cycle 501 on
//!     monitor.observe(&cycle, &mut |alarm| println!("{}: {}", alarm.level.as_str(), alarm.what))?;
//! }
//! assert!(monitor.recipe("bracket").is_some_and(|recipe| recipe.level().is_some()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | topic | module |
//! |---|---|
//! | reported cycles | [`Cycle`] |
//! | normal behaviour | [`Baseline`] |
//! | changes and their start | [`detector`], with the [`factors`] of each metric |
//! | the paper's rule, a figure without a guarantee that raises no alarms | [`paper`] |
//! | validated region and risk model | [`domain`] |
//! | differences between robots | [`robogate_stats::overdispersion`] |
//! | false-alarm rates and detection delays | [`simulate`] |
//! | warnings within an episode, before a failure | [`warn`] |
//!
//! The feature `service` adds the service: feeds, store, outputs and page.

mod alarm;
mod baseline;
mod block_sums;
mod cycle;
pub mod detector;
pub mod domain;
mod events;
mod explanation;
pub mod factors;
mod history;
mod learning;
mod metric;
mod modes;
mod monitor;
pub mod paper;
mod recipe;
mod reference;
mod series;
#[cfg(feature = "service")]
#[expect(clippy::disallowed_methods, reason = "a service has deadlines and waits; the monitor itself uses no clock")]
pub mod service;
mod settings;
pub mod simulate;
pub mod warn;

pub use alarm::{Alarm, Happening, Level, Since};
pub use baseline::{Baseline, BaselineError, Count};
pub use block_sums::Inflation;
pub use cycle::{Cycle, CycleError, LONGEST_NAME, MOST_PARAMETERS, ParameterValue};
pub use events::{EventSettings, MOST_EVENTS, default_events};
pub use metric::Metric;
pub use modes::{MOST_MODES, ModeCounts, OTHER_MODE};
pub use monitor::{Monitor, TooManyRecipes};
pub use recipe::{DetectorView, OutsideTally, Recipe, RecipeState, RobotTally, Standing};
pub use reference::{Reference, ReferenceError};
pub use series::SeriesPoint;
pub use settings::{Settings, SettingsError, Shares};
