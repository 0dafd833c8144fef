//! A second Python environment beside the first: the same packages, except for some.
//!
//! It contains only what pip installs for the requested packages. Everything else comes from the folders of the first environment, which
//! stay as they are. It is kept in the user's cache folder.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use anyhow::{Context, anyhow};
use robogate_dictionary::hex;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::environments::{cache, installed_marker};
use crate::failure::{Failure, OrFailure};
use crate::notice::note;

/// Asks a Python for its packages. Modules in the current folder are not imported.
const ASK: &str = r#"
import sys
sys.path[:] = [path for path in sys.path if path]
import importlib.metadata, importlib.util, json, os
packages = {}
for found in importlib.metadata.distributions():
    name = (found.metadata["Name"] or "").lower().replace("_", "-").replace(".", "-")
    packages.setdefault(name, found.version)
packages.pop("", None)
folders = [path for path in sys.path if os.path.basename(path) in ("site-packages", "dist-packages")]
print(json.dumps({"python": sys.executable, "version": sys.version, "packages": packages, "folders": folders,
                  "has_pip": importlib.util.find_spec("pip") is not None}))
"#;

/// A Python with its packages.
#[derive(Debug, Clone, Deserialize)]
pub struct Packages {
    python: PathBuf,
    version: String,
    /// Versions by name.
    pub packages: BTreeMap<String, String>,
    folders: Vec<PathBuf>,
    has_pip: bool,
}

/// A package with another version.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct VersionChange {
    /// Its name.
    pub package: String,
    /// The version before. `None` if it was not installed.
    pub before: Option<String>,
    /// The version after.
    pub after: Option<String>,
}

impl Packages {
    /// Its interpreter.
    pub(super) fn path(&self) -> &Path {
        &self.python
    }

    /// The packages of this Python.
    pub fn of(python: &Path) -> Result<Self, Failure> {
        let output = run(Command::new(python).args(["-c", ASK])).or_request()?;
        let text = String::from_utf8_lossy(&output.stdout);
        let line = text.lines().last().unwrap_or_default();
        serde_json::from_str(line)
            .with_context(|| format!("{}: cannot list its packages: {}", python.display(), errors(&output)))
            .or_request()
    }

    /// The versions that differ in another Python.
    pub fn changes(&self, other: &Self) -> Vec<VersionChange> {
        let names: std::collections::BTreeSet<&String> = self.packages.keys().chain(other.packages.keys()).collect();
        let change = |name: &String| {
            let (before, after) = (self.packages.get(name).cloned(), other.packages.get(name).cloned());
            (before != after).then(|| VersionChange { package: name.clone(), before, after })
        };
        names.into_iter().filter_map(change).collect()
    }

