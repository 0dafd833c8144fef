//! Checks that recorded rows are those that a plan gives.

use std::sync::Arc;

use robogate_core::Foresight;
use robogate_dictionary::{DictionaryError, Entry, Provenance};
use robogate_risk::all_processors;

use crate::active::Chooser;
use crate::{Bins, BoundaryReport, Plan, Points, RunError, Stage};

/// The reason why rows are not those of their plan.
#[derive(Debug, thiserror::Error)]
pub enum RowsError {
    /// The provenance contains no plan of a campaign.
    #[error("the rows have no plan of a campaign: {0}\nHint: only rows that robogate recorded can be checked")]
    NoPlan(serde_json::Error),
    /// An episode is missing.
    #[error("episode {index} is missing")]
    Missing {
        /// Its index.
        index: u64,
    },
    /// An episode with a scenario, stage, weight or label that the plan does not give.
    #[error("episode {index} is not an episode of the plan: its scenario, stage, weight or label differ")]
    Foreign {
        /// Its index.
        index: u64,
    },
    /// The number of episodes of a stage differs from the plan.
    #[error("there are {found} episodes. The plan has {expected}")]
    Count {
        /// The number of rows.
        found: u64,
        /// The number in the plan.
        expected: u64,
    },
    /// The plan is invalid.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The rows cannot be read.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
}

/// Checks that the rows are the episodes of the plan in their provenance: none is missing, none is added, and each has
/// the scenario that plan and seed give. Whether their outcomes are true takes a replay.
///
/// A suite may have stopped after any complete round. The points of an active stage follow from the rows before and from
/// `foresight`, which is that of the run's environment.
///
/// # Errors
/// The first difference. Another C library or CPU than that of the run can round a point differently.
pub fn check_rows<E>(
    provenance: &Provenance,
    foresight: Option<Arc<dyn Foresight>>,
    rows: impl Iterator<Item = Result<Entry, E>>,
) -> Result<u64, RowsError>
where
    RowsError: From<E>,
{
    let plan: Plan = serde_json::from_value(provenance.plan.clone()).map_err(RowsError::NoPlan)?;
    plan.check(&provenance.space).map_err(RunError::from)?;
    let space = Arc::new(provenance.space.clone());
    let mut points = match &plan.suite {
        Some(suite) => Points::suite(suite, plan.seed),
        None => Points::uniform(&plan, &space)?,
    };
    let mut bins = Bins::of(&plan, &space).map_err(RunError::from)?;
    let mut chooser = Chooser::new(&plan, &space, foresight, all_processors());
    let mut rounds = 0;
    let mut found = 0;
    for row in rows {
        let row = row?;
        if let Some(chooser) = &chooser
            && !points.indices().contains(&found)
            && found < plan.episodes()
        {
            let opened = chooser.open(rounds)?;
            points = Points::active(&plan, found, opened.points);
            rounds += 1;
        }
        if !points.indices().contains(&found) && points.stage() == Stage::Uniform && plan.boundary.episodes > 0 {
            let report = BoundaryReport::find(&plan.boundary, &space, &bins).map_err(RunError::from)?;
            points = Points::boundary(&plan, &space, &report)?;
        }
        let index = row.index();
        if index > found {
            return Err(RowsError::Missing { index: found });
        }
        if index < found || points.entry(row.episode.clone()).as_ref() != Some(&row) {
            return Err(RowsError::Foreign { index });
        }
        if points.scenario(index).as_ref() != Some(&row.episode.scenario) {
            return Err(RowsError::Foreign { index });
        }
        if points.stage() == Stage::Uniform {
            bins.add(&row.episode.scenario.requested, &row.episode.outcome);
        }
        if let Some(chooser) = &mut chooser {
            chooser.add(&row);
        }
        found += 1;
    }
    let expected = match &plan.suite {
        Some(suite) if found > 0 && found % suite.scenarios() == 0 => found,
        Some(suite) => (found / suite.scenarios() + 1) * suite.scenarios(),
        None => match &chooser {
            // The stage ends early if the model is good enough.
            Some(chooser)
                if found < plan.episodes()
                    && found == points.indices().end
                    && chooser.open(rounds)?.points.is_empty() =>
            {
                found
            }
            _ => plan.episodes(),
        },
    };
    if found == expected { Ok(found) } else { Err(RowsError::Count { found, expected }) }
}
