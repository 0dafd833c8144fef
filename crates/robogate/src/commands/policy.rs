//! `robogate policy`: profiles of external policies, and checks of a policy before a run.

mod motion;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, anyhow};
use clap::{Args, Subcommand};
use robogate_core::{Environment, FaultKind, Image, Observation, TaskSpec};
use robogate_dictionary::files;
use robogate_policy::{
    BoundMap, Chunk, Decoder, Draft, ExternalPolicy, MapRow, PolicyError, Profile, Query, Servers, TaskMap, check_task,
    map_table, outside_range,
};
use serde_json::json;

use crate::arguments::{AccessArguments, EnvironmentArguments, StatisticsArguments};
use crate::commands::probe::{Probes, probe};
use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::interface;
use crate::terminal::{bold, foreign, line, note};
use motion::{check_actions, check_motion};
use robogate_session::{
    EnvironmentSource, ServerComparison, connect, nominal, picture_problems, policy_error, profile, task_map,
};

/// Check a policy.
#[derive(Debug, Args)]
pub(crate) struct Policies {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Check a policy server or an ONNX file against a profile and an environment: what the model expects and what the
    /// environment has, as a table; metadata, shapes, latency, determinism, size, direction and effect of the actions.
    /// Exit codes: 0 no problems, 1 problems found, 2 wrong usage or mismatch, 5 no answer
    Check(Box<Check>),
}

#[derive(Debug, Args)]
struct Check {
    /// Address of the server, such as ws://127.0.0.1:8000, or path of an ONNX file
    #[arg(value_name = "URL|FILE")]
    url: String,
    /// Choose the observation and action mapping of the policy: a built-in profile (robogate list profiles), or a
    /// TOML file
    #[arg(long, value_name = "NAME|FILE")]
    profile: String,
    /// Map the observations, cameras and actions of the environment to those of the profile with this TOML file
    /// (docs/guides/environments.md)
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Set the number of requests with the same observation (at least 2)
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..))]
    requests: u32,
    /// Draft a profile from what the server declares about its inputs and outputs (GR00T and RoboArena servers), and from
    /// --statistics, write it to this file, and check nothing. The rest is that of --profile
    #[arg(long = "out", alias = "write", value_name = "FILE", conflicts_with = "json")]
    write: Option<PathBuf>,
    #[command(flatten)]
    statistics: StatisticsArguments,
    #[command(flatten)]
    access: AccessArguments,
    #[command(flatten)]
    environment: EnvironmentArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Policies {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            What::Check(check) => check.execute(),
        }
    }
}

/// The error for a name that is not a built-in profile.
fn unknown_profile(name: &str) -> anyhow::Error {
    let known = Profile::built_in_names().collect::<Vec<_>>().join(", ");
    anyhow!("unknown profile `{name}`. Expected one of: {known}")
}

/// Prints the built-in profiles, or one of them as TOML.
pub(crate) fn profiles(name: Option<&str>, json: bool) -> Result<u8, Exit> {
    if let (Some(name), false) = (name, json) {
        let text = Profile::built_in(name).ok_or_else(|| unknown_profile(name)).or_usage()?;
        line(text.trim_end());
        return Ok(DONE);
    }
    let names = Profile::built_in_names().filter(|known| name.is_none_or(|name| name == *known));
    let profiles = names.map(profile).collect::<anyhow::Result<Vec<_>>>().or_broken()?;
    if let ([], Some(name)) = (&*profiles, name) {
        return Err(unknown_profile(name)).or_usage();
    }
    if json {
        line(json!({"version": 1, "profiles": profiles}));
        return Ok(DONE);
    }
    for p in &profiles {
        line(format_args!("{}  {}", bold(format_args!("{:<18}", p.name)), p.model));
        let cameras: Vec<&str> = p.cameras.iter().map(|camera| camera.from.as_str()).collect();
        line(format_args!(
            "{:<20}{} at {}, cameras {}, {} numbers per action, executes {} of {} actions",
            "",
            p.dialect.name(),
            p.dialect.address(),
            cameras.join(" and "),
            p.action.size,
            p.chunk.execute,
            p.chunk.length.map_or_else(|| "all".to_owned(), |n| n.to_string())
        ));
    }
    Ok(DONE)
}

