//! The user's signing key: ed25519, as PEM files that OpenSSL can read.

use std::fmt;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use ed25519_dalek::pkcs8::spki::der::pem::LineEnding;
use ed25519_dalek::pkcs8::{DecodePrivateKey, DecodePublicKey, EncodePrivateKey, EncodePublicKey, KeypairBytes};
use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use robogate_dictionary::hex;
use sha2::{Digest, Sha256};
use zeroize::Zeroizing;

use super::EvidenceError;

/// Size limit of a key file, in bytes. A key has a few hundred bytes.
const LONGEST: u64 = 1 << 14;

/// A private key. It is wiped from memory when it is dropped, and never printed.
pub struct PrivateKey(SigningKey);

impl fmt::Debug for PrivateKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PrivateKey of {}", self.public().id())
    }
}

impl PrivateKey {
    /// Generates a key from the operating system's random numbers.
    #[expect(clippy::disallowed_methods, reason = "a private key must not be predictable")]
    pub fn generate() -> Result<Self, EvidenceError> {
        let mut seed = Zeroizing::new([0; 32]);
        getrandom::fill(seed.as_mut()).map_err(|e| EvidenceError::Random(e.to_string()))?;
        Ok(Self(SigningKey::from_bytes(&seed)))
    }

    /// The key with this seed (RFC 8032).
    pub fn from_seed(seed: [u8; 32]) -> Self {
        Self(SigningKey::from_bytes(&seed))
    }

    /// Reads PKCS#8 PEM (RFC 8410). A file that other users can read is rejected.
    pub fn read(path: &Path) -> Result<Self, EvidenceError> {
        const WHAT: &str = "private key";
        let (file, metadata) = open(path, WHAT)?;
        let wrong = |reason: String| EvidenceError::NotAKey { path: path.to_owned(), what: WHAT, reason };
        let text = text_of(file, path)?;
        if text.contains("PUBLIC KEY") {
            return Err(wrong(
                "it is a public key\nHint: sign with the private key file that `robogate keys new` wrote beside it"
                    .to_owned(),
            ));
        }
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = metadata.permissions().mode() & 0o777;
            if mode & 0o077 != 0 {
                return Err(EvidenceError::KeyMode { path: path.to_owned(), mode });
            }
        }
        #[cfg(not(unix))]
        let _ = metadata;
        // The library's error could contain parts of the key, so a hint replaces it.
        let key = SigningKey::from_pkcs8_pem(&text).map_err(|_| {
            wrong("not PKCS#8 PEM of an ed25519 key\nHint: create one with `robogate keys new FILE`".to_owned())
        })?;
        Ok(Self(key))
    }

    /// Writes the private key to `path`, readable only by its owner, and the public key to `path` with the suffix
    /// `.pub`. Returns the path of the public key. Existing files are not overwritten.
    pub fn write_new(&self, path: &Path) -> Result<PathBuf, EvidenceError> {
        let mut public = path.as_os_str().to_owned();
        public.push(".pub");
        let public = PathBuf::from(public);
        let exists = |path: &Path| EvidenceError::Exists {
            path: path.to_owned(),
            hint: "keys are not overwritten. Choose another name",
        };
        // Checks links too, for any target.
        if public.symlink_metadata().is_ok() {
            return Err(exists(&public));
        }
        // Version 1, without the public key, because OpenSSL rejects version 2.
        let bytes = KeypairBytes { secret_key: self.0.to_bytes(), public_key: None };
        let pem = bytes.to_pkcs8_pem(LineEnding::LF).map_err(|e| EvidenceError::NotAKey {
            path: path.to_owned(),
            what: "private key",
            reason: e.to_string(),
        })?;
        let create = |path: &Path, mode: u32, text: &str| {
            let mut options = OpenOptions::new();
            options.write(true).create_new(true);
            #[cfg(unix)]
            std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
            #[cfg(not(unix))]
            let _ = mode;
            let mut file = options.open(path).map_err(|error| match error.kind() {
                std::io::ErrorKind::AlreadyExists => exists(path),
                _ => EvidenceError::io(path, "create")(error),
            })?;
            let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
            if written.is_err() {
                // Half a key pair is useless. The write error is returned already.
                let _ = std::fs::remove_file(path);
            }
            written.map_err(EvidenceError::io(path, "write"))
        };
        create(path, 0o600, &pem)?;
        if let Err(error) = create(&public, 0o644, &self.public().to_pem()) {
            let _ = std::fs::remove_file(path);
            return Err(error);
        }
        Ok(public)
    }

    /// The public key of this private key.
    pub fn public(&self) -> PublicKey {
        PublicKey(self.0.verifying_key())
    }

    /// Signs `message`. Equal messages have equal signatures.
    pub fn sign(&self, message: &[u8]) -> [u8; 64] {
        self.0.sign(message).to_bytes()
    }
}

