//! What a name or a path is, from its form and its first bytes. Nothing is started or loaded for it.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use anyhow::{anyhow, bail};
use robogate_campaign::folder::PLAN;
use robogate_gate::evidence::MANIFEST;
use robogate_physics::built_in_robots;

use crate::environment_choice::file_and_attribute;
use crate::environments::BUNDLED;
use crate::text::foreign;

/// Something that a user starts with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Thing {
    /// An environment, as `--env` takes it.
    Environment(String),
    /// A policy server, or a policy that the process of an environment loads, as `--policy` takes it.
    Policy(String),
    /// A network in an ONNX file.
    Network(PathBuf),
    /// A robot: the name of a built-in one, or a folder with `robot.toml`.
    Robot(String),
    /// The model of a robot, without `robot.toml`.
    Model(PathBuf),
    /// Results of another tool.
    Results(PathBuf),
    /// The folder of a run.
    Run(PathBuf),
    /// A folder of evidence.
    Evidence(PathBuf),
}

/// What is expected, for the hint of an error.
const EXPECTED: &str = "Expected an environment (FILE.py, FAMILY:NAME or gymnasium:ID), a policy (FILE.onnx, the folder of a LeRobot \
                        checkpoint, sb3:FILE.zip, or the address of a server), a robot (URDF or MJCF), results (CSV, JSON, JSON Lines or \
                        Parquet), a run or evidence";
/// How much of a file is read to recognise it, in bytes.
const HEAD: u64 = 4096;

impl Thing {
    /// Recognises a name or a path.
    ///
    /// # Errors
    /// A path that does not exist, or that is none of these.
    pub fn of(named: &str) -> anyhow::Result<Self> {
        let path = Path::new(named);
        if named.contains("://")
            || named
                .strip_prefix("lerobot:")
                .and_then(|rest| rest.split('?').next())
                .is_some_and(|rest| Path::new(rest).is_dir())
            || named.starts_with("sb3:")
        {
            return Ok(Self::Policy(named.to_owned()));
        }
        if file_and_attribute(named).is_some_and(|(file, _)| Path::new(file).is_file()) {
            return Ok(Self::Environment(named.to_owned()));
        }
        if path.is_dir() {
            return Self::of_folder(named, path);
        }
        if path.is_file() {
            return Self::of_file(path);
        }
        let family = named.split_once(':').map(|(family, _)| family);
        if family
            .is_some_and(|family| BUNDLED.contains(&family) || family == "gymnasium" || !family.contains(['/', '.']))
        {
            return Ok(Self::Environment(named.to_owned()));
        }
        if built_in_robots().any(|robot| robot == named) {
            return Ok(Self::Robot(named.to_owned()));
        }
        bail!("{}: no such file or folder, and not the name of an environment\nHint: {EXPECTED}", foreign(named))
    }

    fn of_folder(named: &str, path: &Path) -> anyhow::Result<Self> {
        let has = |name: &str| path.join(name).is_file();
        if has(MANIFEST) {
            return Ok(Self::Evidence(path.to_owned()));
        }
        if has(PLAN) || has("dictionary.parquet") {
            return Ok(Self::Run(path.to_owned()));
        }
        if has("robot.toml") {
            return Ok(Self::Robot(named.to_owned()));
        }
        if has("config.json") && has("model.safetensors")
            || path.join("pretrained_model").is_dir()
            || path.join("checkpoints").is_dir()
        {
            return Ok(Self::Policy(format!("lerobot:{named}")));
        }
        let models = files(path).into_iter().filter(|file| robot_model(file));
        match &models.collect::<Vec<_>>()[..] {
            [one] => Ok(Self::Model(one.clone())),
            [] => bail!("{}: nothing in this folder is recognised\nHint: {EXPECTED}", foreign(named)),
            several => {
                let names: Vec<String> = several.iter().map(|model| foreign(model.display())).collect();
                Err(anyhow!("{}: several models of robots\nHint: name one of {}", foreign(named), names.join(", ")))
            }
        }
    }

