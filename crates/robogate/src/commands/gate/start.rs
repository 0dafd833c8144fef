//! A gate that runs episodes: prepares the question, and runs the suite until the verdict is certain.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use robogate_campaign::{Completion, DEFAULT_SEED, Plan, Settings};
use robogate_core::Suite;
use robogate_dictionary::{Label, Provenance, files};
use robogate_gate::{Asked, AskedAgainst, GatePlan, PairPlan, Planned, Question, Record, Requirements, Sampling};
use robogate_report::Again;
use robogate_stats::format::counted;

use super::Gate;
use super::question::{Other, real_evidence_for};
use super::verdict::{answer_files, finish, show};
use crate::answer;
use crate::commands::register::{Registered, Registrar, free};
use crate::commands::run::{How, free_folder, introduce};
use crate::commands::shard;
use crate::exit::{DONE, Exit, OrExit};
use crate::force_limits;
use crate::place;
use crate::terminal::{line, note};
use robogate_session::{
    Arms, CHECKPOINT, MARGIN, PolicyChoice, Reopening, Rival, Rounds, SAMPLED_SCENARIOS, Subject, checkpoint, families,
    named_suite, nominal_suite, rounds_and_sampling, run_controls, with_plan,
};

/// A gate before its first episode.
struct Prepared {
    subject: Subject,
    plan: Plan,
    /// The provenance without the plan.
    provenance: Provenance,
    /// The provenance as the run records it.
    planned: Provenance,
    record: Record,
    requirements: Requirements,
    other: Other,
    /// The non-inferiority margin.
    margin: f64,
    sampling: Sampling,
    rounds: u64,
    scenarios: usize,
    /// How often the gate decides.
    expected: GatePlan,
    /// Whether a control of the policy failed, so that its episodes would say nothing about it.
    control_failed: bool,
}

impl Gate {
    /// Runs a suite until the verdict is certain.
    pub(super) fn start(&self) -> Result<u8, Exit> {
        self.check_nominal()?;
        self.check_margin(self.against.is_some() || self.against_run().is_some())?;
        if let Some(out) = self.out.as_ref().filter(|_| self.divide.is_none()) {
            place::check_local(out)?;
        }
        let prepared = self.prepare()?;
        if self.plan {
            return self.print_expected(&prepared);
        }
        let asked = prepared.asked(self.against.is_some());
        let provenance = Provenance { question_sha256: Some(asked.sha256()), ..prepared.provenance.clone() };
        // Read before anything is written, so that an unusable key is reported early.
        let registrar = self.register.as_deref().map(Registrar::new).transpose()?;
        let dir = match &self.out {
            Some(dir) => dir.clone(),
            None => free_folder(&format!("gate-{}-{}", prepared.subject.label(), prepared.plan.seed)),
        };
        if prepared.control_failed {
            return self.refuse(&dir, &prepared, &asked);
        }
        prepared.subject.register(&dir, &provenance);
        if let Some(shards) = self.divide {
            return self.divide(&dir, shards, &prepared.plan, provenance, &asked, registrar.as_ref());
        }
        let rival = self.rival(&prepared)?;
        self.introduce(&dir, &prepared, &provenance);
        self.run_suite(dir, prepared, asked, provenance, rival, registrar.as_ref())
    }

