//! Compares designs and learners by the map of success that they give, on a common test set:
//!
//! ```text
//! cargo run --release -p robogate --example discovery -- points TEST_RUN COUNT > SUITE
//! cargo run --release -p robogate --example discovery -- score TEST_RUN PARTNERS RUN...
//! cargo run --release -p robogate --example discovery -- until MODE COUNT RUN...
//! ```
//!
//! `scripts/discovery.sh` does everything. `TEST_RUN` is a finished campaign of one uniform stage. The first form prints a suite of
//! its first `COUNT` points; a run of it, `PARTNERS`, has the same parameters and other draws. The second form fits the learners
//! to each `RUN` (a folder named `...-DESIGN-EPISODES-REPEAT`) and prints a table. The third form prints after how many episodes of
//! each run, in their order, a failure mode had occurred `COUNT` times.
//!
//! The Brier score of a perfect map p(x) is not 0 but the mean of p (1 - p), because draws that no parameter sets decide some
//! episodes: the noise floor. A point and its partner have independent outcomes y and z of the same p, so that the floor is half the
//! share of pairs with different outcomes, and the mean of (q - y)(q - z) is the excess error of a map q: the mean of (q - p)².
//! Both are unbiased. Intervals contain both sources of variance, repeats and test points ([`robogate_stats::crossed`]).
#![expect(clippy::print_stdout, reason = "an example prints")]

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, anyhow, bail, ensure};
use robogate_analysis::learners::{self, predictions};
use robogate_campaign::folder::DICTIONARY;
use robogate_core::{Fault, FeatureSpec, Foresight, Measures, Outcome, Scenario, Seed, Value};
use robogate_dictionary::Dictionary;
use robogate_physics::{MujocoEngine, built_in_robot};
use robogate_risk::{Fitting, Inputs, Learner, RiskModel, Sample};
use robogate_stats::crossed::crossed_mean;
use robogate_stats::{Confidence, Interval, Trials, wilson};
use robogate_tasks::file::shipped;
use robogate_tasks::insertion::Insertion;
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::{ArmTask, Rig};

/// Size of camera images, which nothing reads here.
const PICTURE_PX: usize = 16;
/// Fresh draws over which a model is averaged.
const DRAWS: u64 = 96;
/// The name of a learner, and the learner.
const LEARNERS: [(&str, Fitted); 5] = [
    ("both, told draws", Fitted::Risk { told: true, learner: Learner::Chosen }),
    ("boosting, told draws", Fitted::Risk { told: true, learner: Learner::Boosting }),
    ("splines, told draws", Fitted::Risk { told: true, learner: Learner::Splines }),
    ("parameters alone", Fitted::Risk { told: false, learner: Learner::Chosen }),
    ("`flexible`", Fitted::Flexible),
];

/// What is fitted to a run.
#[derive(Clone, Copy)]
enum Fitted {
    /// A risk model, which may be told the hidden draws.
    Risk { told: bool, learner: Learner },
    /// The flexible learner of `robogate_analysis::learners`, which knows the parameters alone.
    Flexible,
}
/// Samples of repeats for the interval of equal numbers of episodes.
const SAMPLES: usize = 2_000;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments.as_slice() {
        ["points", test, count] => points(&open(test)?, count.parse()?),
        ["score", test, partners, runs @ ..] if !runs.is_empty() => score(test, partners, runs),
        ["until", mode, count, runs @ ..] if !runs.is_empty() => until(mode, count.parse()?, runs),
        _ => bail!("usage: discovery points TEST COUNT | score TEST PARTNERS RUN... | until MODE COUNT RUN..."),
    }
}

/// Prints a suite of the first points of a run, in the order of its episodes.
fn points(test: &Dictionary, count: usize) -> anyhow::Result<()> {
    println!("schema = 1\nname = \"partners\"\nversion = \"1.0.0\"");
    println!("description = \"Points of a test set.\"\n[[group]]\nname = \"partners\"\ncategory = \"partners\"");
    println!("scenarios = [");
    for entry in test.entries().take(count) {
        let scenario = entry?.episode.scenario;
        let values = scenario.requested.iter().map(|(name, value)| match value {
            Value::Number(x) => format!(", {name} = {x:?}"),
            Value::Integer(n) => format!(", {name} = {n}"),
            Value::Category(word) => format!(", {name} = {word:?}"),
        });
        println!("    {{ id = \"point-{}\"{} }},", scenario.index, values.collect::<String>());
    }
    println!("]");
    Ok(())
}

