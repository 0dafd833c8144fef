//! Tests of the journal: append, repair, locking and interruption.

use std::fs::{self, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};

use crate::common::{Folder, PLAN, entry, same, strange_entry, task};
use robogate_core::Seed;
use robogate_dictionary::frame::{Frames, encode_frame};
use robogate_dictionary::{DictionaryError, Entry, Journal, JournalTail, Recovery, dataset_hash};

/// Creates a journal with the entries of these indices. Also returns the end of each record.
fn journal(path: &std::path::Path, indices: impl IntoIterator<Item = u64>) -> Vec<u64> {
    let mut journal = Journal::create(path, &PLAN).unwrap();
    let mut ends = vec![fs::metadata(path).unwrap().len()];
    for index in indices {
        journal.append(&entry(index)).unwrap();
        ends.push(fs::metadata(path).unwrap().len());
    }
    journal.sync().unwrap();
    ends
}

#[test]
fn episodes_come_back_bit_for_bit() {
    let folder = Folder::new("journal-order");
    let path = folder.join("j");
    let mut written = Journal::create(&path, &PLAN).unwrap();
    let order = [3, 0, 7, 1, u64::MAX, 5];
    for index in order {
        let entry = if index % 2 == 0 { entry(index) } else { strange_entry(index) };
        written.append(&entry).unwrap();
        assert!(same(&written.read(index).unwrap().unwrap(), &entry));
    }
    drop(written);
    let (mut read, recovery) = Journal::open(&path, &PLAN).unwrap();
    assert_eq!(recovery, Recovery::default());
    assert_eq!(read.len(), 6);
    assert_eq!(read.indices().collect::<Vec<_>>(), [0, 1, 3, 5, 7, u64::MAX]);
    assert!(read.contains(7) && !read.contains(2));
    assert_eq!(read.read(2).unwrap(), None);
    for found in read.ordered() {
        let found = found.unwrap();
        let index = found.index();
        assert!(same(&found, &if index % 2 == 0 { entry(index) } else { strange_entry(index) }));
    }
}

#[test]
fn extend_equals_single_appends() {
    let folder = Folder::new("journal-extend");
    let (one, many) = (folder.join("one"), folder.join("many"));
    let order = [9, 3, 0, 7, 1, 5];
    journal(&one, order);
    let mut extended = Journal::create(&many, &PLAN).unwrap();
    extended.append(&entry(9)).unwrap();
    let rest = order[1..].iter().map(|index| Ok::<_, DictionaryError>(entry(*index)));
    extended.extend(rest).unwrap();
    assert_eq!(extended.indices().collect::<Vec<_>>(), [0, 1, 3, 5, 7, 9]);
    assert!(same(&extended.read(7).unwrap().unwrap(), &entry(7)));
    drop(extended);
    assert!(fs::read(&one).unwrap() == fs::read(&many).unwrap());
    assert_eq!(Journal::open(&many, &PLAN).unwrap().0.len(), 6);
}

#[test]
fn failed_extend_changes_nothing() {
    let folder = Folder::new("journal-extend-fails");
    let path = folder.join("j");
    journal(&path, [4, 2]);
    let before = fs::read(&path).unwrap();
    let (mut opened, _) = Journal::open(&path, &PLAN).unwrap();
    let twice = [entry(3), entry(2)].map(Ok::<_, DictionaryError>);
    assert!(matches!(opened.extend(twice), Err(DictionaryError::Duplicate { index: 2, .. })));
    let source_fails = [Ok(entry(1)), Err(DictionaryError::TooLarge { index: 0 })];
    assert!(matches!(opened.extend(source_fails), Err(DictionaryError::TooLarge { .. })));
    assert_eq!(opened.indices().collect::<Vec<_>>(), [2, 4]);
    assert!(fs::read(&path).unwrap() == before);
    opened.append(&entry(0)).unwrap();
    assert_eq!(opened.indices().collect::<Vec<_>>(), [0, 2, 4]);
}

#[test]
fn frames_survive_no_change() {
    let mut bytes = Vec::new();
    let entries = [entry(3), strange_entry(1)];
    entries.iter().for_each(|entry| encode_frame(entry, &mut bytes).unwrap());
    let read: Vec<Entry> = Frames::new(&bytes).map(Result::unwrap).collect();
    assert!(read.iter().zip(&entries).all(|(a, b)| same(a, b)) && read.len() == 2);
    for at in 0..bytes.len() {
        let mut flipped = bytes.clone();
        flipped[at] ^= 1;
        assert!(Frames::new(&flipped).any(|entry| entry.is_err()), "byte {at}");
    }
    assert!(Frames::new(&bytes[..bytes.len() - 1]).any(|entry| entry.is_err()));
    let mut heavy = entry(2);
    heavy.weight = f64::NAN;
    assert!(encode_frame(&heavy, &mut bytes).is_err());
    assert_eq!(Frames::new(&bytes).count(), 2);
}

