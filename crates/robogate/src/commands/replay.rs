//! `robogate replay`: replays one episode bit for bit and prints its timeline.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use clap::Args;
use robogate_campaign::{WorkerFactory, recorded};
use robogate_core::{Environment, Episode, Outcome, TaskSpec, Tick, Word, rollout_with};
use robogate_dictionary::{Provenance, World};
use robogate_replay::{EncodedImage, Export, Recording, Sample, mcap, record_with};
use robogate_stats::format::number;
use serde_json::json;

use crate::arguments::{AccessArguments, EnvironmentArguments, TrustArguments};
use crate::commands::stills::{Pictures, Stills};
use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::film::{self, Cameras, Filmed, Shot};
use crate::picture;
use crate::terminal::{bold, dim, foreign, line, note};
use crate::watch;
use robogate_session::{PolicySource, Reopening, Subject};

/// Replay one episode bit for bit and print its timeline; or render moments of it, or of a scenario that has not run.
///
/// --set also sets parameters of the scenario (docs/reference/parameters.md).
#[derive(Debug, Args)]
pub(crate) struct Replay {
    /// Folder of the run
    #[arg(requires = "index", conflicts_with_all = ["suite", "scenario", "seed", "task", "set", "engine", "time_step", "renderer"])]
    dir: Option<PathBuf>,
    /// Index of the episode, as in the dictionary
    index: Option<u64>,
    /// Write an animation of a camera to this file (GIF)
    #[arg(long, value_name = "FILE", requires = "dir", conflicts_with = "at")]
    gif: Option<PathBuf>,
    /// Write a video of a camera to this file (MP4); the program `ffmpeg` encodes it
    #[arg(long, value_name = "FILE", requires = "dir", conflicts_with = "at")]
    mp4: Option<PathBuf>,
    /// Write six frames at equal distances in time to this file (PNG)
    #[arg(long, value_name = "FILE", requires = "dir", conflicts_with = "at")]
    png_strip: Option<PathBuf>,
    /// Write poses, joint states, commands, contacts, measures, events and camera images to this file for Foxglove and other
    /// tools (MCAP)
    #[arg(long, value_name = "FILE", requires = "dir", conflicts_with = "at")]
    mcap: Option<PathBuf>,
    /// Choose the camera of the images; default: the first one of the environment, in MCAP all of them
    #[arg(long, value_name = "CAMERA")]
    camera: Option<String>,
    /// Set width and height of the images, in pixels (16 to 2048), if the built-in cell renders them; default: 320, of moments
    /// 256, and 144 on a sheet
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u16).range(16..=2048))]
    size: Option<u16>,
    /// Use this policy for the run, which must be the recorded one: the address of its server, or its ONNX file. Only needed for a
    /// run that you did not make on this machine, or if the policy has another address now
    #[arg(long, visible_alias = "policy-at", value_name = "URL|FILE", requires = "dir")]
    policy: Option<String>,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    trust: TrustArguments,
    #[command(flatten)]
    access: AccessArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    stills: Stills,
}

/// An event with its time and phase.
struct Line {
    time_s: f64,
    phase: Option<Word>,
    what: String,
}

