//! Checks of the values of a profile.

use super::{Arm, Chunking, Dialect, Orientation, Profile};
use crate::array::Dtype;

/// Maximum width or height of an image, in pixels.
const MAX_SIDE: usize = 4096;
/// Maximum number of actions that an image or a state may lie back.
const MAX_HISTORY: i32 = 100;
/// Maximum number of actions in a reply.
pub(crate) const MAX_CHUNK: usize = 1000;
/// Maximum number of connection attempts. The last pause is then about eight minutes.
const MAX_ATTEMPTS: u32 = 10;
/// Maximum timeout, in seconds.
const MAX_TIMEOUT_S: f64 = 86_400.0;

/// An error in a profile.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProfileError {
    /// The text is not the TOML of a profile. The message has line and column.
    #[error("not a valid profile: {0}")]
    Form(String),
    /// A value is invalid.
    #[error("{field}: {why}")]
    Value {
        /// Path of the field in the file.
        field: String,
        /// The problem, with the expected value.
        why: String,
    },
}

/// The result of a check of one part of a profile.
type Checked = Result<(), ProfileError>;

fn invalid(field: impl Into<String>, why: impl Into<String>) -> Checked {
    Err(ProfileError::Value { field: field.into(), why: why.into() })
}

/// Check the offsets of a camera or a state.
fn check_history(offsets: &[i32], field: impl Fn() -> String) -> Checked {
    if offsets.iter().all(|offset| (-MAX_HISTORY..=0).contains(offset)) {
        return Ok(());
    }
    invalid(field(), format!("the offsets are out of range. Expected integers from {} to 0", -MAX_HISTORY))
}

impl Profile {
    /// Check the values.
    pub fn check(&self) -> Result<(), ProfileError> {
        self.check_name()?;
        self.check_images()?;
        self.check_states()?;
        self.check_memories()?;
        self.check_numbers()?;
        self.check_action()?;
        self.check_reference()?;
        self.check_dialect()?;
        self.check_chunk()
    }

    fn check_name(&self) -> Checked {
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if self.name.is_empty() || self.name.len() > 64 || !self.name.chars().all(allowed) {
            let why = "is not a valid name. Expected 1 to 64 letters, digits, `-`, `_` and `.`";
            return invalid("name", format!("`{}` {why}", self.name));
        }
        Ok(())
    }

    fn check_images(&self) -> Checked {
        if let Some(side) = self.rendered_px
            && !(8..=MAX_SIDE).contains(&side)
        {
            return invalid("rendered_px", format!("{side} is out of range. Expected 8 to {MAX_SIDE} pixels"));
        }
        for (i, camera) in self.cameras.iter().enumerate() {
            let field = |name: &str| format!("camera[{i}].{name}");
            for (name, side) in [("width", camera.width), ("height", camera.height)] {
                if !(1..=MAX_SIDE).contains(&side) {
                    return invalid(field(name), format!("{side} is out of range. Expected 1 to {MAX_SIDE} pixels"));
                }
            }
            if !(camera.crop > 0.0 && camera.crop <= 1.0) {
                return invalid(
                    field("crop"),
                    format!("{} is out of range. Expected a fraction in (0, 1]", camera.crop),
                );
            }
            check_history(&camera.history, || field("history"))?;
            if camera.turned && camera.orientation != Orientation::Upright {
                return invalid(field("turned"), "use `orientation` alone");
            }
            if self.cameras[..i].iter().any(|other| other.key == camera.key) {
                return invalid(field("key"), format!("another camera has the key `{}`", camera.key));
            }
        }
        Ok(())
    }

    fn check_states(&self) -> Checked {
        for (i, state) in self.states.iter().enumerate() {
            let field = |name: &str| format!("state[{i}].{name}");
            if state.parts.is_empty() && state.vectors.is_empty() {
                return invalid(field("parts"), "the list is empty. Expected at least one part, or state.vectors");
            }
            if !matches!(state.dtype, Dtype::F32 | Dtype::F64) {
                return invalid(field("type"), format!("{} is not supported. Expected <f4 or <f8", state.dtype.name()));
            }
            check_history(&state.history, || field("history"))?;
            if matches!(self.dialect, Dialect::LeRobot(_)) && !state.history.is_empty() {
                let why =
                    "not used with the dialect lerobot, whose policies keep earlier observations themselves. Remove it";
                return invalid(field("history"), why);
            }
            let (low, high) = (state.low.len(), state.high.len());
            if low != high
                || state.low.iter().zip(&state.high).any(|(low, high)| low > high || low.is_nan() || high.is_nan())
            {
                return invalid(
                    field("low"),
                    "the published range needs as many numbers in `high`, none of them smaller",
                );
            }
            if self.states[..i].iter().any(|other| other.key == state.key) {
                return invalid(field("key"), format!("another state has the key `{}`", state.key));
            }
        }
        let needs_stroke = self.states.iter().flat_map(|state| &state.parts).any(|part| part.needs_stroke());
        if needs_stroke && self.tool.stroke_m.is_none() {
            return invalid("tool.stroke_m", "missing. A state contains the openness of the gripper, which needs it");
        }
        Ok(())
    }