    fn of_file(path: &Path) -> anyhow::Result<Self> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
        match &*ending {
            "onnx" => Ok(Self::Network(path.to_owned())),
            "zip" => Ok(Self::Policy(format!("sb3:{}", path.display()))),
            "csv" | "tsv" | "json" | "jsonl" | "parquet" => Ok(Self::Results(path.to_owned())),
            _ if robot_model(path) => Ok(Self::Model(path.to_owned())),
            _ => bail!("{}: this kind of file is not recognised\nHint: {EXPECTED}", foreign(path.display())),
        }
    }

    /// The things in a folder that their names and first bytes show, as a user would name them.
    pub fn in_folder(folder: &Path) -> Vec<String> {
        let named = |file: PathBuf| file.strip_prefix(folder).unwrap_or(&file).display().to_string();
        let shown = |file: &PathBuf| match file.extension().and_then(|ending| ending.to_str()) {
            Some("py") => head(file).contains("gym"),
            Some("onnx" | "csv" | "jsonl") => true,
            _ => robot_model(file),
        };
        files(folder).into_iter().filter(shown).map(named).collect()
    }
}

/// The files of a folder, by name.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(|path| path.is_file()).collect();
    files.sort();
    files
}

/// The start of a file as text.
fn head(path: &Path) -> String {
    let mut bytes = Vec::new();
    let _ = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut bytes));
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Whether a file is the model of a robot: URDF, or MJCF.
fn robot_model(path: &Path) -> bool {
    let xml = path.extension().is_some_and(|ending| ending == "urdf" || ending == "xml" || ending == "mjcf");
    xml && ["<robot", "<mujoco"].iter().any(|root| head(path).contains(root))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_are_recognised_by_form_and_content() {
        let dir = tempfile::TempDir::new().unwrap();
        let at = |name: &str| dir.path().join(name).display().to_string();
        let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
        for folder in ["evidence", "robot", "act", "arm"] {
            std::fs::create_dir(at(folder)).unwrap();
        }
        for (name, text) in [
            ("env.py", "import gymnasium"),
            ("policy.onnx", ""),
            ("rows.csv", "success\n1\n"),
            ("notes.txt", ""),
            ("evidence/manifest.json", "{}"),
            ("robot/robot.toml", ""),
            ("act/config.json", "{}"),
            ("act/model.safetensors", ""),
            ("arm/arm.urdf", "<?xml version=\"1.0\"?>\n<robot name=\"arm\">"),
            ("arm/other.xml", "<launch/>"),
        ] {
            write(name, text);
        }
        let of = |name: &str| Thing::of(&at(name)).unwrap();
        assert_eq!(of("env.py:Env"), Thing::Environment(at("env.py:Env")));
        assert_eq!(of("policy.onnx"), Thing::Network(at("policy.onnx").into()));
        assert_eq!(of("rows.csv"), Thing::Results(at("rows.csv").into()));
        assert_eq!(of("evidence"), Thing::Evidence(at("evidence").into()));
        assert_eq!(of("robot"), Thing::Robot(at("robot")));
        assert_eq!(of("act"), Thing::Policy(format!("lerobot:{}", at("act"))));
        assert_eq!(of("arm"), Thing::Model(at("arm/arm.urdf").into()));
        assert_eq!(Thing::of("ws://host:8000").unwrap(), Thing::Policy("ws://host:8000".to_owned()));
        assert_eq!(Thing::of("metaworld:push-v3").unwrap(), Thing::Environment("metaworld:push-v3".to_owned()));
        assert_eq!(Thing::of("ur5e").unwrap(), Thing::Robot("ur5e".to_owned()));
        for (wrong, part) in [("notes.txt", "not recognised"), ("none", "no such file")] {
            let error = format!("{:#}", Thing::of(&at(wrong)).unwrap_err());
            assert!(error.contains(part) && error.contains("Hint: Expected an environment"), "{error}");
        }
        assert_eq!(Thing::in_folder(dir.path()), ["env.py", "policy.onnx", "rows.csv"]);
    }
}
