//! `robogate monitor reference`: writes baseline, envelope and risk model of a run.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use anyhow::Context;
use clap::Args;
use robogate_analysis::{Analysis, AnalysisOptions, Finding, Population, RiskModel, Source};
use robogate_core::{Domain, Parameter};
use robogate_dictionary::results::only_identifies;
use robogate_dictionary::{Column, Dictionary, DictionaryError, files};
use robogate_gate::{Asked, Metric, RealEvidence, Requirements};
use robogate_monitor::domain::{self, Predictor, PredictorColumn, Risk, RiskTerm, Validated};
use robogate_monitor::{Baseline, Count, ModeCounts, Reference};

use crate::commands::analyze::analyse;
use crate::commands::gate::real_evidence_for;
use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::terminal::{grouped, line, note};
use robogate_session::open_source;

/// An end of a suite's or an import's range counts as validated if an episode came this close to it, as a share of the range.
const NEAR: f64 = 0.02;

/// Write the reference file of a run: baseline, envelope and risk model.
///
/// The file contains the counts of successes (and of failure modes, for episodes of a real robot), the range or the
/// categories of each parameter in the valid episodes, and the risk model with the covariance of its coefficients. For a
/// sample of a space the range is that of the space; for the scenarios of a suite, an end of the range counts as validated if an episode came
/// within 2 % of the range to it.
///
/// A run whose success rate is below the limit of its gate is rejected, because a monitor with this baseline would
/// accept what the gate rejects: use the run of a gate that passed, or --learn-baseline. The limit is the largest one on the
/// success rate in simulation and on the real robot.
#[derive(Debug, Args)]
pub(super) struct ReferenceOf {
    /// Folder of a run, or a dictionary
    run: PathBuf,
    /// Leave the success rate out. The monitor learns it from the first cycles of the robot
    #[arg(long)]
    learn_baseline: bool,
    /// Take the success rate from these trials of the real robot instead of from the run: the file of `robogate transfer
    /// --out`
    #[arg(long, value_name = "FILE", conflicts_with = "learn_baseline")]
    real: Option<PathBuf>,
    /// Take the smallest accepted success rate from these requirements; default: those of the run's gate, otherwise
    /// `default`
    #[arg(long, value_name = "NAME|FILE")]
    requirements: Option<String>,
    /// File to write, - for stdout
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
}

