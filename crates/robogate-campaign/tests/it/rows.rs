//! Rows that are not those of their plan are detected.

use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{Plan, RowsError, check_rows};
use robogate_core::{Outcome, Value};
use robogate_dictionary::{Dictionary, DictionaryError, Entry, Provenance};

use crate::world::{Synthetic, plan, start};

fn rows_of(plan: &Plan) -> (Provenance, Vec<Entry>) {
    let base = tempfile::tempdir().unwrap();
    start(base.path(), plan, &Synthetic::default(), 2).unwrap();
    let dictionary = Dictionary::open(&base.path().join(DICTIONARY)).unwrap();
    (dictionary.provenance().clone(), dictionary.entries().collect::<Result<_, _>>().unwrap())
}

fn check(provenance: &Provenance, rows: &[Entry]) -> Result<u64, RowsError> {
    check_rows(provenance, None, rows.iter().cloned().map(Ok::<_, DictionaryError>))
}

#[test]
fn own_rows_are_accepted() {
    for plan in [plan(60, 30), plan(40, 0)] {
        let (provenance, rows) = rows_of(&plan);
        assert_eq!(check(&provenance, &rows).unwrap(), rows.len() as u64);
    }
}

#[test]
fn missing_rows_are_detected() {
    let (provenance, rows) = rows_of(&plan(60, 30));
    for left_out in [0, 17, 59, 60, 80] {
        let rest: Vec<Entry> = rows.iter().filter(|row| row.index() != left_out).cloned().collect();
        let error = check(&provenance, &rest).unwrap_err();
        assert!(matches!(error, RowsError::Missing { index } if index == left_out), "{error}");
    }
    let error = check(&provenance, &rows[..89]).unwrap_err();
    assert!(matches!(error, RowsError::Count { found: 89, expected: 90 }), "{error}");
}

#[test]
fn foreign_rows_are_detected() {
    let (provenance, rows) = rows_of(&plan(60, 30));
    let changes: [fn(&mut Entry); 5] = [
        |row| row.weight = 0.5,
        |row| row.stage = "suite".to_owned(),
        |row| row.label.case = Some("easy".to_owned()),
        |row| row.episode.scenario.seed = robogate_core::Seed::campaign(99).episode(3),
        |row| {
            let name = row.episode.scenario.requested.iter().next().unwrap().0.to_owned();
            row.episode.scenario.requested.set(name.as_str(), Value::Number(0.123));
        },
    ];
    for change in changes {
        let mut forged = rows.clone();
        change(&mut forged[3]);
        let error = check(&provenance, &forged).unwrap_err();
        assert!(matches!(error, RowsError::Foreign { index: 3 }), "{error}");
    }
    // Another first stage gives another boundary, so the second stage no longer follows from it.
    let mut invented = rows.clone();
    invented[..60].iter_mut().for_each(|row| row.episode.outcome = Outcome::Success);
    assert!(matches!(check(&provenance, &invented), Err(RowsError::Foreign { .. } | RowsError::Run(_))));
    let foreign = Provenance { plan: serde_json::json!({ "n": 3 }), ..provenance };
    assert!(matches!(check(&foreign, &rows), Err(RowsError::NoPlan(_))));
}