    fn check_memories(&self) -> Checked {
        if !self.memories.is_empty() && !self.dialect.is_file() {
            return invalid(
                "memory",
                "only an ONNX file has memory that RoboGate keeps. A server keeps its own. Remove it",
            );
        }
        for (i, memory) in self.memories.iter().enumerate() {
            let earlier = &self.memories[..i];
            let input = &memory.input;
            let cameras = self.cameras.iter().map(|camera| &camera.key);
            if cameras.chain(self.states.iter().map(|state| &state.key)).any(|key| key == input) {
                let why =
                    format!("a camera or a state has the key `{input}`. Expected an input that nothing else fills");
                return invalid(format!("memory[{i}].input"), why);
            }
            if earlier.iter().any(|other| other.input == *input) {
                return invalid(format!("memory[{i}].input"), format!("another memory has the input `{input}`"));
            }
            if earlier.iter().any(|other| other.output == memory.output) {
                let why = format!("another memory has the output `{}`", memory.output);
                return invalid(format!("memory[{i}].output"), why);
            }
        }
        Ok(())
    }

    fn check_numbers(&self) -> Checked {
        // A negative scale reverses a motion.
        for (field, scale) in [
            ("action.position_scale_m", self.action.position_scale_m),
            ("action.rotation_scale_rad", self.action.rotation_scale_rad),
        ] {
            if !(scale.is_finite() && scale.abs() > 0.0) {
                return invalid(field, format!("{scale} is out of range. Expected a finite number other than 0"));
            }
        }
        let positive = [
            ("action.clip", self.action.clip.unwrap_or(1.0)),
            ("tool.joint_unit_rad", self.tool.joint_unit_rad.unwrap_or(1.0)),
            ("action.control_hz", self.action.control_hz.unwrap_or(1.0)),
            ("tool.stroke_m", self.tool.stroke_m.unwrap_or(1.0)),
            ("server.connect_s", self.server.connect_s),
            ("server.first_answer_s", self.server.first_answer_s),
            ("server.answer_s", self.server.answer_s),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return invalid(field, format!("{value} is out of range. Expected a number above 0"));
            }
            if field.starts_with("server.") && value > MAX_TIMEOUT_S {
                return invalid(field, format!("{value} s is out of range. Expected at most {MAX_TIMEOUT_S} s"));
            }
        }
        if !(1..=MAX_ATTEMPTS).contains(&self.server.attempts) {
            let why = format!("{} is out of range. Expected 1 to {MAX_ATTEMPTS}", self.server.attempts);
            return invalid("server.attempts", why);
        }
        for (field, values) in [("tool.shift_m", self.tool.shift_m), ("tool.turn_rad", self.tool.turn_rad)] {
            if !values.iter().all(|n| n.is_finite()) {
                return invalid(field, "contains a number that is not finite");
            }
        }
        if self.action.gripper_threshold.is_some_and(|threshold| !threshold.is_finite()) {
            return invalid("action.gripper_threshold", "is not finite");
        }
        Ok(())
    }

    fn check_gripper(&self) -> Checked {
        let fields = [
            ("action.gripper_threshold", self.action.gripper_threshold.is_some()),
            ("action.gripper_open", self.action.gripper_open.is_some()),
        ];
        let vector = self.action.arm == Arm::Vector;
        match fields.iter().find(|(_, given)| *given == vector) {
            Some((field, true)) => invalid(*field, "not used with arm = \"vector\". Remove it"),
            Some((field, false)) => invalid(*field, "missing. Without it the gripper has no commands"),
            None => Ok(()),
        }
    }

    fn check_action(&self) -> Checked {
        self.check_gripper()?;
        let (used, size) = (self.action.used(), self.action.size);
        if used == 0 || used > size {
            return invalid("action.used", format!("{used} is out of range. Expected 1 to {size} (action.size)"));
        }
        match (self.action.arm, self.action.used()) {
            (Arm::ToolDelta | Arm::OscPose | Arm::ToolPose, used) if used == 4 + self.action.rotation.size() => Ok(()),
            (Arm::JointPositions | Arm::JointDeltas, 2..=64) | (Arm::Vector, 1..=1024) => Ok(()),
            (Arm::Vector, size) => {
                invalid("action.size", format!("{size} is out of range. Expected 1 to 1024 for arm = \"vector\""))
            }
            (Arm::ToolDelta | Arm::OscPose | Arm::ToolPose, size) => {
                let (kind, rotation) = (self.action.arm.as_str(), self.action.rotation.size());
                let expected = 4 + rotation;
                invalid(
                    "action.size",
                    format!(
                        "{size}, but arm = \"{kind}\" has {expected} numbers: 3 for the translation, {rotation} for the \
                         rotation, 1 for the gripper"
                    ),
                )
            }
            (_, size) => invalid(
                "action.size",
                format!("{size} is out of range. Expected 2 to 64: one number for each joint, 1 for the gripper"),
            ),
        }
    }

    fn check_reference(&self) -> Checked {
        match &self.reference {
            Some(name) if Self::built_in(name).is_none() => {
                let known = Self::built_in_names().collect::<Vec<_>>().join(", ");
                invalid("reference", format!("unknown profile `{name}`. Expected one of: {known}"))
            }
            _ => Ok(()),
        }
    }

    fn check_dialect(&self) -> Checked {
        match &self.dialect {
            Dialect::LeRobot(_) if self.chunk.length.is_none() => {
                invalid("chunk.length", "missing. A lerobot server needs the number of actions per reply")
            }
            Dialect::Gr00tN15(names) | Dialect::Gr00tN16(names) | Dialect::Gr00tN15Http(names)
                if names.action_keys.is_empty() =>
            {
                invalid("dialect.action_keys", "the list is empty. Expected at least one key")
            }
            _ => Ok(()),
        }
    }

    fn check_chunk(&self) -> Checked {
        let Chunking { length, execute } = self.chunk;
        if execute == 0 || execute > MAX_CHUNK {
            return invalid("chunk.execute", format!("{execute} is out of range. Expected 1 to {MAX_CHUNK}"));
        }
        if let Some(length) = length
            && !(execute..=MAX_CHUNK).contains(&length)
        {
            let why = format!("{length} is out of range. Expected {execute} (chunk.execute) to {MAX_CHUNK}");
            return invalid("chunk.length", why);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_field() {
        let good = Profile::built_in("pi0-libero").unwrap();
        for (from, to, part) in [
            ("size = 7", "size = 6", "action.size: 6, but"),
            ("execute = 5", "execute = 51", "chunk.length: 50 is out of range. Expected 51 (chunk.execute)"),
            ("execute = 5", "execute = 0", "chunk.execute: 0 is out of range"),
            ("width = 224", "width = 0", "camera[0].width: 0 is out of range"),
            (
                "observation/wrist_image",
                "observation/image",
                "camera[1].key: another camera has the key `observation/image`",
            ),
            ("gripper_fingers", "gripper_openness", "tool.stroke_m: missing"),
            ("clip = 1.0", "clip = -1.0", "action.clip: -1 is out of range"),
            ("position_scale_m = 0.05", "position_scale_m = nan", "action.position_scale_m: NaN"),
            ("name = \"pi0-libero\"", "name = \"a b\"", "name: `a b` is not a valid name"),
            ("gripper_open = \"below\"", "", "action.gripper_open: missing"),
            ("arm = \"osc_pose\"", "arm = \"vector\"", "action.gripper_threshold: not used with arm = \"vector\""),
            ("\"below\"", "\"beneath\"", "TOML parse error at line"),
            ("clip = 1.0", "clap = 1.0", "unknown field `clap`"),
            ("name = \"openpi\"", "name = \"openqi\"", "openqi"),
        ] {
            let error = Profile::from_toml(&good.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn memory_and_history_are_checked() {
        let learned = Profile::built_in("learned").unwrap();
        let memory = |input: &str, output: &str| format!("\n[[memory]]\ninput = \"{input}\"\noutput = \"{output}\"\n");
        let error = |text: String| Profile::from_toml(&text).unwrap_err().to_string();
        let pair = memory("h0", "h1") + &memory("c0", "c1");
        assert_eq!(Profile::from_toml(&(learned.to_owned() + &pair)).unwrap().memories.len(), 2);
        for (added, part) in [
            (memory("state", "h1"), "memory[0].input: a camera or a state has the key `state`"),
            (memory("h0", "h1") + &memory("h0", "c1"), "memory[1].input: another memory has the input `h0`"),
            (memory("h0", "h1") + &memory("c0", "h1"), "memory[1].output: another memory has the output `h1`"),
        ] {
            assert!(error(learned.to_owned() + &added).contains(part), "{added}");
        }
        let served = Profile::built_in("pi0-libero").unwrap();
        assert!(error(served.to_owned() + &pair).contains("memory: only an ONNX file has memory"));
        let history = |offsets: &str| learned.replacen("type =", &format!("history = {offsets}\ntype ="), 1);
        assert!(Profile::from_toml(&history("[-2, -1, 0]")).is_ok());
        for offsets in ["[-101]", "[1]", "[-2147483648]"] {
            assert!(error(history(offsets)).contains("state[0].history: the offsets are out of range"), "{offsets}");
        }
        let lerobot = Profile::built_in("smolvla").unwrap().replacen("parts =", "history = [-1, 0]\nparts =", 1);
        assert!(error(lerobot).contains("state[0].history: not used with the dialect lerobot"));
    }
}
