//! Tests with GR00T, REST and LeRobot servers that answer with captured bytes.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "support/direct.rs"]
mod direct;
mod support;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::thread;

use direct::direct;
use robogate_core::{Action, Command, FaultKind, Policy};
use robogate_policy::{ExternalPolicy, Profile};
use robogate_zmtp::{Limits, Replier};
use support::{begin, observation};

fn captured(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures").join(name)).unwrap()
}

fn policy(url: &str, name: &str, change: impl Fn(String) -> String) -> ExternalPolicy {
    let text = change(Profile::built_in(name).unwrap().to_owned());
    ExternalPolicy::connect(url, Arc::new(Profile::from_toml(&text).unwrap())).unwrap()
}

fn unchanged(text: String) -> String {
    text
}

/// Starts a REP socket whose replies depend on the endpoint and the bytes of a request.
fn zeromq(answer: impl Fn(&str, &[u8]) -> Vec<u8> + Send + 'static) -> String {
    let limits = Limits { frames: 4, frame_bytes: 1 << 20, message_bytes: 1 << 20 };
    let replier = Replier::bind(&"tcp://127.0.0.1:0".parse().unwrap(), limits).unwrap();
    let url = replier.address().to_string();
    thread::spawn(move || {
        replier.serve(&AtomicBool::new(false), &mut |frames| {
            let value = rmpv::decode::read_value(&mut &*frames[0]).unwrap();
            vec![answer(value["endpoint"].as_str().unwrap(), &frames[0])]
        });
    });
    url
}

#[test]
fn gr00t_layout_is_detected() {
    let url = zeromq(|endpoint, request| {
        let file = match endpoint {
            "ping" => "00_ping.rep.bin",
            "get_modality_config" => "01_get_modality_config.rep.bin",
            "reset" => "02_reset.rep.bin",
            // The simulation wrapper accepts flat keys and rejects nested ones.
            _ if request.windows(11).any(|bytes| bytes == b"video.image") => "03_get_action.rep.bin",
            _ => "06_err_other_layout.rep.bin",
        };
        captured(&format!("gr00t_n16/libero_panda_sim/{file}"))
    });
    let mut policy = policy(&url, "gr00t-n1.6-libero", unchanged);
    assert_eq!(policy.declared()["action"]["delta_indices"][15], 15);
    begin(&mut policy, "pick up the black bowl").unwrap();
    for step in 0..9 {
        assert_eq!(policy.wants_images(), step % 8 == 0);
        let action = policy.act(&observation(256)).unwrap();
        assert!(matches!(action.command, Command::ToolDelta { .. }));
    }
}

/// An HTTP server with one reply for each path. It records the requested paths.
fn http(answer: impl Fn(&str) -> (u16, Vec<u8>) + Send + 'static) -> (String, Arc<Mutex<Vec<String>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let paths = Arc::new(Mutex::new(Vec::new()));
    let recorded = Arc::clone(&paths);
    thread::spawn(move || {
        for stream in listener.incoming() {
            drop(serve(stream.unwrap(), &answer, &recorded));
        }
    });
    (url, paths)
}

fn serve(
    mut stream: TcpStream,
    answer: &impl Fn(&str) -> (u16, Vec<u8>),
    recorded: &Mutex<Vec<String>>,
) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream.try_clone()?);
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line)? == 0 {
            return Ok(());
        }
        let path = line.split(' ').nth(1).unwrap_or_default().to_owned();
        let mut length = 0;
        loop {
            let mut header = String::new();
            reader.read_line(&mut header)?;
            if let Some(n) = header.to_lowercase().strip_prefix("content-length:") {
                length = n.trim().parse().unwrap();
            }
            if header.trim().is_empty() {
                break;
            }
        }
        reader.read_exact(&mut vec![0; length])?;
        recorded.lock().unwrap().push(path.clone());
        let (status, body) = answer(&path);
        write!(stream, "HTTP/1.1 {status} X\r\nContent-Length: {}\r\n\r\n", body.len())?;
        stream.write_all(&body)?;
    }
}

