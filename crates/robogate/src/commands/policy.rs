//! `robogate policy`: profiles of policy servers, and a look at a server before anything is judged.

use std::sync::Arc;
use std::time::Instant;

use anyhow::anyhow;
use clap::{Args, Subcommand};
use robogate_campaign::{Worker, WorkerFactory};
use robogate_core::{Action, Assignment, Environment, FaultKind, Image, Observation, Scenario, Seed};
use robogate_physics::SuctionLaw;
use robogate_policy::{Arm, Chunk, Profile, ServerError, ServerPolicy, Side};
use serde_json::json;

use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::policy_source::{profile, refused};
use crate::subject::{EnvironmentArguments, Subject};
use crate::terminal::{bold, foreign, line, note};

/// List the profiles of policies, or probe one.
#[derive(Debug, Args)]
pub(crate) struct Policies {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// List the built-in profiles, or show one as the start of your own
    Profiles {
        /// Print this profile (TOML)
        name: Option<String>,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Probe a policy server or an ONNX file: what it says of itself, shapes, repeatability, latency, and whether its actions mean what the
    /// profile says; exit code 1 if something looks wrong
    Check(Box<Check>),
}

#[derive(Debug, Args)]
struct Check {
    /// The server's address, such as ws://127.0.0.1:8000, or an ONNX file
    url: String,
    /// What its model sees and how its answers are meant: a built-in profile, or a file of your own (TOML)
    #[arg(long, value_name = "NAME|FILE")]
    profile: String,
    /// How often the same question is asked
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..))]
    questions: u32,
    #[command(flatten)]
    environment: EnvironmentArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Policies {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            What::Profiles { name: Some(name), json: false } => {
                let text = Profile::built_in(name).ok_or_else(|| anyhow!("there is no profile `{name}`")).or_usage()?;
                line(text.trim_end());
                Ok(DONE)
            }
            What::Profiles { name, json } => profiles(name.as_deref(), *json),
            What::Check(check) => check.execute(),
        }
    }
}

fn profiles(name: Option<&str>, json: bool) -> Result<u8, Exit> {
    let names = Profile::built_in_names().filter(|known| name.is_none_or(|name| name == *known));
    let profiles = names.map(profile).collect::<anyhow::Result<Vec<_>>>().or_broken()?;
    if let ([], Some(name)) = (&*profiles, name) {
        return Err(anyhow!("there is no profile `{name}`")).or_usage();
    }
    if json {
        line(json!({"version": 1, "profiles": profiles}));
        return Ok(DONE);
    }
    for p in &profiles {
        line(format_args!("{}  {}", bold(format_args!("{:<18}", p.name)), p.model));
        let cameras: Vec<&str> = p.cameras.iter().map(|camera| camera.from.as_str()).collect();
        line(format_args!(
            "{:<20}{} at {}, cameras {}, {} numbers, executes {} of {}",
            "",
            p.dialect.name(),
            p.dialect.address(),
            cameras.join(" and "),
            p.action.size,
            p.chunk.execute,
            p.chunk.length.map_or_else(|| "as many as come".to_owned(), |n| n.to_string())
        ));
    }
    Ok(DONE)
}

/// What a probe found.
struct Findings {
    figures: Vec<(&'static str, String)>,
    complaints: Vec<String>,
}

impl Check {
    fn execute(&self) -> Result<u8, Exit> {
        let profile = Arc::new(profile(&self.profile).or_usage()?);
        let subject = Subject::new(self.environment.environment(SuctionLaw::Vacuum)?, None)?;
        let subject = profile.rendered_px.into_iter().fold(subject, Subject::with_pictures_of);
        let mut found = Findings { figures: Vec::new(), complaints: Vec::new() };
        let mut policy = ServerPolicy::connect(&self.url, Arc::clone(&profile)).map_err(refused)?;
        found.figures.push(("says of itself", foreign(policy.declared())));
        let mut worker = subject.worker().or_broken()?;
        match self.ask(&profile, &mut policy, &mut worker, &mut found) {
            Ok(()) => {}
            // What the server cannot do is what was asked.
            Err(error @ (ServerError::Shape(_) | ServerError::NotFinite { .. } | ServerError::Refused { .. })) => {
                found.complaints.push(error.to_string());
            }
            Err(error) => return Err(refused(error)),
        }
        moves(&profile, &mut *worker.environment, &mut found)?;
        if self.json {
            let figures: serde_json::Map<_, _> =
                found.figures.iter().map(|(name, value)| ((*name).to_owned(), json!(value))).collect();
            line(json!({
                "version": 1,
                "server": self.url,
                "profile": profile.name,
                "figures": figures,
                "looks_wrong": found.complaints,
            }));
        } else {
            line(bold(format_args!("{} as {}", self.url, profile.name)));
            found.figures.iter().for_each(|(name, value)| line(format_args!("  {name:<22} {value}")));
            for complaint in &found.complaints {
                line(format_args!("{} {}", bold("looks wrong:"), foreign(complaint)));
            }
            if found.complaints.is_empty() {
                line("nothing looks wrong");
            }
        }
        Ok(if found.complaints.is_empty() { DONE } else { FAIL })
    }

