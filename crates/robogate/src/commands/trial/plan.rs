//! `robogate trial plan`: writes the plan and the secret of a study.

use std::path::PathBuf;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_core::Word;
use robogate_dictionary::files;
use robogate_gate::evidence::{Envelope, PrivateKey};
use robogate_session::{named_space, open_source};
use robogate_stats::format::{counted, number, percent, significant};
use robogate_trial::{Arm, FORMAT, Folder, Plan, Population, Question, Secret, Time, expected, rules};

use super::exit;
use crate::exit::{DONE, Exit, OrExit};
use crate::place;
use crate::terminal::{line, note, warning, wrapped};

/// Type of the signed plan.
pub(super) const PAYLOAD_TYPE: &str = "application/vnd.robogate.trial-plan+json";
/// The signed plan, in the folder of a study.
pub(super) const SIGNED: &str = "plan.dsse.json";

/// Plan a study: question, policies, set-ups, largest number of trials.
///
/// One policy with --at-least: is its success rate at least that? Two policies: which is better? Three or more: which is the
/// best? Each block is one set-up, drawn at random, with one trial of each policy in random order. The order is secret until the
/// study is unblinded.
#[derive(Debug, Args)]
pub(super) struct PlanOf {
    /// Folder of the study; it must not exist, or be empty
    #[arg(value_name = "DIR", value_parser = place::local())]
    study: PathBuf,
    /// Name a policy, with the SHA-256 of its files if known; repeat for each
    #[arg(long, value_name = "NAME[@SHA256]", required = true)]
    policy: Vec<String>,
    /// Ask whether the success rate of one policy is at least RATE, above 0 and below 1
    #[arg(long, value_name = "RATE")]
    at_least: Option<f64>,
    /// Draw set-ups from this space: a name of `robogate list spaces`, or a file (TOML)
    #[arg(long, value_name = "SPACE", group = "population")]
    space: Option<String>,
    /// Draw set-ups from this list (CSV): one row for each, columns are properties
    #[arg(long, value_name = "FILE", group = "population")]
    setups: Option<PathBuf>,
    /// Draw set-ups from N that are only numbered
    #[arg(long, value_name = "N", group = "population")]
    count: Option<u64>,
    /// Take task, robot, failure modes, phases as stages, and the space from this run
    #[arg(long, value_name = "RUN")]
    sim: Option<PathBuf>,
    /// Choose the largest number of blocks (1 to 500); default: 100 for one policy, 52 for two, 90 for more
    #[arg(long, value_name = "N")]
    blocks: Option<u64>,
    /// Choose the probability of a wrong claim over all looks, above 0 and below 0.5
    #[arg(long, value_name = "P", default_value_t = 0.05)]
    error: f64,
    /// Name the task; default: that of --sim, or `task`
    #[arg(long)]
    task: Option<String>,
    /// Name the robot; default: that of --sim, or `robot`
    #[arg(long)]
    robot: Option<String>,
    /// List the failure modes, one button each; default: those of --sim, or `failed`
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    modes: Vec<String>,
    /// List the stages of the task in order; default: the phases of --sim, or none
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    stages: Vec<String>,
    /// Name a number that the operator may measure in each trial, with its unit, such as peak_force_n
    #[arg(long, value_name = "NAME")]
    measure: Option<String>,
    /// List the operators; default: each operator enters a name
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    operators: Vec<String>,
    /// State the minutes that a change of the set-up, one trial with its reset, and one session take: 4,2,120
    #[arg(long, value_name = "CHANGE,TRIAL,SESSION", value_delimiter = ',')]
    minutes: Vec<f64>,
    /// Sign the plan with this private key from `robogate keys new`
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
}

/// The right answers of a plan, by their names.
const RIGHT: [&str; 3] = ["pass", "the better one", "the best one alone"];
/// The probability of a right answer below which a study is hardly worth its trials.
const FEWEST_ANSWERS: f64 = 0.2;

