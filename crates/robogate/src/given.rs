//! The options on the command line.

use clap::parser::ValueSource;
use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Id};
use robogate_analysis::shell_word;

/// The arguments on the command line by name, each with the values of each time that it is there.
#[derive(Debug)]
pub(crate) struct Given(Vec<(String, Vec<Vec<String>>)>);

impl Given {
    /// The names of all of them.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|(name, _)| name.as_str())
    }

    /// Whether this argument is on the command line.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.names().any(|given| given == name)
    }

    /// The options that are not among the `used` arguments, as on the command line. `None` without any.
    pub(crate) fn beside(&self, used: &[&str]) -> Option<String> {
        let unused: Vec<String> = self.names().filter(|name| !used.contains(name)).map(option).collect();
        (!unused.is_empty()).then(|| unused.join(", "))
    }

    /// The options that a verb also has, except those named, as words of a shell command with a space before each.
    pub(crate) fn again(&self, verb: &str, except: &[&str]) -> String {
        let mut command = crate::Arguments::command();
        command.build();
        let arguments = command.find_subcommand(verb).into_iter().flat_map(clap::Command::get_arguments);
        let mut words = String::new();
        for argument in arguments.filter(|argument| argument.get_long().is_some()) {
            let given = self.0.iter().find(|(name, _)| argument.get_id() == name.as_str());
            let Some((name, occurrences)) = given.filter(|(name, _)| !except.contains(&name.as_str())) else {
                continue;
            };
            if !argument.get_action().takes_values() {
                words += &format!(" {}", option(name));
                continue;
            }
            let between = if argument.is_require_equals_set() { '=' } else { ' ' };
            for values in occurrences {
                words += &format!(" {}", option(name));
                let many = argument.get_num_args().is_some_and(|range| range.max_values() > 1);
                for (at, value) in values.iter().enumerate() {
                    // A list with commas comes apart: the option stands before each of its values.
                    if at > 0 && !many {
                        words += &format!(" {}", option(name));
                    }
                    words.push(between);
                    words += &shell_word(value);
                }
            }
        }
        words
    }
}

/// The option of an argument.
fn option(name: &str) -> String {
    match name {
        "goes_on" => "--continue".to_owned(),
        "columns" => "--groups".to_owned(),
        "addresses" => "--simulator".to_owned(),
        "timeout_s" => "--simulator-timeout".to_owned(),
        name => format!("--{}", name.replace('_', "-")),
    }
}

impl FromArgMatches for Given {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        // The groups of clap have the names of types, which start with an upper-case letter.
        let arguments = matches.ids().map(Id::as_str).filter(|name| name.starts_with(|c: char| c.is_ascii_lowercase()));
        let given = arguments.filter(|name| matches.value_source(name) == Some(ValueSource::CommandLine));
        let raw = |name: &str| -> Vec<Vec<String>> {
            let occurrences = matches.get_raw_occurrences(name).into_iter().flatten();
            occurrences.map(|values| values.map(|value| value.to_string_lossy().into_owned()).collect()).collect()
        };
        Ok(Self(given.map(|name| (name.to_owned(), raw(name))).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for Given {
    fn augment_args(command: clap::Command) -> clap::Command {
        command
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        command
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_have_their_names() {
        let command = crate::Arguments::command();
        let rank = command.find_subcommand("rank").unwrap();
        for argument in rank.get_arguments() {
            if let Some(long) = argument.get_long() {
                assert_eq!(option(argument.get_id().as_str()), format!("--{long}"));
            }
        }
    }

    #[test]
    fn unused_options_are_found() {
        let given = Given(["policies", "json", "goes_on"].map(|name| (name.to_owned(), Vec::new())).to_vec());
        assert_eq!(given.beside(&["policies", "json"]).as_deref(), Some("--continue"));
        assert_eq!(given.beside(&["policies", "json", "goes_on"]), None);
    }

    #[test]
    fn a_command_is_repeated_with_its_options() {
        let words = "robogate gate --env my_env.py:Env --python /opt/a~b/python --requirements r.toml --set jam_force_n=50 \
                     --set tolerance_m=0.02 --seed 3 --rounds 9 --sandbox=on --stress images,language --fixed --out x";
        // One of the paths has a space.
        let words = words.split_whitespace().map(|word| word.replace('~', " "));
        let words: Vec<String> = words.collect();
        let matches = crate::Arguments::command().get_matches_from(words);
        let given = Given::from_arg_matches(matches.subcommand_matches("gate").unwrap()).unwrap();
        assert_eq!(
            given.again("gate", &["seed", "rounds", "out"]),
            " --requirements r.toml --fixed --env my_env.py:Env --set jam_force_n=50 --set tolerance_m=0.02 --python '/opt/a b/python' --sandbox=on --stress images --stress language"
        );
        let run = given.again("run", &["seed", "rounds", "out"]);
        assert!(!run.contains("requirements") && run.contains("--env my_env.py:Env"), "{run}");
    }
}
