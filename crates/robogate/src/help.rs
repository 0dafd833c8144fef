//! The help of a verb: its options in the same groups everywhere. `-h` fits a screen, `--help` describes every option.

use std::ffi::OsString;

use clap::{Arg, Command};

use crate::terminal::{bold, line};

/// The groups, in the order of the help.
const GROUPS: [&str; 5] = ["What", "Where", "How many", "Output", "Advanced"];

/// The options of the first four groups, by name. All others are advanced.
const MEMBERS: [&[&str]; 4] = [
    &[
        "env",
        "policy",
        "profile",
        "map",
        "task",
        "robot",
        "space",
        "suite",
        "requirements",
        "baseline",
        "against",
        "run",
        "real",
        "sim",
        "units",
        "unit-space",
        "mapping",
        "reference",
        "success",
        "collisions-per-thousand",
        "cycle-time",
        "payload",
        "family",
        "nominal",
        "stress",
        "wordings",
        "rate",
        "event",
        "env-with",
        "bisect",
        "versions",
    ],
    &[
        "engine",
        "simulator",
        "python",
        "sandbox",
        "sandbox-read",
        "sandbox-write",
        "threads",
        "in-flight",
        "policy-at",
        "wait",
        "store",
        "listen",
        "bind",
        "port",
        "simulator-timeout",
    ],
    &[
        "n",
        "preset",
        "plan",
        "rounds",
        "seed",
        "design",
        "fixed",
        "share",
        "twins",
        "nominal-episodes",
        "controls",
        "margin",
        "target",
        "requests",
        "episodes",
        "check",
        "pairs",
        "all",
    ],
    &["out", "json", "html", "format", "gif", "mp4", "mcap", "png-strip", "sheet", "list", "force", "svg", "csv"],
];

/// Most lines of `-h`.
const LINES: usize = 25;
/// The columns of a line, and those before the text of an option.
const COLUMNS: [usize; 2] = [100, 34];

fn group(option: &Arg) -> usize {
    let name = option.get_long().unwrap_or_default();
    MEMBERS.iter().position(|members| members.contains(&name)).unwrap_or(MEMBERS.len())
}

/// The options of a group, in the order of the table and then of the verb.
fn options(command: &Command, of: usize) -> Vec<&Arg> {
    let hidden = ["help", "version", "quiet", "verbose"];
    let shown = |arg: &&Arg| !arg.is_positional() && !arg.is_hide_set() && !hidden.contains(&arg.get_id().as_str());
    let mut found: Vec<&Arg> = command.get_arguments().filter(shown).filter(|arg| group(arg) == of).collect();
    let members = MEMBERS.get(of).copied().unwrap_or_default();
    let place = |arg: &&Arg| members.iter().position(|name| arg.get_long() == Some(name)).unwrap_or(members.len());
    found.sort_by_key(place);
    found
}

/// The verb whose help the command line asks for, and whether it asks for the long one. `None` for the overview.
pub(crate) fn asked<'a>(command: &'a Command, words: &[OsString]) -> Option<(&'a Command, bool)> {
    let words: Vec<_> = words.iter().skip(1).map(|word| word.to_string_lossy()).collect();
    let by_word = words.first().is_some_and(|word| word == "help");
    let long = by_word || words.iter().any(|word| word == "--help");
    let named = words.iter().skip(usize::from(by_word)).filter(|word| !word.starts_with('-'));
    let mut found = command;
    for word in named {
        match found.find_subcommand(&**word) {
            Some(next) => found = next,
            None => break,
        }
    }
    // Lists of verbs have few options.
    (found.get_name() != command.get_name() && !found.has_subcommands()).then_some((found, long))
}

/// Prints the help of a verb.
pub(crate) fn show(command: &Command, long: bool) {
    let text = if long { long_help(command) } else { short_help(command) };
    text.iter().for_each(|(heading, text)| match heading {
        Some(heading) => line(format_args!("{}{text}", bold(heading))),
        None => line(text),
    });
}

