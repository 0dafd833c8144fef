//! The open connections: limits by address and in total.
//!
//! A connection that waits for a request costs nothing but its place. At a limit, the one that has waited longest gives
//! its place to the new one, so unfinished request heads cannot lock other clients out.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::Notify;

use super::HttpSettings;

/// The connected addresses.
#[derive(Default)]
pub(super) struct Peers {
    addresses: BTreeMap<IpAddr, Peer>,
    /// Connections that wait for a request, by number: the smallest has waited longest.
    waiting: BTreeMap<u64, (IpAddr, Arc<Notify>)>,
    /// Number of open connections.
    open: usize,
    /// The number of the next connection, or of the next wait of one.
    next: u64,
}

struct Peer {
    connections: usize,
    /// Number of requests that it may still send.
    credit: f64,
    since: Instant,
}

/// A connection.
pub(super) struct Connection {
    address: IpAddr,
    /// Its place among the waiting connections, while it waits for a request.
    wait: u64,
    /// Tells it to close.
    pub(super) close: Arc<Notify>,
}

impl Connection {
    /// The address of the client.
    pub(super) fn address(&self) -> IpAddr {
        self.address
    }
}

impl Peers {
    /// Accepts a connection. `None` if the limits are reached and no connection waits.
    pub(super) fn connect(&mut self, address: IpAddr, settings: &HttpSettings) -> Option<Connection> {
        if self.addresses.len() > 10_000 {
            self.addresses.retain(|_, peer| peer.connections > 0 || peer.since.elapsed() < Duration::from_secs(10));
        }
        let of_address = self.addresses.get(&address).map_or(0, |peer| peer.connections);
        if of_address >= settings.most_connections_per_address && !self.evict(|waiting| *waiting == address) {
            return None;
        }
        if self.open >= settings.most_connections && !self.evict(|_| true) {
            return None;
        }
        let credit = settings.requests_per_s * 10.0;
        let peer = self.addresses.entry(address).or_insert(Peer { connections: 0, credit, since: Instant::now() });
        peer.connections += 1;
        self.open += 1;
        let mut connection = Connection { address, wait: 0, close: Arc::new(Notify::new()) };
        self.wait(&mut connection);
        Some(connection)
    }

    /// Closes the connection that has waited longest, of those that match. Returns whether there is one.
    fn evict(&mut self, matches: impl Fn(&IpAddr) -> bool) -> bool {
        let Some(number) = self.waiting.iter().find(|(_, (address, _))| matches(address)).map(|(number, _)| *number)
        else {
            return false;
        };
        if let Some((address, close)) = self.waiting.remove(&number) {
            close.notify_one();
            self.forget(address);
        }
        true
    }

    fn forget(&mut self, address: IpAddr) {
        self.open = self.open.saturating_sub(1);
        if let Some(peer) = self.addresses.get_mut(&address) {
            peer.connections = peer.connections.saturating_sub(1);
        }
    }

    /// The connection waits for a request.
    fn wait(&mut self, connection: &mut Connection) {
        connection.wait = self.next;
        self.next += 1;
        self.waiting.insert(connection.wait, (connection.address, Arc::clone(&connection.close)));
    }

    /// The connection has received the head of a request. Returns whether the address may send one more.
    pub(super) fn begin(&mut self, connection: &Connection, settings: &HttpSettings) -> bool {
        self.waiting.remove(&connection.wait);
        let Some(peer) = self.addresses.get_mut(&connection.address) else { return true };
        let gained = peer.since.elapsed().as_secs_f64() * settings.requests_per_s;
        peer.since = Instant::now();
        peer.credit = (peer.credit + gained).min(settings.requests_per_s * 10.0);
        let allowed = peer.credit >= 1.0;
        peer.credit -= f64::from(u8::from(allowed));
        allowed
    }

    /// The request is answered.
    pub(super) fn end(&mut self, connection: &mut Connection) {
        self.wait(connection);
    }

    /// The connection is closed. One that was evicted is forgotten already.
    pub(super) fn disconnect(&mut self, connection: &Connection, busy: bool) {
        if self.waiting.remove(&connection.wait).is_some() || busy {
            self.forget(connection.address);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOST: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    fn settings() -> HttpSettings {
        HttpSettings { most_connections: 6, most_connections_per_address: 4, ..HttpSettings::default() }
    }

    #[test]
    fn unfinished_heads_give_way() {
        let mut peers = Peers::default();
        let slow: Vec<_> = (0..600).map(|_| peers.connect(HOST, &settings()).unwrap()).collect();
        assert_eq!((peers.open, peers.waiting.len()), (4, 4));
        let mut client = peers.connect(HOST, &settings()).unwrap();
        assert!(peers.begin(&client, &settings()));
        // The client is busy, so more slow connections replace each other.
        let more: Vec<_> = (0..600).map(|_| peers.connect(HOST, &settings()).unwrap()).collect();
        assert_eq!(peers.open, 4);
        peers.end(&mut client);
        for connection in slow.iter().chain(&more).chain([&client]) {
            peers.disconnect(connection, false);
        }
        assert_eq!((peers.open, peers.waiting.len(), peers.addresses[&HOST].connections), (0, 0, 0));
    }

    #[test]
    fn busy_connections_are_kept() {
        let mut peers = Peers::default();
        let busy: Vec<_> = (0..4).map(|_| peers.connect(HOST, &settings()).unwrap()).collect();
        assert!(busy.iter().all(|connection| peers.begin(connection, &settings())));
        assert!(peers.connect(HOST, &settings()).is_none());
        let other = IpAddr::V6(std::net::Ipv6Addr::LOCALHOST);
        let far: Vec<_> = (0..9).map(|_| peers.connect(other, &settings()).unwrap()).collect();
        assert_eq!(peers.open, 6);
        busy.iter().for_each(|connection| peers.disconnect(connection, true));
        far.iter().for_each(|connection| peers.disconnect(connection, false));
        assert_eq!(peers.open, 0);
    }
}
