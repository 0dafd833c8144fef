//! Drafts a profile from what a server declares about its inputs and outputs.

use serde_json::Value as Json;

use super::access::Access;
use super::array::Dtype;
use super::connection;
use super::error::PolicyError;
use super::gr00t::indices;
use super::profile::{Axes, Camera, Dialect, Filter, Fit, Gr00t, Orientation, Part, Profile, State};

/// A drafted profile, and what its author must decide.
#[derive(Debug, Clone, PartialEq)]
pub struct Draft {
    /// The profile.
    pub profile: Profile,
    /// Parts that the server does not declare, one sentence each.
    pub open: Vec<String>,
}

impl Draft {
    /// A copy of a profile, whose conventions remain those of the positive control.
    pub fn of(base: &Profile) -> Self {
        let reference = base.reference.clone().or_else(|| Profile::built_in(&base.name).map(|_| base.name.clone()));
        Self { profile: Profile { name: format!("{}-draft", base.name), reference, ..base.clone() }, open: Vec::new() }
    }
}

/// Draft a profile from the metadata of the server at `url`. What the server does not declare is that of `base`.
///
/// # Errors
/// If the server cannot be reached, or does not declare its modalities: only GR00T and RoboArena servers do.
pub fn draft(url: &str, base: &Profile) -> Result<Draft, PolicyError> {
    let connection = connection::connect_with(url, base, None, &Access::from_environment(), base.server.connect_s)?;
    from_metadata(connection.declared(), base)
}

/// What the server at `address` (HOST:PORT) declares about its inputs and outputs.
///
/// # Errors
/// If the server cannot be reached with the dialect of the profile, or declares something that contradicts it.
pub fn declared(address: &str, profile: &Profile) -> Result<Json, PolicyError> {
    let url = format!("{}{address}", profile.dialect.scheme());
    let access = Access::from_environment();
    let connection = connection::connect_with(&url, profile, None, &access, profile.server.connect_s)?;
    Ok(connection.declared().clone())
}

fn from_metadata(declared: &Json, base: &Profile) -> Result<Draft, PolicyError> {
    let mut profile = Profile { name: format!("{}-draft", base.name), reference: None, ..base.clone() };
    let mut open = Vec::new();
    match &base.dialect {
        Dialect::Gr00tN15(names) | Dialect::Gr00tN16(names) => {
            let names = gr00t(declared, names.clone(), &mut profile, &mut open)?;
            profile.dialect = match &base.dialect {
                Dialect::Gr00tN15(_) => Dialect::Gr00tN15(names),
                _ => Dialect::Gr00tN16(names),
            };
        }
        Dialect::RoboArena {} => {
            if let Some([height, width]) = declared.get("image_resolution").and_then(Json::as_array).map(Vec::as_slice)
                && let (Some(height), Some(width)) = (side(height), side(width))
            {
                profile.cameras.iter_mut().for_each(|camera| (camera.width, camera.height) = (width, height));
            }
        }
        other => {
            let why = format!("a server of the dialect {} does not declare its modalities", other.name());
            return Err(PolicyError::Mismatch(why));
        }
    }
    profile.notes = "A draft from the metadata of a server. Check every table.".to_owned();
    profile.check().map_err(|error| PolicyError::Mismatch(format!("the draft is not a valid profile: {error}")))?;
    Ok(Draft { profile, open })
}

fn side(value: &Json) -> Option<usize> {
    usize::try_from(value.as_u64()?).ok()
}

/// The names of a kind of modality, without the prefix of N1.5.
fn names(declared: &Json, kind: &str) -> Option<Vec<String>> {
    let keys = declared.get(kind)?.get("modality_keys")?.as_array()?;
    let bare = |name: &str| name.strip_prefix(kind).and_then(|n| n.strip_prefix('.')).unwrap_or(name).to_owned();
    Some(keys.iter().filter_map(Json::as_str).map(bare).collect())
}

