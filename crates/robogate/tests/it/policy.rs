//! External policies on the command line: `policy check`, `run --policy`, `resume`.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::ops::ControlFlow;
use std::path::Path;
use std::thread;

use tempfile::TempDir;
use tungstenite::{Message, accept};

use crate::harness::{assert_exit, robogate};
use crate::openpi::{actions, serve};

/// Write a built-in profile with changes to a file.
fn profile(dir: &TempDir, name: &str, changes: &[(&str, &str)]) -> String {
    let mut toml = String::from_utf8(robogate(&["list", "profiles", name]).stdout).unwrap();
    for (from, to) in changes {
        assert!(toml.contains(from), "{toml}");
        toml = toml.replace(from, to);
    }
    let file = dir.path().join(format!("{name}.toml"));
    fs::write(&file, toml).unwrap();
    file.to_str().unwrap().to_owned()
}

/// Ten actions per reply, all of them executed; one connection attempt.
const TEN: [(&str, &str); 2] =
    [("length = 50\nexecute = 5", "length = 10\nexecute = 10"), ("[action]", "[server]\nattempts = 1\n\n[action]")];

/// The arguments of a campaign in two stages with the policy at `url`, written to `run`. `more` has further options.
fn two_stages<'a>(url: &'a str, profile: &'a str, run: &'a str, more: &'a str) -> Vec<&'a str> {
    let fixed = ["run", "--policy", url, "--profile", profile, "--design", "two-stage", "--out", run];
    fixed.into_iter().chain(more.split(' ')).collect()
}

fn listener() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    (listener, url)
}

/// Answer this number of requests with actions straight down and an open gripper, then stop.
fn go_down(listener: TcpListener, mut requests: usize) {
    let answer = actions(10, 7, |_, j| [0.0, 0.0, -0.5, 0.0, 0.0, 0.0, -1.0][j]);
    serve(listener, move |_, socket| {
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                if requests == 0 {
                    return ControlFlow::Break(());
                }
                requests -= 1;
                socket.send(Message::binary(answer.clone())).unwrap();
            }
        }
        ControlFlow::Continue(())
    });
}

/// The outcome of each episode of a run.
fn outcomes(run: &str) -> Vec<String> {
    let out = Path::new(run).join("rows.csv");
    assert_exit(&["export", run, out.to_str().unwrap()], 0, &[]);
    let table = fs::read_to_string(out).unwrap();
    let mut lines = table.lines();
    let column = lines.next().unwrap().split(',').position(|name| name == "outcome").unwrap();
    lines.map(|line| line.split(',').nth(column).unwrap().to_owned()).collect()
}

#[test]
fn policy_servers_are_checked_and_replayed() {
    let dir = TempDir::new().unwrap();
    let profile = profile(&dir, "pi0-libero", &TEN);
    let (listener, url) = listener();
    go_down(listener, usize::MAX);
    let check = ["policy", "check", &url, "--profile", &profile, "--requests", "2"];
    assert_exit(
        &check,
        0,
        &["10 actions of 7 numbers", "the same observation gives the same actions", "no problems found"],
    );
    let run = dir.path().join("run").to_str().unwrap().to_owned();
    let start = ["run", "--policy", &url, "--profile", &profile, "-n", "3", "--threads", "1", "--out", &run];
    assert_exit(&start, 0, &["pi0-libero policy"]);
    // The server commands the hand straight into the table.
    assert_eq!(outcomes(&run), ["collision"; 3]);
    assert_exit(&["replay", &run, "1"], 0, &["identical to the recorded episode"]);
}