/// A line, with its heading if it begins a group.
type Line = (Option<String>, String);

/// The parts of a command that a template renders, as lines.
fn rendered(command: Command, template: &'static str) -> Vec<String> {
    // The long form sets every option apart, which only descriptions of several paragraphs need.
    let is_long = command.get_arguments().any(|arg| !arg.is_hide_set() && arg.get_long_help().is_some());
    let mut command = command.help_template(template).max_term_width(COLUMNS[0]);
    let text = if is_long { command.render_long_help() } else { command.render_help() };
    text.to_string().trim_end().lines().map(|line| line.trim_end().to_owned()).collect()
}

/// The command, whose help shows these arguments only.
fn with(command: &Command, shown: &[&Arg]) -> Command {
    let shown: Vec<&str> = shown.iter().map(|arg| arg.get_id().as_str()).collect();
    command.clone().mut_args(|arg| {
        let hide = !shown.contains(&arg.get_id().as_str());
        arg.help_heading(None::<&'static str>).hide(hide)
    })
}

fn long_help(command: &Command) -> Vec<Line> {
    let plain = |text: String| (None, text);
    let about = command.get_long_about().or(command.get_about()).map(ToString::to_string).unwrap_or_default();
    let mut lines: Vec<Line> = about.lines().flat_map(|text| wrapped(text, COLUMNS[0])).map(plain).collect();
    lines.extend(["".to_owned(), usage(command)].map(plain));
    let positional: Vec<&Arg> = command.get_positionals().collect();
    let parts = std::iter::once(("Arguments", positional, "{positionals}"));
    let groups = GROUPS.iter().enumerate().map(|(of, name)| (*name, options(command, of), "{options}"));
    for (name, members, template) in parts.chain(groups).filter(|(_, members, _)| !members.is_empty()) {
        lines.push(plain(String::new()));
        lines.push((Some(format!("{name}:")), String::new()));
        lines.extend(rendered(with(command, &members), template).into_iter().map(plain));
    }
    lines.push(plain(
        "\n`--quiet` prints results, warnings and errors only. `--verbose` adds the details of a result.".to_owned(),
    ));
    lines
}

fn short_help(command: &Command) -> Vec<Line> {
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    let mut head = wrapped(&about, COLUMNS[0]);
    head.extend([String::new(), usage(command)]);
    let positional = command.get_positionals().map(|arg| described(&format!("  {arg}"), arg));
    head.extend(positional);
    head.push(String::new());
    let foot = format!("`robogate {} --help` describes every option.", path(command));
    let mut groups: Vec<Vec<String>> = (0..GROUPS.len()).map(|of| one_each(&options(command, of))).collect();
    // Where not all options fit, the last ones of a group are a list of names: first in the least important group.
    for of in [4, 1, 2, 0, 3] {
        let others: usize = groups.iter().map(Vec::len).sum::<usize>() - groups[of].len();
        let room = LINES.saturating_sub(head.len() + others + 2);
        let members = options(command, of);
        let some = (0..=members.len()).rev().map(|first| {
            let (described, rest) = members.split_at(first);
            [one_each(described), names(rest)].concat()
        });
        groups[of] = some.into_iter().find(|lines| lines.len() <= room).unwrap_or_else(|| names(&members));
    }
    let mut lines: Vec<Line> = head.into_iter().map(|text| (None, text)).collect();
    for (name, group) in GROUPS.iter().zip(groups) {
        for (at, text) in group.into_iter().enumerate() {
            let name = if at == 0 { *name } else { "" };
            lines.push((Some(format!("{name:<10}")), text));
        }
    }
    lines.push((None, String::new()));
    lines.push((None, foot));
    lines
}

/// `robogate run` without its first word.
fn path(command: &Command) -> String {
    let whole = command.get_bin_name().unwrap_or_else(|| command.get_name());
    whole.split_once(' ').map_or(whole, |(_, rest)| rest).to_owned()
}

fn usage(command: &Command) -> String {
    let mut usage = format!("Usage: robogate {} [OPTIONS]", path(command));
    for arg in command.get_positionals() {
        usage += &format!(" {arg}");
    }
    usage
}

/// An option with its value: `-n, --n <N>`.
fn form(arg: &Arg) -> String {
    match arg.get_short() {
        Some(short) => format!("-{short}, {arg}"),
        None => arg.to_string(),
    }
}

/// A name with the start of its description, in one line.
fn described(name: &str, arg: &Arg) -> String {
    let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
    let help = ["\n", ";", ": ", " ("].iter().fold(&*help, |text, end| text.split(end).next().unwrap_or_default());
    let room = COLUMNS[0] - COLUMNS[1] - 15;
    let mut text: String = wrapped(help, room).into_iter().next().unwrap_or_default();
    if text.len() < help.len() {
        text += " ...";
    }
    format!("{name:<wide$} {text}", wide = COLUMNS[1]).trim_end().to_owned()
}

fn one_each(options: &[&Arg]) -> Vec<String> {
    options.iter().map(|arg| described(&form(arg), arg)).collect()
}

/// The names of options, several in a line.
fn names(options: &[&Arg]) -> Vec<String> {
    if options.is_empty() {
        return Vec::new();
    }
    let names: Vec<String> = options.iter().map(|arg| format!("--{}", arg.get_long().unwrap_or_default())).collect();
    wrapped(&names.join(" "), COLUMNS[0] - 10)
}

/// A text in lines of at most this number of columns.
pub(crate) fn wrapped(text: &str, columns: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.len() - 1;
        if !lines[last].is_empty() && lines[last].chars().count() + 1 + word.chars().count() > columns {
            lines.push(word.to_owned());
        } else {
            if !lines[last].is_empty() {
                lines[last].push(' ');
            }
            lines[last].push_str(word);
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    /// All verbs, with those below others.
    fn all(command: &Command) -> Vec<&Command> {
        command.get_subcommands().flat_map(|verb| std::iter::once(verb).chain(all(verb))).collect()
    }

    #[test]
    fn short_help_of_every_verb_fits_a_screen() {
        let mut command = crate::Arguments::command();
        command.build();
        let verbs: Vec<&Command> = all(&command).into_iter().filter(|verb| !verb.has_subcommands()).collect();
        assert!(verbs.len() > 30, "{}", verbs.len());
        for verb in verbs {
            let short = short_help(verb);
            assert!(short.len() <= LINES, "{}: {} lines", verb.get_name(), short.len());
            let long = long_help(verb);
            let text = |lines: &[Line]| {
                lines.iter().map(|(a, b)| format!("{}{b}\n", a.clone().unwrap_or_default())).collect::<String>()
            };
            let (short, long) = (text(&short), text(&long));
            for line in short.lines() {
                assert!(line.chars().count() <= COLUMNS[0], "{}: {line}", verb.get_name());
            }
            // Both have every option, and the long one in the same groups.
            for (of, group) in GROUPS.iter().enumerate() {
                for arg in options(verb, of) {
                    let name = format!("--{}", arg.get_long().unwrap());
                    assert!(short.contains(&name) && long.contains(&name), "{}: {name}", verb.get_name());
                }
                assert_eq!(long.contains(&format!("{group}:\n")), !options(verb, of).is_empty(), "{}", verb.get_name());
            }
        }
    }

    /// A name in the table is one that some verb has.
    #[test]
    fn groups_name_options_that_exist() {
        let mut command = crate::Arguments::command();
        command.build();
        let known: Vec<&str> =
            all(&command).into_iter().flat_map(Command::get_arguments).filter_map(Arg::get_long).collect();
        for name in MEMBERS.iter().flat_map(|members| members.iter()) {
            assert!(known.contains(name), "{name}");
        }
    }
}
