//! `robogate audit`: finds rows that make the success rate of a file wrong.

use std::path::PathBuf;

use clap::Args;
use robogate_dictionary::results::Format;
use robogate_dictionary::results::audit::{Audit, CheckResult, audit};
use robogate_stats::format::counted;

use crate::commands::import::{Layout, open_mapping};
use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::terminal::{bold, dim, foreign, grouped, line, wrapped};

/// Find rows that make a success rate wrong, in the results of any tool.
///
/// Checks for infrastructure errors counted as failures, duplicate initial states, success at the first step or at the
/// time limit, missing and duplicate rows, batch-size artefacts and repeated seeds. Reads the formats of `robogate import`. Exit codes: 0
/// nothing was found, 1 a problem was found.
#[derive(Debug, Args)]
pub(crate) struct AuditOf {
    /// File with the results
    results: PathBuf,
    /// Set the format of the results; default: detected from their content
    #[arg(long)]
    format: Option<Layout>,
    /// Read the roles of the columns from this TOML file, as in `robogate import`
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    /// Set roles of columns: success=ok,seed=env_seed
    #[arg(long, value_name = "KEY=COLUMN,...")]
    map: Vec<String>,
    /// Print one versioned JSON document
    #[arg(long)]
    json: bool,
}

impl AuditOf {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let mapping = open_mapping(self.mapping.as_deref(), &self.map)?;
        let audit = audit(&self.results, self.format.map(Format::from), &mapping).or_usage()?;
        if self.json {
            line(serde_json::to_string_pretty(&audit).or_broken()?);
        } else {
            print(&audit);
        }
        Ok(if audit.found() == 0 { DONE } else { FAIL })
    }
}

fn print(audit: &Audit) {
    line(format_args!(
        "{}: {}, {} successes, {}",
        audit.format.replace('_', " "),
        counted(audit.rows, "row"),
        grouped(audit.successes),
        counted(audit.failures, "failure")
    ));
    for checked in &audit.checks {
        let title = checked.check.title();
        match &checked.result {
            CheckResult::Clear { .. } => line(format_args!("  ok       {title}")),
            CheckResult::NotPossible { because } => {
                line(dim(format_args!("  -        {title}: not checked, because {because}")));
            }
            CheckResult::Found { problems, remedy } => {
                line(bold(format_args!("  problem  {title}")));
                for problem in problems {
                    let rows: Vec<String> = problem.rows.iter().map(u64::to_string).collect();
                    let more = if problem.count > rows.len() as u64 { ", ..." } else { "" };
                    let rows = match problem.count {
                        0 => String::new(),
                        n => format!(" [{}: {}{more}]", counted(n, "row"), rows.join(", ")),
                    };
                    wrapped(&format!("{}.{rows}", foreign(&problem.what)));
                }
                wrapped(remedy);
            }
        }
    }
    let found = audit.found();
    line(match found {
        0 => "No problem was found.".to_owned(),
        1 => "One check found a problem. Rows are numbered from 0, without the header.".to_owned(),
        n => format!("{n} checks found problems. Rows are numbered from 0, without the header."),
    });
}
