//! `robogate snapshot`: renders the cameras of the cell.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::anyhow;
use clap::Args;
use robogate_camera::{CAMERAS, SIZE_PX};
use robogate_campaign::{DEFAULT_SEED, Worker, WorkerFactory, recorded};
use robogate_core::{Assignment, Image, Scenario, Seed, Start, Suite};
use serde_json::json;

use crate::arguments::{EnvironmentArguments, TrustArguments};
use crate::commands::suites;
use crate::exit::{DONE, Exit, OrExit};
use crate::picture;
use crate::place;
use crate::terminal::{foreign, line, note};
use robogate_session::Subject;

/// Default width and height of an image, in pixels.
const ON_SHEET_PX: usize = 144;
/// Images per row of a sheet.
const COLUMNS: usize = 10;
/// Upper limit of `--size`, in pixels. Larger values are probably typing errors.
const LARGEST_PX: usize = 4096;

/// Render a scenario with the cameras of the cell, at the start or while the scripted controller works.
///
/// --set also sets parameters of the scenario (docs/parameters.md).
#[derive(Debug, Args)]
pub(crate) struct Snapshot {
    /// Render a scenario of this suite: a built-in one or a TOML file
    #[arg(long, value_name = "SUITE")]
    suite: Option<String>,
    /// Select the suite's scenario by its name; default: that of --index
    #[arg(long, value_name = "ID", requires = "suite", conflicts_with = "index")]
    case: Option<String>,
    /// Render an episode of this run
    #[arg(long, value_name = "DIR", requires = "index", conflicts_with_all = ["suite", "seed", "set", "robot", "engine", "time_step", "renderer"])]
    run: Option<PathBuf>,
    /// Select the index: of the suite's scenario (counted across rounds), of the run's episode, or of the random draws
    /// of a scenario; default: 0
    #[arg(long, value_name = "I")]
    index: Option<u64>,
    /// Set the campaign seed
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Render at these simulated times, in seconds; separate several with commas
    #[arg(long, value_name = "SECONDS", value_delimiter = ',', default_value = "0")]
    at: Vec<f64>,
    /// Render only this camera: front or wrist; default: both, and front on a sheet
    #[arg(long, value_name = "CAMERA", value_parser = CAMERAS)]
    camera: Option<String>,
    /// Set width and height of an image, in pixels; default: 256, and 144 on a sheet
    #[arg(long, value_name = "PIXELS")]
    size: Option<usize>,
    /// Render every scenario of the suite once, on one contact sheet
    #[arg(long, requires = "suite", conflicts_with_all = ["case", "run"])]
    sheet: bool,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    trust: TrustArguments,
    /// Write to this path: a folder, or the file of a sheet; default: snapshots, or SUITE.png
    #[arg(long, value_name = "PATH", value_parser = place::local())]
    out: Option<PathBuf>,
    /// Print the list of written files as one JSON document
    #[arg(long)]
    json: bool,
}

