//! End-to-end tests of a campaign in shards: several processes run it, and the merged files are those of one process.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::Instant;

use serde_json::Value;
use tempfile::TempDir;

#[cfg(target_os = "linux")]
use crate::harness::handles_interrupts;
use crate::harness::{TWO_SCENARIOS, real_trials, run_all_shards, runs_until, verb};

/// The files of a folder, without its subfolders.
fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap())
        .filter(|entry| entry.file_type().unwrap().is_file())
        .map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap()))
        .collect()
}

const PENDULUM: &str = "run --task pendulum --design two-stage -n 90 --seed 3 --out run";

#[test]
fn merged_shards_equal_single_run() {
    let (one, many) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    verb(one.path(), PENDULUM, 0, &[]);
    let at = many.path();
    let verb = |arguments: &str, code: i32, parts: &[&str]| verb(at, arguments, code, parts);
    verb("plan run --next", 2, &["no campaign in shards", "--shard 0/N"]);
    verb(&format!("{PENDULUM} --divide 0"), 2, &["0 shards are out of range"]);
    verb(&format!("{PENDULUM} --divide 3"), 0, &["90 episodes in 3 shards", "next: robogate plan run --next"]);
    verb(&format!("{PENDULUM} --divide 3"), 0, &[]);
    verb(&format!("{PENDULUM} --divide 4"), 2, &["divided into 3 shards"]);
    verb(&format!("{PENDULUM} --divide 3 --shard 0/3"), 2, &["cannot be used with"]);
    verb(&format!("{PENDULUM} --policy-at ws://127.0.0.1:1 --shard 2/3"), 2, &["neither a server nor a file"]);
    verb(&format!("{PENDULUM} --shard 2/3"), 0, &["shard 2/3 of round uniform: 20 episodes"]);
    verb("run --shard 2/3 --out run", 0, &["nothing to do", "committed already"]);
    // Options of this process, which are not part of the plan.
    verb("-q run --shard 2/3 --out run", 0, &[]);
    verb("run --shard 2/3 --out run -q --policy-key key.txt --policy-ca ca.pem", 0, &[]);
    verb(&format!("{PENDULUM} --shard 2/3"), 0, &["nothing to do"]);

    // Everything that differs from the first shard is named.
    verb(
        "run --task pendulum --design two-stage -n 91 --seed 3 --out run --shard 0/3",
        2,
        &["plan.uniform.episodes", "60", "61"],
    );
    verb("run --task pendulum --design two-stage -n 90 --seed 4 --out run --shard 0/3", 2, &["plan.seed"]);
    verb("run --preset quick --out run --shard 0/3", 2, &["another"]);
    verb(
        "run --task pendulum --design two-stage --policy random -n 90 --seed 3 --out run --shard 0/3",
        2,
        &["policy", "random"],
    );
    verb("run --out run --shard 0/4", 2, &["divided into 3 shards"]);
    verb("run --out run --shard 3/3", 2, &["0 to 2"]);
    verb("run --out run --shard third", 2, &["Expected K/N"]);
    verb("run --shard 0/3", 2, &["--out"]);
    verb("resume run", 2, &["in shards", "robogate plan run --next"]);

    let status = verb("plan run", 0, &["20 of 90 episodes", "uniform", "1 of 3 shards", "missing: 0-1"]);
    assert!(status.contains("1 more round after that"), "{status}");
    let status: Value = serde_json::from_str(&verb("plan run --json", 0, &[])).unwrap();
    assert_eq!((status["done"].as_u64(), status["complete"].as_bool()), (Some(20), Some(false)));
    let next: Value = serde_json::from_str(&verb("plan run --next --json", 0, &[])).unwrap();
    assert_eq!((next["round"].as_str(), next["items"].as_array().unwrap().len()), (Some("uniform"), 2));
    let command = serde_json::json!(["robogate", "run", "--shard", "1/3", "--out", "run"]);
    assert_eq!((&next["items"][1]["command"], next["items"][1]["episodes"].as_u64()), (&command, Some(20)));
    verb("merge run", 5, &["2 of 3 shards of round uniform are missing: 0, 1"]);

    assert_eq!(run_all_shards(at, "run"), 5);
    verb("plan run --next", 0, &["next: robogate merge run"]);
    verb("run --shard 0/3 --out run", 0, &["all rounds are complete"]);
    verb("plan run", 0, &["90 of 90 episodes", "boundary"]);
    verb("merge run --out elsewhere", 0, &["success"]);
    verb("merge run", 0, &["success", "dataset"]);
    let expected = files(&one.path().join("run"));
    assert!(expected.contains_key("report.html"));
    assert!(files(&at.join("run")) == expected, "the merged run differs");
    let mut elsewhere = files(&at.join("elsewhere"));
    // The report names its folder.
    elsewhere.insert("report.html".to_owned(), expected["report.html"].clone());
    assert!(elsewhere == expected, "the run that was merged into another folder differs");
    verb("merge run", 0, &["merged already"]);
    let dictionary = at.join("elsewhere/dictionary.parquet");
    let whole = fs::read(&dictionary).unwrap();
    fs::write(&dictionary, &whole[..whole.len() - 100]).unwrap();
    verb("merge run --out elsewhere", 5, &["elsewhere/dictionary.parquet", "merge them again"]);
    verb("replay run 70", 0, &["identical to the recorded episode"]);

    // One changed byte of a shard.
    let shard = at.join("run/shards/uniform-1-of-3.rgs");
    let mut bytes = fs::read(&shard).unwrap();
    bytes[1000] ^= 1;
    fs::write(&shard, bytes).unwrap();
    verb("merge run --out again", 5, &["uniform-1-of-3.rgs is damaged", "run this shard again"]);
    verb("plan run", 5, &["uniform-1-of-3.rgs is damaged"]);
}

