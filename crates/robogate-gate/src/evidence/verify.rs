//! Verifies a folder of evidence.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use robogate_core::budget::Budget;

use super::manifest::is_plain;
use super::{
    AGAINST, ATTESTATION, BARE_ENDING, BASELINE, DICTIONARY, EVALUATION, Envelope, EnvironmentBinding, EvidenceError,
    MANIFEST, Manifest, PAYLOAD_TYPE, PolicyBinding, Problem, PublicKey, QuestionBinding, REQUIREMENTS, Registered,
    SIGNED_ENDING, SIGNER, TEST_RESULT, facts, statement,
};
use crate::{Counts, Population, RealEvidence, RequirementResult, Verdict};

/// Size limit of manifests, statements and public keys, in bytes. Real ones are far smaller.
const LONGEST: u64 = 16 << 20;

/// A verified folder of evidence.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Verified {
    /// The verdict, recomputed from the rows.
    pub verdict: Verdict,
    /// The reason for the verdict, in one sentence.
    pub because: String,
    /// Numbers of episodes.
    pub counts: Counts,
    /// What the episodes represent.
    pub population: Population,
    /// Each requirement with its limit, figure and status, recomputed from the rows.
    pub requirements: Vec<RequirementResult>,
    /// What a reader of the verdict must know, such as settings of the task that were changed.
    pub remarks: Vec<String>,
    /// The policy that was judged.
    pub policy: String,
    /// How the policy is identified.
    pub policy_binding: PolicyBinding,
    /// How the judged question relates to the one that the gate was asked.
    pub question: QuestionBinding,
    /// The registration of the run before its first episode.
    pub registration: Option<Registered>,
    /// The environment as one hash.
    pub environment: EnvironmentBinding,
    /// The campaign's seed.
    pub seed: u64,
    /// The robot.
    pub robot: String,
    /// Number of verified files.
    pub files: u64,
    /// Who signed the folder.
    pub signed: Signed,
}

/// Who signed a folder.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Signed {
    /// Unsigned: anyone who can change one file can also change all files that refer to it.
    Unsigned,
    /// A key that the caller did not name. It may belong to anyone.
    ByUnknown {
        /// The key's identifier.
        keyid: String,
    },
    /// The key that the caller trusts.
    ByTrusted {
        /// The key's identifier.
        keyid: String,
    },
}

