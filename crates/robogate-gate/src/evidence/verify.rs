//! Checking the folder.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use super::manifest::is_plain;
use super::{
    AGAINST, ATTESTATION, BARE_ENDING, BASELINE, DICTIONARY, EVALUATION, Envelope, MANIFEST, Manifest, PAYLOAD_TYPE,
    Problem, PublicKey, REQUIREMENTS, SIGNED_ENDING, SIGNER, TEST_RESULT, facts, statement,
};
use crate::{Counts, Verdict};

/// A manifest, a statement or a public key is far smaller.
const LONGEST: u64 = 16 << 20;

/// A folder whose every file is what it should be.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Verified {
    /// The answer, computed again from the rows.
    pub verdict: Verdict,
    /// Why, in a sentence.
    pub because: String,
    /// How many episodes.
    pub counts: Counts,
    /// The policy that was judged.
    pub policy: String,
    /// The robot.
    pub robot: String,
    /// How many files were checked.
    pub files: u64,
    /// Who vouches for it.
    pub signed: Signed,
}

/// Who vouches for a folder.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Signed {
    /// Nobody: whoever changed a file could have changed all that refer to it.
    Unsigned,
    /// A key of which nothing is known here: it may be anyone's.
    ByUnknown {
        /// The key.
        keyid: String,
    },
    /// The key that the caller trusts.
    ByTrusted {
        /// The key.
        keyid: String,
    },
}

/// Checks a folder of evidence: every file against the manifest, the evaluation and the verdict against the rows,
/// the statements and their signatures against all of it.
///
/// With `trusted`, the folder must be signed by that key. What is wrong is returned, each with its file.
pub fn verify(folder: &Path, trusted: Option<&PublicKey>) -> Result<Verified, Vec<Problem>> {
    let mut problems = Vec::new();
    let manifest = match manifest_of(folder) {
        Ok(manifest) => manifest,
        Err(problem) => return Err(vec![problem]),
    };
    let statements = statements_of(&manifest);
    check_files(folder, &manifest, &statements, &mut problems);
    let evaluation = check_facts(folder, &manifest, &mut problems);
    let (signed, key) = check_key(folder, &manifest, trusted, &mut problems);
    let sha256 = facts::sha256(manifest.to_json().as_bytes());
    let bodies = evaluation.as_ref().map(|evaluation| {
        [statement::test_result(&manifest, &sha256, evaluation), statement::evidence(&manifest, &sha256)]
    });
    for (i, name) in statements.iter().enumerate() {
        let body = match (&manifest.signer, &key) {
            (None, _) => read(folder, name).map(|text| text.strip_suffix('\n').unwrap_or(&text).to_owned()),
            (Some(_), Some(key)) => signed_body(folder, name, key),
            // Without the key there is nothing to hold it against; that the key is missing is said already.
            (Some(_), None) => continue,
        };
        let body = match body {
            Ok(body) => body,
            Err(reason) => {
                problems.push(Problem::new(name.as_str(), reason));
                continue;
            }
        };
        if let Some(said) = statement::manifest_sha256(&body)
            && said != sha256
        {
            let reason = format!("its SHA-256 is {sha256}, and {name} says {said}: one of them was changed");
            problems.push(Problem::new(MANIFEST, reason));
        }
        let expected = bodies.as_ref().and_then(|bodies| bodies.get(i));
        if expected.is_some_and(|expected| *expected != body) {
            let reason = "it is not the statement that follows from the manifest and the rows";
            problems.push(Problem::new(name.as_str(), reason));
        }
    }
    let mut seen = BTreeSet::new();
    problems.retain(|problem| seen.insert((problem.file.clone(), problem.reason.clone())));
    match (evaluation, signed) {
        (Some(evaluation), Some(signed)) if problems.is_empty() => Ok(Verified {
            verdict: evaluation.verdict,
            because: evaluation.because,
            counts: evaluation.counts,
            policy: evaluation.policy,
            robot: evaluation.robot,
            files: manifest.files.len() as u64 + 1 + statements.len() as u64,
            signed,
        }),
        _ => Err(problems),
    }
}

fn statements_of(manifest: &Manifest) -> [String; 2] {
    let ending = if manifest.signer.is_some() { SIGNED_ENDING } else { BARE_ENDING };
    [TEST_RESULT, ATTESTATION].map(|name| format!("{name}{ending}"))
}

fn read(folder: &Path, name: &str) -> Result<String, String> {
    let path = folder.join(name);
    let metadata = fs::symlink_metadata(&path).map_err(|e| missing(&e))?;
    if !metadata.is_file() {
        return Err("it is no plain file".to_owned());
    }
    if metadata.len() > LONGEST {
        return Err(format!("it has {} bytes, more than any such file", metadata.len()));
    }
    fs::read_to_string(&path).map_err(|e| missing(&e))
}

fn missing(error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::NotFound => "it is missing".to_owned(),
        _ => format!("it cannot be read: {error}"),
    }
}

