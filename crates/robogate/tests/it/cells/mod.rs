//! The connections of cells: ROS 2 topics through rosbridge.

mod rosbridge;

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::{Message, connect};

use crate::harness::{assert_exit_in, robogate_in, stderr, stdout, text};
use rosbridge::Rosbridge;

const MAP: &str = r#"
robot = "cell-1"
recipe = "bracket"
success = { field = "status", is = ["ok"] }
failure_mode = "status"
id = "serial"
cycle_time_s = "duration"

[end]
topic = "/cell/result"
type = "cell_msgs/msg/Result"
time = "header.stamp"

[parameters]
mass_kg = { topic = "/scale", type = "std_msgs/msg/Float64", field = "data" }
"#;

/// A detector that warns where `position` is above 0.45.
fn detector() -> Value {
    let group = |name: &str, kind: &str| json!({ "name": name, "kind": kind, "length": 1 });
    json!({
        "warn_format": 1,
        "conditions": { "task": "weigh 1", "engine": "", "robot": "", "policy": "", "population": "" },
        "features": { "signals": { "period_s": 0.1, "groups": [group("position", "observation"), group("vector", "command")] } },
        "distance": {
            "columns": [0], "scale": [[0.0, 1.0]], "moments": { "bin_s": 100.0, "cells": [[0]] }, "means": [[0.0]], "factors": [[1.0]],
            "band": [[0.0, 1.0]],
        },
        "calibration": { "threshold": 0.45, "successes": 59, "rank": 59, "promised": 0.05 },
        "baselines": { "clock": 0.0 },
    })
}

#[test]
fn control_periods_of_a_file_are_watched() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    fs::write(folder.join("w.json"), detector().to_string()).unwrap();
    let period = |time_s: f64, position: f64| json!({ "robot": "a", "time_s": time_s, "observation": { "position": [position] }, "command": { "vector": [0.0] } });
    let start = json!({ "robot": "a", "recipe": "bracket", "start": {}, "started_s": 1_795_254_000.0 });
    let lines =
        [start, period(0.0, 0.1), period(0.1, 0.6), json!({ "robot": "a", "end": "jam" }), json!({ "robt": 1 })];
    let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    fs::write(folder.join("periods.jsonl"), text).unwrap();
    let output = robogate_in(folder, &["monitor", "serve", "--warner", "w.json", "--periods", "periods.jsonl"]);
    assert_eq!(output.status.code(), Some(1), "a line was rejected: {}", stderr(&output));
    for part in ["4 control periods accepted, 1 rejected, 1 warnings", "control period 5: unknown field"] {
        assert!(stderr(&output).contains(part), "{part}: {}", stderr(&output));
    }
    let alarms: Vec<Value> = stdout(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(alarms.len(), 2, "{alarms:?}");
    assert_eq!((&alarms[0]["metric"], &alarms[0]["recipe"]), (&json!("warning"), &json!("bracket")));
    assert!(alarms[1]["what"].as_str().unwrap().contains("ended with jam, 0.00 s after the warning"), "{alarms:?}");
    assert_exit_in(folder, &["monitor", "serve", "--periods", "periods.jsonl"], 2, &["--warner"]);
    fs::write(folder.join("none.json"), "{}").unwrap();
    assert_exit_in(folder, &["monitor", "serve", "-", "--warner", "none.json"], 2, &["not a detector", "Hint: "]);
}

