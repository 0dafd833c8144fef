//! Tests that exports can be imported without loss.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use robogate_core::{Domain, FailureMode, Outcome, ParameterSpace, TaskSpec, Value, Word};
use robogate_dictionary::export::{Format, write_file};
use robogate_dictionary::results::{Mapping, import};
use robogate_dictionary::{Dictionary, DictionaryError, Entry, Provenance, dataset_hash, published, write_parquet};

use crate::common::{Folder, entry, entry_of, pick_place, provenance, provenance_of, same, strange_entry, task};

const FORMATS: [(Format, &str); 2] = [(Format::Csv, "robogate_csv"), (Format::JsonLines, "robogate_json_lines")];

fn dictionary(path: &Path, provenance: &Provenance, entries: impl IntoIterator<Item = Entry>) -> Dictionary {
    write_parquet(path, provenance, entries.into_iter().map(Ok)).unwrap();
    Dictionary::open(path).unwrap()
}

fn imported(from: &Path, to: &Path) -> Dictionary {
    import(from, to, None, &Mapping::default()).unwrap();
    Dictionary::open(to).unwrap()
}

/// Exports the dictionary in each format, imports it again and compares the entries bit for bit.
fn round_trip(folder: &Folder, original: &Dictionary) -> Vec<Provenance> {
    let round_trip = |(format, name)| {
        let (from, to) = (folder.join("export"), folder.join("again.parquet"));
        write_file(original, format, &from).unwrap();
        let again = imported(&from, &to);
        assert_eq!(again.len(), original.len());
        for (before, after) in original.entries().zip(again.entries()) {
            let (before, after) = (before.unwrap(), after.unwrap());
            assert!(same(&before, &after), "{before:#?}\n{after:#?}");
        }
        // The rows are the same data, independent of what is known about their task.
        let task = Arc::clone(&original.provenance().task);
        assert_eq!(dataset_hash(task, again.entries()).unwrap(), original.dataset_hash());
        assert_eq!(again.provenance().source.as_ref().unwrap().format, name);
        again.provenance().clone()
    };
    FORMATS.map(round_trip).into()
}

fn modes(task: &TaskSpec) -> Vec<&str> {
    task.failure_modes.iter().map(|mode| mode.name.as_str()).collect()
}

#[test]
fn own_task_survives_the_round_trip() {
    let folder = Folder::new("exported-own");
    let undeclared = |index| {
        let mut entry = entry(index);
        if index % 50 == 20 {
            entry.episode.outcome = Outcome::Failure(FailureMode::new("scratched").unwrap());
            entry.episode.phase = Some(Word::constant("wait"));
        }
        entry
    };
    let original = dictionary(&folder.join("d.parquet"), &provenance(), (0..3000).map(|i| undeclared(3 * i)));
    for again in round_trip(&folder, &original) {
        assert_eq!(modes(&again.task), ["bore.damaged", "jammed", "scratched", "tilted", "timeout"]);
        let measures: Vec<&str> = again.task.measures.iter().map(|measure| measure.name.as_str()).collect();
        assert_eq!(measures, ["peak_force_n", "depth_m", "tilt_rad"]);
        assert_eq!((again.task.name.as_str(), again.task.phases.len(), again.seed), ("imported", 4, 2026));
        let names = |space: &ParameterSpace| space.parameters().iter().map(|p| p.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&again.space), names(&original.provenance().space));
        assert_eq!(again.space.parameters()[2].domain, Domain::Integer { low: 0, high: 5 });
    }
}

#[test]
fn pick_place_survives_the_round_trip() {
    let folder = Folder::new("exported-pick-place");
    let task = pick_place();
    let original =
        dictionary(&folder.join("d.parquet"), &provenance_of(task.clone()), (0..500).map(|i| entry_of(&task, i)));
    for again in round_trip(&folder, &original) {
        assert_eq!(modes(&again.task), ["collision", "grasp_miss", "grip_loss", "timeout"]);
        assert_eq!((again.task.measures.len(), again.task.phases.len()), (4, 6));
    }
}

