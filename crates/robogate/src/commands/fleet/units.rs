//! Runs the gates of all units.

use std::io::IsTerminal;
use std::ops::ControlFlow;
use std::path::Path;

use robogate_analysis::Source;
use robogate_campaign::folder::PLAN;
use robogate_campaign::{Completion, Event, Executor, Round, RunError};
use robogate_gate::{FleetUnit, GateError, Question, Record, Verdict};

use super::plan::{FleetPlan, Unit, UnitCampaign};
use super::result;
use crate::commands::gate::{refused, write_answer};
use crate::commands::run::{How, interrupted};
use crate::exit::{Exit, OrExit};
use robogate_session::{Look, Subject, write_question};

use crate::terminal::{grouped, note, percent};

/// How the execution of the units ended.
enum End {
    Done,
    /// A unit was interrupted: its episodes that are recorded, and all.
    Interrupted {
        done: u64,
        episodes: u64,
    },
}

/// Judges all units that are not finished, and writes the result.
pub(super) fn judge(dir: &Path, plan: &FleetPlan, subject: &Subject, how: &How) -> Result<u8, Exit> {
    let units = plan.all_units().collect::<anyhow::Result<Vec<Unit>>>().or_usage()?;
    let mut judged: Vec<FleetUnit> = Vec::new();
    let mut failed = None;
    let (end, outage) = how.guarded(subject, u64::MAX, |executor, events| {
        for unit in &units {
            let folder = dir.join(unit.folder());
            let campaign = match plan.campaign(unit) {
                Ok(campaign) => campaign,
                Err(error) => {
                    failed = Some(error);
                    return Ok(End::Done);
                }
            };
            subject.register(&folder, &campaign.provenance);
            match run(&folder, &campaign, executor, events)? {
                (Completion::Interrupted { done, episodes }, _) => return Ok(End::Interrupted { done, episodes }),
                (Completion::Finished { .. }, Some(error)) => {
                    failed = Some(refused(error));
                    return Ok(End::Done);
                }
                (Completion::Finished { .. }, None) => {}
            }
            match finish(&folder, unit, &campaign) {
                Ok(unit) => {
                    tell(plan, &unit);
                    judged.push(unit);
                }
                Err(error) => {
                    failed = Some(error);
                    return Ok(End::Done);
                }
            }
        }
        Ok(End::Done)
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    match (end, outage) {
        (End::Interrupted { .. }, Some(outage)) => Err(anyhow::anyhow!(
            "stopped: {outage}\nHint: the recorded episodes are kept; `robogate resume` runs the others once the server is \
             available again"
        ))
        .or_broken(),
        (End::Interrupted { done, episodes }, None) => {
            note(format_args!("{} of {} units are judged; of the next one:", judged.len(), units.len()));
            Ok(interrupted(dir, done, episodes))
        }
        (End::Done, _) => result::write(dir, plan, judged, how.json),
    }
}

/// Runs or continues the gate of a unit. Also returns the error that stopped it, if there was one.
fn run(
    dir: &Path,
    campaign: &UnitCampaign,
    executor: &dyn Executor,
    events: &mut dyn FnMut(&Event),
) -> Result<(Completion, Option<GateError>), RunError> {
    let UnitCampaign { plan, asked, provenance, record } = campaign;
    let (mut record, mut trouble) = (record.clone(), None);
    let completion = {
        let mut look = Look { asked, other: None, record: &mut record, trouble: &mut trouble };
        let mut after = |round: &Round<'_>| -> ControlFlow<()> { look.after(round) };
        // A bar for each unit suits a terminal. A log gets one line for each unit.
        let shown = std::io::stderr().is_terminal();
        let mut events = |event: &Event| {
            if let Event::Started { .. } = event {
                write_question(dir, asked);
            }
            if shown || matches!(event, Event::Warning { .. }) {
                events(event);
            }
        };
        if dir.join(PLAN).is_file() {
            robogate_campaign::resume_in_rounds(dir, provenance, executor, &mut events, &mut after)?
        } else {
            robogate_campaign::start_in_rounds(dir, plan, provenance.clone(), executor, &mut events, &mut after)?
        }
    };
    Ok((completion, trouble))
}

/// Evaluates a finished unit from the rows on disk, and writes the files of its gate.
fn finish(dir: &Path, unit: &Unit, campaign: &UnitCampaign) -> Result<FleetUnit, Exit> {
    let source = Source::open(dir).or_broken()?;
    let record = Record::of(source.dictionary()).map_err(refused)?;
    let asked = &campaign.asked;
    let question = Question {
        requirements: &asked.requirements,
        baseline: asked.baseline.as_ref(),
        against: None,
        sampling: asked.sampling,
    };
    let evaluation = question.evaluate(&record).map_err(refused)?;
    write_answer(dir, &evaluation, None)?;
    Ok(FleetUnit::of(u64::from(unit.number), unit.seed, &unit.parameters, &evaluation))
}

/// Prints the result of a unit.
fn tell(plan: &FleetPlan, unit: &FleetUnit) {
    let verdict = match unit.verdict {
        Verdict::Pass => "meets the requirements",
        Verdict::Fail => "violates them",
        Verdict::Inconclusive => "is undecided",
        Verdict::Invalid => "has no valid episode",
    };
    let rate = if unit.valid > 0 { percent(unit.successes as f64 / unit.valid as f64) } else { "-".to_owned() };
    note(format_args!(
        "unit {} of {} {verdict}: {rate} success in {} episodes",
        unit.unit,
        plan.units,
        grouped(unit.episodes)
    ));
}
