//! The HTTP interface: processing of cycles, limits, access control.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use robogate_monitor::service::{HttpSettings, Replays, StoreSettings, serve};
use serde_json::json;

use crate::common::{Service, agent, cycle, cycles, get, intake, post};

fn open() -> (tempfile::TempDir, Service) {
    let folder = tempfile::tempdir().unwrap();
    let service = Service::start(&folder.path().join("monitor.db"), HttpSettings::default(), None);
    (folder, service)
}

#[test]
fn cycles_are_processed_as_documented() {
    let (_folder, service) = open();
    let to = service.address;
    let first = cycle(10, 0.0);
    assert_eq!(post(to, "/v1/cycles", &first, None).1["accepted"], 1);
    // Duplicate: acknowledged and not counted.
    let (status, again) = post(to, "/v1/cycles", &first, None);
    assert_eq!((status, &again["accepted"], &again["duplicates"]), (200, &json!(0), &json!(1)));
    // Contradictory: the same id with another outcome.
    let (status, other) = post(to, "/v1/cycles", &first.replace("true", "false"), None);
    assert_eq!((status, &other["refused"]), (422, &json!(1)));
    assert!(other["refusals"][0]["because"].as_str().unwrap().contains("`c10` is already stored with other content"));
    // Out of order by 12 s, and late by more than an hour: processed nevertheless.
    let (_, early) = post(to, "/v1/cycles", &cycle(7, 0.0), None);
    assert_eq!((&early["accepted"], &early["out_of_order"], &early["late"]), (&json!(1), &json!(1), &json!(0)));
    let late = cycle(4, 0.0).replace("1760000016", "1750000016");
    let (_, late) = post(to, "/v1/cycles", &late, None);
    assert_eq!((&late["accepted"], &late["out_of_order"], &late["late"]), (&json!(1), &json!(1), &json!(1)));
    // Malformed: refused with its line. Its neighbours are accepted.
    let batch = format!("{}\n{{\"id\":\"x\"}}\n\nnonsense\n{}\n", cycle(20, 0.0), cycle(21, 0.0));
    let (status, mixed) = post(to, "/v1/cycles", &batch, None);
    assert_eq!((status, &mixed["accepted"], &mixed["refused"]), (422, &json!(2), &json!(2)));
    assert_eq!((&mixed["refusals"][0]["line"], &mixed["refusals"][1]["line"]), (&json!(2), &json!(4)));
    // An array is equivalent to lines. An empty body is not a batch.
    let array = format!("[{},\n{}]", cycle(30, 0.0), cycle(31, 0.0));
    assert_eq!(post(to, "/v1/cycles", &array, None).1["accepted"], 2);
    assert_eq!(post(to, "/v1/cycles", " \n", None).0, 400);
    let (_, status) = get(to, "/v1/status");
    let status: serde_json::Value = serde_json::from_str(&status).unwrap();
    assert_eq!(status["intake"]["accepted"], 7);
    assert_eq!(status["cycles"].as_array().unwrap().len(), 7);
    service.end();
}

