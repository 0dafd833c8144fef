//! Measures the merge of a large campaign in shards.

use std::path::PathBuf;
use std::time::Instant;

use robogate_campaign::shards::{Assignment, DirectoryStore, ShardEnd, Shards};
use robogate_dictionary::Dictionary;

use crate::overhead::peak_memory_kb;
use crate::world::{Synthetic, plan, provenance, with_pool};

const DIR: &str = "ROBOGATE_MERGE_DIR";

/// The number of episodes: `ROBOGATE_MERGE_EPISODES`, or one million. A shard has 1,000 of them.
fn episodes() -> u64 {
    std::env::var("ROBOGATE_MERGE_EPISODES").map_or(1_000_000, |number| number.parse().unwrap())
}

/// Runs synthetic episodes in shards into the folder that `ROBOGATE_MERGE_DIR` names.
#[test]
#[ignore = "prepares the measurement below; run it in release"]
fn prepare_million_episodes() {
    let Some(dir) = std::env::var_os(DIR) else { return };
    let begin = Instant::now();
    let store = || Box::new(DirectoryStore::new(dir.as_ref()));
    let shards = u32::try_from(episodes() / 1000).unwrap();
    let campaign = Shards::begin(store(), shards, &plan(episodes(), 0), provenance()).unwrap();
    while let Some(open) = campaign.open_round(None).unwrap() {
        for index in open.missing {
            let Assignment::Run(task) = campaign.assign(index, None).unwrap() else { panic!() };
            let end = with_pool(&Synthetic::default(), 1, &mut |_, _| {}, |pool, events| task.run(pool, events));
            let ShardEnd::Complete(result) = end.unwrap() else { panic!() };
            campaign.commit(&result).unwrap();
        }
    }
    println!("{shards} shards: {:.0} s", begin.elapsed().as_secs_f64());
}

/// Prints the time and the peak memory of the merge of these shards, in a process that does nothing else.
#[test]
#[ignore = "a measurement; run it in release, alone, after prepare_million_episodes"]
fn merge_million_episodes() {
    let Some(dir) = std::env::var_os(DIR) else { return };
    let temporary = tempfile::tempdir().unwrap();
    // Another measurement may need the merged files.
    let kept = std::env::var_os("ROBOGATE_MERGE_OUT").map(PathBuf::from);
    let out = kept.as_deref().unwrap_or_else(|| temporary.path());
    let begin = Instant::now();
    let campaign = Shards::open(Box::new(DirectoryStore::new(dir.as_ref()))).unwrap();
    campaign.merge(out, &mut |_| {}, None).unwrap();
    let seconds = begin.elapsed().as_secs_f64();
    println!("merge: {seconds:.1} s; peak memory of the process {} kB", peak_memory_kb().unwrap_or_default());
    let rows = Dictionary::open(&out.join("dictionary.parquet")).unwrap().entries().count();
    assert_eq!(rows as u64, episodes());
}
