//! The state of a study: what follows from its plan, its secret and its records.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::decide::Judge;
use crate::{
    Attachment, BlockResults, Codes, Decision, Event, Measured, Moment, Outcome, Plan, Planned, Problem, Record,
    Secret, VoidBy, order,
};

/// Longest note or reason, in bytes.
const LONGEST_NOTE: usize = 4_000;
/// Longest name of an operator, and longest identifier of a request, in bytes.
pub(crate) const LONGEST_NAME: usize = 100;

/// A request of an operator or a script.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// Begin the trial.
    Start {
        /// Its code.
        code: String,
        /// Who runs it.
        operator: String,
    },
    /// The motion has ended.
    Stop {
        /// Its code.
        code: String,
    },
    /// State the result.
    Result {
        /// The code of the trial.
        code: String,
        /// The result.
        result: Outcome,
    },
    /// Declare the trial invalid.
    #[serde(alias = "invalid")]
    Void {
        /// Its code.
        code: String,
        /// The reason.
        reason: String,
    },
    /// Correct the result of the last trial.
    Correct {
        /// Its code.
        code: String,
        /// The new result.
        result: Outcome,
        /// The reason.
        reason: String,
    },
    /// Begin a pause.
    Pause,
    /// End a pause.
    Resume,
}

/// One execution of a planned trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Attempt {
    /// Its code.
    pub code: String,
    /// The number of the planned trial.
    pub planned: usize,
    /// Who runs it.
    pub operator: String,
    /// When it began.
    pub start: Moment,
    /// Whether the motion has ended.
    pub stopped: bool,
    /// Its duration in seconds, if known.
    pub duration_s: Option<f64>,
    /// Its result, with corrections.
    pub result: Option<Outcome>,
    /// Number of corrections.
    pub corrections: u64,
    /// Whether it succeeded as it was first recorded, if a correction says otherwise.
    pub first: Option<bool>,
    /// Why it is invalid.
    pub void: Option<(String, VoidBy)>,
    /// What the switch measured.
    pub measured: Option<Measured>,
    /// Whether a script was told its policy.
    pub told: bool,
    /// The files that were attached to it.
    pub attachments: Vec<Attachment>,
}

impl Attempt {
    /// Whether it succeeded. `None` if it is not finished, or is repeated. Invalid after its end counts as a failure.
    pub fn success(&self) -> Option<bool> {
        match &self.void {
            None => self.result.as_ref().map(|result| result.success),
            Some((_, VoidBy::OperatorAfter)) => Some(false),
            Some((_, VoidBy::OperatorBefore | VoidBy::Infrastructure)) => None,
        }
    }

    /// Whether it was declared invalid and is repeated.
    pub fn is_repeated(&self) -> bool {
        self.void.as_ref().is_some_and(|(_, by)| *by != VoidBy::OperatorAfter)
    }
}

/// What comes next in a study.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The set-up of the next trial is to be made.
    Ready,
    /// A trial runs.
    Running,
    /// A trial has ended, and its result is open.
    Stopped,
    /// The operator has paused.
    Paused,
    /// No further trial is needed.
    Finished,
}

/// A study.
#[derive(Debug)]
pub struct Study {
    /// Its plan.
    pub plan: Plan,
    order: Vec<Planned>,
    codes: Codes,
    attempts: Vec<Attempt>,
    /// The code of the next attempt.
    code: String,
    paused: bool,
    unblinded: Option<bool>,
    /// The records of requests with an identifier.
    known: BTreeMap<String, Event>,
    judge: Judge,
    /// Blocks that the decision is about.
    judged: usize,
    decision: Decision,
}

impl Study {
    /// A study without trials.
    ///
    /// # Errors
    /// If the secret is not that of the plan, or the plan cannot be used.
    pub fn new(plan: Plan, secret: &Secret) -> Result<Self, Problem> {
        if plan.secret_sha256 != secret.sha256() {
            return Err(Problem::Plan("the secret is not the one that the plan names".to_owned()));
        }
        let order = order(&plan, secret)?;
        let mut codes = Codes::new(secret);
        let code = codes.next().unwrap_or_default();
        let (judge, decision) = (Judge::new(&plan)?, Decision::open(plan.arms.len()));
        Ok(Self {
            plan,
            order,
            codes,
            attempts: Vec::new(),
            code,
            paused: false,
            unblinded: None,
            known: BTreeMap::new(),
            judge,
            judged: 0,
            decision,
        })
    }

