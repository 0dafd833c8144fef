//! `robogate admit`: the judged policy is admitted, another one is not.

use std::fs;
use std::path::Path;

use tempfile::TempDir;

use crate::harness::{TWO_SCENARIOS, robogate_in, text, verb};

/// A network of the repository.
fn network(name: &str) -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/policies").join(name);
    file.canonicalize().unwrap().to_str().unwrap().to_owned()
}

#[test]
fn judged_policy_is_admitted_and_others_are_not() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("two.toml"), TWO_SCENARIOS).unwrap();
    let requirements =
        "name = \"half\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.2\n";
    fs::write(at.join("half.toml"), requirements).unwrap();
    fs::create_dir(at.join("act")).unwrap();
    fs::write(at.join("act/config.json"), r#"{"n_action_steps": 50, "device": "cuda"}"#).unwrap();
    let (judged, other) = (network("learned.onnx"), network("learned-wide.onnx"));
    for threads in [1, 2] {
        let line = format!(
            "gate --policy {judged} --profile learned --suite two.toml --requirements half.toml --rounds 6 --controls 0 --threads {threads} --checkpoint act --out g{threads}"
        );
        let output = robogate_in(at, &line.split(' ').collect::<Vec<_>>());
        assert!(at.join(format!("g{threads}/fingerprint.msgpack")).is_file(), "{}", text(&output));
    }
    let bytes = |run: &str| fs::read(at.join(run).join("fingerprint.msgpack")).unwrap();
    assert_eq!(bytes("g1"), bytes("g2"), "the choice depends on threads");

    verb(at, &format!("admit g1 --policy {judged} --rate 20"), 0, &["ADMITTED", "64 requests"]);
    let refused = verb(at, &format!("admit g1 --policy {other} --json"), 1, &[]);
    let document: serde_json::Value = serde_json::from_str(&refused).unwrap();
    assert_eq!(document["admitted"], false, "{refused}");
    assert!(!document["differences"].as_array().unwrap().is_empty(), "{refused}");
    verb(
        at,
        &format!("admit g1 --policy {judged} --rate 10"),
        1,
        &["NOT ADMITTED", "the cell runs at 10 Hz in place of 20"],
    );
    let profile = String::from_utf8(robogate_in(at, &["list", "profiles", "learned"]).stdout).unwrap();
    assert!(profile.contains("gripper_open = \"below\"") || profile.contains("gripper_open = \"above\""), "{profile}");
    let turned = profile.replace("\"below\"", "\"?\"").replace("\"above\"", "\"below\"").replace("\"?\"", "\"above\"");
    fs::write(at.join("turned.toml"), turned).unwrap();
    verb(at, &format!("admit g1 --policy {judged} --profile turned.toml"), 1, &["action.gripper_open = \""]);

    // The results are part of a safety case, and only of that of the same fingerprint.
    fs::write(at.join("refused.json"), &refused).unwrap();
    let admitted = verb(at, &format!("admit g1 --policy {judged} --json"), 0, &["\"fingerprint_sha256\""]);
    fs::write(at.join("admitted.json"), &admitted).unwrap();
    for (file, status) in [("admitted.json", "supported"), ("refused.json", "not supported")] {
        let include = format!("admission={file}");
        let output = robogate_in(
            at,
            &["evidence", "g1", file.trim_end_matches(".json"), "--safety-case", "--include", &include],
        );
        let argument = fs::read_to_string(at.join(file.trim_end_matches(".json")).join("safety-case.gsn.yaml"));
        let argument = argument.unwrap_or_else(|_| panic!("{}", text(&output)));
        let deployed = argument.split("G-deployed:\n").nth(1).unwrap();
        assert!(deployed.lines().nth(1).unwrap().ends_with(&format!("\"{status}\"")), "{deployed}");
        verb(at, &format!("verify {}", file.trim_end_matches(".json")), 0, &[]);
    }
    fs::write(
        at.join("foreign.json"),
        admitted.replacen("\"fingerprint_sha256\": \"", "\"fingerprint_sha256\": \"0", 1),
    )
    .unwrap();
    verb(
        at,
        "evidence g1 foreign --include admission=foreign.json",
        4,
        &["about something else: `fingerprint_sha256` is"],
    );

    // The files of the checkpoint, alone and beside the running policy.
    let (same, files) =
        ("admit g1 --checkpoint act", ["has the files of the judged policy", "1 file of the checkpoint"]);
    verb(at, same, 0, &files);
    verb(at, &format!("{same} --policy {judged}"), 0, &["answers as the judged policy", files[1]]);
    fs::write(at.join("act/config.json"), r#"{"n_action_steps": 10, "device": "cpu"}"#).unwrap();
    let cause = "chunk length: config.json has n_action_steps = 10 in place of 50";
    verb(at, same, 1, &["NOT ADMITTED: act", cause]);
    verb(at, &format!("{same} --policy {judged}"), 1, &[cause]);

    // Evidence contains the fingerprint, and one of another gate is not that of this evidence.
    let output = robogate_in(at, &["evidence", "g1", "evidence"]);
    assert!(at.join("evidence/fingerprint.msgpack").is_file(), "{}", text(&output));
    verb(at, &format!("admit evidence --policy {judged}"), 0, &["ADMITTED"]);
    verb(at, "admit evidence --checkpoint act", 1, &[cause]);
    let mut changed = bytes("g1");
    *changed.last_mut().unwrap() ^= 1;
    fs::write(at.join("evidence/fingerprint.msgpack"), changed).unwrap();
    verb(at, &format!("admit evidence --policy {judged}"), 4, &["INVALID", "not the file that the manifest"]);
}

#[test]
fn folders_without_fingerprint_are_refused() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, "run --task pendulum -n 4 --design uniform --out r", 0, &[]);
    verb(at, "admit r --policy ws://127.0.0.1:1", 2, &["no fingerprint.msgpack", "Hint:"]);
    verb(at, "admit r --checkpoint .", 2, &["no checkpoint.json", "gate --checkpoint PATH"]);
    verb(at, "admit r", 2, &["--policy"]);
    fs::write(at.join("text"), "not a fingerprint").unwrap();
    verb(at, "admit text --policy ws://127.0.0.1:1", 2, &["fingerprint"]);
    verb(at, "admit /dev/zero --policy ws://127.0.0.1:1", 2, &["not a file of at most 64 MiB"]);
}

