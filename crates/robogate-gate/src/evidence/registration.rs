//! Pre-registration: a signed statement about a run, made before its first episode.
//!
//! A signature proves that nothing changed since. It does not prove that the run was the first attempt. Therefore each
//! registration has a number, and contains the hash of the one before. Evidence with registration 7 shows that its
//! signer registered six others before, whose results can be requested.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use robogate_core::budget::Budget;
use robogate_dictionary::{Provenance, hex, read_regular_text};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{Envelope, EvidenceError, PAYLOAD_TYPE, PolicyBinding, PrivateKey, Problem, PublicKey, STATEMENT_TYPE};

/// The predicate type of a registration.
pub const REGISTRATION_PREDICATE: &str = "urn:robogate:registration:v1";
/// The registration in the folder of a run and of evidence.
pub const REGISTRATION: &str = "registration.dsse.json";
/// The public key of its signer.
pub const REGISTRATION_KEY: &str = "registration.pub.pem";

/// Size limit of a list of registrations, in bytes. One has about 1.5 kB.
const LONGEST: u64 = 64 << 20;

/// What is registered before the first episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Registration {
    /// Position in the list of registrations of the key, from 1.
    pub number: u64,
    /// SHA-256 (hex) of the envelope before. `None` for the first.
    pub previous_sha256: Option<String>,
    /// SHA-256 (hex) of the provenance as JSON: plan, seed, policy, task, robot, engine, platform and build.
    pub provenance_sha256: String,
    /// SHA-256 (hex) of the question of the gate ([`crate::Asked::sha256`]).
    pub question_sha256: Option<String>,
    /// The seed of the campaign.
    pub seed: u64,
    /// The policy's name.
    pub policy: String,
    /// How the policy is identified.
    pub policy_binding: PolicyBinding,
}

/// A registration in a folder of evidence, whose signature was verified.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Registered {
    /// The key that signed it.
    pub keyid: String,
    /// Position in the list of registrations of the key, from 1.
    pub number: u64,
}

