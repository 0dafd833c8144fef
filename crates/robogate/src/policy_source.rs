//! Where a policy comes from, as the command names it and a run records it.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use clap::Args;
use robogate_core::{Fault, Policy};
use robogate_policy::{Profile, ServerError, ServerPolicy};
use robogate_tasks::Random;
use serde::{Deserialize, Serialize};

use crate::exit::{Exit, INFRASTRUCTURE, OrExit, USAGE};

/// A policy other than the environment's scripted controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum PolicySource {
    /// Behind a server or in a file.
    External(ExternalPolicy),
    /// Built in.
    BuiltIn(BuiltInPolicy),
}

/// Built-in policies that drive any task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum BuiltInPolicy {
    /// Draws its actions at random.
    Random,
}

/// A learned policy behind a server, or in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExternalPolicy {
    /// Its server's address, or its file.
    server: String,
    /// Observation and action mapping, in full.
    profile: Arc<Profile>,
    /// What the server reported about itself when the run began.
    declared: serde_json::Value,
}

impl PolicySource {
    /// Its name in records.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::External(served) => &served.profile.name,
            Self::BuiltIn(BuiltInPolicy::Random) => "random",
        }
    }

    /// Its observation and action mapping, where it has one.
    pub(crate) fn profile(&self) -> Option<&Profile> {
        match self {
            Self::External(served) => Some(&served.profile),
            Self::BuiltIn(_) => None,
        }
    }

    /// The same policy, with what its server reports now.
    pub(crate) fn asked_again(&self) -> Result<Self, Exit> {
        match self {
            Self::External(served) => {
                ExternalPolicy::ask(&served.server, Arc::clone(&served.profile)).map(Self::External)
            }
            Self::BuiltIn(own) => Ok(Self::BuiltIn(*own)),
        }
    }

    /// A new instance, for a worker of its own.
    pub(crate) fn policy(&self) -> Result<Box<dyn Policy>, Fault> {
        Ok(match self {
            Self::External(served) => Box::new(ServerPolicy::connect(&served.server, Arc::clone(&served.profile))?),
            Self::BuiltIn(BuiltInPolicy::Random) => Box::new(Random::new()),
        })
    }
}

impl ExternalPolicy {
    /// Connects to a server and records what it reports about itself.
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
    /// Choose the policy: scripted (the environment's own controller, the default), random (actions drawn within the
    /// bounds of the task), the address of a policy server such as ws://127.0.0.1:8000, or an ONNX file
    #[arg(long, value_name = "URL|FILE|random|scripted")]
    policy: Option<String>,
    /// Choose the observation and action mapping of that policy: a built-in profile (see `robogate policy profiles`), or
    /// a file of your own (TOML)
    #[arg(long, value_name = "NAME|FILE", requires = "policy")]
    profile: Option<String>,
}

impl PolicyArguments {
    /// The policy that they name; `None` for the scripted controller.
    pub(crate) fn source(&self) -> Result<Option<PolicySource>, Exit> {
        match (self.policy.as_deref(), &self.profile) {
            (None, _) | (Some("scripted"), None) => Ok(None),
            (Some("random"), None) => Ok(Some(PolicySource::BuiltIn(BuiltInPolicy::Random))),
            (Some(name @ ("random" | "scripted")), Some(_)) => {
                Err(anyhow!("--policy {name} takes no profile\n  hint: leave out --profile")).or_usage()
            }
            (Some(server), Some(wanted)) => {
                ExternalPolicy::ask(server, Arc::new(profile(wanted).or_usage()?)).map(|served| Some(PolicySource::External(served)))
            }
            (Some(server), None) => {
                Err(anyhow!("--policy {server}: an external policy needs a profile\n  hint: add --profile NAME (see `robogate policy profiles`)")).or_usage()
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
            bail!("--profile {wanted}: unknown profile. Expected a file, or one of: {known}")
        }
        None => {
            let text = std::fs::read_to_string(wanted).with_context(|| format!("cannot read {wanted}"))?;
            Profile::from_toml(&text).with_context(|| wanted.to_owned())
        }
    }
}

/// A server's error with its exit code: usage where the settings are wrong, else infrastructure.
pub(crate) fn refused(error: ServerError) -> Exit {
    let code = if error.is_in_the_settings() { USAGE } else { INFRASTRUCTURE };
    Exit { code, error: error.into() }
}
