//! The settings file of the service.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::store::StoreSettings;
use crate::{Settings, SettingsError};

/// The settings of the service. Missing settings have their default values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ServiceSettings {
    /// The detectors.
    pub detectors: Settings,
    /// The store.
    pub store: StoreSettings,
    /// Limits of the HTTP server.
    pub http: HttpSettings,
    /// A cycle that is older than the newest of its robot by more than this is late, in seconds of the sender's clock.
    pub late_after_s: f64,
    /// How many new recipes a client of HTTP or MQTT may add in an hour, at once or one by one. Further ones are refused.
    pub new_recipes_per_hour: u32,
}

impl ServiceSettings {
    /// Checks all settings.
    ///
    /// # Errors
    /// The first problem.
    pub fn check(&self) -> Result<(), SettingsError> {
        self.detectors.check()?;
        let HttpSettings { requests_per_s, head_s, body_s, answer_s, connection_s, .. } = self.http;
        for (setting, value, low, high, range) in [
            ("new_recipes_per_hour", self.new_recipes_per_hour.into(), 1.0, 1e9, "from 1 to 1e9"),
            ("late_after_s", self.late_after_s, 0.0, 1e9, "from 0 to 1e9"),
            ("http.requests_per_s", requests_per_s, 0.1, 1e6, "from 0.1 to 1e6"),
            ("http.head_s", head_s, 0.1, 3_600.0, "from 0.1 to 3600"),
            ("http.body_s", body_s, 0.1, 3_600.0, "from 0.1 to 3600"),
            ("http.answer_s", answer_s, 0.1, 3_600.0, "from 0.1 to 3600"),
            ("http.connection_s", connection_s, 1.0, 1e6, "from 1 to 1e6"),
            ("http.most_connections", self.http.most_connections as f64, 1.0, 1e6, "from 1 to 1e6"),
            ("http.most_body_bytes", self.http.most_body_bytes as f64, 1.0, 1e9, "from 1 to 1e9"),
            ("store.keep_cycles", self.store.keep_cycles as f64, 1.0, 1e12, "from 1 to 1e12"),
            ("store.keep_alarms", self.store.keep_alarms as f64, 1.0, 1e12, "from 1 to 1e12"),
            ("store.most_mib", self.store.most_mib as f64, 0.0, 1e9, "from 0 to 1e9"),
        ] {
            if !(value >= low && value <= high) {
                return Err(SettingsError::Range { setting, value, range });
            }
        }
        Ok(())
    }
}

impl Default for ServiceSettings {
    fn default() -> Self {
        Self {
            detectors: Settings::default(),
            store: StoreSettings::default(),
            http: HttpSettings::default(),
            late_after_s: 3_600.0,
            new_recipes_per_hour: 200,
        }
    }
}

/// Limits of the HTTP server.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HttpSettings {
    /// Maximum size of a body, in bytes.
    pub most_body_bytes: usize,
    /// Maximum total size of all bodies in memory, from their arrival until they are on disk, in bytes.
    pub most_held_bytes: usize,
    /// Maximum number of connections.
    pub most_connections: usize,
    /// Maximum number of connections from one address.
    pub most_connections_per_address: usize,
    /// Maximum number of requests per second from one address. A burst may have ten times as many.
    pub requests_per_s: f64,
    /// Timeout for a request's head, and for an idle connection, in seconds.
    pub head_s: f64,
    /// Timeout for a request's body, in seconds.
    pub body_s: f64,
    /// Timeout after which a request without a reply is aborted, in seconds.
    pub answer_s: f64,
    /// Age after which a connection accepts no further request, in seconds.
    pub connection_s: f64,
}

impl Default for HttpSettings {
    fn default() -> Self {
        Self {
            most_body_bytes: 16 << 20,
            most_held_bytes: 128 << 20,
            most_connections: 1_024,
            most_connections_per_address: 512,
            requests_per_s: 2_000.0,
            head_s: 10.0,
            body_s: 30.0,
            answer_s: 30.0,
            connection_s: 600.0,
        }
    }
}
