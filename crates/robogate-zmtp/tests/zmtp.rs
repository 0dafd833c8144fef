//! Tests of the sockets with captured bytes of libzmq, with libzmq itself, and with peers that violate the protocol.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use robogate_testing::fuzz::{self, Draw};
use robogate_zmtp::{Address, Decoder, Item, Limits, Replier, Requester, ZmtpError};

mod support;

const LIMITS: Limits = Limits { frames: 17, frame_bytes: 1 << 20, message_bytes: 1 << 21 };
const SECOND: Duration = Duration::from_secs(1);

const REQ: &[u8] = include_bytes!("captures/zmtp-req.bin");
const REP: &[u8] = include_bytes!("captures/zmtp-rep.bin");

fn items(decoder: &mut Decoder) -> Result<Vec<Item>, ZmtpError> {
    let mut items = Vec::new();
    while let Some(item) = decoder.next_item()? {
        items.push(item);
    }
    Ok(items)
}

/// Decode a stream that arrives in pieces of this size.
fn read(stream: &[u8], piece: usize) -> Vec<Item> {
    let mut decoder = Decoder::new(LIMITS);
    let mut all = Vec::new();
    for bytes in stream.chunks(piece) {
        decoder.feed(bytes);
        all.extend(items(&mut decoder).unwrap());
    }
    assert!(!decoder.has_pending());
    all
}

#[test]
fn decoding_does_not_depend_on_pieces() {
    for stream in [REQ, REP] {
        let whole = read(stream, stream.len());
        for piece in [1, 2, 7, 63, 64, 65, 1000] {
            assert_eq!(read(stream, piece), whole);
        }
        assert!(matches!(whole[0], Item::Greeting(greeting) if greeting.version == (3, 1)));
        assert!(matches!(&whole[1], Item::Command(name, _) if name == b"READY"));
    }
}

#[test]
fn captured_messages_have_delimiter_frames() {
    let (questions, answers) = (read(REQ, 4096), read(REP, 4096));
    assert_eq!(questions.len(), answers.len());
    assert_eq!(questions.len(), 14);
    for message in questions.iter().chain(&answers).filter(|item| matches!(item, Item::Message(_))) {
        let Item::Message(frames) = message else { unreachable!() };
        assert_eq!(frames.len(), 2);
        assert!(frames[0].is_empty() && !frames[1].is_empty());
    }
    let Item::Message(first) = &questions[2] else { panic!("{:?}", questions[2]) };
    assert_eq!(first[1], b"\x81\xa8endpoint\xa4ping");
}

#[test]
fn libzmq_answers_requests() {
    let Some(python) = support::python() else { return };
    let script = support::root().join("crates/robogate-zmtp/tests/peers/echo.py");
    let peer = support::Peer::start(&python, &script, &[]);
    let mut requester = Requester::new(peer.first_line.parse().unwrap(), LIMITS);
    let big = vec![7; 300_000];
    for frames in [vec![&b"one"[..]], vec![b"", &big[..255], &big[..256]], vec![&big, b"end"]] {
        let answer = requester.request(&frames, 60 * SECOND).unwrap();
        assert_eq!(answer, frames.iter().rev().map(|frame| frame.to_vec()).collect::<Vec<_>>());
        // libzmq sends heartbeats in the meantime.
        std::thread::sleep(Duration::from_millis(120));
    }
}

/// Run a client while a replier answers with the frames in reverse order.
fn with_replier(client: impl FnOnce(&Address)) {
    let replier = Replier::bind(&"tcp://127.0.0.1:*".parse().unwrap(), LIMITS).unwrap();
    let (address, stop) = (replier.address().clone(), AtomicBool::new(false));
    /// Stops the replier, even if the client panics.
    struct Stop<'a>(&'a AtomicBool);
    impl Drop for Stop<'_> {
        fn drop(&mut self) {
            self.0.store(true, Ordering::Relaxed);
        }
    }
    std::thread::scope(|scope| {
        let stopping = Stop(&stop);
        scope.spawn(|| replier.serve(&stop, &mut |frames| frames.into_iter().rev().collect()));
        client(&address);
        drop(stopping);
    });
}

#[test]
fn libzmq_requests_are_answered() {
    let Some(python) = support::python() else { return };
    let script = support::root().join("crates/robogate-zmtp/tests/peers/ask.py");
    with_replier(|address| {
        let peer = support::Peer::start(&python, &script, &[&address.to_string()]);
        assert_eq!(peer.first_line, "all answered");
    });
}

#[test]
fn parallel_requests_are_answered() {
    with_replier(|address| {
        std::thread::scope(|scope| {
            for i in 0..4_u8 {
                scope.spawn(move || {
                    let mut requester = Requester::new(address.clone(), LIMITS);
                    for j in 0..50_u8 {
                        let answer = requester.request(&[vec![i], vec![j]], 60 * SECOND).unwrap();
                        assert_eq!(answer, [vec![j], vec![i]]);
                    }
                });
            }
        });
    });
}

/// A request that waits while the server stops gets no answer, and the server ends.
#[test]
fn stopped_servers_end_with_requests_left() {
    let replier = Replier::bind(&"tcp://127.0.0.1:*".parse().unwrap(), LIMITS).unwrap();
    let (address, stop) = (replier.address().clone(), AtomicBool::new(false));
    std::thread::scope(|scope| {
        for _ in 0..3 {
            let mut requester = Requester::new(address.clone(), LIMITS);
            scope.spawn(move || requester.request(&[b"x"], 60 * SECOND));
        }
        replier.serve(&stop, &mut |frames| {
            // The other requests arrive meanwhile.
            std::thread::sleep(SECOND / 5);
            stop.store(true, Ordering::Relaxed);
            frames
        });
    });
}

