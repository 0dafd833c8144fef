//! `robogate list`: lists the contents of this build by name.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::{Args, ValueEnum};
use robogate_campaign::BUILT_IN_SUITES;
use robogate_core::{Allowed, SettingSpec};
use robogate_physics::built_in_robots;
use robogate_policy::Profile;
use robogate_session::{ARM_TASKS, ENGINES, POLICIES, TASKS, named_suite, spaces, tasks};
use serde_json::{Map, Value, json};

use crate::commands::{env, policy, robots, suites};
use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{bold, foreign, line};

/// List what this build contains: tasks and their settings, engines, robots, policies, profiles, environments, spaces and
/// suites.
#[derive(Debug, Args)]
pub(crate) struct List {
    /// List one kind in detail; default: the names of all
    #[arg(value_enum)]
    kind: Option<Kind>,
    /// Show this suite with its scenarios (a built-in one or a TOML file), or this profile as TOML
    name: Option<String>,
    /// Find the packages of environments with this Python interpreter instead of those of `robogate env setup`
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A kind of contents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Built-in tasks
    Tasks,
    /// Settings of the built-in tasks, for --set
    Settings,
    /// Physics engines
    Engines,
    /// Built-in robots
    Robots,
    /// Policies that --policy names
    Policies,
    /// Profiles of learned policies
    Profiles,
    /// Environments in Python, and whether their packages are installed
    Environments,
    /// Parameter spaces
    Spaces,
    /// Suites of scenarios
    Suites,
}

impl List {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let (name, json) = (self.name.as_deref(), self.json);
        if self.python.is_some() && self.kind != Some(Kind::Environments) {
            return Err(anyhow!("--python applies to `robogate list environments`\nHint: leave it out")).or_usage();
        }
        match (self.kind, name) {
            (Some(Kind::Suites), Some(name)) => return suites::show(&named_suite(name)?, json),
            (Some(Kind::Profiles), name) => return policy::profiles(name, json),
            (_, Some(name)) => {
                return Err(anyhow!(
                    "list {}: only suites and profiles are shown by name\nHint: leave it out",
                    foreign(name)
                ))
                .or_usage();
            }
            (Some(Kind::Suites), None) => return suites::list(json),
            (Some(Kind::Robots), None) => return robots::list(json),
            (Some(Kind::Environments), None) => return env::list(self.python.as_deref(), json),
            (Some(Kind::Tasks | Kind::Settings | Kind::Engines | Kind::Policies | Kind::Spaces) | None, None) => {}
        }
        let wanted = self.kind.and_then(|kind| kind.to_possible_value());
        let listing = listing();
        let listing =
            listing.into_iter().filter(|(kind, _)| wanted.as_ref().is_none_or(|wanted| wanted.get_name() == *kind));
        if self.json {
            let mut document: Map<String, Value> =
                listing.map(|(kind, names)| (kind.to_owned(), json!(names))).collect();
            document.insert("version".to_owned(), json!(1));
            line(Value::Object(document));
            return Ok(DONE);
        }
        for (kind, names) in listing {
            line(bold(kind));
            names.iter().for_each(|name| line(format_args!("  {name}")));
        }
        Ok(DONE)
    }
}

/// All names, by kind, for the terminal.
fn listing() -> Vec<(&'static str, Vec<String>)> {
    let names = |names: &mut dyn Iterator<Item = &str>| names.map(str::to_owned).collect::<Vec<String>>();
    vec![
        ("tasks", tasks().map(|(name, summary)| format!("{name}: {summary}")).collect()),
        ("settings", settings().collect()),
        ("engines", names(&mut ENGINES.iter().map(|engine| engine.name))),
        ("robots", names(&mut built_in_robots())),
        ("policies", names(&mut POLICIES.into_iter().chain(Profile::built_in_names()))),
        ("spaces", names(&mut spaces())),
        ("suites", names(&mut BUILT_IN_SUITES.iter().map(|(name, _)| *name))),
    ]
}

/// The settings of all tasks, one line each.
fn settings() -> impl Iterator<Item = String> {
    let arms = ARM_TASKS.iter().map(|task| (task.name(), task.settings()));
    let others = TASKS.iter().map(|task| (task.name(), task.settings()));
    let line = |task: &str, setting: &SettingSpec| {
        let unit = |value: String| format!("{value} {}", setting.unit).trim_end().to_owned();
        let accepts = match &setting.allowed {
            Allowed::Continuous { low, high } => unit(format!("{low} to {high}")),
            Allowed::Integer { low, high } => unit(format!("{low} to {high}")),
            Allowed::Categorical { choices, .. } => choices.join(" or "),
        };
        let default = setting.default.as_ref().map_or("that of the robot".to_owned(), |value| unit(value.to_string()));
        format!("{task} {}: {} {accepts}, default {default}", setting.name, setting.meaning)
    };
    arms.chain(others).flat_map(move |(task, settings)| settings.into_iter().map(move |setting| line(task, &setting)))
}
