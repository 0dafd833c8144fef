//! `robogate monitor`: a deployed robot's cycles watched for drift.

mod reference;
mod serve;
mod simulate;

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, Subcommand};
use robogate_monitor::Reference;
use robogate_monitor::service::ServiceSettings;

use crate::exit::{Exit, OrExit};

/// Watch a deployed robot: drift of its cycles, with alarms whose false-alarm rate is promised.
#[derive(Debug, Args)]
pub(crate) struct Monitor {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Hear cycles and tell alarms
    Serve(serve::Serve),
    /// Say how often it would cry wolf, and how late it would see a drop
    Simulate(simulate::Simulate),
    /// Write what the monitor needs to know of a run: its baseline, and what was validated
    Reference(reference::ReferenceOf),
}

impl Monitor {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.verb {
            Verb::Serve(serve) => serve.execute(),
            Verb::Simulate(simulate) => simulate.execute(),
            Verb::Reference(reference) => reference.execute(),
        }
    }
}

/// What is watched.
#[derive(Debug, Args)]
struct Watched {
    /// Settings (TOML): promises, shares, baselines of the recipes, store, limits
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// What was validated (from `robogate monitor reference`), for one recipe or for all without one of their own
    #[arg(long, value_name = "[RECIPE=]FILE")]
    reference: Vec<String>,
}

impl Watched {
    fn settings(&self) -> Result<ServiceSettings, Exit> {
        let mut settings = match &self.settings {
            Some(path) => settings(path)?,
            None => ServiceSettings::default(),
        };
        for named in &self.reference {
            let (recipe, path) = match named.split_once('=') {
                Some((recipe, path)) => (Some(recipe), path),
                None => (None, named.as_str()),
            };
            settings.detectors.refer(recipe, reference(Path::new(path))?);
        }
        settings.detectors.check().or_usage()?;
        Ok(settings)
    }
}

fn settings(path: &Path) -> Result<ServiceSettings, Exit> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    let settings: ServiceSettings = toml::from_str(&text).with_context(|| format!("{}", path.display())).or_usage()?;
    settings.check().with_context(|| format!("{}", path.display())).or_usage()?;
    Ok(settings)
}

fn reference(path: &Path) -> Result<Reference, Exit> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    let hint = || format!("{} is no reference; hint: robogate monitor reference", path.display());
    let reference: Reference = serde_json::from_str(&text).with_context(hint).or_usage()?;
    reference.check().with_context(|| format!("{}", path.display())).or_usage()?;
    Ok(reference)
}
