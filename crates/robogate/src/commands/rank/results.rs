//! A ranking of finished results.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use robogate_analysis::{Comparison, ComparisonOptions, Source};
use robogate_core::budget::Budget;
use robogate_dictionary::read_text;
use robogate_dictionary::results::{Mapping, policies};
use robogate_gate::{DroppedPolicy, RankedPair, RankedPolicy, Ranking, RankingDesign};
use robogate_report::comparison_html_with;

use super::show::show;
use super::{ANSWER, Rank};
use crate::commands::compare;
use crate::commands::import::open_mapping;
use crate::exit::{Exit, OrExit};
use robogate_session::open_source;

/// The arguments that finished results use, and those that the answer of a finished contest uses.
const OF_RESULTS: [&str; 10] =
    ["policies", "names", "guarantee", "error", "columns", "map", "html", "json", "quiet", "verbose"];
const OF_ANSWER: [&str; 4] = ["policies", "json", "quiet", "verbose"];

impl Rank {
    /// Ranks finished results by one test of all pairs.
    pub(super) fn results(&self) -> Result<u8, Exit> {
        if let [one] = &*self.policies
            && let Some(ranking) = finished(Path::new(one))?
        {
            self.check_used(&OF_ANSWER, "the answer of a finished contest")?;
            return show(&ranking, self.how.json);
        }
        self.check_used(&OF_RESULTS, "finished results")?;
        if !(self.error > 0.0 && self.error < 0.5) {
            return Err(anyhow!("--error {}: expected a number above 0 and below 0.5", self.error)).or_usage();
        }
        let mapping = open_mapping(None, &self.map)?;
        let mut sources = Vec::new();
        for path in &self.policies {
            sources.extend(open(Path::new(path), &mapping)?);
        }
        if sources.len() < 2 {
            return Err(anyhow!(
                "the results have one policy, which has no rank\nHint: give results of two or more, or name the column of the \
                 policy with --map policy=COLUMN"
            ))
            .or_usage();
        }
        let options = ComparisonOptions {
            names: self.names.clone(),
            groups: self.groups.columns.clone(),
            ..ComparisonOptions::default()
        };
        let comparison = Comparison::of(&sources, &options).map_err(compare::exit)?;
        if let Some(excluded) = comparison.datasets.iter().find(|of| of.excluded_because.is_some()) {
            let why = excluded.excluded_because.as_deref().unwrap_or_default();
            return Err(anyhow!("{}: {why}\nHint: leave it out", excluded.name)).or_usage();
        }
        if let Some(file) = &self.html {
            compare::write(file, &comparison_html_with(&comparison, None))?;
        }
        show(&self.ranking(&comparison), self.how.json)
    }

    /// Rejects options that have no effect.
    fn check_used(&self, used: &[&str], what: &str) -> Result<(), Exit> {
        match self.given.beside(used) {
            None => Ok(()),
            Some(unused) => Err(anyhow!("{unused}: no effect on {what}\nHint: leave it out")).or_usage(),
        }
    }

    fn ranking(&self, comparison: &Comparison) -> Ranking {
        let all = comparison.datasets.len();
        let error = self.guarantee().of_test().error_of_pair(all, self.error);
        // The policy that is most clearly better than this one.
        let better = |name: &str| {
            let shown = comparison.differences.iter().filter(|pair| pair.ln_p <= error.ln()).filter_map(|pair| {
                let behind = if pair.difference > 0.0 { &pair.second } else { &pair.first };
                let ahead = if pair.difference > 0.0 { &pair.first } else { &pair.second };
                (behind == name && pair.difference.abs() > 0.0).then(|| (pair.ln_p, ahead.clone()))
            });
            shown.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, by)| DroppedPolicy { by, round: None })
        };
        let policies = comparison.datasets.iter().map(|of| RankedPolicy {
            name: of.name.clone(),
            run: of.subject.path.clone(),
            valid: of.success.rate.n,
            invalid: of.success.bounds.invalid,
            successes: of.success.rate.successes,
            rate: of.success.rate.rate,
            stage: None,
            interval_95: of.success.rate.wilson_95,
            dropped: better(&of.name),
        });
        let pairs = comparison.differences.iter().map(|pair| RankedPair {
            first: pair.first.clone(),
            second: pair.second.clone(),
            pairs: pair.valid_pairs.unwrap_or(0),
            clusters: pair.clusters,
            difference: pair.difference,
            interval_95: pair.interval_95,
        });
        Ranking::new(
            scenarios(comparison),
            RankingDesign::Results,
            (self.guarantee(), self.error),
            policies.collect(),
            pairs.collect(),
        )
    }
}

/// The ranking in the folder of a finished contest.
fn finished(folder: &Path) -> Result<Option<Ranking>, Exit> {
    let path = folder.join(ANSWER);
    if !path.is_file() {
        return Ok(None);
    }
    let text = read_text(&path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    let ranking: Ranking = Budget::FILE
        .json(text.as_bytes())
        .with_context(|| format!("{}: not a ranking\nHint: run the contest again", path.display()))
        .or_usage()?;
    Ok(Some(ranking))
}

/// How the results were compared, in one sentence.
fn scenarios(comparison: &Comparison) -> String {
    let pairs: Vec<u64> = comparison.differences.iter().filter_map(|pair| pair.valid_pairs).collect();
    let clusters = comparison.differences.iter().filter_map(|pair| pair.clusters).min();
    let how = match pairs.iter().min() {
        Some(fewest) if pairs.len() == comparison.differences.len() => {
            format!("Finished results, paired by scenario and seed: at least {fewest} pairs for each two policies")
        }
        Some(_) => "Finished results, some of them paired by scenario and seed".to_owned(),
        None => "Finished results of independent episodes".to_owned(),
    };
    match clusters {
        Some(clusters) => format!("{how}; rows depend on each other, so {clusters} clusters count"),
        None => how,
    }
}

/// Opens a run or a dictionary, or imports each policy of a results file.
fn open(path: &Path, mapping: &Mapping) -> Result<Vec<(Source, PathBuf)>, Exit> {
    let opened = open_source(path);
    if path.is_dir() || opened.is_ok() {
        return Ok(vec![(opened?, path.to_owned())]);
    }
    let names = policies(path, None, mapping).or_usage()?;
    if names.len() < 2 {
        return Ok(vec![(Source::import(path, mapping).or_usage()?, path.to_owned())]);
    }
    let import = |name: String| {
        // Each policy has a path of its own in the comparison.
        let shown = path.join(&name);
        let mut mapping = mapping.clone();
        mapping.about.policy = Some(name);
        Ok((Source::import(path, &mapping).or_usage()?, shown))
    };
    names.into_iter().map(import).collect()
}
