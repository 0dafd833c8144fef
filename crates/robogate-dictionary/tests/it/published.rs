//! Tests of import from and export to the published JSON.

use std::fs;
use std::path::{Path, PathBuf};

use robogate_core::{Domain, Episode, Outcome};
use robogate_dictionary::published::{export, import};
use robogate_dictionary::{Dictionary, DictionaryError, RowPlace, write_parquet};

use crate::common::{Folder, entry_of, pick_place, provenance_of};

fn imported(folder: &Folder, json: &str) -> Result<Dictionary, DictionaryError> {
    let (from, to) = (folder.join("published.json"), folder.join("imported.parquet"));
    let _ = fs::remove_file(&to);
    fs::write(&from, json).unwrap();
    let result = import(&from, &to);
    assert_eq!(to.exists(), result.is_ok(), "no file is written if a row is invalid");
    result.map(|_| Dictionary::open(&to).unwrap())
}

const FRANKA: &str = r#"{
    "friction": 0.3, "mass": 1, "com_offset": 0.1, "size": 0.05, "ik_noise": 0.01, "obstacles": 2, "shape": "L_shape",
    "placement": "edge_45", "success": false, "failure_type": "grip_loss", "cycle_time": 3.5, "collision": false,
    "drop": true, "grasp_miss": false, "zone": "danger", "fail_prob": 0.9, "sample_idx": 0}"#;

fn file(rows: &[String]) -> String {
    format!("{{\"metadata\": {{\"seed\": 2026}}, \"summary\": {{}}, \"experiments\": [{}]}}", rows.join(","))
}

fn shared_data() -> Option<PathBuf> {
    robogate_testing::path("ROBOGATE_SHARED_DATA", "the folder of the released data")
}

#[test]
fn released_ur5e_file_is_imported() {
    let Some(data) = shared_data() else { return };
    let folder = Folder::new("ur5e");
    let to = folder.join("ur5e.parquet");
    let done = import(&data.join("published/ur5e_failure_dictionary.json"), &to).unwrap();
    assert_eq!(done.written.rows, 10_000);
    let dictionary = Dictionary::open(&to).unwrap();
    let provenance = dictionary.provenance();
    assert_eq!(provenance.seed, 2026);
    assert_eq!(provenance.source.as_ref().unwrap().format, "published_json");
    let names: Vec<&str> = provenance.space.parameters().iter().map(|p| &*p.name).collect();
    assert_eq!(names, ["ik_noise_rad", "mass_kg", "grip_threshold_m", "obstacles", "placement"]);
    let domain = |name: &str| &provenance.space.parameters()[provenance.space.position(name).unwrap()].domain;
    // This differs from the paper's description: 0..3 obstacles, 8 placements.
    assert_eq!(*domain("obstacles"), Domain::Integer { low: 0, high: 4 });
    assert_eq!(domain("placement").levels(), Some(14));

    let (mut successes, mut misses) = (0, 0);
    let mut bins = [(0_u32, 0_u32); 10];
    let mass = dictionary.numbers("mass_kg").unwrap();
    let low = mass.iter().flatten().copied().fold(f64::INFINITY, f64::min);
    let high = mass.iter().flatten().copied().fold(0.0, f64::max);
    for found in dictionary.entries() {
        let found = found.unwrap();
        assert!(found.episode.applied.is_empty());
        let success = found.episode.outcome == Outcome::Success;
        match found.episode.outcome.as_str() {
            "success" => successes += 1,
            "grasp_miss" => misses += 1,
            other => panic!("{other}"),
        }
        let mass = found.episode.scenario.requested.number("mass_kg").unwrap();
        let bin = ((mass - low) / (high - low) * 10.0) as usize;
        let (hit, all) = &mut bins[bin.min(9)];
        *hit += u32::from(success);
        *all += 1;
    }
    assert_eq!((successes, misses), (7432, 2568));
    // Ten equal bins over the observed range. The fourth to seventh span 0.935 to 2.114 kg.
    let edge = |i: u32| low + f64::from(i) * (high - low) / 10.0;
    let edges: Vec<String> = (3..8).map(|i| format!("{:.3}", edge(i))).collect();
    assert_eq!(edges, ["0.935", "1.230", "1.524", "1.819", "2.114"]);
    let rates: Vec<String> =
        bins[3..7].iter().map(|(hit, all)| format!("{:.1}", 100.0 * f64::from(*hit) / f64::from(*all))).collect();
    assert_eq!(rates, ["30.9", "25.3", "28.9", "28.1"]);
}

