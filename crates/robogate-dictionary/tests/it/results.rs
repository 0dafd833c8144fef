//! Tests of imports from other tools, with files in the layouts of those tools.

use std::fs;
use std::path::{Path, PathBuf};

use robogate_core::{Fault, FaultKind, Outcome, Value};
use robogate_dictionary::results::{Format, Mapping, import, policies};
use robogate_dictionary::{Dictionary, Entry, Label, Provenance, RowSampling, Source, Stopping, write_parquet};

use crate::common::{Folder, entry, provenance};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/results").join(name)
}

fn imported(from: &Path, format: Option<Format>, mapping: &Mapping) -> (Provenance, Vec<Entry>) {
    let folder = Folder::new(&format!("results-{:?}", std::thread::current().id()));
    let to = folder.join("d.parquet");
    let imported = import(from, &to, format, mapping).unwrap();
    let dictionary = Dictionary::open(&to).unwrap();
    assert_eq!(imported.provenance, *dictionary.provenance());
    (imported.provenance, dictionary.entries().collect::<Result<_, _>>().unwrap())
}

fn refused(name: &str, content: impl AsRef<[u8]>, mapping: &Mapping) -> String {
    let folder = Folder::new(&format!("results-refused-{name}"));
    let (from, to) = (folder.join(name), folder.join("d.parquet"));
    fs::write(&from, content).unwrap();
    let error = import(&from, &to, None, mapping).unwrap_err().to_string();
    assert!(!to.exists(), "no file is written on error: {error}");
    error
}

fn words(entries: &[Entry]) -> Vec<&str> {
    entries.iter().map(|entry| entry.episode.outcome.as_str()).collect()
}

fn source(provenance: &Provenance) -> &Source {
    provenance.source.as_ref().unwrap()
}

#[test]
fn lerobot_keeps_success_and_seed() {
    let (provenance, entries) = imported(&fixture("lerobot_one_environment.json"), None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "unknown", "success", "success"]);
    let seeds: Vec<_> = entries.iter().map(|e| e.episode.scenario.requested.get("source_seed").cloned()).collect();
    assert_eq!(seeds, [1000, 1001, 1002, 1003].map(|n| Some(Value::Integer(n))));
    assert!(entries.iter().all(|entry| entry.episode.time_s.is_nan()));
    assert_eq!(source(&provenance).format, "lerobot");
    assert_eq!(source(&provenance).not_recorded, ["collision", "grasp_miss", "grip_loss", "cycle_time_s"]);
    assert_eq!(provenance.robot.sha256, None);
    assert_eq!(provenance.plan["source_metadata"]["pc_success"], 75.0);
}

#[test]
fn lerobot_tasks_become_cases() {
    let (provenance, entries) = imported(&fixture("lerobot_tasks.json"), None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "unknown", "success", "success", "success"]);
    assert_eq!(provenance.plan["source_metadata"]["n_episodes"], 5);
    let label = |case: &str, category: &str| Label {
        case: Some(case.to_owned()),
        category: Some(category.to_owned()),
        group: None,
    };
    assert_eq!(entries[2].label, label("libero_spatial/0", "libero_spatial"));
    assert_eq!(entries[3].label, label("libero_object/3", "libero_object"));
}

#[test]
fn contradicting_averages_are_rejected() {
    let text = fs::read_to_string(fixture("lerobot_one_environment.json")).unwrap();
    let error = refused("edited.json", text.replace("75.0", "100.0"), &Mapping::default());
    assert!(error.contains("`pc_success` is 100") && error.contains("3 successes in 4 episodes"), "{error}");
    let text = fs::read_to_string(fixture("lerobot_tasks.json")).unwrap();
    let error = refused("cut.json", text.replace("[true, true]", "[true]"), &Mapping::default());
    assert!(error.contains("`overall.n_episodes` is 5, but it has 4 episodes"), "{error}");
}

#[test]
fn crashed_vla_eval_episode_is_invalid() {
    let (provenance, entries) = imported(&fixture("vla_eval.json"), None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "unknown", "invalid", "success", "invalid"]);
    let fault = |at: usize| match &entries[at].episode.outcome {
        Outcome::Invalid(fault) => fault.clone(),
        other => panic!("{other:?}"),
    };
    assert_eq!(entries[4].label.case.as_deref(), Some("close the drawer"));
    assert_eq!(entries[4].label.category.as_deref(), Some("drawers"));
    let away = Fault::new(FaultKind::Unavailable, "connection_closed: the model server went away");
    assert_eq!(fault(2), away);
    assert_eq!(fault(4), Fault::new(FaultKind::Setup, "env_start"));
    assert_eq!((provenance.policy.as_str(), provenance.engine.name.as_str()), ("OpenVLA", "Drawer_demo"));
    assert_eq!(provenance.seed, 7);
    assert!(source(&provenance).not_recorded.contains(&"collision".to_owned()));
}

