//! `robogate verify`: checks evidence.

use std::path::PathBuf;

use clap::Args;
use robogate_gate::evidence::{Problem, PublicKey, Signed, Verified, verify};
use serde::Serialize;

use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::terminal::{bold, foreign, grouped, indented, line};

/// Verify a folder of evidence: every file, the signatures, and the verdict recomputed from the rows.
///
/// Exit codes: 0 if the evidence is valid, for any verdict in it; 4 if it is not.
#[derive(Debug, Args)]
pub(crate) struct Verify {
    /// Folder of the evidence
    evidence: PathBuf,
    /// Require a signature by this public key
    #[arg(long, value_name = "PUBLIC")]
    key: Option<PathBuf>,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

/// The document of `--json`.
#[derive(Debug, Serialize)]
struct Document<'a> {
    format: u32,
    holds: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    evidence: Option<&'a Verified>,
    problems: &'a [Problem],
}

impl Verify {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let key = self.key.as_deref().map(PublicKey::read).transpose().or_usage()?;
        if !self.evidence.is_dir() {
            let error = anyhow::anyhow!(
                "{} not a folder. Expected a folder written by `robogate evidence RUN OUT`",
                self.evidence.display()
            );
            return Err(error).or_usage();
        }
        let checked = verify(&self.evidence, key.as_ref());
        let problems = checked.as_ref().err().map_or(&[][..], Vec::as_slice);
        if self.json {
            let document = Document { format: 1, holds: checked.is_ok(), evidence: checked.as_ref().ok(), problems };
            line(serde_json::to_string_pretty(&document).or_broken()?);
        } else {
            match &checked {
                Ok(verified) => tell(verified),
                Err(_) => {
                    line(bold("verification failed"));
                    problems.iter().for_each(|problem| {
                        line(format_args!("  {}: {}", foreign(&problem.file), indented(&problem.reason)))
                    });
                }
            }
        }
        Ok(if checked.is_ok() { DONE } else { INVALID })
    }
}

fn tell(verified: &Verified) {
    let Verified { verdict, because, counts, policy, robot, files, signed } = verified;
    line(format_args!("{} {}", bold("verification passed: verdict"), bold(verdict)));
    line(format_args!("  {}", foreign(because)));
    line(format_args!(
        "  {} episodes of {} on {}, {} of them invalid; verdict recomputed from the rows",
        grouped(counts.episodes),
        foreign(policy),
        foreign(robot),
        grouped(counts.invalid)
    ));
    line(format_args!("  {files} files, all as listed in the manifest"));
    line(match signed {
        Signed::Unsigned => {
            "  UNSIGNED: the origin is unknown; anyone with write access to the folder could have created it".to_owned()
        }
        Signed::ByUnknown { keyid } => format!(
            "  signed by key {keyid}, which was not given\n  hint: pass the public key of the expected signer with \
             --key"
        ),
        Signed::ByTrusted { keyid } => format!("  signed by the expected key {keyid}"),
    });
}
