//! The files that `robogate init` writes. They are collected first, and written together.

use std::fmt::Write as _;
use std::path::Path;
#[cfg(feature = "onnx")]
use std::path::PathBuf;

use anyhow::{Context, anyhow};
use robogate_core::TaskSpec;
use robogate_dictionary::files;
use robogate_remote::message::Hello;
use robogate_session::PolicyChoice;
use robogate_session::init::{Wanted, requirements};
use toml::Value;

use super::Parts;
use crate::commands::env::space_file;
use crate::exit::{Exit, OrExit};
use crate::project;
#[cfg(feature = "onnx")]
use crate::terminal::foreign;
use crate::terminal::line;

/// The file of the requirements.
pub(super) const REQUIREMENTS: &str = "requirements.toml";
const SPACE: &str = "space.toml";
const PROFILE: &str = "profile.toml";
const MAP: &str = "map.toml";
const CI: &str = ".github/workflows/robogate.yml";
/// All of them.
const FILES: [&str; 6] = [project::FILE, REQUIREMENTS, SPACE, PROFILE, MAP, CI];

/// A job that judges the policy on each pull request. `{options}` are added to the command.
const JOB: &str = "\
# A pull request is merged only if its policy passes. Exit codes of `robogate gate`: 0 pass, 1 fail, 3 inconclusive.
name: robogate
on: pull_request

env:
  # The package, or the path or the address of its wheel (docs/guides/installing.md).
  ROBOGATE_WHEEL: robogate-eval==VERSION

jobs:
  gate:
    runs-on: ubuntu-latest
    permissions:
      contents: read
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: \"3.11\"
      - run: pip install \"$ROBOGATE_WHEEL\"PACKAGES
      # Each run has its own seed: a policy that was tuned on fixed scenarios must be judged on new ones.
      - run: robogate gate --seed ${{ github.run_number }}PYTHON --out gate
      - if: always()
        run: if [ -f gate/gate.md ]; then cat gate/gate.md >> \"$GITHUB_STEP_SUMMARY\"; fi
      - if: always()
        uses: actions/upload-artifact@v4
        with:
          name: gate
          path: gate
";

/// The drafts.
pub(super) struct Drafts {
    force: bool,
    files: Vec<(&'static str, String)>,
}

impl Drafts {
    pub(super) fn new(force: bool) -> Self {
        Self { force, files: Vec::new() }
    }

    fn add(&mut self, file: &'static str, text: String) {
        self.files.push((file, text));
    }

    fn has(&self, file: &str) -> bool {
        self.files.iter().any(|(name, _)| *name == file)
    }

    /// Refuses to replace the files of an earlier call, before anything is started.
    pub(super) fn refuse_existing(&self) -> Result<(), Exit> {
        let existing: Vec<&str> = FILES.into_iter().filter(|file| Path::new(file).exists()).collect();
        if self.force || existing.is_empty() {
            return Ok(());
        }
        Err(anyhow!(
            "{} exist in this folder\nHint: replace them with --force, or use another folder",
            existing.join(", ")
        ))
        .or_usage()
    }

    /// The parameter space of an environment, if it declares parameters.
    pub(super) fn space(&mut self, hello: &Hello) {
        let parameters = hello.task.parameters.len();
        if parameters > 0 {
            let varied = hello.space.as_ref().map_or(0, |space| space.parameters().len());
            line(format_args!("varies    {varied} of {parameters} parameters ({SPACE})"));
            self.add(SPACE, space_file(hello));
        }
    }

    /// The profile and the map of a network.
    #[cfg(feature = "onnx")]
    pub(super) fn network(&mut self, file: &Path, task: &TaskSpec, policy: &mut PolicyChoice) -> Result<(), Exit> {
        let draft = robogate_policy::draft_network(file, task).map_err(robogate_session::policy_error)?;
        line(format_args!("found     {}: a network that {}", foreign(file.display()), foreign(&draft.found)));
        draft.guesses.iter().for_each(|guess| line(format_args!("guess     {}", foreign(guess))));
        self.add(PROFILE, draft.profile);
        policy.profile = Some(PROFILE.to_owned());
        if let Some(map) = draft.map {
            self.add(MAP, map);
            policy.map = Some(PathBuf::from(MAP));
        }
        Ok(())
    }

