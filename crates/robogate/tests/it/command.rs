//! End-to-end tests of the command: real physics, real files, exit codes.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use robogate_core::Seed;
use tempfile::TempDir;

use crate::harness::{TWO_SCENARIOS, assert_done, assert_exit, path, robogate, runs_until, text};

/// Asserts exit code 2 and that the message contains each of `parts`.
#[track_caller]
fn assert_usage(arguments: &[&str], parts: &[&str]) {
    assert_exit(arguments, 2, parts);
}

/// The files that record a run. The report is excluded, because it names its folder.
fn files(dir: &str) -> BTreeMap<String, Vec<u8>> {
    fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap() != "report.html")
        .map(|path| (path.file_name().unwrap().to_str().unwrap().to_owned(), fs::read(&path).unwrap()))
        .collect()
}

fn run(dir: &str, episodes: &str, threads: &str) {
    assert_done(&robogate(&["run", "-n", episodes, "--threads", threads, "--out", dir]));
}

fn spawn(arguments: &[&str]) -> std::process::Child {
    Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Bytes of the journal of a run that has not ended.
fn recorded(dir: &str) -> u64 {
    fs::metadata(Path::new(dir).join("journal.rgj")).map_or(0, |file| file.len())
}

/// Killed again and again, each time after at least one more episode and at a random moment.
#[test]
fn killed_runs_resume_identically() {
    let dir = TempDir::new().unwrap();
    let (one, two, killed) = (path(&dir, "one"), path(&dir, "two"), path(&dir, "killed"));
    run(&one, "24", "1");
    run(&two, "24", "2");
    assert!(files(&one) == files(&two), "1 and 2 threads differ");
    let mut delays = Seed::campaign(5).stream("kills");
    let mut kills = 0;
    for attempt in 0..20 {
        let before = recorded(&killed);
        let begun = Path::new(&killed).join("plan.json").exists();
        let mut child = if begun {
            spawn(&["resume", "--threads", "1", &killed])
        } else {
            spawn(&["run", "-n", "24", "--threads", "2", "--out", &killed])
        };
        // The first kill may come before the plan is written.
        let grown = attempt == 0 || runs_until(&mut child, || recorded(&killed) > before);
        std::thread::sleep(Duration::from_secs_f64(delays.between(0.0, 0.05)));
        kills += usize::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        assert!(grown || child.wait().unwrap().success(), "the run failed");
        child.wait().unwrap();
        if !grown || Path::new(&killed).join("dictionary.parquet").exists() {
            break;
        }
    }
    println!("killed {kills} times");
    assert!(kills >= 5, "killed {kills} times only");
    assert_done(&robogate(&["resume", &killed]));
    assert!(files(&one) == files(&killed), "a killed and resumed run differs");
}

#[test]
fn interrupt_exits_130_and_resumes() {
    let dir = TempDir::new().unwrap();
    let out = path(&dir, "run");
    let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args(["run", "-n", "300", "--out", &out])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    assert!(runs_until(&mut child, || recorded(&out) > 8_000), "no episode is recorded");
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let stderr: Vec<String> = lines.map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{stderr:?}");
    assert!(stderr.iter().any(|line| line.contains("robogate resume")), "{stderr:?}");
    // An interrupted run can be inspected.
    assert_done(&robogate(&["replay", &out, "0"]));
}

#[test]
fn replays_are_identical() {
    let dir = TempDir::new().unwrap();
    let out = path(&dir, "run");
    let output = robogate(&["run", "-n", "12", "--json", "--out", &out]);
    assert_done(&output);
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["summary"]["episodes"], 12);
    for index in 0..12 {
        let output = robogate(&["replay", &out, &index.to_string(), "--json"]);
        assert_done(&output);
        let replay: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(replay["same_as_recorded"], true);
        assert_eq!(replay["timeline"][0]["phase"], "APPROACH_ABOVE");
    }
    assert_usage(&["replay", &out, "12"], &["episode 12", "12"]);
    for name in ["rows.csv", "rows.jsonl", "rows.json"] {
        let file = path(&dir, name);
        assert_done(&robogate(&["export", &out, &file]));
        assert!(fs::metadata(&file).unwrap().len() > 1000);
    }
    let printed = robogate(&["export", &out, "-"]);
    assert_done(&printed);
    assert_eq!(printed.stdout, fs::read(path(&dir, "rows.csv")).unwrap());
    // A file in the published schema can be imported again.
    assert_done(&robogate(&["import", &path(&dir, "rows.json"), &path(&dir, "again.parquet")]));
}