#[test]
fn one_process_runs_several_shards() {
    let dirs = [TempDir::new().unwrap(), TempDir::new().unwrap()];
    let [one, many] = dirs.each_ref().map(TempDir::path);
    verb(one, PENDULUM, 0, &[]);
    // The shards whose documents a command prints, and their states.
    let run = |shards: &str| -> Vec<String> {
        let text = verb(many, &format!("run --shard {shards} --out run --json"), 0, &[]);
        let documents = text.lines().filter(|line| line.starts_with('{')).map(|line| line.parse::<Value>().unwrap());
        documents.map(|one| format!("{} {} {}", one["shard"], one["round"], one["state"]).replace('"', "")).collect()
    };
    verb(many, &format!("{PENDULUM} --divide 4"), 0, &[]);
    assert_eq!(run("1/4"), ["1/4 uniform committed"]);
    let states = ["0/4 uniform committed", "1/4 uniform already_committed", "3/4 uniform committed"];
    assert_eq!(run("3,0-1/4"), states);
    verb(many, "run --shard 0-4/4 --out run", 2, &["shard 4 of 4 does not exist"]);
    verb(many, "run --shard 2-1/4 --out run", 2, &["Expected K/N", "0-3,7/16"]);
    // The round ends in the middle. Shards of the next one are not run.
    let states = ["0/4 uniform already_committed", "2/4 uniform committed", "3/4 uniform already_committed"];
    assert_eq!(run("0,2-3/4"), states);
    assert_eq!(run("0-3/4"), [0, 1, 2, 3].map(|k| format!("{k}/4 boundary committed")));
    assert_eq!(run("0-1/4"), [0, 1].map(|k| format!("{k}/4 null complete")));
    verb(many, "merge run", 0, &[]);
    assert!(files(&many.join("run")) == files(&one.join("run")));
}

#[test]
fn suite_shards_equal_single_run() {
    let dirs = [TempDir::new().unwrap(), TempDir::new().unwrap()];
    let [one, many] = dirs.each_ref().map(|dir| {
        fs::write(dir.path().join("two.toml"), TWO_SCENARIOS).unwrap();
        dir.path()
    });
    let run = "run --suite two.toml --rounds 2 --out run";
    verb(one, run, 0, &[]);
    verb(many, &format!("{run} --shard 0/2"), 0, &["round suite-0: 1 episode, into"]);
    assert_eq!(run_all_shards(many, "run"), 3);
    verb(many, "merge run", 0, &[]);
    assert!(files(&many.join("run")) == files(&one.join("run")));
}

