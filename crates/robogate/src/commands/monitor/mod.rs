//! `robogate monitor`: detects drift of deployed robots.

mod bag;
mod cycles;
mod recipes;
mod reference;
mod results;
mod rosbridge;
mod serve;
mod simulate;
mod simulated;

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::{Args, Subcommand};
use robogate_core::budget::Budget;
use robogate_dictionary::read_text;
use robogate_monitor::service::{ServiceSettings, TopicMap};
use robogate_monitor::{EventSettings, Reference, default_events};

use crate::exit::{Exit, OrExit};
use crate::terminal::note;

/// Detect drift of deployed robots, with a bounded false-alarm rate.
#[derive(Debug, Args)]
pub(crate) struct Monitor {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Ingest cycle records and raise alarms
    Serve(Box<serve::Serve>),
    /// Print the cycles of a recording or of a dictionary as JSON Lines
    Cycles(cycles::Cycles),
    /// Simulate false-alarm rates and detection delays
    Simulate(simulate::Simulate),
    /// List, remove or merge the recipes in a store
    Recipes(recipes::Recipes),
    /// Write the reference file of a run: baseline, envelope and risk model
    Reference(reference::ReferenceOf),
}

impl Monitor {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.verb {
            Verb::Serve(serve) => serve.execute(),
            Verb::Cycles(cycles) => cycles.execute(),
            Verb::Simulate(simulate) => simulate.execute(),
            Verb::Recipes(recipes) => recipes.execute(),
            Verb::Reference(reference) => reference.execute(),
        }
    }
}

/// Arguments that configure the detectors.
#[derive(Debug, Args)]
struct Watched {
    /// Read settings from this file (TOML): false-alarm limits, baselines of the recipes, store, server limits
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Use this reference file from `robogate monitor reference`, for one recipe or for all recipes without their own
    #[arg(long, value_name = "[RECIPE=]FILE")]
    reference: Vec<String>,
}

/// A reference file, and the recipe that it is for. `None`: all recipes without their own.
struct Referred {
    recipe: Option<String>,
    path: PathBuf,
    reference: Reference,
}

impl Watched {
    fn settings(&self) -> Result<(ServiceSettings, Vec<Referred>), Exit> {
        let mut settings = match &self.settings {
            Some(path) => settings(path)?,
            None => ServiceSettings::default(),
        };
        let mut referred = Vec::with_capacity(self.reference.len());
        for named in &self.reference {
            let (recipe, path) = match named.split_once('=') {
                Some((recipe, path)) => (Some(recipe), path),
                None => (None, named.as_str()),
            };
            let path = PathBuf::from(path);
            let reference = reference(&path)?;
            settings.detectors.refer(recipe, reference.clone());
            referred.push(Referred { recipe: recipe.map(str::to_owned), path, reference });
        }
        settings.detectors.check().or_usage()?;
        Ok((settings, referred))
    }
}

fn settings(path: &Path) -> Result<ServiceSettings, Exit> {
    let text = read_text(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    let context = || format!("{}", path.display());
    let mut table: toml::Table = toml::from_str(&text).with_context(context).or_usage()?;
    let renamed = table.get_mut("detectors").and_then(toml::Value::as_table_mut).map_or_else(Vec::new, rename);
    for (old, new) in &renamed {
        note(format_args!("note: {}: `detectors.{old}` is the old name of `detectors.{new}`", path.display()));
    }
    // Errors in the text have a line number, those in the table have none.
    let settings: ServiceSettings =
        if renamed.is_empty() { toml::from_str(&text) } else { table.try_into() }.with_context(context).or_usage()?;
    settings.check().with_context(|| format!("{}", path.display())).or_usage()?;
    Ok(settings)
}

/// Moves the share of each event that was a field of `shares` to its place. Returns the old and the new names.
fn rename(detectors: &mut toml::Table) -> Vec<(String, String)> {
    let Some(shares) = detectors.get_mut("shares").and_then(toml::Value::as_table_mut) else { return Vec::new() };
    let found: Vec<(String, toml::Value)> =
        default_events().into_keys().filter_map(|event| shares.remove(&event).map(|share| (event, share))).collect();
    if found.is_empty() || detectors.contains_key("events") {
        return Vec::new();
    }
    let mut events = toml::Table::new();
    for (event, EventSettings { share, causes }) in default_events() {
        let former = found.iter().find(|(name, _)| *name == event).map(|(_, share)| share.clone());
        let mut settings = toml::Table::new();
        settings.insert("share".to_owned(), former.unwrap_or(share.into()));
        settings.extend(causes.map(|causes| ("causes".to_owned(), causes.into())));
        events.insert(event, settings.into());
    }
    detectors.insert("events".to_owned(), events.into());
    found.into_iter().map(|(event, _)| (format!("shares.{event}"), format!("events.{event}.share"))).collect()
}

fn reference(path: &Path) -> Result<Reference, Exit> {
    let text = read_text(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    let hint = || {
        format!("{}: not a monitor reference file. Create one with `robogate monitor reference RUN`", path.display())
    };
    let reference: Reference = Budget::FILE.json(text.as_bytes()).with_context(hint).or_usage()?;
    reference.check().with_context(|| format!("{}", path.display())).or_usage()?;
    Ok(reference)
}

fn topic_map(path: &Path) -> Result<TopicMap, Exit> {
    let text = read_text(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    TopicMap::parse(&text).map_err(|because| anyhow!("{}: {because}", path.display())).or_usage()
}