fn gr00t(
    declared: &Json,
    mut known: Gr00t,
    profile: &mut Profile,
    open: &mut Vec<String>,
) -> Result<Gr00t, PolicyError> {
    let missing = |kind: &str| PolicyError::Mismatch(format!("the server declares no {kind}"));
    let history: Vec<i32> =
        indices(declared, "video").unwrap_or_default().into_iter().filter_map(|i| i32::try_from(i).ok()).collect();
    let history = if history == [0] { Vec::new() } else { history };
    let cameras = names(declared, "video").ok_or_else(|| missing("video"))?.into_iter().map(|key| {
        let same = profile.cameras.iter().find(|camera| camera.key == key);
        if same.is_none() {
            open.push(format!("camera `{key}`: its source, size and orientation are guessed"));
        }
        Camera { history: history.clone(), ..same.cloned().unwrap_or_else(|| camera(&key)) }
    });
    let cameras = cameras.collect();
    let states = names(declared, "state").ok_or_else(|| missing("state"))?.into_iter().map(|key| {
        profile.states.iter().find(|state| state.key == key).cloned().unwrap_or_else(|| {
            let (parts, guessed) = parts(&key);
            let what = if guessed { "its parts are guessed from the name" } else { "unknown; a zero is sent" };
            open.push(format!("state `{key}`: {what}"));
            State {
                key,
                parts,
                vectors: Vec::new(),
                dtype: Dtype::F32,
                history: Vec::new(),
                low: Vec::new(),
                high: Vec::new(),
            }
        })
    });
    let states = states.collect();
    (profile.cameras, profile.states) = (cameras, states);
    let actions = names(declared, "action").ok_or_else(|| missing("action"))?;
    if known.action_keys.iter().any(|key| !actions.contains(key)) {
        open.push(format!("action: its parts are {}; set size, arm, scales and gripper", actions.join(", ")));
        known.action_keys = actions;
    }
    if let Some([language]) = names(declared, "language").as_deref() {
        known.language_key.clone_from(language);
    }
    if let Some(length) = indices(declared, "action").map(|indices| indices.len()) {
        profile.chunk.length = Some(length);
        profile.chunk.execute = profile.chunk.execute.min(length.max(1));
    }
    Ok(known)
}

fn camera(key: &str) -> Camera {
    let from = if key.contains("wrist") || key.contains("hand") { "wrist" } else { "front" };
    Camera {
        from: from.to_owned(),
        or_from: Vec::new(),
        key: key.to_owned(),
        width: 256,
        height: 256,
        fit: Fit::default(),
        filter: Filter::default(),
        orientation: Orientation::default(),
        turned: false,
        crop: 1.0,
        axes: Axes::default(),
        history: Vec::new(),
    }
}

/// The parts of a state with this name, and whether the name is known.
fn parts(key: &str) -> (Vec<Part>, bool) {
    let parts = match key {
        "x" => vec![Part::ToolX],
        "y" => vec![Part::ToolY],
        "z" => vec![Part::ToolZ],
        "roll" => vec![Part::ToolRoll],
        "pitch" => vec![Part::ToolPitch],
        "yaw" => vec![Part::ToolYaw],
        "eef_9d" => vec![Part::ToolPosition, Part::ToolRot6dRows],
        _ if key.contains("joint_position") || key.ends_with("arm") => vec![Part::JointPositions],
        _ if key.contains("end_effector_position") || key.contains("eef_position") => vec![Part::ToolPosition],
        _ if key.contains("end_effector_rotation") || key.contains("eef_rotation") => vec![Part::ToolQuaternionXyzw],
        _ if key.contains("gripper") => vec![Part::GripperFingers],
        _ => return (vec![Part::Zero], false),
    };
    (parts, true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_become_a_profile() {
        let base = Profile::from_toml(Profile::built_in("gr00t-n1.6-libero").unwrap()).unwrap();
        let declared = serde_json::json!({
            "video": {"modality_keys": ["image", "wrist_view"], "delta_indices": [-15, 0]},
            "state": {"modality_keys": ["eef_9d", "joint_position", "mood"], "delta_indices": [0]},
            "action": {"modality_keys": ["joint_position", "gripper"], "delta_indices": (0..40).collect::<Vec<_>>()},
            "language": {"modality_keys": ["annotation.language.language_instruction"], "delta_indices": [0]},
        });
        let Draft { profile, open } = from_metadata(&declared, &base).unwrap();
        assert_eq!(profile.cameras[1].from, "wrist");
        assert_eq!((&*profile.cameras[0].history, profile.chunk.length), (&[-15, 0][..], Some(40)));
        assert_eq!(profile.states[0].parts, [Part::ToolPosition, Part::ToolRot6dRows]);
        assert_eq!(open.len(), 5, "{open:?}");
        // The file that is written can be read again.
        let text = toml::to_string_pretty(&profile).unwrap();
        assert_eq!(Profile::from_toml(&text).unwrap(), profile);
        let openpi = Profile::from_toml(Profile::built_in("pi0-libero").unwrap()).unwrap();
        assert!(from_metadata(&declared, &openpi).unwrap_err().to_string().contains("does not declare"));
        assert!(from_metadata(&serde_json::json!({}), &base).is_err());
    }
}