impl Snapshot {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let size = self.size.unwrap_or(if self.sheet { ON_SHEET_PX } else { SIZE_PX });
        if !(1..=LARGEST_PX).contains(&size) {
            return Err(anyhow!("--size {size}: expected 1 to {LARGEST_PX} pixels")).or_usage();
        }
        let mut times = self.at.clone();
        if let Some(wrong) = times.iter().find(|t| !(0.0..=1e6).contains(*t)) {
            return Err(anyhow!("--at {wrong}: expected a time from 0 to 1,000,000 s")).or_usage();
        }
        times.sort_by(f64::total_cmp);
        let (subject, set) = match &self.run {
            Some(dir) => {
                let settings = robogate_campaign::settings(dir).or_usage()?;
                let opening = self.environment.choice().reopening(self.trust.choice());
                (Subject::recorded(&settings.provenance, Some(dir), &opening)?, Assignment::default())
            }
            None => {
                let (environment, set) = self.environment.choice().environment_and_parameters()?;
                (Subject::new(environment, None)?, set)
            }
        };
        let subject = subject.with_pictures_of(size);
        let suite = self.suite.as_deref().map(suites::find).transpose()?;
        if let Some(suite) = &suite {
            subject.check_suite(suite).or_usage()?;
        }
        match &suite {
            Some(suite) if self.sheet => self.sheet(&subject, suite, &set, &times),
            _ => self.pictures(&subject, suite.as_ref(), &set, &times),
        }
    }

    /// Renders one scenario: one file for each camera and time.
    fn pictures(&self, subject: &Subject, suite: Option<&Suite>, set: &Assignment, times: &[f64]) -> Result<u8, Exit> {
        let (name, scenario) = self.scenario(suite, set)?;
        let folder = self.out.clone().unwrap_or_else(|| PathBuf::from("snapshots"));
        let mut worker = subject.worker().or_broken()?;
        let mut written = Vec::new();
        let reached = watch(&mut worker, &scenario, times, |time_s, images| {
            for image in images.into_iter().filter(|image| self.shows(image, None)) {
                let file = folder.join(format!("{name}-{time_s:.2}s-{}.png", image.camera));
                picture::write(&file, &image).or_usage()?;
                if !self.json {
                    line(foreign(file.display()));
                }
                written.push(json!({ "file": file, "camera": image.camera, "time_s": time_s }));
            }
            Ok(())
        })?;
        if let Some(later) = times.iter().find(|t| **t > reached + 1e-9) {
            note(format_args!("the episode ended at {reached:.2} s: there are no images of {later} s and later"));
        }
        if self.json {
            line(json!({ "version": 1, "scenario": name, "pictures": written }));
        }
        Ok(DONE)
    }

    /// Renders every scenario of a suite on one sheet.
    fn sheet(&self, subject: &Subject, suite: &Suite, set: &Assignment, times: &[f64]) -> Result<u8, Exit> {
        let [time] = times else {
            return Err(anyhow!("--sheet renders every scenario once: expected one time for --at")).or_usage();
        };
        let file = self.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.png", suite.name())));
        let mut worker = subject.worker().or_broken()?;
        let mut pictures = Vec::with_capacity(suite.cases().len());
        for (index, case) in (self.index.unwrap_or(0)..).zip(suite.cases()) {
            let scenario = with(suite.scenario(self.campaign(), index), set);
            // An episode that ends before this time is shown at its end.
            let mut last = None;
            watch(&mut worker, &scenario, &[*time], |_, images| {
                last = images.into_iter().find(|image| self.shows(image, Some(CAMERAS[0])));
                Ok(())
            })?;
            pictures.extend(last.map(|image| (case.id.clone(), image)));
        }
        picture::write(&file, &picture::sheet(&pictures, COLUMNS)).or_usage()?;
        if self.json {
            line(json!({ "version": 1, "suite": suite.name(), "file": file, "scenarios": pictures.len() }));
        } else {
            line(foreign(file.display()));
        }
        Ok(DONE)
    }

    fn shows(&self, image: &Image, default: Option<&str>) -> bool {
        self.camera.as_deref().or(default).is_none_or(|camera| image.camera == camera)
    }

    fn campaign(&self) -> Seed {
        Seed::campaign(self.seed.unwrap_or(DEFAULT_SEED))
    }

    /// The requested scenario, and its name in file names.
    fn scenario(&self, suite: Option<&Suite>, set: &Assignment) -> Result<(String, Scenario), Exit> {
        if let (Some(dir), Some(index)) = (&self.run, self.index) {
            let entry = recorded(dir, index).or_usage()?;
            return Ok((format!("episode-{index}"), entry.episode.scenario));
        }
        let index = self.index.unwrap_or(0);
        let Some(suite) = suite else {
            let scenario = Scenario { index, seed: self.campaign().episode(index), requested: Assignment::default() };
            return Ok((format!("scenario-{index}"), with(scenario, set)));
        };
        let index = match &self.case {
            None => index,
            Some(id) => match suite.cases().iter().position(|case| case.id == *id) {
                Some(place) => place as u64,
                None => {
                    let (suite, id) = (suite.name(), foreign(id));
                    let why = anyhow!("{suite} has no scenario `{id}`; robogate suites show {suite} lists them");
                    return Err(why).or_usage();
                }
            },
        };
        Ok((suite.case(index).id.clone(), with(suite.scenario(self.campaign(), index), set)))
    }
}

/// The scenario with these values of its parameters.
fn with(mut scenario: Scenario, set: &Assignment) -> Scenario {
    set.iter().for_each(|(name, value)| scenario.requested.set(name, value.clone()));
    scenario
}

/// Runs an episode and passes on the images at these times (ascending, in seconds). If the episode ends first, it
/// passes on the last images. Returns the time of the last images.
fn watch(
    worker: &mut Worker,
    scenario: &Scenario,
    times: &[f64],
    mut show: impl FnMut(f64, Vec<Image>) -> Result<(), Exit>,
) -> Result<f64, Exit> {
    let Worker { environment, policy } = worker;
    let task = Arc::clone(environment.task());
    let Start { instance, mut observation, .. } = environment.reset(scenario).or_usage()?;
    policy.reset(&task, &instance, scenario.seed).or_broken()?;
    let mut times = times.iter().peekable();
    let mut over = false;
    while let Some(next) = times.peek() {
        let now = observation.time_s;
        over = over || now >= task.time_limit_s - 1e-9;
        if now >= **next - 1e-9 || over {
            show(now, environment.render().or_usage()?)?;
            while times.next_if(|t| over || **t <= now + 1e-9).is_some() {}
            if over {
                return Ok(now);
            }
        } else {
            let step = policy.act(&observation).and_then(|action| environment.step(&action)).or_broken()?;
            over = step.ending.is_some();
            observation = step.observation;
        }
    }
    Ok(observation.time_s)
}