#[test]
fn imported_results_are_cycles() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let rows: String = (0..40).map(|i| format!("pi0,{},{i}\n", u8::from(i % 4 != 3))).collect();
    fs::write(folder.join("arena.csv"), format!("policy,binary_success,mass_kg\n{rows}")).unwrap();
    let import = robogate_in(folder, &["import", "arena.csv", "rows.parquet"]);
    assert!(import.status.success(), "{}", text(&import));
    let args =
        ["monitor", "cycles", "rows.parquet", "--robot", "cell-1", "--recipe", "bracket", "--since", "1795254000"];
    let lines = robogate_in(folder, &args);
    assert_eq!(lines.status.code(), Some(0), "{}", stderr(&lines));
    let cycles: Vec<Value> = stdout(&lines).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((cycles.len(), &cycles[3]["success"], &cycles[3]["robot"]), (40, &json!(false), &json!("cell-1")));
    assert_eq!((&cycles[39]["time_s"], &cycles[5]["parameters"]["mass_kg"]), (&json!(1_795_254_040.0), &json!(5.0)));
    let served = robogate_in(folder, &["monitor", "serve", "rows.parquet", "--store", "m.db"]);
    assert!(stderr(&served).contains("40 cycles accepted"), "{}", stderr(&served));
    let again = robogate_in(folder, &["monitor", "serve", "rows.parquet", "--store", "m.db"]);
    assert!(stderr(&again).contains("40 duplicates"), "{}", stderr(&again));
    assert_exit_in(folder, &["monitor", "cycles", "arena.csv"], 2, &["not a dictionary", "robogate import"]);
}

fn until(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < Duration::from_secs(60), "{what} did not happen in 60 s");
        thread::sleep(Duration::from_millis(20));
    }
}

/// Files of a cell whose recipe has a baseline, so that no learning is needed.
fn files(folder: &Path) {
    fs::write(folder.join("cell.toml"), MAP).unwrap();
    let baseline = "[detectors.recipes.bracket]\nsuccess = { count = 4890, of = 5000 }\n";
    fs::write(folder.join("monitor.toml"), baseline).unwrap();
}

/// A monitor of a rosbridge server, with its messages and its address. It is killed on drop.
struct Monitor(Child, Receiver<String>, String);

impl Monitor {
    fn start(folder: &Path, url: &str) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(["monitor", "serve", "--store", "m.db", "--settings", "monitor.toml", "--topics", "cell.toml"])
            .args(["--diagnostics", "/diagnostics", "--listen", "127.0.0.1:0", "--rosbridge", url])
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (sender, messages) = channel();
        let stderr = BufReader::new(child.stderr.take().unwrap());
        thread::spawn(move || stderr.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
        let mut monitor = Self(child, messages, String::new());
        let listening = monitor.says("Listening on http://");
        monitor.2 = listening.rsplit('/').next().unwrap().to_owned();
        monitor
    }

    fn says(&self, part: &str) -> String {
        self.1.iter().find(|line| line.contains(part)).unwrap_or_else(|| panic!("{part}"))
    }

    fn get(&self, path: &str) -> Value {
        let mut stream = TcpStream::connect(&self.2).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", self.2).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        serde_json::from_str(answer.split_once("\r\n\r\n").unwrap().1).unwrap()
    }

    fn accepted(&self) -> u64 {
        self.get("/v1/status")["intake"]["accepted"].as_u64().unwrap()
    }
}

