//! A prefix of an object store: Amazon S3, Google Cloud Storage or Azure Blob Storage, and services with their interfaces.
//!
//! Credentials and endpoints are environment variables of the services, such as `AWS_ACCESS_KEY_ID` and `AWS_ENDPOINT`.

use std::io;
use std::path::PathBuf;

use anyhow::{Context, bail};
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt, PutMode};
use robogate_campaign::shards::{ShardStore, Stored};
use tokio::runtime::{Builder, Runtime};
use url::Url;

/// The schemes of addresses.
const SCHEMES: [&str; 3] = ["s3", "gs", "az"];

/// A prefix of an object store. An object is created with a conditional request, which only one of several writers wins.
pub(crate) struct ObjectPrefix {
    address: String,
    store: Box<dyn ObjectStore>,
    prefix: Path,
    runtime: Runtime,
}

impl ObjectPrefix {
    /// Opens the address `SCHEME://BUCKET/PREFIX`. No request is sent.
    pub(crate) fn open(address: &str) -> anyhow::Result<Self> {
        let expected =
            || format!("{address}: expected s3://BUCKET/PREFIX, gs://BUCKET/PREFIX or az://CONTAINER/PREFIX");
        let url = Url::parse(address).with_context(expected)?;
        if !SCHEMES.contains(&url.scheme()) || url.path().trim_matches('/').is_empty() {
            bail!(expected());
        }
        // It fails if another part of the process has chosen one.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let settings = std::env::vars().map(|(name, value)| (name.to_ascii_lowercase(), value));
        let (store, prefix) = object_store::parse_url_opts(&url, settings).with_context(|| address.to_owned())?;
        Self::new(address, store, prefix)
    }

    fn new(address: &str, store: Box<dyn ObjectStore>, prefix: Path) -> anyhow::Result<Self> {
        let runtime = Builder::new_current_thread().enable_all().build().context("cannot start the network runtime")?;
        Ok(Self { address: address.trim_end_matches('/').to_owned(), store, prefix, runtime })
    }

    fn path(&self, name: &str) -> Path {
        name.split('/').filter(|part| !part.is_empty()).fold(self.prefix.clone(), |path, part| path.join(part))
    }
}

impl ShardStore for ObjectPrefix {
    fn put_if_absent(&self, name: &str, bytes: &[u8]) -> io::Result<Stored> {
        let path = self.path(name);
        let put = self.store.put_opts(&path, bytes.to_vec().into(), PutMode::Create.into());
        match self.runtime.block_on(put) {
            Ok(_) => Ok(Stored::New),
            Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => Ok(Stored::Exists),
            Err(error) => Err(io::Error::other(error)),
        }
    }

    fn get(&self, name: &str) -> io::Result<Option<Vec<u8>>> {
        let path = self.path(name);
        let content = self.runtime.block_on(async { self.store.get(&path).await?.bytes().await });
        match content {
            Ok(bytes) => Ok(Some(bytes.to_vec())),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(io::Error::other(error)),
        }
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let path = self.path(folder);
        let listed = self.runtime.block_on(self.store.list_with_delimiter(Some(&path))).map_err(io::Error::other)?;
        let mut names: Vec<String> =
            listed.objects.iter().filter_map(|object| Some(object.location.filename()?.to_owned())).collect();
        names.sort_unstable();
        Ok(names)
    }

    /// An object exists completely or not at all.
    fn remove_leftovers(&self) -> io::Result<()> {
        Ok(())
    }

    fn place(&self, name: &str) -> PathBuf {
        if name.is_empty() { PathBuf::from(&self.address) } else { PathBuf::from(format!("{}/{name}", self.address)) }
    }
}

#[cfg(test)]
mod tests {
    use object_store::memory::InMemory;

    use super::*;

    #[test]
    fn first_writer_wins() {
        let store = ObjectPrefix::new("s3://bucket/a/b/", Box::new(InMemory::new()), Path::from("a/b")).unwrap();
        assert_eq!(store.get("shards/x").unwrap(), None);
        assert_eq!(store.put_if_absent("shards/x", b"one").unwrap(), Stored::New);
        assert_eq!(store.put_if_absent("shards/x", b"two").unwrap(), Stored::Exists);
        assert_eq!(store.put_if_absent("plan.json", b"{}").unwrap(), Stored::New);
        assert_eq!(store.get("shards/x").unwrap().unwrap(), b"one");
        assert_eq!(store.list("shards").unwrap(), ["x"]);
        assert_eq!(store.list("").unwrap(), ["plan.json"]);
        assert_eq!(store.place("shards/x"), PathBuf::from("s3://bucket/a/b/shards/x"));
    }

    #[test]
    fn wrong_addresses_are_explained() {
        for address in ["s3://bucket", "s3://bucket/", "ftp://host/x", "s3:///", "://"] {
            let error = ObjectPrefix::open(address).err().unwrap();
            assert!(format!("{error:#}").contains("expected s3://BUCKET/PREFIX"), "{address}: {error:#}");
        }
    }
}
