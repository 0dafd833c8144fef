//! `robogate trial report` and `unblind`: the answer of a study.

use std::path::PathBuf;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate::exit_codes::INCONCLUSIVE;
use robogate_dictionary::files;
use robogate_trial::{Folder, answer, check_attachments, csv_of, mapping, provenance, report};

use super::{StudyArgument, exit};
use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::terminal::{line, note, wrapped};

/// Publish the order of a study. Before its end, this withdraws its claim.
#[derive(Debug, Args)]
pub(super) struct Unblind {
    #[command(flatten)]
    study: StudyArgument,
    /// Unblind before the end that the plan states. The study then makes no claim
    #[arg(long)]
    early: bool,
}

impl Unblind {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        Folder::open(&self.study.study).and_then(|mut folder| folder.unblind(self.early)).map_err(exit)?;
        note("unblinded. `robogate trial report` has the answer");
        Ok(DONE)
    }
}

/// Write the answer of a study: page, CSV of the trials, provenance.
///
/// Exit code 0: pass, or a policy is the best; 1: fail; 3: not shown, withdrawn or not finished; 4: the records were changed.
#[derive(Debug, Args)]
pub(super) struct Report {
    #[command(flatten)]
    study: StudyArgument,
    /// Write report.html, trials.csv, one CSV for each of several policies, trials.toml (the mapping for `import`) and trials.json
    /// to this folder; default: that of the study
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the answer as one versioned JSON document
    #[arg(long)]
    json: bool,
}

impl Report {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let folder = &self.study.study;
        let study = Folder::read(folder).map_err(exit)?;
        if study.unblinded().is_none() {
            let problem = "the study is blinded\nHint: `robogate trial unblind` publishes its order once it has ended";
            return Err(anyhow!(problem)).or_usage();
        }
        check_attachments(folder, &study).map_err(exit)?;
        let answer = answer(&study);
        let out = self.out.as_ref().unwrap_or(folder);
        files::create_folders(out).with_context(|| format!("cannot write {}", out.display())).or_broken()?;
        let csv = csv_of(&study, None);
        let mut files = vec![
            ("report.html".to_owned(), report(&study, &answer)),
            ("trials.json".to_owned(), provenance(folder, &study, &answer, &csv).map_err(exit)?),
            ("trials.toml".to_owned(), mapping(&study)),
            ("trials.csv".to_owned(), csv),
        ];
        if study.plan.arms.len() > 1 {
            files.extend(
                (0..study.plan.arms.len()).map(|arm| (format!("trials-{}.csv", arm + 1), csv_of(&study, Some(arm)))),
            );
        }
        for (name, content) in files {
            let path = out.join(name);
            files::write(&path, content).with_context(|| format!("cannot write {}", path.display())).or_broken()?;
            note(format_args!("written: {}", path.display()));
        }
        if self.json {
            line(serde_json::to_string(&answer).or_broken()?);
        } else {
            wrapped(&answer.sentence);
            for arm in &answer.arms {
                line(format_args!(
                    "  {}: {}{}",
                    arm.policy,
                    arm.rate(),
                    if arm.eliminated { ", eliminated" } else { "" }
                ));
            }
            answer.notes.iter().for_each(|note| wrapped(note));
        }
        Ok(match answer.verdict {
            "pass" | "best" => DONE,
            "fail" => FAIL,
            _ => INCONCLUSIVE,
        })
    }
}
