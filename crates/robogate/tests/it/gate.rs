//! End-to-end tests of the gate as used on the command line and in CI: real physics, real files, exit codes.

use std::fmt::Write;
use std::fs;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{assert_exit, robogate, text, verb};

const SUITE: &str = r#"
schema = 1
name = "two"
version = "1.0.0"
description = "A part that the controller places, and one that no gripper holds."
defaults = { shape = "box", size_m = 0.05, mass_kg = 0.2, friction = 0.8, com_offset = 0.0, placement = "center_0", ik_noise_rad = 0.0, obstacles = 0 }
[[group]]
name = "easy"
category = "nominal"
scenarios = [{ id = "easy-1" }, { id = "easy-2", mass_kg = 0.3 }]
[[group]]
name = "hopeless"
category = "edge_cases"
scenarios = [{ id = "hopeless-1", mass_kg = 2.0, friction = 0.05 }]
"#;

fn gate(success: &str) -> String {
    format!(
        "name = \"test\"\nmode = \"confidence\"\nconfidence = 0.75\n[budget]\nrounds = 12\n[[requirement]]\nmetric = \"success\"\n{success}\n"
    )
}

struct Folder {
    dir: TempDir,
}

impl Folder {
    fn new() -> Self {
        Self { dir: TempDir::new().unwrap() }
    }

    fn path(&self, name: &str) -> String {
        self.dir.path().join(name).to_str().unwrap().to_owned()
    }

    fn write(&self, name: &str, text: &str) -> String {
        fs::write(self.path(name), text).unwrap();
        self.path(name)
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_str(&fs::read_to_string(self.path(name)).unwrap()).unwrap()
    }
}

/// Counts elements of one name, in a text that an XML parser accepts.
fn elements(xml: &str, name: &str) -> usize {
    let document = roxmltree::Document::parse(xml).unwrap();
    document.descendants().filter(|node| node.has_tag_name(name)).count()
}

#[test]
fn default_gate_needs_no_arguments() {
    // If this reports a missing baseline, write assets/baselines/franka-industrial-68.json again with
    // `robogate run --suite industrial-68 --rounds 3 --out DIR` and `robogate gate --run DIR --write-baseline FILE`.
    assert_exit(
        &["gate", "--plan"],
        0,
        &["success rate at least 92.00 %", "limit", "met at the earliest after 7 rounds"],
    );
}

#[test]
fn files_agree_with_exit_code() {
    let folder = Folder::new();
    let suite = folder.write("suite.toml", SUITE);
    for (name, limit, code, verdict) in [
        ("pass", "at_least = 0.2", 0, "pass"),
        ("fail", "at_least = 0.85", 1, "fail"),
        ("open", "at_least = 0.65", 3, "inconclusive"),
    ] {
        let requirements = folder.write("gate.toml", &gate(limit));
        let out = folder.path(name);
        assert_exit(
            &["gate", "--suite", &suite, "--requirements", &requirements, "--out", &out],
            code,
            &[&verdict.to_uppercase(), "edge_cases/hopeless"],
        );
        let evaluation = folder.json(&format!("{name}/gate.json"));
        assert_eq!(evaluation["verdict"], verdict);
        let rounds = evaluation["counts"]["rounds"].as_u64().unwrap();
        assert_eq!(rounds == 12, name == "open", "{name} took {rounds} rounds");
        let junit = fs::read_to_string(folder.path(&format!("{name}/gate.junit.xml"))).unwrap();
        assert_eq!(elements(&junit, "testcase"), 3);
        assert_eq!(
            (elements(&junit, "failure"), elements(&junit, "error")),
            (usize::from(code == 1), usize::from(code == 3))
        );
        assert!(fs::read_to_string(folder.path(&format!("{name}/gate.md"))).unwrap().contains(&verdict.to_uppercase()));
        // Judging the rows again gives the same verdict, because the test is still sequential.
        assert_exit(&["gate", "--run", &out], code, &[]);
    }
    let pass = folder.path("pass");
    let baseline = folder.path("baseline.json");
    assert_exit(&["gate", "--run", &pass, "--write-baseline", &baseline], 0, &["suite two 1.0.0"]);
    // The same scenarios again: the policies are equal, so a wide margin is met.
    let requirements = folder.write("gate.toml", &gate("at_least = 0.2"));
    let arguments =
        ["gate", "--suite", &suite, "--requirements", &requirements, "--baseline", &pass, "--margin", "0.9"];
    let output =
        assert_exit(&[&arguments[..], &["--out", &folder.path("b")]].concat(), 0, &["not worse than scripted"]);
    assert!(output.contains("pairs"), "{output}");
    // Judging the run again includes the comparison, and prints each changed part of the question.
    assert_exit(&["gate", "--run", &folder.path("b")], 0, &["not worse than scripted"]);
    let anew = ["gate", "--run", &folder.path("b"), "--margin", "0.8"];
    let output = text(&robogate(&anew));
    assert!(output.contains("used the margin 0.9; this evaluation uses 0.8"), "{output}");
    // Without the file of the question, the rows still show that the run stopped before the end of its plan.
    let rows = folder.path("pass/dictionary.parquet");
    let output = text(&robogate(&["gate", "--run", &rows, "--requirements", &requirements, "--json"]));
    assert!(output.contains("\"sampling\": \"sequential\""), "{output}");
    let small = ["gate", "--suite", &suite, "--requirements", &requirements, "--baseline", &pass];
    let nowhere = folder.path("d");
    let small = [&small[..], &["--margin", "0.01", "--out", &nowhere]].concat();
    assert_exit(&small, 2, &["the comparison can't be decided"]);
    let other = folder.write("other.toml", &SUITE.replace("0.3", "0.4"));
    let arguments = ["gate", "--suite", &other, "--requirements", &requirements, "--baseline", &pass];
    assert_exit(&[&arguments[..], &["--out", &folder.path("c")]].concat(), 2, &["the baseline is of suite two"]);
    let board = format!("first={pass}");
    assert_exit(&["leaderboard", &board, &folder.path("open"), "--baseline", &baseline], 0, &["first", "grip"]);
    for format in ["md", "html", "json"] {
        assert_exit(&["leaderboard", &board, "--baseline", &baseline, "--format", format], 0, &["first"]);
    }
}

