//! A prefix of an object store: Amazon S3, Google Cloud Storage or Azure Blob Storage, and services with their interfaces.
//!
//! Credentials and endpoints are environment variables of the services, such as `AWS_ACCESS_KEY_ID` and `AWS_ENDPOINT`.

use std::ffi::OsString;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt, PutMode};
use robogate_campaign::shards::{ShardStore, Stored};
use tokio::runtime::{Builder, Runtime};
use url::Url;

/// The schemes of addresses.
const SCHEMES: [&str; 3] = ["s3", "gs", "az"];
/// How the environment variables of the services start. Their library also takes names without this start, such as `TOKEN` or
/// `TIMEOUT`, which belong to other programs.
const VARIABLES: [&str; 3] = ["aws_", "google_", "azure_"];
/// How often an object is created that no writer has stored.
const ATTEMPTS: u32 = 6;
/// The pause after the first attempt. Each pause is twice as long as the one before.
const FIRST_PAUSE: Duration = Duration::from_millis(100);

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
        let settings = settings(std::env::vars_os())?;
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
        let put = || {
            let put = self.store.put_opts(&path, bytes.to_vec().into(), PutMode::Create.into());
            self.runtime.block_on(put).map(|_| ())
        };
        let exists = || match self.runtime.block_on(self.store.head(&path)) {
            Ok(_) => Ok(true),
            Err(Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(error),
        };
        create(put, exists, |pause| self.runtime.block_on(tokio::time::sleep(pause)))
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
        Ok(names(&path, listed.objects.iter().map(|object| &object.location)))
    }

    /// An object exists completely or not at all.
    fn remove_leftovers(&self) -> io::Result<()> {
        Ok(())
    }

    fn place(&self, name: &str) -> PathBuf {
        if name.is_empty() { PathBuf::from(&self.address) } else { PathBuf::from(format!("{}/{name}", self.address)) }
    }
}

/// The settings of the services among environment variables.
fn settings(variables: impl Iterator<Item = (OsString, OsString)>) -> anyhow::Result<Vec<(String, String)>> {
    let mut settings = Vec::new();
    for (name, value) in variables {
        let Some(name) = name.to_str().map(str::to_ascii_lowercase) else { continue };
        if VARIABLES.iter().any(|start| name.starts_with(start)) {
            let value = value.into_string();
            let value = value.map_err(|_| anyhow!("{}: its value is not UTF-8", name.to_ascii_uppercase()))?;
            settings.push((name, value));
        }
    }
    Ok(settings)
}

/// Creates an object with the conditional request `put`, unless it `exists`.
fn create(
    mut put: impl FnMut() -> object_store::Result<()>,
    mut exists: impl FnMut() -> object_store::Result<bool>,
    mut pause: impl FnMut(Duration),
) -> io::Result<Stored> {
    let mut length = FIRST_PAUSE;
    let mut left = ATTEMPTS;
    loop {
        left -= 1;
        let error = match put() {
            Ok(()) => return Ok(Stored::New),
            Err(error) => error,
        };
        match error {
            // S3 also refuses a request while that of another writer runs, which may fail. Then no object exists.
            Error::AlreadyExists { .. } | Error::Precondition { .. } => {
                if exists().map_err(io::Error::other)? {
                    return Ok(Stored::Exists);
                }
                if left == 0 {
                    return Err(io::Error::other(error));
                }
                pause(length);
                length *= 2;
            }
            // The service may have stored the object although its answer was lost.
            Error::Generic { .. } if exists().unwrap_or(false) => return Ok(Stored::Exists),
            error => return Err(io::Error::other(error)),
        }
    }
}

