//! Cycles from the messages of topics, as in ROS 2: a map says which message ends a cycle, and which fields of which
//! messages hold its values.

use std::collections::BTreeMap;

use robogate_core::budget::Budget;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::warn::Period;
use crate::{Cycle, MOST_PARAMETERS, ParameterValue};

/// Limits on a text within a message that contains JSON.
const WITHIN: Budget = Budget { bytes: 1 << 20, values: 1 << 16, depth: 32 };

/// A topic and the type of its messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Topic {
    /// The name, for example `/cell/result`.
    pub topic: String,
    /// The type of its messages, for example `std_msgs/msg/String`. Absent: the one that the server knows.
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    pub type_name: Option<String>,
    /// Field with the time of a message: seconds since 1970, or a ROS time. Absent: the time at which it was received.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<String>,
}

/// A value that is the same for all cycles, or a field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a text, or a table with `field` and optionally `topic`, `type`, `is`")]
pub enum Name {
    /// The value.
    Constant(String),
    /// A field of a message.
    Field(Place),
}

/// A field of a message: its path, or a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a field, or a table with `field` and optionally `topic`, `type`, `is`")]
pub enum Picked {
    /// The path of a field of the message that ends the cycle: names and indices from 0, separated by dots. A path that
    /// goes on within a text reads that text as JSON.
    Path(String),
    /// A field of any message.
    Field(Place),
}

/// A field of a message.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// The topic. The newest message since the end of the cycle before counts. Absent: that of the message that ends the
    /// cycle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// The type of its messages.
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    pub type_name: Option<String>,
    /// The path of the field.
    pub field: String,
    /// Values that mean true, for `success` and events. Absent: true, numbers other than 0.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub is: Vec<Value>,
}

/// How messages become control periods, for a detector of warnings within episodes. An episode begins with the message `start` of the
/// map and ends with `end`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PeriodMap {
    /// The topic of which each message is a control period: that of the command, which comes before its execution.
    pub topic: String,
    /// The type of its messages. Absent: the one that the server knows.
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    pub type_name: Option<String>,
    /// Field with the time of a message: seconds since 1970, or a ROS time. Absent: the time at which it was received.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<String>,
    /// The observed vectors of the task, by name. A field is a number or a list of numbers.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub observation: BTreeMap<String, Picked>,
    /// The command, by its kind.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub command: BTreeMap<String, Picked>,
    /// The command of the gripper.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper: Option<Picked>,
}

/// How messages become cycles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TopicMap {
    /// The robot.
    pub robot: Name,
    /// The recipe.
    pub recipe: Name,
    /// The message that ends a cycle.
    pub end: Topic,
    /// The message that starts a cycle. Its time gives the cycle time, unless there is a field for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<Topic>,
    /// Whether the task succeeded.
    pub success: Picked,
    /// The id. Absent: the robot and the time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<Picked>,
    /// The failure mode, read for failures only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure_mode: Option<Picked>,
    /// The cycle time, in seconds or as a ROS duration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cycle_time_s: Option<Picked>,
    /// Events, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub events: BTreeMap<String, Picked>,
    /// Parameters, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, Picked>,
    /// Control periods within the cycles. It needs `start`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub period: Option<PeriodMap>,
}

impl TopicMap {
    /// Reads a map.
    ///
    /// # Errors
    /// The problem, as text.
    pub fn parse(text: &str) -> Result<Self, String> {
        let map: Self = Budget::FILE.toml(text).map_err(|error| error.to_string())?;
        for (name, count) in [("events", map.events.len()), ("parameters", map.parameters.len())] {
            if count > MOST_PARAMETERS {
                return Err(format!("{name}: {count} entries. Expected at most {MOST_PARAMETERS}"));
            }
        }
        let vectors = map.period.as_ref().map_or(0, |period| period.observation.len() + period.command.len());
        if vectors > MOST_PARAMETERS {
            return Err(format!("period: {vectors} vectors. Expected at most {MOST_PARAMETERS}"));
        }
        if map.period.is_some() && map.start.is_none() {
            return Err("[period] needs [start], the message that starts an episode".to_owned());
        }
        Ok(map)
    }

