//! The explorer: its server, its page as one file, and its figures. The parts in a browser are skipped without Chromium.

use std::fs::{self, OpenOptions};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use robogate_core::{Outcome, Value as Parameter};
use robogate_dictionary::Dictionary;
use robogate_risk::{Fitting, Inputs, Learner, RiskModel, Sample};
use robogate_stats::{Confidence, Trials, clopper_pearson, wilson};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::browser::Browser;
use crate::harness::{assert_done, robogate_in, stderr};

/// Runs a line of arguments in `folder`, and returns what it prints on stderr.
fn robogate(folder: &Path, line: &str) -> String {
    let output = robogate_in(folder, &line.split(' ').collect::<Vec<_>>());
    assert_done(&output);
    stderr(&output)
}

/// A process that ends with the test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// A server of the explorer.
struct Server {
    _process: Process,
    address: String,
    token: String,
}

impl Server {
    fn start(folder: &Path, runs: &[&str]) -> Self {
        let mut process = Process(
            Command::new(env!("CARGO_BIN_EXE_robogate"))
                .arg("view")
                .args(runs)
                .current_dir(folder)
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        );
        let mut line = String::new();
        BufReader::new(process.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let (address, token) = line.trim().split_once("/#token=").unwrap();
        let address = address.strip_prefix("http://").unwrap().to_owned();
        Self { _process: process, address, token: token.to_owned() }
    }

    /// Sends a request, and returns status, head and body.
    fn send(&self, request: &str) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut reply = Vec::new();
        stream.read_to_end(&mut reply).unwrap();
        let end = reply.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        let head = String::from_utf8_lossy(&reply[..end]).into_owned();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, head, reply[end + 4..].to_vec())
    }

    fn get(&self, path: &str) -> (u16, String, Vec<u8>) {
        let (address, token) = (&self.address, &self.token);
        self.send(&format!(
            "GET {path} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\nConnection: close\r\n\r\n"
        ))
    }

    fn json(&self, path: &str) -> Value {
        let (status, _, body) = self.get(path);
        assert_eq!(status, 200, "{path}: {}", String::from_utf8_lossy(&body));
        serde_json::from_slice(&body).unwrap()
    }

    /// Waits until the state fulfils a condition.
    fn wait(&self, condition: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        loop {
            let state = self.json("/v1/state");
            if condition(&state) {
                return state;
            }
            assert!(begun.elapsed() < Duration::from_secs(90), "{state:#}");
            std::thread::sleep(Duration::from_millis(200));
        }
    }
}