/// Prints after how many episodes a failure mode had occurred `count` times, counted again from there to the end of each run.
fn until(mode: &str, count: u64, runs: &[&str]) -> anyhow::Result<()> {
    println!("| run | episodes | {mode} | episodes until {count} of them, each time |\n|---|---:|---:|---|");
    for run in runs {
        let (mut episodes, mut found, mut since, mut times) = (0_u64, 0_u64, 0_u64, Vec::new());
        for entry in open(run)?.entries() {
            episodes += 1;
            since += 1;
            if entry?.episode.outcome.as_str() == mode {
                found += 1;
                if found.is_multiple_of(count) {
                    times.push(since.to_string());
                    since = 0;
                }
            }
        }
        let name = Path::new(run).file_name().and_then(|name| name.to_str()).unwrap_or(run);
        println!("| {name} | {episodes} | {found} | {} |", times.join(", "));
    }
    Ok(())
}

/// The test set: points and outcomes, and the outcome of the partner where there is one.
struct Test {
    points: Vec<(Sample, Option<bool>)>,
}

/// The losses of one map at each test point.
#[derive(Debug)]
struct Losses {
    brier: Vec<f64>,
    /// At the points with a partner.
    excess: Vec<f64>,
}

/// A design, its number of episodes, and the learner.
type Key = (String, u64, usize);

fn score(test: &str, partners: &str, runs: &[&str]) -> anyhow::Result<()> {
    let dictionary = open(test)?;
    let robot = built_in_robot(&dictionary.provenance().robot.name)?;
    let engine = MujocoEngine::new(robot, MujocoEngine::TIME_STEP_S)?;
    let task = dictionary.provenance().task.name;
    let tasks: [&dyn ArmTask; 2] = [&PickPlace::DEFAULT, &Insertion::DEFAULT];
    let from_files = shipped().map(|task| -> &dyn ArmTask { task });
    let of = tasks
        .into_iter()
        .chain(from_files)
        .find(|of| task == *of.name())
        .with_context(|| format!("unknown task {task}"))?;
    let rig = Rig { picture_px: [PICTURE_PX; 2], ..Rig::default() };
    let foresight = of.environment(Box::new(engine), rig).map(|of| of.foresight());
    let foresight = foresight.map_err(|why| anyhow!(why))?;
    let foresight = Arc::new(Remembered { inner: foresight.context("no foresight")?, rows: Mutex::default() });
    let test = Test::new(&dictionary, &open(partners)?)?;
    let floor = test.floor()?;
    println!("{}\n", test.describe(&floor));
    let next = AtomicUsize::new(0);
    let found: Mutex<BTreeMap<Key, BTreeMap<u64, Losses>>> = Mutex::default();
    let work = || -> anyhow::Result<()> {
        while let Some(run) = runs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let (design, episodes, repeat) = parsed(run)?;
            let episodes_of_run = open(run)?;
            let train = samples(&episodes_of_run)?;
            for (at, (name, fitted)) in LEARNERS.into_iter().enumerate() {
                let losses = match fitted {
                    Fitted::Risk { told, learner } => {
                        let known = told.then(|| Arc::clone(&foresight) as Arc<dyn Foresight>);
                        let inputs = Arc::new(Inputs::new(&dictionary.provenance().space, known));
                        let how = Fitting { learner, ..Fitting::default() };
                        let model = RiskModel::fit(inputs, &train, how).with_context(|| format!("{run}: {name}"))?;
                        let chance = |sample: &Sample| model.averaged(&sample.scenario.requested, DRAWS);
                        let map: Result<Vec<f64>, Fault> = test.points.iter().map(|(point, _)| chance(point)).collect();
                        test.losses(&map.map_err(|fault| anyhow!("{fault}"))?)
                    }
                    Fitted::Flexible => {
                        test.losses(&predictions(learners::Learner::Flexible, &episodes_of_run, &dictionary)?)
                    }
                };
                let mut found = found.lock().unwrap_or_else(PoisonError::into_inner);
                found.entry((design.clone(), episodes, at)).or_default().insert(repeat, losses);
            }
        }
        Ok(())
    };
    let threads = std::thread::available_parallelism()?.get();
    std::thread::scope(|scope| {
        let all: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        all.into_iter().try_for_each(|one| one.join().map_err(|_| anyhow!("a thread panicked"))?)
    })?;
    let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    table(&found.into_iter().map(|(key, repeats)| (key, repeats.into_values().collect())).collect())
}

