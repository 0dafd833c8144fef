//! `robogate evidence`: a verdict as a folder that someone else can check.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, ValueEnum};
use robogate_gate::Sampling;
use robogate_gate::evidence::{Ingredients, PrivateKey, Role, write};

use crate::exit::{Exit, OrExit};
use crate::terminal::{line, note};

/// Judge a run and put all that the verdict depends on into a folder that someone else can check.
///
/// Ends with the verdict's code: 0 pass, 1 fail, 3 inconclusive, 4 invalid.
#[derive(Debug, Args)]
pub(crate) struct Evidence {
    /// A run's folder, or a dictionary (Parquet)
    run: PathBuf,
    /// The folder to make
    out: PathBuf,
    /// What is demanded (TOML)
    #[arg(long, value_name = "FILE")]
    requirements: PathBuf,
    /// What relative demands refer to (JSON)
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// The run or dictionary of the policy that may be replaced
    #[arg(long, value_name = "RUN", requires = "margin")]
    against: Option<PathBuf>,
    /// How far below that policy's success rate this one may lie (0.05 for five points)
    #[arg(long, requires = "against")]
    margin: Option<f64>,
    /// How the number of episodes came about
    #[arg(long, value_name = "HOW", default_value = "fixed")]
    sampling: Count,
    /// Sign with this private key; without one the evidence is unsigned
    #[arg(long, value_name = "PRIVATE")]
    key: Option<PathBuf>,
    /// A further file: suite=FILE, robot=FILE-OR-FOLDER, policy=FILE, attachment=FILE
    #[arg(long, value_name = "ROLE=FILE")]
    include: Vec<String>,
}

/// How the number of episodes came about.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Count {
    /// It was fixed before the first episode
    Fixed,
    /// Somebody looked and decided whether to go on
    Sequential,
}

impl Evidence {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let mut others = Vec::new();
        if self.run.is_dir() {
            for (role, name) in [(Role::Plan, "plan.json"), (Role::Summary, "summary.json")] {
                let path = self.run.join(name);
                if path.exists() {
                    others.push((role, name.to_owned(), path));
                }
            }
        }
        for include in &self.include {
            add(include, &mut others).or_usage()?;
        }
        let ingredients = Ingredients {
            dictionary: dictionary(&self.run),
            requirements: self.requirements.clone(),
            baseline: self.baseline.clone(),
            against: self.against.as_deref().map(dictionary).zip(self.margin),
            sampling: match self.sampling {
                Count::Fixed => Sampling::Fixed,
                Count::Sequential => Sampling::Sequential,
            },
            others,
        };
        // Read before anything is judged: a key that cannot sign is better known now.
        let key = self.key.as_deref().map(PrivateKey::read).transpose().or_usage()?;
        let manifest = write(&self.out, &ingredients, key.as_ref()).or_usage()?;
        line(format_args!("{}: {}", manifest.verdict, manifest.because));
        let signed = manifest.signer.map_or("unsigned".to_owned(), |keyid| format!("signed by key {keyid}"));
        note(format_args!("{}: {} files, {signed}", self.out.display(), manifest.files.len() + 3));
        Ok(manifest.verdict.exit_code())
    }
}

/// The dictionary of a run's folder, or the dictionary itself.
fn dictionary(run: &Path) -> PathBuf {
    if run.is_dir() { run.join("dictionary.parquet") } else { run.to_owned() }
}

/// Adds a file, or every file of a folder, under the name of its role.
fn add(include: &str, others: &mut Vec<(Role, String, PathBuf)>) -> anyhow::Result<()> {
    let (word, path) = include
        .split_once('=')
        .with_context(|| format!("`{include}` is not ROLE=FILE\nhint: as in --include suite=industrial.toml"))?;
    let role = match word {
        "suite" => Role::Suite,
        "robot" => Role::Robot,
        "policy" => Role::Policy,
        "attachment" => Role::Attachment,
        _ => anyhow::bail!("`{word}` is no role of a file\nhint: suite, robot, policy or attachment"),
    };
    let path = Path::new(path);
    let mut paths = vec![(String::new(), path.to_owned())];
    while let Some((name, path)) = paths.pop() {
        if path.is_dir() {
            let entries = std::fs::read_dir(&path).with_context(|| format!("cannot read {}", path.display()))?;
            for entry in entries {
                let entry = entry.with_context(|| format!("cannot read {}", path.display()))?;
                paths.push((format!("{name}/{}", entry.file_name().to_string_lossy()), entry.path()));
            }
        } else {
            let own = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let name = if name.is_empty() { format!("/{own}") } else { name };
            others.push((role, format!("{word}{name}"), path));
        }
    }
    Ok(())
}
