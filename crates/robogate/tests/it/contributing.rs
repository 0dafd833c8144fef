//! Tests that CONTRIBUTING.md is true: the paths that it names exist, and each kind of addition touches the files that it lists.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

fn text() -> String {
    fs::read_to_string(root().join("CONTRIBUTING.md")).unwrap()
}

/// The paths in a text, between backquotes: they contain a slash and no space.
fn paths(text: &str) -> BTreeSet<&str> {
    let quoted = text.split('`').skip(1).step_by(2);
    let tops = ["crates/", "assets/", "docs/", "python/", "bridges/", "scripts/", "schemas/", "deploy/"];
    quoted.filter(|part| !part.contains([' ', '*']) && tops.iter().any(|top| part.starts_with(top))).collect()
}

#[test]
fn named_paths_exist() {
    let text = text();
    let missing: Vec<&str> = paths(&text).into_iter().filter(|path| !root().join(path).exists()).collect();
    assert!(missing.is_empty(), "CONTRIBUTING.md names files that do not exist: {missing:?}");
    let links = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let dead: Vec<&str> = links.filter(|link| !link.contains("://") && !root().join(link).exists()).collect();
    assert!(dead.is_empty(), "{dead:?}");
}

/// Rust sources and manifests that contain `word` in code: not in a comment, a message or a test.
fn mentions(word: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut folders = vec![root().join("crates")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if !["tests", "benches", "examples", "target", "results"].contains(&name.as_str()) {
                    folders.push(path);
                }
            } else if (name.ends_with(".rs") && !name.ends_with("_tests.rs")) || name == "Cargo.toml" {
                let source = fs::read_to_string(&path).unwrap();
                let code = source.split("#[cfg(test)]").next().unwrap_or_default();
                if code.lines().any(|line| is_mentioned(line, word)) {
                    found.insert(path.strip_prefix(root()).unwrap().to_string_lossy().into_owned());
                }
            }
        }
    }
    found
}

/// Whether the code of a line contains the word: as a name, or as a text that is nothing but the word or a path.
fn is_mentioned(line: &str, word: &str) -> bool {
    let line = line.trim_start();
    if line.starts_with("//") || line.starts_with('#') {
        return false;
    }
    let is_word = |text: &str| text.split(|c: char| !c.is_alphanumeric() && c != '_').any(|part| part == word);
    line.split('"').enumerate().any(|(at, part)| is_word(part) && (at % 2 == 0 || !part.contains(' ')))
}

#[test]
fn additions_touch_the_listed_files() {
    let text = text();
    for (title, words, most) in [
        ("## Add a task", &["insertion"][..], 4),
        ("## Add an engine", &["rapier"], 6),
        ("## Add a robot", &["ur3e"], 2),
        ("## Add a policy dialect", &["gr00t", "Gr00t"], 7),
        ("## Add a family of environments in Python", &["dm_control"], 6),
        ("## Add a verb", &["audit", "AuditOf"], 4),
    ] {
        let section = text.split(title).nth(1).unwrap().split("\n## ").next().unwrap();
        let listed = paths(section);
        // A verb prints what a crate of the same name computes.
        let scope = if title.ends_with("verb") { "crates/robogate/" } else { "crates/" };
        let touched: BTreeSet<String> = words.iter().flat_map(|word| mentions(word)).collect();
        let touched: Vec<&String> = touched.iter().filter(|path| path.starts_with(scope)).collect();
        let unlisted: Vec<&&String> = touched
            .iter()
            .filter(|path| !listed.iter().any(|one| *path == one || one.ends_with('/') && path.starts_with(one)))
            .collect();
        assert!(unlisted.is_empty(), "{title}: these files mention {words:?} and are not listed: {unlisted:?}");
        let outside =
            touched.iter().filter(|path| !words.iter().any(|word| path.contains(&format!("/{word}/")))).count();
        assert!(outside <= most, "{title}: {outside} files outside of its folder, at most {most}: {touched:?}");
    }
}