    /// All attempts so far.
    pub fn attempts(&self) -> &[Attempt] {
        &self.attempts
    }

    /// The planned trial of an attempt.
    pub fn planned(&self, attempt: &Attempt) -> &Planned {
        &self.order[attempt.planned]
    }

    /// The decision after the last complete block.
    pub fn decision(&self) -> &Decision {
        &self.decision
    }

    /// Whether the study was unblinded, and whether that was early.
    pub fn unblinded(&self) -> Option<bool> {
        self.unblinded
    }

    /// What comes next.
    pub fn phase(&self) -> Phase {
        match self.attempts.last() {
            Some(last) if last.void.is_none() && last.result.is_none() => {
                if last.stopped {
                    Phase::Stopped
                } else {
                    Phase::Running
                }
            }
            _ if self.next().is_none() => Phase::Finished,
            _ if self.paused => Phase::Paused,
            _ => Phase::Ready,
        }
    }

    /// The code of the trial that is next, runs or waits for its result.
    pub fn code(&self) -> &str {
        match (self.phase(), self.attempts.last()) {
            (Phase::Running | Phase::Stopped, Some(last)) => &last.code,
            _ => &self.code,
        }
    }

    /// The planned trial that is next, runs or waits for its result.
    pub fn current(&self) -> Option<&Planned> {
        match (self.phase(), self.attempts.last()) {
            (Phase::Running | Phase::Stopped, Some(last)) => self.order.get(last.planned),
            _ => self.next().and_then(|at| self.order.get(at)),
        }
    }

    /// The number of the planned trial that has no result yet. `None` at the end.
    fn next(&self) -> Option<usize> {
        if self.decision.is_final() || self.unblinded.is_some() {
            return None;
        }
        let from = self.attempts.last().map_or(0, |last| last.planned + usize::from(!last.is_repeated()));
        (from..self.order.len()).find(|at| !self.decision.dropped[self.order[*at].arm])
    }

    /// The results of the complete blocks.
    pub fn blocks(&self) -> Vec<BlockResults> {
        let arms = self.plan.arms.len();
        let mut blocks: Vec<BlockResults> = Vec::new();
        for attempt in &self.attempts {
            let planned = self.planned(attempt);
            let block = planned.block as usize;
            if blocks.len() <= block {
                let none = BlockResults { success: vec![None; arms], repeated: vec![0; arms], first: vec![None; arms] };
                blocks.resize(block + 1, none);
            }
            match attempt.success() {
                Some(success) => {
                    blocks[block].success[planned.arm] = Some(success);
                    blocks[block].first[planned.arm] = attempt.first;
                }
                None => blocks[block].repeated[planned.arm] += u64::from(attempt.is_repeated()),
            }
        }
        // The last block is complete if the next trial belongs to another one.
        let open = self.attempts.last().is_some_and(|last| {
            let block = self.planned(last).block;
            last.success().is_none()
                || self.order[last.planned + 1..].iter().any(|p| p.block == block && !self.decision.dropped[p.arm])
        });
        if open {
            blocks.pop();
        }
        blocks
    }

