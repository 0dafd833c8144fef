//! Writes the task.toml of an imported task.

use std::fmt::Write;

use nalgebra::Isometry3;

use super::{Imported, Wishes};
use crate::file::mjcf::{plain, pose_texts};
use crate::file::model::Model;
use crate::file::numbers::PartNumbers;
use crate::file::units::Dimension;

/// The condition of a task whose goal nobody has stated.
pub const UNFINISHED: &str = "TODO";

/// An MJCF file in a task.
#[derive(Debug, Clone, Default)]
pub(super) struct Fragment {
    pub(super) file: String,
    pub(super) name: Option<String>,
    /// Its pose in the frame of the robot's base.
    pub(super) place: Option<Isometry3<f64>>,
    pub(super) free: bool,
    /// Radius of the disc from which the start of the part is drawn, in metres, and how far it may be turned, in radians.
    pub(super) spread_m: f64,
    pub(super) spin_rad: f64,
}

/// Further tables of a task: regions, values at the start.
pub(super) fn task_with(
    mut imported: Imported,
    wishes: &Wishes,
    fragments: &[Fragment],
    tables: &str,
) -> Result<Imported, String> {
    let head = head(wishes, fragments, tables);
    let probe = format!("{head}\n[success]\nwhen = \"time() > 1 s\"\n");
    let files = &imported.files;
    let model =
        Model::read(&probe, &mut |name| files.get(name).cloned().ok_or_else(|| "there is no such file".to_owned()));
    let mut text = head;
    if let Ok(model) = &model {
        imported.bodies = bodies(model);
        text.push_str(&parameters(model, fragments));
    }
    text.push_str(&success(wishes, &imported.bodies));
    text.push_str(EXPERT);
    imported.text = text;
    Ok(imported)
}

pub(super) fn task(imported: Imported, wishes: &Wishes, fragments: &[Fragment]) -> Result<Imported, String> {
    task_with(imported, wishes, fragments, "")
}

const EXPERT: &str = r#"
# A script that solves the task is its positive control. Without one, nothing shows that the task can be solved. An example:
# [expert]
# do = [
#   "approach(cup, 15 cm)",
#   "grasp(cup)",
#   "lift(15 cm)",
#   "carry(shelf, 5 cm)",
#   "release()",
# ]
"#;

/// A text in quotes.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn head(wishes: &Wishes, fragments: &[Fragment], tables: &str) -> String {
    let name = plain(&wishes.name);
    let instruction = wishes.instruction.clone().unwrap_or_else(|| name.replace('_', " "));
    let instruction: String = instruction.replace(['{', '}'], "");
    let mut text = format!(
        "# An imported task. `robogate tasks check FOLDER` checks it; docs/reference/task-file.md explains every key.\n\
         format = \"robogate-task/1\"\nname = \"{name}\"\nversion = 1\nsummary = {}\ninstruction = {}\ntime_limit = \"30 s\"\n\n\
         [scene]\n# That of MuJoCo for bodies that state none.\nfriction = 1\n",
        quoted(&instruction),
        quoted(&instruction)
    );
    for fragment in fragments {
        let _ = write!(text, "\n[[mjcf]]\nfile = {}\n", quoted(&fragment.file));
        if let Some(name) = &fragment.name {
            let _ = writeln!(text, "name = {}", quoted(name));
        }
        let place = fragment.place.as_ref().map(pose_texts);
        let (at, rotation) = match place {
            Some((at, rotation)) => (Some(at), Some(rotation)),
            None => (None, None),
        };
        if wishes.at.is_none() && fragment.place.is_none() {
            text.push_str("# Where the origin of the file is in the frame of the robot's base: x forward, y to the left, z up from the table.\n");
        }
        let at = wishes.at.clone().or(at).unwrap_or_else(|| "0, 0, 0 m".to_owned());
        let rotation = wishes.rotation.clone().or(rotation).unwrap_or_else(|| "0, 0, 0 deg".to_owned());
        let _ = writeln!(text, "at = {}\nrotation = {}", quoted(&at), quoted(&rotation));
        if !wishes.weld.is_empty() {
            let _ = writeln!(text, "weld = {}", quoted(&wishes.weld.join(", ")));
        }
        if fragment.free || wishes.free {
            text.push_str("free = true\n");
        }
    }
    text.push_str(tables);
    for fragment in fragments {
        let drawn = fragment.spread_m > 0.0 || fragment.spin_rad > 0.0;
        let Some(name) = fragment.name.as_ref().filter(|_| drawn) else { continue };
        let _ = write!(text, "\n[[part]]\nname = {}\nspread = \"{:.4} m\"\n", quoted(name), fragment.spread_m);
        if fragment.spin_rad > 0.0 {
            let _ = writeln!(text, "spin = \"{} rad\"", fragment.spin_rad);
        }
    }
    text
}

