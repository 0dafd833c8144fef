//! A gate: runs a suite in rounds until the question is answered.

use std::ops::ControlFlow;
use std::path::Path;

use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{Completion, DEFAULT_SEED, Event, Plan, Round};
use robogate_core::Suite;
use robogate_dictionary::{Dictionary, Provenance, files};
use robogate_gate::{
    Against, Asked, AskedAgainst, Evaluation, GateError, Mode, Question, Record, Requirements, Sampling, Trial, Verdict,
};

use crate::arms::Arms;
use crate::compared::{built_in_baseline, judged};
use crate::controls::{CONTROL_EPISODES, run_controls};
use crate::failure::{Failure, OrFailure};
use crate::nominal_episodes::{default_nominal_episodes, nominal_rate_of};
use crate::notice::warning;
use crate::rival::Rival;
use crate::rounds::Rounds;
use crate::subject::Subject;
use crate::warner::warner_effect_of;
use crate::workers::Workers;

/// The number of scenarios of a suite that is sampled from a space.
pub const SAMPLED_SCENARIOS: usize = 64;

/// The default non-inferiority margin of a comparison with another policy, as a fraction.
pub const MARGIN: f64 = 0.05;

/// What a gate asks about a policy.
#[derive(Debug, Clone)]
pub struct GateRequest {
    /// The scenarios.
    pub suite: Suite,
    /// The requirements: the name of built-in ones, or a file.
    pub requirements: String,
    /// The largest number of rounds over the suite. `None` for that of the suite or of the requirements.
    pub rounds: Option<u32>,
    /// Whether all rounds run, and the test is done once.
    pub fixed: bool,
    /// The seed of the rounds.
    pub seed: u64,
    /// The non-inferiority margin of a comparison with another policy, as a fraction.
    pub margin: f64,
    /// The number of episodes of each control of an external policy. With 0, neither controls run nor the episodes that run twice.
    pub controls: u32,
}

impl GateRequest {
    /// A request with the default requirements and seed.
    pub fn of(suite: Suite) -> Self {
        let requirements = "default".to_owned();
        let controls = CONTROL_EPISODES;
        Self { suite, requirements, rounds: None, fixed: false, seed: DEFAULT_SEED, margin: MARGIN, controls }
    }

    /// Decides whether the policy of `subject` may run, from episodes in the new folder `folder`. With `rival`, both policies run
    /// the same scenarios, round by round, and the evaluation compares them. If a control fails, no
    /// other episode runs.
    ///
    /// # Errors
    /// A request that the task cannot meet, or infrastructure. A campaign that `workers` stops is an error too; its episodes
    /// are kept.
    pub fn decide(
        &self,
        subject: Subject,
        rival: Option<Subject>,
        folder: &Path,
        workers: Workers<'_>,
        events: &mut dyn FnMut(&Event),
    ) -> Result<Evaluation, Failure> {
        let requirements = Requirements::open(&self.requirements, subject.task())?;
        subject.check_suite(&self.suite).or_request()?;
        let (rounds, sampling) = rounds_and_sampling(&self.suite, &requirements, self.rounds, self.fixed);
        let mut plan = Plan::of_suite(self.suite.clone(), u64::from(rounds), self.seed);
        plan.nominal_episodes = default_nominal_episodes(&subject, &plan, self.suite.space());
        let controls = run_controls(&subject, &self.suite, self.controls, self.seed)?;
        let failed = controls.as_ref().is_some_and(|controls| controls.failure().is_some());
        let subject = match &controls {
            Some(controls) => subject.with_controls(controls),
            None => subject,
        };
        let provenance = subject.provenance(self.suite.space().clone())?;
        // The rows of the other policy do not exist yet.
        let unwritten =
            |_: &Subject| AskedAgainst { path: String::new(), dataset_sha256: String::new(), margin: self.margin };
        let mut asked = Asked {
            format: Asked::FORMAT,
            requirements,
            baseline: None,
            against: rival.as_ref().map(unwritten),
            sampling,
            real: None,
        };
        let record = begun(&with_plan(&provenance, &plan)?, &asked)?;
        asked.baseline = built_in_baseline(&record);
        if rival.is_some() {
            robogate_gate::check_repeats(&[&record])?;
        }
        if failed {
            // Episodes would say nothing about the policy.
            return Ok(Question { against: None, ..question(&asked, None) }.evaluate(&record)?);
        }
        let provenance = Provenance { question_sha256: Some(asked.sha256()), ..provenance };
        let planned = with_plan(&provenance, &plan)?;
        let rival = rival.map(|rival| Rival::new(rival, &planned, workers.threads)).transpose()?;
        subject.register(folder, &provenance);
        let arms = Arms::of(folder, &plan, &provenance.space, &subject)?;
        let mut rounds = Rounds::new(folder, asked, rival, None, record);
        let completion = workers.carry(folder, &subject, events, |executor, events| {
            rounds.run(&plan, provenance, arms, executor, &[], events)
        })?;
        if let Completion::Interrupted { done, episodes } = completion {
            return Err(anyhow::anyhow!("stopped after {done} of {episodes} episodes")).or_broken();
        }
        let (asked, other) = rounds.end(&completion)?;
        let dictionary = Dictionary::open(&folder.join(DICTIONARY)).or_broken()?;
        let record = judged(folder, &dictionary, &asked)?;
        let mut evaluation = question(&asked, other.as_ref()).evaluate(&record)?;
        evaluation.nominal = nominal_rate_of(folder)?;
        evaluation.warner = warner_effect_of(folder, &dictionary)?;
        Ok(evaluation)
    }
}

