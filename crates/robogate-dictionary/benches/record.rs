//! Benchmark: rows per second and peak memory for each file format of the record.
//!
//! `cargo bench -p robogate-dictionary [-- ROWS]` prints one line per operation. Peak memory is that of the process so
//! far. If it stays constant from line to line, memory is bounded.
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::print_stdout, clippy::unwrap_used, reason = "a benchmark prints its results")]

use std::fs;
use std::io::sink;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use robogate_core::{Contact, Episode, Outcome, ParameterSpace, Scenario, Seed, TaskSpec};
use robogate_dictionary::{
    Dictionary, Engine, Entry, Journal, Label, Platform, Provenance, Robot, SCHEMA_VERSION, Tool, dataset_hash, export,
    published, v1, write_parquet,
};

fn main() {
    let rows: u64 = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(100_000);
    let folder = std::env::temp_dir().join(format!("robogate-bench-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    measure(rows, &folder);
    fs::remove_dir_all(&folder).unwrap();
}

fn measure(rows: u64, folder: &Path) {
    let (journal_path, parquet, json) = (folder.join("j"), folder.join("d.parquet"), folder.join("p.json"));
    let space = space();
    let task = Arc::new(v1::task());
    let entry = |index| entry(&task, &space, index);
    let size = |path: &Path| fs::metadata(path).unwrap().len() as f64 / rows as f64;
    println!("{rows} rows of {} parameters", space.len());

    report("make entries (part of the next two)", rows, || (0..rows).for_each(|i| drop(entry(i))));
    let mut journal = Journal::create(&journal_path, &[7; 32]).unwrap();
    report("journal, append", rows, || (0..rows).for_each(|i| journal.append(&entry(i)).unwrap()));
    drop(journal);
    let mut journal = None;
    report("journal, open", rows, || journal = Some(Journal::open(&journal_path, &[7; 32]).unwrap().0));
    let mut journal = journal.unwrap();
    report("journal, ordered", rows, || assert_eq!(journal.ordered().map(Result::unwrap).count() as u64, rows));
    report("journal to Parquet", rows, || {
        drop(write_parquet(&parquet, &provenance(&task, &space), journal.ordered()).unwrap())
    });
    println!("  a row is {:.0} bytes in the journal, {:.0} in Parquet", size(&journal_path), size(&parquet));

    let dictionary = Dictionary::open(&parquet).unwrap();
    report("Parquet, entries", rows, || assert_eq!(dictionary.entries().map(Result::unwrap).count() as u64, rows));
    report("Parquet, one column", rows, || drop(dictionary.column("friction").unwrap()));
    report("dataset hash", rows, || drop(dataset_hash(Arc::clone(&task), dictionary.entries()).unwrap()));
    report("to CSV", rows, || assert_eq!(export::csv(&dictionary, sink()).unwrap(), rows));
    report("to JSON Lines", rows, || assert_eq!(export::json_lines(&dictionary, sink()).unwrap(), rows));
    report("to published JSON", rows, || {
        export::write_file(&dictionary, export::Format::Published, &json).unwrap();
    });
    println!("  {:.0} MB of JSON", size(&json) * rows as f64 / 1e6);
    report("from published JSON", rows, || drop(published::import(&json, &folder.join("i.parquet")).unwrap()));
}

fn report(what: &str, rows: u64, run: impl FnOnce()) {
    let start = Instant::now();
    run();
    let seconds = start.elapsed().as_secs_f64();
    println!("{what:36} {:9.0} rows/s  {seconds:7.2} s  peak {}", rows as f64 / seconds, peak_memory());
}

/// The peak resident memory of this process, as reported by Linux.
fn peak_memory() -> String {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.map_or_else(|| "unknown".to_owned(), |line| line.trim().to_owned())
}

fn space() -> ParameterSpace {
    ParameterSpace::from_toml(include_str!("../../../assets/spaces/franka.toml")).unwrap()
}

fn provenance(task: &Arc<TaskSpec>, space: &ParameterSpace) -> Provenance {
    Provenance {
        task: Arc::clone(task),
        tool: Tool::robogate(),
        schema_version: SCHEMA_VERSION,
        build: None,
        engine: Engine { name: "none".to_owned(), version: None, build_sha256: None },
        robot: Robot { name: "none".to_owned(), sha256: None, dimensions: None },
        policy: "none".to_owned(),
        world: None,
        space: space.clone(),
        plan: serde_json::Value::Null,
        seed: 1,
        question_sha256: None,
        platform: Some(Platform::here()),
        source: None,
    }
}

fn entry(task: &TaskSpec, space: &ParameterSpace, index: u64) -> Entry {
    let seed = Seed::campaign(1).episode(index);
    let mut stream = seed.stream("bench");
    let value = |parameter: &robogate_core::Parameter, u| parameter.domain.decode(parameter.domain.from_unit(u));
    let parameters = space.parameters().iter();
    let requested: robogate_core::Assignment =
        parameters.map(|parameter| (Arc::clone(&parameter.name), value(parameter, stream.uniform()))).collect();
    let failure = task.modes().next().filter(|_| index.is_multiple_of(5));
    Entry {
        stage: "uniform".to_owned(),
        design: "latin_hypercube".to_owned(),
        weight: 1.0,
        label: Label::default(),
        episode: Episode {
            applied: requested.clone(),
            scenario: Scenario { index, seed, requested },
            outcome: failure.map_or(Outcome::Success, Outcome::Failure),
            time_s: stream.between(2.0, 15.0),
            phase: task.phases.get((index % 6) as usize).copied(),
            contact: failure.map(|_| Contact {
                robot_body: "link5".to_owned(),
                other_body: "table".to_owned(),
                force_n: stream.uniform(),
            }),
            measures: task.measures.iter().map(|measure| (measure.name, Some(stream.uniform()))).collect(),
            draws: Default::default(),
            ticks: 100 + (index % 100) as u32,
            trajectory_hash: stream.bits(),
        },
    }
}
