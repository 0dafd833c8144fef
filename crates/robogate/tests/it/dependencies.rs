//! Checks licences and sources of all dependencies against `deny.toml`, without cargo-deny and without a network.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

fn packages() -> Vec<Value> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--offline", "--locked", "--all-features"])
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    metadata["packages"].as_array().unwrap().clone()
}

fn deny() -> toml::Table {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deny.toml");
    std::fs::read_to_string(path).unwrap().parse().unwrap()
}

fn words<'a>(table: &'a toml::Table, section: &str, key: &str) -> Vec<&'a str> {
    table[section][key].as_array().unwrap().iter().map(|word| word.as_str().unwrap()).collect()
}

/// Whether the allowed licences satisfy an SPDX expression. A slash is the deprecated form of OR.
fn satisfied(expression: &str, allowed: &[&str]) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let tokens: Vec<&str> = spaced.split_whitespace().collect();
    let mut at = 0;
    let result = any(&tokens, &mut at, allowed);
    assert_eq!(at, tokens.len(), "{expression} is not an SPDX expression");
    result
}

/// Terms joined by OR.
fn any(tokens: &[&str], at: &mut usize, allowed: &[&str]) -> bool {
    let mut result = all(tokens, at, allowed);
    while tokens.get(*at) == Some(&"OR") {
        *at += 1;
        result |= all(tokens, at, allowed);
    }
    result
}

/// Factors joined by AND, which binds more tightly than OR.
fn all(tokens: &[&str], at: &mut usize, allowed: &[&str]) -> bool {
    let mut result = one(tokens, at, allowed);
    while tokens.get(*at) == Some(&"AND") {
        *at += 1;
        result &= one(tokens, at, allowed);
    }
    result
}

/// A licence, perhaps with an exception, or an expression in brackets.
fn one(tokens: &[&str], at: &mut usize, allowed: &[&str]) -> bool {
    let token = tokens.get(*at).copied().unwrap_or_default();
    *at += 1;
    if token == "(" {
        let result = any(tokens, at, allowed);
        assert_eq!(tokens.get(*at), Some(&")"), "{tokens:?}");
        *at += 1;
        return result;
    }
    if tokens.get(*at) == Some(&"WITH") {
        *at += 2;
        // An exception adds permissions; deny.toml would have to name it with the licence.
        return allowed.contains(&format!("{token} WITH {}", tokens[*at - 1]).as_str());
    }
    allowed.contains(&token)
}

/// The licences that deny.toml allows for this crate only.
fn exceptions<'a>(deny: &'a toml::Table, name: &str) -> Vec<&'a str> {
    let exceptions = deny["licenses"]["exceptions"].as_array().unwrap().iter();
    let of = exceptions.filter(|one| one["crate"].as_str() == Some(name));
    of.flat_map(|one| one["allow"].as_array().unwrap()).map(|licence| licence.as_str().unwrap()).collect()
}

#[test]
fn licences_are_allowed() {
    let deny = deny();
    let allowed = words(&deny, "licenses", "allow");
    for package in packages() {
        let (name, licence) = (&package["name"], package["license"].as_str());
        let licence = licence.unwrap_or_else(|| panic!("{name} declares no licence"));
        let mut allowed = allowed.clone();
        allowed.extend(exceptions(&deny, name.as_str().unwrap()));
        assert!(satisfied(licence, &allowed), "{name}: deny.toml does not allow `{licence}`");
    }
}

#[test]
fn sources_are_allowed() {
    let deny = deny();
    let registries = words(&deny, "sources", "allow-registry");
    for package in packages() {
        // Crates of the workspace have no source.
        let Some(source) = package["source"].as_str() else { continue };
        let registry = source.strip_prefix("registry+");
        assert!(registry.is_some_and(|url| registries.contains(&url)), "{}: {source} is not allowed", package["name"]);
    }
}

#[test]
fn banned_crates_are_absent() {
    let deny = deny();
    let banned: Vec<&str> =
        deny["bans"]["deny"].as_array().unwrap().iter().map(|entry| entry["crate"].as_str().unwrap()).collect();
    for package in packages() {
        let name = package["name"].as_str().unwrap();
        assert!(!banned.contains(&name), "deny.toml bans {name}");
    }
}

#[test]
fn expressions_are_evaluated() {
    let allowed = ["MIT", "ISC"];
    for (expression, expected) in [
        ("MIT", true),
        ("GPL-3.0-only", false),
        ("GPL-3.0-only OR MIT", true),
        ("Apache-2.0/MIT", true),
        ("MIT AND Apache-2.0", false),
        ("(Apache-2.0 OR MIT) AND ISC", true),
        ("Apache-2.0 OR MIT AND GPL-3.0-only", false),
        ("MIT WITH Some-exception", false),
    ] {
        assert_eq!(satisfied(expression, &allowed), expected, "{expression}");
    }
}

/// The scripts install Python packages by version and hash. Each lock states the requirements that it was made from.
#[test]
fn python_locks_are_current() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scripts/lock_python.sh");
    let output = Command::new(script).arg("--check").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
