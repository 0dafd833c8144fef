//! ROS 2 through rosbridge (protocol v2, JSON): subscribes to the topics of a map, and publishes alarms as
//! `diagnostic_msgs/msg/DiagnosticArray`. No ROS installation is needed. Nothing that a server sends starts code.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use robogate_core::budget::Budget;
use serde::Deserialize;
use serde_json::{Value, json};

use super::batch::Batch;
use super::engine::Handle;
use super::outputs::{Deliver, OutputError};
use super::topics::{TopicMap, TopicReader};
use super::warnings::Periods;
use crate::{Alarm, Happening, Level};

/// Time until the next attempt to connect, and longest wait for a message before other work is looked at.
const AGAIN: Duration = Duration::from_secs(1);
/// Time without a message after which the server gets a ping, and time after which the connection is opened again.
const ASK_AFTER: Duration = Duration::from_secs(10);
const SILENT_AFTER: Duration = Duration::from_secs(30);
/// Time for subscribers to find a new publisher. DDS delivers nothing to those that have not.
const DISCOVERY: Duration = Duration::from_millis(500);
/// Time until the server must have received an alarm.
const RECEIVED: Duration = Duration::from_secs(10);
/// Limits on a message of the server.
const MESSAGE: Budget = Budget { bytes: 8 << 20, values: 1 << 18, depth: 64 };
/// Longest part of a text of the server in a problem, in bytes.
const QUOTED: usize = 300;

/// What a server sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Received {
    /// A message.
    Text(String),
    /// The answer to a ping.
    Pong,
}

/// A WebSocket connection to rosbridge. Errors are texts.
pub trait Bridge: Send {
    /// Sends a message, or a ping.
    fn send(&mut self, text: Option<String>) -> Result<(), String>;
    /// Waits for a message. `None` if no message arrives in this time.
    fn receive(&mut self, within: Duration) -> Result<Option<Received>, String>;
}

/// Opens a connection.
pub type Connect = Box<dyn FnMut() -> Result<Box<dyn Bridge>, String> + Send>;

/// A message of the server, with the fields that are used.
#[derive(Deserialize)]
struct FromServer {
    op: String,
    #[serde(default)]
    topic: String,
    #[serde(default)]
    msg: Value,
    #[serde(default)]
    level: String,
}

impl FromServer {
    fn parse(text: &str) -> Result<Self, String> {
        MESSAGE.json(text.as_bytes()).map_err(|error| format!("a message of the server: {error}"))
    }

    /// The error or warning that the server reports.
    fn problem(&self) -> Option<String> {
        let reported = self.op == "status" && matches!(self.level.as_str(), "error" | "warning");
        reported.then(|| {
            let mut text = self.msg.as_str().map_or_else(|| self.msg.to_string(), str::to_owned);
            text.truncate(text.floor_char_boundary(QUOTED));
            format!("the server reports: {}", text.replace(|c: char| c.is_control(), " "))
        })
    }
}

/// Processes cycles from the topics of a map until `end` is set. `problem` receives error messages.
pub fn subscribe(
    map: TopicMap,
    mut connect: Connect,
    engine: Handle,
    end: Arc<AtomicBool>,
    problem: impl Fn(&str) + Send + 'static,
) -> JoinHandle<()> {
    std::thread::spawn(move || {
        let mut reader = TopicReader::new(map);
        let mut last = String::new();
        while !end.load(Ordering::Acquire) {
            // Messages during an outage are lost, so what is left of the cycle before must not complete another one.
            reader.forget();
            let ended = connect().and_then(|bridge| {
                last.clear();
                follow(bridge, &mut reader, &engine, &end, &problem)
            });
            let Err(because) = ended else { return };
            if because != last {
                problem(&format!("rosbridge: {because}. Trying again every {} s", AGAIN.as_secs()));
                last = because;
            }
            std::thread::sleep(AGAIN);
        }
    })
}

