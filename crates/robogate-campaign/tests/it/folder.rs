//! Tests of folders with unexpected contents.

use std::fs;

use robogate_campaign::{RunError, settings};
use robogate_dictionary::{Build, DictionaryError, Place, Provenance, World};

use crate::world::{Synthetic, files, plan, provenance, resume, start, stop_after, with_pool};

fn interrupted(dir: &std::path::Path) {
    let mut stop = stop_after(10);
    with_pool(&Synthetic::default(), 1, &mut stop, |pool, events| {
        robogate_campaign::start(dir, &plan(20, 10), provenance(), pool, events)
    })
    .unwrap();
}

#[test]
fn foreign_folder_is_rejected() {
    let base = tempfile::tempdir().unwrap();
    fs::write(base.path().join("thesis.tex"), "mine").unwrap();
    let error = start(base.path(), &plan(5, 0), &Synthetic::default(), 1).unwrap_err();
    assert!(matches!(&error, RunError::NotEmpty { name, .. } if name == "thesis.tex"), "{error}");
    assert_eq!(files(base.path()).len(), 1);
}

#[test]
fn existing_run_is_not_overwritten() {
    let base = tempfile::tempdir().unwrap();
    interrupted(base.path());
    let before = files(base.path());
    let error = start(base.path(), &plan(20, 10), &Synthetic::default(), 1).unwrap_err();
    assert!(matches!(error, RunError::AlreadyARun { finished: false, .. }));
    assert!(error.to_string().contains("robogate resume"), "{error}");
    assert_eq!(files(base.path()), before);
    resume(base.path(), &Synthetic::default(), 1).unwrap();
    let error = start(base.path(), &plan(20, 10), &Synthetic::default(), 1).unwrap_err();
    assert!(matches!(error, RunError::AlreadyARun { finished: true, .. }));
    assert!(error.to_string().contains("choose another folder"), "{error}");
}

#[test]
fn partial_plan_file_is_ignored() {
    let base = tempfile::tempdir().unwrap();
    fs::write(base.path().join(".plan.json.part"), "{\"ver").unwrap();
    start(base.path(), &plan(5, 0), &Synthetic::default(), 1).unwrap();
    assert_eq!(files(base.path()).len(), 3);
}

#[test]
fn resume_needs_a_run() {
    let base = tempfile::tempdir().unwrap();
    for dir in [base.path().to_owned(), base.path().join("nowhere")] {
        let error = resume(&dir, &Synthetic::default(), 1).unwrap_err();
        assert!(matches!(error, RunError::NotARun { .. }) && error.to_string().contains("Hint: "), "{error}");
    }
}

#[test]
fn uncreatable_folder_is_located() {
    let base = tempfile::tempdir().unwrap();
    let file = base.path().join("file");
    fs::write(&file, "").unwrap();
    for dir in [file.join("run"), file.clone()] {
        let error = start(&dir, &plan(5, 0), &Synthetic::default(), 1).unwrap_err();
        assert!(matches!(error, RunError::Io { .. }) && error.to_string().contains("file"), "{error}");
    }
}

type Change = fn(&mut Provenance);

#[test]
fn changed_provenance_is_rejected() {
    let base = tempfile::tempdir().unwrap();
    interrupted(base.path());
    let before = files(base.path());
    let changes: [(&str, Change); 11] = [
        ("tool version", |p| p.tool.version = "9.9.9".to_owned()),
        ("engine version", |p| p.engine.version = None),
        ("engine build", |p| p.engine.build_sha256 = Some("00".to_owned())),
        ("robot", |p| p.robot.name = "ur5e".to_owned()),
        ("robot files", |p| p.robot.sha256 = Some("00".to_owned())),
        ("policy", |p| p.policy = "acts".to_owned()),
        ("world.place.engine", |p| p.world = Some(World::new(Place::SelfContained))),
        ("platform", |p| p.platform = None),
        ("C library", |p| p.platform.as_mut().unwrap().libc = Some("glibc 2.31".to_owned())),
        ("CPU features", |p| p.platform.as_mut().unwrap().cpu = Some(Vec::new())),
        ("source files of robogate", |p| p.build = Some(Build { source_sha256: "00".to_owned() })),
    ];
    for (name, change) in changes {
        let mut present = provenance();
        change(&mut present);
        let resumed = with_pool(&Synthetic::default(), 1, &mut |_, _| {}, |pool, events| {
            robogate_campaign::resume(base.path(), &present, pool, events)
        });
        let error = resumed.unwrap_err();
        assert!(matches!(&error, RunError::Mismatch { what, .. } if what == name), "{error}");
    }
    assert_eq!(files(base.path()), before);
}

#[test]
fn settings_round_trip() {
    let base = tempfile::tempdir().unwrap();
    interrupted(base.path());
    let settings = settings(base.path()).unwrap();
    assert_eq!(settings.plan, plan(20, 10));
    assert_eq!((settings.provenance.seed, &settings.provenance.robot), (7, &provenance().robot));
    assert_eq!(settings.provenance.plan, serde_json::to_value(plan(20, 10)).unwrap());
}

