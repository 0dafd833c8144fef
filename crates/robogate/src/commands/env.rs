//! `robogate env`: environments that run in Python.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use clap::{Args, Subcommand};
use robogate_core::{Allowed, Domain, Parameter, ParameterSpec, Scale};
use robogate_dictionary::{check_columns, files};
use robogate_remote::Timeouts;
use robogate_remote::message::Hello;
use robogate_stats::format::number;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::arguments::seconds;
use crate::exit::{DONE, Exit, INFRASTRUCTURE, OrExit};
use crate::interface;
use crate::terminal::{bold, dim, line, note};
use robogate_session::{Interpreter, installed, installed_marker};

/// List, install and inspect environments that run in Python (docs/guides/environments.md).
#[derive(Debug, Args)]
pub(crate) struct Environments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Create a Python environment with the pinned packages of a family
    Setup(Setup),
    /// Show what can be varied in an environment, its measures and its policies
    Inspect(Inspect),
}

#[derive(Debug, Args)]
struct Setup {
    /// Name of the family (see `robogate list environments`)
    family: String,
    /// Create the Python environment with this interpreter; default: the active python3
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct Inspect {
    /// Name of the environment, as for --env
    name: String,
    /// Use this Python interpreter; default: that of `robogate env setup`, otherwise the active python3
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// Set the timeout for a step of the check, in seconds (0.001 to 86400); a reset may take four times as long
    #[arg(long = "simulator-timeout", value_name = "SECONDS", default_value_t = 30.0, value_parser = seconds)]
    timeout_s: f64,
    /// Write a parameter space with all knobs to this TOML file: those of the default space, and the others as comments
    #[arg(long = "out", alias = "space", value_name = "FILE")]
    space: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A family, as the Python package lists it.
#[derive(Debug, Serialize, Deserialize)]
struct Family {
    name: String,
    summary: String,
    requirements: Vec<String>,
    names: Vec<String>,
    /// The package that must be importable.
    package: String,
    /// The package that is missing: that of the family, or one of the server.
    missing: Option<String>,
    /// How users get the package of the family, if `setup` cannot install it.
    yours: Option<String>,
}

/// The declaration of an environment.
#[derive(Debug, Serialize, Deserialize)]
struct Description {
    #[serde(flatten)]
    hello: Hello,
    not_offered: Vec<NotOffered>,
}

/// A knob whose effect cannot be read.
#[derive(Debug, Serialize, Deserialize)]
struct NotOffered {
    name: String,
    reason: String,
}

impl Environments {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            What::Setup(setup) => setup.execute(),
            What::Inspect(inspect) => inspect.execute(),
        }
    }
}

impl Family {
    /// Checks, before anything is installed, that a package which only the user can provide is importable.
    fn is_provided(&self) -> Result<(), Exit> {
        match (&self.yours, &self.missing) {
            (Some(yours), Some(missing)) if *missing == self.package => Err(anyhow!(
                "{}: the package {missing} cannot be imported, and pip cannot install it\nHint: {yours}, and repeat this command",
                self.name
            ))
            .or_usage(),
            _ => Ok(()),
        }
    }
}

/// Prints the bundled environments, and whether their packages are installed.
pub(crate) fn list(python: Option<&Path>, json: bool) -> Result<u8, Exit> {
    let mut families: Vec<Family> = Interpreter::choose(python, "").or_usage()?.ask("list", &[])?;
    if python.is_none() {
        for listed in &mut families {
            let folder = installed(&listed.name).or_usage()?;
            if installed_marker(&folder).is_file() {
                let own: Vec<Family> = Interpreter::new(folder.join("bin/python")).or_usage()?.ask("list", &[])?;
                if let Some(own) = own.into_iter().find(|own| own.name == listed.name) {
                    *listed = own;
                }
            }
        }
    }
    if json {
        line(json!({"version": 1, "families": families}));
        return Ok(DONE);
    }
    for Family { name, summary, names, missing, .. } in &families {
        line(format_args!("{}  {summary}", bold(name)));
        match missing {
            Some(package) => line(dim(format_args!(
                "  not installed (the package {package} is missing); next: robogate env setup {name}"
            ))),
            None => names.iter().for_each(|one| line(format_args!("  {name}:{one}"))),
        }
    }
    line(dim(
        "gymnasium:ID, FILE.py:ATTRIBUTE and MODULE:ATTRIBUTE name any other environment (docs/guides/environments.md)",
    ));
    Ok(DONE)
}