    /// Finds everything that the gate depends on. Questions that cannot be decided are reported before anything runs, the
    /// controls included.
    fn prepare(&self) -> Result<Prepared, Exit> {
        let suite = self.suite.as_deref().map(named_suite).transpose()?;
        let environment =
            self.environment.choice().with_policy(&self.policy.choice())?.environment_of(suite.as_ref())?;
        let policy = self.policy.choice().source_at(&self.location())?;
        // With --against, the key can be that of the other policy.
        if self.against.is_none() {
            self.location().check_used(policy.as_ref())?;
        }
        let subject = Subject::new(environment, policy)?;
        let subject =
            subject.with_statistics(&self.policy.choice().statistics)?.with_latency(&self.latency.choice())?;
        let subject = subject.with_warner(&self.warner.choice())?;
        let wanted = self.requirements.as_deref().unwrap_or("default");
        let requirements = Requirements::open(wanted, subject.task())?;
        let requirements = force_limits::added(requirements, self.force_limits.as_deref(), subject.task())?;
        let suite = self.suite(&subject)?;
        subject.check_suite(&suite).or_usage()?;
        let (rounds, sampling) = rounds_and_sampling(&suite, &requirements, self.rounds, self.fixed);
        let labels: Vec<Label> = suite
            .cases()
            .iter()
            .map(|case| Label {
                case: Some(case.id.clone()),
                category: Some(case.category.clone()),
                group: Some(case.group.clone()),
            })
            .collect();
        // A comparison with another run uses its seed, because only identical scenarios can be paired.
        let seed = match (self.seed, self.other_seed()?) {
            (Some(seed), _) | (None, Some(seed)) => seed,
            (None, None) => DEFAULT_SEED,
        };
        let mut plan = Plan::of_suite(suite.clone(), u64::from(rounds), seed);
        plan.twins |= self.twins;
        plan.nominal_episodes = self.nominal_episodes.of(&subject, &plan, suite.space())?;
        plan.check(suite.space()).or_usage()?;
        let planned = with_plan(&subject.provenance(suite.space().clone())?, &plan)?;
        let mut record = Record::begun(&planned)?;
        record.real = self.real.as_deref().map(|file| real_evidence_for(file, &planned)).transpose()?;
        // A plan runs nothing, and may precede the trials.
        if !self.plan {
            requirements.check_real(record.real.as_ref())?;
        }
        let other = self.other(&record)?;
        let expected = GatePlan::of(&requirements, other.baseline.as_ref(), &labels, sampling, u64::from(rounds))?;
        requirements.check_task(subject.task())?;
        let margin = self.margin.unwrap_or(MARGIN);
        if let Some((_, a)) = &other.record {
            let planned = Planned { seed: plan.seed, rounds: u64::from(rounds), sampling, alpha: requirements.alpha() };
            robogate_gate::check_pairing(a, &record, planned, margin)?;
        }
        let controls = if self.plan { None } else { run_controls(&subject, &suite, self.controls, seed)? };
        let subject = match &controls {
            Some(controls) => subject.with_controls(controls),
            None => subject,
        };
        let provenance = subject.provenance(suite.space().clone())?;
        let planned = with_plan(&provenance, &plan)?;
        record.controls = planned.controls().cloned();
        let compared = other.record.is_some() || self.against.is_some() || plan.twins;
        if compared {
            robogate_gate::check_repeats(&[&record])?;
        }
        Ok(Prepared {
            subject,
            plan,
            provenance,
            planned,
            record,
            requirements,
            other,
            margin,
            sampling,
            rounds: u64::from(rounds),
            scenarios: labels.len(),
            expected,
            control_failed: controls.is_some_and(|controls| controls.failure().is_some()),
        })
    }

    /// The suite of the arguments, or that of the task, or one sampled from the environment's space.
    fn suite(&self, subject: &Subject) -> Result<Suite, Exit> {
        let named = |name: &str| {
            let suite = named_suite(name)?;
            self.latency.choice().check_suite(suite.space()).or_usage()?;
            Ok(suite)
        };
        if self.nominal.is_some() {
            return nominal_suite(subject.task(), &subject.space(None).or_usage()?, SAMPLED_SCENARIOS).or_usage();
        }
        match (&self.suite, &self.space, subject.own_suite()) {
            (Some(name), _, _) => named(name),
            (None, None, Some(own)) if self.family.is_empty() => named(own),
            (None, space, _) => {
                let space = subject
                    .space(space.as_deref())
                    .and_then(|space| self.latency.choice().added_to(space, subject.task()))
                    .or_usage()?;
                if !self.family.is_empty() {
                    return families::suite(&self.family, &space, subject.task(), SAMPLED_SCENARIOS).or_usage();
                }
                // A fixed set of points is judged as it is. Otherwise the verdict is about the space. A space with jointly sampled
                // parameters has no fresh points.
                let suite = if self.fixed || !space.correlations().is_empty() {
                    Suite::sampled(&Arc::new(space), SAMPLED_SCENARIOS, self.seed.unwrap_or(DEFAULT_SEED))
                } else {
                    Suite::fresh(&space, SAMPLED_SCENARIOS)
                };
                suite.map_err(anyhow::Error::from).or_usage()
            }
        }
    }

