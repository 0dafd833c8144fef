//! Coverage and savings of the interval of the real success rate. Prints the tables of docs/results/transfer.md.
//!
//! Usage: `transfer` for trials whose correlation with the predictions is known, and `transfer SIMULATION REALITY...`,
//! folders of runs, for surrogate realities. Each reality has the same parameters as the simulation; where
//! its ranges differ, they are mapped to those of the simulation, so its physics differ by these factors.

use std::error::Error;
use std::io::Write;
use std::path::Path;

use robogate_analysis::Source;
use robogate_analysis::transfer::{Predictions, RealTrial, RealTrials, Simulation, strata};
use robogate_core::{Outcome, Seed, Stream};
use robogate_stats::exact_strata::{bounds, p_above, p_below};
use robogate_stats::prediction_powered::{Predicted, normal, rate};
use robogate_stats::{Confidence, Trials, clopper_pearson, wilson};

/// Campaigns of each row.
const CAMPAIGNS: u64 = 1_000;

/// The exact interval is computed in every campaign of this number.
const EVERY: u64 = 20;

/// Coverage and mean width of one method.
#[derive(Default)]
struct Score {
    covered: u64,
    width: f64,
}

impl Score {
    fn add(&mut self, [low, high]: [f64; 2], truth: f64) {
        self.covered += u64::from(low <= truth && truth <= high);
        self.width += high - low;
    }

    fn coverage(&self) -> f64 {
        100.0 * self.covered as f64 / CAMPAIGNS as f64
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let folders: Vec<String> = std::env::args().skip(1).collect();
    let mut out = std::io::stdout().lock();
    if folders.is_empty() {
        synthetic(&mut out)?;
        grouped(&mut out)?;
    }
    if let Some((simulation, realities)) = folders.split_first() {
        let source = Source::open(Path::new(simulation))?;
        for reality in realities {
            surrogate(&mut out, &source, reality)?;
        }
    }
    Ok(())
}

/// Trials whose success rate and correlation with the predictions are known.
fn synthetic(out: &mut impl Write) -> Result<(), Box<dyn Error>> {
    writeln!(out, "| trials | rate | correlation | normal PPI++ | RoboGate | exact | width to trials alone | worth |")?;
    for n in [20, 30, 50, 100] {
        for p in [0.5, 0.8, 0.9] {
            for correlation in [0.0, 0.3, 0.5, 0.7, 0.9] {
                let Some(population) = Population::of(p, correlation) else { continue };
                let (mut plain, mut ours, mut exact) = (Score::default(), Score::default(), Score::default());
                let (mut alone, mut worth) = (0.0, 0.0);
                for campaign in 0..CAMPAIGNS {
                    let mut stream = Seed::campaign(campaign).stream("synthetic trials");
                    let (y, f): (Vec<bool>, Vec<f64>) = (0..n).map(|_| population.trial(&mut stream)).unzip();
                    let found = rate(&y, &f, Predicted::of(&population.f), &[], Confidence::P95)?;
                    ours.add([found.interval.low, found.interval.high], p);
                    alone += found.alone.width();
                    worth += found.worth;
                    let numbers: Vec<f64> = y.iter().map(|y| f64::from(u8::from(*y))).collect();
                    let (_, interval) = normal(&numbers, &f, &population.f, None, Confidence::P95);
                    plain.add([interval.low, interval.high], p);
                    let predictions = Predictions { trials: f, population: population.f.clone(), map: Vec::new() };
                    if let Some((_, strata)) = strata(&predictions, &y) {
                        let inside = p_above(strata, p) > 0.025 && p_below(strata, p) > 0.025;
                        exact.covered += u64::from(inside);
                    }
                }
                writeln!(
                    out,
                    "| {n} | {:.0} % | {correlation} | {:.1} % | {:.1} % | {:.1} % | {:.2} | {:.0} |",
                    100.0 * p,
                    plain.coverage(),
                    ours.coverage(),
                    exact.coverage(),
                    ours.width / alone,
                    worth / CAMPAIGNS as f64
                )?;
            }
        }
    }
    writeln!(out)?;
    Ok(())
}

/// Trials that share effects: those of a day, and those of a setting.
fn grouped(out: &mut impl Write) -> Result<(), Box<dyn Error>> {
    writeln!(
        out,
        "| trials | groups | shared effect | RoboGate | trials alone | as if independent | width to trials alone |"
    )?;
    let logistic = |x: f64| 1.0 / (1.0 + (-x).exp());
    let population = Population::of(0.8, 0.5).ok_or("no such population")?;
    let predicted = Predicted::of(&population.f);
    // Quantiles of the effect of a day, which is uniform.
    let quantile = |k: usize, spread: f64| spread * ((k as f64 + 0.5) / 50.0 - 0.5);
    for (n, groups) in [(30, 6), (30, 10), (60, 6), (60, 20), (100, 20)] {
        for (effect, spread) in
            [("none", Some(0.0)), ("day, log-odds ±1", Some(2.0)), ("day, log-odds ±2", Some(4.0)), ("setting", None)]
        {
            let of_day = |p: &f64, k: usize| logistic((p / (1.0 - p)).ln() + quantile(k, spread.unwrap_or_default()));
            let days = (0..50).map(|k| population.p.iter().map(|p| of_day(p, k)).sum::<f64>());
            let truth = days.sum::<f64>() / (50 * Population::POINTS) as f64;
            let [mut ours, mut alone, mut naive] = [0; 3].map(|_| Score::default());
            for campaign in 0..CAMPAIGNS {
                let mut stream = Seed::campaign(campaign).stream("grouped trials");
                let days: Vec<usize> = (0..groups).map(|_| stream.below(50)).collect();
                let settings: Vec<usize> = (0..groups).map(|_| stream.below(Population::POINTS)).collect();
                let group: Vec<usize> = (0..n).map(|i| i % groups).collect();
                let at: Vec<usize> = group
                    .iter()
                    .map(|group| if spread.is_some() { stream.below(Population::POINTS) } else { settings[*group] })
                    .collect();
                let y: Vec<bool> = at
                    .iter()
                    .zip(&group)
                    .map(|(at, group)| stream.uniform() < of_day(&population.p[*at], days[*group]))
                    .collect();
                let f: Vec<f64> = at.iter().map(|at| population.f[*at]).collect();
                let found = rate(&y, &f, predicted, &[group], Confidence::P95)?;
                ours.add([found.interval.low, found.interval.high], truth);
                alone.add([found.alone.low, found.alone.high], truth);
                let plain = wilson(Trials::count(y.iter().copied()), Confidence::P95);
                naive.add([plain.low, plain.high], truth);
            }
            writeln!(
                out,
                "| {n} | {groups} | {effect} | {:.1} % | {:.1} % | {:.1} % | {:.2} |",
                ours.coverage(),
                alone.coverage(),
                naive.coverage(),
                ours.width / alone.width
            )?;
        }
    }
    writeln!(out)?;
    Ok(())
}

/// A population whose success probability is logistic in one variable, with predictions that are too cautious.
struct Population {
    p: Vec<f64>,
    f: Vec<f64>,
}

impl Population {
    const POINTS: usize = 4_000;

