//! `robogate serve`: serves a built-in environment over the bridge protocol.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::anyhow;
use clap::Args;
use robogate_remote::limits::REQUEST;
use robogate_remote::{EnvironmentHost, Host, Server};
use robogate_zmtp::{Address, Replier, ZmtpError};
use serde_json::json;

use crate::arguments::EnvironmentArguments;
use crate::commands::run::stop_at_once;
use crate::exit::{DONE, Exit, OrExit, USAGE};
use crate::terminal::{line, note};

/// Serve a built-in environment to other programs over the bridge protocol (bridges/PROTOCOL.md).
///
/// Prints the address as one line of JSON, then answers requests until Ctrl-C. A server runs one episode at a time:
/// start one server for each client.
#[derive(Debug, Args)]
pub(crate) struct Serve {
    /// Listen on this address; port 0 or * takes a free one
    #[arg(long, value_name = "ADDRESS", default_value = "tcp://127.0.0.1:5570")]
    bind: Address,
    /// Allow an address that other machines can reach. The protocol has no authentication
    #[arg(long)]
    allow_remote: bool,
    /// Compute physics only: set up the cells that the client sends and report physical states, without a task
    #[arg(long)]
    physics_only: bool,
    #[command(flatten)]
    environment: EnvironmentArguments,
}

impl Serve {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if !self.bind.is_loopback() && !self.allow_remote {
            let why = anyhow!(
                "--bind {}: other machines can reach this address, and the protocol has no authentication\nHint: bind to \
                 tcp://127.0.0.1:PORT, or add --allow-remote",
                self.bind
            );
            return Err(why).or_usage();
        }
        if self.physics_only {
            let cell = self.environment.choice().cell()?;
            return self.answer(Server::new(cell.physics_host().or_usage()?));
        }
        let source = self.environment.choice().environment()?;
        let hello = source.hello().or_usage()?;
        let environment = source.environment().or_broken()?;
        self.answer(Server::new(EnvironmentHost::new(hello, environment)))
    }

    fn answer<H: Host>(&self, mut server: Server<H>) -> Result<u8, Exit> {
        let replier = Replier::bind(&self.bind, REQUEST).map_err(|why| match why {
            ZmtpError::Unbindable { .. } => Exit { code: USAGE, error: why.into() },
            why => Exit { code: crate::exit::INFRASTRUCTURE, error: why.into() },
        })?;
        let stop = Arc::new(AtomicBool::new(false));
        let interrupted = Arc::clone(&stop);
        ctrlc::set_handler(move || {
            // The first Ctrl-C lets the current request finish. The second one ends the process.
            if interrupted.swap(true, Ordering::Relaxed) {
                stop_at_once();
            }
        })
        .or_broken()?;
        let hello = server.hello();
        note(format_args!(
            "serving {} in {} {} on {}; press Ctrl-C to stop",
            hello.task.name,
            hello.engine.name,
            hello.engine.version,
            replier.address()
        ));
        line(json!({"version": 1, "listening": replier.address().to_string()}));
        replier.serve(&stop, &mut |request| server.answer(&request));
        Ok(DONE)
    }
}
