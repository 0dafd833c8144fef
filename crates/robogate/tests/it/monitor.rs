//! End-to-end tests of `robogate monitor`.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};

use robogate_monitor::{Cycle, Reference};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{path, real_trials, robogate, verb};

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Parameters and outcome of row `i` of a campaign. The failure rate increases with the mass.
fn row(i: u32) -> (f64, f64, &'static str, bool) {
    let unit = |step: u32| f64::from((i * step) % 97) / 96.0;
    let (friction, mass) = (0.05 + 1.15 * unit(31), 0.05 + 1.95 * unit(17));
    let placement = if i.is_multiple_of(2) { "center_0" } else { "edge_0" };
    (friction, mass, placement, friction + unit(53) > 0.2 + 0.3 * mass)
}

/// Writes a dictionary of 970 rows in the published format, and its reference file.
fn reference(dir: &TempDir) -> (String, Reference) {
    let experiments: Vec<Value> = (0..970)
        .map(|i| {
            let (friction, mass, placement, success) = row(i);
            json!({
                "sample_idx": i, "friction": friction, "mass": mass, "placement": placement, "success": success,
                "failure_type": if success { "none" } else { "grasp_miss" }, "cycle_time": 4.0,
            })
        })
        .collect();
    let document = json!({ "metadata": { "robot": "ur5e" }, "summary": {}, "experiments": experiments });
    let (run, file) = (path(dir, "run.json"), path(dir, "reference.json"));
    fs::write(&run, document.to_string()).unwrap();
    // Many of these rows fail, so the default limit of the gate rejects them as a baseline.
    let refused = robogate(&["monitor", "reference", &run, "--out", &file]);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    assert!(text(&refused.stderr).contains("--learn-baseline"), "{}", text(&refused.stderr));
    let low = path(dir, "low.toml");
    fs::write(&low, "name = 'low'\nmode = 'confidence'\n[[requirement]]\nmetric = 'success'\nat_least = 0.2\n")
        .unwrap();
    let output = robogate(&["monitor", "reference", &run, "--requirements", &low, "--out", &file]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let reference: Reference = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    (file, reference)
}

fn cycle(i: u32, mass: f64, success: bool) -> Value {
    let (friction, _, placement, _) = row(i);
    json!({
        "id": format!("c{i}"), "robot": "cell-1", "recipe": "bracket", "time_s": 1_795_254_000 + 4 * i, "success": success,
        "parameters": { "friction": friction, "mass_kg": mass, "placement": placement },
    })
}

#[test]
fn a_reference_contains_its_own_rows() {
    let dir = tempfile::tempdir().unwrap();
    let (_, reference) = reference(&dir);
    let (mut risk, mut failures) = (0.0, 0.0);
    for i in 0..970 {
        let (_, mass, _, success) = row(i);
        let cycle: Cycle = serde_json::from_value(cycle(i, mass, success)).unwrap();
        let judged = reference
            .domain
            .judge(&cycle, |place, value, outside| assert!(!outside, "row {i}: parameter {place} is {value:?}"));
        assert_eq!(judged.outside, Some(false), "row {i}");
        risk += judged.risk.unwrap();
        failures += f64::from(u8::from(!success));
    }
    // The model is calibrated by cross-validation, so its mean is that of the rows up to a small error.
    assert!(failures > 50.0 && (risk - failures).abs() < 0.03 * failures, "{risk} expected, {failures} seen");
    let success = reference.baseline.success.unwrap();
    assert_eq!((success.count, success.of), (970 - failures as u64, 970));
}

#[test]
fn simulated_modes_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let (file, written) = reference(&dir);
    assert!(written.simulated && written.baseline.failure_modes.is_none());
    let learnt = path(&dir, "learnt.json");
    let run = path(&dir, "run.json");
    let output = robogate(&["monitor", "reference", &run, "--learn-baseline", "--out", &learnt]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let learnt: Reference = serde_json::from_str(&fs::read_to_string(&learnt).unwrap()).unwrap();
    assert_eq!((learnt.baseline.success, learnt.domain), (None, written.domain));
    // A file whose baseline is below its limit is rejected when it is used, too.
    let edited = fs::read_to_string(&file).unwrap().replace("\"required_success\": 0.2", "\"required_success\": 0.999");
    fs::write(&file, edited).unwrap();
    let feed = path(&dir, "cycles.jsonl");
    fs::write(&feed, format!("{}\n", cycle(0, 1.0, true))).unwrap();
    let refused = robogate(&["monitor", "serve", &feed, "--reference", &file]);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
}

/// The baseline is the count of the real trials, and the limit is that of the real robot, also if the simulation has a larger one.
#[test]
fn real_trials_are_a_baseline() {
    let dir = tempfile::tempdir().unwrap();
    reference(&dir);
    let rows: String = (0..40).map(|i| format!("{},{},{}\n", i % 3 > 0, row(i).0, row(i).1)).collect();
    fs::write(path(&dir, "trials.csv"), format!("success,friction,mass_kg\n{rows}")).unwrap();
    real_trials(dir.path(), "run.json", "real.json", 22);
    let requirement = |metric: &str, limit: f64| format!("[[requirement]]\nmetric = '{metric}'\nat_least = {limit}\n");
    for (name, limit) in [("low.toml", 0.5), ("high.toml", 0.95)] {
        let both = requirement("success", 0.93) + &requirement("real:success", limit);
        fs::write(path(&dir, name), format!("name = 'real'\nmode = 'confidence'\n{both}")).unwrap();
    }
    let write = "monitor reference run.json --out with.json --real real.json --requirements";
    verb(dir.path(), &format!("{write} high.toml"), 2, &["88.0 %", "95.0 %"]);
    verb(dir.path(), &format!("{write} low.toml --learn-baseline"), 2, &["cannot be used with"]);
    verb(dir.path(), &format!("{write} low.toml"), 0, &["44 of 50 trials of the real robot", "operating space"]);
    let with: Reference = serde_json::from_slice(&fs::read(path(&dir, "with.json")).unwrap()).unwrap();
    let success = with.baseline.success.unwrap();
    assert_eq!((success.count, success.of, with.required_success), (44, 50, Some(0.5)));
    let trials: Value = serde_json::from_slice(&fs::read(path(&dir, "real.json")).unwrap()).unwrap();
    assert_eq!(with.real_trials_sha256.as_deref(), trials["real"]["sha256"].as_str());
    // Trials about another policy.
    let other = trials.to_string().replace("\"policy\":\"", "\"policy\":\"other ");
    fs::write(path(&dir, "real.json"), other).unwrap();
    verb(dir.path(), &format!("{write} low.toml"), 2, &["the policy is `other "]);
}

#[test]
fn exit_code_reports_a_critical_alarm() {
    let dir = tempfile::tempdir().unwrap();
    let (reference, _) = reference(&dir);
    let feed = path(&dir, "cycles.jsonl");
    // Masses inside the validated range first, then outside.
    let write = |after: Option<f64>| {
        let mass = |i: u32| after.filter(|_| i >= 900).unwrap_or(row(i).1);
        let lines: String = (0..1_200).map(|i| format!("{}\n", cycle(i, mass(i), true))).collect();
        fs::write(&feed, lines).unwrap();
    };
    write(None);
    let quiet = robogate(&["monitor", "serve", &feed, "--reference", &reference]);
    assert_eq!((quiet.status.code(), text(&quiet.stdout)), (Some(0), String::new()), "{}", text(&quiet.stderr));
    write(Some(2.5));
    let loud = robogate(&["monitor", "serve", &feed, "--reference", &format!("bracket={reference}")]);
    assert_eq!(loud.status.code(), Some(1), "{}", text(&loud.stderr));
    assert!(text(&loud.stderr).contains("300 outside the validated region"), "{}", text(&loud.stderr));
    let alarms: Vec<Value> = text(&loud.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let critical = alarms.iter().find(|alarm| alarm["level"] == "critical").unwrap();
    assert_eq!((&critical["metric"], &critical["recipe"]), (&json!("outside"), &json!("bracket")));
    assert!(critical["look_at"][0].as_str().unwrap().starts_with("mass_kg: 2.5 in"), "{critical}");
}

#[test]
fn bad_feeds_and_settings_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let (empty, settings) = (path(&dir, "empty.jsonl"), path(&dir, "monitor.toml"));
    fs::write(&empty, "\nno cycle\n").unwrap();
    let nothing = robogate(&["monitor", "serve", &empty]);
    assert_eq!(nothing.status.code(), Some(4), "{}", text(&nothing.stderr));
    assert!(text(&nothing.stderr).contains("line 2: "), "{}", text(&nothing.stderr));
    for (wrong, because) in [
        ("[detectors]\nwarning_cycles = 0", "warning_cycles"),
        ("[detectors.baseline]\nsuccess = { count = 9, of = 5 }", "9 of 5"),
        ("[http]\nhead_s = 1e300", "head_s"),
        ("speed = 9", "speed"),
    ] {
        fs::write(&settings, wrong).unwrap();
        let refused = robogate(&["monitor", "serve", &empty, "--settings", &settings]);
        assert_eq!(refused.status.code(), Some(2), "{wrong}");
        assert!(text(&refused.stderr).contains(because), "{}", text(&refused.stderr));
    }
    fs::write(&settings, "[detectors.shares]\ndrop = 0.05\n").unwrap();
    let former = robogate(&["monitor", "serve", &empty, "--settings", &settings]);
    assert_eq!(former.status.code(), Some(4), "{}", text(&former.stderr));
    assert!(
        text(&former.stderr).contains("is the old name of `detectors.events.drop.share`"),
        "{}",
        text(&former.stderr)
    );
    let folder = dir.path().to_str().unwrap();
    for arguments in [
        vec!["monitor", "serve"],
        vec!["monitor", "serve", "--listen", "127.0.0.1:0"],
        vec!["monitor", "serve", "nowhere.jsonl"],
        vec!["monitor", "serve", folder],
        vec!["monitor", "serve", &empty, "--reference", &empty],
    ] {
        assert_eq!(robogate(&arguments).status.code(), Some(2), "{arguments:?}");
    }
    let store = path(&dir, "monitor.db");
    let open = robogate(&["monitor", "serve", "--store", &store, "--listen", "0.0.0.0:0"]);
    assert_eq!(open.status.code(), Some(2));
    assert!(text(&open.stderr).contains("--token-file"), "{}", text(&open.stderr));
}

#[test]
fn pipes_are_read_line_by_line() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args(["monitor", "serve", "-"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut pipe = child.stdin.take().unwrap();
    for i in 0..600 {
        writeln!(pipe, "{}", cycle(i, 0.3, i % 20 != 0)).unwrap();
    }
    writeln!(pipe, "{}", "x".repeat(3_000_000)).unwrap();
    for i in 600..900 {
        writeln!(pipe, "{}", cycle(i, 0.3, false)).unwrap();
    }
    pipe.flush().unwrap();
    // The pipe is still open: an alarm is raised before the end of the feed.
    let mut alarm = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut alarm).unwrap();
    assert!(alarm.contains("\"raised\""), "{alarm}");
    drop(pipe);
    let output = child.wait_with_output().unwrap();
    let stderr = text(&output.stderr);
    assert!(stderr.contains("line 601: longer than") && stderr.contains("900 cycles accepted"), "{stderr}");
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn simulation_prints_a_json_document() {
    let output = robogate(&["monitor", "simulate", "--streams", "20", "--json", "--cycle-s", "10"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&document["version"], &document["cycles_per_day"]), (&json!(1), &json!(8_640.0)));
    let figures = document["figures"].as_array().unwrap();
    assert_eq!(figures.len(), 4);
    assert!(figures.iter().all(|figure| figure["delays"].as_array().unwrap().len() == 3));
    let promised: Vec<&Value> = figures.iter().map(|figure| &figure["promised_cycles"]).collect();
    assert_eq!(promised, [&Value::Null, &json!(2_000.0), &Value::Null, &json!(50_000.0)]);
    assert_eq!(robogate(&["monitor", "simulate", "--rate", "1.5"]).status.code(), Some(2));
}

/// A counter of a controller restarts: its cycles have known ids with another content, and none of them reaches the detectors.
#[test]
fn restarted_counters_are_an_alarm() {
    let dir = tempfile::tempdir().unwrap();
    let line = |id: u32, i: u32, success: bool| {
        let cycle = json!({
            "id": format!("cell-1/{id}"), "robot": "cell-1", "recipe": "bracket", "time_s": 1_795_254_000 + 4 * i, "success": success,
        });
        format!("{cycle}\n")
    };
    let alarms = |lines: String| {
        fs::write(dir.path().join("cycles.jsonl"), lines).unwrap();
        let output = robogate(&["monitor", "serve", &path(&dir, "cycles.jsonl")]);
        let alarms: Vec<Value> = text(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        (output.status.code(), alarms)
    };
    let good: String = (0..300).map(|i| line(i, i, true)).collect();
    assert_eq!(alarms(good.clone()), (Some(0), Vec::new()));

    let (code, raised) = alarms(good.clone() + &(0..300).map(|i| line(i, 300 + i, i % 2 == 0)).collect::<String>());
    assert_eq!((code, raised.len()), (Some(1), 1), "{raised:?}");
    assert_eq!((&raised[0]["metric"], &raised[0]["level"]), (&json!("sender"), &json!("critical")));
    assert!(raised[0]["what"].as_str().unwrap().contains("the id `cell-1/0` is already stored"), "{raised:?}");

    let (code, raised) = alarms(good.clone() + &line(320, 320, true));
    assert_eq!((code, raised.len()), (Some(1), 1), "{raised:?}");
    assert!(raised[0]["what"].as_str().unwrap().contains("20 ids are missing"), "{raised:?}");

    let (code, raised) = alarms(good + "nonsense\n");
    assert_eq!((code, raised.len()), (Some(1), 1), "{raised:?}");
    assert!(raised[0]["what"].as_str().unwrap().contains("line 301"), "{raised:?}");
}

#[test]
fn recipes_are_listed_removed_and_merged() {
    let dir = tempfile::tempdir().unwrap();
    let lines: String = (0..60_u32)
        .map(|i| {
            let recipe = ["bracket", "Bracket", "invented"][i as usize % 3];
            let cycle = json!({ "id": format!("c{i}x"), "robot": "a", "recipe": recipe, "time_s": 1_795_254_000 + i, "success": true });
            format!("{cycle}\n")
        })
        .collect();
    fs::write(dir.path().join("cycles.jsonl"), &lines).unwrap();
    let serve = "monitor serve cycles.jsonl --store monitor.db";
    verb(dir.path(), serve, 0, &["60 cycles accepted"]);
    let list = || verb(dir.path(), "monitor recipes list monitor.db --json", 0, &[]);
    let counts = |text: String| {
        let document: Value = serde_json::from_str(&text).unwrap();
        let recipes = document["recipes"].as_array().unwrap().clone();
        let pair = |one: &Value| (one["recipe"].as_str().unwrap().to_owned(), one["cycles"].as_u64().unwrap());
        recipes.iter().map(pair).collect::<Vec<_>>()
    };
    let named = |name: &str, n: u64| (name.to_owned(), n);
    assert_eq!(counts(list()), [named("Bracket", 20), named("bracket", 20), named("invented", 20)]);
    verb(dir.path(), "monitor recipes remove monitor.db invented", 0, &["removed invented with 20 cycles"]);
    verb(dir.path(), "monitor recipes remove monitor.db invented", 2, &["invented: no such recipe"]);
    verb(dir.path(), "monitor recipes merge monitor.db Bracket bracket", 0, &["moved 20 cycles of Bracket to bracket"]);
    verb(dir.path(), "monitor recipes list other.db", 2, &["no such store"]);
    assert_eq!(counts(list()), [named("bracket", 40)]);
    // The next start knows the merged recipe, and the removed one is new again.
    verb(dir.path(), serve, 1, &["20 cycles accepted, 20 duplicates", "20 refused"]);
    assert_eq!(counts(list()), [named("bracket", 40), named("invented", 20)]);
}
