//! `robogate trial serve`: the page for the operator's phone, and the switch.

use std::net::{IpAddr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::path::Path;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_policy::declared;
use robogate_session::profile;
use robogate_trial::{
    Folder, Plan, Problem, Service, Switch, SwitchSettings, qr, qr_text, random_token, serve, write_private,
};
use serde_json::Value;

use super::{StudyArgument, exit};
use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{line, note, warning};

/// Serve the page for the operator's phone, and connect the robot to the policy of each trial.
///
/// The printed address contains a token. Without it the server answers nothing but the empty page. The connection is not encrypted:
/// use it in a network that you trust. With --server for each policy, the robot connects to --robot in place of a policy server,
/// and reaches the policy of the trial from Start to Stop. A script that starts policies itself asks GET /v1/policy with the token
/// in the file `script.token` of the study.
#[derive(Debug, Args)]
pub(super) struct Serve {
    #[command(flatten)]
    study: StudyArgument,
    /// Serve the page at this address. 0.0.0.0:7390 lets phones in the local network connect
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7390")]
    listen: SocketAddr,
    /// Give the server of a policy; repeat for each
    #[arg(long, value_name = "NAME=HOST:PORT")]
    server: Vec<String>,
    /// Accept connections of the robot at this address
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7391", requires = "server")]
    robot: SocketAddr,
    /// Connect to each server with this profile first, and refuse servers that contradict it or declare different inputs, outputs
    /// or rates
    #[arg(long, value_name = "NAME|FILE", requires = "server")]
    profile: Option<String>,
    /// End a trial as a fault of infrastructure if a server takes longer for a reply, in seconds
    #[arg(long, value_name = "S", default_value_t = 30.0, requires = "server")]
    reply_timeout: f64,
}

impl Serve {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let folder = Folder::open(&self.study.study).map_err(exit)?;
        let token = kept_token(&self.study.study.join("operator.token"))?;
        let script = kept_token(&self.study.study.join("script.token"))?;
        let (faults, failed) = channel();
        let switch = self.switch(&folder.study().plan, faults)?;
        if let Some(switch) = &switch {
            note(format_args!("The robot connects to {}", switch.address()));
            for (arm, added) in folder.study().plan.arms.iter().zip(switch.added()) {
                note(format_args!("  {}: {:.2} ms are added to each reply", arm.name, 1000.0 * added.as_secs_f64()));
            }
        }
        let service = Arc::new(Service::new(folder, switch, token.clone(), script));
        if let Some(code) = service.interrupted().map_err(exit)? {
            warning(format_args!("trial {code} ran when the server ended. It is invalid, and is repeated"));
        }
        let hearing = Arc::clone(&service);
        // Ends with the switch, which holds the sender.
        std::thread::spawn(move || {
            for fault in failed {
                if let Err(problem) = hearing.fault(&fault) {
                    warning(format_args!("the fault of a policy server is not recorded: {problem}"));
                }
            }
        });
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let stop = Mutex::new(Some(stop));
        ctrlc::set_handler(move || {
            let stop = stop.lock().unwrap_or_else(PoisonError::into_inner).take();
            // The server may have ended already.
            let _ = stop.map(|stop| stop.send(()));
        })
        .or_broken()?;
        let listening = |address: SocketAddr| {
            let host = if address.ip().is_unspecified() { own_address().unwrap_or(address.ip()) } else { address.ip() };
            let place = format!("http://{}/#token={token}", SocketAddr::new(host, address.port()));
            line(&place);
            if !host.is_loopback()
                && let Some(modules) = qr(&place)
            {
                note(qr_text(&modules));
            }
            note("Open this address on the phone. Ctrl-C ends the server; all records are on disk.");
        };
        serve(self.listen, service, listening, stopped).map_err(exit)?;
        Ok(DONE)
    }

    fn switch(
        &self,
        plan: &Plan,
        faults: std::sync::mpsc::Sender<robogate_trial::Fault>,
    ) -> Result<Option<Switch>, Exit> {
        if self.server.is_empty() {
            return Ok(None);
        }
        if !(self.reply_timeout > 0.0 && self.reply_timeout <= 3600.0) {
            return Err(anyhow!("--reply-timeout {}: expected seconds above 0, at most 3,600", self.reply_timeout))
                .or_usage();
        }
        let mut servers: Vec<(&str, SocketAddr)> = Vec::new();
        for given in &self.server {
            let (name, address) = given
                .rsplit_once('=')
                .ok_or_else(|| anyhow!("--server {given}: expected NAME=HOST:PORT"))
                .or_usage()?;
            let found = address.to_socket_addrs().with_context(|| format!("--server {given}")).or_usage()?.next();
            servers.push((name, found.ok_or_else(|| anyhow!("--server {given}: no address found")).or_usage()?));
        }
        let of_arm = |name: &str| {
            let mut found = servers.iter().filter(|(known, _)| *known == name).map(|(_, address)| *address);
            match (found.next(), found.next()) {
                (Some(address), None) => Ok(address),
                _ => Err(anyhow!("--server: expected one for each policy, and found another number for {name}"))
                    .or_usage(),
            }
        };
        let addresses = plan.arms.iter().map(|arm| of_arm(&arm.name)).collect::<Result<Vec<_>, _>>()?;
        if addresses.len() != servers.len() {
            return Err(anyhow!("--server: a name is not a policy of the plan")).or_usage();
        }
        if let Some(wanted) = &self.profile {
            check_declared(wanted, &addresses)?;
        }
        let settings =
            SwitchSettings { reply: Duration::from_secs_f64(self.reply_timeout), ..SwitchSettings::default() };
        let report = move |fault| {
            // The receiver lives as long as the server.
            let _ = faults.send(fault);
        };
        Switch::start(self.robot, addresses, settings, report).map(Some).map_err(exit)
    }
}

