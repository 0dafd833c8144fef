//! `robogate config`: the settings of the project file, and where each value comes from.

use std::path::PathBuf;

use clap::{Args, CommandFactory};
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit};
use crate::project::{self, FILE, VERBS};
use crate::terminal::{bold, dim, foreign, line, note};

/// Show the settings of `run`, `gate`, `fleet`, `demos`, `serve` and `policy check` in a folder: those of its project file `robogate.toml`, and the defaults.
///
/// The keys of the file are the options of these verbs without dashes. A key at the top applies to all of them that have the option,
/// and one in a table `[run]`, `[gate]`, `[fleet]`, `[demos]` or `[serve]` to that verb. An option on the command line comes first. Other verbs do not
/// read the file.
#[derive(Debug, Args)]
pub(crate) struct Config {
    /// What to do
    #[arg(value_parser = ["show"], default_value = "show")]
    what: String,
    /// Folder of the project file
    #[arg(default_value = ".")]
    folder: PathBuf,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

/// A value that an option has without being given.
struct Effective {
    verb: &'static str,
    option: String,
    value: String,
    from: String,
}

impl Config {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let mut command = crate::Arguments::command();
        command.build();
        let table = project::read(&self.folder).or_usage()?;
        let mut all = Vec::new();
        for verb in VERBS {
            let settings =
                table.as_ref().map(|table| project::settings(&command, table, verb)).transpose().or_usage()?;
            let settings = settings.unwrap_or_default();
            for argument in project::find(&command, verb).into_iter().flat_map(clap::Command::get_arguments) {
                let Some(option) = argument.get_long() else { continue };
                let own = settings.iter().find(|setting| setting.option == option);
                let defaults = argument.get_default_values();
                let (value, from) = match own {
                    Some(setting) => (setting.values.join(", "), format!("{FILE} {}", setting.place)),
                    None if defaults.is_empty() || !argument.get_action().takes_values() => continue,
                    None => (
                        defaults.iter().map(|v| v.to_string_lossy()).collect::<Vec<_>>().join(", "),
                        "default".to_owned(),
                    ),
                };
                all.push(Effective { verb, option: option.to_owned(), value, from });
            }
        }
        if self.json {
            let document: Vec<_> = all
                .iter()
                .map(|of| json!({ "verb": of.verb, "option": of.option, "value": of.value, "from": of.from }))
                .collect();
            line(json!({ "version": 1, "settings": document }));
            return Ok(DONE);
        }
        let wide = all.iter().map(|of| of.option.len()).max().unwrap_or(0);
        for verb in VERBS {
            line(bold(verb));
            for of in all.iter().filter(|of| of.verb == verb) {
                let text = format!("  {:<wide$}  {}", of.option, foreign(&of.value));
                line(format_args!("{text}  {}", dim(&of.from)));
            }
        }
        if table.is_none() {
            note(format_args!("{} has no {FILE}", self.folder.display()));
        }
        Ok(DONE)
    }
}
