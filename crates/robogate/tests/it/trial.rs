//! Trials of the real robot as a user runs them: by commands, and by taps in a browser of the size of a phone.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use crate::browser::Browser;
use crate::harness::{assert_done, assert_exit_in, robogate_in, stderr, stdout};

fn run(folder: &Path, line: &str) -> String {
    let output = robogate_in(folder, &line.split(' ').collect::<Vec<_>>());
    assert_done(&output);
    stdout(&output)
}

/// Runs the next trial by commands.
fn trial(folder: &Path, success: impl Fn(&str) -> bool) {
    let next: Value = serde_json::from_str(&run(folder, "trial next study --json")).unwrap();
    let code = next["code"].as_str().unwrap();
    run(folder, &format!("trial record study start --code {code} --operator Ada"));
    let policy = run(folder, "trial next study --policy");
    run(folder, &format!("trial record study stop --code {code}"));
    let result = if success(policy.trim()) { "success" } else { "dropped" };
    run(folder, &format!("trial record study result --code {code} --result {result} --measured 4.5 --id r-{code}"));
}

#[test]
fn one_policy_passes_by_commands() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    fs::write(folder.join("parts.csv"), "mass_kg,shape\n0.2,box\n0.4,box\n0.6,can\n").unwrap();
    assert_done(&robogate_in(folder, &["keys", "new", "team.key"]));
    let plan = run(
        folder,
        "trial plan study --policy mine --at-least 0.7 --blocks 30 --setups parts.csv --modes dropped --measure peak_force_n --minutes 4,2,120 --key team.key",
    );
    for part in
        ["At most 30 trials in 30 blocks", "Expected number of trials", "true rates 0.7:", "sessions", "Plan SHA-256"]
    {
        assert!(plan.contains(part), "{part}: {plan}");
    }
    let path = folder.join("study/plan.json");
    let public = fs::read_to_string(&path).unwrap();
    assert!(!public.contains("seed") && public.contains("secret_sha256"));
    assert_exit_in(folder, &["trial", "report", "study"], 2, &["the study is blinded"]);
    assert_exit_in(folder, &["trial", "unblind", "study"], 2, &["--early unblinds it now"]);
    while !run(folder, "trial next study").contains("ended") {
        trial(folder, |_| true);
    }
    run(folder, "trial status study --key team.key.pub");

    // A log and a data set belong to a trial.
    let journal = fs::read_to_string(folder.join("study/journal.jsonl")).unwrap();
    let code = journal.split("\"code\":\"").nth(1).unwrap().split('"').next().unwrap();
    fs::create_dir_all(folder.join("set/meta")).unwrap();
    fs::write(folder.join("set/meta/info.json"), "{}").unwrap();
    fs::write(folder.join("run.log"), "grasped").unwrap();
    run(folder, &format!("trial attach study {code} run.log"));
    run(folder, &format!("trial attach study {code} set"));
    assert_exit_in(folder, &["trial", "attach", "study", code, "run.log"], 2, &["has an attachment run.log already"]);
    assert_exit_in(folder, &["trial", "attach", "study", "NONE", "run.log"], 2, &["there is no trial NONE"]);
    assert!(run(folder, "trial status study").contains("2 attachments intact"));
    run(folder, "trial unblind study");
    let answer: Value = serde_json::from_str(&run(folder, "trial report study --json")).unwrap();
    assert_eq!(answer["verdict"], "pass");
    let trials = answer["trials"].as_u64().unwrap();
    assert!((8..=20).contains(&trials), "{trials}");
    let csv = fs::read_to_string(folder.join("study/trials.csv")).unwrap();
    assert!(csv.lines().next().unwrap().ends_with(",mass_kg,shape"), "{csv}");
    run(folder, "import study/trials.csv trials.parquet --mapping study/trials.toml");
    assert!(run(folder, "analyze trials.parquet").contains("100"));

    assert!(fs::read_to_string(folder.join("study/report.html")).unwrap().contains("set/meta/info.json"));

    // A changed attachment.
    let copy = folder.join("study/attachments").join(code).join("run.log");
    fs::write(&copy, "dropped").unwrap();
    for verb in ["status", "report"] {
        assert_exit_in(folder, &["trial", verb, "study"], 4, &["run.log", "not the one that was attached", "Hint: "]);
    }
    fs::write(&copy, "grasped").unwrap();

    // A changed label, and a changed plan.
    let journal = folder.join("study/journal.jsonl");
    let lines = fs::read_to_string(&journal).unwrap();
    fs::write(&journal, lines.replacen("\"success\":true", "\"success\":false", 1)).unwrap();
    for verb in ["status", "report", "next", "unblind"] {
        assert_exit_in(folder, &["trial", verb, "study"], 4, &["journal.jsonl:", "was changed, removed or moved"]);
    }
    fs::write(&journal, &lines).unwrap();
    fs::write(&path, public.replace("0.7", "0.6")).unwrap();
    assert_exit_in(folder, &["trial", "status", "study"], 4, &["plan was changed"]);
    fs::write(&path, &public).unwrap();
    assert_done(&robogate_in(folder, &["keys", "new", "other.key"]));
    assert_exit_in(
        folder,
        &["trial", "status", "study", "--key", "other.key.pub"],
        4,
        &["not this plan, signed by key"],
    );
}