#[test]
fn server_admits_its_own_page_only() {
    let dir = TempDir::new().unwrap();
    robogate(dir.path(), "run --task pendulum -n 120 --seed 3 --out a");
    let server = Server::start(dir.path(), &["a"]);
    let (address, token) = (&server.address, &server.token);
    assert!(address.starts_with("127.0.0.1:") && token.len() == 32, "{address} {token}");
    let ask = |method: &str, path: &str, host: &str, authorization: &str| {
        let request = format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\n{authorization}Connection: close\r\n\r\n");
        let (status, head, body) = server.send(&request);
        (status, head, String::from_utf8_lossy(&body).into_owned())
    };
    let bearer = format!("Authorization: Bearer {token}\r\n");
    // The page has no data, and its policy allows its own scripts and this server alone.
    let (status, head, page) = ask("GET", "/", address, "");
    assert_eq!(status, 200);
    assert!(
        head.contains("script-src 'sha256-")
            && head.contains("connect-src 'self'")
            && head.contains("frame-ancestors 'none'")
    );
    assert!(
        page.contains("id=\"explorer\"") && !page.contains("id=\"explorer-data\"") && !page.contains(token.as_str())
    );
    for path in ["/v1/state", "/v1/rows?epoch=1&from=0&to=9", "/v1/model?run=0", "/v1/clip?run=0&index=0", "/x"] {
        assert_eq!(ask("GET", path, address, "").0, 401, "{path}");
        let wrong = format!("Authorization: Bearer {}\r\n", "0".repeat(32));
        assert_eq!(ask("GET", path, address, &wrong).0, 401, "{path}");
        assert_eq!(ask("GET", path, "evil.example:80", &bearer).0, 403, "{path}");
        assert_eq!(ask("POST", path, address, &bearer).0, 405, "{path}");
    }
    assert_eq!(ask("GET", "/", "127.0.0.1.evil.example", "").0, 403);
    for (path, status) in [
        ("/v1/nothing", 404),
        ("/../../etc/passwd", 404),
        ("/v1/rows", 400),
        ("/v1/rows?epoch=1&from=5&to=4", 400),
        ("/v1/rows?epoch=1&from=0&to=121", 400),
        ("/v1/rows?epoch=7&from=0&to=9", 400),
        ("/v1/rows?epoch=1&from=-1&to=9", 400),
        ("/v1/rows?epoch=1&from=0&to=99999999999999999999", 400),
        ("/v1/model", 400),
        ("/v1/model?run=1", 404),
        ("/v1/model?run=18446744073709551615", 404),
        ("/v1/clip?run=0", 400),
        ("/v1/clip?run=0&index=120", 404),
        ("/v1/clip?run=9&index=0", 404),
    ] {
        let (found, _, body) = server.get(path);
        assert_eq!(found, status, "{path}: {}", String::from_utf8_lossy(&body));
    }
    let state = server.json("/v1/state");
    assert_eq!((&state["rows"], &state["runs"][0]["finished"]), (&json!(120), &json!(true)));
    let columns = state["columns"].as_array().unwrap().len();
    assert_eq!(server.get("/v1/rows?epoch=1&from=20&to=70").2.len(), 4 * 50 * columns);
    let clip = server.json("/v1/clip?run=0&index=7");
    assert_eq!(clip["reel"]["clips"][0]["title"], json!("Episode 7"));
    // A failed episode comes with its nearest passing twin.
    let entries = Dictionary::open(&dir.path().join("a/dictionary.parquet")).unwrap();
    let outcomes: Vec<Outcome> = entries.entries().map(|entry| entry.unwrap().episode.outcome).collect();
    let failed = outcomes.iter().position(|outcome| matches!(outcome, Outcome::Failure(_))).unwrap();
    let clip = server.json(&format!("/v1/clip?run=0&index={failed}"));
    let twin = clip["twin"]["index"].as_u64().unwrap() as usize;
    assert_eq!((&outcomes[twin], &clip["twin"]["at"]), (&Outcome::Success, &json!(1)));
    assert_eq!(clip["reel"]["clips"][1]["title"], json!(format!("Episode {twin}")));
    let passed = outcomes.iter().position(|outcome| *outcome == Outcome::Success).unwrap();
    assert_eq!(server.json(&format!("/v1/clip?run=0&index={passed}"))["twin"], Value::Null);
}