#[test]
fn mapping_names_the_columns() {
    let text = fs::read_to_string(fixture("table.toml")).unwrap();
    let mapping = Mapping::from_toml(&text, "table.toml").unwrap();
    let (provenance, entries) = imported(&fixture("table.csv"), None, &mapping);
    // The last row reports success together with a collision.
    assert_eq!(words(&entries), ["success", "grip_loss", "collision", "invalid", "collision"]);
    assert!(
        source(&provenance)
            .notes
            .iter()
            .any(|n| n.starts_with("Episodes with success and the flag of a failure mode: 1."))
    );
    assert_eq!(entries[2].episode.time_s, 3.125);
    assert_eq!(entries[1].episode.scenario.requested.number("mass_kg"), Some(1.1));
    assert_eq!(entries[1].episode.scenario.requested.category("surface"), Some("rubber"));
    assert_eq!((provenance.policy.as_str(), provenance.robot.name.as_str()), ("act-v3", "UR5e"));
    assert!(source(&provenance).not_recorded.is_empty(), "{:?}", source(&provenance).not_recorded);
}

#[test]
fn pairs_equal_a_mapping_file() {
    let mut pairs = Mapping::default();
    pairs.add("success=ok,failure_mode=how,cycle_time_s=duration", "--map").unwrap();
    pairs.add("flag.collision=bump,error=broke,parameter.mass_kg=mass,parameter.surface=surface", "--map").unwrap();
    let text = fs::read_to_string(fixture("table.toml")).unwrap();
    let file = Mapping::from_toml(&text, "table.toml").unwrap();
    let mut same = file.clone();
    (same.failure_modes, same.about) = Default::default();
    assert_eq!(pairs, same);
    let error = pairs.add("colision=bump", "--map").unwrap_err().to_string();
    assert!(error.contains("Unknown role `colision`. Expected one of success, failure_mode,"), "{error}");
    assert!(pairs.add("flag.none=x", "--map").is_err() && pairs.add("success", "--map").is_err());
}

#[test]
fn nested_json_gets_dotted_names() {
    let mapping =
        Mapping { parameters: Some([("lux".to_owned(), "scene.lux".to_owned())].into()), ..Mapping::default() };
    let (provenance, entries) = imported(&fixture("table.jsonl"), None, &mapping);
    assert_eq!(words(&entries), ["success", "timeout", "grip_loss", "invalid"]);
    assert_eq!(entries[3].episode.outcome, Outcome::Invalid(Fault::new(FaultKind::Diverged, "diverged: NaN in qpos")));
    assert_eq!(entries[2].episode.scenario.requested.number("lux"), Some(350.5));
    assert_eq!(entries[2].episode.scenario.requested.number("source_seed"), Some(13.0));
    // All three flags and all times are present, so every requested quantity is recorded.
    assert!(source(&provenance).not_recorded.is_empty());
}

#[test]
fn pyarrow_file_is_read() {
    let (provenance, entries) = imported(&fixture("table.parquet"), None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "grip_loss", "invalid", "success", "timeout"]);
    assert_eq!(entries[1].episode.time_s, 4.25);
    let requested = &entries[3].episode.scenario.requested;
    assert_eq!(requested.number("mass_kg"), Some(0.75));
    assert_eq!(requested.get("obstacles"), Some(&Value::Integer(3)));
    assert_eq!(requested.category("shape"), Some("box"));
    assert!(source(&provenance).notes.iter().any(|note| note.contains("`trace.list.element` is ignored")));
}

#[test]
fn wrong_values_are_located() {
    let none = Mapping::default();
    for (name, content, wanted) in [
        ("a.csv", "success,mass\n1,2\n2,3\n", &["a.csv", "line 3, column `success`: 2 is neither true nor false"][..]),
        ("b.csv", "success,failure_mode\n0,7\n", &["line 2, column `failure_mode`: 7 is not a word"]),
        ("c.csv", "success,failure_mode\n1,collision\n", &["contradicts `success`"]),
        (
            "d.csv",
            "success,failure_mode,collision\n0,collision,0\n",
            &["column `collision`", "contradicts `failure_mode`"],
        ),
        ("e.csv", "success,cycle_time_s\n1,-2\n", &["-2 is negative"]),
        ("f.csv", "success,cycle_time_s\n1,soon\n", &["`soon` is not a time in seconds"]),
        (
            "g.csv",
            "result,mass\n1,2\n",
            &[
                "no row has an outcome in `success`: there is no such column. Other columns: result, mass\n",
                "--map success=COLUMN",
            ],
        ),
        ("h.csv", "success,success\n1,2\n", &["the column `success` twice"]),
        ("i.csv", "success,mass\n1,2\n1\n", &["line 3", "1 fields. Expected 2"]),
        ("j.csv", "success,mass\n", &["no episodes", "Expected at least one row"]),
        ("k.jsonl", "{\"success\": true}\n{\"success\": tru}\n", &["line 2", "one JSON object"]),
        ("l.jsonl", "{\"success\": true, \"success\": false}\n{}\n", &["line 1", "`success` twice"]),
        ("m.json", "[{\"success\": true}]", &["JSON array", "JSON Lines"]),
        ("n.json", "{\"per_episode\": 3}", &["n.json", "no row has an outcome in `success`"]),
        ("o.json", "{\"per_episode\": [], \"per_task\": []}", &["twice"]),
        ("p.json", "{\"tasks\": [{\"episodes\": [{}], \"task\": \"t\"}]}", &["before its name"]),
        (
            "q.json",
            "{\"tasks\": [{\"task\": \"t\", \"episodes\": [{\"metrics\": {\"success\": 0.5}}]}]}",
            &["row 0", "0.5 is neither"],
        ),
        ("r.json", "{\"per_episode\": [{\"success\": NaN}]}", &["no row has an outcome in `success`"]),
        ("s.csv", "success,case\n1,2.5\n", &["2.5 is not a word, as a case must be"]),
        ("u.csv", "success,drop\n1,0.3\n", &["column `drop`: 0.3 is neither true nor false", "[parameters]"]),
        ("s", "", &["the file is empty"]),
        ("t", "\u{1}\0\u{2}", &["its format is unknown", "--format"]),
    ] {
        let error = refused(name, content, &none);
        assert!(wanted.iter().all(|part| error.contains(part)), "{name}: {error}");
    }
}

