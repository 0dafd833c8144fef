//! A mapping as a table: each input of a model and each number of an action, with its place in the environment.

use robogate_core::{ActionSpace, TaskSpec};
use serde::Serialize;

use super::piece::Piece;
use super::{BoundMap, TaskMap};
use crate::decoder::is_robosuite;
use crate::profile::{Arm, Frame, Orientation, Part, Profile, Side};

/// A row of the table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MapRow {
    /// `camera`, `state` or `action`.
    pub kind: &'static str,
    /// The model's name, with positions in a vector.
    pub model: String,
    /// The name and meaning in the profile.
    pub profile: String,
    /// Where it is in the environment. `missing` if the environment lacks it.
    pub environment: String,
}

/// What an environment without a source of a name shows.
const MISSING: &str = "missing";

/// The rows of a profile in an environment: cameras, then states, then actions.
///
/// # Errors
/// If the map does not fit.
pub fn map_table(profile: &Profile, map: Option<&TaskMap>, task: &TaskSpec) -> Result<Vec<MapRow>, String> {
    let none = TaskMap::default();
    let map = map.unwrap_or(&none);
    let bound = BoundMap::new(map, profile, task)?;
    let mut rows = cameras(profile, map, bound.task());
    rows.extend(states(profile, map, bound.task()));
    rows.extend(actions(profile, map, task));
    Ok(rows)
}

fn oriented(text: String, orientation: Orientation) -> String {
    if orientation == Orientation::Upright { text } else { format!("{text}, {}", orientation.as_str()) }
}

fn cameras(profile: &Profile, map: &TaskMap, seen: &TaskSpec) -> Vec<MapRow> {
    let rows = profile.cameras.iter().map(|camera| {
        let found = camera.sources().find_map(|name| seen.observation.cameras.iter().find(|known| known.name == name));
        let environment = found.map_or_else(
            || MISSING.to_owned(),
            |spec| {
                let piece = map.cameras.get(&spec.name);
                let name = piece.map_or(&spec.name, |piece| &piece.from);
                let text = format!("{name}, {} x {}", spec.width, spec.height);
                oriented(text, piece.map_or(Orientation::Upright, |piece| piece.orientation))
            },
        );
        let name = found.map_or(&camera.from, |spec| &spec.name);
        MapRow {
            kind: "camera",
            model: format!("{}, {} x {}", camera.key, camera.width, camera.height),
            profile: oriented(name.clone(), camera.orientation()),
            environment,
        }
    });
    rows.collect()
}

/// The place of positions in a vector.
fn place(name: &str, from: usize, size: usize) -> String {
    match size {
        0 => name.to_owned(),
        1 => format!("{name}[{from}]"),
        _ => format!("{name}[{from}:{}]", from + size),
    }
}

fn states(profile: &Profile, map: &TaskMap, seen: &TaskSpec) -> Vec<MapRow> {
    let length = |name: &str| seen.observation.vectors.iter().find(|v| v.name == *name).map(|v| v.length);
    let source = |name: &str| match map.vectors.iter().find(|(known, _)| **known == *name) {
        Some((_, pieces)) => pieces.0.iter().map(Piece::to_string).collect::<Vec<_>>().join(", "),
        None => name.to_owned(),
    };
    let joints = length("joint_pos").or_else(|| length(robogate_core::vectors::JOINT_POSITIONS.as_str())).unwrap_or(0);
    let mut rows = Vec::new();
    for state in &profile.states {
        let mut at = 0;
        let mut push = |rows: &mut Vec<MapRow>, size: usize, profile: String, environment: String| {
            rows.push(MapRow { kind: "state", model: place(&state.key, at, size), profile, environment });
            at += size;
        };
        for part in &state.parts {
            let alternatives = part.robosuite();
            let environment = match part.vector() {
                None => "0".to_owned(),
                Some(vector) if length(vector.as_str()).is_some() => source(vector.as_str()),
                Some(_) if !alternatives.is_empty() && alternatives.iter().all(|name| length(name).is_some()) => {
                    alternatives.iter().map(|name| source(name)).collect::<Vec<_>>().join(", ")
                }
                Some(_) => MISSING.to_owned(),
            };
            push(&mut rows, part.size(joints), name_of(*part), environment);
        }
        for vector in &state.vectors {
            match length(vector.as_str()) {
                Some(size) => push(&mut rows, size, vector.to_string(), source(vector.as_str())),
                None => push(&mut rows, 0, vector.to_string(), MISSING.to_owned()),
            }
        }
    }
    rows
}