#[test]
fn undecidable_questions_run_nothing() {
    let folder = Folder::new();
    let suite = folder.write("suite.toml", SUITE);
    for (limit, problem) in [
        ("at_least = 1.0", "can't be met at any number of episodes"),
        ("at_least = 0.999", "can't be met within the budget"),
        ("at_least = 0.5\ngroup = \"heavy\"", "nominal/easy, edge_cases/hopeless"),
        ("at_most_times_baseline = 1.2", "robogate gate --run RUN --write-baseline FILE"),
    ] {
        let requirements = folder.write("gate.toml", &gate(limit));
        let out = folder.path("out");
        assert_exit(&["gate", "--suite", &suite, "--requirements", &requirements, "--out", &out], 2, &[problem]);
        assert!(!std::path::Path::new(&out).exists(), "{limit}");
    }
    assert_exit(&["gate", "--run", &folder.path("nothing")], 2, &["nothing"]);
    assert_exit(&["gate", "--requirements", &folder.path("no.toml")], 2, &["Hint: check the path"]);
}

#[test]
fn copied_episodes_are_rejected() {
    let folder = Folder::new();
    let requirements = folder.write("gate.toml", &gate("at_least = 0.2"));
    let judge = |name: &str, seed: &dyn Fn(u64) -> u64, code: i32, parts: &[&str]| {
        let rows: String = (0..40).map(|i| format!("lift,{},true\n", seed(i))).collect();
        let csv = folder.write(&format!("{name}.csv"), &format!("case,seed,success\n{rows}"));
        let rows = folder.path(&format!("{name}.parquet"));
        assert_exit(&["import", &csv, &rows], 0, &[]);
        assert_exit(&["gate", "--run", &rows, "--requirements", &requirements], code, parts);
    };
    judge("each", &|i| i, 0, &["PASS"]);
    judge("copied", &|i| i % 20, 4, &["rows 0 and 20 are the same episode"]);
    // One seed for all rows does not identify episodes, so copies cannot be detected.
    judge("one", &|_| 0, 0, &["PASS"]);
}

#[test]
fn imports_that_repeat_cases_apply_to_these_cases() {
    let folder = Folder::new();
    let requirements = folder.write("gate.toml", &gate("at_least = 0.5"));
    let judge = |name: &str, head: &str, case: &dyn Fn(u64) -> String| {
        let rows: String = (0..40).map(|i| format!("{},{i},true\n", case(i))).collect();
        let csv = folder.write(&format!("{name}.csv"), &format!("{head},seed,success\n{rows}"));
        let rows = folder.path(&format!("{name}.parquet"));
        assert_exit(&["import", &csv, &rows], 0, &[]);
        let printed = assert_exit(
            &["gate", "--run", &rows, "--requirements", &requirements, "--out", &folder.path(name)],
            0,
            &[],
        );
        (folder.json(&format!("{name}/gate.json")), printed)
    };
    let repeated = |(found, printed): (Value, String)| {
        assert_eq!(found["population"]["cases"], 8, "{found}");
        assert_eq!(found["new_cases"]["cases"], 8, "{found}");
        assert!(found["estimand"].as_str().unwrap().contains("exactly these cases"), "{found}");
        assert!(printed.contains("imported episodes of 8 cases") && printed.contains("random sample"), "{printed}");
    };
    repeated(judge("named", "case", &|i| format!("lift-{}", i % 8)));
    repeated(judge("settings", "friction", &|i| format!("0.{}5", i % 8)));
    let (found, _) = judge("single", "friction", &|i| format!("0.{}5", 10 + i));
    assert!(found["population"].get("cases").is_none() && found.get("new_cases").is_none(), "{found}");
}

