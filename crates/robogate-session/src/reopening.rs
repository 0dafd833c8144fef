//! How the environment and the policy of a recorded run are set up again, and what may start for that.
//!
//! Another user may have written the record, so the programs that it names start only if the user of this call names them,
//! trusts the record, or made the run on this machine ([`crate::origin`]).

use std::fmt;
use std::path::Path;

use anyhow::anyhow;
use robogate_dictionary::Provenance;

use crate::environment_choice::from_any_folder;
use crate::failure::{Failure, OrFailure};
use crate::origin::{self, Origin};
use crate::policy_source::{PolicyAccess, PolicyLocation};
use crate::remote::Simulators;
use crate::text::foreign;

/// How a recorded run is set up again.
#[derive(Debug, Clone, Default)]
pub struct Reopening {
    /// The environment to start for the run, whose files must be the recorded ones: its name, or the user's own copy as
    /// `FILE.py:ATTRIBUTE`.
    pub env: Option<String>,
    /// The policy of the run: the address of its server, or its network.
    pub policy: Option<String>,
    /// The folder of the robot of the run, whose files must be the recorded ones.
    pub robot: Option<String>,
    /// Whether the programs that the record names may start.
    pub trust: Trust,
    /// How a policy server is reached.
    pub access: PolicyAccess,
    /// The simulators and the Python interpreter.
    pub simulators: Simulators,
    /// Whether new episodes continue the run. They need the original files; all else can use the copies in the run's folder.
    pub continues: bool,
    /// Whether the environment may be another version than that of the run: another engine, other packages and what follows from them.
    pub upgraded: bool,
}

/// Whether the programs that a record names may start, although the user did not make the run on this machine. They can run
/// any code.
#[derive(Debug, Clone, Copy, Default)]
pub struct Trust {
    /// Whether the user trusts the author of the record.
    pub given: bool,
}

impl Trust {
    /// For a run that this process has just made.
    pub const YES: Self = Self { given: true };

    /// Whether the programs of the run in `folder` may start without being named.
    pub fn covers(self, folder: &Path, provenance: &Provenance) -> bool {
        self.given || origin::of(folder, provenance).is_some()
    }
}

/// A program that a record names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Program {
    /// An environment in Python.
    Environment(String),
    /// The address of a policy server, or a network in a file.
    Policy(String),
    /// A folder with the model of a robot.
    Robot(String),
}

impl Program {
    /// The option that names it.
    fn option(&self) -> &'static str {
        match self {
            Self::Environment(_) => "--env",
            Self::Policy(_) => "--policy",
            Self::Robot(_) => "--robot",
        }
    }
}

impl fmt::Display for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Environment(name) => write!(f, "the environment {}", foreign(name)),
            Self::Policy(server) => write!(f, "the policy {}", foreign(server)),
            Self::Robot(folder) => write!(f, "the robot {}", foreign(folder)),
        }
    }
}

/// What a run may start: its programs as the user names them.
#[derive(Debug)]
pub struct Permit {
    /// The environment to start, if the run names one.
    pub environment: Option<String>,
    /// The folder of the robot, if the run names one.
    pub robot: Option<String>,
    /// How the policy is reached.
    pub location: PolicyLocation,
    /// The simulators and the Python interpreter.
    pub simulators: Simulators,
}

impl Reopening {
    /// Nothing is named and nothing is trusted.
    pub fn none() -> Self {
        Self::default()
    }

    /// For a run that this process has just made.
    pub fn trusted() -> Self {
        Self::trusting(Trust::YES)
    }

    /// Trusts the record if `trust` does.
    pub fn trusting(trust: Trust) -> Self {
        Self { trust, ..Self::default() }
    }

    /// For a verb whose other arguments select the environment and the policy of new runs.
    pub fn with(trust: Trust, simulators: &Simulators, location: &PolicyLocation) -> Self {
        let (policy, access) = location.clone().parts();
        Self { policy, trust, access, simulators: simulators.clone(), ..Self::default() }
    }

