//! Warnings within episodes: by HTTP, from topics and over MQTT, stored, and suspended at a shift.

use robogate_core::{SignalGroup, SignalKind, Signals};
use robogate_monitor::service::{HttpSettings, Periods, StoreSettings, TopicMap, TopicReader};
use robogate_monitor::warn::{Baselines, Calibration, Conditions, Distance, Features, Moments, Period, WarnFile};
use serde_json::{Value, json};

use crate::common::{Service, cycles, get, intake, post};

/// A detector that warns where `position` is above 0.45.
pub(crate) fn detector() -> WarnFile {
    let group = |name: &str, kind| SignalGroup { name: name.to_owned(), kind, length: 1, unit: String::new() };
    let groups = vec![group("position", SignalKind::Observation), group("vector", SignalKind::Command)];
    let text = || "any".to_owned();
    WarnFile {
        warn_format: WarnFile::FORMAT,
        conditions: Conditions {
            task: "push 1".to_owned(),
            engine: text(),
            robot: text(),
            policy: text(),
            population: text(),
        },
        runs: Vec::new(),
        features: Features {
            signals: Signals { period_s: 0.1, groups, gripper_in_vector: None },
            parameters: Vec::new(),
        },
        known: Vec::new(),
        trees: Vec::new(),
        distance: Some(Distance {
            columns: vec![0],
            scale: vec![[0.0, 1.0]],
            moments: Moments { bin_s: 100.0, cells: vec![vec![Some(0)]] },
            means: vec![vec![0.0]],
            factors: vec![vec![1.0]],
            band: vec![[0.0, 1.0]],
        }),
        calibration: Calibration { threshold: 0.45, successes: 59, rank: 59, promised: 0.05 },
        events: Vec::new(),
        baselines: Baselines { clock: 0.0, scenario: None, parameters: Vec::new(), trees: Vec::new() },
    }
}

/// An episode of ten periods up to this position, with its end.
pub(crate) fn episode(robot: &str, recipe: &str, up_to: f64, end: &str) -> String {
    let mut lines = vec![json!({ "robot": robot, "recipe": recipe, "start": {}, "started_s": 1_760_000_000.0 })];
    for tick in 0..10 {
        let (time_s, position) = (0.1 * f64::from(tick), up_to * f64::from(tick) / 9.0);
        lines.push(json!({ "robot": robot, "time_s": time_s, "observation": { "position": [position] }, "command": { "vector": [0.1] } }));
    }
    lines.push(json!({ "robot": robot, "end": end }));
    lines.iter().map(|line| format!("{line}\n")).collect()
}

fn start(path: &std::path::Path) -> Service {
    let intake = intake(path, StoreSettings::default()).with_warner(detector(), "a".repeat(64)).unwrap().unwrap();
    Service::with(intake, HttpSettings::default(), None, |_| {})
}

fn status(service: &Service) -> Value {
    serde_json::from_str(&get(service.address, "/v1/status").1).unwrap()
}

#[test]
fn warnings_are_sent_stored_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("monitor.db");
    let service = start(&path);
    let to = service.address;
    let (code, quiet) = post(to, "/v1/periods", &episode("a", "bracket", 0.3, "success"), None);
    assert_eq!((code, &quiet["accepted"], quiet["warnings"].as_array().unwrap().len()), (200, &json!(12), 0));
    let (_, warned) = post(to, "/v1/periods", &episode("a", "bracket", 0.9, "jam"), None);
    assert_eq!(warned["warnings"], json!([{ "robot": "a", "time_s": 0.5, "score": 0.5 }]));
    let (_, missed) = post(to, "/v1/periods", &episode("b", "bracket", 0.2, "jam"), None);
    assert_eq!(missed["rejected"], 0);
    // Lines that do not fit are named, and do not disturb the others.
    let (code, wrong) = post(to, "/v1/periods", "{\"robot\": \"a\", \"time_s\": 0.0}\n{\"robt\": 1}\n", None);
    assert_eq!((code, &wrong["rejected"]), (400, &json!(2)));
    assert!(wrong["rejections"][0]["because"].as_str().unwrap().contains("position is missing"), "{wrong}");

    let counts = |status: &Value| {
        let of = &status["warnings"]["episodes"];
        ["quiet_successes", "warned_failures", "missed_failures"].map(|name| of[name].as_u64().unwrap())
    };
    let now = status(&service);
    assert_eq!(counts(&now), [1, 1, 1]);
    let alarms: Vec<(&str, &str)> = now["alarms"]
        .as_array()
        .unwrap()
        .iter()
        .map(|a| (a["metric"].as_str().unwrap(), a["happening"].as_str().unwrap()))
        .collect();
    assert_eq!(alarms, [("warning", "cleared"), ("warning", "raised")]);
    assert_eq!(now["alarms"][1]["time_s"], 1_760_000_000.5);
    let (_, text) = get(to, "/metrics");
    assert!(text.contains("robogate_monitor_episodes_total{outcome=\"warned_failures\"} 1"), "{text}");
    service.end();

    // The counts survive a restart; those of another detector begin at zero.
    let again = start(&path);
    assert_eq!(counts(&status(&again)), [1, 1, 1]);
    again.end();
    let other = intake(&path, StoreSettings::default()).with_warner(detector(), "b".repeat(64)).unwrap().unwrap();
    let other = Service::with(other, HttpSettings::default(), None, |_| {});
    assert_eq!(counts(&status(&other)), [0, 0, 0]);
    other.end();
    let without = Service::start(&path, HttpSettings::default(), None);
    let (code, answer) = post(without.address, "/v1/periods", "{}", None);
    assert_eq!(code, 404);
    assert!(answer["error"].as_str().unwrap().contains("--warner FILE"), "{answer}");
    without.end();
}

