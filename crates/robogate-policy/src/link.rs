//! What every dialect can do.

use serde_json::Value as Json;

use super::error::ServerError;
use super::exchange::{Chunk, Query};
use super::gr00t::{Gr00tServer, Version};
use super::identify;
use super::lerobot::LeRobotServer;
use super::openpi::Openpi;
use super::profile::{Dialect, Gr00t, Profile};
use super::rest::{Form, Rest};
use super::roboarena::RoboArena;
use super::vla_eval::VlaEval;
use super::websocket::Deadline;

/// A connection to a policy server, whatever it speaks. After an error it is not used again.
pub(crate) trait Link: Send {
    /// Tells the server that an episode begins.
    fn begin(&mut self, instruction: &str, episode: u64, deadline: Deadline) -> Result<(), ServerError>;

    /// Asks for actions.
    fn ask(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, ServerError>;

    /// What the server says of itself.
    fn declared(&self) -> &Json;
}

/// The environment variable that holds the token of servers that ask for one. It is no part of a profile, which
/// becomes part of the record.
const TOKEN: &str = "ROBOGATE_POLICY_TOKEN";

/// The token to show, if there is one.
pub(crate) fn token() -> Option<String> {
    std::env::var(TOKEN).ok().filter(|token| !token.is_empty())
}

/// Connects by the profile's dialect, and holds what the server says of itself against the profile.
pub(crate) fn connect(url: &str, profile: &Profile) -> Result<Box<dyn Link>, ServerError> {
    let deadline = Deadline::within(profile.server.connect_s);
    let dialect = &profile.dialect;
    if dialect.is_file() == url.contains("://") || !(url.starts_with(dialect.scheme()) || url.starts_with("wss://")) {
        return Err(ServerError::Address {
            url: url.to_owned(),
            why: format!("the profile's dialect is {}: {}", dialect.name(), dialect.address()),
        });
    }
    let rest = |form| Rest::connect(url, form, deadline).map(boxed);
    let gr00t = |version, names| Gr00tServer::connect(url, version, names, profile, deadline).map(boxed);
    let link = match dialect {
        Dialect::Openpi {} => Openpi::connect(url, deadline).map(boxed),
        Dialect::RoboArena {} => RoboArena::connect(url, profile, deadline).map(boxed),
        Dialect::Gr00tN15(names) => gr00t(Version::N15, names),
        Dialect::Gr00tN16(names) => gr00t(Version::N16, names),
        Dialect::Gr00tN15Http(Gr00t { action_keys, language_key }) => {
            rest(Form::Gr00tN15 { action_keys: action_keys.clone(), language_key: language_key.clone() })
        }
        Dialect::OpenVla { unnorm_key } => rest(Form::OpenVla { unnorm_key: unnorm_key.clone() }),
        Dialect::OpenVlaOft {} => rest(Form::OpenVlaOft),
        Dialect::Rest { unnorm_key } => rest(Form::Rest { unnorm_key: unnorm_key.clone() }),
        Dialect::LeRobot(settings) => {
            let chunk = profile.chunk.length.unwrap_or(profile.chunk.execute);
            LeRobotServer::connect(url, settings, chunk, deadline).map(boxed)
        }
        Dialect::Onnx {} => network(url, profile),
        Dialect::VlaEval {} => VlaEval::connect(url, profile, deadline).map(boxed),
    };
    // Something is there and does not speak as it should: what is it?
    link.map_err(|error| match error {
        ServerError::Undecodable { .. } | ServerError::Closed { .. } | ServerError::Timeout { .. } => {
            identify::name(url, dialect)
                .map_or(error, |found| ServerError::OtherDialect { wanted: dialect.name(), found })
        }
        other => other,
    })
}

/// A network that runs here: there is nothing to connect to.
#[cfg(feature = "onnx")]
fn network(path: &str, profile: &Profile) -> Result<Box<dyn Link>, ServerError> {
    super::onnx::Network::load(path, profile).map(boxed)
}

#[cfg(not(feature = "onnx"))]
fn network(path: &str, _: &Profile) -> Result<Box<dyn Link>, ServerError> {
    let why = "this build runs no ONNX files: it lacks the feature `onnx`".to_owned();
    Err(ServerError::Address { url: path.to_owned(), why })
}

fn boxed(link: impl Link + 'static) -> Box<dyn Link> {
    Box::new(link)
}