#[test]
fn mapping_of_absent_columns_is_rejected() {
    let table = "ok,mass\n1,2\n";
    let mapping = |text: &str| Mapping::from_toml(text, "m.toml").unwrap();
    let error = refused("a.csv", table, &mapping("success = 'okay'"));
    assert!(error.contains("no row has the column `okay`"), "{error}");
    let error = refused("b.csv", table, &mapping("success = 'ok'\n[parameters]\nmass_kg = 'weight'"));
    assert!(error.contains("`weight`") && error.contains("`mass_kg`"), "{error}");
    let error = refused("c.csv", table, &mapping("success = 'ok'\n[flags]\njammed = 'jam'"));
    assert!(error.contains("`jam`") && error.contains("the flag of jammed"), "{error}");
    let error = refused("d.csv", "success,failure_type\n1,none\n", &mapping("[parameters]\nkind = 'failure_type'"));
    assert!(error.contains("`failure_type` determines the outcome"), "{error}");
}

#[test]
fn invalid_mapping_is_located() {
    for (text, wanted) in [
        (
            "cycle_time_s = 't'\nsucess = 'ok'",
            &["m.toml", "line 2", "Unknown role `sucess`. Expected one of success,"][..],
        ),
        ("success = 3", &["line 1", "expected a string"]),
        ("[failure_modes]\nfell = 'success'", &["line 2", "`success` cannot be a failure mode"]),
        ("[failure_modes]\nfell = 'fell down'", &["line 2", "\"fell down\" is not a valid name"]),
        ("[flags]\n'' = 'a'", &["is not a valid name"]),
        ("drop = 'a'\n[flags]\ngrip_loss = 'b'", &["`grip_loss` has two columns"]),
        ("[about]\ntask = ''", &["line 2", "is not a valid name"]),
    ] {
        let error = Mapping::from_toml(text, "m.toml").unwrap_err().to_string();
        assert!(wanted.iter().all(|part| error.contains(part)), "{text}: {error}");
    }
}

#[test]
fn real_vla_eval_file_is_read() {
    // Written by `vla-eval run` 0.8.0 for a toy benchmark with a stub model.
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/vla_eval_aggregate.json");
    let (provenance, entries) = imported(&path, None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "unknown", "success", "unknown"]);
    assert_eq!((provenance.seed, provenance.policy.as_str()), (7, "S"));
}