    /// A Python with the packages of this one, and with these requirements of pip: `PACKAGE==VERSION`, or a wheel or folder. Returns
    /// its path.
    ///
    /// # Errors
    /// A requirement without a version, a version that does not exist, or an installation that fails.
    pub fn with(&self, requirements: &[String]) -> Result<PathBuf, Failure> {
        let requirements = requirements.iter().map(|text| pinned(text)).collect::<Result<Vec<String>, Failure>>()?;
        let folder = cache().or_broken()?.join("requalify").join(self.key(&requirements)?);
        let python = folder.join("bin/python");
        let marker = installed_marker(&folder);
        if marker.is_file() {
            return Ok(python);
        }
        if folder.exists() {
            fs::remove_dir_all(&folder).with_context(|| format!("cannot remove {}", folder.display())).or_broken()?;
        }
        note(format_args!("creating a Python environment with {} in {}", requirements.join(" "), folder.display()));
        let parent = folder.parent().unwrap_or(&folder);
        fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display())).or_broken()?;
        // Without the packages that a new environment has otherwise: they would hide those of the first.
        let bare = self.has_pip.then_some("--without-pip");
        let mut make = Command::new(&self.python);
        make.args(["-m", "venv"]).args(bare).arg(&folder).current_dir(parent);
        succeed(&mut make).or_broken()?;
        let own = Self::of(&python)?;
        let site = own.folders.iter().find(|path| path.starts_with(&folder)).cloned();
        let site = site.ok_or_else(|| anyhow!("{}: it has no folder for packages", folder.display())).or_broken()?;
        let add: Vec<String> =
            self.folders.iter().map(|path| format!("site.addsitedir({:?})", path.display().to_string())).collect();
        fs::write(site.join("zz_first_environment.pth"), format!("import site; {}\n", add.join("; "))).or_broken()?;
        let mut pip = Command::new(&python);
        pip.current_dir(parent)
            .args(["-m", "pip", "install", "--disable-pip-version-check", "--no-input"])
            .args(&requirements);
        let output = run(&mut pip).or_broken()?;
        if !output.status.success() {
            let text = errors(&output);
            // Nothing that the user can correct but the requirement, or a network that is gone.
            let missing = text.contains("No matching distribution") || text.contains("Invalid requirement");
            let error = anyhow!(
                "pip cannot install {}: {text}\nHint: `python -m pip index versions PACKAGE` lists versions",
                requirements.join(" ")
            );
            return Err(Failure::broken_if(!missing, error));
        }
        // Written last, so that an interrupted installation is repeated.
        fs::write(&marker, requirements.join("\n")).or_broken()?;
        Ok(python)
    }

    /// The versions of a package that pip finds after `from` and up to `to`, in their order. Versions for tests only are left out.
    pub fn versions(&self, package: &str, to: &str) -> Result<Vec<String>, Failure> {
        let mut pip = Command::new(&self.python);
        pip.args(["-m", "pip", "index", "versions", "--disable-pip-version-check", package]);
        let output = run(&mut pip).or_broken()?;
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let listed = text.lines().find_map(|line| line.trim().strip_prefix("Available versions:"));
        let Some(listed) = listed.filter(|_| output.status.success()) else {
            return Err(anyhow!(
                "pip lists no versions of {package}: {}\nHint: name them with --versions A,B,C",
                errors(&output)
            ))
            .or_request();
        };
        let mut versions: Vec<String> = listed.split(',').map(|version| version.trim().to_owned()).collect();
        versions.sort_by_key(|version| order(version));
        let name = package.to_lowercase().replace(['_', '.'], "-");
        let from = self.packages.get(&name).map(|version| order(version)).unwrap_or_default();
        versions.retain(|version| from < order(version) && order(version) <= order(to));
        Ok(versions)
    }

    /// The name of the folder of an environment with these requirements.
    fn key(&self, requirements: &[String]) -> Result<String, Failure> {
        let mut digest = Sha256::new();
        for text in [&*self.python.to_string_lossy(), &*self.version]
            .into_iter()
            .map(str::to_owned)
            .chain(self.packages.iter().map(|(name, version)| format!("{name}=={version}")))
        {
            digest.update(text);
            digest.update([0]);
        }
        for requirement in requirements {
            digest.update(requirement);
            let path = Path::new(requirement);
            if path.exists() {
                content(path, &mut digest, 0)
                    .with_context(|| format!("cannot read {}", path.display()))
                    .or_request()?;
            }
            digest.update([0]);
        }
        Ok(hex(&digest.finalize()).chars().take(16).collect())
    }
}

/// Adds what is written to a digest.
struct DigestWriter<'a>(&'a mut Sha256);

impl std::io::Write for DigestWriter<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Adds the content of a wheel, or of a folder that pip builds: names and bytes of its files. What Python and version control write there
/// is left out.
fn content(path: &Path, digest: &mut Sha256, depth: usize) -> anyhow::Result<()> {
    /// The deepest folder. Deeper files are not part of a package.
    const DEEPEST: usize = 16;
    if !path.is_dir() {
        if !path.is_file() {
            anyhow::bail!("neither a file nor a folder");
        }
        std::io::copy(&mut fs::File::open(path)?, &mut DigestWriter(digest))?;
        return Ok(());
    }
    let mut entries: Vec<_> = fs::read_dir(path)?.collect::<std::io::Result<_>>()?;
    entries.sort_by_key(std::fs::DirEntry::file_name);
    for entry in entries {
        let name = entry.file_name().to_string_lossy().into_owned();
        let written = ["__pycache__", ".git", ".hg", ".venv", ".tox"].contains(&&*name)
            || name.ends_with(".egg-info")
            || (depth == 0 && name == "build");
        // A link may lead back to this folder.
        let leads = entry.file_type()?.is_symlink() && entry.path().is_dir();
        if written || leads || depth == DEEPEST {
            continue;
        }
        digest.update(&name);
        digest.update([0]);
        content(&entry.path(), digest, depth + 1)?;
        digest.update([0]);
    }
    Ok(())
}

