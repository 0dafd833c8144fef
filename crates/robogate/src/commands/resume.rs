//! `robogate resume`: go on where a campaign was interrupted.

use std::path::PathBuf;

use clap::Args;
use robogate_gate::Asked;

use crate::commands::gate;
use crate::commands::run::{How, provenance};
use crate::exit::{Exit, OrExit};
use crate::remote::Simulators;
use crate::world::Cell;

/// Go on with an interrupted campaign.
#[derive(Debug, Args)]
pub(crate) struct Resume {
    /// The run's folder
    dir: PathBuf,
    #[command(flatten)]
    simulators: Simulators,
    #[command(flatten)]
    how: How,
}

impl Resume {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let settings = robogate_campaign::settings(&self.dir).or_usage()?;
        let cell = Cell::recorded(&settings.provenance, &self.simulators)?.asked_again()?;
        if let Some(asked) = Asked::of(&self.dir).or_usage()? {
            return gate::go_on(&self.dir, asked, &cell, settings, &self.how);
        }
        let provenance = provenance(&cell, settings.provenance.space)?;
        self.how
            .conduct(&self.dir, &cell, |crew, events| robogate_campaign::resume(&self.dir, &provenance, crew, events))
    }
}
