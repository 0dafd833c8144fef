//! Measures throughput and memory of the service: the figures of docs/results/monitor.md.
//!
//! `cargo bench -p robogate-monitor --features service --bench service [-- FOLDER]`
//!
//! The service is a separate process, pinned to one core with `taskset`. Its store is in FOLDER (default: the system's
//! temporary folder), which must be on a real disk. This process is the sender. It waits for each reply, so
//! acknowledged cycles are on disk.
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::unwrap_used, reason = "a measurement that fails ends")]
#![expect(clippy::print_stdout, reason = "it prints what it measured")]

use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use robogate_core::{Seed, Stream};
use robogate_monitor::service::{Intake, ServiceEngine, ServiceSettings, Store, serve};
use robogate_monitor::{Cycle, Monitor, Settings};

/// Number of cycles that are sent in batches, and cycles per batch.
const CYCLES: u64 = 1_000_000;
const BATCH: u64 = 1_000;
const RECIPES: u64 = 1_000;
/// Number of single POSTs.
const SINGLES: u64 = 5_000;

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let first = arguments.next();
    if first.as_deref() == Some("serve") {
        return child(Path::new(&arguments.next().unwrap()));
    }
    detectors();
    let base = first.map_or_else(std::env::temp_dir, Into::into);
    for recipes in [1, RECIPES] {
        let folder = tempfile::tempdir_in(&base).unwrap();
        service(&folder.path().join("monitor.db"), recipes);
    }
}

/// Measures the detectors alone, as a robot controller would use them.
fn detectors() {
    let mut monitor = Monitor::new(Settings::default()).unwrap();
    let mut stream = Seed::campaign(1).stream("speed");
    let mut text = String::new();
    line(&mut text, &mut stream, 0, 1);
    let mut cycle: Cycle = serde_json::from_str(&text).unwrap();
    let n = 2_000_000;
    let start = Instant::now();
    let mut alarms = 0;
    for _ in 0..n {
        cycle.success = stream.uniform() < 0.95;
        cycle.cycle_time_s = Some(stream.between(3.5, 4.5));
        monitor.observe(&cycle, &mut |_| alarms += 1).unwrap();
    }
    let each = start.elapsed().as_secs_f64() / f64::from(n);
    println!("detectors alone: {:.0} ns a cycle ({alarms} alarms in {n} cycles)", 1e9 * each);
}

/// The service process. It is killed on drop.
fn child(path: &Path) {
    let settings = ServiceSettings::default();
    let mut http = settings.http;
    http.requests_per_s = 1e6;
    let start = Instant::now();
    let store = Store::open(path, settings.store).unwrap();
    let intake = Intake::open(store, Monitor::new(settings.detectors).unwrap(), settings.late_after_s).unwrap();
    println!("opened {}", start.elapsed().as_secs_f64());
    let engine = ServiceEngine::open(intake, |_| {});
    let (_stop, stopped) = tokio::sync::oneshot::channel();
    let listening = |address| println!("address {address}");
    serve("127.0.0.1:0".parse().unwrap(), None, http, engine.handle(), None, listening, stopped).unwrap();
}

struct Server {
    process: Child,
    connection: BufReader<TcpStream>,
    opened_s: f64,
}