/// A picture of a judged camera, as PNG.
fn png(path: &Path, size: usize) {
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), size as u32, size as u32);
    encoder.set_color(png::ColorType::Rgb);
    let pixels: Vec<u8> = (0..size * size).flat_map(|i| [(i % 251) as u8, 90, (i / size % 256) as u8]).collect();
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
}

#[test]
fn declared_cell_is_compared() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("two.toml"), TWO_SCENARIOS).unwrap();
    fs::write(
        at.join("half.toml"),
        "name = \"half\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.2\n",
    )
    .unwrap();
    let judged = network("learned.onnx");
    let line = format!(
        "gate --policy {judged} --profile learned --suite two.toml --requirements half.toml --rounds 1 --controls 0 --latency fixed:80ms --out g -q"
    );
    robogate_in(at, &line.split(' ').collect::<Vec<_>>());
    verb(at, "admit g --latency 90ms --robot franka", 0, &["ADMITTED: the cell", "is as the judged one"]);
    verb(
        at,
        "admit g --latency 200ms",
        1,
        &["the latency of the cell is 200 ms, 4 control periods", "judged with 80 ms"],
    );
    verb(at, "admit g --latency 0ms", 1, &["0 control periods"]);
    verb(at, "admit g --robot ur5e", 1, &["the robot of the cell is", "in place of"]);
    verb(at, "admit g --robot nobody", 2, &["--robot nobody"]);
    verb(at, "admit g/fingerprint.msgpack --latency 80ms", 2, &["need the folder of the gate"]);

    let profile = String::from_utf8(robogate_in(at, &["list", "profiles", "learned"]).stdout).unwrap();
    let value = |key: &str| {
        let line = profile.lines().find(|line| line.starts_with(&format!("{key} = "))).unwrap();
        line.split(" = ").nth(1).unwrap().trim_matches('"').to_owned()
    };
    let (camera, size) = (value("from"), value("width").parse::<usize>().unwrap());
    png(&at.join("right.png"), size);
    verb(at, &format!("admit g --camera {camera}=right.png"), 0, &["cannot be told"]);
    png(&at.join("small.png"), size / 2);
    let small = format!("{0} x {0} pixels in place of", size / 2);
    verb(at, &format!("admit g --camera {camera}=small.png"), 1, &[small.as_str()]);
    verb(at, "admit g --camera rear=right.png", 1, &["the policy has no camera rear"]);
    fs::write(at.join("text.png"), "no image").unwrap();
    for (place, why) in
        [("text.png", "not a PNG or JPEG image"), ("none.png", "cannot be read"), ("rtsp://x/1", "http or https")]
    {
        verb(at, &format!("admit g --camera {camera}={place}"), 2, &[why]);
    }
    verb(at, "admit g --camera right.png", 2, &["expected NAME=FILE"]);
}
