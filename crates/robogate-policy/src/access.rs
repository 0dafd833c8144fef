//! How a policy server is reached, in addition to its address: key, certificates, and how long to wait for it.

use std::fmt;
use std::time::Duration;

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;

use super::error::PolicyError;

/// The environment variable with the key of servers that require one.
const KEY: &str = "ROBOGATE_POLICY_TOKEN";

/// How a policy server is reached, in addition to its address. It is not part of a [`Profile`](super::Profile) and is
/// never recorded, because it contains a secret, and because it may differ between machines.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Access {
    key: Option<String>,
    /// Trusted certificates. `None` for those of the system.
    certificates: Option<Vec<CertificateDer<'static>>>,
    wait: Duration,
}

/// The key is left out.
impl fmt::Debug for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Access").field("wait", &self.wait).finish_non_exhaustive()
    }
}

impl Access {
    /// The access with the key of the environment variable `ROBOGATE_POLICY_TOKEN`, if it is set.
    pub fn from_environment() -> Self {
        let key = std::env::var(KEY).ok().map(|key| key.trim().to_owned()).filter(|key| !key.is_empty());
        Self { key, ..Self::default() }
    }

    /// Uses this key. HTTP and WebSocket servers receive it in a header: in the one that it names, if the text has the
    /// form `NAME: VALUE`, otherwise in `Authorization`. GR00T servers receive it in each message.
    pub fn with_key(self, text: &str) -> Result<Self, PolicyError> {
        let key = text.trim();
        if key.is_empty() || key.len() > 8192 || key.chars().any(|c| c.is_control() || !c.is_ascii()) {
            return Err(PolicyError::Key("expected one line of ASCII text".to_owned()));
        }
        Ok(Self { key: Some(key.to_owned()), ..self })
    }

    /// Trusts these certificates (PEM) instead of those of the system.
    pub fn with_certificates(self, pem: &[u8]) -> Result<Self, PolicyError> {
        let wrong = |why: String| PolicyError::Certificates(why);
        let certificates: Vec<_> =
            CertificateDer::pem_slice_iter(pem).collect::<Result<_, _>>().map_err(|e| wrong(e.to_string()))?;
        if certificates.is_empty() {
            return Err(wrong(
                "no certificate found. Expected PEM blocks that begin with BEGIN CERTIFICATE".to_owned(),
            ));
        }
        Ok(Self { certificates: Some(certificates), ..self })
    }

    /// Waits this long for a server that does not answer yet, each time a connection is opened.
    #[must_use]
    pub fn with_wait(self, wait: Duration) -> Self {
        Self { wait, ..self }
    }

    /// How long to wait for a server.
    pub(crate) fn wait(&self) -> Duration {
        self.wait
    }

    /// The key, for protocols without headers.
    pub(crate) fn key(&self) -> Option<&str> {
        self.key.as_deref()
    }

    /// Name and value of the header with the key. `scheme` is that of the header `Authorization`.
    pub(crate) fn header(&self, scheme: &str) -> Option<(String, String)> {
        let key = self.key.as_deref()?;
        let is_name = |name: &str| !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-');
        Some(match key.split_once(": ") {
            Some((name, value)) if is_name(name) => (name.to_owned(), value.trim().to_owned()),
            _ => ("Authorization".to_owned(), format!("{scheme} {key}")),
        })
    }

    /// The trusted certificates: the given ones, or those of the system.
    pub(crate) fn certificates(&self) -> Result<Vec<CertificateDer<'static>>, PolicyError> {
        if let Some(certificates) = &self.certificates {
            return Ok(certificates.clone());
        }
        let found = rustls_native_certs::load_native_certs();
        match (found.certs, found.errors.first()) {
            (certificates, _) if !certificates.is_empty() => Ok(certificates),
            (_, Some(error)) => Err(PolicyError::Certificates(format!("those of the system cannot be read: {error}"))),
            (_, None) => Err(PolicyError::Certificates("this system has none".to_owned())),
        }
    }

    /// Removes the key from the text of an error, in case the server repeats it.
    pub(crate) fn without_key(&self, error: PolicyError) -> PolicyError {
        let Some(key) = &self.key else { return error };
        let secret = key.split_once(": ").map_or(key.as_str(), |(_, value)| value);
        let hidden = |text: String| text.replace(secret, "***");
        match error {
            PolicyError::Reported { text } => PolicyError::Reported { text: hidden(text) },
            PolicyError::Closed { when, reason } => PolicyError::Closed { when, reason: hidden(reason) },
            PolicyError::InvalidReply { message, why } => PolicyError::InvalidReply { message, why: hidden(why) },
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_become_headers() {
        let header = |text: &str| Access::default().with_key(text).unwrap().header("Api-Key").unwrap();
        assert_eq!(header("abc\n"), ("Authorization".to_owned(), "Api-Key abc".to_owned()));
        assert_eq!(header("X-API-Key: abc"), ("X-API-Key".to_owned(), "abc".to_owned()));
        assert!(Access::default().with_key("a\nb").is_err());
        assert_eq!(Access::default().header("Bearer"), None);
    }

    #[test]
    fn key_is_never_printed() {
        let access = Access::default().with_key("X-API-Key: hunter2").unwrap();
        assert!(!format!("{access:?}").contains("hunter2"));
        let error = access.without_key(PolicyError::reported("wrong key hunter2"));
        assert_eq!(error.to_string(), "policy error: wrong key ***");
    }

    #[test]
    fn text_without_certificates_is_rejected() {
        assert!(Access::default().with_certificates(b"README").is_err());
    }
}
