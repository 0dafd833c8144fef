//! Writes a folder of evidence.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use robogate_dictionary::{Dictionary, Tool, files};

use super::manifest::is_plain;
use super::{
    AGAINST, ATTESTATION, BARE_ENDING, BASELINE, DICTIONARY, EVALUATION, Envelope, EvidenceError, FileRecord, Judged,
    MANIFEST, Manifest, PAYLOAD_TYPE, PrivateKey, QuestionBinding, REQUIREMENTS, Role, SIGNED_ENDING, SIGNER,
    TEST_RESULT, facts, statement,
};
use crate::{RealEvidence, Sampling};

/// The content of a file of the evidence.
#[derive(Debug, Clone)]
pub enum Content {
    /// A file that is copied into the folder.
    File(PathBuf),
    /// Bytes that are written into the folder.
    Bytes(Vec<u8>),
}

/// The content of a folder of evidence.
#[derive(Debug, Clone)]
pub struct Ingredients {
    /// The rows.
    pub dictionary: PathBuf,
    /// The requirements (TOML).
    pub requirements: Content,
    /// The baseline of relative requirements (JSON).
    pub baseline: Option<Content>,
    /// Trials of the real robot ([`crate::RealEvidence`], JSON).
    pub real: Option<Content>,
    /// The rows of the policy that may be replaced, with the margin.
    pub against: Option<(PathBuf, f64)>,
    /// How the number of episodes was chosen.
    pub sampling: Sampling,
    /// Whether another question than that of the run's gate is accepted.
    pub reasked: bool,
    /// Further files: role, path in the folder, and content.
    pub others: Vec<(Role, String, Content)>,
    /// Documents that follow from the other files, in the formats of other tools. `None` for none.
    pub documents: Option<Documents>,
}

/// Writes documents about what was judged: path in the folder, and content.
pub type Documents = fn(&Judged<'_>) -> Vec<(String, Vec<u8>)>;

/// Writes the folder of evidence `to`, which must not exist. The folder appears complete or not at all.
pub fn write(to: &Path, ingredients: &Ingredients, key: Option<&PrivateKey>) -> Result<Manifest, EvidenceError> {
    if to.exists() {
        return Err(EvidenceError::Exists {
            path: to.to_owned(),
            hint: "evidence is not overwritten. Choose another folder",
        });
    }
    let name = to.file_name().ok_or_else(|| EvidenceError::Name(to.display().to_string()))?;
    let mut partial = std::ffi::OsString::from(".");
    partial.push(name);
    partial.push(".part");
    let partial = to.with_file_name(partial);
    // Left behind by a killed process.
    if partial.exists() {
        fs::remove_dir_all(&partial).map_err(EvidenceError::io(&partial, "clear"))?;
    }
    files::create_folders(&partial).map_err(EvidenceError::io(to, "create"))?;
    let written = fill(&partial, ingredients, key).map_err(|error| error.at(&partial, to)).and_then(|manifest| {
        files::sync_all_below(&partial).map_err(EvidenceError::io(to, "write"))?;
        fs::rename(&partial, to).and_then(|()| files::sync_parent(to)).map_err(EvidenceError::io(to, "create"))?;
        Ok(manifest)
    });
    if written.is_err() {
        // The error is returned already. The next attempt removes what is left.
        let _ = fs::remove_dir_all(&partial);
    }
    written
}

/// The files of a folder that is being written.
struct Filling<'a> {
    folder: &'a Path,
    roles: BTreeMap<String, Role>,
}