/// Written by the JSON sink of inspect-robots 0.60.0, with trials that an operator judged, a trial without a judgement and a trial with an error.
#[test]
fn operators_decide_logs_of_inspect_robots() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/inspect_robots.json");
    let (provenance, entries) = imported(&path, None, &Mapping::default());
    let expected =
        ["success", "max_steps", "success", "success", "max_steps", "invalid", "success", "invalid", "success"];
    assert_eq!(words(&entries), expected);
    let named =
        (provenance.policy.as_str(), provenance.robot.name.as_str(), provenance.task.name.as_str(), provenance.seed);
    assert_eq!(named, ("pi0-fold", "yam-arms", "fold-towel", 3));
    assert_eq!(source(&provenance).format, "inspect_robots");
    assert_eq!(entries[3].label.case.as_deref(), Some("towel-1"));
    assert_eq!(entries[3].episode.scenario.requested.get("towel_mm"), Some(&Value::Integer(310)));
    assert_eq!(entries[0].episode.measures.get("score_episode_length"), Some(20.0));
    let Outcome::Invalid(fault) = &entries[7].episode.outcome else { panic!("{:?}", entries[7]) };
    assert!(fault.detail.contains("camera lost"), "{fault:?}");

    // Without an operator, its own success decides. Another version, and samples of another tool, are refused.
    let own = fs::read_to_string(&path).unwrap().replace("\"operator\": ", "\"success_at_end\": ");
    let own = own.replace("\"success\",", "null,").replace("\"failure\"", "null").replace("\"Yes\"", "null");
    let folder = Folder::new("results-inspect-robots");
    let from = folder.join("own.json");
    fs::write(&from, own).unwrap();
    let (_, entries) = imported(&from, None, &Mapping::default());
    assert_eq!(entries.iter().filter(|entry| entry.episode.outcome == Outcome::Success).count(), 5);
    let none = Mapping::default();
    let error =
        refused("version.json", "{\"samples\": [{\"scene_id\": \"a\", \"epochs\": []}], \"version\": 2}", &none);
    assert!(error.contains("schema version is 2. Expected 1"), "{error}");
    let error = refused("samples.json", "{\"samples\": [{\"id\": 1, \"scores\": {}}], \"version\": 1}", &none);
    assert!(error.contains("has no `scene_id` or no `epochs`"), "{error}");
}

/// By hand from the schema of LeRobot (codebase version v3.0), with pandas and pyarrow.
#[test]
fn episodes_of_lerobot_datasets_are_rows() {
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", "a Python with pyarrow and pandas") else {
        return;
    };
    let folder = Folder::new("results-lerobot-dataset");
    let dataset = folder.join("dataset");
    let output = std::process::Command::new(python).arg(fixture("lerobot_dataset.py")).arg(&dataset).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (provenance, entries) = imported(&dataset, None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "unknown", "success", "success", "unknown", "unknown"]);
    let lengths: Vec<f64> = entries.iter().map(|entry| entry.episode.time_s).collect();
    assert_eq!(lengths, [2.0, 3.0, 2.5, 4.0, 1.0, 3.5]);
    let tasks: Vec<_> = entries.iter().map(|entry| entry.label.category.clone().unwrap()).collect();
    assert_eq!((tasks[0].as_str(), tasks[2].as_str()), ("fold the towel", "stack the cups"));
    assert_eq!(entries[0].episode.measures.get("sum_reward"), Some(1.0));
    assert_eq!(provenance.robot.name, "so101_follower");
    assert_eq!(source(&provenance).format, "lerobot_dataset");

    let info = dataset.join("meta/info.json");
    let text = fs::read_to_string(&info).unwrap();
    let to = folder.join("d.parquet");
    let cases = [
        (text.replace("\"total_episodes\": 6", "\"total_episodes\": 7"), "states 7 episodes, but its frames have 6"),
        (text.replace("next.success", "next.other"), "no feature `next.success`"),
        (text.replace("v3.0", "v1.6"), "codebase version is v1.6. Expected v2 or v3"),
        ("[".to_owned(), "meta/info.json is not a JSON object"),
    ];
    for (text, expected) in cases {
        fs::write(&info, text).unwrap();
        let error = import(&dataset, &to, None, &Mapping::default()).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected}: {error}");
    }
    fs::remove_file(&info).unwrap();
    let error = import(&dataset, &to, None, &Mapping::default()).unwrap_err().to_string();
    assert!(error.contains("Expected the folder of a LeRobot dataset") && !to.exists(), "{error}");
}

/// One row per policy and session, with the fields that RoboArena's evaluator uploads.
#[test]
fn tables_of_roboarena_are_read() {
    let folder = Folder::new("results-roboarena");
    let path = folder.join("t.csv");
    let header = "session_id,command,policy_name,binary_success,partial_success,duration,timestamp\n";
    let rows: String = (0..12)
        .map(|i| format!("s{},pick the cup,pi{},{},0.5,{},2026_01_01\n", i / 2, i % 2, u8::from(i % 3 > 0), 100 + i))
        .collect();
    fs::write(&path, format!("{header}{rows}")).unwrap();
    assert_eq!(policies(&path, None, &Mapping::default()).unwrap(), ["pi0", "pi1"]);
    let mut mapping = Mapping::default();
    mapping.about.policy = Some("pi1".to_owned());
    let (provenance, entries) = imported(&path, None, &mapping);
    assert_eq!(words(&entries).iter().filter(|word| **word == "success").count(), 4);
    assert_eq!(entries[0].episode.measures.get("partial_success"), Some(0.5));
    assert!(
        provenance.space.parameters().iter().any(|parameter| *parameter.name == *"session_id"),
        "a session is a group of episodes"
    );
}

#[test]
fn flags_give_the_failure_mode() {
    let folder = Folder::new("results-flags");
    let path = folder.join("t.csv");
    fs::write(&path, "success,collision,drop,grasp_miss,x\n0,1,1,0,1\n0,0,1,0,2\n0,0,0,1,3\n0,0,0,0,4\n1,0,0,1,5\n")
        .unwrap();
    let (_, entries) = imported(&path, None, &Mapping::default());
    assert_eq!(words(&entries), ["collision", "grip_loss", "grasp_miss", "timeout", "success"]);
}