/// An in-toto statement about the provenance.
#[derive(Debug, Serialize, Deserialize)]
struct Statement {
    #[serde(rename = "_type")]
    type_uri: String,
    subject: Vec<Subject>,
    #[serde(rename = "predicateType")]
    predicate_type: String,
    predicate: Registration,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Subject {
    name: String,
    digest: Sha256Digest,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Sha256Digest {
    sha256: String,
}

impl Registration {
    fn subject(&self) -> Vec<Subject> {
        let of = |name: &str, sha256: &str| Subject {
            name: name.to_owned(),
            digest: Sha256Digest { sha256: sha256.to_owned() },
        };
        let question = self.question_sha256.iter().map(|sha256| of("question", sha256));
        std::iter::once(of("provenance", &self.provenance_sha256)).chain(question).collect()
    }

    fn sign(self, key: &PrivateKey) -> Envelope {
        let statement = Statement {
            type_uri: STATEMENT_TYPE.to_owned(),
            subject: self.subject(),
            predicate_type: REGISTRATION_PREDICATE.to_owned(),
            predicate: self,
        };
        // Strings and integers always serialise.
        Envelope::sign(PAYLOAD_TYPE, serde_json::to_string(&statement).unwrap_or_default().as_bytes(), key)
    }

    /// Reads a signed registration. The error says what is wrong with it.
    pub fn open(envelope: &str, key: &PublicKey) -> Result<Self, String> {
        let envelope: Envelope =
            Budget::FILE.json(envelope.as_bytes()).map_err(|e| format!("not a DSSE envelope: {e}"))?;
        if envelope.payload_type != PAYLOAD_TYPE {
            return Err(format!("payload type `{}`. Expected {PAYLOAD_TYPE}", envelope.payload_type.escape_debug()));
        }
        if !envelope.is_signed_by(key) {
            return Err(format!("no valid signature of key {}", key.id()));
        }
        let body = envelope.body().unwrap_or_default();
        let statement: Statement = Budget::FILE.json(&body).map_err(|e| format!("not a registration of a run: {e}"))?;
        let matches = statement.type_uri == STATEMENT_TYPE
            && statement.predicate_type == REGISTRATION_PREDICATE
            && statement.subject == statement.predicate.subject();
        if matches { Ok(statement.predicate) } else { Err("not a registration of a run".to_owned()) }
    }

    /// Checks that this registers the run with this provenance.
    fn check(&self, provenance: &Provenance) -> Result<(), String> {
        if self.provenance_sha256 != sha256(provenance.to_json().as_bytes()) {
            return Err("registers another run: plan, seed, policy or setup differ from those of the rows".to_owned());
        }
        Ok(())
    }
}

/// Signs and stores the registration of a run, which must not have started yet. Returns the envelope and the number.
///
/// The list of all registrations of the key is the file of the key with the suffix `.registrations`: one envelope per
/// line. Registrations are appended and never removed.
pub fn register(key: &PrivateKey, key_file: &Path, provenance: &Provenance) -> Result<(Envelope, u64), EvidenceError> {
    let path = list_of(key_file);
    let mut file = OpenOptions::new()
        .read(true)
        .append(true)
        .create(true)
        .open(&path)
        .map_err(EvidenceError::io(&path, "open"))?;
    // Two gates that start at the same time must not get the same number.
    file.lock().map_err(EvidenceError::io(&path, "lock"))?;
    let (number, previous_sha256) = last(&mut file, &path, &key.public())?;
    let registration = Registration {
        number: number + 1,
        previous_sha256,
        provenance_sha256: sha256(provenance.to_json().as_bytes()),
        question_sha256: provenance.question_sha256.clone(),
        seed: provenance.seed,
        policy: provenance.policy.clone(),
        policy_binding: PolicyBinding::of(provenance),
    };
    let envelope = registration.sign(key);
    let line = serde_json::to_string(&envelope).unwrap_or_default() + "\n";
    file.write_all(line.as_bytes()).and_then(|()| file.sync_all()).map_err(EvidenceError::io(&path, "append to"))?;
    Ok((envelope, number + 1))
}

/// The list of the registrations of a key.
pub fn list_of(key_file: &Path) -> PathBuf {
    let mut path = key_file.as_os_str().to_owned();
    path.push(".registrations");
    PathBuf::from(path)
}

/// The number and the hash of the last registration. Checks the whole chain.
fn last(file: &mut File, path: &Path, key: &PublicKey) -> Result<(u64, Option<String>), EvidenceError> {
    let wrong = |line: usize, reason: &str| {
        EvidenceError::Contradicts(Problem::new(
            format!("{}:{}", path.display(), line + 1),
            format!("{reason}. The list of registrations must not be edited"),
        ))
    };
    let mut text = String::new();
    file.seek(SeekFrom::Start(0)).map_err(EvidenceError::io(path, "read"))?;
    file.take(LONGEST).read_to_string(&mut text).map_err(EvidenceError::io(path, "read"))?;
    let (mut number, mut previous) = (0, None);
    for (i, line) in text.lines().enumerate() {
        let registration = Registration::open(line, key).map_err(|reason| wrong(i, &reason))?;
        if (registration.number, &registration.previous_sha256) != (number + 1, &previous) {
            return Err(wrong(i, "does not follow the registration before it"));
        }
        number += 1;
        previous = Some(sha256(line.as_bytes()));
    }
    Ok((number, previous))
}

/// Checks the registration in a folder of evidence. `None` if there is none.
pub(super) fn check(
    folder: &Path,
    files: &[super::FileRecord],
    provenance: &Provenance,
) -> Result<Option<Registered>, Problem> {
    let has = |name: &str| files.iter().any(|file| file.path == name);
    if !has(REGISTRATION) {
        return Ok(None);
    }
    let read = |name: &str| {
        let problem = |reason: String| Problem::new(name, reason);
        if !has(name) {
            return Err(problem("missing: the registration is signed by this key".to_owned()));
        }
        read_regular_text(&folder.join(name)).map_err(|e| problem(format!("cannot be read: {e}")))
    };
    let key = PublicKey::from_pem(&read(REGISTRATION_KEY)?).map_err(|reason| Problem::new(REGISTRATION_KEY, reason))?;
    let wrong = |reason: String| Problem::new(REGISTRATION, reason);
    let registration = Registration::open(&read(REGISTRATION)?, &key).map_err(wrong)?;
    registration.check(provenance).map_err(wrong)?;
    Ok(Some(Registered { keyid: key.id(), number: registration.number }))
}

fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}
