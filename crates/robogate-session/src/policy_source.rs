//! Policies, and the records of them.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use robogate_core::{Fault, FaultKind, Observation, Policy, TaskSpec};
use robogate_dictionary::{ComparedServers, hex, read_text};
use robogate_policy::{
    Access, BoundMap, ExternalPolicy, Mapped, PolicyError, Profile, RangeCounts, Recorder, Servers, TaskMap,
};
use robogate_tasks::Random;
use sha2::{Digest, Sha256};

use crate::checkpoint_statistics::CheckpointStatistics;
use crate::failure::{Failure, OrFailure};
use crate::loaded_policy::LoadedPolicy;
use crate::notice::note;
use crate::text::foreign;

/// A policy other than the environment's scripted controller.
#[derive(Debug, Clone, PartialEq)]
pub enum PolicySource {
    /// An external policy.
    External(ExternalSource),
    /// A built-in policy.
    BuiltIn(BuiltInPolicy),
    /// A policy that the environment declares and runs itself.
    Declared(DeclaredPolicy),
}

/// A policy that the environment declares and runs itself.
#[derive(Debug, Clone, PartialEq)]
pub struct DeclaredPolicy {
    /// Its name.
    pub environment: String,
    /// Its version, or the hash of its files, as the environment declares it.
    pub version: String,
    /// Where the process of the environment loads it from ([`LoadedPolicy`]). `None` for one of the environment's own.
    pub from: Option<String>,
}

/// Built-in policies that drive any task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BuiltInPolicy {
    /// Random actions: the baseline of a ranking.
    Random,
}

/// A learned policy behind an inference server, or in a file.
#[derive(Debug, Clone, PartialEq)]
pub struct ExternalSource {
    /// Address of the server, or path of the file.
    pub(crate) server: String,
    /// Observation and action mapping of the policy.
    pub(crate) profile: Arc<Profile>,
    /// How the environment becomes the task that the profile expects.
    pub(crate) map: Option<Arc<TaskMap>>,
    /// What the policy reported about itself on the first connection.
    pub(crate) declared: serde_json::Value,
    /// Where this process reaches the policy, if not at the recorded address.
    pub(crate) at: Option<String>,
    /// Key, certificates and patience of this process.
    pub(crate) access: Access,
    /// Where this process reaches it, as servers that its workers share.
    pub(crate) servers: Servers,
    /// How the answers of several servers were compared. `None` for one server, and if they were not.
    pub(crate) compared: Option<ComparedServers>,
}

impl PolicySource {
    /// Name in records.
    pub fn name(&self) -> &str {
        match self {
            Self::External(served) => &served.profile.name,
            Self::BuiltIn(BuiltInPolicy::Random) => "random",
            Self::Declared(declared) => &declared.environment,
        }
    }

    /// The profile of an external policy.
    pub fn profile(&self) -> Option<&Profile> {
        match self {
            Self::External(served) => Some(served.profile()),
            Self::BuiltIn(_) | Self::Declared(_) => None,
        }
    }

    /// The address of its server, or its file, if it is external.
    pub fn server(&self) -> Option<&str> {
        match self {
            Self::External(served) => Some(&served.server),
            Self::BuiltIn(_) | Self::Declared(_) => None,
        }
    }

    /// The policy that the process of the environment loads, if it is one.
    pub(crate) fn loaded(&self, location: &PolicyLocation) -> anyhow::Result<Option<LoadedPolicy>> {
        let Self::Declared(DeclaredPolicy { environment, from: Some(from), .. }) = self else { return Ok(None) };
        let named = location.at.as_deref().unwrap_or(from);
        Ok(LoadedPolicy::of(named)?.map(|loaded| LoadedPolicy { name: environment.clone(), ..loaded }))
    }

    /// Whether it is a network that this process runs.
    pub fn is_network(&self) -> bool {
        self.profile().is_some_and(|profile| profile.dialect.is_file())
    }

