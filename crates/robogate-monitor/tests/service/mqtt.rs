//! Tests with a real broker, mosquitto. They are skipped if it is not installed.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use robogate_monitor::service::{Broker, Output, ServiceEngine, StoreSettings};
use rumqttc::{Client, Event, MqttOptions, Packet, QoS};

use crate::common::{cycle, cycles, intake};
use crate::warnings::{detector, episode};

/// A mosquitto process on a free port. It is stopped on drop.
struct Mosquitto {
    program: PathBuf,
    process: Child,
    port: u16,
    folder: tempfile::TempDir,
}

impl Mosquitto {
    fn start() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        // Sessions survive a restart. The broker runs as its own user, independent of who started it.
        let settings = format!(
            "listener {port} 127.0.0.1\nallow_anonymous true\npersistence true\npersistence_location {}/\nuser root\n\
             autosave_interval 1\nautosave_on_changes true\nmax_queued_messages 0\n",
            folder.path().display()
        );
        std::fs::write(folder.path().join("mosquitto.conf"), settings).unwrap();
        let program = robogate_testing::program("mosquitto")?;
        let process = Self::run(&program, &folder);
        let broker = Self { program, process, port, folder };
        broker.wait();
        Some(broker)
    }

    fn run(program: &Path, folder: &tempfile::TempDir) -> Child {
        let mut command = Command::new(program);
        command.arg("-c").arg(folder.path().join("mosquitto.conf"));
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    }

    fn wait(&self) {
        until("the broker listens", || std::net::TcpStream::connect(("127.0.0.1", self.port)).is_ok());
    }

    /// Kills the broker and starts it again on the same port.
    fn restart(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
        self.process = Self::run(&self.program, &self.folder);
        self.wait();
    }

    fn broker(&self) -> Broker {
        Broker { host: "127.0.0.1".to_owned(), port: self.port, client: "robogate".to_owned(), login: None }
    }

    fn publish(&self, payload: &str) {
        self.publish_on("cell/cycles", payload);
    }

    /// Publishes a message, and waits until the broker has it.
    fn publish_on(&self, topic: &str, payload: &str) {
        let mut options = MqttOptions::new("sender", "127.0.0.1", self.port);
        options.set_max_packet_size(1 << 20, 1 << 20);
        let (client, mut connection) = Client::new(options, 10);
        client.publish(topic, QoS::AtLeastOnce, false, payload).unwrap();
        for event in connection.iter() {
            if matches!(event.unwrap(), Event::Incoming(Packet::PubAck(_))) {
                break;
            }
        }
        client.disconnect().unwrap();
        connection.iter().take_while(Result::is_ok).for_each(drop);
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn until(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < Duration::from_secs(60), "{what} did not happen in 60 s");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn accepted(engine: &ServiceEngine) -> u64 {
    engine.handle().status().unwrap().intake.accepted
}

#[test]
fn broker_carries_cycles_and_alarms() {
    let Some(broker) = Mosquitto::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let engine = ServiceEngine::open(intake(&folder.path().join("monitor.db"), StoreSettings::default()), |_| {});
    // Subscribes to alarms.
    let received = Arc::new(Mutex::new(Vec::new()));
    let (client, mut connection) = Client::new(MqttOptions::new("listener", "127.0.0.1", broker.port), 10);
    client.subscribe("cell/alarms", QoS::AtLeastOnce).unwrap();
    let subscribed = Arc::new(AtomicBool::new(false));
    let (sink, ready) = (Arc::clone(&received), Arc::clone(&subscribed));
    std::thread::spawn(move || {
        for event in connection.iter().flatten() {
            match event {
                Event::Incoming(Packet::SubAck(_)) => ready.store(true, Ordering::Release),
                Event::Incoming(Packet::Publish(message)) => {
                    sink.lock().unwrap().push(serde_json::from_slice::<serde_json::Value>(&message.payload).unwrap());
                }
                _ => {}
            }
        }
    });
    until("the subscription", || subscribed.load(Ordering::Acquire));
    let deliver = broker.broker().alarms("cell/alarms".to_owned());
    let output = Output::start("mqtt".to_owned(), engine.handle(), deliver, |_| {}).unwrap();
    let (end, refused) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(Vec::new())));
    let sink = Arc::clone(&refused);
    let problem = move |text: &str| sink.lock().unwrap().push(text.to_owned());
    let subscriber = broker.broker().subscribe("cell/cycles".to_owned(), engine.handle(), Arc::clone(&end), problem);
    // The session begins with the subscription, which takes a moment. The first cycle is sent until it arrives.
    until("the first cycle", || {
        broker.publish(&cycle(0, 0.05));
        accepted(&engine) > 0
    });
    broker.publish(&cycles(1..600, 0.05));
    broker.publish("not a cycle");
    broker.publish(&cycles(600..900, 0.6));
    until("900 cycles", || accepted(&engine) == 900);
    until("an alarm", || !received.lock().unwrap().is_empty());
    output.end();
    let alarms = engine.handle().status().unwrap().alarms;
    until("every alarm", || received.lock().unwrap().len() == alarms.len());
    assert!(received.lock().unwrap().iter().eq(alarms.iter().rev()), "alarms in their order, each once");
    assert!(refused.lock().unwrap().iter().any(|text| text.contains("cell/cycles line 1")), "{refused:?}");
    end.store(true, Ordering::Release);
    subscriber.join().unwrap();
    engine.close().unwrap();
}

