//! The promises of the switch.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use robogate_trial::{Switch, SwitchSettings};

/// A policy server that repeats its letter without end, or after each byte that it reads.
fn server(letter: u8, streams: bool) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            std::thread::spawn(move || {
                let mut byte = [0];
                while streams || stream.read_exact(&mut byte).is_ok() {
                    if stream.write_all(&[letter; 512]).is_err() {
                        break;
                    }
                }
            });
        }
    });
    address
}

fn any() -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], 0))
}

fn ask(stream: &mut TcpStream) -> std::io::Result<u8> {
    let mut reply = [0; 512];
    stream.write_all(b"?")?;
    stream.read_exact(&mut reply)?;
    Ok(reply[0])
}

#[test]
fn trials_reach_their_policy() {
    let servers = vec![server(b'a', false), server(b'b', false)];
    let switch = Switch::start(any(), servers, SwitchSettings::default(), |fault| panic!("{fault:?}")).unwrap();
    // A robot that connects before the trial waits for it.
    let mut early = TcpStream::connect(switch.address()).unwrap();
    for (trial, arm) in [1, 0, 0, 1].into_iter().enumerate() {
        switch.open(&format!("T{trial}"), arm);
        let mut robot =
            if trial == 0 { early.try_clone().unwrap() } else { TcpStream::connect(switch.address()).unwrap() };
        for _ in 0..20 {
            assert_eq!(ask(&mut robot).unwrap(), b"ab"[arm]);
        }
        let measured = switch.close();
        assert_eq!((measured.connections, measured.replies), (1, 20));
        assert!(measured.reply_ms.is_some() && measured.added_ms >= 0.0);
        assert!(ask(&mut robot).is_err(), "the connection has ended");
    }
    assert!(ask(&mut early).is_err());
}

/// A server sends without end. After Stop, no byte leaves the switch, and it stops within 100 ms, also if the robot does not read.
#[test]
fn nothing_follows_a_stop() {
    let servers = vec![server(b'a', true), server(b'b', true)];
    let switch = Switch::start(any(), servers, SwitchSettings::default(), |fault| panic!("{fault:?}")).unwrap();
    for trial in 0..20 {
        let arm = trial % 2;
        switch.open("T", arm);
        let robot = TcpStream::connect(switch.address()).unwrap();
        let mut reader = robot.try_clone().unwrap();
        let reads = trial % 4 < 2;
        let (sender, receiver) = channel();
        let read = std::thread::spawn(move || {
            let (mut chunk, mut last) = ([0; 4096], None);
            while let Ok(bytes @ 1..) = reader.read(&mut chunk) {
                assert!(chunk[..bytes].iter().all(|byte| *byte == b"ab"[arm]), "only the present policy");
                last = Some(Instant::now());
                let _ = sender.send(());
                if !reads {
                    return None;
                }
            }
            last
        });
        receiver.recv().unwrap();
        let measured = switch.close();
        let closed = Instant::now();
        assert!(measured.cut_ms < 100.0, "{measured:?}");
        assert_eq!(measured.connections, 1);
        if let Some(last) = read.join().unwrap() {
            let after = last.saturating_duration_since(closed);
            assert!(after < Duration::from_millis(100), "{after:?}");
        }
    }
}

#[test]
fn hanging_servers_are_faults() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let silent = listener.local_addr().unwrap();
    let (sender, receiver) = channel();
    let settings = SwitchSettings { reply: Duration::from_millis(200), ..SwitchSettings::default() };
    let report = move |fault| {
        let _ = sender.send(fault);
    };
    let switch = Switch::start(any(), vec![silent], settings, report).unwrap();
    switch.open("HANGS", 0);
    let mut robot = TcpStream::connect(switch.address()).unwrap();
    robot.write_all(b"?").unwrap();
    let fault = receiver.recv_timeout(Duration::from_secs(30)).unwrap();
    assert_eq!(fault.code, "HANGS");
    assert!(fault.reason.contains("did not reply in time"), "{fault:?}");
    assert!(
        robot.read(&mut [0]).is_err_and(|error| error.kind() != std::io::ErrorKind::WouldBlock)
            || robot.read(&mut [0]).is_ok_and(|n| n == 0)
    );
    switch.close();
    drop(listener);
    switch.open("GONE", 0);
    let _robot = TcpStream::connect(switch.address()).unwrap();
    let fault = receiver.recv_timeout(Duration::from_secs(30)).unwrap();
    assert!(fault.code == "GONE" && fault.reason.contains("accepted no connection"), "{fault:?}");
    assert!(Switch::start(any(), vec![silent], settings, |_| {}).is_err(), "found at the start");
}

