//! The switch: a TCP proxy in front of the policy servers that connects the robot to the policy of the trial.
//!
//! It knows no protocol. A connection of the robot waits until a trial runs and then goes to the server of its policy. Stop ends
//! all connections at once and discards what was not sent yet; [`Switch::close`] returns when none is open. A server that
//! accepts no connection, does not reply in time, or ends a connection while it owes a reply or for good, is reported as a fault.
//!
//! The paths to the servers are made equally long: the time to connect is measured for each at the start, and each reply of a nearer
//! server waits for the difference. The time that a policy computes belongs to the policy; it is measured and not changed.

use std::net::SocketAddr;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt, Interest};
use tokio::net::tcp::{ReadHalf, WriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{oneshot, watch};

use crate::answer::median;
use crate::{Measured, Problem};

/// Most connections at a time.
const CONNECTIONS: usize = 64;
/// Connections per server that measure its distance.
const PROBES: usize = 5;
/// Bytes that are passed on together.
const CHUNK: usize = 64 << 10;
/// Time for which [`Switch::close`] waits. Connections end within a few milliseconds.
const CUT: Duration = Duration::from_secs(2);
/// Time between two looks at a server that owes a reply.
const LOOK: Duration = Duration::from_millis(50);

/// Time limits of the switch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SwitchSettings {
    /// Limit for a connection to a server.
    pub connect: Duration,
    /// Limit for the first byte of a reply, from the first byte of the robot that has none.
    pub reply: Duration,
    /// Time for which a connection of the robot waits for a trial.
    pub hold: Duration,
}

impl Default for SwitchSettings {
    fn default() -> Self {
        Self { connect: Duration::from_secs(5), reply: Duration::from_secs(30), hold: Duration::from_secs(3600) }
    }
}

/// A server that failed during a trial. It names no server: the text may reach the operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// The trial, as given to [`Switch::open`].
    pub code: String,
    /// What happened.
    pub reason: String,
}

/// What is connected.
#[derive(Debug, Clone, Default)]
struct Route {
    /// Increases with each change.
    generation: u64,
    /// The trial and the number of its policy. `None` between trials.
    to: Option<(String, usize)>,
}

/// What was counted since the last [`Switch::open`].
#[derive(Debug, Default)]
struct Counts {
    open: usize,
    connections: u64,
    replies_ms: Vec<f64>,
}

struct Shared {
    route: watch::Sender<Route>,
    counts: Mutex<Counts>,
    closed: Condvar,
    servers: Vec<SocketAddr>,
    added: Vec<Duration>,
    settings: SwitchSettings,
    fault: Box<dyn Fn(Fault) + Send + Sync>,
}

/// A switch that runs. Dropping it ends all connections.
pub struct Switch {
    address: SocketAddr,
    shared: Arc<Shared>,
    _stop: oneshot::Sender<()>,
}

