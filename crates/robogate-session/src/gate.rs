//! A gate: runs a suite in rounds until the question is answered.

use std::ops::ControlFlow;
use std::path::Path;

use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{Completion, DEFAULT_SEED, Event, Plan, Round};
use robogate_core::Suite;
use robogate_dictionary::{Dictionary, Provenance};
use robogate_gate::{
    Against, Asked, AskedAgainst, Evaluation, GateError, Question, Record, Requirements, Sampling, Trial, Verdict,
};

use crate::failure::{Failure, OrFailure};
use crate::rival::Rival;
use crate::subject::Subject;
use crate::workers::Workers;

/// What a gate asks about a policy.
#[derive(Debug, Clone)]
pub struct GateRequest {
    /// The scenarios.
    pub suite: Suite,
    /// The requirements: the name of built-in ones, or a file.
    pub requirements: String,
    /// The largest number of rounds over the suite. `None` for that of the requirements.
    pub rounds: Option<u32>,
    /// Whether all rounds run, and the test is done once.
    pub fixed: bool,
    /// The seed of the rounds.
    pub seed: u64,
    /// The non-inferiority margin of a comparison with another policy, as a fraction.
    pub margin: f64,
}

impl GateRequest {
    /// A request with the default requirements and seed.
    pub fn of(suite: Suite) -> Self {
        let requirements = "default".to_owned();
        Self { suite, requirements, rounds: None, fixed: false, seed: DEFAULT_SEED, margin: 0.05 }
    }

    /// Decides whether the policy of `subject` may run, from episodes in the new folder `folder`. With `rival`, both policies run
    /// the same scenarios, round by round, and the evaluation compares them.
    ///
    /// # Errors
    /// A request that the task cannot meet, or infrastructure. A campaign that `workers` stops is an error too; its episodes
    /// are kept.
    pub fn decide(
        &self,
        subject: &Subject,
        rival: Option<Subject>,
        folder: &Path,
        workers: Workers<'_>,
        events: &mut dyn FnMut(&Event),
    ) -> Result<Evaluation, Failure> {
        let requirements = Requirements::open(&self.requirements, subject.task())?;
        subject.check_suite(&self.suite).or_request()?;
        let rounds = self.rounds.unwrap_or(requirements.budget.rounds);
        let plan = Plan::of_suite(self.suite.clone(), u64::from(rounds), self.seed);
        let mut asked = Asked {
            format: Asked::FORMAT,
            requirements,
            baseline: None,
            against: None,
            sampling: if self.fixed { Sampling::Fixed } else { Sampling::Sequential },
            real: None,
        };
        let provenance = subject.provenance(self.suite.space().clone())?;
        let provenance = Provenance { question_sha256: Some(asked.sha256()), ..provenance };
        let planned =
            Provenance { plan: serde_json::to_value(&plan).or_broken()?, seed: plan.seed, ..provenance.clone() };
        let mut record = begun(&planned, &asked)?;
        let mut rival =
            rival.map(|rival| Rival::new(rival, &planned, Workers::for_rival(workers.threads))).transpose()?;
        if rival.is_some() {
            asked.against =
                Some(AskedAgainst { path: String::new(), dataset_sha256: String::new(), margin: self.margin });
        }
        let (mut trouble, mut broken) = (None, None);
        subject.register(folder, &provenance);
        let completion = workers.carry(subject, events, |executor, events| {
            let mut after = |round: &Round<'_>| {
                if let Some(Err(error)) = rival.as_mut().map(|rival| rival.run(folder, round)) {
                    broken = Some(error);
                    return ControlFlow::Break(());
                }
                let other = rival.as_ref().map(Rival::record);
                Look { asked: &asked, other, record: &mut record, trouble: &mut trouble }.after(round)
            };
            robogate_campaign::start_in_rounds(folder, &plan, provenance, executor, events, &mut after)
        })?;
        if let Some(error) = broken {
            return Err(error);
        }
        if let Some(error) = trouble {
            return Err(error.into());
        }
        if let Completion::Interrupted { done, episodes } = completion {
            return Err(anyhow::anyhow!("stopped after {done} of {episodes} episodes")).or_broken();
        }
        let other = match rival {
            Some(rival) => {
                let (path, record) = rival.write(folder)?;
                let dataset_sha256 = record.dataset_sha256.clone();
                asked.against = Some(AskedAgainst { path, dataset_sha256, margin: self.margin });
                rival.clean(folder);
                Some(record)
            }
            None => None,
        };
        let record = Record::of(&Dictionary::open(&folder.join(DICTIONARY)).or_broken()?)?;
        Ok(question(&asked, other.as_ref()).evaluate(&record)?)
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
