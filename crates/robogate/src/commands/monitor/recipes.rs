//! `robogate monitor recipes`: the recipes in a store.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::{Args, Subcommand};
use robogate_monitor::service::{Store, StoreError, StoreSettings};
use robogate_stats::format::counted;
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{foreign, grouped, line, note};

/// List, remove or merge the recipes in a store. Stop `robogate monitor serve` first: one process uses a
/// store.
#[derive(Debug, Args)]
pub(super) struct Recipes {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// List the recipes with the numbers of their stored cycles
    List(List),
    /// Remove recipes with their cycles: invented names use up the places of real ones
    Remove(Remove),
    /// Give the cycles of a recipe to another one, for example after a change of its name
    Merge(Merge),
}

#[derive(Debug, Args)]
struct List {
    /// SQLite file of the monitor
    store: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct Remove {
    /// SQLite file of the monitor
    store: PathBuf,
    /// Names of the recipes
    #[arg(required = true)]
    recipes: Vec<String>,
}

#[derive(Debug, Args)]
struct Merge {
    /// SQLite file of the monitor
    store: PathBuf,
    /// Recipe that ends
    from: String,
    /// Recipe that receives the cycles. Its baseline is learnt again from all of them
    into: String,
}

impl Recipes {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            What::List(List { store, json }) => list(store, *json),
            What::Remove(Remove { store, recipes }) => remove(store, recipes),
            What::Merge(Merge { store, from, into }) => merge(store, from, into),
        }
    }
}

/// Opens a store that exists.
fn open(path: &Path) -> Result<Store, Exit> {
    if !path.is_file() {
        return Err(anyhow!("{}: no such store\nHint: name the file of --store", path.display())).or_usage();
    }
    at(path, Store::open(path, StoreSettings::default()))
}

/// A result of a store, whose error names the file.
fn at<T>(path: &Path, result: Result<T, StoreError>) -> Result<T, Exit> {
    result.with_context(|| path.display().to_string()).or_broken()
}

/// Rejects names that the store does not have.
fn check(path: &Path, store: &Store, names: &[&str]) -> Result<(), Exit> {
    let known = at(path, store.recipe_counts())?;
    match names.iter().find(|name| known.iter().all(|(known, _)| known != **name)) {
        Some(name) => {
            let hint = "list the recipes: robogate monitor recipes list STORE";
            Err(anyhow!("{}: no such recipe in the store\nHint: {hint}", foreign(name))).or_usage()
        }
        None => Ok(()),
    }
}

fn list(store: &Path, as_json: bool) -> Result<u8, Exit> {
    let all = at(store, open(store)?.recipe_counts())?;
    if as_json {
        let recipes: Vec<_> = all.iter().map(|(name, cycles)| json!({ "recipe": name, "cycles": cycles })).collect();
        line(json!({ "version": 1, "recipes": recipes }));
    } else {
        all.iter().for_each(|(name, cycles)| line(format_args!("{:>12}  {}", grouped(*cycles), foreign(name))));
        note(counted(all.len() as u64, "recipe"));
    }
    Ok(DONE)
}

fn remove(path: &Path, names: &[String]) -> Result<u8, Exit> {
    let store = open(path)?;
    check(path, &store, &names.iter().map(String::as_str).collect::<Vec<_>>())?;
    for name in names {
        let cycles = at(path, store.remove_recipe(name))?;
        note(format_args!("removed {} with {}", foreign(name), counted(cycles, "cycle")));
    }
    Ok(DONE)
}

fn merge(path: &Path, from: &str, into: &str) -> Result<u8, Exit> {
    if from == into {
        return Err(anyhow!("{}: a recipe cannot be merged with itself", foreign(from))).or_usage();
    }
    let store = open(path)?;
    check(path, &store, &[from, into])?;
    let cycles = at(path, store.merge_recipe(from, into))?;
    let (from, into) = (foreign(from), foreign(into));
    note(format_args!(
        "moved {} of {from} to {into}, whose state the next start computes again",
        counted(cycles, "cycle")
    ));
    Ok(DONE)
}