    /// Finds the slope with this correlation of outcomes and probabilities.
    fn of(rate: f64, correlation: f64) -> Option<Self> {
        let logistic = |x: f64| 1.0 / (1.0 + (-x).exp());
        let at = |i: usize| {
            let u = (i as f64 + 0.5) / Self::POINTS as f64;
            (u / (1.0 - u)).ln()
        };
        let with = |slope: f64| {
            let (mut low, mut high) = (-200.0, 200.0);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                let mean =
                    (0..Self::POINTS).map(|i| logistic(middle + slope * at(i))).sum::<f64>() / Self::POINTS as f64;
                if mean > rate { high = middle } else { low = middle }
            }
            low
        };
        let (mut small, mut large) = (0.0, 40.0);
        for _ in 0..40 {
            let slope = 0.5 * (small + large);
            let shift = with(slope);
            let mean_square = (0..Self::POINTS).map(|i| logistic(shift + slope * at(i)).powi(2)).sum::<f64>();
            let variance = mean_square / Self::POINTS as f64 - rate * rate;
            let found = (variance.max(0.0) / (rate * (1.0 - rate))).sqrt();
            if found < correlation { small = slope } else { large = slope }
        }
        let slope = if correlation > 0.0 { large } else { 0.0 };
        let shift = with(slope);
        let eta = |i: usize| shift + slope * at(i);
        let predicted = |i: usize| if correlation > 0.0 { logistic(0.5 + 0.7 * eta(i)) } else { logistic(1.0 + at(i)) };
        Some(Self {
            p: (0..Self::POINTS).map(|i| logistic(eta(i))).collect(),
            f: (0..Self::POINTS).map(predicted).collect(),
        })
    }

    fn trial(&self, stream: &mut Stream) -> (bool, f64) {
        let i = stream.below(Self::POINTS);
        (stream.uniform() < self.p[i], self.f[i])
    }
}