#[test]
fn running_campaigns_update() {
    let dir = TempDir::new().unwrap();
    let at = |name: &str| dir.path().join(name);
    let run = Process(
        Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args("run --task pendulum -n 200000 --seed 3 --threads 1 --out a".split(' '))
            .current_dir(dir.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let begun = Instant::now();
    while fs::metadata(at("a/journal.rgj")).map_or(0, |file| file.len()) < 10_000 {
        assert!(begun.elapsed() < Duration::from_secs(90), "the run does not begin");
        std::thread::sleep(Duration::from_millis(50));
    }
    let server = Server::start(dir.path(), &["a"]);
    let first = server.json("/v1/state");
    assert_eq!(first["runs"][0]["finished"], json!(false));
    let rows = first["rows"].as_u64().unwrap();
    assert!(rows > 0);
    server.wait(|state| state["rows"].as_u64().unwrap() > rows + 20);
    // An episode of an unfinished run is played, although the run holds its lock.
    assert_eq!(server.json("/v1/clip?run=0&index=3")["reel"]["clips"][0]["title"], json!("Episode 3"));
    let mut page = robogate_testing::program("chromium").map(|chromium| Page::open(&chromium, &server));
    if let Some(page) = &mut page {
        page.grows_with_a_selection();
    }
    // A killed run leaves a truncated journal.
    drop(run);
    let journal = OpenOptions::new().write(true).open(at("a/journal.rgj")).unwrap();
    let length = journal.metadata().unwrap().len();
    let known = server.wait(|state| state["epoch"] == json!(1));
    journal.set_len(length / 2).unwrap();
    let after = server.wait(|state| state["epoch"] != json!(1));
    assert!(after["rows"].as_u64().unwrap() < known["rows"].as_u64().unwrap());
    assert_eq!(after["runs"][0]["problem"], Value::Null);
    assert_eq!(Server::start(dir.path(), &["a"]).json("/v1/state")["rows"], after["rows"]);
    if let Some(mut page) = page {
        // The void rows are gone, and the selection is counted again.
        page.0.wait(&format!("robogateExplorer.explorer.data.rows === {}", after["rows"]));
        page.assert_counts();
    }
}

/// The explorer in a browser, with the page of a server.
struct Page(Browser);

impl Page {
    fn open(chromium: &Path, server: &Server) -> Self {
        let mut browser = Browser::start(chromium);
        browser.open(format!("http://{}/#token={}", server.address, server.token));
        browser.wait("document.body.dataset.ready === 'true' && document.body.dataset.modelled === 'true'");
        Self(browser)
    }

    fn rows(&mut self) -> u64 {
        self.0.evaluate("robogateExplorer.explorer.data.rows").as_u64().unwrap()
    }

    /// Brushes an axis, waits for new rows, and plays an episode while more arrive.
    fn grows_with_a_selection(&mut self) {
        self.0.wait("document.querySelector('.x-status').textContent.includes('unfinished')");
        self.0.evaluate(
            "(() => { const e = robogateExplorer.explorer; e.brush(e.axes.find((c) => c.kind === 'number'), [0.2, 0.6]) })()",
        );
        let rows = self.rows();
        self.0.wait(&format!("robogateExplorer.explorer.data.rows > {}", rows + 20));
        self.assert_counts();
        self.0.evaluate("robogateExplorer.explorer.open(2)");
        self.0.wait("document.querySelector('.x-player [data-ready]') !== null");
        let rows = self.rows();
        self.0.wait(&format!("robogateExplorer.explorer.data.rows > {rows}"));
    }

    /// The counts of the selection are those of its rows, and the page has reported no error.
    fn assert_counts(&mut self) {
        let equal = self.0.evaluate(
            "(() => { const { data, selection: s } = robogateExplorer.explorer; let kept = 0; \
             for (let row = 0; row < data.rows; row++) kept += s.has(row) ? 1 : 0; \
             return kept === s.kept && kept > 0 && (s.isEmpty || kept < data.rows) })()",
        );
        assert_eq!(equal, json!(true));
        self.0.assert_no_trouble();
    }
}

/// A page of few rows has a random sample, and the rate of all episodes.
#[test]
fn full_tables_show_a_sample() {
    let dir = TempDir::new().unwrap();
    robogate(dir.path(), "run --task pendulum --design uniform -n 1000 --seed 3 --out a");
    let server = Server::start(dir.path(), &["a", "--rows", "350"]);
    let state = server.json("/v1/state");
    let rows = state["rows"].as_u64().unwrap();
    assert!((175..=350).contains(&rows) && state["halvings"] == json!(2), "{state}");
    let counts = &state["runs"][0]["counts"];
    assert_eq!((&counts["n"], &state["runs"][0]["rows"]), (&json!(1000), &json!(1000)));
    let report = analysis(dir.path(), "a");
    assert_eq!(counts["k"], report["success"]["rate"]["successes"]);
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let mut page = Page::open(&chromium, &server);
    assert_eq!(page.rows(), rows);
    page.0.wait("document.querySelector('.x-what')?.textContent.includes('of 1,000 episodes succeeded')");
    page.0.wait("document.querySelector('.x-status').textContent.includes('random sample of')");
    page.0.evaluate("robogateExplorer.explorer.brush(robogateExplorer.explorer.axes[0], [0.2, 0.6])");
    page.0.wait("document.querySelector('.x-more')?.textContent.includes('Counted in the random sample')");
    page.assert_counts();
}

#[test]
fn shards_arrive_one_by_one() {
    let dir = TempDir::new().unwrap();
    let shard = |k: u32| {
        robogate(dir.path(), &format!("run --task pendulum --design two-stage -n 90 --seed 3 --shard {k}/3 --out s"))
    };
    shard(1);
    let server = Server::start(dir.path(), &["s"]);
    let first = server.json("/v1/state");
    let rows = first["rows"].as_u64().unwrap();
    assert!(rows > 0 && first["runs"][0]["finished"] == json!(false), "{first:#}");
    let mut page = robogate_testing::program("chromium").map(|chromium| Page::open(&chromium, &server));
    shard(0);
    server.wait(|state| state["rows"].as_u64().unwrap() > rows);
    if let Some(page) = &mut page {
        page.0.wait(&format!("robogateExplorer.explorer.data.rows > {rows}"));
    }
    for round in [2, 0, 1, 2] {
        shard(round);
    }
    robogate(dir.path(), "merge s");
    let whole = server.wait(|state| state["runs"][0]["finished"] == json!(true));
    assert_eq!(whole["rows"], whole["runs"][0]["planned"]);
    assert_eq!(whole["epoch"], json!(1));
    if let Some(mut page) = page {
        page.0.wait(&format!("robogateExplorer.explorer.data.rows === {}", whole["rows"]));
        page.0.wait("!document.querySelector('.x-status').textContent.includes('unfinished')");
        page.assert_counts();
    }
}

/// Opens a page, brushes, colours, selects by keyboard, opens an episode, and checks its accessibility in both themes.
fn operate(browser: &mut Browser, axe: Option<&std::path::PathBuf>) {
    browser.wait("document.body.dataset.ready === 'true'");
    browser.wait("document.body.dataset.modelled === 'true'");
    browser.wait("!robogateExplorer.explorer.awake");
    let all = browser.evaluate("robogateExplorer.explorer.selection.kept").as_u64().unwrap();
    // Brush an axis with the pointer.
    browser.evaluate(
        "(() => { const p = robogateExplorer.explorer.parallel, box = p.overlay.getBoundingClientRect(), x = box.left + p.x(1); \
         const at = (type, y) => p.overlay.dispatchEvent(new PointerEvent(type, { clientX: x, clientY: box.top + y, bubbles: true, pointerId: 1, buttons: 1 })); \
         p.overlay.setPointerCapture = () => {}; at('pointerdown', p.y(0.75)); at('pointermove', p.y(0.5)); at('pointermove', p.y(0.25)); at('pointerup', p.y(0.25)) })()",
    );
    browser.wait(&format!("robogateExplorer.explorer.selection.kept < {all} && !robogateExplorer.explorer.awake"));
    browser.wait("!document.querySelector('.x-caution').hidden");
    let kept = browser.evaluate("robogateExplorer.explorer.selection.kept").as_u64().unwrap();
    assert_eq!(browser.evaluate("document.querySelectorAll('.x-chips button').length"), json!(2));
    // A lasso on the scatter plot keeps a part of that.
    browser.evaluate(
        "(() => { const s = robogateExplorer.explorer.scatter, box = s.overlay.getBoundingClientRect(); s.overlay.setPointerCapture = () => {}; \
         const at = (type, u, v) => s.overlay.dispatchEvent(new PointerEvent(type, { clientX: box.left + s.x(u), clientY: box.top + s.y(v), bubbles: true, pointerId: 1, shiftKey: true })); \
         at('pointerdown', 0.1, 0.1); at('pointermove', 0.9, 0.1); at('pointermove', 0.9, 0.9); at('pointermove', 0.1, 0.9); at('pointerup', 0.1, 0.9) })()",
    );
    browser.wait(&format!(
        "robogateExplorer.explorer.selection.kept < {kept} && robogateExplorer.explorer.selection.kept > 0"
    ));
    browser.evaluate("document.querySelector('.x-clear').click()");
    browser.wait(&format!("robogateExplorer.explorer.selection.kept === {all}"));
    // Every colour, and every class of a legend.
    let colours = browser.evaluate("document.querySelector('.x-top select').options.length").as_u64().unwrap();
    for at in 0..colours {
        browser.evaluate(&format!(
            "(() => {{ const s = document.querySelector('.x-top select'); s.selectedIndex = {at}; s.dispatchEvent(new Event('change')) }})()"
        ));
        browser.wait("!robogateExplorer.explorer.awake && document.querySelectorAll('.x-key').length > 0");
    }
    browser.evaluate("document.querySelector('.x-key').click()");
    browser.wait("document.querySelector('.x-key').getAttribute('aria-pressed') === 'true'");
    browser.evaluate("document.querySelector('.x-clear').click()");
    // The form does the same without a pointer.
    browser.evaluate("document.querySelector('.x-form').open = true");
    browser.wait("document.querySelectorAll('.x-filters fieldset').length > 1");
    browser.evaluate(
        "(() => { const i = document.querySelector('.x-filters input[type=number]'); i.value = Number(i.placeholder) * 1.5 + 0.01; \
         i.dispatchEvent(new Event('change')) })()",
    );
    browser.wait(&format!("robogateExplorer.explorer.selection.kept < {all}"));
    browser.evaluate("robogateExplorer.explorer.clear()");
    // Read the map by keyboard, and move a slider.
    browser.evaluate("document.querySelector('.x-map .x-overlay').focus()");
    browser.press("ArrowRight");
    browser.wait("document.querySelector('.x-map .x-reading').textContent.includes('95 % interval of the model')");
    browser.evaluate(
        "document.querySelectorAll('.x-slider input').forEach((s) => { s.value = 0.8; s.dispatchEvent(new Event('input')) })",
    );
    browser.wait("!robogateExplorer.explorer.awake");
    // Sort, and play an episode by keyboard.
    browser.evaluate("document.querySelectorAll('.x-th button')[1].click()");
    browser.wait("!!document.querySelector('.x-th [aria-sort=ascending]')");
    browser.evaluate("document.querySelector('.x-scroll').focus()");
    browser.press("End");
    browser.press("Home");
    let playable = "(() => { const e = robogateExplorer.explorer, d = e.data; for (let r = 0; r < d.rows; r++) if (e.canPlay(d.run.values[r], d.index.values[r])) return r; return -1 })()";
    browser.evaluate(&format!("robogateExplorer.explorer.open({playable})"));
    browser.wait(
        "document.querySelector('.x-player [data-ready]') !== null && !document.querySelector('.x-stage').hidden",
    );
    // A failed episode is beside its nearest passing twin, on one clock.
    browser.wait("document.querySelectorAll('.x-player .view-label').length === 2 && document.querySelector('.x-player .chip.good') !== null");
    browser.wait("document.querySelector('.x-player > .x-reading').textContent.includes('the passing episode with the most similar parameters')");
    browser.evaluate("document.querySelector('.view-play').click()");
    browser.wait("Number(document.querySelector('.view-bar input[type=range]').value) > 0.1");
    browser.evaluate("document.querySelector('.view-play').click()");
    if let Some(axe) = axe {
        browser.assert_accessible(axe);
    }
}

/// The page predicts what the risk model of Rust predicts, for every episode of a run.
fn compare_predictions(browser: &mut Browser, dictionary: &Path) {
    let dictionary = Dictionary::open(dictionary).unwrap();
    // The model of the active stage chose points by their draws, so their outcomes are not a random sample at these parameters.
    let entries = dictionary.entries().map(Result::unwrap);
    let entries = entries.filter(|entry| entry.stage != "active" || entry.design == "uniform");
    let entries = entries.filter(|entry| !matches!(entry.episode.outcome, Outcome::Invalid(_))).map(|entry| {
        let mut episode = entry.episode;
        // The page has the parameters as 32-bit numbers.
        let requested = episode.scenario.requested.clone();
        for (name, value) in requested.iter() {
            if let Parameter::Number(x) = value {
                episode.scenario.requested.set(name, Parameter::Number(f64::from(*x as f32)));
            }
        }
        episode
    });
    let samples: Vec<Sample> = entries
        .map(|episode| Sample { success: episode.outcome == Outcome::Success, scenario: episode.scenario })
        .collect();
    let inputs = Inputs::new(&dictionary.provenance().space, None);
    let how = Fitting { learner: Learner::Splines, ..Fitting::default() };
    let model = RiskModel::fit(std::sync::Arc::new(inputs), &samples, how).unwrap();
    let mut largest = 0.0_f64;
    let indices: Vec<u64> = samples.iter().map(|sample| sample.scenario.index).collect();
    let predicted = browser.evaluate(&format!("{indices:?}.map((index) => robogateExplorer.predict(0, index))"));
    let predicted: Vec<[f64; 3]> = serde_json::from_value(predicted).unwrap();
    assert_eq!(predicted.len(), samples.len());
    for (sample, [found, low, high]) in samples.iter().zip(predicted) {
        let expected: f64 = model.told(&sample.scenario).unwrap();
        largest = largest.max((found - expected).abs());
        assert!(low <= found && found <= high, "{low} {found} {high}");
    }
    assert!(largest < 1e-6, "{largest}");
}

/// The intervals of the page equal those of the statistics.
fn compare_figures(browser: &mut Browser) {
    for (k, n) in [(0, 0), (0, 1), (1, 1), (3, 7), (0, 40), (39, 40), (17, 123), (998, 1000), (12_345, 20_000)] {
        let trials = Trials::new(k, n).unwrap();
        for (name, interval) in
            [("wilson", wilson(trials, Confidence::P95)), ("clopperPearson", clopper_pearson(trials, Confidence::P95))]
        {
            let found = browser.evaluate(&format!("robogateExplorer.{name}({k}, {n})"));
            for (at, expected) in [interval.low, interval.high].into_iter().enumerate() {
                let found = found[at].as_f64().unwrap();
                assert!((found - expected).abs() < 1e-10, "{name}({k}, {n}): {found} {expected}");
            }
        }
    }
}

#[test]
fn exported_page_is_operated() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let axe = robogate_testing::path("ROBOGATE_TEST_AXE", "the file axe.min.js of axe-core");
    let dir = TempDir::new().unwrap();
    robogate(dir.path(), "run -n 72 --seed 7 --out a");
    robogate(dir.path(), "run -n 12 --seed 8 --policy random --out b");
    let text = robogate(dir.path(), "view a b --export explorer.html --clips 4");
    assert!(text.contains("4 recorded episodes"), "{text}");
    let mut browser = Browser::start(&chromium);
    browser.open(dir.path().join("explorer.html"));
    operate(&mut browser, axe.as_ref());
    compare_figures(&mut browser);
    compare_predictions(&mut browser, &dir.path().join("a/dictionary.parquet"));
    assert_eq!(browser.evaluate("document.querySelectorAll('.x-rate').length"), json!(2), "one rate for each run");
    browser.assert_no_trouble();
    // The same runs give the same page.
    let first = fs::read(dir.path().join("explorer.html")).unwrap();
    robogate(dir.path(), "view a b --export again.html --clips 4");
    assert!(first == fs::read(dir.path().join("again.html")).unwrap(), "the pages differ");
}

/// The report of a run, as JSON.
fn analysis(folder: &Path, run: &str) -> Value {
    let output =
        Command::new(env!("CARGO_BIN_EXE_robogate")).args(["analyze", run, "--json"]).current_dir(folder).output();
    serde_json::from_slice(&output.unwrap().stdout).unwrap()
}

/// Episodes and successes of a run's selection on the page after some action.
fn counted(browser: &mut Browser, run: usize, action: &str) -> (Value, Value) {
    browser.evaluate(&format!("(() => {{ const e = robogateExplorer.explorer; {action} }})()"));
    let found = browser.evaluate(&format!("robogateExplorer.explorer.selection.runs[{run}]"));
    (found["n"].clone(), found["k"].clone())
}

/// For each design: the rate of the run, of each of its stages, and of each bin of each parameter.
#[test]
fn rates_equal_the_report() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let dir = TempDir::new().unwrap();
    let designs = ["active", "two-stage", "uniform"];
    for design in designs {
        robogate(dir.path(), &format!("run --task pendulum --design {design} -n 240 --seed 3 --out {design}"));
    }
    robogate(dir.path(), &format!("view {} --export page.html --clips 0", designs.join(" ")));
    let mut browser = Browser::start(&chromium);
    browser.open(dir.path().join("page.html"));
    browser.wait("document.body.dataset.modelled === 'true' && !robogateExplorer.explorer.awake");
    for (run, design) in designs.into_iter().enumerate() {
        let report = analysis(dir.path(), design);
        let of = |rate: &Value| (rate["n"].clone(), rate["successes"].clone());
        // The page counts the stages that sample the space, and the report all episodes by their weights.
        let stages = report["success"]["stages"].as_array().unwrap().iter();
        let sampled = stages.filter(|stage| stage["population"] != json!("focused_design"));
        let sum = |of: &str| sampled.clone().map(|stage| stage["rate"][of].as_u64().unwrap()).sum::<u64>();
        let expected = (json!(sum("n")), json!(sum("successes")));
        assert_eq!(counted(&mut browser, run, "e.clear()"), expected, "{design}");
        for stage in report["success"]["stages"].as_array().unwrap() {
            let name = &stage["stage"];
            let action =
                format!("e.setFilter(e.data.stage, {{ levels: new Set([e.data.stage.levels.indexOf({name})]) }})");
            let counts = counted(&mut browser, run, &action);
            let expected =
                if stage["population"] == json!("focused_design") { (json!(0), json!(0)) } else { of(&stage["rate"]) };
            assert_eq!(counts, expected, "{design}: {name}");
        }
        let mut cells = 0;
        if design != "uniform" {
            continue;
        }
        for effect in report["marginal_effects"].as_array().unwrap() {
            let name = &effect["parameter"];
            for cell in effect["cells"].as_array().unwrap().iter().filter(|cell| cell["range"].is_array()) {
                let [low, high] = [&cell["range"][0], &cell["range"][1]];
                let action = format!(
                    "e.clear(); e.setFilter(e.data.columns.find((c) => c.name === {name}), {{ low: {low}, high: {high} }})"
                );
                assert_eq!(counted(&mut browser, run, &action), of(&cell["rate"]), "{design}: {name} {low} to {high}");
                cells += 1;
            }
        }
        assert!(cells > 8, "{design}: {cells} cells");
    }
    browser.assert_no_trouble();
}