#[test]
fn gate_in_shards_equals_single_gate() {
    let dirs = [TempDir::new().unwrap(), TempDir::new().unwrap()];
    let [one, many] = dirs.each_ref().map(TempDir::path);
    // The test stops before the last round: 92 % are required, and random actions never succeed.
    let gate = "gate --task pendulum --policy random --rounds 9 --seed 3 --out run";
    let verdict = verb(one, gate, 1, &["FAIL"]);
    verb(many, "gate --task pendulum --divide 3", 2, &["--out"]);
    verb(many, &format!("{gate} --divide 3"), 0, &["576 episodes in 3 shards"]);
    verb(many, &format!("{gate} --divide 3 --margin 0.1"), 2, &["--margin applies to a comparison"]);
    let unmerged = ["plan run --next", "merge run"];
    verb(many, "gate --run run", 2, &unmerged);
    verb(many, "analyze run", 2, &unmerged);
    verb(many, "export run rows.csv", 2, &unmerged);
    verb(many, &format!("{gate} --divide 3 --requirements paper"), 2, &["baseline"]);
    let commands = run_all_shards(many, "run");
    assert!(commands < 27 && commands.is_multiple_of(3), "{commands} shards ran");
    verb(many, "plan run", 0, &["next: robogate merge run"]);
    assert_eq!(verb(many, "merge run", 1, &["FAIL"]), verdict);
    assert!(files(&many.join("run")) == files(&one.join("run")));
    // A gate whose question is missing or another one must not become a run without a verdict.
    let question = many.join("run/gate-question.json");
    let asked = fs::read_to_string(&question).unwrap();
    fs::write(&question, asked.replacen("0.92", "0.52", 1)).unwrap();
    verb(many, "merge run --out elsewhere", 2, &["not the question of the plan", "Hint: "]);
    fs::remove_file(&question).unwrap();
    verb(many, "plan run --next", 2, &["gate-question.json: missing", "Hint: "]);
    verb(many, &format!("{gate} --divide 3"), 0, &[]);
    verb(many, "merge run --out elsewhere", 1, &["FAIL"]);
    verb(many, &format!("{gate} --divide 3 --against scripted"), 2, &["cannot be used with", "--against"]);
}

/// Trials of the real robot decide a gate in shards as they decide that of one process, and stop it where they cannot.
#[test]
fn real_trials_decide_gates_on_any_executor() {
    let dirs = [TempDir::new().unwrap(), TempDir::new().unwrap()];
    let [one, many] = dirs.each_ref().map(TempDir::path);
    let requirement = |metric: &str, limit: f64| format!("[[requirement]]\nmetric = '{metric}'\nat_least = {limit}\n");
    let both = requirement("success", 0.05) + &requirement("real:success", 0.7);
    fs::write(one.join("real.toml"), format!("name = 'real'\nmode = 'confidence'\n{both}")).unwrap();
    let rows: String = (0..40).map(|i| format!("{},{}\n", i % 3 > 0, 0.2 + 0.1 * f64::from(i % 7) / 6.0)).collect();
    fs::write(one.join("trials.csv"), format!("success,mass_kg\n{rows}")).unwrap();
    verb(one, "run --task pendulum --design uniform -n 300 --seed 3 --out sim", 0, &[]);
    real_trials(one, "sim", "strong.json", 25);
    real_trials(one, "sim", "weak.json", 19);

    let at = one.display();
    let gate = format!("gate --task pendulum --requirements {at}/real.toml --rounds 9 --seed 3");
    verb(one, &format!("{gate} --out none"), 2, &["`real:success` needs trials", "robogate transfer", "--real"]);
    verb(one, &format!("{gate} --policy random --real {at}/strong.json --out none"), 2, &["`scripted`", "`random`"]);
    assert!(!one.join("none").exists(), "an episode ran");
    let strong = format!("{gate} --real {at}/strong.json --out run");
    let verdict = verb(one, &strong, 0, &["PASS"]);
    verb(many, &format!("{strong} --divide 3"), 0, &[]);
    run_all_shards(many, "run");
    assert_eq!(verb(many, "merge run", 0, &["PASS"]), verdict);
    assert!(files(&many.join("run")) == files(&one.join("run")));

    for (out, more) in [("weak", ""), ("fixed", " --fixed")] {
        let weak = format!("{gate}{more} --real {at}/weak.json --out {out}");
        verb(one, &weak, 3, &["do not show `real:success`: no result of the other 512", "Run more trials"]);
        let found: Value = serde_json::from_slice(&fs::read(one.join(out).join("gate.json")).unwrap()).unwrap();
        assert_eq!(found["ruled_out"], serde_json::json!({ "planned": 576, "requirement": "real:success" }));
    }
    // The safety case says what the trials show about the simulation.
    for (run, code, gap, cell) in [("run", 0, "answered", "supported"), ("weak", 3, "open", "undeveloped")] {
        verb(one, &format!("evidence {run} {run}-evidence --safety-case"), code, &[]);
        verb(one, &format!("verify {run}-evidence"), 0, &[]);
        let argument = fs::read_to_string(one.join(format!("{run}-evidence/safety-case.gsn.yaml"))).unwrap();
        let of =
            |name: &str| argument.split(&format!("\n{name}:\n")).nth(1).unwrap().lines().nth(1).unwrap().to_owned();
        assert_eq!(of("CG-simulation"), format!("  status: \"{gap}\""));
        assert_eq!(of("G-cell"), format!("  status: \"{cell}\""));
    }
    verb(one, "gate --run weak --real strong.json", 0, &["note: the run's gate used 50 real trials", "PASS"]);
    verb(one, "evidence weak evidence --real strong.json", 2, &["the real trials differ", "--reasked"]);
}