impl Setup {
    fn execute(&self) -> Result<u8, Exit> {
        let python = self.python.clone().unwrap_or_else(|| PathBuf::from("python3"));
        let families: Vec<Family> = Interpreter::new(python.clone()).or_usage()?.ask("list", &[])?;
        let Some(wanted) = families.iter().find(|family| family.name == self.family) else {
            let known: Vec<&str> = families.iter().map(|family| &*family.name).collect();
            return Err(anyhow!("{}: no such family. Expected one of: {}", self.family, known.join(", "))).or_usage();
        };
        let folder = installed(&wanted.name).or_usage()?;
        let requirements = wanted.requirements.join("\n");
        if fs::read_to_string(installed_marker(&folder)).is_ok_and(|text| text == requirements) {
            note(format_args!("{} is up to date in {}", wanted.name, folder.display()));
            return Ok(DONE);
        }
        wanted.is_provided()?;
        if folder.exists() {
            fs::remove_dir_all(&folder).with_context(|| format!("cannot remove {}", folder.display())).or_broken()?;
        }
        note(format_args!("creating a Python environment for {} in {}", wanted.name, folder.display()));
        // Python imports modules from its current folder first. The user's current folder may contain another user's files.
        let parent = folder.parent().unwrap_or(&folder);
        fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display())).or_broken()?;
        let from_here = |program: &Path| std::path::absolute(program).unwrap_or_else(|_| program.to_owned());
        let python = if python.components().count() > 1 { from_here(&python) } else { python };
        visibly(Command::new(&python).args(["-m", "venv"]).arg(&folder).current_dir(parent)).or_broken()?;
        let inside = folder.join("bin/python");
        let mut pip = Command::new(&inside);
        pip.current_dir(parent);
        pip.args(["-m", "pip", "install", "--disable-pip-version-check"]).args(&wanted.requirements);
        visibly(&mut pip).or_broken()?;
        let check: Vec<Family> = Interpreter::new(inside).or_usage()?.ask("list", &[])?;
        if let Some(missing) = check.into_iter().find(|own| own.name == wanted.name).and_then(|own| own.missing) {
            let why = anyhow!("{}: the package {missing} cannot be imported after the installation", wanted.name);
            return Err(Exit { code: INFRASTRUCTURE, error: why });
        }
        // The marker is written last, so an interrupted setup is repeated.
        files::write(installed_marker(&folder), requirements).or_broken()?;
        note(format_args!("{} is ready", wanted.name));
        note("next: robogate list environments");
        Ok(DONE)
    }
}

/// Runs a command whose output goes to standard error, where the user sees its progress.
fn visibly(command: &mut Command) -> anyhow::Result<()> {
    let shown = format!("{command:?}");
    let status = command.stdin(Stdio::null()).stdout(std::io::stderr()).status();
    let status = status.with_context(|| format!("cannot start {shown}"))?;
    if !status.success() {
        bail!("{shown} failed ({status})");
    }
    Ok(())
}

impl Inspect {
    fn execute(&self) -> Result<u8, Exit> {
        let interpreter = Interpreter::choose(self.python.as_deref(), &self.name).or_usage()?;
        let timeouts = Timeouts::from_step(Duration::from_secs_f64(self.timeout_s));
        let description: Description = interpreter.ask_within("describe", &[&self.name], &timeouts)?;
        description.hello.check().map_err(|why| anyhow!(why)).or_broken()?;
        check_columns(&description.hello.task).or_usage()?;
        if let Some(file) = &self.space {
            write_new(file, &space_file(&description.hello)).or_usage()?;
            note(format_args!(
                "wrote {}; next: robogate run --env {} --space {}",
                file.display(),
                self.name,
                file.display()
            ));
        }
        if self.json {
            let mut document = serde_json::to_value(&description).or_broken()?;
            if let Some(document) = document.as_object_mut() {
                document.insert("version".to_owned(), json!(1));
            }
            line(document);
        } else {
            print(&description);
        }
        Ok(DONE)
    }
}

/// Writes a file that must not exist yet.
fn write_new(file: &Path, text: &str) -> anyhow::Result<()> {
    match files::write_new(file, text) {
        Err(why) if why.kind() == std::io::ErrorKind::AlreadyExists => {
            bail!("{}: the file exists already\nHint: name another file", file.display())
        }
        written => written.with_context(|| format!("cannot write {}", file.display())),
    }
}

