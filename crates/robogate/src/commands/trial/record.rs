//! `robogate trial next` and `record`: trials of cells without a server.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use robogate_core::Word;
use robogate_stats::format::counted;
use robogate_trial::{Attachment, Command, Folder, Outcome, Phase, SUCCESS};
use serde_json::json;

use super::{StudyArgument, exit};
use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{foreign, line, note};

/// Print the next trial: code and set-up.
#[derive(Debug, Args)]
pub(super) struct Next {
    #[command(flatten)]
    study: StudyArgument,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    /// Print only the name of the policy of the running trial, for a script that starts it. The journal records this
    #[arg(long, conflicts_with = "json")]
    policy: bool,
}

impl Next {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        if self.policy {
            line(Folder::open(&self.study.study).and_then(|mut folder| folder.tell()).map_err(exit)?);
            return Ok(DONE);
        }
        let study = Folder::read(&self.study.study).map_err(exit)?;
        let setup = study.current().map(|planned| planned.setup.clone()).unwrap_or_default();
        let phase = study.phase();
        if self.json {
            let setup: serde_json::Map<String, serde_json::Value> =
                setup.into_iter().map(|(name, value)| (name, value.into())).collect();
            let code = (phase != Phase::Finished).then(|| study.code());
            line(json!({ "version": 1, "phase": phase, "code": code, "setup": setup }));
            return Ok(DONE);
        }
        match phase {
            Phase::Finished => line("The study has ended."),
            Phase::Paused => line("The study is paused."),
            Phase::Ready => line(format_args!("Trial {}", study.code())),
            Phase::Running => line(format_args!("Trial {} runs", study.code())),
            Phase::Stopped => line(format_args!("Trial {} waits for its result", study.code())),
        }
        for (name, value) in setup {
            line(format_args!("  {} = {}", foreign(name), foreign(value)));
        }
        Ok(DONE)
    }
}

/// Record an event of a trial.
#[derive(Debug, Args)]
pub(super) struct RecordOf {
    #[command(flatten)]
    study: StudyArgument,
    /// What happened
    event: What,
    /// Code of the trial, as `next` printed it
    #[arg(long)]
    code: Option<String>,
    /// Who runs the trial; for `start`
    #[arg(long)]
    operator: Option<String>,
    /// `success`, or the failure mode; for `result` and `correct`
    #[arg(long)]
    result: Option<String>,
    /// The last stage that a failure reached
    #[arg(long)]
    stage: Option<String>,
    /// A measured number, such as a force
    #[arg(long, allow_negative_numbers = true)]
    measured: Option<f64>,
    /// Notes
    #[arg(long, default_value = "")]
    notes: String,
    /// Why the trial is invalid, or corrected
    #[arg(long, default_value = "")]
    reason: String,
    /// Identifier of this request: sent twice with the same one, it is recorded once
    #[arg(long, default_value = "")]
    id: String,
}

/// What happened.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum What {
    /// The trial begins
    Start,
    /// The motion has ended
    Stop,
    /// The result is known
    Result,
    /// The trial is invalid: repeated before stop, a failure after it
    Invalid,
    /// The result of the last trial was wrong
    Correct,
    /// A pause begins
    Pause,
    /// A pause ends
    Resume,
}

impl RecordOf {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let command = self.command()?;
        let mut folder = Folder::open(&self.study.study).map_err(exit)?;
        let new = folder.command(&self.id, &command).map_err(exit)?;
        note(if new { "recorded" } else { "recorded before, under the same identifier" });
        Ok(DONE)
    }

    /// Refuses options that the event does not use.
    fn check_options(&self) -> Result<(), Exit> {
        let used: &[&str] = match self.event {
            What::Start => &["--code", "--operator"],
            What::Stop => &["--code"],
            What::Result => &["--code", "--result", "--stage", "--measured", "--notes"],
            What::Invalid => &["--code", "--reason"],
            What::Correct => &["--code", "--result", "--stage", "--measured", "--notes", "--reason"],
            What::Pause | What::Resume => &[],
        };
        let options = [
            ("--code", self.code.is_some()),
            ("--operator", self.operator.is_some()),
            ("--result", self.result.is_some()),
            ("--stage", self.stage.is_some()),
            ("--measured", self.measured.is_some()),
            ("--notes", !self.notes.is_empty()),
            ("--reason", !self.reason.is_empty()),
        ];
        match options.into_iter().find(|(option, present)| *present && !used.contains(option)) {
            Some((option, _)) => Err(anyhow::anyhow!("this event does not use {option}")).or_usage(),
            None => Ok(()),
        }
    }

    fn command(&self) -> Result<Command, Exit> {
        self.check_options()?;
        let code = || given("--code", self.code.as_ref());
        Ok(match self.event {
            What::Start => Command::Start { code: code()?, operator: given("--operator", self.operator.as_ref())? },
            What::Stop => Command::Stop { code: code()? },
            What::Result => Command::Result { code: code()?, result: self.outcome()? },
            What::Invalid => Command::Void { code: code()?, reason: self.reason.clone() },
            What::Correct => Command::Correct { code: code()?, result: self.outcome()?, reason: self.reason.clone() },
            What::Pause => Command::Pause,
            What::Resume => Command::Resume,
        })
    }

    fn outcome(&self) -> Result<Outcome, Exit> {
        let result = given("--result", self.result.as_ref())?;
        let word = |text: &String| Word::new(text).or_usage();
        Ok(Outcome {
            success: result == SUCCESS,
            mode: Some(&result).filter(|result| *result != SUCCESS).map(word).transpose()?,
            stage: self.stage.as_ref().map(word).transpose()?,
            measured: self.measured,
            notes: self.notes.clone(),
        })
    }
}

/// Attach a file, or all files of a folder, to a trial that has ended.
///
/// The folder of the study gets a copy, and the journal its digest: `trial status` and `trial report` end with exit code 4 if a copy was
/// changed. A file may name the policy: let someone attach it who does not judge trials, or attach it after `unblind`.
#[derive(Debug, Args)]
pub(super) struct Attach {
    #[command(flatten)]
    study: StudyArgument,
    /// Code of the trial, as `next` printed it
    #[arg(value_name = "CODE")]
    code: String,
    /// File or folder, for example a data set of LeRobot, a log of Inspect Robots or a recording
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

impl Attach {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let study = &self.study.study;
        let mut folder = Folder::open(study).map_err(exit)?;
        for Attachment { name, bytes, sha256 } in folder.attach(study, &self.code, &self.file).map_err(exit)? {
            note(format_args!("attached: {} ({}, SHA-256 {sha256})", foreign(name), counted(bytes, "byte")));
        }
        Ok(DONE)
    }
}

fn given(option: &str, value: Option<&String>) -> Result<String, Exit> {
    value.cloned().ok_or_else(|| anyhow::anyhow!("this event needs {option}")).or_usage()
}
