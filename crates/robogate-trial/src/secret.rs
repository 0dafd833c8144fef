//! The secret of a study: the seed of order, codes and set-ups, and the key of the journal.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::Path;

use robogate_core::Seed;
use robogate_dictionary::hex;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::Problem;

/// The secret of a study. It is published when the study is unblinded.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Secret {
    /// Seed of order, codes and set-ups.
    seed: u64,
    /// Key of the journal (hex), 256 bits. It also hides the seed in the published hash.
    key: String,
}

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Secret")
    }
}

/// Random bytes of the operating system.
fn random<const N: usize>() -> Result<[u8; N], Problem> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|error| Problem::Random(error.to_string()))?;
    Ok(bytes)
}

/// A token of 128 random bits, as hexadecimal digits.
///
/// # Errors
/// If the operating system has no random numbers.
pub fn random_token() -> Result<String, Problem> {
    random::<16>().map(|bytes| hex(&bytes))
}

impl Secret {
    /// Draws a secret from the operating system.
    ///
    /// # Errors
    /// If the operating system has no random numbers.
    pub fn draw() -> Result<Self, Problem> {
        Ok(Self { seed: u64::from_le_bytes(random()?), key: hex(&random::<32>()?) })
    }

    /// The seed.
    pub fn seed(&self) -> Seed {
        Seed::campaign(self.seed)
    }

    /// SHA-256 (hex), which the plan publishes.
    pub fn sha256(&self) -> String {
        hex(&Sha256::digest(format!("robogate trial secret 1\n{}\n{}\n", self.seed, self.key)))
    }

    /// HMAC-SHA-256 (RFC 2104) of `message` with the key of the journal, as hexadecimal digits.
    pub fn mac(&self, message: &[u8]) -> String {
        // The key has 64 digits: one block of the hash.
        let pad = |byte: u8| self.key.bytes().map(|digit| digit ^ byte).collect::<Vec<u8>>();
        let inner = Sha256::new().chain_update(pad(0x36)).chain_update(message).finalize();
        hex(&Sha256::new().chain_update(pad(0x5c)).chain_update(inner).finalize())
    }

    /// Reads the file of a secret.
    ///
    /// # Errors
    /// If the file cannot be read or is not a secret.
    pub fn read(path: &Path) -> Result<Self, Problem> {
        let wrong = |reason: String| Problem::File { path: path.to_owned(), reason };
        let text = robogate_dictionary::read_regular_text(path).map_err(|error| wrong(error.to_string()))?;
        let secret: Self = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        if secret.key.len() != 64 {
            return Err(wrong("its key does not have 64 digits".to_owned()));
        }
        Ok(secret)
    }

    /// Writes a new file that only its owner can read.
    ///
    /// # Errors
    /// If the file exists or cannot be written.
    pub fn write_new(&self, path: &Path) -> Result<(), Problem> {
        let text = serde_json::to_string(self).unwrap_or_default() + "\n";
        write_private(path, &text)
    }
}

/// Writes a new file that only its owner can read.
///
/// # Errors
/// If the file exists or cannot be written.
pub fn write_private(path: &Path, text: &str) -> Result<(), Problem> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let write = |mut file: File| file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    options
        .open(path)
        .and_then(write)
        .map_err(|error| Problem::File { path: path.to_owned(), reason: error.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The value is that of Python's `hmac.new(key, message, hashlib.sha256)`.
    #[test]
    fn mac_is_hmac_sha256() {
        let secret = Secret { seed: 1, key: "0123456789abcdef".repeat(4) };
        assert_eq!(secret.mac(b"trial"), "96c4b714a100bb1e00c19a55dc528d8a14b8f9e95a2b76225c3718888b54bc6e");
        assert_ne!(secret.sha256(), Secret { seed: 2, ..secret.clone() }.sha256());
        assert_eq!(format!("{secret:?}"), "Secret");
    }

    #[cfg(unix)]
    #[test]
    fn only_the_owner_reads_it() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("secret.json");
        let secret = Secret::draw().unwrap();
        secret.write_new(&path).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(Secret::read(&path).unwrap(), secret);
        assert!(secret.write_new(&path).is_err());
        assert_ne!(Secret::draw().unwrap(), secret);
    }
}
