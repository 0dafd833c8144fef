//! `robogate requalify`: what an upgrade changes.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use anyhow::anyhow;
use clap::{ArgGroup, Args};
use robogate_gate::{Answer, Requalification};
use robogate_report::{RequalificationPage, answer_label, requalification_html};
use robogate_session::{PolicyChoice, RecordedRun, Reopening, Requalified, Requalifying, Simulators, Upgrade};
use robogate_stats::format::{count, percent, significant};
use serde::Serialize;

use super::compare::write;
use crate::arguments::{AccessArguments, TrustArguments, seconds};
use crate::exit::{DONE, Exit, FAIL, INCONCLUSIVE, INVALID, OrExit};
use crate::terminal::{bold, dim, headline, line, note, wrapped};

/// Find out what an upgrade changes: run the scenarios of a run again, before and after it.
///
/// The upgrade is another version of the environment or of packages in its Python, or another policy, robot or engine. The second Python is
/// made in the cache folder; the first is not changed. The answer is the first of these that is certain: success is equal but its meaning
/// changed (contacts, moving parts, duration, drift); initial states changed; success changed; it cannot run; the
/// episodes are not pairs; the solver does worse. Otherwise there is no relevant change, with a bound.
///
/// Exit codes: 0 no relevant change, 1 changed or it cannot run, 3 inconclusive, 4 the pairing is not valid.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("upgrade").required(true).args(["env", "env_with", "policy", "robot", "engine"])))]
pub(crate) struct Requalify {
    /// Folder of the run
    run: PathBuf,
    /// Use another version of the environment: its file with the class or function, or another name
    #[arg(long, value_name = "FILE.py:NAME")]
    env: Option<String>,
    /// Upgrade packages of the environment's Python: PACKAGE==VERSION as pip installs it, or a wheel or folder
    #[arg(long, value_name = "PACKAGE==VERSION", num_args = 1..)]
    env_with: Vec<String>,
    /// Use another policy: the address of a server, a file, or a policy of the environment
    #[arg(long, value_name = "URL|FILE|NAME")]
    policy: Option<String>,
    /// Choose the observation and action mapping of that policy
    #[arg(long, value_name = "NAME|FILE", requires = "policy")]
    profile: Option<String>,
    /// Map the environment to the profile with this TOML file
    #[arg(long, value_name = "FILE", requires = "profile")]
    map: Option<PathBuf>,
    /// Use another robot in the built-in cell
    #[arg(long, value_name = "ROBOT")]
    robot: Option<String>,
    /// Use another engine in the built-in cell
    #[arg(long, value_name = "ENGINE")]
    engine: Option<String>,
    /// Find the first version between both that changes something, by bisection
    #[arg(long, requires = "env_with")]
    bisect: bool,
    /// Name the versions for --bisect, oldest first; default: those that pip lists
    #[arg(long, value_name = "A,B,...", value_delimiter = ',', requires = "bisect")]
    versions: Vec<String>,
    /// Set the largest number of pairs
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pairs: u32,
    /// Run all pairs, also after the answer is certain
    #[arg(long)]
    all: bool,
    /// Set the change of the success rate that is not relevant, in (0, 1)
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    margin: f64,
    /// Set how many episodes run at once; default: one on each processor
    #[arg(long, value_name = "N", value_parser = crate::number::threads)]
    threads: Option<NonZeroUsize>,
    /// Choose the Python of the environment before the upgrade; default: that of the run
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// Set the timeout for a step of the environment, in seconds (0.001 to 86400)
    #[arg(long = "simulator-timeout", value_name = "SECONDS", default_value_t = 30.0, value_parser = seconds)]
    timeout_s: f64,
    #[command(flatten)]
    trust: TrustArguments,
    #[command(flatten)]
    access: AccessArguments,
    /// Write a self-contained HTML page to this file
    #[arg(long = "out", value_name = "FILE")]
    html: Option<PathBuf>,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

/// A version of a bisection with its answer.
#[derive(Debug, Clone, Serialize)]
struct Tried {
    version: String,
    answer: Answer,
    headline: String,
}

/// The document of `--json`.
#[derive(Debug, Serialize)]
struct Document<'a> {
    format: u32,
    #[serde(flatten)]
    found: &'a Requalified,
    /// The versions that were tried between both, in their order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    tried: Vec<Tried>,
    /// The first version that changes something, if it was sought.
    #[serde(skip_serializing_if = "Option::is_none")]
    first_changed: Option<String>,
}