#[test]
fn oversized_messages_close_one_connection() {
    with_replier(|address| {
        let mut greedy = Requester::new(address.clone(), LIMITS);
        let mut modest = Requester::new(address.clone(), LIMITS);
        assert!(modest.request(&[b"x"], 60 * SECOND).is_ok());
        for message in [vec![vec![0_u8; (1 << 20) + 1]], vec![vec![0; 1 << 20]; 3], vec![Vec::new(); 18]] {
            let refused = greedy.request(&message, 60 * SECOND).unwrap_err();
            assert!(matches!(refused, ZmtpError::Closed | ZmtpError::Io(_)), "{refused}");
            assert!(modest.request(&[b"x"], 60 * SECOND).is_ok());
        }
        assert!(greedy.request(&[b"x"], 60 * SECOND).is_ok());
    });
}

/// A peer that sends `bytes` on connection, then waits.
fn peer_that_sends(bytes: Vec<u8>) -> Address {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp://{}", listener.local_addr().unwrap()).parse().unwrap();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        drop(stream.write_all(&bytes));
        drop(stream.read_to_end(&mut Vec::new()));
    });
    address
}

fn greeted(then: &[u8]) -> Vec<u8> {
    // The captured greeting and READY of a REP socket come first.
    let mut bytes = REP[..64 + 27].to_vec();
    bytes.extend_from_slice(then);
    bytes
}

#[test]
fn protocol_errors_are_reported_in_time() {
    let ask_within = |bytes: Vec<u8>, timeout: Duration| {
        let began = Instant::now();
        let mut requester = Requester::new(peer_that_sends(bytes), LIMITS);
        let why = requester.request(&[b"?"], timeout).unwrap_err();
        assert!(began.elapsed() < 20 * SECOND, "{why}");
        why.to_string()
    };
    for silent in [Vec::new(), greeted(b"")] {
        assert!(ask_within(silent, SECOND / 2).contains("no answer within 0.5 s"));
    }
    // All other errors come before the timeout.
    let ask = |bytes: Vec<u8>| ask_within(bytes, 60 * SECOND);
    assert!(ask(b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec()).contains("sent no ZMTP greeting"));
    let mut curve = greeted(b"");
    curve[12..17].copy_from_slice(b"CURVE");
    assert!(ask(curve).contains("the peer requires the security mechanism CURVE"));
    let mut old = greeted(b"");
    old[10] = 1;
    assert!(ask(old).contains("the peer uses version 1"));
    let mut publisher = greeted(b"");
    publisher[64 + 24..].copy_from_slice(b"PUB");
    assert!(ask(publisher).contains("the peer is a PUB socket"));
    assert!(ask(greeted(b"\x02\xff\xff\xff\xff\xff\xff\xff\xff")).contains("at most"));
    assert!(ask(greeted(b"\x00\x02hi")).contains("delimiter frame"));
    assert!(ask(greeted(b"\x08\x00")).contains("flags 0x08"));
    assert!(ask(greeted(b"\x01\x00\x04\x01\x05")).contains("command"));
    assert!(ask(greeted(&b"\x01\x00".repeat(30))).contains("frames"));
}

#[test]
fn unreachable_address_is_an_error() {
    let gone = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut requester = Requester::new(format!("tcp://{gone}").parse().unwrap(), LIMITS);
    let why = requester.request(&[b"?"], SECOND).unwrap_err();
    assert!(why.to_string().starts_with(&format!("cannot reach tcp://{gone}")), "{why}");
}

#[test]
fn late_reply_is_dropped() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp://{}", listener.local_addr().unwrap()).parse().unwrap();
    std::thread::spawn(move || {
        // The first connection is answered late, the second immediately.
        for (wait, answer) in [(400, b"\x01\x00\x00\x04late"), (0, b"\x01\x00\x00\x04good")] {
            let (mut stream, _) = listener.accept().unwrap();
            std::thread::spawn(move || {
                stream.write_all(&greeted(b"")).unwrap();
                std::thread::sleep(Duration::from_millis(wait));
                drop(stream.write_all(answer));
                drop(stream.read_to_end(&mut Vec::new()));
            });
        }
    });
    let mut requester = Requester::new(address, LIMITS);
    assert!(matches!(requester.request(&[b"?"], SECOND / 5), Err(ZmtpError::TimedOut(_))));
    std::thread::sleep(SECOND / 2);
    assert_eq!(requester.request(&[b"?"], 60 * SECOND).unwrap(), [b"good"]);
}

#[test]
fn fuzzed_streams_keep_the_limits() {
    let limits = Limits { frames: 3, frame_bytes: 4096, message_bytes: 8192 };
    let valid = [REQ, REP].map(<[u8]>::to_vec);
    fuzz::Target { name: "zmtp", valid: &valid, kept: &[], words: &[], inputs: 20_000 }.run(|stream| {
        let mut draw = Draw::new("pieces", stream.len() as u64);
        let mut decoder = Decoder::new(limits);
        let mut rest = stream;
        while !rest.is_empty() {
            let (piece, left) = rest.split_at(1 + draw.below(rest.len()));
            decoder.feed(piece);
            rest = left;
            loop {
                match decoder.next_item() {
                    Ok(Some(Item::Message(frames))) => {
                        assert!(frames.len() <= 4 && frames.iter().map(Vec::len).sum::<usize>() <= 8192);
                    }
                    Ok(Some(_)) => {}
                    Ok(None) => break,
                    Err(_) => return false,
                }
            }
        }
        true
    });
}
