//! Runs the gates of all units.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use robogate_campaign::folder::{DICTIONARY, PLAN};
use robogate_campaign::{Completion, Event, Executor};
use robogate_dictionary::Dictionary;
use robogate_gate::{Evaluation, FleetUnit, Record};

use super::plan::{FleetPlan, Unit, UnitCampaign};
use crate::arms::Arms;
use crate::failure::{Failure, OrFailure};
use crate::gate::question;
use crate::rounds::Rounds;
use crate::subject::Subject;
use crate::workers::{Workers, guarded};

/// How the execution of the units ended.
#[derive(Debug)]
pub enum FleetEnd {
    /// All units are judged.
    Judged(Vec<FleetUnit>),
    /// A unit was interrupted.
    Interrupted {
        /// The number of judged units.
        judged: usize,
        /// The folder of the fleet's unit that was interrupted.
        unit: PathBuf,
        /// The recorded episodes of this unit.
        done: u64,
        /// All episodes of this unit.
        episodes: u64,
    },
}

/// What happens to each judged unit: its folder, the unit, and the evaluation of its gate.
pub type OnUnit<'a> = dyn FnMut(&Path, &FleetUnit, &Evaluation) -> Result<(), Failure> + 'a;

impl FleetPlan {
    /// Judges all units that are not finished, in the folder `dir`, and calls `on_unit` for every unit in order.
    ///
    /// # Errors
    /// A unit that cannot be judged, or servers that stay unavailable: the recorded episodes are kept.
    pub fn judge(
        &self,
        dir: &Path,
        subject: &Subject,
        workers: Workers<'_>,
        events: &mut dyn FnMut(&Event),
        on_unit: &mut OnUnit<'_>,
    ) -> Result<FleetEnd, Failure> {
        let (end, outage) = workers.with_pool(subject, |pool| {
            guarded(pool, u64::MAX, events, |executor, events| Ok(self.units(dir, subject, executor, events, on_unit)))
        })?;
        match (end?, outage) {
            (FleetEnd::Interrupted { .. }, Some(outage)) => Err(anyhow!(
                "stopped: {outage}\nHint: the recorded episodes are kept; `robogate resume` runs the others once the server is \
                 available again"
            ))
            .or_broken(),
            (end, _) => Ok(end),
        }
    }

    fn units(
        &self,
        dir: &Path,
        subject: &Subject,
        executor: &dyn Executor,
        events: &mut dyn FnMut(&Event),
        on_unit: &mut OnUnit<'_>,
    ) -> Result<FleetEnd, Failure> {
        let units = self.all_units().collect::<anyhow::Result<Vec<Unit>>>().or_request()?;
        let mut judged = Vec::new();
        for unit in &units {
            let folder = dir.join(unit.folder());
            let campaign = self.campaign(unit)?;
            subject.register(&folder, &campaign.provenance);
            let UnitCampaign { plan, asked, provenance, record } = campaign;
            let mut rounds = Rounds::new(&folder, asked, None, None, record);
            let completion = if folder.join(PLAN).is_file() {
                rounds.resume(&provenance, Arms::none(), executor, events)?
            } else {
                rounds.run(&plan, provenance, Arms::none(), executor, &[], events)?
            };
            if let Completion::Interrupted { done, episodes } = completion {
                return Ok(FleetEnd::Interrupted { judged: judged.len(), unit: folder, done, episodes });
            }
            let (asked, _) = rounds.end(&completion)?;
            // From the rows on disk.
            let record =
                Record::of(&Dictionary::open(&folder.join(DICTIONARY)).or_broken()?)?.with_faults_in(&folder)?;
            let evaluation = question(&asked, None).evaluate(&record)?;
            let unit = FleetUnit::of(u64::from(unit.number), unit.seed, &unit.parameters, &evaluation);
            on_unit(&folder, &unit, &evaluation)?;
            judged.push(unit);
        }
        Ok(FleetEnd::Judged(judged))
    }
}