#[test]
fn unfinished_record_is_cut_off() {
    let folder = Folder::new("journal-cut");
    let path = folder.join("whole");
    let ends = journal(&path, 0..4);
    let whole = fs::read(&path).unwrap();
    for cut in ends[3]..ends[4] {
        let path = folder.join("cut");
        fs::write(&path, &whole[..cut as usize]).unwrap();
        let (mut journal, recovery) = Journal::open(&path, &PLAN).unwrap();
        assert_eq!(recovery.dropped_bytes, cut - ends[3]);
        assert_eq!(journal.indices().collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(fs::metadata(&path).unwrap().len(), ends[3]);
        journal.append(&entry(3)).unwrap();
        drop(journal);
        assert!(fs::read(&path).unwrap() == whole, "cut at {cut}");
        fs::remove_file(&path).unwrap();
    }
}

#[test]
fn truncated_journal_keeps_whole_records() {
    let folder = Folder::new("journal-cut-anywhere");
    let path = folder.join("whole");
    let ends = journal(&path, [2, 0, 1]);
    let whole = fs::read(&path).unwrap();
    for cut in 0..whole.len() {
        let path = folder.join("cut");
        fs::write(&path, &whole[..cut]).unwrap();
        let (mut journal, _) = Journal::open(&path, &PLAN).unwrap();
        let kept = ends[1..].iter().filter(|end| **end <= cut as u64).count();
        assert_eq!(journal.len(), kept as u64, "cut at {cut}");
        assert_eq!(journal.ordered().filter(Result::is_ok).count(), kept);
        fs::remove_file(&path).unwrap();
    }
}

#[test]
fn trailing_zeros_are_cut_off() {
    let folder = Folder::new("journal-zeros");
    let path = folder.join("j");
    let ends = journal(&path, 0..3);
    OpenOptions::new().append(true).open(&path).unwrap().write_all(&[0; 5000]).unwrap();
    let (journal, recovery) = Journal::open(&path, &PLAN).unwrap();
    assert_eq!((journal.len(), recovery.dropped_bytes), (3, 5000));
    assert_eq!(fs::metadata(&path).unwrap().len(), ends[3]);
}

/// After a power failure a file may have later data without the data before it.
#[test]
fn lost_writes_end_the_journal() {
    let folder = Folder::new("journal-holes");
    let path = folder.join("whole");
    let ends = journal(&path, 0..6);
    let whole = fs::read(&path).unwrap();
    let path = folder.join("holes");
    // A whole record, several of them, and a page that begins and ends within records.
    let (second, third) = (ends[1] as usize, ends[2] as usize);
    for hole in [second..third, second..ends[4] as usize, second + 40..third + 5] {
        let mut lost = whole.clone();
        lost[hole.clone()].fill(0);
        fs::write(&path, &lost).unwrap();
        let (journal, recovery) = Journal::open(&path, &PLAN).unwrap();
        assert_eq!((journal.len(), recovery.dropped_bytes), (1, whole.len() as u64 - ends[1]), "{hole:?}");
        drop(journal);
        fs::remove_file(&path).unwrap();
    }
}

#[test]
fn flipped_bits_name_their_record() {
    let folder = Folder::new("journal-flip");
    let path = folder.join("whole");
    let ends = journal(&path, 0..4);
    let whole = fs::read(&path).unwrap();
    let path = folder.join("flipped");
    for byte in 0..ends[3] {
        let mut flipped = whole.clone();
        flipped[byte as usize] ^= 1 << (byte % 8);
        fs::write(&path, &flipped).unwrap();
        let error = Journal::open(&path, &PLAN).expect_err("a flipped bit");
        match error {
            DictionaryError::NotAJournal { .. } => assert!(byte < ends[0]),
            DictionaryError::DamagedJournal { offset, intact, .. } => {
                assert_eq!(offset, ends[intact as usize]);
                assert!((offset..ends[intact as usize + 1]).contains(&byte), "{byte} in the record at {offset}");
            }
            other => panic!("{other}"),
        }
        // Opening did not change the file.
        assert!(fs::read(&path).unwrap() == flipped);
    }
}

#[test]
fn truncation_hint_works() {
    let folder = Folder::new("journal-hint");
    let path = folder.join("j");
    let ends = journal(&path, 0..4);
    let mut bytes = fs::read(&path).unwrap();
    bytes[ends[2] as usize + 40] ^= 4;
    fs::write(&path, &bytes).unwrap();
    let error = Journal::open(&path, &PLAN).unwrap_err();
    let DictionaryError::DamagedJournal { offset, intact, .. } = error else { panic!("{error}") };
    assert_eq!((offset, intact), (ends[2], 2));
    assert!(error.to_string().contains(&format!("byte {offset}")), "{error}");
    OpenOptions::new().write(true).open(&path).unwrap().set_len(offset).unwrap();
    assert_eq!(Journal::open(&path, &PLAN).unwrap().0.len(), 2);
}

#[test]
fn duplicate_episode_is_rejected() {
    let folder = Folder::new("journal-once");
    let mut journal = Journal::create(&folder.join("j"), &PLAN).unwrap();
    journal.append(&entry(1)).unwrap();
    assert!(matches!(journal.append(&entry(1)), Err(DictionaryError::Duplicate { index: 1, .. })));
    assert_eq!(journal.len(), 1);
}

#[test]
fn second_writer_is_rejected() {
    let folder = Folder::new("journal-lock");
    let path = folder.join("j");
    let journal = Journal::create(&path, &PLAN).unwrap();
    assert!(matches!(Journal::open(&path, &PLAN), Err(DictionaryError::Locked { .. })));
    assert!(matches!(Journal::create(&path, &PLAN), Err(DictionaryError::Io { .. })));
    drop(journal);
    assert!(Journal::open(&path, &PLAN).is_ok());
}

#[test]
fn invalid_weight_or_seed_is_rejected() {
    let folder = Folder::new("journal-refuse");
    let mut journal = Journal::create(&folder.join("j"), &PLAN).unwrap();
    for weight in [f64::NAN, f64::INFINITY, -1.0] {
        let wrong = Entry { weight, ..entry(0) };
        assert!(matches!(journal.append(&wrong), Err(DictionaryError::Weight { index: 0, .. })));
    }
    let mut wrong = entry(0);
    wrong.episode.scenario.seed = Seed::campaign(1).episode(9);
    assert!(matches!(journal.append(&wrong), Err(DictionaryError::ForeignSeed { index: 0 })));
    assert!(journal.is_empty());
}

#[test]
fn newer_journal_asks_for_upgrade() {
    let folder = Folder::new("journal-version");
    let path = folder.join("j");
    journal(&path, 0..1);
    let mut bytes = fs::read(&path).unwrap();
    bytes[8] = 4;
    fs::write(&path, bytes).unwrap();
    let error = Journal::open(&path, &PLAN).unwrap_err().to_string();
    assert!(error.contains("upgrade"), "{error}");
}

/// The child process of the tests below: appends entries to the journal named by the environment variable until it is
/// killed or a write fails, and prints their number.
#[test]
#[ignore = "run by other tests"]
fn writer() {
    let path = std::env::var_os("ROBOGATE_TEST_JOURNAL").expect("set by the test that runs this");
    let path = std::path::Path::new(&path);
    let mut journal =
        if path.exists() { Journal::open(path, &PLAN).unwrap().0 } else { Journal::create(path, &PLAN).unwrap() };
    for index in journal.len().. {
        if let Err(error) = journal.append(&entry(index)) {
            println!("stopped at {index}: {error}");
            // Repeated: a full disk stays full, and the journal stays intact.
            assert!(journal.append(&entry(index)).is_err());
            assert_eq!(journal.ordered().map(Result::unwrap).count() as u64, index);
            return;
        }
        println!("appended {index}");
    }
}

#[test]
fn killed_writer_loses_nothing() {
    let folder = Folder::new("journal-kill");
    let path = folder.join("j");
    let mut most = 0;
    for round in 0..20_u64 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["journal::writer", "--exact", "--ignored", "--nocapture"])
            .env("ROBOGATE_TEST_JOURNAL", &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
        let appended = |line: String| line.rsplit_once("appended ").map(|(_, index)| index.parse::<u64>().unwrap());
        let first = lines.by_ref().find_map(appended).unwrap();
        assert_eq!(first, most);
        let mut last = first;
        for _ in 0..(round * 37) % 101 {
            last = lines.by_ref().find_map(appended).unwrap();
        }
        child.kill().unwrap();
        child.wait().unwrap();
        last = lines.filter_map(appended).last().unwrap_or(last);
        let (journal, _) = Journal::open(&path, &PLAN).unwrap();
        most = journal.len();
        assert!(most > last, "{most} in the journal, {last} was appended");
    }
    let (mut journal, _) = Journal::open(&path, &PLAN).unwrap();
    let undisturbed = dataset_hash(task(), (0..most).map(|index| Ok(entry(index)))).unwrap();
    assert_eq!(dataset_hash(task(), journal.ordered()).unwrap(), undisturbed);
}