#[test]
fn octo_servers_are_reset_each_episode() {
    let (url, paths) = http(|path| match path {
        "/health" => (200, br#"{"status":"healthy"}"#.to_vec()),
        "/reset" => (200, br#"{"status":"reset successful"}"#.to_vec()),
        _ => (200, captured("openvla/ok.rep.body")),
    });
    let mut policy = policy(&url, "octo-small", unchanged);
    for _ in 0..2 {
        begin(&mut policy, "pick up the box").unwrap();
        // Five actions per second: each is executed over four control periods of 0.05 s.
        for _ in 0..8 {
            // The captured gripper value is 0.996: open.
            assert_eq!(policy.act(&observation(256)).unwrap().gripper, Some(Action::OPEN));
        }
    }
    let paths = paths.lock().unwrap();
    assert_eq!(*paths, ["/health", "/reset", "/act", "/act", "/reset", "/act", "/act"]);
}

#[test]
fn other_http_replies_are_explained() {
    let refused = |reply: &'static str| {
        let (url, _) = http(move |path| match path {
            "/act" => (200, reply.as_bytes().to_vec()),
            _ => (200, br#"{"status":"healthy"}"#.to_vec()),
        });
        let mut policy = policy(&url, "octo-small", unchanged);
        begin(&mut policy, "pick up the box").unwrap();
        policy.act(&observation(256)).unwrap_err()
    };
    for (reply, part) in [
        (
            r#"{"action_chunk": [[0]], "ms": 3}"#,
            "a map with `actions` or `action`, got `{\"action_chunk\": [[0]], \"ms\": 3}`",
        ),
        (r#"{"error": "KeyError: 'image'"}"#, "policy error: KeyError: 'image'"),
        (r#""[[0, 1]]""#, "expected actions, got the text `\"[[0, 1]]\"`"),
        (r#"{"actions": "k05VTVBZ"}"#, "expected a list of numbers, or a map with `__numpy__`"),
        ("<html>It works</html>", "not valid JSON: expected value at line 1 column 1, in `<html>It works</html>`"),
        (
            r#"{"__numpy__": "AAA=", "dtype": ">f2", "shape": [1]}"#,
            "unsupported array type `>f2`. Expected one of: |b1",
        ),
    ] {
        let fault = refused(reply);
        assert!(fault.detail.contains(part), "{}", fault.detail);
    }
    for reply in ["[0, 0, NaN, 0, 0, 0, 1]", "[0, 0, null, 0, 0, 0, 1]"] {
        let fault = refused(reply);
        assert_eq!(fault.detail, "not finite: number 2 of action 0 is NaN");
        assert_eq!(fault.kind, FaultKind::BadAction);
    }
}

#[test]
fn other_health_replies_are_explained() {
    for (status, body, shown) in [(200, "{\"status\":\"ok\"}", "`{\"status\":\"ok\"}`"), (404, "", "an empty reply")] {
        let (url, _) = http(move |path| (if path == "/health" { status } else { 404 }, body.as_bytes().to_vec()));
        let profile = Profile::from_toml(Profile::built_in("octo-small").unwrap()).unwrap();
        let error = ExternalPolicy::connect(&url, Arc::new(profile)).unwrap_err().to_string();
        let expected = "Expected HTTP 200 with {\"status\": \"healthy\"}";
        assert!(error.contains(&format!("HTTP {status} with {shown}. {expected}")), "{error}");
    }
}

#[test]
fn openvla_errors_with_status_200_are_faults() {
    let (url, _) = http(|path| match path {
        "/openapi.json" => (200, br#"{"paths":{"/act":{}}}"#.to_vec()),
        _ => (200, br#""error""#.to_vec()),
    });
    let mut policy = policy(&url, "openvla", unchanged);
    begin(&mut policy, "pick up the box").unwrap();
    let fault = policy.act(&observation(256)).unwrap_err();
    assert!(fault.detail.starts_with("policy error: "), "{}", fault.detail);
}

/// Starts a gRPC server with LeRobot's four methods. It answers GetActions with this pickle.
fn grpc(actions: Vec<u8>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("grpc://{}", listener.local_addr().unwrap());
    listener.set_nonblocking(true).unwrap();
    thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener).unwrap();
            while let Ok((stream, _)) = listener.accept().await {
                let mut connection = h2::server::handshake(stream).await.unwrap();
                while let Some(Ok((request, mut respond))) = connection.accept().await {
                    let message =
                        if request.uri().path().ends_with("/GetActions") { field(&actions) } else { Vec::new() };
                    let mut framed = vec![0];
                    framed.extend(u32::try_from(message.len()).unwrap().to_be_bytes());
                    framed.extend(message);
                    let head = http::Response::builder().header("content-type", "application/grpc").body(()).unwrap();
                    let mut body = respond.send_response(head, false).unwrap();
                    body.send_data(framed.into(), false).unwrap();
                    let mut trailers = http::HeaderMap::new();
                    trailers.insert("grpc-status", "0".parse().unwrap());
                    body.send_trailers(trailers).unwrap();
                    // Read the rest of the request.
                    let mut request = request.into_body();
                    tokio::spawn(async move {
                        while let Some(Ok(part)) = request.data().await {
                            request.flow_control().release_capacity(part.len()).unwrap();
                        }
                    });
                }
            }
        });
    });
    url
}

/// A protobuf message with a bytes field of number 1.
fn field(bytes: &[u8]) -> Vec<u8> {
    if bytes.is_empty() {
        return Vec::new();
    }
    let length = bytes.len();
    [&[0x0a, (length & 0x7f) as u8 | 0x80, (length >> 7) as u8][..], bytes].concat()
}

fn five(text: String) -> String {
    direct(&text).replace("length = 50", "length = 5").replace("execute = 10", "execute = 5")
}

#[test]
fn lerobot_episodes_execute_tensors() {
    let mut policy = policy(&grpc(captured("lerobot/actions.pickle")), "smolvla", five);
    begin(&mut policy, "pick up the black bowl").unwrap();
    let Command::ToolDelta { translation_m, .. } = policy.act(&observation(256)).unwrap().command else { panic!() };
    assert!((translation_m[0] - 0.785_620_927_810_669 * 0.02).abs() < 1e-12);
}

#[test]
fn hostile_pickles_are_faults() {
    // `pickle.dumps` of an object whose __reduce__ calls os.system.
    let hostile = b"\x80\x04\x95\x2d\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x94\x8c\x06system\x94\x93\x94\x8c\x12touch hostile-here\x94\x85\x94R\x94.";
    for (actions, start) in
        [(hostile.to_vec(), "invalid reply: "), (Vec::new(), "policy error: the server sent no actions")]
    {
        let mut policy = policy(&grpc(actions), "smolvla", five);
        begin(&mut policy, "pick up the box").unwrap();
        let fault = policy.act(&observation(256)).unwrap_err();
        assert!(fault.detail.starts_with(start), "{}", fault.detail);
    }
    assert!(!Path::new("hostile-here").exists());
}
