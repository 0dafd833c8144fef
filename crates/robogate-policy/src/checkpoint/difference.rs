//! What differs between two checkpoints, in the words of an engineer.

use std::collections::BTreeMap;

use serde_json::Value;

use super::safetensors::{Tensor, Tensors};
use super::{Checkpoint, Content};

/// Differences of one file that are listed one by one.
const LISTED: usize = 6;

/// Settings that say where something runs or lies, and not what it does: the last part of their path.
const NO_EFFECT: [&str; 14] = [
    "device",
    "push_to_hub",
    "repo_id",
    "private",
    "license",
    "tags",
    "pretrained_path",
    "output_dir",
    "job_name",
    "resume",
    "num_workers",
    "checkpoint_path",
    "transformers_version",
    "_name_or_path",
];

/// What a setting is about, by a part of its path in lower-case letters. The first that fits counts.
const SUBJECTS: [(&str, &[&str]); 11] = [
    ("normaliser", &["norm", "stats", "quantile"]),
    ("chunk length", &["n_action_steps", "chunk_size", "horizon", "action_steps", "num_actions"]),
    ("history", &["n_obs_steps", "history", "n_frames", "delta_timestamps"]),
    ("denoising", &["inference_steps", "num_steps", "train_timesteps", "noise", "beta_"]),
    ("rate", &["fps", "_hz", "frequency", "control_rate"]),
    ("cameras", &["camera", "image", "rename_map", "video", "crop", "resize"]),
    ("colours", &["bgr", "rgb", "color", "colour", "channel"]),
    ("instruction", &["tokenizer", "prompt", "instruction", "language", "vocab"]),
    ("precision", &["dtype", "amp", "precision", "quantiz"]),
    ("actions", &["action"]),
    ("state", &["state", "proprio"]),
];

impl Checkpoint {
    /// What differs between this checkpoint, which was judged, and a deployed one. Empty if they agree in all that is recorded.
    pub fn differences(&self, deployed: &Self) -> Vec<String> {
        let mut found = Vec::new();
        for (name, judged) in &self.files {
            match (judged, deployed.files.get(name)) {
                (_, None) => found.push(format!("{name} is missing")),
                (Content::Settings(a), Some(Content::Settings(b))) => settings(name, a, b, &mut found),
                (judged, Some(other)) if judged != other => found.push(format!("{}{name} has other bytes", code(name))),
                _ => {}
            }
        }
        let added = deployed.files.keys().filter(|name| !self.files.contains_key(*name));
        found.extend(added.map(|name| format!("{}{name} was added", code(name))));
        for (name, judged) in &self.tensors {
            match deployed.tensors.get(name) {
                None => found.push(format!("the tensors of {name} are missing")),
                Some(other) => tensors(name, judged, other, &mut found),
            }
        }
        let added = deployed.tensors.keys().filter(|name| !self.tensors.contains_key(*name));
        found.extend(added.map(|name| format!("the tensors of {name} were added")));
        found
    }

    /// What a server declares in another way than the settings of this checkpoint say: settings with one name and one number or word
    /// in both.
    pub fn contradictions(&self, declared: &Value) -> Vec<String> {
        let mut stated = BTreeMap::new();
        super::flatten(declared, String::new(), super::MOST_ENTRIES, &mut stated);
        let last = |path: &str| path.rsplit('.').next().unwrap_or(path).to_owned();
        let mut found = Vec::new();
        for (path, value) in stated.iter().filter(|(path, _)| !has_no_effect(path)) {
            let own = self.files.iter().filter_map(|(file, content)| match content {
                Content::Settings(settings) => Some((file, settings)),
                Content::Bytes { .. } => None,
            });
            let same: Vec<(&String, &Value)> = own
                .flat_map(|(file, settings)| settings.iter().map(move |(key, value)| (file, key, value)))
                .filter(|(_, key, _)| last(key) == last(path))
                .map(|(file, _, value)| (file, value))
                .collect();
            let comparable = |a: &Value, b: &Value| {
                (a.is_number() && b.is_number())
                    || (a.is_string() && b.is_string())
                    || (a.is_boolean() && b.is_boolean())
            };
            // A name that stands for several things says nothing.
            if let [(file, recorded)] = &*same
                && comparable(recorded, value)
                && !equal(recorded, value)
            {
                found.push(format!("the server declares {path} = {value}, and {file} has {recorded}"));
            }
        }
        found
    }
}

/// Numbers are equal by their value: 1 and 1.0.
fn equal(a: &Value, b: &Value) -> bool {
    a == b || a.as_f64().zip(b.as_f64()).is_some_and(|(a, b)| a == b)
}

fn has_no_effect(path: &str) -> bool {
    let last = path.rsplit('.').next().unwrap_or(path);
    NO_EFFECT.contains(&last) || path.starts_with("wandb.")
}

