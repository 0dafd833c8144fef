//! Kills the service with signal 9 during its work, again and again. Acknowledged cycles must be stored exactly once.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use robogate_core::Seed;
use robogate_monitor::service::{HttpSettings, StoreSettings};

use crate::common::{Service, cycle, cycles, intake};

const FOLDER: &str = "ROBOGATE_MONITOR_KILLED";

/// The process that is killed: this test binary, which serves if an environment variable is set.
#[test]
fn child() {
    let Some(path) = std::env::var_os(FOLDER) else { return };
    let service = Service::start(Path::new(&path), HttpSettings::default(), None);
    println!("address {}", service.address);
    loop {
        std::thread::park();
    }
}

fn start(path: &Path) -> (Child, String) {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "killed::child", "--nocapture"])
        .env(FOLDER, path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let address = lines.map(Result::unwrap).find_map(|line| Some(line.split_once("address ")?.1.to_owned())).unwrap();
    (child, address)
}

/// Posts one cycle on an open connection. Returns whether it was acknowledged.
fn acknowledged(stream: &mut BufReader<TcpStream>, body: &str) -> Option<()> {
    let head = format!("POST /v1/cycles HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-length: {}\r\n\r\n", body.len());
    stream.get_mut().write_all((head + body).as_bytes()).ok()?;
    let mut status = String::new();
    stream.read_line(&mut status).ok().filter(|n| *n > 0)?;
    let mut length = 0;
    loop {
        let mut line = String::new();
        stream.read_line(&mut line).ok().filter(|n| *n > 0)?;
        if line == "\r\n" {
            break;
        }
        if let Some(n) = line.to_ascii_lowercase().strip_prefix("content-length: ") {
            length = n.trim().parse().ok()?;
        }
    }
    let mut body = vec![0; length];
    std::io::Read::read_exact(stream, &mut body).ok()?;
    status.contains(" 200 ").then_some(())
}

#[test]
fn kills_lose_and_repeat_no_cycle() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("monitor.db");
    let mut stream = Seed::campaign(1).stream("kills");
    let mut next = 0;
    for _ in 0..20 {
        let (mut child, address) = start(&path);
        // The kill comes at a random moment while a sender is sending.
        let wait = std::time::Duration::from_millis(100 + stream.below(200) as u64);
        let killer = std::thread::spawn(move || {
            std::thread::sleep(wait);
            child.kill().unwrap();
            child.wait().unwrap();
        });
        if let Ok(connection) = TcpStream::connect(&address) {
            let mut connection = BufReader::new(connection);
            // Cycles without acknowledgement are sent again after the kill, as a real sender does.
            while acknowledged(&mut connection, &cycle(next, 0.05)).is_some() {
                next += 1;
            }
        }
        killer.join().unwrap();
    }
    assert!(next > 20, "{next} cycles in twenty runs");
    let survivor = intake(&path, StoreSettings::default());
    let stored: u64 = survivor.monitor().recipes().map(|(_, recipe)| recipe.trials().n()).sum();
    // The last cycle may be stored without an acknowledgement.
    assert!(stored == next || stored == next + 1, "{stored} stored, {next} acknowledged");
    let mut never_killed = intake(&folder.path().join("other.db"), StoreSettings::default());
    never_killed.take(&[cycles(0..stored, 0.05).as_bytes()]).unwrap();
    assert!(never_killed.monitor() == survivor.monitor());
}