    /// Prints how often the gate passes and fails at given true rates.
    fn print_expected(&self, prepared: &Prepared) -> Result<u8, Exit> {
        let pairs = match self.against {
            Some(_) => {
                let (alpha, per_round) = (prepared.requirements.alpha(), prepared.scenarios as u64);
                Some(PairPlan::of(prepared.margin, alpha, per_round, prepared.rounds)?)
            }
            None => None,
        };
        if self.how.json {
            let mut document = serde_json::to_value(&prepared.expected).or_broken()?;
            if let (Some(document), Some(pairs)) = (document.as_object_mut(), &pairs) {
                document.insert("against".to_owned(), serde_json::to_value(pairs).or_broken()?);
            }
            line(serde_json::to_string_pretty(&document).or_broken()?);
        } else {
            answer::print_plan(&prepared.expected);
            pairs.iter().for_each(answer::print_pair_plan);
        }
        Ok(DONE)
    }

    /// The policy of `--against`.
    fn rival(&self, prepared: &Prepared) -> Result<Option<Rival>, Exit> {
        let Some(policy) = &self.against else { return Ok(None) };
        let policy = PolicyChoice::of(policy, self.against_profile.as_deref()).with_map_of(&self.policy.choice());
        let source = policy.source_at(&self.location())?;
        let environment = self.environment.choice().with_policy(&policy)?.environment()?;
        let subject = Subject::new(environment, source)?;
        Rival::new(subject, &prepared.planned, self.how.threads).map(Some).map_err(Exit::from)
    }

    /// Writes the plan of the gate in shards.
    fn divide(
        &self,
        dir: &Path,
        shards: u32,
        plan: &Plan,
        provenance: Provenance,
        asked: &Asked,
        registrar: Option<&Registrar>,
    ) -> Result<u8, Exit> {
        let question = asked.to_json();
        let registration = registrar.map(|registrar| registrar.register(plan, &provenance)).transpose()?;
        let files = registration.as_ref().map(Registered::files).into_iter().flatten();
        let documents: Vec<(&str, &[u8])> = std::iter::once((Asked::FILE, question.as_bytes())).chain(files).collect();
        shard::divide(dir, shards, plan, provenance, &documents, self.how.json)
    }

    /// Answers without an episode of the policy, because a control failed.
    fn refuse(&self, dir: &Path, prepared: &Prepared, asked: &Asked) -> Result<u8, Exit> {
        let question = Question {
            requirements: &asked.requirements,
            baseline: asked.baseline.as_ref(),
            against: None,
            sampling: asked.sampling,
        };
        let evaluation = question.evaluate(&prepared.record)?;
        // The store of a campaign in shards has no place for an answer without one.
        let local = Some(dir).filter(|dir| !place::is_remote(dir));
        if let Some(dir) = local {
            files::create_folders(dir).with_context(|| format!("cannot create {}", dir.display())).or_broken()?;
            answer_files(dir, &evaluation, None)?;
        }
        show(dir, local, &evaluation, &prepared.planned, self.how.json)
    }