#[test]
fn endless_input_is_rejected() {
    let none = Mapping::default();
    let long = |mib: usize| "a".repeat(mib << 20);
    let error = refused("quote.csv", format!("success,x\n1,\"{}", long(2)), &none);
    assert!(error.contains("1 MiB without a row") && error.contains("a quote that is never closed"), "{error}");
    let error = refused("line.jsonl", format!("{{\"success\": true, \"x\": \"{}\"}}\n", long(2)), &none);
    assert!(error.contains("line 1 has more than"), "{error}");
    let error =
        refused("text.json", format!("{{\"per_episode\": [{{\"success\": true, \"x\": \"{}\"}}]}}", long(17)), &none);
    assert!(error.contains("16 MiB without a row"), "{error}");
    let error = refused("published.json", format!("{{\"experiments\": [{{\"x\": \"{}\"}}]}}", long(17)), &none);
    assert!(error.contains("16 MiB without a row"), "{error}");
}

/// The failure modes that an imported table of `rows` under `header` lists as not recorded.
fn unrecorded(name: &str, header: &str, rows: &[&str]) -> Vec<String> {
    let folder = Folder::new(&format!("results-unrecorded-{name}"));
    let (from, to) = (folder.join("t.csv"), folder.join("d.parquet"));
    fs::write(&from, format!("{header}\n{}\n", rows.join("\n"))).unwrap();
    let provenance = import(&from, &to, None, &Mapping::default()).unwrap().provenance;
    source(&provenance).not_recorded.iter().filter(|what| *what != "cycle_time_s").cloned().collect()
}

#[test]
fn empty_flags_record_nothing() {
    let header = "success,mass,collision,drop,grasp_miss";
    let modes = ["collision", "grasp_miss", "grip_loss"];
    assert_eq!(unrecorded("failed", header, &["false,1,,,"; 300]), modes);
    assert_eq!(unrecorded("succeeded", header, &["true,1,,,"; 300]), modes);
    assert_eq!(unrecorded("word", "success,mass,failure_mode", &["true,1,"; 3]), modes);
}

#[test]
fn missing_flag_leaves_mode_unrecorded() {
    let header = "success,mass,collision,drop,grasp_miss,failure_mode";
    // A failure with an unknown mode may have been a collision.
    assert_eq!(unrecorded("one", header, &["false,1,0,0,0,", "false,2,,0,0,", "true,3,0,0,0,"]), ["collision"]);
    // A success may also hide one if no row names its mode: here a success with a touch is a collision.
    assert_eq!(unrecorded("success", header, &["false,1,0,0,0,", "true,2,0,,0,"]), ["grip_loss"]);
    // A failure with a named mode was no other mode, and an invalid episode has no mode.
    assert!(unrecorded("named", header, &["false,1,,,,timeout", "true,2,,,,", "error,3,,,,"]).is_empty());
    assert!(unrecorded("raised", header, &["false,1,1,,,", "true,2,0,0,0,"]).is_empty());
}

/// The outcomes of a table, and the failure modes of its task.
fn table(name: &str, content: &str, mapping: &str) -> (Vec<String>, Vec<String>, Provenance) {
    let folder = Folder::new(&format!("results-table-{name}"));
    let path = folder.join("t");
    fs::write(&path, content).unwrap();
    let (provenance, entries) = imported(&path, None, &Mapping::from_toml(mapping, "m.toml").unwrap());
    let modes = provenance.task.failure_modes.iter().map(|mode| mode.name.to_string()).collect();
    (words(&entries).into_iter().map(str::to_owned).collect(), modes, provenance)
}

#[test]
fn any_word_is_a_failure_mode() {
    let rows =
        "success,failure_mode,x\n0,jammed,1\n0,Object fell!,2\n0,stuck,3\n1,None,4\n0,,5\n0,Invalid,6\n0,???,7\n";
    let (outcomes, modes, provenance) = table("words", rows, "[failure_modes]\nstuck = 'jammed'\ncrash = 'collision'");
    assert_eq!(outcomes, ["jammed", "Object_fell_", "jammed", "success", "unknown", "unknown", "unknown"]);
    // The modes of the rows, then the one that the mapping assigns to a word.
    assert_eq!(modes, ["Object_fell_", "jammed", "unknown", "collision"]);
    let task = &provenance.task;
    assert_eq!((task.name.as_str(), task.version, task.measures.len()), ("imported", 1, 0));
    assert!(
        source(&provenance)
            .notes
            .contains(&"Failures without a failure mode: 1. They are recorded as `unknown`.".to_owned())
    );
}

