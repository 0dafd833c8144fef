//! What a run records about its environment and its policy, and the subject of a recorded run.

use std::path::Path;

use anyhow::{Context, anyhow};
use robogate_dictionary::{CellPlace, Place, PolicyRecord, Provenance, PythonPlace, World};
use robogate_physics::{RobotFile, is_folder};

use crate::cell::{self, Cell, FRANKA};
use crate::failure::{Failure, OrFailure};
use crate::origin;
use crate::policy_source::{PolicyLocation, PolicySource};
use crate::registry;
use crate::remote;
use crate::reopening::{Permit, Program, Reopening};
use crate::text::foreign;

use super::Subject;
use super::environment::{EnvironmentSource, Launched, RemoteSource};
use crate::environment_choice::{absolute, file_and_attribute, file_sha256};
use crate::environments::{check_beside, kept};
use crate::notice::note;

/// Whether a run was made in an environment whose Python processes this command starts.
pub fn starts_processes(provenance: &Provenance) -> bool {
    matches!(&provenance.world, Some(World { place: Place::Python(_), .. }))
}

/// The world of a run that RoboGate recorded.
fn world(provenance: &Provenance) -> Result<&World, Failure> {
    let world = provenance.world.as_ref().context("the record does not say where its episodes took place");
    let world = world.or_request()?;
    if let Some(execution) = &world.execution {
        execution.latency.check().context("plan.json: provenance.world.execution is not valid").or_request()?;
    }
    if let Some(stress) = &world.stress {
        let valid = stress.check().map_err(|why| anyhow!("plan.json: provenance.world.stress is not valid: {why}"));
        valid.or_request()?;
    }
    Ok(world)
}

/// The programs that a world names.
fn programs_of(world: &World) -> Vec<Program> {
    let environment = match &world.place {
        Place::Python(PythonPlace { environment, .. }) => Some(Program::Environment(environment.clone())),
        Place::Cell(CellPlace { robot, .. }) | Place::Servers { robot } => {
            is_folder(robot).then(|| Program::Robot(robot.clone()))
        }
        Place::SelfContained => None,
    };
    let policy = match &world.policy {
        Some(PolicyRecord::External(external)) => Some(Program::Policy(external.server.clone())),
        Some(PolicyRecord::Hosted { from, .. }) => from.clone().map(Program::Policy),
        Some(PolicyRecord::BuiltIn { .. }) | None => None,
    };
    environment.into_iter().chain(policy).collect()
}

/// The programs that a record names.
pub fn programs(provenance: &Provenance) -> Result<Vec<Program>, Failure> {
    if provenance.source.is_some() {
        return Ok(Vec::new());
    }
    world(provenance).map(programs_of)
}

/// The files of the robot of a run in `folder`, if they have not changed since. A folder that the record of another user
/// names is not read.
pub fn recorded_robot(provenance: &Provenance, folder: Option<&Path>) -> Option<Vec<RobotFile>> {
    let Place::Cell(CellPlace { robot, .. }) = &provenance.world.as_ref()?.place else { return None };
    if is_folder(robot) {
        origin::of(folder?, provenance)?;
    }
    cell::robot_files(robot, provenance.robot.sha256.as_ref())
}

/// Rejects an environment or a robot whose files are not those of the run, before anything reads them.
fn same_files(what: &str, named: &str, recorded: Option<&String>, now: Option<&String>) -> Result<(), Failure> {
    if recorded == now {
        return Ok(());
    }
    let text = |sha256: Option<&String>| sha256.map_or("unknown", String::as_str).to_owned();
    Err(anyhow!(
        "the {what} {} is not the one of the run: its files have the SHA-256 {}, but the run recorded {}\nHint: restore the files \
         of the run, or start a new run",
        foreign(named),
        text(now),
        text(recorded)
    ))
    .or_request()
}

/// Rejects an environment whose own file, or a file beside it, is not that of the run. Returns the digest of its own file.
fn same_environment(own: &str, recorded: &PythonPlace) -> Result<Option<String>, Failure> {
    let now = file_sha256(own).or_request()?;
    same_files("environment", own, recorded.sha256.as_ref(), now.as_ref())?;
    if let Some((file, _)) = file_and_attribute(own) {
        check_beside(Path::new(file), recorded)?;
    }
    Ok(now)
}

/// The name of the kept copy of an environment in the folder of its run, if all recorded files are there unchanged.
fn kept_copy(run: &Path, recorded: &PythonPlace) -> Option<String> {
    let (file, attribute) = file_and_attribute(&recorded.environment)?;
    let copy = kept(run, recorded)?.join(Path::new(file).file_name()?);
    copy.is_file().then(|| format!("{}{attribute}", copy.display()))
}

impl Subject {
    /// The subject of a recorded run in `folder`, or of rows without one. Starts only what `opening` permits. A remote
    /// environment needs the address of its servers. A policy server is queried for its identity again.
    pub fn recorded(provenance: &Provenance, folder: Option<&Path>, opening: &Reopening) -> Result<Self, Failure> {
        Self::from_world(world(provenance)?.clone(), provenance, folder, opening)
    }

    /// Like [`Self::recorded`], with the scripted controller in place of the policy, whose server may be gone: for what only the
    /// environment knows.
    pub fn recorded_environment(
        provenance: &Provenance,
        folder: Option<&Path>,
        opening: &Reopening,
    ) -> Result<Self, Failure> {
        let world = World { policy: None, ..world(provenance)?.clone() };
        Self::from_world(world, provenance, folder, opening)
    }