/// Results of another tool with words that would run as scripts in a careless page.
#[test]
fn foreign_words_stay_text() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let dir = TempDir::new().unwrap();
    let hostile = "<img src=x onerror=window.bad=1></script><script>window.bad=1</script>";
    let mut rows = "success,surface,mass\n".to_owned();
    for i in 0..90 {
        rows += &format!("{},{},{}\n", i % 3 % 2, ["steel", hostile][i % 2], 0.1 + 0.01 * i as f64);
    }
    fs::write(dir.path().join("rows.csv"), rows).unwrap();
    robogate(dir.path(), "import rows.csv rows.parquet");
    robogate(dir.path(), "view rows.parquet --export page.html");
    let mut browser = Browser::start(&chromium);
    browser.open(dir.path().join("page.html"));
    browser.wait("document.body.dataset.modelled === 'true' && !robogateExplorer.explorer.awake");
    browser.evaluate("document.querySelector('.x-form').open = true");
    browser.wait("document.querySelectorAll('.x-filters fieldset').length > 1");
    browser.evaluate("robogateExplorer.explorer.open(1)");
    browser.wait("document.querySelector('.x-player').textContent.includes('<img src=x') && document.querySelector('.x-scroll').textContent.includes('<img')");
    assert_eq!(browser.evaluate("window.bad === undefined && !document.querySelector('img')"), json!(true));
    browser.assert_no_trouble();
}

