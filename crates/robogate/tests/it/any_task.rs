//! End-to-end tests of tasks other than pick and place: a built-in one, and one that a Python server declares.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;

use robogate_dictionary::{Dictionary, Entry, write_parquet};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{kill_after, verb};

/// Runs all verbs on the same run. Their documents contain the modes and measures of its task and no others.
#[test]
fn pendulum_passes_through_every_verb() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let verb = |arguments: &str, code: i32, parts: &[&str]| verb(at, arguments, code, parts);
    verb("list", 0, &["pick_place", "pendulum"]);
    verb(
        "run --task pendulum -n 120 --seed 3 --threads 2 --out a --verbose",
        0,
        &["pendulum in mujoco", "fell", "overspeed"],
    );
    verb("run --task pendulum -n 120 --seed 3 --threads 1 --out b", 0, &[]);
    let rows = |name: &str| fs::read(at.join(name).join("dictionary.parquet")).unwrap();
    assert!(rows("a") == rows("b"), "rows depend on the number of threads");
    verb("resume a", 0, &[]);
    verb("replay a 7", 0, &["identical to the recorded episode", "peak_speed_rad_s"]);
    without_engine(at);
    verb("analyze a", 0, &["pendulum", "torque limit"]);
    verb("report a --out page.html", 0, &[]);
    let page = fs::read_to_string(at.join("page.html")).unwrap();
    assert!(page.contains("overspeed") && !page.contains("grasp"));
    verb("run --task pendulum --policy random -n 120 --seed 3 --out random", 0, &["random policy"]);
    verb("compare a random", 0, &["random"]);
    verb("export a rows.csv", 0, &[]);
    assert!(fs::read_to_string(at.join("rows.csv")).unwrap().lines().next().unwrap().contains("upright_error_rad"));

    verb("gate --task pendulum --out gate", 1, &["FAIL", "success rate at least 92.0 %", "overspeed"]);
    verb("gate --run a --requirements paper", 2, &["pick_place", "pendulum"]);
    verb("evidence gate evidence", 1, &[]);
    verb("verify evidence", 0, &["verification passed: verdict fail"]);
    verb("gate --task pendulum --policy random --out other", 1, &["FAIL"]);
    verb("leaderboard gate other", 0, &["gate", "other"]);
    verb("leaderboard gate other gate/dictionary.parquet", 2, &["have the same rows"]);
    verb("gate --run gate --write-baseline baseline.json", 1, &["overspeed"]);
    verb("gate --run gate --baseline baseline.json", 1, &[]);
    verb(
        "monitor reference a --out reference.json",
        2,
        &["below the 92.0 % that the gate requires", "--learn-baseline"],
    );
    verb("monitor reference a --learn-baseline --out reference.json", 0, &["risk model"]);
    // A gate without its question must not become a run without a verdict.
    fs::remove_file(at.join("other/gate-question.json")).unwrap();
    verb("resume other", 2, &["gate-question.json: missing", "restore the file"]);
}

