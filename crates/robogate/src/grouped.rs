//! The help of the command: its verbs by purpose.

use std::fmt::Write as _;

use clap::Command;

use crate::help::wrapped;

/// The verbs by purpose, as the help lists them.
const GROUPS: [(&str, &[&str]); 7] = [
    ("Start", &["init"]),
    ("Judge a policy", &["run", "gate", "resume", "compare", "rank", "rare", "leaderboard", "matrix", "fleet"]),
    ("Look at results", &["runs", "analyze", "report", "figure", "view", "replay", "import", "export", "audit"]),
    (
        "Bring your own",
        &["env", "policy", "robots", "tasks", "check", "serve", "demos", "list", "config", "completions"],
    ),
    ("Show that it holds", &["evidence", "verify", "keys"]),
    ("Use many machines", &["plan", "merge"]),
    ("Real robots", &["transfer", "trial", "admit", "requalify", "monitor", "warn"]),
];

/// The order of the parts of the help.
const TEMPLATE: &str = "{about-with-newline}\n{usage-heading} {usage}{after-help}\n\nOptions:\n{options}";

/// The columns before the text of a verb, and all of them.
const COLUMNS: [usize; 2] = [15, 100];

/// The same command, whose help lists the verbs by purpose.
pub(crate) fn by_purpose(command: Command) -> Command {
    let mut text = String::new();
    for (purpose, verbs) in GROUPS {
        let _ = writeln!(text, "{purpose}");
        for verb in verbs {
            let about = command.find_subcommand(verb).and_then(Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(
                text,
                "  {verb:<12} {}",
                wrapped(&about, COLUMNS[1] - COLUMNS[0]).join(&format!("\n{:1$}", "", COLUMNS[0]))
            );
        }
        text.push('\n');
    }
    text.push_str("`robogate help VERB` has the options of a verb.");
    command.help_template(TEMPLATE).after_help(text)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::CommandFactory;

    use super::GROUPS;

    #[test]
    fn every_verb_has_one_purpose() {
        let command = crate::Arguments::command();
        let verbs: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
        let listed: Vec<&str> = GROUPS.iter().flat_map(|(_, verbs)| verbs.iter().copied()).collect();
        assert_eq!(listed, verbs, "the order of the help is that of the declaration");
        assert_eq!(listed.iter().collect::<BTreeSet<_>>().len(), listed.len());
    }
}