    /// The event of a request, if it fits the state. `None` if the same request was recorded already.
    ///
    /// # Errors
    /// If it contradicts itself or the state, or if another request came first.
    pub fn event(&self, id: &str, command: &Command, at: &Moment) -> Result<Option<Event>, Problem> {
        if id.len() > LONGEST_NAME {
            return Err(refused(format!("the identifier has {} bytes. At most {LONGEST_NAME} are accepted", id.len())));
        }
        if let Some(known) = self.known.get(id).filter(|_| !id.is_empty()) {
            return if matches(known, command) {
                Ok(None)
            } else {
                Err(Problem::Conflict("this identifier was used for another request".to_owned()))
            };
        }
        let phase = self.phase();
        match command {
            Command::Pause if phase == Phase::Ready => return Ok(Some(Event::Pause)),
            Command::Resume if phase == Phase::Paused => return Ok(Some(Event::Resume)),
            Command::Pause | Command::Resume => return Err(conflict("the study is in another state now")),
            _ => {}
        }
        let code = command.code();
        let last = self.attempts.last();
        let is_last = last.is_some_and(|last| last.code == code);
        let event = match (command, phase) {
            (Command::Start { operator, .. }, Phase::Ready) if code == self.code => {
                self.check_operator(operator)?;
                Event::Start { code: code.to_owned(), operator: operator.trim().to_owned() }
            }
            (Command::Stop { .. }, Phase::Running) if is_last => {
                let duration_s = last.and_then(|last| at.seconds_since(&last.start));
                Event::Stop { code: code.to_owned(), duration_s }
            }
            (Command::Result { result, .. }, Phase::Stopped) if is_last => {
                self.check(result)?;
                Event::Result { code: code.to_owned(), result: result.clone() }
            }
            (Command::Void { reason, .. }, Phase::Running | Phase::Stopped) if is_last => {
                check_text("reason", reason, true)?;
                let by = if phase == Phase::Running { VoidBy::OperatorBefore } else { VoidBy::OperatorAfter };
                Event::Void { code: code.to_owned(), reason: reason.clone(), by }
            }
            (Command::Correct { result, reason, .. }, Phase::Ready | Phase::Paused | Phase::Finished)
                if is_last && self.unblinded.is_none() && last.is_some_and(|last| last.result.is_some()) =>
            {
                self.check(result)?;
                check_text("reason", reason, true)?;
                Event::Correct { code: code.to_owned(), result: result.clone(), reason: reason.clone() }
            }
            _ => return Err(self.unfit(command, code)),
        };
        Ok(Some(event))
    }

    /// Why a request does not fit.
    fn unfit(&self, command: &Command, code: &str) -> Problem {
        let Some(attempt) = self.attempts.iter().find(|attempt| attempt.code == code) else {
            let next = self.code();
            if next == code {
                return refused(format!("trial {code} has not been started"));
            }
            return refused(format!("trial {code} is not the present one. The present trial is {next}"));
        };
        if attempt.result.is_some() && !matches!(command, Command::Correct { .. }) {
            return conflict(format!("trial {code} already has a result from another device. Yours was not recorded"));
        }
        match (&attempt.void, command) {
            (Some(_), _) => conflict(format!("trial {code} was declared invalid already. Yours was not recorded")),
            (None, Command::Start { .. }) => conflict(format!("trial {code} was started already by another device")),
            (None, Command::Stop { .. }) => conflict(format!("trial {code} was stopped already by another device")),
            (None, Command::Correct { .. }) => refused("only the result of the last trial can be corrected".to_owned()),
            (None, _) => refused(format!("trial {code} still runs. Press Stop first")),
        }
    }

    fn check_operator(&self, operator: &str) -> Result<(), Problem> {
        let operator = operator.trim();
        if operator.is_empty() || operator.len() > LONGEST_NAME {
            return Err(refused("the operator has no name, or a very long one".to_owned()));
        }
        if !self.plan.operators.is_empty() && !self.plan.operators.iter().any(|known| known == operator) {
            let known = self.plan.operators.join(", ");
            return Err(refused(format!("`{operator}` is not an operator of the plan. Expected one of {known}")));
        }
        Ok(())
    }

    /// Refuses results that contradict themselves or the plan.
    fn check(&self, result: &Outcome) -> Result<(), Problem> {
        check_text("notes", &result.notes, false)?;
        if result.measured.is_some() && self.plan.measure.is_none() {
            return Err(refused("the plan declares no measured number".to_owned()));
        }
        if result.measured.is_some_and(|number| !number.is_finite()) {
            return Err(refused("the measured number is not finite".to_owned()));
        }
        let words = |words: &[robogate_core::Word]| words.iter().map(|w| w.as_str()).collect::<Vec<_>>().join(", ");
        match (result.success, result.mode) {
            (true, Some(mode)) => Err(refused(format!("a success cannot have the failure mode `{}`", mode.as_str()))),
            (true, None) if result.stage.is_some() => {
                Err(refused("a success has reached every stage. Leave out the stage".to_owned()))
            }
            (true, None) => Ok(()),
            (false, None) => Err(refused(format!("a failure needs a failure mode: {}", words(&self.plan.modes)))),
            (false, Some(mode)) if !self.plan.modes.contains(&mode) => {
                let known = words(&self.plan.modes);
                Err(refused(format!("`{}` is not a failure mode of the plan. Expected one of {known}", mode.as_str())))
            }
            (false, Some(_)) => match result.stage {
                Some(stage) if !self.plan.stages.contains(&stage) => {
                    let known = words(&self.plan.stages);
                    Err(refused(format!("`{}` is not a stage of the plan. Expected one of {known}", stage.as_str())))
                }
                _ => Ok(()),
            },
        }
    }