/// One of two servers stops. Its episodes run again on the other one.
#[test]
fn lost_server_leaves_the_others() {
    let dir = TempDir::new().unwrap();
    let profile = profile(&dir, "pi0-libero", &TEN);
    let ((dies, first), (stays, second)) = (listener(), listener());
    // Up to twelve requests compare the servers before the first episode.
    go_down(dies, 18);
    go_down(stays, usize::MAX);
    let run = dir.path().join("run").to_str().unwrap().to_owned();
    let both = format!("{first},{second}");
    let start = ["run", "--policy", &both, "--profile", &profile, "-n", "12", "--in-flight", "4", "--out", &run];
    assert_exit(&start, 0, &["pi0-libero policy"]);
    assert_eq!(outcomes(&run), ["collision"; 12]);
    // Both must answer before the first episode.
    let (free, url) = listener();
    drop(free);
    let missing = format!("{second},{url}");
    assert_exit(&["policy", "check", &missing, "--profile", &profile, "--requests", "2"], 5, &["unreachable", &url]);
    let start = ["run", "--policy", &missing, "--profile", &profile, "-n", "3", "--out", &run];
    assert_exit(&start, 5, &["unreachable", &url]);
}

/// Answers request `n` with ten actions, whose number `j` of action `i` is `number(n, i, j)`.
fn answer_with(listener: TcpListener, number: impl Fn(u64, usize, usize) -> f64 + Send + 'static) {
    let mut requests = 0;
    serve(listener, move |_, socket| {
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                requests += 1;
                socket.send(Message::binary(actions(10, 7, |i, j| number(requests, i, j)))).unwrap();
            }
        }
        ControlFlow::Continue(())
    });
}

/// One of several servers with another checkpoint would give a verdict about a mixture of two policies.
#[test]
fn servers_of_one_policy_must_answer_alike() {
    let dir = TempDir::new().unwrap();
    let profile = profile(&dir, "pi0-libero", &TEN);
    let down = |i: usize, j: usize| [0.1, 0.0, -0.5, 0.0, 0.0, 0.0, -1.0][j] + 0.01 * ((i + j) as f64).sin();
    let server = |number: Box<dyn Fn(u64, usize, usize) -> f64 + Send>| {
        let (free, url) = listener();
        answer_with(free, number);
        url
    };
    let first = server(Box::new(move |_, i, j| down(i, j)));
    let same = server(Box::new(move |_, i, j| down(i, j) + 1e-9));
    let opposite = server(Box::new(move |_, i, j| if j == 2 { -down(i, j) } else { down(i, j) }));
    let go = |servers: [&str; 2], out: &str, code: i32, parts: &[&str]| {
        let (list, out) = (servers.join(","), dir.path().join(out));
        let run = ["run", "--policy", &list, "--profile", &profile, "-n", "4", "--in-flight", "2"];
        assert_exit(&[&run[..], &["--out", out.to_str().unwrap()]].concat(), code, parts);
        fs::read_to_string(out.join("plan.json")).ok()
    };
    let plan = go([&first, &same], "same", 0, &["2 servers answer alike in"]).unwrap();
    let plan: serde_json::Value = serde_json::from_str(&plan).unwrap();
    let compared = &plan["provenance"]["world"]["policy"]["compared"];
    assert!(compared["servers"] == 2 && compared["largest"].as_f64().unwrap() < 1e-5, "{compared}");
    let words = format!("{opposite} answers differently from {first}: number 3 of action");
    let different = [&*words, "in place of -0.5"];
    assert_eq!(go([&first, &opposite], "opposite", 2, &different), None);
    let check = format!("{first},{opposite}");
    let check = ["policy", "check", &check, "--profile", &profile, "--requests", "2"];
    assert_exit(&check, 1, &["2 servers differ in 1 request", "problem:", &words]);

    // Random answers are compared as distributions.
    let random = |seed: u64, offset: f64| {
        server(Box::new(move |n, i, j| {
            let mut stream = robogate_core::Seed::campaign(seed).episode(n).stream(&format!("{i} {j}"));
            down(i, j) + offset + stream.between(-0.2, 0.2)
        }))
    };
    let (one, two, other) = (random(1, 0.0), random(2, 0.0), random(3, 0.1));
    go([&one, &two], "random", 0, &["2 servers answer alike in", "random answers, compared as distributions"]);
    let words = format!("{other} answers differently from {one}: the answers have another distribution");
    go([&one, &other], "other", 2, &[&words]);
}

