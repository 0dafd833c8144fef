//! `robogate admit`: compares a deployed policy with the one that was judged.

mod cell;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_core::budget::Budget;
use robogate_dictionary::{hex, read_text};
use robogate_gate::evidence::{MANIFEST, Manifest};
use robogate_policy::{
    Admission, Asked, Checkpoint, Chunk, ExternalPolicy, Fingerprint, PolicyError, Profile, Query, admit,
};
use robogate_session::{
    CHECKPOINT, FINGERPRINT, MOST_FINGERPRINT_BYTES, Rehearsal, Reopening, checkpoint, is_rehearsed, policy_error,
    profile, read_checkpoint, read_fingerprint,
};
use robogate_stats::format::{counted, number};
use serde::Serialize;
use sha2::{Digest, Sha256};

use self::cell::CellArguments;
use crate::arguments::{AccessArguments, SimulatorArguments, TrustArguments};
use crate::exit::{DONE, Exit, FAIL, INVALID, OrExit};
use crate::number;
use crate::terminal::{bold, foreign, line, note};

/// Check that a deployed policy is the one that was judged: ask it the same, and compare its answers.
///
/// A gate of a policy server or a network stores a fingerprint: up to 64 requests of its episodes, with the answers. The deployed
/// policy gets the same requests. If its answers differ, the command tries the usual mistakes (mirrored images, exchanged cameras,
/// units, signs, order, normalisers, chunk length) and names those that explain the difference.
///
/// A policy that the process of an environment runs (sb3:, lerobot:, a function) is asked by the start of some episodes: the same
/// scenarios in the same environment, with the actions of the first control periods as answers.
///
/// With `gate --checkpoint`, and for policies that the environment's process loads, a gate also records the files of the checkpoint:
/// settings, tensors, code. `--checkpoint` compares those of the cell, and loads none of them. `--camera`, `--latency`, `--robot` and
/// `--rate` compare what the cell declares.
///
/// Exit codes: 0 if the policy is admitted, 1 if not, 4 if the fingerprint is not that of its evidence, 5 if the policy does not answer.
#[derive(Debug, Args)]
pub(crate) struct Admit {
    /// Folder of the gate or of its evidence, or a fingerprint file
    fingerprint: PathBuf,
    /// The deployed policy: the address of its server, or an ONNX file; for a gate whose environment ran the policy, the model of the cell
    /// (sb3:PATH, lerobot:PATH), which runs in the environment of the gate
    #[arg(long, value_name = "POLICY", required_unless_present_any = ["checkpoint", "camera", "latency", "robot"])]
    policy: Option<String>,
    /// The folder or file of the deployed checkpoint, compared file by file with the one that the gate recorded
    #[arg(long, value_name = "PATH")]
    checkpoint: Option<PathBuf>,
    /// How the cell sends observations and reads actions: a built-in profile or a TOML file. Differences from the judged profile are
    /// refused; default: the judged profile
    #[arg(long, value_name = "PROFILE", requires = "policy")]
    profile: Option<String>,
    /// Control periods of the cell per second; another number than that of the judged task is refused; default: not checked
    #[arg(long, value_name = "HZ", requires = "policy", value_parser = number::positive)]
    rate: Option<f64>,
    /// Start this environment, whose files must be those of the gate, for a policy that runs in its process; only needed for a gate that
    /// you did not make on this machine
    #[arg(long, value_name = "NAME", requires = "policy")]
    env: Option<String>,
    #[command(flatten)]
    trust: TrustArguments,
    #[command(flatten)]
    simulators: SimulatorArguments,
    #[command(flatten)]
    cell: CellArguments,
    #[command(flatten)]
    access: AccessArguments,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

/// The document of `--json`.
#[derive(Debug, Serialize)]
struct Document<'a> {
    format: u32,
    admitted: bool,
    /// The deployed policy. Absent without a running one.
    #[serde(skip_serializing_if = "Option::is_none")]
    policy: Option<&'a str>,
    /// SHA-256 (hex) of the fingerprint, by which evidence recognises the result. Absent without a running policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    fingerprint_sha256: Option<String>,
    /// The same of the recorded files of the checkpoint. Absent without --checkpoint.
    #[serde(skip_serializing_if = "Option::is_none")]
    checkpoint_sha256: Option<String>,
    /// The requests that were compared. Absent without a running policy, as are the three fields below.
    #[serde(skip_serializing_if = "Option::is_none")]
    requests: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    largest_difference: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tolerance: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p_value: Option<f64>,
    /// The files of the checkpoint that were compared. Absent without --checkpoint.
    #[serde(skip_serializing_if = "Option::is_none")]
    files: Option<usize>,
    /// The tensors in them.
    #[serde(skip_serializing_if = "Option::is_none")]
    tensors: Option<usize>,
    differences: &'a [String],
}

