//! The project file: settings of `run`, `gate`, `fleet`, `demos`, `serve` and `policy check` that need not be repeated on every command line.
//!
//! Its keys are the options of these verbs. A key at the top applies to every verb that has the option, and one in a table such as
//! `[gate]` to this verb. What the command line says comes first. Other verbs do not read the file: it could name a program, and a
//! folder that somebody else made must not start it.

use std::ffi::OsString;
use std::path::Path;

use anyhow::{Context, anyhow, bail};
use clap::error::{ContextKind, ContextValue};
use clap::{Arg, ArgAction, Command};
use robogate_core::budget::Budget;
use robogate_dictionary::read_text;
use toml::{Table, Value};

use crate::commands::matrix::CHILD;

/// The name of the file, in the current folder.
pub(crate) const FILE: &str = "robogate.toml";

/// The verbs that read it: those that start the environment and the policy that the user chooses.
pub(crate) const VERBS: [&str; 6] = ["run", "gate", "fleet", "demos", "serve", "policy check"];

/// Keys at the top that `demos` does not read: those of campaigns.
const OF_CAMPAIGNS: [&str; 4] = ["seed", "out", "suite", "n"];

/// Options that say how an environment is started. They are left out with it.
const OF_ENV: [&str; 2] = ["python", "map"];

/// One setting of the file for a verb.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Setting {
    /// The option, without dashes.
    pub(crate) option: String,
    /// Its values: one, or several for an option that is given several times.
    pub(crate) values: Vec<String>,
    /// Whether the option takes no value.
    is_flag: bool,
    /// Where it is in the file: at the top, or in the table of the verb.
    pub(crate) place: String,
}

impl Setting {
    /// The setting of an option.
    ///
    /// # Errors
    /// A value of another kind than the option has.
    fn new(option: &Arg, value: &Value, place: String) -> anyhow::Result<Self> {
        let (name, is_flag) = (name(option), matches!(option.get_action(), ArgAction::SetTrue));
        let values = match value {
            Value::Boolean(on) if is_flag => vec![on.to_string()],
            _ if is_flag => bail!("{FILE}: `{name}` is true or false"),
            Value::Array(values) => values.iter().map(|value| text(&name, value)).collect::<anyhow::Result<_>>()?,
            value => vec![text(&name, value)?],
        };
        Ok(Self { option: name, values, is_flag, place })
    }

    /// The arguments that it stands for. A flag that is switched off stands for none.
    pub(crate) fn arguments(&self) -> Vec<String> {
        match self.is_flag {
            true if self.values.iter().all(|on| on == "false") => Vec::new(),
            true => vec![format!("--{}", self.option)],
            false => self.values.iter().map(|value| format!("--{}={value}", self.option)).collect(),
        }
    }
}

/// The settings of the file in this folder. `None` without the file.
pub(crate) fn read(folder: &Path) -> anyhow::Result<Option<Table>> {
    let path = folder.join(FILE);
    if !path.is_file() {
        return Ok(None);
    }
    let text = read_text(&path).with_context(|| format!("cannot read {FILE}"))?;
    Budget::FILE.toml(&text).map(Some).with_context(|| FILE.to_owned())
}

/// The settings of the file for one verb.
///
/// # Errors
/// A key that is not an option of any of the verbs, or a value of another kind than the option has.
pub(crate) fn settings(command: &Command, table: &Table, verb: &str) -> anyhow::Result<Vec<Setting>> {
    let mut found: Vec<Setting> = Vec::new();
    for (key, value) in table {
        match value {
            Value::Table(own) if VERBS.contains(&key.as_str()) => {
                // The tables of the other verbs are checked too.
                for (option_key, value) in own {
                    let setting = Setting::new(option(command, &[key], option_key)?, value, format!("[{key}]"))?;
                    if key == verb {
                        found.retain(|other| other.option != setting.option);
                        found.push(setting);
                    }
                }
            }
            _ => {
                // A key at the top must belong to one of the verbs, and need not belong to this one.
                option(command, &VERBS, key)?;
                let Ok(option) = option(command, &[verb], key) else { continue };
                // Demonstrations on the scenarios of a gate would train a policy on its test.
                if verb == "demos" && OF_CAMPAIGNS.contains(&key.as_str()) {
                    continue;
                }
                let setting = Setting::new(option, value, "top".to_owned())?;
                if found.iter().all(|other| other.option != setting.option) {
                    found.push(setting);
                }
            }
        }
    }
    Ok(found)
}

