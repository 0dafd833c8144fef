//! The store: restarts, retention, a full disk.

use std::sync::{Arc, Mutex};

use robogate_monitor::service::{HttpSettings, IntakeError, Store, StoreError, StoreSettings};

use crate::common::{Service, cycles, get, intake, post};

#[test]
fn restarts_continue_the_statistics() {
    let folder = tempfile::tempdir().unwrap();
    let batches: Vec<String> = (0..60).map(|i| cycles(20 * i..20 * i + 20, if i < 40 { 0.05 } else { 0.4 })).collect();
    let mut whole = intake(&folder.path().join("whole.db"), StoreSettings::default());
    for batch in &batches {
        whole.take(&[batch.as_bytes()]).unwrap();
    }
    let path = folder.path().join("parts.db");
    for (i, batch) in batches.iter().enumerate() {
        // Every second run ends without the shutdown that writes the states.
        let mut part = intake(&path, StoreSettings::default());
        part.take(&[batch.as_bytes()]).unwrap();
        if i % 2 == 0 {
            part.close().unwrap();
        }
    }
    let parts = intake(&path, StoreSettings::default());
    assert!(whole.monitor() == parts.monitor());
    assert!(whole.monitor().recipes().any(|(_, recipe)| recipe.level().is_some()));
}

#[test]
fn full_disks_refuse_whole_batches() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("monitor.db");
    let small = StoreSettings { most_mib: 1, ..StoreSettings::default() };
    let mut full = intake(&path, small);
    let mut kept = 0;
    let error = (0..200).find_map(|i| match full.take(&[cycles(100 * i..100 * i + 100, 0.05).as_bytes()]) {
        Ok(_) => {
            kept = 100 * i + 100;
            None
        }
        Err(error) => Some(error),
    });
    assert!(matches!(error, Some(IntakeError::Store(StoreError::Full))), "{error:?}");
    let counted = |intake: &robogate_monitor::service::Intake| -> u64 {
        intake.monitor().recipes().map(|(_, recipe)| recipe.trials().n()).sum()
    };
    assert!(kept > 100);
    assert_eq!(counted(&full), kept);
    drop(full);
    // After space was freed, it continues where it stopped.
    let mut again = intake(&path, StoreSettings::default());
    assert_eq!(counted(&again), kept);
    let taken = again.take(&[cycles(kept - 100..kept + 100, 0.05).as_bytes()]).unwrap();
    assert_eq!((taken[0].duplicates, taken[0].accepted), (100, 100));
}

#[test]
fn full_disks_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let small = StoreSettings { most_mib: 1, ..StoreSettings::default() };
    let messages = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&messages);
    let say = move |text: &str| sink.lock().unwrap().push(text.to_owned());
    let service = Service::with(intake(&folder.path().join("monitor.db"), small), HttpSettings::default(), None, say);
    let to = service.address;
    assert_eq!(get(to, "/healthz").0, 200);
    let full = (0..200).find(|i| post(to, "/v1/cycles", &cycles(100 * i..100 * i + 100, 0.05), None).0 == 507);
    let kept = 100 * full.unwrap();
    let (status, health) = get(to, "/healthz");
    assert!(status == 507 && health.contains("full"), "{status} {health}");
    // Known cycles need no space. A successful write ends the problem.
    let (status, known) = post(to, "/v1/cycles", &cycles(kept - 100..kept, 0.05), None);
    assert_eq!((status, &known["duplicates"]), (200, &serde_json::json!(100)));
    assert_eq!(messages.lock().unwrap().len(), 2);
    assert!(messages.lock().unwrap()[0].starts_with("cycles are refused: the disk"), "{messages:?}");
    assert!(
        service.close().unwrap_err().contains("full"),
        "the statistics could not be written; they follow from the cycles"
    );
}

#[test]
fn old_cycles_are_deleted_and_statistics_kept() {
    let folder = tempfile::tempdir().unwrap();
    let keep = StoreSettings { keep_cycles: 500, ..StoreSettings::default() };
    let mut whole = intake(&folder.path().join("whole.db"), StoreSettings::default());
    let path = folder.path().join("few.db");
    let mut few = intake(&path, keep);
    for i in 0..40 {
        let batch = cycles(50 * i..50 * i + 50, 0.05);
        whole.take(&[batch.as_bytes()]).unwrap();
        few.take(&[batch.as_bytes()]).unwrap();
    }
    drop(few);
    let mut few = intake(&path, keep);
    assert!(whole.monitor() == few.monitor());
    // The id of the first cycle is deleted, that of the last one is kept.
    let taken = few.take(&[cycles(0..1, 0.05).as_bytes(), cycles(1_999..2_000, 0.05).as_bytes()]).unwrap();
    assert_eq!((taken[0].accepted, taken[1].duplicates), (1, 1));
}

#[test]
fn used_and_foreign_stores_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("monitor.db");
    let held = intake(&path, StoreSettings::default());
    assert!(matches!(Store::open(&path, StoreSettings::default()), Err(StoreError::InUse)));
    drop(held);
    let text = folder.path().join("notes.txt");
    std::fs::write(&text, "this is no database, but it is longer than a header of one hundred bytes".repeat(9))
        .unwrap();
    assert!(Store::open(&text, StoreSettings::default()).is_err());
}