/// Results of a check.
struct Findings {
    /// Names and values of properties.
    properties: Vec<(&'static str, String)>,
    /// What the model expects, and where the environment has it.
    mapping: Vec<MapRow>,
    /// The effect of each number of an action.
    probes: Probes,
    /// Descriptions of problems.
    problems: Vec<String>,
}

impl Check {
    fn execute(&self) -> Result<u8, Exit> {
        let profile = Arc::new(profile(&self.profile).or_usage()?);
        if let Some(path) = &self.write {
            return self.draft(&profile, path);
        }
        let map = self.map()?;
        let source = self.source(&profile)?;
        let task = source.task().or_broken()?;
        let mut found =
            Findings { properties: Vec::new(), mapping: Vec::new(), probes: Probes::default(), problems: Vec::new() };
        let mut policy = connect(&self.url, Arc::clone(&profile), self.access.choice().access()?)?;
        found.properties.push(("metadata", foreign(policy.declared())));
        if let Some(length) = policy.chunk_length().filter(|length| profile.chunk.length != Some(*length)) {
            found.properties.push(("declared length", format!("{length} actions in each reply")));
        }
        describe(&task, &mut found);
        if let Some(bound) = fit(&profile, map.as_deref(), &task, &mut found) {
            let mut environment = source.environment_for(&profile, map.as_deref()).or_broken()?;
            let profile = self.ranged(&profile, &bound, &mut *environment)?;
            let inferred = self.infer(&profile, &bound, &mut policy, &mut *environment, &mut found);
            // A server may have room for one client.
            drop(policy);
            match inferred {
                Ok(query) => self.compare_servers(&profile, query, task.control_period_s, &mut found)?,
                // These errors are results of the check.
                Err(
                    error @ (PolicyError::Shape(_)
                    | PolicyError::NotFinite { .. }
                    | PolicyError::InvalidReply { .. }
                    | PolicyError::Network { .. }
                    | PolicyError::Reported { .. }),
                ) => found.problems.push(error.to_string()),
                Err(error) => return Err(policy_error(error).into()),
            }
            if is_cell(&task) {
                check_motion(&profile, &mut *environment, &mut found)?;
            } else {
                if !profile.cameras.is_empty() {
                    let shown = picture_problems(&mut *environment, &nominal());
                    found
                        .problems
                        .extend(shown.unwrap_or_else(|fault| vec![format!("the cameras cannot be rendered: {fault}")]));
                }
                found.probes = probe(&profile, &bound, &mut *environment)?;
                found.problems.append(&mut found.probes.problems);
            }
        }
        if self.json {
            let properties: serde_json::Map<_, _> =
                found.properties.iter().map(|(name, value)| ((*name).to_owned(), json!(value))).collect();
            line(json!({
                "version": 2,
                "policy": self.url,
                "profile": profile.name,
                "properties": properties,
                "environment": task.name,
                "mapping": found.mapping,
                "probes": found.probes.probes,
                "environment_repeats": found.probes.repeats,
                "problems": found.problems,
            }));
        } else {
            line(bold(format_args!("{} with profile {}", self.url, profile.name)));
            found.properties.iter().for_each(|(name, value)| line(format_args!("  {name:<22} {value}")));
            print_mapping(&found.mapping);
            print_probes(&found.probes);
            for problem in &found.problems {
                line(format_args!("{} {}", bold("problem:"), foreign(problem)));
            }
            if found.problems.is_empty() {
                line("no problems found");
            }
        }
        Ok(if found.problems.is_empty() { DONE } else { FAIL })
    }

    fn map(&self) -> Result<Option<Arc<TaskMap>>, Exit> {
        self.map.as_deref().map(task_map).transpose().or_usage()
    }