/// Refuses servers that declare different inputs, outputs or rates.
fn check_declared(wanted: &str, servers: &[SocketAddr]) -> Result<(), Exit> {
    let profile = profile(wanted).or_usage()?;
    let mut first = None;
    for server in servers {
        let found = declared(&server.to_string(), &profile).with_context(|| format!("--server {server}")).or_usage()?;
        let found = without_names(found);
        let expected = first.get_or_insert_with(|| found.clone());
        if found != *expected {
            return Err(anyhow!("the servers declare different properties: {expected} and {found}")).or_usage();
        }
    }
    Ok(())
}

/// Metadata without texts that are values of their own: names of checkpoints and versions may differ.
fn without_names(declared: Value) -> Value {
    match declared {
        Value::Object(entries) => {
            let kept = entries.into_iter().filter(|(_, value)| !value.is_string());
            Value::Object(kept.map(|(key, value)| (key, without_names(value))).collect())
        }
        other => other,
    }
}

/// The token in a file that only its owner can read. A new one is drawn if the file does not exist, so that phones stay connected over
/// a restart.
fn kept_token(path: &Path) -> Result<String, Exit> {
    if let Ok(text) = robogate_dictionary::read_regular_text(path) {
        let token = text.trim().to_owned();
        if token.len() < 16 {
            let reason = "the token has fewer than 16 bytes. Remove the file".to_owned();
            return Err(exit(Problem::File { path: path.to_owned(), reason }));
        }
        return Ok(token);
    }
    let token = random_token().map_err(exit)?;
    write_private(path, &token).map_err(exit)?;
    Ok(token)
}

/// The address of this machine in its network. No packet is sent.
fn own_address() -> Option<IpAddr> {
    let socket = UdpSocket::bind("0.0.0.0:0").ok()?;
    socket.connect("192.0.2.1:9").ok()?;
    Some(socket.local_addr().ok()?.ip())
}