#[test]
fn failure_type_is_the_failure_mode() {
    let (outcomes, _, provenance) = table("type", "success,failure_type,x\n0,jammed,1\n1,none,2\n0,,3\n", "");
    assert_eq!(outcomes, ["jammed", "success", "unknown"]);
    assert_eq!(provenance.space.len(), 1);
    // Beside a column with the default name it fills missing values.
    let both = "success,failure_mode,failure_type,x\n0,tilted,jammed,1\n0,,jammed,2\n0,none,jammed,3\n1,,,4\n";
    let (outcomes, _, provenance) = table("both", both, "");
    assert_eq!((outcomes.join(" "), provenance.space.len()), ("tilted jammed jammed success".to_owned(), 1));
    // Beside a column named by the mapping it is ignored, and the notes report that.
    let (outcomes, _, provenance) =
        table("named", "success,how,failure_type,x\n0,tilted,a,1\n1,,,4\n", "failure_mode = 'how'");
    assert_eq!((outcomes.join(" "), provenance.space.len()), ("tilted success".to_owned(), 1));
    assert!(source(&provenance).notes.iter().any(|note| note.starts_with("Column `failure_type` is ignored")));
}

#[test]
fn own_flags_give_own_modes() {
    let rows = "success,jam,spill,x\n0,1,0,1\n0,0,1,2\n0,0,0,3\n1,0,0,4\n1,1,0,5\n";
    let mapping = "[flags]\njammed = 'jam'\nspilled = 'spill'\n[about]\ntask = 'pouring'";
    let (outcomes, modes, provenance) = table("own", rows, mapping);
    assert_eq!(outcomes, ["jammed", "spilled", "timeout", "success", "jammed"]);
    assert_eq!((modes.join(" "), provenance.task.name.as_str()), ("jammed spilled timeout".to_owned(), "pouring"));
    assert_eq!(source(&provenance).not_recorded, ["cycle_time_s"]);
    // A flag with one missing value leaves its mode unrecorded.
    let (outcomes, modes, provenance) = table("gap", "success,jam,spill,x\n0,0,,1\n1,0,0,2\n", mapping);
    assert_eq!((outcomes.join(" "), modes.join(" ")), ("unknown success".to_owned(), "unknown jammed".to_owned()));
    assert_eq!(source(&provenance).not_recorded, ["spilled", "cycle_time_s"]);
}

#[test]
fn published_flags_are_understood() {
    let rows = "success,bump,drop,grasp_miss,x\n1,0,0,1,1\n1,0,1,0,2\n1,1,0,0,3\n0,0,0,0,4\n";
    for mapping in ["collision = 'bump'", "[flags]\ncollision = 'bump'"] {
        let (outcomes, modes, provenance) = table("old", rows, mapping);
        assert_eq!(outcomes, ["success", "grip_loss", "collision", "timeout"], "a success outweighs a missed grasp");
        assert_eq!(modes, ["collision", "grip_loss", "timeout", "grasp_miss"]);
        assert_eq!(provenance.space.len(), 1);
    }
}

#[test]
fn parameter_may_have_a_flag_name() {
    let mapping = "[parameters]\ndrop_m = 'drop'";
    let (outcomes, _, provenance) = table("drop", "success,collision,drop\n1,0,0.3\n0,1,0.4\n", mapping);
    assert_eq!(outcomes, ["success", "collision"]);
    assert!(provenance.space.position("drop_m").is_some());
    assert!(source(&provenance).not_recorded.contains(&"grip_loss".to_owned()));
}

#[test]
fn failure_without_outcome_is_a_failure() {
    let (outcomes, ..) = table("silent", "success,failure_mode,drop,x\n,jammed,,1\n,,1,2\n,,,3\n1,,,4\n", "");
    assert_eq!(outcomes, ["jammed", "grip_loss", "invalid", "success"]);
}

#[test]
fn too_many_failure_modes_are_rejected() {
    let row = |i: u32| format!("0,word {i}\n");
    let rows = |n: u32| format!("success,failure_mode\n{}", (0..n).map(row).collect::<String>());
    let error = refused("modes.csv", rows(1001), &Mapping::default());
    assert!(error.contains("line 1002: it has more than 1000 different failure modes"), "{error}");
    assert_eq!(table("modes", &rows(1000), "").1.len(), 1000);
}

#[test]
fn ignored_columns_are_named() {
    let (.., provenance) = table("ignored", "success,mu,ok,weight\n1,0.5,true,3\n0,,false,4\n", "");
    let notes = &source(&provenance).notes;
    for note in [
        "Parameter `mu`: 1 of 2 rows have no value. They are kept without it.",
        "Column `ok` is ignored: it contains truth values.",
    ] {
        assert!(notes.iter().any(|found| found == note), "{note} {notes:?}");
    }
    assert!(provenance.space.position("source_weight").is_some(), "the dictionary has another column `weight`");
}