/// Appends copies of the rows with other values until the page has `rows` of them.
fn grow(browser: &mut Browser, rows: usize) {
    browser.evaluate(&format!(
        "(() => {{ const e = robogateExplorer.explorer, d = e.data, known = d.rows, more = {rows} - known; \
         d.append(d.columns.map((c) => {{ const spread = c.kind === 'number' && c.role !== 'weight' ? 0.01 * (c.high - c.low) : 0; \
         return Float32Array.from({{ length: more }}, (_, i) => c.role === 'index' ? known + i : c.values[i % known] + spread * ((i * 0.618) % 1)); }})); \
         e.refresh(true); }})()"
    ));
    browser.wait("!robogateExplorer.explorer.awake");
}

/// Moves a brush, and returns the milliseconds of processor time of the page's thread for each frame, and all times. The browser
/// shares the processors with other tests, so wall times are only printed.
fn brushed(browser: &mut Browser) -> (f64, Value) {
    browser.call("Performance.enable", json!({ "timeDomain": "threadTicks" }));
    let spent = |browser: &mut Browser| {
        let metrics = browser.call("Performance.getMetrics", json!({}))["metrics"].clone();
        let of = |metric: &&Value| metric["name"] == json!("TaskDuration");
        let seconds = metrics.as_array().unwrap().iter().find(of).unwrap()["value"].as_f64().unwrap();
        (seconds, browser.evaluate("robogateExplorer.explorer.work.frames").as_f64().unwrap())
    };
    let before = spent(browser);
    let measured = browser.evaluate("robogateExplorer.measure(30)");
    let after = spent(browser);
    (1e3 * (after.0 - before.0) / (after.1 - before.1), measured)
}

