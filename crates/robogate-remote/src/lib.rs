//! Environments in another process: client and server of the bridge protocol (`bridges/PROTOCOL.md`).
//!
//! A [`Pool`] holds the connections to one or more servers. A server that scores itself becomes a
//! [`RemoteEnvironment`]; a server that only computes physics for a [`RemoteTask`] becomes a [`RemotePhysics`]. A
//! [`Server`] makes an environment of this process available to other programs. [`conformance`] tests whether a server
//! conforms to the protocol.

pub mod conformance;
mod connection;
mod environment;
mod error;
pub mod header;
pub mod limits;
pub mod message;
mod physics;
mod pool;
mod proposals;
mod scored;
mod server;
mod session;

pub use connection::{Connection, Timeouts};
pub use environment::{IncompatibleServer, RemoteEnvironment, RemotePhysics};
pub use error::RequestError;
pub use physics::{PhysicsSession, RemoteTask};
pub use pool::{Listener, MAX_FAILURES, Pool, PoolError, Restart};
pub use proposals::RemotePolicy;
pub use scored::ScoredSession;
pub use server::{EnvironmentHost, Host, Server};
pub use session::Session;
