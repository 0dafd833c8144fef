//! The risk model of an active design, for the terminal and the page.

use std::path::Path;

use robogate_campaign::folder::ACTIVE;
use robogate_campaign::{ActiveReport, ActiveRound, Certificate};
use robogate_report::{ActiveModel, ActiveModelRound};
use robogate_stats::format::counted;

/// The model of the active design in the folder of a run. `None` without one.
pub(crate) fn of_run(dir: &Path) -> Option<ActiveModel> {
    let text = std::fs::read(dir.join(ACTIVE)).ok()?;
    let report: ActiveReport = serde_json::from_slice(&text).ok()?;
    let last = report.rounds.last()?;
    let mut sentences = vec![score(last)];
    sentences.extend(last.certificate.as_ref().map(certificate));
    Some(ActiveModel { sentences, rounds: report.rounds.iter().map(round).collect() })
}

fn score(last: &ActiveRound) -> String {
    match (&last.model, &last.problem) {
        (Some(model), _) => {
            format!("Brier score {:.3} in cross-validation, from {}", model.brier, counted(last.trained_on, "episode"))
        }
        (None, Some(problem)) => format!("none: {problem}"),
        (None, None) => "none: too few failures, or too few successes".to_owned(),
    }
}

fn certificate(found: &Certificate) -> String {
    let reached = if found.reached { "reached" } else { "not reached" };
    format!(
        "error of the model of the parameters: at most {:.3} (95 % confidence, {}); the requested error is {reached}",
        found.rms_bound,
        counted(found.pairs, "pair")
    )
}

fn round(round: &ActiveRound) -> ActiveModelRound {
    ActiveModelRound {
        episodes: round.episodes,
        trained_on: round.trained_on,
        boosting_share: round.model.map(|model| model.boosting_share),
        brier: round.model.map(|model| model.brier),
        log_loss: round.model.map(|model| model.log_loss),
    }
}