    /// The map between the environment and the profile, if there is one.
    pub fn map(&self) -> Option<&Arc<TaskMap>> {
        match self {
            Self::External(served) => served.map(),
            Self::BuiltIn(_) | Self::Declared(_) => None,
        }
    }

    /// The same policy with new connection metadata. A network must have the recorded bytes before it is loaded.
    pub fn asked_again(&self, location: &PolicyLocation) -> Result<Self, Failure> {
        match self {
            Self::External(served) => {
                served.check_file(location)?;
                ExternalSource::ask(&served.server, Arc::clone(&served.profile), served.map.clone(), location)
                    .map(Self::External)
            }
            // The environment has loaded it from there, and declares its version.
            Self::Declared(DeclaredPolicy { from: Some(_), .. }) => Ok(self.clone()),
            Self::BuiltIn(_) | Self::Declared(_) => location.unused().map(|()| self.clone()),
        }
    }

    /// Creates the policy for one worker. One that the environment runs is created with the environment.
    /// `ranges` count what it sees, and `recorder` keeps some of its requests.
    pub fn policy(&self, ranges: Option<&RangeCounts>, recorder: Option<&Recorder>) -> Result<Box<dyn Policy>, Fault> {
        Ok(match self {
            Self::External(served) => {
                let policy = ExternalPolicy::connect_among(
                    &served.servers,
                    Arc::clone(&served.profile),
                    served.access.clone(),
                    &mut |_| {},
                );
                let policy = policy?.counting(ranges.cloned()).recording(recorder.cloned());
                mapped(Box::new(policy), &served.profile, served.map.as_ref())
            }
            Self::BuiltIn(BuiltInPolicy::Random) => Box::new(Random::new()),
            Self::Declared(declared) => {
                let detail = format!("the policy {} runs in its environment only", declared.environment);
                return Err(Fault::new(FaultKind::Setup, detail));
            }
        })
    }
}

impl ExternalSource {
    /// The profile.
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// The map between the environment and the profile, if there is one.
    pub fn map(&self) -> Option<&Arc<TaskMap>> {
        self.map.as_ref()
    }

    /// Connects to the policy once more.
    pub(crate) fn connect(&self) -> Result<ExternalPolicy, Failure> {
        let server = self.at.as_deref().unwrap_or(&self.server);
        connect(server, Arc::clone(&self.profile), self.access.clone())
    }

    /// Adds the ranges of a checkpoint to the profile. `observation` is one of the environment with this task.
    pub fn add_ranges(
        &mut self,
        statistics: &CheckpointStatistics,
        task: &TaskSpec,
        observation: &Observation,
    ) -> Result<(), Failure> {
        let none = TaskMap::default();
        let bound = BoundMap::new(self.map.as_deref().unwrap_or(&none), &self.profile, task);
        let bound = bound.map_err(|why| anyhow!("the map does not fit: {why}")).or_request()?;
        let seen = bound.observation(observation).map_err(anyhow::Error::from).or_broken()?;
        self.profile = Arc::new(statistics.add_to(&self.profile, &seen)?);
        Ok(())
    }

    /// Rejects another network than the recorded one.
    fn check_file(&self, location: &PolicyLocation) -> Result<(), Failure> {
        let file = location.at.as_deref().unwrap_or(&self.server);
        let recorded = self.declared.get("sha256").and_then(serde_json::Value::as_str);
        if !self.profile.dialect.is_file() || file.contains("://") {
            return Ok(());
        }
        let now =
            network_sha256(Path::new(file)).with_context(|| format!("cannot read the policy {file}")).or_request()?;
        if recorded == Some(now.as_str()) {
            return Ok(());
        }
        Err(anyhow!(
            "the policy {} is not the one of the run: its SHA-256 is {now}, but the run recorded {}\nHint: name the recorded \
             file with --policy-at",
            foreign(file),
            foreign(recorded.unwrap_or("none"))
        ))
        .or_request()
    }

