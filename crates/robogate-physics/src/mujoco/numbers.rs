//! A loaded scene as numbers, for a simulator that steps many worlds of one topology.
//!
//! Scenes have the same topology if their compiled models differ in [`FIELDS`] alone: masses, sizes, friction, poses, gains. These
//! numbers are sent for each world; everything else is in the model that all worlds share.

use mujoco_rs::prelude::*;
use robogate_core::{Fault, FaultKind};
use serde::Serialize;

use super::{Kind, Loaded, MujocoEngine, wxyz};
use crate::Motion;

/// The fields that differ between worlds of one topology, as MuJoCo Warp names them.
macro_rules! fields {
    ($($field:ident $flatten:ident),*) => {
        /// Passes the name and the numbers of each field to `take`.
        fn each_field(model: &MjModel, mut take: impl FnMut(&'static str, &mut dyn Iterator<Item = f64>)) {
            $(take(stringify!($field), &mut fields!(@iter model.$field(), $flatten));)*
        }
    };
    (@iter $values:expr, scalars) => { $values.iter().copied() };
    (@iter $values:expr, rows) => { $values.iter().flatten().copied() };
}

fields! {
    qpos0 scalars, body_pos rows, body_quat rows, body_ipos rows, body_iquat rows, body_mass scalars,
    body_subtreemass scalars, body_inertia rows, body_invweight0 rows, jnt_axis rows, dof_armature scalars,
    dof_invweight0 scalars, geom_size rows, geom_aabb rows, geom_rbound scalars, geom_pos rows, geom_quat rows,
    geom_friction rows, actuator_gainprm rows, actuator_biasprm rows, eq_data rows
}

/// A scene for a simulator of many worlds.
#[derive(Debug, Clone)]
pub(crate) struct Numbers {
    /// Equal for scenes of one topology.
    pub(crate) topology: u64,
    /// The numbers of this world.
    pub(crate) values: Vec<f32>,
    /// Name and count of each field.
    pub(crate) fields: Vec<(&'static str, usize)>,
}

/// What a simulator has to know about the model of a topology.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Plan {
    time_step: f64,
    pub(crate) steps: usize,
    /// Role of each geom: 0 robot, 1 free body, 2 fixture, -1 without contact.
    role: Vec<i32>,
    /// The robot's body, the free body or the fixture that it belongs to.
    index: Vec<usize>,
    /// The finger that it belongs to, or -1.
    finger: Vec<i32>,
    pub(crate) fixtures: usize,
    /// Damping by stiffness of each servo of the arm, in seconds.
    lag: Vec<f64>,
    /// The first control of the arm. Those of the fingers follow.
    first: usize,
    /// Addresses of the fingers in qpos.
    fingers: Vec<usize>,
    open_finger: f64,
    tcp: usize,
    /// Body, address in qpos and address in qvel of each free body.
    free: Vec<[usize; 3]>,
    /// Addresses in qpos and qvel of the fixtures that move.
    movers: Vec<[usize; 2]>,
}

impl MujocoEngine {
    /// The loaded scene as numbers.
    pub(crate) fn numbers(&self) -> Numbers {
        let loaded = self.loaded();
        let model = loaded.data.model();
        let (mut values, mut fields) = (Vec::new(), Vec::new());
        let mut take = |name: &'static str, numbers: &mut dyn Iterator<Item = f64>| {
            let before = values.len();
            values.extend(numbers.map(|number| number as f32));
            if values.len() > before {
                fields.push((name, values.len() - before));
            }
        };
        take("opt.gravity", &mut model.opt().gravity.into_iter());
        each_field(model, &mut take);
        let motions = loaded.movers.iter().map(|mover| mover.motion);
        let motions = motions.flat_map(|motion| match motion {
            Motion::Straight { velocity, starts_s, ends_s } => [velocity.norm(), starts_s, ends_s],
            // [`Self::plan`] refuses other laws.
            _ => [f64::NAN; 3],
        });
        take("motion", &mut motions.collect::<Vec<_>>().into_iter());
        take("qpos", &mut loaded.data.qpos().iter().copied());
        Numbers { topology: topology(model), values, fields }
    }

    /// The plan of the topology of the loaded scene, with this number of time steps in a control period.
    ///
    /// # Errors
    /// If the robot has drives that a simulator of many worlds does not have.
    pub(crate) fn plan(&self, steps: usize) -> Result<Plan, Fault> {
        let loaded = self.loaded();
        let arm = &self.robot.settings.arm;
        let gripper = &self.robot.settings.gripper;
        let strong = self.strong.arm.iter().chain(&self.strong.fingers).any(|strong| *strong);
        if loaded.movers.iter().any(|mover| !matches!(mover.motion, Motion::Straight { .. })) {
            let why = "the scene has a belt or a fixture that shuttles or turns, which many worlds at once cannot simulate\n\
                       Hint: use --engine mujoco";
            return Err(Fault::new(FaultKind::Setup, why));
        }
        let lacks = match (gripper.jaw(), strong) {
            (None, _) => Some("a suction cup"),
            (Some(jaw), _) if !jaw.drives.is_empty() => Some("fingers with drives"),
            (_, true) => Some("joints that are damped far more than their inertia allows"),
            _ => None,
        };
        if let Some(what) = lacks {
            let why = format!(
                "{} has {what}, which many worlds at once cannot simulate\nHint: use --engine mujoco",
                self.robot.name()
            );
            return Err(Fault::new(FaultKind::Setup, why));
        }
        let kinds = loaded.kinds.iter().map(|kind| match *kind {
            Kind::Robot { body, finger } => (0, body, finger.map_or(-1, |finger| finger as i32)),
            Kind::Object(body) => (1, body, -1),
            Kind::Fixture(fixture) => (2, fixture, -1),
            Kind::Visual => (-1, 0, -1),
        });
        let kinds: Vec<(i32, usize, i32)> = kinds.collect();
        let lag = arm.damping_nms_rad.iter().zip(&arm.stiffness_nm_rad).map(|(damping, stiffness)| damping / stiffness);
        Ok(Plan {
            time_step: self.time_step,
            steps,
            role: kinds.iter().map(|(role, ..)| *role).collect(),
            index: kinds.iter().map(|(_, index, _)| *index).collect(),
            finger: kinds.iter().map(|(.., finger)| *finger).collect(),
            fixtures: loaded.scene.fixtures.len(),
            lag: lag.collect(),
            first: loaded.data.ctrl().len() - arm.joints.len() - loaded.fingers.len(),
            fingers: loaded.fingers.iter().map(|(qpos, _)| *qpos).collect(),
            open_finger: gripper.jaw().map_or(0.0, |jaw| 0.5 * jaw.opening_m),
            tcp: loaded.tcp,
            free: loaded.free.iter().map(|free| [free.body, free.qpos, free.qvel]).collect(),
            movers: loaded.movers.iter().map(|mover| [mover.qpos, mover.qvel]).collect(),
        })
    }

    /// The model of the loaded scene in MuJoCo's binary format.
    pub(crate) fn model_bytes(&self) -> Vec<u8> {
        bytes(self.loaded().data.model())
    }

    /// Takes the loaded scene out of the engine.
    pub(crate) fn take(&mut self) -> Option<Stage> {
        self.loaded.take().map(|loaded| Stage(Box::new(loaded)))
    }

    /// Puts a scene back that was taken out.
    pub(crate) fn put(&mut self, stage: Stage) {
        self.loaded = Some(*stage.0);
    }

    /// Sets positions and velocities of the loaded scene as a simulator reports them, and updates all poses.
    pub(crate) fn set_state(&mut self, qpos: &[f32], qvel: &[f32], steps: u64) {
        let Some(loaded) = self.loaded.as_mut() else { return };
        let set = |to: &mut [f64], from: &[f32]| to.iter_mut().zip(from).for_each(|(to, from)| *to = f64::from(*from));
        set(loaded.data.qpos_mut(), qpos);
        set(loaded.data.qvel_mut(), qvel);
        loaded.steps = steps;
        loaded.data.kinematics();
    }

    /// The number of free bodies of the loaded scene.
    pub(crate) fn free_bodies(&self) -> usize {
        self.loaded().free.len()
    }
}