/// Episodes keep their hash from one version to the next: this one is that of RoboGate 0.1.
#[test]
fn imported_rows_keep_their_hash() {
    let folder = Folder::new("published-hash");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/published.json");
    let imported = import(&file, &folder.join("d.parquet")).unwrap();
    assert_eq!(imported.written.rows, 20);
    assert_eq!(imported.written.dataset_hash, "0dd9260c2a0db6e5e6cb57e44ea4bae96c39b804b81bf405f44e98e387b3e770");
}

#[test]
fn units_are_added_and_removed() {
    let folder = Folder::new("units");
    let there = ["grip_threshold", "approach_speed", "position_jitter", "gravity_scale", "table_friction"];
    let here = ["grip_threshold_m", "approach_speed_m_s", "position_jitter_m", "gravity_scale", "table_friction"];
    let row = |i: u32| {
        let fields: String = there.iter().map(|name| format!("\"{name}\": 0.{}, ", i + 1)).collect();
        format!("{{{fields}\"success\": true, \"failure_type\": \"none\", \"cycle_time\": 1.0, \"sample_idx\": {i}}}")
    };
    let dictionary = imported(&folder, &file(&[row(0), row(1)])).unwrap();
    for name in here {
        assert!(dictionary.provenance().space.position(name).is_some(), "{name}");
    }
    let mut out = Vec::new();
    export(&dictionary, &mut out).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&out).unwrap();
    for name in there {
        assert_eq!(json["experiments"][1][name], 0.2, "{name}");
    }
}

#[test]
fn analytic_fields_are_left_out() {
    let folder = Folder::new("franka");
    let second = FRANKA.replace("\"sample_idx\": 0", "\"sample_idx\": 7").replace("0.3", "0.4");
    let dictionary = imported(&folder, &file(&[FRANKA.to_owned(), second])).unwrap();
    let entries: Vec<_> = dictionary.entries().map(Result::unwrap).collect();
    assert_eq!(entries[1].index(), 7);
    let requested = &entries[0].episode.scenario.requested;
    assert_eq!(requested.len(), 8);
    assert_eq!(requested.number("mass_kg"), Some(1.0));
    assert_eq!(requested.category("shape"), Some("L_shape"));
    assert_eq!(entries[0].episode.outcome.as_str(), "grip_loss");
    assert_eq!(entries[0].weight.to_bits(), 1.0_f64.to_bits());
    let notes = &dictionary.provenance().source.as_ref().unwrap().notes;
    assert!(notes.iter().any(|note| note.contains("zone")) && notes.iter().any(|note| note.contains("fail_prob")));
}

#[test]
fn export_is_imported_again() {
    let folder = Folder::new("round-trip");
    let path = folder.join("d.parquet");
    let task = pick_place();
    write_parquet(&path, &provenance_of(pick_place()), (0..500).map(|i| Ok(entry_of(&task, 2 * i)))).unwrap();
    let original = Dictionary::open(&path).unwrap();
    let mut json = Vec::new();
    let rows = export(&original, &mut json).unwrap();
    let json = String::from_utf8(json).unwrap();
    let valid: Vec<_> = original
        .entries()
        .map(Result::unwrap)
        .filter(|entry| !matches!(entry.episode.outcome, Outcome::Invalid(_)))
        .collect();
    assert_eq!(rows as usize, valid.len());
    let parsed: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(parsed["summary"]["total"], rows);
    assert_eq!(parsed["metadata"]["fields_left_out"], serde_json::json!(["zone", "fail_prob"]));
    let row = parsed["experiments"][0].as_object().unwrap();
    for field in ["friction", "mass", "obstacles", "shape", "success", "failure_type", "cycle_time", "collision"] {
        assert!(row.contains_key(field), "{field}");
    }
    assert!(!row.contains_key("zone") && !row.contains_key("mass_kg"));
    let again = imported(&folder, &json).unwrap();
    assert_eq!(again.len(), rows);
    for (before, after) in valid.iter().zip(again.entries()) {
        let (before, after) = (&before.episode, after.unwrap().episode);
        assert_eq!(before.scenario, after.scenario);
        assert_eq!(before.outcome, after.outcome);
        assert_eq!(before.time_s.to_bits(), after.time_s.to_bits());
        let distance = |episode: &Episode| episode.measures.get("target_distance_m").map(f64::to_bits);
        assert_eq!(distance(before), distance(&after));
    }
}