impl Requalify {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if !(self.margin > 0.0 && self.margin < 1.0) {
            return Err(anyhow!("--margin {}: expected a share between 0 and 1", self.margin)).or_usage();
        }
        let how = Requalifying {
            pairs: self.pairs as usize,
            all: self.all,
            margin: self.margin,
            error: 0.05,
            threads: self.threads,
        };
        let between = self.bisected()?;
        let opening = Reopening {
            trust: self.trust.choice(),
            access: self.access.choice(),
            simulators: Simulators { python: self.python.clone(), timeout_s: self.timeout_s, ..Simulators::default() },
            ..Reopening::none()
        };
        let mut run = RecordedRun::open(&self.run, opening, &how)?;
        let found = run.requalify(&self.upgrade(), &how, &mut progress)?;
        let (tried, first_changed) = match between {
            Some((package, to)) if has_changed(found.result.answer) => {
                self.bisect(&mut run, &how, package, to, &found)?
            }
            _ => (Vec::new(), None),
        };
        if let Some(file) = &self.html {
            write(file, &page(&found, &tried))?;
        }
        if self.json {
            let document = Document { format: 1, found: &found, tried, first_changed };
            line(serde_json::to_string_pretty(&document).or_broken()?);
        } else {
            print(&found, &tried, first_changed.as_deref());
        }
        Ok(match found.result.answer {
            Answer::NoRelevantChange => DONE,
            Answer::Inconclusive => INCONCLUSIVE,
            Answer::NotPaired => INVALID,
            _ => FAIL,
        })
    }

    fn upgrade(&self) -> Upgrade {
        match (&self.policy, &self.robot, &self.engine, &self.env) {
            (Some(policy), ..) => {
                let choice = PolicyChoice::of(policy, self.profile.as_deref());
                Upgrade::Policy(Box::new(PolicyChoice { map: self.map.clone(), ..choice }))
            }
            (_, Some(robot), ..) => Upgrade::Robot(robot.clone()),
            (_, _, Some(engine), _) => Upgrade::Engine(engine.clone()),
            (.., Some(env)) => Upgrade::Environment(env.clone()),
            _ => Upgrade::Packages(self.env_with.clone()),
        }
    }

    /// The package and the version of a bisection.
    fn bisected(&self) -> Result<Option<(&str, &str)>, Exit> {
        match self.env_with.as_slice() {
            _ if !self.bisect => Ok(None),
            [one] => one
                .split_once("==")
                .map(Some)
                .ok_or_else(|| anyhow!("--bisect needs PACKAGE==VERSION, not {one}"))
                .or_usage(),
            _ => Err(anyhow!("--bisect needs one package\nHint: name one with --env-with PACKAGE==VERSION")).or_usage(),
        }
    }

    /// Halves the versions until one that changes something follows one that does not.
    fn bisect(
        &self,
        run: &mut RecordedRun,
        how: &Requalifying,
        package: &str,
        to: &str,
        last: &Requalified,
    ) -> Result<(Vec<Tried>, Option<String>), Exit> {
        let listed = match (self.versions.is_empty(), run.packages()) {
            (true, Some(packages)) => packages.versions(package, to)?,
            _ => self.versions.clone(),
        };
        let versions: Vec<String> = listed.into_iter().filter(|version| version != to).chain([to.to_owned()]).collect();
        let (mut low, mut high) = (0, versions.len() - 1);
        let entry = |version: &str, found: &Requalified| Tried {
            version: version.to_owned(),
            answer: found.result.answer,
            headline: found.result.headline.clone(),
        };
        let mut tried = vec![(high, entry(to, last))];
        while low < high {
            let middle = low.midpoint(high);
            let version = &versions[middle];
            note(format_args!("trying {package} {version}"));
            let found = run.requalify(&Upgrade::Packages(vec![format!("{package}=={version}")]), how, &mut progress)?;
            tried.push((middle, entry(version, &found)));
            if has_changed(found.result.answer) { high = middle } else { low = middle + 1 }
        }
        tried.sort_by_key(|(at, _)| *at);
        Ok((tried.into_iter().map(|(_, tried)| tried).collect(), versions.get(high).cloned()))
    }
}

