//! `robogate verify`: whether evidence holds.

use std::path::PathBuf;

use clap::Args;
use robogate_gate::evidence::{Problem, PublicKey, Signed, Verified, verify};
use serde::Serialize;

use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::terminal::{bold, foreign, grouped, indented, line};

/// Check a folder of evidence: every file, the signatures, and the verdict anew from the rows.
///
/// It ends with 0 where the evidence holds, whatever its verdict is, and with 4 where it does not.
#[derive(Debug, Args)]
pub(crate) struct Verify {
    /// The folder of evidence
    evidence: PathBuf,
    /// The public key that must have signed it
    #[arg(long, value_name = "PUBLIC")]
    key: Option<PathBuf>,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
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
                "{} is no folder\nhint: give the folder that `robogate evidence RUN OUT` made, after `robogate gate`",
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
                    line(bold("the evidence does not hold"));
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
    line(format_args!("{} {}", bold("the evidence holds: verdict"), bold(verdict)));
    line(format_args!("  {}", foreign(because)));
    line(format_args!(
        "  {} episodes of {} on {}, {} of them invalid; verdict computed anew from the rows",
        grouped(counts.episodes),
        foreign(policy),
        foreign(robot),
        grouped(counts.invalid)
    ));
    line(format_args!("  {files} files as the manifest says, and no other"));
    line(match signed {
        Signed::Unsigned => {
            "  UNSIGNED: nobody vouches for it; whoever has the folder could have made all of it".to_owned()
        }
        Signed::ByUnknown { keyid } => format!(
            "  signed by key {keyid}, of which nothing is known here\n  hint: pass --key with the public key of who you \
             think made it"
        ),
        Signed::ByTrusted { keyid } => format!("  signed by the given key {keyid}"),
    });
}