/// A loaded scene outside of an engine.
pub(crate) struct Stage(Box<Loaded>);

impl std::fmt::Debug for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stage").field("steps", &self.0.steps).finish_non_exhaustive()
    }
}

/// A number that is equal for models that differ in [`FIELDS`] and in what no simulator uses.
fn topology(model: &MjModel) -> u64 {
    let mut model = model.clone();
    model.opt_mut().gravity = [0.0; 3];
    let stat = model.stat_mut();
    (stat.extent, stat.meaninertia, stat.meanmass, stat.meansize, stat.center) = (0.0, 0.0, 0.0, 0.0, [0.0; 3]);
    model.qpos0_mut().fill(0.0);
    model.qpos_spring_mut().fill(0.0);
    model.body_pos_mut().fill([0.0; 3]);
    let identity = wxyz(&nalgebra::UnitQuaternion::identity());
    model.body_quat_mut().fill(identity);
    model.body_ipos_mut().fill([0.0; 3]);
    model.body_iquat_mut().fill(identity);
    model.body_mass_mut().fill(0.0);
    model.body_subtreemass_mut().fill(0.0);
    model.body_inertia_mut().fill([0.0; 3]);
    model.body_invweight0_mut().fill([0.0; 2]);
    model.jnt_axis_mut().fill([0.0; 3]);
    model.dof_armature_mut().fill(0.0);
    model.dof_invweight0_mut().fill(0.0);
    model.dof_m0_mut().fill(0.0);
    model.geom_size_mut().fill([0.0; 3]);
    model.geom_aabb_mut().fill([0.0; 6]);
    model.geom_rbound_mut().fill(0.0);
    model.geom_pos_mut().fill([0.0; 3]);
    model.geom_quat_mut().fill(identity);
    model.geom_friction_mut().fill([0.0; 3]);
    model.geom_rgba_mut().fill([0.0; 4]);
    model.bvh_aabb_mut().fill([0.0; 6]);
    model.dof_simplenum_mut().fill(0);
    model.dof_length_mut().fill(0.0);
    model.body_sameframe_mut().fill(MjtSameFrame::mjSAMEFRAME_NONE);
    model.geom_sameframe_mut().fill(MjtSameFrame::mjSAMEFRAME_NONE);
    // SAFETY: this copy of the model is saved and never simulated; no size and no address changes.
    #[expect(unsafe_code, reason = "the binding has no safe setters for numbers that another model refers to")]
    unsafe {
        model.actuator_gainprm_mut().iter_mut().flatten().for_each(|x| *x = 0.0);
        model.actuator_biasprm_mut().iter_mut().flatten().for_each(|x| *x = 0.0);
        model.eq_data_mut().iter_mut().flatten().for_each(|x| *x = 0.0);
        model.body_simple_mut().fill(0);
        model.bvh_nodeid_mut().fill(0);
        model.bvh_child_mut().fill([0; 2]);
    }
    // FNV-1a, by words of eight bytes.
    bytes(&model).chunks(8).fold(0xcbf2_9ce4_8422_2325, |hash: u64, chunk| {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        (hash ^ u64::from_le_bytes(word)).wrapping_mul(0x0100_0000_01b3).rotate_left(5)
    })
}

fn bytes(model: &MjModel) -> Vec<u8> {
    let mut buffer = vec![0; model.size()];
    // The buffer has the size that the model asked for.
    let _ = model.save_to_buffer(&mut buffer);
    buffer
}
