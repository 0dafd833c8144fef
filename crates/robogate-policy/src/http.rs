//! An HTTP/1.1 client without TLS, with deadlines and a size limit on replies.

use super::deadline::Deadline;
use super::error::PolicyError;
use super::websocket::MAX_REPLY;

/// An HTTP server.
#[derive(Debug)]
pub(crate) struct Http {
    agent: ureq::Agent,
    base: String,
}

/// The reply to a request.
#[derive(Debug)]
pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) body: Vec<u8>,
}

impl Http {
    /// Create a client for the server at `http://host:port`.
    pub(crate) fn new(url: &str) -> Result<Self, PolicyError> {
        let wrong = |why: &str| PolicyError::Address { url: url.to_owned(), why: why.to_owned() };
        let rest = url.strip_prefix("http://").ok_or_else(|| wrong("expected http://HOST:PORT"))?;
        let authority = rest.trim_end_matches('/');
        if authority.is_empty() || authority.contains(['/', '?', '#', ' ']) {
            return Err(wrong("expected http://HOST:PORT, without a path"));
        }
        let agent =
            ureq::Agent::config_builder().http_status_as_error(false).max_redirects(0).proxy(None).build().into();
        Ok(Self { agent, base: format!("http://{authority}") })
    }

    /// Send JSON to a path.
    pub(crate) fn post(&self, path: &'static str, json: &str, deadline: Deadline) -> Result<Reply, PolicyError> {
        let left = deadline.left().ok_or_else(|| deadline.passed(path))?;
        let request = self.agent.post(format!("{}{path}", self.base)).config().timeout_global(Some(left)).build();
        let response = request.header("Content-Type", "application/json").send(json);
        self.reply(path, response, deadline)
    }

    /// Request a path.
    pub(crate) fn get(&self, path: &'static str, deadline: Deadline) -> Result<Reply, PolicyError> {
        let left = deadline.left().ok_or_else(|| deadline.passed(path))?;
        let response =
            self.agent.get(format!("{}{path}", self.base)).config().timeout_global(Some(left)).build().call();
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
            ureq::Error::HostNotFound | ureq::Error::ConnectionFailed => self.unreachable(error),
            ureq::Error::Io(e) => PolicyError::Closed { when: format!("during {path}"), reason: format!(": {e}") },
            other => PolicyError::invalid_reply("HTTP reply", other),
        };
        let mut response = response.map_err(named)?;
        let body = response.body_mut().with_config().limit(MAX_REPLY as u64).read_to_vec().map_err(named)?;
        Ok(Reply { status: response.status().as_u16(), body })
    }

    fn unreachable(&self, why: impl ToString) -> PolicyError {
        PolicyError::Unreachable { url: self.base.clone(), why: why.to_string() }
    }
}