impl PlanOf {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let key = self.key.as_deref().map(PrivateKey::read).transpose()?;
        let secret = Secret::draw().map_err(exit)?;
        let plan = self.plan(&secret)?;
        Folder::create(&self.study, &plan, &secret).map_err(exit)?;
        if let Some(key) = key {
            let signed = Envelope::sign(PAYLOAD_TYPE, plan.to_json().as_bytes(), &key).to_json();
            let path = self.study.join(SIGNED);
            files::write(&path, signed).with_context(|| format!("cannot write {}", path.display())).or_broken()?;
            note(format_args!("signed with key {}", key.public().id()));
        }
        print(&plan);
        // An answer for none of the listed rates: the people at the robot would work for nothing.
        let right = |row: &robogate_trial::Expected| {
            row.answers.iter().filter(|(name, _)| RIGHT.contains(&name.as_str())).any(|(_, p)| *p >= FEWEST_ANSWERS)
        };
        if !plan.expected.iter().any(right) {
            warning(format_args!(
                "for none of these rates does the study find the answer in {} of cases: raise --blocks",
                percent(FEWEST_ANSWERS)
            ));
        }
        note(format_args!(
            "The order of the policies is secret. Do not read {} before the end.",
            self.study.join(robogate_trial::SECRET).display()
        ));
        Ok(DONE)
    }

    fn plan(&self, secret: &Secret) -> Result<Plan, Exit> {
        let sim = self.sim.as_deref().map(open_source).transpose()?;
        let known = sim.as_ref().map(|source| source.dictionary().provenance());
        let arms: Vec<Arm> = self.policy.iter().map(|text| arm(text)).collect();
        let question = match (self.at_least, arms.len()) {
            (Some(limit), _) => Question::AtLeast(limit),
            (None, 1) => {
                return Err(anyhow!("one policy\nHint: give --at-least RATE, or a second --policy")).or_usage();
            }
            (None, 2) => Question::Better,
            (None, _) => Question::Best,
        };
        let population = match (&self.space, &self.setups, self.count, known) {
            (Some(wanted), ..) => Population::Space(named_space(wanted).or_usage()?),
            (None, Some(file), ..) => Population::from_csv(file).map_err(exit)?,
            (None, None, Some(count), _) => Population::Count(count),
            (None, None, None, Some(known)) => Population::Space(known.space.clone()),
            (None, None, None, None) => {
                return Err(anyhow!("no set-ups\nHint: give --space, --setups, --count or --sim")).or_usage();
            }
        };
        let named = |given: &Option<String>, of: Option<&str>, default: &str| {
            given.clone().or_else(|| of.map(str::to_owned)).unwrap_or_else(|| default.to_owned())
        };
        let mut modes = words("--modes", &self.modes)?;
        if modes.is_empty() {
            let of_task = known.map(|known| known.task.modes().map(|mode| mode.as_str().to_owned()).collect());
            modes = words("--sim", &of_task.unwrap_or_else(|| vec!["failed".to_owned()]))?;
        }
        let mut stages = words("--stages", &self.stages)?;
        if stages.is_empty() {
            stages = known.map(|known| known.task.phases.clone()).unwrap_or_default();
        }
        let time = match self.minutes.as_slice() {
            [change_min, trial_min, session_min] => {
                if self.minutes.iter().any(|minutes| !(*minutes >= 0.0 && minutes.is_finite())) || *session_min <= 0.0 {
                    return Err(anyhow!("--minutes: expected three numbers of at least 0, and a session above 0"))
                        .or_usage();
                }
                Some(Time { change_min: *change_min, trial_min: *trial_min, session_min: *session_min })
            }
            [] => None,
            _ => return Err(anyhow!("--minutes: expected three numbers, such as 4,2,120")).or_usage(),
        };
        let blocks = self.blocks.unwrap_or(match question {
            Question::AtLeast(_) => 100,
            Question::Better => 52,
            Question::Best => 90,
        });
        let mut plan = Plan {
            format: FORMAT,
            question,
            arms,
            population,
            task: named(&self.task, known.map(|known| known.task.name.as_str()), "task"),
            robot: named(&self.robot, known.map(|known| known.robot.name.as_str()), "robot"),
            modes,
            stages,
            measure: self.measure.as_ref().map(|name| Word::new(name).context("--measure")).transpose().or_usage()?,
            operators: self.operators.iter().map(|name| name.trim().to_owned()).collect(),
            blocks,
            error: self.error,
            time,
            expected: Vec::new(),
            rules: Vec::new(),
            secret_sha256: secret.sha256(),
        };
        plan.check().map_err(exit)?;
        plan.expected = expected(&plan).map_err(exit)?;
        plan.rules = rules(&plan);
        Ok(plan)
    }
}

/// A policy of the command line: its name, and the SHA-256 of its files.
fn arm(text: &str) -> Arm {
    let is_hash = |hash: &str| hash.len() == 64 && hash.bytes().all(|byte| byte.is_ascii_hexdigit());
    match text.rsplit_once('@').filter(|(_, hash)| is_hash(hash)) {
        Some((name, hash)) => Arm { name: name.to_owned(), sha256: Some(hash.to_ascii_lowercase()) },
        None => Arm { name: text.to_owned(), sha256: None },
    }
}

fn words(option: &str, texts: &[String]) -> Result<Vec<Word>, Exit> {
    texts.iter().map(|text| Word::new(text.trim()).with_context(|| option.to_owned()).or_usage()).collect()
}

fn print(plan: &Plan) {
    line(format_args!(
        "At most {} in {} ({})",
        counted(plan.most_trials(), "trial"),
        counted(plan.blocks, "block"),
        plan.population.describe()
    ));
    for rule in &plan.rules {
        wrapped(rule);
    }
    line("");
    line("Expected number of trials");
    for expected in &plan.expected {
        let rates: Vec<String> = expected.rates.iter().map(|rate| significant(*rate, 3)).collect();
        let answers: Vec<String> = expected.answers.iter().map(|(name, p)| format!("{name} {}", percent(*p))).collect();
        wrapped(&format!(
            "true rates {}: {} trials; {}",
            rates.join(", "),
            number(expected.trials),
            answers.join(", ")
        ));
    }
    if let Some(time) = plan.time {
        let arms = plan.arms.len() as f64;
        let minutes = |trials: f64| trials * time.trial_min + trials / arms * time.change_min;
        let most = minutes(plan.most_trials() as f64);
        let means = plan.expected.iter().map(|expected| number(minutes(expected.trials) / 60.0)).collect::<Vec<_>>();
        line(format_args!(
            "Time: {} h expected, at most {} h in {} sessions",
            means.join(", "),
            number(most / 60.0),
            (most / time.session_min).ceil()
        ));
    }
    line(format_args!("Plan SHA-256 {}", plan.sha256()));
}