fn print(description: &Description) {
    let hello = &description.hello;
    let task = &hello.task;
    line(format_args!("{} in {} {}", bold(task.name), hello.engine.name, hello.engine.version));
    line(format_args!("  instruction     {}", task.instruction));
    let (rate, limit) = (number(1.0 / task.control_period_s), number(task.time_limit_s));
    line(format_args!("  actions         {rate} per second, at most {limit} s"));
    line(format_args!("  observes        {}", interface::observes(task)));
    line(format_args!("  cameras         {}", interface::cameras(task)));
    line(format_args!("  takes           {}", interface::takes(task)));
    let deterministic = if hello.deterministic {
        "yes: a scenario ran twice with equal states"
    } else {
        "no: two runs of a scenario differ"
    };
    line(format_args!("  deterministic   {deterministic}"));
    let names = |names: Vec<&str>| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    line(format_args!("  policies        {}", names(hello.policies.iter().map(|policy| &*policy.name).collect())));
    line(format_args!(
        "  failure modes   {}",
        names(task.failure_modes.iter().map(|mode| mode.name.as_str()).collect())
    ));
    line(format_args!(
        "  measures        {}",
        names(task.measures.iter().map(|measure| measure.name.as_str()).collect())
    ));
    let wide = task.parameters.iter().map(|spec| spec.name.len()).max().unwrap_or(0).max(32);
    line(bold(format_args!(
        "{:<wide$} {:>10}  {:<22} {:<10} {}",
        "parameter", "nominal", "allowed", "unit", "sampled by default"
    )));
    let space = hello.space.as_ref();
    for spec in &task.parameters {
        let nominal = spec.nominal.as_ref().map_or_else(|| "-".to_owned(), value);
        let sampled = space.and_then(|space| space.parameters().iter().find(|parameter| *parameter.name == *spec.name));
        let sampled = sampled.map_or_else(String::new, |parameter| domain(&parameter.domain));
        line(format_args!(
            "{:<wide$} {nominal:>10}  {:<22} {:<10} {sampled}",
            spec.name,
            allowed(&spec.allowed),
            spec.unit
        ));
    }
    for NotOffered { name, reason } in &description.not_offered {
        line(dim(format_args!("not offered: {name}: {reason}")));
    }
}

fn value(value: &robogate_core::Value) -> String {
    match value {
        robogate_core::Value::Number(x) => number(*x),
        other => other.to_string(),
    }
}

fn allowed(allowed: &Allowed) -> String {
    match allowed {
        Allowed::Continuous { low, high } => format!("{} to {}", number(*low), number(*high)),
        Allowed::Integer { low, high } => format!("{low} to {high}"),
        Allowed::Categorical { choices, .. } => format!("{} choices", choices.len()),
    }
}

/// A range in words.
pub(crate) fn domain(domain: &Domain) -> String {
    match domain {
        Domain::Continuous { low, high, .. } if low == high => number(*low),
        Domain::Continuous { low, high, scale: Scale::Log } => format!("{} to {}, log", number(*low), number(*high)),
        Domain::Continuous { low, high, .. } => format!("{} to {}", number(*low), number(*high)),
        Domain::Integer { low, high } => format!("{low} to {high}"),
        Domain::Categorical { choices } => choices.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
    }
}

/// A parameter space as a TOML file: the parameters of the default space, and all others as comments.
pub(crate) fn space_file(hello: &Hello) -> String {
    let mut text = format!(
        "# What to vary in {}, and how far. Remove the # of a parameter to vary it too.\nname = \"{}\"\n",
        hello.task.name, hello.task.name
    );
    let sampled: &[Parameter] = hello.space.as_ref().map_or(&[], |space| space.parameters());
    let (first, rest): (Vec<_>, Vec<_>) =
        hello.task.parameters.iter().partition(|spec| sampled.iter().any(|parameter| *parameter.name == *spec.name));
    for spec in first {
        let chosen = sampled.iter().find(|parameter| *parameter.name == *spec.name);
        text += &entry(spec, chosen.map(|parameter| &parameter.domain), "");
    }
    for spec in rest {
        text += &entry(spec, None, "# ");
    }
    text
}

/// The lines of one parameter, each after `prefix`.
fn entry(spec: &ParameterSpec, chosen: Option<&Domain>, prefix: &str) -> String {
    let nominal = spec.nominal.as_ref().map_or_else(String::new, |nominal| format!(" Nominal: {nominal}."));
    let unit = if spec.unit.is_empty() { String::new() } else { format!(" Unit: {}.", spec.unit) };
    let mut text = format!("\n# {}{unit}{nominal} Allowed: {}.\n", spec.meaning, allowed(&spec.allowed));
    let list = |choices: &mut dyn Iterator<Item = String>| {
        let quoted: Vec<String> = choices.map(|choice| format!("{choice:?}")).collect();
        format!("choices = [{}]", quoted.join(", "))
    };
    let (kind, values) = match (chosen, &spec.allowed) {
        (Some(Domain::Continuous { low, high, scale }), _) => {
            let scale = if matches!(scale, Scale::Log) { "\nscale = \"log\"" } else { "" };
            ("continuous", format!("low = {low:?}\nhigh = {high:?}{scale}"))
        }
        (Some(Domain::Integer { low, high }), _) | (None, Allowed::Integer { low, high }) => {
            ("integer", format!("low = {low}\nhigh = {high}"))
        }
        (Some(Domain::Categorical { choices }), _) => {
            ("categorical", list(&mut choices.iter().map(ToString::to_string)))
        }
        (None, Allowed::Continuous { low, high }) => ("continuous", format!("low = {low:?}\nhigh = {high:?}")),
        (None, Allowed::Categorical { choices, .. }) => {
            ("categorical", list(&mut choices.iter().map(ToString::to_string)))
        }
    };
    let body = format!("[[parameter]]\nname = \"{}\"\nkind = \"{kind}\"\n{values}", spec.name);
    for one in body.lines() {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{prefix}{one}");
    }
    text
}