#[test]
fn all_paths_answer() {
    let (_folder, service) = open();
    let to = service.address;
    assert_eq!(post(to, "/v1/cycles", &cycles(0..600, 0.05), None).0, 200);
    assert_eq!(post(to, "/v1/cycles", &cycles(600..1_200, 0.5), None).0, 200);
    let (status, text) = get(to, "/metrics");
    assert_eq!(status, 200);
    assert!(text.contains("robogate_monitor_cycles_total{recipe=\"part-0\"} 600"), "{text}");
    assert!(
        text.contains("robogate_monitor_alarm_standing{recipe=\"part-0\",metric=\"success\",level=\"critical\"} 1")
    );
    // Every sample belongs to a family that was declared before it.
    let families: Vec<&str> = text.lines().filter_map(|l| l.strip_prefix("# TYPE ")?.split(' ').next()).collect();
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let name = line.split(['{', ' ']).next().unwrap();
        assert!(families.contains(&name), "{line}");
        assert!(line.rsplit(' ').next().unwrap().parse::<f64>().is_ok(), "{line}");
    }
    assert_eq!(get(to, "/healthz"), (200, "{\"healthy\":true}".to_owned()));
    let fleet: serde_json::Value = serde_json::from_str(&get(to, "/v1/fleet").1).unwrap();
    assert_eq!(fleet["recipes"][0]["spread"]["robots"], 3);
    assert!(get(to, "/").1.contains("<title>RoboGate monitor</title>"));
    assert!(get(to, "/page.css").1.contains(":root"));
    let page = agent().get(format!("http://{to}/")).call().unwrap();
    let policy = page.headers()["content-security-policy"].to_str().unwrap();
    assert!(policy.contains("script-src 'self'") && !policy.contains("unsafe"), "{policy}");
    assert_eq!(get(to, "/nothing").0, 404);
    assert_eq!(post(to, "/v1/recipes/part-0/restart", "", None).0, 200);
    assert_eq!(post(to, "/v1/recipes/none/restart", "", None).0, 404);
    let after: serde_json::Value = serde_json::from_str(&get(to, "/v1/status").1).unwrap();
    let part = after["recipes"].as_array().unwrap().iter().find(|r| r["recipe"] == "part-0").unwrap();
    assert!(part["detectors"].as_array().unwrap().iter().all(|d| d["standing"].is_null()));
    service.end();
}

#[test]
fn only_local_clients_connect_without_token() {
    let (_folder, service) = open();
    let raw = |head: &str| {
        let mut stream = TcpStream::connect(service.address).unwrap();
        write!(stream, "{head}connection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer.split(' ').nth(1).unwrap().to_owned()
    };
    assert_eq!(raw("GET /v1/status HTTP/1.1\r\nhost: 127.0.0.1\r\n"), "200");
    assert_eq!(raw("GET /v1/status HTTP/1.1\r\nhost: evil.example\r\n"), "403");
    assert_eq!(raw("POST /v1/cycles HTTP/1.1\r\nhost: localhost\r\norigin: http://evil.example\r\n"), "403");
    let anyone = "0.0.0.0:0".parse().unwrap();
    let (_stop, stopped) = tokio::sync::oneshot::channel();
    let refused =
        serve(anyone, None, HttpSettings::default(), service.engine.handle(), None, |_| {}, stopped).unwrap_err();
    assert!(refused.to_string().contains("--token-file"), "{refused}");
    service.end();
}

#[test]
fn token_protects_all_data() {
    let folder = tempfile::tempdir().unwrap();
    let token = "0123456789abcdef";
    let service = Service::start(&folder.path().join("monitor.db"), HttpSettings::default(), Some(token));
    let to = service.address;
    assert_eq!(post(to, "/v1/cycles", &cycle(1, 0.0), None).0, 401);
    assert_eq!(post(to, "/v1/cycles", &cycle(1, 0.0), Some("0123456789abcdeF")).0, 401);
    assert_eq!(post(to, "/v1/cycles", &cycle(1, 0.0), Some(token)).0, 200);
    for (path, status) in
        [("/v1/status", 401), ("/metrics", 401), ("/v1/fleet", 401), ("/", 200), ("/page.css", 200), ("/healthz", 200)]
    {
        assert_eq!(get(to, path).0, status, "{path}");
    }
    service.end();
}

#[test]
fn large_bodies_and_fast_senders_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let http = HttpSettings { most_body_bytes: 2_000, requests_per_s: 1.0, ..HttpSettings::default() };
    let service = Service::start(&folder.path().join("monitor.db"), http, None);
    let to = service.address;
    assert_eq!(post(to, "/v1/cycles", &cycles(0..30, 0.0), None).0, 413);
    let codes: Vec<u16> = (0..30).map(|i| post(to, "/v1/cycles", &cycle(i, 0.0), None).0).collect();
    assert!(codes.contains(&200) && codes.contains(&429), "{codes:?}");
    service.end();
}

