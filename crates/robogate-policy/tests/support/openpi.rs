//! Test servers with the dialect openpi.

use std::net::{TcpListener, TcpStream};
use std::ops::ControlFlow;
use std::thread;

use rmpv::Value;
use tungstenite::{Message, WebSocket, accept};

/// Encodes a reply with this number of actions and numbers per action.
pub(crate) fn actions(rows: usize, width: usize, number: impl Fn(usize, usize) -> f64) -> Vec<u8> {
    let data =
        (0..rows).flat_map(|i| (0..width).flat_map(move |j| [(i, j)])).flat_map(|(i, j)| number(i, j).to_le_bytes());
    let key = |name: &str| Value::Binary(name.as_bytes().to_vec());
    let array = Value::Map(vec![
        (key("__ndarray__"), true.into()),
        (key("data"), Value::Binary(data.collect())),
        (key("dtype"), "<f8".into()),
        (key("shape"), Value::Array(vec![rows.into(), width.into()])),
    ]);
    let mut bytes = Vec::new();
    rmpv::encode::write_value(&mut bytes, &Value::Map(vec![("actions".into(), array)]))
        .expect("writing to a vector cannot fail");
    bytes
}

/// Starts a server that sends metadata and then runs a conversation on each connection, until one returns `Break`.
pub(crate) fn serve(
    listener: TcpListener,
    mut converse: impl FnMut(usize, &mut WebSocket<TcpStream>) -> ControlFlow<()> + Send + 'static,
) {
    thread::spawn(move || {
        for (number, stream) in listener.incoming().enumerate() {
            let stream = stream.expect("a connection");
            stream.set_nodelay(true).expect("a connection");
            let Ok(mut socket) = accept(stream) else { continue };
            // A probing client may have closed the connection.
            if socket.send(Message::binary(vec![0x80])).is_ok() && converse(number, &mut socket).is_break() {
                return;
            }
        }
    });
}
