//! Maps of environments: how the observations, cameras and actions of an environment become those of a profile.
//!
//! A profile says what a model expects. A [`TaskMap`] says where an environment has it: a few lines of TOML with slices
//! of vectors, scales, constants, names of cameras, and the order, scale and sign of the numbers of an action.

mod bound;
mod piece;
mod policy;
mod table;

use robogate_core::budget::Budget;
use std::collections::BTreeMap;

use robogate_core::Word;
use serde::{Deserialize, Serialize};

pub use bound::BoundMap;
pub use piece::{CameraPiece, Piece, Pieces, Slice, Source};
pub use policy::{Mapped, Unmapped};
pub use table::{MapRow, map_table};

/// How an environment becomes the task that a profile expects.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskMap {
    /// Vectors under the names that the profile uses, made of pieces of the environment's vectors. A vector of the
    /// environment that is not named here keeps its name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub vectors: BTreeMap<Word, Pieces>,
    /// Cameras under the names that the profile uses. A camera that is not named here keeps its name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub cameras: BTreeMap<String, CameraPiece>,
    /// Each number of the environment's action, under the environment's name for it, from the action that the profile
    /// describes. Empty: the action of the profile is that of the environment.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub action: BTreeMap<String, Piece>,
}

impl TaskMap {
    /// Reads a map. Whether it fits an environment and a profile is known when it is bound to them ([`BoundMap::new`]).
    ///
    /// # Errors
    /// If the text is not the TOML of a map. The message has line and column.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        let map: Self = Budget::FILE.toml(text).map_err(|why| format!("not a valid map: {why}"))?;
        if map == Self::default() {
            return Err("the map is empty. Expected at least one of [vectors], [cameras] and [action]".to_owned());
        }
        Ok(map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_survives_its_record() {
        let text = "[vectors]\neef_pos = \"observation[0:3]\"\ngripper_qpos = [{ from = \"observation[3]\", scale = 0.04, offset = 1 }, 0]\n\
                    [cameras]\nfront = \"corner2\"\nwrist = { from = \"hand\", orientation = \"flipped\" }\n\
                    [action]\nx = { from = \"x\", scale = -100 }\ngripper = 1.0\n";
        let map = TaskMap::from_toml(text).unwrap();
        let json = serde_json::to_string(&map).unwrap();
        assert_eq!(serde_json::from_str::<TaskMap>(&json).unwrap(), map, "{json}");
    }

    #[test]
    fn errors_name_line_and_problem() {
        for (text, part) in [
            ("", "the map is empty"),
            ("[vectors]\na = true\n", "expected a number"),
            ("[vectors]\na = \"b[\"\n", "`b[` is not a source. Expected NAME, NAME[3] or NAME[0:3]"),
            ("[vectors]\na = \"b[x:2]\"\n", "`b[x:2]` is not a source"),
            ("[vectors]\na = { scale = 2.0 }\n", "missing field `from`"),
            ("[vectors]\na = { from = \"b\", factor = 2.0 }\n", "unknown field `factor`"),
            ("[vectors]\na = []\n", "the list is empty"),
            ("[vectors]\na = { from = \"b\", scale = nan }\n", "scale is not finite"),
            ("[vector]\na = \"b\"\n", "unknown field `vector`"),
            ("[cameras]\na = 3\n", "expected the name of a camera"),
        ] {
            let error = TaskMap::from_toml(text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