#[test]
fn slow_clients_do_not_delay_others() {
    let folder = tempfile::tempdir().unwrap();
    let http = HttpSettings { head_s: 60.0, body_s: 60.0, ..HttpSettings::default() };
    let service = Service::start(&folder.path().join("monitor.db"), http, None);
    let to = service.address;
    let head = "POST /v1/cycles HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-length: 1000\r\n";
    let slow: Vec<TcpStream> = (0..200)
        .map(|i| {
            let mut stream = TcpStream::connect(to).unwrap();
            // Half of them stop within the head, half within the body.
            let part = if i % 2 == 0 { head.to_owned() } else { format!("{head}\r\n{{") };
            stream.write_all(part.as_bytes()).unwrap();
            stream
        })
        .collect();
    let start = Instant::now();
    assert_eq!(post(to, "/v1/cycles", &cycle(1, 0.0), None).0, 200);
    // The slow ones may take 60 s.
    assert!(start.elapsed() < Duration::from_secs(30), "{:?}", start.elapsed());
    drop(slow);
    service.end();
}

#[test]
fn unfinished_heads_time_out() {
    let folder = tempfile::tempdir().unwrap();
    let http = HttpSettings { head_s: 0.3, ..HttpSettings::default() };
    let service = Service::start(&folder.path().join("monitor.db"), http, None);
    let mut stream = TcpStream::connect(service.address).unwrap();
    stream.write_all(b"GET / HTTP/1.1\r\nhost: 127").unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut answer = Vec::new();
    // The connection must be closed, with or without a reply.
    let _ = stream.read_to_end(&mut answer);
    assert!(!String::from_utf8_lossy(&answer).contains("200 OK"));
    service.end();
}

