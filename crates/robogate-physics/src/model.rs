//! A MuJoCo model without a robot, for tasks with their own world.

use mujoco_loader::LoadError;
use mujoco_rs::prelude::*;
use robogate_core::{Fault, FaultKind};

use crate::EngineBuild;
use crate::mujoco::{build, load_mujoco, warning};

/// A MuJoCo model and its state.
pub struct MujocoModel {
    data: MjData<Box<MjModel>>,
}

impl std::fmt::Debug for MujocoModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MujocoModel").finish_non_exhaustive()
    }
}

impl MujocoModel {
    /// Compiles an MJCF text. The state is the model's initial one.
    ///
    /// # Errors
    /// A setup fault: MuJoCo cannot be loaded, or rejects the model.
    pub fn from_xml(xml: &str) -> Result<Self, Fault> {
        load_mujoco().map_err(setup)?;
        let model = MjModel::from_xml_string(xml)
            .map_err(|why| Fault::new(FaultKind::Setup, format!("MuJoCo cannot compile the model: {why}")))?;
        Ok(Self { data: MjData::new(Box::new(model)) })
    }

    /// Identifies the MuJoCo library.
    ///
    /// # Errors
    /// A setup fault if MuJoCo cannot be loaded.
    pub fn build() -> Result<EngineBuild, Fault> {
        load_mujoco().map(build).map_err(setup)
    }

    /// The state, which contains the model.
    pub fn data(&self) -> &MjData<Box<MjModel>> {
        &self.data
    }

    /// The mutable state, to set positions and controls.
    pub fn data_mut(&mut self) -> &mut MjData<Box<MjModel>> {
        &mut self.data
    }

    /// Advances one time step.
    ///
    /// # Errors
    /// A fault of kind `Diverged` if MuJoCo issues a warning or the state is not finite.
    pub fn step(&mut self) -> Result<(), Fault> {
        self.data.step();
        if let Some(warning) = warning(&self.data) {
            return Err(Fault::new(FaultKind::Diverged, warning));
        }
        if self.data.qpos().iter().chain(self.data.qvel()).any(|x| !x.is_finite()) {
            return Err(Fault::new(FaultKind::Diverged, "MuJoCo: the state is not finite"));
        }
        Ok(())
    }

    /// Hash of positions and velocities (FNV-1a over 64-bit words).
    pub fn state_hash(&self) -> u64 {
        self.data.qpos().iter().chain(self.data.qvel()).fold(0xcbf2_9ce4_8422_2325, |hash, x| {
            (hash ^ x.to_bits()).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(5)
        })
    }
}

fn setup(error: LoadError) -> Fault {
    Fault::new(FaultKind::Setup, error.to_string())
}
