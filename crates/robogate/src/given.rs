//! The options on the command line.

use clap::parser::ValueSource;
use clap::{ArgMatches, Args, FromArgMatches, Id};

/// The arguments on the command line, by name.
#[derive(Debug)]
pub(crate) struct Given(Vec<String>);

impl Given {
    /// The names of all of them.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }

    /// Whether this argument is on the command line.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.names().any(|given| given == name)
    }

    /// The options that are not among the `used` arguments, as on the command line. `None` without any.
    pub(crate) fn beside(&self, used: &[&str]) -> Option<String> {
        let unused: Vec<String> =
            self.0.iter().filter(|name| !used.contains(&name.as_str())).map(|name| option(name)).collect();
        (!unused.is_empty()).then(|| unused.join(", "))
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
        Ok(Self(given.map(str::to_owned).collect()))
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
    use clap::CommandFactory;

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
        let given = Given(["policies", "json", "goes_on"].map(str::to_owned).to_vec());
        assert_eq!(given.beside(&["policies", "json"]).as_deref(), Some("--continue"));
        assert_eq!(given.beside(&["policies", "json", "goes_on"]), None);
    }
}
