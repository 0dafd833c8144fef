//! A ranking by a contest: the policies run round by round.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, anyhow, bail};
use robogate_campaign::{Event, Plan};
use robogate_core::Suite;
use robogate_dictionary::files;
use robogate_gate::{Ranking, RankingDesign, RankingOutcome, Record};
use robogate_stats::contest::{Dropped, Elimination};
use robogate_stats::format::percent_or_dash;
use serde_json::json;

use super::show::show;
use super::{ANSWER, Rank};
use crate::commands::run::{free_folder, introduce};
use crate::exit::{DONE, Exit, INTERRUPTED, INVALID, OrExit};
use crate::place::folder_name;
use crate::terminal::{bold, dim, grouped, line, note, percent};
use robogate_session::text::quoted;
use robogate_session::{
    Contest, ContestEnd, Contestant, PolicyChoice, PolicyLocation, SAMPLED_SCENARIOS, Subject, named_suite,
    run_controls, with_plan,
};

/// True rates of the best policy and of the others for which a plan is printed.
const EXAMPLES: [[f64; 2]; 4] = [[0.9, 0.6], [0.9, 0.8], [0.9, 0.85], [0.9, 0.9]];
/// Simulated contests for each of them, and the part of the scenarios that decide all policies alike.
const SIMULATED: u64 = 400;
const SHARED: f64 = 0.5;

impl Rank {
    /// Runs the policies, and prints the ranking.
    pub(super) fn contest(&self) -> Result<u8, Exit> {
        if self.html.is_some() || !self.map.is_empty() || !self.groups.columns.is_empty() {
            return Err(anyhow!("--html, --map and --groups apply to finished results\nHint: leave them out"))
                .or_usage();
        }
        if self.how.goes_on {
            return Err(anyhow!("--continue has no effect: first failures do not stop a contest\nHint: leave it out"))
                .or_usage();
        }
        if self.plan && self.out.is_some() {
            return Err(anyhow!("--plan writes nothing\nHint: leave out --out, or --plan")).or_usage();
        }
        if self.policies.len() < 2 {
            return Err(anyhow!("one policy has no rank\nHint: give two or more policies")).or_usage();
        }
        self.check_profiles()?;
        let subjects = self.policies.iter().map(|policy| self.subject(policy)).collect::<Result<Vec<_>, Exit>>()?;
        let task = subjects[0].task();
        if self.outcome() == RankingOutcome::Stage && task.stages.is_empty() {
            return Err(anyhow!(
                "--by stage: the task {} declares no stages\nHint: a task of your own declares `[[stage]]` in its file, or `stages` and \
                 a measure `stages`; or leave out --by",
                task.name
            ))
            .or_usage();
        }
        let suite = self.suite_of(&subjects[0])?;
        let plan = Plan::of_suite(suite.clone(), u64::from(self.rounds), self.seed);
        plan.check(suite.space()).or_usage()?;
        let names = self.names_of(&subjects)?;
        let dir =
            self.out.clone().unwrap_or_else(|| free_folder(&format!("rank-{}-{}", subjects[0].label(), self.seed)));
        let contestants = subjects
            .into_iter()
            .zip(names)
            .map(|(subject, name)| Contestant { folder: dir.join(folder_name(&name)), name, subject })
            .collect();
        let (folder, guarantee, by) = (dir.clone(), self.guarantee(), self.outcome());
        let contest = Contest { folder, contestants, plan, by, guarantee, error: self.error };
        if self.plan {
            return self.print_plan(&contest.elimination()?, suite.cases().len() as u64);
        }
        let scenarios = self.check(&contest, &suite)?;
        introduce(&contest.contestants[0].subject.provenance(suite.space().clone())?, self.seed);
        note(format_args!(
            "{} policies, {} scenarios, at most {} rounds, into {}",
            contest.contestants.len(),
            suite.cases().len(),
            self.rounds,
            dir.display()
        ));
        self.run(&contest, &dir, scenarios)
    }

