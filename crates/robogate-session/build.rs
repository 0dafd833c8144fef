//! Computes the hash of the source files that results depend on, so that builds with different physics can be told apart.

use std::env;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// What is hashed, from the root of the workspace: dependencies, code, and files that the code embeds. Each entry of
/// `crates` contributes its folder `src`.
const FILES: [&str; 2] = ["Cargo.lock", "Cargo.toml"];
const FOLDERS: [&str; 2] = ["assets", "python/src"];

fn main() -> io::Result<()> {
    // Read when the script runs, because a compiled script may be kept while its folder moves.
    let package = env::var_os("CARGO_MANIFEST_DIR").ok_or(io::ErrorKind::NotFound)?;
    let root = Path::new(&package).join("../..");
    let mut crates: Vec<PathBuf> =
        fs::read_dir(root.join("crates"))?.map(|entry| Ok(entry?.path().join("src"))).collect::<io::Result<_>>()?;
    crates.retain(|folder| folder.is_dir());
    let hashed = FILES.iter().chain(&FOLDERS).map(|name| root.join(name)).chain(crates);
    let mut files = Vec::new();
    for path in hashed {
        collect(&path, &mut files)?;
    }
    // Files and not their folders, where Python writes its caches. A new file has an effect only if one of these names it.
    for path in &files {
        writeln!(io::stdout(), "cargo::rerun-if-changed={}", path.display())?;
    }
    // Names with one separator and in one order give the same hash on every machine.
    let mut named: Vec<(String, PathBuf)> = files
        .into_iter()
        .map(|path| {
            let name = path.strip_prefix(&root).unwrap_or(&path).to_string_lossy().replace('\\', "/");
            (name, path)
        })
        .collect();
    named.sort();
    let mut hash = Sha256::new();
    for (name, path) in named {
        let content = fs::read(&path)?;
        // Each length precedes its content, so that different trees give different bytes.
        hash.update((name.len() as u64).to_le_bytes());
        hash.update(&name);
        hash.update((content.len() as u64).to_le_bytes());
        hash.update(&content);
    }
    let digits: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    writeln!(io::stdout(), "cargo::rustc-env=ROBOGATE_SOURCE_SHA256={digits}")
}

/// The files below `path`, without what Python and pip generate.
fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_dir() {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name == "__pycache__" || name.ends_with(".egg-info") {
            return Ok(());
        }
        fs::read_dir(path)?.try_for_each(|entry| collect(&entry?.path(), files))
    } else {
        files.push(path.to_owned());
        Ok(())
    }
}
