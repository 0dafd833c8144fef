//! Policies that the process of an environment loads: a checkpoint of LeRobot, or a model of Stable-Baselines3.

use std::path::{Component, Path, PathBuf};

use anyhow::{anyhow, bail};

/// What stands before the path of such a policy.
const KINDS: [&str; 2] = ["lerobot:", "sb3:"];
/// The argument of a policy that is a file.
const STATISTICS: &str = "statistics=";
/// Folders of checkpoints whose names say nothing about the policy.
const GENERIC: [&str; 4] = ["pretrained_model", "checkpoints", "last", "best_model"];

/// A policy that the process of an environment loads beside the environment's own.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoadedPolicy {
    /// Its name in the declaration of the environment and in records.
    pub name: String,
    /// `lerobot:FOLDER`, or `sb3:FILE` or `sb3:FOLDER`, with an absolute path, and arguments after a `?`.
    pub from: String,
}

impl LoadedPolicy {
    /// The policy that the user names as `lerobot:PATH` or `sb3:PATH`. `None` for any other policy.
    ///
    /// # Errors
    /// A path that does not exist.
    pub fn of(policy: &str) -> anyhow::Result<Option<Self>> {
        let Some((kind, named)) = KINDS.iter().find_map(|kind| Some((*kind, policy.strip_prefix(kind)?))) else {
            return Ok(None);
        };
        let full = |path: &str| -> anyhow::Result<String> {
            let full = Path::new(path).canonicalize().map_err(|why| {
                anyhow!(
                    "--policy {policy}: {path}: {why}\nHint: name a local folder or file; download a model of a hub first"
                )
            })?;
            let Some(text) = full.to_str() else { bail!("--policy {policy}: the path is not valid UTF-8") };
            Ok(text.to_owned())
        };
        let (path, arguments) = parts(named);
        let mut from = full(path)?;
        let name = name(kind, Path::new(&from));
        for (number, argument) in arguments.enumerate() {
            from.push(if number == 0 { '?' } else { '&' });
            match argument.strip_prefix(STATISTICS) {
                Some(file) => from.extend([STATISTICS, &full(file)?]),
                None => from.push_str(argument),
            }
        }
        Ok(Some(Self { name, from: format!("{kind}{from}") }))
    }

    /// The folders that a process reads to load it. Beside a file are its statistics and settings.
    pub(crate) fn folders(&self) -> Vec<PathBuf> {
        let (path, arguments) = parts(named(&self.from));
        let files = arguments.filter_map(|argument| argument.strip_prefix(STATISTICS));
        let paths = std::iter::once(path).chain(files).map(Path::new);
        paths.map(|path| if path.is_file() { path.parent().unwrap_or(path) } else { path }.to_owned()).collect()
    }

    /// The argument of the process.
    pub(crate) fn argument(&self) -> String {
        format!("{}={}", self.name, self.from)
    }
}

/// The path in a name such as `lerobot:FOLDER?argument`.
pub(crate) fn loaded_path(from: &str) -> &str {
    parts(named(from)).0
}

/// What follows the kind of policy.
fn named(from: &str) -> &str {
    from.split_once(':').map_or(from, |(_, named)| named)
}

/// The path of a policy, and its arguments.
fn parts(named: &str) -> (&str, impl Iterator<Item = &str>) {
    let (path, arguments) = named.split_once('?').unwrap_or((named, ""));
    (path, arguments.split('&').filter(|argument| !argument.is_empty()))
}

/// The last part of a path that says something about the policy, as a name.
fn name(kind: &str, path: &Path) -> String {
    let parts = path.components().rev().filter_map(|part| match part {
        Component::Normal(part) => part.to_str().map(|part| part.trim_end_matches(".zip")),
        _ => None,
    });
    let mut telling = parts.filter(|part| !GENERIC.contains(part) && !part.bytes().all(|byte| byte.is_ascii_digit()));
    let kind = kind.trim_end_matches(':');
    let found = telling.next().unwrap_or(kind);
    let plain: String =
        found.chars().map(|c| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' }).take(48).collect();
    let plain = plain.trim_start_matches('-');
    let plain = if plain.is_empty() { kind } else { plain };
    // These names mean other policies.
    if ["random", "scripted"].contains(&plain) { format!("{kind}-{plain}") } else { plain.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_something() {
        let named = |path: &str| name("lerobot:", Path::new(path));
        assert_eq!(named("/home/me/outputs/train/act pusht/checkpoints/last/pretrained_model"), "act-pusht");
        assert_eq!(named("/runs/diffusion/checkpoints/020000/pretrained_model"), "diffusion");
        assert_eq!(named("/models/tqc.v2.zip"), "tqc-v2");
        assert_eq!(named("/models/random"), "lerobot-random");
        assert_eq!(named("/tmp/.cache"), "cache");
        assert_eq!(named("/"), "lerobot");
    }

    #[test]
    fn arguments_follow_the_path() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().canonicalize().unwrap();
        let at = |name: &str| inner.join(name).to_str().unwrap().to_owned();
        for file in ["model.zip", "vn.pkl"] {
            std::fs::write(at(file), "").unwrap();
        }
        let named = format!("sb3:{}?x=1&statistics={}", at("./model.zip"), at("./vn.pkl"));
        let loaded = LoadedPolicy::of(&named).unwrap().unwrap();
        assert_eq!(loaded.from, format!("sb3:{}?x=1&statistics={}", at("model.zip"), at("vn.pkl")));
        assert_eq!(loaded.name, "model");
        // The sandbox lets the process read what is beside a model.
        assert_eq!(loaded.folders(), [inner.clone(), inner.clone()]);
        let error = LoadedPolicy::of(&format!("sb3:{}?statistics=none.pkl", at("model.zip"))).unwrap_err().to_string();
        assert!(error.contains("none.pkl: No such file"), "{error}");
    }

    #[test]
    fn other_policies_are_left_alone() {
        assert_eq!(LoadedPolicy::of("ws://127.0.0.1:8000").unwrap(), None);
        assert_eq!(LoadedPolicy::of("expert").unwrap(), None);
        assert!(
            LoadedPolicy::of("lerobot:/no/such/folder")
                .unwrap_err()
                .to_string()
                .contains("download a model of a hub first")
        );
    }
}
