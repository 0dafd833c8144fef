//! The safety case of evidence: an argument from files to the claim that the policy may run.
//!
//! Claims, defeaters, and the files that they rest on follow from the evidence alone. The status of a claim is computed:
//!
//! - **not supported** if a file contradicts it, or one of its parts is not supported;
//! - **undeveloped** if no file is about it, if a defeater is open, or if one of its parts is undeveloped;
//! - **supported** otherwise.
//!
//! A *defeater* is what would make a claim false. It is open, answered by a file or by the method, or confirmed by a file.
//!
//! [`SafetyCase::to_gsn`] writes the argument in Goal Structuring Notation, as gsn2x reads it, with the dialectic extension of version 3 of the
//! GSN Community Standard for defeaters. Evidence that is invalid gives no argument.

mod clauses;
mod gsn;
mod page;
mod parts;
mod population;
mod requirements;
mod subject;

use robogate_gate::evidence::{EnvironmentBinding, Judged, PolicyBinding, Role};
use robogate_gate::{Mode, Verdict};
use robogate_stats::format::percent;

pub use clauses::Clause;
pub use page::safety_case_html;

/// Whether the evidence supports a claim, from the best to the worst.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Support {
    /// Files support it, and no defeater is open.
    Supported,
    /// No file is about it, or a defeater is open.
    Undeveloped,
    /// A file contradicts it.
    NotSupported,
}

impl Support {
    /// The name in data and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Supported => "supported",
            Self::Undeveloped => "undeveloped",
            Self::NotSupported => "not supported",
        }
    }
}

/// What the evidence says about a defeater, from the worst to the best.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Answered {
    /// It applies.
    Confirmed,
    /// Nothing.
    Open,
    /// It does not apply.
    Yes,
}

impl Answered {
    /// The name in data and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Yes => "answered",
            Self::Confirmed => "confirmed",
        }
    }
}

/// What would make a claim false.
#[derive(Debug, Clone, PartialEq)]
pub struct Defeater {
    /// Its name: letters, digits and hyphens.
    pub name: String,
    /// What would be the case.
    pub text: String,
    /// What the evidence says about it.
    pub state: Answered,
    /// Why, as a sentence.
    pub because: String,
    /// The files that say so: their paths in the folder.
    pub files: Vec<String>,
}

impl Defeater {
    fn new(
        name: impl Into<String>,
        text: impl Into<String>,
        state: Answered,
        because: impl Into<String>,
        files: Vec<String>,
    ) -> Self {
        Self { name: name.into(), text: text.into(), state, because: because.into(), files }
    }
}

/// A claim with the files and claims that support it.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    /// Its name: letters, digits and hyphens.
    pub name: String,
    /// The claim, as a sentence.
    pub text: String,
    /// Whether the evidence supports it.
    pub support: Support,
    /// Why, as a sentence.
    pub because: String,
    /// The files that support it: their paths in the folder.
    pub files: Vec<String>,
    /// How its parts support it. Empty without parts.
    pub strategy: String,
    /// The claims that it consists of.
    pub parts: Vec<Self>,
    /// What would make it false.
    pub defeaters: Vec<Defeater>,
}

impl Claim {
    /// A claim that rests on files. Without a file it is undeveloped.
    fn on(
        name: impl Into<String>,
        text: impl Into<String>,
        because: impl Into<String>,
        files: Vec<String>,
        defeaters: Vec<Defeater>,
    ) -> Self {
        let of = |state| defeaters.iter().any(|defeater| defeater.state == state);
        let support = match () {
            () if of(Answered::Confirmed) => Support::NotSupported,
            () if files.is_empty() || of(Answered::Open) => Support::Undeveloped,
            () => Support::Supported,
        };
        let (name, text, because) = (name.into(), text.into(), because.into());
        Self { name, text, support, because, files, strategy: String::new(), parts: Vec::new(), defeaters }
    }

    /// A claim that consists of others.
    fn of_parts(
        name: &str,
        text: impl Into<String>,
        strategy: &str,
        parts: Vec<Self>,
        defeaters: Vec<Defeater>,
    ) -> Self {
        let own = Self::on(name, text, "", vec![String::new()], defeaters);
        let worst = parts.iter().map(|part| part.support).chain([own.support]).max();
        let support = if parts.is_empty() { Support::Undeveloped } else { worst.unwrap_or(own.support) };
        let of = |support| parts.iter().filter(move |part| part.support == support).count();
        let [supported, undeveloped, not] = [Support::Supported, Support::Undeveloped, Support::NotSupported].map(of);
        let because = format!("Parts: {supported} supported, {undeveloped} undeveloped, {not} not supported.");
        Self { support, because, files: Vec::new(), strategy: strategy.to_owned(), parts, ..own }
    }

