//! Plain HTTP/1.1 with deadlines and bounded answers.

use super::error::ServerError;
use super::websocket::{Deadline, MAX_ANSWER};

/// A server that is asked over HTTP.
#[derive(Debug)]
pub(crate) struct Http {
    agent: ureq::Agent,
    base: String,
}

/// What came back.
#[derive(Debug)]
pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) body: Vec<u8>,
}

impl Http {
    /// A server at `http://host:port`.
    pub(crate) fn new(url: &str) -> Result<Self, ServerError> {
        let wrong = |why: &str| ServerError::Address { url: url.to_owned(), why: why.to_owned() };
        if url.starts_with("https://") {
            return Err(wrong(
                "TLS is not spoken here; put a proxy on this machine and name it as http://127.0.0.1:PORT",
            ));
        }
        let rest = url.strip_prefix("http://").ok_or_else(|| wrong("it must begin with http://"))?;
        let authority = rest.trim_end_matches('/');
        if authority.is_empty() || authority.contains(['/', '?', '#', ' ']) {
            return Err(wrong("it must be http://HOST:PORT, without a path"));
        }
        let agent =
            ureq::Agent::config_builder().http_status_as_error(false).max_redirects(0).proxy(None).build().into();
        Ok(Self { agent, base: format!("http://{authority}") })
    }

    /// Sends JSON to a path.
    pub(crate) fn post(&self, path: &'static str, json: &str, deadline: Deadline) -> Result<Reply, ServerError> {
        let left = deadline.left().ok_or_else(|| deadline.passed(path))?;
        let request = self.agent.post(format!("{}{path}", self.base)).config().timeout_global(Some(left)).build();
        let response = request.header("Content-Type", "application/json").send(json);
        self.reply(path, response, deadline)
    }

    /// Fetches a path.
    pub(crate) fn get(&self, path: &'static str, deadline: Deadline) -> Result<Reply, ServerError> {
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
    ) -> Result<Reply, ServerError> {
        let named = |error: ureq::Error| match error {
            ureq::Error::Timeout(_) => deadline.passed(path),
            ureq::Error::BodyExceedsLimit(_) => ServerError::TooLarge { limit: MAX_ANSWER },
            ureq::Error::Io(e) if e.kind() == std::io::ErrorKind::ConnectionRefused => self.unreachable(e),
            ureq::Error::HostNotFound | ureq::Error::ConnectionFailed => self.unreachable(error),
            ureq::Error::Io(e) => ServerError::Closed { when: format!("during {path}"), reason: format!(": {e}") },
            other => ServerError::undecodable("an HTTP answer", other),
        };
        let mut response = response.map_err(named)?;
        let body = response.body_mut().with_config().limit(MAX_ANSWER as u64).read_to_vec().map_err(named)?;
        Ok(Reply { status: response.status().as_u16(), body })
    }

    fn unreachable(&self, why: impl ToString) -> ServerError {
        ServerError::Unreachable { url: self.base.clone(), why: why.to_string() }
    }
}