    fn from_world(
        world: World,
        provenance: &Provenance,
        folder: Option<&Path>,
        opening: &Reopening,
    ) -> Result<Self, Failure> {
        let Permit { environment: permitted, robot: permitted_robot, location, mut simulators } =
            opening.permit(folder, provenance, &programs_of(&world))?;
        let World { mut place, policy, execution, stress, warner, controls, .. } = world;
        let recorded_comparison = match &policy {
            Some(PolicyRecord::External(external)) => external.compared.clone(),
            _ => None,
        };
        let policy = policy.as_ref().map(PolicySource::recorded).transpose()?;
        if let Some(policy) = &policy {
            simulators.loads = policy.loaded(&location).or_request()?;
        }
        let mut recorded_robot = None;
        if let Some(own) = permitted_robot {
            let now = cell::identity(&cell::robot(&own).or_request()?.files().or_request()?);
            // A simulator that has the robot need not declare its files.
            if provenance.robot.sha256.is_some() {
                same_files("robot", &own, provenance.robot.sha256.as_ref(), Some(&now))?;
            }
            match &mut place {
                Place::Cell(CellPlace { robot, .. }) | Place::Servers { robot } => {
                    let own = absolute(&own);
                    if own != *robot {
                        recorded_robot = Some(std::mem::replace(robot, own));
                    }
                }
                Place::SelfContained | Place::Python(_) => {}
            }
        }
        let (pool, launched) = match &place {
            Place::Python(recorded) if simulators.addresses.is_empty() => {
                let PythonPlace { environment, sha256, .. } = recorded;
                // A copy in the folder is as trusted as the folder, which the user need not trust when naming other files.
                let may_copy = opening.env.is_none() && !opening.continues;
                let copy = folder.filter(|_| may_copy).and_then(|run| kept_copy(run, recorded));
                let own = permitted.as_ref().unwrap_or(environment);
                let (own, now) = match (same_environment(own, recorded), copy) {
                    (Ok(now), _) => (own.clone(), now),
                    (Err(_), Some(copy)) => {
                        note(format_args!(
                            "the files of {} have changed since the run; its copies are used",
                            foreign(own)
                        ));
                        (copy, sha256.clone())
                    }
                    (Err(why), None) => return Err(why),
                };
                let (pool, servers) = simulators.launch(&own)?;
                if !opening.upgraded {
                    servers.imported().same_as(recorded)?;
                }
                (Some(pool), Some(Launched { name: environment.clone(), sha256: now, servers }))
            }
            _ => (simulators.connect()?, None),
        };
        let engine = &provenance.engine;
        let remote = match &place {
            Place::SelfContained => false,
            Place::Servers { .. } | Place::Python(_) => true,
            Place::Cell(cell) => cell.physics_servers,
        };
        match &pool {
            None if remote => Err(anyhow!(
                "the run was made in the remote simulator {}\nHint: give its address with --simulator ADDRESS",
                engine.name
            )),
            Some(_) if !remote => {
                Err(anyhow!("the run was made in the built-in engine {}, without --simulator", engine.name))
            }
            Some(pool) if !opening.upgraded && !remote::is_engine(pool.hello(), engine) => {
                let (now, version) = (remote::engine(pool.hello()), engine.version.as_deref().unwrap_or_default());
                let other = now.version.as_deref().unwrap_or_default();
                Err(anyhow!("the run was made in {} {version}; this simulator is {} {other}", engine.name, now.name))
            }
            _ => Ok(()),
        }
        .or_request()?;
        let chosen = provenance.task.setting_values();
        let task = provenance.task.name.as_str();
        let environment = match (place, pool) {
            (Place::SelfContained, _) => {
                let task = registry::task(task).or_request()?.with(&chosen);
                let task = task.map_err(|why| anyhow!("plan.json: {why}")).or_request()?;
                EnvironmentSource::BuiltIn(Box::new(task))
            }
            (Place::Servers { robot }, Some(pool)) => {
                EnvironmentSource::Remote(RemoteSource { pool, robot, launched: None })
            }
            (Place::Python(_), Some(pool)) => {
                EnvironmentSource::Remote(RemoteSource { pool, robot: FRANKA.to_owned(), launched })
            }
            (Place::Cell(place), pool) => {
                let task = cell::recorded_task(&provenance.task).or_request()?;
                EnvironmentSource::BuiltIn(Box::new(Cell::new(&*task, place, chosen, pool).or_setup()?))
            }
            (Place::Servers { .. } | Place::Python(_), None) => {
                return Err(anyhow!("--simulator ADDRESS is missing")).or_request();
            }
        };
        let policy = match policy {
            Some(policy) => {
                let may_copy = location.at.is_none() && !opening.continues;
                let copy = folder.filter(|_| may_copy).and_then(|run| policy.kept(run));
                Some(policy.asked_again(&PolicyLocation { at: copy.or(location.at), access: location.access })?)
            }
            None => location.unused().map(|()| None)?,
        };
        let mut subject = Self::new(environment, policy)?.executed(execution)?.stressed(stress)?.warned(warner)?;
        // The servers were compared again. The record of the run stays.
        subject.record_compared(recorded_comparison);
        Ok(Self { controls, recorded_robot, ..subject })
    }
}

impl EnvironmentSource {
    /// What a run records about where its episodes take place.
    pub(crate) fn place(&self) -> Place {
        match self {
            Self::BuiltIn(built_in) => built_in.place(),
            Self::Remote(RemoteSource { launched: Some(Launched { name, sha256, servers }), .. }) => {
                let imported = servers.imported();
                Place::Python(PythonPlace {
                    environment: name.clone(),
                    sha256: sha256.clone(),
                    files: imported.files(),
                    packages: imported.packages,
                })
            }
            Self::Remote(source) => Place::Servers { robot: source.robot.clone() },
        }
    }
}
