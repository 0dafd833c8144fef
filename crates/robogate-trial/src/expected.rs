//! What a plan states before the first trial: expected numbers of trials, and its rules in words.

use robogate_stats::contest::{Duel, Truth};
use robogate_stats::format::{percent, significant};
use robogate_stats::operating::{Schedule, characteristics};

use crate::decide::{budget, elimination, rate_test};
use crate::{Expected, Plan, Problem, Question};

/// Simulated contests for each expected number of several policies.
const CONTESTS: u64 = 1_000;
/// Seed of these contests.
const SEED: u64 = 1;

/// The expected number of trials for three true rates. For one and two policies the numbers are exact, for several they are means of
/// 1,000 simulated contests. Outcomes within a block are taken as independent, which is the case with the most trials.
///
/// # Errors
/// If the plan cannot be tested.
pub fn expected(plan: &Plan) -> Result<Vec<Expected>, Problem> {
    let wrong = |error: robogate_stats::contest::ContestError| Problem::Plan(error.to_string());
    let named = |name: &str, probability: f64| (name.to_owned(), probability);
    let arms = plan.arms.len();
    Ok(match plan.question {
        Question::AtLeast(limit) => {
            let rates = [limit, limit + 0.5 * (1.0 - limit), limit + 0.75 * (1.0 - limit)];
            let found = characteristics(rate_test(plan, limit), Schedule::Budget(budget(plan)), &rates);
            let row = |(rate, found): (f64, robogate_stats::operating::Characteristic)| Expected {
                rates: vec![rate],
                trials: found.trials,
                answers: vec![named("pass", found.met), named("fail", found.violated), named("not shown", found.open)],
            };
            rates.into_iter().zip(found).map(row).collect()
        }
        Question::Better => {
            let duel = Duel::new(plan.blocks, plan.error).map_err(wrong)?;
            let row = |(first, second): (f64, f64)| {
                let found = duel.expected(Truth { first, second, correlation: 0.0 });
                Expected {
                    rates: vec![first, second],
                    trials: 2.0 * found.blocks,
                    answers: vec![
                        named("the better one", found.second_better),
                        named("the worse one", found.first_better),
                        named("not shown", found.no_difference),
                    ],
                }
            };
            [(0.75, 0.75), (0.6, 0.9), (0.8, 0.95)].into_iter().map(row).collect()
        }
        Question::Best => {
            let contest = elimination(plan).map_err(wrong)?;
            let row = |(best, others): (f64, f64)| {
                let mut rates = vec![others; arms];
                rates[0] = best;
                let found = contest.expected(&rates, 0.0, CONTESTS, SEED).map_err(wrong)?;
                let answers = vec![
                    named("the best one alone", if best > others { found.best_alone } else { 0.0 }),
                    named("the best one eliminated", if best > others { found.best_dropped } else { 0.0 }),
                ];
                Ok(Expected { rates, trials: found.trials, answers })
            };
            [(0.75, 0.75), (0.9, 0.6), (0.95, 0.8)].into_iter().map(row).collect::<Result<_, Problem>>()?
        }
    })
}

/// The rules of a plan, as sentences.
pub fn rules(plan: &Plan) -> Vec<String> {
    let error = percent(plan.error);
    let (test, stop) = match plan.question {
        Question::AtLeast(limit) => (
            format!(
                "Test: sequential test of a success rate against {} with at most {} trials. The probability of a wrong pass is at most \
                 {error}, and that of a wrong fail too, over all looks together.",
                significant(limit, 4),
                plan.blocks
            ),
            "Stop: after the first trial that shows a pass or a fail, or after the last planned trial.",
        ),
        Question::Better => (
            format!(
                "Test: paired sequential test of two policies with at most {} blocks. The probability of calling one better if both are \
                 equal is at most {error}, over all looks together.",
                plan.blocks
            ),
            "Stop: after the first block that shows which policy is better, or that makes a difference unlikely to be shown, or after \
             the last planned block.",
        ),
        Question::Best => (
            format!(
                "Test: elimination of policies by paired sequential tests with at most {} blocks. The probability that the best policy is \
                 eliminated is at most {error}, over all looks together.",
                plan.blocks
            ),
            "Stop: once one policy is left, or after the last planned block. An eliminated policy has no further trials.",
        ),
    };
    [
        &test,
        stop,
        "Blocks: one set-up with one trial of each policy, in random order.",
        "Corrections: only the result of the last trial can be corrected, with a reason. The test counts the one of both results that is \
         against the claim.",
        "Exclusions: a trial is repeated only if it is declared invalid with a reason before Stop, or if the switch or the \
         server of the policy fails. A claim must hold even if each such trial had gone against it. A trial declared invalid \
         after Stop counts as a failure.",
        "Blinding: order, set-ups and codes follow from a secret that is published when the study is unblinded. Unblinding before \
         the end withdraws the claim.",
    ]
    .map(str::to_owned)
    .to_vec()
}
