//! Paths among the arguments.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use clap::builder::{PathBufValueParser, TypedValueParser};

use crate::exit::{Exit, OrExit};

pub(crate) use robogate_session::is_remote;

/// Parses the path of a folder or file on this machine. An address would become a folder with its name.
pub(crate) fn local() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| {
        if is_remote(&path) {
            Err("expected a path on this machine. Only a campaign in shards can be in an object store (docs/guides/cluster.md)")
        } else {
            Ok(path)
        }
    })
}

/// Whether a file or folder, which may not exist yet, is in `folder` or is `folder` itself.
pub(crate) fn is_within(path: &Path, folder: &Path) -> bool {
    let Ok(folder) = folder.canonicalize() else { return false };
    // Links are followed as far as the path exists.
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    absolute.ancestors().find_map(|part| part.canonicalize().ok()).is_some_and(|part| part.starts_with(&folder))
}

/// Rejects two options with the same file: the second one would replace the first.
pub(crate) fn check_different(one: (&str, Option<&Path>), other: (&str, Option<&Path>)) -> Result<(), Exit> {
    let ((first, Some(one)), (second, Some(other))) = (one, other) else { return Ok(()) };
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    if absolute(one) == absolute(other) {
        return Err(anyhow!("{first} and {second} are the same file, {}\nHint: choose two files", one.display()))
            .or_usage();
    }
    Ok(())
}

/// Rejects an address as the `--out` of a campaign that is not divided into shards.
pub(crate) fn check_local(out: &Path) -> Result<(), Exit> {
    if is_remote(out) {
        return Err(anyhow!(
            "--out {}: an object store needs --divide or --shard (docs/guides/cluster.md)",
            out.display()
        ))
        .or_usage();
    }
    Ok(())
}

/// A name of a folder: other characters than letters, digits, `.`, `_` and `-` become `-`.
pub(crate) fn folder_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' };
    let name: String = name.chars().map(plain).collect();
    name.trim_start_matches('.').to_owned()
}