/// Brushes 20,000 and a million rows.
#[test]
fn many_rows_stay_interactive() {
    let Some(chromium) = robogate_testing::program("chromium") else { return };
    let dir = TempDir::new().unwrap();
    robogate(dir.path(), "run --task pendulum -n 1500 --seed 3 --out a");
    robogate(dir.path(), "view a a --export page.html --clips 0");
    let mut browser = Browser::start(&chromium);
    browser.open(dir.path().join("page.html"));
    browser.wait("document.body.dataset.modelled === 'true' && !robogateExplorer.explorer.awake");
    // A page with a sample says so, and its recorded episodes are in it.
    let text = robogate(dir.path(), "view a --export sample.html --clips 2 --rows 500");
    assert!(text.contains("random sample of 50"), "{text}");
    let page = fs::metadata(dir.path().join("sample.html")).unwrap().len();
    assert!(page < 1_500_000, "{page} bytes");
    let rows = |browser: &mut Browser| browser.evaluate("robogateExplorer.explorer.data.rows").as_u64().unwrap();
    grow(&mut browser, 20_000);
    assert_eq!(rows(&mut browser), 20_000);
    let (frame_ms, measured) = brushed(&mut browser);
    println!("{frame_ms:.1} ms of processor time per frame; {measured}");
    assert!(frame_ms < 50.0, "20,000 rows: {frame_ms} ms");
    grow(&mut browser, 1_000_000);
    assert_eq!(rows(&mut browser), 1_000_000);
    let (frame_ms, measured) = brushed(&mut browser);
    println!("{frame_ms:.1} ms of processor time per frame; {measured}");
    assert!(frame_ms < 50.0, "a million rows: {frame_ms} ms");
    // A moved brush updates the counts by the rows at its ends. They equal those of a full count.
    for ends in ["[0.1, 0.4]", "[0.15, 0.7]", "[0.5, 0.9]", "[0, 1]"] {
        let equal = browser.evaluate(&format!(
            "(() => {{ const e = robogateExplorer.explorer, s = e.selection; e.brush(e.axes[0], {ends}); \
             const counts = () => JSON.stringify([s.kept, [...s.counts], [...s.kinds]]), moved = counts(); s.count(); return moved === counts() }})()"
        ));
        assert_eq!(equal, json!(true), "{ends}");
    }
    browser.wait("!robogateExplorer.explorer.awake && document.querySelector('.x-rows > .x-reading').textContent.includes('The list shows 20,000')");
    browser.open(dir.path().join("sample.html"));
    browser.wait("document.querySelector('.x-status').textContent.includes('random sample of 50')");
    browser.wait("document.querySelector('.x-player [data-ready]') !== null");
    browser.assert_no_trouble();
}