    /// This environment and robot, for a run whose policy is not needed.
    pub fn of(env: Option<String>, robot: Option<String>, trust: Trust, simulators: &Simulators) -> Self {
        Self { env, robot, trust, simulators: simulators.clone(), ..Self::default() }
    }

    /// How the policy is reached.
    pub fn location(&self) -> PolicyLocation {
        PolicyLocation::at(self.policy.clone(), &self.access)
    }

    /// The same for a second policy of the run: `--policy` names the first one.
    pub fn without_policy(&self) -> Self {
        Self { policy: None, ..self.clone() }
    }

    /// The same, whose processes write the physics of their episodes to this folder.
    pub(crate) fn probed(&self, folder: &Path) -> Self {
        let mut probed = self.clone();
        probed.simulators.probe = Some(folder.to_owned());
        probed
    }

    /// Checks that `programs`, which the run in `folder` names, may start.
    ///
    /// # Errors
    /// A request. The first line of the message stands alone.
    pub fn permit(
        &self,
        folder: Option<&Path>,
        provenance: &Provenance,
        programs: &[Program],
    ) -> Result<Permit, Failure> {
        let origin = folder.filter(|_| !programs.is_empty()).and_then(|folder| origin::of(folder, provenance));
        let mut permit =
            Permit { environment: None, robot: None, location: self.location(), simulators: self.simulators.clone() };
        let mut unnamed = Vec::new();
        for program in programs {
            let named = match program {
                Program::Environment(recorded) => {
                    let named = self.env.as_deref().map(|own| same_environment(recorded, own)).transpose()?;
                    permit.environment = Some(named.clone().unwrap_or_else(|| recorded.clone()));
                    // A simulator that the user names runs already.
                    named.is_some() || !self.simulators.addresses.is_empty()
                }
                Program::Robot(recorded) => {
                    permit.robot = Some(self.robot.clone().unwrap_or_else(|| recorded.clone()));
                    self.robot.is_some()
                }
                Program::Policy(_) => self.policy.is_some(),
            };
            if !named {
                unnamed.push(program);
            }
        }
        let unused = [
            ("--env", &self.env, programs.iter().any(|program| matches!(program, Program::Environment(_)))),
            ("--robot", &self.robot, programs.iter().any(|program| matches!(program, Program::Robot(_)))),
        ];
        if let Some((option, Some(value), _)) = unused.into_iter().find(|(_, value, used)| value.is_some() && !used) {
            return Err(anyhow!("{option} {value}: the run names none\nHint: leave out {option}")).or_request();
        }
        match &origin {
            Some(Origin { python }) if permit.simulators.python.is_none() => {
                permit.simulators.python.clone_from(python)
            }
            _ => {}
        }
        if origin.is_none() && !self.trust.given && !unnamed.is_empty() {
            return Err(refusal(&unnamed)).or_request();
        }
        Ok(permit)
    }
}

/// The error for programs that may not start.
fn refusal(unnamed: &[&Program]) -> anyhow::Error {
    let names: Vec<String> = unnamed.iter().map(ToString::to_string).collect();
    let options: Vec<&str> = unnamed.iter().map(|program| program.option()).collect();
    anyhow!(
        "the run was not made by you on this machine, so {} {} not started\nHint: name your own copy with {}, or add --trust if \
         you trust the author: such a program can run any code",
        names.join(" and "),
        if names.len() == 1 { "is" } else { "are" },
        options.join(" and ")
    )
}

/// The environment that the user names for that of a run. Its files are compared before it starts.
fn same_environment(recorded: &str, named: &str) -> Result<String, Failure> {
    let full = from_any_folder(named);
    let attribute = |name: &str| name.rsplit_once(".py").map(|(_, attribute)| attribute.to_owned());
    let same = match (attribute(recorded), attribute(&full)) {
        (Some(one), Some(other)) => one == other,
        _ => *recorded == *full,
    };
    if same {
        return Ok(full);
    }
    Err(anyhow!("--env {named}: the run was made in {}\nHint: name the same environment", foreign(recorded)))
        .or_request()
}
