//! Each alarm is delivered in order, even if the receiver fails at first.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;

use robogate_monitor::service::{Output, ServiceEngine, StoreSettings, webhook};

use crate::common::{cycles, intake};

#[test]
fn webhooks_receive_alarms_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let source = intake(&folder.path().join("monitor.db"), StoreSettings::default());
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/hook", listener.local_addr().unwrap());
    let receiver = std::thread::spawn(move || {
        let mut got: Vec<serde_json::Value> = Vec::new();
        for (i, stream) in listener.incoming().enumerate() {
            let mut stream = BufReader::new(stream.unwrap());
            let mut length = 0;
            loop {
                let mut line = String::new();
                stream.read_line(&mut line).unwrap();
                if line == "\r\n" {
                    break;
                }
                if let Some(n) = line.to_ascii_lowercase().strip_prefix("content-length: ") {
                    length = n.trim().parse().unwrap();
                }
            }
            let mut body = vec![0; length];
            stream.read_exact(&mut body).unwrap();
            let code = if i == 0 { "503 Service Unavailable" } else { "204 No Content" };
            write!(stream.get_mut(), "HTTP/1.1 {code}\r\nconnection: close\r\ncontent-length: 0\r\n\r\n").unwrap();
            if i > 0 {
                got.push(serde_json::from_slice(&body).unwrap());
            }
            if got.len() == 4 {
                return got;
            }
        }
        got
    });
    let engine = ServiceEngine::open(source, |_| {});
    let output = Output::start("webhook".to_owned(), engine.handle(), webhook(url), |_| {}).unwrap();
    engine.handle().take((cycles(0..600, 0.05) + &cycles(600..900, 0.6)).into_bytes()).unwrap();
    let got = receiver.join().unwrap();
    output.end();
    let alarms = engine.handle().status().unwrap().alarms;
    let first: Vec<_> = alarms.iter().rev().take(4).cloned().collect();
    assert_eq!(got, first);
    engine.close().unwrap();
}
