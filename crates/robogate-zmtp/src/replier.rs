//! The REP side.

use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use super::connection::{Connection, Deadline, Kind};
use super::{Address, Limits, ZmtpError};

/// Interval in which waiting threads check the stop flag.
const POLL: Duration = Duration::from_millis(50);
/// Time limit of a peer for the handshake, for completing a message, and for receiving a reply.
const PEER_TIMEOUT: Duration = Duration::from_secs(30);
/// Maximum number of simultaneous peers. Further connections are closed.
const MAX_PEERS: usize = 32;

/// The frames of a message.
type Frames = Vec<Vec<u8>>;
/// A request, and the channel for its reply.
type Pending = (Frames, Sender<Frames>);

/// A REP socket. Answers the requests of all peers one at a time.
#[derive(Debug)]
pub struct Replier {
    listener: TcpListener,
    address: Address,
    limits: Limits,
}

impl Replier {
    /// Listen on this address, with limits on the size of requests. Port 0 takes a free port.
    pub fn bind(address: &Address, limits: Limits) -> Result<Self, ZmtpError> {
        let unbindable = |why| ZmtpError::Unbindable { address: address.to_string(), why };
        let sockets = address.sockets().map_err(unbindable)?;
        let listener = TcpListener::bind(sockets.as_slice()).map_err(unbindable)?;
        listener.set_nonblocking(true).map_err(unbindable)?;
        let address = Address::of(listener.local_addr().map_err(unbindable)?);
        Ok(Self { listener, address, limits })
    }

    /// Address on which the socket listens.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Answer requests until `stop` is set. Calls `answer` from this thread, for one request at a time.
    ///
    /// The connection of a peer that breaks the protocol or the limits is closed; other peers are not affected.
    pub fn serve(&self, stop: &AtomicBool, answer: &mut dyn FnMut(Frames) -> Frames) {
        let peers = AtomicUsize::new(0);
        let (requests, pending) = channel::<Pending>();
        std::thread::scope(|scope| {
            let (peers, limits) = (&peers, self.limits);
            scope.spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    let Ok((stream, _)) = self.listener.accept() else {
                        std::thread::sleep(POLL / 5);
                        continue;
                    };
                    if peers.fetch_add(1, Ordering::Relaxed) >= MAX_PEERS {
                        peers.fetch_sub(1, Ordering::Relaxed);
                        continue;
                    }
                    let requests = requests.clone();
                    scope.spawn(move || {
                        // An error affects only this peer, whose connection is then closed.
                        drop(serve_peer(stream, limits, stop, &requests));
                        peers.fetch_sub(1, Ordering::Relaxed);
                    });
                }
            });
            answer_all(stop, &pending, answer);
            // A request that arrived after the last answer is dropped with the channel. Its peer would wait for the reply for ever.
            drop(pending);
        });
    }
}

fn answer_all(stop: &AtomicBool, pending: &Receiver<Pending>, answer: &mut dyn FnMut(Frames) -> Frames) {
    while !stop.load(Ordering::Relaxed) {
        match pending.recv_timeout(POLL) {
            // The peer may have disconnected in the meantime.
            Ok((request, to)) => drop(to.send(answer(request))),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Forward the requests of a peer, and send the replies back.
fn serve_peer(
    stream: TcpStream,
    limits: Limits,
    stop: &AtomicBool,
    requests: &Sender<Pending>,
) -> Result<(), ZmtpError> {
    stream.set_nonblocking(false).map_err(ZmtpError::Io)?;
    let mut connection = Connection::open(stream, Kind::Rep, limits, Deadline::new(PEER_TIMEOUT))?;
    while !stop.load(Ordering::Relaxed) {
        let Some(mut envelope) = connection.receive_if_any(POLL, PEER_TIMEOUT)? else { continue };
        // The envelope is everything up to the first empty frame.
        let Some(end) = envelope.iter().position(Vec::is_empty) else {
            return Err(ZmtpError::Framing("a request without the delimiter frame".to_owned()));
        };
        let request = envelope.split_off(end + 1);
        let (to, from) = channel();
        if requests.send((request, to)).is_err() {
            break;
        }
        let Ok(reply) = from.recv() else { break };
        connection.send(&envelope, &reply, Deadline::new(PEER_TIMEOUT))?;
    }
    Ok(())
}