impl Shared {
    fn counts(&self) -> std::sync::MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Switch {
    /// Starts a switch for the servers of all policies, in the order of the plan. `fault` hears of servers that fail; it
    /// must not wait, because the connections wait for it.
    ///
    /// # Errors
    /// If the address cannot be used, or a server does not accept a connection.
    pub fn start(
        listen: SocketAddr,
        servers: Vec<SocketAddr>,
        settings: SwitchSettings,
        fault: impl Fn(Fault) + Send + Sync + 'static,
    ) -> Result<Self, Problem> {
        let failed = |error: std::io::Error| Problem::Listen { address: listen.to_string(), reason: error.to_string() };
        let distances =
            servers.iter().map(|server| distance(*server, settings.connect)).collect::<Result<Vec<_>, _>>()?;
        let farthest = distances.iter().copied().max().unwrap_or_default();
        let added = distances.into_iter().map(|own| farthest - own).collect();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
        let (route, _) = watch::channel(Route::default());
        let shared = Arc::new(Shared {
            route,
            counts: Mutex::default(),
            closed: Condvar::new(),
            servers,
            added,
            settings,
            fault: Box::new(fault),
        });
        let listener = runtime.block_on(TcpListener::bind(listen)).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let (stop, stopped) = oneshot::channel::<()>();
        let accepting = Arc::clone(&shared);
        // The thread ends when `stop` is dropped, and all connections with it.
        std::thread::spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    () = accept(listener, accepting) => {}
                    _ = stopped => {}
                }
            });
        });
        Ok(Self { address, shared, _stop: stop })
    }

    /// The address for the robot.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Connects the robot to policy `arm` for a trial. Connections of the trial before end first.
    pub fn open(&self, code: &str, arm: usize) {
        self.close();
        *self.shared.counts() = Counts::default();
        self.shared.route.send_modify(|route| {
            route.generation += 1;
            route.to = Some((code.to_owned(), arm));
        });
    }

    /// Ends all connections. When this returns, none is open, and no byte follows.
    pub fn close(&self) -> Measured {
        let begin = Instant::now();
        let mut arm = None;
        self.shared.route.send_modify(|route| {
            route.generation += 1;
            arm = route.to.take().map(|(_, arm)| arm);
        });
        let counts = self.shared.counts();
        let waited = self.shared.closed.wait_timeout_while(counts, CUT, |counts| counts.open > 0);
        let (counts, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let ms = |time: Duration| 1000.0 * time.as_secs_f64();
        Measured {
            connections: counts.connections,
            replies: counts.replies_ms.len() as u64,
            reply_ms: median(counts.replies_ms.clone()),
            added_ms: arm.and_then(|arm| self.shared.added.get(arm)).map_or(0.0, |added| ms(*added)),
            cut_ms: ms(begin.elapsed()),
        }
    }

    /// The number of connections in the present trial.
    pub fn connections(&self) -> u64 {
        self.shared.counts().connections
    }

    /// The time that is added to each reply of each server.
    pub fn added(&self) -> &[Duration] {
        &self.shared.added
    }
}

/// The median time to connect to a server.
fn distance(server: SocketAddr, limit: Duration) -> Result<Duration, Problem> {
    let probe = || {
        let begin = Instant::now();
        std::net::TcpStream::connect_timeout(&server, limit).map(|_| begin.elapsed().as_secs_f64())
    };
    let times: Result<Vec<f64>, _> = (0..PROBES).map(|_| probe()).collect();
    let times =
        times.map_err(|error| Problem::Plan(format!("no policy server accepts a connection at {server}: {error}")))?;
    Ok(Duration::from_secs_f64(median(times).unwrap_or_default()))
}

async fn accept(listener: TcpListener, shared: Arc<Shared>) {
    let places = Arc::new(tokio::sync::Semaphore::new(CONNECTIONS));
    loop {
        let Ok((client, _)) = listener.accept().await else {
            tokio::time::sleep(LOOK).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        let shared = Arc::clone(&shared);
        tokio::spawn(async move {
            connection(client, &shared).await;
            drop(place);
        });
    }
}

/// A connection counts as open until it is dropped.
struct Open<'a>(&'a Shared);

impl Drop for Open<'_> {
    fn drop(&mut self) {
        self.0.counts().open -= 1;
        self.0.closed.notify_all();
    }
}

/// Takes a connection of the robot through one trial.
async fn connection(mut client: TcpStream, shared: &Shared) {
    let mut routes = shared.route.subscribe();
    let begun = async { routes.wait_for(|route| route.to.is_some()).await.map(|route| route.clone()) };
    let begun = tokio::select! {
        begun = tokio::time::timeout(shared.settings.hold, begun) => begun,
        () = closed(&client) => return,
    };
    let Ok(Ok(Route { generation, to: Some((code, arm)) })) = begun else { return };
    // Counted before the route is looked at again: whoever changes it afterwards waits for this connection.
    let open = {
        let mut counts = shared.counts();
        counts.open += 1;
        counts.connections += 1;
        Open(shared)
    };
    let ended = async {
        // An error means that the switch is gone.
        let _ = routes.wait_for(|now| now.generation != generation).await;
    };
    let fault = |reason: &str| (shared.fault)(Fault { code: code.clone(), reason: reason.to_owned() });
    let mut ended = std::pin::pin!(ended);
    let connected = tokio::select! {
        biased;
        () = &mut ended => return drop((abort(client), open)),
        connected = tokio::time::timeout(shared.settings.connect, TcpStream::connect(shared.servers[arm])) => connected,
    };
    let Ok(Ok(mut server)) = connected else {
        drop((abort(client), open));
        return fault("the policy server accepted no connection");
    };
    let (_, _) = (client.set_nodelay(true), server.set_nodelay(true));
    let asked = Mutex::new(None);
    let end = {
        let (from_client, to_client) = client.split();
        let (from_server, to_server) = server.split();
        let late = tokio::time::sleep(shared.added[arm]);
        let passed = async {
            late.await;
            let up = forward(from_client, to_server, &asked);
            let down = backward(from_server, to_client, &asked, shared, arm);
            let mut down = std::pin::pin!(down);
            tokio::select! {
                by_server = &mut down => return if by_server { End::ByServer } else { End::Closed },
                () = up => {}
            }
            // The robot has sent everything; the rest of the reply follows.
            down.await;
            End::Closed
        };
        tokio::select! {
            biased;
            () = &mut ended => End::Cut,
            () = hanging(&asked, shared.settings.reply) => End::Hanging,
            end = passed => end,
        }
    };
    if matches!(end, End::Cut | End::Hanging) {
        abort(server);
        abort(client);
    }
    drop(open);
    match end {
        End::Hanging => fault("the policy server did not reply in time"),
        End::ByServer if at(&asked).is_some() => fault("the policy server closed the connection and owed a reply"),
        // A protocol may end a connection after each reply. A server that is gone accepts no other one.
        End::ByServer => {
            let again = tokio::time::timeout(shared.settings.connect, TcpStream::connect(shared.servers[arm]));
            let gone = tokio::select! {
                biased;
                () = ended => false,
                again = again => !matches!(again, Ok(Ok(_))),
            };
            if gone {
                fault("the policy server closed the connection and accepts no other one");
            }
        }
        End::Closed | End::Cut => {}
    }
}