/// Options that an event does not use are refused, and nothing is recorded.
#[test]
fn options_of_other_events_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let plan = ["trial", "plan", "study", "--policy", "mine", "--at-least", "0.7", "--count", "3", "--blocks", "30"];
    let planned = |operators: &'static str| [&plan[..], &["--operators", operators]].concat();
    assert_exit_in(folder, &planned("Ada,Ada"), 2, &["`Ada` occurs twice among the operators"]);
    assert_exit_in(folder, &planned("Ada, "), 2, &["cannot name an operator"]);
    assert_done(&robogate_in(folder, &planned("Ada, Grace")));
    let next: Value = serde_json::from_str(&run(folder, "trial next study --json")).unwrap();
    let code = next["code"].as_str().unwrap();
    for (event, option, value) in [
        ("start", "--result", "success"),
        ("start", "--stage", "reach"),
        ("stop", "--operator", "Ada"),
        ("stop", "--notes", "slow"),
        ("result", "--reason", "late"),
        ("invalid", "--notes", "bumped"),
        ("invalid", "--measured", "3"),
        ("correct", "--operator", "Ada"),
        ("pause", "--reason", "lunch"),
        ("resume", "--code", code),
    ] {
        let line = ["trial", "record", "study", event, option, value];
        assert_exit_in(folder, &line, 2, &[&format!("this event does not use {option}")]);
    }
    let journal = || fs::read_to_string(folder.join("study/journal.jsonl")).unwrap().lines().count();
    assert_eq!(journal(), 1);
    run(folder, &format!("trial record study start --code {code} --operator Grace"));
    assert_eq!(journal(), 2);
}

/// A server of a study.
struct Server {
    process: Child,
    address: String,
    token: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.process.kill());
        drop(self.process.wait());
    }
}

impl Server {
    fn start(folder: &Path, listen: &str, more: &[&str]) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(["trial", "serve", "study", "--listen", listen])
            .args(more)
            .current_dir(folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let (address, token) = line.trim().strip_prefix("http://").unwrap().split_once("/#token=").unwrap();
        Self { process, address: address.to_owned(), token: token.to_owned() }
    }

