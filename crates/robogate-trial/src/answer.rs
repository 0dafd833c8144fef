//! The answer of a study, in words and figures.

use std::collections::BTreeMap;

use robogate_stats::compare::fisher_exact;
use robogate_stats::format::{counted, percent, significant};
use robogate_stats::{Confidence, Interval, Trials, clopper_pearson};
use serde::Serialize;

use crate::{Question, Study, Verdict};

/// The answer of a study that was unblinded.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Answer {
    /// Version of the document.
    pub version: u32,
    /// `pass`, `fail`, `best`, `not_shown`, `open` or `withdrawn`.
    pub verdict: &'static str,
    /// The answer in one sentence.
    pub sentence: String,
    /// The best policy, for a verdict `best`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub best: Option<String>,
    /// Limits of the answer, as sentences.
    pub notes: Vec<String>,
    /// One row for each policy.
    pub arms: Vec<ArmAnswer>,
    /// Complete blocks.
    pub blocks: u64,
    /// Trials with a result.
    pub trials: u64,
}

/// The figures of one policy.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ArmAnswer {
    /// Its name.
    pub policy: String,
    /// Its trials in complete blocks.
    pub trials: u64,
    /// Successes among them.
    pub successes: u64,
    /// The 95 % interval of a fixed number of trials, for description. It does not account for the stopping rule.
    pub interval_95: [f64; 2],
    /// Whether it was eliminated.
    pub eliminated: bool,
    /// Trials that were declared invalid before their end, and repeated.
    pub repeated: u64,
    /// Trials that were declared invalid after their end, and count as failures.
    pub invalid_after: u64,
    /// Failures by mode.
    pub failures: BTreeMap<String, u64>,
    /// Median duration in seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// Median time of a reply at the server of the policy, in milliseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reply_ms: Option<f64>,
}

/// The median. `None` without values.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    Some(0.5 * (values.get(n.checked_sub(1)? / 2)? + values.get(n / 2)?))
}

/// The answer of a study. Its policies appear in it, so it is for a study that was unblinded.
pub fn answer(study: &Study) -> Answer {
    let blocks = study.blocks();
    let decision = study.decision();
    let arms: Vec<ArmAnswer> = (0..study.plan.arms.len()).map(|arm| arm_answer(study, arm)).collect();
    let name = |arm: usize| study.plan.arms[arm].name.clone();
    let early = study.unblinded() == Some(true);
    let (mut verdict, mut best) = ("open", None);
    let mut sentence = match (decision.answer, study.plan.question) {
        (Verdict::Open, _) => "The study has not reached an answer.".to_owned(),
        (Verdict::Pass, Question::AtLeast(limit)) => {
            verdict = "pass";
            format!("Pass: the success rate of {} is at least {}.", name(0), significant(limit, 4))
        }
        (Verdict::Fail, Question::AtLeast(limit)) => {
            verdict = "fail";
            format!("Fail: the success rate of {} is below {}.", name(0), significant(limit, 4))
        }
        (Verdict::Best(arm), _) => {
            verdict = "best";
            best = Some(name(arm));
            format!(
                "{} is better than {}.",
                name(arm),
                if arms.len() == 2 { name(1 - arm) } else { "all others".into() }
            )
        }
        (_, Question::AtLeast(limit)) => {
            verdict = "not_shown";
            format!(
                "Not shown: the trials show neither that the rate is at least {0} nor that it is below {0}.",
                significant(limit, 4)
            )
        }
        (_, Question::Better | Question::Best) => {
            verdict = "not_shown";
            let left: Vec<String> = (0..arms.len()).filter(|arm| !decision.dropped[*arm]).map(name).collect();
            format!("No difference was shown between {}. This does not prove that they are equal.", left.join(", "))
        }
    };
    let mut notes = Vec::new();
    if early && verdict != "open" {
        notes.push(format!("Without early unblinding the answer would have been: {sentence}"));
    }
    if early {
        (verdict, best) = ("withdrawn", None);
        sentence = "No claim: the study was unblinded before its end.".to_owned();
    }
    notes.extend(void_notes(&arms, decision.withheld));
    let told = study.attempts().iter().filter(|attempt| attempt.told).count() as u64;
    if told > 0 {
        notes.push(format!(
            "A script was told the policy of {}. Blinding depends on what it showed.",
            counted(told, "trial")
        ));
    }
    let corrections: u64 = study.attempts().iter().map(|attempt| attempt.corrections).sum();
    if corrections > 0 {
        notes.push(format!("Results were corrected {corrections} times; the journal has the reasons. The test counts the result that is against the claim."));
    }
    let trials = arms.iter().map(|arm| arm.trials).sum();
    Answer { version: 1, verdict, sentence, best, notes, arms, blocks: blocks.len() as u64, trials }
}