fn manifest_of(folder: &Path) -> Result<Manifest, Problem> {
    let wrong = |reason: String| Problem::new(MANIFEST, reason);
    let text = read(folder, MANIFEST).map_err(|reason| {
        wrong(format!(
            "{reason}\nhint: a folder of evidence is made by `robogate evidence RUN OUT` after `robogate gate`"
        ))
    })?;
    let json: serde_json::Value = serde_json::from_str(&text).map_err(|e| wrong(format!("it is no JSON: {e}")))?;
    match json.get("format").and_then(serde_json::Value::as_u64) {
        Some(format) if format == u64::from(Manifest::FORMAT) => {}
        Some(format) if format > u64::from(Manifest::FORMAT) => {
            let known = Manifest::FORMAT;
            return Err(wrong(format!(
                "its format is {format}, and this robogate reads {known}\nhint: upgrade robogate"
            )));
        }
        Some(format) => {
            return Err(wrong(format!(
                "its format {format} has expired\nhint: check it with the robogate that wrote it"
            )));
        }
        None => return Err(wrong("it has no `format`: it is no manifest of evidence".to_owned())),
    }
    let manifest: Manifest = serde_json::from_str(&text).map_err(|e| wrong(format!("it is no manifest: {e}")))?;
    if manifest.to_json() != text {
        return Err(wrong("it was changed: robogate writes the same content in other bytes".to_owned()));
    }
    if let Some(file) = manifest.files.iter().find(|file| !is_plain(&file.path)) {
        return Err(wrong(format!("it names `{}`, which is no place in the folder", file.path.escape_debug())));
    }
    if let Some(pair) = manifest.files.windows(2).find(|pair| pair[0].path >= pair[1].path) {
        return Err(wrong(format!("its files are not in order, or `{}` is there twice", pair[1].path)));
    }
    for name in [DICTIONARY, REQUIREMENTS, EVALUATION] {
        if manifest.files.iter().all(|file| file.path != name) {
            return Err(wrong(format!("it does not name {name}, without which there is no verdict")));
        }
    }
    Ok(manifest)
}

/// Every file is there, with its bytes, and no other.
fn check_files(folder: &Path, manifest: &Manifest, statements: &[String; 2], problems: &mut Vec<Problem>) {
    for file in &manifest.files {
        let path = folder.join(&file.path);
        // Looked at before it is opened: a pipe or a device never ends, and a file of holes takes hours.
        let reason = match fs::symlink_metadata(&path) {
            Err(error) => Some(missing(&error)),
            Ok(metadata) if !metadata.is_file() => Some("it is no plain file".to_owned()),
            Ok(metadata) if metadata.len() != file.bytes => {
                Some(format!("it has {} bytes, the manifest says {}", metadata.len(), file.bytes))
            }
            Ok(_) => None,
        };
        if let Some(reason) = reason {
            problems.push(Problem::new(file.path.as_str(), reason));
            continue;
        }
        let reason = match facts::digest(&path) {
            Err(error) => missing(&error),
            Ok((bytes, _)) if bytes != file.bytes => format!("it has {bytes} bytes, the manifest says {}", file.bytes),
            Ok((_, sha256)) if sha256 != file.sha256 => {
                format!("it was changed: its SHA-256 is {sha256}, the manifest says {}", file.sha256)
            }
            Ok(_) => continue,
        };
        problems.push(Problem::new(file.path.as_str(), reason));
    }
    let mut found = Vec::new();
    let belongs = |place: &str| {
        manifest.files.iter().any(|file| file.path.strip_prefix(place).is_some_and(|rest| rest.starts_with('/')))
    };
    walk(folder, "", &belongs, &mut found, problems);
    for name in found {
        let known =
            name == MANIFEST || statements.contains(&name) || manifest.files.iter().any(|file| file.path == name);
        if !known {
            problems
                .push(Problem::new(name, "it is no part of the evidence\nhint: remove it, or ask who put it there"));
        }
    }
}

fn walk(
    folder: &Path,
    prefix: &str,
    belongs: &dyn Fn(&str) -> bool,
    found: &mut Vec<String>,
    problems: &mut Vec<Problem>,
) {
    // Names that the manifest can hold are no longer than this.
    const DEEPEST: usize = 200;
    let here = folder.join(prefix);
    let entries = match fs::read_dir(&here).and_then(Iterator::collect::<Result<Vec<_>, _>>) {
        Ok(entries) if prefix.len() <= DEEPEST => entries,
        Ok(_) => return problems.push(Problem::new(prefix, "it lies too deep to be a part of the evidence")),
        Err(error) => {
            return problems.push(Problem::new(if prefix.is_empty() { "." } else { prefix }, missing(&error)));
        }
    };
    let mut names: Vec<_> =
        entries.iter().map(|entry| (entry.file_name(), entry.file_type().is_ok_and(|kind| kind.is_dir()))).collect();
    names.sort();
    for (name, is_folder) in names {
        let name = name.to_string_lossy();
        let path = if prefix.is_empty() { name.into_owned() } else { format!("{prefix}/{name}") };
        if !is_folder {
            found.push(path);
        } else {
            if !belongs(&path) {
                let reason = "no file of the evidence lies in this folder\nhint: remove it, or ask who put it there";
                problems.push(Problem::new(format!("{path}/"), reason));
            }
            walk(folder, &path, belongs, found, problems);
        }
    }
}