    fn get(&self, path: &str, token: &str) -> Value {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        let head =
            format!("GET {path} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\nConnection: close\r\n\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        let mut reply = String::new();
        stream.read_to_string(&mut reply).unwrap();
        serde_json::from_str(reply.split("\r\n\r\n").nth(1).unwrap()).unwrap()
    }
}

/// Presses the visible button with this text, once it can be pressed.
fn tap(browser: &mut Browser, text: &str) {
    let button = format!(
        "[...document.querySelectorAll('button')].find(b => b.textContent === '{text}' && b.offsetHeight > 0 && !b.disabled)"
    );
    browser.wait(&format!("!!{button}"));
    browser.evaluate(&format!("{button}.click()"));
}

#[test]
fn better_policy_wins_on_a_phone() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    run(
        folder,
        "trial plan study --policy alpha-policy --policy beta-policy --count 12 --modes dropped,missed --stages reach,grasp",
    );
    let mut server = Server::start(folder, "127.0.0.1:0", &[]);
    let script = fs::read_to_string(folder.join("study/script.token")).unwrap();
    let mut browser = Browser::start(&chromium);
    browser.resize(390, 844, 2.0);
    browser.open(format!("http://{}/#token={}", server.address, server.token));
    browser.wait("document.getElementById('name').offsetHeight > 0");
    browser.evaluate("document.getElementById('name').value = 'Ada'");
    tap(&mut browser, "Continue");
    let mut trials = 0;
    loop {
        browser.wait("!!state && (state.phase === 'ready' || state.phase === 'finished') && !busy");
        if browser.evaluate("state.phase") == "finished" {
            break;
        }
        tap(&mut browser, "Start");
        browser.wait("state.phase === 'running'");
        let winner = server.get("/v1/policy", &script)["policy"] == "beta-policy";
        if trials == 2 {
            // The server is gone: the tap is kept, the operator sees that at once, and it is recorded once after the return.
            drop(server.process.kill());
            drop(server.process.wait());
            let shown = "(async () => { const from = performance.now(); \
                [...document.querySelectorAll('button')].find(b => b.textContent === 'Stop').click(); \
                while (document.getElementById('alarm').hidden) await new Promise(next => setTimeout(next, 10)); \
                return performance.now() - from; })()";
            let after = browser.evaluate(shown);
            assert!(after.as_f64().unwrap() < 2_000.0, "{after}");
            let address = server.address.clone();
            server = Server::start(folder, &address, &[]);
        } else {
            tap(&mut browser, "Stop");
        }
        browser.wait("state.phase === 'stopped' && !busy && document.getElementById('details').offsetHeight > 0");
        assert_eq!(
            browser.evaluate("document.querySelectorAll('[aria-pressed=true]').length"),
            0,
            "nothing is selected"
        );
        assert_eq!(browser.evaluate("document.getElementById('send').disabled"), true);
        assert_eq!(browser.evaluate("document.documentElement.scrollWidth"), 390, "nothing is cut off");
        let small =
            "[...document.querySelectorAll('button')].filter(b => b.offsetHeight > 0 && b.offsetHeight < 48).length";
        assert_eq!(browser.evaluate(small), 0);
        tap(&mut browser, if winner { "success" } else { "dropped" });
        if !winner {
            tap(&mut browser, "grasp");
        }
        tap(&mut browser, "Record");
        browser.wait("state.phase !== 'stopped'");
        trials += 1;
        assert!(trials < 100);
    }
    assert!(browser.evaluate("document.body.innerText").as_str().unwrap().contains("The study has ended"));
    drop(server);
    assert!(run(folder, "trial status study").contains("All records are intact."));
    run(folder, "trial unblind study");
    let output = robogate_in(folder, &["trial", "report", "study", "--out", "out"]);
    assert_done(&output);
    assert!(stdout(&output).contains("beta-policy is better than alpha-policy."), "{}", stdout(&output));
    assert!(stderr(&output).contains("report.html"));
    let answer: Value = serde_json::from_str(&fs::read_to_string(folder.join("out/trials.json")).unwrap()).unwrap();
    assert_eq!(answer["answer"]["trials"], trials);
    run(folder, "import out/trials.csv both.parquet --mapping out/trials.toml");
    let compared = robogate_in(folder, &["compare", "both-alpha-policy.parquet", "both-beta-policy.parquet"]);
    assert_done(&compared);
    browser.open(folder.join("out/report.html"));
    assert!(browser.evaluate("document.body.innerText").as_str().unwrap().contains("Order of the trials"));
    assert_eq!(browser.evaluate("getComputedStyle(document.body).maxWidth"), "960px", "the style is allowed");
}

/// A trial that runs when a server with a switch begins is repeated: the switch would not open for it.
#[test]
fn restart_with_a_switch_repeats_the_trial() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    run(folder, "trial plan study --policy mine --at-least 0.7 --count 3 --blocks 30");
    let next: Value = serde_json::from_str(&run(folder, "trial next study --json")).unwrap();
    let code = next["code"].as_str().unwrap();
    run(folder, &format!("trial record study start --code {code} --operator Ada"));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let policy = format!("mine={}", listener.local_addr().unwrap());
    let server = Server::start(folder, "127.0.0.1:0", &["--server", &policy, "--robot", "127.0.0.1:0"]);
    let state = server.get("/v1/state", &server.token);
    assert_eq!(state["phase"], "ready");
    assert_eq!(state["repeated"], "the server was started again while the trial ran");
    let status: Value = serde_json::from_str(&run(folder, "trial status study --json")).unwrap();
    assert_eq!(status["repeated"], 1);
}

/// A server with the dialect openpi that declares this number.
fn policy_server(chunk: u64) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut socket) = tungstenite::accept(stream.unwrap()) else { continue };
            let entries =
                vec![("action_horizon".into(), chunk.into()), ("checkpoint".into(), format!("step-{chunk}").into())];
            let mut bytes = Vec::new();
            rmpv::encode::write_value(&mut bytes, &rmpv::Value::Map(entries)).unwrap();
            if socket.send(tungstenite::Message::binary(bytes)).is_ok() {
                drop(socket.read());
            }
        }
    });
    address
}

#[test]
fn servers_with_other_metadata_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    run(folder, "trial plan study --policy one --policy other --count 3");
    let [eight, sixteen] = [8, 16].map(policy_server);
    let (one, other) = (format!("one={eight}"), format!("other={sixteen}"));
    let serve =
        ["trial", "serve", "study", "--listen", "127.0.0.1:0", "--robot", "127.0.0.1:0", "--profile", "pi0-libero"];
    let wrong = [&serve[..], &["--server", &one, "--server", &other]].concat();
    assert_exit_in(folder, &wrong, 2, &["the servers declare different properties", "\"action_horizon\":16"]);
    let unknown = [&serve[..], &["--server", &one, "--server", &one]].concat();
    assert_exit_in(folder, &unknown, 2, &["expected one for each policy"]);
    assert_eq!(
        fs::read_to_string(folder.join("study/journal.jsonl")).unwrap().lines().count(),
        1,
        "no trial has started"
    );
}
