//! A stub of rosbridge_server: protocol v2 over WebSocket, as far as topics need it. It forwards messages between clients, reports
//! errors as status messages, and can close all connections.

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};
use tungstenite::{Error, Message, accept};

#[derive(Default)]
struct State {
    /// The type of each topic.
    types: BTreeMap<String, String>,
    /// Subscribers of each topic, by client.
    subscribers: Vec<(usize, String, Sender<String>)>,
    clients: usize,
    /// Clients below this number are disconnected.
    closed_below: usize,
}

/// A stub on a free port.
pub(crate) struct Rosbridge {
    pub(crate) address: SocketAddr,
    state: Arc<Mutex<State>>,
}

impl Rosbridge {
    pub(crate) fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let state = Arc::<Mutex<State>>::default();
        let shared = Arc::clone(&state);
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let state = Arc::clone(&shared);
                thread::spawn(move || serve(stream, &state));
            }
        });
        Self { address, state }
    }

    pub(crate) fn url(&self) -> String {
        format!("ws://{}", self.address)
    }

    /// How many clients have subscribed to a topic.
    pub(crate) fn subscribers(&self, topic: &str) -> usize {
        self.state.lock().unwrap().subscribers.iter().filter(|(_, known, _)| known == topic).count()
    }

    /// Closes all connections, as a server that restarts.
    pub(crate) fn close_all(&self) {
        let mut state = self.state.lock().unwrap();
        state.closed_below = state.clients;
        state.subscribers.clear();
        state.types.clear();
    }
}

fn serve(stream: TcpStream, state: &Mutex<State>) {
    let Ok(mut web) = accept(stream) else { return };
    web.get_ref().set_read_timeout(Some(Duration::from_millis(5))).unwrap();
    let client = {
        let mut state = state.lock().unwrap();
        state.clients += 1;
        state.clients - 1
    };
    let (sender, messages): (Sender<String>, Receiver<String>) = channel();
    while client >= state.lock().unwrap().closed_below {
        match web.read() {
            Ok(Message::Text(text)) => {
                if let Err(problem) = handle(&text, client, &sender, &mut state.lock().unwrap()) {
                    let status = json!({ "op": "status", "level": "error", "msg": problem });
                    let _ = sender.send(status.to_string());
                }
            }
            Ok(_) => drop(web.flush()),
            Err(Error::Io(e)) if matches!(e.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
        for message in messages.try_iter() {
            if web.send(Message::text(message)).is_err() {
                return;
            }
        }
    }
    state.lock().unwrap().subscribers.retain(|(one, ..)| *one != client);
}

fn handle(text: &str, client: usize, sender: &Sender<String>, state: &mut State) -> Result<(), String> {
    let message: Value = serde_json::from_str(text).map_err(|e| e.to_string())?;
    let field = |name: &str| message[name].as_str().map(str::to_owned);
    let topic = field("topic").ok_or("no topic")?;
    match message["op"].as_str() {
        Some("advertise") => {
            let type_name = field("type").filter(|name| name.contains('/')).ok_or("invalid type")?;
            let known = state.types.entry(topic.clone()).or_insert_with(|| type_name.clone());
            if short(known) == short(&type_name) { Ok(()) } else { Err(format!("{topic} has the type {known}")) }
        }
        Some("subscribe") => {
            if !state.types.contains_key(&topic) {
                state.types.insert(topic.clone(), field("type").ok_or(format!("{topic}: its type is unknown"))?);
            }
            state.subscribers.push((client, topic, sender.clone()));
            Ok(())
        }
        Some("unsubscribe") => {
            state.subscribers.retain(|(one, known, _)| *one != client || *known != topic);
            Ok(())
        }
        Some("publish") if state.types.contains_key(&topic) => {
            let forwarded = json!({ "op": "publish", "topic": topic, "msg": message["msg"] }).to_string();
            for (_, _, to) in state.subscribers.iter().filter(|(_, known, _)| *known == topic) {
                let _ = to.send(forwarded.clone());
            }
            Ok(())
        }
        Some("unadvertise") => Ok(()),
        _ => Err(format!("cannot process {text}")),
    }
}

/// The name of a type without the folder that ROS 2 added.
fn short(type_name: &str) -> String {
    type_name.replace("/msg/", "/")
}
