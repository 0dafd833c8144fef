//! `robogate warn check`: measures a detector on the episodes of another run.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use robogate_monitor::warn::{Baselines, Track, WarnFile, calibrate, false_warnings};

use super::recorded::RunArguments;
use super::show::{Shown, Verdict, Views};
use super::train::baselines;
use crate::exit::{DONE, Exit, OrExit};
use crate::place;
use crate::terminal::{foreign, note};

/// Measure a detector on the episodes of another run: how many successes it warns, and how early it warns failures.
///
/// The run may be one of another engine, policy or population: the output says in what it differs from the calibration, and whether the
/// promise holds there. With --out, the successes of the run give a new threshold, and the conditions become those of the run.
///
/// Exit codes: 0 if the promise holds for this run, 1 if it does not, 3 if the run has too few successes to tell.
#[derive(Debug, Args)]
pub(super) struct CheckOn {
    /// Detector of `robogate warn train`
    file: PathBuf,
    #[command(flatten)]
    run: RunArguments,
    /// Calibrate again with the successes of this run, and write the detector to this file
    #[arg(short, long, value_name = "FILE", value_parser = place::local())]
    out: Option<PathBuf>,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

impl CheckOn {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let file = super::read(&self.file)?;
        let detector = file.detector().or_usage()?;
        let risk = file.scenario_risk().or_usage()?;
        let (mut recorded, _) = self.run.read(&file.events, |_| Ok(file.known.clone()))?;
        if file.runs.contains(&recorded.run) {
            return Err(anyhow!(
                "{}: its episodes trained this detector or gave its threshold, so they do not measure the promise\nHint: check it on another \
                 run, for example with another --seed",
                self.run.run.display()
            ))
            .or_usage();
        }
        if recorded.signals != file.features.signals {
            return Err(anyhow!(
                "{}: its signals are not those of the detector: another task, robot or control period\nHint: train a detector with this run",
                self.run.run.display()
            ))
            .or_usage();
        }
        // The risk of the scenario reads the parameters in the order of the file.
        let places: Vec<Option<usize>> = (file.baselines.parameters.iter())
            .map(|of| recorded.parameters.iter().position(|found| found == of))
            .collect();
        for track in &mut recorded.tracks {
            let found = &track.scenario_numbers;
            track.scenario_numbers =
                places.iter().map(|at| at.and_then(|at| found.get(at)).copied().unwrap_or(f64::NAN)).collect();
        }
        let tracks: Vec<&Track> = recorded.tracks.iter().collect();
        let scored = recorded.scores(&detector, &tracks)?;
        let differences = file.conditions.differences(&recorded.conditions);
        let verdict = Verdict::of(&false_warnings(&scored, file.calibration.threshold), file.calibration.promised);
        let views = Views::of(&file, &tracks, &scored, risk.as_ref());
        let (check, differences) = (Some(verdict), &*differences);
        Shown { file: &file, detector: &detector, views: &views, fitted: None, check, differences }.print(self.json)?;
        if let Some(out) = &self.out {
            let promised = file.calibration.promised;
            let calibration = calibrate(&scored, promised).or_usage()?;
            let again = baselines(&tracks, &scored, risk.as_ref(), promised)?;
            let baselines = Baselines { clock: again.clock, scenario: again.scenario, ..file.baselines.clone() };
            let runs = file.runs.iter().cloned().chain([recorded.run]).collect();
            let again = WarnFile { calibration, baselines, conditions: recorded.conditions, runs, ..file };
            super::write(out, &again)?;
            note(format_args!("calibrated again: {}", foreign(out.display())));
            return Ok(DONE);
        }
        Ok(verdict.exit_code())
    }
}