impl ReferenceOf {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let source = open_source(&self.run)?;
        let analysis = analyse(&source, &self.run, &AnalysisOptions::default())?;
        let of_space = analysis.population == Population::OperatingSpace;
        let envelope = envelope(source.dictionary(), of_space).or_broken()?;
        let rate = &analysis.success.rate;
        if rate.n == 0 || envelope.is_empty() {
            let error = anyhow::anyhow!("the run has no valid episode, so nothing was validated");
            return Err(Exit { code: INVALID, error });
        }
        let provenance = source.dictionary().provenance();
        let real = self.real.as_deref().map(|file| real_evidence_for(file, provenance)).transpose()?;
        let population = match &real {
            Some(real) => real.population.clone(),
            None => analysis.population.describe().to_owned(),
        };
        let reference = Reference {
            version: Reference::VERSION,
            robot: analysis.subject.robot.clone(),
            policy: analysis.subject.policy.clone(),
            population,
            dataset_sha256: analysis.subject.dataset_hash.clone(),
            real_trials_sha256: real.as_ref().map(|real| real.trials_sha256.clone()),
            run: source.folder().and_then(|folder| self.place_of(folder)),
            baseline: self.baseline(&analysis, real.as_ref()),
            domain: domain::Domain { envelope, risk: analysis.risk.estimated().map(risk) },
            simulated: is_simulated(&analysis),
            required_success: self.required_success(&source)?,
        };
        // A reference that the monitor would reject is not written.
        reference.check().or_usage()?;
        let text = serde_json::to_string_pretty(&reference).map_err(anyhow::Error::from).or_broken()?;
        if self.out.as_os_str() == "-" {
            line(text);
            return Ok(DONE);
        }
        files::write(&self.out, text + "\n")
            .with_context(|| format!("cannot write {}", self.out.display()))
            .or_broken()?;
        self.report(&analysis, &reference);
        Ok(DONE)
    }

    /// The folder of the run from the folder of the reference. `None` for a reference on stdout, which has no place.
    fn place_of(&self, run: &Path) -> Option<String> {
        if self.out.as_os_str() == "-" {
            return None;
        }
        let parent = self.out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let (run, parent) = (run.canonicalize().ok()?, parent.canonicalize().ok()?);
        let common = run.components().zip(parent.components()).take_while(|(a, b)| a == b).count();
        let up = parent.components().skip(common).map(|_| Component::ParentDir);
        let place: PathBuf = up.chain(run.components().skip(common)).collect();
        let place = if place.as_os_str().is_empty() { PathBuf::from(".") } else { place };
        place.to_str().map(str::to_owned)
    }

    fn report(&self, analysis: &Analysis, reference: &Reference) {
        note(format_args!("{}: {} on {}", self.out.display(), reference.policy, reference.robot));
        if reference.simulated && self.mixes_modes(analysis) {
            note(
                "  no mix of failure modes: that of a simulator differs from that of the robot, so the monitor learns it from the robot",
            );
        }
        match reference.baseline.success {
            Some(Count { count, of }) => {
                let what = match &reference.real_trials_sha256 {
                    Some(sha256) => format!("trials of the real robot (SHA-256 {sha256})"),
                    None => "episodes".to_owned(),
                };
                note(format_args!(
                    "  baseline: {} of {} {what} succeeded; {}",
                    grouped(count),
                    grouped(of),
                    reference.population
                ));
            }
            None if self.learn_baseline => {
                note("  no baseline: the monitor learns the success rate from the first cycles")
            }
            None => note(
                "  no baseline: focused episodes do not estimate the rate of the operating space; the monitor learns it from the first cycles",
            ),
        }
        note(format_args!("  envelope of {} parameters", reference.domain.envelope.len()));
        match &analysis.risk {
            Finding::Estimated(model) => {
                note(format_args!("  risk model of {} parameters", model.scoring.terms.len()));
                if let Finding::CannotBeEstimated { because } = &model.predictor {
                    note(format_args!("  the logistic model predicts, because {because}"));
                }
                model.regression.warnings.iter().for_each(|warning| note(format_args!("  {warning}")));
            }
            Finding::CannotBeEstimated { because } => note(format_args!("  no risk model because {because}")),
        }
    }
}

/// Whether the episodes come from a simulator. An import names its origin.
fn is_simulated(analysis: &Analysis) -> bool {
    let real = ["real", "robot", "hardware"].iter().any(|word| analysis.subject.engine.eq_ignore_ascii_case(word));
    !(real && analysis.provenance.source.is_some())
}

impl ReferenceOf {
    /// The smallest success rate that the gate of this run accepts: with trials of the real robot the limit on its rate, if
    /// there is one, and otherwise the larger limit of simulation and real robot. `None` if its requirements have no limit.
    fn required_success(&self, source: &Source) -> Result<Option<f64>, Exit> {
        let asked = source.folder().map_or(Ok(None), Asked::of)?;
        let requirements = match (&self.requirements, asked) {
            (None, Some(asked)) => asked.requirements,
            (name, _) => {
                Requirements::open(name.as_deref().unwrap_or("default"), &source.dictionary().provenance().task)?
            }
        };
        let limit = |metric: Metric| {
            let whole = requirements
                .requirement
                .iter()
                .filter(|r| r.metric == metric && r.category.is_none() && r.group.is_none() && r.each.is_none());
            whole.filter_map(|r| r.at_least).reduce(f64::max)
        };
        let (simulated, real) = (limit(Metric::Success), limit(Metric::RealSuccess));
        Ok(match (&self.real, real) {
            (Some(_), Some(_)) => real,
            _ => simulated.into_iter().chain(real).reduce(f64::max),
        })
    }

    fn mixes_modes(&self, analysis: &Analysis) -> bool {
        analysis.failure_modes.modes.iter().any(|share| share.failures > 0)
    }

    /// The counts of the run, with the successes of the real trials in place of its own. A focused design has none, because its
    /// rate does not estimate that of the operating space.
    fn baseline(&self, analysis: &Analysis, real: Option<&RealEvidence>) -> Baseline {
        let full = baseline(analysis);
        let success = match real {
            Some(real) => Some(Count { count: real.successes(), of: real.trials() }),
            None => full.success.filter(|_| !self.learn_baseline),
        };
        Baseline { success, failure_modes: full.failure_modes.filter(|_| !is_simulated(analysis)), ..full }
    }
}