    /// The environment with the pictures of the profile.
    fn source(&self, profile: &Profile) -> Result<EnvironmentSource, Exit> {
        let source = self.environment.choice().environment()?;
        Ok(profile.rendered_px.into_iter().fold(source, EnvironmentSource::with_pictures_of))
    }

    /// The profile with the ranges of --statistics.
    fn ranged(&self, profile: &Profile, bound: &BoundMap, environment: &mut dyn Environment) -> Result<Profile, Exit> {
        if !self.statistics.choice().is_given() {
            return Ok(profile.clone());
        }
        let start = environment.reset(&nominal()).or_broken()?;
        Ok(self.statistics.choice().add_to(profile, &bound.observation(&start.observation).or_broken()?)?)
    }

    /// [`Self::ranged`], in an environment of its own.
    fn ranged_draft(&self, profile: &Profile) -> Result<Profile, Exit> {
        let (map, source) = (self.map()?, self.source(profile)?);
        let (none, task) = (TaskMap::default(), source.task().or_broken()?);
        let bound = BoundMap::new(map.as_deref().unwrap_or(&none), profile, &task);
        let bound = bound.map_err(|why| anyhow!("the map does not fit: {why}")).or_usage()?;
        self.ranged(profile, &bound, &mut *source.environment_for(profile, map.as_deref()).or_broken()?)
    }

    /// Drafts a profile from the metadata of the server and the statistics of the checkpoint.
    fn draft(&self, base: &Profile, path: &Path) -> Result<u8, Exit> {
        if path.exists() {
            return Err(anyhow!("{}: the file exists\nHint: choose another name", path.display())).or_usage();
        }
        let drafted = if base.dialect.declares_modalities() || !self.statistics.choice().is_given() {
            robogate_policy::draft(&self.url, base).map_err(policy_error)?
        } else {
            Draft::of(base)
        };
        let Draft { profile, open } = drafted;
        let profile = match self.statistics.choice().is_given() {
            true => self.ranged_draft(&profile)?,
            false => profile,
        };
        let text = toml::to_string_pretty(&profile).or_broken()?;
        files::write(path, text).with_context(|| format!("cannot write {}", path.display())).or_broken()?;
        for text in &open {
            line(format_args!("open: {}", foreign(text)));
        }
        line(format_args!("{}: a draft of a profile. Check it, and then the server:", path.display()));
        line(format_args!("  robogate policy check {} --profile {}", self.url, path.display()));
        Ok(DONE)
    }

    fn requests(&self) -> u32 {
        self.requests
    }