/// Verifies a folder of evidence: all files against the manifest, evaluation and verdict against the rows, statements
/// and signatures against both.
///
/// With `trusted`, the folder must be signed by that key. Returns all problems, each with its file.
pub fn verify(folder: &Path, trusted: Option<&PublicKey>) -> Result<Verified, Vec<Problem>> {
    if let Some(trusted) = trusted {
        check_signatures(folder, trusted)?;
    }
    let mut problems = Vec::new();
    let manifest = match manifest_of(folder) {
        Ok(manifest) => manifest,
        Err(problem) => return Err(vec![problem]),
    };
    let statements = statements_of(&manifest);
    let (signed, key) = check_key(folder, &manifest, trusted, &mut problems);
    check_files(folder, &manifest, &statements, &mut problems);
    let evaluation = check_facts(folder, &manifest, &mut problems);
    let sha256 = facts::sha256(manifest.to_json().as_bytes());
    let bodies = evaluation.as_ref().map(|evaluation| {
        [statement::test_result(&manifest, &sha256, evaluation), statement::evidence(&manifest, &sha256)]
    });
    for (i, name) in statements.iter().enumerate() {
        let body = match (&manifest.signer, &key) {
            (None, _) => read(folder, name).map(|text| text.strip_suffix('\n').unwrap_or(&text).to_owned()),
            (Some(_), Some(key)) => signed_body(folder, name, key),
            // Without the key the signature cannot be checked. The missing key is reported already.
            (Some(_), None) => continue,
        };
        let body = match body {
            Ok(body) => body,
            Err(reason) => {
                problems.push(Problem::new(name.as_str(), reason));
                continue;
            }
        };
        if let Some(stated) = statement::manifest_sha256(&body)
            && stated != sha256
        {
            let reason = format!("its SHA-256 is {sha256}, but {name} states {stated}: one of them was changed");
            problems.push(Problem::new(MANIFEST, reason));
        }
        let expected = bodies.as_ref().and_then(|bodies| bodies.get(i));
        if expected.is_some_and(|expected| *expected != body) {
            let reason = "differs from the statement computed from the manifest and the rows";
            problems.push(Problem::new(name.as_str(), reason));
        }
    }
    let mut seen = BTreeSet::new();
    problems.retain(|problem| seen.insert((problem.file.clone(), problem.reason.clone())));
    match (evaluation, signed) {
        (Some(evaluation), Some(signed)) if problems.is_empty() => Ok(Verified {
            verdict: evaluation.verdict,
            remarks: evaluation.remarks(),
            population: evaluation.population,
            requirements: evaluation.results,
            because: evaluation.because,
            counts: evaluation.counts,
            policy: evaluation.policy,
            policy_binding: manifest.policy_binding,
            question: manifest.question,
            registration: manifest.registration,
            environment: manifest.environment,
            seed: manifest.seed,
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

/// Checks that the trusted key signed the statements, and that they are about these bytes of the manifest. No other file of a folder
/// that this key did not sign is read.
fn check_signatures(folder: &Path, trusted: &PublicKey) -> Result<(), Vec<Problem>> {
    let names = [TEST_RESULT, ATTESTATION].map(|name| format!("{name}{SIGNED_ENDING}"));
    if !folder.join(MANIFEST).exists() {
        // The error of the manifest says what is expected.
        return manifest_of(folder).map(drop).map_err(|problem| vec![problem]);
    }
    if names.iter().map(String::as_str).chain([SIGNER]).all(|name| !folder.join(name).exists()) {
        let reason = format!("unsigned, but a signature by key {} is required", trusted.id());
        return Err(vec![Problem::new(MANIFEST, reason)]);
    }
    let signer = read(folder, SIGNER).and_then(|text| PublicKey::from_pem(&text).map_err(|error| error.to_string()));
    let wrong = match signer {
        Ok(key) if key == *trusted => None,
        Ok(key) => Some(format!("the evidence is signed by key {}. Expected the given key {}", key.id(), trusted.id())),
        Err(reason) => Some(reason),
    };
    if let Some(reason) = wrong {
        return Err(vec![Problem::new(SIGNER, reason)]);
    }
    let mut problems = Vec::new();
    let sha256 = read(folder, MANIFEST).map(|text| facts::sha256(text.as_bytes()));
    let sha256 = sha256.map_err(|reason| vec![Problem::new(MANIFEST, reason)])?;
    for name in &names {
        match signed_body(folder, name, trusted) {
            Ok(body) if statement::manifest_sha256(&body).is_some_and(|stated| stated != sha256) => {
                let reason = format!("its SHA-256 is {sha256}, but {name} states another one: one of them was changed");
                problems.push(Problem::new(MANIFEST, reason));
            }
            Ok(_) => {}
            Err(reason) => problems.push(Problem::new(name.as_str(), reason)),
        }
    }
    if problems.is_empty() { Ok(()) } else { Err(problems) }
}

fn read(folder: &Path, name: &str) -> Result<String, String> {
    let path = folder.join(name);
    let metadata = fs::symlink_metadata(&path).map_err(|e| missing(&e))?;
    if !metadata.is_file() {
        return Err("not a regular file".to_owned());
    }
    if metadata.len() > LONGEST {
        return Err(format!("{} bytes, which is too large for such a file", metadata.len()));
    }
    fs::read_to_string(&path).map_err(|e| missing(&e))
}

fn missing(error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::NotFound => "missing".to_owned(),
        _ => format!("cannot be read: {error}"),
    }
}

fn manifest_of(folder: &Path) -> Result<Manifest, Problem> {
    let wrong = |reason: String| Problem::new(MANIFEST, reason);
    let text = read(folder, MANIFEST)
        .map_err(|reason| wrong(format!("{reason}\nHint: expected a folder written by `robogate evidence RUN OUT`")))?;
    let json: serde_json::Value = Budget::FILE.json(text.as_bytes()).map_err(|e| wrong(format!("not JSON: {e}")))?;
    match json.get("format").and_then(serde_json::Value::as_u64) {
        Some(format) if format == u64::from(Manifest::FORMAT) => {}
        Some(format) if format > u64::from(Manifest::FORMAT) => {
            let known = Manifest::FORMAT;
            return Err(wrong(format!("unsupported format {format}. Expected {known}\nHint: upgrade robogate")));
        }
        Some(format) => {
            return Err(wrong(format!(
                "format {format} is no longer supported\nHint: verify it with the version of robogate that wrote it"
            )));
        }
        None => return Err(wrong("no `format`, so it is not a manifest of evidence".to_owned())),
    }
    let manifest: Manifest = Budget::FILE.json(text.as_bytes()).map_err(|e| wrong(format!("not a manifest: {e}")))?;
    if manifest.to_json() != text {
        return Err(wrong("was changed: robogate writes the same content with other bytes".to_owned()));
    }
    if let Some(file) = manifest.files.iter().find(|file| !is_plain(&file.path)) {
        return Err(wrong(format!("lists `{}`, which is not a valid path in the folder", file.path.escape_debug())));
    }
    if let Some(pair) = manifest.files.windows(2).find(|pair| pair[0].path >= pair[1].path) {
        return Err(wrong(format!("its files are not sorted, or `{}` is listed twice", pair[1].path)));
    }
    for name in [DICTIONARY, REQUIREMENTS, EVALUATION] {
        if manifest.files.iter().all(|file| file.path != name) {
            return Err(wrong(format!("does not list {name}, which the verdict needs")));
        }
    }
    Ok(manifest)
}

/// Checks that the folder contains every listed file with its content, and no other file.
fn check_files(folder: &Path, manifest: &Manifest, statements: &[String; 2], problems: &mut Vec<Problem>) {
    for file in &manifest.files {
        let path = folder.join(&file.path);
        // Checked before opening: reading a pipe or a device never ends, and a huge sparse file takes hours.
        let reason = match fs::symlink_metadata(&path) {
            Err(error) => Some(missing(&error)),
            Ok(metadata) if !metadata.is_file() => Some("not a regular file".to_owned()),
            Ok(metadata) if metadata.len() != file.bytes => {
                Some(format!("{} bytes, but the manifest states {}", metadata.len(), file.bytes))
            }
            Ok(_) => None,
        };
        if let Some(reason) = reason {
            problems.push(Problem::new(file.path.as_str(), reason));
            continue;
        }
        let reason = match facts::digest(&path) {
            Err(error) => missing(&error),
            Ok((bytes, _)) if bytes != file.bytes => format!("{bytes} bytes, but the manifest states {}", file.bytes),
            Ok((_, sha256)) if sha256 != file.sha256 => {
                format!("was changed: its SHA-256 is {sha256}, but the manifest states {}", file.sha256)
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
            problems.push(Problem::new(name, "not part of the evidence\nHint: remove it, or find out who added it"));
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
    // The manifest cannot list longer paths.
    const DEEPEST: usize = 200;
    let here = folder.join(prefix);
    let entries = match fs::read_dir(&here).and_then(Iterator::collect::<Result<Vec<_>, _>>) {
        Ok(entries) if prefix.len() <= DEEPEST => entries,
        Ok(_) => return problems.push(Problem::new(prefix, "nested too deeply to be part of the evidence")),
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
                let reason = "this folder contains no file of the evidence\nHint: remove it, or find out who added it";
                problems.push(Problem::new(format!("{path}/"), reason));
            }
            walk(folder, &path, belongs, found, problems);
        }
    }
}

/// Recomputes the manifest from the files. `None` if that is not possible.
fn check_facts(folder: &Path, manifest: &Manifest, problems: &mut Vec<Problem>) -> Option<crate::Evaluation> {
    let uses = [DICTIONARY, REQUIREMENTS, BASELINE, AGAINST, RealEvidence::FILE];
    if problems.iter().any(|problem| uses.contains(&problem.file.as_str())) {
        // Results of changed files say nothing about the other files.
        return None;
    }
    // Files without a hash must not be used.
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
            format!("differs from the evaluation of the rows, which is {}: {}", evaluation.verdict, evaluation.because),
        )),
        Err(reason) => problems.push(Problem::new(EVALUATION, reason)),
    }
    if problems.is_empty() {
        // Only files with the bytes that the manifest lists are safe to read.
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
                "its statements about the rows differ from the rows".to_owned()
            } else {
                format!("states {}, but the rows give {}", manifest.verdict, rebuilt.verdict)
            };
            problems.push(Problem::new(MANIFEST, reason));
        }
        Err(EvidenceError::Contradicts(problem)) => problems.push(problem),
        Err(error) => problems.push(Problem::new(DICTIONARY, error.to_string())),
    }
    Some(evaluation)
}

