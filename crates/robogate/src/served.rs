//! A learned policy, behind a socket or in a file, as the command names it and a run records it.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, bail};
use clap::Args;
use robogate_bridge::policy::{Dialect, Profile, ServerError, ServerPolicy};
use serde::{Deserialize, Serialize};

use crate::exit::{Exit, INFRASTRUCTURE, OrExit, USAGE};

/// A learned policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Served {
    /// Its server's address, or its file.
    pub(crate) server: String,
    /// What the model sees and how its answers are meant, in full.
    pub(crate) profile: Arc<Profile>,
    /// What the server said of itself when it was first asked.
    pub(crate) declared: serde_json::Value,
}

impl Served {
    /// Asks a server what it is.
    fn ask(server: &str, profile: Arc<Profile>) -> Result<Self, Exit> {
        // A run is resumed and replayed from other folders, too.
        let server = match &profile.dialect {
            Dialect::Onnx {} if !server.contains("://") => {
                std::path::absolute(server).map_or_else(|_| server.to_owned(), |path| path.display().to_string())
            }
            _ => server.to_owned(),
        };
        let policy = ServerPolicy::connect(&server, Arc::clone(&profile)).map_err(refused)?;
        Ok(Self { server, profile, declared: policy.declared().clone() })
    }

    /// The same policy, its server asked anew what it is.
    pub(crate) fn asked_again(&self) -> Result<Self, Exit> {
        Self::ask(&self.server, Arc::clone(&self.profile))
    }

    /// A connection for one station.
    pub(crate) fn connect(&self) -> Result<ServerPolicy, ServerError> {
        ServerPolicy::connect(&self.server, Arc::clone(&self.profile))
    }
}

/// The policy, on the command line.
#[derive(Debug, Args)]
pub(crate) struct PolicyArguments {
    /// A policy in place of the scripted controller: the address of its server, such as ws://127.0.0.1:8000, or an ONNX
    /// file
    #[arg(long, value_name = "URL|FILE", requires = "profile")]
    policy: Option<String>,
    /// What that model sees and how its answers are meant: a built-in profile (robogate policy profiles), or a
    /// file of your own (TOML)
    #[arg(long, value_name = "NAME|FILE", requires = "policy")]
    profile: Option<String>,
}

impl PolicyArguments {
    /// Asks the server that they name, if any, what it is.
    pub(crate) fn served(&self) -> Result<Option<Served>, Exit> {
        let (Some(server), Some(wanted)) = (&self.policy, &self.profile) else { return Ok(None) };
        Served::ask(server, Arc::new(profile(wanted).or_usage()?)).map(Some)
    }
}

/// A profile by its name or its file.
pub(crate) fn profile(wanted: &str) -> anyhow::Result<Profile> {
    match Profile::built_in(wanted) {
        Some(text) => Profile::from_toml(text).with_context(|| format!("profile {wanted}")),
        None if !Path::new(wanted).exists() && !wanted.contains(['/', '.']) => {
            let known = Profile::built_in_names().collect::<Vec<_>>().join(", ");
            bail!("there is no profile `{wanted}`; built in: {known}; one of your own is named by its file")
        }
        None => {
            let text = std::fs::read_to_string(wanted).with_context(|| format!("cannot read {wanted}"))?;
            Profile::from_toml(&text).with_context(|| wanted.to_owned())
        }
    }
}

/// A server's error with its exit code: what the settings say wrongly is usage, the rest infrastructure.
pub(crate) fn refused(error: ServerError) -> Exit {
    let code = if error.is_in_the_settings() { USAGE } else { INFRASTRUCTURE };
    Exit { code, error: error.into() }
}