#[test]
fn dictionary_is_not_imported() {
    let folder = Folder::new("results-dictionary");
    let path = folder.join("dictionary.parquet");
    write_parquet(&path, &provenance(), (0..3).map(|index| Ok(entry(index)))).unwrap();
    let error = import(&path, &folder.join("d.parquet"), None, &Mapping::default()).unwrap_err().to_string();
    assert!(error.contains("it is already a dictionary"), "{error}");
}

#[test]
fn texts_that_repeat_their_starts_are_read() {
    for name in ["delta_texts.parquet", "delta_texts_v2.parquet"] {
        let (_, entries) = imported(&fixture(name), None, &Mapping::default());
        let shapes: Vec<_> = entries.iter().map(|entry| entry.episode.scenario.requested.category("shape")).collect();
        let expected: Vec<String> = (0..300).map(|i| format!("box with {} holes", i % 7)).collect();
        assert_eq!(shapes, expected.iter().map(|shape| Some(shape.as_str())).collect::<Vec<_>>(), "{name}");
    }
}

/// The roles of the columns, as `column: role`.
fn roles(provenance: &Provenance) -> Vec<String> {
    source(provenance).columns.iter().map(|column| format!("{}: {}", column.column, column.role)).collect()
}

#[test]
fn zstd_pages_are_read() {
    for name in ["zstd.parquet", "zstd_v2.parquet"] {
        let (provenance, entries) = imported(&fixture(name), None, &Mapping::default());
        assert_eq!(words(&entries), ["success", "unknown", "success", "success", "unknown"], "{name}");
        assert_eq!(entries[4].episode.scenario.requested.number("mass_kg"), Some(2.0));
        assert_eq!(entries[1].episode.scenario.requested.category("shape"), Some("sphere"));
        assert_eq!(entries[1].episode.measures.get("episode_length"), Some(200.0));
        assert_eq!(
            roles(&provenance),
            [
                "success: success",
                "return: measure return",
                "episode_length: measure episode_length",
                "mass_kg: parameter mass_kg",
                "shape: parameter shape"
            ]
        );
    }
}

#[test]
fn rows_without_a_parameter_are_kept() {
    let (provenance, entries) = imported(&fixture("zstd.parquet"), None, &Mapping::default());
    assert_eq!((entries.len(), provenance.space.len()), (5, 2));
    assert!(entries[2].episode.scenario.requested.is_empty());
    let notes = &source(&provenance).notes;
    assert!(notes.iter().any(|note| note.starts_with("Parameter `mass_kg`: 1 of 5 rows have no value.")), "{notes:?}");
}

#[test]
fn gaps_survive_an_export() {
    use robogate_dictionary::export::{Format as ExportFormat, write_file};
    let folder = Folder::new("results-gaps");
    let (first, again) = (folder.join("first.parquet"), folder.join("again.parquet"));
    import(&fixture("zstd.parquet"), &first, None, &Mapping::default()).unwrap();
    let original = Dictionary::open(&first).unwrap();
    for format in [ExportFormat::Csv, ExportFormat::JsonLines] {
        let export = folder.join("export");
        write_file(&original, format, &export).unwrap();
        import(&export, &again, None, &Mapping::default()).unwrap();
        let again = Dictionary::open(&again).unwrap();
        assert_eq!(again.dataset_hash(), original.dataset_hash());
    }
}

#[test]
fn results_become_measures() {
    let rows =
        "Success,friction,reward,episode_length,cycle_time,video_path\n1,0.5,3.5,120,4.2,a.mp4\n0,0.1,0.5,400,,b.mp4\n";
    let (outcomes, _, provenance) = table("measures", rows, "");
    assert_eq!(outcomes, ["success", "unknown"]);
    assert_eq!(provenance.space.parameters().iter().map(|p| &*p.name).collect::<Vec<_>>(), ["friction"]);
    let measures: Vec<&str> = provenance.task.measures.iter().map(|measure| measure.name.as_str()).collect();
    assert_eq!(measures, ["reward", "episode_length", "cycle_time"]);
    assert!(roles(&provenance).contains(&"video_path: identifier, not used".to_owned()));
    // The mapping takes precedence over the name.
    let (.., provenance) =
        table("chosen", rows, "[parameters]\nlength = 'episode_length'\n[measures]\nmu = 'friction'");
    assert_eq!(provenance.space.parameters().iter().map(|p| &*p.name).collect::<Vec<_>>(), ["length"]);
    assert!(roles(&provenance).contains(&"friction: measure mu".to_owned()));
}

#[test]
fn stated_sampling_is_recorded() {
    let rows = "success,x\n1,0.5\n0,0.1\n";
    let (.., provenance) = table("silent", rows, "");
    assert_eq!((source(&provenance).sampling, source(&provenance).stopping), (None, None));
    let (.., provenance) = table("stated", rows, "[about]\nsampling = 'uniform'\nstopping = 'monitored'");
    let stated = (source(&provenance).sampling, source(&provenance).stopping);
    assert_eq!(stated, (Some(RowSampling::Uniform), Some(Stopping::Monitored)));
}

