//! `robogate evidence`: writes a verdict as a folder that others can check.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, ValueEnum};
use robogate_analysis::Source;
use robogate_core::TaskSpec;
use robogate_dictionary::{LostEpisode, Place, PolicyRecord, Provenance, World};
use robogate_gate::evidence::{Content, Ingredients, PrivateKey, REGISTRATION, REGISTRATION_KEY, Role, write};
use robogate_gate::{Asked, REPEATED, Record, Requirements, Sampling};

use crate::commands::gate::real_evidence_for;
use crate::compliance;
use crate::exit::{Exit, OrExit};
use crate::place;
use crate::terminal::{foreign, line, note};
use robogate_session::{
    CHECKPOINT, ENVIRONMENT, FINGERPRINT, POLICY, built_in_baseline, open_source, recorded_robot, register_copy,
};

/// Judge a run and write a folder with everything that the verdict depends on, so that others can check it.
///
/// Exit codes: those of the verdict: 0 pass, 1 fail, 3 inconclusive, 4 invalid.
#[derive(Debug, Args)]
pub(crate) struct Evidence {
    /// Folder of a run, or a dictionary (Parquet)
    run: PathBuf,
    /// Folder to write
    #[arg(value_parser = place::local())]
    out: PathBuf,
    /// Choose the requirements: default, paper or a TOML file; default: those of the run's gate
    #[arg(long, value_name = "NAME|FILE")]
    requirements: Option<String>,
    /// Compare relative requirements with this baseline (JSON); default: that of the run's gate, or the built-in one
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Add these trials of the real robot: the file of `robogate transfer --out`; default: those of the run's gate
    #[arg(long, value_name = "FILE")]
    real: Option<PathBuf>,
    /// Compare with this run or dictionary, of the policy that may be replaced
    #[arg(long, value_name = "RUN", requires = "margin")]
    against: Option<PathBuf>,
    /// Set the non-inferiority margin: how far the success rate may lie below that policy's (0.05 is five points)
    #[arg(long, requires = "against")]
    margin: Option<f64>,
    /// State how the number of episodes was chosen; default: as in the run's gate, otherwise fixed
    #[arg(long, value_name = "HOW")]
    sampling: Option<Count>,
    /// Judge other requirements, baseline, margin or real trials than those of the run's gate. `robogate verify` reports
    /// it in its first line
    #[arg(long)]
    reasked: bool,
    /// Add the folder `compliance` with the verdict as a page and as JUnit, and a CycloneDX list of components (SBOM)
    #[arg(long)]
    compliance: bool,
    /// Add the safety case: a page and an argument in Goal Structuring Notation, from the files of the evidence to the claim that the policy
    /// may run, with what can defeat it and the clauses that it can support. Conformity is not claimed
    #[arg(long)]
    safety_case: bool,
    /// Sign with this private key; without one the evidence is unsigned
    #[arg(long, value_name = "PRIVATE")]
    key: Option<PathBuf>,
    /// Add a file: suite=FILE, robot=FILE-OR-FOLDER, environment=FILE-OR-FOLDER, policy=FILE, attachment=FILE; for the safety case also
    /// what came after the gate: admission=JSON of `admit --json`, monitor=FILE of `monitor reference`, warning=FILE of `warn train`,
    /// requalification=JSON of `requalify --json`, fleet=fleet-result.json
    #[arg(long, value_name = "ROLE=FILE")]
    include: Vec<String>,
}

/// How the number of episodes was chosen.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Count {
    /// Fixed before the first episode
    Fixed,
    /// Chosen while results came in
    Sequential,
}

