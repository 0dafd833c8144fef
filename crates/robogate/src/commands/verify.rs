//! `robogate verify`: checks evidence.

use std::path::PathBuf;

use clap::Args;
use robogate_campaign::built_in_suite;
use robogate_dictionary::suite_sha256;
use robogate_gate::Population;
use robogate_gate::evidence::{
    Problem, PublicKey, QuestionBinding, REGISTRATION, Registered, Signed, Verified, verify,
};
use robogate_stats::format::counted;
use serde::Serialize;

use crate::answer::value;
use crate::arguments::ReopeningArguments;
use crate::compliance;
use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::terminal::{bold, foreign, grouped, indented, line, note, percent};
use robogate_session::{Rerun, rerun};

/// Verify a folder of evidence: every file, the signatures, and the verdict recomputed from the rows.
///
/// Exit codes: 0 if the evidence is valid, for any verdict in it; 4 if it is not.
#[derive(Debug, Args)]
pub(crate) struct Verify {
    /// Folder of the evidence
    evidence: PathBuf,
    /// Require a signature by this public key
    #[arg(long, value_name = "PUBLIC")]
    key: Option<PathBuf>,
    /// Reject unsigned evidence, also without --key
    #[arg(long)]
    require_signed: bool,
    /// Reject evidence of a run that was not registered before its first episode; with --key, by that key
    #[arg(long)]
    require_registered: bool,
    /// Reject evidence of another campaign seed. Choose the seed before the run, so that its author cannot
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Run K rows again, chosen at random, and compare outcome, measures and trajectory; also check that the rows are
    /// exactly those of the plan
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u64).range(1..))]
    rerun: Option<u64>,
    #[command(flatten)]
    opening: ReopeningArguments,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

/// The document of `--json`.
#[derive(Debug, Serialize)]
struct Document<'a> {
    format: u32,
    holds: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    evidence: Option<&'a Verified>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rerun: Option<&'a Rerun>,
    problems: &'a [Problem],
}

impl Verify {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let key = self.key.as_deref().map(PublicKey::read).transpose().or_usage()?;
        if !self.evidence.is_dir() {
            let error = anyhow::anyhow!(
                "{} is not a folder. Expected a folder written by `robogate evidence RUN OUT`",
                self.evidence.display()
            );
            return Err(error).or_usage();
        }
        let mut checked = verify(&self.evidence, key.as_ref()).and_then(|verified| self.accept(verified, key.as_ref()));
        if let Ok(verified) = checked {
            let (problems, compared) = compliance::check(&self.evidence).or_broken()?;
            if !compared {
                note(
                    "another version of robogate wrote the summary and the compliance pack; only their hashes were checked",
                );
            }
            checked = if problems.is_empty() { Ok(verified) } else { Err(problems) };
        }
        let mut repeated = None;
        if let (Some(k), Ok(_)) = (self.rerun, &checked) {
            match rerun(&self.evidence, k, &self.opening.choice())? {
                Ok(rerun) => repeated = Some(rerun),
                Err(problem) => checked = Err(vec![problem]),
            }
        }
        let problems = checked.as_ref().err().map_or(&[][..], Vec::as_slice);
        if self.json {
            let document = Document {
                format: 1,
                holds: checked.is_ok(),
                evidence: checked.as_ref().ok(),
                rerun: repeated.as_ref(),
                problems,
            };
            line(serde_json::to_string_pretty(&document).or_broken()?);
        } else {
            match &checked {
                Ok(verified) => {
                    tell(verified);
                    repeated.iter().for_each(tell_rerun);
                    line(bold(foreign(trust(verified))));
                }
                Err(_) => {
                    line(bold("verification failed"));
                    problems.iter().for_each(|problem| {
                        line(format_args!("  {}: {}", foreign(&problem.file), indented(&problem.reason)))
                    });
                    let why = problems.first().map_or("verification failed", |problem| &problem.file);
                    line(bold(format_args!("Do not trust this evidence, because {} does not verify.", foreign(why))));
                }
            }
        }
        Ok(if checked.is_ok() { DONE } else { INVALID })
    }
}

impl Verify {
    /// Applies what the user requires in addition to consistency.
    fn accept(&self, verified: Verified, key: Option<&PublicKey>) -> Result<Verified, Vec<Problem>> {
        let mut problems = Vec::new();
        if self.require_signed && verified.signed == Signed::Unsigned {
            problems.push(Problem::new("manifest.json", "unsigned, but --require-signed is given"));
        }
        match (&verified.registration, key) {
            (None, _) if self.require_registered => {
                let reason = "missing: the run was not registered before its first episode";
                problems.push(Problem::new(REGISTRATION, reason));
            }
            (Some(registered), Some(key)) if registered.keyid != key.id() => {
                let reason = format!("registered by key {}. Expected the given key {}", registered.keyid, key.id());
                problems.push(Problem::new(REGISTRATION, reason));
            }
            _ => {}
        }
        if let Some(seed) = self.seed.filter(|seed| *seed != verified.seed) {
            let reason = format!("the campaign has the seed {}. Expected {seed}", verified.seed);
            problems.push(Problem::new("dictionary.parquet", reason));
        }
        if problems.is_empty() { Ok(verified) } else { Err(problems) }
    }
}

