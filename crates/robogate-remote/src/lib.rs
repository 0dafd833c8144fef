//! Simulators behind a socket, both sides of it: `bridges/PROTOCOL.md`.
//!
//! A [`Pool`] of servers makes a [`Remote`] simulator for each worker; a [`Server`] puts one of ours behind the
//! protocol; [`conformance`] holds a server to it.

pub mod bounds;
mod client;
pub mod conformance;
mod link;
pub mod message;
mod pool;
mod server;

pub use client::{NoWorld, World};
pub use link::{AskError, Link, Patience};
pub use pool::{GIVE_UP, Listener, Pool, PoolError, Remote};
pub use server::{Host, Judging, Server};
