//! `robogate export`: writes a dictionary in another format.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};
use robogate_campaign::WorkerFactory;
use robogate_core::latency::{Execution, with_declarations};
use robogate_core::{DrawSpec, Foresight, Measures, Scenario, TaskSpec};
use robogate_dictionary::export::{Format, write_file, write_to};
use robogate_dictionary::{Dictionary, DictionaryError, Entry, Provenance, write_parquet};
use robogate_stats::format::counted;

use crate::arguments::TrustArguments;
use crate::exit::{DONE, Exit, OrExit};
use crate::place;
use crate::terminal::note;
#[cfg(feature = "mujoco")]
use robogate_session::EnvironmentChoice;
use robogate_session::text::quoted;
use robogate_session::{Reopening, Subject, starts_processes};

/// Write a failure dictionary as CSV, JSON Lines, the published JSON or Parquet, or the scene of an episode as MJCF.
#[derive(Debug, Args)]
pub(crate) struct Export {
    /// Folder of a run, or a dictionary (Parquet)
    dictionary: PathBuf,
    /// File to write; its extension selects the format unless --format is given. `-` writes to standard output (CSV by
    /// default)
    #[arg(value_parser = place::local())]
    out: PathBuf,
    /// Choose the format
    #[arg(long, conflicts_with = "mjcf")]
    format: Option<To>,
    /// Write the scene of the episode with this index for plain MuJoCo, into a new folder: the MJCF with its meshes, the inputs of each
    /// step, and a script that plays them
    #[arg(long, value_name = "INDEX")]
    mjcf: Option<u64>,
    #[command(flatten)]
    trust: TrustArguments,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum To {
    /// RFC 4180 (.csv)
    Csv,
    /// One object per row (.jsonl, .ndjson)
    Jsonl,
    /// The schema of the dictionaries released with the paper (.json)
    Published,
    /// A dictionary of this version (.parquet). The hidden draws of an older run of a built-in task are computed again
    /// from its seed
    Parquet,
}

impl Export {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if let Some(index) = self.mjcf {
            return self.scene(index);
        }
        let standard_output = self.out.as_os_str() == "-";
        let to = match self.format.or_else(|| by_ending(&self.out)) {
            None if standard_output => To::Csv,
            Some(to) => to,
            None => {
                let why = anyhow::anyhow!(
                    "{}: unknown file extension. Expected .csv, .jsonl, .json or .parquet, or choose the format with --format",
                    self.out.display()
                );
                return Err(why).or_usage();
            }
        };
        if !standard_output {
            require_absent(&self.out)?;
        }
        let dictionary = open(&self.dictionary)?;
        let format = match to {
            To::Parquet if standard_output => {
                return Err(anyhow::anyhow!("Parquet cannot be written to standard output\nHint: name a file"))
                    .or_usage();
            }
            To::Parquet => return self.parquet(&dictionary, Some(&*self.dictionary).filter(|path| path.is_dir())),
            To::Csv => Format::Csv,
            To::Jsonl => Format::JsonLines,
            To::Published => Format::Published,
        };
        if standard_output {
            return match write_to(&dictionary, format, io::stdout().lock()) {
                // The reader, for example `head`, has seen enough.
                Err(DictionaryError::Io { source, .. }) if source.kind() == io::ErrorKind::BrokenPipe => Ok(DONE),
                written => written.map(|_| DONE).or_broken(),
            };
        }
        let rows = write_file(&dictionary, format, &self.out).or_broken()?;
        note(format_args!("{}: {}", self.out.display(), counted(rows, "row")));
        Ok(DONE)
    }
}

impl Export {
    /// Writes the scene of an episode.
    #[cfg(feature = "mujoco")]
    fn scene(&self, index: u64) -> Result<u8, Exit> {
        if self.out.as_os_str() == "-" {
            return Err(anyhow::anyhow!(
                "a scene has several files and cannot be written to standard output\nHint: name a folder"
            ))
            .or_usage();
        }
        require_absent(&self.out)?;
        let settings = robogate_campaign::settings(&self.dictionary).or_usage()?;
        let opening = EnvironmentChoice::default().reopening(self.trust.choice());
        let subject = Subject::recorded(&settings.provenance, Some(&self.dictionary), &opening)?;
        let recorded = robogate_campaign::recorded(&self.dictionary, index).or_usage()?.episode;
        let written = subject.write_scene(&recorded, &self.out)?;
        if !written.repeats {
            note("note: the episode differs from the recorded one: see `robogate replay`");
        }
        let out = &self.out;
        note(format_args!("{}: scene.xml and {}", out.display(), counted(written.steps as u64, "time step")));
        note(format_args!("next: python {}", quoted(&out.join("play.py"))));
        Ok(DONE)
    }

    #[cfg(not(feature = "mujoco"))]
    fn scene(&self, _: u64) -> Result<u8, Exit> {
        let TrustArguments { .. } = &self.trust;
        Err(anyhow::anyhow!("--mjcf needs MuJoCo, which this build does not have")).or_usage()
    }

