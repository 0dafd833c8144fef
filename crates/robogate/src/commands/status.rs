//! The progress of a campaign in shards.

use std::path::Path;

use robogate_campaign::shards::{RoundState, RoundStatus, ShardStatus};

use crate::commands::shard::open;
use crate::exit::{DONE, Exit, OrExit};
use crate::summary::outcomes_in_one_line;
use crate::terminal::{bold, grouped, line, note};
use robogate_session::text::quoted;

/// Prints which shards are committed, and their outcomes so far.
pub(crate) fn print(dir: &Path, json: bool) -> Result<u8, Exit> {
    let status = open(dir)?.status()?;
    if json {
        line(serde_json::to_string_pretty(&status).or_broken()?);
        return Ok(DONE);
    }
    let ShardStatus { shards, episodes, done, complete, rounds, .. } = &status;
    line(format_args!("{} of {} episodes in committed shards", grouped(*done), grouped(*episodes)));
    // A suite may have thousands of rounds that wait.
    for round in rounds.iter().filter(|round| round.state != RoundState::Waiting || round.committed > 0) {
        show(round, *shards);
    }
    let waiting = rounds.iter().filter(|round| round.state == RoundState::Waiting).count();
    if waiting > 0 {
        line(format_args!("{waiting} more round{} after that", if waiting == 1 { "" } else { "s" }));
    }
    let verb = if *complete { "merge" } else { "plan" };
    let option = if *complete { "" } else { " --next" };
    note(format_args!("next: robogate {verb} {}{option}", quoted(dir)));
    Ok(DONE)
}

fn show(round: &RoundStatus, shards: u32) {
    line(format_args!(
        "{}  {} of {shards} shards, {} of {} episodes",
        bold(format_args!("{:<9}", round.round.to_string())),
        round.committed,
        grouped(round.done),
        grouped(round.episodes)
    ));
    if round.done > 0 {
        line(format_args!("           {}", outcomes_in_one_line(&round.outcomes)));
    }
    if !round.missing.is_empty() {
        line(format_args!("           missing: {}", ranges(&round.missing)));
    }
}

/// Sorted numbers as a list of ranges: `0, 3-7, 9`.
fn ranges(numbers: &[u32]) -> String {
    let parts = numbers.chunk_by(|a, b| a + 1 == *b).map(|run| match run {
        [first, .., last] => format!("{first}-{last}"),
        _ => run.iter().map(ToString::to_string).collect(),
    });
    parts.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::ranges;

    #[test]
    fn consecutive_numbers_become_ranges() {
        assert_eq!(ranges(&[0, 3, 4, 5, 7, 9, 10]), "0, 3-5, 7, 9-10");
        assert_eq!(ranges(&[6]), "6");
    }
}