/// What a difference of a file is about, before its name.
fn code(name: &str) -> &'static str {
    if [".py", ".so", ".pyc", ".sh"].iter().any(|end| name.ends_with(end)) { "code: " } else { "" }
}

/// What a setting is about.
fn subject(file: &str, path: &str) -> &'static str {
    let path = path.to_lowercase();
    let of = |text: &str| SUBJECTS.iter().find(|(_, parts)| parts.iter().any(|part| text.contains(part)));
    of(&path)
        .or_else(|| of(&file.to_lowercase()).filter(|(subject, _)| *subject == "normaliser"))
        .map_or("setting", |(name, _)| name)
}

fn settings(file: &str, a: &BTreeMap<String, Value>, b: &BTreeMap<String, Value>, found: &mut Vec<String>) {
    let keys = a.keys().chain(b.keys().filter(|key| !a.contains_key(*key))).filter(|key| !has_no_effect(key));
    let other: Vec<&String> =
        keys.filter(|key| !matches!((a.get(*key), b.get(*key)), (Some(a), Some(b)) if equal(a, b))).collect();
    for key in other.iter().take(LISTED) {
        let of = subject(file, key);
        found.push(match (a.get(*key), b.get(*key)) {
            (Some(a), Some(b)) => format!("{of}: {file} has {key} = {b} in place of {a}"),
            (Some(a), None) => format!("{of}: {file} lacks {key} = {a}"),
            (None, b) => format!("{of}: {file} also has {key} = {}", b.unwrap_or(&Value::Null)),
        });
    }
    more(file, "settings", other.len(), found);
}

fn more(name: &str, what: &str, all: usize, found: &mut Vec<String>) {
    if all > LISTED {
        found.push(format!("{} more {what} of {name} differ", all - LISTED));
    }
}

/// Whether a group of tensors is that of a normaliser: it has statistics of the training data.
fn is_normaliser(name: &str, tensors: &Tensors) -> bool {
    let statistic = |tensor: &String| {
        ["mean", "std", "min", "max", "q01", "q99", "count"]
            .contains(&tensor.rsplit(['.', '_']).next().unwrap_or(tensor))
    };
    let lower = name.to_lowercase();
    lower.contains("normaliz") || lower.contains("processor") || (!tensors.is_empty() && tensors.keys().all(statistic))
}