/// Sampled latencies are hidden draws: of a task without other draws, and of one with them. A dictionary without their columns, as an
/// earlier version wrote it, replays as before, and `export` computes them again.
#[test]
fn sampled_latencies_are_recorded() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let rows = |dictionary: &Dictionary| dictionary.entries().collect::<Result<Vec<Entry>, _>>().unwrap();
    let is_latency = |name: &str| name.starts_with("inference_latency_");
    for (run, options) in [("pendulum", "--task pendulum -n 4"), ("cell", "-n 2")] {
        let latency = "--latency gamma:80ms,20ms --design uniform";
        verb(at, &format!("run {options} {latency} --out {run}"), 0, &["inference latency gamma"]);
        verb(at, &format!("replay {run} 1"), 0, &["identical to the recorded episode"]);
        let file = at.join(run).join("dictionary.parquet");
        let new = Dictionary::open(&file).unwrap();
        let recorded = rows(&new);
        for Entry { episode, .. } in &recorded {
            let [first, mean, longest] = ["first", "mean", "longest"]
                .map(|which| episode.draws.get(&format!("inference_latency_{which}_s")).unwrap());
            assert!(0.0 < first && first <= longest && 0.04 < mean && mean <= longest, "{first} {mean} {longest}");
        }
        let (provenance, hash) = (new.provenance().clone(), new.dataset_hash().to_owned());
        let mut old = provenance.clone();
        let mut task = (*old.task).clone();
        task.draws.retain(|draw| !is_latency(draw.name.as_str()));
        assert_eq!(task.draws.is_empty(), run == "pendulum");
        old.task = Arc::new(task);
        let without = recorded.iter().cloned().map(|mut entry| {
            let others = entry.episode.draws.iter().filter(|(name, _)| !is_latency(name.as_str()));
            entry.episode.draws = others.map(|(name, value)| (name, Some(value))).collect();
            Ok(entry)
        });
        fs::remove_file(&file).unwrap();
        write_parquet(&file, &old, without).unwrap();
        verb(at, &format!("replay {run} 1"), 0, &["identical to the recorded episode"]);
        verb(at, &format!("export {run} {run}.parquet"), 0, &[]);
        let again = Dictionary::open(&at.join(format!("{run}.parquet"))).unwrap();
        assert!(rows(&again) == recorded, "{run}: the draws differ");
        assert_eq!((again.provenance(), again.dataset_hash()), (&provenance, &*hash), "{run}");
        // A distribution that cannot be sampled is refused.
        let plan = at.join(run).join("plan.json");
        let mut settings: Value = serde_json::from_slice(&fs::read(&plan).unwrap()).unwrap();
        settings["provenance"]["world"]["execution"]["latency"]["sd_s"] = json!(0.0);
        fs::write(&plan, settings.to_string()).unwrap();
        verb(at, &format!("replay {run} 1"), 2, &["provenance.world.execution is not valid"]);
    }
}

/// Runs the verbs on tasks for an arm, whose robot and engine are chosen.
#[test]
fn arm_tasks_pass_through_the_verbs() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let verb = |arguments: &str, code: i32, parts: &[&str]| verb(at, arguments, code, parts);
    verb("list", 0, &["stacking", "insertion", "stacking-40", "insertion-40"]);
    for (task, mode, measure, other) in
        [("stacking", "toppled", "stability_margin_m", "wedge"), ("insertion", "wedge", "insertion_depth_m", "toppled")]
    {
        let run = format!("run --task {task} --robot ur5e -n 8 --seed 3");
        let a = format!("{task}-a");
        verb(&format!("{run} --threads 2 --out {a}"), 0, &["ur5e"]);
        verb(&format!("{run} --threads 1 --out {task}-b"), 0, &[]);
        // The uniform stage, then one round of the active stage.
        for shard in [0, 1, 0, 1] {
            verb(&format!("{run} --shard {shard}/2 --out {task}-s"), 0, &[]);
        }
        verb(&format!("merge {task}-s"), 0, &[]);
        let rows = |name: &str| fs::read(at.join(name).join("dictionary.parquet")).unwrap();
        assert!(rows(&a) == rows(&format!("{task}-b")), "rows depend on the number of threads");
        assert!(rows(&a) == rows(&format!("{task}-s")), "rows depend on the shards");
        verb(&format!("resume {a}"), 0, &[]);
        verb(&format!("replay {a} 3"), 0, &["identical to the recorded episode", measure]);
        verb(&format!("analyze {a}"), 0, &["failure report: Ur5e"]);
        verb(&format!("report {a} --out {task}.html"), 0, &[]);
        let page = fs::read_to_string(at.join(format!("{task}.html"))).unwrap();
        assert!(page.contains(mode) && !page.contains(other));
        verb(&format!("monitor reference {a} --learn-baseline --out {task}.json"), 0, &[]);
    }
    verb("run --task stacking --robot ur5e --set grip_force_n=10 -n 2 --out c", 2, &["no effect", "suction cup"]);
    verb("run --task stacking --renderer egl --engine rapier -n 2 --out d", 2, &["--renderer egl"]);
    verb("run --task stacking --engine none -n 2 --out e", 2, &["no such engine"]);
    verb("demos --task pendulum -n 2 --out none", 2, &["a built-in task for an arm: pick_place, stacking, insertion"]);
    verb("check physics coulomb --task stacking", 2, &["stacking has no claim `coulomb`", "overhang"]);
    verb("serve --physics-only --set jam_force_n=50", 2, &["--set jam_force_n has no effect", "client"]);
}

