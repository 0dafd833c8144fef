//! The service around the detectors: cycles in by HTTP, MQTT or lines; alarms out; everything on disk before it is acknowledged.
//!
//! One thread owns the store and the monitor ([`Desk`]); feeds hand it bytes and wait for the answer. Requests that wait together
//! share one commit.

mod desk;
mod fleet;
mod http;
mod intake;
mod metrics;
mod mqtt;
mod outputs;
mod settings;
mod status;
mod store;

pub use desk::{Busy, Desk, Handle};
pub use fleet::{FleetStatus, OutlierStatus, RecipeFleet, RobotStatus, SpreadStatus};
pub use http::{HttpError, HttpSettings, serve};
pub use intake::{Intake, IntakeError, Refused, Taken};
pub use mqtt::Broker;
pub use outputs::{Deliver, Output, OutputError, json_lines, webhook};
pub use settings::ServiceSettings;
pub use status::{DetectorStatus, OutsideStatus, RateStatus, RecipeStatus, Status};
pub use store::{Store, StoreError, StoreSettings};
