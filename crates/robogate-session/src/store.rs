//! Where a campaign in shards is kept: a folder, or a prefix of an object store.

use std::path::Path;

use anyhow::anyhow;
use robogate_campaign::folder::PLAN;
use robogate_campaign::shards::{DirectoryStore, ShardStore};

use crate::failure::{Failure, OrFailure};
use crate::origin::is_remote;

/// Opens the store of an existing campaign.
///
/// # Errors
/// An address that this build does not know.
pub fn open_store(dir: &Path) -> Result<Box<dyn ShardStore>, Failure> {
    if is_remote(dir) { remote(dir) } else { Ok(Box::new(DirectoryStore::new(dir))) }
}

/// Opens the store of a campaign that may be new.
///
/// # Errors
/// A store that is not empty and contains no plan.
pub fn create_store(dir: &Path) -> Result<Box<dyn ShardStore>, Failure> {
    if !is_remote(dir) {
        let store = DirectoryStore::new(dir);
        store.check_free()?;
        return Ok(Box::new(store));
    }
    let store = remote(dir)?;
    let names = store.list("").or_broken()?;
    match names.first() {
        Some(name) if !names.iter().any(|name| name == PLAN) => {
            Err(anyhow!("{} is not empty (it contains `{name}`) and is not a robogate run", dir.display())).or_request()
        }
        _ => Ok(store),
    }
}

#[cfg(feature = "object-store")]
fn remote(dir: &Path) -> Result<Box<dyn ShardStore>, Failure> {
    let store = crate::object_store::ObjectPrefix::open(&dir.to_string_lossy()).or_request()?;
    Ok(Box::new(store))
}

#[cfg(not(feature = "object-store"))]
fn remote(dir: &Path) -> Result<Box<dyn ShardStore>, Failure> {
    Err(anyhow!(
        "{}: this build of robogate has no object stores\nHint: use a folder, the Python package robogate-eval, or a build with \
         --features object-store",
        dir.display()
    ))
    .or_request()
}