#[test]
fn strange_values_survive_the_round_trip() {
    let folder = Folder::new("exported-strange");
    let strange = |index| {
        let mut entry = strange_entry(index);
        // Texts that a simple parser would misread.
        let words = ["", " ", "nan", "none", "true", "1e400", "a,b", "\"", "x\r\ny", "-", "\u{feff}"];
        entry.stage = words[index as usize % words.len()].to_owned();
        entry.label.case = Some(words[(index as usize + 1) % words.len()].to_owned());
        entry.episode.scenario.requested.set("shape", Value::Category(words[index as usize % 7].into()));
        entry
    };
    let original = dictionary(&folder.join("d.parquet"), &provenance(), (0..30).map(strange));
    round_trip(&folder, &original);
}

#[test]
fn categories_of_digits_stay_words() {
    let folder = Folder::new("exported-digits");
    let space = ParameterSpace::from_toml(
        "name = 'digits'\n[[parameter]]\nname = 'layers'\nkind = 'categorical'\nchoices = ['1', '2', '-3.5']",
    )
    .unwrap();
    let with = |index: u64| {
        let mut entry = entry(index);
        let word = Value::Category(["1", "2", "-3.5"][index as usize % 3].into());
        entry.episode.scenario.requested = [("layers".into(), word.clone())].into_iter().collect();
        entry.episode.applied = [("layers".into(), word)].into_iter().collect();
        entry
    };
    let original = dictionary(&folder.join("d.parquet"), &Provenance { space, ..provenance() }, (0..9).map(with));
    round_trip(&folder, &original);
}

#[test]
fn published_form_survives_the_round_trip() {
    let folder = Folder::new("exported-published");
    let (from, to) = (folder.join("p.json"), folder.join("again.parquet"));
    // Rows of a task with other failure modes. The published form has no fields for its measures.
    let original = dictionary(&folder.join("d.parquet"), &provenance_of(task()), (0..700).map(entry));
    let rows = write_file(&original, Format::Published, &from).unwrap();
    let text = fs::read_to_string(&from).unwrap();
    assert!(!text.contains("grasp_miss"), "flags exist only for declared modes");
    let done = published::import(&from, &to).unwrap();
    assert_eq!((done.written.rows, done.provenance.task.name.as_str()), (rows, "pick_place"));
    let again = Dictionary::open(&to).unwrap();
    let valid = original.entries().map(Result::unwrap).filter(|e| !matches!(e.episode.outcome, Outcome::Invalid(_)));
    for (before, after) in valid.zip(again.entries()) {
        let after = after.unwrap();
        assert_eq!(before.episode.scenario, after.episode.scenario);
        assert_eq!(before.episode.outcome, after.episode.outcome);
        assert_eq!(before.episode.time_s.to_bits(), after.episode.time_s.to_bits());
    }
}

#[test]
fn data_frame_file_is_read() {
    let folder = Folder::new("exported-frame");
    let original = dictionary(&folder.join("d.parquet"), &provenance(), (0..7).map(entry));
    let (from, to) = (folder.join("e.csv"), folder.join("again.parquet"));
    write_file(&original, Format::Csv, &from).unwrap();
    // As written by pandas: plain line ends, integers with missing values as real numbers, and no quotes.
    let text = fs::read_to_string(&from).unwrap().replace("\r\n", "\n").replace(",\"\"", ",");
    let column = original.column_names().position(|name| name == "applied_obstacles").unwrap();
    let as_real = |line: &str| {
        let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        if fields[column].parse::<i64>().is_ok() {
            fields[column].push_str(".0");
        }
        fields.join(",")
    };
    let text: Vec<String> = text.lines().map(as_real).collect();
    let text = text.join("\n");
    fs::write(&from, format!("\u{feff}{text}\n")).unwrap();
    let again = imported(&from, &to);
    for (before, after) in original.entries().zip(again.entries()) {
        let mut before = before.unwrap();
        before.label.group = before.label.group.filter(|group| !group.is_empty());
        assert_eq!(before, after.unwrap());
    }
}

