//! Prints a ranking.

use robogate_gate::{RankedPolicy, Ranking};
use robogate_stats::format::{percent_or_dash, percent_range, points, points_range};

use crate::exit::Exit;
use crate::terminal::{bold, dim, grouped, line, wrapped};

/// Policies in the table of the terminal. `--json` has all of them.
const MOST_ROWS: usize = 14;
/// Columns of a name.
const NAME: usize = 24;

/// Prints the ranking, and returns the exit code.
pub(super) fn show(ranking: &Ranking, json: bool) -> Result<u8, Exit> {
    if json {
        line(ranking.to_json().trim_end());
    } else {
        print(ranking);
    }
    Ok(ranking.verdict().exit_code())
}

fn print(ranking: &Ranking) {
    line(bold(ranking.headline()));
    wrapped(&ranking.scenarios);
    line("");
    let by_stage = ranking.policies.iter().any(|policy| policy.stage.is_some());
    let head = if by_stage { format!("{:>8}  ", "stages") } else { String::new() };
    line(dim(format_args!(
        "  {:<NAME$} {:>7}  {:<18} {head}{:>8}  state",
        "policy", "rate", "95 % interval", "episodes"
    )));
    for policy in ranking.policies.iter().take(MOST_ROWS) {
        let stage = if by_stage { format!("{:>8}  ", percent_or_dash(policy.stage)) } else { String::new() };
        let text = format!(
            "  {:<NAME$} {:>7}  {:<18} {stage}{:>8}  {}",
            policy.name.chars().take(NAME).collect::<String>(),
            percent_or_dash(policy.rate),
            percent_range(policy.interval_95),
            grouped(policy.valid),
            state(policy)
        );
        if policy.dropped.is_some() { line(dim(text)) } else { line(text) }
    }
    if let Some(more @ 1..) = ranking.policies.len().checked_sub(MOST_ROWS) {
        line(dim(format_args!("  and {more} more, all of them with --json")));
    }
    line("");
    if let Some((names, [difference, low, high])) = ranking.first_difference() {
        let all = ranking.differences.len();
        let together = if all > 1 { format!(" for all {all} pairs together") } else { String::new() };
        let (difference, range) = (points(difference), points_range([low, high]));
        let groups = match ranking.differences.iter().find_map(|pair| pair.clusters) {
            Some(_) => {
                " Each group of dependent episodes counts once, so this need not be the difference of the rates."
            }
            None => "",
        };
        let what = if by_stage {
            " That is the share of scenarios in which the first got further minus that in which the second did."
        } else {
            ""
        };
        wrapped(&format!("{names}: {difference} points, {range} (95 %{together}).{what}{groups}"));
    }
    wrapped(&ranking.statement());
    let invalid: u64 = ranking.policies.iter().map(|policy| policy.invalid).sum();
    if invalid > 0 {
        wrapped(&format!("{} invalid episodes are left out of every rate and difference.", grouped(invalid)));
    }
}

fn state(policy: &RankedPolicy) -> String {
    match &policy.dropped {
        None => "best set".to_owned(),
        Some(out) => match out.round {
            Some(round) => format!("dropped after round {round}: {} is better", out.by),
            None => format!("dropped: {} is better", out.by),
        },
    }
}
