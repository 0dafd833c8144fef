//! The arms of a campaign: campaigns in its folder that run after it, whose plans follow from its plan.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::anyhow;
use robogate_campaign::folder::PLAN;
use robogate_campaign::{
    Completion, Event, Executor, FAMILIES, NOMINAL, NominalArm, Plan, RunError, SuiteStage, Summary,
};
use robogate_core::{ParameterSpace, TaskSpec};
use robogate_dictionary::Provenance;
use robogate_stats::format::count;

use crate::failure::{Failure, OrFailure};
use crate::nominal_episodes::{UNVARIED, nominal_suite};
use crate::notice::note;
use crate::subject::Subject;
use crate::warner::WarnedAgain;

/// The campaigns beside a campaign with twins: the control arm, and the episodes with one declared family of perturbations each. And
/// the episodes that run again without a warner.
pub struct Arms {
    arms: Vec<Arm>,
    warned: Option<WarnedAgain>,
}

struct Arm {
    kind: ArmKind,
    folder: PathBuf,
    plan: Plan,
    provenance: Provenance,
}

/// The kind of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ArmKind {
    /// The nominal twin of each episode.
    Nominal,
    /// For each episode, one with each declared family of perturbations alone.
    Families,
    /// A few episodes with nothing varied.
    Unvaried,
}

impl ArmKind {
    /// The kinds that follow from [`Plan::twins`].
    pub(crate) const TWINS: [Self; 2] = [Self::Nominal, Self::Families];

    /// The folder of the arm in that of its campaign.
    pub(crate) fn folder(self) -> &'static str {
        match self {
            Self::Nominal => NOMINAL,
            Self::Families => FAMILIES,
            Self::Unvaried => UNVARIED,
        }
    }

    /// The name of the arm in messages.
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Nominal => "control arm",
            Self::Families => "arm of one family each",
            Self::Unvaried => "arm with nothing varied",
        }
    }

    /// The name of its episodes in messages.
    fn episodes(self) -> &'static str {
        match self {
            Self::Nominal => "nominal twins",
            Self::Families | Self::Unvaried => "episodes",
        }
    }

    /// The plan of the arm. `None` if the campaign has none.
    ///
    /// # Errors
    /// A space that the arm cannot have.
    pub(crate) fn plan(
        self,
        plan: &Plan,
        space: &Arc<ParameterSpace>,
        task: &TaskSpec,
        rounds: u64,
    ) -> Result<Option<Plan>, RunError> {
        match self {
            Self::Nominal => NominalArm::of(plan, space, task, rounds).map(|arm| Some(arm.plan)),
            Self::Families => robogate_campaign::family_arm(plan, space, task, rounds),
            Self::Unvaried => {
                let suite = nominal_suite(task, space, 1)?;
                Ok(Some(Plan::of_suite(suite, plan.nominal_episodes, plan.seed)))
            }
        }
    }
}

impl Arms {
    /// The arms of a campaign in `dir`. None if its plan has no twins and no episodes with nothing varied.
    pub fn of(dir: &Path, plan: &Plan, space: &ParameterSpace, subject: &Subject) -> Result<Self, Failure> {
        let twins = if plan.twins { &ArmKind::TWINS[..] } else { &[] };
        let unvaried = if plan.nominal_episodes > 0 { &[ArmKind::Unvaried][..] } else { &[] };
        let mut arms = Vec::new();
        let rounds = plan.suite.as_ref().map_or_else(|| plan.episodes(), |stage| stage.rounds);
        let space = space.clone().into();
        for kind in [twins, unvaried].concat() {
            let Some(plan) = kind.plan(plan, &space, subject.task(), rounds)? else { continue };
            let provenance = subject.provenance(space_of(&plan)?)?;
            let folder = dir.join(kind.folder());
            subject.register(&folder, &provenance);
            arms.push(Arm { kind, folder, plan, provenance });
        }
        Ok(Self { arms, warned: subject.warned_again(dir) })
    }

    /// No arms.
    pub(crate) fn none() -> Self {
        Self { arms: Vec::new(), warned: None }
    }

    /// Whether the campaign has no arms.
    pub(crate) fn is_empty(&self) -> bool {
        self.arms.is_empty()
    }

    /// No arms, with a note.
    pub(crate) fn left_out(self) -> Self {
        let names: Vec<&str> = self.arms.iter().map(|arm| arm.kind.as_str()).collect();
        note(format_args!(
            "the {} does not run, because the invalid episodes rule out a pass",
            names.join(" and the ")
        ));
        Self { arms: Vec::new(), ..self }
    }

    /// Runs or resumes the arms after their campaign. A campaign that was stopped has no arms yet.
    pub fn after(
        self,
        campaign: Completion,
        executor: &dyn Executor,
        events: &mut dyn FnMut(&Event),
    ) -> Result<Completion, RunError> {
        let Completion::Finished { summary, .. } = &campaign else { return Ok(campaign) };
        for Arm { kind, folder, mut plan, provenance } in self.arms {
            if let Some(stage) = plan.suite.as_mut().filter(|_| kind != ArmKind::Unvaried) {
                as_many_rounds(stage, rounds_of(summary));
            }
            let done = if folder.join(PLAN).is_file() {
                robogate_campaign::resume(&folder, &provenance, executor, events)?
            } else {
                note(format_args!("{}: {} {}", kind.as_str(), count(plan.episodes()), kind.episodes()));
                robogate_campaign::start(&folder, &plan, provenance, executor, events)?
            };
            if let Completion::Interrupted { .. } = done {
                return Ok(done);
            }
        }
        let missing = self.warned.map_or(Ok(0), |warned| warned.run(executor))? as u64;
        match campaign {
            Completion::Finished { summary, .. } if missing > 0 => {
                let episodes = summary.episodes + missing;
                Ok(Completion::Interrupted { done: summary.episodes, episodes })
            }
            campaign => Ok(campaign),
        }
    }
}

/// The parameter space of the suite of an arm.
///
/// # Errors
/// A plan without a suite.
pub(crate) fn space_of(plan: &Plan) -> Result<ParameterSpace, Failure> {
    let space = plan.suite.as_ref().map(|stage| stage.suite.space().clone());
    space.ok_or_else(|| anyhow!("the arm has no suite")).or_broken()
}

/// The rounds of the suite that ran, or the episodes of a campaign without a suite.
pub(crate) fn rounds_of(summary: &Summary) -> u64 {
    summary.suite.as_ref().map_or(summary.episodes, |suite| suite.rounds)
}

/// Limits the arm to the rounds that ran.
fn as_many_rounds(stage: &mut SuiteStage, rounds: u64) {
    stage.rounds = stage.rounds.min(rounds.max(1));
}