/// Prints the figures of each learner, size and design.
fn table(found: &BTreeMap<Key, Vec<Losses>>) -> anyhow::Result<()> {
    println!(
        "| learner | episodes | design | repeats | Brier score | excess error | Brier score minus that of uniform | uniform episodes to equal error |"
    );
    println!("|---|---:|---|---:|---:|---:|---:|---:|");
    let mut keys: Vec<&Key> = found.keys().collect();
    keys.sort_by_key(|(design, episodes, learner)| (*learner, *episodes, rank(design)));
    for key in keys {
        let (design, episodes, learner) = key;
        let losses = &found[key];
        let mean = |of: &dyn Fn(&Losses) -> Vec<f64>| -> anyhow::Result<String> {
            let found = crossed_mean(&losses.iter().map(of).collect::<Vec<_>>(), Confidence::P95)?;
            Ok(written(found.mean, found.interval))
        };
        let base = found.get(&("uniform".to_owned(), *episodes, *learner)).filter(|_| design != "uniform");
        let difference = match base {
            Some(base) => {
                let rows =
                    losses.iter().zip(base).map(|(a, b)| a.brier.iter().zip(&b.brier).map(|(a, b)| a - b).collect());
                let found = crossed_mean(&rows.collect::<Vec<Vec<f64>>>(), Confidence::P95)?;
                written(found.mean, found.interval)
            }
            None => String::new(),
        };
        println!(
            "| {} | {episodes} | {design} | {} | {} | {} | {difference} | {} |",
            LEARNERS[*learner].0,
            losses.len(),
            mean(&|of| of.brier.clone())?,
            mean(&|of| of.excess.clone())?,
            if base.is_some() { equal(found, key) } else { String::new() },
        );
    }
    Ok(())
}

/// The number of uniform episodes with the same mean Brier score, by interpolation between sizes on a logarithmic scale, and its 95 %
/// interval over samples of the repeats.
fn equal(found: &BTreeMap<Key, Vec<Losses>>, key: &Key) -> String {
    let means = |key: &Key| -> Vec<f64> {
        found[key].iter().map(|of| of.brier.iter().sum::<f64>() / of.brier.len() as f64).collect()
    };
    let own = means(key);
    let curve: Vec<(u64, Vec<f64>)> = found
        .keys()
        .filter(|(design, _, learner)| design == "uniform" && *learner == key.2)
        .map(|of| (of.1, means(of)))
        .collect();
    let (Some(first), Some(last)) = (curve.first(), curve.last()) else { return String::new() };
    let mut random = Seed::campaign(1).stream("samples of repeats");
    let mut drawn = |values: &[f64], resample: bool| -> f64 {
        let n = values.len();
        let at = |i: usize, random: f64| values[if resample { (random * n as f64) as usize % n } else { i }];
        (0..n).map(|i| at(i, random.uniform())).sum::<f64>() / n as f64
    };
    let mut size = |resample: bool| -> f64 {
        let target = drawn(&own, resample);
        let points: Vec<(f64, f64)> =
            curve.iter().map(|(n, values)| ((*n as f64).ln(), drawn(values, resample))).collect();
        let crossed = points.windows(2).find(|two| two[0].1 >= target && target >= two[1].1);
        match crossed {
            Some(&[(x0, y0), (x1, y1)]) => (x0 + (x1 - x0) * (y0 - target) / (y0 - y1).max(1e-12)).exp(),
            _ if points.first().is_some_and(|(_, y)| target > *y) => 0.0,
            _ => f64::INFINITY,
        }
    };
    let point = size(false);
    let mut samples: Vec<f64> = (0..SAMPLES).map(|_| size(true)).collect();
    samples.sort_by(f64::total_cmp);
    let at = |share: f64| samples[((SAMPLES - 1) as f64 * share).round() as usize];
    let written = |n: f64| match n {
        n if n <= 0.0 => format!("below {}", first.0),
        n if n.is_infinite() => format!("above {}", last.0),
        n => format!("{n:.0}"),
    };
    format!("{} ({} to {})", written(point), written(at(0.025)), written(at(0.975)))
}

fn rank(design: &str) -> usize {
    ["uniform", "two-stage", "active"].iter().position(|of| *of == design).unwrap_or(3)
}

fn written(mean: f64, interval: Option<Interval>) -> String {
    let interval = interval.map_or_else(String::new, |of| format!(" ({:.4} to {:.4})", of.low, of.high));
    format!("{mean:.4}{interval}")
}

/// Design, number of episodes and repeat in the name of a run: `franka-two-stage-500-3`.
fn parsed(run: &str) -> anyhow::Result<(String, u64, u64)> {
    let name = Path::new(run).file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let mut parts = name.rsplitn(3, '-');
    let (repeat, episodes, rest) = (parts.next(), parts.next(), parts.next());
    let number = |text: Option<&str>| text.and_then(|text| text.parse::<u64>().ok());
    let design = rest.and_then(|rest| rest.split_once('-')).map(|(_, design)| design.to_owned());
    match (design, number(episodes), number(repeat)) {
        (Some(design), Some(episodes), Some(repeat)) => Ok((design, episodes, repeat)),
        _ => bail!("{run}: expected a name of the form ROBOT-DESIGN-EPISODES-REPEAT"),
    }
}