    /// Connect to a policy and record what it reports about itself.
    fn ask(
        server: &str,
        profile: Arc<Profile>,
        map: Option<Arc<TaskMap>>,
        location: &PolicyLocation,
    ) -> Result<Self, Failure> {
        // A run may be resumed and replayed from another folder.
        let is_file = profile.dialect.is_file() && !server.contains("://");
        let full = if is_file { std::path::absolute(server).ok() } else { None };
        let server = full.map_or_else(|| server.to_owned(), |path| path.display().to_string());
        let at = location.at.clone();
        let reached = at.as_deref().unwrap_or(&server);
        let access = location.access.access()?;
        let servers = Servers::of(reached);
        let mut declared: Option<serde_json::Value> = None;
        for url in servers.urls() {
            let policy = connect(url, Arc::clone(&profile), access.clone())?;
            let one = declared.get_or_insert_with(|| policy.declared().clone());
            if one != policy.declared() {
                return Err(anyhow!(
                    "{} and {} are different policies: one declares {one}, the other {}",
                    foreign(&servers.urls()[0]),
                    foreign(url),
                    policy.declared()
                ))
                .or_request();
            }
        }
        Ok(Self { server, profile, map, declared: declared.unwrap_or_default(), at, access, servers, compared: None })
    }
}

/// The policy as the user chooses it.
#[derive(Debug, Clone, Default)]
pub struct PolicyChoice {
    /// `scripted` (as `None`: the environment's own controller), `random`, a policy that the environment declares, the address of a
    /// policy server, an ONNX file, or a policy that the process of the environment loads ([`LoadedPolicy`]).
    pub policy: Option<String>,
    /// The observation and action mapping of a policy server or a network: the name of a built-in profile, or a TOML file.
    pub profile: Option<String>,
    /// A file that maps the environment to the task that the profile expects.
    pub map: Option<PathBuf>,
    /// The statistics of the checkpoint.
    pub statistics: CheckpointStatistics,
}

/// Where this process reaches an external policy.
#[derive(Debug, Clone, Default)]
pub struct PolicyLocation {
    /// The address of the server, or the file, if it is another one than the run records.
    pub at: Option<String>,
    /// How a server is reached.
    pub access: PolicyAccess,
}

/// How this process reaches a policy server, in addition to its address. It is not recorded.
#[derive(Debug, Clone, Default)]
pub struct PolicyAccess {
    /// How long to wait for a server that does not answer yet, at the start and after a restart of the server.
    pub wait: Option<Duration>,
    /// The file with the key of the server. `None` for the environment variable `ROBOGATE_POLICY_TOKEN`.
    pub key_file: Option<PathBuf>,
    /// The file with trusted certificates (PEM). `None` for those of the system.
    pub certificates_file: Option<PathBuf>,
}

impl PolicyAccess {
    /// Reads the files of the arguments.
    pub fn access(&self) -> Result<Access, Failure> {
        let mut access = Access::from_environment().with_wait(self.wait.unwrap_or_default());
        if let Some(file) = &self.key_file {
            let text = read_text(file).with_context(|| format!("--policy-key {}", file.display()));
            let text = text.or_request()?;
            access = access.with_key(&text).with_context(|| format!("--policy-key {}", file.display())).or_request()?;
        }
        if let Some(file) = &self.certificates_file {
            let pem = std::fs::read(file).with_context(|| format!("--policy-ca {}", file.display())).or_request()?;
            let read = access.with_certificates(&pem);
            access = read.with_context(|| format!("--policy-ca {}", file.display())).or_request()?;
        }
        Ok(access)
    }