#[test]
#[cfg(target_os = "linux")]
fn full_disk_keeps_the_journal() {
    let folder = Folder::new("journal-full");
    let path = folder.join("j");
    // A limit on the file size, in blocks of 512 or 1024 bytes, simulates a full disk: the write that reaches it is cut
    // short, and the next one fails.
    let output = Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 20; exec \"$0\" journal::writer --exact --ignored --nocapture"])
        .arg(std::env::current_exe().unwrap())
        .env("ROBOGATE_TEST_JOURNAL", &path)
        .output()
        .unwrap();
    let output = String::from_utf8_lossy(&output.stdout);
    assert!(output.contains("stopped at") && output.contains("1 passed"), "{output}");
    let (mut journal, recovery) = Journal::open(&path, &PLAN).unwrap();
    assert_eq!(recovery.dropped_bytes, 0);
    let n = journal.len();
    assert!(n > 10);
    journal.append(&entry(n)).unwrap();
    let undisturbed = dataset_hash(task(), (0..=n).map(|index| Ok(entry(index)))).unwrap();
    assert_eq!(dataset_hash(task(), journal.ordered()).unwrap(), undisturbed);
}

/// The indices of the entries that a tail has not passed on yet.
fn arrived(tail: &mut JournalTail) -> Result<Vec<u64>, DictionaryError> {
    let mut indices = Vec::new();
    tail.read(&mut |entry| indices.push(entry.index()))?;
    Ok(indices)
}

