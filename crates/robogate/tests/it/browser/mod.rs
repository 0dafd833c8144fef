//! A headless Chromium that is driven through the Chrome DevTools protocol.

use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket};

/// The longest wait for a condition on a page.
const PATIENCE: Duration = Duration::from_secs(90);

/// Decodes Base64 (RFC 4648).
fn base64(text: &str) -> Vec<u8> {
    let value = |letter: &u8| match letter {
        b'A'..=b'Z' => letter - b'A',
        b'a'..=b'z' => letter - b'a' + 26,
        b'0'..=b'9' => letter - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let of_four = |four: &[u8]| {
        let bits = four.iter().fold(0_u32, |bits, letter| (bits << 6) | u32::from(value(letter)));
        (bits << (6 * (4 - four.len()))).to_be_bytes().into_iter().skip(1).take(four.len() * 6 / 8).collect::<Vec<u8>>()
    };
    text.trim_end_matches('=').as_bytes().chunks(4).flat_map(of_four).collect()
}

/// A browser with one page.
pub struct Browser {
    process: Child,
    socket: WebSocket<TcpStream>,
    session: Option<String>,
    last: u64,
    troubles: Vec<String>,
    /// The server whose pages may be requested.
    server: Option<String>,
    _profile: TempDir,
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Browser {
    /// Starts the browser.
    pub fn start(chromium: &Path) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let mut process = Command::new(chromium)
            .args(["--headless", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-sync"])
            .args(["--disable-component-update", "--hide-scrollbars", "--window-size=1280,1000"])
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0"])
            // WebGL is emulated on the processor. What is around it is painted in less time without that emulation.
            .arg("--disable-gpu-compositing")
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stderr.take().unwrap()).lines();
        let address = lines
            .by_ref()
            .find_map(|line| line.unwrap().strip_prefix("DevTools listening on ").map(str::to_owned))
            .expect("chromium prints its address");
        // The pipe must be read, or the browser stops when it is full.
        std::thread::spawn(move || lines.for_each(drop));
        let host = address.trim_start_matches("ws://").split('/').next().unwrap().to_owned();
        let stream = TcpStream::connect(&host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let (socket, _) = tungstenite::client(&*address, stream).unwrap();
        let mut browser =
            Self { process, socket, session: None, last: 0, troubles: Vec::new(), server: None, _profile: profile };
        let target = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let session = browser.call("Target.attachToTarget", attach);
        browser.session = Some(session["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Runtime", "Log", "Page", "Network"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        browser
    }

    /// Calls a method and returns its result. Errors on the page are collected meanwhile.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.try_call(method, parameters).unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// Calls a method and returns its result or error.
    fn try_call(&mut self, method: &str, parameters: Value) -> Result<Value, Value> {
        self.last += 1;
        let id = self.last;
        let mut request = json!({ "id": id, "method": method, "params": parameters });
        if let Some(session) = &self.session {
            request["sessionId"] = json!(session);
        }
        self.socket.send(Message::text(request.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == json!(id) {
                let error = &message["error"];
                return if error.is_null() { Ok(message["result"].clone()) } else { Err(error.clone()) };
            }
            self.note(&message);
        }
    }

    /// Collects errors, warnings and network requests of the page.
    fn note(&mut self, message: &Value) {
        let parameters = &message["params"];
        let trouble = match message["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => Some(parameters["exceptionDetails"].to_string()),
            "Runtime.consoleAPICalled" if parameters["type"] == "error" => Some(parameters["args"].to_string()),
            "Log.entryAdded" if parameters["entry"]["level"] == "error" => Some(parameters["entry"].to_string()),
            "Network.requestWillBeSent" => {
                let url = parameters["request"]["url"].as_str().unwrap_or_default();
                let local = ["file:", "data:", "blob:", "about:"].iter().any(|scheme| url.starts_with(scheme));
                let served = self.server.as_ref().is_some_and(|server| url.starts_with(server));
                (!local && !served).then(|| format!("request of {url}"))
            }
            _ => None,
        };
        self.troubles.extend(trouble);
    }

    /// Opens a page: the path of a file, or an address such as `http://127.0.0.1:7380/`.
    pub fn open(&mut self, page: impl AsRef<Path>) {
        let page = page.as_ref();
        let url = match page.to_str() {
            Some(address) if address.starts_with("http:") => {
                let host = address.trim_start_matches("http://").split('/').next().unwrap_or_default();
                self.server = Some(format!("http://{host}/"));
                address.to_owned()
            }
            _ => format!("file://{}", page.canonicalize().unwrap().display()),
        };
        self.call("Page.navigate", json!({ "url": url }));
        self.wait("document.readyState === 'complete'");
    }

    /// Evaluates an expression on the page. A promise is awaited.
    pub fn evaluate(&mut self, expression: &str) -> Value {
        self.try_evaluate(expression).unwrap_or_else(|error| panic!("{expression}: {error}"))
    }

    /// Evaluates an expression. An error is that of the browser, for example of a page that it has just left.
    fn try_evaluate(&mut self, expression: &str) -> Result<Value, Value> {
        let parameters = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let result = self.try_call("Runtime.evaluate", parameters)?;
        assert!(result["exceptionDetails"].is_null(), "{expression}: {}", result["exceptionDetails"]);
        Ok(result["result"]["value"].clone())
    }

    /// Waits until an expression is true. It has no value while the browser moves to another page.
    pub fn wait(&mut self, condition: &str) {
        let begun = Instant::now();
        loop {
            match self.try_evaluate(condition) {
                Ok(Value::Bool(true)) => return,
                Err(error) if !error.to_string().contains("navigated") => panic!("{condition}: {error}"),
                _ => {}
            }
            assert!(begun.elapsed() < PATIENCE, "{condition} did not become true; troubles: {:?}", self.troubles);
            std::thread::sleep(Duration::from_millis(40));
        }
    }

    /// Sets the size of the window, and how many pixels of the screen are one pixel of the page in each direction.
    pub fn resize(&mut self, width: u64, height: u64, scale: f64) {
        let window = json!({ "width": width, "height": height, "deviceScaleFactor": scale, "mobile": false });
        self.call("Emulation.setDeviceMetricsOverride", window);
    }

    /// Presses a key on the focused element.
    pub fn press(&mut self, key: &str) {
        let code = match key {
            " " => 32,
            "ArrowRight" => 39,
            "End" => 35,
            _ => 0,
        };
        for kind in ["keyDown", "keyUp"] {
            let mut parameters = json!({ "type": kind, "key": key, "windowsVirtualKeyCode": code });
            if key == " " && kind == "keyDown" {
                parameters["text"] = json!(" ");
            }
            self.call("Input.dispatchKeyEvent", parameters);
        }
    }

    /// Opens a page in the light theme, and prints it as PDF.
    pub fn print(&mut self, page: &Path) -> Vec<u8> {
        self.call("Emulation.setEmulatedMedia", json!({ "features": [] }));
        self.call("Emulation.clearDeviceMetricsOverride", json!({}));
        self.open(page);
        let printed = self.call("Page.printToPDF", json!({ "preferCSSPageSize": true, "printBackground": true }));
        base64(printed["data"].as_str().unwrap())
    }

    /// Asserts that the page has reported no error and has requested nothing.
    pub fn assert_no_trouble(&self) {
        assert!(self.troubles.is_empty(), "{:#?}", self.troubles);
    }

    /// Asserts that axe finds no violation in either theme. `axe` is the file of axe-core.
    pub fn assert_accessible(&mut self, axe: &Path) {
        let source = std::fs::read_to_string(axe).unwrap();
        self.evaluate(&format!("{source}; true"));
        // Both themes have the same elements: the second one can only change colours.
        for (theme, rules) in [("light", ""), ("dark", "runOnly: ['color-contrast', 'link-in-text-block'], ")] {
            let media = json!({ "features": [{ "name": "prefers-color-scheme", "value": theme }] });
            self.call("Emulation.setEmulatedMedia", media);
            self.assert_no_violation(theme, rules);
        }
    }

    fn assert_no_violation(&mut self, theme: &str, rules: &str) {
        // The page reacts to the sizes of its parts in the next frame.
        self.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 300))))",
        );
        let found = self.evaluate(&format!(
            "axe.run(document, {{ {rules}resultTypes: ['violations'] }}).then((r) => r.violations.map((v) => v.id + ': ' + \
             v.nodes.slice(0, 3).map((n) => n.target + ' ' + n.failureSummary).join(' | ')))",
        ));
        assert_eq!(found, json!([]), "{theme}: {found:#}");
    }
}