    fn run(&self, contest: &Contest, dir: &Path, scenarios: String) -> Result<u8, Exit> {
        let mut events = |event: &Event| {
            if let Event::Warning { message, .. } = event {
                crate::terminal::warning(message);
            }
        };
        let mut told = |round: u64, so_far: &Elimination, dropped: &[Dropped]| tell(contest, round, so_far, dropped);
        let end = self.how.with_workers(|workers| Ok(contest.run(workers, &mut events, &mut told)?))?;
        let (elimination, invalid) = match end {
            ContestEnd::Finished { elimination, invalid } => (elimination, invalid),
            ContestEnd::Interrupted { name, done } => {
                note(format_args!("stopped: {name} has {} recorded episodes", grouped(done)));
                note(format_args!("next: the same command with --out {}", quoted(dir)));
                return Ok(INTERRUPTED);
            }
        };
        let design = RankingDesign::Rounds {
            scenarios: contest.plan.suite.as_ref().map_or(0, |suite| suite.scenarios()),
            rounds: elimination.looks(),
            most_rounds: u64::from(self.rounds),
        };
        let policies: Vec<(String, String, u64)> = contest
            .contestants
            .iter()
            .zip(invalid)
            .map(|(of, invalid)| (of.name.clone(), of.folder.display().to_string(), invalid))
            .collect();
        let question = (self.guarantee(), self.error, self.outcome());
        let ranking = Ranking::of_rounds(scenarios, design, question, &policies, &elimination);
        let answer = dir.join(ANSWER);
        files::write(&answer, ranking.to_json())
            .with_context(|| format!("cannot write {}", answer.display()))
            .or_broken()?;
        let code = show(&ranking, self.how.json)?;
        note(format_args!("files: {}", answer.display()));
        Ok(code)
    }

    /// Rejects a profile of no policy, and a second one of a policy.
    fn check_profiles(&self) -> Result<(), Exit> {
        for (at, (policy, profile)) in self.profile.iter().enumerate() {
            let wrong = if !self.policies.contains(policy) {
                "is not one of the policies"
            } else if self.profile.iter().take(at).any(|(earlier, _)| earlier == policy) {
                "has two profiles"
            } else {
                continue;
            };
            return Err(anyhow!(
                "--profile {policy}={profile}: {policy} {wrong}\nHint: give one profile for each policy, with the policy as given"
            ))
            .or_usage();
        }
        Ok(())
    }

    fn subject(&self, policy: &str) -> Result<Subject, Exit> {
        let profile = self.profile.iter().find(|(name, _)| name == policy).map(|(_, profile)| profile.as_str());
        let choice = PolicyChoice::of(policy, profile);
        let location = PolicyLocation { at: None, access: self.access.choice() };
        let suite = self.suite.as_deref().map(named_suite).transpose()?;
        let environment = self.environment.choice().with_policy(&choice)?.environment_of(suite.as_ref())?;
        let subject = Subject::new(environment, choice.source_at(&location)?)?;
        Ok(subject.with_latency(&self.latency.choice())?)
    }

    /// The suite of the arguments, or that of the task, or new points of the environment's space in each round.
    fn suite_of(&self, subject: &Subject) -> Result<Suite, Exit> {
        let named = |name: &str| {
            let suite = named_suite(name)?;
            self.latency.choice().check_suite(suite.space()).or_usage()?;
            Ok::<_, Exit>(suite)
        };
        let suite = match (&self.suite, &self.space, subject.own_suite()) {
            (Some(name), _, _) => named(name)?,
            (None, None, Some(own)) => named(own)?,
            (None, space, _) => {
                let space = subject.space(space.as_deref()).or_usage()?;
                Suite::fresh(&self.latency.choice().added_to(space, subject.task()).or_usage()?, SAMPLED_SCENARIOS)
                    .map_err(anyhow::Error::from)
                    .or_usage()?
            }
        };
        Ok(suite)
    }

    /// Unique names of the policies.
    fn names_of(&self, subjects: &[Subject]) -> Result<Vec<String>, Exit> {
        let names = if self.names.is_empty() {
            let mut seen: BTreeMap<&str, u32> = BTreeMap::new();
            let own = subjects.iter().map(|subject| {
                let count = seen.entry(subject.policy_name()).or_insert(0);
                *count += 1;
                if *count > 1 { format!("{}-{count}", subject.policy_name()) } else { subject.policy_name().to_owned() }
            });
            own.collect()
        } else {
            self.names.clone()
        };
        names.iter().try_for_each(|name| check_name(name)).or_usage()?;
        let mut folders: Vec<String> = names.iter().map(|name| folder_name(name)).collect();
        folders.sort();
        folders.dedup();
        if names.len() != subjects.len() || folders.len() != names.len() {
            return Err(anyhow!(
                "--names: {} different names for {} policies\nHint: give one name for each policy",
                folders.len(),
                subjects.len()
            ))
            .or_usage();
        }
        Ok(names)
    }