    #[cfg(not(feature = "onnx"))]
    pub(super) fn network(&mut self, file: &Path, _: &TaskSpec, _: &mut PolicyChoice) -> Result<(), Exit> {
        Err(anyhow!("{}: this build runs no networks\nHint: build with --features onnx", file.display())).or_usage()
    }

    /// The requirements.
    pub(super) fn requirements(&mut self, wanted: &Wanted, task: &TaskSpec) -> Result<(), Exit> {
        let (text, remarks) = requirements(wanted, task).or_usage()?;
        remarks.iter().for_each(|remark| line(format_args!("note      {remark}")));
        self.add(REQUIREMENTS, text);
        Ok(())
    }

    /// The project file.
    pub(super) fn project(&mut self, parts: &Parts, policy: &PolicyChoice, python: Option<&Path>) {
        let mut text = "# Settings of the verbs of robogate in this folder: `robogate config show` prints them all. An option on the \
                        command line comes first.\n"
            .to_owned();
        let path = |path: &Path| path.display().to_string();
        // The file is shared with other machines.
        let folder = std::env::current_dir().map(|folder| format!("{}/", folder.display())).unwrap_or_default();
        for (key, value) in [
            ("env", parts.env.clone()),
            ("python", python.filter(|_| parts.env.is_some()).map(path)),
            ("robot", parts.robot.clone()),
            ("policy", policy.policy.clone()),
            ("profile", policy.profile.clone()),
            ("map", policy.map.as_deref().map(path)),
        ] {
            if let Some(value) = value {
                let _ = writeln!(
                    text,
                    "{key} = {}",
                    Value::String(value.strip_prefix(&*folder).unwrap_or(&value).to_owned())
                );
            }
        }
        let space = if self.has(SPACE) { format!("space = \"{SPACE}\"\n") } else { String::new() };
        let _ = write!(text, "\n[run]\nn = 1000\n{space}\n[gate]\nrequirements = \"{REQUIREMENTS}\"\n{space}");
        self.add(project::FILE, text);
    }

    /// The job of a continuous integration.
    pub(super) fn ci(&mut self, python: bool) {
        // The file of the project may name a Python of this machine.
        let own = if python { " --python python3" } else { "" };
        let packages = if python { " gymnasium numpy pyzmq msgpack" } else { "" };
        let job =
            JOB.replace("VERSION", env!("CARGO_PKG_VERSION")).replace("PACKAGES", packages).replace("PYTHON", own);
        self.add(CI, job);
    }

    /// Writes the files.
    pub(super) fn write(&self) -> Result<(), Exit> {
        for (name, text) in &self.files {
            let path = Path::new(name);
            if !self.force && path.exists() {
                return Err(anyhow!("{name} exists\nHint: replace it with --force, or use another folder")).or_usage();
            }
            let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty());
            folder
                .map(files::create_folders)
                .transpose()
                .with_context(|| format!("cannot write {name}"))
                .or_broken()?;
            files::write(path, text).with_context(|| format!("cannot write {name}")).or_unwritable()?;
        }
        let names: Vec<&str> = self.files.iter().map(|(name, _)| *name).collect();
        line(format_args!("wrote     {}", names.join(", ")));
        Ok(())
    }
}

/// Sets the payload in a drafted `robot.toml`.
pub(super) fn set_payload(file: &Path, payload_kg: Option<f64>) -> Result<(), Exit> {
    let Some(payload_kg) = payload_kg else { return Ok(()) };
    let text = robogate_dictionary::read_text(file).with_context(|| format!("cannot read {}", file.display()));
    let set = |line: &str| match line.starts_with("payload_kg") {
        true => format!("payload_kg = {payload_kg:?}\n"),
        false => format!("{line}\n"),
    };
    let text: String = text.or_usage()?.lines().map(set).collect();
    files::write(file, text).with_context(|| format!("cannot write {}", file.display())).or_unwritable()
}