/// Two policies under two time limits are two questions. Other settings than the default stand with the verdict.
#[test]
fn policies_under_other_settings_are_not_compared() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let gate = "gate --task pendulum --policy random --rounds 1 --seed 3 --controls 0";
    let requirements = "name = 'r'\nmode = 'point'\n[[requirement]]\nmetric = 'success'\nat_least = 0.0\n";
    fs::write(at.join("r.toml"), requirements).unwrap();
    let changed = "Settings of the task that were changed: time_limit_s = 3";
    verb(at, &format!("{gate} --requirements r.toml --set time_limit_s=3 --out short"), 0, &[changed]);
    let other =
        ["the two policies were not judged alike: time_limit_s: 3 and", "Hint: run both with the same settings"];
    verb(at, &format!("{gate} --requirements r.toml --baseline short --margin 0.9 --out long"), 2, &other);
    verb(at, "gate --run short --requirements r.toml --write-baseline short.json", 0, &[changed]);
    verb(at, &format!("{gate} --requirements r.toml --baseline short.json --out long"), 2, &other[..1]);
    verb(at, "evidence short evidence", 0, &[]);
    verb(at, "verify evidence", 0, &[changed, "success at least 0.00 %"]);
    // A question that was changed after the start is not that of the run.
    let question = at.join("short/gate-question.json");
    let text = fs::read_to_string(&question).unwrap();
    fs::write(
        &question,
        text.replacen("\"at_least\":0.0", "\"at_least\":0.1", 1).replacen("\"at_least\": 0.0", "\"at_least\": 0.1", 1),
    )
    .unwrap();
    verb(at, "gate --run short", 2, &["not the question that the gate was asked"]);
}

/// A gate that did not pass says under which limits the requirement holds, which mode costs most and what separates failures; where
/// nothing does, how many episodes would show a difference. Imported rows are enough.
#[test]
fn failed_gate_says_what_to_change() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let rows = |name: &str, fails: &dyn Fn(f64, usize) -> bool| {
        let mut text = "success,failure_mode,friction,mass\n".to_owned();
        for i in 0..600_usize {
            let unit = |step: usize| ((i * step + 13) % 601) as f64 / 601.0;
            let (friction, failed) = (unit(37), fails(unit(37), i));
            let mode = if !failed {
                ""
            } else if i % 9 == 0 {
                "timeout"
            } else {
                "slip"
            };
            let _ = writeln!(text, "{},{mode},{friction},{}", !failed, unit(211));
        }
        fs::write(at.join(format!("{name}.csv")), text).unwrap();
        verb(at, &format!("import {name}.csv {name}.parquet --sampling uniform --stopping fixed"), 0, &[]);
    };
    fs::write(
        at.join("r.toml"),
        "name = 'r'\nmode = 'confidence'\n[[requirement]]\nmetric = 'success'\nat_least = 0.85\n",
    )
    .unwrap();
    rows("slippery", &|friction, _| friction < 0.3);
    let text = verb(at, "gate --run slippery.parquet --requirements r.toml", 1, &["FAIL", "What to change"]);
    let at_of = |part: &str| text.find(part).unwrap_or_else(|| panic!("{part:?} is not in {text}"));
    let ranks =
        ["Operate within friction at least 0.", "success is at least 85.0 %", "Costs most: slip", "Friction below 0."];
    assert!(ranks.windows(2).all(|pair| at_of(pair[0]) < at_of(pair[1])), "{text}");
    assert!(text.lines().count() <= 25, "{text}");
    rows("noise", &|_, i| (i * 7919) % 10 < 3);
    let power = ["No parameter separates failures from successes", "A difference of 10 points"];
    let text = verb(at, "gate --run noise.parquet --requirements r.toml", 1, &power);
    assert!(!text.contains("Operate within"), "{text}");
    rows("good", &|_, i| i % 100 == 0);
    let text = verb(at, "gate --run good.parquet --requirements r.toml", 0, &["PASS"]);
    assert!(!text.contains("What to change"), "{text}");
}
