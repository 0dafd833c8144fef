//! TLS over a stream with a deadline.

use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;

use rustls::pki_types::ServerName;
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};

use super::access::Access;
use super::deadline::TimedStream;
use super::error::PolicyError;

/// A connection with or without TLS.
#[derive(Debug)]
pub(crate) enum Wire {
    /// Without TLS.
    Plain(TimedStream),
    /// With TLS.
    Tls(Box<StreamOwned<ClientConnection, TimedStream>>),
}

impl Wire {
    /// Performs the TLS handshake with the server `host`.
    pub(crate) fn encrypt(
        url: &str,
        host: &str,
        mut stream: TimedStream,
        access: &Access,
    ) -> Result<Self, PolicyError> {
        let failed = |why: String| PolicyError::Tls { url: url.to_owned(), why };
        let mut roots = RootCertStore::empty();
        roots.add_parsable_certificates(access.certificates()?);
        let config = ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(|e| failed(e.to_string()))?
            .with_root_certificates(roots)
            .with_no_client_auth();
        let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        let name = ServerName::try_from(host).map_err(|e| failed(e.to_string()))?;
        let mut connection = ClientConnection::new(Arc::new(config), name).map_err(|e| failed(e.to_string()))?;
        while connection.is_handshaking() {
            connection.complete_io(&mut stream).map_err(|e| match e.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut => {
                    stream.deadline.passed(format!("the TLS handshake with {url}"))
                }
                ErrorKind::InvalidData => failed(e.to_string()),
                _ => PolicyError::Closed { when: "during the TLS handshake".to_owned(), reason: format!(": {e}") },
            })?;
        }
        Ok(Self::Tls(Box::new(StreamOwned::new(connection, stream))))
    }

    /// The stream below.
    pub(crate) fn stream(&self) -> &TimedStream {
        match self {
            Self::Plain(stream) => stream,
            Self::Tls(tls) => tls.get_ref(),
        }
    }

    /// The stream below, to set its deadline.
    pub(crate) fn stream_mut(&mut self) -> &mut TimedStream {
        match self {
            Self::Plain(stream) => stream,
            Self::Tls(tls) => tls.get_mut(),
        }
    }
}

impl Read for Wire {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Plain(stream) => stream.read(into),
            Self::Tls(tls) => tls.read(into),
        }
    }
}

impl Write for Wire {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        match self {
            Self::Plain(stream) => stream.write(from),
            Self::Tls(tls) => tls.write(from),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Plain(stream) => stream.flush(),
            Self::Tls(tls) => tls.flush(),
        }
    }
}