    /// Runs the controls of external policies. Returns the scenarios in words.
    fn check(&self, contest: &Contest, suite: &Suite) -> Result<String, Exit> {
        let mut scenarios = String::new();
        for Contestant { name, subject, .. } in &contest.contestants {
            subject.check_suite(suite).or_usage()?;
            let planned = with_plan(&subject.provenance(suite.space().clone())?, &contest.plan)?;
            let mut record = Record::begun(&planned)?;
            scenarios = record.population.to_string();
            record.controls = run_controls(subject, suite, self.controls, self.seed)?;
            robogate_gate::check_repeats(&[&record])?;
            if let Some(why) = record.controls.as_ref().and_then(|controls| controls.failure()) {
                let error = anyhow!("{name}: {why}\nHint: correct its profile, or leave the policy out");
                return Err(Exit { code: INVALID, error });
            }
        }
        Ok(scenarios)
    }

    /// Prints how such a contest ends for a few true rates.
    fn print_plan(&self, elimination: &Elimination, scenarios: u64) -> Result<u8, Exit> {
        let n = self.policies.len();
        let expected = EXAMPLES.map(|[best, others]| {
            let mut rates = vec![others; n];
            rates[0] = best;
            elimination.expected(&rates, SHARED, SIMULATED, self.seed).or_usage().map(|found| ([best, others], found))
        });
        let expected = expected.into_iter().collect::<Result<Vec<_>, Exit>>()?;
        if self.how.json {
            let rows: Vec<_> = expected
                .iter()
                .map(|([best, others], found)| {
                    json!({ "best": best, "others": others, "best_alone": found.best_alone,
                        "best_dropped": found.best_dropped, "episodes": found.trials })
                })
                .collect();
            let document =
                json!({ "format": 1, "policies": n, "scenarios": scenarios, "rounds": self.rounds, "at": rows });
            line(serde_json::to_string_pretty(&document).or_broken()?);
            return Ok(DONE);
        }
        line(bold(format_args!("{n} policies, at most {} rounds of {scenarios} scenarios", self.rounds)));
        line(dim(format_args!("  {:<26} {:>10} {:>13} {:>9}", "true rates", "best found", "best dropped", "episodes")));
        for ([best, others], found) in expected {
            let alone = (best > others).then_some(found.best_alone);
            line(format_args!(
                "  {:<26} {:>10} {:>13} {:>9}",
                format!("{} and {} of {}", percent(best), n - 1, percent(others)),
                percent_or_dash(alone),
                percent(found.best_dropped),
                grouped(found.trials.round() as u64)
            ));
        }
        Ok(DONE)
    }
}

/// Rejects a name that cannot be that of a folder beside the files of a contest.
fn check_name(name: &str) -> anyhow::Result<()> {
    let is_path = name.is_empty() || name == "." || name == ".." || name.contains(['/', '\0']);
    let is_taken = [ANSWER, Contest::QUESTION].iter().any(|file| file.eq_ignore_ascii_case(name));
    if is_path || is_taken {
        bail!(
            "{name:?} cannot be the name of a policy, because its folder has this name\nHint: give other names with --names"
        );
    }
    Ok(())
}

/// Prints the policies that left in a round.
fn tell(contest: &Contest, round: u64, so_far: &Elimination, dropped: &[Dropped]) {
    let name = |at: usize| contest.contestants.get(at).map_or("", |of| of.name.as_str());
    let left = so_far.best_set();
    let rates: Vec<String> =
        left.iter().map(|at| format!("{} {}", name(*at), percent_or_dash(so_far.trials(*at).rate()))).collect();
    note(format_args!("round {round}: {}", rates.join(", ")));
    for out in dropped {
        let rate = percent_or_dash(so_far.trials(out.policy).rate());
        note(format_args!("  {} leaves with {rate}: {} is better", name(out.policy), name(out.by)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_policies_are_folders() {
        for name in ["", ".", "..", "a/b", "a\0b", "/", "ranking.json", "question.json", "Question.JSON"] {
            assert!(check_name(name).is_err(), "{name:?}");
        }
        for name in ["a", "a-2", "v1.2", "net.onnx", "my policy", "question"] {
            assert!(check_name(name).is_ok(), "{name:?}");
        }
    }
}
