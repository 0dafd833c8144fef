//! `robogate list`: lists the contents of this build by name.

use clap::Args;
use robogate_campaign::BUILT_IN_SUITES;
use robogate_core::{Allowed, SettingSpec};
use robogate_physics::built_in_robots;
use robogate_policy::Profile;
use robogate_session::{ARM_TASKS, ENGINES, POLICIES, TASKS, spaces, tasks};
use serde_json::{Map, Value, json};

use crate::exit::{DONE, Exit};
use crate::terminal::{bold, line};

/// List the tasks, engines, robots, policies, spaces and suites of this build.
#[derive(Debug, Args)]
pub(crate) struct List {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl List {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let listing = listing();
        if self.json {
            let mut document: Map<String, Value> =
                listing.into_iter().map(|(kind, names)| (kind.to_owned(), json!(names))).collect();
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
