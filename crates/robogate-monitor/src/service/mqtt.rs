//! MQTT 3.1.1: cycles in by one topic, alarms out by another.
//!
//! The payload is what `POST /v1/cycles` takes as lines. A message is acknowledged to the broker (quality of service 1) after its
//! cycles are on disk, so that the broker sends it again where the monitor was killed; known cycles are not counted twice.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use rumqttc::{Client, Connection, Event, MqttOptions, Packet, Publish, QoS};

use super::desk::Handle;
use super::outputs::{Deliver, OutputError};

/// Time until a lost broker is tried again.
const AGAIN: Duration = Duration::from_secs(1);
/// Largest message.
const LARGEST: usize = 16 << 20;

/// Where the broker is, and the topics.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broker {
    /// Its host.
    pub host: String,
    /// Its port, 1883 without encryption.
    pub port: u16,
    /// A name that no other client of the broker has; its session is kept by the broker while the monitor is away.
    pub client: String,
    /// User and password, where the broker asks.
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
        // Room for an acknowledgement of everything that can be in flight: sending one must not wait.
        Client::new(options, 70_000)
    }

    /// Hears cycles from a topic until `end` is set. `trouble` is told what goes wrong.
    pub fn hear(
        &self,
        topic: String,
        desk: Handle,
        end: Arc<AtomicBool>,
        trouble: impl Fn(&str) + Send + 'static,
    ) -> JoinHandle<()> {
        let (client, mut connection) = self.connect("cycles");
        std::thread::spawn(move || {
            while !end.load(Ordering::Acquire) {
                match connection.recv_timeout(AGAIN) {
                    Ok(Ok(Event::Incoming(Packet::ConnAck(_)))) => {
                        if let Err(error) = client.subscribe(&topic, QoS::AtLeastOnce) {
                            trouble(&format!("MQTT: {error}"));
                        }
                    }
                    Ok(Ok(Event::Incoming(Packet::Publish(message)))) => {
                        let kept = keep(&desk, &message, &end, &trouble);
                        if kept && let Err(error) = client.ack(&message) {
                            trouble(&format!("MQTT: {error}"));
                        }
                    }
                    Ok(Err(error)) => {
                        trouble(&format!("MQTT: {error}"));
                        std::thread::sleep(AGAIN);
                    }
                    Ok(Ok(_)) | Err(_) => {}
                }
            }
            let _ = client.disconnect();
        })
    }

    /// Alarms to a topic; delivered once the broker acknowledged it.
    pub fn alarms(&self, topic: String) -> Deliver {
        let broker = self.clone();
        let mut open: Option<(Client, Connection)> = None;
        Box::new(move |alarm| {
            let (client, connection) = open.get_or_insert_with(|| broker.connect("alarms"));
            let sent = publish(client, connection, &topic, alarm);
            if sent.is_err() {
                // A fresh connection sends nothing that was given up.
                open = None;
            }
            sent
        })
    }
}

/// Takes in a message, however long the store is in trouble; false where the end came first and the broker must keep it.
fn keep(desk: &Handle, message: &Publish, end: &AtomicBool, trouble: &impl Fn(&str)) -> bool {
    while !end.load(Ordering::Acquire) {
        match desk.take(message.payload.to_vec()) {
            Ok(taken) => {
                // What was refused would be refused again: it is told, and acknowledged.
                if let Some(first) = taken.refusals.first() {
                    let (topic, line, because) = (&message.topic, first.line, &first.because);
                    trouble(&format!("MQTT: {topic} line {line}: {because} ({} refused)", taken.refused));
                }
                return true;
            }
            Err(because) => {
                trouble(&format!("MQTT: {because}"));
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
    Err(OutputError("the broker did not acknowledge the alarm in ten seconds".to_owned()))
}
