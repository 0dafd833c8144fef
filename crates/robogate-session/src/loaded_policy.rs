//! Policies that the process of an environment loads: a checkpoint of LeRobot, or a model of Stable-Baselines3.

use std::path::{Component, Path};

use anyhow::{anyhow, bail};

/// What stands before the path of such a policy.
const KINDS: [&str; 2] = ["lerobot:", "sb3:"];
/// Folders of checkpoints whose names say nothing about the policy.
const GENERIC: [&str; 4] = ["pretrained_model", "checkpoints", "last", "best_model"];

/// A policy that the process of an environment loads beside the environment's own.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoadedPolicy {
    /// Its name in the declaration of the environment and in records.
    pub name: String,
    /// `lerobot:FOLDER`, or `sb3:FILE` or `sb3:FOLDER`, with an absolute path.
    pub from: String,
}

impl LoadedPolicy {
    /// The policy that the user names as `lerobot:PATH` or `sb3:PATH`. `None` for any other policy.
    ///
    /// # Errors
    /// A path that does not exist.
    pub fn of(policy: &str) -> anyhow::Result<Option<Self>> {
        let Some((kind, path)) = KINDS.iter().find_map(|kind| Some((*kind, policy.strip_prefix(kind)?))) else {
            return Ok(None);
        };
        let full = Path::new(path).canonicalize().map_err(|why| {
            anyhow!("--policy {policy}: {why}\nHint: name a local folder or file; download a model of a hub first")
        })?;
        let Some(text) = full.to_str() else { bail!("--policy {policy}: the path is not valid UTF-8") };
        Ok(Some(Self { name: name(kind, &full), from: format!("{kind}{text}") }))
    }

    /// The argument of the process.
    pub(crate) fn argument(&self) -> String {
        format!("{}={}", self.name, self.from)
    }
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
