//! `robogate warn`: record, train, check.

use std::fs;

use tempfile::TempDir;

use crate::harness::{robogate_in, text, verb};

/// Loads of which the heavy ones are sometimes lost.
const SPACE: &str = r#"
name = "grip"
[[parameter]]
name = "mass_kg"
kind = "continuous"
low = 0.1
high = 0.8
"#;

#[test]
fn detector_is_trained_checked_and_calibrated_again() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("grip.toml"), SPACE).unwrap();
    let run = |seed: u64, n: u32, more: &str| {
        let line = format!(
            "run --space grip.toml --design uniform -n {n} --seed {seed} --nominal-episodes 0 --out r{seed} -q{more}"
        );
        let output = robogate_in(at, &line.split_whitespace().collect::<Vec<_>>());
        assert!(output.status.success(), "{}", text(&output));
    };
    run(1, 165, " --record-signals --threads 2");
    run(2, 70, " --record-signals");

    // Recorded while the episodes run, and by a replay, is the same.
    let recorded = fs::read(at.join("r1/signals.rgs")).unwrap();
    let answer = verb(at, "warn train r1 --out w.json --json", 0, &["\"calibration\""]);
    fs::remove_file(at.join("r1/signals.rgs")).unwrap();
    assert_eq!(verb(at, "warn train r1 --out again.json --json --threads 1", 0, &[]), answer);
    assert_eq!(fs::read(at.join("r1/signals.rgs")).unwrap(), recorded);
    assert_eq!(fs::read(at.join("w.json")).unwrap(), fs::read(at.join("again.json")).unwrap());
    let document: serde_json::Value = serde_json::from_str(&answer).unwrap();
    let (rank, n) = (&document["calibration"]["rank"], document["calibration"]["successes"].as_u64().unwrap());
    assert!(n >= 59 && rank.as_u64().unwrap() <= n, "{answer}");

    verb(at, "warn check w.json r1", 2, &["its episodes trained this detector", "Hint: check it on another run"]);
    let checked = robogate_in(at, &["warn", "check", "w.json", "r2"]);
    assert!(matches!(checked.status.code(), Some(0 | 3)), "{}", text(&checked));
    assert!(text(&checked).contains("independent successes warned"), "{}", text(&checked));
    verb(at, "warn check w.json r2 --out c.json", 0, &["at most 5.0 % of successful episodes"]);
    let file: serde_json::Value = serde_json::from_slice(&fs::read(at.join("c.json")).unwrap()).unwrap();
    assert_ne!(file["calibration"], document["calibration"], "{file}");

    // A live feed: one number is missing in a line, and one line is no control period.
    let groups = file["features"]["signals"]["groups"].as_array().unwrap();
    let of = |kind: &str| -> serde_json::Map<String, serde_json::Value> {
        let of = groups.iter().filter(|group| group["kind"] == kind);
        of.map(|group| {
            let zeros = vec![0.0; group["length"].as_u64().unwrap() as usize];
            (group["name"].as_str().unwrap().to_owned(), serde_json::json!(zeros))
        })
        .collect()
    };
    let (observation, command) = (of("observation"), of("command"));
    let mut lines = vec!["{\"robot\": \"a\", \"start\": {}}".to_owned(), "{\"robot\": 1}".to_owned()];
    for tick in 0..20 {
        let time_s = 0.05 * f64::from(tick);
        let period = serde_json::json!({ "robot": "a", "time_s": time_s, "observation": observation, "command": command, "gripper": 1.0 });
        lines.push(period.to_string());
    }
    lines.push("{\"robot\": \"a\", \"time_s\": 1.0, \"command\": {}}".to_owned());
    lines.push("{\"robot\": \"a\", \"end\": \"success\"}".to_owned());
    fs::write(at.join("feed.jsonl"), lines.join("\n")).unwrap();
    let heard = verb(at, "warn watch c.json feed.jsonl", 2, &["line 2 is rejected", "line 23 is rejected", "missing"]);
    let last: serde_json::Value = serde_json::from_str(heard.lines().last().unwrap()).unwrap();
    let successes = |name: &str| last["episodes"][name].as_u64().unwrap();
    assert_eq!(successes("quiet_successes") + successes("warned_successes"), 1, "{heard}");
    assert_eq!(last["rejected_lines"], 2, "{heard}");

    // The promise is a part of the safety case of the run, and not of that of another policy.
    fs::write(
        at.join("half.toml"),
        "name = \"half\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.2\n",
    )
    .unwrap();
    let line = "evidence r1 e --requirements half.toml --safety-case --include warning=w.json";
    verb(at, line, 0, &[]);
    verb(at, "verify e", 0, &[]);
    let argument = fs::read_to_string(at.join("e/safety-case.gsn.yaml")).unwrap();
    let warning = argument.split("\nG-warning-1:\n").nth(1).unwrap();
    assert!(warning.starts_with("  text: \"A detector warns within an episode, and warns at most 5.0 %"), "{warning}");
    assert!(warning.contains("status: \"supported\""), "{warning}");
    let other = fs::read_to_string(at.join("w.json")).unwrap().replacen("scripted", "other", 1);
    fs::write(at.join("other.json"), other).unwrap();
    verb(
        at,
        "evidence r1 wrong --requirements half.toml --include warning=other.json",
        4,
        &["conditions/policy` is other"],
    );

    // Errors of the user.
    verb(at, "warn train r1 --out w.json --parameters mass", 2, &["mass_kg"]);
    verb(at, "warn train r1 --out w.json --event jam", 2, &["MODE=MEASURE>LIMIT"]);
    fs::write(at.join("empty.json"), "{}").unwrap();
    verb(at, "warn check empty.json r2", 2, &["not a detector", "Hint: "]);
    let line = "run --nominal -n 8 --out few -q";
    robogate_in(at, &line.split_whitespace().collect::<Vec<_>>());
    verb(at, "warn train few --out few.json", 2, &["successes", "needed"]);
    fs::write(at.join("r2/signals.rgs"), "no signals").unwrap();
    verb(at, "warn check w.json r2", 2, &["not a file of signals", "Hint: "]);
}

