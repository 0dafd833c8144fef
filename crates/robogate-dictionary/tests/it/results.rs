//! Results of other tools, in the layouts in which those tools write them.

use std::fs;
use std::path::{Path, PathBuf};

use robogate_core::{Fault, FaultKind, Outcome, Value};
use robogate_dictionary::results::{Format, Mapping, import};
use robogate_dictionary::{Dictionary, Entry, Label, Provenance, Source};

use crate::common::Folder;

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
    assert!(!to.exists(), "nothing is written where {error}");
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
    assert_eq!(words(&entries), ["success", "timeout", "success", "success"]);
    let seeds: Vec<_> = entries.iter().map(|e| e.episode.scenario.requested.get("source_seed").cloned()).collect();
    assert_eq!(seeds, [1000, 1001, 1002, 1003].map(|n| Some(Value::Integer(n))));
    assert!(entries.iter().all(|entry| entry.episode.time_s.is_nan()));
    assert_eq!(source(&provenance).format, "lerobot");
    assert_eq!(source(&provenance).not_recorded, ["grasp_miss", "grip_loss", "collision", "cycle_time_s"]);
    assert_eq!(provenance.robot.sha256, None);
    assert_eq!(provenance.plan["source_metadata"]["pc_success"], 75.0);
}

#[test]
fn lerobot_tasks_become_cases() {
    let (provenance, entries) = imported(&fixture("lerobot_tasks.json"), None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "timeout", "success", "success", "success"]);
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
fn contradicting_averages_are_refused() {
    let text = fs::read_to_string(fixture("lerobot_one_environment.json")).unwrap();
    let error = refused("edited.json", text.replace("75.0", "100.0"), &Mapping::default());
    assert!(error.contains("`pc_success` says 100") && error.contains("3 successes in 4 episodes"), "{error}");
    let text = fs::read_to_string(fixture("lerobot_tasks.json")).unwrap();
    let error = refused("cut.json", text.replace("[true, true]", "[true]"), &Mapping::default());
    assert!(error.contains("`overall.n_episodes` says 5, its rows are 4"), "{error}");
}

#[test]
fn crashed_vla_eval_episode_is_invalid() {
    let (provenance, entries) = imported(&fixture("vla_eval.json"), None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "timeout", "invalid", "success", "invalid"]);
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
    // The last one says success beside a collision.
    assert_eq!(words(&entries), ["success", "grip_loss", "collision", "invalid", "collision"]);
    assert!(source(&provenance).notes.iter().any(|n| n.starts_with("1 episodes say success beside a collision")));
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
    pairs.add("collision=bump,error=broke,parameter.mass_kg=mass,parameter.surface=surface", "--map").unwrap();
    let text = fs::read_to_string(fixture("table.toml")).unwrap();
    let file = Mapping::from_toml(&text, "table.toml").unwrap();
    let mut same = file.clone();
    (same.failure_modes, same.about) = Default::default();
    assert_eq!(pairs, same);
    let error = pairs.add("colision=bump", "--map").unwrap_err().to_string();
    assert!(error.contains("`colision` is nothing that a column can be") && error.contains("collision"), "{error}");
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
    // All three flags are given, and all times: whatever is asked of these rows is in them.
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
    assert!(source(&provenance).notes.iter().any(|note| note.contains("`trace.list.element` is left out")));
}

#[test]
fn wrong_values_are_located() {
    let none = Mapping::default();
    for (name, content, wanted) in [
        ("a.csv", "success,mass\n1,2\n2,3\n", &["a.csv", "row 1, column `success`: 2 is neither true nor false"][..]),
        (
            "b.csv",
            "success,failure_mode\n0,fell\n",
            &["row 0, column `failure_mode`: `fell` is none of", "[failure_modes]"],
        ),
        ("c.csv", "success,failure_mode\n1,collision\n", &["contradicts `success`"]),
        (
            "d.csv",
            "success,failure_mode,collision\n0,collision,0\n",
            &["column `collision`", "contradicts `failure_mode`"],
        ),
        ("e.csv", "success,cycle_time_s\n1,-2\n", &["-2 is below 0 seconds"]),
        ("f.csv", "success,cycle_time_s\n1,soon\n", &["`soon` is no time in seconds"]),
        ("g.csv", "result,mass\n1,2\n", &["no row says in `success`", "--map success=COLUMN"]),
        ("h.csv", "success,success\n1,2\n", &["the column `success` twice"]),
        ("i.csv", "success,mass\n1,2\n1\n", &["line 3", "1 fields under a header of 2"]),
        ("j.csv", "success,mass\n", &["no episodes", "nothing was evaluated"]),
        ("k.jsonl", "{\"success\": true}\n{\"success\": tru}\n", &["line 2", "one JSON object"]),
        ("l.jsonl", "{\"success\": true, \"success\": false}\n{}\n", &["line 1", "`success` twice"]),
        ("m.json", "[{\"success\": true}]", &["JSON array", "JSON Lines"]),
        ("n.json", "{\"per_episode\": 3}", &["n.json", "an array of episodes"]),
        ("o.json", "{\"per_episode\": [], \"per_task\": []}", &["twice"]),
        ("p.json", "{\"tasks\": [{\"episodes\": [{}], \"task\": \"t\"}]}", &["before its name"]),
        (
            "q.json",
            "{\"tasks\": [{\"task\": \"t\", \"episodes\": [{\"metrics\": {\"success\": 0.5}}]}]}",
            &["row 0", "0.5 is neither"],
        ),
        ("r.json", "{\"per_episode\": [{\"success\": NaN}]}", &["line 1 column 30", "JSON has no NaN"]),
        ("s.csv", "success,case\n1,2.5\n", &["2.5 is no word, as a case must be"]),
        ("s", "", &["it is empty"]),
        ("t", "\u{1}\0\u{2}", &["none of the known formats", "--format"]),
    ] {
        let error = refused(name, content, &none);
        assert!(wanted.iter().all(|part| error.contains(part)), "{name}: {error}");
    }
}

