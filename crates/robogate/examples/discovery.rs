//! Compares designs and learners by the map of success that they give, on a common test set:
//!
//! ```text
//! cargo run --release -p robogate --example discovery -- TEST_RUN RUN...
//! ```
//!
//! `TEST_RUN` and each `RUN` are folders of finished campaigns on the same robot and space; `scripts/discovery.sh` runs them. All
//! uniform rows of the test run are the test set. For each run and learner one line of tab-separated values follows: the
//! run, its episodes, the learner, the Brier score and the log loss of the model of the parameters. The learners are the
//! risk model told the hidden draws and averaged over fresh ones, the same with either learner alone, and the model of the
//! parameters alone.
#![expect(clippy::print_stdout, reason = "an example prints")]

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow};
use robogate_campaign::folder::DICTIONARY;
use robogate_core::{Environment, Foresight, Outcome};
use robogate_dictionary::Dictionary;
use robogate_physics::{MujocoEngine, built_in_robot};
use robogate_risk::{Inputs, Learner, RiskModel, Sample};
use robogate_tasks::pick_place::PickPlace;

/// Fresh draws over which a model is averaged.
const DRAWS: u64 = 24;

/// The name of a learner, the knowledge that its model is told, and the learner.
type Variant = (&'static str, Option<Arc<dyn Foresight>>, Learner);

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (test, runs) = arguments.split_first().context("usage: discovery TEST_RUN RUN...")?;
    let dictionary = open(test)?;
    let space = dictionary.provenance().space.clone();
    let robot = built_in_robot(&dictionary.provenance().robot.name)?;
    let engine = MujocoEngine::new(robot, MujocoEngine::TIME_STEP_S)?;
    let foresight = PickPlace::new(engine, None).map_err(|why| anyhow!(why))?.foresight();
    let test: Vec<Sample> = samples(&dictionary, true)?;
    println!("run\tepisodes\tlearner\tbrier\tlog_loss");
    for run in runs {
        let train = samples(&open(run)?, false)?;
        let variants: [Variant; 4] = [
            ("told", foresight.clone(), Learner::Chosen),
            ("told, boosting", foresight.clone(), Learner::Boosting),
            ("told, splines", foresight.clone(), Learner::Splines),
            ("parameters", None, Learner::Chosen),
        ];
        for (name, foresight, learner) in variants {
            let model =
                match RiskModel::fit(Arc::new(Inputs::new(&space, foresight)), &train, learner, RiskModel::LEAST) {
                    Ok(model) => model,
                    Err(error) => {
                        println!("{run}\t{}\t{name}\t-\t{error}", train.len());
                        continue;
                    }
                };
            let (mut brier, mut log_loss) = (0.0, 0.0);
            for sample in &test {
                let p = model.averaged(&sample.scenario.requested, DRAWS).map_err(|fault| anyhow!("{fault}"))?;
                let likely = if sample.success { p } else { 1.0 - p };
                brier += (1.0 - likely).powi(2);
                log_loss -= likely.max(1e-15).ln();
            }
            let n = test.len().max(1) as f64;
            println!("{run}\t{}\t{name}\t{:.5}\t{:.5}", train.len(), brier / n, log_loss / n);
        }
    }
    Ok(())
}

fn open(dir: &str) -> anyhow::Result<Dictionary> {
    Ok(Dictionary::open(&Path::new(dir).join(DICTIONARY))?)
}

/// The valid episodes of a run.
fn samples(dictionary: &Dictionary, uniform_only: bool) -> anyhow::Result<Vec<Sample>> {
    let mut samples = Vec::new();
    for entry in dictionary.entries() {
        let entry = entry?;
        let success = match entry.episode.outcome {
            Outcome::Success => true,
            Outcome::Failure(_) => false,
            Outcome::Invalid(_) => continue,
        };
        if !uniform_only || entry.stage == "uniform" {
            samples.push(Sample { scenario: entry.episode.scenario, success });
        }
    }
    Ok(samples)
}
