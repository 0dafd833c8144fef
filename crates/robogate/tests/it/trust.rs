//! Files of runs name programs. They must never start one: only the user of a call does, or the fact that this user made the run
//! on this machine.

use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use robogate_dictionary::{Dictionary, Entry, Provenance, write_parquet};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use crate::harness::{text, verb};

const RUN: &str = "run --task pendulum -n 40 --design uniform --seed 3 --out";

/// A folder with runs, and interpreters of Python that leave a mark.
struct Bench {
    dir: TempDir,
    /// A server that nobody may contact.
    server: TcpListener,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { dir: TempDir::new().unwrap(), server: TcpListener::bind("127.0.0.1:0").unwrap() };
        bench.server.set_nonblocking(true).unwrap();
        fs::create_dir(bench.at("bin")).unwrap();
        let program = format!("#!/bin/sh\ntouch '{}'\nexit 1\n", bench.at("mark").display());
        for name in ["bin/python3", "bin/python", "mine.py"] {
            fs::write(bench.at(name), &program).unwrap();
            fs::set_permissions(bench.at(name), fs::Permissions::from_mode(0o755)).unwrap();
        }
        bench
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn command(&self, line: &str) -> Output {
        let path = std::env::var("PATH").unwrap_or_default();
        Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(line.split(' '))
            .current_dir(&self.dir)
            .env("ROBOGATE_STATE_DIR", self.at("state"))
            .env("PATH", format!("{}:{path}", self.at("bin").display()))
            .env("PYTHONPATH", self.dir.path())
            .output()
            .unwrap()
    }

    /// Runs a line of arguments, and checks its exit code and parts of the output.
    #[track_caller]
    fn expect(&self, line: &str, code: i32, parts: &[&str]) -> String {
        let output = self.command(line);
        let printed = text(&output);
        assert_eq!(output.status.code(), Some(code), "{line}: {printed}");
        for part in parts {
            assert!(printed.contains(part), "{line} does not say {part:?}: {printed}");
        }
        printed
    }

    /// Checks that nothing was started and nothing was contacted.
    #[track_caller]
    fn assert_untouched(&self, line: &str, world: &Value) {
        assert!(!self.at("mark").exists(), "{line} started a program of {world}");
        assert!(self.server.accept().is_err(), "{line} contacted the server of {world}");
    }

    fn server(&self) -> String {
        format!("ws://{}", self.server.local_addr().unwrap())
    }
}

/// Copies a run, whose files name another world from then on.
fn forge(from: &Path, to: &Path, world: &Value) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let (source, target) = (entry.path(), to.join(entry.file_name()));
        match entry.file_name().to_str().unwrap() {
            "plan.json" => {
                let mut plan: Value = serde_json::from_slice(&fs::read(&source).unwrap()).unwrap();
                plan["provenance"]["world"] = world.clone();
                let text = plan.to_string();
                // Shards are bound to the bytes of their plan.
                let layout = from.join("shards/layout.json");
                if let Ok(old) = fs::read_to_string(&layout) {
                    let hash =
                        |bytes: &[u8]| Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect::<String>();
                    let bound = old.replace(&hash(&fs::read(&source).unwrap()), &hash(text.as_bytes()));
                    assert_ne!(old, bound);
                    fs::create_dir_all(to.join("shards")).unwrap();
                    fs::write(to.join("shards/layout.json"), bound).unwrap();
                }
                fs::write(target, text).unwrap();
            }
            "dictionary.parquet" => {
                let dictionary = Dictionary::open(&source).unwrap();
                let forged = Provenance {
                    world: serde_json::from_value(world.clone()).unwrap(),
                    ..dictionary.provenance().clone()
                };
                let rows: Vec<Entry> = dictionary.entries().map(Result::unwrap).collect();
                write_parquet(&target, &forged, rows.into_iter().map(Ok)).unwrap();
            }
            "report.html" | "layout.json" => {}
            _ if source.is_dir() => forge(&source, &target, world),
            _ => fs::copy(source, target).map(drop).unwrap(),
        }
    }
}

/// A policy as a run records it.
fn policy(server: &str, profile: &str) -> Value {
    let text =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../robogate-policy/src/profiles").join(profile));
    let profile: Value = toml::from_str(&text.unwrap()).unwrap();
    json!({ "kind": "external", "server": server, "profile": profile, "declared": {} })
}