impl Evidence {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if self.run.join(FLEET).is_file() {
            return Err(anyhow::anyhow!(
                "{}: the folder of a fleet. Each of its units has rows and a verdict of its own\nHint: write the evidence of a unit, for \
                 example of {}; with --safety-case it includes the result of the fleet",
                self.run.display(),
                self.run.join("unit-001").display()
            ))
            .or_usage();
        }
        let source = open_source(&self.run)?;
        if self.run.is_dir() && place::is_within(&self.out, &self.run) {
            return Err(anyhow::anyhow!(
                "{} is in the folder of the run\nHint: choose a folder outside of it, so that the run keeps its own files only",
                self.out.display()
            ))
            .or_usage();
        }
        let provenance = source.dictionary().provenance();
        let asked = source.folder().map_or(Ok(None), Asked::of)?;
        let mut others = Vec::new();
        let files = [
            (Role::Plan, "plan.json"),
            (Role::Summary, "summary.json"),
            (Role::Question, Asked::FILE),
            (Role::Registration, REGISTRATION),
            (Role::Registration, REGISTRATION_KEY),
            (Role::Attachment, LostEpisode::FILE),
            (Role::Fingerprint, FINGERPRINT),
            (Role::Fingerprint, CHECKPOINT),
            (Role::Repeats, REPEATED),
        ];
        for (role, name) in files {
            let path = self.run.join(name);
            if self.run.is_dir() && path.exists() {
                others.push((role, name.to_owned(), Content::File(path)));
            }
        }
        for include in &self.include {
            add(include, &mut others).or_usage()?;
        }
        if self.safety_case && !others.iter().any(|(role, ..)| *role == Role::Fleet) {
            others.extend(fleet_of(&self.run).map(|file| (Role::Fleet, FLEET_RESULT.to_owned(), Content::File(file))));
        }
        if !others.iter().any(|(role, ..)| *role == Role::Robot) && provenance.robot.sha256.is_some() {
            match recorded_robot(provenance, source.folder()) {
                Some(files) => {
                    others.extend(files.into_iter().map(|(name, bytes)| {
                        (Role::Robot, format!("robot/{name}"), Content::Bytes(bytes.into_owned()))
                    }))
                }
                None => note(
                    "the robot's files have changed since the run or are missing. They are not included; their hash is in the rows",
                ),
            }
        }
        if !others.iter().any(|(role, ..)| *role == Role::Environment)
            && let (Some(folder), Some(World { place: Place::Python(python), .. })) =
                (source.folder(), &provenance.world)
        {
            let kept = |name: &String| Some(folder.join(ENVIRONMENT).join(name)).filter(|path| path.is_file());
            match python.files.keys().map(kept).collect::<Option<Vec<PathBuf>>>() {
                Some(files) => {
                    others.extend(
                        python.files.keys().zip(files).map(|(name, file)| {
                            (Role::Environment, format!("environment/{name}"), Content::File(file))
                        }),
                    )
                }
                None => note(
                    "the run has no copies of its environment's files. They are not included; their hashes are in the rows",
                ),
            }
        }
        if !others.iter().any(|(role, ..)| *role == Role::Policy)
            && let (Some(folder), Some(World { policy: Some(PolicyRecord::External(network)), .. })) =
                (source.folder(), &provenance.world)
            && let Some(name) = Path::new(&network.server).file_name().filter(|_| network.is_file())
        {
            let file = folder.join(POLICY).join(name);
            match file.is_file() {
                true => others.push((Role::Policy, format!("policy/{}", name.to_string_lossy()), Content::File(file))),
                false => note("the run has no copy of its policy. It is not included; its hash is in the rows"),
            }
        }
        let ingredients = Ingredients {
            dictionary: dictionary(&self.run),
            requirements: self.requirements(&provenance.task, asked.as_ref())?,
            baseline: self.baseline(asked.as_ref(), &source)?,
            real: self.real(asked.as_ref(), provenance)?,
            against: self.against(asked.as_ref())?,
            sampling: self.sampling(asked.as_ref()).or_usage()?,
            reasked: self.reasked,
            others,
            documents: Some(compliance::documents(self.compliance, self.safety_case)),
        };
        // Read before the evaluation, so that an unusable key is reported early.
        let key = self.key.as_deref().map(PrivateKey::read).transpose()?;
        let manifest = write(&self.out, &ingredients, key.as_ref())?;
        source.folder().into_iter().for_each(|folder| register_copy(&self.out, folder, provenance));
        line(format_args!("{}: {}", manifest.verdict, foreign(&manifest.because)));
        let signed = manifest.signer.map_or("unsigned".to_owned(), |keyid| format!("signed by key {keyid}"));
        note(format_args!("policy: {}", foreign(&manifest.policy_binding)));
        note(format_args!("question: {}", foreign(&manifest.question)));
        note(format_args!("{}: {} files, {signed}", self.out.display(), manifest.files.len() + 3));
        Ok(manifest.verdict.exit_code())
    }
}