impl Admit {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        // A file that the evidence does not list is not decoded.
        if let Some(why) = not_of_its_evidence(&self.fingerprint)? {
            line(format_args!("{}", bold(format_args!("INVALID: {why}"))));
            return Ok(INVALID);
        }
        // Files first: they need no server.
        let files = self.checkpoint.as_deref().map(|path| self.files(path)).transpose()?;
        let judged = match &self.policy {
            Some(_) => Some(read_fingerprint(&self.fingerprint)?),
            // A gate has none if its policy has no requests, and the rest of the cell is compared.
            None if self.cell.any() => read_fingerprint(&self.fingerprint).ok(),
            None => None,
        };
        let of_cell = self.cell.differences(&self.fingerprint, judged.as_ref())?;
        let asked = match (&self.policy, &judged) {
            (Some(policy), Some(judged)) => Some(self.compare(policy, judged, files.as_ref())?),
            _ => None,
        };
        let answers = asked.iter().flat_map(|admission| &admission.differences);
        let differences: Vec<String> =
            files.iter().flat_map(|files| &files.differences).chain(&of_cell).chain(answers).cloned().collect();
        if self.json {
            let document = Document {
                format: 1,
                admitted: differences.is_empty(),
                policy: self.policy.as_deref(),
                fingerprint_sha256: asked.as_ref().map(|_| self.sha256_of(FINGERPRINT)).transpose()?,
                checkpoint_sha256: files.as_ref().map(|_| self.sha256_of(CHECKPOINT)).transpose()?,
                requests: asked.as_ref().map(|admission| admission.requests),
                largest_difference: asked.as_ref().and_then(|of| of.largest).filter(|largest| largest.is_finite()),
                tolerance: asked.as_ref().map(|admission| admission.tolerance),
                p_value: asked.as_ref().and_then(|admission| admission.p_value),
                files: files.as_ref().map(|files| files.recorded.size().0),
                tensors: files.as_ref().map(|files| files.recorded.size().1),
                differences: &differences,
            };
            line(serde_json::to_string_pretty(&document).or_broken()?);
        } else {
            self.print(asked.as_ref(), files.as_ref(), &differences);
        }
        Ok(if differences.is_empty() { DONE } else { FAIL })
    }

    /// SHA-256 (hex) of a file of the judged policy.
    fn sha256_of(&self, name: &str) -> Result<String, Exit> {
        let path = &self.fingerprint;
        let file = if path.is_dir() { path.join(name) } else { path.clone() };
        let bytes = fs::read(&file).with_context(|| format!("cannot read {}", file.display())).or_usage()?;
        Ok(hex(&Sha256::digest(&bytes)))
    }

    /// Compares the files of the deployed checkpoint with those that the gate recorded.
    fn files(&self, deployed: &Path) -> Result<Files, Exit> {
        let Some(recorded) = read_checkpoint(&self.fingerprint)? else {
            return Err(anyhow!(
                "{}: it has no {CHECKPOINT}\nHint: `robogate gate --checkpoint PATH` records the files of a policy; run the gate again",
                self.fingerprint.display()
            ))
            .or_usage();
        };
        let differences = recorded.differences(&checkpoint(deployed)?);
        Ok(Files { recorded, differences })
    }

    fn compare(&self, policy: &str, judged: &Fingerprint, files: Option<&Files>) -> Result<Admission, Exit> {
        let mut differences = Vec::new();
        let deployed = self.profile.as_deref().map(profile).transpose().or_usage()?;
        if let Some(deployed) = &deployed {
            differences.extend(differing_fields(judged, deployed).or_broken()?);
        }
        let period_s = judged.control_period_s;
        if let Some(rate) = self.rate.filter(|rate| (rate * period_s - 1.0).abs() > 1e-3) {
            differences.push(format!("the cell runs at {} Hz in place of {} Hz", number(rate), number(1.0 / period_s)));
        }
        note(format_args!(
            "{} of {}, to {}",
            counted(judged.probes.len() as u64, "request"),
            foreign(&judged.profile.name),
            foreign(policy)
        ));
        // The judged requests are sent as the judged profile says; another profile of the cell is a difference of its own.
        let refused = |why: String| Admission {
            requests: judged.probes.len(),
            largest: None,
            tolerance: judged.tolerance(),
            p_value: None,
            differences: vec![why],
        };
        if is_rehearsed(judged) {
            let opening = Reopening {
                env: self.env.clone(),
                trust: self.trust.choice(),
                access: self.access.choice(),
                simulators: self.simulators.choice(),
                ..Reopening::none()
            };
            let mut policy = Rehearsal::deployed(&self.fingerprint, judged, policy, &opening)?;
            let mut admission = admit(judged, &mut policy).map_err(policy_error)?;
            admission.differences.splice(0..0, differences);
            return Ok(admission);
        }
        let mut answered = 0;
        let (profile, access) = (Arc::new(judged.profile.clone()), self.access.choice().access()?);
        let asked = ExternalPolicy::connect_with(policy, profile, access, &mut |_| {}).and_then(|mut policy| {
            differences.extend(
                files.iter().flat_map(|files| files.recorded.contradictions(policy.declared(), &judged.declared)),
            );
            let mut counted = Counted { policy: &mut policy, answered: 0 };
            let admission = admit(judged, &mut counted);
            answered = counted.answered;
            admission
        });
        let mut admission = match asked {
            Ok(admission) => admission,
            // A policy that answers some requests and reports an error for others has not answered.
            Err(error) if is_answer(&error) && (answered == 0 || !matches!(error, PolicyError::Reported { .. })) => {
                refused(error.to_string())
            }
            Err(error) => return Err(policy_error(error).into()),
        };
        admission.differences.splice(0..0, differences);
        Ok(admission)
    }

    fn print(&self, asked: Option<&Admission>, files: Option<&Files>, differences: &[String]) {
        let deployed = match (&self.policy, &self.checkpoint) {
            (Some(policy), _) => foreign(policy).to_string(),
            (None, Some(path)) => path.display().to_string(),
            (None, None) => "the cell".to_owned(),
        };
        if !differences.is_empty() {
            line(bold(format_args!("NOT ADMITTED: {deployed}")));
            differences.iter().for_each(|difference| line(format_args!("  {}", foreign(difference))));
            return;
        }
        line(bold(format_args!(
            "ADMITTED: {deployed} {}",
            match asked {
                Some(_) => "answers as the judged policy",
                None if files.is_some() => "has the files of the judged policy",
                None => "is as the judged one in what was compared",
            }
        )));
        if let Some(files) = files {
            let (files, tensors) = files.recorded.size();
            line(format_args!(
                "  {} of the checkpoint and {} agree",
                counted(files as u64, "file"),
                counted(tensors as u64, "tensor")
            ));
        }
        let Some(Admission { requests, largest, tolerance, p_value, .. }) = asked else {
            note(
                "Not checked here: the running policy. --policy asks it, if the gate has a fingerprint of its answers.",
            );
            return;
        };
        let of = counted(*requests as u64, "request");
        match (largest, p_value) {
            (Some(largest), _) => line(format_args!(
                "  {of}; largest difference {} % of the spread of a number, tolerance {} %",
                number(100.0 * largest),
                number(100.0 * tolerance)
            )),
            (None, Some(p)) => line(format_args!("  {of}; random answers of the same distribution (p = {p:.3})")),
            (None, None) => line(format_args!("  {of}")),
        }
        let rate = self.rate.is_none().then_some("--rate");
        let options: Vec<&str> = rate.into_iter().chain(self.cell.missing()).collect();
        let more = if options.is_empty() { String::new() } else { format!(" {} compare more.", options.join(", ")) };
        note(format_args!("Not checked here: what the program of the cell does before its requests.{more}"));
    }
}