#[test]
fn edited_exports_are_rejected() {
    let folder = Folder::new("exported-edited");
    let original = dictionary(&folder.join("d.parquet"), &provenance(), (0..14).map(entry));
    let (from, to) = (folder.join("e.csv"), folder.join("again.parquet"));
    write_file(&original, Format::Csv, &from).unwrap();
    let whole = fs::read_to_string(&from).unwrap();
    let cut = |from: &str, to: &str| whole.replacen(from, to, 1);
    for (text, wanted) in [
        (cut(",jammed,jammed,", ",jammed,tilted,"), "column `failure_type`: `tilted` contradicts the outcome jammed"),
        (cut(",jammed,jammed,", ",stuck fast,jammed,"), "\"stuck fast\" is not a valid name"),
        (cut(",setup,", ",sunspots,"), "`sunspots` is not a class of fault"),
        (cut("\r\n1,", "\r\nx,"), "row 1, column `index`: `x` is not an integer of at least 0"),
        (cut("\r\n1,", "\r\n\"1\","), "`1` is not an integer of at least 0 without quotes"),
        (cut("\r\n1,", "\r\n5,"), "episode 2 follows episode 5"),
        (cut(",2026,", ",2027,"), "2027"),
        (cut("\r\n2,", "\r\n2,2,"), "line 4: 32 fields. Expected 31"),
        (cut("index,stage,", "stage,index,"), "not all of them in order"),
        (cut(",ticks,", ",colour,ticks,"), "31 fields. Expected 32"),
        (cut(",seed,friction,", ",seed,Friction,"), "not all of them in order"),
        (cut(",depth_m,", ",depth in m,"), "\"depth in m\" is not a valid name"),
        (format!("{},\"open", whole.trim_end()), "a quote is never closed"),
        (cut(",uniform,", ",\"uniform\"ly,"), "text after a closing quote"),
        (whole.lines().next().unwrap().to_owned(), "it has no episodes"),
    ] {
        fs::write(&from, text).unwrap();
        let error = import(&from, &to, None, &Mapping::default()).unwrap_err().to_string();
        assert!(error.contains(wanted) && !to.exists(), "{wanted}: {error}");
    }
    write_file(&original, Format::JsonLines, &from).unwrap();
    let whole = fs::read_to_string(&from).unwrap();
    for (text, wanted) in [
        (
            whole.replacen("\"stage\":\"uniform\",", "", 2).replacen("{", "{\"stage\":\"uniform\",", 1),
            "line 2: its fields",
        ),
        (whole.replace("\"ticks\":", "\"ticks\":[1],\"x\":"), "no row has an outcome in `success`"),
        (whole.replacen("\"index\":1,", "\"index\":true,", 1), "line 2"),
        (whole.replacen("\"friction\":", "\"friction\":null,\"was\":", 1), "line 2: its fields"),
    ] {
        fs::write(&from, text).unwrap();
        let error = import(&from, &to, None, &Mapping::default()).unwrap_err().to_string();
        assert!(error.contains(wanted) && !to.exists(), "{wanted}: {error}");
    }
}

#[test]
fn mapping_of_export_is_rejected() {
    let folder = Folder::new("exported-mapping");
    let original = dictionary(&folder.join("d.parquet"), &provenance(), (0..5).map(entry));
    let (from, to) = (folder.join("e.csv"), folder.join("again.parquet"));
    write_file(&original, Format::Csv, &from).unwrap();
    let mapping = Mapping::from_toml("success = 'outcome'", "m.toml").unwrap();
    let error = import(&from, &to, None, &mapping).unwrap_err();
    assert!(matches!(error, DictionaryError::Mapping { .. }) && error.to_string().contains("remove the mapping"));
    // Information that the export lacks may be given.
    let mapping = Mapping::from_toml("[about]\ntask = 'press_fit'\nrobot = 'ur5e'", "m.toml").unwrap();
    let provenance = import(&from, &to, None, &mapping).unwrap().provenance;
    assert_eq!((provenance.task.name.as_str(), provenance.robot.name.as_str()), ("press_fit", "ur5e"));
    assert_eq!(provenance.policy, "unknown");
}