    /// This claim and all claims below it.
    pub fn all(&self) -> Vec<&Self> {
        std::iter::once(self).chain(self.parts.iter().flat_map(Self::all)).collect()
    }
}

/// The kind of a note.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoteKind {
    /// What the argument is about.
    Context,
    /// What is taken as true without evidence.
    Assumption,
    /// Why a way of arguing is sound.
    Justification,
}

/// A context, an assumption or a justification of the whole argument.
#[derive(Debug, Clone, PartialEq)]
pub struct Note {
    /// Its name: letters, digits and hyphens.
    pub name: &'static str,
    /// Its kind.
    pub kind: NoteKind,
    /// Its text.
    pub text: String,
}

/// A file that the argument rests on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Solution {
    /// Its path in the folder.
    pub path: String,
    /// What it is.
    pub what: &'static str,
    /// SHA-256 (hex).
    pub sha256: String,
}

/// The argument of evidence.
#[derive(Debug, Clone, PartialEq)]
pub struct SafetyCase {
    /// The claim that everything else supports.
    pub claim: Claim,
    /// What the argument is about, and what it assumes.
    pub notes: Vec<Note>,
    /// The files that it rests on, in the order of their first use.
    pub solutions: Vec<Solution>,
    /// The clauses of standards and regulations that it can support.
    pub clauses: Vec<Clause>,
}

/// The operating ranges in the folder.
pub const OPERATING_DOMAIN: &str = "compliance/operating-domain.odd.yaml";

/// What an argument does not claim.
const NO_CONFORMITY: &str = "Conformity with ISO 10218-2:2025 or with Regulation (EU) 2023/1230 is not claimed. The clauses name where this \
    evidence can support the risk assessment and the technical documentation. Whether a clause applies, and whether it is fulfilled, is for the \
    manufacturer, the integrator and, where required, a notified body to decide. RoboGate judges whether a policy does its task. It is not a \
    safety function and does not replace one.";

impl SafetyCase {
    /// The argument of evidence. `operating_domain` is the SHA-256 (hex) of [`OPERATING_DOMAIN`].
    ///
    /// # Errors
    /// Invalid evidence, which supports no argument, with the reason.
    pub fn of(judged: &Judged<'_>, operating_domain: &str) -> Result<Self, String> {
        let evaluation = judged.evaluation;
        if evaluation.verdict == Verdict::Invalid {
            return Err(format!("the evidence is invalid: {}", evaluation.because));
        }
        let mut parts = vec![
            requirements::claim(judged),
            population::claim(judged),
            subject::claim(judged),
            parts::question(judged),
            parts::cell(judged),
            parts::deployed(judged),
            parts::operation(judged),
        ];
        parts.extend(parts::fleet(judged));
        parts.extend(parts::upgrades(judged));
        let text = format!(
            "The policy {} may run the task {} {} on {} in the cell, within the operating ranges.",
            evaluation.policy, evaluation.task.name, evaluation.task.version, evaluation.robot
        );
        let strategy = "Argue over what was shown, over whom and what it applies to, and over what can defeat it.";
        let claim = Claim::of_parts("may-run", text, strategy, parts, Vec::new());
        let solutions = solutions(judged, &claim, operating_domain);
        let clauses = clauses::of(judged, &claim);
        Ok(Self { notes: notes(judged), solutions, clauses, claim })
    }
}

/// The paths of the files with these roles.
fn paths(judged: &Judged<'_>, roles: &[Role]) -> Vec<String> {
    roles.iter().flat_map(|role| judged.with_role(*role)).map(|file| file.path.clone()).collect()
}