/// The default design is active. Its gate uses the episodes that no model chose, and other designs can be chosen.
#[test]
fn designs_of_the_pendulum() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let verb = |arguments: &str, code: i32, parts: &[&str]| verb(at, arguments, code, parts);
    let run = "run --task pendulum -n 200 --seed 3";
    verb(&format!("{run} --verbose --out a"), 0, &["over the operating space", "Risk model"]);
    verb("export a rows.csv", 0, &[]);
    let rows = fs::read_to_string(at.join("rows.csv")).unwrap();
    let header: Vec<&str> = rows.lines().next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|of| *of == name).unwrap();
    let (stage, design) = (column("stage"), column("design"));
    let cells: Vec<Vec<&str>> = rows.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let count = |of: &str, chosen: &str| cells.iter().filter(|row| row[stage] == of && row[design] == chosen).count();
    let sampled = count("uniform", "latin_hypercube") + count("active", "uniform");
    assert_eq!(sampled + count("active", "active"), 200);
    assert!(sampled > 100 && sampled < 160, "{sampled}");
    let judged = format!("{sampled} episodes");
    let excluded = format!("{} episodes of a focused design are excluded", 200 - sampled);
    verb("gate --run a --requirements default", 1, &[&judged, &excluded]);
    verb("analyze a", 0, &["active (uniform part)", "valid episodes count in every figure"]);

    verb(&format!("{run} --design uniform --out uniform"), 0, &["200 episodes over the operating space, into uniform"]);
    // The terminal leads with the rate of the report and of the analysis, not with that of the uniform stage.
    let weighted = ["134 episodes over the operating space, then 66 near", "; 200 episodes", "Sampling"];
    verb(&format!("{run} --design two-stage --verbose --out two"), 0, &weighted);
    assert!(!at.join("two/active.json").exists() && at.join("two/boundary.json").exists());
    // A boundary report that cannot be read is an error. Only a missing one is skipped.
    fs::rename(at.join("two/boundary.json"), at.join("boundary.json")).unwrap();
    fs::create_dir(at.join("two/boundary.json")).unwrap();
    verb("analyze two", 2, &["two/boundary.json"]);
    fs::remove_dir(at.join("two/boundary.json")).unwrap();
    fs::rename(at.join("boundary.json"), at.join("two/boundary.json")).unwrap();
    verb(&format!("{run} --seek fell --out sought"), 0, &["fell", "of 200 episodes failed in this way"]);
    verb(&format!("{run} --seek flew --out x"), 2, &["no such failure mode", "fell", "overspeed"]);
    verb(&format!("{run} --seek fell --design uniform --out x"), 2, &["active design"]);
    // The mode of a plan is checked too.
    let plan = "seed = 3\n[uniform]\nepisodes = 50\n[active]\nepisodes = 150\nseek = \"flew\"\n";
    fs::write(at.join("seeks.toml"), plan).unwrap();
    verb("run --task pendulum --plan seeks.toml --out x", 2, &["no such failure mode", "fell"]);
}