impl Filling<'_> {
    /// Adds a file that the caller chose.
    fn add(&mut self, role: Role, name: &str, content: &Content) -> Result<(), EvidenceError> {
        let reserved = [MANIFEST, EVALUATION, SIGNER].contains(&name)
            || [TEST_RESULT, ATTESTATION].iter().any(|statement| {
                [SIGNED_ENDING, BARE_ENDING].iter().any(|ending| name == format!("{statement}{ending}"))
            });
        if !is_plain(name) {
            return Err(EvidenceError::Name(name.to_owned()));
        }
        if reserved || self.roles.insert(name.to_owned(), role).is_some() {
            return Err(EvidenceError::Twice(name.to_owned()));
        }
        let place = self.folder.join(name);
        if let Some(parent) = place.parent() {
            fs::create_dir_all(parent).map_err(EvidenceError::io(parent, "create"))?;
        }
        match content {
            Content::File(from) => {
                let mut source = fs::File::open(from).map_err(EvidenceError::io(from, "read"))?;
                if fs::metadata(from).is_ok_and(|metadata| metadata.is_dir()) {
                    return Err(EvidenceError::io(from, "read")(std::io::ErrorKind::IsADirectory.into()));
                }
                let copied = fs::File::create(&place).and_then(|mut copy| std::io::copy(&mut source, &mut copy));
                copied.map(|_| ()).map_err(EvidenceError::io(&place, "write"))
            }
            Content::Bytes(bytes) => fs::write(&place, bytes).map_err(EvidenceError::io(&place, "write")),
        }
    }

    /// Adds a file with a reserved name.
    fn put(&mut self, role: Role, name: &str, content: &str) -> Result<(), EvidenceError> {
        put(self.folder, name, content)?;
        self.roles.insert(name.to_owned(), role);
        Ok(())
    }

    /// The records of all files, of which these are known.
    fn records(&self, known: Vec<FileRecord>) -> Result<Vec<FileRecord>, EvidenceError> {
        let new = self.roles.iter().filter(|(path, _)| known.iter().all(|file| file.path != **path));
        let new = new.map(|(path, role)| {
            let place = self.folder.join(path);
            let (bytes, sha256) = facts::digest(&place).map_err(EvidenceError::io(&place, "read"))?;
            Ok(FileRecord { path: path.clone(), role: *role, bytes, sha256 })
        });
        let mut records = new.collect::<Result<Vec<_>, EvidenceError>>()?;
        records.extend(known);
        records.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(records)
    }
}

fn put(folder: &Path, name: &str, content: &str) -> Result<(), EvidenceError> {
    let path = folder.join(name);
    fs::write(&path, content).map_err(EvidenceError::io(&path, "write"))
}

fn fill(folder: &Path, ingredients: &Ingredients, key: Option<&PrivateKey>) -> Result<Manifest, EvidenceError> {
    let mut files = Filling { folder, roles: BTreeMap::new() };
    files.add(Role::Dictionary, DICTIONARY, &Content::File(ingredients.dictionary.clone()))?;
    files.add(Role::Requirements, REQUIREMENTS, &ingredients.requirements)?;
    if let Some(baseline) = &ingredients.baseline {
        files.add(Role::Baseline, BASELINE, baseline)?;
    }
    if let Some(real) = &ingredients.real {
        files.add(Role::Real, RealEvidence::FILE, real)?;
    }
    if let Some((against, _)) = &ingredients.against {
        files.add(Role::Against, AGAINST, &Content::File(against.clone()))?;
    }
    for (role, name, content) in &ingredients.others {
        files.add(*role, name, content)?;
    }
    let margin = ingredients.against.as_ref().map(|(_, margin)| *margin);
    // The copies are judged, so that verdict and folder agree.
    let evaluation = facts::evaluate(folder, ingredients.sampling, margin)?;
    files.put(Role::Evaluation, EVALUATION, &evaluation.to_json())?;
    let mut records = files.records(Vec::new())?;
    if let Some(problem) = facts::origin(folder, &records)?.into_iter().next() {
        return Err(EvidenceError::Contradicts(problem));
    }
    if let Some(documents) = ingredients.documents {
        let dictionary = Dictionary::open(&folder.join(DICTIONARY))?;
        for (name, bytes) in documents(&Judged::of(folder, &evaluation, &dictionary, &records, margin)?) {
            files.add(Role::Compliance, &name, &Content::Bytes(bytes))?;
        }
    }
    if let Some(key) = key {
        files.put(Role::PublicKey, SIGNER, &key.public().to_pem())?;
    }
    records = files.records(records)?;
    let signer = key.map(|key| key.public().id());
    let manifest = facts::manifest(folder, Tool::robogate(), &evaluation, margin, signer, records)?;
    if let (QuestionBinding::Reasked { changed }, false) = (&manifest.question, ingredients.reasked) {
        return Err(EvidenceError::Reasked { changed: changed.clone() });
    }
    let json = manifest.to_json();
    let sha256 = facts::sha256(json.as_bytes());
    put(folder, MANIFEST, &json)?;
    for (name, body) in [
        (TEST_RESULT, statement::test_result(&manifest, &sha256, &evaluation)),
        (ATTESTATION, statement::evidence(&manifest, &sha256)),
    ] {
        match key {
            Some(key) => {
                let envelope = Envelope::sign(PAYLOAD_TYPE, body.as_bytes(), key);
                put(folder, &format!("{name}{SIGNED_ENDING}"), &envelope.to_json())?;
            }
            None => put(folder, &format!("{name}{BARE_ENDING}"), &(body + "\n"))?,
        }
    }
    Ok(manifest)
}