#[test]
fn layouts_of_other_tools_are_understood() {
    let (provenance, entries) = imported(&fixture("isaac_lab_arena.jsonl"), None, &Mapping::default());
    assert_eq!(entries.len(), 24);
    assert!(roles(&provenance).contains(&"episode_length: measure episode_length".to_owned()));
    assert!(roles(&provenance).contains(&"env_id: identifier, not used".to_owned()));
    let (provenance, entries) = imported(&fixture("robosuite_rollouts.jsonl"), None, &Mapping::default());
    assert_eq!(words(&entries).iter().filter(|word| **word == "success").count(), 6);
    assert!(roles(&provenance).contains(&"Success_Rate: success".to_owned()));
    assert!(roles(&provenance).contains(&"Horizon: measure Horizon".to_owned()));
}

#[test]
fn one_dictionary_has_one_policy() {
    let folder = Folder::new("results-policies");
    let path = folder.join("t.csv");
    let rows: String = (0..12).map(|i| format!("{},{},{},{}\n", ["a", "b"][i % 2], i / 2, i % 3, i % 2)).collect();
    fs::write(&path, format!("policy_id,seed,mass,success\n{rows}")).unwrap();
    let mut mapping = Mapping::default();
    assert_eq!(policies(&path, None, &mapping).unwrap(), ["a", "b"]);
    let error = import(&path, &folder.join("d.parquet"), None, &mapping).unwrap_err().to_string();
    assert!(
        error.contains("column `policy_id` names 2 policies: `a`, `b`") && error.contains("--policy NAME"),
        "{error}"
    );
    mapping.about.policy = Some("b".to_owned());
    let (provenance, entries) = imported(&path, None, &mapping);
    assert_eq!((provenance.policy.as_str(), words(&entries)), ("b", vec!["success"; 6]));
    assert!(entries.iter().enumerate().all(|(at, entry)| entry.index() == at as u64));
    assert!(provenance.space.parameters().iter().all(|parameter| &*parameter.name != "policy_id"));
    assert!(source(&provenance).notes.iter().any(|note| note.contains("Rows of the policy `b`: 6 of 12")));
    mapping.about.policy = Some("c".to_owned());
    let error = import(&path, &folder.join("d.parquet"), None, &mapping).unwrap_err().to_string();
    assert!(error.contains("and not `c`"), "{error}");
    // The only policy of a file is its policy, and a given role comes first.
    fs::write(&path, "checkpoint,seed,mass,success\npi0,1,2,1\npi0,2,3,0\n").unwrap();
    assert_eq!(imported(&path, None, &Mapping::default()).0.policy, "pi0");
    fs::write(&path, "checkpoint,seed,mass,success\nmug,1,2,1\nbowl,2,3,0\n").unwrap();
    let mut mapping = Mapping::default();
    mapping.add("parameter.model=checkpoint", "--map").unwrap();
    let (provenance, entries) = imported(&path, None, &mapping);
    assert_eq!((provenance.policy.as_str(), entries.len()), ("unknown", 2));
    // A column `model` can name objects.
    fs::write(&path, "model,seed,mass,success\nmug,1,2,1\nbowl,2,3,0\n").unwrap();
    let (provenance, entries) = imported(&path, None, &Mapping::default());
    assert_eq!((provenance.policy.as_str(), entries.len()), ("unknown", 2));
    assert!(!roles(&provenance).contains(&"model: policy".to_owned()), "{:?}", roles(&provenance));
}

#[test]
fn rows_without_policy_are_refused() {
    let rows = "policy,mass,success\na,1,1\n,2,0\nb,3,1\n,4,1\n";
    let error = refused("no-policy.csv", rows, &Mapping::default());
    assert!(error.contains("line 3, column `policy`: a missing value names no policy"), "{error}");
    assert!(error.contains("Hint: fill it in, or leave the column out with --map ignore=policy"), "{error}");
    let folder = Folder::new("results-no-policy");
    let path = folder.join("t.csv");
    fs::write(&path, rows).unwrap();
    assert_eq!(policies(&path, None, &Mapping::default()).unwrap_err().to_string().lines().count(), 2);
    // As the hint says.
    let mut mapping = Mapping::default();
    mapping.add("ignore=policy", "--map").unwrap();
    assert!(policies(&path, None, &mapping).unwrap().is_empty());
    let (provenance, entries) = imported(&path, None, &mapping);
    assert_eq!((provenance.policy.as_str(), entries.len()), ("unknown", 4));
    assert!(roles(&provenance).contains(&"policy: not used, as requested".to_owned()), "{:?}", roles(&provenance));
    // A column without any value names no policy.
    fs::write(&path, "policy,mass,success\n,1,1\n,2,0\n").unwrap();
    let (provenance, entries) = imported(&path, None, &Mapping::default());
    assert_eq!((provenance.policy.as_str(), entries.len()), ("unknown", 2));
}