    /// All topics, each with its type if the map names it.
    pub fn topics(&self) -> BTreeMap<&str, Option<&str>> {
        let mut all: BTreeMap<&str, Option<&str>> = BTreeMap::new();
        let ends = [Some(&self.end), self.start.as_ref()];
        let ends = ends.into_iter().flatten().map(|topic| (topic.topic.as_str(), topic.type_name.as_deref()));
        let names = [&self.robot, &self.recipe].into_iter().filter_map(|name| match name {
            Name::Field(place) => Some(place),
            Name::Constant(_) => None,
        });
        let options = [Some(&self.success), self.id.as_ref(), self.failure_mode.as_ref(), self.cycle_time_s.as_ref()];
        let period = self.period.iter();
        let vectors =
            period.clone().flat_map(|of| of.observation.values().chain(of.command.values()).chain(&of.gripper));
        let picked = options.into_iter().flatten().chain(self.events.values()).chain(self.parameters.values());
        let picked = picked.chain(vectors);
        let places = names.chain(picked.filter_map(|picked| match picked {
            Picked::Field(place) => Some(place),
            Picked::Path(_) => None,
        }));
        let places = places.filter_map(|place| Some((place.topic.as_deref()?, place.type_name.as_deref())));
        let period = period.map(|of| (of.topic.as_str(), of.type_name.as_deref()));
        for (topic, type_name) in ends.chain(places).chain(period) {
            let known = all.entry(topic).or_default();
            *known = known.or(type_name);
        }
        all
    }
}

/// Collects messages until a cycle ends.
#[derive(Debug)]
pub struct TopicReader {
    map: TopicMap,
    /// The newest message of each topic in this cycle.
    latest: BTreeMap<String, Value>,
    started_s: Option<f64>,
    /// Control periods, starts and ends that were not taken yet.
    periods: Vec<Result<Period, String>>,
}

impl TopicReader {
    /// A reader without messages.
    pub fn new(map: TopicMap) -> Self {
        Self { map, latest: BTreeMap::new(), started_s: None, periods: Vec::new() }
    }

    /// The map.
    pub fn map(&self) -> &TopicMap {
        &self.map
    }

    /// Forgets the messages of the current cycle, because messages were missed.
    pub fn forget(&mut self) {
        self.latest.clear();
        self.started_s = None;
    }

    /// Processes a message that was received at this time, in seconds since 1970. Returns the cycle that it ends.
    ///
    /// # Errors
    /// The problem with that cycle, as text.
    pub fn observe(&mut self, topic: &str, received_s: f64, message: Value) -> Option<Result<Cycle, String>> {
        if !self.map.topics().contains_key(topic) {
            return None;
        }
        if let Some(start) = self.map.start.as_ref().filter(|start| start.topic == topic) {
            let started_s = time_of(start.time.as_deref(), &message).unwrap_or(received_s);
            self.started_s = Some(started_s);
            if self.map.period.is_some() {
                self.latest.insert(topic.to_owned(), message.clone());
                let start = Some(self.parameters());
                let period = self.of_robot(Period { start, started_s: Some(started_s), ..Period::default() });
                self.periods.push(period);
            }
        }
        self.latest.insert(topic.to_owned(), message);
        if self.map.period.as_ref().is_some_and(|period| period.topic == topic) {
            self.periods.extend(self.period(received_s));
        }
        if self.map.end.topic != topic {
            return None;
        }
        let cycle = self.cycle(received_s);
        if let (Some(_), Some(_), Ok(cycle)) = (&self.map.period, self.started_s, &cycle) {
            let end = if cycle.success { Some("success") } else { cycle.failure_mode.as_deref().or(Some("failure")) };
            let end = end.map(str::to_owned);
            self.periods.push(self.of_robot(Period { end, ..Period::default() }));
        }
        self.forget();
        Some(cycle)
    }

    /// Takes the control periods since the last call.
    pub fn take_periods(&mut self) -> Vec<Result<Period, String>> {
        std::mem::take(&mut self.periods)
    }

    /// A period of the robot and its recipe, if they are known already.
    fn of_robot(&self, period: Period) -> Result<Period, String> {
        let recipe = self.name("recipe", &self.map.recipe).ok();
        Ok(Period { robot: self.name("robot", &self.map.robot)?, recipe, ..period })
    }

    /// The control period of the newest message. `None` outside of an episode.
    fn period(&self, received_s: f64) -> Option<Result<Period, String>> {
        let (map, started_s) = (self.map.period.as_ref()?, self.started_s?);
        let now_s = self.latest.get(&map.topic).and_then(|message| time_of(map.time.as_deref(), message));
        let vector = |(name, picked): (&String, &Picked)| {
            let (_, value) = self.find_in(&map.topic, picked);
            Some((name.clone(), numbers(&value?)?))
        };
        let gripper = map.gripper.as_ref().and_then(|picked| self.find_in(&map.topic, picked).1?.as_f64());
        Some(self.of_robot(Period {
            time_s: Some(now_s.unwrap_or(received_s) - started_s),
            started_s: Some(started_s),
            observation: map.observation.iter().filter_map(vector).collect(),
            command: map.command.iter().filter_map(vector).collect(),
            gripper,
            ..Period::default()
        }))
    }

    /// The parameters that are known now.
    fn parameters(&self) -> BTreeMap<String, ParameterValue> {
        let parameters = self.map.parameters.iter();
        parameters.filter_map(|(name, picked)| Some((name.clone(), parameter(&self.find(picked).1?)?))).collect()
    }