#[test]
fn warnings_are_suspended_at_a_shift() {
    let folder = tempfile::tempdir().unwrap();
    let service = start(&folder.path().join("monitor.db"));
    let to = service.address;
    post(to, "/v1/cycles", &cycles(0..600, 0.05), None);
    let warned = |recipe: &str| {
        let (_, heard) = post(to, "/v1/periods", &episode("cell-0", recipe, 0.9, "jam"), None);
        (heard["warnings"].as_array().unwrap().len(), heard["suppressed"].as_u64().unwrap())
    };
    assert_eq!(warned("part-0"), (1, 0));
    post(to, "/v1/cycles", &cycles(600..1_200, 0.5), None);
    // Both recipes have an alarm now; another one has none.
    assert_eq!((warned("part-0"), warned("bracket")), ((0, 1), (1, 0)));
    let now = status(&service);
    assert_eq!(
        (&now["warnings"]["shifted"], &now["warnings"]["suppressed"]),
        (&json!(["part-0", "part-1"]), &json!(1))
    );
    // The suppressed warning counts as one.
    assert_eq!(now["warnings"]["episodes"]["warned_failures"], 3);
    service.end();
}

#[test]
fn broken_promise_suspends_all_warnings() {
    let folder = tempfile::tempdir().unwrap();
    let service = start(&folder.path().join("monitor.db"));
    let to = service.address;
    let mut last = Value::Null;
    for _ in 0..4 {
        last = post(to, "/v1/periods", &episode("a", "bracket", 0.9, "success"), None).1;
    }
    assert_eq!(last["warnings"], json!([]), "suspended");
    let now = status(&service);
    assert_eq!(now["warnings"]["episodes"]["suspended"], true);
    let suspended =
        now["alarms"].as_array().unwrap().iter().any(|a| a["what"].as_str().unwrap().contains("are suspended"));
    assert!(suspended, "{now}");
    assert!(get(to, "/metrics").1.contains("robogate_monitor_warnings_suspended 1"));
    service.end();
}

#[test]
fn topics_give_control_periods() {
    let map = r#"
        robot = "cell-1"
        recipe = "bracket"
        success = { field = "status", is = ["ok"] }
        failure_mode = "status"
        [end]
        topic = "/result"
        [start]
        topic = "/start"
        time = "stamp"
        [parameters]
        mass_kg = { topic = "/start", field = "mass" }
        [period]
        topic = "/command"
        time = "stamp"
        command = { vector = "data" }
        observation = { position = { topic = "/joints", field = "position" } }
    "#;
    let without_start = map.replace("[start]\n        topic = \"/start\"\n        time = \"stamp\"", "");
    assert!(TopicMap::parse(&without_start).unwrap_err().contains("[period] needs [start]"));
    let map = TopicMap::parse(map).unwrap();
    assert_eq!(map.topics().len(), 4);
    let mut reader = TopicReader::new(map);
    // A command outside of an episode is not a control period.
    reader.observe("/command", 1.0, json!({ "stamp": 1.0, "data": [0.1] }));
    assert!(reader.take_periods().is_empty());
    reader.observe("/start", 2.0, json!({ "stamp": { "sec": 2, "nanosec": 0 }, "mass": 0.4 }));
    reader.observe("/joints", 2.05, json!({ "position": [0.25] }));
    reader.observe("/command", 2.1, json!({ "stamp": 2.1, "data": [0.1] }));
    let cycle = reader.observe("/result", 3.0, json!({ "status": "jam" })).unwrap().unwrap();
    let periods: Vec<Period> = reader.take_periods().into_iter().map(Result::unwrap).collect();
    assert_eq!((periods.len(), cycle.success), (3, false));
    assert_eq!(periods[0].start.as_ref().map(|of| of.len()), Some(1));
    assert!((periods[1].time_s.unwrap() - 0.1).abs() < 1e-9);
    assert_eq!((periods[1].observation["position"][0], periods[1].command["vector"][0]), (0.25, 0.1));
    assert_eq!((periods[2].end.as_deref(), periods[2].robot.as_str()), (Some("jam"), "cell-1"));
    assert!(!Periods::of(periods.into_iter().map(Ok).collect(), 3.0).is_empty());
}