/// Campaigns of trials from the episodes of another simulator.
fn surrogate(out: &mut impl Write, simulation: &Source, reality: &str) -> Result<(), Box<dyn Error>> {
    let model = Simulation::open(simulation, None)?;
    let (space, dictionary) = (model.space(), Source::open(Path::new(reality))?);
    let dictionary = dictionary.dictionary();
    let other = &dictionary.provenance().space;
    let mut pool = Vec::new();
    for entry in dictionary.entries() {
        let entry = entry?;
        if entry.stage != "uniform" || matches!(entry.episode.outcome, Outcome::Invalid(_)) {
            continue;
        }
        let requested = &entry.episode.scenario.requested;
        let value = |parameter: &robogate_core::Parameter| {
            let own = &other.parameters()[other.position(&parameter.name)?].domain;
            let coded = own.encode(requested.get(&parameter.name)?)?;
            Some(parameter.domain.from_unit(own.to_unit(coded)))
        };
        pool.push(RealTrial {
            line: entry.index(),
            success: entry.episode.outcome == Outcome::Success,
            mode: None,
            values: space.parameters().iter().map(value).collect(),
        });
    }
    let trials = RealTrials {
        sha256: String::new(),
        trials: pool,
        outside: Vec::new(),
        outside_in: Default::default(),
        groupings: Vec::new(),
        constant: Vec::new(),
        one_setting: false,
        missing: Vec::new(),
        incomplete: 0,
        ignored: Vec::new(),
        has_modes: false,
        names_policy: false,
    };
    let all = model.predictions(&trials)?;
    let outcomes = trials.outcomes();
    let truth = outcomes.iter().filter(|y| **y).count() as f64 / outcomes.len() as f64;
    let population = Predicted { points: f64::INFINITY, ..Predicted::of(&all.population) };
    // The surrogate is a finite set of episodes, so the population is theirs.
    let own = Predicted { points: f64::INFINITY, ..Predicted::of(&all.trials) };
    writeln!(
        out,
        "{reality}: {} episodes, success {:.1} %; the model predicts {:.1} % over the space and {:.1} % over these episodes",
        outcomes.len(),
        100.0 * truth,
        100.0 * population.mean,
        100.0 * own.mean
    )?;
    let reality = Reality { outcomes, truth, own };
    reality.table(out, &all.trials, true)?;
    for hidden in space.parameters().iter().take(2) {
        let mut unstated = trials.clone();
        let at = space.position(&hidden.name).ok_or("no such parameter")?;
        unstated.trials.iter_mut().for_each(|trial| trial.values[at] = None);
        writeln!(out, "without {}, which the trials do not state:", hidden.name)?;
        reality.table(out, &model.predictions(&unstated)?.trials, false)?;
    }
    Ok(())
}

/// A surrogate reality: the outcomes of its episodes, their rate, and the predictions for them.
struct Reality {
    outcomes: Vec<bool>,
    truth: f64,
    own: Predicted,
}

impl Reality {
    /// Writes coverage and savings. The exact interval needs complete settings.
    fn table(&self, out: &mut impl Write, predicted: &[f64], complete: bool) -> Result<(), Box<dyn Error>> {
        let Self { outcomes, truth, own } = self;
        writeln!(
            out,
            "| trials | coverage | trials alone | exact | exact alone | width to trials alone | trials saved (median, 10 to 90 %) | saved none |"
        )?;
        for n in [20, 30, 50, 100] {
            let [mut ours, mut plain, mut exact, mut pearson] = [0; 4].map(|_| Score::default());
            let mut saved = Vec::new();
            for campaign in 0..CAMPAIGNS {
                let mut stream = Seed::campaign(campaign).stream("surrogate trials");
                let chosen: Vec<usize> = (0..n).map(|_| stream.below(outcomes.len())).collect();
                let y: Vec<bool> = chosen.iter().map(|i| outcomes[*i]).collect();
                let f: Vec<f64> = chosen.iter().map(|i| predicted[*i]).collect();
                let found = rate(&y, &f, *own, &[], Confidence::P95)?;
                ours.add([found.interval.low, found.interval.high], *truth);
                let counts = Trials::count(y.iter().copied());
                let alone = wilson(counts, Confidence::P95);
                plain.add([alone.low, alone.high], *truth);
                let alone = clopper_pearson(counts, Confidence::P95);
                pearson.add([alone.low, alone.high], *truth);
                saved.push(found.worth - n as f64);
                let predictions = Predictions { trials: f, population: predicted.to_vec(), map: Vec::new() };
                if let Some((_, strata)) = strata(&predictions, &y).filter(|_| complete) {
                    exact.covered += u64::from(p_above(strata, *truth) > 0.025 && p_below(strata, *truth) > 0.025);
                    // The exact interval takes long, so its width comes from a part of the campaigns.
                    if campaign % EVERY == 0 {
                        exact.width += EVERY as f64 * bounds(strata, 0.025).width();
                    }
                }
            }
            saved.sort_by(f64::total_cmp);
            let quantile = |q: f64| saved[(q * (saved.len() - 1) as f64) as usize];
            let none = saved.iter().filter(|saved| **saved < 0.5).count() as f64 / saved.len() as f64;
            let [covered, width] = if complete {
                [format!("{:.1} %", exact.coverage()), format!(" (exact {:.2})", exact.width / pearson.width)]
            } else {
                ["–".to_owned(), String::new()]
            };
            writeln!(
                out,
                "| {n} | {:.1} % | {:.1} % | {covered} | {:.1} % | {:.2}{width} | {:.0} ({:.0} to {:.0}) | {:.1} % |",
                ours.coverage(),
                plain.coverage(),
                pearson.coverage(),
                ours.width / plain.width,
                quantile(0.5),
                quantile(0.1),
                quantile(0.9),
                100.0 * none
            )?;
        }
        writeln!(out)?;
        Ok(())
    }
}
