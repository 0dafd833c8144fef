//! The monitoring service: receives cycles by HTTP, MQTT, rosbridge or as lines, writes them to disk before it acknowledges them,
//! and sends alarms.
//!
//! One thread owns the store and the monitor ([`ServiceEngine`]). Feeds send bytes to it and wait for the reply.
//! Requests that wait at the same time share one commit.

mod admission;
mod batch;
mod charts;
mod engine;
mod fleet;
mod http;
mod intake;
mod local;
mod metrics;
mod mqtt;
mod nearest;
mod newcomers;
mod otlp;
mod outputs;
mod peers;
mod replays;
mod rosbridge;
mod senders;
mod settings;
mod status;
mod store;
mod topics;
mod warnings;

pub use batch::{Batch, MOST_LINES, MOST_MALFORMED, TooManyLines};
pub use charts::{Charts, EvidenceChart, MetricChart};
pub use engine::{Busy, Handle, ServiceEngine};
pub use fleet::{FleetStatus, OutlierStatus, RecipeFleet, RobotStatus, SpreadStatus};
pub use http::{HttpError, serve};
pub use intake::{Intake, IntakeError, Refused, Taken};
pub use local::{LocalReply, LocalRequest, random_token, serve_local};
pub use mqtt::Broker;
pub use nearest::{Episodes, NearestEpisode, SimulatedEpisode};
pub use otlp::otlp;
pub use outputs::{Deliver, Output, OutputError, json_lines, webhook};
pub use replays::{Recompute, Replays};
pub use rosbridge::{Bridge, Connect, Received, diagnostics, subscribe};
pub use settings::{HttpSettings, ServiceSettings};
pub use status::{Around, DetectorStatus, OutsideStatus, RateStatus, RecipeStatus, Status};
pub use store::{Store, StoreError, StoreSettings};
pub use topics::{Name, PeriodMap, Picked, Place, Topic, TopicMap, TopicReader};
pub use warnings::{HeardPeriods, Periods, SentWarning, WarningStatus};
