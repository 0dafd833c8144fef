//! What a gate prints about a suite that is a published benchmark: success per task, and published results beside it.

use robogate_core::Suite;
use robogate_dictionary::Provenance;
use robogate_gate::Evaluation;

use crate::terminal::{bold, line, percent};

/// Prints the success of each group with its interval, and the published results, if the run's suite lists some.
pub(crate) fn print(evaluation: &Evaluation, provenance: &Provenance) {
    let Some(suite) = suite_of(provenance).filter(|suite| !suite.published().is_empty()) else { return };
    line("");
    line(bold(format_args!(
        "  {}: success of {} per task, with exact 95 % intervals",
        suite.name(),
        provenance.policy
    )));
    for group in &evaluation.groups {
        let [low, high] = group.interval_95;
        let rate = match group.valid {
            0 => "no valid episode".to_owned(),
            n => format!("{:>7}  [{}, {}]", percent(group.successes as f64 / n as f64), percent(low), percent(high)),
        };
        let name = suite.group_description(&group.category, &group.group).unwrap_or(&group.group);
        line(format_args!("     {:>3} of {:<3}  {rate}  {name}", group.successes, group.valid));
    }
    line("");
    line(bold("  Published results on this suite"));
    let wide = suite.published().iter().map(|published| published.policy.chars().count()).max().unwrap_or(0);
    for published in suite.published() {
        let same = provenance.policy.eq_ignore_ascii_case(&published.policy);
        let remark = if same { "the same policy by its name" } else { "not comparable: another policy" };
        let rate = percent(published.success);
        line(format_args!("     {rate:>7}  {:<wide$}  {remark}; {}", published.policy, published.source));
    }
}

/// The suite of a run, from its plan.
fn suite_of(provenance: &Provenance) -> Option<Suite> {
    serde_json::from_value(provenance.plan.get("suite")?.get("suite")?.clone()).ok()
}
