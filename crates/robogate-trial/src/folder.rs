//! The folder of a study on disk.

use std::path::Path;

use crate::attachment::copied;
use crate::{Attachment, Command, Event, Journal, Measured, Moment, Plan, Problem, Record, Secret, Study, VoidBy};

/// Name of the plan in the folder of a study.
pub const PLAN: &str = "plan.json";
/// Name of the secret in the folder of a study. Only its owner can read it.
pub const SECRET: &str = "secret.json";

/// A study that is open for writing.
#[derive(Debug)]
pub struct Folder {
    secret: Secret,
    journal: Journal,
    study: Study,
}

impl Folder {
    /// Writes the folder of a new study.
    ///
    /// # Errors
    /// If it exists and is not empty, or cannot be written.
    pub fn create(path: &Path, plan: &Plan, secret: &Secret) -> Result<(), Problem> {
        plan.check()?;
        let failed = |error: std::io::Error| Problem::File { path: path.to_owned(), reason: error.to_string() };
        robogate_dictionary::files::create_folders(path).map_err(failed)?;
        if std::fs::read_dir(path).map_err(failed)?.next().is_some() {
            let reason = "the folder is not empty\nHint: choose another one for this study".to_owned();
            return Err(Problem::File { path: path.to_owned(), reason });
        }
        let mut study = Study::new(plan.clone(), secret)?;
        secret.write_new(&path.join(SECRET))?;
        let text = plan.to_json();
        let file = path.join(PLAN);
        robogate_dictionary::files::write(&file, text)
            .map_err(|error| Problem::File { path: file, reason: error.to_string() })?;
        let (mut journal, _) = Journal::open(path, secret, true)?;
        let opened = Event::Opened { plan_sha256: plan.sha256() };
        study.apply(&journal.append(Moment::now(), "", opened)?);
        Ok(())
    }

    /// Opens a study for writing.
    ///
    /// # Errors
    /// If it cannot be read, was changed, or another process writes it.
    pub fn open(path: &Path) -> Result<Self, Problem> {
        let (plan, secret) = parts(path)?;
        let (journal, records) = Journal::open(path, &secret, false)?;
        let study = replay(path, plan, &secret, &records)?;
        Ok(Self { secret, journal, study })
    }

    /// Reads and checks a study, also while another process writes it.
    ///
    /// # Errors
    /// If it cannot be read, or was changed.
    pub fn read(path: &Path) -> Result<Study, Problem> {
        let (plan, secret) = parts(path)?;
        let records = Journal::read(path, &secret)?;
        replay(path, plan, &secret, &records)
    }

    /// The study.
    pub fn study(&self) -> &Study {
        &self.study
    }

    /// Executes a request. When this returns, it is on disk. Returns whether it is new: a request that is sent twice has one record.
    ///
    /// # Errors
    /// If it does not fit, or cannot be written.
    pub fn command(&mut self, id: &str, command: &Command) -> Result<bool, Problem> {
        let at = Moment::now();
        match self.study.event(id, command, &at)? {
            Some(event) => self.append(at, id, event).map(|()| true),
            None => Ok(false),
        }
    }

    /// Ends the running trial because the switch or the server of its policy failed. It is repeated.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn fault(&mut self, reason: &str) -> Result<(), Problem> {
        let code = self.study.code().to_owned();
        self.append(Moment::now(), "", Event::Void { code, reason: reason.to_owned(), by: VoidBy::Infrastructure })
    }

    /// Records what the switch measured.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn measured(&mut self, code: &str, measured: Measured) -> Result<(), Problem> {
        self.append(Moment::now(), "", Event::Switch { code: code.to_owned(), measured })
    }

    /// Attaches a file, or all files of a folder, to a trial that has ended. The folder of the study gets a copy.
    ///
    /// # Errors
    /// If there is no such trial, or a file cannot be read or copied.
    pub fn attach(&mut self, path: &Path, code: &str, from: &Path) -> Result<Vec<Attachment>, Problem> {
        match self.study.attempts().iter().find(|attempt| attempt.code == code) {
            None => return Err(Problem::Refused(format!("there is no trial {code} that was started"))),
            Some(attempt) if !attempt.stopped && attempt.void.is_none() => {
                return Err(Problem::Refused(format!("trial {code} still runs. Attach files after its end")));
            }
            Some(_) => {}
        }
        let files = copied(path, code, from)?;
        for file in &files {
            self.append(Moment::now(), "", Event::Attach { code: code.to_owned(), file: file.clone() })?;
        }
        Ok(files)
    }

    /// The name of the policy of the present trial, for a script that starts it. The journal records that it was told.
    ///
    /// # Errors
    /// If no trial is next or runs, or the journal cannot be written.
    pub fn tell(&mut self) -> Result<String, Problem> {
        let arm = self.study.current().map(|planned| planned.arm);
        let arm = arm.ok_or_else(|| Problem::Refused("the study has ended".to_owned()))?;
        let code = self.study.code().to_owned();
        if !matches!(self.study.phase(), crate::Phase::Running | crate::Phase::Stopped) {
            return Err(Problem::Refused("no trial runs. Start it first".to_owned()));
        }
        if !self.study.attempts().last().is_some_and(|last| last.told) {
            self.append(Moment::now(), "", Event::Told { code })?;
        }
        Ok(self.study.plan.arms[arm].name.clone())
    }

    /// Unblinds the study. `early` allows it before its end, and withdraws its claim.
    ///
    /// # Errors
    /// If the study has not ended and `early` is not set, or the journal cannot be written.
    pub fn unblind(&mut self, early: bool) -> Result<(), Problem> {
        if self.study.unblinded().is_some() {
            return Ok(());
        }
        let ended = self.study.phase() == crate::Phase::Finished;
        if !ended && !early {
            let reason = "the study has not ended\nHint: --early unblinds it now and withdraws its claim";
            return Err(Problem::Refused(reason.to_owned()));
        }
        let event = Event::Unblind { secret: self.secret.clone(), early: !ended };
        self.append(Moment::now(), "", event)
    }

    fn append(&mut self, at: Moment, id: &str, event: Event) -> Result<(), Problem> {
        let record = self.journal.append(at, id, event)?;
        self.study.apply(&record);
        Ok(())
    }
}

fn parts(path: &Path) -> Result<(Plan, Secret), Problem> {
    let file = path.join(PLAN);
    let text = robogate_dictionary::read_regular_text(&file)
        .map_err(|error| Problem::File { path: file.clone(), reason: error.to_string() })?;
    Ok((Plan::from_json(&file, &text)?, Secret::read(&path.join(SECRET))?))
}

/// The study that follows from the records.
fn replay(path: &Path, plan: Plan, secret: &Secret, records: &[Record]) -> Result<Study, Problem> {
    let changed = |reason: &str| Problem::Changed { path: path.join(PLAN), line: 1, reason: reason.to_owned() };
    match records.first().map(|record| &record.event) {
        Some(Event::Opened { plan_sha256 }) if *plan_sha256 == plan.sha256() => {}
        Some(Event::Opened { .. }) => return Err(changed("the plan was changed after the study was opened")),
        _ => return Err(changed("the journal does not begin with this plan")),
    }
    let mut study = Study::new(plan, secret).map_err(|error| changed(&error.to_string()))?;
    records.iter().for_each(|record| study.apply(record));
    Ok(study)
}
