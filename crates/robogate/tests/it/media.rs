//! Episodes for other programs: MCAP, video, and frames in Markdown. Other implementations read the files.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{TWO_SCENARIOS, robogate_in};

/// Runs the command, which must succeed.
fn done(folder: &Path, arguments: &[&str]) -> String {
    let output = robogate_in(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn run_of(n: &str) -> TempDir {
    let dir = TempDir::new().unwrap();
    done(dir.path(), &["run", "-n", n, "--seed", "7", "--out", "run", "--quiet"]);
    dir
}

#[test]
fn mcap_opens_in_another_reader() {
    let wanted = "a Python with the package mcap (crates/robogate-replay/tests/requirements.txt)";
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", wanted) else { return };
    let dir = run_of("3");
    let said = done(dir.path(), &["replay", "run", "0", "--mcap", "a.mcap", "--size", "64"]);
    assert!(said.contains("identical to the recorded episode"), "{said}");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/media/read_mcap.py");
    let output = Command::new(python).arg(script).arg(dir.path().join("a.mcap")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let file: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(file["undeclared"], json!([]), "the schemas declare all fields");
    let topics = &file["topics"];
    for (topic, schema) in [
        ("/tf", "foxglove.FrameTransforms"),
        ("/scene", "foxglove.SceneUpdate"),
        ("/contacts/arrows", "foxglove.SceneUpdate"),
        ("/contacts", "robogate.Contacts"),
        ("/joint_states", "foxglove.JointStates"),
        ("/joint_commands", "foxglove.JointStates"),
        ("/command", "robogate.Command"),
        ("/observation", "robogate.Observation"),
        ("/measures", "robogate.Measures"),
        ("/log", "foxglove.Log"),
        ("/camera/front", "foxglove.CompressedImage"),
        ("/camera/wrist", "foxglove.CompressedImage"),
    ] {
        assert_eq!(topics[topic]["schema"], schema, "{topic}");
    }
    // One image per observation, one command per control period, and each joint has a state.
    let replay: Value = serde_json::from_str(&done(dir.path(), &["replay", "run", "0", "--json"])).unwrap();
    let ticks = replay["ticks"].as_u64().unwrap();
    assert_eq!(topics["/command"]["messages"], ticks);
    assert_eq!(topics["/camera/front"]["messages"], ticks + 1);
    assert_eq!(topics["/scene"]["messages"], 1);
    let joints = topics["/joint_states"]["first"]["joints"].as_array().unwrap();
    assert_eq!(joints.len(), 7);
    assert!(joints.iter().all(|joint| joint["position"].is_f64() && joint["velocity"].is_number()));
    let frames: Vec<&Value> =
        topics["/tf"]["first"]["transforms"].as_array().unwrap().iter().map(|one| &one["child_frame_id"]).collect();
    let bodies = topics["/scene"]["first"]["entities"].as_array().unwrap();
    assert!(bodies.len() > 5 && bodies.iter().all(|body| frames.contains(&&body["frame_id"])));
    assert_eq!(file["metadata"]["robogate"]["trajectory_hash"], replay["trajectory_hash"]);
    // The same episode gives the same bytes; an existing file is kept.
    done(dir.path(), &["replay", "run", "0", "--mcap", "b.mcap", "--size", "64"]);
    let [a, b] = ["a.mcap", "b.mcap"].map(|name| fs::read(dir.path().join(name)).unwrap());
    assert!(a == b, "the files differ");
    let again = robogate_in(dir.path(), &["replay", "run", "0", "--mcap", "a.mcap"]);
    assert_eq!(again.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&again.stderr).contains("a.mcap: already exists"));
}

#[test]
fn files_that_cannot_be_written_are_no_wrong_usage() {
    let dir = run_of("1");
    for option in ["--gif", "--mcap"] {
        let output = robogate_in(dir.path(), &["replay", "run", "0", option, "no/file", "--size", "16"]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(5), "{option}: {said}");
        assert!(said.contains("cannot write no/file"), "{option}: {said}");
    }
}

#[test]
fn video_has_every_frame() {
    let Some(ffprobe) = robogate_testing::program("ffprobe") else { return };
    let dir = run_of("3");
    // An odd size: the encoder needs an even one.
    done(dir.path(), &["replay", "run", "0", "--mp4", "a.mp4", "--size", "97"]);
    let replay: Value = serde_json::from_str(&done(dir.path(), &["replay", "run", "0", "--json"])).unwrap();
    let output = Command::new(ffprobe)
        .args(["-v", "error", "-count_frames", "-show_entries", "stream=width,height,nb_read_frames,avg_frame_rate"])
        .args(["-of", "json"])
        .arg(dir.path().join("a.mp4"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let streams: Value = serde_json::from_slice(&output.stdout).unwrap();
    let video = &streams["streams"][0];
    assert_eq!((&video["width"], &video["height"]), (&json!(98), &json!(98)));
    assert_eq!(video["nb_read_frames"], json!((replay["ticks"].as_u64().unwrap() + 1).to_string()));
    assert_eq!(video["avg_frame_rate"], "20/1");
}

#[test]
fn missing_ffmpeg_is_explained() {
    let dir = run_of("3");
    let output = Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args(["replay", "run", "0", "--mp4", "a.mp4"])
        .current_dir(dir.path())
        .env("PATH", dir.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("`ffmpeg` is not installed") && said.contains("--gif"), "{said}");
    assert!(!dir.path().join("a.mp4").exists());
}

/// The images of a Markdown file: alternative text and path.
fn images(text: &str) -> Vec<(&str, &str)> {
    text.lines().filter_map(|line| line.trim().strip_prefix("![")?.strip_suffix(')')?.split_once("](")).collect()
}

#[test]
fn markdown_shows_frames() {
    let dir = run_of("12");
    done(dir.path(), &["report", "run", "--format", "md", "--out", "the page.md"]);
    fs::write(dir.path().join("two.toml"), TWO_SCENARIOS).unwrap();
    let requirements = "name = \"half\"\nmode = \"point\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.5\n";
    fs::write(dir.path().join("half.toml"), requirements).unwrap();
    let gate = "gate --suite two.toml --requirements half.toml --rounds 2 --out gate --quiet";
    let judged = robogate_in(dir.path(), &gate.split(' ').collect::<Vec<_>>());
    assert!([Some(0), Some(1)].contains(&judged.status.code()), "{}", String::from_utf8_lossy(&judged.stderr));
    for page in ["the page.md", "gate/gate.md"] {
        let path = dir.path().join(page);
        let text = fs::read_to_string(&path).unwrap();
        let images = images(&text);
        assert!(!images.is_empty(), "{page} has no image");
        for (alt, link) in images {
            assert!(alt.starts_with("Episode ") && alt.contains("4 frames from 0.00 s"), "{alt}");
            let file = path.with_file_name("").join(link.replace("%20", " "));
            assert!(fs::read(&file).unwrap().starts_with(b"\x89PNG"), "{}", file.display());
        }
    }
    // Markdown on stdout has no place for images.
    assert!(!done(dir.path(), &["report", "run", "--format", "md", "--out", "-"]).contains("!["));
}

#[test]
fn quiet_runs_print_results_only() {
    let dir = TempDir::new().unwrap();
    let output = robogate_in(dir.path(), &["run", "-n", "3", "--seed", "7", "--out", "run", "--quiet"]);
    assert!(output.status.success());
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("success ") && !text.contains('\x1b') && !text.contains('\r'), "{text}");
    // Without a terminal, the progress of a run has neither colours nor cursor movements.
    let output = robogate_in(dir.path(), &["run", "-n", "3", "--seed", "7", "--out", "again"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("uniform  1/1") && !said.contains('\x1b') && !said.contains('\r'), "{said}");
}
