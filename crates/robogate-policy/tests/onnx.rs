//! Networks in ONNX files, compared with ONNX Runtime (networks/networks.py).

mod support;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use robogate_core::{Action, Command, Policy};
use robogate_policy::{ExternalPolicy, PolicyError, Profile};
use support::{begin, observation};

const SMALL: &str = include_str!("networks/small.toml");

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/networks").join(name)
}

fn load(path: &Path, profile: &str) -> Result<ExternalPolicy, PolicyError> {
    let profile = Profile::from_toml(profile).expect("a good profile");
    ExternalPolicy::connect(&path.display().to_string(), Arc::new(profile))
}

/// The error of loading a network or of its first inference.
fn error_of(path: &Path, profile: &str) -> String {
    let error = load(path, profile).err().or_else(|| {
        let mut policy = load(path, profile).ok()?;
        policy.begin("pick up the box").ok()?;
        policy.infer(&observation(96)).err()
    });
    error.expect("it must be refused").to_string()
}

fn expected(name: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(file("expected.json")).expect("it lies there");
    let mut all: serde_json::Value = serde_json::from_str(&text).expect("it is JSON");
    serde_json::from_value(all[name].take()).expect("rows of numbers")
}

fn agrees_with_onnx_runtime(path: &Path, profile: &str, name: &str) {
    let mut policy = load(path, profile).expect("it loads");
    policy.begin("pick up the box").expect("nothing to begin");
    let chunk = policy.infer(&observation(96)).expect("it answers");
    let expected = expected(name);
    assert_eq!(chunk.rows().len(), expected.len());
    for (ours, theirs) in chunk.rows().iter().zip(&expected) {
        assert_eq!(ours.len(), theirs.len());
        for (ours, theirs) in ours.iter().zip(theirs) {
            assert!((ours - theirs).abs() < 1e-5 * theirs.abs().max(1.0), "{ours} {theirs}");
        }
    }
}

#[test]
fn a_small_network_agrees_with_onnx_runtime() {
    agrees_with_onnx_runtime(&file("small.onnx"), SMALL, "small");
}

#[test]
fn shipped_networks_agree_with_onnx_runtime() {
    let learned = Profile::built_in("learned").expect("it is there");
    let policies = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/policies");
    for name in ["learned", "learned-wide"] {
        agrees_with_onnx_runtime(&policies.join(format!("{name}.onnx")), learned, name);
    }
}

#[test]
fn chunks_become_joint_positions() {
    let mut policy = load(&file("small.onnx"), SMALL).expect("it loads");
    begin(&mut policy, "pick up the box").expect("nothing to begin");
    let rows = expected("small");
    for tick in 0..4 {
        assert_eq!(policy.wants_images(), tick % 2 == 0);
        let action = policy.act(&observation(96)).expect("it answers");
        let Command::JointPosition(joints) = action.command else { panic!("{:?}", action.command) };
        let row = &rows[tick % 2];
        assert!(joints.iter().zip(row).all(|(q, expected)| (q - expected).abs() < 1e-5), "{joints:?}");
        assert_eq!(action.gripper == Some(Action::OPEN), row[7] > 0.0);
    }
}

#[test]
fn the_file_is_identified_by_its_hash() {
    let policy = load(&file("small.onnx"), SMALL).expect("it loads");
    let declared = policy.declared().to_string();
    assert!(declared.contains("\"sha256\":\"") && declared.contains("\"front\""), "{declared}");
}

#[test]
fn mismatches_with_the_profile_are_errors() {
    let small = file("small.onnx");
    for (from, to, part) in [
        (
            "key = \"front\"",
            "key = \"above\"",
            "the profile sends `above`, but the inputs of the network are front, state",
        ),
        (
            "width = 8\nheight = 8",
            "width = 16\nheight = 16",
            "`front` with shape [16, 16, 3], but the network takes [1, 8, 8, 3]",
        ),
        (", \"gripper_opening\"]", "]", "`state` with shape [7], but the network takes [1, 8]"),
        (
            "size = 8\narm = \"joint_positions\"",
            "size = 7\narm = \"tool_delta\"\nrotation = \"axis_angle\"",
            "8 numbers",
        ),
        ("length = 2\nexecute = 2", "length = 5\nexecute = 2", "5"),
    ] {
        let profile = SMALL.replace(from, to);
        assert_ne!(profile, SMALL, "{from}");
        let why = error_of(&small, &profile);
        assert!(why.contains(part), "expected {part:?} in {why:?}");
    }
}

#[test]
fn an_open_batch_size_becomes_one() {
    agrees_with_onnx_runtime(&file("batch.onnx"), SMALL, "small");
}

#[test]
fn other_open_sizes_are_errors() {
    let why = error_of(&file("open.onnx"), SMALL);
    assert!(why.contains("the input `state` has no fixed size"), "{why}");
}

#[test]
fn the_wrong_kind_of_address_is_explained() {
    let why = error_of(Path::new("ws://127.0.0.1:1"), SMALL);
    assert!(why.contains("has the dialect onnx and takes a file. Expected FILE.onnx"), "{why}");
    let pi0 = Profile::built_in("pi0-libero").expect("it is there");
    let why = error_of(&file("small.onnx"), pi0);
    assert!(
        why.contains(
            "profile pi0-libero has the dialect openpi and takes the address of a server. Expected ws://HOST:PORT. Hint"
        ),
        "{why}"
    );
    let why = error_of(Path::new("nowhere.onnx"), SMALL);
    assert!(why.contains("nowhere.onnx") && why.contains("cannot be read"), "{why}");
    for (path, part) in [("small.toml", "it is a text file"), ("../networks", "it is a folder")] {
        let why = error_of(&file(path), SMALL);
        assert!(why.starts_with("invalid policy file: ") && why.contains(part), "{why}");
    }
}

#[test]
fn corrupted_files_never_panic() {
    let good = std::fs::read(file("small.onnx")).expect("it lies there");
    let folder = std::env::temp_dir().join(format!("robogate-networks-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("room for a file");
    let path = folder.join("bad.onnx");
    let mut refused = 0;
    for i in 0..good.len() {
        let mut bad = good.clone();
        if i % 3 == 0 {
            bad.truncate(i);
        } else {
            bad[i] ^= 1 << (i % 8);
        }
        std::fs::write(&path, bad).expect("room for a file");
        match load(&path, SMALL) {
            Err(_) => refused += 1,
            Ok(mut policy) => drop(policy.infer(&observation(96))),
        }
    }
    std::fs::remove_dir_all(&folder).expect("it is ours");
    assert!(refused > good.len() / 3, "{refused} of {}", good.len());
}