#[test]
fn mapping_of_absent_columns_is_refused() {
    let table = "ok,mass\n1,2\n";
    let mapping = |text: &str| Mapping::from_toml(text, "m.toml").unwrap();
    let error = refused("a.csv", table, &mapping("success = 'okay'"));
    assert!(error.contains("no row has the column `okay`"), "{error}");
    let error = refused("b.csv", table, &mapping("success = 'ok'\n[parameters]\nmass_kg = 'weight'"));
    assert!(error.contains("`weight`") && error.contains("`mass_kg`"), "{error}");
    let error = Mapping::from_toml("sucess = 'ok'", "m.toml").unwrap_err().to_string();
    assert!(error.contains("m.toml") && error.contains("sucess"), "{error}");
    let error = Mapping::from_toml("[failure_modes]\nfell = 'drop'", "m.toml").unwrap_err().to_string();
    assert!(error.contains("`drop`") && error.contains("grip_loss"), "{error}");
}

#[test]
fn real_vla_eval_file_is_read() {
    let Some(shared) = std::env::var_os("ROBOGATE_SHARED_DATA") else {
        println!("skipped: ROBOGATE_SHARED_DATA is not set");
        return;
    };
    let captured = "reference/protocols/captures/vla_eval/results/Tiny_demo_aggregate.json";
    let Some(path) = Path::new(&shared).parent().map(|shared| shared.join(captured)).filter(|path| path.exists())
    else {
        println!("skipped: the captured aggregate is not there");
        return;
    };
    let (provenance, entries) = imported(&path, None, &Mapping::default());
    assert_eq!(words(&entries), ["success", "timeout", "success", "timeout"]);
    assert_eq!((provenance.seed, provenance.policy.as_str()), (7, "S"));
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
fn endless_input_is_refused() {
    let none = Mapping::default();
    let long = |mib: usize| "a".repeat(mib << 20);
    let error = refused("quote.csv", format!("success,x\n1,\"{}", long(2)), &none);
    assert!(error.contains("1 MiB without a row") && error.contains("a quote that is opened"), "{error}");
    let error = refused("line.jsonl", format!("{{\"success\": true, \"x\": \"{}\"}}\n", long(2)), &none);
    assert!(error.contains("line 1 has more than"), "{error}");
    let error =
        refused("text.json", format!("{{\"per_episode\": [{{\"success\": true, \"x\": \"{}\"}}]}}", long(17)), &none);
    assert!(error.contains("16 MiB without a row"), "{error}");
    let error = refused("published.json", format!("{{\"experiments\": [{{\"x\": \"{}\"}}]}}", long(17)), &none);
    assert!(error.contains("16 MiB without a row"), "{error}");
}

/// The modes that a table of `rows` under `header` is said not to record.
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
    let modes = ["grasp_miss", "grip_loss", "collision"];
    assert_eq!(unrecorded("failed", header, &["false,1,,,"; 300]), modes);
    assert_eq!(unrecorded("succeeded", header, &["true,1,,,"; 300]), modes);
    assert_eq!(unrecorded("word", "success,mass,failure_mode", &["true,1,"; 3]), modes);
}

#[test]
fn missing_flag_leaves_mode_unrecorded() {
    let header = "success,mass,collision,drop,grasp_miss,failure_mode";
    // A failure of unknown kind may have been a collision.
    assert_eq!(unrecorded("one", header, &["false,1,0,0,0,", "false,2,,0,0,", "true,3,0,0,0,"]), ["collision"]);
    // So may a success, where no row names its mode; a success beside a touch is a collision here.
    assert_eq!(unrecorded("success", header, &["false,1,0,0,0,", "true,2,0,,0,"]), ["grip_loss"]);
    // A failure whose kind is named was nothing else, and an invalid episode says nothing of any kind.
    assert!(unrecorded("named", header, &["false,1,,,,timeout", "true,2,,,,", "error,3,,,,"]).is_empty());
    assert!(unrecorded("raised", header, &["false,1,1,,,", "true,2,0,0,0,"]).is_empty());
}
