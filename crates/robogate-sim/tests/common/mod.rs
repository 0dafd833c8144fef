//! The workbench of the tests: a robot in one of the engines.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![allow(dead_code, reason = "each test binary uses its part")]

use std::path::Path;

use robogate_sim::claims::{Bench, Setup, Workbench};
use robogate_sim::{Engine, MujocoEngine, PickPlace, RapierEngine, Robot, Scripted, SuctionLaw};

pub(crate) struct InMujoco(pub(crate) Robot);

pub(crate) fn franka() -> InMujoco {
    robot("franka")
}

/// A robot of the repository, by the name of its folder.
pub(crate) fn robot(name: &str) -> InMujoco {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/robots").join(name);
    InMujoco(Robot::from_folder(&folder).unwrap())
}

impl InMujoco {
    /// The same robot under the other engine.
    pub(crate) fn in_rapier(self) -> InRapier {
        InRapier(self.0)
    }
}

pub(crate) struct InRapier(Robot);

impl Workbench for InMujoco {
    fn setup(&self) -> Setup {
        Setup { robot: self.0.clone(), time_step_s: MujocoEngine::TIME_STEP_S, suction: SuctionLaw::Vacuum }
    }

    fn bench(&self, setup: &Setup) -> Result<Bench, String> {
        bench(MujocoEngine::new(setup.robot.clone(), setup.time_step_s).map_err(|e| e.to_string())?, setup)
    }
}

impl Workbench for InRapier {
    fn setup(&self) -> Setup {
        Setup { robot: self.0.clone(), time_step_s: RapierEngine::TIME_STEP_S, suction: SuctionLaw::Vacuum }
    }

    fn bench(&self, setup: &Setup) -> Result<Bench, String> {
        bench(RapierEngine::new(setup.robot.clone(), setup.time_step_s).map_err(|e| e.to_string())?, setup)
    }
}

fn bench<E: Engine + 'static>(engine: E, setup: &Setup) -> Result<Bench, String> {
    let policy = Scripted::new(setup.robot.clone(), engine.chain().clone());
    Ok((Box::new(PickPlace::new(engine, None)?.with_suction(setup.suction)), Box::new(policy)))
}
