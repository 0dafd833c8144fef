//! `robogate keys`: creates and identifies the keys that sign evidence.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use robogate_gate::evidence::{PrivateKey, PublicKey};

use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{line, note};

/// Create and identify the keys that sign evidence (ed25519, PEM).
#[derive(Debug, Args)]
pub(crate) struct Keys {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Create a key pair: the private key in FILE, which only you can read, and the public key in FILE.pub
    New {
        /// File of the private key; existing files are not overwritten
        file: PathBuf,
    },
    /// Print the identifier of a public key
    Id {
        /// File of the public key
        file: PathBuf,
    },
}

impl Keys {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.verb {
            Verb::New { file } => {
                let key = PrivateKey::generate().or_broken()?;
                let public = key.write_new(file).or_unwritable()?;
                note(format_args!("{}: private key. Do not share it", file.display()));
                note(format_args!("{}: public key. Give it to those who verify evidence", public.display()));
                line(key.public().id());
            }
            Verb::Id { file } => line(PublicKey::read(file).or_usage()?.id()),
        }
        Ok(DONE)
    }
}