#[test]
fn statistics_of_a_checkpoint_are_compared() {
    let dir = TempDir::new().unwrap();
    let profile = profile(&dir, "pi0-libero", &TEN);
    let (listener, url) = listener();
    go_down(listener, usize::MAX);
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let eight = |value: f64| [value; 8];
    let state = serde_json::json!({"mean": eight(0.0), "q01": eight(-4.0), "q99": eight(4.0)});
    fs::write(path("wide.json"), serde_json::json!({"norm_stats": {"state": state}}).to_string()).unwrap();
    // Fingers are never 3 m apart.
    let mut low = eight(-4.0);
    low[6] = 3.0;
    let state = serde_json::json!({"min": low, "max": eight(4.0)});
    fs::write(path("narrow.json"), serde_json::json!({"bridge_orig": {"proprio": state}}).to_string()).unwrap();
    let check = ["policy", "check", &url, "--profile", &profile, "--requests", "2", "--statistics"];
    let with = |rest: &[&str], code: i32, parts: &[&str]| assert_exit(&[&check[..], rest].concat(), code, parts);
    with(&[&path("wide.json")], 0, &["8 of 8 numbers of the state are inside", "no problems found"]);
    let outside = "number 6 of the state `observation/state` is 0.0400, outside of the published range";
    with(&[&path("narrow.json")], 1, &["7 of 8 numbers", outside, "3.0000 to 4.0000"]);
    with(&[&path("narrow.json"), "--statistics-group", "fractal"], 2, &["no group `fractal`. Known: bridge_orig"]);
    // A profile with the ranges, which is compared in every later check.
    with(&[&path("narrow.json"), "--write", &path("mine.toml")], 0, &["a draft of a profile"]);
    assert_exit(&["policy", "check", &url, "--profile", &path("mine.toml"), "--requests", "2"], 1, &[outside]);
}

#[test]
fn mismatches_with_the_profile_are_named() {
    let dir = TempDir::new().unwrap();
    let (openpi, url) = listener();
    go_down(openpi, usize::MAX);
    // A tool delta has seven numbers.
    let six = profile(&dir, "pi0-libero", &[("size = 7", "size = 6")]);
    assert_exit(&["policy", "check", &url, "--profile", &six], 2, &["action.size: 6, but arm = \"osc_pose\" has 7"]);
    // Eight numbers are seven joints and a gripper, but the server sends seven.
    let [ten, once] = TEN;
    let joints = ("size = 7\narm = \"osc_pose\"", "size = 8\narm = \"joint_positions\"");
    let eight = profile(&dir, "pi0-libero", &[ten, once, joints]);
    let words = "an action has 7 numbers, but action.size of the profile is 8";
    assert_exit(&["policy", "check", &url, "--profile", &eight], 1, &["problem:", words]);
    let run = dir.path().join("run").to_str().unwrap().to_owned();
    let start = ["run", "--policy", &url, "--profile", &eight, "-n", "3", "--threads", "1", "--out", &run];
    assert_exit(&start, 4, &[]);
    assert_eq!(outcomes(&run), ["invalid"; 3]);

    let (http, url) = listener();
    thread::spawn(move || {
        for stream in http.incoming() {
            let mut stream = stream.unwrap();
            if matches!(stream.read(&mut [0; 2048]), Ok(1..)) {
                drop(
                    stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 22\r\n\r\n{\"detail\":\"Not Found\"}"),
                );
            }
        }
    });
    let profile_of = |changes: &[(&str, &str)]| profile(&dir, "droid-roboarena", changes);
    let ten = profile(&dir, "pi0-libero", &TEN);
    let words = ["wrong dialect: the profile expects openpi, but", "such as OpenVLA's"];
    assert_exit(&["policy", "check", &url, "--profile", &ten], 2, &words);
    assert_exit(&["run", "--policy", &url, "--profile", &ten, "-n", "3"], 2, &words);

    let (roboarena, url) = listener();
    thread::spawn(move || {
        for stream in roboarena.incoming() {
            let Ok(mut socket) = accept(stream.unwrap()) else { continue };
            let config = include_bytes!("../../../robogate-policy/tests/captures/roboarena/s2c_00_config_metadata.bin");
            drop(socket.send(Message::binary(config.to_vec())));
        }
    });
    let large = profile_of(&[("width = 224", "width = 256"), ("height = 224", "height = 256")]);
    let words = ["profile mismatch: the server requires images of 224 x 224, but", "is 256 x 256"];
    assert_exit(&["policy", "check", &url, "--profile", &large], 2, &words);
}

