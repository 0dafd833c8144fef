//! Each alarm is delivered in order, even if the receiver fails at first.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;

use robogate_monitor::service::{Output, ServiceEngine, StoreSettings, otlp, webhook};

use crate::common::{cycles, intake};

/// Answers one request with each of these statuses and bodies. Returns what was sent, with the path of each request.
fn receive(listener: &TcpListener, answers: &[(&str, &str)]) -> Vec<(String, serde_json::Value)> {
    let mut got = Vec::new();
    for (stream, (code, text)) in listener.incoming().zip(answers) {
        let mut stream = BufReader::new(stream.unwrap());
        let (mut length, mut path) = (0, String::new());
        loop {
            let mut line = String::new();
            stream.read_line(&mut line).unwrap();
            if line == "\r\n" {
                break;
            }
            if let Some(rest) = line.strip_prefix("POST ") {
                path = rest.split(' ').next().unwrap().to_owned();
            }
            if let Some(n) = line.to_ascii_lowercase().strip_prefix("content-length: ") {
                length = n.trim().parse().unwrap();
            }
        }
        let mut body = vec![0; length];
        stream.read_exact(&mut body).unwrap();
        let length = text.len();
        write!(stream.get_mut(), "HTTP/1.1 {code}\r\nconnection: close\r\ncontent-length: {length}\r\n\r\n{text}")
            .unwrap();
        got.push((path, serde_json::from_slice(&body).unwrap()));
    }
    got
}

#[test]
fn webhooks_receive_alarms_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let source = intake(&folder.path().join("monitor.db"), StoreSettings::default());
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/hook", listener.local_addr().unwrap());
    let good = ("204 No Content", "");
    let receiver =
        std::thread::spawn(move || receive(&listener, &[("503 Service Unavailable", ""), good, good, good, good]));
    let engine = ServiceEngine::open(source, |_| {});
    let output = Output::start("webhook".to_owned(), engine.handle(), webhook(url), |_| {}).unwrap();
    engine.handle().take((cycles(0..600, 0.05) + &cycles(600..900, 0.6)).into_bytes()).unwrap();
    let got: Vec<_> = receiver.join().unwrap().into_iter().skip(1).map(|(_, alarm)| alarm).collect();
    output.end();
    let alarms = engine.handle().status().unwrap().alarms;
    let first: Vec<_> = alarms.iter().rev().take(4).cloned().collect();
    assert_eq!(got, first);
    engine.close().unwrap();
}

#[test]
fn collectors_receive_alarms_as_logs() {
    let folder = tempfile::tempdir().unwrap();
    let source = intake(&folder.path().join("monitor.db"), StoreSettings::default());
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/", listener.local_addr().unwrap());
    // An answer of 503 is tried again. A refusal is final, and reported.
    let answers = [
        ("503 Service Unavailable", ""),
        ("200 OK", "{\"partialSuccess\":{}}"),
        ("400 Bad Request", "no logs here"),
        ("200 OK", "{\"partialSuccess\":{\"rejectedLogRecords\":\"1\",\"errorMessage\":\"too old\"}}"),
        ("200 OK", ""),
    ];
    let receiver = std::thread::spawn(move || receive(&listener, &answers));
    let engine = ServiceEngine::open(source, |_| {});
    let (sender, problems) = std::sync::mpsc::channel();
    let deliver = otlp(&url, move |problem: &str| sender.send(problem.to_owned()).unwrap());
    let output = Output::start("otlp".to_owned(), engine.handle(), deliver, |_| {}).unwrap();
    engine.handle().take((cycles(0..600, 0.05) + &cycles(600..900, 0.6)).into_bytes()).unwrap();
    let got = receiver.join().unwrap();
    output.end();
    assert!(got.iter().all(|(path, _)| path == "/v1/logs"));
    assert_eq!(got[0], got[1]);
    let alarms = engine.handle().status().unwrap().alarms;
    for ((_, request), alarm) in got[1..].iter().zip(alarms.iter().rev()) {
        let resource = &request["resourceLogs"][0];
        assert_eq!(resource["resource"]["attributes"][0]["value"]["stringValue"], "robogate-monitor");
        let log = &resource["scopeLogs"][0]["logRecords"][0];
        assert_eq!(log["body"]["stringValue"], alarm["what"]);
        assert_eq!(log["severityNumber"], if alarm["level"] == "warning" { 13 } else { 17 });
        let seconds = log["timeUnixNano"].as_str().unwrap().parse::<f64>().unwrap() * 1e-9;
        assert!((seconds - alarm["time_s"].as_f64().unwrap()).abs() < 1e-3, "{log}");
        assert_eq!(log["attributes"][0]["value"]["stringValue"], alarm["id"]);
    }
    let problems: Vec<String> = problems.try_iter().collect();
    assert!(problems[0].contains("no logs here") && problems[1].contains("too old"), "{problems:?}");
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