/// A sweep of two policies on the pendulum.
fn sweep_of(name: &str, episodes: u32) -> String {
    format!(
        r#"
        version = 1
        name = "{name}"
        seed = 3
        [[task]]
        name = "pendulum"
        episodes = {episodes}
        [[policy]]
        name = "scripted"
        [[policy]]
        name = "random actions"
        policy = "random"
        "#
    )
}

#[test]
fn sweep_ranks_policies_on_any_executor() {
    let dirs = [TempDir::new().unwrap(), TempDir::new().unwrap()];
    let sweep = sweep_of("swing-ups", 60);
    let [threads, shards] = dirs.each_ref().map(|dir| {
        fs::write(dir.path().join("sweep.toml"), &sweep).unwrap();
        dir.path()
    });
    verb(threads, "matrix sweep.toml --list", 0, &["--task pendulum --design uniform -n 60 --policy random --seed 3"]);
    // A process that was killed while it wrote the plan.
    fs::create_dir(threads.join("run")).unwrap();
    fs::write(threads.join("run/.sweep.json.part"), "half").unwrap();
    verb(threads, "matrix sweep.toml --out run", 0, &["scripted, pendulum", "page: run/leaderboard.html"]);
    assert!(!threads.join("run/.sweep.json.part").exists());
    verb(threads, "matrix sweep.toml --out run", 0, &["finished already"]);
    fs::write(threads.join("other.toml"), sweep.replace("60", "61")).unwrap();
    verb(threads, "matrix other.toml --out run", 2, &["another sweep"]);

    verb(shards, "matrix sweep.toml --divide 2 --out run", 0, &["robogate plan run --next"]);
    verb(shards, "merge run", 5, &["no run of swing-ups is finished"]);
    verb(shards, "plan run", 0, &["0 of 120 episodes", "uniform 0 of 2 shards"]);
    assert_eq!(run_all_shards(shards, "run"), 4);
    verb(shards, "merge run", 0, &["random actions"]);
    let [one, other] = [threads, shards].map(|dir| files(&dir.join("run")));
    for page in ["leaderboard.html", "leaderboard.md"] {
        assert!(one[page] == other[page], "{page} differs");
    }

    // A run that fails does not end the sweep.
    let broken = sweep.replace("policy = \"random\"", "policy = \"nowhere.onnx\"\nprofile = \"learned\"");
    fs::write(threads.join("broken.toml"), broken).unwrap();
    let parts = ["failed with exit code", "1 of 2 runs are missing: random actions, pendulum", "page:"];
    verb(threads, "matrix broken.toml --out broken", 5, &parts);
    assert!(threads.join("broken/leaderboard.html").exists());
}