/// The largest number of rounds over a suite, and how they are tested, unless the user gives them: the protocol of a published
/// benchmark fixes the number of episodes, and requirements on the observed rate are tested once.
pub fn rounds_and_sampling(
    suite: &Suite,
    requirements: &Requirements,
    rounds: Option<u32>,
    fixed: bool,
) -> (u32, Sampling) {
    let usual = if suite.published().is_empty() { requirements.budget.rounds } else { 1 };
    let fixed = fixed || requirements.mode == Mode::Point;
    (rounds.unwrap_or(usual), if fixed { Sampling::Fixed } else { Sampling::Sequential })
}

/// The provenance of a campaign with this plan, as the run records it.
///
/// # Errors
/// A plan that is not valid JSON.
pub fn with_plan(provenance: &Provenance, plan: &Plan) -> Result<Provenance, Failure> {
    Ok(Provenance { plan: serde_json::to_value(plan).or_broken()?, seed: plan.seed, ..provenance.clone() })
}

/// Writes the question beside the plan. Without it, an interrupted gate cannot continue.
pub(crate) fn write_question(dir: &Path, asked: &Asked) {
    if let Err(error) = files::write(dir.join(Asked::FILE), asked.to_json()) {
        let file = dir.join(Asked::FILE);
        warning(format_args!("cannot write {}: {error}. `robogate resume` needs it", file.display()));
    }
}

/// Evaluates the question after each round.
pub struct Look<'a> {
    /// The question.
    pub asked: &'a Asked,
    /// The run that it compares with.
    pub other: Option<&'a Record>,
    /// The episodes so far.
    pub record: &'a mut Record,
    /// The error that has ended the rounds, if there was one.
    pub trouble: &'a mut Option<GateError>,
}

impl Look<'_> {
    /// Whether another round follows. Each pass over the rounds starts with round 0.
    pub fn after(&mut self, round: &Round<'_>) -> ControlFlow<()> {
        if round.number == 0 {
            self.record.trials.clear();
        }
        self.record.trials.extend(round.entries.iter().map(Trial::from));
        self.record.count_lost(round.lost);
        let fixed = self.asked.sampling == Sampling::Fixed;
        // Only invalid episodes and trials of the real robot end a gate with a fixed number of episodes.
        let valid = self.record.trials.iter().all(|trial| trial.ending.is_valid());
        if fixed && valid && self.record.real.is_none() {
            return ControlFlow::Continue(());
        }
        match question(self.asked, self.other).evaluate(self.record) {
            // More rounds cannot give a pass.
            Ok(evaluation) if evaluation.ruled_out.is_some() || evaluation.is_violated_by_trials() => {
                ControlFlow::Break(())
            }
            // A number of episodes that was fixed is tested once. The test at the end reports an error too.
            _ if fixed => ControlFlow::Continue(()),
            Ok(evaluation) if matches!(evaluation.verdict, Verdict::Pass | Verdict::Fail) => ControlFlow::Break(()),
            Ok(_) => ControlFlow::Continue(()),
            Err(error) => {
                *self.trouble = Some(error);
                ControlFlow::Break(())
            }
        }
    }
}

/// The record of a gate before its first episode, with the trials of the real robot that it was asked about.
///
/// # Errors
/// A provenance without a suite.
pub fn begun(provenance: &Provenance, asked: &Asked) -> Result<Record, GateError> {
    let record = Record::begun(provenance)?;
    Ok(Record { real: asked.real.clone(), ..record })
}

/// The question of a run, with the record of the run that it compares with.
pub fn question<'a>(asked: &'a Asked, other: Option<&'a Record>) -> Question<'a> {
    Question {
        requirements: &asked.requirements,
        baseline: asked.baseline.as_ref(),
        against: other.zip(asked.against.as_ref()).map(|(record, a)| Against { record, margin: a.margin }),
        sampling: asked.sampling,
    }
}