/// A requirement with an exact version, or the absolute path of a wheel or a folder.
fn pinned(text: &str) -> Result<String, Failure> {
    let path = Path::new(text);
    if path.components().count() > 1 || text.ends_with(".whl") {
        return path
            .canonicalize()
            .map(|full| full.display().to_string())
            .with_context(|| {
                format!("--env-with {text}: cannot be read\nHint: name a wheel or a folder, or PACKAGE==VERSION")
            })
            .or_request();
    }
    let plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "=-_.[],+!".contains(c));
    match text.split_once("==") {
        Some((name, version)) if plain && name.starts_with(|c: char| c.is_ascii_alphanumeric()) && !version.is_empty() => Ok(text.to_owned()),
        _ => Err(anyhow!("--env-with {text}: expected PACKAGE==VERSION, a wheel or a folder\nHint: for example --env-with mujoco==3.9.0"))
            .or_request(),
    }
}

/// The numbers of a version, for comparisons.
fn order(version: &str) -> Vec<u64> {
    version.split(|c: char| !c.is_ascii_digit()).filter_map(|part| part.parse().ok()).collect()
}

fn run(command: &mut Command) -> anyhow::Result<Output> {
    let shown = command.get_program().to_string_lossy().into_owned();
    command.stdin(Stdio::null()).output().with_context(|| format!("cannot start {shown}"))
}

fn succeed(command: &mut Command) -> anyhow::Result<()> {
    let output = run(command)?;
    if output.status.success() { Ok(()) } else { Err(anyhow!("{command:?} failed: {}", errors(&output))) }
}

/// The last lines that a program printed as an error.
fn errors(output: &Output) -> String {
    const LINES: usize = 8;
    let text = String::from_utf8_lossy(&output.stderr);
    let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("[notice]")).collect();
    let last = lines[lines.len().saturating_sub(LINES)..].iter().map(|line| crate::text::foreign(line).to_string());
    last.collect::<Vec<_>>().join("\n  ").trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_pinned() {
        assert_eq!(pinned("mujoco-core==4.0.1").unwrap(), "mujoco-core==4.0.1");
        for wrong in ["mujoco", "mujoco>=3", "--index-url==x", "a==b;c", "mujoco==", "./missing.whl"] {
            assert!(pinned(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn changed_folder_is_another_environment() {
        let folder = tempfile::TempDir::new().unwrap();
        let of = || {
            let mut digest = Sha256::new();
            content(folder.path(), &mut digest, 0).unwrap();
            hex(&digest.finalize())
        };
        let write = |name: &str, text: &str| {
            fs::create_dir_all(folder.path().join(name).parent().unwrap()).unwrap();
            fs::write(folder.path().join(name), text).unwrap();
        };
        write("pack/__init__.py", "DRAG = 1.0");
        let first = of();
        write("pack/__pycache__/x.pyc", "x");
        write(".git/HEAD", "x");
        assert_eq!(of(), first);
        write("pack/__init__.py", "DRAG = 2.5");
        assert_ne!(of(), first);
    }

    #[test]
    fn versions_have_an_order() {
        let mut versions = ["3.10.0", "3.9.0", "3.3.0", "4.0.1", "3.8.1"];
        versions.sort_by_key(|version| order(version));
        assert_eq!(versions, ["3.3.0", "3.8.1", "3.9.0", "3.10.0", "4.0.1"]);
    }
}