/// A campaign that is killed does not end its sweep, and SIGTERM ends the sweep after the episodes in flight.
#[cfg(target_os = "linux")]
#[test]
fn sweep_survives_killed_run_and_ends_on_signal() {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("sweep.toml"), sweep_of("long", 30_000)).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args("matrix sweep.toml --threads 1 --out run".split(' '))
        .current_dir(dir.path())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let id = child.id().to_string();
    let kill = |signal: &str, id: &str| Command::new("kill").args([signal, id]).status().unwrap().success();
    // The folders with a journal, in which a campaign has recorded episodes.
    let begun = || -> Vec<PathBuf> {
        let folders = fs::read_dir(dir.path().join("run")).into_iter().flatten().map(|entry| entry.unwrap().path());
        folders.filter(|folder| fs::metadata(folder.join("journal.rgj")).is_ok_and(|file| file.len() > 1000)).collect()
    };
    assert!(runs_until(&mut child, || begun().len() == 1), "the sweep ended");
    let campaign = fs::read_to_string(format!("/proc/{id}/task/{id}/children")).unwrap();
    assert!(kill("-KILL", campaign.trim()));
    assert!(runs_until(&mut child, || begun().len() == 2), "the sweep ended with its first run");
    assert!(kill("-TERM", &id));
    let printed: Vec<String> = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap).collect();
    let printed = printed.join("\n");
    assert_eq!(child.wait().unwrap().code(), Some(130), "{printed}");
    for part in ["failed (signal: 9", "the sweep continues", "stopping after the episodes in flight", "next: the same"]
    {
        assert!(printed.contains(part), "expected {part:?} in {printed}");
    }
    // No campaign has been left in its folder.
    for folder in begun() {
        fs::File::open(folder).unwrap().try_lock().unwrap();
    }
}

/// The default design: workers choose the points of each round, and every scheduler runs it with the same loop.
#[test]
fn active_shards_equal_single_run() {
    let (one, many) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let run = "run --task pendulum -n 120 --seed 3 --out run";
    verb(one.path(), run, 0, &[]);
    let at = many.path();
    verb(at, &format!("{run} --divide 2"), 0, &["120 episodes in 2 shards"]);
    assert!(run_all_shards(at, "run") >= 6);
    verb(at, "plan run", 0, &["120 of 120 episodes", "active-0"]);
    verb(at, "merge run --verbose", 0, &["Risk model"]);
    assert!(files(&at.join("run")) == files(&one.path().join("run")));
    // A worker that is killed after it commits the last shard chooses nothing. The merge does it then.
    let last = fs::read_dir(at.join("run/shards")).unwrap().map(|entry| entry.unwrap().path());
    let is_choice = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().starts_with("active-");
    let last = last.filter(|path| is_choice(path) && path.extension().unwrap() == "json").max().unwrap();
    fs::remove_file(last).unwrap();
    verb(at, "merge run --out again", 0, &[]);
}

#[test]
fn killed_merge_can_be_repeated() {
    let (one, many) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let run = "run --task pendulum -n 120 --seed 5 --out run";
    verb(one.path(), run, 0, &[]);
    verb(many.path(), &format!("{run} --divide 2"), 0, &[]);
    run_all_shards(many.path(), "run");
    let begin = Instant::now();
    verb(many.path(), "merge run --out elsewhere", 0, &[]);
    let merge = begin.elapsed();
    // Killed at moments that are spread over its usual time. Wherever it is then, the next one starts over.
    for tenth in 0..10 {
        let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(["merge", "run"])
            .current_dir(many.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        thread::sleep(merge * tenth / 10);
        child.kill().unwrap();
        child.wait().unwrap();
    }
    verb(many.path(), "merge run", 0, &[]);
    assert!(files(&many.path().join("run")) == files(&one.path().join("run")));
}

#[cfg(target_os = "linux")]
#[test]
fn interrupted_shard_is_not_committed() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args("run --task pendulum -n 30000 --threads 1 --out run --shard 0/1".split(' '))
        .current_dir(at)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let id = child.id();
    assert!(runs_until(&mut child, || handles_interrupts(id)), "the shard ended");
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let printed: Vec<String> = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{printed:?}");
    assert!(printed.iter().any(|line| line.starts_with("shard 0/1")), "{printed:?}");
    assert!(printed.iter().any(|line| line.contains("not committed")), "{printed:?}");
    assert_eq!(files(&at.join("run/shards")).keys().collect::<Vec<_>>(), ["design-uniform.points", "layout.json"]);
}