/// The sorted names of objects in a folder. The folder itself may be an object, which S3's console creates.
fn names<'a>(folder: &Path, objects: impl Iterator<Item = &'a Path>) -> Vec<String> {
    let name = |object: &Path| Some(object.prefix_match(folder)?.next()?.as_ref().to_owned());
    let mut names: Vec<String> = objects.filter_map(name).collect();
    names.sort_unstable();
    names
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

    fn refused() -> Error {
        Error::AlreadyExists { path: "x".to_owned(), source: "409 Conflict".into() }
    }

    /// Creates an object. `answers` are those of the requests, and `existing` tells whether the object exists after each of
    /// them. Returns the result and the number of pauses.
    fn created(answers: Vec<object_store::Result<()>>, existing: &[bool]) -> (io::Result<Stored>, usize) {
        let (mut answers, mut existing) = (answers.into_iter(), existing.iter());
        let mut pauses = 0;
        let exists = || Ok(*existing.next().unwrap());
        let stored = create(|| answers.next().unwrap(), exists, |_| pauses += 1);
        assert_eq!((answers.len(), existing.len()), (0, 0), "every answer is used");
        (stored, pauses)
    }

    #[test]
    fn refused_request_without_object_is_repeated() {
        let (stored, pauses) = created(vec![Err(refused()), Err(refused()), Ok(())], &[false, false]);
        assert_eq!((stored.unwrap(), pauses), (Stored::New, 2));
        let (stored, pauses) = created(vec![Err(refused()), Err(refused())], &[false, true]);
        assert_eq!((stored.unwrap(), pauses), (Stored::Exists, 1));
        let attempts = ATTEMPTS as usize;
        let (stored, pauses) = created((0..attempts).map(|_| Err(refused())).collect(), &vec![false; attempts]);
        assert!(stored.unwrap_err().to_string().contains("409 Conflict"));
        assert_eq!(pauses, attempts - 1);
    }

    #[test]
    fn lost_answer_is_looked_up() {
        let lost = || Error::Generic { store: "S3", source: "timeout".into() };
        let (stored, _) = created(vec![Err(lost())], &[true]);
        assert_eq!(stored.unwrap(), Stored::Exists);
        let (stored, pauses) = created(vec![Err(lost())], &[false]);
        assert!(stored.unwrap_err().to_string().contains("timeout"));
        assert_eq!(pauses, 0);
    }

    #[test]
    fn folder_itself_is_no_name() {
        let objects = ["a/b", "a/b/plan.json", "a/b/boundary.json"].map(Path::from);
        assert_eq!(names(&Path::from("a/b"), objects.iter()), ["boundary.json", "plan.json"]);
    }

    #[test]
    fn only_variables_of_the_services_are_settings() {
        let variables =
            [("AWS_REGION", "r"), ("TIMEOUT", "soon"), ("TOKEN", "t"), ("GOOGLE_BUCKET", "b"), ("XAWS_A", "")];
        let variables = variables.map(|(name, value)| (OsString::from(name), OsString::from(value)));
        let expected = [("aws_region", "r"), ("google_bucket", "b")].map(|(a, b)| (a.to_owned(), b.to_owned()));
        assert_eq!(settings(variables.into_iter()).unwrap(), expected);
    }

    #[cfg(unix)]
    #[test]
    fn variables_of_other_programs_may_have_any_bytes() {
        use std::os::unix::ffi::OsStringExt;

        let variable = |name: &str| [(OsString::from(name), OsString::from_vec(vec![0xff]))].into_iter();
        assert!(settings(variable("OTHER")).unwrap().is_empty());
        let error = settings(variable("AWS_REGION")).unwrap_err().to_string();
        assert!(error.contains("AWS_REGION: its value is not UTF-8"), "{error}");
    }

    #[test]
    fn wrong_addresses_are_explained() {
        for address in ["s3://bucket", "s3://bucket/", "ftp://host/x", "s3:///", "://"] {
            let error = ObjectPrefix::open(address).err().unwrap();
            assert!(format!("{error:#}").contains("expected s3://BUCKET/PREFIX"), "{address}: {error:#}");
        }
    }
}