/// The files of the judged checkpoint, and how those of the deployed one differ.
struct Files {
    recorded: Checkpoint,
    differences: Vec<String>,
}

/// A policy whose answers are counted.
struct Counted<'a> {
    policy: &'a mut ExternalPolicy,
    answered: u64,
}

impl Asked for Counted<'_> {
    fn ask(&mut self, query: &Query) -> Result<Chunk, PolicyError> {
        let answer = self.policy.ask(query)?;
        self.answered += 1;
        Ok(answer)
    }

    fn declared(&self) -> &serde_json::Value {
        self.policy.declared()
    }
}

/// Whether an error is an answer of the policy that no judged policy gives, and not a fault of the connection.
fn is_answer(error: &PolicyError) -> bool {
    matches!(
        error,
        PolicyError::Mismatch(_)
            | PolicyError::Shape(_)
            | PolicyError::NotFinite { .. }
            | PolicyError::Network { .. }
            | PolicyError::Reported { .. }
    )
}

/// Why the fingerprint or the record of the checkpoint in a folder of evidence is not the one that its manifest lists. `None` outside of
/// evidence.
fn not_of_its_evidence(folder: &Path) -> Result<Option<String>, Exit> {
    let manifest = folder.join(MANIFEST);
    if !folder.is_dir() || !manifest.exists() {
        return Ok(None);
    }
    let text = read_text(&manifest).with_context(|| format!("cannot read {}", manifest.display())).or_usage()?;
    let read = Budget::FILE.json::<Manifest>(text.as_bytes());
    let manifest =
        read.map_err(|why| anyhow!("{}: not a manifest of evidence: {why}", manifest.display())).or_usage()?;
    for name in [FINGERPRINT, CHECKPOINT] {
        let path = folder.join(name);
        if !path.exists() {
            continue;
        }
        let metadata = fs::metadata(&path).with_context(|| format!("cannot read {name}")).or_usage()?;
        if !metadata.is_file() || metadata.len() > MOST_FINGERPRINT_BYTES {
            return Ok(Some(format!("{name} is not a file of at most 64 MiB")));
        }
        let bytes = fs::read(&path).with_context(|| format!("cannot read {name}")).or_usage()?;
        let listed = manifest.files.iter().find(|file| file.path == name);
        if listed.is_none_or(|file| file.sha256 != hex(&Sha256::digest(&bytes))) {
            return Ok(Some(format!("{name} is not the file that the manifest of the evidence lists")));
        }
    }
    note("`robogate verify` checks the signature of the evidence");
    Ok(None)
}

