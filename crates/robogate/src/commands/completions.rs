//! `robogate completions`: completions of the shell, and man pages.

use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, CommandFactory, ValueEnum};
use clap_complete::{Generator, Shell};
use robogate_dictionary::files;

use crate::exit::{DONE, Exit, OrExit};
use crate::place;
use crate::terminal::{line, note};

/// Write the completions of a shell, or man pages, for a package or a profile.
///
/// bash: `robogate completions bash > ~/.local/share/bash-completion/completions/robogate`
#[derive(Debug, Args)]
pub(crate) struct Completions {
    /// What to write
    #[arg(value_enum)]
    what: What,
    /// Write to this folder; default: stdout. Man pages need it, because they are several files
    #[arg(long, value_name = "DIR", value_parser = place::local(), required_if_eq("what", "man"))]
    out: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    Bash,
    Zsh,
    Fish,
    Man,
}

impl Completions {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let mut command = crate::Arguments::command();
        let shell = match self.what {
            What::Bash => Shell::Bash,
            What::Zsh => Shell::Zsh,
            What::Fish => Shell::Fish,
            What::Man => {
                let out = self.out.as_deref().unwrap_or_else(|| std::path::Path::new("."));
                files::create_folders(out)
                    .and_then(|()| clap_mangen::generate_to(command, out))
                    .with_context(|| format!("cannot write the man pages into {}", out.display()))
                    .or_unwritable()?;
                note(format_args!("man pages: {}", out.display()));
                return Ok(DONE);
            }
        };
        match &self.out {
            None => {
                // The generator does not expect a reader that leaves early.
                let mut script = Vec::new();
                clap_complete::generate(shell, &mut command, "robogate", &mut script);
                line(String::from_utf8_lossy(&script).trim_end());
            }
            Some(out) => {
                // The generator would end the process at an error.
                let mut script = Vec::new();
                clap_complete::generate(shell, &mut command, "robogate", &mut script);
                let file = out.join(shell.file_name("robogate"));
                files::create_folders(out)
                    .and_then(|()| files::write(&file, script))
                    .with_context(|| format!("cannot write {}", file.display()))
                    .or_unwritable()?;
                note(format_args!("completions: {}", file.display()));
            }
        }
        Ok(DONE)
    }
}