    /// Rejects a key or certificates if the policy is not behind a server.
    fn check_used(&self, policy: Option<&PolicySource>) -> Result<(), Failure> {
        let given = [("--policy-key", &self.key_file), ("--policy-ca", &self.certificates_file)];
        let option = given.into_iter().find_map(|(option, file)| file.as_ref().map(|_| option));
        match option {
            Some(option) if !matches!(policy, Some(PolicySource::External(_))) => Err(anyhow!(
                "{option} applies to policy servers, but the policy is not behind one\nHint: leave it out, or give the address of \
                 the server with --policy"
            ))
            .or_request(),
            _ => Ok(()),
        }
    }
}

/// Connects to a policy, and tells the user once if it has to wait for the server.
pub fn connect(server: &str, profile: Arc<Profile>, access: Access) -> Result<ExternalPolicy, Failure> {
    let mut told = false;
    let mut waiting = |error: &PolicyError| {
        if !std::mem::replace(&mut told, true) {
            note(format_args!("waiting for the policy server: {error}"));
        }
    };
    ExternalPolicy::connect_with(server, profile, access, &mut waiting).map_err(policy_error)
}

impl PolicyLocation {
    /// The recorded address, reached in this way.
    pub fn with_access(access: &PolicyAccess) -> Self {
        Self { at: None, access: access.clone() }
    }

    /// A policy that is reached at this address, or at the recorded one.
    pub fn at(at: Option<String>, access: &PolicyAccess) -> Self {
        Self { at, access: access.clone() }
    }

    /// Address and access.
    pub fn parts(self) -> (Option<String>, PolicyAccess) {
        (self.at, self.access)
    }

    /// Rejects a key or certificates if the policy is not behind a server.
    pub fn check_used(&self, policy: Option<&PolicySource>) -> Result<(), Failure> {
        self.access.check_used(policy)
    }

    /// Rejects the argument for a policy that is neither a server nor a file.
    pub fn unused(&self) -> Result<(), Failure> {
        match &self.at {
            None => Ok(()),
            Some(at) => {
                Err(anyhow!("{at}: the policy of this run is neither a server nor a file\nHint: leave out its address"))
                    .or_request()
            }
        }
    }
}

impl PolicyChoice {
    /// Another policy with this profile.
    pub fn of(policy: &str, profile: Option<&str>) -> Self {
        let statistics = CheckpointStatistics::default();
        Self { policy: Some(policy.to_owned()), profile: profile.map(str::to_owned), map: None, statistics }
    }

    /// The same choice with the map of another: it describes the environment. A policy without a profile needs none.
    pub fn with_map_of(self, other: &Self) -> Self {
        let map = self.profile.as_ref().and_then(|_| other.map.clone());
        Self { map, ..self }
    }

    /// The policy that the process of the environment loads, if it is one. It needs no profile.
    pub(crate) fn loaded(&self) -> Result<Option<LoadedPolicy>, Failure> {
        let loaded = self.policy.as_deref().map_or(Ok(None), LoadedPolicy::of).or_request()?;
        match (&loaded, &self.profile) {
            (Some(loaded), Some(_)) => {
                Err(anyhow!("--profile cannot be used with --policy {}\nHint: leave out --profile", loaded.from))
                    .or_request()
            }
            _ => Ok(loaded),
        }
    }

    /// Connect to the policy of this choice at `location`; `None` for the scripted controller.
    pub fn source_at(&self, location: &PolicyLocation) -> Result<Option<PolicySource>, Failure> {
        if let Some(loaded) = self.loaded()? {
            let declared = DeclaredPolicy { environment: loaded.name, version: String::new(), from: Some(loaded.from) };
            return location.unused().map(|()| Some(PolicySource::Declared(declared)));
        }
        match (self.policy.as_deref(), &self.profile) {
            (None, _) | (Some("scripted"), None) => location.unused().map(|()| None),
            (Some("random"), None) => location.unused().map(|()| Some(PolicySource::BuiltIn(BuiltInPolicy::Random))),
            (Some(name @ ("random" | "scripted")), Some(_)) => {
                Err(anyhow!("--profile cannot be used with --policy {name}\nHint: leave out --profile")).or_request()
            }
            (Some(server), Some(wanted)) => {
                let map = self.map.as_deref().map(task_map).transpose().or_request()?;
                ExternalSource::ask(server, Arc::new(profile(wanted).or_request()?), map, location)
                    .map(|served| Some(PolicySource::External(served)))
            }
            (Some(name), None) if is_name(name) => {
                let declared = DeclaredPolicy { environment: name.to_owned(), version: String::new(), from: None };
                location.unused().map(|()| Some(PolicySource::Declared(declared)))
            }
            (Some(policy), None) => Err(without_profile(policy)).or_request(),
        }
    }
}

