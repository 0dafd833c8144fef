//! The side that answers.

use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use super::connection::{Connection, Deadline, Kind};
use super::{Address, Limits, ZmtpError};

/// How often waiting threads look whether they shall stop.
const LOOK: Duration = Duration::from_millis(50);
/// A peer has this long to greet, to finish a message that it began, and to take an answer.
const WITHIN: Duration = Duration::from_secs(30);
/// Peers at once; further ones are turned away.
const PEERS: usize = 32;

/// A message's frames.
type Frames = Vec<Vec<u8>>;
/// A question, and where its answer goes.
type Question = (Frames, Sender<Frames>);

/// A REP socket: answers one question after the other, whoever asks.
#[derive(Debug)]
pub struct Replier {
    listener: TcpListener,
    address: Address,
    limits: Limits,
}

impl Replier {
    /// Listens on this address; port 0 takes a free one. Questions are held to the limits.
    pub fn bind(address: &Address, limits: Limits) -> Result<Self, ZmtpError> {
        let unbindable = |why| ZmtpError::Unbindable { address: address.to_string(), why };
        let sockets = address.sockets().map_err(unbindable)?;
        let listener = TcpListener::bind(sockets.as_slice()).map_err(unbindable)?;
        listener.set_nonblocking(true).map_err(unbindable)?;
        let address = Address::of(listener.local_addr().map_err(unbindable)?);
        Ok(Self { listener, address, limits })
    }

    /// Where it listens.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Answers until `stop` is set. `answer` is called from this thread, one question at a time.
    ///
    /// A peer that breaks the protocol or the limits loses its connection; nobody else notices.
    pub fn serve(&self, stop: &AtomicBool, answer: &mut dyn FnMut(Frames) -> Frames) {
        let peers = AtomicUsize::new(0);
        let (questions, asked) = channel::<Question>();
        std::thread::scope(|scope| {
            let (peers, limits) = (&peers, self.limits);
            scope.spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    let Ok((stream, _)) = self.listener.accept() else {
                        std::thread::sleep(LOOK / 5);
                        continue;
                    };
                    if peers.fetch_add(1, Ordering::Relaxed) >= PEERS {
                        peers.fetch_sub(1, Ordering::Relaxed);
                        continue;
                    }
                    let questions = questions.clone();
                    scope.spawn(move || {
                        // Whatever ended it concerns this peer alone, and there is nobody to tell.
                        drop(attend(stream, limits, stop, &questions));
                        peers.fetch_sub(1, Ordering::Relaxed);
                    });
                }
            });
            answer_all(stop, &asked, answer);
        });
    }
}

fn answer_all(stop: &AtomicBool, asked: &Receiver<Question>, answer: &mut dyn FnMut(Frames) -> Frames) {
    while !stop.load(Ordering::Relaxed) {
        match asked.recv_timeout(LOOK) {
            // A peer that is gone wants no answer.
            Ok((question, to)) => drop(to.send(answer(question))),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Passes one peer's questions on and the answers back.
fn attend(stream: TcpStream, limits: Limits, stop: &AtomicBool, questions: &Sender<Question>) -> Result<(), ZmtpError> {
    stream.set_nonblocking(false).map_err(ZmtpError::Io)?;
    let mut connection = Connection::open(stream, Kind::Rep, limits, Deadline::new(WITHIN))?;
    while !stop.load(Ordering::Relaxed) {
        let Some(mut envelope) = connection.receive_if_any(LOOK, WITHIN)? else { continue };
        // Up to the first empty frame stands the way back.
        let Some(end) = envelope.iter().position(Vec::is_empty) else {
            return Err(ZmtpError::Framing("a question without the empty frame before it".to_owned()));
        };
        let question = envelope.split_off(end + 1);
        let (to, from) = channel();
        if questions.send((question, to)).is_err() {
            break;
        }
        let Ok(answer) = from.recv() else { break };
        connection.send(&envelope, &answer, Deadline::new(WITHIN))?;
    }
    Ok(())
}