fn tensors(name: &str, a: &Tensors, b: &Tensors, found: &mut Vec<String>) {
    let of = if is_normaliser(name, a) { "normaliser" } else { "weights" };
    let only = |one: &Tensors, other: &Tensors| {
        one.keys().filter(|key| !other.contains_key(*key)).cloned().collect::<Vec<_>>()
    };
    for (what, names) in [("lacks", only(a, b)), ("also has", only(b, a))] {
        if let Some(first) = names.first() {
            let rest = if names.len() > 1 { format!(" and {} more", names.len() - 1) } else { String::new() };
            found.push(format!("{of}: {name} {what} the tensor {first}{rest}"));
        }
    }
    let pairs: Vec<(&String, &Tensor, &Tensor)> =
        a.iter().filter_map(|(key, a)| Some((key, a, b.get(key)?))).filter(|(_, a, b)| a != b).collect();
    let (converted, changed): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(_, a, b)| a.dtype != b.dtype);
    if let Some((_, was, is)) = converted.first() {
        let n = converted.iter().filter(|(_, a, b)| (&a.dtype, &b.dtype) == (&was.dtype, &is.dtype)).count();
        found.push(format!(
            "precision: {n} of {} tensors of {name} are {} in place of {}",
            a.len(),
            is.dtype,
            was.dtype
        ));
    }
    if changed.len() > LISTED && of == "weights" {
        let all = if changed.len() == a.len() { "all".to_owned() } else { changed.len().to_string() };
        found.push(format!("weights: {all} of {} tensors of {name} have other numbers", a.len()));
        return;
    }
    for (key, a, b) in changed.iter().take(LISTED) {
        let differs = a.numbers.iter().zip(&b.numbers).position(|(a, b)| a != b);
        found.push(match differs {
            _ if a.shape != b.shape => {
                format!("{of}: {key} of {name} has the shape {:?} in place of {:?}", b.shape, a.shape)
            }
            Some(at) => {
                format!("{of}: number {} of {key} of {name} is {} in place of {}", at + 1, b.numbers[at], a.numbers[at])
            }
            None => format!("{of}: {key} of {name} has other numbers"),
        });
    }
    more(name, "tensors", changed.len(), found);
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use serde_json::json;

    use super::*;

    /// A tensor of 32-bit numbers.
    fn tensor(dtype: &str, numbers: &[f32]) -> (String, Vec<u8>) {
        (dtype.to_owned(), numbers.iter().flat_map(|number| number.to_le_bytes()).collect())
    }

    fn safetensors(tensors: &[(&str, (String, Vec<u8>))]) -> Vec<u8> {
        let (mut header, mut data) = (serde_json::Map::new(), Vec::new());
        header.insert("__metadata__".to_owned(), json!({ "format": "pt" }));
        for (name, (dtype, bytes)) in tensors {
            let width = if dtype == "F16" { 2 } else { 4 };
            let offsets = [data.len(), data.len() + bytes.len()];
            header.insert(
                (*name).to_owned(),
                json!({ "dtype": dtype, "shape": [bytes.len() / width], "data_offsets": offsets }),
            );
            data.extend(bytes);
        }
        let header = serde_json::to_vec(&header).unwrap();
        [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat()
    }

    const CONFIG: &str = r#"{"type": "act", "n_action_steps": 50, "chunk_size": 50, "n_obs_steps": 1, "device": "cuda",
        "normalization_mapping": {"STATE": "MEAN_STD", "ACTION": "MEAN_STD"}, "num_inference_steps": 10,
        "input_features": {"observation.images.front": {"shape": [3, 480, 640]}, "observation.state": {"shape": [6]}}}"#;
    const STEPS: &str = r#"{"name": "policy_preprocessor", "steps": [{"registry_name": "rename_observations_processor",
        "config": {"rename_map": {}}}, {"registry_name": "normalizer_processor", "config": {"eps": 1e-8}}]}"#;

    /// A checkpoint as LeRobot writes it.
    fn write(at: &Path) {
        let layers: Vec<(String, (String, Vec<u8>))> =
            (0..12).map(|layer| (format!("model.{layer}.weight"), tensor("F32", &[layer as f32; 100]))).collect();
        let layers: Vec<(&str, (String, Vec<u8>))> = layers.iter().map(|(name, of)| (&**name, of.clone())).collect();
        fs::write(at.join("model.safetensors"), safetensors(&layers)).unwrap();
        let statistics = [
            ("observation.state.mean", tensor("F32", &[0.5, -1.0])),
            ("observation.state.std", tensor("F32", &[1.0, 2.0])),
        ];
        fs::write(at.join("policy_preprocessor_step_2_normalizer_processor.safetensors"), safetensors(&statistics))
            .unwrap();
        fs::write(at.join("config.json"), CONFIG).unwrap();
        fs::write(at.join("policy_preprocessor.json"), STEPS).unwrap();
        fs::write(at.join("modeling_custom.py"), "x = 1\n").unwrap();
        fs::write(at.join("README.md"), "a model").unwrap();
        fs::create_dir(at.join("training_state")).unwrap();
        fs::write(at.join("training_state/optimizer_state.safetensors"), "x").unwrap();
    }

    /// The differences after a change of a deployed copy.
    fn after(change: impl FnOnce(&Path)) -> Vec<String> {
        let [judged, deployed] = [0, 1].map(|_| tempfile::TempDir::new().unwrap());
        write(judged.path());
        write(deployed.path());
        change(deployed.path());
        let judged = Checkpoint::of(judged.path()).unwrap();
        let judged = Checkpoint::from_json(judged.to_json().as_bytes()).unwrap();
        judged.differences(&Checkpoint::of(deployed.path()).unwrap())
    }

    fn edit(file: &str, from: &str, to: &str) -> impl FnOnce(&Path) {
        move |at| {
            let text = fs::read_to_string(at.join(file)).unwrap();
            assert!(text.contains(from));
            fs::write(at.join(file), text.replace(from, to)).unwrap();
        }
    }

    #[test]
    fn equal_content_in_another_form_is_equal() {
        assert_eq!(after(|_| {}), [""; 0]);
        assert_eq!(after(edit("config.json", "cuda", "cpu")), [""; 0]);
        assert_eq!(after(edit("README.md", "a", "the")), [""; 0]);
        assert_eq!(after(|at| fs::remove_dir_all(at.join("training_state")).unwrap()), [""; 0]);
        // Another order of keys, other spaces, and 1 in place of 1.0.
        let other = after(|at| {
            let document: Value = serde_json::from_str(CONFIG).unwrap();
            fs::write(at.join("config.json"), serde_json::to_string_pretty(&document).unwrap().replace("50,", "50.0,"))
                .unwrap();
        });
        assert_eq!(other, [""; 0]);
        // The weights in two files with an index.
        let parts = after(|at| {
            let layers: Vec<_> =
                (0..12).map(|layer| (format!("model.{layer}.weight"), tensor("F32", &[layer as f32; 100]))).collect();
            let layers: Vec<_> = layers.iter().map(|(name, of)| (&**name, of.clone())).collect();
            fs::remove_file(at.join("model.safetensors")).unwrap();
            fs::write(at.join("model-00001-of-00002.safetensors"), safetensors(&layers[..5])).unwrap();
            fs::write(at.join("model-00002-of-00002.safetensors"), safetensors(&layers[5..])).unwrap();
            fs::write(at.join("model.safetensors.index.json"), "{}").unwrap();
        });
        assert_eq!(parts, [""; 0]);
    }

    #[test]
    fn changes_have_a_cause() {
        let config = |from, to| after(edit("config.json", from, to));
        let steps = |from, to| after(edit("policy_preprocessor.json", from, to));
        let statistics = |mean: &[f32]| {
            let of = [
                ("observation.state.mean", tensor("F32", mean)),
                ("observation.state.std", tensor("F32", &[1.0, 2.0])),
            ];
            let bytes = safetensors(&of);
            after(move |at| {
                fs::write(at.join("policy_preprocessor_step_2_normalizer_processor.safetensors"), bytes).unwrap()
            })
        };
        let weights = |layer: &dyn Fn(usize) -> (String, Vec<u8>)| {
            let layers: Vec<_> = (0..12).map(|of| (format!("model.{of}.weight"), layer(of))).collect();
            let bytes = safetensors(&layers.iter().map(|(name, of)| (&**name, of.clone())).collect::<Vec<_>>());
            after(move |at| fs::write(at.join("model.safetensors"), bytes).unwrap())
        };
        for (found, cause) in [
            (
                config("\"n_action_steps\": 50", "\"n_action_steps\": 10"),
                "chunk length: config.json has n_action_steps = 10 in place of 50",
            ),
            (
                config("MEAN_STD\", \"ACTION", "MIN_MAX\", \"ACTION"),
                "normaliser: config.json has normalization_mapping.STATE",
            ),
            (config("\"num_inference_steps\": 10", "\"num_inference_steps\": 4"), "denoising: "),
            (config("\"n_obs_steps\": 1", "\"n_obs_steps\": 2"), "history: "),
            (config("images.front", "images.wrist"), "cameras: config.json"),
            (
                config("[3, 480, 640]", "[3, 224, 224]"),
                "cameras: config.json has input_features.observation.images.front.shape.2",
            ),
            (steps("\"rename_map\": {}", "\"rename_map\": {\"a\": \"b\"}"), "cameras: policy_preprocessor.json"),
            (steps("1e-8", "1e-6"), "setting: policy_preprocessor.json has steps.2.config.eps"),
            (
                statistics(&[0.5, -1.5]),
                "normaliser: number 2 of observation.state.mean of policy_preprocessor_step_2_normalizer_processor is -1.5 in place of -1",
            ),
            (
                weights(&|of| tensor("F32", &[of as f32 + 0.5; 100])),
                "weights: all of 12 tensors of model have other numbers",
            ),
            (
                weights(&|of| tensor("F32", &[if of == 3 { 9.0 } else { of as f32 }; 100])),
                "weights: model.3.weight of model has other numbers",
            ),
            (
                weights(&|_| ("F16".to_owned(), vec![0; 200])),
                "precision: 12 of 12 tensors of model are F16 in place of F32",
            ),
            (after(edit("modeling_custom.py", "1", "2")), "code: modeling_custom.py has other bytes"),
            (after(|at| fs::write(at.join("hook.py"), "").unwrap()), "code: hook.py was added"),
            (
                after(|at| fs::remove_file(at.join("policy_preprocessor.json")).unwrap()),
                "policy_preprocessor.json is missing",
            ),
            (after(|at| fs::remove_file(at.join("model.safetensors")).unwrap()), "the tensors of model are missing"),
        ] {
            assert!(found.iter().any(|found| found.starts_with(cause)), "{cause}: {found:?}");
        }
    }

    #[test]
    fn server_and_checkpoint_must_not_contradict_each_other() {
        let folder = tempfile::TempDir::new().unwrap();
        write(folder.path());
        let checkpoint = Checkpoint::of(folder.path()).unwrap();
        assert_eq!(
            checkpoint.contradictions(&json!({ "n_action_steps": 50.0, "device": "cpu", "shape": 3, "other": 1 })),
            [""; 0]
        );
        assert_eq!(
            checkpoint.contradictions(&json!({ "policy": { "n_action_steps": 10 } })),
            ["the server declares policy.n_action_steps = 10, and config.json has 50"]
        );
    }

    #[test]
    fn folders_without_a_policy_are_refused() {
        let folder = tempfile::TempDir::new().unwrap();
        fs::write(folder.path().join("README.md"), "nothing").unwrap();
        assert!(Checkpoint::of(folder.path()).unwrap_err().to_string().contains("it has no files of a policy\nHint: "));
        assert!(Checkpoint::of(&folder.path().join("none")).is_err());
        for text in ["", "{}", "[]", r#"{"format":9,"files":{},"tensors":{}}"#] {
            assert!(Checkpoint::from_json(text.as_bytes()).is_err(), "{text}");
        }
    }
}