    /// Send the same observation several times: shape, latency, determinism, size and sign of the actions.
    fn infer(
        &self,
        profile: &Profile,
        bound: &BoundMap,
        policy: &mut ExternalPolicy,
        environment: &mut dyn Environment,
        found: &mut Findings,
    ) -> Result<Query, PolicyError> {
        let cannot = |why: String| PolicyError::Observation(why);
        let start = environment.reset(&nominal()).map_err(|fault| cannot(fault.to_string()))?;
        let mut observation = start.observation;
        let mut replaced = None;
        if !profile.cameras.is_empty() {
            match environment.render() {
                Ok(images) => observation.images = images,
                Err(fault) if fault.kind == FaultKind::Setup => {
                    note(format_args!("note: the images are grey, because the cameras cannot be rendered: {fault}"));
                    replaced = Some(grey(profile));
                }
                Err(fault) => return Err(cannot(fault.to_string())),
            }
        }
        let mut observation = bound.observation(&observation).map_err(|fault| cannot(fault.to_string()))?;
        observation.images.extend(replaced.into_iter().flatten());
        let ranges: usize = profile.states.iter().map(|state| state.low.len()).sum();
        let outside = outside_range(profile, &observation)?;
        if ranges > 0 {
            let inside = ranges - outside.len();
            found
                .properties
                .push(("published ranges", format!("{inside} of {ranges} numbers of the state are inside")));
        }
        found.problems.extend(outside);
        policy.begin(&start.instance.instruction)?;
        let (first, first_s) = timed(policy, &observation)?;
        let mut later = Vec::new();
        let mut different = 0;
        for _ in 1..self.requests() {
            policy.begin(&start.instance.instruction)?;
            let (chunk, seconds) = timed(policy, &observation)?;
            different += u32::from(chunk != first);
            later.push(seconds);
        }
        later.sort_by(f64::total_cmp);
        let (rows, size) = (first.rows().len(), profile.action.size);
        found.properties.push(("actions", format!("{rows} actions of {size} numbers")));
        let median = later[later.len() / 2];
        let longest = later.last().copied().unwrap_or_default();
        found.properties.push((
            "latency",
            format!(
                "first {:.1} ms, then {:.1} ms (median), {:.1} ms (maximum)",
                1e3 * first_s,
                1e3 * median,
                1e3 * longest
            ),
        ));
        found.properties.push((
            "deterministic",
            if different == 0 {
                "yes: the same observation gives the same actions".to_owned()
            } else {
                format!(
                    "no: {different} of {} replies to the same observation differ, so replays will differ too",
                    self.requests() - 1
                )
            },
        ));
        found.properties.extend(history(profile).map(|text| ("history", text)));
        if !profile.memories.is_empty() {
            policy.begin(&start.instance.instruction)?;
            let repeated = [policy.infer(&observation)?, policy.infer(&observation)?];
            found.properties.push(("memory", memory(profile, &repeated)));
        }
        check_actions(profile, &first, &observation, is_cell(bound.task()), found);
        in_environment(profile, bound, &first, &observation, found)?;
        Query::new(profile, &observation, &start.instance.instruction, 0)
    }

