//! An HTTP/1.1 client, with or without TLS, with deadlines and a size limit on replies.

use ureq::tls::{Certificate, RootCerts, TlsConfig};

use super::access::Access;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::websocket::MAX_REPLY;

/// An HTTP server.
#[derive(Debug)]
pub(crate) struct Http {
    agent: ureq::Agent,
    base: String,
    /// Name and value of the header with the key.
    key: Option<(String, String)>,
}

/// The reply to a request.
#[derive(Debug)]
pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) body: Vec<u8>,
}

impl Http {
    /// Create a client for the server at `http://host:port` or `https://host:port`.
    pub(crate) fn new(url: &str, access: &Access) -> Result<Self, PolicyError> {
        let wrong = |why: &str| PolicyError::Address { url: url.to_owned(), why: why.to_owned() };
        let (scheme, rest) = url.split_once("://").ok_or_else(|| wrong("expected http://HOST:PORT"))?;
        let authority = rest.trim_end_matches('/');
        if authority.is_empty() || authority.contains(['/', '?', '#', ' ']) {
            return Err(wrong("expected http://HOST:PORT, without a path"));
        }
        let mut config = ureq::Agent::config_builder().http_status_as_error(false).max_redirects(0).proxy(None);
        if scheme == "https" {
            let certificates = access.certificates()?;
            let roots: Vec<_> = certificates.iter().map(|der| Certificate::from_der(der).to_owned()).collect();
            config = config.tls_config(TlsConfig::builder().root_certs(RootCerts::new_with_certs(&roots)).build());
        }
        let agent = config.build().into();
        Ok(Self { agent, base: format!("{scheme}://{authority}"), key: access.header("Bearer") })
    }

    /// Send JSON to a path.
    pub(crate) fn post(&self, path: &'static str, json: &str, deadline: Deadline) -> Result<Reply, PolicyError> {
        let left = deadline.left().ok_or_else(|| deadline.passed(path))?;
        let request = self.agent.post(format!("{}{path}", self.base)).config().timeout_global(Some(left)).build();
        let request = request.header("Content-Type", "application/json");
        let response = match &self.key {
            Some((name, value)) => request.header(name, value),
            None => request,
        }
        .send(json);
        self.reply(path, response, deadline)
    }

    /// Request a path.
    pub(crate) fn get(&self, path: &'static str, deadline: Deadline) -> Result<Reply, PolicyError> {
        let left = deadline.left().ok_or_else(|| deadline.passed(path))?;
        let request = self.agent.get(format!("{}{path}", self.base)).config().timeout_global(Some(left)).build();
        let response = match &self.key {
            Some((name, value)) => request.header(name, value),
            None => request,
        }
        .call();
        self.reply(path, response, deadline)
    }

    fn reply(
        &self,
        path: &'static str,
        response: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
        deadline: Deadline,
    ) -> Result<Reply, PolicyError> {
        let named = |error: ureq::Error| match error {
            ureq::Error::Timeout(_) => deadline.passed(path),
            ureq::Error::BodyExceedsLimit(_) => PolicyError::TooLarge { limit: MAX_REPLY },
            ureq::Error::Io(e) if e.kind() == std::io::ErrorKind::ConnectionRefused => self.unreachable(e),
            ureq::Error::Io(e) if e.kind() == std::io::ErrorKind::InvalidData && self.base.starts_with("https") => {
                PolicyError::Tls { url: self.base.clone(), why: e.to_string() }
            }
            ureq::Error::Tls(why) => PolicyError::Tls { url: self.base.clone(), why: why.to_owned() },
            ureq::Error::Rustls(e) => PolicyError::Tls { url: self.base.clone(), why: e.to_string() },
            ureq::Error::HostNotFound | ureq::Error::ConnectionFailed => self.unreachable(error),
            ureq::Error::Io(e) => PolicyError::Closed { when: format!("during {path}"), reason: format!(": {e}") },
            other => PolicyError::invalid_reply("HTTP reply", other),
        };
        let mut response = response.map_err(named)?;
        let body = response.body_mut().with_config().limit(MAX_REPLY as u64).read_to_vec().map_err(named)?;
        match response.status().as_u16() {
            status @ (502..=504) => {
                Err(PolicyError::NotReady { url: self.base.clone(), why: format!("HTTP {status} for {path}") })
            }
            status => Ok(Reply { status, body }),
        }
    }

    fn unreachable(&self, why: impl ToString) -> PolicyError {
        PolicyError::Unreachable { url: self.base.clone(), why: why.to_string() }
    }
}