#[test]
fn messages_during_outages_count_once() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("monitor.db");
    let subscribe = |broker: &Mosquitto, engine: &ServiceEngine| {
        let end = Arc::new(AtomicBool::new(false));
        (broker.broker().subscribe("cell/cycles".to_owned(), engine.handle(), Arc::clone(&end), |_| {}), end)
    };
    let engine = ServiceEngine::open(intake(&path, StoreSettings::default()), |_| {});
    let (subscriber, end) = subscribe(&broker, &engine);
    until("the first cycle", || {
        broker.publish(&cycle(0, 0.05));
        accepted(&engine) > 0
    });
    end.store(true, Ordering::Release);
    subscriber.join().unwrap();
    engine.close().unwrap();
    // No monitor is connected.
    broker.publish(&cycles(1..100, 0.05));
    let engine = ServiceEngine::open(intake(&path, StoreSettings::default()), |_| {});
    let (subscriber, end) = subscribe(&broker, &engine);
    until("what was sent meanwhile", || accepted(&engine) == 99);
    broker.restart();
    broker.publish(&cycles(100..200, 0.05));
    until("what was sent after the broker's restart", || accepted(&engine) == 199);
    end.store(true, Ordering::Release);
    subscriber.join().unwrap();
    engine.close().unwrap();
}

#[test]
fn broker_carries_control_periods() {
    let Some(broker) = Mosquitto::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let intake = intake(&folder.path().join("monitor.db"), StoreSettings::default());
    let engine = ServiceEngine::open(intake.with_warner(detector(), "a".repeat(64)).unwrap().unwrap(), |_| {});
    let (end, refused) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(Vec::new())));
    let sink = Arc::clone(&refused);
    let problem = move |text: &str| sink.lock().unwrap().push(text.to_owned());
    let topic = "cell/periods".to_owned();
    let subscriber = broker.broker().subscribe_periods(topic, engine.handle(), Arc::clone(&end), problem);
    let warned = || engine.handle().status().unwrap().warnings.unwrap().episodes.warned_failures;
    until("a warning", || {
        broker.publish_on("cell/periods", &episode("a", "bracket", 0.9, "jam"));
        warned() > 0
    });
    broker.publish_on("cell/periods", "no period");
    until("a rejected line", || refused.lock().unwrap().iter().any(|text| text.contains("cell/periods line 1")));
    end.store(true, Ordering::Release);
    subscriber.join().unwrap();
    engine.close().unwrap();
}