fn solutions(judged: &Judged<'_>, claim: &Claim, operating_domain: &str) -> Vec<Solution> {
    let mut found: Vec<Solution> = Vec::new();
    let all = claim.all();
    let of_claim = |claim: &&Claim| {
        let defeaters = claim.defeaters.iter().flat_map(|defeater| defeater.files.clone());
        claim.files.iter().cloned().chain(defeaters).collect::<Vec<String>>()
    };
    for path in all.iter().flat_map(of_claim) {
        if found.iter().any(|solution| solution.path == path) {
            continue;
        }
        if path == OPERATING_DOMAIN {
            let sha256 = operating_domain.to_owned();
            found.push(Solution { path, what: "the operating ranges as ASAM OpenODD 1.0", sha256 });
        } else if let Some(file) = judged.files.iter().find(|file| file.path == path) {
            found.push(Solution { path, what: what(file.role), sha256: file.sha256.clone() });
        }
    }
    found
}

/// What a file of a role is.
fn what(role: Role) -> &'static str {
    match role {
        Role::Dictionary => "every episode, with its parameters, outcome and measures",
        Role::Against => "every episode of the policy that may be replaced",
        Role::Requirements => "the requirements",
        Role::Baseline => "the baseline of relative requirements",
        Role::Real => "trials of the real robot, in strata",
        Role::Evaluation => "every figure with its bounds, and the verdict",
        Role::Plan => "the plan of the campaign, written before the first episode",
        Role::Question => "the question of the gate, written before the first episode",
        Role::Registration => "the registration of the run before its first episode",
        Role::Suite => "the scenarios of the suite",
        Role::Robot => "a file of the robot",
        Role::Environment => "a file of the environment",
        Role::Policy => "the file of the policy",
        Role::Fingerprint => {
            "what identifies the judged policy: its answers to requests of the gate, or the files of its checkpoint"
        }
        Role::Repeats => "what repeats of the first episodes after the last one",
        Role::Admission => "the comparison of the deployed policy with the judged one",
        Role::Monitor => "the reference of the monitor",
        Role::Warning => "the detector that warns within an episode, with its promise",
        Role::Requalification => "what an upgrade changes",
        Role::Fleet => "the result of the fleet of units",
        Role::Summary => "the summary of the campaign",
        Role::PublicKey | Role::Compliance | Role::Attachment => "an attached file",
    }
}

fn notes(judged: &Judged<'_>) -> Vec<Note> {
    let (evaluation, provenance) = (judged.evaluation, judged.provenance());
    let note = |name, kind, text| Note { name, kind, text };
    let engine = &provenance.engine;
    let version = engine.version.as_deref().unwrap_or("of unknown version");
    let method = match evaluation.requirements.mode {
        Mode::Confidence => format!(
            "Each requirement is tested at {} confidence, for every outcome that the invalid episodes could have had: a pass and a fail are \
             each wrong in at most {} of such gates.",
            percent(evaluation.requirements.confidence),
            percent(1.0 - evaluation.requirements.confidence)
        ),
        Mode::Point => "The observed figures are compared with the limits. No error probability is stated.".to_owned(),
    };
    vec![
        note("policy", NoteKind::Context, format!("Policy: {}, {}.", evaluation.policy, PolicyBinding::of(provenance))),
        note("robot", NoteKind::Context, match &provenance.robot.sha256 {
            Some(sha256) => format!("Robot: {}, files with SHA-256 {sha256}.", evaluation.robot),
            None => format!("Robot: {}.", evaluation.robot),
        }),
        note(
            "environment",
            NoteKind::Context,
            format!(
                "Environment: {} {version}, task {} {}; SHA-256 {}.",
                engine.name,
                evaluation.task.name,
                evaluation.task.version,
                EnvironmentBinding::of(provenance).sha256
            ),
        ),
        note("population", NoteKind::Context, format!("Population: {}.", evaluation.population)),
        note("requirements", NoteKind::Context, format!("Requirements: {}.", evaluation.requirements.name)),
        note("conformity", NoteKind::Context, NO_CONFORMITY.to_owned()),
        note(
            "unchanged",
            NoteKind::Assumption,
            "Policy, robot, tools, parts and settings stay as they were judged. A change needs `robogate requalify` or a new gate.".to_owned(),
        ),
        note(
            "took-place",
            NoteKind::Assumption,
            "The episodes took place as recorded. `robogate verify --rerun` repeats some of them; a signature names who vouches for them."
                .to_owned(),
        ),
        note(
            "requirements-fit",
            NoteKind::Assumption,
            "The requirements, their limits and the operating ranges are those that the risk assessment of the cell asks for.".to_owned(),
        ),
        note("method", NoteKind::Justification, method),
    ]
}