/// The worlds of strangers: environments by all kinds of names, policies, robots.
fn worlds(bench: &Bench) -> Vec<Value> {
    symlink(bench.at("mine.py"), bench.at("link.py")).unwrap();
    fs::create_dir(bench.at("package")).unwrap();
    fs::copy(bench.at("mine.py"), bench.at("package/__init__.py")).unwrap();
    fs::create_dir(bench.at("robot")).unwrap();
    let absolute = format!("{}:make", bench.at("mine.py").display());
    let names = [
        &*absolute,
        "mine.py:make",
        "./mine.py:make",
        "/proc/self/cwd/mine.py:make",
        "link.py:make",
        "package:make",
        "gymnasium:package:Some-v0",
        "metaworld:push-v3",
    ];
    let environments = names.into_iter().map(|name| json!({ "kind": "python", "environment": name }));
    let digest = "0".repeat(64);
    let with_digest = json!({ "kind": "python", "environment": "mine.py:make", "sha256": digest });
    let robot = json!({ "kind": "cell", "robot": bench.at("robot"), "engine": "mujoco", "time_step_s": 0.002 });
    let places = environments.chain([with_digest, robot]);
    let in_places = places.map(|place| json!({ "version": 1, "place": place }));
    let served = policy(&bench.server(), "openvla.toml");
    let with_server = json!({ "version": 1, "place": { "kind": "self_contained" }, "policy": served });
    in_places.chain([with_server]).collect()
}

/// Each verb, with a run of a stranger: pages, figures and verdicts come from the rows, and nothing starts.
#[test]
fn recorded_programs_never_start() {
    let bench = Bench::new();
    verb(bench.dir.path(), &format!("{RUN} honest"), 0, &[]);
    verb(bench.dir.path(), &format!("{RUN} parts --divide 2"), 0, &[]);
    for (at, world) in worlds(&bench).iter().enumerate() {
        let (run, parts, out) = (format!("r{at}"), format!("p{at}"), format!("o{at}"));
        forge(&bench.at("honest"), &bench.at(&run), world);
        forge(&bench.at("parts"), &bench.at(&parts), world);
        let refused = "the run was not made by you on this machine";
        let lines = [
            (format!("report {run} --out {out}.html"), 0, refused),
            (format!("report {run} --format md --out {out}.md"), 0, refused),
            (format!("report {run} --format json --out {out}.json"), 0, ""),
            (format!("view {run} --export {out}-view.html"), 0, refused),
            (format!("replay {run} 3"), 2, refused),
            (format!("resume {run}"), 2, refused),
            (format!("replay {run} 3 --at 0"), 2, refused),
            (format!("analyze {run}"), 0, ""),
            (format!("audit {run}/dictionary.parquet"), 0, ""),
            (format!("export {run} {out}.csv"), 0, ""),
            (format!("export {run} {out}.parquet"), 0, ""),
            (format!("compare {run} honest --html {out}-compare.html"), 0, ""),
            (format!("leaderboard {run} honest"), 0, ""),
            (format!("gate --run {run}"), 1, ""),
            (format!("evidence {run} {out}-evidence --requirements default"), 1, ""),
            (format!("verify {out}-evidence"), 0, "verification passed"),
            (format!("verify {out}-evidence --rerun 2"), 2, refused),
            (format!("monitor reference {run} --out {out}-reference.json"), 0, ""),
            (format!("plan {parts} --next"), 0, "--shard"),
            (format!("run --shard 0/2 --out {parts}"), 2, refused),
            (format!("plan {parts}"), 0, ""),
        ];
        for (line, code, part) in lines {
            let output = bench.command(&line);
            let printed = text(&output);
            bench.assert_untouched(&line, world);
            // Some verbs do not apply to this run, whoever made it.
            if !part.is_empty() {
                assert_eq!(output.status.code(), Some(code), "{line} of {world}: {printed}");
                assert!(printed.contains(part), "{line} of {world} does not say {part:?}: {printed}");
            }
        }
        let page = fs::read_to_string(bench.at(&format!("{out}.html"))).unwrap();
        assert!(page.contains(refused), "the page does not say why it has no episodes");
        // The commands for other machines do not spread a trust that nobody gave.
        let commands = bench.expect(&format!("plan {parts} --next"), 0, &[]);
        assert!(!commands.contains("--trust"), "{commands}");
        let trusted = bench.expect(&format!("plan {parts} --next --trust"), 0, &[]);
        assert!(trusted.contains("--trust"), "{trusted}");
    }
}

/// A suite is data, too.
#[test]
fn suites_start_no_code() {
    let bench = Bench::new();
    let suite = r#"
        schema = 1
        name = "theirs"
        version = "1.0.0"
        description = "One scenario."
        environment = "mine.py:make"
        defaults = { mass_kg = 0.3 }
        [[group]]
        name = "plain"
        category = "nominal"
        scenarios = [{ id = "plain-1" }]
    "#;
    fs::write(bench.at("theirs.toml"), suite).unwrap();
    for verb in ["run", "gate", "fleet"] {
        let line = format!("{verb} --suite theirs.toml");
        bench.expect(&line, 2, &["whose code a file cannot start", "--env mine.py:make"]);
        bench.assert_untouched(&line, &Value::Null);
    }
}