/// Follows one connection, until it fails or `end` is set.
fn follow(
    mut bridge: Box<dyn Bridge>,
    reader: &mut TopicReader,
    engine: &Handle,
    end: &AtomicBool,
    problem: &impl Fn(&str),
) -> Result<(), String> {
    for (topic, type_name) in reader.map().topics() {
        let mut request =
            json!({ "op": "subscribe", "id": format!("robogate:{topic}"), "topic": topic, "queue_length": 0 });
        if let Some(type_name) = type_name {
            request["type"] = type_name.into();
        }
        bridge.send(Some(request.to_string()))?;
    }
    let (mut heard, mut asked) = (Instant::now(), false);
    while !end.load(Ordering::Acquire) {
        match bridge.receive(AGAIN)? {
            Some(received) => {
                (heard, asked) = (Instant::now(), false);
                let Received::Text(text) = received else { continue };
                match FromServer::parse(&text) {
                    Ok(message) => hear(message, reader, engine, end, problem),
                    Err(because) => problem(&format!("rosbridge: {because}")),
                }
            }
            None if heard.elapsed() > SILENT_AFTER => return Err("the server does not answer".to_owned()),
            None if heard.elapsed() > ASK_AFTER && !asked => {
                bridge.send(None)?;
                asked = true;
            }
            None => {}
        }
    }
    Ok(())
}

fn hear(message: FromServer, reader: &mut TopicReader, engine: &Handle, end: &AtomicBool, problem: &impl Fn(&str)) {
    if let Some(because) = message.problem() {
        problem(&format!("rosbridge: {because}"));
    }
    if message.op != "publish" {
        return;
    }
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    let topic = message.topic;
    let cycle = reader.observe(&topic, now, message.msg);
    let periods = reader.take_periods();
    if !periods.is_empty() {
        // A control period that comes late is worth nothing, so it is not tried again.
        match engine.hear(Periods::of(periods, now)) {
            Ok(heard) => heard.rejections.iter().for_each(|of| problem(&format!("rosbridge: {topic}: {}", of.because))),
            Err(because) => problem(&format!("rosbridge: {because}")),
        }
    }
    let Some(cycle) = cycle else { return };
    let batch = Batch::of(vec![cycle]).sent_by("rosbridge");
    while !end.load(Ordering::Acquire) {
        match engine.take_parsed(batch.clone()) {
            Ok(taken) => {
                if let Some(refused) = taken.refusals.first() {
                    problem(&format!("rosbridge: {topic}: {}", refused.because));
                }
                return;
            }
            Err(because) => {
                problem(&format!("rosbridge: {because}"));
                std::thread::sleep(AGAIN);
            }
        }
    }
}

/// Creates an output that publishes alarms on a topic. An alarm is delivered when the server answered a ping that was sent
/// after it, and reported no error until then.
pub fn diagnostics(topic: String, mut connect: Connect) -> Deliver {
    let mut advertise = move |topic: &str| {
        let mut bridge = connect()?;
        let message = json!({ "op": "advertise", "id": format!("robogate:{topic}"), "topic": topic, "latch": true,
            "type": "diagnostic_msgs/msg/DiagnosticArray" });
        bridge.send(Some(message.to_string()))?;
        Ok::<_, String>((bridge, Instant::now()))
    };
    // Connects at the start, so that subscribers know the publisher before the first alarm. A failure is reported with it.
    let mut open = advertise(&topic).ok();
    Box::new(move |alarm| {
        let mut deliver = || {
            let (mut bridge, since) = match open.take() {
                Some(open) => open,
                None => advertise(&topic)?,
            };
            std::thread::sleep(DISCOVERY.saturating_sub(since.elapsed()));
            let alarm: Alarm = serde_json::from_str(alarm).map_err(|error| error.to_string())?;
            let message = json!({ "op": "publish", "id": format!("robogate:{topic}"), "topic": topic,
                "msg": diagnostic_array(&alarm) });
            bridge.send(Some(message.to_string()))?;
            bridge.send(None)?;
            await_pong(&mut *bridge)?;
            open = Some((bridge, since));
            Ok(())
        };
        deliver().map_err(|because: String| OutputError(format!("rosbridge: {because}")))
    })
}