fn tell_rerun(rerun: &Rerun) {
    let rows = rerun.rows.len() as u64;
    let same = match rows - rerun.identical {
        0 => "with the same outcome, measures and trajectory".to_owned(),
        others if rerun.other_maths => format!(
            "with the same outcome; {} have other last bits, because the mathematical functions of the C library differ from those \
             of the run",
            grouped(others)
        ),
        others => format!("with the same outcome; {} are invalid for the same reason in other words", grouped(others)),
    };
    if rows == rerun.of {
        line(format_args!("  rerun: all {} ran again, {same}", counted(rows, "row")));
    } else {
        line(format_args!(
            "  rerun: {} of {} rows, chosen at random, ran again, {same}; {} or more invented rows would have been found with \
             95 % probability",
            grouped(rows),
            grouped(rerun.of),
            percent(rerun.detects())
        ));
    }
    if rerun.lost > 0 {
        line(format_args!(
            "  rerun: {} chosen had been lost to a server that was unavailable, and cannot be repeated",
            counted(rerun.lost, "row")
        ));
    }
}

/// The first line: the verdict, with all that limits its meaning.
fn headline(verified: &Verified) -> String {
    let limits = match &verified.question {
        QuestionBinding::AsAsked => String::new(),
        other => format!(" ({other})"),
    };
    format!("verification passed: verdict {}{limits}", verified.verdict)
}

/// The last line: whether to trust the evidence, and why.
fn trust(verified: &Verified) -> String {
    let verdict = verified.verdict;
    let not_yet = |why: String| format!("Do not trust this evidence yet, because {why}.");
    match &verified.signed {
        Signed::Unsigned => not_yet("it is unsigned: anybody could have made it".to_owned()),
        Signed::ByUnknown { keyid } => not_yet(format!(
            "you did not say whom to trust: compare the key {keyid} with that of its author, and give it with --key"
        )),
        Signed::ByTrusted { .. } if verified.question != QuestionBinding::AsAsked => {
            not_yet("its question is not the one that the run was asked".to_owned())
        }
        Signed::ByTrusted { .. } if verified.registration.is_none() => format!(
            "Trust the verdict {verdict} as far as you trust its signer, because it may be the best of several attempts: the run was \
             not registered."
        ),
        Signed::ByTrusted { .. } if verified.registration.as_ref().is_some_and(|of| of.number > 1) => format!(
            "Trust the verdict {verdict} as far as you trust its signer, because earlier registrations of the key may be attempts at the \
             same question: ask for their evidence."
        ),
        Signed::ByTrusted { .. } => format!(
            "Trust the verdict {verdict}, because the key that you gave signed it, the run was registered before its first episode, and \
             the verdict follows from the rows."
        ),
    }
}

/// What was asked: the scenarios, the limits and the figures. A verdict without them says nothing.
fn asked(verified: &Verified) {
    line(format_args!("  judged on {}{}", foreign(&verified.population), known(&verified.population)));
    for of in &verified.requirements {
        let figure =
            of.figure.observed.map_or_else(|| "no figure".to_owned(), |found| value(of.requirement.metric, found));
        line(format_args!(
            "  {} {} {}: {figure}, {}",
            foreign(&of.id),
            of.bound.sense,
            value(of.requirement.metric, of.bound.limit),
            of.status.as_str()
        ));
    }
    verified.remarks.iter().for_each(|remark| line(format_args!("  {}", foreign(remark))));
}

/// Whether a suite with the name of a built-in one is another one.
fn known(population: &Population) -> &'static str {
    let Population::Suite { name, sha256, .. } = population else { return "" };
    let own = name.split(' ').next().and_then(built_in_suite).and_then(Result::ok);
    match own {
        Some(own) if suite_sha256(&own) != *sha256 => ", which is NOT the built-in suite of this name",
        _ => "",
    }
}

fn tell(verified: &Verified) {
    let Verified { because, counts, policy, robot, files, signed, .. } = verified;
    line(bold(foreign(headline(verified))));
    line(format_args!("  {}", foreign(because)));
    asked(verified);
    line(format_args!(
        "  {} of {} on {}, {} of them invalid; verdict recomputed from the rows",
        counted(counts.episodes, "episode"),
        foreign(policy),
        foreign(robot),
        grouped(counts.invalid)
    ));
    line(format_args!("  {files} files, all as listed in the manifest"));
    line(format_args!("  policy: {}", foreign(&verified.policy_binding)));
    let unknown = if verified.environment.simulator_build_known {
        ""
    } else {
        "; the build of the simulator is not bound: as declared by the server"
    };
    line(format_args!("  environment: SHA-256 {}{unknown}", verified.environment.sha256));
    line(match &verified.registration {
        None => "  not registered before the run: it may be the best of several attempts".to_owned(),
        Some(Registered { number: 1, keyid }) => {
            format!("  registered before its first episode, as the first of key {keyid}")
        }
        Some(Registered { number, keyid }) => format!(
            "  registered before its first episode, as number {number} of key {keyid}\nHint: request the evidence of \
             {}: earlier attempts may be among them",
            if *number == 2 { "registration 1".to_owned() } else { format!("registrations 1 to {}", number - 1) }
        ),
    });
    line(match signed {
        Signed::Unsigned => {
            "  UNSIGNED: the origin is unknown; anyone with write access to the folder could have created it".to_owned()
        }
        Signed::ByUnknown { keyid } => format!(
            "  signed by key {keyid}, which was not given\nHint: pass the public key of the expected signer with \
             --key"
        ),
        Signed::ByTrusted { keyid } => format!("  signed by the expected key {keyid}"),
    });
}
