//! `robogate keys`: the key that signs evidence.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use robogate_gate::evidence::{PrivateKey, PublicKey};

use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{line, note};

/// Make and name the keys that sign evidence (ed25519, PEM).
#[derive(Debug, Args)]
pub(crate) struct Keys {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Make a key: the private half in FILE, for you alone, the public half in FILE.pub, for everyone
    New {
        /// The file of the private key; nothing that is there is overwritten
        file: PathBuf,
    },
    /// Say what a public key is called
    Id {
        /// The file of the public key
        file: PathBuf,
    },
}

impl Keys {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.verb {
            Verb::New { file } => {
                let key = PrivateKey::generate().or_broken()?;
                let public = key.write_new(file).or_usage()?;
                note(format_args!("{}: the private key; keep it to yourself", file.display()));
                note(format_args!("{}: the public key; give it to whoever checks", public.display()));
                line(key.public().id());
            }
            Verb::Id { file } => line(PublicKey::read(file).or_usage()?.id()),
        }
        Ok(DONE)
    }
}
