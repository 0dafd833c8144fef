//! Connections to policies of all dialects.

use serde_json::Value as Json;

use super::access::Access;
use super::chunk::Chunk;
use super::deadline::Deadline;
use super::error::PolicyError;
use super::gr00t::{Gr00tServer, Version};
use super::identify;
use super::lerobot::LeRobotServer;
use super::openpi::Openpi;
use super::profile::{Dialect, Gr00t, Profile};
use super::query::Query;
use super::rest::{Api, RestServer};
use super::roboarena::RoboArena;
use super::starvla::StarVla;
use super::vla_eval::VlaEval;
use super::xpolicylab::XPolicyLab;

/// A connection to a policy. It must not be used again after an error.
pub(crate) trait Connection: Send {
    /// Announce the start of an episode.
    fn begin(&mut self, instruction: &str, episode: u64, deadline: Deadline) -> Result<(), PolicyError>;

    /// Request actions for an observation.
    fn infer(&mut self, query: &Query, deadline: Deadline) -> Result<Chunk, PolicyError>;

    /// The metadata that the policy reports.
    fn declared(&self) -> &Json;
}

/// Connect with the dialect of the profile, and check the policy's metadata against the profile.
///
/// `limit_s` is the time limit.
pub(crate) fn connect(
    url: &str,
    profile: &Profile,
    access: &Access,
    limit_s: f64,
) -> Result<Box<dyn Connection>, PolicyError> {
    connect_with(url, profile, Some(profile), access, limit_s)
}

/// Connect like [`connect`]. The policy's metadata are checked against `expected`, if it is given.
pub(crate) fn connect_with(
    url: &str,
    profile: &Profile,
    expected: Option<&Profile>,
    access: &Access,
    limit_s: f64,
) -> Result<Box<dyn Connection>, PolicyError> {
    check_address(url, profile)?;
    let deadline = Deadline::within(limit_s);
    let dialect = &profile.dialect;
    let rest = |api| RestServer::connect(url, api, access, deadline).map(boxed);
    let gr00t = |version, names| Gr00tServer::connect(url, version, names, expected, access, deadline).map(boxed);
    let connection = match dialect {
        Dialect::Openpi { separator } => Openpi::connect(url, *separator, access, deadline).map(boxed),
        Dialect::RoboArena {} => RoboArena::connect(url, expected, access, deadline).map(boxed),
        Dialect::Gr00tN15(names) => gr00t(Version::N15, names),
        Dialect::Gr00tN16(names) => gr00t(Version::N16, names),
        Dialect::Gr00tN15Http(Gr00t { action_keys, language_key }) => {
            rest(Api::Gr00tN15 { action_keys: action_keys.clone(), language_key: language_key.clone() })
        }
        Dialect::OpenVla { unnorm_key } => rest(Api::OpenVla { unnorm_key: unnorm_key.clone() }),
        Dialect::OpenVlaOft {} => rest(Api::OpenVlaOft),
        Dialect::Rest { unnorm_key } => rest(Api::Rest { unnorm_key: unnorm_key.clone() }),
        Dialect::LeRobot(settings) => {
            let chunk = profile.chunk.length.unwrap_or(profile.chunk.execute);
            LeRobotServer::connect(url, settings, chunk, deadline).map(boxed)
        }
        Dialect::Onnx {} => load_network(url, profile, deadline),
        Dialect::StarVla { unnorm_key } => StarVla::connect(url, unnorm_key.clone(), access, deadline).map(boxed),
        Dialect::XPolicyLab { action_keys } => {
            XPolicyLab::connect(url, action_keys.clone(), access, deadline).map(boxed)
        }
        Dialect::VlaEval {} => VlaEval::connect(url, expected, access, deadline).map(boxed),
    };
    // A server listens but does not use this dialect: identify its dialect for the error message.
    connection.map_err(|error| match access.without_key(error) {
        error @ (PolicyError::InvalidReply { .. } | PolicyError::Closed { .. } | PolicyError::Timeout { .. }) => {
            identify::describe(url, dialect)
                .map_or(error, |found| PolicyError::WrongDialect { expected: dialect.name(), found })
        }
        other => other,
    })
}

/// Check that the address has the form that the dialect requires.
fn check_address(url: &str, profile: &Profile) -> Result<(), PolicyError> {
    let (name, dialect) = (&profile.name, &profile.dialect);
    let is_url = url.contains("://");
    let why = match (dialect.is_file(), is_url) {
        (true, false) => return Ok(()),
        (true, true) => format!(
            "profile {name} has the dialect onnx and takes a file. Expected FILE.onnx. Hint: for a server, use a profile \
             with its dialect (robogate list profiles)"
        ),
        (false, false) => {
            let (dialect, expected) = (dialect.name(), dialect.address());
            let is_file = std::path::Path::new(url).exists();
            let hint = "Hint: for an ONNX file, use a profile with the dialect onnx, such as `learned`";
            let hint = if is_file { format!(". {hint}") } else { String::new() };
            format!(
                "profile {name} has the dialect {dialect} and takes the address of a server. Expected {expected}{hint}"
            )
        }
        (false, true) if url.contains('@') => {
            "it contains a user or a password. Hint: give a key in ROBOGATE_POLICY_TOKEN or with --policy-key"
                .to_owned()
        }
        (false, true) if has_scheme(url, dialect.scheme()) => return Ok(()),
        (false, true) => {
            format!("profile {name} has the dialect {}. Expected {}", dialect.name(), dialect.address())
        }
    };
    Err(PolicyError::Address { url: url.to_owned(), why })
}

/// Whether an address has this scheme, or its variant with TLS.
fn has_scheme(url: &str, scheme: &str) -> bool {
    let secure = match scheme {
        "ws://" => "wss://",
        "http://" => "https://",
        other => other,
    };
    url.starts_with(scheme) || url.starts_with(secure)
}

/// Load a network that runs in this process.
#[cfg(feature = "onnx")]
fn load_network(path: &str, profile: &Profile, deadline: Deadline) -> Result<Box<dyn Connection>, PolicyError> {
    super::onnx::Network::load(path, profile, deadline).map(boxed)
}

#[cfg(not(feature = "onnx"))]
fn load_network(path: &str, _: &Profile, _: Deadline) -> Result<Box<dyn Connection>, PolicyError> {
    let why = "this build cannot run ONNX files. Build RoboGate with the feature `onnx`".to_owned();
    Err(PolicyError::File { path: path.to_owned(), why })
}

fn boxed(connection: impl Connection + 'static) -> Box<dyn Connection> {
    Box::new(connection)
}