/// The command line with the settings of the project file in the current folder, if its verb reads it, and what was added. A setting
/// that the command line has, or that contradicts it, is left out.
pub(crate) fn completed(command: &Command, line: Vec<OsString>) -> anyhow::Result<(Vec<OsString>, Vec<Setting>)> {
    let Some(at) = line.iter().skip(1).position(|word| !word.to_string_lossy().starts_with('-')) else {
        return Ok((line, Vec::new()));
    };
    let words = |count: usize| {
        let words = line.iter().skip(at + 1).take(count).map(|word| word.to_string_lossy());
        words.collect::<Vec<_>>().join(" ")
    };
    let Some((verb, count)) =
        [1, 2].map(|count| (words(count), count)).into_iter().find(|(verb, _)| VERBS.contains(&&**verb))
    else {
        return Ok((line, Vec::new()));
    };
    let (before, after) = line.split_at(at + 1 + count);
    let Some(own) = find(command, &verb) else { return Ok((line, Vec::new())) };
    let given: Vec<&Arg> =
        own.get_arguments().filter(|argument| after.iter().any(|word| names(word, argument))).collect();
    // A shard belongs to a plan that exists, the runs of a sweep have all their options, and help starts nothing.
    let asks = |option: &str| given.iter().any(|argument| name(argument) == option);
    if asks("shard") || asks("help") || std::env::var_os(CHILD).is_some() {
        return Ok((line, Vec::new()));
    }
    let Some(table) = read(Path::new("."))? else { return Ok((line, Vec::new())) };
    let mut settings = settings(command, &table, &verb)?;
    settings.retain(|setting| {
        let Some(argument) = own.get_arguments().find(|argument| name(argument) == setting.option) else {
            return false;
        };
        // Only one of two options need declare that they contradict each other.
        let contradicts =
            |one: &Arg, other: &Arg| own.get_arg_conflicts_with(one).iter().any(|of| of.get_id() == other.get_id());
        !given.iter().any(|other| {
            other.get_id() == argument.get_id() || contradicts(argument, other) || contradicts(other, argument)
        })
    });
    if table.contains_key("env") && !settings.iter().any(|setting| setting.option == "env") && !asks("env") {
        settings.retain(|setting| !OF_ENV.contains(&setting.option.as_str()));
    }
    let added = settings.iter().flat_map(Setting::arguments).map(OsString::from);
    Ok((before.iter().cloned().chain(added).chain(after.iter().cloned()).collect(), settings))
}

/// Whether an error in the command line is about this setting.
pub(crate) fn is_about(why: &clap::Error, setting: &Setting) -> bool {
    let named = match why.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(named)) => std::slice::from_ref(named),
        Some(ContextValue::Strings(named)) => named,
        _ => return false,
    };
    let option = |named: &String| named.split([' ', '=']).next() == Some(&format!("--{}", setting.option));
    named.iter().any(option)
}

/// Whether a word of the command line gives this option: `--name`, `--name=value`, or a letter of `-abc`.
fn names(word: &OsString, argument: &Arg) -> bool {
    let word = word.to_string_lossy();
    match word.strip_prefix("--") {
        Some(long) => argument.get_long().is_some_and(|name| long.split('=').next() == Some(name)),
        None => {
            word.strip_prefix('-').is_some_and(|letters| argument.get_short().is_some_and(|of| letters.contains(of)))
        }
    }
}

fn name(argument: &Arg) -> String {
    argument.get_long().unwrap_or(argument.get_id().as_str()).to_owned()
}

/// The command of a verb, which may be below another one.
pub(crate) fn find<'a>(command: &'a Command, verb: &str) -> Option<&'a Command> {
    verb.split(' ').try_fold(command, |command, word| command.find_subcommand(word))
}

/// The option of one of these verbs with this name.
fn option<'a>(command: &'a Command, verbs: &[&str], key: &str) -> anyhow::Result<&'a Arg> {
    let wanted = key.replace('_', "-");
    let options = || {
        let verbs = verbs.iter().filter_map(|verb| find(command, verb));
        verbs.flat_map(Command::get_arguments).filter(|argument| argument.get_long().is_some())
    };
    options().find(|argument| name(argument) == wanted).ok_or_else(|| {
        let near = options().map(name).max_by(|a, b| likeness(a, &wanted).total_cmp(&likeness(b, &wanted)));
        let hint = near.filter(|near| likeness(near, &wanted) > 0.6).map(|near| format!(" Did you mean `{near}`?"));
        anyhow!("{FILE}: `{key}` is not an option of {}.{}", verbs.join(", "), hint.unwrap_or_default())
    })
}

/// How alike two words are, from 0 to 1: the share of their pairs of neighbouring letters that they have in common (Dice).
fn likeness(one: &str, other: &str) -> f64 {
    let pairs = |word: &str| word.as_bytes().windows(2).map(<[u8]>::to_vec).collect::<Vec<_>>();
    let (a, mut b) = (pairs(one), pairs(other));
    let all = a.len() + b.len();
    let mut common = 0;
    for pair in a {
        if let Some(at) = b.iter().position(|other| *other == pair) {
            b.swap_remove(at);
            common += 1;
        }
    }
    if all == 0 { 0.0 } else { 2.0 * f64::from(common) / all as f64 }
}

/// A value as the command line has it.
fn text(option: &str, value: &Value) -> anyhow::Result<String> {
    Ok(match value {
        Value::String(text) => text.clone(),
        Value::Integer(number) => number.to_string(),
        Value::Float(number) => number.to_string(),
        _ => bail!("{FILE}: `{option}`: expected a text, a number, or a list of them"),
    })
}
