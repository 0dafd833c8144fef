//! Robots of MuJoCo Menagerie, by name: `menagerie:NAME`, or `menagerie:NAME/MODEL` for another model of the robot.
//!
//! Its package on PyPI, `mujoco-menagerie`, lists the robots with digests of their files, and keeps the files in a cache of its own. This
//! module asks the package in the user's Python for one robot, copies the files of its model to RoboGate's cache, and drafts
//! `robot.toml` there. From then on it is a robot's folder like every other: runs record its path and the hash of its files, one of
//! which says from which version they are. Nothing is downloaded.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use anyhow::{Context, anyhow, bail};
use serde::{Deserialize, Serialize};

use crate::environments::cache;
use crate::failure::{Failure, OrFailure};
use crate::isolation::this_program;

/// The start of the name of such a robot.
pub(crate) const PREFIX: &str = "menagerie:";
/// The file that says where the files of a robot are from.
const SOURCE: &str = "menagerie.json";
/// Where the robots are, in the cache folder.
const FOLDER: &str = "robots/menagerie";

/// Asks the package for a robot. Modules in the current folder are not imported.
const ASK: &str = r#"
import hashlib, json, sys
sys.path[:] = [path for path in sys.path if path]
try:
    import mujoco_menagerie as mm
except ImportError:
    sys.exit("the Python package mujoco-menagerie is not installed in " + sys.executable
             + "\nHint: " + sys.executable + " -m pip install mujoco-menagerie, or name another Python with --python")
name, model = sys.argv[1:3]
try:
    robot = mm.get(name)
    entry = robot.entry(model or robot.default_model)
except mm.MenagerieError as error:
    sys.exit(str(error) + "\nHint: " + sys.executable + " -m mujoco_menagerie names, or info NAME, list robots and models")
cache = mm.Cache()
if not cache.root and not cache.is_cached(robot):
    sys.exit("the files of " + name + " are not on this machine\nHint: " + sys.executable + " -m mujoco_menagerie prefetch " + name)
try:
    folder = robot.path(progress=None).resolve()
    files = robot.files(entry.name)
    changed = [] if cache.root else cache.verify(robot)
except (mm.MenagerieError, OSError) as error:
    sys.exit(str(error))
if changed:
    sys.exit("files of " + name + " are not those of the package: " + ", ".join(sorted(changed)[:5])
             + "\nHint: " + sys.executable + " -m mujoco_menagerie clear")
files = {str(path.relative_to(folder)) for path in files} | {path.name for path in folder.glob("LICENSE*")}
digest = hashlib.sha256()
for file in sorted(files):
    digest.update(file.encode() + b"\0" + hashlib.sha256((folder / file).read_bytes()).digest())
source = {"robot": name, "model": entry.file, "package": mm.__version__, "checkout": bool(cache.root), "tree": robot.oid,
          "archive_sha256": robot.sha256, "files_sha256": digest.hexdigest(), "license": robot.license}
print(json.dumps({"folder": str(folder), "files": sorted(files), "source": source}))
"#;

/// What the package says about a robot.
#[derive(Debug, Deserialize)]
struct Found {
    folder: PathBuf,
    /// Names of the files of its model, relative to the folder.
    files: Vec<PathBuf>,
    source: Source,
}

/// Where the files of a robot are from.
#[derive(Debug, Serialize, Deserialize)]
struct Source {
    robot: String,
    /// The file of the model.
    model: String,
    /// The version of the package.
    package: String,
    /// Whether the files are those of a checkout (`MENAGERIE_ROOT`), which the package does not compare with its digests.
    checkout: bool,
    /// The identity of the folder in the Menagerie's repository: a git tree.
    tree: String,
    /// SHA-256 of the archive with the files.
    archive_sha256: Option<String>,
    /// SHA-256 of names and contents of the copied files.
    files_sha256: String,
    license: String,
}