/// A server that stops in a trial is a fault and not a failure of its policy. A server may close its connection after each reply.
#[test]
fn servers_that_go_away_are_faults() {
    let (sender, receiver) = channel();
    let report = move |fault| {
        let _ = sender.send(fault);
    };
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let switch = Switch::start(any(), vec![listener.local_addr().unwrap()], SwitchSettings::default(), report).unwrap();
    // The connections that measure the distance come first.
    let next = |listener: &TcpListener| loop {
        let (mut server, _) = listener.accept().unwrap();
        let mut byte = [0];
        if server.read(&mut byte).is_ok_and(|n| n == 1) {
            return server;
        }
    };
    let ask = |code: &str| {
        switch.open(code, 0);
        let mut robot = TcpStream::connect(switch.address()).unwrap();
        robot.write_all(b"?").unwrap();
        robot
    };
    let _robot = ask("OWES");
    drop(next(&listener));
    let fault = receiver.recv_timeout(Duration::from_secs(30)).unwrap();
    assert!(fault.code == "OWES" && fault.reason.contains("owed a reply"), "{fault:?}");
    let mut robot = ask("ENDS");
    let mut server = next(&listener);
    server.write_all(b"!").unwrap();
    drop(server);
    let mut replies = Vec::new();
    robot.read_to_end(&mut replies).unwrap();
    assert_eq!((replies.as_slice(), receiver.recv_timeout(Duration::from_millis(300)).ok()), (&b"!"[..], None));
    let mut robot = ask("DIES");
    let mut server = next(&listener);
    server.write_all(b"!").unwrap();
    robot.read_exact(&mut [0]).unwrap();
    drop(listener);
    drop(server);
    let fault = receiver.recv_timeout(Duration::from_secs(30)).unwrap();
    assert!(fault.code == "DIES" && fault.reason.contains("accepts no other one"), "{fault:?}");
}

/// A robot that goes on sending does not hide a server that hangs.
#[test]
fn sending_does_not_extend_the_limit() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let silent = listener.local_addr().unwrap();
    let (sender, receiver) = channel();
    let settings = SwitchSettings { reply: Duration::from_millis(300), ..SwitchSettings::default() };
    let report = move |fault| {
        let _ = sender.send(fault);
    };
    let switch = Switch::start(any(), vec![silent], settings, report).unwrap();
    switch.open("HANGS", 0);
    let mut robot = TcpStream::connect(switch.address()).unwrap();
    let begin = Instant::now();
    let fault = loop {
        // Fails once the switch has ended the connection.
        let _ = robot.write_all(b"?");
        if let Ok(fault) = receiver.recv_timeout(Duration::from_millis(20)) {
            break fault;
        }
        assert!(begin.elapsed() < Duration::from_secs(30), "no fault");
    };
    assert!(fault.code == "HANGS" && fault.reason.contains("did not reply in time"), "{fault:?}");
}

/// The time of a reply begins with the last byte of the request.
#[test]
fn slow_requests_do_not_count_as_slow_replies() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            std::thread::spawn(move || {
                if stream.read_exact(&mut [0; 2]).is_ok() {
                    let _ = stream.write_all(&[b'a'; 512]);
                }
            });
        }
    });
    let switch = Switch::start(any(), vec![address], SwitchSettings::default(), |fault| panic!("{fault:?}")).unwrap();
    switch.open("T", 0);
    let mut robot = TcpStream::connect(switch.address()).unwrap();
    robot.write_all(b"?").unwrap();
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(ask(&mut robot).unwrap(), b'a');
    let measured = switch.close();
    assert!(measured.replies == 1 && measured.reply_ms.unwrap() < 1_500.0, "{measured:?}");
}

/// A robot that gives up and connects again many times before a trial does not use up the places.
#[test]
fn closed_connections_free_their_places() {
    let switch =
        Switch::start(any(), vec![server(b'a', false)], SwitchSettings::default(), |fault| panic!("{fault:?}"))
            .unwrap();
    for _ in 0..200 {
        let mut robot = TcpStream::connect(switch.address()).unwrap();
        // A robot that has sent its handshake.
        let _ = robot.write_all(b"?");
    }
    // A connection without a place ends at once; one with a place waits for the trial.
    let begin = Instant::now();
    let mut waiting = loop {
        let mut robot = TcpStream::connect(switch.address()).unwrap();
        robot.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
        if robot.read(&mut [0]).is_err_and(|error| error.kind() == std::io::ErrorKind::WouldBlock) {
            break robot;
        }
        assert!(begin.elapsed() < Duration::from_secs(60), "no connection has a place");
    };
    switch.open("T", 0);
    waiting.set_read_timeout(None).unwrap();
    assert_eq!(ask(&mut waiting).unwrap(), b'a');
    switch.close();
}