/// What the invalid trials mean.
fn void_notes(arms: &[ArmAnswer], withheld: bool) -> Vec<String> {
    let mut notes = Vec::new();
    if withheld {
        notes.push("Claim withdrawn: the trials that were declared invalid or corrected could reverse it.".to_owned());
    }
    let repeated: Vec<String> =
        arms.iter().filter(|arm| arm.repeated > 0).map(|arm| format!("{} {}", arm.policy, arm.repeated)).collect();
    if !repeated.is_empty() {
        notes.push(format!("Repeated trials: {}. The test counts each against the claim.", repeated.join(", ")));
    }
    let voids = |arm: &ArmAnswer| Trials::new(arm.repeated, arm.repeated + arm.trials).unwrap_or(Trials::NONE);
    let pairs = (0..arms.len()).flat_map(|i| (i + 1..arms.len()).map(move |j| (i, j)));
    let least = pairs.map(|(i, j)| fisher_exact(voids(&arms[i]), voids(&arms[j]))).fold(1.0, f64::min);
    let tests = arms.len() * arms.len().saturating_sub(1) / 2;
    if least * (tests.max(1) as f64) < 0.05 {
        notes.push("The repeated trials are uneven between the policies (Fisher's test, 5 %).".to_owned());
    }
    notes
}

fn arm_answer(study: &Study, arm: usize) -> ArmAnswer {
    let results = Trials::count(study.blocks().iter().filter_map(|block| block.success[arm]));
    let of_arm: Vec<&crate::Attempt> =
        study.attempts().iter().filter(|attempt| study.planned(attempt).arm == arm).collect();
    let Interval { low, high } = clopper_pearson(results, Confidence::P95);
    let mut failures = BTreeMap::new();
    for attempt in &of_arm {
        if let Some(mode) = attempt.result.as_ref().and_then(|result| result.mode) {
            *failures.entry(mode.as_str().to_owned()).or_insert(0) += 1;
        }
    }
    let count = |test: fn(&crate::Attempt) -> bool| of_arm.iter().filter(|attempt| test(attempt)).count() as u64;
    ArmAnswer {
        policy: study.plan.arms[arm].name.clone(),
        trials: results.n(),
        successes: results.successes(),
        interval_95: [low, high],
        eliminated: study.decision().dropped[arm],
        repeated: count(crate::Attempt::is_repeated),
        invalid_after: count(|attempt| attempt.void.is_some() && !attempt.is_repeated()),
        failures,
        duration_s: median(of_arm.iter().filter_map(|attempt| attempt.duration_s).collect()),
        reply_ms: median(of_arm.iter().filter_map(|a| a.measured.as_ref().and_then(|m| m.reply_ms)).collect()),
    }
}

impl ArmAnswer {
    /// Its rate with the interval, as text.
    pub fn rate(&self) -> String {
        let rate = if self.trials > 0 { percent(self.successes as f64 / self.trials as f64) } else { "-".to_owned() };
        let [low, high] = self.interval_95;
        format!("{}/{} = {rate} ({})", self.successes, self.trials, robogate_stats::format::percent_range([low, high]))
    }
}