impl Replay {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let pictures =
            Pictures { stills: &self.stills, camera: self.camera.as_deref(), size: self.size, json: self.json };
        match (&self.dir, self.index) {
            (Some(dir), Some(index)) if self.stills.is_given() => pictures.of_episode(dir, index, &self.opening()),
            (Some(dir), Some(index)) => self.replay(dir, index),
            _ if self.stills.is_given() => {
                let (environment, set) = self.environment.choice().environment_and_parameters()?;
                pictures.of_scenario(Subject::new(environment, None)?, &set)
            }
            _ => Err(anyhow!(
                "which episode? Expected a run and the index of an episode\nHint: robogate replay RUN INDEX; a scenario that has not \
                 run is rendered with --suite or --scenario"
            ))
            .or_usage(),
        }
    }

    /// How the run is set up again.
    fn opening(&self) -> Reopening {
        let own = self.environment.choice().reopening(self.trust.choice());
        Reopening { policy: self.policy.clone(), access: self.access.choice(), ..own }
    }

    fn replay(&self, dir: &Path, index: u64) -> Result<u8, Exit> {
        /// Default width and height of images in animations, in pixels.
        const SIZE_PX: u16 = 320;
        let settings = robogate_campaign::settings(dir).or_usage()?;
        let subject = Subject::recorded(&settings.provenance, Some(dir), &self.opening())?;
        if self.mp4.is_some() {
            film::check_mp4().or_usage()?;
        }
        let pictures = self.gif.is_some() || self.mp4.is_some() || self.png_strip.is_some();
        // An environment without cameras still has poses and commands.
        let cameras = !subject.task().observation.cameras.is_empty();
        let filming = pictures || (self.mcap.is_some() && (cameras || self.camera.is_some()));
        // The size of images would change what a policy that sees them receives.
        let seeing = subject.policy_source().and_then(PolicySource::profile).is_some();
        let subject = if filming && !seeing {
            subject.with_pictures_of(usize::from(self.size.unwrap_or(SIZE_PX)))
        } else {
            subject
        };
        if let (true, Some(camera)) = (filming, &self.camera) {
            check_camera(subject.task(), camera)?;
        }
        let entry = recorded(dir, index).or_usage()?;
        let mut worker = subject.worker().or_broken()?;
        let mut timeline: Vec<Line> = Vec::new();
        let mut phase = None;
        let before = entry.episode;
        let mut observe = |tick: Tick<'_>| {
            let time_s = tick.step.observation.time_s;
            if tick.action.phase != phase {
                phase = tick.action.phase;
                timeline.push(Line { time_s, phase, what: "begins".to_owned() });
            }
            timeline.extend(tick.step.events.iter().map(|what| Line { time_s, phase, what: what.clone() }));
        };
        let again = if filming || self.mcap.is_some() {
            let filmed = &mut match (&self.camera, &self.mcap) {
                _ if !filming => Filmed::at(&mut *worker.environment, Cameras::First, &[]),
                (Some(camera), _) => Filmed::new(&mut *worker.environment, Cameras::Named(camera.clone())),
                (None, Some(_)) => Filmed::new(&mut *worker.environment, Cameras::All),
                (None, None) => Filmed::new(&mut *worker.environment, Cameras::First),
            };
            let episode = if let Some(file) = &self.mcap {
                let mut samples = Vec::new();
                let recording = record_with(filmed, &mut *worker.policy, &before.scenario, &mut |tick| {
                    samples.push(Sample::of(tick));
                    let Tick { observation, action, step } = *tick;
                    observe(Tick { observation, action, step });
                });
                self.write_mcap(file, &recording, &samples, filmed, &settings.provenance)?;
                recording.episode
            } else {
                rollout_with(filmed, &mut *worker.policy, &before.scenario, &mut observe)
            };
            self.write_images(filmed)?;
            episode
        } else {
            rollout_with(&mut *worker.environment, &mut *worker.policy, &before.scenario, &mut observe)
        };
        if let Some(fault) = watch::not_run(&before, &again) {
            return Err(anyhow!("episode {} cannot run again: {fault}", index)).or_broken();
        }
        let same = again.repeats(&before);
        if self.json {
            self.print_json(&again, &timeline, same);
        } else {
            self.print(dir, subject.task(), &again, &timeline);
            if same {
                line(format_args!(
                    "identical to the recorded episode, bit for bit (trajectory {:016x})",
                    again.trajectory_hash
                ));
            } else {
                line(bold("DIFFERS from the recorded episode"));
                line(format_args!("  recorded {}", describe(&before)));
                line(format_args!("  replayed {}", describe(&again)));
                if !subject.is_deterministic() {
                    line(
                        "  the environment is not deterministic: it does not repeat an episode of the same seed (see `robogate env inspect`)",
                    );
                }
                let was = &settings.provenance;
                if let Some(engine) = subject.many_worlds_engine() {
                    line(format_args!(
                        "  the run was made in many worlds at once ({engine}), and a replay runs in MuJoCo in this process: other bits"
                    ));
                    return Ok(INVALID);
                }
                let now = subject.provenance(was.space.clone())?;
                let maths =
                    matches!((&was.platform, &now.platform), (Some(was), Some(is)) if was.differs_in_maths_only(is));
                if maths {
                    line(
                        "  the mathematical functions of the C library differ from those of the run, which changes last bits",
                    );
                } else if (&now.tool, &now.build, &now.engine, &now.robot, &now.platform)
                    != (&was.tool, &was.build, &was.engine, &was.robot, &was.platform)
                {
                    line("  tool, build, engine, robot or platform differ from those of the run");
                }
                let world = |provenance: &Provenance| provenance.world.as_ref().map(World::without_packages);
                if world(&now) != world(was) {
                    line("  the policy differs: another file, or its server reports something else about itself");
                }
                let profile = subject.policy_source().and_then(PolicySource::profile);
                if profile.is_some_and(|profile| !profile.dialect.is_file()) {
                    line(
                        "  the policy is behind a server: if the server samples its actions, replays differ (see `robogate policy check`)",
                    );
                }
            }
        }
        Ok(if same { DONE } else { INVALID })
    }

    /// Writes the requested images.
    fn write_images(&self, filmed: &Filmed<'_>) -> Result<(), Exit> {
        rendered(filmed)?;
        let shots = filmed.of(self.camera.as_deref());
        type Writer = fn(&Path, &[&Shot]) -> anyhow::Result<()>;
        let files: [(&Option<PathBuf>, Writer); 3] =
            [(&self.gif, film::write_gif), (&self.mp4, film::write_mp4), (&self.png_strip, film::write_strip)];
        for (file, write) in files {
            if let Some(file) = file {
                write(file, &shots).or_unwritable()?;
                note(foreign(file.display()));
            }
        }
        Ok(())
    }

    /// Writes the episode as MCAP.
    fn write_mcap(
        &self,
        file: &Path,
        recording: &Recording,
        samples: &[Sample],
        filmed: &Filmed<'_>,
        provenance: &Provenance,
    ) -> Result<(), Exit> {
        rendered(filmed)?;
        let mut images = Vec::with_capacity(filmed.shots.len());
        for Shot { time_s, image } in &filmed.shots {
            let png = picture::png(image).or_broken()?;
            images.push(EncodedImage { time_s: *time_s, camera: image.camera.clone(), png });
        }
        let episode = &recording.episode;
        let mut metadata: Vec<(String, String)> = [
            ("episode", episode.scenario.index.to_string()),
            ("task", provenance.task.name.to_string()),
            ("robot", provenance.robot.name.to_string()),
            ("policy", provenance.policy.to_string()),
            ("outcome", episode.outcome.as_str().to_owned()),
            ("trajectory_hash", format!("{:016x}", episode.trajectory_hash)),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
        let requested = episode.scenario.requested.iter();
        metadata.extend(requested.map(|(name, value)| (format!("parameter.{name}"), value.to_string())));
        let task = filmed.task();
        picture::create(file, &mcap(&Export { task, recording, samples, images: &images, metadata }))
            .or_unwritable()?;
        note(foreign(file.display()));
        Ok(())
    }

    fn print(&self, dir: &Path, task: &TaskSpec, episode: &Episode, timeline: &[Line]) {
        line(bold(format_args!("Episode {} of {}", episode.scenario.index, dir.display())));
        for (name, requested) in episode.scenario.requested.iter() {
            line(format_args!("  {name:<14} {requested}"));
        }
        line("");
        let mut last = None;
        for Line { time_s, phase, what } in timeline {
            let word = phase.map_or("", Word::as_str);
            if last == Some(*phase) {
                line(format_args!("  {time_s:>6.2} s  {:<15} {what}", ""));
            } else if what == "begins" {
                line(format_args!("  {time_s:>6.2} s  {}", bold(format_args!("{word:<15}"))));
            } else {
                line(format_args!("  {time_s:>6.2} s  {word:<15} {what}"));
            }
            last = Some(*phase);
        }
        line("");
        line(format_args!("{}", bold(describe(episode))));
        if let Some(contact) = &episode.contact {
            line(format_args!("  {} touched {} with {:.1} N", contact.robot_body, contact.other_body, contact.force_n));
        }
        for measure in &task.measures {
            match episode.measures.get(measure.name.as_str()) {
                Some(x) => line(format_args!("  {:<22} {:>8} {}", measure.name, number(x), measure.unit)),
                None => line(format_args!("  {:<22} {:>8}", measure.name, dim("-"))),
            }
        }
    }

    fn print_json(&self, episode: &Episode, timeline: &[Line], same: bool) {
        let timeline: Vec<_> = timeline
            .iter()
            .map(|Line { time_s, phase, what }| json!({"time_s": time_s, "phase": phase, "what": what}))
            .collect();
        let requested: serde_json::Map<_, _> =
            episode.scenario.requested.iter().map(|(name, value)| (name.to_owned(), json!(value))).collect();
        line(json!({
            "version": 2,
            "index": episode.scenario.index,
            "requested": requested,
            "outcome": episode.outcome.as_str(),
            "time_s": episode.time_s,
            "phase": episode.phase,
            "contact": episode.contact,
            "measures": episode.measures,
            "ticks": episode.ticks,
            "trajectory_hash": format!("{:016x}", episode.trajectory_hash),
            "same_as_recorded": same,
            "timeline": timeline,
        }));
    }
}

/// Returns an error if the environment could not render.
fn rendered(filmed: &Filmed<'_>) -> Result<(), Exit> {
    match &filmed.trouble {
        Some(fault) => Err(anyhow!("the episode cannot be rendered: {fault}")).or_usage(),
        None => Ok(()),
    }
}

/// Rejects a camera that the environment does not declare.
fn check_camera(task: &TaskSpec, camera: &str) -> Result<(), Exit> {
    let known: Vec<&str> = task.observation.cameras.iter().map(|camera| camera.name.as_str()).collect();
    if known.contains(&camera) {
        return Ok(());
    }
    let expected = if known.is_empty() {
        "this environment has no cameras".to_owned()
    } else {
        format!("expected one of: {}", known.join(", "))
    };
    Err(anyhow!("--camera {}: unknown camera; {expected}", foreign(camera))).or_usage()
}

/// The end of an episode in one line.
fn describe(episode: &Episode) -> String {
    let phase = episode.phase.map_or_else(String::new, |phase| format!(" in {phase}"));
    match &episode.outcome {
        Outcome::Invalid(fault) => format!("invalid: {fault}"),
        outcome => format!("{} at {:.3} s{phase}", outcome.as_str(), episode.time_s),
    }
}
