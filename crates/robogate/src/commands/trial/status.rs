//! `robogate trial status`: checks the records of a study and shows its progress.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use robogate_gate::evidence::{Envelope, PublicKey};
use robogate_stats::format::counted;
use robogate_trial::{Folder, Phase, check_attachments};
use serde_json::json;

use super::{StudyArgument, exit, plan};
use crate::exit::{DONE, Exit, INVALID};
use crate::terminal::line;

/// Check the records of a study and show its progress.
///
/// Every record carries a code over itself and all records before. A record that was changed, removed or moved ends with exit
/// code 4. Nothing printed depends on the policies.
#[derive(Debug, Args)]
pub(super) struct Status {
    #[command(flatten)]
    study: StudyArgument,
    /// Check that the plan was signed with the private key of this public key
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Status {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let study = Folder::read(&self.study.study).map_err(exit)?;
        if let Some(key) = &self.key {
            self.check_signature(&PublicKey::read(key)?, &study.plan.to_json())?;
        }
        let attached = check_attachments(&self.study.study, &study).map_err(exit)?;
        let trials = study.attempts().iter().filter(|attempt| attempt.success().is_some()).count() as u64;
        let repeated = study.attempts().iter().filter(|attempt| attempt.is_repeated()).count() as u64;
        let (blocks, phase) = (study.blocks().len() as u64, study.phase());
        if self.json {
            line(json!({
                "version": 1,
                "phase": phase,
                "trials": trials,
                "repeated": repeated,
                "blocks": blocks,
                "most_blocks": study.plan.blocks,
                "attachments": attached,
                "unblinded": study.unblinded().is_some(),
                "plan_sha256": study.plan.sha256(),
            }));
            return Ok(DONE);
        }
        line("All records are intact.");
        line(format_args!(
            "{} with a result, {} of at most {} complete, {} repeated",
            counted(trials, "trial"),
            counted(blocks, "block"),
            study.plan.blocks,
            repeated
        ));
        if attached > 0 {
            line(format_args!("{} intact", counted(attached, "attachment")));
        }
        line(match (phase, study.unblinded()) {
            (_, Some(true)) => "Unblinded before its end: no claim.",
            (_, Some(false)) => "Ended and unblinded.",
            (Phase::Finished, None) => "Ended. `robogate trial unblind` publishes the order.",
            (Phase::Running, None) => "A trial runs.",
            (Phase::Stopped, None) => "A trial waits for its result.",
            (Phase::Paused, None) => "Paused.",
            (Phase::Ready, None) => "Ready for the next trial.",
        });
        Ok(DONE)
    }

    fn check_signature(&self, key: &PublicKey, plan: &str) -> Result<(), Exit> {
        let path = self.study.study.join(plan::SIGNED);
        let text = robogate_dictionary::read_regular_text(&path).unwrap_or_default();
        let signed = serde_json::from_str::<Envelope>(&text).ok().filter(|envelope| {
            let is_plan =
                envelope.payload_type == plan::PAYLOAD_TYPE && envelope.body().as_deref() == Some(plan.as_bytes());
            is_plan && envelope.is_signed_by(key)
        });
        if signed.is_some() {
            return Ok(());
        }
        Err(Exit { code: INVALID, error: anyhow!("{}: not this plan, signed by key {}", path.display(), key.id()) })
    }
}