#[test]
fn other_file_versions_are_rejected() {
    let base = tempfile::tempdir().unwrap();
    interrupted(base.path());
    let path = base.path().join("plan.json");
    let text = fs::read_to_string(&path).unwrap();
    let before = files(base.path());
    for (version, hint) in [(3, "upgrade robogate"), (1, "the version of robogate that wrote it")] {
        fs::write(&path, text.replacen("\"version\": 2", &format!("\"version\": {version}"), 1)).unwrap();
        let error = resume(base.path(), &Synthetic::default(), 1).unwrap_err();
        assert!(matches!(error, RunError::OtherVersion { expected: 2, .. }), "{error}");
        assert!(error.to_string().contains(hint), "{error}");
    }
    fs::write(&path, text.replacen("\"seed\": 7", "\"seed\": 8", 1)).unwrap();
    let error = resume(base.path(), &Synthetic::default(), 1).unwrap_err();
    assert!(error.to_string().contains("contradict"), "{error}");
    fs::write(&path, &text[..text.len() / 2]).unwrap();
    let error = resume(base.path(), &Synthetic::default(), 1).unwrap_err();
    assert!(matches!(error, RunError::Unreadable { .. }) && error.to_string().contains("line"), "{error}");
    assert_eq!(files(base.path())["journal.rgj"], before["journal.rgj"]);
}

#[test]
fn foreign_journal_is_rejected() {
    let base = tempfile::tempdir().unwrap();
    let (ours, theirs) = (base.path().join("ours"), base.path().join("theirs"));
    interrupted(&ours);
    let mut other = plan(20, 10);
    other.seed = 8;
    let mut stop = stop_after(5);
    with_pool(&Synthetic::default(), 1, &mut stop, |pool, events| {
        robogate_campaign::start(&theirs, &other, provenance(), pool, events)
    })
    .unwrap();
    fs::copy(theirs.join("journal.rgj"), ours.join("journal.rgj")).unwrap();
    let error = resume(&ours, &Synthetic::default(), 1).unwrap_err();
    assert!(matches!(error, RunError::Dictionary(DictionaryError::OtherPlan { .. })), "{error}");
    // The same seed and scenarios, but another policy.
    let theirs = base.path().join("other policy");
    let other = Provenance { policy: "acts".to_owned(), ..provenance() };
    with_pool(&Synthetic::default(), 1, &mut stop_after(5), |pool, events| {
        robogate_campaign::start(&theirs, &plan(20, 10), other, pool, events)
    })
    .unwrap();
    fs::copy(theirs.join("journal.rgj"), ours.join("journal.rgj")).unwrap();
    let error = resume(&ours, &Synthetic::default(), 1).unwrap_err();
    assert!(matches!(error, RunError::Dictionary(DictionaryError::OtherPlan { .. })), "{error}");
}

/// A journal of version 2 does not name its plan.
#[test]
fn older_journal_is_rejected() {
    let base = tempfile::tempdir().unwrap();
    interrupted(base.path());
    let path = base.path().join("journal.rgj");
    let journal = fs::read(&path).unwrap();
    // Magic, version and CRC-32.
    let header = b"RGJOURNL\x02\0\0\0\xcc\x46\x81\x77";
    fs::write(&path, [header, &journal[48..]].concat()).unwrap();
    let error = resume(base.path(), &Synthetic::default(), 1).unwrap_err().to_string();
    assert!(error.contains("its version is 2. Expected 3") && error.contains("start it again"), "{error}");
}

#[test]
fn damaged_journal_error_has_hint() {
    let base = tempfile::tempdir().unwrap();
    interrupted(base.path());
    let path = base.path().join("journal.rgj");
    let mut bytes = fs::read(&path).unwrap();
    bytes[100] ^= 1;
    fs::write(&path, bytes).unwrap();
    let error = resume(base.path(), &Synthetic::default(), 1).unwrap_err();
    assert!(matches!(error, RunError::Dictionary(DictionaryError::DamagedJournal { .. })), "{error}");
}

/// A folder with a plan has the documents of its campaign. A process that was killed between them can be started again.
#[test]
fn documents_are_written_before_the_plan() {
    let base = tempfile::tempdir().unwrap();
    let documents: [(&str, &[u8]); 1] = [("gate-question.json", b"{}")];
    let begin = |dir: &std::path::Path| {
        let mut go_on = |_: &robogate_campaign::Round<'_>| std::ops::ControlFlow::Continue(());
        with_pool(&Synthetic::default(), 1, &mut |_, _| {}, |pool, events| {
            robogate_campaign::start_in_rounds(dir, &plan(5, 0), provenance(), &documents, pool, events, &mut go_on)
        })
    };
    fs::write(base.path().join("gate-question.json"), "half").unwrap();
    begin(base.path()).unwrap();
    assert_eq!(fs::read(base.path().join("gate-question.json")).unwrap(), b"{}");
    // A document that cannot be written leaves no plan.
    let other = base.path().join("other");
    fs::create_dir_all(other.join("gate-question.json")).unwrap();
    assert!(matches!(begin(&other), Err(RunError::Io { .. })));
    assert!(!other.join("plan.json").exists());
}
