//! Is boundary focusing worth it? Compares designs of equal budget by the models that they train, on one test set:
//!
//! ```text
//! robogate run --robot franka -n 3000 --design uniform --seed 1 --out runs/test
//! robogate run --robot franka -n 1500 --design uniform --seed 2 --out runs/uniform-1
//! robogate run --robot franka -n 1500 --design two-stage --seed 3 --out runs/two-stage-1
//! cargo run --release -p robogate --example boundary_focusing -- runs/test runs/uniform-1 runs/two-stage-1
//! ```
//!
//! Each run after the test set is a folder with the name `DESIGN-REPEAT`; repeats have seeds of their own. The reference is the design
//! `uniform`. Differences are paired by test episode, and their intervals contain both sources of variance, repeats and test
//! episodes ([`robogate_stats::crossed`]), with simultaneous 95 % confidence for all differences of a measure (Bonferroni).
#![expect(clippy::print_stdout, reason = "an example prints")]

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, bail};
use robogate_analysis::learners::{Learner, predictions};
use robogate_campaign::folder::DICTIONARY;
use robogate_core::Outcome;
use robogate_dictionary::Dictionary;
use robogate_stats::Confidence;
use robogate_stats::crossed::crossed_mean;

/// The learners, with their names in the table.
const LEARNERS: [(&str, Learner); 3] =
    [("paper's features", Learner::Paper), ("main effects", Learner::MainEffects), ("flexible", Learner::Flexible)];

/// The design that the others are compared with.
const REFERENCE: &str = "uniform";

/// The measures, in the order of [`losses`]. Smaller is better.
const MEASURES: [&str; 3] = ["boundary error", "log loss", "Brier score"];

/// Numbers of one model for each measure and test episode.
type Losses = [Vec<f64>; 3];

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [test, runs @ ..] = arguments.as_slice() else { bail!("usage: boundary_focusing TEST DESIGN-REPEAT...") };
    let test = open(test)?;
    let mut outcomes = Vec::new();
    for entry in test.entries() {
        match entry?.episode.outcome {
            Outcome::Invalid(_) => {}
            outcome => outcomes.push(outcome == Outcome::Success),
        }
    }
    let mut designs: BTreeMap<&str, Vec<Dictionary>> = BTreeMap::new();
    for run in runs {
        let name = Path::new(run).file_name().and_then(|name| name.to_str());
        let (design, _) =
            name.and_then(|name| name.rsplit_once('-')).with_context(|| format!("{run}: not a DESIGN-REPEAT"))?;
        designs.entry(design).or_default().push(open(run)?);
    }
    println!("| learner | design | repeats | {} |", MEASURES.map(|name| format!("{name} | minus uniform")).join(" | "));
    println!("|---|---|---:{}|", "|---:|---:".repeat(MEASURES.len()));
    let comparisons = LEARNERS.len() * designs.len().saturating_sub(1).max(1);
    for (name, learner) in LEARNERS {
        let found: anyhow::Result<BTreeMap<&str, Vec<Losses>>> = designs
            .iter()
            .map(|(design, runs)| {
                let models = runs.iter().map(|run| Ok(losses(&predictions(learner, run, &test)?, &outcomes)));
                Ok((*design, models.collect::<anyhow::Result<_>>()?))
            })
            .collect();
        match found {
            Ok(found) => rows(name, &found, comparisons)?.iter().for_each(|row| println!("{row}")),
            // Not every task has the paper's features.
            Err(error) => println!("| {name} | {error:#} |"),
        }
    }
    Ok(())
}

fn open(run: &str) -> anyhow::Result<Dictionary> {
    Ok(Dictionary::open(&Path::new(run).join(DICTIONARY))?)
}

/// The losses of predicted chances of success.
fn losses(chances: &[f64], outcomes: &[bool]) -> Losses {
    let likely: Vec<f64> =
        chances.iter().zip(outcomes).map(|(p, success)| if *success { *p } else { 1.0 - p }).collect();
    let of = |loss: fn(f64) -> f64| likely.iter().map(|p| loss(*p)).collect();
    [of(|p| f64::from(u8::from(p < 0.5))), of(|p| -p.max(1e-15).ln()), of(|p| (1.0 - p).powi(2))]
}

/// The rows of one learner: the mean of each measure, and its difference from the reference with an interval.
fn rows(learner: &str, found: &BTreeMap<&str, Vec<Losses>>, comparisons: usize) -> anyhow::Result<Vec<String>> {
    let mut rows = Vec::new();
    for (design, models) in found {
        let mut row = format!("| {learner} | {design} | {} |", models.len());
        for at in 0..MEASURES.len() {
            let own: Vec<Vec<f64>> = models.iter().map(|model| model[at].clone()).collect();
            row += &format!(" {:.4} |", crossed_mean(&own, Confidence::P95)?.mean);
            let Some(reference) = found.get(REFERENCE).filter(|_| *design != REFERENCE) else {
                row += " |";
                continue;
            };
            let differences: Vec<Vec<f64>> = own
                .iter()
                .zip(reference)
                .map(|(own, of)| own.iter().zip(&of[at]).map(|(a, b)| a - b).collect())
                .collect();
            let found = crossed_mean(&differences, Confidence::P95.shared_by(comparisons))?;
            let interval =
                found.interval.map_or_else(String::new, |of| format!(" ({:+.4} to {:+.4})", of.low, of.high));
            row += &format!(" {:+.4}{interval} |", found.mean);
        }
        rows.push(row);
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn designs_are_compared_with_uniform() {
        let outcomes = [true, false, true, true];
        let [good, bad] = [[0.9, 0.2, 0.8, 0.6], [0.9, 0.2, 0.8, 0.4]].map(|chances| losses(&chances, &outcomes));
        let found =
            BTreeMap::from([(REFERENCE, vec![good.clone(), good.clone()]), ("focused", vec![bad.clone(), bad])]);
        let rows = rows("flexible", &found, 1).unwrap();
        assert!(rows[0].starts_with("| flexible | focused | 2 | 0.2500 | +0.2500"), "{}", rows[0]);
        // The mean of 0.01, 0.04, 0.04 and 0.16.
        assert!(rows[1].ends_with("| 0.0625 | |"), "{}", rows[1]);
    }
}
