//! `robogate resume`: continue an interrupted campaign.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use robogate_gate::Asked;

use crate::arguments::ReopeningArguments;
use crate::commands::run::How;
use crate::commands::{fleet, gate};
use crate::exit::{Exit, OrExit};
use robogate_session::{Arms, Reopening, Subject, is_fleet};

/// Resume an interrupted campaign.
#[derive(Debug, Args)]
pub(crate) struct Resume {
    /// Folder of the run
    dir: PathBuf,
    #[command(flatten)]
    opening: ReopeningArguments,
    #[command(flatten)]
    how: How,
}

impl Resume {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let opening = Reopening { continues: true, ..self.opening.choice() };
        if is_fleet(&self.dir) {
            return fleet::resume(&self.dir, &opening, &self.how);
        }
        let settings = robogate_campaign::settings(&self.dir).or_usage()?;
        let asked = Asked::of(&self.dir).or_usage()?;
        if asked.is_none() && settings.provenance.question_sha256.is_some() {
            let file = self.dir.join(Asked::FILE);
            return Err(anyhow!(
                "{}: missing, but the plan is that of a gate with a question\nHint: restore the file, repeat `robogate merge` if \
                 it was interrupted, or start the gate again in another folder",
                file.display()
            ))
            .or_usage();
        }
        if let Some(asked) = &asked {
            asked.check(&settings.provenance)?;
        }
        let subject = Subject::recorded(&settings.provenance, Some(&self.dir), &opening)?;
        if let Some(asked) = asked {
            return gate::resume(&self.dir, asked, &subject, settings, &opening, &self.how);
        }
        let arms = Arms::of(&self.dir, &settings.plan, &settings.provenance.space, &subject)?;
        let provenance = subject.provenance(settings.provenance.space)?;
        self.how.conduct(&self.dir, &subject, |executor, events| {
            let completion = robogate_campaign::resume(&self.dir, &provenance, executor, events)?;
            arms.after(completion, executor, events)
        })
    }
}