/// A detector that always warns ends every episode, and the episodes run again without it.
#[test]
fn warner_acts_in_the_episodes_of_a_run() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("grip.toml"), SPACE).unwrap();
    let run = |more: &str| {
        let line = format!("run --space grip.toml --design uniform --nominal-episodes 0 -q --json {more}");
        let output = robogate_in(at, &line.split_whitespace().collect::<Vec<_>>());
        assert!(output.status.success(), "{more}: {}", text(&output));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    run("-n 165 --seed 1 --record-signals --out r1");
    verb(at, "warn train r1 --out w.json", 0, &[]);
    let mut file: serde_json::Value = serde_json::from_slice(&fs::read(at.join("w.json")).unwrap()).unwrap();
    file["calibration"]["threshold"] = (-1e9).into();
    fs::write(at.join("always.json"), file.to_string()).unwrap();

    let outcomes = |run: &str| {
        let csv = verb(at, &format!("export {run} -"), 0, &[]);
        let column = csv.lines().next().unwrap().split(',').position(|name| name == "outcome").unwrap();
        csv.lines().skip(1).map(|row| row.split(',').nth(column).unwrap().to_owned()).collect::<Vec<_>>()
    };
    run("-n 10 --seed 4 --out plain");
    let successes = outcomes("plain").iter().filter(|outcome| *outcome == "success").count() as u64;
    let document =
        run("-n 10 --seed 4 --out stopped --warner always.json --on-warning stop --threads 1 --record-signals");
    assert!(outcomes("stopped").iter().all(|outcome| outcome == "warned_stop"));
    let warner = &document["warner"];
    assert_eq!(
        (warner["false_warnings"].as_u64(), warner["avoided"].as_u64()),
        (Some(successes), Some(10 - successes))
    );
    assert_eq!(warner["without"]["successes"], successes);
    let page = fs::read_to_string(at.join("stopped/report.html")).unwrap();
    assert!(page.contains("10 of 10 episodes were stopped at a warning"), "the page says it");

    // The same for any number of threads, by a replay, and after an interruption before the second runs.
    run("-n 10 --seed 4 --out again --warner always.json --on-warning stop --threads 3");
    for name in ["dictionary.parquet", "without_warner.json"] {
        assert_eq!(fs::read(at.join("stopped").join(name)).unwrap(), fs::read(at.join("again").join(name)).unwrap());
    }
    verb(at, "replay stopped 3", 0, &["warned_stop", "identical to the recorded episode"]);
    fs::remove_file(at.join("again/without_warner.json")).unwrap();
    verb(at, "resume again", 0, &["10 of 10 episodes were stopped"]);
    assert_eq!(
        fs::read(at.join("stopped/without_warner.json")).unwrap(),
        fs::read(at.join("again/without_warner.json")).unwrap()
    );

    // The successes among the stopped episodes count for the promise.
    let checked = verb(at, "warn check w.json stopped --json", 1, &[]);
    let checked: serde_json::Value = serde_json::from_str(&checked).unwrap();
    assert_eq!(checked["detector"]["false_warnings"]["of"], successes, "{checked}");
    verb(at, "warn check w.json stopped --out c.json", 2, &["successes"]);

    // A handover is an assist, and slow motion goes on.
    let document = run("-n 3 --seed 4 --out handed --warner always.json --on-warning handover");
    assert_eq!(document["warner"]["ended"], 3);
    let document = run("-n 3 --seed 4 --out slow --warner always.json --on-warning slow");
    assert_eq!((&document["warner"]["ended"], &document["warner"]["warned"]), (&0.into(), &3.into()));
    fs::write(
        at.join("q.toml"),
        "name = \"q\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.5\n",
    )
    .unwrap();
    let line =
        "gate --space grip.toml --rounds 1 --requirements q.toml --out g --warner always.json --on-warning record -q";
    verb(at, line, 0, &["64 of 64 episodes were warned", "the detector promises at most 5.0 %"]);
    verb(at, "evidence g e", 0, &[]);
    verb(at, "verify e", 0, &["64 of 64 episodes were warned"]);

    verb(at, "run -n 2 --warner w.json --out x", 2, &["--on-warning"]);
    verb(at, "run -n 2 --warner q.toml --on-warning stop --out x", 2, &["not a detector", "Hint: "]);
    verb(at, "run -n 2 --warner w.json --on-warning halt --out x", 2, &["handover"]);
    verb(at, "run --task pendulum -n 2 --warner w.json --on-warning stop --out x", 2, &["other signals", "Hint: "]);
    verb(
        at,
        "run --task stacking -n 2 --nominal-episodes 0 --warner w.json --on-warning record --out x",
        0,
        &["other conditions: task"],
    );
    verb(
        at,
        "run -n 2 --warner w.json --on-warning slow --latency fixed:80ms --out x",
        2,
        &["slowed down too", "Hint: "],
    );
    verb(at, "gate --run g --warner w.json --on-warning stop", 2, &["cannot be used with --run", "Hint: "]);
}