fn baseline(analysis: &Analysis) -> Baseline {
    if analysis.population == Population::FocusedDesign {
        return Baseline::default();
    }
    // Episodes that count by sampling weights are as many as independent ones with the same variance.
    let rate = match analysis.success.rate.weighted_as {
        Some(_) => analysis.success.rate.effective_trials(),
        None => analysis.success.rate.trials(),
    };
    let modes: ModeCounts =
        analysis.failure_modes.modes.iter().map(|share| (share.mode.as_str(), share.failures)).collect();
    Baseline {
        success: Some(Count { count: rate.successes(), of: rate.n() }),
        failure_modes: (modes.total() > 0).then_some(modes),
        ..Baseline::default()
    }
}

fn risk(model: &RiskModel) -> Risk {
    let penalties = |parameter: &str| {
        let penalty = model.penalties.iter().find(|penalty| penalty.parameter == parameter)?;
        Some(penalty.levels.iter().map(|level| (level.level.clone(), level.penalty)).collect())
    };
    let scoring = &model.scoring;
    let term = |term: &robogate_analysis::ScoringTerm| RiskTerm {
        parameter: term.parameter.clone(),
        coefficient: term.coefficient,
        log: term.log,
        penalties: penalties(&term.parameter),
    };
    Risk {
        intercept: scoring.intercept,
        terms: scoring.terms.iter().map(term).collect(),
        covariance: scoring.covariance.clone(),
        most_variance: scoring.max_variance,
        predictor: model.predictor.estimated().and_then(|predictor| {
            let column = |column: &robogate_analysis::PredictorColumn| PredictorColumn {
                parameter: column.parameter.clone(),
                category: column.category.clone(),
            };
            Some(Predictor::new(predictor.columns.iter().map(column).collect(), predictor.model.clone()?))
        }),
    }
}

/// The values of each parameter in the valid episodes. `of_space` states that they are a sample of the space, which vouches for its
/// whole range.
fn envelope(dictionary: &Dictionary, of_space: bool) -> Result<BTreeMap<String, Validated>, DictionaryError> {
    let valid = valid(dictionary)?;
    let mut envelope = BTreeMap::new();
    let settings = dictionary.provenance().space.parameters().iter().filter(|p| !only_identifies(&p.name));
    for parameter in settings {
        let found = match dictionary.column(&parameter.name)? {
            Column::Categories { words, codes } => {
                let mut seen: Vec<u32> = kept(codes, &valid).collect();
                seen.sort_unstable();
                seen.dedup();
                let words: Vec<String> =
                    seen.into_iter().filter_map(|code| words.get(code as usize).cloned()).collect();
                (!words.is_empty()).then_some(Validated::Words(words))
            }
            _ => range(parameter, kept(dictionary.numbers(&parameter.name)?, &valid), of_space),
        };
        envelope.extend(found.map(|found| (parameter.name.to_string(), found)));
    }
    Ok(envelope)
}

fn kept<'a, T: 'a>(values: Vec<Option<T>>, valid: &'a [bool]) -> impl Iterator<Item = T> + 'a {
    values.into_iter().zip(valid).filter_map(|(value, valid)| value.filter(|_| *valid))
}

/// The range from the lowest to the highest value, extended to an end of the operating range if a value is close to it, or if the values
/// are a sample of that range.
fn range(parameter: &Parameter, values: impl Iterator<Item = f64>, of_space: bool) -> Option<Validated> {
    let (low, high) = values
        .filter(|x| x.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    if low > high {
        return None;
    }
    let (first, last) = match parameter.domain {
        Domain::Continuous { low, high, .. } => (low, high),
        Domain::Integer { low, high } => (low as f64, high as f64),
        Domain::Categorical { .. } => (low, high),
    };
    let low = if of_space || parameter.domain.to_unit(low) <= NEAR { low.min(first) } else { low };
    let high = if of_space || parameter.domain.to_unit(high) >= 1.0 - NEAR { high.max(last) } else { high };
    Some(Validated::Range([low, high]))
}

/// Marks the valid episodes.
fn valid(dictionary: &Dictionary) -> Result<Vec<bool>, DictionaryError> {
    let Column::Categories { words, codes } = dictionary.column("outcome")? else { return Ok(Vec::new()) };
    let counts = |word: &String| word != "invalid";
    let counts: Vec<bool> = words.iter().map(counts).collect();
    Ok(codes.iter().map(|code| code.and_then(|code| counts.get(code as usize).copied()).unwrap_or(false)).collect())
}