    /// Applies a record. Records of a journal fit, because each was checked before it was written.
    pub fn apply(&mut self, record: &Record) {
        if !record.id.is_empty() {
            self.known.insert(record.id.clone(), record.event.clone());
        }
        match &record.event {
            Event::Opened { .. } => {}
            Event::Start { code, operator } => {
                let Some(planned) = self.next() else { return };
                self.attempts.push(Attempt {
                    code: code.clone(),
                    planned,
                    operator: operator.clone(),
                    start: record.at.clone(),
                    stopped: false,
                    duration_s: None,
                    result: None,
                    corrections: 0,
                    first: None,
                    void: None,
                    measured: None,
                    told: false,
                    attachments: Vec::new(),
                });
                self.code = self.codes.next().unwrap_or_default();
            }
            Event::Stop { code, duration_s } => self.change(code, |attempt| {
                attempt.stopped = true;
                attempt.duration_s = *duration_s;
            }),
            Event::Result { code, result } => self.change(code, |attempt| attempt.result = Some(result.clone())),
            Event::Void { code, reason, by } => self.change(code, |attempt| attempt.void = Some((reason.clone(), *by))),
            Event::Correct { code, result, .. } => self.change(code, |attempt| {
                // The first result counts, however often it is corrected.
                let first = attempt.first.or(attempt.success());
                attempt.result = Some(result.clone());
                attempt.corrections += 1;
                attempt.first = first;
            }),
            Event::Pause => self.paused = true,
            Event::Resume => self.paused = false,
            Event::Switch { code, measured } => self.change(code, |attempt| attempt.measured = Some(measured.clone())),
            Event::Attach { code, file } => self.change(code, |attempt| attempt.attachments.push(file.clone())),
            Event::Told { code } => self.change(code, |attempt| attempt.told = true),
            Event::Unblind { early, .. } => self.unblinded = Some(*early),
        }
        let blocks = self.blocks();
        if blocks.len() != self.judged || matches!(record.event, Event::Correct { .. }) {
            self.judged = blocks.len();
            self.decision = self.judge.decision(&blocks);
        }
    }

    fn change(&mut self, code: &str, change: impl FnOnce(&mut Attempt)) {
        if let Some(attempt) = self.attempts.iter_mut().rev().find(|attempt| attempt.code == code) {
            change(attempt);
        }
    }
}

impl Command {
    /// The code of the trial that it is about. Empty for a pause.
    fn code(&self) -> &str {
        match self {
            Self::Start { code, .. }
            | Self::Stop { code }
            | Self::Result { code, .. }
            | Self::Void { code, .. }
            | Self::Correct { code, .. } => code,
            Self::Pause | Self::Resume => "",
        }
    }
}

/// Whether an event is the record of this request.
fn matches(event: &Event, command: &Command) -> bool {
    match (event, command) {
        (Event::Start { code: a, .. }, Command::Start { code: b, .. })
        | (Event::Stop { code: a, .. }, Command::Stop { code: b })
        | (Event::Void { code: a, .. }, Command::Void { code: b, .. }) => a == b,
        (Event::Result { code: a, result: x }, Command::Result { code: b, result: y })
        | (Event::Correct { code: a, result: x, .. }, Command::Correct { code: b, result: y, .. }) => a == b && x == y,
        (Event::Pause, Command::Pause) | (Event::Resume, Command::Resume) => true,
        _ => false,
    }
}

fn check_text(what: &str, text: &str, needed: bool) -> Result<(), Problem> {
    if needed && text.trim().is_empty() {
        return Err(refused(format!("the {what} is empty")));
    }
    if text.len() > LONGEST_NOTE {
        return Err(refused(format!("the {what} has {} bytes. At most {LONGEST_NOTE} are accepted", text.len())));
    }
    Ok(())
}

fn refused(reason: String) -> Problem {
    Problem::Refused(reason)
}

fn conflict(reason: impl Into<String>) -> Problem {
    Problem::Conflict(reason.into())
}