    fn cycle(&self, received_s: f64) -> Result<Cycle, String> {
        let map = &self.map;
        let time_s = self.latest.get(&map.end.topic).and_then(|message| time_of(map.end.time.as_deref(), message));
        let time_s = match (time_s, &map.end.time) {
            (None, Some(field)) => return Err(format!("time: {} has no time in `{field}`", map.end.topic)),
            (time_s, _) => time_s.unwrap_or(received_s),
        };
        let robot = self.name("robot", &map.robot)?;
        let (at, success) = self.find(&map.success);
        let success = success.and_then(|value| flag(&value, self.is(&map.success))).ok_or_else(|| {
            format!("success: {at} is missing or is neither true nor false\nHint: name its good values with `is`")
        })?;
        let text = |picked: &Picked| self.find(picked).1.as_ref().and_then(text).filter(|text| !text.is_empty());
        let id = match &map.id {
            Some(picked) => text(picked).ok_or_else(|| format!("id: {} is missing", self.find(picked).0))?,
            None => format!("{robot}/{time_s:.6}"),
        };
        let measured = map.cycle_time_s.as_ref().and_then(|picked| seconds(&self.find(picked).1?));
        let events = map.events.iter();
        let cycle = Cycle {
            id,
            recipe: self.name("recipe", &map.recipe)?,
            robot,
            time_s,
            success,
            failure_mode: map.failure_mode.as_ref().filter(|_| !success).and_then(text),
            events: events
                .filter_map(|(name, picked)| Some((name.clone(), flag(&self.find(picked).1?, self.is(picked))?)))
                .collect(),
            cycle_time_s: measured.or(self.started_s.map(|started| time_s - started)),
            parameters: self.parameters(),
        };
        cycle.check().map_err(|error| error.to_string())?;
        Ok(cycle)
    }

    fn name(&self, what: &str, name: &Name) -> Result<String, String> {
        match name {
            Name::Constant(name) => Ok(name.clone()),
            Name::Field(place) => {
                let (at, value) = self.find(&Picked::Field(place.clone()));
                value.as_ref().and_then(text).ok_or_else(|| format!("{what}: {at} is missing"))
            }
        }
    }

    /// The name of a field for messages, and its value in this cycle.
    fn find(&self, picked: &Picked) -> (String, Option<Value>) {
        self.find_in(&self.map.end.topic, picked)
    }

    /// The same, where a field without a topic is one of this topic.
    fn find_in(&self, of: &str, picked: &Picked) -> (String, Option<Value>) {
        let (topic, path) = match picked {
            Picked::Path(path) => (None, path),
            Picked::Field(place) => (place.topic.as_deref(), &place.field),
        };
        let topic = topic.unwrap_or(of);
        (format!("`{path}` of {topic}"), self.latest.get(topic).and_then(|message| at(message, path)))
    }

    fn is<'a>(&self, picked: &'a Picked) -> &'a [Value] {
        match picked {
            Picked::Field(place) => &place.is,
            Picked::Path(_) => &[],
        }
    }
}

/// The value at a path. A path that goes on within a text reads that text as JSON.
fn at(message: &Value, path: &str) -> Option<Value> {
    let (first, rest) = path.split_once('.').map_or((path, None), |(first, rest)| (first, Some(rest)));
    let inner = match message {
        Value::Object(fields) => fields.get(first)?,
        Value::Array(items) => items.get(first.parse::<usize>().ok()?)?,
        Value::String(text) => {
            return at(&WITHIN.json(text.as_bytes()).ok().filter(|json: &Value| !json.is_string())?, path);
        }
        _ => return None,
    };
    rest.map_or_else(|| Some(inner.clone()), |rest| at(inner, rest))
}

fn time_of(field: Option<&str>, message: &Value) -> Option<f64> {
    seconds(&at(message, field?)?)
}

/// A number, or a list of numbers.
fn numbers(value: &Value) -> Option<Vec<f64>> {
    match value {
        Value::Array(items) => items.iter().map(Value::as_f64).collect(),
        value => Some(vec![value.as_f64()?]),
    }
}

/// Seconds as a number, or as a time or duration of ROS 1 or 2.
fn seconds(value: &Value) -> Option<f64> {
    let part = |names: [&str; 2]| names.iter().find_map(|name| value.get(name)?.as_f64());
    value.as_f64().or_else(|| Some(part(["sec", "secs"])? + 1e-9 * part(["nanosec", "nsecs"])?))
}

