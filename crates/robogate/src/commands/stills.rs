//! Pictures of moments: of an episode, or of a scenario that has not run.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::anyhow;
use clap::Args;
use robogate_camera::{CAMERAS, SIZE_PX};
use robogate_campaign::{DEFAULT_SEED, Worker, WorkerFactory, recorded};
use robogate_core::{Assignment, Image, Scenario, Seed, Start, Suite};
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit};
use crate::picture;
use crate::place;
use crate::terminal::{foreign, line, note};
use robogate_session::{Reopening, Subject, named_suite};

/// Default width and height of an image, in pixels.
const ON_SHEET_PX: usize = 144;
/// Images per row of a sheet.
const COLUMNS: usize = 10;

/// Which moments are rendered, of an episode or of a scenario that has not run.
#[derive(Debug, Args)]
#[command(next_help_heading = "Pictures of moments")]
pub(crate) struct Stills {
    /// Write the cameras' images of these simulated times, in seconds, as PNG files; separate several with commas. Without a
    /// run: of a scenario while the scripted controller works; default: 0
    #[arg(long, value_name = "SECONDS", value_delimiter = ',')]
    at: Vec<f64>,
    /// Render a scenario of this suite: a built-in one or a TOML file
    #[arg(long, value_name = "SUITE")]
    suite: Option<String>,
    /// Select the suite's scenario by its name; default: that of --scenario
    #[arg(long, value_name = "ID", requires = "suite", conflicts_with = "scenario")]
    case: Option<String>,
    /// Select the index of the suite's scenario (counted across rounds), or of the random draws of a scenario without a
    /// suite; default: 0
    #[arg(long, value_name = "I")]
    scenario: Option<u64>,
    /// Set the campaign seed of the scenario
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Render every scenario of the suite once, on one contact sheet
    #[arg(long, requires = "suite", conflicts_with = "case")]
    sheet: bool,
    /// Write the images to this path: a folder, or the file of a sheet; default: pictures, or SUITE.png
    #[arg(long, value_name = "PATH", value_parser = place::local())]
    out: Option<PathBuf>,
}

/// A request for pictures.
pub(crate) struct Pictures<'a> {
    pub(crate) stills: &'a Stills,
    /// The only camera.
    pub(crate) camera: Option<&'a str>,
    /// Width and height, in pixels.
    pub(crate) size: Option<u16>,
    pub(crate) json: bool,
}

impl Stills {
    /// Whether moments are wanted.
    pub(crate) fn is_given(&self) -> bool {
        !self.at.is_empty() || self.suite.is_some() || self.scenario.is_some()
    }
}

impl Pictures<'_> {
    /// Renders moments of an episode of a run.
    pub(crate) fn of_episode(&self, dir: &Path, index: u64, opening: &Reopening) -> Result<u8, Exit> {
        let settings = robogate_campaign::settings(dir).or_usage()?;
        let subject = Subject::recorded(&settings.provenance, Some(dir), opening)?;
        let subject = subject.with_pictures_of(self.size());
        let entry = recorded(dir, index).or_usage()?;
        self.write(&subject, &format!("episode-{index}"), &entry.episode.scenario, &self.times()?)
    }

    /// Renders a scenario that has not run, with these values of its parameters, or all scenarios of a suite.
    pub(crate) fn of_scenario(&self, subject: Subject, set: &Assignment) -> Result<u8, Exit> {
        let subject = subject.with_pictures_of(self.size());
        let times = self.times()?;
        let suite = self.stills.suite.as_deref().map(named_suite).transpose()?;
        if let Some(suite) = &suite {
            subject.check_suite(suite).or_usage()?;
        }
        match &suite {
            Some(suite) if self.stills.sheet => self.sheet(&subject, suite, set, &times),
            suite => {
                let (name, scenario) = self.scenario(suite.as_ref(), set)?;
                self.write(&subject, &name, &scenario, &times)
            }
        }
    }

    fn size(&self) -> usize {
        self.size.map_or(if self.stills.sheet { ON_SHEET_PX } else { SIZE_PX }, usize::from)
    }

    fn times(&self) -> Result<Vec<f64>, Exit> {
        let mut times = self.stills.at.clone();
        if let Some(wrong) = times.iter().find(|t| !(0.0..=1e6).contains(*t)) {
            return Err(anyhow!("--at {wrong}: expected a time from 0 to 1,000,000 s")).or_usage();
        }
        if times.is_empty() {
            times.push(0.0);
        }
        times.sort_by(f64::total_cmp);
        Ok(times)
    }

    /// Renders one scenario: one file for each camera and time.
    fn write(&self, subject: &Subject, name: &str, scenario: &Scenario, times: &[f64]) -> Result<u8, Exit> {
        let folder = self.stills.out.clone().unwrap_or_else(|| PathBuf::from("pictures"));
        let mut worker = subject.worker().or_broken()?;
        let mut written = Vec::new();
        let reached = watch(&mut worker, scenario, times, |time_s, images| {
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
        let file = self.stills.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.png", suite.name())));
        let mut worker = subject.worker().or_broken()?;
        let mut pictures = Vec::with_capacity(suite.cases().len());
        for (index, case) in (self.stills.scenario.unwrap_or(0)..).zip(suite.cases()) {
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
        self.camera.or(default).is_none_or(|camera| image.camera == camera)
    }

    fn campaign(&self) -> Seed {
        Seed::campaign(self.stills.seed.unwrap_or(DEFAULT_SEED))
    }

    /// The requested scenario, and its name in file names.
    fn scenario(&self, suite: Option<&Suite>, set: &Assignment) -> Result<(String, Scenario), Exit> {
        let index = self.stills.scenario.unwrap_or(0);
        let Some(suite) = suite else {
            let scenario = Scenario { index, seed: self.campaign().episode(index), requested: Assignment::default() };
            return Ok((format!("scenario-{index}"), with(scenario, set)));
        };
        let index = match &self.stills.case {
            None => index,
            Some(id) => match suite.cases().iter().position(|case| case.id == *id) {
                Some(place) => place as u64,
                None => {
                    let (suite, id) = (suite.name(), foreign(id));
                    let why = anyhow!("{suite} has no scenario `{id}`; robogate list suites {suite} lists them");
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