/// What conditions can name.
fn bodies(model: &Model) -> Vec<String> {
    let fixtures = model.fixtures.iter().map(|of| format!("fixture {}", of.name));
    let parts = model.parts.iter().zip(&model.nominal.parts).map(|(part, numbers)| match joint(numbers) {
        Some((kind, unit, [low, high])) => format!("part {} on a {kind} from {low:.4} to {high:.4} {unit}", part.name),
        None => format!("part {}, which moves freely", part.name),
    });
    fixtures.chain(parts).chain(model.region_names().map(|name| format!("region {name}"))).collect()
}

fn joint(numbers: &PartNumbers) -> Option<(&'static str, &'static str, [f64; 2])> {
    let joint = numbers.joint?;
    Some(match joint.kind {
        robogate_physics::JointKind::Hinge => ("hinge", "rad", joint.range),
        _ => ("slide", "m", joint.range),
    })
}

/// Parameters with ranges that are guesses.
fn parameters(model: &Model, fragments: &[Fragment]) -> String {
    /// Most parts that get parameters.
    const MOST: usize = 6;
    let mut text = String::from("\n# What varies. The ranges are guesses: state those of your cell.\n");
    for (part, numbers) in model.parts.iter().zip(&model.nominal.parts).take(MOST) {
        let name = &part.name;
        // Three digits of a guess are enough to read.
        let short = |x: f64| format!("{x:.2e}").parse::<f64>().unwrap_or(x);
        let [low, high] = [0.7, 1.5].map(|factor| short(factor * numbers.mass_kg).clamp(1e-3, 100.0));
        let mut add = |parameter: String, sets: String, range: String, meaning: &str| {
            let _ = write!(
                text,
                "[[parameter]]\nname = \"{parameter}\"\nsets = \"{sets}\"\nrange = \"{range}\"\nmeaning = \"{meaning}\"\n\n"
            );
        };
        add(format!("{name}_mass_kg"), format!("{name}.mass"), format!("{low}, {high} kg"), "Mass of the part.");
        let starts = fragments.iter().any(|of| of.spread_m > 0.0 && of.name.as_ref() == Some(name));
        match &numbers.joint {
            None if !starts => {
                add(format!("{name}_spread_m"), format!("{name}.spread"), "0, 3 cm".to_owned(), "Spread of its start.");
            }
            None => {}
            Some(joint) => {
                let (force, unit, most) = match joint.kind {
                    robogate_physics::JointKind::Hinge => (Dimension::TORQUE, "nm", 1.0),
                    _ => (Dimension::FORCE, "n", 5.0),
                };
                let high = short(2.0 * joint.friction).max(most);
                let range = format!("0, {high} {}", force.unit());
                add(
                    format!("{name}_stick_{unit}"),
                    format!("{name}.joint.friction"),
                    range,
                    "Dry friction of the joint.",
                );
            }
        }
    }
    text
}

fn success(wishes: &Wishes, bodies: &[String]) -> String {
    let mut text = String::from("\n# Conditions can name:\n");
    for body in bodies {
        let _ = writeln!(text, "#   {body}");
    }
    let todo = format!(
        "{UNFINISHED}: say when the task is done, such as `joint(drawer) > 15 cm` or `on(cup, shelf) for 0.5 s`"
    );
    let goal = wishes.goal.as_ref().unwrap_or(&todo);
    let _ = write!(text, "[success]\nwhen = {}\n", quoted(goal));
    text
}
