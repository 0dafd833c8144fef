//! The leaderboard of a sweep.

use std::path::Path;

use anyhow::{Context, anyhow};
use robogate_campaign::Event;
use robogate_campaign::folder::SUMMARY;
use robogate_dictionary::files;
use robogate_gate::{Baseline, Leaderboard, Metric, Record, Requirements, Sampling, ScoreTerm, Scoring};
use robogate_report::{leaderboard_text, leaderboards_html, leaderboards_markdown};
use serde_json::{Value, json};

use super::sweep::SweepPlan;
use crate::commands::run::write_report;
use crate::commands::shard;
use crate::exit::{DONE, Exit, INFRASTRUCTURE, INVALID, OrExit};
use crate::terminal::{line, print_report, warning};
use robogate_session::{Reopening, Trust, built_in_baseline, open_source, record_of};

/// The pages in the folder of a sweep.
const PAGES: [&str; 2] = ["leaderboard.html", "leaderboard.md"];

/// Merges the runs of a sweep in shards, and writes its page.
pub(crate) fn merge(dir: &Path, plan: &SweepPlan, trust: Trust, as_json: bool) -> Result<u8, Exit> {
    let mut failed = Vec::new();
    let opening = Reopening::trusting(trust);
    for run in &plan.runs {
        let folder = run.dir(dir);
        let mut events = |event: &Event| {
            if let Event::Warning { message, .. } = event {
                warning(format_args!("{}: {message}", run.name));
            }
        };
        let merged = shard::open(&folder).and_then(|mut campaign| {
            campaign.merge(&folder, &mut events, &opening)?;
            write_report(&folder, None, None);
            Ok(())
        });
        if let Err(exit) = merged {
            warning(format_args!("{}: {exit}", run.name));
            failed.push(run.name.clone());
        }
    }
    write(dir, plan, &failed, as_json)
}

/// Writes the page from the finished runs. `failed` names the others.
pub(super) fn write(dir: &Path, plan: &SweepPlan, failed: &[String], as_json: bool) -> Result<u8, Exit> {
    let boards = boards(dir, plan)?;
    if boards.is_empty() {
        return Err(Exit { code: INFRASTRUCTURE, error: anyhow!("no run of {} is finished", plan.name) });
    }
    for (name, text) in
        PAGES.iter().zip([leaderboards_html(&plan.name, &boards), leaderboards_markdown(&plan.name, &boards)])
    {
        let path = dir.join(name);
        files::write(&path, text).with_context(|| format!("cannot write {}", path.display())).or_broken()?;
    }
    if as_json {
        let boards: Vec<Value> = boards.iter().filter_map(|board| serde_json::to_value(board).ok()).collect();
        line(json!({ "version": 1, "name": plan.name, "failed": failed, "leaderboards": boards }));
    } else {
        for board in &boards {
            print_report(&leaderboard_text(board));
            line("");
        }
        line(format_args!("page: {}", dir.join(PAGES[0]).display()));
    }
    if !failed.is_empty() {
        let error = anyhow!("{} of {} runs are missing: {}", failed.len(), plan.runs.len(), failed.join("; "));
        return Err(Exit { code: INFRASTRUCTURE, error });
    }
    Ok(if boards.iter().flat_map(|board| &board.standings).any(|s| s.valid > 0) { DONE } else { INVALID })
}

/// One leaderboard for each task and set of scenarios, in the order of the sweep.
fn boards(dir: &Path, plan: &SweepPlan) -> Result<Vec<Leaderboard>, Exit> {
    let mut groups: Vec<Vec<(String, Record, Sampling)>> = Vec::new();
    for run in plan.runs.iter().filter(|run| run.dir(dir).join(SUMMARY).is_file()) {
        let source = open_source(&run.dir(dir))?;
        let record = record_of(&source).or_broken()?;
        let comparable = |group: &&mut Vec<(String, Record, Sampling)>| {
            group.first().is_some_and(|(_, first, _)| {
                first.population.is_that_of(&record.population) && first.task.name == record.task.name
            })
        };
        // All runs of one leaderboard have the same task.
        let name = run.name.replacen(&format!(", {}", record.task.name), "", 1);
        // A sweep runs all its episodes.
        match groups.iter_mut().find(comparable) {
            Some(group) => group.push((name, record, Sampling::Fixed)),
            None => groups.push(vec![(name, record, Sampling::Fixed)]),
        }
    }
    groups.iter().map(|group| board(group, plan.requirements.as_deref())).collect()
}

fn board(group: &[(String, Record, Sampling)], requirements: Option<&str>) -> Result<Leaderboard, Exit> {
    let Some((_, first, _)) = group.first() else {
        return Err(anyhow!("a leaderboard needs at least one run")).or_broken();
    };
    let Some(name) = requirements else {
        let success = ScoreTerm {
            name: "Success".to_owned(),
            metric: Metric::Success,
            category: None,
            weight: 1.0,
            scoring: Scoring::Linear { full_at: 1.0 },
        };
        return Leaderboard::of(group, &[success], None).or_usage();
    };
    let requirements = Requirements::open(name, &first.task)?;
    // Relative terms compare with the first policy, unless the suite has a baseline.
    let baseline = match built_in_baseline(first) {
        Some(baseline) => baseline,
        None => Baseline::of(first).or_usage()?,
    };
    Leaderboard::of(group, &requirements.score, Some(&baseline)).or_usage()
}
