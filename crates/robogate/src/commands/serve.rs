//! `robogate serve`: our engines behind the bridge protocol.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::anyhow;
use clap::Args;
use robogate_bridge::simulator::bounds::REQUEST;
use robogate_bridge::simulator::{Host, Judging, Server};
use robogate_bridge::zmtp::{Address, Replier, ZmtpError};
use robogate_physics::SuctionLaw;
use serde_json::json;

use crate::commands::run::stop_at_once;
use crate::exit::{DONE, Exit, OrExit, USAGE};
use crate::terminal::{line, note};
use crate::world::WorldArguments;

/// Put the cell behind a socket, for a policy or a script of your own (bridges/PROTOCOL.md).
///
/// Prints its address as one line of JSON, then answers until Ctrl-C. One episode runs at a time: start one server for each client.
#[derive(Debug, Args)]
pub(crate) struct Serve {
    /// Where to listen; port 0 or * takes a free one
    #[arg(long, value_name = "ADDRESS", default_value = "tcp://127.0.0.1:5570")]
    bind: Address,
    /// Listen where other machines reach it, too: the protocol has no authentication
    #[arg(long)]
    allow_remote: bool,
    /// Judge nothing: be told the cell and report what is seen, as the servers under bridges/ do
    #[arg(long)]
    physics_only: bool,
    #[command(flatten)]
    world: WorldArguments,
}

impl Serve {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if !self.bind.is_loopback() && !self.allow_remote {
            let why = anyhow!(
                "{} is reached by other machines and the protocol has no authentication\n  hint: --allow-remote if that \
                 is meant",
                self.bind
            );
            return Err(why).or_usage();
        }
        let cell = self.world.cell(SuctionLaw::Vacuum)?;
        if self.physics_only {
            let host = cell.physics_host().or_usage()?;
            return self.answer(Server::new(host));
        }
        let hello = cell.hello().or_usage()?;
        let simulator = cell.simulator().or_broken()?;
        self.answer(Server::new(Judging::new(hello, simulator)))
    }

    fn answer<H: Host>(&self, mut server: Server<H>) -> Result<u8, Exit> {
        let replier = Replier::bind(&self.bind, REQUEST).map_err(|why| match why {
            ZmtpError::Unbindable { .. } => Exit { code: USAGE, error: why.into() },
            why => Exit { code: crate::exit::INFRASTRUCTURE, error: why.into() },
        })?;
        let stop = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&stop);
        ctrlc::set_handler(move || {
            // A client in the middle of something has its time; who asks twice has none.
            if asked.swap(true, Ordering::Relaxed) {
                stop_at_once();
            }
        })
        .or_broken()?;
        let hello = server.hello();
        note(format_args!(
            "{} in {} {} on {}; Ctrl-C ends it",
            hello.robot.name,
            hello.engine.name,
            hello.engine.version,
            replier.address()
        ));
        line(json!({"version": 1, "listening": replier.address().to_string()}));
        replier.serve(&stop, &mut |request| server.answer(&request));
        Ok(DONE)
    }
}
