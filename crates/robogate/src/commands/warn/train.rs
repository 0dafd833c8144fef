//! `robogate warn train`: trains a detector with the episodes of a run.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use robogate_monitor::warn::{
    Baselines, Calibration, EventRule, Features, KnownParameter, Model, PROMISED, Scored, Track, WarnFile, calibrate,
    divided, train,
};
use robogate_stats::boosting::{Boosting, Monotone, Options};

use super::recorded::{Recorded, RunArguments, event_rule};
use super::show::{Shown, Views};
use crate::exit::{DONE, Exit, OrExit};
use crate::place;
use crate::terminal::{foreign, note};

/// Train a detector that warns within an episode, before it fails.
///
/// 60 % of the scenarios fit the detector: boosted trees if at least 20 of their episodes fail, otherwise a distance to successes. Of
/// the others, at least 59 successes of different scenarios give the threshold: at most 5 % of the successes of new episodes are
/// warned, with 95 % confidence. The output says how early the failures among the others are warned.
///
/// The detector sees observations, actions and the command of the gripper, and the parameters of --parameters.
#[derive(Debug, Args)]
pub(super) struct TrainOn {
    #[command(flatten)]
    run: RunArguments,
    /// Also use parameters of the scenario that the cell knows before an episode: names, or all
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    parameters: Vec<String>,
    /// Learn from successes alone, as if no failure were known
    #[arg(long)]
    successes_only: bool,
    /// Set the event of a failure mode to the first time at which a measure is above a limit: MODE=MEASURE>LIMIT; default: the end
    /// of the episode
    #[arg(long, value_name = "RULE", value_parser = event_rule)]
    event: Vec<EventRule>,
    /// Set the seed of the division and of the trees
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Write the detector to this file
    #[arg(short, long, value_name = "FILE", value_parser = place::local())]
    out: PathBuf,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

impl TrainOn {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let (mut recorded, known) = self.run.read(&self.event, |parameters| self.known(parameters))?;
        recorded.tracks.retain(|track| !recorded.unknown.contains(&track.index));
        let Recorded { conditions, run, signals, parameters, .. } = recorded.clone();
        let (model, others) = divided(&recorded.tracks, self.seed);
        let features = Features { signals, parameters: known.iter().map(|of| of.name.clone()).collect() };
        let kept = |track: &&Track| !self.successes_only || track.failure.is_none();
        let fitting: Vec<&Track> = model.iter().copied().filter(kept).collect();
        let detector = train(features, &fitting, self.seed).or_usage()?;
        let scored = recorded.scores(&detector, &others)?;
        let calibration = calibrate(&scored, PROMISED).or_usage()?;
        let risk = scenario_risk(&model, parameters.len(), self.seed);
        let (trees, distance) = match &detector.model {
            Model::Trees(trees) => (trees.lines(), None),
            Model::Distance(distance) => (Vec::new(), Some(distance.clone())),
        };
        let baselines = baselines(&others, &scored, risk.as_ref(), PROMISED)?;
        let baselines =
            Baselines { parameters, trees: risk.as_ref().map(Boosting::lines).unwrap_or_default(), ..baselines };
        let file = WarnFile {
            warn_format: WarnFile::FORMAT,
            conditions,
            runs: vec![run],
            features: detector.features.clone(),
            known,
            trees,
            distance,
            calibration,
            events: self.event.clone(),
            baselines,
        };
        super::write(&self.out, &file)?;
        note(format_args!("written: {}", foreign(self.out.display())));
        let views = Views::of(&file, &others, &scored, risk.as_ref());
        let fitted = Some(&*fitting);
        Shown { file: &file, detector: &detector, views: &views, fitted, check: None, differences: &[] }
            .print(self.json)?;
        Ok(DONE)
    }

    /// The parameters that the detector gets.
    fn known(&self, parameters: &[KnownParameter]) -> Result<Vec<KnownParameter>, Exit> {
        if self.parameters == ["all"] {
            return Ok(parameters.to_vec());
        }
        let find = |name: &String| {
            let found = parameters.iter().find(|of| of.name == *name).cloned();
            let names: Vec<&str> = parameters.iter().map(|of| of.name.as_str()).collect();
            found.ok_or_else(|| {
                anyhow!("--parameters {name}: not a parameter of the run. Expected some of: {}", names.join(", "))
            })
        };
        self.parameters.iter().map(find).collect::<Result<_, _>>().or_usage()
    }
}

/// The scores of the baselines: the clock, and the risk of the scenario.
pub(super) fn baseline_scores(
    tracks: &[&Track],
    scored: &[Scored],
    risk: Option<&Boosting>,
) -> (Vec<Scored>, Option<Vec<Scored>>) {
    let clock = scored.iter().map(|of| of.with(f64::from)).collect();
    let by_risk = |risk: &Boosting| {
        let pairs = tracks.iter().zip(scored);
        pairs.map(|(track, of)| of.with(|_| -risk.log_odds(&track.scenario_numbers))).collect()
    };
    (clock, risk.map(by_risk))
}

/// The thresholds of the baselines with the same promise.
pub(super) fn baselines(
    tracks: &[&Track],
    scored: &[Scored],
    risk: Option<&Boosting>,
    promised: f64,
) -> Result<Baselines, Exit> {
    let (clock, scenario) = baseline_scores(tracks, scored, risk);
    let threshold =
        |scored: &[Scored]| calibrate(scored, promised).map(|Calibration { threshold, .. }| threshold).or_usage();
    Ok(Baselines {
        clock: threshold(&clock)?,
        scenario: scenario.map(|scored| threshold(&scored)).transpose()?,
        parameters: Vec::new(),
        trees: Vec::new(),
    })
}

/// The risk of a scenario by its parameters alone. `None` without parameters, or with outcomes of one kind.
fn scenario_risk(tracks: &[&Track], parameters: usize, seed: u64) -> Option<Boosting> {
    let columns: Vec<Vec<f64>> =
        (0..parameters).map(|i| tracks.iter().map(|track| track.scenario_numbers[i]).collect()).collect();
    let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let outcomes: Vec<bool> = tracks.iter().map(|track| track.failure.is_none()).collect();
    let options = Options { trees: 80, learning_rate: 0.08, leaves: 6, rows_of_leaf: 20, seed, ..Options::default() };
    (parameters > 0)
        .then(|| Boosting::fit(&views, &outcomes, &vec![Monotone::Free; parameters], options).ok())
        .flatten()
}