/// The SHA-256 of a network in a file, which is read and not loaded.
pub(crate) fn network_sha256(file: &Path) -> io::Result<String> {
    /// As large as a network may be.
    const MOST_BYTES: u64 = 1 << 30;
    let opened = File::open(file)?;
    let metadata = opened.metadata()?;
    if !metadata.is_file() || metadata.len() > MOST_BYTES {
        return Err(io::Error::other("not a file of at most 1 GiB"));
    }
    let mut bytes = Vec::new();
    opened.take(MOST_BYTES).read_to_end(&mut bytes)?;
    Ok(hex(&Sha256::digest(bytes)))
}

/// Whether this can be the name of a policy that an environment declares.
fn is_name(policy: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    !policy.is_empty() && policy.chars().all(allowed) && !Path::new(policy).exists()
}

/// The error for a policy without a profile.
pub fn without_profile(policy: &str) -> anyhow::Error {
    if policy.contains("://") || Path::new(policy).exists() {
        anyhow!(
            "--policy {policy}: --profile is missing. It describes the observations and actions of the model\nHint: \
             `robogate list profiles` lists the built-in profiles"
        )
    } else if policy.contains(['/', '.']) {
        anyhow!(
            "--policy {policy}: no such file. Expected an ONNX file, or the address of a server such as ws://127.0.0.1:8000"
        )
    } else {
        anyhow!(
            "--policy {policy}: not a policy. Expected the address of a server such as ws://127.0.0.1:8000, the path of \
             an ONNX file, `random` or `scripted`"
        )
    }
}

/// A profile by its name or the path of its file.
pub fn profile(wanted: &str) -> anyhow::Result<Profile> {
    match Profile::built_in(wanted) {
        Some(text) => Profile::from_toml(text).with_context(|| format!("profile {wanted}")),
        None if !Path::new(wanted).exists() && !wanted.contains(['/', '.']) => {
            let known = Profile::built_in_names().collect::<Vec<_>>().join(", ");
            bail!("--profile {wanted}: unknown profile. Expected the path of a TOML file or one of: {known}")
        }
        None => {
            let text = read_text(Path::new(wanted)).with_context(|| format!("cannot read {wanted}"))?;
            Profile::from_toml(&text).with_context(|| wanted.to_owned())
        }
    }
}

/// A map from its file.
pub fn task_map(file: &Path) -> anyhow::Result<Arc<TaskMap>> {
    let text = read_text(file).with_context(|| format!("--map {}", file.display()))?;
    TaskMap::from_toml(&text).map(Arc::new).map_err(|why| anyhow!("{}: {why}", file.display()))
}

/// A policy that sees the environment through a map, if there is one.
pub fn mapped(policy: Box<dyn Policy>, profile: &Arc<Profile>, map: Option<&Arc<TaskMap>>) -> Box<dyn Policy> {
    match map {
        Some(map) => Box::new(Mapped::new(policy, Arc::clone(profile), Arc::clone(map))),
        None => policy,
    }
}

/// Gives an error of a policy its kind: wrong settings are requests, all others infrastructure.
pub fn policy_error(error: PolicyError) -> Failure {
    Failure::broken_if(!error.is_usage_error(), error)
}
