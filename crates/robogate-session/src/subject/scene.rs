//! Writes the scene of an episode for plain MuJoCo, with the inputs that repeat its motion there.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::PoisonError;

use anyhow::{Context, anyhow};
use robogate_campaign::{Worker, WorkerFactory};
use robogate_core::{Episode, rollout};
use robogate_dictionary::files;
use robogate_physics::{Input, Tape};

use super::Subject;
use super::environment::EnvironmentSource;
use crate::failure::{Failure, OrFailure};

/// Plays the episode.
const PLAY: &str = include_str!("play_scene.py");

/// A scene that was written.
#[derive(Debug)]
pub struct WrittenScene {
    /// Number of time steps.
    pub steps: usize,
    /// Whether the episode ran as it was recorded.
    pub repeats: bool,
}

impl Subject {
    /// Runs a recorded episode again, and writes its scene into a new folder: `scene.xml` with its meshes, `inputs.csv`,
    /// `trajectory.csv`, and `play.py`, which repeats the motion in plain MuJoCo.
    ///
    /// # Errors
    /// If the episode did not run in MuJoCo in this process, cannot run again, or a file cannot be written.
    pub fn write_scene(mut self, recorded: &Episode, out: &Path) -> Result<WrittenScene, Failure> {
        let cell = match &mut self.environment {
            EnvironmentSource::BuiltIn(built_in) => built_in.cell_mut(),
            EnvironmentSource::Remote(_) => None,
        };
        let cell =
            cell.context("the episode is not one of the built-in cell, which has a scene to write").or_request()?;
        let tape = cell.taped().or_request()?;
        let engine = cell.mujoco().or_setup()?;
        let Worker { mut environment, mut policy } = self.worker().map_err(|fault| anyhow!("{fault}")).or_broken()?;
        let episode = rollout(&mut *environment, &mut *policy, &recorded.scenario);
        drop(environment);
        let tape = std::mem::take(&mut *tape.lock().unwrap_or_else(PoisonError::into_inner));
        let Some(scene) = tape.scene.as_ref().filter(|_| !tape.inputs.is_empty()) else {
            return Err(anyhow!("the episode has no time step: {:?}", episode.outcome)).or_request();
        };
        files::create_folders(out).with_context(|| format!("cannot make {}", out.display())).or_request()?;
        let out = out.canonicalize().with_context(|| out.display().to_string()).or_request()?;
        let names =
            engine.write_scene(scene, &tape.start, &out, "scene.xml").map_err(|why| anyhow!(why)).or_broken()?;
        let version = robogate_physics::Engine::build(&engine).version;
        for (name, text) in [
            ("inputs.csv", inputs(&tape.inputs, &names)),
            ("trajectory.csv", trajectory(&tape)),
            ("play.py", PLAY.replace("@VERSION@", &version)),
        ] {
            files::write(out.join(name), text).with_context(|| format!("cannot write {name}")).or_broken()?;
        }
        Ok(WrittenScene { steps: tape.inputs.len(), repeats: episode.repeats(recorded) })
    }
}

/// A row of numbers, each with all of its digits.
fn row(text: &mut String, numbers: impl Iterator<Item = f64>) {
    for (i, number) in numbers.enumerate() {
        // Writing to a string cannot fail.
        let _ = write!(text, "{}{number}", if i == 0 { "" } else { "," });
    }
    text.push('\n');
}

fn inputs(inputs: &[Input], [actuators, fixtures, welds]: &[Vec<String>; 3]) -> String {
    let mut columns: Vec<String> = actuators.iter().map(|name| format!("control:{name}")).collect();
    columns.extend(fixtures.iter().flat_map(|name| [format!("position:{name}"), format!("speed:{name}")]));
    for name in welds {
        columns.push(format!("closed:{name}"));
        columns.extend((0..11).map(|i| format!("weld{i}:{name}")));
    }
    let mut text = format!("{}\n", columns.join(","));
    for input in inputs {
        let fixtures = input.fixtures.iter().flatten().copied();
        let welds = input
            .welds
            .iter()
            .flat_map(|weld| std::iter::once(f64::from(weld.is_some())).chain(weld.unwrap_or([0.0; 11])));
        row(&mut text, input.controls.iter().copied().chain(fixtures).chain(welds));
    }
    text
}

/// Positions of all joints at the start and after each step.
fn trajectory(tape: &Tape) -> String {
    let names: Vec<String> = (0..tape.start.len()).map(|i| format!("qpos{i}")).collect();
    let mut text = format!("{}\n", names.join(","));
    row(&mut text, tape.start.iter().copied());
    tape.positions.iter().for_each(|positions| row(&mut text, positions.iter().copied()));
    text
}
