//! A policy in place of the scripted controller, as the command names it and a run records it.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use clap::Args;
use robogate_core::{Fault, Policy};
use robogate_policy::{Profile, ServerError, ServerPolicy};
use robogate_tasks::Random;
use serde::{Deserialize, Serialize};

use crate::exit::{Exit, INFRASTRUCTURE, OrExit, USAGE};

/// A policy in place of the scripted controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum Guest {
    /// Behind a socket or in a file.
    Served(Served),
    /// One that comes with RoboGate.
    Own(Own),
}

/// Policies that come with RoboGate, beside the scripted controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Own {
    /// Knows nothing: the floor of a ranking.
    Random,
}

/// A learned policy behind a socket, or in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Served {
    /// Its server's address, or its file.
    server: String,
    /// What the model sees and how its answers are meant, in full.
    profile: Arc<Profile>,
    /// What the server said of itself when it was first asked.
    declared: serde_json::Value,
}

impl Guest {
    /// Its name in records.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Served(served) => &served.profile.name,
            Self::Own(Own::Random) => "random",
        }
    }

    /// What it was taught to see, where it was taught.
    pub(crate) fn profile(&self) -> Option<&Profile> {
        match self {
            Self::Served(served) => Some(&served.profile),
            Self::Own(_) => None,
        }
    }

    /// The same policy, its server asked anew what it is.
    pub(crate) fn asked_again(&self) -> Result<Self, Exit> {
        match self {
            Self::Served(served) => Served::ask(&served.server, Arc::clone(&served.profile)).map(Self::Served),
            Self::Own(own) => Ok(Self::Own(*own)),
        }
    }

    /// One for a station of its own.
    pub(crate) fn policy(&self) -> Result<Box<dyn Policy>, Fault> {
        Ok(match self {
            Self::Served(served) => Box::new(ServerPolicy::connect(&served.server, Arc::clone(&served.profile))?),
            Self::Own(Own::Random) => Box::new(Random::new()),
        })
    }
}

impl Served {
    /// Asks a server what it is.
    fn ask(server: &str, profile: Arc<Profile>) -> Result<Self, Exit> {
        // A run is resumed and replayed from other folders, too.
        let is_file = profile.dialect.is_file() && !server.contains("://");
        let full = if is_file { std::path::absolute(server).ok() } else { None };
        let server = full.map_or_else(|| server.to_owned(), |path| path.display().to_string());
        let policy = ServerPolicy::connect(&server, Arc::clone(&profile)).map_err(refused)?;
        Ok(Self { server, profile, declared: policy.declared().clone() })
    }
}

/// The policy, on the command line.
#[derive(Debug, Args)]
pub(crate) struct PolicyArguments {
    /// A policy in place of the scripted controller: the address of its server, such as ws://127.0.0.1:8000, or an ONNX
    /// file, or random, the floor of a ranking
    #[arg(long, value_name = "URL|FILE|random")]
    policy: Option<String>,
    /// What that model sees and how its answers are meant: a built-in profile (robogate policy profiles), or a
    /// file of your own (TOML)
    #[arg(long, value_name = "NAME|FILE", requires = "policy")]
    profile: Option<String>,
}

impl PolicyArguments {
    /// The policy that they name, if any; its server is asked what it is.
    pub(crate) fn guest(&self) -> Result<Option<Guest>, Exit> {
        match (self.policy.as_deref(), &self.profile) {
            (None, _) => Ok(None),
            (Some("random"), None) => Ok(Some(Guest::Own(Own::Random))),
            (Some("random"), Some(_)) => Err(anyhow!("--policy random has no profile")).or_usage(),
            (Some(server), Some(wanted)) => {
                Served::ask(server, Arc::new(profile(wanted).or_usage()?)).map(|served| Some(Guest::Served(served)))
            }
            (Some(server), None) => {
                Err(anyhow!("--policy {server}: --profile says what it sees and how its answers are meant")).or_usage()
            }
        }
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