impl Evidence {
    fn requirements(&self, task: &TaskSpec, asked: Option<&Asked>) -> Result<Content, Exit> {
        match (&self.requirements, asked) {
            (Some(file), _) if Path::new(file).is_file() => Ok(Content::File(file.into())),
            (Some(name), _) => Ok(Content::Bytes(Requirements::open(name, task)?.to_toml().into_bytes())),
            (None, Some(asked)) => Ok(Content::Bytes(asked.requirements.to_toml().into_bytes())),
            (None, None) => Err(anyhow::anyhow!(
                "this run was not made by `robogate gate`, so it has no requirements\nHint: choose them with --requirements default, paper, or a file"
            ))
            .or_usage(),
        }
    }

    fn baseline(&self, asked: Option<&Asked>, source: &Source) -> Result<Option<Content>, Exit> {
        let baseline = match (&self.baseline, asked) {
            (Some(file), _) => return Ok(Some(Content::File(file.clone()))),
            (None, Some(asked)) => asked.baseline.clone(),
            (None, None) => built_in_baseline(&Record::of(source.dictionary())?),
        };
        Ok(baseline.map(|baseline| Content::Bytes(baseline.to_json().into_bytes())))
    }

    fn real(&self, asked: Option<&Asked>, provenance: &Provenance) -> Result<Option<Content>, Exit> {
        let real = match (&self.real, asked) {
            (Some(file), _) => Some(real_evidence_for(file, provenance)?),
            (None, asked) => asked.and_then(|asked| asked.real.clone()),
        };
        Ok(real.map(|real| Content::Bytes(real.to_json().into_bytes())))
    }

    fn against(&self, asked: Option<&Asked>) -> Result<Option<(PathBuf, f64)>, Exit> {
        let Some(against) = asked.and_then(|asked| asked.against.as_ref()).filter(|_| self.against.is_none()) else {
            return Ok(self.against.as_deref().map(dictionary).zip(self.margin));
        };
        let path = Path::new(&against.path);
        let now = open_source(path)?;
        if Record::of(now.dictionary())?.dataset_sha256 != against.dataset_sha256 {
            return Err(anyhow::anyhow!(
                "{} has changed since the gate ran. Expected the dataset that it was compared with",
                against.path
            ))
            .or_usage();
        }
        Ok(Some((dictionary(path), against.margin)))
    }

    /// A run that was tested after each round stays a sequential test.
    fn sampling(&self, asked: Option<&Asked>) -> anyhow::Result<Sampling> {
        let recorded = asked.map_or(Sampling::Fixed, |asked| asked.sampling);
        match self.sampling {
            Some(Count::Fixed) if recorded == Sampling::Sequential => anyhow::bail!(
                "--sampling fixed: the run's gate tested after each round, so its number of episodes was not fixed\nHint: leave out --sampling"
            ),
            Some(Count::Fixed) => Ok(Sampling::Fixed),
            Some(Count::Sequential) => Ok(Sampling::Sequential),
            None => Ok(recorded),
        }
    }
}

/// The plan of a fleet in its folder, and its result.
const FLEET: &str = "fleet.json";
const FLEET_RESULT: &str = "fleet-result.json";

/// The result of the fleet that has this run as a unit, if it is finished.
fn fleet_of(run: &Path) -> Option<PathBuf> {
    let fleet = run.canonicalize().ok()?.parent()?.to_owned();
    let result = fleet.join(FLEET_RESULT);
    (fleet.join(FLEET).is_file() && result.is_file()).then_some(result)
}

/// The dictionary of a run's folder, or the dictionary file itself.
fn dictionary(run: &Path) -> PathBuf {
    if run.is_dir() { run.join("dictionary.parquet") } else { run.to_owned() }
}

/// Adds a file, or every file of a folder, with its role.
fn add(include: &str, others: &mut Vec<(Role, String, Content)>) -> anyhow::Result<()> {
    let (word, path) = include
        .split_once('=')
        .with_context(|| format!("--include {include}: expected ROLE=FILE, for example suite=industrial.toml"))?;
    let role = match word {
        "suite" => Role::Suite,
        "robot" => Role::Robot,
        "environment" => Role::Environment,
        "policy" => Role::Policy,
        "admission" => Role::Admission,
        "monitor" => Role::Monitor,
        "warning" => Role::Warning,
        "requalification" => Role::Requalification,
        "fleet" => Role::Fleet,
        "attachment" => Role::Attachment,
        _ => anyhow::bail!(
            "--include {include}: unknown role `{word}`. Expected suite, robot, environment, policy, admission, monitor, warning, \
             requalification, fleet or attachment"
        ),
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
            others.push((role, format!("{word}{name}"), Content::File(path)));
        }
    }
    Ok(())
}