/// Determines who signed, and the key for the statements.
fn check_key(
    folder: &Path,
    manifest: &Manifest,
    trusted: Option<&PublicKey>,
    problems: &mut Vec<Problem>,
) -> (Option<Signed>, Option<PublicKey>) {
    let Some(signer) = &manifest.signer else {
        if let Some(trusted) = trusted {
            let reason = format!("unsigned, but a signature by key {} is required", trusted.id());
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
        problems.push(Problem::new(SIGNER, format!("key {keyid}, but the manifest names {signer}")));
    }
    let signed = match trusted {
        None => Signed::ByUnknown { keyid },
        Some(trusted) if *trusted == key => Signed::ByTrusted { keyid },
        Some(trusted) => {
            let reason = format!("the evidence is signed by key {keyid}. Expected the given key {}", trusted.id());
            problems.push(Problem::new(SIGNER, reason));
            return (None, Some(key));
        }
    };
    (Some(signed), Some(key))
}

/// The content of the envelope `name`, if `key` signed it and the envelope was not changed.
fn signed_body(folder: &Path, name: &str, key: &PublicKey) -> Result<String, String> {
    let text = read(folder, name)?;
    let envelope: Envelope = Budget::FILE.json(text.as_bytes()).map_err(|e| format!("not a DSSE envelope: {e}"))?;
    if envelope.payload_type != PAYLOAD_TYPE {
        return Err(format!("payload type `{}`. Expected {PAYLOAD_TYPE}", envelope.payload_type.escape_debug()));
    }
    let id = key.id();
    if !envelope.is_signed_by(key) {
        return Err(format!("no valid signature of key {id}"));
    }
    // The signature only covers the payload. The rest of the envelope must be unchanged too.
    if envelope.written_again(&id).as_deref() != Some(&text) {
        return Err(
            "was changed outside the signed payload: robogate writes the same content with other bytes".to_owned()
        );
    }
    envelope.body().and_then(|body| String::from_utf8(body).ok()).ok_or_else(|| "its payload is not text".to_owned())
}