/// Returns once the robot has closed a connection that waits, so that it does not take the place of another one.
async fn closed(client: &TcpStream) {
    loop {
        tokio::time::sleep(LOOK).await;
        // A connection can always be written to, so this does not wait.
        let ready = client.ready(Interest::READABLE | Interest::WRITABLE).await;
        if ready.is_ok_and(|ready| ready.is_read_closed()) {
            return;
        }
    }
}

/// How a connection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// The robot closed it.
    Closed,
    /// The server closed it before the robot did.
    ByServer,
    /// The trial ended.
    Cut,
    /// The server did not reply.
    Hanging,
}

/// Drops a connection at once. What was not sent yet is discarded.
fn abort(stream: TcpStream) {
    // If the connection is gone, nothing is left to discard.
    let _ = stream.set_zero_linger();
}

/// When the robot sent what has no reply. Any byte of the server counts as a reply.
#[derive(Debug, Clone, Copy)]
struct Sent {
    /// The first byte: the limit for the reply begins here. What the robot sends later does not extend it.
    first: Instant,
    /// The last byte: the measured time of the reply begins here.
    last: Instant,
}

/// What has no reply. `None` if the server owes nothing.
type Asked = Mutex<Option<Sent>>;

fn at(asked: &Asked) -> std::sync::MutexGuard<'_, Option<Sent>> {
    asked.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn forward(mut from: ReadHalf<'_>, mut to: WriteHalf<'_>, asked: &Asked) {
    let mut chunk = vec![0; CHUNK];
    while let Ok(bytes @ 1..) = from.read(&mut chunk).await {
        let now = Instant::now();
        at(asked).get_or_insert(Sent { first: now, last: now }).last = now;
        if to.write_all(&chunk[..bytes]).await.is_err() {
            break;
        }
    }
    // The server may be gone already.
    let _ = to.shutdown().await;
}

/// Returns whether the server ended the connection.
async fn backward(mut from: ReadHalf<'_>, mut to: WriteHalf<'_>, asked: &Asked, shared: &Shared, arm: usize) -> bool {
    let mut chunk = vec![0; CHUNK];
    while let Ok(bytes @ 1..) = from.read(&mut chunk).await {
        let sent = at(asked).take();
        if let Some(sent) = sent {
            shared.counts().replies_ms.push(1000.0 * sent.last.elapsed().as_secs_f64());
            tokio::time::sleep(shared.added[arm]).await;
        }
        if to.write_all(&chunk[..bytes]).await.is_err() {
            return false;
        }
    }
    // The reply must arrive before the connection is dropped.
    let _ = to.shutdown().await;
    true
}

/// Returns once a reply is later than `limit`.
async fn hanging(asked: &Asked, limit: Duration) {
    loop {
        tokio::time::sleep(LOOK.min(limit)).await;
        if at(asked).is_some_and(|sent| sent.first.elapsed() > limit) {
            return;
        }
    }
}