/// An engine that cannot start says nothing about the record.
fn without_engine(at: &Path) {
    for (arguments, code) in [
        (&["replay", "a", "7"][..], 5),
        (&["view", "a", "--export", "without.html"][..], 0),
        (&["view", "a", "--export", "none.html", "--clips", "4"][..], 5),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_robogate"));
        let output =
            command.args(arguments).current_dir(at).env("ROBOGATE_MUJOCO_LIB", "/nonexistent").output().unwrap();
        let text = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(text.contains("no such library"), "{text}");
        assert!(!text.contains("DIFFERS") && !text.contains("replay differs"), "{text}");
        assert_eq!(output.status.code(), Some(code), "{text}");
        assert_eq!(text.matches("not in the page").count(), usize::from(code == 0), "{text}");
    }
    // Only a page whose episodes were requested needs them.
    assert!(at.join("without.html").is_file() && !at.join("none.html").exists());
}

/// An option that changes nothing is refused.
#[test]
fn options_without_effect_are_refused() {
    let dir = TempDir::new().unwrap();
    let options = ["--robot ur5e", "--engine rapier", "--time-step 0.001"];
    for option in options {
        let says = format!("{} cannot be used with pendulum", option.split(' ').next().unwrap());
        verb(dir.path(), &format!("run --task pendulum {option} -n 10 --out x"), 2, &[&says]);
    }
    verb(dir.path(), "run --task pendulum --python python3 -n 10 --out x", 2, &["--python applies to --env"]);
    for option in ["--policy-key", "--policy-ca"] {
        let says = format!("{option} applies to policy servers");
        verb(dir.path(), &format!("run --task pendulum {option} none.txt -n 10 --out x"), 2, &[&says]);
        verb(dir.path(), &format!("gate --task pendulum {option} none.txt --out x"), 2, &[&says]);
    }
    assert!(!dir.path().join("x").exists());
}

#[test]
fn interrupted_pendulum_resumes_identically() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, "run --task pendulum -n 120 --seed 9 --out whole", 0, &[]);
    let cut = "run --task pendulum -n 120 --seed 9 --out cut";
    kill_after(at, cut, ["cut", "dictionary.parquet"], |line| line.starts_with("uniform"));
    verb(at, "resume cut", 0, &[]);
    let rows = |name: &str| fs::read(at.join(name).join("dictionary.parquet")).unwrap();
    assert!(rows("whole") == rows("cut"));
}

struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// The command judges the task of `examples/task_server.py`, which no crate contains, without a settings file.
#[test]
fn declared_tasks_need_only_an_address() {
    let Some(python) = robogate_testing::path("ROBOGATE_BRIDGE_PYTHON", "a Python with pyzmq and msgpack") else {
        return;
    };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let script = fs::read_to_string(root.join("examples/task_server.py")).unwrap();
    // Adds a failure mode that the task does not declare, and takes any free port.
    let script = script
        .replace("tcp://127.0.0.1:5570\")", "tcp://127.0.0.1:*\")")
        .replace("failure = \"overspeed\" if", "failure = \"jammed\" if self.mass > 1.5 else \"overspeed\" if");
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("server.py"), script).unwrap();
    let mut child = Command::new(python)
        .arg(at.join("server.py"))
        .env("PYTHONPATH", root.join("bridges/common"))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let _server = Server(child);
    let address =
        line.split(['"', ' ', '\n']).find(|part| part.starts_with("tcp://")).unwrap_or_else(|| panic!("{line}"));

    verb(at, &format!("check bridge {address}"), 0, &["pass"]);
    let run = format!("run --simulator {address} --policy random -n 40 --seed 4 --out run");
    verb(at, &run, 0, &["swing_up", "jammed"]);
    verb(at, "analyze run", 0, &["jammed"]);
    verb(at, "export run rows.csv", 0, &[]);
    let csv = fs::read_to_string(at.join("rows.csv")).unwrap();
    let jammed = csv.lines().filter(|row| row.contains(",jammed,")).count();
    assert!(jammed > 0, "{csv}");
    verb(at, &format!("replay run 3 --simulator {address}"), 0, &["identical to the recorded episode"]);
    verb(at, &format!("gate --simulator {address} --policy random --out gate"), 1, &["FAIL", "overspeed"]);
    verb(at, &format!("run --simulator {address} -n 10"), 2, &["no scripted controller", "--policy"]);
}