    /// The same question again and again: shapes, time, repeatability, size and sign of the answers.
    fn ask(
        &self,
        profile: &Profile,
        policy: &mut ServerPolicy,
        worker: &mut Worker,
        found: &mut Findings,
    ) -> Result<(), ServerError> {
        let cannot = |why: String| ServerError::Observation(why);
        let start = worker.environment.reset(&nominal()).map_err(|fault| cannot(fault.to_string()))?;
        let mut observation = start.observation;
        if !profile.cameras.is_empty() {
            observation.images = match worker.environment.render() {
                Ok(images) => images,
                Err(fault) if fault.kind == FaultKind::Setup => {
                    note(format_args!("the pictures are grey: {fault}"));
                    grey(profile)
                }
                Err(fault) => return Err(cannot(fault.to_string())),
            };
        }
        policy.begin(&start.instance.instruction)?;
        let (first, first_s) = timed(policy, &observation)?;
        let mut later = Vec::new();
        let mut different = 0;
        for _ in 1..self.questions {
            policy.begin(&start.instance.instruction)?;
            let (chunk, seconds) = timed(policy, &observation)?;
            different += u32::from(chunk != first);
            later.push(seconds);
        }
        later.sort_by(f64::total_cmp);
        let (rows, size) = (first.rows().len(), profile.action.size);
        found.figures.push(("answers", format!("{rows} actions of {size} numbers")));
        let median = later[later.len() / 2];
        let longest = later.last().copied().unwrap_or_default();
        found.figures.push((
            "latency",
            format!(
                "{:.1} ms at first, then {:.1} ms (median), {:.1} ms at most",
                1e3 * first_s,
                1e3 * median,
                1e3 * longest
            ),
        ));
        found.figures.push((
            "repeatable",
            if different == 0 {
                "the same question gets the same answer".to_owned()
            } else {
                format!(
                    "no: {different} of {} answers to the same question differ; replays will too",
                    self.questions - 1
                )
            },
        ));
        meaning(profile, &first, &observation, found);
        Ok(())
    }
}

/// What is to be seen in the numbers of an answer to an open gripper that is far above the object.
fn meaning(profile: &Profile, chunk: &Chunk, observation: &Observation, found: &mut Findings) {
    let form = &profile.action;
    let arms = || chunk.rows().iter().filter_map(|row| row.split_last());
    let largest = arms().flat_map(|(_, arm)| arm).fold(0.0_f64, |largest, n| largest.max(n.abs()));
    found.figures.push(("largest arm number", format!("{largest:.4}")));
    if form.arm != Arm::JointPositions {
        if largest == 0.0 {
            found.complaints.push("every number for the arm is zero: it would never move".to_owned());
        } else if largest * form.position_scale_m < 1e-4 && form.arm == Arm::ToolDelta {
            found.complaints.push(format!(
                "the largest number for the arm is {largest:.4}: with action.position_scale_m = {} it moves less than 0.1 mm a \
                 step; does the model answer in metres (a scale of 1)?",
                form.position_scale_m
            ));
        } else if form.clip.is_some_and(|clip| largest > 10.0 * clip) {
            found.complaints.push(format!(
                "the largest number for the arm is {largest:.1}, ten times what action.clip leaves of it: is this the right scale?"
            ));
        }
    }
    let grippers: Vec<f64> = arms().map(|(gripper, _)| *gripper).collect();
    let low = grippers.iter().copied().fold(f64::INFINITY, f64::min);
    let high = grippers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let Some(threshold) = form.gripper_threshold else { return };
    found.figures.push(("gripper numbers", format!("{low:.3} to {high:.3}, threshold {threshold}")));
    let joints = observation.joint_positions();
    let first = chunk.rows().first().map(|row| form.action(row, joints));
    if matches!(&first, Some(Ok(action)) if action.gripper == Some(Action::CLOSE)) {
        found.complaints.push(format!(
            "with the gripper open and far from the object the first action closes it ({}): is action.gripper_open the right \
             side of action.gripper_threshold = {threshold}?",
            grippers.first().copied().unwrap_or_default(),
        ));
    }
    if let Some(Err(error)) = first {
        found.complaints.push(error.to_string());
    }
}

/// Whether the profile's actions do in this cell what they say: each way along its axis, open opens, close closes.
fn moves(profile: &Profile, environment: &mut dyn Environment, found: &mut Findings) -> Result<(), Exit> {
    const TICKS: u32 = 10;
    let form = &profile.action;
    let (Some(threshold), Some(side)) = (form.gripper_threshold, form.gripper_open) else { return Ok(()) };
    let (open, close) = match side {
        Side::Above => (threshold + 1.0, threshold - 1.0),
        Side::Below => (threshold - 1.0, threshold + 1.0),
    };
    let mut run = |arm: &dyn Fn(&Observation) -> Vec<f64>, gripper: f64, ticks: u32| -> Result<_, Exit> {
        let before = environment.reset(&nominal()).or_broken()?.observation;
        let mut after = before.clone();
        for _ in 0..ticks {
            let mut raw = arm(&before);
            raw.push(gripper);
            let action = form.action(&raw, after.joint_positions()).map_err(refused)?;
            let step = environment.step(&action).or_broken()?;
            after = step.observation;
            // Closing on nothing ends an episode.
            if step.ending.is_some() {
                break;
            }
        }
        Ok((before, after))
    };
    if form.arm == Arm::ToolDelta {
        for (axis, name) in
            ["+x moves the tool by", "+y moves the tool by", "+z moves the tool by"].into_iter().enumerate()
        {
            let one = |_: &Observation| (0..6).map(|i| f64::from(i == axis)).collect();
            let (before, after) = run(&one, open, TICKS)?;
            let way: Vec<f64> = position(&after).iter().zip(position(&before)).map(|(a, b)| a - b).collect();
            let told = f64::from(TICKS) * form.clip.unwrap_or(1.0).min(1.0) * form.position_scale_m;
            let mm: Vec<String> = way.iter().map(|m| format!("{:+.1}", 1e3 * m)).collect();
            found.figures.push((name, format!("{} mm in {TICKS} steps, told {:.1}", mm.join(", "), 1e3 * told)));
            let aside = way.iter().enumerate().filter(|(i, _)| *i != axis).map(|(_, m)| m.abs()).fold(0.0, f64::max);
            if way[axis] <= 0.0 || aside > way[axis] {
                found
                    .complaints
                    .push(format!("an action along {} does not move the tool that way", ["+x", "+y", "+z"][axis]));
            }
        }
    }
    let hold = |observation: &Observation| match form.arm {
        Arm::JointPositions => observation.joint_positions().to_vec(),
        _ => vec![0.0; form.size - 1],
    };
    let opening = Observation::gripper_opening_m;
    if let (Some(opened), Some(closed)) = (opening(&run(&hold, open, 40)?.1), opening(&run(&hold, close, 40)?.1)) {
        found.figures.push((
            "gripper opens to",
            format!("{:.1} mm at {open}, closes to {:.1} mm at {close}", 1e3 * opened, 1e3 * closed),
        ));
        if opened <= closed {
            found.complaints.push("what the profile calls open does not open the gripper".to_owned());
        }
    }
    Ok(())
}

/// Where the tool is, in metres.
fn position(observation: &Observation) -> [f64; 3] {
    observation.tool_pose().map_or([f64::NAN; 3], |pose| pose.position)
}

fn nominal() -> Scenario {
    Scenario { index: 0, seed: Seed::campaign(0).episode(0), requested: Assignment::default() }
}

/// Pictures without anything to see.
fn grey(profile: &Profile) -> Vec<Image> {
    let mut images: Vec<Image> = Vec::new();
    for camera in &profile.cameras {
        if images.iter().all(|image| image.camera != camera.from) {
            let (width, height) = (256, 256);
            images.push(Image { camera: camera.from.clone(), width, height, rgb: vec![128; 3 * width * height] });
        }
    }
    images
}

fn timed(policy: &mut ServerPolicy, observation: &Observation) -> Result<(Chunk, f64), ServerError> {
    let start = Instant::now();
    let chunk = policy.ask(observation)?;
    Ok((chunk, start.elapsed().as_secs_f64()))
}