fn await_pong(bridge: &mut dyn Bridge) -> Result<(), String> {
    let sent = Instant::now();
    while let Some(left) = RECEIVED.checked_sub(sent.elapsed()) {
        match bridge.receive(left)? {
            Some(Received::Pong) => return Ok(()),
            Some(Received::Text(text)) => {
                if let Some(problem) = FromServer::parse(&text)?.problem() {
                    return Err(problem);
                }
            }
            None => break,
        }
    }
    Err(format!("the server did not answer within {} s", RECEIVED.as_secs()))
}

/// The message of an alarm. Its level is that of `diagnostic_msgs/msg/DiagnosticStatus`; a cleared alarm is OK.
fn diagnostic_array(alarm: &Alarm) -> Value {
    let level = match (alarm.happening, alarm.level) {
        (Happening::Cleared, _) => 0,
        (Happening::Raised, Level::Warning) => 1,
        (Happening::Raised, Level::Critical) => 2,
    };
    let mut values = vec![
        ("id", alarm.id.clone()),
        ("recipe", alarm.recipe.clone()),
        ("metric", alarm.metric.clone()),
        ("cycle_id", alarm.cycle_id.clone()),
        ("how_sure", alarm.how_sure.clone()),
    ];
    values.extend(alarm.since.map(|since| ("since_s", since.time_s.to_string())));
    values.extend(alarm.look_at.iter().map(|cause| ("look_at", cause.clone())));
    let values: Vec<Value> = values.into_iter().map(|(key, value)| json!({ "key": key, "value": value })).collect();
    let seconds = alarm.time_s.floor();
    let nanoseconds = ((alarm.time_s - seconds) * 1e9) as u32;
    // The seconds of a ROS time have 32 bits.
    let stamp = json!({ "sec": seconds.clamp(0.0, f64::from(i32::MAX)) as i32, "nanosec": nanoseconds });
    let status = json!({ "level": level, "name": format!("robogate: {}: {}", alarm.recipe, alarm.metric),
        "message": alarm.what, "hardware_id": alarm.robot, "values": values });
    json!({ "header": { "stamp": stamp, "frame_id": "" }, "status": [status] })
}

#[cfg(test)]
mod tests {
    use robogate_testing::fuzz::Target;

    use super::*;

    /// Messages of a server, up to the cycle that a map makes of them.
    #[test]
    fn fuzzed_messages_are_read_or_refused() {
        let map = r#"
            robot = "cell-1"
            recipe = "bracket"
            success = { field = "status", is = ["ok"] }
            failure_mode = "status"
            id = "serial"
            [end]
            topic = "/cell/result"
            time = "header.stamp"
            [parameters]
            mass_kg = "angles.1"
        "#;
        let map = TopicMap::parse(map).unwrap();
        let message = |status: &str| {
            let stamp = json!({ "sec": 1_795_254_000_u64, "nanosec": 5 });
            let msg = json!({ "header": { "stamp": stamp }, "serial": 7, "status": status, "angles": [0.5, 1e3] });
            json!({ "op": "publish", "topic": "/cell/result", "msg": msg }).to_string().into_bytes()
        };
        let reports = json!({ "op": "status", "level": "error", "msg": "no such topic" }).to_string().into_bytes();
        let valid = [message("ok"), message("jammed")];
        let words =
            ["\"publish\"", "\"/cell/result\"", "\"status\"", "\"stamp\"", "null", "1e400", "-1", "[", "{", "\"\""];
        Target { name: "rosbridge", valid: &valid, kept: &[reports], words: &words, inputs: 500 }.run(|bytes| {
            let Ok(text) = std::str::from_utf8(bytes) else { return false };
            let Ok(message) = FromServer::parse(text) else { return false };
            let _ = message.problem();
            let mut reader = TopicReader::new(map.clone());
            reader.observe(&message.topic, 5.0, message.msg).is_some_and(|cycle| cycle.is_ok())
        });
    }
}