fn network(bench: &Bench) {
    let networks = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robogate-policy/tests/networks");
    for file in ["small.onnx", "small.toml"] {
        fs::copy(networks.join(file), bench.at(file)).unwrap();
    }
    fs::write(bench.at("plan.toml"), "seed = 5\n[uniform]\nepisodes = 1\n").unwrap();
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// A run of this user replays without a question. A copy of it does not, nor does an edited one.
#[test]
fn own_runs_are_known() {
    let bench = Bench::new();
    network(&bench);
    let run = "run --space learned --plan plan.toml --policy small.onnx --profile small.toml --out own";
    bench.expect(run, 0, &[]);
    bench.expect("replay own 0", 0, &["identical to the recorded episode"]);
    copy(&bench.at("own"), &bench.at("copied"));
    let refused = ["not made by you on this machine", "--policy", "--trust"];
    bench.expect("replay copied 0", 2, &refused);
    bench.expect("replay copied 0 --trust", 0, &["identical"]);
    bench.expect("replay copied 0 --policy small.onnx", 0, &["identical"]);
    bench.expect("replay copied 0 --env mine.py:make", 2, &["the run names none"]);
    let plan = fs::read_to_string(bench.at("own/plan.json")).unwrap();
    let edited = plan.replace("small.onnx", "other.onnx");
    assert_ne!(plan, edited);
    fs::write(bench.at("own/plan.json"), edited).unwrap();
    bench.expect("replay own 0", 2, &refused);
    // Evidence of an own run is an own folder.
    fs::write(bench.at("own/plan.json"), plan).unwrap();
    bench.expect("evidence own proof --requirements default", 3, &["inconclusive"]);
    bench.expect("verify proof --rerun 1", 0, &["ran again"]);
    copy(&bench.at("proof"), &bench.at("their-proof"));
    bench.expect("verify their-proof --rerun 1", 2, &refused);
}

/// The bytes are compared before the library reads the network.
#[test]
fn changed_programs_are_refused() {
    let bench = Bench::new();
    network(&bench);
    bench.expect("run --space learned --plan plan.toml --policy small.onnx --profile small.toml --out own", 0, &[]);
    fs::write(bench.at("small.onnx"), "not a network").unwrap();
    let parts = ["is not the one of the run", "SHA-256"];
    bench.expect("resume own", 2, &parts);
    // The run has a copy, which must be the recorded network too.
    bench.expect("replay own 0", 0, &["its copy is used", "identical to the recorded episode"]);
    fs::write(bench.at("own/policy/small.onnx"), "not a network").unwrap();
    bench.expect("replay own 0 --trust", 2, &parts);
    // The same for the file of an environment: nothing is imported.
    let name = bench.at("mine.py").display().to_string() + ":make";
    let place = json!({ "kind": "python", "environment": name, "sha256": "0".repeat(64) });
    let world = json!({ "version": 1, "place": place });
    verb(bench.dir.path(), &format!("{RUN} honest"), 0, &[]);
    forge(&bench.at("honest"), &bench.at("theirs"), &world);
    for option in ["--trust", "--env mine.py:make"] {
        let line = format!("replay theirs 0 {option}");
        bench.expect(&line, 2, &parts);
        bench.assert_untouched(&line, &world);
    }
    bench.expect("replay theirs 0 --env other.py:make", 2, &[]);
}

/// Python imports from its current folder first. That may be the folder of somebody else.
#[test]
fn current_folder_holds_no_modules() {
    let Some(python) =
        robogate_testing::path("ROBOGATE_METAWORLD_PYTHON", "a Python with Meta-World, pyzmq and msgpack")
    else {
        return;
    };
    const MODULES: [&str; 6] = ["numpy.py", "runpy.py", "gymnasium.py", "zmq.py", "metaworld.py", "robogate_eval.py"];
    let bench = Bench::new();
    let module = format!("open({:?}, 'w').close()\n", bench.at("mark").display().to_string());
    for name in MODULES {
        fs::write(bench.at(name), &module).unwrap();
    }
    let inspect = |name: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_robogate"));
        command.args(["env", "inspect", name, "--python"]).arg(&python).current_dir(&bench.dir);
        command.env("ROBOGATE_CACHE_DIR", bench.at("cache")).env_remove("PYTHONPATH").output().unwrap()
    };
    let output = inspect("metaworld:drawer-open-v3");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    bench.assert_untouched("env inspect", &Value::Null);
    // A module that the user names may be there.
    for name in MODULES {
        fs::remove_file(bench.at(name)).unwrap();
    }
    fs::write(bench.at("own_world.py"), "raise ImportError('own_world was imported')\n").unwrap();
    let printed = text(&inspect("own_world:make"));
    assert!(printed.contains("own_world was imported"), "{printed}");
}
