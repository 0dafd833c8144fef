//! Writes a scene for plain MuJoCo, and records what moves it there.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use mujoco_rs::prelude::*;

use super::MujocoEngine;
use crate::{Scene, robot_model};

/// Digits of the numbers in an exported model: all of a double.
const DIGITS: i32 = 17;
/// Name of the keyframe with the state at the start.
const START: &str = "start";

/// What moved the last scene that an engine loaded, time step by time step. Another MuJoCo with the same model, state at the start
/// and inputs repeats the motion.
#[derive(Debug, Default)]
pub struct Tape {
    /// The scene.
    pub scene: Option<Scene>,
    /// Positions of all joints at the start, in the order of the model.
    pub start: Vec<f64>,
    /// The inputs of each step.
    pub inputs: Vec<Input>,
    /// Positions of all joints after each step.
    pub positions: Vec<Vec<f64>>,
}

/// The inputs of a time step.
#[derive(Debug, Clone, PartialEq)]
pub struct Input {
    /// The controls of all actuators.
    pub controls: Vec<f64>,
    /// Position and speed of the joint of each fixture that moves, which are prescribed.
    pub fixtures: Vec<[f64; 2]>,
    /// The numbers of the weld between a suction cup and each free body, if it is closed.
    pub welds: Vec<Option<[f64; 11]>>,
}

impl MujocoEngine {
    /// The same engine, which records what moves its scenes.
    #[must_use]
    pub fn taped(mut self, tape: Arc<Mutex<Tape>>) -> Self {
        self.tape = Some(tape);
        self
    }

    /// Records a scene that was loaded.
    pub(super) fn tape_start(&self) {
        let (Some(tape), Some(loaded)) = (&self.tape, &self.loaded) else { return };
        *tape.lock().unwrap_or_else(PoisonError::into_inner) =
            Tape { scene: Some(loaded.scene.clone()), start: loaded.data.qpos().to_vec(), ..Tape::default() };
    }

    /// Records the inputs of the next step.
    pub(super) fn tape_inputs(&self) {
        let (Some(tape), Some(loaded)) = (&self.tape, &self.loaded) else { return };
        let (data, model) = (&loaded.data, loaded.data.model());
        let weld = |weld: &super::Weld| {
            let closed = data.eq_active()[weld.equality];
            closed.then(|| std::array::from_fn(|i| model.eq_data()[weld.equality][i]))
        };
        tape.lock().unwrap_or_else(PoisonError::into_inner).inputs.push(Input {
            controls: data.ctrl().to_vec(),
            fixtures: loaded.movers.iter().map(|mover| [data.qpos()[mover.qpos], data.qvel()[mover.qvel]]).collect(),
            welds: loaded.welds.iter().map(weld).collect(),
        });
    }

    /// Records the positions after a step.
    pub(super) fn tape_positions(&self) {
        let (Some(tape), Some(loaded)) = (&self.tape, &self.loaded) else { return };
        tape.lock().unwrap_or_else(PoisonError::into_inner).positions.push(loaded.data.qpos().to_vec());
    }

    /// Writes a scene with all of its files into a folder, as an MJCF of this name with a keyframe of the state at the start. Returns the
    /// names of the actuators, of the joints of moving fixtures and of the welds of a suction cup, in the order of [`Input`].
    ///
    /// # Errors
    /// If a file cannot be read or written, or MuJoCo cannot write the model.
    pub fn write_scene(
        &self,
        scene: &Scene,
        start: &[f64],
        folder: &Path,
        name: &str,
    ) -> Result<[Vec<String>; 3], String> {
        let mut spec = self.base.clone();
        self.furnish(&mut spec, scene).map_err(|error| error.to_string())?;
        let key = spec.add_key().with_name(START);
        key.set_qpos(start);
        self.gather(&mut spec, folder)?;
        spec.compile().map_err(|error| error.to_string())?;
        mujoco_loader::set_xml_precision(DIGITS);
        let file = folder.join(name);
        spec.save_xml(&file).map_err(|error| error.to_string())?;
        let cannot = |error: std::io::Error| format!("{}: {error}", file.display());
        let text = fs::read_to_string(&file).map_err(cannot)?;
        // The folder may be moved.
        fs::write(&file, text.replace(&format!("{}/", folder.display()), "")).map_err(cannot)?;
        let movers = scene.fixtures.iter().filter(|fixture| fixture.motion.is_some());
        let welds = self.robot.settings.gripper.cup().map_or(0, |_| 1 + scene.others.len());
        Ok([
            spec.actuator_iter().map(|actuator| actuator.name().to_owned()).collect(),
            movers.map(|fixture| format!("{}{}", super::PREFIX, fixture.name)).collect(),
            (0..welds).map(super::scene::weld_name).collect(),
        ])
    }

    /// Copies meshes and textures of the robot into folders of their own, and names them there.
    fn gather(&self, spec: &mut MjSpec, folder: &Path) -> Result<(), String> {
        let model = robot_model::path(&self.robot);
        let base = model.parent().unwrap_or(Path::new("")).to_owned();
        let (meshes, textures) = (spec.compiler().meshdir().to_owned(), spec.compiler().texturedir().to_owned());
        let strips = spec.strippath();
        let mut taken = BTreeSet::new();
        let mut copy = |file: &str, from: &str, to: &str| -> Result<Option<String>, String> {
            let file = Path::new(file);
            let Some(own) = file.file_name().map(|name| name.to_string_lossy().into_owned()) else { return Ok(None) };
            let source = base.join(from).join(if strips { Path::new(&own) } else { file });
            let mut name = own.clone();
            while !taken.insert(format!("{to}/{name}")) {
                name = format!("{}_{own}", taken.len());
            }
            let target = folder.join(to).join(&name);
            fs::create_dir_all(folder.join(to))
                .and_then(|()| fs::copy(&source, &target))
                .map_err(|error| format!("cannot copy {}: {error}", source.display()))?;
            Ok(Some(name))
        };
        for mesh in spec.mesh_iter_mut() {
            if let Some(name) = copy(mesh.file(), &meshes, "meshes")? {
                mesh.set_file(&name);
            }
        }
        for texture in spec.texture_iter_mut() {
            if let Some(name) = copy(texture.file(), &textures, "textures")? {
                texture.set_file(&name);
            }
        }
        let compiler = spec.compiler_mut();
        compiler.set_meshdir(&folder.join("meshes").to_string_lossy());
        compiler.set_texturedir(&folder.join("textures").to_string_lossy());
        Ok(())
    }
}