    /// Writes a dictionary of this version, with the draws of every episode as far as this build knows them.
    fn parquet(&self, dictionary: &Dictionary, folder: Option<&Path>) -> Result<u8, Exit> {
        let recorded = dictionary.provenance();
        let Draws { specs, compute } = Draws::of(recorded, folder);
        let declared = |spec: &DrawSpec| recorded.task.draws.iter().any(|known| known.name == spec.name);
        let complete = specs.iter().all(declared);
        let mut provenance = recorded.clone();
        provenance.task = Arc::new(TaskSpec { draws: specs, ..(*recorded.task).clone() });
        let with_draws = |entry: Result<Entry, DictionaryError>| {
            let mut entry = entry?;
            let episode = &mut entry.episode;
            // An episode that could not be set up has no draws.
            if !episode.applied.is_empty() && (episode.draws.is_empty() || !complete) {
                for (name, value) in compute(&episode.scenario).iter() {
                    // What the run recorded stays.
                    if episode.draws.get(name.as_str()).is_none() {
                        episode.draws.set(name, Some(value));
                    }
                }
            }
            Ok(entry)
        };
        let written = write_parquet(&self.out, &provenance, dictionary.entries().map(with_draws)).or_broken()?;
        note(format_args!("{}: {}", self.out.display(), counted(written.rows, "row")));
        Ok(DONE)
    }
}

/// The hidden draws of the episodes of a run.
struct Draws {
    /// Their declarations: those of this build, or else those that the run recorded.
    specs: Vec<DrawSpec>,
    /// Computes the draws of an episode that an older run did not record.
    compute: Box<dyn Fn(&Scenario) -> Measures>,
}

impl Draws {
    /// The draws of a run, with those of its task if the task is built into this version.
    fn of(provenance: &Provenance, folder: Option<&Path>) -> Self {
        let why = match knowledge(provenance, folder) {
            Ok((task, foresight)) => {
                // An episode that could not be set up has no draws.
                let compute = move |scenario: &Scenario| foresight.draws(scenario).unwrap_or_default();
                return Self { specs: task.draws.clone(), compute: Box::new(compute) };
            }
            Err(why) => why,
        };
        note(format_args!("note: the hidden draws of the task are not computed: {why:#}"));
        match provenance.execution().cloned() {
            // Sampled latencies follow from the seed alone, also in an environment of another process.
            Some(Execution { latency, .. }) if latency.check().is_ok() => Self {
                specs: with_declarations(&provenance.task, &latency).draws.clone(),
                compute: Box::new(move |scenario: &Scenario| latency.draws(scenario.seed)),
            },
            _ => Self { specs: provenance.task.draws.clone(), compute: Box::new(|_: &Scenario| Measures::default()) },
        }
    }
}

/// The task of this build that a run recorded, with its knowledge about episodes before they run.
fn knowledge(provenance: &Provenance, folder: Option<&Path>) -> anyhow::Result<(Arc<TaskSpec>, Arc<dyn Foresight>)> {
    if provenance.source.is_some() || starts_processes(provenance) {
        anyhow::bail!("the episodes are not those of a built-in task");
    }
    // Draws do not depend on the policy.
    let subject = Subject::recorded_environment(provenance, folder, &Reopening::none()).map_err(|exit| exit.error)?;
    if subject.robot_sha256()? != provenance.robot.sha256 {
        anyhow::bail!("the files of the robot {} have changed since the run", provenance.robot.name);
    }
    let task = Arc::clone(subject.task());
    let same = task.name == provenance.task.name && task.version == provenance.task.version;
    let worker = subject.worker().map_err(|fault| anyhow::anyhow!("{fault}"))?;
    match worker.environment.foresight() {
        Some(foresight) if same => Ok((task, foresight)),
        Some(_) => anyhow::bail!("the task {} has another version in this build", provenance.task.name),
        None => anyhow::bail!("the task {} has no hidden draws", provenance.task.name),
    }
}

/// Returns an error if the path exists: the file may be the source of the rows.
pub(crate) fn require_absent(out: &Path) -> Result<(), Exit> {
    if out.symlink_metadata().is_err() {
        return Ok(());
    }
    let why = anyhow::anyhow!(
        "{}: already exists, and is not overwritten\nHint: choose another name, or remove it",
        out.display()
    );
    Err(why).or_usage()
}

fn by_ending(path: &Path) -> Option<To> {
    match path.extension()?.to_str()? {
        "csv" => Some(To::Csv),
        "jsonl" | "ndjson" => Some(To::Jsonl),
        "json" => Some(To::Published),
        "parquet" => Some(To::Parquet),
        _ => None,
    }
}

/// Opens the dictionary of a run's folder, or a dictionary file.
fn open(path: &Path) -> Result<Dictionary, Exit> {
    let file = if path.is_dir() { path.join(robogate_campaign::folder::DICTIONARY) } else { path.to_owned() };
    if path.is_dir() && !file.exists() && robogate_campaign::settings(path).is_ok() {
        robogate_campaign::not_in_shards(path).or_usage()?;
        let why =
            anyhow::anyhow!("{}: the run is not finished\nHint: robogate resume {}", path.display(), quoted(path));
        return Err(why).or_usage();
    }
    Dictionary::open(&file).or_usage()
}