/// What the manifest says follows from its files. `None` where that could not be computed.
fn check_facts(folder: &Path, manifest: &Manifest, problems: &mut Vec<Problem>) -> Option<crate::Evaluation> {
    let uses = [DICTIONARY, REQUIREMENTS, BASELINE, AGAINST];
    if problems.iter().any(|problem| uses.contains(&problem.file.as_str())) {
        // Nothing that follows from changed files says anything about the others.
        return None;
    }
    // What has no hash must not take part.
    let unnamed = |name: &&str| folder.join(name).exists() && manifest.files.iter().all(|file| file.path != **name);
    if uses.iter().any(unnamed) {
        return None;
    }
    let evaluation = match facts::evaluate(folder, manifest.sampling, manifest.margin) {
        Ok(evaluation) => evaluation,
        Err(error) => {
            problems.push(Problem::new(DICTIONARY, format!("the verdict cannot be computed from it: {error}")));
            return None;
        }
    };
    match read(folder, EVALUATION) {
        Ok(text) if text == evaluation.to_json() => {}
        Ok(_) => problems.push(Problem::new(
            EVALUATION,
            format!("it is not what follows from the rows, which is {}: {}", evaluation.verdict, evaluation.because),
        )),
        Err(reason) => problems.push(Problem::new(EVALUATION, reason)),
    }
    if problems.is_empty() {
        // Only files with the bytes that the manifest states are safe to read.
        match facts::origin(folder, &manifest.files) {
            Ok(found) => problems.extend(found),
            Err(error) => problems.push(Problem::new(DICTIONARY, error.to_string())),
        }
    }
    let rebuilt = facts::manifest(
        folder,
        manifest.tool.clone(),
        &evaluation,
        manifest.margin,
        manifest.signer.clone(),
        manifest.files.clone(),
    );
    match rebuilt {
        Ok(rebuilt) if rebuilt == *manifest => {}
        Ok(rebuilt) => {
            let reason = if rebuilt.verdict == manifest.verdict {
                "what it says of the rows is not what follows from them".to_owned()
            } else {
                format!("it says {}, and the rows say {}", manifest.verdict, rebuilt.verdict)
            };
            problems.push(Problem::new(MANIFEST, reason));
        }
        Err(error) => problems.push(Problem::new(DICTIONARY, error.to_string())),
    }
    Some(evaluation)
}

/// Who signed, and the key with which to check the statements.
fn check_key(
    folder: &Path,
    manifest: &Manifest,
    trusted: Option<&PublicKey>,
    problems: &mut Vec<Problem>,
) -> (Option<Signed>, Option<PublicKey>) {
    let Some(signer) = &manifest.signer else {
        if let Some(trusted) = trusted {
            let reason = format!("nobody signed it, and key {} was asked for", trusted.id());
            problems.push(Problem::new(MANIFEST, reason));
        }
        return (Some(Signed::Unsigned), None);
    };
    let key = match read(folder, SIGNER).and_then(|text| PublicKey::from_pem(&text)) {
        Ok(key) => key,
        Err(reason) => {
            problems.push(Problem::new(SIGNER, reason));
            return (None, None);
        }
    };
    let keyid = key.id();
    if keyid != *signer {
        problems.push(Problem::new(SIGNER, format!("it is key {keyid}, and the manifest names {signer}")));
    }
    let signed = match trusted {
        None => Signed::ByUnknown { keyid },
        Some(trusted) if *trusted == key => Signed::ByTrusted { keyid },
        Some(trusted) => {
            let reason = format!("the evidence is signed by key {keyid}, and not by the given key {}", trusted.id());
            problems.push(Problem::new(SIGNER, reason));
            return (None, Some(key));
        }
    };
    (Some(signed), Some(key))
}

/// What the envelope `name` holds, where `key` signed it and nothing around it was changed.
fn signed_body(folder: &Path, name: &str, key: &PublicKey) -> Result<String, String> {
    let text = read(folder, name)?;
    let envelope: Envelope = serde_json::from_str(&text).map_err(|e| format!("it is no DSSE envelope: {e}"))?;
    if envelope.payload_type != PAYLOAD_TYPE {
        return Err(format!("its payload type is `{}`, not {PAYLOAD_TYPE}", envelope.payload_type.escape_debug()));
    }
    let id = key.id();
    if !envelope.is_signed_by(key) {
        return Err(format!("it has no valid signature of key {id}"));
    }
    // What is signed holds; what stands around it must be as it was written too.
    if envelope.written_again(&id).as_deref() != Some(&text) {
        return Err("it was changed around what is signed: robogate writes the same in other bytes".to_owned());
    }
    envelope.body().and_then(|body| String::from_utf8(body).ok()).ok_or_else(|| "its payload is no text".to_owned())
}