    /// Prints what will run.
    fn introduce(&self, dir: &Path, prepared: &Prepared, provenance: &Provenance) {
        let seed = prepared.plan.seed;
        introduce(provenance, seed);
        prepared.subject.note_warner(&prepared.planned);
        note(format_args!(
            "{}: {} scenarios, {} {}, requirements `{}`, into {}",
            prepared.record.population,
            prepared.scenarios,
            if prepared.sampling == Sampling::Fixed { "exactly" } else { "at most" },
            counted(prepared.rounds, "round"),
            prepared.requirements.name,
            dir.display()
        ));
        if self.seed.is_none() {
            note(format_args!(
                "seed {seed}: the default of every gate. A policy that was tuned on these scenarios must be judged with another --seed"
            ));
        }
    }

    /// Runs the rounds, and prints the verdict.
    fn run_suite(
        &self,
        dir: PathBuf,
        prepared: Prepared,
        mut asked: Asked,
        provenance: Provenance,
        rival: Option<Rival>,
        registrar: Option<&Registrar>,
    ) -> Result<u8, Exit> {
        let Prepared { subject, plan, record, other, margin, .. } = prepared;
        if let Some(rival) = &rival {
            asked.against = Some(AskedAgainst { path: rival.file(&dir), dataset_sha256: String::new(), margin });
            note(format_args!("against {}: the same scenarios, round by round", rival.name()));
        }
        let registration = match registrar {
            Some(registrar) => {
                free(&dir)?;
                Some(registrar.register(&plan, &provenance)?)
            }
            None => None,
        };
        let recorded = match &self.checkpoint {
            Some(path) => Some(checkpoint(path)?),
            None => subject.loaded_checkpoint(),
        };
        let recorded = recorded.map(|checkpoint| checkpoint.to_json());
        let arms = Arms::of(&dir, &plan, &provenance.space, &subject)?;
        let mut rounds = Rounds::new(&dir, asked, rival, other.record.map(|(_, record)| record), record);
        let completion = self.how.carry(&dir, &subject, |executor, events| {
            let mut documents: Vec<_> = registration.iter().flat_map(Registered::files).collect();
            documents.extend(recorded.iter().map(|text| (CHECKPOINT, text.as_bytes())));
            rounds.run(&plan, provenance, arms, executor, &documents, events)
        })?;
        if let Completion::Finished { .. } = &completion {
            subject.write_fingerprint(&dir);
        }
        let (asked, other) = rounds.end(&completion)?;
        let again = self.again(Again::default());
        finish(&dir, &asked, other.as_ref(), completion, Some(&subject), Some(&again), self.how.json)
    }
}

/// Resumes an interrupted gate.
pub(crate) fn resume(
    dir: &Path,
    asked: Asked,
    subject: &Subject,
    settings: Settings,
    opening: &Reopening,
    how: &How,
) -> Result<u8, Exit> {
    let mut rounds = Rounds::resumed(dir, asked, &settings, opening, how.threads)?;
    let arms = Arms::of(dir, &settings.plan, &settings.provenance.space, subject)?;
    let provenance = subject.provenance(settings.provenance.space)?;
    let completion = how.carry(dir, subject, |executor, events| rounds.resume(&provenance, arms, executor, events))?;
    if let Completion::Finished { .. } = &completion {
        subject.write_fingerprint(dir);
    }
    let (asked, other) = rounds.end(&completion)?;
    finish(dir, &asked, other.as_ref(), completion, Some(subject), None, how.json)
}

impl Prepared {
    /// The question. With `unwritten`, the rows of the other policy do not exist yet: the file is written again once they do.
    fn asked(&self, unwritten: bool) -> Asked {
        let against = match &self.other.record {
            _ if unwritten => Some((String::new(), String::new())),
            Some((path, record)) => {
                let full = path.canonicalize().unwrap_or_else(|_| path.clone());
                Some((full.to_string_lossy().into_owned(), record.dataset_sha256.clone()))
            }
            None => None,
        };
        let against = against.map(|(path, dataset_sha256)| AskedAgainst { path, dataset_sha256, margin: self.margin });
        Asked {
            format: Asked::FORMAT,
            requirements: self.requirements.clone(),
            baseline: self.other.baseline.clone(),
            against,
            sampling: self.sampling,
            real: self.record.real.clone(),
        }
    }
}
