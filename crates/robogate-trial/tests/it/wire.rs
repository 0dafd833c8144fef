//! What reaches the operator's page.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;

use robogate_trial::{Folder, Question, Secret, Service, serve};

use crate::plan;

const TOKEN: &str = "0123456789abcdef0123456789abcdef";
const SCRIPT: &str = "fedcba9876543210fedcba9876543210";

/// Sends a request and returns the whole reply.
fn send(address: SocketAddr, token: &str, request: &str, body: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    let head = format!(
        "{request} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    let mut reply = String::new();
    stream.read_to_string(&mut reply).unwrap();
    reply
}

/// The whole study by HTTP. No byte of the replies names a policy, its digest, the secret or an address.
#[test]
fn replies_identify_no_policy() {
    let dir = tempfile::tempdir().unwrap();
    let secret = Secret::draw().unwrap();
    let mut plan = plan(Question::Better, &["alpha-policy", "beta-policy"], 20, &secret);
    plan.arms[0].sha256 = Some("ab12".repeat(16));
    Folder::create(dir.path(), &plan, &secret).unwrap();
    let service = Arc::new(Service::new(Folder::open(dir.path()).unwrap(), None, TOKEN.to_owned(), SCRIPT.to_owned()));
    let (stop, stopped) = tokio::sync::oneshot::channel();
    let (sender, receiver) = std::sync::mpsc::channel();
    let server = std::thread::spawn(move || {
        let listening = move |address| sender.send(address).unwrap();
        serve(SocketAddr::from(([127, 0, 0, 1], 0)), service, listening, stopped).unwrap();
    });
    let address = receiver.recv().unwrap();
    let mut wire = String::new();
    let mut told = std::collections::BTreeSet::new();
    for path in ["/", "/page.js", "/page.css"] {
        wire += &send(address, "", &format!("GET {path}"), "");
    }
    assert!(wire.matches("HTTP/1.1 200").count() == 3 && wire.contains("default-src 'none'"));
    for trial in 0..40 {
        let state = send(address, TOKEN, "GET /v1/state", "");
        let document: serde_json::Value = serde_json::from_str(state.split("\r\n\r\n").nth(1).unwrap()).unwrap();
        wire += &state;
        if document["phase"] == "finished" {
            break;
        }
        let code = document["code"].as_str().unwrap();
        for (step, rest) in [
            "\"do\":\"start\",\"operator\":\"Ada\"",
            "\"do\":\"stop\"",
            "\"do\":\"result\",\"result\":{\"success\":true}",
        ]
        .into_iter()
        .enumerate()
        {
            let body = format!("{{\"id\":\"{trial}-{step}\",\"code\":\"{code}\",{rest}}}");
            let reply = send(address, TOKEN, "POST /v1/do", &body);
            assert!(reply.starts_with("HTTP/1.1 200"), "{reply}");
            wire += &reply;
            if step == 0 {
                let reply = send(address, SCRIPT, "GET /v1/policy", "");
                told.insert(reply.split("\r\n\r\n").nth(1).unwrap().to_owned());
            }
        }
        wire += &send(
            address,
            TOKEN,
            "POST /v1/do",
            &format!("{{\"id\":\"x\",\"do\":\"start\",\"code\":\"{code}\",\"operator\":\"Ada\"}}"),
        );
    }
    assert!(wire.contains("already has a result"), "a second start is refused");
    assert_eq!(told.len(), 2, "the script is told both: {told:?}");
    for other in ["", SCRIPT, "0123456789abcdef0123456789abcdee"] {
        assert!(send(address, other, "GET /v1/state", "").starts_with("HTTP/1.1 401"));
    }
    assert!(send(address, TOKEN, "GET /v1/policy", "").starts_with("HTTP/1.1 401"));
    assert!(send(address, TOKEN, "POST /v1/do", &"x".repeat(70_000)).starts_with("HTTP/1.1 413"));
    let hidden = ["alpha", "beta-", "ab12ab12", &secret.sha256(), &plan.sha256(), dir.path().to_str().unwrap()];
    for text in hidden {
        assert!(!wire.contains(text), "{text} is on the wire");
    }
    drop(stop);
    server.join().unwrap();
    assert_eq!(
        Folder::read(dir.path()).unwrap().attempts().iter().filter(|attempt| attempt.told).count(),
        told_of(dir.path())
    );
}

/// Started trials, all of which were told to the script.
fn told_of(folder: &std::path::Path) -> usize {
    Folder::read(folder).unwrap().attempts().len()
}