#[test]
fn wrong_arguments_are_usage_errors() {
    let dir = TempDir::new().unwrap();
    let out = path(&dir, "run");
    let run = |key: &str, value: &str, parts: &[&str]| assert_usage(&["run", "--out", &out, key, value], parts);
    let file = |name: &str, content: &str| {
        let path = path(&dir, name);
        fs::write(&path, content).unwrap();
        path
    };
    run("-n", "0", &["'0' for '--n <N>'", "at least 1"]);
    run("--threads", "0", &["'0' for '--threads <T>'", "from 1 to 4096"]);
    run("--threads", "1000000000000", &["from 1 to 4096"]);
    assert_usage(&["run", "--out", &out, "-n", "3", "--rounds", "5"], &["--rounds needs --suite"]);
    assert_usage(&["gate", "--baseline", &out, "--against-profile", "droid"], &["--against-profile", "--baseline"]);
    run("--robot", "r2d2", &["unknown robot `r2d2`", "franka"]);
    run("--engine", "ode", &["no such engine", "mujoco"]);
    assert_usage(&["run", "--out", &out, "--engine", "rapier", "--renderer", "egl"], &["--engine mujoco", "rapier"]);
    run("--renderer", "vulkan", &["vulkan", "embedded", "egl"]);
    run("--set", "grip_force_n=500", &["500", "70"]);
    run("--set", "jam_force_n=none", &["jam_force_n", "none", "a number from 0.1"]);
    run("--set", "time_limit_s=0.03", &["time_limit_s", "0.03", "0.05 to 86400"]);
    run("--set", "time_limit_s=3.01", &["time_limit_s", "3.01", "multiple of 0.05 s"]);
    run("--set", "suction=vacuum", &["suction", "no effect", "franka"]);
    run("--set", "friction=0.3", &["`friction` is a parameter", "--space"]);
    run("--set", "jam_force=50", &["jam_force", "no such setting", "jam_force_n"]);
    run("--set", "jam_force_n", &["jam_force_n", "NAME=VALUE"]);
    run("--time-step", "0.003", &["0.003", "not an integer multiple"]);
    run("--preset", "big", &["big", "quick", "paper"]);

    let space = |name: &str, low: f64, rest: &str| {
        let parameter =
            format!("[[parameter]]\nname = \"{name}\"\nkind = \"continuous\"\nlow = {low}\nhigh = 0.6\n{rest}");
        format!("name = \"mine\"\n{parameter}")
    };
    run("--space", "nope", &["unknown parameter space", "franka", "stacking", "insertion"]);
    run("--space", &file("space.toml", &space("friction", 1.2, "")), &["space.toml", "`friction`", "1.2", "0.6"]);
    run("--space", &file("key.toml", &space("friction", 0.1, "scal = \"log\"")), &["key.toml", "scal", "line"]);
    run("--space", &file("name.toml", &space("frictoin", 0.1, "")), &["`frictoin`", "friction"]);
    run("--space", &file("range.toml", &space("mass_kg", -2.0, "")), &["`mass_kg`", "-2"]);
    let plan = file("plan.toml", "[uniform]\nepisodes = 10\n[boundary]\nepisodes = 5\nband = [0.7, 0.3]\n");
    run("--plan", &plan, &["plan.toml", "0.7", "0.3"]);

    fs::create_dir(dir.path().join("robot")).unwrap();
    let toml = include_str!("../../../../assets/robots/franka/robot.toml");
    let robot = path(&dir, "robot");
    run("--robot", &robot, &["robot.toml"]);
    file("robot/robot.toml", toml);
    run("--robot", &robot, &["franka.xml", "does not exist"]);
    file("robot/franka.xml", "<mujoco><worldbody><body></worldbody></mujoco>");
    run("--robot", &robot, &["franka.xml"]);
    file("robot/franka.xml", "<mujoco><worldbody><body name='a'/></worldbody></mujoco>");
    run("--robot", &robot, &["franka.xml", "joint1"]);
    file("robot/robot.toml", &toml.replace("reach_m = 0.855", "reach_m = -1"));
    run("--robot", &robot, &["reach_m", "-1"]);

    assert_usage(&["resume", &out], &["no plan.json"]);
    assert_usage(&["export", &plan, &path(&dir, "x.csv")], &["plan.toml"]);
    assert_usage(&["import", &plan, &path(&dir, "x.parquet")], &["plan.toml"]);
    // An address is not a folder. Without a check, a folder `s3:` would be created.
    for line in [
        "run -n 1 --out",
        "gate --out",
        "merge r --out",
        "matrix s.toml --out",
        "demos --out",
        "report r --out",
        "export r",
    ] {
        let arguments: Vec<&str> = line.split(' ').chain(["s3://bucket/x"]).collect();
        assert_usage(&arguments, &["s3://bucket/x", "docs/guides/cluster.md"]);
    }
    assert!(!Path::new(&out).exists() && !Path::new("s3:").exists(), "a run was started");
    assert!(!dir.path().join("x.csv").exists() && !dir.path().join("x.parquet").exists());
}