/// The name of a part in profiles.
fn name_of(part: Part) -> String {
    serde_json::to_value(part).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
}

fn actions(profile: &Profile, map: &TaskMap, task: &TaskSpec) -> Vec<MapRow> {
    let form = &profile.action;
    let used = form.used();
    let arms = if form.arm == Arm::Vector { used } else { used.saturating_sub(1) };
    let row =
        |model: String, profile: String, environment: String| MapRow { kind: "action", model, profile, environment };
    let bounds = task.action.spaces.iter().find_map(|space| match space {
        ActionSpace::Vector { names, low, high } => Some((names, low, high)),
        _ => None,
    });
    let in_bounds = |name: &str| match bounds.and_then(|(names, low, high)| {
        let at = names.iter().position(|known| known == name)?;
        low.get(at).zip(high.get(at))
    }) {
        Some((low, high)) => format!(" ({low} to {high})"),
        None => String::new(),
    };
    // What the environment does with the quantities of these names.
    let users = |names: &[String]| {
        let uses = map.action.iter().filter(|(_, piece)| match piece {
            Piece::From { source, .. } => names.contains(&source.to_string()),
            Piece::Number(_) => false,
        });
        let texts: Vec<String> = uses.map(|(name, piece)| format!("{name} = {piece}{}", in_bounds(name))).collect();
        if texts.is_empty() { "not used".to_owned() } else { texts.join(", ") }
    };
    let of = |names: &[&str], otherwise: &str| match map.action.is_empty() {
        true => otherwise.to_owned(),
        false => users(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>()),
    };
    let robosuite = form.arm == Arm::OscPose && map.action.is_empty() && is_robosuite(task);
    let direct = |kind: &str, native: bool| match (robosuite, native) {
        (true, _) => "the environment's own OSC_POSE".to_owned(),
        (false, true) => kind.to_owned(),
        (false, false) => MISSING.to_owned(),
    };
    let mut rows = Vec::new();
    match form.arm {
        Arm::Vector if map.action.is_empty() => {
            let environment = bounds.map_or_else(|| MISSING.to_owned(), |(names, ..)| names.join(", "));
            rows.push(row(place("action", 0, used), "vector".to_owned(), environment));
        }
        Arm::Vector => {
            for i in 0..used {
                let name = format!("action[{i}]");
                rows.push(row(name.clone(), "vector".to_owned(), users(&[name])));
            }
        }
        Arm::ToolDelta | Arm::OscPose | Arm::ToolPose => {
            let frame = if form.frame == Frame::Tool { "tool frame" } else { "base frame" };
            let kind = if form.arm == Arm::ToolPose { "position" } else { "translation" };
            let own = direct("tool_delta", task.action.tool_delta().is_some());
            rows.push(row(
                place("action", 0, 3),
                format!("{kind} x, y, z: 1 is {} m, {frame}", form.position_scale_m),
                of(&["x", "y", "z"], &own),
            ));
            let unit = if form.rotation.is_scaled() {
                format!(": 1 is {} rad", form.rotation_scale_rad)
            } else {
                String::new()
            };
            rows.push(row(
                place("action", 3, arms.saturating_sub(3)),
                format!("rotation rx, ry, rz{unit}"),
                of(&["rx", "ry", "rz"], &own),
            ));
        }
        Arm::JointPositions | Arm::JointDeltas => {
            let names: Vec<String> = (0..arms).map(|i| format!("joint[{i}]")).collect();
            let own = direct("joint_position", task.action.joints().is_some());
            let environment = if map.action.is_empty() { own } else { users(&names) };
            rows.push(row(place("action", 0, arms), form.arm.as_str().to_owned(), environment));
        }
    }
    if let (Some(threshold), Some(side)) = (form.gripper_threshold, form.gripper_open) {
        let side = if side == Side::Above { "above" } else { "below" };
        let own = if robosuite {
            direct("", false)
        } else if task.action.gripper.is_some() {
            "gripper".to_owned()
        } else {
            MISSING.to_owned()
        };
        rows.push(row(place("action", arms, 1), format!("gripper: opens {side} {threshold}"), of(&["gripper"], &own)));
    }
    for (name, piece) in &map.action {
        if let Piece::Number(_) = piece {
            rows.push(row("-".to_owned(), "constant".to_owned(), format!("{name} = {piece}")));
        }
    }
    rows
}