fn has_changed(answer: Answer) -> bool {
    !matches!(answer, Answer::NoRelevantChange | Answer::Inconclusive)
}

fn progress(so_far: &Requalification) {
    let [ran, planned] = so_far.pairs;
    note(format_args!("{} of {} pairs: {}", count(ran), count(planned), answer_label(so_far.answer)));
}

fn title(found: &Requalified) -> String {
    format!("{}: {} on {}", found.upgrade, found.policy, found.task)
}

fn subtitle(found: &Requalified) -> String {
    let [before, after] = &found.engines;
    let [same, of] = found.repeats_run;
    let repeated = if of > 0 {
        format!("; {same} of {of} episodes before repeat those of the run bit for bit")
    } else {
        String::new()
    };
    format!("{before} before, {after} after{repeated}")
}

/// The packages with another version, each with both versions.
fn packages(found: &Requalified) -> Vec<[String; 3]> {
    let version = |version: &Option<String>| version.clone().unwrap_or_else(|| "none".to_owned());
    found.packages.iter().map(|of| [of.package.clone(), version(&of.before), version(&of.after)]).collect()
}

fn page(found: &Requalified, tried: &[Tried]) -> String {
    let packages = packages(found);
    let versions: Vec<[String; 2]> = tried.iter().map(|of| [of.version.clone(), of.headline.clone()]).collect();
    requalification_html(&RequalificationPage {
        title: &title(found),
        subtitle: &subtitle(found),
        packages: &packages,
        versions: &versions,
        result: &found.result,
    })
}

fn print(found: &Requalified, tried: &[Tried], first_changed: Option<&str>) {
    let result = &found.result;
    line(bold(title(found)));
    wrapped(&subtitle(found));
    for [package, before, after] in packages(found) {
        line(dim(format_args!("  {package} {before} -> {after}")));
    }
    line("");
    headline(&result.headline);
    for (at, change) in result.changes.iter().enumerate() {
        if at > 0 {
            wrapped(&change.sentence);
        }
        change.details.iter().for_each(|detail| wrapped(&format!("- {detail}")));
    }
    line("");
    let success = &result.success;
    let [ran, planned] = result.pairs;
    wrapped(&format!(
        "{} of {} pairs ran, {} of them equal bit for bit. Success: {} before, {} after, of {} valid.",
        count(ran),
        count(planned),
        count(result.identical),
        count(success.successes[0]),
        count(success.successes[1]),
        count(success.pairs)
    ));
    let mut visible: Vec<usize> = result.explanation.divergence.iter().filter_map(|of| of.visible).collect();
    visible.sort_unstable();
    if let Some(median) = visible.get(visible.len() / 2) {
        let body = result.explanation.divergence.iter().find_map(|of| of.body.clone()).unwrap_or_default();
        wrapped(&format!(
            "Motion differs by more than 1 mm in {} of {} episodes, at the median from control period {median} on (body {body} in the first of them).",
            visible.len(),
            result.explanation.divergence.len()
        ));
    }
    for of in &result.explanation.signals {
        let [before, after] = of.mean.map(|x| significant(x, 3));
        line(dim(format_args!("  {:<22} {before:>9} before, {after:>9} after (mean)", of.name.replace('_', " "))));
    }
    if result.answer == Answer::NoRelevantChange || result.answer == Answer::Inconclusive {
        wrapped(&format!(
            "Not excluded: a net change of any property in up to {} of the episodes.",
            percent(result.bound)
        ));
    }
    if let Some(first) = first_changed {
        line("");
        line(bold(format_args!("The first version that changes something is {first}.")));
        tried.iter().for_each(|of| wrapped(&format!("{}: {}", of.version, of.headline)));
    }
}