impl Drop for Monitor {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn roslibpy_cycles_raise_a_diagnostic() {
    let wanted = "a Python with roslibpy (crates/robogate-replay/tests/requirements.txt)";
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", wanted) else { return };
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let server = Rosbridge::start();
    let monitor = Monitor::start(folder.path(), &server.url());
    until("the subscription", || server.subscribers("/cell/result") == 1 && server.subscribers("/scale") == 1);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/cells/robot.py");
    let port = server.address.port().to_string();
    let robot = Command::new(python).arg(script).args(["127.0.0.1", &port, "60", "40"]).output().unwrap();
    assert!(robot.status.success(), "{}", String::from_utf8_lossy(&robot.stderr));
    let message: Value = serde_json::from_slice(&robot.stdout).unwrap();
    let status = &message["status"][0];
    assert_eq!((&status["hardware_id"], &status["name"]), (&json!("cell-1"), &json!("robogate: bracket: success")));
    assert!(matches!(status["level"].as_u64(), Some(1 | 2)), "{message}");
    assert!(message["header"]["stamp"]["sec"].as_u64().unwrap() >= 1_795_254_000 + 4 * 60, "{message}");
    assert!(status["values"].as_array().unwrap().iter().any(|pair| pair["key"] == "since_s"), "{message}");
    until("all cycles", || monitor.accepted() == 100);
}

#[test]
fn rosbridge_restarts_lose_no_later_cycle() {
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let server = Rosbridge::start();
    let monitor = Monitor::start(folder.path(), &server.url());
    let publish = |messages: &[(&str, &str, Value)]| {
        until("the subscription", || server.subscribers("/cell/result") == 1 && server.subscribers("/scale") == 1);
        let (mut robot, _) = connect(server.url()).unwrap();
        for (topic, type_name, msg) in messages {
            for request in [
                json!({ "op": "advertise", "topic": topic, "type": type_name }),
                json!({ "op": "publish", "topic": topic, "msg": msg }),
            ] {
                robot.send(Message::text(request.to_string())).unwrap();
            }
        }
        robot.close(None).unwrap();
        while robot.read().is_ok() {}
    };
    let result = |serial: u64, status: &str| {
        let msg = json!({ "header": { "stamp": { "sec": 1_795_254_000 + serial, "nanosec": 0 } }, "serial": serial, "status": status });
        ("/cell/result", "cell_msgs/Result", msg)
    };
    publish(&[("/scale", "std_msgs/Float64", json!({ "data": 0.5 })), result(1, "ok"), result(2, "jammed")]);
    until("two cycles", || monitor.accepted() == 2);
    publish(&[("/scale", "std_msgs/Float64", json!({ "data": 9.5 }))]);
    server.close_all();
    monitor.says("Trying again");
    // A cycle without a status is refused with its field; a weight from before the restart belongs to no later cycle.
    let broken = ("/cell/result", "cell_msgs/Result", json!({ "header": { "stamp": { "sec": 5, "nanosec": 0 } } }));
    publish(&[broken, result(3, "ok")]);
    monitor.says("/cell/result: success: `status` of /cell/result is missing");
    until("three cycles", || monitor.accepted() == 3);
    let around = monitor.get("/v1/cycles?recipe=bracket&until=3");
    let cycles: Vec<&Value> = around["cycles"].as_array().unwrap().iter().rev().collect();
    assert_eq!(cycles[0]["parameters"], json!({ "mass_kg": 0.5 }));
    assert_eq!(cycles[1]["failure_mode"], "jammed");
    assert_eq!((&cycles[2]["id"], &cycles[2]["parameters"]), (&json!("3"), &Value::Null));
}

#[test]
fn wrong_maps_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let serve = ["monitor", "serve", "--store", "m.db", "--rosbridge", "ws://127.0.0.1:9", "--topics", "cell.toml"];
    assert_exit_in(
        folder.path(),
        &["monitor", "serve", "-", "--rosbridge", "http://x:1"],
        2,
        &["expected ws://HOST:PORT"],
    );
    for (from, to, part) in [
        ("robot = \"cell-1\"", "", "missing field `robot`"),
        ("[end]\n", "[end]\nspeed = 1\n", "speed"),
        ("id = \"serial\"", "id = 3", "expected a field"),
    ] {
        fs::write(folder.path().join("cell.toml"), MAP.replace(from, to)).unwrap();
        assert_exit_in(folder.path(), &serve, 2, &["cell.toml", part]);
    }
}