impl Server {
    fn start(path: &Path) -> Self {
        let mut process = Command::new("taskset")
            .args(["-c", "0"])
            .arg(std::env::current_exe().unwrap())
            .arg("serve")
            .arg(path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines().map(Result::unwrap);
        let mut value = |name: &str| lines.find_map(|line| line.strip_prefix(name).map(str::to_owned)).unwrap();
        let opened_s = value("opened ").parse().unwrap();
        let stream = TcpStream::connect(value("address ")).unwrap();
        stream.set_nodelay(true).unwrap();
        Self { process, connection: BufReader::new(stream), opened_s }
    }

    fn post(&mut self, body: &str) {
        let stream = self.connection.get_mut();
        let head = format!("POST /v1/cycles HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-length: {}\r\n\r\n", body.len());
        stream.write_all((head + body).as_bytes()).unwrap();
        let mut status = String::new();
        self.connection.read_line(&mut status).unwrap();
        assert!(status.contains(" 200 "), "{status}");
        let mut length = 0;
        loop {
            let mut line = String::new();
            self.connection.read_line(&mut line).unwrap();
            if line == "\r\n" {
                break;
            }
            if let Some(n) = line.to_ascii_lowercase().strip_prefix("content-length: ") {
                length = n.trim().parse().unwrap();
            }
        }
        self.connection.read_exact(&mut vec![0; length]).unwrap();
    }

    fn resident_mib(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.process.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.split_whitespace().next().unwrap().parse::<u64>().unwrap() / 1024
    }

    /// Processor time that it has used, in seconds. Other processes on the machine do not change it.
    fn processor_s(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.process.id())).unwrap();
        // After the process name in parentheses, fields 12 and 13 are user and system time in ticks of 10 ms.
        let ticks = stat.rsplit(')').next().unwrap().split_whitespace().skip(11).take(2);
        ticks.map(|ticks| ticks.parse::<f64>().unwrap() / 100.0).sum()
    }

    fn kill(mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }
}

fn service(path: &Path, recipes: u64) {
    let mut server = Server::start(path);
    let mut stream = Seed::campaign(2).stream("speed");
    let mut body = String::new();
    let mut sent = Duration::ZERO;
    let mut memory = Vec::new();
    for batch in 0..CYCLES / BATCH {
        body.clear();
        (batch * BATCH..(batch + 1) * BATCH).for_each(|i| line(&mut body, &mut stream, i, recipes));
        let start = Instant::now();
        server.post(&body);
        sent += start.elapsed();
        if (batch + 1) % (CYCLES / BATCH / 5) == 0 {
            memory.push(server.resident_mib());
        }
    }
    println!(
        "{recipes} recipes: {:.0} cycles/s in batches of {BATCH}, {:.0} per second of processor time; resident after each fifth of {CYCLES} cycles: {memory:?} MiB",
        CYCLES as f64 / sent.as_secs_f64(),
        CYCLES as f64 / server.processor_s()
    );
    let mut times: Vec<f64> = (CYCLES..CYCLES + SINGLES)
        .map(|i| {
            body.clear();
            line(&mut body, &mut stream, i, recipes);
            // An idle machine, like a cell that sends a cycle now and then.
            std::thread::sleep(Duration::from_millis(1));
            let start = Instant::now();
            server.post(body.trim_end());
            1e3 * start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[(share * (times.len() - 1) as f64) as usize];
    println!("  single POST: median {:.2} ms, p99 {:.2} ms, maximum {:.2} ms", at(0.5), at(0.99), at(1.0));
    server.kill();
    let again = Server::start(path);
    println!("  after kill -9, requests are answered again in {:.2} s", again.opened_s);
    again.kill();
}

/// A cycle with four parameters, on one line.
fn line(text: &mut String, stream: &mut Stream, i: u64, recipes: u64) {
    let success = stream.uniform() < 0.95;
    let mode = if success { "" } else { r#","failure_mode":"grasp_miss""# };
    writeln!(
        text,
        r#"{{"id":"cell-{:02}/{i:08x}","robot":"cell-{:02}","recipe":"part-{:04}","time_s":{},"success":{success}{mode},"drop":false,"collision":false,"cycle_time_s":{:.3},"parameters":{{"mass_kg":{:.3},"friction":{:.3},"com_offset":{:.3},"shape":"box"}}}}"#,
        i % 20,
        i % 20,
        i % recipes,
        1_760_000_000.0 + 0.2 * i as f64,
        stream.between(3.5, 4.5),
        stream.between(0.1, 0.8),
        stream.between(0.2, 1.0),
        stream.between(0.0, 0.4),
    )
    .unwrap();
}