#[test]
fn idle_connections_and_memory_are_bounded() {
    let folder = tempfile::tempdir().unwrap();
    let http = HttpSettings { head_s: 0.3, most_held_bytes: 20_000, ..HttpSettings::default() };
    let service = Service::start(&folder.path().join("monitor.db"), http, None);
    let mut idle = TcpStream::connect(service.address).unwrap();
    idle.write_all(b"GET /healthz HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n").unwrap();
    idle.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut answer = Vec::new();
    let start = Instant::now();
    idle.read_to_end(&mut answer).unwrap();
    assert!(String::from_utf8_lossy(&answer).contains("200 OK") && start.elapsed() < Duration::from_secs(50));
    // Senders that stop in the middle occupy memory. Further senders are asked to retry until those time out.
    let held: Vec<TcpStream> = (0..3)
        .map(|_| {
            let mut stream = TcpStream::connect(service.address).unwrap();
            let head = "POST /v1/cycles HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-length: 9000\r\n\r\n";
            stream.write_all(head.as_bytes()).unwrap();
            stream.write_all(&[b' '; 6_000]).unwrap();
            stream
        })
        .collect();
    let mut refused = 200;
    for _ in 0..50 {
        refused = post(service.address, "/v1/cycles", &(cycle(1, 0.0) + &" ".repeat(6_000)), None).0;
        if refused == 503 {
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(refused, 503);
    drop(held);
    let start = Instant::now();
    while post(service.address, "/v1/cycles", &(cycle(2, 0.0) + &" ".repeat(6_000)), None).0 != 200 {
        assert!(start.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(20));
    }
    service.end();
}

#[test]
fn body_formats_are_equivalent() {
    let folder = tempfile::tempdir().unwrap();
    let of = |name: &str, bodies: &[String]| {
        let service = Service::start(&folder.path().join(name), HttpSettings::default(), None);
        for body in bodies {
            assert_eq!(post(service.address, "/v1/cycles", body, None).0, 200);
        }
        let status = get(service.address, "/v1/status").1;
        service.end();
        serde_json::from_str::<serde_json::Value>(&status).unwrap()["cycles"].clone()
    };
    let lines = cycles(0..5, 0.5);
    let array = format!("[{}]", lines.trim_end().replace('\n', ",\r\n"));
    let documents: Vec<String> = lines.lines().map(|line| line.replace(',', ",\n  ")).collect();
    let wanted = of("lines", std::slice::from_ref(&lines));
    assert_eq!(wanted.as_array().unwrap().len(), 5);
    assert_eq!(of("array", &[array]), wanted);
    assert_eq!(of("documents", &documents), wanted);
}

#[test]
fn service_survives_any_body() {
    let (_folder, service) = open();
    let deep = "[".repeat(100_000);
    let long = format!("{{\"id\":\"{}\"}}", "x".repeat(1_000_000));
    let huge = cycle(1, 0.0).replace("1760000004", "1e999");
    for body in ["null", "[]", "[null]", "{", "\"\u{0}\"", "1e9", "[1,2]", "\u{feff}{}", &deep, &long, &huge] {
        let (status, answer) = post(service.address, "/v1/cycles", body, None);
        assert!(status == 422 || status == 400, "{status} {answer} for {}", &body[..body.len().min(30)]);
    }
    assert_eq!(post(service.address, "/v1/cycles", &cycle(1, 0.0), None).0, 200);
    service.end();
}

/// A body of short malformed lines used to occupy the only thread for seconds.
#[test]
fn malformed_bodies_do_not_delay_others() {
    let (_folder, service) = open();
    let to = service.address;
    let hostile = "x\n".repeat(8 << 20);
    let attackers: Vec<_> = (0..4)
        .map(|_| {
            let hostile = hostile.clone();
            std::thread::spawn(move || post(to, "/v1/cycles", &hostile, None).0)
        })
        .collect();
    let mut slowest = Duration::ZERO;
    for i in 0..20 {
        let begun = Instant::now();
        assert_eq!(post(to, "/v1/cycles", &cycle(i, 0.0), None).0, 200);
        assert_eq!(get(to, "/healthz").0, 200);
        slowest = slowest.max(begun.elapsed());
        std::thread::sleep(Duration::from_millis(20));
    }
    for attacker in attackers {
        assert_eq!(attacker.join().unwrap(), 413, "too many lines");
    }
    println!("slowest pair of requests beside four bodies of 16 MiB: {slowest:?}");
    // Only a hang takes so long. Unit tests of `batch` bound the work on a body.
    assert!(slowest < Duration::from_secs(60), "{slowest:?}");
    // Fewer lines: all are refused, and the first are listed.
    let (status, reply) = post(to, "/v1/cycles", &"x\n".repeat(30_000), None);
    assert_eq!((status, &reply["refused"]), (422, &json!(30_000)));
    assert_eq!(reply["refusals"].as_array().unwrap().len(), 100);
    service.end();
}

/// An alarm about malformed lines ends with good ones, so that it does not hide the next.
#[test]
fn alarms_about_malformed_lines_are_cleared() {
    let (_folder, service) = open();
    let to = service.address;
    assert_eq!(post(to, "/v1/cycles", "nonsense\n", None).0, 422);
    assert_eq!(post(to, "/v1/cycles", &cycles(0..1_000, 0.05), None).0, 200);
    assert_eq!(post(to, "/v1/cycles", "nonsense\n", None).0, 422);
    let alarms = service.engine.handle().status().unwrap().alarms;
    let of_sender = alarms.iter().rev().filter(|alarm| alarm["metric"] == "sender");
    let happenings: Vec<&str> = of_sender.map(|alarm| alarm["happening"].as_str().unwrap()).collect();
    assert_eq!(happenings, ["raised", "cleared", "raised"]);
    service.end();
}

/// Each new connection takes the place of the unfinished head that has waited longest.
#[test]
fn unfinished_heads_lock_nobody_out() {
    let folder = tempfile::tempdir().unwrap();
    let settings = HttpSettings { most_connections: 64, most_connections_per_address: 32, ..HttpSettings::default() };
    let service = Service::start(&folder.path().join("monitor.db"), settings, None);
    let heads: Vec<TcpStream> = (0..200)
        .map(|_| {
            let mut stream = TcpStream::connect(service.address).unwrap();
            stream.write_all(b"POST /v1/cycles HTTP/1.1\r\nhost: ").unwrap();
            stream
        })
        .collect();
    for i in 0..20 {
        assert_eq!(post(service.address, "/v1/cycles", &cycle(i, 0.0), None).0, 200);
        assert_eq!(get(service.address, "/healthz").0, 200);
    }
    drop(heads);
    service.end();
}

#[test]
fn one_episode_is_recomputed_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let (begun, starts) = channel();
    let (finish, ends) = channel::<()>();
    let ends = Mutex::new(ends);
    let recompute = move |run: usize, index: u64| {
        if index == 9 {
            return Err("the run has no episode 9".to_owned());
        }
        begun.send(()).unwrap();
        ends.lock().unwrap().recv().unwrap();
        Ok(json!({ "run": run, "index": index }).to_string().into_bytes())
    };
    let replays = Replays::new("<p>replay".to_owned(), "default-src 'none'".to_owned(), Arc::new(recompute));
    let service = Service::replaying(
        intake(&folder.path().join("monitor.db"), StoreSettings::default()),
        HttpSettings::default(),
        None,
        Some(replays),
        |_| {},
    );
    let to = service.address;
    let first = std::thread::spawn(move || get(to, "/v1/replay?run=1&index=3"));
    starts.recv().unwrap();
    // Meanwhile a second one is asked to come again, and cycles are received.
    assert_eq!(get(to, "/v1/replay?run=1&index=4").0, 503);
    assert_eq!(post(to, "/v1/cycles", &cycle(1, 0.0), None).0, 200);
    finish.send(()).unwrap();
    assert_eq!(first.join().unwrap(), (200, "{\"index\":3,\"run\":1}".to_owned()));
    assert_eq!(get(to, "/v1/replay?run=0&index=9"), (404, "{\"error\":\"the run has no episode 9\"}".to_owned()));
    for path in ["/v1/replay", "/v1/replay?run=0", "/v1/replay?run=-1&index=0", "/v1/replay?run=0&index=x"] {
        assert_eq!(get(to, path).0, 400, "{path}");
    }
    let page = agent().get(format!("http://{to}/replay")).call().unwrap();
    assert_eq!(page.headers()["content-security-policy"], "default-src 'none'");
    assert_eq!(post(to, "/replay", "", None).0, 405);
    service.end();
    // Without episodes, there is no such page.
    let (_folder, service) = open();
    assert_eq!([get(service.address, "/replay").0, get(service.address, "/v1/replay?run=0&index=0").0], [404, 404]);
    service.end();
}

/// A client that invents names uses up its own share of the recipes only.
#[test]
fn new_recipes_of_a_client_are_limited() {
    let folder = tempfile::tempdir().unwrap();
    let intake = intake(&folder.path().join("monitor.db"), StoreSettings::default()).with_new_recipes_per_hour(20);
    let service = Service::with(intake, HttpSettings::default(), None, |_| {});
    let named = |n: u32, recipe: &str| {
        json!({ "id": format!("c{n}"), "robot": "a", "recipe": recipe, "time_s": 1_760_000_000 + n, "success": true })
            .to_string()
    };
    let invented: String = (0..1_000).map(|n| named(n, &format!("invented-{n}")) + "\n").collect();
    let (status, taken) = post(service.address, "/v1/cycles", &invented, None);
    assert_eq!((status, &taken["accepted"], &taken["refused"]), (422, &json!(20), &json!(980)));
    assert!(taken["refusals"][0]["because"].as_str().unwrap().contains("may add 20 recipes in an hour"), "{taken}");
    // Known recipes are accepted as before, and the lines of the user's own feed are not limited.
    assert_eq!(post(service.address, "/v1/cycles", &named(2_000, "invented-3"), None).1["accepted"], 1);
    let own = service.engine.handle().take(named(3_000, "bracket").into_bytes()).unwrap();
    assert_eq!((own.accepted, own.refused), (1, 0));
    let (_, status) = get(service.address, "/v1/status");
    let status: serde_json::Value = serde_json::from_str(&status).unwrap();
    assert!(status["alarms"].as_array().unwrap().iter().any(|alarm| alarm["metric"] == "sender"), "{status}");
    service.end();
}
