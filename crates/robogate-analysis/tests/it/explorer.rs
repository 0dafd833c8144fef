//! Tests of the columns of the explorer.

use robogate_analysis::{Analysis, ExplorerTable, Role, Source, ValueKind, worth_watching};
use robogate_core::Outcome;

use crate::synthetic::{law, provenance, space, write};

fn column<'a>(table: &'a ExplorerTable, name: &str) -> &'a robogate_analysis::ExplorerColumn {
    table.columns().iter().find(|column| column.name == name).unwrap()
}

#[test]
fn columns_hold_the_rows() {
    let space = space(&["box", "sphere"]);
    let entries = law(&space, 100);
    let mut table = ExplorerTable::new(usize::MAX);
    let run = table.add_run("a", &provenance(space.clone()));
    entries.iter().for_each(|entry| table.push(run, entry));
    assert_eq!(table.rows(), 100);
    assert!(table.columns().iter().all(|column| column.values().len() == 100));
    let friction = column(&table, "friction");
    assert_eq!((friction.role, friction.kind, friction.log), (Role::Parameter, ValueKind::Number, true));
    assert_eq!(friction.range, Some([0.05, 1.2]));
    let (outcome, shape) = (column(&table, "outcome"), column(&table, "shape"));
    assert_eq!(outcome.levels[0], "success");
    assert_eq!(shape.levels, ["box", "sphere"]);
    assert_eq!((column(&table, "mass_kg").label.as_str(), column(&table, "mass_kg").unit.as_str()), ("mass", "kg"));
    for (row, entry) in entries.iter().enumerate() {
        let requested = &entry.episode.scenario.requested;
        assert_eq!(friction.values()[row].to_bits(), (requested.number("friction").unwrap() as f32).to_bits());
        assert_eq!(shape.levels[shape.values()[row] as usize], requested.category("shape").unwrap());
        assert_eq!(outcome.levels[outcome.values()[row] as usize], entry.episode.outcome.as_str());
    }
    // A part of the rows, column after column.
    let bytes = table.bytes(10..30);
    assert_eq!(bytes.len(), 4 * 20 * table.columns().len());
    let at = table.columns().iter().position(|column| column.name == "friction").unwrap();
    assert_eq!(bytes[4 * 20 * at..][..4], friction.values()[10].to_le_bytes());
    assert!(table.bytes(90..110).is_empty(), "rows that do not exist");
}

#[test]
fn runs_share_columns_of_one_name() {
    let (first, second) = (space(&["box", "sphere"]), space(&["sphere", "cone"]));
    let mut table = ExplorerTable::new(usize::MAX);
    let runs = [table.add_run("a", &provenance(first.clone())), table.add_run("b", &provenance(second.clone()))];
    for (run, space) in runs.into_iter().zip([&first, &second]) {
        law(space, 20).iter().for_each(|entry| table.push(run, entry));
    }
    let shape = column(&table, "shape");
    assert_eq!(shape.levels, ["box", "sphere", "cone"]);
    assert!(shape.values()[20..].iter().all(|code| *code >= 1.0));
    let names: Vec<&str> = table.columns().iter().map(|column| column.name.as_str()).collect();
    let mut distinct = names.clone();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), names.len(), "{names:?}");
    assert_eq!(column(&table, "run").levels, ["a", "b"]);
    table.clear();
    assert_eq!((table.rows(), column(&table, "shape").levels.len()), (0, 3));
}

#[test]
fn twins_equal_those_of_the_report() {
    let space = space(&["box", "sphere"]);
    let entries = law(&space, 400);
    let mut table = ExplorerTable::new(usize::MAX);
    let run = table.add_run("a", &provenance(space.clone()));
    entries.iter().for_each(|entry| table.push(run, entry));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rows.parquet");
    write(&path, &space, entries.clone());
    let source = Source::open(&path).unwrap();
    let analysis = Analysis::of(&source, &path, &[]).unwrap();
    let watched = worth_watching(&source, &analysis, 12).unwrap();
    let failed: Vec<_> = watched.iter().filter_map(|one| Some((one.episode.index, one.twin.as_ref()?))).collect();
    assert!(failed.len() > 2, "{watched:?}");
    for (index, twin) in failed {
        let found = table.passing_twin(run, index).unwrap();
        assert_eq!((found.index, &found.differences), (twin.episode.index, &twin.differences), "episode {index}");
    }
    let passed = entries.iter().find(|entry| entry.episode.outcome == Outcome::Success).unwrap();
    assert_eq!(table.passing_twin(run, passed.index()), None);
    assert_eq!(table.passing_twin(run, 400), None, "an episode that does not exist");
    assert_eq!(table.passing_twin(1, 0), None, "a run that does not exist");
}

#[test]
fn samples_are_even() {
    let space = space(&["box"]);
    let mut table = ExplorerTable::new(usize::MAX);
    let run = table.add_run("a", &provenance(space.clone()));
    law(&space, 900).iter().for_each(|entry| table.push(run, entry));
    assert_eq!(table.sample(900), (0..900).collect::<Vec<_>>());
    let rows = table.sample(300);
    assert!(rows.len() == 300 && rows.is_sorted() && rows == table.sample(300));
    // Each third of the rows has about a third of the sample.
    for part in 0..3 {
        let n = rows.iter().filter(|row| **row / 300 == part).count();
        assert!((75..=125).contains(&n), "part {part}: {n}");
    }
}

#[test]
fn full_table_keeps_a_random_half() {
    let space = space(&["box", "sphere"]);
    let entries = law(&space, 1000);
    let fill = |most: usize, entries: &mut dyn Iterator<Item = &robogate_dictionary::Entry>| {
        let mut table = ExplorerTable::new(most);
        let run = table.add_run("a", &provenance(space.clone()));
        entries.for_each(|entry| table.push(run, entry));
        table
    };
    let whole = fill(1000, &mut entries.iter());
    let table = fill(300, &mut entries.iter());
    assert_eq!((whole.rows(), whole.halvings(), table.halvings()), (1000, 0, 2));
    assert!((180..300).contains(&table.rows()), "{}", table.rows());
    assert!(table.columns().iter().all(|column| column.values().len() == table.rows()));
    // The counts are those of all valid episodes.
    let count =
        |which: fn(&Outcome) -> bool| entries.iter().filter(|entry| which(&entry.episode.outcome)).count() as u64;
    let n = count(|outcome| !matches!(outcome, Outcome::Invalid(_)));
    let k = count(|outcome| *outcome == Outcome::Success);
    assert_eq!((table.counts(0).n, table.counts(0).k), (n, k));
    assert_eq!((table.counts(0), table.counts(1).n), (whole.counts(0), 0));
    // Another order of arrival gives the same sample.
    let sorted = |table: &ExplorerTable| {
        let mut indices: Vec<u64> = column(table, "index").values().iter().map(|index| *index as u64).collect();
        indices.sort_unstable();
        indices
    };
    assert_eq!(sorted(&table), sorted(&fill(300, &mut entries.iter().rev())));
    // The rows are whole.
    let friction = column(&table, "friction").values();
    for (row, index) in column(&table, "index").values().iter().enumerate() {
        let expected = entries[*index as usize].episode.scenario.requested.number("friction").unwrap() as f32;
        assert_eq!(friction[row].to_bits(), expected.to_bits());
    }
}