#[test]
fn a_run_is_resumed_after_a_server_stopped() {
    let dir = TempDir::new().unwrap();
    let profile = profile(&dir, "pi0-libero", &TEN);
    let (listener, url) = listener();
    let address = listener.local_addr().unwrap();
    // The first episode takes seven requests.
    go_down(listener, 10);
    let run = dir.path().join("run").to_str().unwrap().to_owned();
    let start = two_stages(&url, &profile, &run, "-n 18 --threads 1");
    assert_exit(&start, 5, &["10 episodes in a row were lost", "robogate resume"]);
    assert_exit(&["resume", &run], 5, &["unreachable", &url]);
    go_down(TcpListener::bind(address).unwrap(), usize::MAX);
    assert_exit(&["resume", &run, "--threads", "1"], 0, &[]);
    // The ten lost episodes ran again, and the record says so.
    let outcomes = outcomes(&run);
    assert_eq!(outcomes.len(), 18);
    assert!(!outcomes.iter().any(|outcome| outcome == "invalid"), "{outcomes:?}");
    let summary = fs::read_to_string(Path::new(&run).join("summary.json")).unwrap();
    assert!(summary.contains("\"lost_attempts\": 10") && summary.contains("\"episodes\": 10"), "{summary}");
    let lost = fs::read_to_string(Path::new(&run).join("lost_episodes.jsonl")).unwrap();
    assert!(lost.lines().count() == 10 && lost.contains("unavailable"), "{lost}");
}

#[test]
fn shard_without_server_is_not_committed() {
    let dir = TempDir::new().unwrap();
    let profile = profile(&dir, "pi0-libero", &TEN);
    let (listener, url) = listener();
    let address = listener.local_addr().unwrap();
    go_down(listener, 0);
    let run = dir.path().join("run").to_str().unwrap().to_owned();
    let shard = dir.path().join("run/shards/uniform-1-of-4.rgs");
    let plan = two_stages(&url, &profile, &run, "-n 18 --shard 1/4 --threads 1");
    // A shard of three episodes is lost if the server is unavailable in all of them. One thread connects once, before the
    // server stops; a second one might find it stopped already.
    assert_exit(&plan, 5, &["3 episodes in a row were lost", "not committed"]);
    assert!(!shard.exists());
    let again = ["run", "--shard", "1/4", "--out", &run];
    assert_exit(&again, 5, &["unreachable", &url]);
    go_down(TcpListener::bind(address).unwrap(), usize::MAX);
    assert_exit(&again, 0, &["shard 1/4 of round uniform: 3 episodes"]);
    assert!(shard.exists());
}

#[test]
fn server_lost_at_the_end_of_a_shard() {
    let dir = TempDir::new().unwrap();
    let profile = profile(&dir, "pi0-libero", &TEN);
    let (listener, url) = listener();
    let address = listener.local_addr().unwrap();
    // The server answers some episodes of the shard, and fewer than ten are left when it stops.
    go_down(listener, 5);
    let run = dir.path().join("run").to_str().unwrap().to_owned();
    let shard = dir.path().join("run/shards/uniform-0-of-1.rgs");
    let start = two_stages(&url, &profile, &run, "-n 12 --shard 0/1 --threads 1");
    assert_exit(&start, 5, &["unreachable", &url]);
    assert!(!shard.exists(), "a shard with lost episodes was committed");
    go_down(TcpListener::bind(address).unwrap(), usize::MAX);
    assert_exit(&["run", "--shard", "0/1", "--threads", "1", "--out", &run], 0, &["8/8"]);
    assert!(shard.exists());
}