#[test]
fn finished_and_damaged_runs_are_rejected() {
    let dir = TempDir::new().unwrap();
    let out = path(&dir, "run");
    run(&out, "12", "2");
    let before = files(&out);
    assert_usage(&["run", "-n", "12", "--out", &out], &["finished run"]);
    assert!(files(&out) == before);
    let dictionary = Path::new(&out).join("dictionary.parquet");
    let bytes = fs::read(&dictionary).unwrap();
    fs::write(&dictionary, &bytes[..bytes.len() / 2]).unwrap();
    assert_usage(&["export", &out, &path(&dir, "x.csv")], &["dictionary.parquet"]);
}

#[test]
fn suite_rows_ignore_thread_count() {
    let dir = TempDir::new().unwrap();
    let suite = path(&dir, "two.toml");
    fs::write(&suite, TWO_SCENARIOS).unwrap();
    assert_done(&robogate(&["check", "suite", &suite]));
    let runs = ["1", "2"].map(|threads| {
        let out = path(&dir, threads);
        assert_done(&robogate(&["run", "--suite", &suite, "--rounds", "3", "--threads", threads, "--out", &out]));
        files(&out)
    });
    assert_eq!(runs[0], runs[1]);
    let (out, rows) = (path(&dir, "1"), path(&dir, "rows.csv"));
    assert_done(&robogate(&["export", &out, &rows]));
    let rows = fs::read_to_string(rows).unwrap();
    assert_eq!(rows.lines().skip(1).filter(|row| row.contains(",plain-2,nominal,plain,")).count(), 3);
    assert_done(&robogate(&["replay", &out, "5"]));
}

#[test]
fn documented_suite_is_valid() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/guides/suites.md");
    let page = fs::read_to_string(page).unwrap();
    let example = page.split("```toml\n").nth(1).unwrap().split("```").next().unwrap();
    let dir = TempDir::new().unwrap();
    let suite = path(&dir, "bottles.toml");
    fs::write(&suite, example).unwrap();
    assert_exit(&["check", "suite", &suite], 0, &["suite of 4 scenarios"]);
}

#[test]
fn wrong_suites_are_usage_errors() {
    let dir = TempDir::new().unwrap();
    let suite = path(&dir, "wrong.toml");
    let write = |scenarios: &str| {
        let head = "schema = 1\nname = \"w\"\nversion = \"1\"\ndescription = \"\"\n[[group]]\nname = \"g\"";
        fs::write(&suite, format!("{head}\ncategory = \"nominal\"\nscenarios = [{scenarios}]")).unwrap();
    };
    write("{ id = \"a\", friction = 20.0, glare = 1.0 }, { id = \"b\", friction = 0.1, glare = 1.0 }");
    assert_usage(
        &["check", "suite", &suite],
        &["`friction` = 20: expected a number from 0 to 10", "unknown parameter `glare`", "2 problems"],
    );
    assert_usage(
        &["run", "--suite", &suite],
        &["`friction` = 20: expected a number from 0 to 10", "unknown parameter `glare`"],
    );
    write("{ id = \"a\" }, { id = \"a\" }");
    assert_usage(&["check", "suite", &suite], &["scenario id `a` is used twice"]);
    assert_usage(&["run", "--suite", "industrial-67"], &["unknown suite `industrial-67`", "industrial-68"]);
    assert_usage(&["run", "--suite", "industrial-68", "-n", "10"], &["cannot be used with"]);
    assert_usage(&["run", "--rounds", "10"], &["--suite"]);
}