#[test]
fn contradicting_rows_are_named() {
    let folder = Folder::new("contradict");
    let contradictions = [
        ("\"success\": false", "\"success\": true", "failure_type"),
        ("\"grip_loss\"", "\"none\"", "failure_type"),
        ("\"grip_loss\"", "\"fell down\"", "failure_type"),
        ("\"success\": false", "\"success\": 0", "success"),
        ("\"drop\": true", "\"drop\": false", "drop"),
        ("\"drop\": true", "\"drop\": \"yes\"", "drop"),
        ("\"cycle_time\": 3.5", "\"cycle_time\": -3.5", "cycle_time"),
        ("\"cycle_time\": 3.5", "\"cycle_time\": null", "cycle_time"),
        ("\"cycle_time\": 3.5", "\"dist_to_target\": 3.5", "cycle_time"),
        ("\"mass\": 1,", "", "mass"),
        ("\"mass\": 1", "\"mass\": null", "mass"),
        ("\"mass\": 1", "\"mass\": \"heavy\"", "mass"),
        ("\"shape\": \"L_shape\"", "\"shape\": 4", "shape"),
    ];
    for (old, new, at) in contradictions {
        assert!(FRANKA.contains(old));
        let rows: Vec<String> =
            (0..5).map(|i| if i == 3 { FRANKA.replace(old, new) } else { FRANKA.to_owned() }).collect();
        let error = imported(&folder, &file(&rows)).unwrap_err();
        let DictionaryError::Value { place, column, .. } = &error else { panic!("{error}") };
        assert_eq!((*place, column.as_str()), (RowPlace::Row(3), at), "{error}");
    }
}

#[test]
fn contradicting_totals_are_rejected() {
    let folder = Folder::new("whole");
    for (wrong, says) in [
        ("{\"metadata\": {\"total_experiments\": 2}, \"experiments\": [ROW]}", "total_experiments"),
        ("{\"experiments\": [ROW], \"summary\": {\"success_count\": 1}}", "success_count"),
        ("{\"experiments\": [ROW], \"summary\": {\"failure_types\": {\"timeout\": 1}}}", "timeout"),
        ("{\"experiments\": []}", "empty"),
        ("{\"metadata\": {}, \"analysis\": {}}", "experiments"),
        ("{\"experiments\": [ROW], \"experiments\": [ROW]}", "twice"),
        ("{\"experiments\": [ROW, 3]}", "row 1"),
        ("{\"experiments\": [ROW", "line"),
        ("{\"experiments\": [ROW]} more", "line"),
        ("[ROW]", "experiments"),
        ("", "line"),
    ] {
        let error = imported(&folder, &wrong.replace("ROW", FRANKA)).unwrap_err().to_string();
        assert!(error.contains(says) && error.contains("published.json"), "{says}: {error}");
    }
}

#[test]
fn unknown_fields_become_parameters() {
    let folder = Folder::new("unknown");
    let row = |i: i32| {
        FRANKA.replace(
            "\"sample_idx\": 0",
            &format!(
                "\"sample_idx\": {}, \"gravity_scale\": 1.0, \"lamp\": \"on\", \"weight\": {i}, \"camera\": [1, 2],
                 \"ok\": true, \"a b\": 1",
                5 - i
            ),
        )
    };
    let dictionary = imported(&folder, &file(&[row(0), row(1)])).unwrap();
    let entries: Vec<_> = dictionary.entries().map(Result::unwrap).collect();
    let requested = &entries[1].episode.scenario.requested;
    assert_eq!(requested.number("gravity_scale"), Some(1.0));
    assert_eq!(requested.category("lamp"), Some("on"));
    assert_eq!(requested.number("published_weight"), Some(1.0));
    assert_eq!(entries[1].index(), 1, "decreasing sample numbers are not used as indices");
    let notes = dictionary.provenance().source.as_ref().unwrap().notes.join("\n");
    for field in ["`camera`", "`ok`", "`a b`", "`weight`", "`sample_idx`"] {
        assert!(notes.contains(field), "{notes}");
    }
    let mut json = Vec::new();
    export(&dictionary, &mut json).unwrap();
    assert!(String::from_utf8(json).unwrap().contains("\"weight\":1"));
}

#[test]
fn same_file_gives_same_bytes() {
    let folder = Folder::new("import-twice");
    let from = folder.join("p.json");
    fs::write(&from, file(&[FRANKA.to_owned()])).unwrap();
    let bytes = |to: &Path| {
        import(&from, to).unwrap();
        fs::read(to).unwrap()
    };
    assert!(bytes(&folder.join("a")) == bytes(&folder.join("b")));
}
