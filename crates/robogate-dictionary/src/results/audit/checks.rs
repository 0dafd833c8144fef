//! The checks of an audit.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value};

use super::table::{AuditRow, Table};
use super::{Check, Problem};

/// Number of rows that a problem lists.
const LISTED: usize = 20;

/// Problems and the columns that were used, or what is missing.
type Outcome = Result<(Vec<Problem>, Vec<String>), String>;

pub(super) fn run(check: Check, table: &Table<'_>, metadata: &Map<String, Value>) -> Outcome {
    if let Some(because) = needless(check, table) {
        return Err(because.to_owned());
    }
    match check {
        Check::InfrastructureErrors => infrastructure(table),
        Check::DuplicateInitialStates => initial_states(table),
        Check::SuccessAtFirstStep => first_step(table),
        Check::SuccessAtTimeLimit => time_limit(table),
        Check::MissingRows => missing(table, metadata),
        Check::DuplicateRows => duplicates(table),
        Check::BatchArtefacts => batches(table),
        Check::RepeatedSeeds => seeds(table),
    }
}

/// Why a dictionary or an export of RoboGate does not need a check.
fn needless(check: Check, table: &Table<'_>) -> Option<&'static str> {
    if !table.own {
        return None;
    }
    match check {
        Check::DuplicateInitialStates => Some("episodes of RoboGate with equal parameters differ in their own seeds"),
        Check::BatchArtefacts => {
            Some("each episode of RoboGate has its own seed, and a gate runs some of them twice in another order")
        }
        Check::RepeatedSeeds if table.seed.is_empty() => {
            Some("RoboGate derives the seed of each episode from `seed` and `index`")
        }
        Check::InfrastructureErrors
        | Check::SuccessAtFirstStep
        | Check::SuccessAtTimeLimit
        | Check::MissingRows
        | Check::DuplicateRows
        | Check::RepeatedSeeds => None,
    }
}

fn problem(what: String, rows: &[usize]) -> Problem {
    let listed = rows.iter().take(LISTED).map(|row| *row as u64).collect();
    Problem { what, count: rows.len() as u64, rows: listed }
}

fn names(columns: &BTreeSet<String>) -> Vec<String> {
    columns.iter().cloned().collect()
}

/// The rows with each key, in the order of the keys.
fn grouped<K: Ord>(table: &Table<'_>, key: impl Fn(&AuditRow) -> Option<K>) -> BTreeMap<K, Vec<usize>> {
    let mut groups: BTreeMap<K, Vec<usize>> = BTreeMap::new();
    for (at, row) in table.rows.iter().enumerate() {
        if let Some(key) = key(row) {
            groups.entry(key).or_default().push(at);
        }
    }
    groups
}

fn where_(table: &Table<'_>, wanted: impl Fn(&AuditRow) -> bool) -> Vec<usize> {
    (0..table.rows.len()).filter(|at| wanted(&table.rows[*at])).collect()
}

fn infrastructure(table: &Table<'_>) -> Outcome {
    if table.reasons.is_empty() && table.length.is_empty() {
        return Err("no column reports an error, a reason or a number of steps".to_owned());
    }
    let mut problems = Vec::new();
    let reported = where_(table, |row| row.success == Some(false) && row.error.is_some());
    if let Some(first) = reported.first() {
        let text = table.rows[*first].error.as_deref().unwrap_or_default();
        problems.push(problem(format!("A failure reports an infrastructure error, for example {text}"), &reported));
    }
    let never_ran = |row: &AuditRow| {
        row.success == Some(false) && row.error.is_none() && row.length.is_some_and(|length| length <= 0.0)
    };
    let empty = where_(table, never_ran);
    if !empty.is_empty() {
        problems.push(problem("A failure has 0 steps: the episode never ran".to_owned(), &empty));
    }
    let silent = where_(table, |row| row.success == Some(false) && !row.has_reason);
    if problems.is_empty() && !silent.is_empty() && !table.own {
        return Err(format!(
            "{} of the failures have no text about an error or a reason, and a number of steps alone shows only episodes that never ran",
            silent.len()
        ));
    }
    Ok((problems, names(&table.reasons.union(&table.length).cloned().collect())))
}

fn initial_states(table: &Table<'_>) -> Outcome {
    let by_name = !table.state.is_empty();
    if !by_name && !table.continuous {
        return Err("no column identifies the initial state, and no parameter has real values".to_owned());
    }
    let groups = grouped(table, |row| {
        let state = if by_name {
            row.state.clone()
        } else {
            // Parameters describe the scenario. Its seeds give different initial states.
            row.parameters.map(|hash| format!("{hash} {}", row.seed.as_deref().unwrap_or_default()))
        };
        state.map(|state| (row.place(), state))
    });
    // Some rounded settings are equal by chance.
    let by_chance = !by_name && 2 * groups.len() > table.rows.len();
    let repeated: Vec<&Vec<usize>> = groups.values().filter(|rows| rows.len() > 1 && !by_chance).collect();
    let mut rows: Vec<usize> = repeated.iter().flat_map(|rows| rows.iter().skip(1)).copied().collect();
    rows.sort_unstable();
    let columns = if by_name { &table.state } else { &table.parameters };
    let what = format!(
        "{} initial states occur more than once in the same task ({} different states in {} rows)",
        repeated.len(),
        groups.len(),
        table.rows.len()
    );
    Ok((if rows.is_empty() { Vec::new() } else { vec![problem(what, &rows)] }, names(columns)))
}

fn first_step(table: &Table<'_>) -> Outcome {
    if table.length.is_empty() {
        return Err("no column has the number of steps".to_owned());
    }
    let rows = where_(table, |row| row.success == Some(true) && row.length.is_some_and(|length| length <= 1.0));
    if !table.rows.iter().any(|row| row.success == Some(true) && row.length.is_some()) {
        return Err("no success has a number of steps".to_owned());
    }
    let what = "The episode succeeded after at most one step".to_owned();
    Ok((if rows.is_empty() { Vec::new() } else { vec![problem(what, &rows)] }, names(&table.length)))
}

fn time_limit(table: &Table<'_>) -> Outcome {
    if table.truncated.is_empty() {
        return Err("no column states whether the time limit ended the episode, such as `truncated`".to_owned());
    }
    let successes = where_(table, |row| row.success == Some(true) && row.truncated.is_some());
    let at_limit: Vec<usize> = successes
        .iter()
        .copied()
        .filter(|at| table.rows[*at].truncated == Some(true) && table.rows[*at].terminated != Some(true))
        .collect();
    if successes.is_empty() {
        return Err("no success states whether the time limit ended it".to_owned());
    }
    // Where no success ends the episode, the task ends at its limit by design.
    if at_limit.len() == successes.len() {
        return Err("every success lasts until the time limit, so the task does not end at a success".to_owned());
    }
    let what = "The time limit ended the episode, and it counts as a success".to_owned();
    let problems = if at_limit.is_empty() { Vec::new() } else { vec![problem(what, &at_limit)] };
    Ok((problems, names(&table.truncated)))
}

fn missing(table: &Table<'_>, metadata: &Map<String, Value>) -> Outcome {
    let mut problems = Vec::new();
    let declared = ["n_episodes", "num_episodes", "num_episodes_total", "n_rollouts", "num_rollouts"]
        .iter()
        .find_map(|key| Some((*key, metadata.get(*key)?.as_u64()?)));
    if let Some((key, declared)) = declared
        && declared != table.rows.len() as u64
    {
        let what = format!("`{key}` is {declared}, but the file has {} rows", table.rows.len());
        problems.push(problem(what, &[]));
    }
    let is_set =
        |key: &str| metadata.get(key).is_some_and(|value| value.as_bool() == Some(true) || value.as_u64() > Some(0));
    for key in ["partial", "queue_unfinished"] {
        if is_set(key) {
            problems.push(problem(format!("The file says that it is not complete (`{key}`)"), &[]));
        }
    }
    // A row of RoboGate without success or failure is an invalid episode, and says so.
    let silent = where_(table, |row| row.success.is_none() && !table.own);
    if !silent.is_empty() && silent.len() < table.rows.len() {
        problems.push(problem("The row reports neither success nor failure".to_owned(), &silent));
    }
    if table.episode.is_empty() && declared.is_none() {
        return if problems.is_empty() {
            Err("no column numbers the episodes".to_owned())
        } else {
            Ok((problems, Vec::new()))
        };
    }
    // Numbers that run over the whole file are not repeated in each case.
    let all: Vec<i64> = table.rows.iter().filter_map(|row| row.episode).collect();
    let distinct: BTreeSet<i64> = all.iter().copied().collect();
    let whole_file = distinct.len() == all.len();
    let groups = grouped(table, |row| row.episode.map(|_| if whole_file { String::new() } else { row.case.clone() }));
    for (case, rows) in &groups {
        let numbers: BTreeSet<i64> = rows.iter().filter_map(|at| table.rows[*at].episode).collect();
        let (Some(first), Some(last)) = (numbers.first(), numbers.last()) else { continue };
        let gaps = last.abs_diff(*first) + 1 - numbers.len() as u64;
        if gaps > 0 {
            let absent: Vec<String> =
                (*first..=*last).filter(|n| !numbers.contains(n)).take(5).map(|n| n.to_string()).collect();
            let of = if case.is_empty() { String::new() } else { format!(" in {}", case.trim_end_matches('/')) };
            problems.push(problem(format!("{gaps} episode numbers have no row{of}, first {}", absent.join(", ")), &[]));
        }
    }
    let most = groups.values().map(Vec::len).max().unwrap_or(0);
    let short: Vec<String> = groups
        .iter()
        .filter(|(_, rows)| !whole_file && rows.len() < most)
        .map(|(case, rows)| format!("{} ({})", case.trim_end_matches('/'), rows.len()))
        .collect();
    if !short.is_empty() && short.len() * 2 <= groups.len() {
        let listed = short.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
        problems.push(problem(format!("{} tasks have fewer than {most} episodes: {listed}", short.len()), &[]));
    }
    Ok((problems, names(&table.episode)))
}

fn duplicates(table: &Table<'_>) -> Outcome {
    let extra = |groups: BTreeMap<_, Vec<usize>>| {
        let mut rows: Vec<usize> = groups.into_values().flat_map(|rows| rows.into_iter().skip(1)).collect();
        rows.sort_unstable();
        rows
    };
    let mut problems = Vec::new();
    let identified = !table.episode.is_empty() || !table.seed.is_empty() || table.continuous;
    if !identified {
        return Err(
            "no column numbers the episodes or names their seeds, so equal rows can be different episodes".to_owned()
        );
    }
    let same = extra(grouped(table, |row| Some((String::new(), row.whole as i64))));
    if table.episode.is_empty() && table.seed.is_empty() && are_coincidences(table, same.len()) {
        return Err("no column numbers the episodes or names their seeds, and rows are also equal in all settings but not in their result, so \
             equal rows can be different episodes"
            .to_owned());
    }
    if !same.is_empty() {
        problems.push(problem("The row is equal to an earlier one in every column".to_owned(), &same));
    }
    let numbered = extra(grouped(table, |row| Some((row.place(), row.episode?))));
    let other: Vec<usize> = numbered.into_iter().filter(|row| !same.contains(row)).collect();
    // With parallel environments, each may number its own episodes.
    if !other.is_empty() && table.environment.is_empty() {
        problems.push(problem("The number of the episode occurs twice in the same task".to_owned(), &other));
    }
    Ok((problems, names(&table.episode.union(&table.seed).cloned().collect())))
}

/// Whether `same` rows may equal others by chance: other rows with equal settings have other results, or independent results would be
/// equal as well with a probability of at least 1 %.
fn are_coincidences(table: &Table<'_>, same: usize) -> bool {
    let groups = grouped(table, |row| row.parameters);
    let differ = |rows: &Vec<usize>| rows.iter().any(|at| table.rows[*at].whole != table.rows[rows[0]].whole);
    let successes = table.rows.iter().filter(|row| row.success == Some(true)).count();
    let rate = successes as f64 / table.rows.len().max(1) as f64;
    let alike = rate * rate + (1.0 - rate) * (1.0 - rate);
    groups.values().any(differ) || alike.powi(i32::try_from(same).unwrap_or(i32::MAX)) >= 0.01
}

fn seeds(table: &Table<'_>) -> Outcome {
    if table.seed.is_empty() {
        return Err("no column has the seed".to_owned());
    }
    let groups = grouped(table, |row| Some((row.scenario(), row.seed.clone()?)));
    let distinct: BTreeSet<&String> = groups.keys().map(|(_, seed)| seed).collect();
    let mut rows: Vec<usize> = groups.values().flat_map(|rows| rows.iter().skip(1)).copied().collect();
    rows.sort_unstable();
    let scenarios: BTreeSet<_> = groups.keys().map(|(scenario, _)| scenario).collect();
    let repeated = !rows.is_empty();
    if !repeated && 2 * distinct.len() <= table.rows.len() && 2 * scenarios.len() > table.rows.len() {
        return Err(format!(
            "{} seeds occur in {} rows, each time with other numbers in {}. If a column of these is a result of the episode, leave \
             it out with --map ignore=COLUMN",
            distinct.len(),
            table.rows.len(),
            names(&table.parameters).join(", ")
        ));
    }
    let what = if distinct.len() == 1 {
        // No row repeats another one more than all others do.
        rows.clear();
        format!(
            "All {} rows have the same seed. It is that of the run, so it does not identify an episode",
            table.rows.len()
        )
    } else {
        format!(
            "The seed was used before in the same task ({} different seeds in {} rows)",
            distinct.len(),
            table.rows.len()
        )
    };
    Ok((if repeated { vec![problem(what, &rows)] } else { Vec::new() }, names(&table.seed)))
}

/// Sizes of batches that are tried if no column names the environment.
const SIZES: [usize; 11] = [2, 4, 5, 8, 10, 16, 20, 25, 32, 50, 64];

fn batches(table: &Table<'_>) -> Outcome {
    let mut problems = Vec::new();
    if table.environment.is_empty() {
        if table.rows.len() < 40 {
            return Err(
                "no column names the parallel environment, and 40 rows are needed to look for a period".to_owned()
            );
        }
        // The level is divided by the number of sizes that are tried.
        let limit = 3.72 + (SIZES.len() as f64).ln() / 3.72;
        let tried = SIZES.iter().filter_map(|size| Some((dependence(table, |at, _| Some((at % size) as i64))?, *size)));
        let tried: Vec<(f64, usize)> = tried.collect();
        let largest = tried.iter().map(|(_, size)| *size).max();
        let found = tried.iter().copied().filter(|(z, _)| *z > limit);
        if let Some((_, size)) = found.max_by(|a, b| a.0.total_cmp(&b.0)) {
            let what = format!("Success depends on the position in a batch of {size} rows (p < 0.0001)");
            problems.push(problem(what, &[]));
        }
        if let Some((period, rows)) = seed_period(table) {
            problems.push(problem(
                format!("The seeds repeat with a period of {period} rows, as if each batch restarted them"),
                &rows,
            ));
        }
        if !problems.is_empty() {
            return Ok((problems, Vec::new()));
        }
        if sorted_by_outcome(table) {
            return Err(
                "no column names the parallel environment, and equal outcomes stand side by side: the rows are sorted, or in the \
                 order in which episodes ended, so their position says nothing about the environment"
                    .to_owned(),
            );
        }
        return if tried.len() == SIZES.len() {
            Ok((problems, Vec::new()))
        } else {
            let tried = largest.map_or("no batch size".to_owned(), |size| format!("only batches of up to {size}"));
            Err(format!(
                "no column names the parallel environment, and with these outcomes {tried} can be tested (nothing was found)"
            ))
        };
    }
    let groups = grouped(table, |row| row.environment);
    let counts: Vec<usize> = groups.values().map(Vec::len).collect();
    let (least, most) = (counts.iter().min().copied().unwrap_or(0), counts.iter().max().copied().unwrap_or(0));
    if groups.len() > 1 && most > least + 1 {
        let what = format!(
            "The {} environments have {least} to {most} episodes. If the run stops at a total, environments with short episodes count \
             more often, which biases the rate",
            groups.len()
        );
        problems.push(problem(what, &[]));
    }
    match dependence(table, |_, row| row.environment) {
        Some(z) if z > 3.72 => {
            problems.push(problem("Success depends on the environment (p < 0.0001)".to_owned(), &[]));
        }
        None if problems.is_empty() => {
            return Err("the environments have too few successes or failures to compare their rates".to_owned());
        }
        _ => {}
    }
    Ok((problems, names(&table.environment)))
}

/// The chi-square statistic of success by group within scenarios, as a standard normal number (Mantel and Haenszel 1959; Wilson and
/// Hilferty 1931). Scenarios and policies differ by design, so each row is compared with the rate of its own.
///
/// The smallest groups are left out until each has a variance of 1, and five successes and failures are expected per group. `None`
/// if fewer than two groups are left.
fn dependence(table: &Table<'_>, group: impl Fn(usize, &AuditRow) -> Option<i64>) -> Option<f64> {
    // Parameters that hardly ever repeat do not identify scenarios.
    let scenarios = grouped(table, |row| Some(row.scenario()));
    let repeated = 2 * scenarios.len() <= table.rows.len();
    let strata = if repeated { scenarios.into_values() } else { places(table).into_values() };
    // Rows, successes, expected successes and their variance in each group.
    let mut counts: BTreeMap<i64, [f64; 4]> = BTreeMap::new();
    for rows in strata {
        let known: Vec<(i64, bool)> =
            rows.into_iter().filter_map(|at| Some((group(at, &table.rows[at])?, table.rows[at].success?))).collect();
        let rate = known.iter().filter(|(_, success)| *success).count() as f64 / known.len().max(1) as f64;
        for (group, success) in known {
            let count = counts.entry(group).or_default();
            let row = [1.0, f64::from(u8::from(success)), rate, rate * (1.0 - rate)];
            count.iter_mut().zip(row).for_each(|(sum, x)| *sum += x);
        }
    }
    let mut groups: Vec<[f64; 4]> = counts.into_values().collect();
    let all: f64 = groups.iter().map(|group| group[0]).sum();
    groups.sort_by(|a, b| b[3].total_cmp(&a[3]));
    let (mut rows, mut successes, mut kept) = (0.0_f64, 0.0_f64, 0);
    for (n, group) in (1_u32..).zip(&groups) {
        (rows, successes) = (rows + group[0], successes + group[2]);
        // Sums of rates are rounded.
        if group[3] >= 1.0 && f64::min(successes, rows - successes) >= 5.0 * f64::from(n) - 1e-6 {
            kept = n;
        }
    }
    groups.truncate(kept as usize);
    if groups.len() < 2 {
        return None;
    }
    let statistic: f64 = groups.iter().map(|group| (group[1] - group[2]).powi(2) / group[3]).sum();
    // The mean of the statistic. It is the number of groups minus 1 if none is left out.
    let k = groups.len() as f64 - groups.iter().map(|group| group[0]).sum::<f64>() / all;
    let spread = 2.0 / (9.0 * k);
    Some(((statistic / k).cbrt() - (1.0 - spread)) / spread.sqrt())
}

/// The rows of each task, case and arm.
fn places(table: &Table<'_>) -> BTreeMap<(String, Option<u64>), Vec<usize>> {
    grouped(table, |row| Some((row.place(), None)))
}

/// Whether equal outcomes stand side by side within a task more often than chance allows: the runs test (Wald and
/// Wolfowitz 1940), over all tasks together, at 3.72 standard deviations (p < 0.0001).
fn sorted_by_outcome(table: &Table<'_>) -> bool {
    let (mut excess, mut variance) = (0.0, 0.0);
    for rows in grouped(table, |row| Some(row.place())).values() {
        let outcomes: Vec<bool> = rows.iter().filter_map(|at| table.rows[*at].success).collect();
        let successes = outcomes.iter().filter(|success| **success).count() as f64;
        let (n, failures) = (outcomes.len() as f64, outcomes.len() as f64 - successes);
        let both = 2.0 * successes * failures;
        if both <= 0.0 || n < 2.0 {
            continue;
        }
        let runs = 1.0 + outcomes.windows(2).filter(|pair| pair[0] != pair[1]).count() as f64;
        excess += 1.0 + both / n - runs;
        variance += both * (both - n) / (n * n * (n - 1.0));
    }
    excess > 3.72 * f64::max(variance, 1.0).sqrt()
}

/// The period with which the seeds repeat, and the repeated rows.
fn seed_period(table: &Table<'_>) -> Option<(usize, Vec<usize>)> {
    let seeds: Option<Vec<_>> = table.rows.iter().map(|row| Some((row.scenario(), row.seed.as_ref()?))).collect();
    let seeds = seeds?;
    let first = seeds.first()?;
    let period = 1 + seeds.iter().skip(1).position(|seed| seed == first)?;
    // A period of one is a seed of the whole run, which the check of seeds reports.
    let repeats = period > 1 && (period..seeds.len()).all(|at| seeds[at] == seeds[at - period]);
    repeats.then(|| (period, (period..seeds.len()).collect()))
}