impl Test {
    fn new(test: &Dictionary, partners: &Dictionary) -> anyhow::Result<Self> {
        let mut others: BTreeMap<u64, (Scenario, Option<bool>)> = BTreeMap::new();
        for entry in partners.entries() {
            let episode = entry?.episode;
            others.insert(episode.scenario.index, (episode.scenario, success(&episode.outcome)));
        }
        let mut points = Vec::new();
        for entry in test.entries() {
            let episode = entry?.episode;
            let partner = others.remove(&episode.scenario.index);
            if let Some((scenario, _)) = &partner {
                let same =
                    episode.scenario.requested.iter().all(|(name, value)| scenario.requested.get(name) == Some(value));
                ensure!(same, "point {} and its partner differ", episode.scenario.index);
            }
            let Some(success) = success(&episode.outcome) else { continue };
            points.push((Sample { scenario: episode.scenario, success }, partner.and_then(|(_, other)| other)));
        }
        ensure!(others.is_empty(), "{} partners without a point", others.len());
        Ok(Self { points })
    }

    /// The number of pairs, and of those with different outcomes.
    fn pairs(&self) -> (u64, u64) {
        let pairs = self.points.iter().filter_map(|(sample, other)| Some(sample.success != (*other)?));
        pairs.fold((0, 0), |(n, changed), differ| (n + 1, changed + u64::from(differ)))
    }

    /// The noise floor of the Brier score, and its 95 % interval.
    fn floor(&self) -> anyhow::Result<(f64, Interval)> {
        let (pairs, changed) = self.pairs();
        let trials = Trials::new(changed, pairs)?;
        let Interval { low, high } = wilson(trials, Confidence::P95);
        let half = Interval { low: low / 2.0, high: high / 2.0 };
        Ok((changed as f64 / pairs.max(1) as f64 / 2.0, half))
    }

    fn describe(&self, (floor, interval): &(f64, Interval)) -> String {
        let successes = self.points.iter().filter(|(sample, _)| sample.success).count() as f64;
        let rate = successes / self.points.len().max(1) as f64;
        let (pairs, changed) = self.pairs();
        format!(
            "{} test episodes, success {:.1} %; {pairs} of them have a partner, {changed} pairs differ. Noise floor of the Brier score \
             {}; always predicting the success rate gives {:.4}.",
            self.points.len(),
            100.0 * rate,
            written(*floor, Some(*interval)),
            rate * (1.0 - rate)
        )
    }

    /// The losses of a map: its chance of success at each point.
    fn losses(&self, map: &[f64]) -> Losses {
        let mut losses = Losses { brier: Vec::with_capacity(self.points.len()), excess: Vec::new() };
        for ((sample, partner), q) in self.points.iter().zip(map) {
            let error = |success: bool| q - f64::from(u8::from(success));
            losses.brier.push(error(sample.success).powi(2));
            losses.excess.extend(partner.map(|other| error(sample.success) * error(other)));
        }
        losses
    }
}

/// Foresight that computes the features of each scenario once: all models are averaged over the same draws at the same points.
struct Remembered {
    inner: Arc<dyn Foresight>,
    rows: Mutex<HashMap<String, Vec<f64>>>,
}

impl Foresight for Remembered {
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        self.inner.draws(scenario)
    }

    fn feature_specs(&self) -> &[FeatureSpec] {
        self.inner.feature_specs()
    }

    fn features(&self, scenario: &Scenario) -> Result<Vec<f64>, Fault> {
        let key = format!("{:?}", (scenario.seed, scenario.index, &scenario.requested));
        if let Some(known) = self.rows.lock().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(known.clone());
        }
        let row = self.inner.features(scenario)?;
        self.rows.lock().unwrap_or_else(PoisonError::into_inner).insert(key, row.clone());
        Ok(row)
    }
}

fn open(dir: &str) -> anyhow::Result<Dictionary> {
    Ok(Dictionary::open(&Path::new(dir).join(DICTIONARY))?)
}

/// Whether an episode succeeded. `None` for an invalid one.
fn success(outcome: &Outcome) -> Option<bool> {
    match outcome {
        Outcome::Success => Some(true),
        Outcome::Failure(_) => Some(false),
        Outcome::Invalid(_) => None,
    }
}

/// The valid episodes of a run.
fn samples(dictionary: &Dictionary) -> anyhow::Result<Vec<Sample>> {
    let mut samples = Vec::new();
    for entry in dictionary.entries() {
        let episode = entry?.episode;
        let Some(success) = success(&episode.outcome) else { continue };
        samples.push(Sample { scenario: episode.scenario, success });
    }
    Ok(samples)
}
