//! The page of a study and its HTTP interface.
//!
//! | request | answer |
//! |---|---|
//! | `GET /`, `GET /page.js`, `GET /page.css` | the page, which contains no data |
//! | `GET /v1/state` | the present trial: code, set-up, phase, buttons |
//! | `POST /v1/do` | executes a [`Command`]: `{"id": "...", "do": "start", "code": "...", "operator": "..."}` |
//! | `GET /v1/policy` | the policy of the running trial, for the script that starts it |
//!
//! All but the page require a bearer token: that of the operator, and for `/v1/policy` that of the script. No reply to the
//! token of the operator depends on the policy: it contains no name, address or digest, and its codes are new for each trial.

mod http;

use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};

pub use http::serve;

use crate::{Command, Fault, Folder, Moment, Outcome, Phase, Problem, Setup, Switch};

/// A study that is served.
pub struct Service {
    folder: Mutex<Folder>,
    switch: Option<Switch>,
    /// The token of the operator.
    token: String,
    /// The token of the script that starts policies.
    script_token: String,
}

/// A request of the page.
#[derive(Debug, Deserialize)]
struct Request {
    /// An identifier that the device chose. It stays the same if the request is sent again.
    id: String,
    /// What to do.
    #[serde(flatten)]
    command: Command,
}

/// What the page shows.
#[derive(Debug, Serialize)]
struct State<'a> {
    version: u32,
    task: &'a str,
    robot: &'a str,
    phase: Phase,
    code: &'a str,
    setup: Setup,
    /// Number of the trial, from 1.
    trial: u64,
    most_trials: u64,
    /// Seconds since Start.
    elapsed_s: Option<f64>,
    /// Duration of the last motion, in seconds.
    duration_s: Option<f64>,
    /// Connections of the robot in this trial. `None` without a switch.
    connections: Option<u64>,
    modes: Vec<&'a str>,
    stages: Vec<&'a str>,
    /// The name of the number that is measured.
    measure: Option<&'a str>,
    operators: &'a [String],
    /// The last trial with its result, which can still be corrected.
    last: Option<Last<'a>>,
    /// Why the last trial is repeated, if it is.
    repeated: Option<&'a str>,
}

#[derive(Debug, Serialize)]
struct Last<'a> {
    code: &'a str,
    result: &'a Outcome,
}

impl Service {
    /// A study with its switch, if it has one, and the tokens of the operator and of the script.
    pub fn new(folder: Folder, switch: Option<Switch>, token: String, script_token: String) -> Self {
        Self { folder: Mutex::new(folder), switch, token, script_token }
    }

    fn folder(&self) -> MutexGuard<'_, Folder> {
        self.folder.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The state as a JSON document.
    pub fn state(&self) -> String {
        let folder = self.folder();
        let study = folder.study();
        let phase = study.phase();
        let running = study.attempts().last().filter(|_| matches!(phase, Phase::Running | Phase::Stopped));
        let finished = study.attempts().iter().filter(|attempt| attempt.success().is_some()).count() as u64;
        let before = study.attempts().last().filter(|_| running.is_none());
        let words = |words: &'_ [robogate_core::Word]| words.iter().map(|word| word.as_str()).collect();
        let state = State {
            version: 1,
            task: &study.plan.task,
            robot: &study.plan.robot,
            phase,
            code: if phase == Phase::Finished { "" } else { study.code() },
            setup: study.current().map(|planned| planned.setup.clone()).unwrap_or_default(),
            trial: finished + 1,
            most_trials: study.plan.most_trials(),
            elapsed_s: running
                .filter(|_| phase == Phase::Running)
                .and_then(|one| Moment::now().seconds_since(&one.start)),
            duration_s: running.and_then(|one| one.duration_s),
            connections: self.switch.as_ref().filter(|_| phase == Phase::Running).map(Switch::connections),
            modes: words(&study.plan.modes),
            stages: words(&study.plan.stages),
            measure: study.plan.measure.as_ref().map(|measure| measure.as_str()),
            operators: &study.plan.operators,
            last: before
                .filter(|_| study.unblinded().is_none())
                .and_then(|one| Some(Last { code: &one.code, result: one.result.as_ref()? })),
            repeated: before
                .filter(|one| one.is_repeated())
                .and_then(|one| one.void.as_ref())
                .map(|void| void.0.as_str()),
        };
        // Strings and finite numbers always serialise.
        serde_json::to_string(&state).unwrap_or_default()
    }

    /// Executes a request of the page. Returns whether it is new.
    ///
    /// # Errors
    /// If it is not a request, does not fit, or cannot be written.
    pub fn execute(&self, body: &[u8]) -> Result<bool, Problem> {
        let budget = robogate_core::budget::Budget::FILE;
        let request: Request =
            budget.json(body).map_err(|error| Problem::Refused(format!("not a request: {error}")))?;
        if request.id.is_empty() {
            return Err(Problem::Refused("the request has no identifier".to_owned()));
        }
        let mut folder = self.folder();
        // The robot stops before anything is written.
        let ends = matches!(request.command, Command::Stop { .. } | Command::Void { .. });
        let fits = folder.study().event(&request.id, &request.command, &Moment::now());
        let cut = matches!(fits, Ok(Some(_))) && ends && folder.study().phase() == Phase::Running;
        let measured = self.switch.as_ref().filter(|_| cut).map(Switch::close);
        let code = folder.study().code().to_owned();
        let new = folder.command(&request.id, &request.command)?;
        if let Some(measured) = measured {
            folder.measured(&code, measured)?;
        }
        if new
            && matches!(request.command, Command::Start { .. })
            && let (Some(switch), Some(planned)) = (&self.switch, folder.study().current())
        {
            switch.open(folder.study().code(), planned.arm);
        }
        Ok(new)
    }

    /// Ends a trial whose server failed. A fault of an earlier trial has no effect.
    ///
    /// # Errors
    /// If the journal cannot be written.
    pub fn fault(&self, fault: &Fault) -> Result<(), Problem> {
        let mut folder = self.folder();
        if folder.study().phase() != Phase::Running || folder.study().code() != fault.code {
            return Ok(());
        }
        let measured = self.switch.as_ref().map(Switch::close);
        folder.fault(&fault.reason)?;
        measured.map_or(Ok(()), |measured| folder.measured(&fault.code, measured))
    }

    /// Ends a trial that runs when a study with a switch begins to be served: its connections ended with the server before, and
    /// the switch opens only at Start. It is repeated. Returns its code.
    ///
    /// # Errors
    /// If the journal cannot be written.
    pub fn interrupted(&self) -> Result<Option<String>, Problem> {
        let mut folder = self.folder();
        if self.switch.is_none() || folder.study().phase() != Phase::Running {
            return Ok(None);
        }
        let code = folder.study().code().to_owned();
        folder.fault("the server was started again while the trial ran")?;
        Ok(Some(code))
    }

    /// The policy of the running trial, for a script.
    ///
    /// # Errors
    /// If no trial runs, or the journal cannot be written.
    pub fn policy(&self) -> Result<String, Problem> {
        self.folder().tell()
    }
}