/// The folder of a robot of the Menagerie, made on the first use; another robot stays as it is. `python` is the interpreter with the
/// package, by default the active one.
///
/// # Errors
/// If the package or the robot is missing, or its model cannot be drafted.
pub fn resolved(robot: &str, python: Option<&Path>) -> Result<String, Failure> {
    let Some(name) = robot.strip_prefix(PREFIX) else { return Ok(robot.to_owned()) };
    let folder = prepared(name, python).with_context(|| format!("{PREFIX}{name}")).or_request()?;
    Ok(folder.to_string_lossy().into_owned())
}

fn prepared(name: &str, python: Option<&Path>) -> anyhow::Result<PathBuf> {
    let (robot, model) = name.split_once('/').unwrap_or((name, ""));
    let plain = |text: &str| text.chars().all(|c| c.is_ascii_alphanumeric() || "_-.".contains(c));
    if robot.is_empty() || !plain(robot) || !plain(model) || [robot, model].iter().any(|text| text.starts_with('.')) {
        bail!("not a name of a robot. Expected menagerie:NAME or menagerie:NAME/MODEL, such as menagerie:franka_fr3");
    }
    let mut command = Command::new(python.unwrap_or(Path::new("python3")));
    command.args(["-c", ASK, robot, model]).stdin(Stdio::null());
    let answer = output(&mut command)?;
    let Found { folder, files, source } =
        serde_json::from_slice(&answer.stdout).context("cannot read what the package mujoco-menagerie says")?;
    let stem = Path::new(&source.model).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let files_sha256: String = source.files_sha256.chars().filter(char::is_ascii_alphanumeric).take(12).collect();
    // Another version may draft the robot in another way.
    let version = env!("CARGO_PKG_VERSION");
    let place = cache()?.join(FOLDER).join(format!("{robot}-{stem}-{files_sha256}-{version}"));
    if place.join("robot.toml").is_file() {
        return Ok(place);
    }
    // A folder is complete or absent: it gets its name at the end.
    let part = place.with_extension(format!("{}.part", std::process::id()));
    let made = copy(&folder, &files, &part)
        .and_then(|()| fs::write(part.join(SOURCE), serde_json::to_vec_pretty(&source)?).context("cannot write"))
        .and_then(|()| draft(&part, &source))
        .and_then(|()| match fs::rename(&part, &place) {
            // Another process made it.
            Err(_) if place.join("robot.toml").is_file() => Ok(()),
            renamed => renamed.with_context(|| format!("cannot make {}", place.display())),
        });
    if part.exists() {
        fs::remove_dir_all(&part).ok();
    }
    made.map(|()| place)
}

/// Runs a command. Its message on standard error is the error if it fails.
fn output(command: &mut Command) -> anyhow::Result<Output> {
    let program = command.get_program().to_string_lossy().into_owned();
    let output = command.output().with_context(|| format!("cannot start {program}"))?;
    if output.status.success() {
        return Ok(output);
    }
    let why = String::from_utf8_lossy(&output.stderr);
    Err(anyhow!("{}", why.trim().trim_start_matches("error: ")))
}

/// Copies files of a folder with their names.
fn copy(from: &Path, files: &[PathBuf], to: &Path) -> anyhow::Result<()> {
    for name in files {
        let inside = name.components().all(|part| matches!(part, std::path::Component::Normal(_)));
        if !inside {
            bail!("{}: not in the folder of the robot", name.display());
        }
        let target = to.join(name);
        let copied =
            target.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::copy(from.join(name), &target));
        copied.with_context(|| format!("cannot copy {}", from.join(name).display()))?;
    }
    Ok(())
}

/// Drafts `robot.toml` in a process of its own.
fn draft(folder: &Path, source: &Source) -> anyhow::Result<()> {
    let mut command = this_program()?;
    command.args(["robots", "init"]).arg(folder.join(&source.model)).args(["--name", &source.robot]);
    let text = output(command.stdin(Stdio::null())).map(|_| ()).map_err(|why| {
        // The folder of the draft is gone when the message is read.
        anyhow!("{}", why.to_string().replace(&*folder.to_string_lossy(), &source.robot))
    });
    text.context("its model cannot be used")
}