/// A public key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PublicKey(VerifyingKey);

impl PublicKey {
    /// Reads SubjectPublicKeyInfo PEM (RFC 8410).
    pub fn read(path: &Path) -> Result<Self, EvidenceError> {
        let (file, _) = open(path, "public key")?;
        let text = text_of(file, path)?;
        Self::from_pem(&text).map_err(|reason| EvidenceError::NotAKey {
            path: path.to_owned(),
            what: "public key",
            reason,
        })
    }

    /// Parses SubjectPublicKeyInfo PEM. The error describes the problem, with a hint.
    pub fn from_pem(text: &str) -> Result<Self, String> {
        if text.contains("PRIVATE KEY") {
            return Err(
                "it is a private key\nHint: use the file with the suffix .pub, and do not share this one".to_owned()
            );
        }
        // The library names a byte of its parser, also one that is not in the text.
        VerifyingKey::from_public_key_pem(text).map(Self).map_err(|_| {
            "not SubjectPublicKeyInfo PEM of an ed25519 key\nHint: expected the file with the suffix .pub that `robogate keys new` wrote"
                .to_owned()
        })
    }

    /// The key of these 32 bytes. `None` if they are not a point of the curve.
    pub fn from_bytes(bytes: &[u8; 32]) -> Option<Self> {
        VerifyingKey::from_bytes(bytes).ok().map(Self)
    }

    /// The key as SubjectPublicKeyInfo PEM.
    pub fn to_pem(&self) -> String {
        // Encoding 32 bytes in a fixed structure cannot fail.
        self.0.to_public_key_pem(LineEnding::LF).unwrap_or_default()
    }

    /// The key's identifier: SHA-256 (hex) of its DER form, as `openssl pkey -pubin -outform DER | sha256sum` prints.
    pub fn id(&self) -> String {
        let der = self.0.to_public_key_der().map(|der| der.as_bytes().to_vec()).unwrap_or_default();
        hex(&Sha256::digest(der))
    }

    /// Whether `signature` is a signature of `message` by this key. The check is strict: a second encoding is rejected.
    pub fn verifies(&self, message: &[u8], signature: &[u8]) -> bool {
        Signature::from_slice(signature).is_ok_and(|signature| self.0.verify_strict(message, &signature).is_ok())
    }
}

/// Opens a regular file. The type is checked first, because opening a pipe would wait for its writer.
fn open(path: &Path, what: &'static str) -> Result<(File, Metadata), EvidenceError> {
    let metadata = std::fs::metadata(path).map_err(EvidenceError::io(path, "open the key"))?;
    if !metadata.is_file() {
        return Err(EvidenceError::NotAKey { path: path.to_owned(), what, reason: "not a regular file".to_owned() });
    }
    let file = File::open(path).map_err(EvidenceError::io(path, "open the key"))?;
    let metadata = file.metadata().map_err(EvidenceError::io(path, "inspect"))?;
    Ok((file, metadata))
}

/// Reads the text of a key file. It is wiped from memory when it is dropped.
fn text_of(file: File, path: &Path) -> Result<Zeroizing<String>, EvidenceError> {
    // The buffer has the maximum size, because a buffer that grows leaves copies in memory.
    let mut text = Zeroizing::new(String::with_capacity(LONGEST as usize + 1));
    file.take(LONGEST).read_to_string(&mut text).map_err(EvidenceError::io(path, "read the key"))?;
    Ok(text)
}