#[test]
fn tail_follows_an_open_journal() {
    let folder = Folder::new("journal-tail");
    let path = folder.join("j");
    let mut tail = JournalTail::new(&path, &PLAN);
    assert_eq!(arrived(&mut tail).unwrap(), [0; 0], "the file does not exist yet");
    // The writer holds its lock all the time.
    let mut written = Journal::create(&path, &PLAN).unwrap();
    assert_eq!(arrived(&mut tail).unwrap(), [0; 0]);
    for index in [4, 2] {
        written.append(&entry(index)).unwrap();
    }
    assert_eq!(arrived(&mut tail).unwrap(), [4, 2]);
    written.append(&strange_entry(7)).unwrap();
    assert_eq!(arrived(&mut tail).unwrap(), [7]);
    assert_eq!(arrived(&mut tail).unwrap(), [0; 0]);
    assert!(same(&tail.entry(7).unwrap().unwrap(), &strange_entry(7)));
    assert!(same(&tail.entry(4).unwrap().unwrap(), &entry(4)));
    assert!(tail.entry(5).unwrap().is_none());
    assert_eq!(tail.len(), 3);
}

#[test]
fn tail_waits_for_the_rest_of_a_record() {
    let folder = Folder::new("journal-tail-cut");
    let (whole, path) = (folder.join("whole"), folder.join("j"));
    let ends = journal(&whole, 0..3);
    let bytes = fs::read(&whole).unwrap();
    // A reader sees any prefix of what a writer writes, the header included.
    for cut in 0..bytes.len() {
        fs::write(&path, &bytes[..cut]).unwrap();
        let mut tail = JournalTail::new(&path, &PLAN);
        let complete = ends.iter().skip(1).filter(|end| **end <= cut as u64).count() as u64;
        assert_eq!(arrived(&mut tail).unwrap().len() as u64, complete, "{cut}");
        fs::write(&path, &bytes).unwrap();
        assert_eq!(arrived(&mut tail).unwrap(), (complete..3).collect::<Vec<_>>(), "{cut}");
    }
}

#[test]
fn tail_reports_damage_and_other_plans() {
    let folder = Folder::new("journal-tail-damage");
    let path = folder.join("j");
    let ends = journal(&path, 0..3);
    let mut tail = JournalTail::new(&path, &PLAN);
    arrived(&mut tail).unwrap();
    OpenOptions::new().write(true).open(&path).unwrap().set_len(ends[1]).unwrap();
    assert!(matches!(arrived(&mut tail), Err(DictionaryError::DamagedJournal { intact: 3, .. })));
    let mut bytes = fs::read(&path).unwrap();
    bytes[ends[0] as usize + 20] ^= 1;
    bytes.extend_from_slice(&[7; 40]);
    fs::write(&path, &bytes).unwrap();
    let error = arrived(&mut JournalTail::new(&path, &PLAN)).unwrap_err();
    assert!(matches!(error, DictionaryError::DamagedJournal { intact: 0, .. }), "{error}");
    let error = arrived(&mut JournalTail::new(&path, &[9; 32])).unwrap_err();
    assert!(matches!(error, DictionaryError::OtherPlan { .. }), "{error}");
    fs::write(&path, "no journal at all, but long enough for a header of one").unwrap();
    let error = arrived(&mut JournalTail::new(&path, &PLAN)).unwrap_err();
    assert!(matches!(error, DictionaryError::NotAJournal { .. }), "{error}");
}
