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

/// A receiver that fails for every fifth request gets every alarm, in order, without falling behind.
#[test]
fn flaky_receivers_get_all_alarms() {
    use std::sync::mpsc::channel;
    use std::time::{Duration, Instant};

    use robogate_monitor::service::OutputError;

    let folder = tempfile::tempdir().unwrap();
    let engine = ServiceEngine::open(intake(&folder.path().join("monitor.db"), StoreSettings::default()), |_| {});
    let (sender, received) = channel();
    let mut calls = 0_u32;
    let flaky = Box::new(move |alarm: &str| {
        calls += 1;
        if calls.is_multiple_of(5) {
            return Err(OutputError("500".to_owned()));
        }
        sender.send(alarm.to_owned()).map_err(|error| OutputError(error.to_string()))
    });
    let output = Output::start("flaky".to_owned(), engine.handle(), flaky, |_| {}).unwrap();
    // Each recipe that degrades raises several alarms.
    for recipe in 0..40 {
        let text = cycles(0..600, 0.05) + &cycles(600..900, 0.6);
        let text =
            text.replace("part-0", &format!("part-{recipe}-0")).replace("\"id\":\"c", &format!("\"id\":\"r{recipe}c"));
        let taken = engine.handle().take(text.into_bytes()).unwrap();
        assert_eq!((taken.refused, taken.duplicates), (0, 0), "{taken:?}");
    }
    let raised = engine.handle().status().unwrap().alarms.len();
    let begun = Instant::now();
    let mut got = Vec::new();
    while got.len() < raised {
        let alarm = received.recv_timeout(Duration::from_secs(60));
        got.push(alarm.unwrap_or_else(|_| panic!("{} of {raised}", got.len())));
    }
    let seconds = begun.elapsed().as_secs_f64();
    println!("{} alarms in {seconds:.1} s", got.len());
    output.end();
    got.extend(received.try_iter());
    assert!(got.len() >= raised.max(40), "{} of {raised}", got.len());
    let unique: std::collections::BTreeSet<&String> = got.iter().collect();
    assert_eq!(unique.len(), got.len(), "no alarm is delivered twice");
    assert!(seconds < 60.0);
    engine.close().unwrap();
}