/// The fields in which the profile of a cell differs from the judged one.
fn differing_fields(judged: &Fingerprint, deployed: &Profile) -> serde_json::Result<Vec<String>> {
    let (a, b) = (serde_json::to_value(&judged.profile)?, serde_json::to_value(deployed)?);
    let mut found = Vec::new();
    compare(&a, &b, String::new(), &mut found);
    Ok(found)
}

/// Adds the differences of two documents, each with its path. The way to a server is not part of a policy's meaning.
fn compare(a: &serde_json::Value, b: &serde_json::Value, path: String, found: &mut Vec<String>) {
    use serde_json::Value;
    let within = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match (a, b) {
        (Value::Object(a), Value::Object(b)) => {
            for key in a.keys().chain(b.keys().filter(|key| !a.contains_key(*key))) {
                if !["name", "model", "server"].contains(&within(key).as_str()) {
                    compare(a.get(key).unwrap_or(&Value::Null), b.get(key).unwrap_or(&Value::Null), within(key), found);
                }
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (at, (a, b)) in a.iter().zip(b).enumerate() {
                compare(a, b, within(&(at + 1).to_string()), found);
            }
        }
        _ if a != b => found.push(format!("the profile of the cell has {path} = {b} in place of {a}")),
        _ => {}
    }
}