fn flag(value: &Value, is: &[Value]) -> Option<bool> {
    match value {
        Value::Null => None,
        value if !is.is_empty() => {
            Some(is.iter().any(|good| good == value || good.as_f64().is_some_and(|x| value.as_f64() == Some(x))))
        }
        Value::Bool(flag) => Some(*flag),
        value => value.as_f64().map(|number| number != 0.0),
    }
}

fn text(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    }
}

fn parameter(value: &Value) -> Option<ParameterValue> {
    match value {
        Value::String(word) => Some(ParameterValue::Word(word.clone())),
        Value::Bool(flag) => Some(ParameterValue::Word(flag.to_string())),
        value => seconds(value).map(ParameterValue::Number),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const MAP: &str = r#"
        robot = "cell-1"
        recipe = { topic = "/plc/order", field = "product" }
        success = { field = "status", is = ["ok", 4] }
        failure_mode = "reason"
        id = "data.serial"
        [end]
        topic = "/cell/result"
        type = "cell_msgs/msg/Result"
        time = "header.stamp"
        [start]
        topic = "/cell/start"
        [events]
        drop = "dropped"
        [parameters]
        mass_kg = { topic = "/scale", type = "std_msgs/msg/Float64", field = "data" }
        tilt = "angles.1"
    "#;

    #[test]
    fn fuzzed_maps_are_read_or_refused() {
        let words =
            ["[end]", "[start]", "[events]", "[parameters]", "{ topic = \"/x\", field = \"y.0.z\" }", "is = []", "="];
        let valid = [MAP.as_bytes().to_vec()];
        robogate_testing::fuzz::Target { name: "topics", valid: &valid, kept: &[], words: &words, inputs: 500 }
            .run(|bytes| std::str::from_utf8(bytes).is_ok_and(|text| TopicMap::parse(text).is_ok()));
    }

    fn result(status: &Value) -> Value {
        json!({ "header": { "stamp": { "sec": 1_795_254_008, "nanosec": 500_000_000 } }, "status": status, "reason": "jammed",
            "dropped": 0, "angles": [0.5, 0.25], "data": "{\"serial\": 17}" })
    }

    #[test]
    fn messages_become_cycles() {
        let mut reader = TopicReader::new(TopicMap::parse(MAP).unwrap());
        let topics = reader.map().topics();
        assert_eq!(topics.len(), 4);
        assert_eq!(topics["/scale"], Some("std_msgs/msg/Float64"));
        let feed = |reader: &mut TopicReader, status: Value| {
            assert!(reader.observe("/plc/order", 1_795_254_001.0, json!({ "product": "bracket" })).is_none());
            assert!(reader.observe("/cell/start", 1_795_254_004.0, json!({})).is_none());
            assert!(reader.observe("/camera", 1_795_254_004.0, json!({})).is_none());
            reader.observe("/cell/result", 1_795_254_009.0, result(&status)).unwrap()
        };
        reader.observe("/scale", 1.0, json!({ "data": 0.25 }));
        let good = feed(&mut reader, json!("ok")).unwrap();
        let expected = json!({ "id": "17", "robot": "cell-1", "recipe": "bracket", "time_s": 1_795_254_008.5, "success": true,
            "events": { "drop": false }, "cycle_time_s": 4.5, "parameters": { "mass_kg": 0.25, "tilt": 0.25 } });
        assert_eq!(serde_json::to_value(&good).unwrap(), expected);
        // A value of the cycle before does not count again.
        let bad = feed(&mut reader, json!("aborted")).unwrap();
        assert_eq!((bad.success, bad.failure_mode.as_deref(), bad.parameters.len()), (false, Some("jammed"), 1));
        assert!(feed(&mut reader, json!(4.0)).unwrap().success);
    }

    #[test]
    fn incomplete_cycles_name_the_field() {
        let mut reader = TopicReader::new(TopicMap::parse(MAP).unwrap());
        let end = |reader: &mut TopicReader, message: Value| {
            reader.observe("/cell/result", 9.0, message).unwrap().unwrap_err()
        };
        assert!(end(&mut reader, json!({})).contains("no time in `header.stamp`"));
        reader.observe("/plc/order", 1.0, json!({ "product": "bracket" }));
        assert!(end(&mut reader, result(&json!(null))).starts_with("success: `status` of /cell/result"));
        assert!(end(&mut reader, result(&json!("ok"))).starts_with("recipe: `product` of /plc/order"));
        let wrong = TopicMap::parse(&MAP.replace("\"reason\"", "3")).unwrap_err();
        assert!(wrong.contains("expected a field, or a table"), "{wrong}");
    }

    #[test]
    fn texts_within_messages_are_bounded() {
        let deep = format!("{}1{}", "[".repeat(100_000), "]".repeat(100_000));
        assert_eq!(at(&json!({ "data": deep }), "data.0"), None);
        assert_eq!(at(&json!({ "data": "\"{}\"" }), "data.0.0"), None);
    }
}