    /// Sends a request to all servers of a list and compares their answers.
    fn compare_servers(
        &self,
        profile: &Profile,
        query: Query,
        control_period_s: f64,
        found: &mut Findings,
    ) -> Result<(), Exit> {
        let servers = Servers::of(&self.url);
        if servers.urls().len() > 1 {
            let (profile, access) = (Arc::new(profile.clone()), self.access.choice().access()?);
            let compared = ServerComparison::of(&servers, &profile, &access, vec![query], control_period_s)?;
            found.properties.push(("servers", compared.line()));
            found.problems.extend(compared.difference);
        }
        Ok(())
    }
}

/// Whether the task takes motions of an arm, as the built-in cell does. Any other one takes a vector.
fn is_cell(task: &TaskSpec) -> bool {
    task.action.tool_delta().is_some() || task.action.joints().is_some()
}

/// What the environment observes and takes.
fn describe(task: &TaskSpec, found: &mut Findings) {
    found.properties.push(("environment", format!("{}, {:.4} s per action", task.name, task.control_period_s)));
    found.properties.push(("  observes", interface::observes(task)));
    found.properties.push(("  cameras", interface::cameras(task)));
    found.properties.push(("  takes", interface::takes(task)));
}

/// The map that fits, with its table. `None` if the environment lacks something, which is a problem.
fn fit(profile: &Profile, map: Option<&TaskMap>, task: &TaskSpec, found: &mut Findings) -> Option<BoundMap> {
    const HINT: &str = "--map FILE maps the environment to the profile (docs/guides/environments.md)";
    let none = TaskMap::default();
    let bound = match BoundMap::new(map.unwrap_or(&none), profile, task) {
        Ok(bound) => bound,
        Err(why) => {
            found.problems.push(format!("the map does not fit: {why}"));
            return None;
        }
    };
    match map_table(profile, map, task) {
        Ok(rows) => found.mapping = rows,
        Err(why) => found.problems.push(why),
    }
    if let Err(why) = check_task(profile, bound.task()) {
        let hint = if map.is_none() && !is_cell(task) { format!(". Hint: {HINT}") } else { String::new() };
        found.problems.push(format!("{why}{hint}"));
        return None;
    }
    Some(bound)
}

fn print_mapping(rows: &[MapRow]) {
    if rows.is_empty() {
        return;
    }
    let width = |of: fn(&MapRow) -> &str, head: &str| {
        rows.iter().map(|row| of(row).chars().count()).chain([head.len()]).max().unwrap_or(0)
    };
    let (model, profile) = (width(|row| &row.model, "model"), width(|row| &row.profile, "profile"));
    line(bold(format_args!("  {:<6} {:<model$}  {:<profile$}  environment", "", "model", "profile")));
    for row in rows {
        line(format_args!("  {:<6} {:<model$}  {:<profile$}  {}", row.kind, row.model, row.profile, row.environment));
    }
}

fn print_probes(found: &Probes) {
    if found.probes.is_empty() {
        return;
    }
    line(bold(format_args!("  {:<6} {:>8}  changes after 10 control periods", "number", "by")));
    for probe in &found.probes {
        line(format_args!("  {:<6} {:>8.3}  {}", probe.number, probe.by, probe.moves));
    }
    if let Some(repeats) = found.repeats {
        let text = if repeats { "yes: an episode repeats exactly" } else { "no: the same actions give other states" };
        line(format_args!("  {:<22} {text}", "environment repeats"));
    }
}

/// The range of each number of the environment's action that the chunk becomes.
fn in_environment(
    profile: &Profile,
    bound: &BoundMap,
    chunk: &Chunk,
    observation: &Observation,
    found: &mut Findings,
) -> Result<(), PolicyError> {
    let mut decoder = Decoder::new(profile);
    decoder.begin(bound.task())?;
    let mut ranges: Vec<(f64, f64)> = Vec::new();
    for row in chunk.rows() {
        decoder.put(row.clone());
        while !decoder.is_empty() {
            let robogate_core::Command::Vector(numbers) = bound.action(decoder.next(observation)?).command else {
                return Ok(());
            };
            ranges.resize(numbers.len(), (f64::INFINITY, f64::NEG_INFINITY));
            ranges.iter_mut().zip(numbers).for_each(|(range, n)| *range = (range.0.min(n), range.1.max(n)));
        }
    }
    let texts: Vec<String> = ranges.iter().map(|(low, high)| format!("{low:.3} to {high:.3}")).collect();
    found.properties.push(("in the environment", texts.join(", ")));
    Ok(())
}

/// The earlier observations that the model sees, as offsets in actions.
fn history(profile: &Profile) -> Option<String> {
    let cameras = profile.cameras.iter().map(|camera| (&camera.key, &camera.history));
    let states = profile.states.iter().map(|state| (&state.key, &state.history));
    let described = cameras.chain(states).filter(|(_, offsets)| !offsets.is_empty()).map(|(key, offsets)| {
        let offsets: Vec<String> = offsets.iter().map(ToString::to_string).collect();
        format!("{key}: {}", offsets.join(", "))
    });
    let described: Vec<String> = described.collect();
    (!described.is_empty()).then(|| format!("{} (in actions; the first observation repeats)", described.join("; ")))
}

/// The memory of a recurrent network, and its effect on the second of two requests with the same observation.
fn memory(profile: &Profile, replies: &[Chunk; 2]) -> String {
    let pairs: Vec<String> =
        profile.memories.iter().map(|memory| format!("{} is fed by {}", memory.input, memory.output)).collect();
    let [first, second] = replies.each_ref().map(|chunk| chunk.rows().concat());
    let change = first.iter().zip(&second).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let pairs = pairs.join(", ");
    format!("{pairs}; zero at the start of each episode; changes the second reply by up to {change:.4}")
}

/// Grey images for the cameras of the profile.
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

fn timed(policy: &mut ExternalPolicy, observation: &Observation) -> Result<(Chunk, f64), PolicyError> {
    let start = Instant::now();
    let chunk = policy.infer(observation)?;
    Ok((chunk, start.elapsed().as_secs_f64()))
}
