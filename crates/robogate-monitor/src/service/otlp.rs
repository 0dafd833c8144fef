//! Alarms as log records of OpenTelemetry (OTLP 1 over HTTP, JSON).

use std::time::Duration;

use serde_json::{Value, json};

use super::outputs::{Deliver, OutputError};
use crate::{Alarm, Happening, Level};

/// Largest answer that is read, in bytes.
const ANSWER: u64 = 1 << 16;

/// Creates an output that sends alarms to a collector, for example `http://127.0.0.1:4318`. An alarm that the collector refuses
/// for good (status 400, or a partial success) is reported to `problem` and not sent again, as the protocol requires.
pub fn otlp(url: &str, problem: impl Fn(&str) + Send + 'static) -> Deliver {
    let url = url.trim_end_matches('/');
    let url = if url.ends_with("/v1/logs") { url.to_owned() } else { format!("{url}/v1/logs") };
    let config = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(10))).max_redirects(0);
    let agent: ureq::Agent = config.http_status_as_error(false).build().into();
    Box::new(move |alarm| {
        let failed = |because: String| OutputError(format!("{url}: {because}"));
        let alarm: Alarm = serde_json::from_str(alarm).map_err(|error| failed(error.to_string()))?;
        let request = agent.post(&url).header("content-type", "application/json");
        let mut answer = request.send(record(&alarm).to_string()).map_err(|error| failed(error.to_string()))?;
        let status = answer.status();
        if !status.is_success() && status != 400 {
            return Err(failed(format!("it answered {status}")));
        }
        let text = answer.body_mut().with_config().limit(ANSWER).read_to_string().unwrap_or_default();
        let refused = serde_json::from_str::<Value>(&text).ok().and_then(|answer| {
            let partial = answer.get("partialSuccess")?;
            let rejected = partial.get("rejectedLogRecords").is_some_and(|n| *n != json!(0) && *n != json!("0"));
            rejected.then(|| partial.get("errorMessage").map_or_else(String::new, Value::to_string))
        });
        if let Some(because) = refused.or((status == 400).then_some(text)) {
            problem(&format!("{url}: the alarm {} was refused: {}", alarm.id, because.escape_debug()));
        }
        Ok(())
    })
}

/// The request with one alarm.
fn record(alarm: &Alarm) -> Value {
    let text = |key: &str, value: &str| json!({ "key": key, "value": { "stringValue": value } });
    let (number, severity) = match (alarm.happening, alarm.level) {
        (Happening::Cleared, _) => (9, "INFO"),
        (Happening::Raised, Level::Warning) => (13, "WARN"),
        (Happening::Raised, Level::Critical) => (17, "ERROR"),
    };
    let happening = if alarm.happening == Happening::Raised { "raised" } else { "cleared" };
    let causes: Vec<Value> = alarm.look_at.iter().map(|cause| json!({ "stringValue": cause })).collect();
    let attributes = json!([
        text("robogate.alarm.id", &alarm.id),
        text("robogate.alarm.happening", happening),
        text("robogate.alarm.level", alarm.level.as_str()),
        text("robogate.alarm.how_sure", &alarm.how_sure),
        text("robogate.metric", &alarm.metric),
        text("robogate.recipe", &alarm.recipe),
        text("robogate.robot", &alarm.robot),
        text("robogate.cycle.id", &alarm.cycle_id),
        { "key": "robogate.cycle.number", "value": { "intValue": alarm.cycle.to_string() } },
        { "key": "robogate.alarm.look_at", "value": { "arrayValue": { "values": causes } } },
    ]);
    // Integers of 64 bits are texts in this encoding.
    let time = ((alarm.time_s * 1e6) as u64).saturating_mul(1_000).to_string();
    let log = json!({ "timeUnixNano": time, "severityNumber": number, "severityText": severity, "eventName": "robogate.alarm",
        "body": { "stringValue": alarm.what }, "attributes": attributes });
    json!({ "resourceLogs": [{
        "resource": { "attributes": [text("service.name", "robogate-monitor")] },
        "scopeLogs": [{ "scope": { "name": "robogate", "version": env!("CARGO_PKG_VERSION") }, "logRecords": [log] }],
    }] })
}