/// Reads width and height from a PNG's header.
fn png_size(file: &str) -> [u32; 2] {
    let bytes = fs::read(file).unwrap();
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n", "{file}");
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()))
}

#[test]
fn snapshots_are_deterministic() {
    let dir = TempDir::new().unwrap();
    let take = |folder: &str| {
        let out = path(&dir, folder);
        let case = ["--suite", "industrial-68", "--case", "cluttered_scene-2", "--at", "0,0.6", "--size", "64"];
        robogate(&[["replay", "--json", "--out", &out].as_slice(), &case].concat())
    };
    let (one, two) = (take("one"), take("two"));
    assert_done(&one);
    assert_done(&two);
    let document: serde_json::Value = serde_json::from_slice(&one.stdout).unwrap();
    let pictures = document["pictures"].as_array().unwrap();
    assert_eq!(pictures.len(), 4);
    let mut different = std::collections::BTreeSet::new();
    for picture in pictures {
        let file = picture["file"].as_str().unwrap();
        assert_eq!(png_size(file), [64, 64]);
        assert!(fs::read(file).unwrap() == fs::read(file.replace("/one/", "/two/")).unwrap(), "{file}");
        different.insert(fs::read(file).unwrap());
    }
    assert_eq!(different.len(), 4, "each camera and time has a different image");
    let again = take("one");
    assert_eq!(again.status.code(), Some(2));
    assert!(text(&again).contains("already exists"), "{}", text(&again));

    let sheet = path(&dir, "sheet.png");
    assert_done(&robogate(&["replay", "--suite", "industrial-68", "--sheet", "--size", "16", "--out", &sheet]));
    assert_eq!(png_size(&sheet), [10 * 20 + 4, 7 * 33 + 4]);
}

#[test]
fn wrong_snapshots_are_usage_errors() {
    assert_usage(&["replay", "--suite", "industrial-68", "--case", "nothing"], &["has no scenario `nothing`"]);
    assert_usage(&["replay", "--suite", "nothing"], &["unknown suite `nothing`"]);
    assert_usage(&["replay", "--scenario", "0", "--set", "lighting_lux"], &["expected NAME=VALUE"]);
    assert_usage(&["replay", "--scenario", "0", "--set", "lighting=500"], &["lighting"]);
    assert_usage(&["replay", "--scenario", "0", "--set", "table_material=marble"], &["marble", "wood"]);
    assert_usage(&["replay", "--at=-1"], &["--at -1", "0 to 1,000,000 s"]);
    assert_usage(&["replay", "--at", "1e9"], &["0 to 1,000,000 s"]);
    assert_usage(&["replay", "--scenario", "0", "--size", "0"], &["16..=2048"]);
    assert_usage(&["replay", "--sheet"], &["--suite"]);
    assert_usage(&["replay", "/nowhere", "3", "--at", "1"], &["/nowhere"]);
}

/// Runs the command with this stdout. Returns its exit code and stderr.
#[cfg(target_os = "linux")]
fn ends_with_stdout(arguments: &[&str], stdout: impl Into<Stdio>) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_robogate"));
    let output = command.args(arguments).stdout(stdout).stderr(Stdio::piped()).spawn().unwrap().wait_with_output();
    let output = output.unwrap();
    (output.status.code(), text(&output))
}

#[cfg(target_os = "linux")]
#[test]
fn lost_output_is_an_error() {
    for arguments in [&["list"][..], &["list", "--json"], &["list", "suites", "industrial-68"]] {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let (code, printed) = ends_with_stdout(arguments, full);
        assert_eq!(code, Some(5), "{arguments:?}: {printed}");
        assert!(printed.starts_with("error: cannot write to stdout: ") && printed.lines().count() == 1, "{printed}");
        // A reader that has seen enough, such as `head`.
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        assert_eq!(ends_with_stdout(arguments, writer), (Some(0), String::new()), "{arguments:?}");
    }
}
