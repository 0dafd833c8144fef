//! The workbench of the tests: the Franka in MuJoCo.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use robogate_sim::claims::{Bench, Workbench};
use robogate_sim::{Engine, Gripper, MujocoEngine, PickPlace, Robot, Scripted, built_in_robot};

pub(crate) struct FrankaInMujoco(Robot);

pub(crate) fn franka() -> FrankaInMujoco {
    FrankaInMujoco(built_in_robot("franka").unwrap())
}

impl Workbench for FrankaInMujoco {
    fn bench(&self, time_step_s: Option<f64>, grip_force_n: Option<f64>) -> Result<Bench, String> {
        let engine =
            MujocoEngine::new(self.0.clone(), time_step_s.unwrap_or(self.time_step_s())).map_err(|e| e.to_string())?;
        let policy = Scripted::new(self.0.clone(), engine.chain().clone());
        Ok((Box::new(PickPlace::new(engine, grip_force_n)?), Box::new(policy)))
    }

    fn time_step_s(&self) -> f64 {
        MujocoEngine::TIME_STEP_S
    }

    fn opening_m(&self) -> f64 {
        let Gripper::ParallelJaw { opening_m, .. } = &self.0.settings.gripper;
        *opening_m
    }

    fn force_limit_n(&self) -> f64 {
        let Gripper::ParallelJaw { force_limit_n, .. } = &self.0.settings.gripper;
        *force_limit_n
    }

    fn joint_limits(&self) -> (Vec<f64>, Vec<f64>) {
        let arm = &self.0.settings.arm;
        (arm.velocity_limit_rad_s.clone(), arm.acceleration_limit_rad_s2.clone())
    }
}
