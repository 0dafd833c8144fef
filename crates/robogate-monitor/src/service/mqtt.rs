//! MQTT 3.1.1: subscribes to cycles on one topic and publishes alarms on another.
//!
//! The payload has the format of `POST /v1/cycles`. A message is acknowledged to the broker (quality of service 1)
//! after its cycles are on disk. If the monitor is killed before that, the broker sends the message again; known cycles
//! are not counted twice.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rumqttc::{Client, Connection, Event, MqttOptions, Packet, Publish, QoS};

use super::engine::Handle;
use super::outputs::{Deliver, OutputError};
use super::warnings::Periods;

/// Time until the next attempt to connect to the broker.
const AGAIN: Duration = Duration::from_secs(1);
/// Maximum size of a message.
const LARGEST: usize = 16 << 20;

/// Processes a message. Returns what is wrong with it, or the reason why it must be processed later.
type Hear = Box<dyn Fn(&Publish) -> Result<Option<String>, String> + Send>;

/// The address of a broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broker {
    /// The host.
    pub host: String,
    /// The port, 1883 without encryption.
    pub port: u16,
    /// The client id, unique at the broker. The broker keeps its session while the monitor is disconnected.
    pub client: String,
    /// User and password, if the broker requires them.
    pub login: Option<(String, String)>,
}

impl Broker {
    fn connect(&self, role: &str) -> (Client, Connection) {
        let mut options = MqttOptions::new(format!("{}-{role}", self.client), &self.host, self.port);
        options.set_keep_alive(Duration::from_secs(15)).set_clean_session(false).set_manual_acks(true);
        options.set_max_packet_size(LARGEST, LARGEST);
        if let Some((user, password)) = &self.login {
            options.set_credentials(user, password);
        }
        // Capacity for the acknowledgements of all messages in flight, because sending one must not block.
        Client::new(options, 70_000)
    }

    /// Processes cycles from a topic until `end` is set. `problem` receives error messages.
    pub fn subscribe(
        &self,
        topic: String,
        engine: Handle,
        end: Arc<AtomicBool>,
        problem: impl Fn(&str) + Send + 'static,
    ) -> JoinHandle<()> {
        let hear = move |message: &Publish| {
            let taken = engine.take_from("mqtt", &message.payload)?;
            // The cycle would be refused again, so it is reported and the message is acknowledged.
            Ok(taken.refusals.first().map(|first| {
                let (topic, line, because) = (&message.topic, first.line, &first.because);
                format!("{topic} line {line}: {because} ({} refused)", taken.refused)
            }))
        };
        self.follow("cycles", topic, Box::new(hear), end, problem)
    }

    /// Processes control periods from a topic until `end` is set. `problem` receives error messages.
    pub fn subscribe_periods(
        &self,
        topic: String,
        engine: Handle,
        end: Arc<AtomicBool>,
        problem: impl Fn(&str) + Send + 'static,
    ) -> JoinHandle<()> {
        let hear = move |message: &Publish| {
            let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
            let heard = engine.hear(Periods::parse(&message.payload, now).map_err(|error| error.to_string())?)?;
            Ok(heard.rejections.first().map(|first| {
                let (topic, line, because) = (&message.topic, first.line, &first.because);
                format!("{topic} line {line}: {because} ({} rejected)", heard.rejected)
            }))
        };
        self.follow("periods", topic, Box::new(hear), end, problem)
    }

    fn follow(
        &self,
        role: &str,
        topic: String,
        hear: Hear,
        end: Arc<AtomicBool>,
        problem: impl Fn(&str) + Send + 'static,
    ) -> JoinHandle<()> {
        let (client, mut connection) = self.connect(role);
        std::thread::spawn(move || {
            while !end.load(Ordering::Acquire) {
                match connection.recv_timeout(AGAIN) {
                    Ok(Ok(Event::Incoming(Packet::ConnAck(_)))) => {
                        if let Err(error) = client.subscribe(&topic, QoS::AtLeastOnce) {
                            problem(&format!("MQTT: {error}"));
                        }
                    }
                    Ok(Ok(Event::Incoming(Packet::Publish(message)))) => {
                        let kept = keep(&hear, &message, &end, &problem);
                        if kept && let Err(error) = client.ack(&message) {
                            problem(&format!("MQTT: {error}"));
                        }
                    }
                    Ok(Err(error)) => {
                        problem(&format!("MQTT: {error}"));
                        std::thread::sleep(AGAIN);
                    }
                    Ok(Ok(_)) | Err(_) => {}
                }
            }
            let _ = client.disconnect();
        })
    }

    /// Publishes alarms on a topic. An alarm is delivered when the broker has acknowledged it.
    pub fn alarms(&self, topic: String) -> Deliver {
        let broker = self.clone();
        let mut open: Option<(Client, Connection)> = None;
        Box::new(move |alarm| {
            let (client, connection) = open.get_or_insert_with(|| broker.connect("alarms"));
            let sent = publish(client, connection, &topic, alarm);
            if sent.is_err() {
                // A new connection does not send an abandoned alarm.
                open = None;
            }
            sent
        })
    }
}

/// Processes a message, and waits while the store fails. Returns false on shutdown, when the broker must keep the
/// message.
fn keep(hear: &Hear, message: &Publish, end: &AtomicBool, problem: &impl Fn(&str)) -> bool {
    while !end.load(Ordering::Acquire) {
        match hear(message) {
            Ok(refused) => {
                refused.iter().for_each(|because| problem(&format!("MQTT: {because}")));
                return true;
            }
            Err(because) => {
                problem(&format!("MQTT: {because}"));
                std::thread::sleep(AGAIN);
            }
        }
    }
    false
}

fn publish(client: &Client, connection: &mut Connection, topic: &str, alarm: &str) -> Result<(), OutputError> {
    client.publish(topic, QoS::AtLeastOnce, false, alarm).map_err(|e| OutputError(e.to_string()))?;
    for _ in 0..100 {
        match connection.recv_timeout(Duration::from_millis(100)) {
            Ok(Ok(Event::Incoming(Packet::PubAck(_)))) => return Ok(()),
            Ok(Ok(_)) | Err(rumqttc::RecvTimeoutError::Timeout) => {}
            Ok(Err(error)) => return Err(OutputError(error.to_string())),
            Err(rumqttc::RecvTimeoutError::Disconnected) => {
                return Err(OutputError("the connection to the broker ended".to_owned()));
            }
        }
    }
    Err(OutputError("the broker did not acknowledge the alarm within 10 s".to_owned()))
}