#[test]
fn recordings_of_other_programs_are_read() {
    let wanted = "a Python with mcap and rosbags (crates/robogate-replay/tests/requirements.txt)";
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", wanted) else { return };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    files(folder);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/cells/record.py");
    let output = Command::new(python).arg(script).args([folder, Path::new("1500")]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let serve = |feed: &str, store: &str| {
        let output = robogate_in(
            folder,
            &["monitor", "serve", feed, "--topics", "cell.toml", "--store", store, "--settings", "monitor.toml"],
        );
        (output.status.code(), stderr(&output))
    };
    // One cycle in ten failed, of a cell whose baseline is 2 %: a critical alarm.
    for feed in ["bag", "zstd.mcap"] {
        let (code, said) = serve(feed, &format!("{feed}.db"));
        assert!(
            code == Some(1) && said.contains("1,500 cycles accepted") && said.contains("0 refused"),
            "{feed}: {said}"
        );
    }
    // The same cycles from another recording have the same ids and contents.
    assert!(serve("zstd.mcap", "bag.db").1.contains("0 cycles accepted, 1,500 duplicates"));
    let (code, said) = serve("lz4.mcap", "l.db");
    assert!(code == Some(5) && said.contains("lz4.mcap: its chunks are compressed with lz4"), "{said}");
    // The same as trials.
    let lines = robogate_in(folder, &["monitor", "cycles", "bag", "--topics", "cell.toml"]);
    assert_eq!(lines.status.code(), Some(0), "{}", stderr(&lines));
    fs::write(folder.join("cycles.jsonl"), &lines.stdout).unwrap();
    let import = text(&robogate_in(folder, &["import", "cycles.jsonl", "trials.parquet"]));
    for part in
        ["1500 rows", "column failure_mode: failure mode (150 of", "column parameters.mass_kg: parameter mass_kg"]
    {
        assert!(import.replace(',', "").contains(part), "{part}: {import}");
    }
    let table = robogate_in(folder, &["monitor", "cycles", "zstd.mcap", "--topics", "cell.toml", "--csv"]);
    let table = stdout(&table);
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows[0], "id,robot,recipe,time_s,success,failure_mode,cycle_time_s,mass_kg");
    assert_eq!((rows.len(), rows[10]), (1_501, "9,cell-1,bracket,1795254036,false,jammed,3.5,9.25"));
    // Control periods in the same recording: each weight is a start, an observation and a command.
    let period = "[start]\ntopic = \"/scale\"\n[period]\ntopic = \"/scale\"\nobservation = { position = \"data\" }\ncommand = { vector = \"data\" }\n";
    fs::write(folder.join("periods.toml"), format!("{MAP}{period}")).unwrap();
    fs::write(folder.join("w.json"), detector().to_string()).unwrap();
    let watched = ["monitor", "serve", "bag", "--topics", "periods.toml", "--warner", "w.json"];
    let output = robogate_in(folder, &watched);
    assert!(stderr(&output).contains("4,500 control periods accepted, 0 rejected"), "{}", stderr(&output));
    // Nearly all successes are warned, which the promise excludes.
    let alarms = stdout(&output);
    assert!(alarms.contains("\"metric\":\"warning\"") && alarms.contains("are suspended"), "{alarms}");
    assert_exit_in(folder, &watched[..5], 2, &["[period] needs a detector", "--warner FILE"]);
    // A damaged recording: what comes before the damage counts.
    let mut bytes = fs::read(folder.join("zstd.mcap")).unwrap();
    bytes.truncate(bytes.len() / 2);
    fs::write(folder.join("half.mcap"), bytes).unwrap();
    let (code, said) = serve("half.mcap", "h.db");
    assert!(code == Some(5) && said.contains("half.mcap: it ends"), "{said}");
    fs::write(folder.join("cell.toml"), MAP.replace("topic = \"/cell/result\"", "topic = \"/cell/done\"")).unwrap();
    let (code, said) = serve("bag", "n.db");
    assert!(code == Some(5) && said.contains("no topic /cell/done. Its topics: /camera, /cell/result"), "{said}");
    fs::create_dir(folder.join("old")).unwrap();
    fs::write(folder.join("old/old_0.db3"), "").unwrap();
    assert_exit_in(folder, &["monitor", "serve", "old", "--topics", "cell.toml"], 2, &["SQLite", "ros2 bag convert"]);
    assert_exit_in(folder, &["monitor", "serve", "bag"], 2, &["--topics"]);
    let nothing = robogate_in(folder, &["monitor", "serve", "--topics", "cell.toml"]);
    assert!(nothing.status.code() == Some(2) && text(&nothing).contains("--rosbridge"), "{}", text(&nothing));
}
